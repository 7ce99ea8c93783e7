"""The pressure at a frame's time: its value, and whether it rises or falls.

Reading the log is in `tracker.study.pressure_log`.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..tracker.types import FloatArray

# The direction reverses when the pressure goes back by this part of its range: more than noise, less than a step.
_MIN_REVERSAL = 0.04
_MAX_GAP_S = 0.5  # in a longer gap of the log the pressure is unknown


class PressureSignal:
    """Pressure and its direction over the time of a video that shares the log's clock.

    Parameters
    ----------
    time_s : ndarray of float
        (M,) increasing times, s.
    pressure_kpa : ndarray of float
        (M,) pressures, kPa; NaN where unknown.
    """

    def __init__(self, time_s: FloatArray, pressure_kpa: FloatArray) -> None:
        known = np.isfinite(pressure_kpa)
        self._time_s, self._pressure_kpa = time_s[known], pressure_kpa[known]

    @property
    def range_kpa(self) -> float:
        """Difference of the highest and the lowest pressure, kPa; 0 without data."""
        return float(np.ptp(self._pressure_kpa)) if len(self._pressure_kpa) else 0.0

    def at(self, time_s: float) -> tuple[float, int] | None:
        """Return the pressure and its direction at a time.

        Parameters
        ----------
        time_s : float
            Time, s.

        Returns
        -------
        tuple of float and int or None
            Pressure in kPa, and 1 while it rises or 0 while it falls; None before, after and in a gap of the log.
        """
        after = int(np.searchsorted(self._time_s, time_s))
        if after == len(self._time_s) or time_s < self._time_s[0]:
            return None
        if self._time_s[after] - self._time_s[max(after - 1, 0)] > _MAX_GAP_S:
            return None
        return float(np.interp(time_s, self._time_s, self._pressure_kpa)), int(self._rising[after])

    @cached_property
    def _rising(self) -> np.ndarray:
        """Whether the pressure rises, (M,) bool; reversals within the noise are ignored."""
        pressure, turn = self._pressure_kpa, _MIN_REVERSAL * self.range_kpa
        # Every sample belongs to the branch between the two turning points around it.
        turns, rising = [0], True
        for index, value in enumerate(pressure.tolist()):
            ahead = value - pressure[turns[-1]]
            if (ahead >= 0) == rising:
                turns[-1] = index
            elif abs(ahead) > turn:
                turns.append(index)
                rising = not rising
        # `turns` are the extrema, starting with the end of the first rise.
        branch = np.searchsorted(np.array(turns), np.arange(len(pressure)))
        return np.asarray(branch % 2 == 0)
