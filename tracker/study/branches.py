"""The angle at the turns of the pressure, without the bias of the largest noisy frame.

The largest of many noisy angles lies above the truth, and no frame lies exactly at a turn. So the angle is read
where the branches before and after a turn meet. The pressure's turns are found in `turning_points.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..types import FloatArray
from .turning_points import TurningPressure

# Polynomials fitted to the branches next to a turn: order, fraction of the pressure's range, least frames of each
# branch there. The first fit that is adequate is taken, else the one with the smallest residual.
_BRANCHES = ((4, 0.7, 24), (4, 0.4, 16), (3, 0.25, 8), (3, 0.5, 7), (2, 0.15, 4), (1, 0.1, 4), (2, 0.35, 4))
# A fit is adequate where the residual variance is at most this factor times the frames' noise variance, plus a
# misfit of this fraction of the angle's range.
_ADEQUATE, _MISFIT_FRACTION = 1.2, 0.002
# How late the angle's turn may come against the pressure's, as a standard deviation in frames: clock shift and lag.
_LAG_FRAMES = 2.0
# Within this many frames of a turn the pressure is that of the curve fitted through the log.
_CORNER_FRAMES = 1.5
_STEPS = 3
# An extreme beyond the branches' intersection is accepted where the frames there exceed it by so many sd.
_CLEAR_SD = 4.0


@dataclass(frozen=True)
class TurningAngle:
    """Angle at the turns of one kind.

    Attributes
    ----------
    deg : ndarray of float
        (C,) degrees, for each cycle; NaN where a branch has too few frames near the turn.
    common_sd_deg : float
        Standard uncertainty that all of them share, because they share a lag and a turning pressure.
    misfit_deg : float
        RMS distance of the frames from the branches, beyond noise, where no fit is adequate; else 0.
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
    there. Two more things, the same for all turns, are fitted as well, each with a Gaussian prior around 0:

    - the delay of the angle's turn: a clock shift or the material's lag moves the branches and their intersection,
      so with the delay fitted a wrong shift does not bias the angle (the fitted delay is not used elsewhere, it is
      no estimate of the clocks' shift);
    - the error of the turning pressure.

    Parameters
    ----------
    time_s, angle_deg, pressure_kpa, rate_kpa_s : ndarray of float
        (T,) time, angle, pressure and its slope of the frames; NaN where missing.
    turning : TurningPressure
        The pressure's turns of this kind (peaks or troughs).
    bounds_s : ndarray of float
        (C, 2) s, begin and end of the frames that belong to each turn.

    Returns
    -------
    TurningAngle
        The angles, NaN where they cannot be estimated.
    """
    known = np.isfinite(angle_deg) & np.isfinite(pressure_kpa) & np.isfinite(rate_kpa_s)
    frames = (time_s[known], angle_deg[known], pressure_kpa[known], rate_kpa_s[known])
    frame_s = float(np.median(np.diff(time_s))) if time_s.size > 1 else float("nan")
    found = TurningAngle(np.full(len(bounds_s), np.nan), float("nan"))
    if known.sum() < 3:
        return found
    noise_deg = frame_noise_deg(angle_deg[known])
    allowed = _ADEQUATE * noise_deg**2 + (_MISFIT_FRACTION * float(np.ptp(angle_deg[known]))) ** 2
    least = float("inf")
    for order, fraction, min_frames in _BRANCHES:
        intersections = _intersections(*frames, turning, bounds_s, frame_s, order, fraction, min_frames)
        if intersections is None:
            continue
        angle, variance = _fitted(intersections, len(bounds_s), frame_s)
        if variance < least:
            found, least = angle, variance
        if variance <= allowed:
            return angle
    # A misfit of the branches may shift their intersection as much.
    misfit_deg = max(least - noise_deg**2, 0.0) ** 0.5
    return replace(
        found, misfit_deg=misfit_deg, common_sd_deg=float(np.hypot(found.common_sd_deg, misfit_deg))
    )


def frame_noise_deg(angle_deg: FloatArray) -> float:
    """Noise (sd) of one frame's angle, from its distance to the line through the neighbouring frames, deg.

    Parameters
    ----------
    angle_deg : ndarray of float
        (T,) degrees, without NaN.

    Returns
    -------
    float
        Standard deviation, degrees; NaN with fewer than three frames.
    """
    if angle_deg.size < 3:
        return float("nan")
    return 1.4826 * float(np.median(np.abs(np.diff(angle_deg, n=2)))) / 6**0.5


def _fitted(intersections: _Intersections, count: int, frame_s: float) -> tuple[TurningAngle, float]:
    """The angles of `count` turns, and the residual variance of the frames, deg^2."""
    corner_sd = intersections.turning.common_sd_kpa
    sd = np.array([_LAG_FRAMES * frame_s, max(corner_sd if np.isfinite(corner_sd) else 0.0, 1e-6)])
    common = np.zeros(2)  # lag in s, corner in kPa
    for _ in range(_STEPS):
        fit = intersections.linearised(common, sd)
        variance = max(float(np.sum(fit.residual**2)) / max(intersections.degrees_of_freedom, 1), 1e-12)
        jacobian = fit.by_common_residual.reshape(-1, 2)
        covariance = np.linalg.inv(jacobian.T @ jacobian / variance + np.diag(sd**-2))
        step = covariance @ (jacobian.T @ fit.residual.ravel() / variance - common / sd**2)
        common = common + step
    values_deg = np.full(count, np.nan)
    beyond_deg = intersections.beyond_deg(common, fit.coefficients, variance)
    values_deg[intersections.indices] = fit.value_deg + fit.by_common @ step + beyond_deg
    by_common = fit.by_common.mean(axis=0)
    unseen_deg = float(by_common[1]) * intersections.turning.unseen_kpa
    return TurningAngle(
        values_deg, float(np.sqrt(by_common @ covariance @ by_common + unseen_deg**2))
    ), variance


@dataclass(frozen=True)
class _Fit:
    """Fits of all turns for a given lag and corner error, linearised in the two.

    Attributes
    ----------
    coefficients : ndarray of float
        (C, parameters) polynomial coefficients of the branches.
    by_common : ndarray of float
        (C, 2) derivatives of the angle at the intersection with respect to lag and corner error.
    residual : ndarray of float
        (C, N) degrees, of the frames.
    by_common_residual : ndarray of float
        (C, N, 2) derivatives of the residual with respect to lag and corner error.
    """

    coefficients: FloatArray
    by_common: FloatArray
    residual: FloatArray
    by_common_residual: FloatArray

    @property
    def value_deg(self) -> FloatArray:
        """(C,) the angle at the branches' intersection, degrees."""
        return self.coefficients[:, 0]


@dataclass(frozen=True)
class _Intersections:
    """The frames of the two branches at each turn: all (C, N), padded with frames of weight 0."""

    indices: np.ndarray  # (C,) indices of these turns
    weight: FloatArray
    late_s: FloatArray  # after the pressure's turn
    angle_deg: FloatArray
    off_kpa: FloatArray  # pressure minus that of the turn
    rate_kpa_s: FloatArray
    turning: TurningPressure
    range_kpa: FloatArray  # (C, 1)
    order: int
    frame_s: float

    @property
    def degrees_of_freedom(self) -> int:
        return int(self.weight.sum()) - len(self.indices) * (1 + 2 * self.order)

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
            by_common_residual=by_common - design @ followed,
        )

    def beyond_deg(self, common: FloatArray, coefficients: FloatArray, variance: float) -> FloatArray:
        """(C,) how far the angle goes beyond the intersection, degrees: a lagging material turns later.

        The extreme is located once, on the median of all turns' branches. 0 where the frames there do not reach
        it: a polynomial may overshoot them.
        """
        count = self.order
        # Side of the turn on which the frames' pressures lie.
        away = -1.0 if np.sum(self.off_kpa) < 0 else 1.0
        x = away * np.linspace(0, 0.5, 51)[1:]
        powers = x[:, None] ** np.arange(1, count + 1)
        gain = np.concatenate(
            [coefficients[:, 1 : 1 + count] @ powers.T, coefficients[:, 1 + count :] @ powers.T], axis=1
        )
        middle = np.median(gain, axis=0)  # robust against branches that consist of rest only
        # The turn is a maximum of the angle where the angle falls away from it, else a minimum.
        sign = 1.0 if middle[x.size - 1] + middle[-1] < 0 else -1.0
        index = int(np.argmax(sign * middle))
        after, at = divmod(index, x.size)
        fraction = self._powers(*common)[..., 1 + after * count] / x[at]  # of the way to there
        near = (fraction > 0.5) & (fraction < 1.5)
        seen = sign * (self.angle_deg - coefficients[:, :1])[near]
        if seen.size < 2 or seen.mean() < max(
            _CLEAR_SD * (variance / seen.size) ** 0.5, 0.5 * sign * middle[index]
        ):
            return np.zeros(len(gain))
        best = gain[:, index]
        off = np.abs(best - middle[index])
        return np.where(off > 5 * 1.4826 * np.median(off), middle[index], best)

    def _powers(self, lag_s: float, corner_kpa: float) -> FloatArray:
        """(C, N, parameters) powers of the distance in pressure, separate for each branch."""
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


