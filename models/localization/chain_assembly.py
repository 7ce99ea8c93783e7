"""Skeleton assembly: the best chain through the locator's candidate peaks, by dynamic programming.

By itself every keypoint is at its heatmap's highest peak, wherever the others are. Together they are a chain that
begins at the fixed end, whose neighbours are neither too close nor too far apart, and that does not turn back.
"""

from __future__ import annotations

import numpy as np

from ...tracker.types import FloatArray, IntArray

NEAREST_END, NEAREST, FURTHEST = 0.25, 0.55, 1.6
"""Range of the distance between neighbours, as a share of an even spacing; the two points of an end may be closer."""

ANCHOR = 0.05
"""Distance of the first keypoint from the fixed end, in body lengths, that costs nothing."""

PENALTY = 30.0
"""Cost of each body length beyond these ranges, in log likelihood: a tenth of it equals a peak twenty times lower."""

MIN_TURN_COS = 0.2
"""Cosine of the largest turn between neighbouring steps that costs nothing: about 80 degrees."""

TURN_PENALTY = 10.0
"""Cost of each unit of cosine below that, in log likelihood: a chain never turns right back."""

RESTING = 0.05
"""Factor on the likelihood of a moving end where nothing ever moves."""

MIN_PEAK = 1e-3
"""Peaks are not taken for lower, so that one unseen keypoint does not decide alone."""


def assemble_chain(
    xy: FloatArray,
    likelihood: FloatArray,
    fixed_xy: FloatArray | None,
    body_px: float,
    motion: FloatArray | float = 1.0,
) -> tuple[FloatArray, FloatArray]:
    """The best chains through candidate peaks, from the fixed end on, whichever end the network took for it.

    Parameters
    ----------
    xy : ndarray of float, shape (N, K, M, 2)
        M candidate positions of each keypoint, px, in the order of the chain, K > 2.
    likelihood : ndarray of float, shape (N, K, M)
        In [0, 1].
    fixed_xy : ndarray of float, shape (2,), or None
        The fixed end, px; None where it is not known.
    body_px : float
        Length of the body, px.
    motion : ndarray of float, shape (N, K, M), optional
        In [0, 1], how certainly something moves at each candidate (`motion.MotionEvidence.at`).

    Returns
    -------
    xy : ndarray of float, shape (N, K, 2)
    likelihood : ndarray of float, shape (N, K)
    """
    moving = _of_moving_chain(likelihood, motion)
    forward = _best_chain(xy, moving, fixed_xy, body_px)
    moving = _of_moving_chain(likelihood[:, ::-1], np.broadcast_to(motion, likelihood.shape)[:, ::-1])
    backward = _best_chain(xy[:, ::-1], moving, fixed_xy, body_px)
    better = forward[2] >= backward[2]
    return (
        np.where(better[:, None, None], forward[0], backward[0]),
        np.where(better[:, None], forward[1], backward[1]),
    )


def likeliest_points(
    xy: FloatArray, likelihood: FloatArray, motion: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The likeliest candidate of each keypoint by itself, in whichever direction more of the chain moves.

    Parameters
    ----------
    xy, likelihood, motion
        As `assemble_chain`'s.

    Returns
    -------
    xy : ndarray of float, shape (N, K, 2)
    likelihood : ndarray of float, shape (N, K)
    """
    forward = _of_moving_chain(likelihood, motion)
    backward = _of_moving_chain(likelihood[:, ::-1], motion[:, ::-1])[:, ::-1]
    better = forward.max(axis=2).sum(axis=1) >= backward.max(axis=2).sum(axis=1)
    weighted = np.where(better[:, None, None], forward, backward)
    best = weighted.argmax(axis=2)[..., None]
    return np.take_along_axis(xy, best[..., None], 2)[:, :, 0], np.take_along_axis(weighted, best, 2)[..., 0]


def _of_moving_chain(likelihood: FloatArray, motion: FloatArray | float) -> FloatArray:
    """Likelihoods (N, K, M) of candidates on a chain whose last third moves, and whose first third need not."""
    along = np.linspace(0.0, 1.0, likelihood.shape[1])[:, None]
    moves = np.clip(3 * along - 1, 0.0, 1.0)
    return likelihood * (1 - (1 - RESTING) * moves * (1 - np.asarray(motion)))


def _best_chain(
    xy: FloatArray, likelihood: FloatArray, fixed_xy: FloatArray | None, body_px: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions (N, K, 2), likelihoods (N, K) and scores (N,) of the best chains that begin with the first keypoint."""
    n, k = likelihood.shape[:2]
    score = np.log(np.maximum(likelihood, MIN_PEAK))
    if fixed_xy is not None:
        away = np.linalg.norm(xy[:, 0] - fixed_xy, axis=2) / body_px
        score[:, 0] -= PENALTY * np.maximum(away - ANCHOR, 0)
    # From every candidate of one keypoint to every candidate of the next, in body lengths: (N, K - 1, M, M, 2).
    step = (xy[:, 1:, None] - xy[:, :-1, :, None]) / body_px
    length = np.linalg.norm(step, axis=-1)
    nearest = np.full(k - 1, NEAREST / (k - 1))
    nearest[[0, -1]] = NEAREST_END / (k - 1)
    too_close = np.maximum(nearest[:, None, None] - length, 0)
    off = PENALTY * (np.maximum(length - FURTHEST / (k - 1), 0) + too_close)
    best = score[:, 0, :, None] + score[:, 1, None] - off[:, 0]
    came_from: list[IntArray] = []
    for i in range(2, k):
        along = np.einsum("nabx,nbcx->nabc", step[:, i - 2], step[:, i - 1])
        # The direction of steps shorter than the least distance has little weight.
        lengths = length[:, i - 2, :, :, None] * length[:, i - 1, None] + nearest[0] ** 2
        turn = TURN_PENALTY * np.maximum(MIN_TURN_COS - along / lengths, 0)
        through = best[..., None] - turn
        came_from.append(through.argmax(axis=1))
        best = through.max(axis=1) - off[:, i - 1] + score[:, i, None]
    rows, m = np.arange(n), likelihood.shape[2]
    chosen = np.empty((n, k), int)
    chosen[:, -2], chosen[:, -1] = np.divmod(best.reshape(n, -1).argmax(axis=1), m)
    for i in range(k - 1, 1, -1):
        chosen[:, i - 2] = came_from[i - 2][rows, chosen[:, i - 1], chosen[:, i]]
    mapping = rows[:, None], np.arange(k), chosen
    return xy[mapping], likelihood[mapping], best.reshape(n, -1).max(axis=1)
