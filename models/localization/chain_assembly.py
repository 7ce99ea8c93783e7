"""Which of the places that a locator offers for each keypoint make up one actuator, held where it is held.

By itself every keypoint is at its heatmap's highest peak, wherever those of the others are. Together they are a chain
that begins at the fixed end, whose neighbours lie neither on each other nor far apart, and which does not turn back on
itself; the best chain is found by dynamic programming over pairs of neighbours.
"""

from __future__ import annotations

import numpy as np

from ...tracker.types import FloatArray, IntArray

NEAREST_END, NEAREST, FURTHEST = 0.25, 0.55, 1.6
"""Neighbours on the chain lie so far apart, as a share of an even spacing; the two points of an end may be closer."""

HELD = 0.05
"""The first keypoint lies within so much of the body's length of the fixed end."""

PENALTY = 30.0
"""What a length of the body beyond those costs: a tenth of it as much as a peak that is twenty times lower."""

SHARPEST_COS = 0.2
"""A chain turns from neighbour to neighbour by up to 80 degrees."""

TURN_PENALTY = 10.0
"""What a cosine less than that costs: turning right back is out of the question."""

LOWEST_PEAK = 1e-3


def assemble_chain(
    xy: FloatArray, likelihood: FloatArray, fixed_xy: FloatArray, body_px: float
) -> tuple[FloatArray, FloatArray]:
    """The best chains through offered places, from the fixed end on, whichever end the network took for that.

    Parameters
    ----------
    xy, likelihood : (N, K, M, 2) px and (N, K, M), in the order of the chain, K > 2; likelihoods in [0, 1]
    fixed_xy : (2,) px, where the first keypoint is held
    body_px : the body's length

    Returns
    -------
    Positions (N, K, 2) px and their likelihoods (N, K).
    """
    as_said = _best_chain(xy, likelihood, fixed_xy, body_px)
    turned = _best_chain(xy[:, ::-1], likelihood[:, ::-1], fixed_xy, body_px)
    better = as_said[2] >= turned[2]
    return (
        np.where(better[:, None, None], as_said[0], turned[0]),
        np.where(better[:, None], as_said[1], turned[1]),
    )


def _best_chain(
    xy: FloatArray, likelihood: FloatArray, fixed_xy: FloatArray, body_px: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions (N, K, 2), likelihoods (N, K) and worth (N,) of the best chains that begin with the first keypoint."""
    n, k = likelihood.shape[:2]
    worth = np.log(np.maximum(likelihood, LOWEST_PEAK))
    away = np.linalg.norm(xy[:, 0] - fixed_xy, axis=2) / body_px
    worth[:, 0] -= PENALTY * np.maximum(away - HELD, 0)
    # From every place of one keypoint to every place of the next, in lengths of the body: (N, K - 1, M, M, 2).
    step = (xy[:, 1:, None] - xy[:, :-1, :, None]) / body_px
    length = np.linalg.norm(step, axis=-1)
    nearest = np.full(k - 1, NEAREST / (k - 1))
    nearest[[0, -1]] = NEAREST_END / (k - 1)
    too_close = np.maximum(nearest[:, None, None] - length, 0)
    off = PENALTY * (np.maximum(length - FURTHEST / (k - 1), 0) + too_close)
    best = worth[:, 0, :, None] + worth[:, 1, None] - off[:, 0]
    came_from: list[IntArray] = []
    for i in range(2, k):
        along = np.einsum("nabx,nbcx->nabc", step[:, i - 2], step[:, i - 1])
        # Steps shorter than the least have no direction to speak of.
        lengths = length[:, i - 2, :, :, None] * length[:, i - 1, None] + nearest[0] ** 2
        turn = TURN_PENALTY * np.maximum(SHARPEST_COS - along / lengths, 0)
        through = best[..., None] - turn
        came_from.append(through.argmax(axis=1))
        best = through.max(axis=1) - off[:, i - 1] + worth[:, i, None]
    rows, m = np.arange(n), likelihood.shape[2]
    chosen = np.empty((n, k), int)
    chosen[:, -2], chosen[:, -1] = np.divmod(best.reshape(n, -1).argmax(axis=1), m)
    for i in range(k - 1, 1, -1):
        chosen[:, i - 2] = came_from[i - 2][rows, chosen[:, i - 1], chosen[:, i]]
    mapping = rows[:, None], np.arange(k), chosen
    return xy[mapping], likelihood[mapping], best.reshape(n, -1).max(axis=1)
