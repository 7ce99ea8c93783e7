"""How pressure moves in a trial and how the angle follows it: waves, and a hysteresis of known ratio.

The response is a Prandtl-Ishlinskii operator (many play operators in parallel) followed by a static curve:

    angle = angle_min + (angle_max - angle_min) f(y),        f(y) = (1 - c) y + c y^2
    y     = y_turn +- psi(|x - x_turn|),                      psi(d) = (1 - lambda) d + lambda d^3

where x = pressure / pressure_peak and (x_turn, y_turn) is the last turning point. When x comes back to where
an earlier turning point was, the loop between them closes and is forgotten (return-point memory, Masing's
rules; Mayergoyz, Mathematical Models of Hysteresis, 1991). psi is convex, hence the play weights are
positive. Time does not appear: the response is rate-independent.

The ratio is exact. A steady cycle from 0 to the peak goes up on y = psi(x) and down on y = 1 - psi(1 - x), so
for the area between them, in units of the peak and of the range of f,

    int_0^1 [1 - psi(1 - x)] - psi(x) dx           = 1 - 2 int psi = lambda / 2            for f(y) = y
    int_0^1 [1 - psi(1 - x)]^2 - psi(x)^2 dx       = 1 - 2 int psi = lambda / 2            for f(y) = y^2

and so for every mixture c. The study's hysteresis ratio is that area over the rectangle from the axes to the
largest pressure and angle: ratio = lambda / 2 (angle_max - angle_min) / angle_max.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BendtrackError
from ..types import FloatArray

# Pneu-nets bend slowly at first and fast near the end; near 1 the curve is almost a parabola.
_CURVATURE = 0.85


def play(way: FloatArray, cubic: float | FloatArray) -> FloatArray:
    """psi of the module's equations: how far y has come after a `way` in x since the last turn."""
    return (1 - cubic) * way + cubic * way**3


def bend(y: FloatArray) -> FloatArray:
    """f of the module's equations, from 0 to 1."""
    return (1 - _CURVATURE) * y + _CURVATURE * y**2


@dataclass(frozen=True)
class HystereticResponse:
    """Angle from the history of pressure, with a known hysteresis ratio.

    Parameters
    ----------
    pressure_peak_kpa : float
        The largest pressure of the cycles that the ratio is meant for.
    angle_min_deg, angle_max_deg : float
        Angle at zero and at the peak, in the steady cycle.
    hysteresis_ratio : float
        Area of the steady loop over pressure_peak_kpa * angle_max_deg, from 0 to just under
        0.5 (angle_max_deg - angle_min_deg) / angle_max_deg.

    Raises
    ------
    BendtrackError
        The angles are not in order, or the ratio cannot be reached with them.
    """

    pressure_peak_kpa: float
    angle_min_deg: float
    angle_max_deg: float
    hysteresis_ratio: float

    def __post_init__(self) -> None:
        if not self.pressure_peak_kpa > 0:
            raise BendtrackError(f"expected a largest pressure above 0 kPa, got {self.pressure_peak_kpa:g}")
        if not self.angle_max_deg > max(self.angle_min_deg, 0):
            raise BendtrackError(
                f"expected a largest angle above 0 and above the smallest, "
                f"got {self.angle_min_deg:g} to {self.angle_max_deg:g} deg"
            )
        largest = 0.5 * (self.angle_max_deg - self.angle_min_deg) / self.angle_max_deg
        if not 0 <= self.hysteresis_ratio <= largest:
            raise BendtrackError(
                f"expected a hysteresis ratio from 0 to {largest:.3f} for these angles, "
                f"got {self.hysteresis_ratio:g}"
            )

    @property
    def _cubic(self) -> float:
        """lambda of the module's equations."""
        return 2 * self.hysteresis_ratio * self.angle_max_deg / (self.angle_max_deg - self.angle_min_deg)

    def angle_deg(self, pressure_kpa: FloatArray) -> FloatArray:
        """Angles along a pressure history that begins at rest, at the low end of the steady cycle.

        Parameters
        ----------
        pressure_kpa : ndarray
            (N,) in the order of time, monotonic between samples; what is under 0 counts as 0.
        """
        cubic = self._cubic
        x = np.maximum(np.asarray(pressure_kpa, dtype=float) / self.pressure_peak_kpa, 0)
        y = np.empty_like(x)
        # Turning points not yet forgotten, oldest first; directions alternate, the first goes up.
        turns = [(0.0, 0.0)]
        last_x, last_y = 0.0, 0.0
        for index, here in enumerate(x.tolist()):
            rising = len(turns) % 2 == 1
            if here != last_x and (here > last_x) != rising:
                turns.append((last_x, last_y))
                rising = not rising
            # Past the turn before last, the loop between the two is closed and forgotten.
            while len(turns) >= 2 and (here >= turns[-2][0] if rising else here <= turns[-2][0]):
                del turns[-2:]
                if not turns:
                    turns = [(0.0, 0.0)]
                    break
            turn_x, turn_y = turns[-1]
            step = abs(here - turn_x)
            moved = (1 - cubic) * step + cubic * step**3
            last_x, last_y = here, turn_y + (moved if rising else -moved)
            y[index] = last_y
        result: FloatArray = self.angle_min_deg + (self.angle_max_deg - self.angle_min_deg) * bend(y)
        return result


def triangle_kpa(time_s: FloatArray, peak_kpa: float, frequency_hz: float) -> FloatArray:
    """Triangle wave from 0 to `peak_kpa` and back, beginning at 0."""
    phase = np.asarray(time_s, dtype=float) * frequency_hz % 1.0
    wave: FloatArray = peak_kpa * (1 - np.abs(2 * phase - 1))
    return wave


def staircase_kpa(
    time_s: FloatArray, peak_kpa: float, step_kpa: float = 5.0, hold_s: float = 3.0, ramp_s: float = 0.4
) -> FloatArray:
    """Staircase from 0 to `peak_kpa`: each level held for `hold_s`, reached by a ramp of `ramp_s`."""
    steps = max(round(peak_kpa / step_kpa), 1)
    levels = np.linspace(0, peak_kpa, steps + 1)
    starts = np.arange(steps + 1) * (hold_s + ramp_s)
    knots_s = np.stack([starts, starts + hold_s], axis=1).ravel()
    wave: FloatArray = np.interp(time_s, knots_s, np.repeat(levels, 2))
    return wave


def staircase_duration_s(
    peak_kpa: float, step_kpa: float = 5.0, hold_s: float = 3.0, ramp_s: float = 0.4
) -> float:
    """How long `staircase_kpa` takes with its last level held."""
    steps = max(round(peak_kpa / step_kpa), 1)
    return (steps + 1) * hold_s + steps * ramp_s
