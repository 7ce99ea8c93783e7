"""How the labels of one actuator move together: a curve through all its labelled frames, fitted in spite of mistakes.

An actuator bends in one way, so every point runs along a path, and all with one parameter. What is to be said of
labels that leave the curve is in `checks.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..tracker.types import FloatArray
from .motion_axis import motion_coordinate

LEAST_FRAMES = 8
"""Fewer labelled frames do not tell a mistake from another shape."""

_FRAMES_A_DEGREE = 4  # labelled frames for each degree of the polynomials
_MOST_DEGREES = 5  # enough for 205 degrees of bending to a few tenths of a px
_PARAMETERS = 241  # at which the curve is known
_BEYOND = 0.05  # how far it goes on beyond the labelled frames, of its length
_DRAWS = 200  # of few frames, to find some without a mistake
_ROUNDS = 4  # of each way to weigh
# A point so many standard deviations off (in x and in y) counts no more: Tukey's biweight.
_TUKEY = 5.0
_LEAST_SD_PX = 0.5  # no hand is steadier
_ALONE = 3.0  # a frame so many times farther from others than is usual says nothing of the motion


@dataclass(frozen=True)
class LabelShape:
    """A fitted curve.

    Attributes
    ----------
    curve : (S, K, 2) px, the points along it
    sd_px : (K,) spread of the labels about it, in x and in y
    """

    curve: FloatArray
    sd_px: FloatArray

    def deviations(self, xy: FloatArray) -> FloatArray:
        """How far points (K, 2) are from the curve where it fits them best, (K,) in standard deviations.

        NaN where a point is missing.
        """
        return np.asarray(self._deviations(xy)[self.best(xy)])

    def best(self, xy: FloatArray) -> int:
        """Where on the curve points (K, 2) fit best, when one that is far off counts no more than one a little off."""
        return int(np.argmin(np.nansum(np.minimum(self._deviations(xy), _TUKEY) ** 2, axis=1)))

    def _deviations(self, xy: FloatArray) -> FloatArray:
        """(S, K) in standard deviations."""
        return np.asarray(np.linalg.norm(self.curve - xy, axis=2) / self.sd_px)


def fit_shape(xy: FloatArray) -> LabelShape:
    """Fit a curve to the labels of frames that show one actuator from one place.

    A principal curve of polynomials: parameters and curve are found in turn, points that are far off weigh less. It
    begins with the few frames that most of the others agree with (least quantile of residuals, Rousseeuw 1984).

    Parameters
    ----------
    xy : (N, K, 2) px, NaN where a point is missing; at least `LEAST_FRAMES` frames with all points
    """
    xy = xy[np.isfinite(xy).all(axis=(1, 2))]
    degree = int(np.clip(len(xy) // _FRAMES_A_DEGREE, 1, _MOST_DEGREES))
    fine = np.linspace(-1 - 2 * _BEYOND, 1 + 2 * _BEYOND, _PARAMETERS)
    xy, parameter = _in_order(xy)
    fits = _agreed_fit(parameter, xy, degree)
    distance = np.linalg.norm(xy - _at(parameter, fits), axis=2)
    for number in range(2 * _ROUNDS):
        sd_px = _spread(distance, degree)
        off = distance / sd_px
        # First least absolute deviations, by which a good frame that was left out so far draws the curve back.
        weight = 1 / off.clip(1) if number < _ROUNDS else (1 - (off / _TUKEY) ** 2).clip(1e-3) ** 2
        fits = np.stack([_fit(parameter, xy[:, k], weight[:, k], degree) for k in range(xy.shape[1])], axis=1)
        shape = LabelShape(_at(fine, fits), sd_px)
        place = np.array([shape.best(points) for points in xy])
        distance = np.linalg.norm(xy - shape.curve[place], axis=2)
        parameter = fine[place]
    return LabelShape(shape.curve, _spread(distance, degree))


def _in_order(xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frames that are like some others, and how far along the motion each is, from -1 to 1."""
    between = np.linalg.norm(xy[:, None] - xy[None], axis=3)
    second_nearest = np.sort(between.mean(axis=2), axis=1)[:, 2]
    alike = second_nearest <= _ALONE * np.median(second_nearest)
    # The middle of the points' distances: one point in the wrong place does not move its frame.
    middle = np.median(between[np.ix_(alike, alike)], axis=2)
    along = motion_coordinate(middle, np.full(len(middle), 1 / len(middle)))
    return xy[alike], 2 * (along - along.min()) / (np.ptp(along) or 1.0) - 1


def _agreed_fit(parameter: FloatArray, xy: FloatArray, degree: int) -> FloatArray:
    """Coefficients (degree + 1, K, 2) of few frames from which most of the others are not far."""
    rng = np.random.default_rng(0)
    size = min(degree + 2, len(xy))
    best, least = np.zeros((degree + 1, *xy.shape[1:])), np.inf
    for _ in range(_DRAWS):
        # Spread over the motion: one of each of as many parts.
        parts = np.array_split(np.argsort(parameter), size)
        drawn = np.array([rng.choice(part) for part in parts])
        flat = xy[drawn].reshape(size, -1)
        fits = np.linalg.lstsq(_basis(parameter[drawn], degree), flat, rcond=None)[0].reshape(best.shape)
        distance = np.linalg.norm(xy - _at(parameter, fits), axis=2)
        badness = float(np.quantile(distance, 0.65, axis=0).sum())
        if badness < least:
            best, least = fits, badness
    return best


def _fit(parameter: FloatArray, points: FloatArray, weight: FloatArray, degree: int) -> FloatArray:
    """Coefficients (degree + 1, 2) of one point's path."""
    root = np.sqrt(weight)[:, None]
    fit = np.linalg.lstsq(_basis(parameter, degree) * root, points * root, rcond=None)[0]
    return np.asarray(fit)


def _at(parameter: FloatArray, fits: FloatArray) -> FloatArray:
    """Points (N, K, 2) of the curve at parameters (N,)."""
    return np.asarray(np.tensordot(_basis(parameter, len(fits) - 1), fits, axes=1))


def _basis(parameter: FloatArray, degree: int) -> FloatArray:
    """Legendre polynomials, (N, degree + 1)."""
    return np.polynomial.legendre.legvander(parameter, degree)


def _spread(distance: FloatArray, degree: int) -> FloatArray:
    """Standard deviation (K,) in x and in y of points at distances (N, K) from where they should be."""
    # Of a Rayleigh distribution, half lie within 1.18 and seven tenths within 1.55 standard deviations. Where the
    # curve fits badly in some part, the second says so.
    half, most = (np.quantile(distance, part, axis=0) / of for part, of in ((0.5, 1.177), (0.7, 1.552)))
    freedom = np.sqrt(len(distance) / max(len(distance) - degree - 1, 1))
    return np.asarray(np.maximum(freedom * np.maximum(half, most), _LEAST_SD_PX))
