"""Clustering of a stream of frames: clusters of similar frames, with a few descriptors kept in each.

Memory does not grow with the video. Which clusters become images to label is decided in `selection.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..tracker.types import FloatArray
from .frame_descriptors import FrameDescriptor

# Enough that one of them is sharp. They are a random sample, so they come from all passes through the pose.
_MAX_MEMBERS = 6


@dataclass
class Cluster:
    """Similar frames.

    Attributes
    ----------
    members : list of FrameDescriptor
        Random sample of the cluster's frames, at most `_MAX_MEMBERS`; the first one opened the cluster.
    count : int
        Number of its frames.
    branch : int
        Branch of its frames (loading or unloading); clusters of different branches are never merged.
    """

    members: list[FrameDescriptor]
    count: int = 1
    branch: int = 0

    def merge(self, other: Cluster, rng: np.random.Generator) -> None:
        """Take over the frames of another cluster.

        Parameters
        ----------
        other : Cluster
            The other cluster.
        rng : numpy.random.Generator
            Source of the random sample.
        """
        self.count += other.count
        for descriptor in other.members:
            if len(self.members) < _MAX_MEMBERS:
                self.members.append(descriptor)
            else:  # reservoir sampling, but the first stays
                index = int(rng.integers(1, self.count))
                if index < _MAX_MEMBERS:
                    self.members[index] = descriptor


class AppearanceClusters:
    """Clusters of frames of similar appearance: the thumbnails of any two clusters differ by more than a radius.

    The radius starts at 0. It grows whenever there are more than `limit` clusters, which are then merged: the
    doubling algorithm of Charikar, Chekuri, Feder and Motwani (1997) for k-centre clustering of a stream. A pose
    passed once in an hour keeps its cluster, like one held for an hour.

    Parameters
    ----------
    limit : int
        Largest number of clusters.
    seed : int, optional
        Seed of the random sample in each cluster.

    Attributes
    ----------
    clusters : list of Cluster
        The clusters so far.
    """

    def __init__(self, limit: int, seed: int = 0) -> None:
        self.limit = limit
        self.clusters: list[Cluster] = []
        self._centres = np.empty((0, 0), np.float32)  # rows beyond len(clusters) are free
        self._squares = np.empty(0, np.float32)
        self._radius = 0.0
        self._rng = np.random.default_rng(seed)

    def add(self, descriptor: FrameDescriptor) -> None:
        """Add a frame to the nearest cluster within the radius, or open a new one."""
        # Minus a grey of 128, so that float32 keeps differences of long vectors exact.
        thumbnail = descriptor.thumbnail.ravel() - np.float32(128)
        n = len(self.clusters)
        if n == 0:
            self._centres = np.empty((self.limit + 1, thumbnail.size), np.float32)
            self._squares = np.empty(self.limit + 1, np.float32)
        else:
            square = self._squares[:n] - 2 * (self._centres[:n] @ thumbnail) + thumbnail @ thumbnail
            nearest = int(np.argmin(square))
            if square[nearest] <= self._radius**2 * thumbnail.size:
                self.clusters[nearest].merge(Cluster([descriptor]), self._rng)
                return
        self._centres[n], self._squares[n] = thumbnail, thumbnail @ thumbnail
        self.clusters.append(Cluster([descriptor]))
        while len(self.clusters) > self.limit:
            self._coarsen()

    def _coarsen(self) -> None:
        """Increase the radius so that about a fifth of the clusters is merged."""
        distance = rms_distances(self._centres[: len(self.clusters)])
        np.fill_diagonal(distance, np.inf)
        self._radius = max(1.2 * self._radius, float(np.quantile(distance.min(axis=1), 0.2)))
        kept: list[int] = []
        for index, cluster in enumerate(self.clusters):
            near = distance[index, kept]
            if len(kept) and near.min() <= self._radius:
                self.clusters[kept[int(np.argmin(near))]].merge(cluster, self._rng)
            else:
                kept.append(index)
        self.clusters = [self.clusters[index] for index in kept]
        self._centres[: len(kept)] = self._centres[kept]
        self._squares[: len(kept)] = self._squares[kept]


@dataclass
class BinnedClusters:
    """Clusters of frames in bins of a quantity that is known from their time: the time itself, or a pressure.

    Attributes
    ----------
    value_at : callable
        time_s -> (value, branch); None for a time at which the value is unknown.
    width : float
        Width of a bin, in the value's unit; doubled whenever there are more than `limit` clusters.
    limit : int
        Largest number of clusters.
    seed : int
        Seed of the random sample in each cluster.
    """

    value_at: Callable[[float], tuple[float, int] | None]
    width: float
    limit: int
    seed: int = 0
    _bins: dict[tuple[int, int], Cluster] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    @property
    def clusters(self) -> list[Cluster]:
        """The clusters, by branch and value."""
        return [self._bins[key] for key in sorted(self._bins)]

    def add(self, descriptor: FrameDescriptor) -> None:
        """Add a frame to the bin of its time; a frame whose value is unknown is left out."""
        found = self.value_at(descriptor.time_s)
        if found is not None:
            value, branch = found
            self._put((branch, int(value // self.width)), Cluster([descriptor], branch=branch))
        while len(self._bins) > self.limit:
            self.width *= 2
            finer, self._bins = self._bins, {}
            for (branch, index), cluster in finer.items():
                self._put((branch, index // 2), cluster)

    def _put(self, key: tuple[int, int], cluster: Cluster) -> None:
        if key in self._bins:
            self._bins[key].merge(cluster, self._rng)
        else:
            self._bins[key] = cluster


def rms_distances(thumbnails: FloatArray, others: FloatArray | None = None) -> FloatArray:
    """Return the root mean square difference of each thumbnail to each other one.

    Parameters
    ----------
    thumbnails : ndarray of float
        (n, P) grey levels.
    others : ndarray of float or None, optional
        (m, P) grey levels; None compares `thumbnails` with themselves.

    Returns
    -------
    ndarray of float
        (n, m) grey levels.
    """
    others = thumbnails if others is None else others
    squares = [(array * array).sum(axis=1, dtype=np.float64) for array in (thumbnails, others)]
    square = squares[0][:, None] + squares[1][None] - 2 * (thumbnails @ others.T)
    return np.sqrt(np.maximum(square, 0) / thumbnails.shape[1])
