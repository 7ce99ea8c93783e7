"""The bending angle: four named definitions from keypoints, with sign and uncertainty.

The circular-arc fit itself is in `arc_fit.py`; which definition a project uses, in `project.py`.

Glossary of this file
---------------------
chain       the keypoints of a definition, from the fixed end (base) to the moving end (tip).
turn        the rotation from one direction to the next along the chain, in (-180, 180] degrees.
sign        before `AngleDefinition.sign` multiplies it, an angle is positive when the chain turns from +x
            towards +y. With y down that is **clockwise as seen on the screen**: an actuator that leaves
            its clamp to the right and curls downwards has a positive angle.
range       a turn cannot exceed 180 degrees, a sum of turns can: 208 degrees comes out as 208, not -152.
straight    0 degrees, in every definition.

The definitions
---------------
two-vector   p1 p2 ... p(k-1) pk, k >= 4: the turn from p2 - p1 to pk - p(k-1), summed along the chain
             (the paper's angle, section Vision; points in between make the sum safer).
three-point  p1 p2 p3: the turn at p2, so 180 minus the inner angle, with a sign.
chord        p1 p2 ... pk, k >= 3: twice the turn from the base tangent p2 - p1 to the chord pk - p2. Exact
             for an arc that starts at p2 along p2 - p1 (tangent-chord theorem). Points between are not used.
arc-fit      k >= 3: a circle is fitted to all points; the turn of its tangent from the first to the last.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .arc_fit import arc_angle
from .errors import AngleError
from .types import Correlation, FloatArray

_LEAST_POINTS = {"two-vector": 4, "three-point": 3, "chord": 3, "arc-fit": 3}
DEFINITIONS = tuple(_LEAST_POINTS)

# Neighbours closer than this have no direction that means anything: no label or network is that precise.
COINCIDENT_PX = 1e-3


@dataclass(frozen=True)
class AngleDefinition:
    """Which angle is meant: a definition's name, the keypoints of its chain from base to tip, and a sign.

    Attributes
    ----------
    name : str
        One of `DEFINITIONS`.
    points : tuple of str
        Keypoint names, base to tip.
    sign : int
        +1 or -1, multiplies the angle (+1: positive is clockwise on the screen, see the glossary above).

    Raises
    ------
    AngleError
        Unknown name, wrong number of points, a point named twice, a sign that is neither +1 nor -1.

    Examples
    --------
    >>> AngleDefinition("two-vector", ("base_1", "base_2", "tip_1", "tip_2")).sign
    1
    """

    name: str
    points: tuple[str, ...]
    sign: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", tuple(self.points))
        least = _least_points(self.name)
        count = len(self.points)
        if count < least or (self.name == "three-point" and count != 3):
            wanted = "exactly 3" if self.name == "three-point" else f"at least {least}"
            raise AngleError(
                f"angle '{self.name}' expected {wanted} points, got {count}: {_listed(self.points)}"
            )
        if len(set(self.points)) != count:
            raise AngleError(f"angle '{self.name}' expected distinct points, got {_listed(self.points)}")
        if self.sign not in (1, -1):
            raise AngleError(f"angle sign: expected +1 or -1, got {self.sign!r}")


def default_points(definition_name: str, keypoints: Sequence[str]) -> tuple[str, ...]:
    """Chain for a project whose keypoints run from base to tip and that names no points of its own.

    `two-vector` and `arc-fit` take all keypoints, `three-point` the first, the middle (of an even number
    the one nearer the base) and the last, `chord` the first two and the last.

    Parameters
    ----------
    definition_name : str
        One of `DEFINITIONS`.
    keypoints : sequence of str
        All keypoint names of the project, base to tip.

    Returns
    -------
    tuple of str
        Names of the chain's points, base to tip.

    Raises
    ------
    AngleError
        Unknown definition, or fewer keypoints than it needs.

    Examples
    --------
    >>> default_points("three-point", ["base_1", "base_2", "tip_1", "tip_2"])
    ('base_1', 'base_2', 'tip_2')
    """
    names = tuple(keypoints)
    least = _least_points(definition_name)
    if len(names) < least:
        raise AngleError(
            f"angle '{definition_name}' expected at least {least} keypoints, "
            f"got {len(names)}: {_listed(names)}"
        )
    if definition_name == "three-point":
        return (names[0], names[(len(names) - 1) // 2], names[-1])
    if definition_name == "chord":
        return (names[0], names[1], names[-1])
    return names


def bending_angle(
    xy: FloatArray,
    keypoints: Sequence[str],
    definition: AngleDefinition,
    covariance: FloatArray | None = None,
    correlations: Sequence[Correlation] = (),
) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Bending angle of every frame, and its standard deviation to first order.

    Parameters
    ----------
    xy : ndarray of float
        (T, K, 2) px, NaN where unknown.
    keypoints : sequence of str
        K names, in the order of `xy`.
    definition : AngleDefinition
        Which angle, of which points, with which sign.
    covariance : ndarray of float or None, optional
        (T, K, 2, 2) px^2 of the positions.
    correlations : sequence of Correlation, optional
        Of points whose errors go together; those of all others are taken as independent.

    Returns
    -------
    angle_deg : ndarray of float
        (T,) degrees; NaN where a point of the chain is NaN or neighbours coincide.
    angle_sd_deg : ndarray of float
        (T,) degrees; NaN where the angle or a covariance is NaN, or `covariance` is None.
    coincident : ndarray of bool
        (T,) two neighbours of the chain lie closer than `COINCIDENT_PX`.

    Raises
    ------
    AngleError
        A point of the definition is not among the keypoints.
    ValueError
        Arrays of the wrong shape.
    """
    points = _chain(xy, keypoints, definition)
    if definition.name == "chord":
        points = points[:, [0, 1, -1]]
    coincident = (np.linalg.norm(np.diff(points, axis=1), axis=-1) < COINCIDENT_PX).any(axis=1)
    usable = np.isfinite(points).all(axis=(1, 2)) & ~coincident

    angle_deg = np.full(len(points), np.nan)
    gradient = np.full(points.shape, np.nan)
    angle_rad, gradient[usable] = _angle_and_gradient(points[usable], definition.name)
    angle_deg[usable] = definition.sign * np.degrees(angle_rad)

    angle_sd_deg = np.full(len(points), np.nan)
    if covariance is not None:
        if covariance.shape != (*xy.shape, 2):
            raise ValueError(f"expected covariance {(*xy.shape, 2)}, got {covariance.shape}")
        names = definition.points
        chain_covariance = covariance[:, _chain_index(keypoints, definition)]
        if definition.name == "chord":
            names, chain_covariance = (*names[:2], names[-1]), chain_covariance[:, [0, 1, -1]]
        variance = np.einsum("tki,tkij,tkj->t", gradient, chain_covariance, gradient)
        for first, second, coefficient in correlations:
            if first in names and second in names:
                k, p = names.index(first), names.index(second)
                # Both points of an end turn it by what moves them apart: their gradients are opposite.
                own, other = (_times_root(gradient[:, i], chain_covariance[:, i]) for i in (k, p))
                variance += 2 * coefficient * (own * other).sum(axis=1)
        # Rounding can leave a variance a hair under zero; NaN stays NaN.
        angle_sd_deg = np.degrees(np.sqrt(np.maximum(variance, 0.0)))
    return angle_deg, angle_sd_deg, coincident


