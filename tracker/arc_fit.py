"""Circular arcs through keypoints: a robust least-squares fit that does not mind a straight actuator.

Used by `angle.py` for the definition `arc-fit`; signs are explained there.

A circle is written by its curvature k and by the place where it passes a reference point o: offset d along
the normal n there, tangent direction phi. With t = (cos phi, sin phi), n = (-sin phi, cos phi), q = o + d n
and u = x - q,

    f(x) = k/2 |u|^2 - n.u      is zero on the circle, and
    r(x) = 2 f / (1 + sqrt(1 + 2 k f))      is the signed distance to it,

both smooth through k = 0, a straight line (the form of Pratt 1987, moved to a point on the curve, where it is
well conditioned for every arc; the geometric refinement follows Chernov and Lesort 2005).
"""

from __future__ import annotations

import numpy as np

from .types import FloatArray

# Distances beyond this fraction of the chain's length count linearly, not squared (Huber): a misplaced
# keypoint pulls less. Fits of sound frames stay under it, and are plain least squares.
_HUBER_FRACTION = 0.01
_MAX_ITERATIONS = 60
_TOLERANCE = 1e-18  # on the squared step, in units of the chain's length and radians


def arc_angle(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn of the fitted arc's tangent from the first to the last point, and its derivative.

    Parameters
    ----------
    points : ndarray of float
        (T, k, 2) px, k >= 3, finite, neighbours distinct, in order along an arc of less than 360
        degrees, with less than 270 between neighbours.

    Returns
    -------
    angle : ndarray of float
        (T,) rad, may exceed pi.
    gradient : ndarray of float
        (T, k, 2) rad/px, the Gauss-Newton derivative of the angle by every coordinate.
    """
    if not len(points):
        return np.empty(0), np.empty(points.shape)
    origin = points[:, points.shape[1] // 2]
    length = np.linalg.norm(np.diff(points, axis=1), axis=-1).sum(axis=1)
    scaled = (points - origin[:, None]) / length[:, None, None]
    parameters = _fit(scaled)
    angle, gradient = _angle_and_gradient(scaled, parameters)
    return angle, gradient / length[:, None, None]


def _fit(points: FloatArray) -> FloatArray:
    """Levenberg-Marquardt over all frames at once: parameters (T, 3) of curvature, direction, offset."""
    parameters = _through_three_points(points)
    damping = np.full(len(points), 1e-3)
    active = np.arange(len(points))  # frames whose fit still moves
    for _ in range(_MAX_ITERATIONS):
        start = parameters[active]
        residual, jacobian = _residuals(points[active], start)
        weight = _weights(residual)
        normal = np.einsum("tki,tk,tkj->tij", jacobian, weight, jacobian)
        slope = np.einsum("tki,tk,tk->ti", jacobian, weight, residual)
        diagonal = np.einsum("tii->ti", normal)
        diagonal += damping[active, None] * (diagonal + 1e-12)
        trial = start - np.linalg.solve(normal, slope[..., None])[..., 0]
        better = _huber(_residuals(points[active], trial)[0]) <= _huber(residual)
        parameters[active] = np.where(better[:, None], trial, start)
        damping[active] = np.clip(damping[active] * np.where(better, 0.2, 5.0), 1e-12, 1e12)
        active = active[((trial - start) ** 2).sum(axis=1) > _TOLERANCE]
        if not active.size:
            break
    return parameters


def _through_three_points(points: FloatArray) -> FloatArray:
    """Exact circle through the first, the reference (middle) and the last point: where the fit starts."""
    first, middle, last = points[:, 0], points[:, points.shape[1] // 2], points[:, -1]
    to_middle, to_last, whole = middle - first, last - middle, last - first
    cross = to_middle[:, 0] * to_last[:, 1] - to_middle[:, 1] * to_last[:, 0]
    sides = np.linalg.norm([to_middle, to_last, whole], axis=-1).prod(axis=0)
    curvature = 2.0 * cross / np.maximum(sides, 1e-9)
    # Inscribed angles: the tangent at the middle point is turned from the first chord by as much as the
    # second chord is from the one across.
    direction = _heading(to_middle) + _heading(to_last) - _heading(whole)
    return np.stack([curvature, direction, np.zeros(len(points))], axis=1)


def _residuals(points: FloatArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (T, k) of the points to the circle, and their derivatives (T, k, 3)."""
    curvature, offset, tangent, normal, u = _frame(points, parameters)
    along, across = (u * tangent).sum(axis=-1), (u * normal).sum(axis=-1)
    f = 0.5 * curvature * (u**2).sum(axis=-1) - across
    # |k| x distance to the centre; it is zero at the centre itself, where the distance has no derivative.
    root = np.maximum(np.sqrt(np.maximum(1.0 + 2.0 * curvature * f, 0.0)), 1e-6)
    residual = 2.0 * f / (1.0 + root)
    by_curvature = (0.5 * (u**2).sum(axis=-1) - 0.5 * residual**2) / root
    by_direction = (1.0 + curvature * offset) * along / root
    by_offset = (1.0 - curvature * across) / root
    return residual, np.stack([by_curvature, by_direction, by_offset], axis=-1)


def _angle_and_gradient(points: FloatArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn of the tangent over the chain, and its derivative with the fit following the points."""
    curvature, offset, tangent, normal, u = _frame(points, parameters)
    inward = normal - curvature[..., None] * u  # normal at each point's foot, not of unit length
    before, after = inward[:, :-1], inward[:, 1:]
    cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    steps = np.arctan2(cross, (before * after).sum(axis=-1))
    # Neighbours more than 180 degrees apart: the circle is run through in one direction, the curvature's. A
    # misplaced point may lie a little behind its neighbour; half of the way round is no such thing.
    behind = (steps * curvature < 0) & (np.abs(steps) > np.pi / 2)
    angle = (steps + np.where(behind, 2 * np.pi * np.sign(curvature), 0.0)).sum(axis=1)

    # Direct part: how the tangent at the first and last point answers to the point and to the parameters.
    turned = np.stack([-inward[..., 1], inward[..., 0]], axis=-1) / (inward**2).sum(axis=-1, keepdims=True)
    by_point = -curvature[..., None] * turned
    by_parameter = np.stack(
        [
            -(turned * u).sum(axis=-1),
            -(1.0 + curvature * offset) * (turned * tangent).sum(axis=-1),
            curvature * (turned * normal).sum(axis=-1),
        ],
        axis=-1,
    )
    gradient = np.zeros_like(points)
    gradient[:, 0] -= by_point[:, 0]
    gradient[:, -1] += by_point[:, -1]

    # Part through the fit: normal equations; moving a point changes its distance along the circle's normal.
    residual, jacobian = _residuals(points, parameters)
    weight = _weights(residual)
    matrix = np.einsum("tki,tk,tkj->tij", jacobian, weight, jacobian)
    solved = np.einsum("tij,tkj,tk->tki", np.linalg.pinv(matrix), jacobian, weight)
    unit_inward = inward / np.maximum(np.linalg.norm(inward, axis=-1, keepdims=True), 1e-12)
    by_distance = np.einsum("ti,tki->tk", by_parameter[:, -1] - by_parameter[:, 0], solved)
    gradient += by_distance[..., None] * unit_inward
    return angle, gradient


def _frame(
    points: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Curvature and offset (T, 1), tangent and normal (T, 1, 2) at the reference point, and u (T, k, 2)."""
    curvature, direction, offset = (parameters[:, i, None] for i in range(3))
    cosine, sine = np.cos(direction), np.sin(direction)
    tangent, normal = np.stack([cosine, sine], axis=-1), np.stack([-sine, cosine], axis=-1)
    return curvature, offset, tangent, normal, points - offset[..., None] * normal


def _weights(residual: FloatArray) -> FloatArray:
    return _HUBER_FRACTION / np.maximum(np.abs(residual), _HUBER_FRACTION)


def _huber(residual: FloatArray) -> FloatArray:
    size = np.abs(residual)
    linear = _HUBER_FRACTION * (size - 0.5 * _HUBER_FRACTION)
    return np.where(size <= _HUBER_FRACTION, 0.5 * residual**2, linear).sum(axis=1)


def _heading(vector: FloatArray) -> FloatArray:
    return np.arctan2(vector[:, 1], vector[:, 0])
