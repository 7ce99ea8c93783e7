"""The axis of motion: one coordinate for each thumbnail, which orders the thumbnails of one moving body.

Only thumbnails are known here, no video; how they are collected is in `stream_clustering.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree, shortest_path

from ..tracker.types import FloatArray
from .stream_clustering import rms_distances

# Least and most neighbours in the graph of thumbnails: enough to bridge noise, few enough to follow a curved motion.
_NEIGHBOURS = (2, 6)
_THUMBNAILS_PER_NEIGHBOUR = 40
# Two views (the camera was moved, or is another one): sets of thumbnails with nothing in between. Each has at least
# this share of the frames and this number of thumbnails; the step between them is at least this part of the largest
# distance within either.
_VIEW_SHARE = 0.05
_VIEW_JUMP = 0.8
_VIEW_THUMBNAILS = 12
# Standard deviation of a pixel that rounding alone causes, grey levels.
_ROUNDING_SD = 0.3
# A pixel moves when its spread is at least this multiple of the noise's.
_MOVING_RATIO = 4.0
# Width of a Gaussian from the 5th to the 95th percentile, in standard deviations.
_PERCENTILE_WIDTH = 3.3
# A smaller share of moving pixels is noise and compression.
_MIN_MOVING_SHARE = 1 / 250
# Thumbnails closer than this multiple of the noise show the same pose.
_SAME_POSE = 2.5

# Added to distances that become edges, as a sparse matrix takes 0 for no edge.
_EDGE_OFFSET = 1e-6


@dataclass(frozen=True)
class Motion:
    """The moving pixels of a set of thumbnails, and the thumbnails' weights.

    Attributes
    ----------
    noise : float
        Root mean square difference of two thumbnails of one pose, grey levels.
    weight : ndarray of float
        (n,) weight of each thumbnail, with sum 1.
    moving : ndarray
        (P,) bool, the pixels that move; all where none does.
    moves : bool
        Whether any pixel moves.
    """

    noise: float
    weight: FloatArray
    moving: np.ndarray
    moves: bool


def detect_motion(thumbnails: FloatArray, counts: FloatArray) -> Motion:
    """Find the pixels that move more than noise, and weigh the thumbnails by pose.

    A pose has the weight of the square root of its number of frames, in however many clusters they are: neither
    hours of rest nor a hand that passes once outweighs the motion. For the same reason a pixel's spread is taken from
    its 5th to its 95th percentile.

    Parameters
    ----------
    thumbnails : ndarray of float
        (n, P) grey levels.
    counts : ndarray of float
        (n,) number of frames that each thumbnail stands for.

    Returns
    -------
    Motion
        Moving pixels, weights and noise.
    """
    deviation = thumbnails.std(axis=0)
    still = deviation[deviation <= np.quantile(deviation, 0.25)]
    noise = max(float(np.sqrt(np.mean(still.astype(np.float64) ** 2))), _ROUNDING_SD)
    crowd = (rms_distances(thumbnails) <= _SAME_POSE * np.sqrt(2) * noise) @ counts
    weight = counts / np.sqrt(crowd)
    weight /= weight.sum()
    order = np.argsort(thumbnails, axis=0)
    below = np.cumsum(weight[order], axis=0)
    low, high = (
        np.take_along_axis(
            thumbnails, np.take_along_axis(order, (below < part).sum(axis=0)[None], axis=0), axis=0
        )
        for part in (0.05, 0.95)
    )
    moving = (high - low)[0] > _MOVING_RATIO * _PERCENTILE_WIDTH * noise
    moves = bool(moving.mean() > _MIN_MOVING_SHARE)
    return Motion(np.sqrt(2) * noise, weight, moving if moves else np.ones_like(moving), moves)


def split_views(distances: FloatArray, counts: FloatArray) -> np.ndarray:
    """Separate thumbnails of different views of the camera.

    The thumbnails of a view are connected by small steps. Two views are apart by a step about as large as the
    distances within them (`_VIEW_JUMP`), and each has its share of the frames.

    Parameters
    ----------
    distances : ndarray of float
        (n, n) between thumbnails.
    counts : ndarray of float
        (n,) number of frames that each thumbnail stands for.

    Returns
    -------
    ndarray
        (n,) int, number of each thumbnail's view, from 0.
    """
    view = np.zeros(len(distances), np.intp)
    _split(distances, counts / counts.sum(), np.arange(len(distances)), view)
    return np.unique(view, return_inverse=True)[1]


def _split(distances: FloatArray, shares: FloatArray, members: np.ndarray, view: np.ndarray) -> None:
    """Give the thumbnails beyond the longest step another view, and continue with both sides."""
    within = distances[np.ix_(members, members)]
    tree = minimum_spanning_tree(csr_matrix(within + _EDGE_OFFSET)).tocoo()
    for cut in np.argsort(-tree.data):
        rest = np.arange(len(tree.data)) != cut
        graph = csr_matrix((tree.data[rest], (tree.row[rest], tree.col[rest])), shape=within.shape)
        side = connected_components(graph, directed=False)[1] == 0
        if min(shares[members[side]].sum(), shares[members[~side]].sum()) < _VIEW_SHARE:
            continue
        sizes = [within[np.ix_(part, part)].max() for part in (side, ~side)]
        if tree.data[cut] > _VIEW_JUMP * max(sizes) and min(side.sum(), (~side).sum()) >= _VIEW_THUMBNAILS:
            view[members[~side]] = view.max() + 1
            _split(distances, shares, members[side], view)
            _split(distances, shares, members[~side], view)
        return


def motion_coordinate(distances: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the coordinate of each thumbnail along the main motion.

    It is the first principal coordinate of the geodesic distances in the neighbour graph (Isomap: Tenenbaum, de Silva
    and Langford 2000). An actuator bends in one way, so the coordinate is monotonic in the angle; its sign is
    arbitrary.

    Parameters
    ----------
    distances : ndarray of float
        (n, n) between thumbnails.
    weight : ndarray of float
        (n,) weight of each thumbnail, with sum 1.

    Returns
    -------
    ndarray of float
        (n,) coordinates, in the distances' unit.
    """
    n = len(distances)
    if n < 3:
        return np.arange(n, dtype=np.float64) * (distances[0, -1] if n else 0.0)
    graph = minimum_spanning_tree(csr_matrix(distances + _EDGE_OFFSET)).toarray()
    neighbours = min(int(np.clip(n // _THUMBNAILS_PER_NEIGHBOUR, *_NEIGHBOURS)), n - 1)
    near = np.argpartition(distances, neighbours, axis=1)[:, : neighbours + 1]
    rows = np.repeat(np.arange(n), near.shape[1])
    graph[rows, near.ravel()] = distances[rows, near.ravel()] + _EDGE_OFFSET
    geodesic = shortest_path(csr_matrix(graph), directed=False)
    square = geodesic**2
    # Weighted classical scaling: the eigenvector of the largest eigenvalue of the double-centred squares.
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