def _intersections(
    time_s: FloatArray,
    angle_deg: FloatArray,
    pressure_kpa: FloatArray,
    rate_kpa_s: FloatArray,
    turning: TurningPressure,
    bounds_s: FloatArray,
    frame_s: float,
    order: int,
    fraction: float,
    min_frames: int,
) -> _Intersections | None:
    """The frames next to each turn; None where fewer than half of the usable turns have enough frames."""
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

    def frames_near(fraction: float) -> tuple[np.ndarray, np.ndarray]:
        """(C, N) the frames within a fraction of the range, and (C,) their number in the branch with fewer."""
        near = (
            inside & (np.abs(off) <= fraction * reach) & np.isfinite(off) & (np.abs(late) >= turning.blind_s)
        )
        before = (near & (late < 0)).sum(axis=1)
        return near, np.minimum(before, near.sum(axis=1) - before)

    _, last_share, last_min_frames = _BRANCHES[-1]
    possible = int((frames_near(last_share)[1] >= last_min_frames).sum())
    chosen, fewer = frames_near(fraction)
    enough = fewer >= min_frames
    if not enough.any() or 2 * enough.sum() < possible:
        return None
    weight = chosen[enough].astype(float)
    return _Intersections(
        indices=np.flatnonzero(enough),
        weight=weight,
        late_s=late[enough],
        angle_deg=angle_deg[index][enough] * weight,
        off_kpa=np.where(chosen, off, 0.0)[enough],
        rate_kpa_s=rate_kpa_s[index][enough],
        turning=turning,
        range_kpa=fraction * reach[enough],
        order=order,
        frame_s=frame_s,
    )
