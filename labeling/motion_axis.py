"""Along the motion: one number for each look, by which the looks of one moving thing can be put in order.

Knows looks only, no video; how they are gathered is in `pose_cells.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree, shortest_path

from ..tracker.types import FloatArray
from .pose_cells import rms_distances

# Neighbours of a look in the graph of looks: enough to bridge noise, few enough to follow a curved motion.
_NEIGHBOURS = (2, 6)
_LOOKS_A_NEIGHBOUR = 40
# A camera that was moved, or another camera: nothing between two sets of looks, each with its share of frames.
_VIEW_SHARE = 0.05
_VIEW_JUMP = 0.8
_VIEW_LOOKS = 12
# A standard deviation of looks that rounding alone gives.
_ROUNDING = 0.3
# A pixel moves when it spreads so many times wider than noise spreads.
_MOVES = 4.0
# From the 5th to the 95th percentile a Gaussian spreads over so many standard deviations.
_WIDTH = 3.3
# Looks closer than this many times the noise crowd: they are one pose many times.
_CROWD = 2.5


@dataclass(frozen=True)
class Movement:
    """What moves in a set of looks, and what each look weighs in it.

    Attributes
    ----------
    noise : root mean square difference of two looks of one pose, grey levels
    weight : (n,) of each look, adding up to 1
    moving : (P,) bool, the pixels that move; all where nothing does
    moves : whether anything does
    """

    noise: float
    weight: FloatArray
    moving: np.ndarray
    moves: bool


def find_movement(looks: FloatArray, counts: FloatArray) -> Movement:
    """Tell pixels that move from those that only are noisy, and poses from mere repetitions.

    A pose weighs as much as the root of its frames, however many cells they lie in: hours of rest do not outweigh
    the motion, nor does a hand that passes once. For the same reason a pixel's spread counts from its 5th to its
    95th percentile.

    Parameters
    ----------
    looks : (n, P) grey levels
    counts : (n,) frames that look like each
    """
    deviation = looks.std(axis=0)
    still = deviation[deviation <= np.quantile(deviation, 0.25)]
    noise = max(float(np.sqrt(np.mean(still.astype(np.float64) ** 2))), _ROUNDING)
    crowd = (rms_distances(looks) <= _CROWD * np.sqrt(2) * noise) @ counts
    weight = counts / np.sqrt(crowd)
    weight /= weight.sum()
    order = np.argsort(looks, axis=0)
    below = np.cumsum(weight[order], axis=0)
    low, high = (
        np.take_along_axis(looks, np.take_along_axis(order, (below < part).sum(axis=0)[None], axis=0), axis=0)
        for part in (0.05, 0.95)
    )
    moving = (high - low)[0] > _MOVES * _WIDTH * noise
    moves = bool(moving.any())
    return Movement(np.sqrt(2) * noise, weight, moving if moves else np.ones_like(moving), moves)


def views(distances: FloatArray, counts: FloatArray) -> np.ndarray:
    """Tell looks from different views apart: (n,) int, 0 for the first view.

    A view holds the looks between which there is a way in small steps. It ends where the smallest step to other
    looks is as large as its own looks differ, and both sides have their share of the frames.
    """
    view = np.zeros(len(distances), np.intp)
    _split(distances, counts / counts.sum(), np.arange(len(distances)), view)
    return np.unique(view, return_inverse=True)[1]


def _split(distances: FloatArray, shares: FloatArray, members: np.ndarray, view: np.ndarray) -> None:
    """Give the looks beyond the longest step another view, and go on with both sides."""
    within = distances[np.ix_(members, members)]
    tree = minimum_spanning_tree(csr_matrix(np.where(np.isinf(within), 1e9, within + 1e-6))).tocoo()
    for cut in np.argsort(-tree.data):
        rest = np.arange(len(tree.data)) != cut
        graph = csr_matrix((tree.data[rest], (tree.row[rest], tree.col[rest])), shape=within.shape)
        side = connected_components(graph, directed=False)[1] == 0
        if min(shares[members[side]].sum(), shares[members[~side]].sum()) < _VIEW_SHARE:
            continue
        sizes = [within[np.ix_(part, part)].max() for part in (side, ~side)]
        if tree.data[cut] > _VIEW_JUMP * max(sizes) and min(side.sum(), (~side).sum()) >= _VIEW_LOOKS:
            view[members[~side]] = view.max() + 1
            _split(distances, shares, members[side], view)
            _split(distances, shares, members[~side], view)
        return


def motion_coordinate(distances: FloatArray, weight: FloatArray) -> FloatArray:
    """Where each look lies along the main motion, (n,) in grey levels; which end is which is left open.

    The length of the way from look to look in small steps (Isomap: Tenenbaum, de Silva and Langford 2000), of which
    the first principal coordinate is taken: an actuator bends in one way, so it grows with the angle.

    Parameters
    ----------
    distances : (n, n) between looks, see `rms_distances`
    weight : (n,) of each look, adding up to 1
    """
    n = len(distances)
    if n < 3:
        return np.arange(n, dtype=np.float64) * (distances[0, -1] if n else 0.0)
    graph = minimum_spanning_tree(csr_matrix(distances + 1e-6)).tolil()
    neighbours = min(int(np.clip(n // _LOOKS_A_NEIGHBOUR, *_NEIGHBOURS)), n - 1)
    near = np.argpartition(distances, neighbours, axis=1)[:, : neighbours + 1]
    rows = np.repeat(np.arange(n), near.shape[1])
    graph[rows, near.ravel()] = distances[rows, near.ravel()] + 1e-6
    ways = shortest_path(graph.tocsr(), directed=False)
    square = ways**2
    # Weighted classical scaling: the double-centred squares, of which the largest eigenvector.
    across = square @ weight
    inner = -0.5 * (square - across[:, None] - across[None] + weight @ across)
    root = np.sqrt(weight)
    vector = np.sin(np.arange(n) + 1.0)  # a start that is never orthogonal by symmetry
    matrix = root[:, None] * inner * root[None]
    for _ in range(200):
        following = matrix @ vector
        following /= np.linalg.norm(following) or 1.0
        if np.abs(following - vector).max() < 1e-9:
            break
        vector = following
    value = float(vector @ matrix @ vector)
    return np.asarray(np.sqrt(max(value, 0.0)) * vector / root)
