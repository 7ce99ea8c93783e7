"""Live values collected into an ordinary angle table, and kept on disk as they come."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ..angle import AngleDefinition
from ..errors import ResultsError, reason
from ..links import make_folder
from ..results import AngleTable, json_ready
from ..types import Flag
from .low_latency import LiveValue

PARTIAL_SUFFIX = ".partial.csv"
"""Ends the name of the table of a recording that has not ended, or was killed."""

# As in the CSV of an angle table.
_DECIMALS = {"time_s": 6, "angle_deg": 4, "angle_sd_deg": 4, "xy": 3, "likelihood": 4}


class PartialTable:
    """A CSV of an angle table that grows by each value: what a kill or a power cut leaves of a recording.

    Parameters
    ----------
    path : Path
        The file; its folder is made.
    keypoints : sequence of str
        K names, in the order of the detector's arrays.

    Raises
    ------
    ResultsError
        The file cannot be written.
    """

    def __init__(self, path: Path, keypoints: Sequence[str]) -> None:
        self.path = path
        self._frame = 0
        columns = ["frame", "time_s", "angle_deg", "angle_sd_deg", "flag"]
        columns += [f"{name}_{part}" for name in keypoints for part in ("x", "y", "likelihood")]
        self._empty = "," * (3 * len(keypoints))
        try:
            make_folder(path.parent)
            # Exclusive: what an earlier recording left is the user's. One write a line, so that no line is half.
            self._file: TextIO = path.open("x", encoding="utf-8", newline="\n", buffering=1)
            self._file.write(",".join(columns) + "\n")
        except OSError as error:
            raise ResultsError(
                f"--out: expected a file that can be written, got {path} ({reason(error)})"
            ) from error

    def add(self, value: LiveValue) -> None:
        """Write a value, after rows for the frames dropped before it.

        Parameters
        ----------
        value : LiveValue
            The next value of the source.

        Raises
        ------
        ResultsError
            The disk is full, or gone.
        """
        lines = [self._line(time_s, "", "", Flag.PASSED_OVER, self._empty) for time_s in value.dropped_s]
        found = value.found
        points = "".join(
            f",{_cell(xy[0], 'xy')},{_cell(xy[1], 'xy')},{_cell(likelihood, 'likelihood')}"
            for xy, likelihood in zip(found.xy[0], found.likelihood[0], strict=True)
        )
        angle, sd = _cell(value.angle_deg, "angle_deg"), _cell(value.angle_sd_deg, "angle_sd_deg")
        lines.append(self._line(value.time_s, angle, sd, value.flag, points))
        try:
            self._file.write("".join(lines))
            self._file.flush()
        except OSError as error:
            raise ResultsError(f"{self.path}: cannot be written ({reason(error)})") from error

    def close(self, *, keep: bool) -> None:
        """End it; it goes unless it is to be kept.

        Parameters
        ----------
        keep : bool
            Whether it is all there is of the recording.
        """
        with suppress(OSError):
            self._file.close()
        if not keep:
            self.path.unlink(missing_ok=True)

    def _line(self, time_s: float, angle: str, sd: str, flag: Flag, points: str) -> str:
        line = f"{self._frame},{_cell(time_s, 'time_s')},{angle},{sd},{flag}{points}\n"
        self._frame += 1
        return line


def _cell(number: float, kind: str) -> str:
    return "" if np.isnan(number) else f"{round(float(number), _DECIMALS[kind]) + 0.0:.{_DECIMALS[kind]}f}"


class Recording:
    """Rows of an angle table, one for every frame of the source; dropped frames have a time and a flag only.

    Parameters
    ----------
    keypoints : sequence of str
        K names, in the order of the detector's arrays.
    definition : AngleDefinition
        Which angle was measured.
    """

    def __init__(self, keypoints: Sequence[str], definition: AngleDefinition) -> None:
        self._keypoints = tuple(keypoints)
        self._definition = definition
        self._numbers = array("d")  # row by row; an hour at 60 frames/s takes 55 MB
        self._flag: list[Flag] = []

    def __len__(self) -> int:
        return len(self._flag)

    def add(self, value: LiveValue) -> None:
        """Keep a value, and the times of the frames dropped before that value.

        Parameters
        ----------
        value : LiveValue
            The next value of the source.
        """
        k = len(self._keypoints)
        for time_s in value.dropped_s:
            self._numbers.extend([time_s, *[np.nan] * (2 + 7 * k)])
            self._flag.append(Flag.PASSED_OVER)
        self._numbers.extend([value.time_s, value.angle_deg, value.angle_sd_deg])
        for values in (value.found.xy, value.found.likelihood, value.found.covariance):
            self._numbers.extend(values.ravel().tolist())
        self._flag.append(value.flag)

    def table(
        self,
        source: str,
        detector_provenance: Mapping[str, Any],
        settings: Mapping[str, Any],
        warnings: Sequence[str] = (),
    ) -> AngleTable:
        """The angle table of all values kept.

        Parameters
        ----------
        source : str
            Name of the camera, file or stream.
        detector_provenance : mapping of str to Any
            `Detector.provenance` of the detector.
        settings : mapping of str to Any
            Settings from `tracking.tracking_settings`.
        warnings : sequence of str, optional
            Notes for the user, a line each.

        Returns
        -------
        AngleTable
            One row for every frame of the source.
        """
        t, k = len(self._flag), len(self._keypoints)
        rows = np.array(self._numbers).reshape(t, 3 + 7 * k)
        time_s, angle_deg, angle_sd_deg = rows[:, :3].T
        xy, likelihood, covariance = np.split(rows[:, 3:], [2 * k, 3 * k], axis=1)
        n_dropped = sum(flag == Flag.PASSED_OVER for flag in self._flag)
        provenance = {
            "bendtrack": version("bendtrack"),
            # No hash: a live recording never counts as the tracked table of a file.
            "video": {
                "name": source,
                "sha256": None,
                "live": True,
                "frames": t,
                "frames_passed_over": n_dropped,
            },
            "detector": detector_provenance,
            "settings": settings,
            "warnings": list(warnings),
            "rows": {kind.value or "sound": self._flag.count(kind) for kind in Flag},
        }
        return AngleTable(
            time_s=time_s,
            angle_deg=angle_deg,
            angle_sd_deg=angle_sd_deg,
            flag=np.array(self._flag, dtype=np.str_),
            xy=xy.reshape(t, k, 2),
            likelihood=likelihood,
            covariance=covariance.reshape(t, k, 2, 2),
            keypoints=self._keypoints,
            definition=self._definition,
            provenance=json_ready(provenance),
        )
