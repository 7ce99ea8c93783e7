"""The pressure and the angle at a turn of the cycle, without the bias that the largest noisy reading has.

The largest of many noisy readings lies above the truth, and the frame nearest a turn lies beside it. So both are
read from curves fitted to the readings around. Loops and trial values are `dynamic.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import FloatArray

# How far around a turn the log is looked at: share of the period, and at most.
_WINDOW_SHARE, _WINDOW_S = 0.06, 0.25
# Half widths of a rounded corner that are tried, as shares of the window.
_ROUNDINGS = (0.06, 0.09, 0.13, 0.2, 0.3, 0.5)
# The branches are fitted with polynomials over this share of the pressure's range next to the turn: the richer
# one where both branches have so many frames there, else the plainer.
_BRANCHES = ((4, 0.7, 24), (2, 0.35, 4))
# How late the angle's turn may come against the pressure's, as a standard deviation in frames: clock shift and lag.
_LAG_FRAMES = 2.0
_STEPS = 4
# Within this many frames of a turn the pressure's corner is told by the curve through the log.
_CORNER_FRAMES = 1.5


@dataclass(frozen=True)
class TurningPressure:
    """Pressure around the turns of one kind (all tops, or all feet) of a trial's cycles.

    Attributes
    ----------
    turn_s, kpa : (C,) when it turns, and its pressure there
    common_sd_kpa : standard uncertainty that all of `kpa` share, from the curve that they share
    reach_s : how far on either side the curve describes the pressure
    """

    turn_s: FloatArray
    kpa: FloatArray
    common_sd_kpa: float
    reach_s: float
    _curve: Curve | None

    def off_kpa(self, late_s: FloatArray) -> FloatArray:
        """Pressure less that of the turn, so long after a turn; NaN further away than the curve reaches."""
        off = late_s / self.reach_s
        if self._curve is None:
            return np.full(off.shape, np.nan)
        return np.where(np.abs(off) <= 1, self._curve.at(off) - self._curve.at(np.zeros(1)), np.nan)


@dataclass(frozen=True)
class Curve:
    """Two polynomials that meet in a corner, sharp or rounded: order, half width of the rounding, coefficients."""

    order: int
    rounding: float
    coefficients: FloatArray

    def at(self, off: FloatArray) -> FloatArray:
        return _design(off, self.order, self.rounding) @ self.coefficients


def turning_pressure(
    time_s: FloatArray, pressure_kpa: FloatArray, turns_s: FloatArray, period_s: float
) -> TurningPressure:
    """Pressure at the turns of a log.

    All turns are laid over each other and one curve is fitted through them, the simplest that describes them
    (by AIC): two lines, parabolas or cubics that meet in a corner, sharp or rounded. A turn of its own then
    differs by its mean distance from the curve.

    Parameters
    ----------
    time_s, pressure_kpa : (M,) the log as recorded, NaN where missing
    turns_s : (C,) roughly when it turns
    period_s : of the cycles
    """
    reach = min(_WINDOW_SHARE * period_s, _WINDOW_S)
    known = np.isfinite(pressure_kpa)
    time_s, pressure_kpa = time_s[known], pressure_kpa[known]
    turns_s = np.array([_aligned(time_s, pressure_kpa, float(turn), reach) for turn in turns_s])
    places = [slice(*np.searchsorted(time_s, (turn - reach, turn + reach))) for turn in turns_s]
    counts = np.array([place.stop - place.start for place in places])
    if not counts.size or counts.min() < 8:
        nearest = np.interp(turns_s, time_s, pressure_kpa) if time_s.size else np.full(turns_s.size, np.nan)
        return TurningPressure(turns_s, nearest, float("nan"), reach, None)
    means = np.array([pressure_kpa[place].mean() for place in places])
    off = np.concatenate(
        [(time_s[place] - turn) / reach for place, turn in zip(places, turns_s, strict=True)]
    )
    level = np.concatenate([pressure_kpa[place] for place in places]) - np.repeat(means, counts)
    curve, sd = _simplest_curve(off, level)
    return TurningPressure(turns_s, means + curve.at(np.zeros(1)), sd, reach, curve)


def _aligned(time_s: FloatArray, pressure_kpa: FloatArray, turn_s: float, reach_s: float) -> float:
    """The turn's time, better: where the lines through the flanks on its two sides meet."""
    first, middle, last = np.searchsorted(time_s, (turn_s - reach_s, turn_s, turn_s + reach_s))
    if middle - first < 4 or last - middle < 4:
        return turn_s
    left, right = slice(first, middle), slice(middle, last)
    slope_l, at_l = np.polyfit(time_s[left] - turn_s, pressure_kpa[left], 1)
    slope_r, at_r = np.polyfit(time_s[right] - turn_s, pressure_kpa[right], 1)
    if slope_l * slope_r >= 0 or min(abs(slope_l), abs(slope_r)) < 0.3 * max(abs(slope_l), abs(slope_r)):
        return turn_s  # a plateau or a rest on one side: there is no corner to meet in
    move = float((at_r - at_l) / (slope_l - slope_r))
    return turn_s + min(max(move, -reach_s / 4), reach_s / 4)


