"""Live values collected into an ordinary angle table."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from ..angle import AngleDefinition
from ..results import AngleTable, json_ready
from ..types import Flag
from .low_latency import LiveValue


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
