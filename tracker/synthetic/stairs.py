"""A static trial without a video: a staircase of pressures, the angle at every stair, and a model curve beside it.

Everything has a closed form; what is written to disk is `study.py`'s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..types import FloatArray

_LEVELS = 11
# After a step the pressure comes near its new level with this time constant, and the silicone creeps after it.
_PRESSURE_S = 0.16
_CREEP_S = 0.6


@dataclass(frozen=True)
class StaircaseTrial:
    """0 to `peak_kpa` in ten equal steps, each level held for `hold_s`; times of the pressure log's clock.

    Parameters
    ----------
    angle_max_deg : float
        Steady angle at `peak_kpa`; the actuator begins straight.
    model_rmse_deg : float or None
        Root mean square over the eleven levels of (model - steady angle); None: there is no model.
    """

    angle_max_deg: float
    model_rmse_deg: float | None = None
    peak_kpa: float = 50.0
    hold_s: float = 10.0

    @property
    def duration_s(self) -> float:
        """From the beginning of the log to its end."""
        return _LEVELS * self.hold_s

    @property
    def levels_kpa(self) -> FloatArray:
        return np.linspace(0, self.peak_kpa, _LEVELS)

    @property
    def steady_deg(self) -> FloatArray:
        """Steady angle at every level."""
        return self._steady_deg(self.levels_kpa)

    def reference_kpa(self, time_s: FloatArray) -> FloatArray:
        """The staircase that the pump was told to follow."""
        return self.levels_kpa[self._level(time_s)]

    def pressure_kpa(self, time_s: FloatArray) -> FloatArray:
        """The pressure in the actuator, without noise."""
        return self._settling(time_s, self.levels_kpa, _PRESSURE_S)

    def angle_deg(self, time_s: FloatArray) -> FloatArray:
        """The bending angle, without noise."""
        return self._settling(time_s, self.steady_deg, _CREEP_S)

    def model_curve(self) -> tuple[FloatArray, FloatArray]:
        """Pressures (kPa) and angles (deg) of the model, finer than the stairs and with them among its points."""
        if self.model_rmse_deg is None:
            raise ValueError("this trial has no model")
        fine_kpa = np.linspace(0, self.peak_kpa, 5 * (_LEVELS - 1) + 1)
        scale = self.model_rmse_deg / math.sqrt(np.mean(_off(self.levels_kpa / self.peak_kpa) ** 2))
        return fine_kpa, self._steady_deg(fine_kpa) + scale * _off(fine_kpa / self.peak_kpa)

    def truth(self, pressure_noise_kpa: float = 0.0) -> dict[str, float | list[float]]:
        """The numbers, by name and unit. pressure_noise_kpa : of the sensor (see `CyclingTrial.truth`)."""
        # Ten steps, each an exponential whose square has the integral step^2 tau / 2, seen for eleven holds.
        step_kpa = self.peak_kpa / (_LEVELS - 1)
        mean_square = (_LEVELS - 1) * step_kpa**2 * _PRESSURE_S / 2 / self.duration_s
        rmse_kpa = math.sqrt(mean_square + pressure_noise_kpa**2)
        truth: dict[str, float | list[float]] = {
            "levels_kpa": self.levels_kpa.tolist(),
            "steady_deg": self.steady_deg.tolist(),
            "control_rmse_kpa": rmse_kpa,
            "control_nrmse": rmse_kpa / self.peak_kpa,
        }
        if self.model_rmse_deg is not None:
            truth["model_rmse_deg"] = self.model_rmse_deg
            truth["model_nrmse"] = self.model_rmse_deg / self.angle_max_deg
        return truth

    def _steady_deg(self, pressure_kpa: FloatArray) -> FloatArray:
        x = np.asarray(pressure_kpa, float) / self.peak_kpa
        angle: FloatArray = self.angle_max_deg * (0.25 * x + 0.75 * x**2.5)
        return angle

    def _level(self, time_s: FloatArray) -> np.ndarray:
        return np.clip(np.floor(np.asarray(time_s, float) / self.hold_s), 0, _LEVELS - 1).astype(int)

    def _settling(self, time_s: FloatArray, levels: FloatArray, constant_s: float) -> FloatArray:
        level = self._level(time_s)
        steps = np.diff(levels, prepend=levels[0])
        since = np.maximum(np.asarray(time_s, float) - level * self.hold_s, 0)
        value: FloatArray = levels[level] - steps[level] * np.exp(-since / constant_s)
        return value


def _off(x: FloatArray) -> FloatArray:
    """How a model strays from what it models: nowhere at rest, first below, then above."""
    strays: FloatArray = x * np.sin(1.6 * np.pi * x - 2.2)
    return strays