def _simplest_curve(off: FloatArray, level: FloatArray) -> tuple[Curve, float]:
    """The simplest curve through the points, and the standard uncertainty of its value at 0."""
    best: tuple[float, Curve, float] | None = None
    for order in (1, 2, 3):
        for rounding in (0.0, *_ROUNDINGS):
            design = _design(off, order, rounding)
            inverse = np.linalg.pinv(design.T @ design, hermitian=True)
            coefficients = inverse @ (design.T @ level)
            residual = level - design @ coefficients
            count, parameters = design.shape
            variance = max(float(residual @ residual), 1e-18) / max(count - parameters, 1)
            aic = count * np.log(variance) + 2 * parameters
            if best is None or aic < best[0]:
                at_zero = _design(np.zeros(1), order, rounding)[0]
                sd = float(np.sqrt(variance * (at_zero @ inverse @ at_zero)))
                best = (aic, Curve(order, rounding, coefficients), sd)
    assert best is not None
    return best[1], best[2]


def _design(off: FloatArray, order: int, rounding: float) -> FloatArray:
    corner = np.abs(off)
    columns = [np.ones_like(off), off, corner]
    if order >= 2:
        columns += [off**2, off * corner]
    if order >= 3:
        columns += [off**3, corner**3]
    if rounding:
        columns.append(np.clip(rounding - corner, 0, None) ** 2)
    return np.stack(columns, axis=1)


