"""Principal curve of one actuator's labels: a robust fit of the paths of all points along the motion.

An actuator bends in one way, so every point moves along a path, and all paths share one parameter. Labels that are
off the curve are reported in `checks.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..tracker.types import FloatArray
from .motion_axis import motion_coordinate

MIN_FRAMES = 8
"""With fewer labelled frames a mistake cannot be distinguished from another shape."""

_FRAMES_PER_DEGREE = 4  # labelled frames for each degree of the polynomials
_MAX_DEGREE = 5  # enough for 205 degrees of bending to a few tenths of a px
_N_SAMPLES = 241  # parameters at which the curve is evaluated
_EXTRAPOLATION = 0.05  # beyond the labelled frames at each end, as a part of the curve's length
_N_DRAWS = 200  # random subsets of frames, to find one without a mistake
_ROUNDS = 4  # iterations with each kind of weights
# Cut-off of Tukey's biweight, in standard deviations (in x and in y): a point farther off has no weight.
_TUKEY = 5.0
_MIN_SD_PX = 0.5  # no labeller is more precise
_ISOLATED = 3.0  # a frame this multiple of the median distance from others is no part of the motion


@dataclass(frozen=True)
class PrincipalCurve:
    """A fitted principal curve.

    Attributes
    ----------
    points : ndarray of float
        (S, K, 2) px, the K keypoints at S parameters along the motion.
    sd_px : ndarray of float
        (K,) px, standard deviation of the labels about the curve, in x and in y.
    """

    points: FloatArray
    sd_px: FloatArray

    def deviations(self, xy: FloatArray) -> FloatArray:
        """Return the distances of a frame's points from the curve at the best parameter.

        Parameters
        ----------
        xy : ndarray of float
            (K, 2) px, NaN where a point is missing.

        Returns
        -------
        ndarray of float
            (K,) distances in standard deviations, NaN where a point is missing.
        """
        return np.asarray(self._deviations(xy)[self.best(xy)])

    def best(self, xy: FloatArray) -> int:
        """Return the index in [0, S) of the curve's parameter that fits a frame's points best.

        Distances are capped at `_TUKEY` standard deviations, so that one mistake does not decide.

        Parameters
        ----------
        xy : ndarray of float
            (K, 2) px, NaN where a point is missing.

        Returns
        -------
        int
            Index into the first axis of `points`.
        """
        return int(np.argmin(np.nansum(np.minimum(self._deviations(xy), _TUKEY) ** 2, axis=1)))

    def _deviations(self, xy: FloatArray) -> FloatArray:
        """Return the distances (S, K) in standard deviations."""
        return np.asarray(np.linalg.norm(self.points - xy, axis=2) / self.sd_px)


def fit_principal_curve(xy: FloatArray) -> PrincipalCurve:
    """Fit a principal curve to the labels of frames that show one actuator from one view.

    The paths are polynomials of one parameter. Parameters and polynomials are estimated in turn, with robust weights.
    The start is the subset of frames with the least quantile of residuals (Rousseeuw 1984).

    Parameters
    ----------
    xy : ndarray of float
        (N, K, 2) px, NaN where a point is missing; at least `MIN_FRAMES` frames with all points.

    Returns
    -------
    PrincipalCurve
        The curve and the labels' standard deviation about it.
    """
    xy = xy[np.isfinite(xy).all(axis=(1, 2))]
    degree = int(np.clip(len(xy) // _FRAMES_PER_DEGREE, 1, _MAX_DEGREE))
    fine = np.linspace(-1 - 2 * _EXTRAPOLATION, 1 + 2 * _EXTRAPOLATION, _N_SAMPLES)
    xy, parameter = _order_along_motion(xy)
    fits = _initial_fit(parameter, xy, degree)
    distance = np.linalg.norm(xy - _evaluate(parameter, fits), axis=2)
    for number in range(2 * _ROUNDS):
        sd_px = _standard_deviation(distance, degree)
        off = distance / sd_px
        # First least absolute deviations, with which good frames outside the first subset still attract the curve.
        weight = 1 / off.clip(1) if number < _ROUNDS else (1 - (off / _TUKEY) ** 2).clip(1e-3) ** 2
        fits = np.stack([_fit(parameter, xy[:, k], weight[:, k], degree) for k in range(xy.shape[1])], axis=1)
        curve = PrincipalCurve(_evaluate(fine, fits), sd_px)
        best = np.array([curve.best(points) for points in xy])
        distance = np.linalg.norm(xy - curve.points[best], axis=2)
        parameter = fine[best]
    return PrincipalCurve(curve.points, _standard_deviation(distance, degree))


def _order_along_motion(xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the frames that are not isolated (N, K, 2), and their coordinate (N,) along the motion in [-1, 1]."""
    between = np.linalg.norm(xy[:, None] - xy[None], axis=3)
    second_nearest = np.sort(between.mean(axis=2), axis=1)[:, 2]
    alike = second_nearest <= _ISOLATED * np.median(second_nearest)
    # The median over the points: one point in the wrong place does not move its frame.
    median = np.median(between[np.ix_(alike, alike)], axis=2)
    along = motion_coordinate(median, np.full(len(median), 1 / len(median)))
    return xy[alike], 2 * (along - along.min()) / (np.ptp(along) or 1.0) - 1


