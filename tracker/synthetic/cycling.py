"""A dynamic trial without a video: pressure and angle in closed form at any time, and what is true of it.

How the wave of a pump differs from its reference, how cycles differ from each other, and the trial's true
numbers live here; what is written to disk in `study.py`. The loop's shape is `response.py`'s:

    up    angle = start + (peak - start) f(psi(x))          x = pressure / largest pressure
    down  angle = end + (peak - end) f(1 - psi(1 - x))

so a steady cycle (start = end) has the area lambda / 2 (peak - start) x largest pressure. Between its turns the
pressure may move as it likes as long as it never turns back, for time does not appear: the corners of the
triangle are rounded and the flanks ripple, the area stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..types import FloatArray
from .response import bend, play

# The first pressurisation of a trial bends a little less far than the later ones, and begins at rest.
_FIRST_PEAK = 0.985
# Half the width of the rounding of a turn, and the size and rate of the ripple: a 5 Hz loop on a pump station.
_ROUNDING_S = 0.03
_RIPPLE_KPA = 0.15
_RIPPLE_HZ = 1.25
# How fine the loops are on which the numbers without a closed form are summed.
_FINE = 40_000


@dataclass(frozen=True)
class CyclingTrial:
    """Triangle cycles of one actuator, at times of the pressure log's clock.

    Parameters
    ----------
    frequency_hz, peak_kpa, cycles : float or int
        The wave, from 0 to `peak_kpa`, after `rest_s` at 0 and before another.
    angle_max_deg : float
        Largest angle of a steady cycle.
    residual_deg : float
        Angle at 0 kPa after every cycle.
    hysteresis_ratio : float
        Of a steady cycle, to the axes (paper, section on dynamic analysis).
    lag_s : float
        By how much the pressure follows its reference late.
    peak_sd_deg, ratio_sd : float
        How cycles differ (standard deviations of the largest angle and of the ratio).
    rest_s : float
        Time at 0 kPa before and after.
    first_differs : bool
        The first cycle begins at 0 deg and bends less far, as that of a rested actuator.
    seed : int
        Draws the differences of the cycles.
    """

    frequency_hz: float
    peak_kpa: float
    angle_max_deg: float
    hysteresis_ratio: float
    residual_deg: float = 0.0
    cycles: int = 12
    lag_s: float = 0.0
    peak_sd_deg: float = 0.0
    ratio_sd: float = 0.0
    rest_s: float = 1.0
    first_differs: bool = True
    seed: int = 0

    @property
    def duration_s(self) -> float:
        """From the beginning of the log to its end."""
        return self.cycles / self.frequency_hz + 2 * self.rest_s

    @cached_property
    def _peaks_deg(self) -> FloatArray:
        draws = np.random.default_rng([self.seed, 21]).standard_normal(self.cycles)
        peaks = self.angle_max_deg + self.peak_sd_deg * draws
        if self.first_differs:
            peaks[0] *= _FIRST_PEAK
        return peaks

    @cached_property
    def _cubics(self) -> FloatArray:
        """lambda of every cycle."""
        draws = np.random.default_rng([self.seed, 22]).standard_normal(self.cycles)
        ratios = self.hysteresis_ratio + self.ratio_sd * draws
        return 2 * ratios * self.angle_max_deg / (self.angle_max_deg - self.residual_deg)

    def reference_kpa(self, time_s: FloatArray) -> FloatArray:
        """The triangle that the pump was told to follow."""
        phase = (np.asarray(time_s, float) - self.rest_s) * self.frequency_hz
        wave: FloatArray = self.peak_kpa * (1 - np.abs(2 * (phase % 1) - 1))
        return np.where((phase < 0) | (phase > self.cycles), 0.0, wave)

    def pressure_kpa(self, time_s: FloatArray) -> FloatArray:
        """The pressure in the actuator, without noise."""
        cycle, phase = self._phase(time_s)
        wave = self.peak_kpa * self._wave(phase)
        return np.where((cycle < 0) | (cycle >= self.cycles), 0.0, wave)

    def angle_deg(self, time_s: FloatArray) -> FloatArray:
        """The bending angle, without noise."""
        cycle, phase = self._phase(time_s)
        inside = np.clip(cycle, 0, self.cycles - 1)
        rested_deg = 0.0 if self.first_differs else self.residual_deg
        start = np.where(inside == 0, rested_deg, self.residual_deg)
        angle = _loop(
            phase < 0.5,
            self._wave(phase),
            self._cubics[inside],
            start,
            self._peaks_deg[inside],
            self.residual_deg,
        )
        angle = np.where(cycle < 0, rested_deg, angle)
        return np.where(cycle >= self.cycles, self.residual_deg, angle)

    def truth(self, pressure_noise_kpa: float = 0.0) -> dict[str, float]:
        """The numbers of a steady cycle (mean over what cycles could be), by name and unit.

        pressure_noise_kpa : of the sensor; it adds to the error of the pressure against its reference
        """
        cubic = 2 * self.hysteresis_ratio * self.angle_max_deg / (self.angle_max_deg - self.residual_deg)
        width = bend(1 - play(np.array(0.5), cubic)) - bend(play(np.array(0.5), cubic))
        time_s = np.linspace(0, self.duration_s, _FINE * 4)
        error_kpa = self.pressure_kpa(time_s) - self.reference_kpa(time_s)
        rmse_kpa = float(np.sqrt(np.mean(error_kpa**2) + pressure_noise_kpa**2))
        return {
            "angle_max_deg": self.angle_max_deg,
            "residual_deg": self.residual_deg,
            "area_deg_kpa": self.hysteresis_ratio * self.peak_kpa * self.angle_max_deg,
            "hysteresis_ratio": self.hysteresis_ratio,
            "hysteresis_ratio_extremes": cubic / 2,
            "mid_pressure_width_deg": float((self.angle_max_deg - self.residual_deg) * width),
            "pressure_max_kpa": self.peak_kpa,
            "period_s": 1 / self.frequency_hz,
            "first_angle_max_deg": float(self._peaks_deg[0]),
            "ratio_per_second_shift": (self.shifted_ratio(1e-3) - self.shifted_ratio(-1e-3)) / 2e-3,
            "control_rmse_kpa": rmse_kpa,
            "control_nrmse": rmse_kpa / self.peak_kpa,
        }

    def shifted_ratio(self, shift_s: float) -> float:
        """Ratio of a steady cycle when the pressure is taken `shift_s` too late: pressure(t + shift), angle(t).

        A sum over a fine loop, for the rounded wave has no simple formula. For a plain triangle a small shift
        adds 4 frequency x shift x (largest - residual angle) / largest angle.
        """
        phase = np.arange(_FINE) / _FINE
        cubic = 2 * self.hysteresis_ratio * self.angle_max_deg / (self.angle_max_deg - self.residual_deg)
        x = self._wave(phase)
        angle = _loop(
            phase < 0.5,
            x,
            np.full(_FINE, cubic),
            np.full(_FINE, self.residual_deg),
            np.full(_FINE, self.angle_max_deg),
            self.residual_deg,
        )
        moved = self._wave((phase + shift_s * self.frequency_hz) % 1)
        return float(-np.sum(angle * (np.roll(moved, -1) - np.roll(moved, 1)) / 2) / self.angle_max_deg)

    def _phase(self, time_s: FloatArray) -> tuple[np.ndarray, FloatArray]:
        """Number of the cycle (negative before the first, `cycles` after the last) and place in it, 0 to 1."""
        turns = (np.asarray(time_s, float) - self.rest_s - self.lag_s) * self.frequency_hz
        cycle = np.floor(turns).astype(int)
        return cycle, turns - cycle

    def _wave(self, phase: FloatArray) -> FloatArray:
        """Relative pressure over one cycle: 0, up to 1 at the middle, and back, turning nowhere else."""
        waves = max(round(_RIPPLE_HZ / self.frequency_hz), 1)
        size = _RIPPLE_KPA / (2 * self.peak_kpa)
        away = np.abs((phase + size * np.sin(2 * np.pi * waves * phase)) - 0.5)
        half = _ROUNDING_S * self.frequency_hz
        # The mean of the triangle over 2 `half`, stretched so that it still runs from 0 to 1.
        top, bottom = (away**2 + half**2) / half, ((0.5 - away) ** 2 + half**2) / half
        mean = np.where(away < half, 1 - top, np.where(0.5 - away < half, bottom, 1 - 2 * away))
        wave: FloatArray = (mean - half) / (1 - 2 * half)
        return wave


def _loop(
    rising: np.ndarray, x: FloatArray, cubic: FloatArray, start: FloatArray, peak: FloatArray, end: float
) -> FloatArray:
    up = start + (peak - start) * bend(play(x, cubic))
    down = end + (peak - end) * bend(1 - play(1 - x, cubic))
    return np.where(rising, up, down)