def _times_root(gradient: FloatArray, covariance: FloatArray) -> FloatArray:
    """Gradients (T, 2) times the Cholesky factors of covariances (T, 2, 2), (T, 2)."""
    first = np.sqrt(np.maximum(covariance[:, 0, 0], 0.0))
    below = covariance[:, 1, 0] / np.where(first > 0, first, 1.0)
    second = np.sqrt(np.maximum(covariance[:, 1, 1] - below**2, 0.0))
    return np.stack([gradient[:, 0] * first + gradient[:, 1] * below, gradient[:, 1] * second], axis=1)


def sign_from_labels(xy: FloatArray, keypoints: Sequence[str], definition: AngleDefinition) -> int:
    """Sign that makes bending under pressure positive, judged from labelled frames over the pressure range.

    The quarter of the frames with the strongest bending votes (its median), so that an actuator that rests
    slightly bent the other way, or one frame labelled in the wrong order, does not decide.

    Parameters
    ----------
    xy : ndarray of float
        (N, K, 2) px.
    keypoints : sequence of str
        K names, in the order of `xy`.
    definition : AngleDefinition
        Which angle, of which points; its own sign is ignored.

    Returns
    -------
    int
        +1 or -1, to be used as `AngleDefinition.sign` (+1 when everything is exactly straight).

    Raises
    ------
    AngleError
        No frame has all points of the angle.
    """
    unsigned = AngleDefinition(definition.name, definition.points)
    angle_deg, _, _ = bending_angle(xy, keypoints, unsigned)
    angle_deg = angle_deg[np.isfinite(angle_deg)]
    if not angle_deg.size:
        raise AngleError(
            f"angle sign 'auto': expected a labelled frame with all of {_listed(definition.points)}, "
            f"got none among {len(xy)}"
        )
    return -1 if strongest_bend_deg(angle_deg) < 0 else 1


