"""Live values sent to other programs: one line of text each, to a stream and to a UDP address."""

from __future__ import annotations

import json
import math
import socket
from typing import Any

from ..errors import BendtrackError, reason
from .low_latency import LiveValue

# Decimals, the same as in an angle table.
_DECIMALS = {"time_s": 6, "angle_deg": 4, "angle_sd_deg": 4, "likelihood": 4, "latency_ms": 2}
COLUMNS = (
    *("frame", "time_s", "angle_deg", "angle_sd_deg", "likelihood", "flag"),
    *("latency_ms", "passed_over"),
)
# Columns whose name in the files differs from the attribute of `LiveValue`.
_ATTRIBUTES = {"passed_over": "dropped"}
HEADER = ",".join(COLUMNS)
"""The first line of the CSV."""


def line_of(value: LiveValue, format: str) -> str:
    """A value as a row of CSV or as a JSON object, without the newline. NaN is empty or null.

    Parameters
    ----------
    value : LiveValue
        The value.
    format : str
        "csv" or "jsonl".

    Returns
    -------
    str
        One line, with the columns of `COLUMNS`.
    """
    cells: dict[str, Any] = {name: getattr(value, _ATTRIBUTES.get(name, name)) for name in COLUMNS}
    for name, decimals in _DECIMALS.items():
        # "+ 0.0": no "-0.000"
        cells[name] = None if math.isnan(cells[name]) else round(cells[name], decimals) + 0.0
    if format == "jsonl":
        return json.dumps(cells)
    return ",".join(
        "" if cell is None else f"{cell:.{_DECIMALS[name]}f}" if name in _DECIMALS else str(cell)
        for name, cell in cells.items()
    )


class UdpTarget:
    """A UDP address to which each line is sent as one datagram. To be used in a `with` block.

    Parameters
    ----------
    address : str
        HOST:PORT; an IPv6 host is in brackets.

    Raises
    ------
    BendtrackError
        Not an address, or an unknown host.
    """

    def __init__(self, address: str) -> None:
        self._name = address
        host, colon, port = address.rpartition(":")
        if not (host and colon and port.isdecimal() and 0 < int(port) < 1 << 16):
            raise BendtrackError(f"--udp: expected HOST:PORT such as 127.0.0.1:5005, got '{address}'")
        plain = host.removeprefix("[").removesuffix("]")
        try:
            self._found = socket.getaddrinfo(plain, int(port), type=socket.SOCK_DGRAM)[0]
        except (OSError, UnicodeError) as error:
            raise BendtrackError(f"--udp: cannot find '{host}' ({reason(error)})") from error

    def __enter__(self) -> UdpTarget:
        self._socket = socket.socket(*self._found[:3])
        return self

    def __exit__(self, *exception: object) -> None:
        self._socket.close()

    def send(self, text: str) -> None:
        """Send one datagram; UDP does not report whether anything receives it.

        Parameters
        ----------
        text : str
            Contents of the datagram.

        Raises
        ------
        BendtrackError
            The network cannot be reached.
        """
        try:
            self._socket.sendto(text.encode(), self._found[4])
        except ConnectionError:
            pass  # no receiver yet
        except OSError as error:
            raise BendtrackError(f"--udp: cannot send to {self._name} ({reason(error)})") from error