@dataclass(frozen=True)
class TurningAngle:
    """Angle at the turns of one kind.

    Attributes
    ----------
    deg : (C,) of each cycle; NaN where a branch has too few frames near the turn
    common_sd_deg : standard uncertainty that all of them share, because they share a lag and a turning pressure
    """

    deg: FloatArray
    common_sd_deg: float


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
    there. Two more things, the same for all turns, are fitted along, each held near 0 by
    what is known of it:

    - by how much the angle's turn comes late: a clock's shift or the material's lag moves the
      branches apart and with them the place where they meet, so a wrong shift does not bias the angle (what is
      found so stays here, it is no estimate of the clocks' shift);
    - by how much the pressure's corner is off.

    Parameters
    ----------
    time_s, angle_deg, pressure_kpa, rate_kpa_s : (T,) frames; NaN where missing
    turning : the turns of this kind
    bounds_s : (C, 2) from which time to which the frames belong to each turn
    """
    known = np.isfinite(angle_deg) & np.isfinite(pressure_kpa) & np.isfinite(rate_kpa_s)
    frame_s = float(np.median(np.diff(time_s))) if time_s.size > 1 else float("nan")
    meetings: list[_Meeting | None] = []
    for place, (start_s, end_s) in enumerate(bounds_s):
        inside = known & (time_s >= start_s) & (time_s <= end_s)
        frames = [values[inside] for values in (time_s, angle_deg, pressure_kpa, rate_kpa_s)]
        meetings.append(_meeting(*frames, turning, place, frame_s))
    found = [meeting for meeting in meetings if meeting is not None]
    values_deg = np.full(len(meetings), np.nan)
    if not found:
        return TurningAngle(values_deg, float("nan"))
    sd = np.array([_LAG_FRAMES * frame_s, max(turning.common_sd_kpa, 1e-6)])
    common = np.zeros(2)  # lag in s, corner in kPa
    for _ in range(_STEPS):
        fits = [meeting.linearised(common, sd) for meeting in found]
        freedom = sum(
            fit.residual.size - meeting.parameters for fit, meeting in zip(fits, found, strict=True)
        )
        noise = max(float(np.sqrt(sum(fit.residual @ fit.residual for fit in fits) / max(freedom, 1))), 1e-6)
        covariance = np.linalg.inv(sum(fit.left.T @ fit.left for fit in fits) / noise**2 + np.diag(sd**-2))
        step = covariance @ (sum(fit.left.T @ fit.residual for fit in fits) / noise**2 - common / sd**2)
        common = common + step
    values_deg[[m is not None for m in meetings]] = [fit.value_deg + fit.by_common @ step for fit in fits]
    by_common = np.mean([fit.by_common for fit in fits], axis=0)
    return TurningAngle(values_deg, float(np.sqrt(by_common @ covariance @ by_common)))


@dataclass(frozen=True)
class _Fit:
    """One turn's fit for a given lag and corner, and what a change of the two does to it.

    Attributes
    ----------
    value_deg, by_common : angle at the turn, and (2,) its derivatives by lag and corner
    residual : (N,) of the frames
    left : (N, 2) what lag and corner do to the frames and the branches cannot follow
    """

    value_deg: float
    by_common: FloatArray
    residual: FloatArray
    left: FloatArray


@dataclass(frozen=True)
class _Meeting:
    """The frames of two branches that meet at a turn."""

    late_s: FloatArray  # after the pressure's turn
    angle_deg: FloatArray
    off_kpa: FloatArray  # pressure less the turn's
    rate_kpa_s: FloatArray
    turning: TurningPressure
    range_kpa: float
    order: int
    frame_s: float

    @property
    def parameters(self) -> int:
        return 1 + 2 * self.order

    def linearised(self, common: FloatArray, sd: FloatArray) -> _Fit:
        lag_s, corner_kpa = common
        steps = sd * 1e-2
        design = self._branches(lag_s, corner_kpa)
        moved = (self._branches(lag_s + steps[0], corner_kpa), self._branches(lag_s, corner_kpa + steps[1]))
        q, r = np.linalg.qr(design)
        coefficients = np.linalg.lstsq(r, q.T @ self.angle_deg, rcond=None)[0]
        by_common = np.stack(
            [(m - design) @ coefficients / s for m, s in zip(moved, steps, strict=True)], axis=1
        )
        followed = np.linalg.lstsq(r, q.T @ by_common, rcond=None)[0]
        return _Fit(
            value_deg=float(coefficients[0]),
            by_common=-followed[0],
            residual=self.angle_deg - design @ coefficients,
            left=by_common - design @ followed,
        )

    def _branches(self, lag_s: float, corner_kpa: float) -> FloatArray:
        """(N, parameters) powers of the distance in pressure, for each branch apart."""
        late = self.late_s - lag_s
        off = self.turning.off_kpa(late)
        off = np.where(np.isfinite(off), off, self.off_kpa - lag_s * self.rate_kpa_s)
        off = off - corner_kpa * np.minimum(np.abs(late) / (_CORNER_FRAMES * self.frame_s), 1)
        powers = (off / self.range_kpa)[:, None] ** np.arange(1, self.order + 1)
        before = (late < 0)[:, None]
        return np.column_stack([np.ones_like(late), powers * before, powers * ~before])


def _meeting(
    time_s: FloatArray,
    angle_deg: FloatArray,
    pressure_kpa: FloatArray,
    rate_kpa_s: FloatArray,
    turning: TurningPressure,
    place: int,
    frame_s: float,
) -> _Meeting | None:
    """The frames next to one turn, from those of its cycle; None where a branch has too few."""
    late_s = time_s - turning.turn_s[place]
    off_kpa = pressure_kpa - turning.kpa[place]
    range_kpa = float(np.abs(off_kpa).max()) if off_kpa.size else 0.0
    for order, share, fewest in _BRANCHES:
        chosen = np.abs(off_kpa) <= share * range_kpa
        before = int((chosen & (late_s < 0)).sum())
        if min(before, int(chosen.sum()) - before) >= fewest:
            return _Meeting(
                late_s=late_s[chosen],
                angle_deg=angle_deg[chosen],
                off_kpa=off_kpa[chosen],
                rate_kpa_s=rate_kpa_s[chosen],
                turning=turning,
                range_kpa=share * range_kpa,
                order=order,
                frame_s=frame_s,
            )
    return None
