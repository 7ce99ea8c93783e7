"""Data of one trial for the analysis: angle and pressure on one clock, and the uncertainty of that clock.

Files are read and pressure is resampled at the frames in `trial_data.py`; the analysis is elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from ..types import FloatArray


class Kind(StrEnum):
    """Kind of a trial's pressure: a staircase (static), or cycles (dynamic)."""

    STATIC = "static"
    DYNAMIC = "dynamic"


@dataclass(frozen=True)
class Shift:
    """Shift between the log's clock and the video's: video time = log time + `delay_s`.

    Attributes
    ----------
    delay_s : float
        Video time minus log time, s.
    sd_s : float
        Standard uncertainty of the delay, s.
    method : str
        "shared clock", "given delay" or "sync event".
    """

    delay_s: float
    sd_s: float
    method: str


@dataclass(frozen=True)
class TrialData:
    """One trial on the video's clock.

    Attributes
    ----------
    name, design : str
        Names of the trial and of its design in the study file.
    kind : Kind
        Static or dynamic.
    frequency_hz, pressure_pp_kpa : float or None
        Nominal values of the study file; None where not given.
    time_s : ndarray of float
        (T,) the frames' times, rising.
    angle_deg, angle_sd_deg : ndarray of float
        (T,) NaN where a frame gives no angle; the sd is one frame's.
    pressure_kpa : ndarray of float
        (T,) pressure at the frames' times, NaN in the log's gaps.
    pressure_rate_kpa_s : ndarray of float
        (T,) slope of the filtered pressure at the frames' times.
    log_time_s, log_pressure_kpa : ndarray of float
        (M,) the log as recorded, its times on the video's clock.
    log_reference_kpa : ndarray of float or None
        (M,) the reference wave at the log's times, if there is one.
    model_pressure_kpa, model_angle_deg : ndarray of float or None
        (S,) the model (FEM) curve, if there is one.
    shift : Shift
        Shift between the two clocks.
    warnings : tuple of str
        Warnings from reading the trial, one sentence each.
    provenance : mapping of str to Any
        JSON-ready, where the data came from.
    angle_common_sd_deg : float
        Standard uncertainty common to all angles of the trial (a bias of the labels, for example).
    saturated_s : ndarray of float
        Times at which the pressure sensor was saturated, s.
    """

    name: str
    design: str
    kind: Kind
    frequency_hz: float | None
    pressure_pp_kpa: float | None
    time_s: FloatArray
    angle_deg: FloatArray
    angle_sd_deg: FloatArray
    pressure_kpa: FloatArray
    pressure_rate_kpa_s: FloatArray
    log_time_s: FloatArray
    log_pressure_kpa: FloatArray
    shift: Shift
    log_reference_kpa: FloatArray | None = None
    model_pressure_kpa: FloatArray | None = None
    model_angle_deg: FloatArray | None = None
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    angle_common_sd_deg: float = 0.0
    saturated_s: FloatArray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        on_frames = (self.angle_deg, self.angle_sd_deg, self.pressure_kpa, self.pressure_rate_kpa_s)
        if any(values.shape != self.time_s.shape for values in on_frames):
            raise ValueError(
                f"expected one value a frame, {self.time_s.shape}, got {[v.shape for v in on_frames]}"
            )
        if self.log_pressure_kpa.shape != self.log_time_s.shape:
            raise ValueError(
                f"expected a pressure for each time of the log, "
                f"got {self.log_pressure_kpa.shape} and {self.log_time_s.shape}"
            )

    @property
    def frame_s(self) -> float:
        """Median time from frame to frame, s; NaN with fewer than two frames."""
        return float(np.median(np.diff(self.time_s))) if self.time_s.size > 1 else float("nan")

    @property
    def shift_sd_s(self) -> float:
        """Standard uncertainty of the shift used by the analysis, s: `shift.sd_s`, with a lower limit.

        The time of a frame's exposure is known to within half a frame either way; as a standard uncertainty that is
        half a frame / sqrt(3) (a rectangular distribution, GUM 4.3.7).
        """
        return max(self.shift.sd_s, 0.5 * self.frame_s / 3**0.5)
