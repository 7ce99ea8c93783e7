"""Units of pressure and time: their spellings in headers, and their factors to kPa and s. No file is read here."""

from __future__ import annotations

import re

from ..errors import PressureLogError

# Exact by definition, except psi (1 lbf / in2, six digits more than any sensor has).
KPA_IN = {
    "kPa": 1.0,
    "Pa": 0.001,
    "hPa": 0.1,
    "MPa": 1000.0,
    "mbar": 0.1,
    "bar": 100.0,
    "psi": 6.894757293168,
}
# A voltage is a pressure only by the sensor's gain, which the user gives.
VOLT_IN = {"V": 1.0, "mV": 0.001}
PRESSURE_UNITS = (*KPA_IN, *VOLT_IN)

SECONDS_IN = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}

_SPELLINGS = {
    **{unit.lower(): unit for unit in (*KPA_IN, *VOLT_IN, *SECONDS_IN)},
    **dict.fromkeys(("psig", "lbf/in2", "lb/in2"), "psi"),
    **dict.fromkeys(("kpag", "kilopascal", "kilopascals"), "kPa"),
    **dict.fromkeys(("pascal", "pascals"), "Pa"),
    **dict.fromkeys(("barg",), "bar"),
    **dict.fromkeys(("millibar", "millibars"), "mbar"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("millivolt", "millivolts"), "mV"),
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "millis", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("µs", "μs", "usec", "micros", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("minute", "minutes"), "min"),
    **dict.fromkeys(("hour", "hours"), "h"),
    **dict.fromkeys(("day", "days"), "d"),
}
TIME_WORDS = {
    *("time", "times", "t", "timestamp", "timestamps", "tout", "clock", "date", "datetime", "elapsed"),
    *("zeit", "uhrzeit", "zeitstempel", "temps", "tiempo", "tempo"),
}
_BRACKETS = re.compile(r"[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$")
# Characters of a header that are looked at: the patterns take time with the square of its length.
_LONGEST_NAME = 300
_WORDS = re.compile(r"[^\W_]+")


def known_unit(text: str) -> str | None:
    """The unit named by a text, in this module's spelling; None if there is none. "mPa" is not read as "MPa".

    Parameters
    ----------
    text : str
        A unit as written.

    Returns
    -------
    str or None
        A key of `KPA_IN`, `VOLT_IN` or `SECONDS_IN`.

    Examples
    --------
    >>> known_unit("KPA"), known_unit("seconds"), known_unit("mPa"), known_unit("apples")
    ('kPa', 's', None, None)
    """
    text = text.strip()
    if text == "mPa":
        return None
    return _SPELLINGS.get(text.lower())


def split_unit(header: str) -> tuple[str, str | None]:
    """Name and unit of a column's header: "P [kPa]", "Pressure (psi)", "pressure_psi", "time / s", "kPa".

    Without brackets, only a time has a unit of time: a "P_d" is no pressure in days.

    Parameters
    ----------
    header : str
        The header as written.

    Returns
    -------
    name : str
        Name of the column, without its unit.
    unit : str or None
        As `known_unit` spells it; text in brackets that is no known unit is returned unchanged.

    Examples
    --------
    >>> [split_unit(h) for h in ("P [kPa]", "pressure_psi", "time / s", "P (apples)", "P_d", "kPa")]
    [('P', 'kPa'), ('pressure', 'psi'), ('time', 's'), ('P', 'apples'), ('P_d', None), ('kPa', 'kPa')]
    """
    header = header[:_LONGEST_NAME]
    header = header.strip()
    brackets = _BRACKETS.search(header)
    if brackets:
        inside = brackets[1].strip()
        return header[: brackets.start()].strip() or header, known_unit(inside) or inside or None
    alone = known_unit(header)
    if alone in PRESSURE_UNITS or header == "s":
        return header, alone
    parts = re.match(r"(.*[^\W_])[\s_/,.:-]+(\S+)$", header)
    unit = known_unit(parts[2]) if parts else None
    if parts and unit and (unit in PRESSURE_UNITS or words_of(parts[1]) & TIME_WORDS):
        return parts[1], unit
    return header, None


def words_of(name: str) -> set[str]:
    """Words of a name in lower case, split at punctuation and before capitals.

    Parameters
    ----------
    name : str
        A name.

    Returns
    -------
    set of str
        The words.

    Examples
    --------
    >>> sorted(words_of("PressureRef_2"))
    ['2', 'pressure', 'ref']
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return {word.lower() for word in _WORDS.findall(spaced)}


def factor_to_kpa(unit: str, gain_kpa_per_v: float | None, where: str) -> float:
    """kPa in one of a column's units; for a voltage, by the sensor's gain.

    Parameters
    ----------
    unit : str
        Unit of the column, as `known_unit` spells it.
    gain_kpa_per_v : float or None
        Gain of the sensor, kPa per V.
    where : str
        Begins error messages.

    Returns
    -------
    float
        kPa per unit.

    Raises
    ------
    PressureLogError
        Not a pressure, or a voltage without a gain, or a gain without a voltage. `where` begins the message.
    """
    if unit in KPA_IN:
        if gain_kpa_per_v is not None:
            raise PressureLogError(f"{where}: gain_kpa_per_v is for a pressure in V or mV, got one in {unit}")
        return KPA_IN[unit]
    if unit in VOLT_IN:
        if gain_kpa_per_v is None:
            raise PressureLogError(
                f"{where}: the pressure is in {unit}; give gain_kpa_per_v, the sensor's gain"
            )
        return VOLT_IN[unit] * gain_kpa_per_v
    raise PressureLogError(f"{where}: expected a pressure unit ({', '.join(PRESSURE_UNITS)}), got '{unit}'")
