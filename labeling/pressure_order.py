"""Frames in the order of pressure: how high it was at a time, and whether it rose or fell.

Reading the log is `tracker.study.pressure_log`'s.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..tracker.types import FloatArray

# The pressure has turned when it has gone back by this part of its range: more than noise, less than a step.
_TURN = 0.04
_PAUSE_S = 0.5  # a hole in the log over which nothing is known of the pressure


class PressureOrder:
    """Pressure and direction at times of a video whose clock is the log's.

    Parameters
    ----------
    time_s, pressure_kpa : (M,) increasing times, NaN where the pressure is unknown
    """

    def __init__(self, time_s: FloatArray, pressure_kpa: FloatArray) -> None:
        known = np.isfinite(pressure_kpa)
        self._time_s, self._pressure_kpa = time_s[known], pressure_kpa[known]

    @property
    def range_kpa(self) -> float:
        """From the lowest to the highest pressure; 0 where there is none."""
        return float(np.ptp(self._pressure_kpa)) if len(self._pressure_kpa) else 0.0

    def at(self, time_s: float) -> tuple[float, int] | None:
        """(kPa, 1 while it rises and 0 while it falls); None before, after and in a hole of the log."""
        after = int(np.searchsorted(self._time_s, time_s))
        if after == len(self._time_s) or time_s < self._time_s[0]:
            return None
        if self._time_s[after] - self._time_s[max(after - 1, 0)] > _PAUSE_S:
            return None
        return float(np.interp(time_s, self._time_s, self._pressure_kpa)), int(self._rising[after])

    @cached_property
    def _rising(self) -> np.ndarray:
        """Which way the pressure goes, (M,) bool: that of the last turn that was more than noise."""
        pressure, turn = self._pressure_kpa, _TURN * self.range_kpa
        # Every sample belongs to the way between the two turns around it.
        turns, rising = [0], True
        for place, value in enumerate(pressure.tolist()):
            ahead = value - pressure[turns[-1]]
            if (ahead >= 0) == rising:
                turns[-1] = place
            elif abs(ahead) > turn:
                turns.append(place)
                rising = not rising
        # `turns` are the extremes, beginning with the end of the first rise.
        ways = np.searchsorted(np.array(turns), np.arange(len(pressure)))
        return np.asarray(ways % 2 == 0)