def strongest_bend_deg(angle_deg: FloatArray) -> float:
    """Median angle of the quarter of the frames that bend most, to whichever side.

    Parameters
    ----------
    angle_deg : ndarray of float
        (T,) degrees, none of them NaN, at least one.

    Returns
    -------
    float
        Degrees.
    """
    strongest = angle_deg[np.argsort(-np.abs(angle_deg), kind="stable")][: max(1, angle_deg.size // 4)]
    return float(np.median(strongest))


def end_vector_px(xy: FloatArray, keypoints: Sequence[str], definition: AngleDefinition) -> float:
    """Length of the shorter of the two end vectors of the chain, each as its median over the frames, in px.

    The longer it is, the less an error of a point turns it. For `chord` the second vector is the chord.
    NaN where no frame has the points of one of the two vectors.

    Parameters
    ----------
    xy : ndarray of float
        (T, K, 2) px, NaN where unknown.
    keypoints : sequence of str
        K names, in the order of `xy`.
    definition : AngleDefinition
        Which angle, of which points.

    Returns
    -------
    float
        Length, px.
    """
    points = _chain(xy, keypoints, definition)
    last_start = 1 if definition.name == "chord" else -2
    ends = (points[:, 1] - points[:, 0], points[:, -1] - points[:, last_start])
    lengths = [np.linalg.norm(end, axis=-1) for end in ends]
    known = [length[np.isfinite(length)] for length in lengths]
    if not all(length.size for length in known):
        return float("nan")
    return float(min(np.median(length) for length in known))


def label_noise_floor_deg(sigma_px: float, n_labels: int, end_vector_px: float) -> float:
    """Best angle error to hope for from n labels with errors of `sigma_px`: 2 sigma / (sqrt(n) L) rad.

    Averaged over the labels a point is off by sigma / sqrt(n) across its vector of length L; its two points
    turn a vector by sqrt(2) sigma / (sqrt(n) L), and two such vectors turn the angle by the figure above.

    Parameters
    ----------
    sigma_px : float
        Standard deviation of one label's position, px.
    n_labels : int
        Number of labelled frames.
    end_vector_px : float
        Length of an end vector, px (see `end_vector_px`).

    Returns
    -------
    float
        Standard deviation of the angle, degrees; NaN without labels or for a length that is not positive.

    Examples
    --------
    >>> round(label_noise_floor_deg(sigma_px=1.0, n_labels=30, end_vector_px=60.0), 2)
    0.35
    """
    if n_labels < 1 or not end_vector_px > 0:
        return float("nan")
    return math.degrees(2.0 * sigma_px / (math.sqrt(n_labels) * end_vector_px))


def _angle_and_gradient(points: FloatArray, name: str) -> tuple[FloatArray, FloatArray]:
    """Angle in rad (T,) and its derivative by every coordinate (T, k, 2), for finite distinct points."""
    if name == "arc-fit":
        return arc_angle(points)
    segments = np.diff(points, axis=1)
    before, after = segments[:, :-1], segments[:, 1:]
    cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    turn = np.arctan2(cross, (before * after).sum(axis=-1))
    turn[turn == -np.pi] = np.pi  # a cross product of -0.0: a turn is in (-180, 180]
    angle = turn.sum(axis=1)

    # Whatever lies between cancels: the sum is the last direction minus the first, up to whole turns.
    direction = np.stack([-segments[..., 1], segments[..., 0]], axis=-1)
    direction /= (segments**2).sum(axis=-1, keepdims=True)  # d(direction of a segment) / d(its end point)
    gradient = np.zeros_like(points)
    gradient[:, 0] += direction[:, 0]
    gradient[:, 1] -= direction[:, 0]
    gradient[:, -1] += direction[:, -1]
    gradient[:, -2] -= direction[:, -1]
    factor = 2.0 if name == "chord" else 1.0
    return factor * angle, factor * gradient


def _chain(xy: FloatArray, keypoints: Sequence[str], definition: AngleDefinition) -> FloatArray:
    """Positions of the chain's points, (T, k, 2) float64."""
    if xy.ndim != 3 or xy.shape[1:] != (len(keypoints), 2):
        raise ValueError(f"expected positions (T, {len(keypoints)}, 2), got {xy.shape}")
    return np.asarray(xy, dtype=np.float64)[:, _chain_index(keypoints, definition)]


def _chain_index(keypoints: Sequence[str], definition: AngleDefinition) -> list[int]:
    names = list(keypoints)
    missing = [point for point in definition.points if point not in names]
    if missing:
        raise AngleError(
            f"angle '{definition.name}' expected points among the keypoints {_listed(names)}, "
            f"got {_listed(missing)}"
        )
    return [names.index(point) for point in definition.points]


def _least_points(definition_name: str) -> int:
    if definition_name not in _LEAST_POINTS:
        raise AngleError(f"angle definition: expected one of {_listed(DEFINITIONS)}, got '{definition_name}'")
    return _LEAST_POINTS[definition_name]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "(none)"
