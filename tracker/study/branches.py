"""The angle at the turns of the pressure, without the bias that the largest noisy frame has.

The largest of many noisy angles lies above the truth, and the frame nearest a turn lies beside it. So the angle is
read where the branches before and after a turn meet. Where the pressure turns is `corner.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..types import FloatArray
from .corner import TurningPressure

# The branches are fitted with polynomials over a share of the pressure's range next to the turn: order, share, and
# the frames that each branch must have there. The first that describes the frames is taken, else the
# one nearest to them.
_BRANCHES = ((4, 0.7, 24), (4, 0.4, 16), (3, 0.25, 8), (3, 0.5, 7), (2, 0.15, 4), (1, 0.1, 4), (2, 0.35, 4))
# It does where the frames lie around it as they do around their neighbours, but for this factor in variance and
# this share of the angle's range.
_ADEQUATE, _MISFIT_SHARE = 1.2, 0.002
# How late the angle's turn may come against the pressure's, as a standard deviation in frames: clock shift and lag.
_LAG_FRAMES = 2.0
# Within this many frames of a turn the pressure's corner is told by the curve through the log.
_CORNER_FRAMES = 1.5
_STEPS = 3
# The angle goes on beyond the meeting where the frames there say so by this many standard deviations.
_CLEAR_SD = 4.0


@dataclass(frozen=True)
class TurningAngle:
    """Angle at the turns of one kind.

    Attributes
    ----------
    deg : ndarray of float
        (C,) of each cycle; NaN where a branch has too few frames near the turn.
    common_sd_deg : float
        Standard uncertainty that all of them share, because they share a lag and a turning pressure.
    misfit_deg : float
        How far off the frames the branches lie where none describes them (RMS); else 0.
    """

    deg: FloatArray
    common_sd_deg: float
    misfit_deg: float = 0.0


def turning_angle(
    time_s: FloatArray,
    angle_deg: FloatArray,
    pressure_kpa: FloatArray,
    rate_kpa_s: FloatArray,
    turning: TurningPressure,
    bounds_s: FloatArray,
) -> TurningAngle:
    """Angle at the turns: where the branches before and after each meet, as functions of pressure.

    Both branches are polynomials of the pressure's distance from the turning pressure with one common value
    there. Two more things, the same for all turns, are fitted along, each held near 0 by what is known of it:

    - by how much the angle's turn comes late: a clock's shift or the material's lag moves the branches apart and
      with them the place where they meet, so a wrong shift does not bias the angle (what is found so stays here,
      it is no estimate of the clocks' shift);
    - by how much the pressure's corner is off.

    Parameters
    ----------
    time_s, angle_deg, pressure_kpa, rate_kpa_s : ndarray of float
        (T,) frames; NaN where missing.
    turning : TurningPressure
        The turns of this kind.
    bounds_s : ndarray of float
        (C, 2) from which time to which the frames belong to each turn.
    """
    known = np.isfinite(angle_deg) & np.isfinite(pressure_kpa) & np.isfinite(rate_kpa_s)
    frames = (time_s[known], angle_deg[known], pressure_kpa[known], rate_kpa_s[known])
    frame_s = float(np.median(np.diff(time_s))) if time_s.size > 1 else float("nan")
    found = TurningAngle(np.full(len(bounds_s), np.nan), float("nan"))
    if known.sum() < 3:
        return found
    noise_deg = frame_noise_deg(angle_deg[known])
    allowed = _ADEQUATE * noise_deg**2 + (_MISFIT_SHARE * float(np.ptp(angle_deg[known]))) ** 2
    least = float("inf")
    for order, share, fewest in _BRANCHES:
        meetings = _meetings(*frames, turning, bounds_s, frame_s, order, share, fewest)
        if meetings is None:
            continue
        angle, variance = _fitted(meetings, len(bounds_s), frame_s)
        if variance < least:
            found, least = angle, variance
        if variance <= allowed:
            return angle
    # What the branches miss, the angle where they meet may miss too.
    misfit_deg = max(least - noise_deg**2, 0.0) ** 0.5
    return replace(
        found, misfit_deg=misfit_deg, common_sd_deg=float(np.hypot(found.common_sd_deg, misfit_deg))
    )


def frame_noise_deg(angle_deg: FloatArray) -> float:
    """Noise of one frame's angle, from how much frames leave the line through their neighbours."""
    if angle_deg.size < 3:
        return float("nan")
    return 1.4826 * float(np.median(np.abs(np.diff(angle_deg, n=2)))) / 6**0.5


def _fitted(meetings: _Meetings, count: int, frame_s: float) -> tuple[TurningAngle, float]:
    """The angles of `count` turns, and the variance of the frames around the branches, deg^2."""
    corner_sd = meetings.turning.common_sd_kpa
    sd = np.array([_LAG_FRAMES * frame_s, max(corner_sd if np.isfinite(corner_sd) else 0.0, 1e-6)])
    common = np.zeros(2)  # lag in s, corner in kPa
    for _ in range(_STEPS):
        fit = meetings.linearised(common, sd)
        variance = max(float(np.sum(fit.residual**2)) / max(meetings.freedom, 1), 1e-12)
        left = fit.left.reshape(-1, 2)
        covariance = np.linalg.inv(left.T @ left / variance + np.diag(sd**-2))
        step = covariance @ (left.T @ fit.residual.ravel() / variance - common / sd**2)
        common = common + step
    values_deg = np.full(count, np.nan)
    beyond_deg = meetings.beyond_deg(common, fit.coefficients, variance)
    values_deg[meetings.places] = fit.value_deg + fit.by_common @ step + beyond_deg
    by_common = fit.by_common.mean(axis=0)
    unseen_deg = float(by_common[1]) * meetings.turning.unseen_kpa
    return TurningAngle(
        values_deg, float(np.sqrt(by_common @ covariance @ by_common + unseen_deg**2))
    ), variance


@dataclass(frozen=True)
class _Fit:
    """Fits of all turns for a given lag and corner, and what a change of the two does to them.

    Attributes
    ----------
    coefficients : ndarray of float
        (C, parameters) of the branches.
    by_common : ndarray of float
        (C, 2) derivatives of the angle where they meet by lag and corner.
    residual : ndarray of float
        (C, N) of the frames.
    left : ndarray of float
        (C, N, 2) what lag and corner do to the frames and the branches cannot follow.
    """

    coefficients: FloatArray
    by_common: FloatArray
    residual: FloatArray
    left: FloatArray

    @property
    def value_deg(self) -> FloatArray:
        """(C,) the angle where the branches meet."""
        return self.coefficients[:, 0]


@dataclass(frozen=True)
class _Meetings:
    """The frames of two branches that meet, for each turn: all (C, N), filled up with frames of weight 0."""

    places: np.ndarray  # (C,) which turns these are
    weight: FloatArray
    late_s: FloatArray  # after the pressure's turn
    angle_deg: FloatArray
    off_kpa: FloatArray  # pressure less the turn's
    rate_kpa_s: FloatArray
    turning: TurningPressure
    range_kpa: FloatArray  # (C, 1)
    order: int
    frame_s: float

    @property
    def freedom(self) -> int:
        return int(self.weight.sum()) - len(self.places) * (1 + 2 * self.order)

    def linearised(self, common: FloatArray, sd: FloatArray) -> _Fit:
        lag_s, corner_kpa = common
        steps = sd * 1e-2
        design = self._powers(lag_s, corner_kpa)
        solve = np.linalg.pinv(np.swapaxes(design, 1, 2) @ design, rcond=1e-13, hermitian=True)
        solve = solve @ np.swapaxes(design, 1, 2)
        coefficients = solve @ self.angle_deg[..., None]
        later = self._powers(lag_s + steps[0], corner_kpa) @ coefficients
        higher = self._powers(lag_s, corner_kpa + steps[1]) @ coefficients
        fitted = design @ coefficients
        by_common = np.concatenate([(later - fitted) / steps[0], (higher - fitted) / steps[1]], axis=2)
        followed = solve @ by_common
        return _Fit(
            coefficients=coefficients[..., 0],
            by_common=-followed[:, 0],
            residual=self.angle_deg - fitted[..., 0],
            left=by_common - design @ followed,
        )

    def beyond_deg(self, common: FloatArray, coefficients: FloatArray, variance: float) -> FloatArray:
        """(C,) how far the angle goes on beyond where the branches meet: it may, where the material lags.

        Looked for on the median of the turns' branches, at one place for all. 0 where the frames there do not go
        that far themselves: a polynomial may bend where they do not.
        """
        count = self.order
        # To which side of the turn the frames' pressures lie; all on it are no branch.
        away = -1.0 if np.sum(self.off_kpa) < 0 else 1.0
        x = away * np.linspace(0, 0.5, 51)[1:]
        powers = x[:, None] ** np.arange(1, count + 1)
        gain = np.concatenate(
            [coefficients[:, 1 : 1 + count] @ powers.T, coefficients[:, 1 + count :] @ powers.T], axis=1
        )
        middle = np.median(gain, axis=0)  # a branch that is all rest bends as it likes
        # The turn is a largest angle where the angle falls away from it, else a smallest one.
        sign = 1.0 if middle[x.size - 1] + middle[-1] < 0 else -1.0
        place = int(np.argmax(sign * middle))
        after, at = divmod(place, x.size)
        share = self._powers(*common)[..., 1 + after * count] / x[at]  # of the way to there
        near = (share > 0.5) & (share < 1.5)
        seen = sign * (self.angle_deg - coefficients[:, :1])[near]
        if seen.size < 2 or seen.mean() < max(
            _CLEAR_SD * (variance / seen.size) ** 0.5, 0.5 * sign * middle[place]
        ):
            return np.zeros(len(gain))
        best = gain[:, place]
        off = np.abs(best - middle[place])
        return np.where(off > 5 * 1.4826 * np.median(off), middle[place], best)

    def _powers(self, lag_s: float, corner_kpa: float) -> FloatArray:
        """(C, N, parameters) powers of the distance in pressure, for each branch apart."""
        late = self.late_s - lag_s
        off = self.turning.off_kpa(late)
        off = np.where(np.isfinite(off), off, self.off_kpa - lag_s * self.rate_kpa_s)
        off = off - corner_kpa * np.minimum(np.abs(late) / (_CORNER_FRAMES * self.frame_s), 1)
        x = off / self.range_kpa
        design = np.empty((*late.shape, 1 + 2 * self.order))
        design[..., 0] = self.weight
        before = (late < 0) * self.weight
        power = np.ones_like(x)
        for exponent in range(1, self.order + 1):
            power = power * x
            design[..., exponent] = power * before
            design[..., self.order + exponent] = power * (self.weight - before)
        return design


def _meetings(
    time_s: FloatArray,
    angle_deg: FloatArray,
    pressure_kpa: FloatArray,
    rate_kpa_s: FloatArray,
    turning: TurningPressure,
    bounds_s: FloatArray,
    frame_s: float,
    order: int,
    share: float,
    fewest: int,
) -> _Meetings | None:
    """The frames next to each turn; None where too few turns have them: half of those that could be told at all."""
    first, last = np.searchsorted(time_s, bounds_s[:, 0]), np.searchsorted(time_s, bounds_s[:, 1])
    width = int((last - first).max(initial=0))
    if width == 0:
        return None
    index = first[:, None] + np.arange(width)
    inside = index < last[:, None]
    index = np.minimum(index, time_s.size - 1)
    late = time_s[index] - turning.turn_s[:, None]
    off = pressure_kpa[index] - turning.kpa[:, None]
    reach = np.where(inside, np.abs(off), 0).max(axis=1, keepdims=True)

    def frames_near(share: float) -> tuple[np.ndarray, np.ndarray]:
        """(C, N) the frames within a share of the range, and (C,) how many the poorer branch has of them."""
        near = inside & (np.abs(off) <= share * reach) & np.isfinite(off) & (np.abs(late) >= turning.blind_s)
        before = (near & (late < 0)).sum(axis=1)
        return near, np.minimum(before, near.sum(axis=1) - before)

    _, plainest, least = _BRANCHES[-1]
    possible = int((frames_near(plainest)[1] >= least).sum())
    chosen, poorer = frames_near(share)
    enough = poorer >= fewest
    if not enough.any() or 2 * enough.sum() < possible:
        return None
    weight = chosen[enough].astype(float)
    return _Meetings(
        places=np.flatnonzero(enough),
        weight=weight,
        late_s=late[enough],
        angle_deg=angle_deg[index][enough] * weight,
        off_kpa=np.where(chosen, off, 0.0)[enough],
        rate_kpa_s=rate_kpa_s[index][enough],
        turning=turning,
        range_kpa=share * reach[enough],
        order=order,
        frame_s=frame_s,
    )