def _initial_fit(parameter: FloatArray, xy: FloatArray, degree: int) -> FloatArray:
    """Return coefficients (degree + 1, K, 2) fitted to the random subset with the least quantile of residuals."""
    rng = np.random.default_rng(0)
    size = min(degree + 2, len(xy))
    best, least = np.zeros((degree + 1, *xy.shape[1:])), np.inf
    for _ in range(_N_DRAWS):
        # Stratified over the motion: one frame of each part.
        parts = np.array_split(np.argsort(parameter), size)
        drawn = np.array([rng.choice(part) for part in parts])
        flat = xy[drawn].reshape(size, -1)
        fits = np.linalg.lstsq(_basis(parameter[drawn], degree), flat, rcond=None)[0].reshape(best.shape)
        distance = np.linalg.norm(xy - _evaluate(parameter, fits), axis=2)
        badness = float(np.quantile(distance, 0.65, axis=0).sum())
        if badness < least:
            best, least = fits, badness
    return best


def _fit(parameter: FloatArray, points: FloatArray, weight: FloatArray, degree: int) -> FloatArray:
    """Fit the path of one point: coefficients (degree + 1, 2)."""
    root = np.sqrt(weight)[:, None]
    fit = np.linalg.lstsq(_basis(parameter, degree) * root, points * root, rcond=None)[0]
    return np.asarray(fit)


def _evaluate(parameter: FloatArray, fits: FloatArray) -> FloatArray:
    """Evaluate the curve at parameters (N,): points (N, K, 2)."""
    return np.asarray(np.tensordot(_basis(parameter, len(fits) - 1), fits, axes=1))


def _basis(parameter: FloatArray, degree: int) -> FloatArray:
    """Evaluate Legendre polynomials, (N, degree + 1)."""
    return np.polynomial.legendre.legvander(parameter, degree)


def _standard_deviation(distance: FloatArray, degree: int) -> FloatArray:
    """Estimate the standard deviation (K,) in x and in y from distances (N, K) to the curve."""
    # Half of a Rayleigh distribution is within 1.18 and seven tenths within 1.55 standard deviations. The second is
    # larger where the curve fits badly in some part.
    half, most = (np.quantile(distance, part, axis=0) / of for part, of in ((0.5, 1.177), (0.7, 1.552)))
    freedom = np.sqrt(len(distance) / max(len(distance) - degree - 1, 1))
    return np.asarray(np.maximum(freedom * np.maximum(half, most), _MIN_SD_PX))
