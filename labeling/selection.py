"""Selecting frames to label: they span the range of motion with small gaps, are sharp, and all differ.

The videos' descriptors come from `video_scan.py`. Poses are ordered by appearance (`motion_axis.py`), time or pressure.
Saving the selected frames is in `frame_extraction.py`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.distance import pdist, squareform

from ..tracker.types import FloatArray
from .frame_descriptors import FrameDescriptor, brightness_ratio
from .gap_filling import Target, fill_gaps
from .motion_axis import Motion, detect_motion, motion_coordinate, split_views
from .stream_clustering import Cluster, rms_distances
from .video_scan import VideoScan

# Largest distance of a frame from its target, in spacings of the targets. It leaves a choice of frames, so that one
# that is not blurred can be found.
_MAX_OFFSET = 0.7
# A frame is blurred when its sharpness is below this part of the sharpest similar frame's.
_MIN_SHARPNESS = 0.75
# Similar thumbnails near a target: their distance from the most typical one is below this multiple of the median one.
_MAX_DISTANCE = 2.0
# Images whose distance is at most this multiple of the noise are the same to a labeller.
_MIN_NOVELTY = 1.5
# A target without a usable frame is moved to the widest gap, in so many rounds.
_ROUNDS = 3

PositionOf = Callable[[float], float | None]


@dataclass(frozen=True)
class _Pose:
    """A cluster of similar frames, and the index of its video."""

    video: int
    cluster: Cluster


def select_frames(
    scans: Sequence[VideoScan], count: int, position_of: Sequence[PositionOf] | None = None
) -> list[list[FrameDescriptor]]:
    """Select frames among the videos of one actuator, so that they and the known ones leave small gaps.

    At each target position the nearest sharp frame is taken. Its sharpness is measured where the image moves and
    compared with similar frames only. Videos take turns, and so do branches (loading, unloading).

    Parameters
    ----------
    scans : sequence of VideoScan
        Scans of all the actuator's videos.
    count : int
        Number of frames. Fewer are selected when the videos do not show so many different images.
    position_of : sequence of PositionOf or None, optional
        For each video, a function from its time_s to the position on the axis over which frames are spread evenly;
        None orders them by appearance.

    Returns
    -------
    list of list of FrameDescriptor
        For each video the descriptors of its selected frames, by frame.
    """
    sets = list(_comparable(scans, by_appearance=position_of is None))
    known = _known(scans, sets)
    chosen: list[list[FrameDescriptor]] = [[] for _ in scans]
    for poses, own, share in zip(sets, known, _shares(sets, count), strict=True):
        for video, descriptor in _MotionLine(scans, poses, own, position_of).select(share):
            chosen[video].append(descriptor)
    return [sorted(descriptors, key=lambda descriptor: descriptor.frame) for descriptors in chosen]


def _comparable(scans: Sequence[VideoScan], *, by_appearance: bool) -> Iterator[list[_Pose]]:
    """Yield sets of poses that can be ordered: thumbnails of one size and, by appearance, of one view."""
    shapes: dict[tuple[int, ...], list[_Pose]] = {}
    for video, found in enumerate(scans):
        for cluster in found.clusters:
            shapes.setdefault(cluster.members[0].thumbnail.shape, []).append(_Pose(video, cluster))
    for poses in shapes.values():
        if not by_appearance:
            yield poses
            continue
        view = split_views(_swept(_thumbnails(scans, poses)), _counts(poses))
        for number in range(view.max() + 1):
            yield [pose for pose, own in zip(poses, view, strict=True) if own == number]


def _known(
    scans: Sequence[VideoScan], sets: Sequence[Sequence[_Pose]]
) -> list[list[tuple[int, FrameDescriptor]]]:
    """Assign every known frame to the most similar set of poses; (video, descriptor) for each set."""
    known: list[list[tuple[int, FrameDescriptor]]] = [[] for _ in sets]
    for video, found in enumerate(scans):
        own = [
            (np.stack([_centred(p.cluster.members[0], 1.0) for p in poses if p.video == video]), index)
            for index, poses in enumerate(sets)
            if any(p.video == video for p in poses)
        ]
        for descriptor in found.known if own else ():
            thumbnail = _centred(descriptor, 1.0)[None]
            known[min(own, key=lambda item: rms_distances(thumbnail, item[0]).min())[1]].append(
                (video, descriptor)
            )
    return known


def _shares(sets: Sequence[Sequence[_Pose]], count: int) -> list[int]:
    """Divide `count` frames among the sets by their share of the videos; all videos weigh the same."""
    frames = Counter[int]()
    for poses in sets:
        for pose in poses:
            frames[pose.video] += pose.cluster.count
    parts = [sum(pose.cluster.count / frames[pose.video] for pose in poses) for poses in sets]
    exact = [count * part / sum(parts) for part in parts]
    shares = [int(part) for part in exact]
    for index in sorted(range(len(exact)), key=lambda i: shares[i] - exact[i])[: count - sum(shares)]:
        shares[index] += 1
    return shares


class _MotionLine:
    """Poses ordered along the motion, and the frames selected along it."""

    def __init__(
        self,
        scans: Sequence[VideoScan],
        poses: Sequence[_Pose],
        known: Sequence[tuple[int, FrameDescriptor]],
        position_of: Sequence[PositionOf] | None,
    ) -> None:
        self._poses = poses
        self._gain = _gains(scans, poses)
        thumbnails, counts = _thumbnails(scans, poses), _counts(poses)
        self._motion = detect_motion(thumbnails, counts)
        self._thumbnails = thumbnails[:, self._motion.moving]
        self._tiles = _tile_weights(self._motion, poses[0].cluster.members[0])
        if position_of is None:
            self._value = motion_coordinate(_swept(self._thumbnails), self._motion.weight)
            nearest = [int(np.argmin(self._differences(video, descriptor))) for video, descriptor in known]
            self._taken = [float(self._value[index]) for index in nearest]
        else:
            self._value = np.array([_position(position_of[p.video], p.cluster.members[0]) for p in poses])
            self._taken = [_position(position_of[video], descriptor) for video, descriptor in known]
        self._seen = [self._thumbnail(video, descriptor) for video, descriptor in known]  # selected or known
        self._turns = Counter[object](video for video, _ in known)

    def select(self, count: int) -> list[tuple[int, FrameDescriptor]]:
        """Select frames.

        Parameters
        ----------
        count : int
            Largest number of frames.

        Returns
        -------
        list of tuple of int and FrameDescriptor
            (index of the video, descriptor) of each frame.
        """
        chosen: list[tuple[int, FrameDescriptor]] = []
        for _ in range(_ROUNDS):
            targets = fill_gaps(self._value.min(), self._value.max(), self._taken, count - len(chosen))
            for target in targets:
                found = self._best_frame(target)
                if found is not None:
                    index, descriptor = found
                    pose = self._poses[index]
                    chosen.append((pose.video, descriptor))
                    self._taken.append(float(self._value[index]))
                    self._seen.append(self._thumbnail(pose.video, descriptor))
                    self._turns.update([pose.video, self._kind(index)])
        return chosen

    def _best_frame(self, target: Target) -> tuple[int, FrameDescriptor] | None:
        """Return the best new frame for a target, with its pose's index: sharp and near."""
        away = np.abs(self._value - target.value)
        near = np.flatnonzero(away <= max(_MAX_OFFSET * target.spacing, away.min()))
        turn = min(
            (self._kind(index) for index in near.tolist()),
            key=lambda kind: (self._turns[kind[0]], self._turns[kind]),
        )
        near = near[[self._kind(index) == turn for index in near.tolist()]]
        # Sharpness is compared among typical frames only, or a frame with a hand in it would be the sharpest.
        between = rms_distances(self._thumbnails[near])
        typical = near[int(np.argmin(between @ self._motion.weight[near]))]
        usual = np.median(
            rms_distances(
                self._thumbnails[typical][None], self._thumbnails[away <= max(2 * target.spacing, away.min())]
            )
        )
        alike = near[between[near == typical][0] <= max(_MAX_DISTANCE * usual, self._motion.noise)]
        members = [
            (index, descriptor) for index in alike for descriptor in self._poses[index].cluster.members
        ]
        sharpness = np.array([self._sharpness(descriptor) for _, descriptor in members])
        is_sharp = sharpness >= _MIN_SHARPNESS * sharpness.max()
        # First sharp frames by their distance from the target, then the others by sharpness.
        distance = np.array([away[index] for index, _ in members])
        order = np.lexsort((np.where(is_sharp, distance, -sharpness), ~is_sharp))
        return next((members[i] for i in order if self._is_new(*members[i])), None)

    def _kind(self, index: int) -> tuple[int, int]:
        """Return a pose's video and branch, which take turns."""
        return self._poses[index].video, self._poses[index].cluster.branch

    def _is_new(self, index: int, descriptor: FrameDescriptor) -> bool:
        """Whether a frame differs from all selected and known ones; where nothing moves, none does."""
        if not self._seen:
            return True
        thumbnail = self._thumbnail(self._poses[index].video, descriptor)
        nearest = float(rms_distances(thumbnail[None], np.stack(self._seen)).min())
        return self._motion.moves and nearest > _MIN_NOVELTY * self._motion.noise

    def _thumbnail(self, video: int, descriptor: FrameDescriptor) -> FloatArray:
        """Return the moving pixels of a thumbnail, scaled to the common brightness."""
        return _centred(descriptor, self._gain[video])[self._motion.moving]

    def _differences(self, video: int, descriptor: FrameDescriptor) -> FloatArray:
        return rms_distances(self._thumbnail(video, descriptor)[None], self._thumbnails)[0]

    def _sharpness(self, descriptor: FrameDescriptor) -> float:
        return float((descriptor.sharpness * self._tiles).sum())


def _position(position_of: PositionOf, descriptor: FrameDescriptor) -> float:
    """Return the position of a frame on the axis, NaN where it is unknown."""
    value = position_of(descriptor.time_s)
    return np.nan if value is None else value


def _swept(thumbnails: FloatArray) -> FloatArray:
    """Return sums of absolute differences (n, n): proportional to the area swept, so even along the motion."""
    return np.asarray(squareform(pdist(thumbnails, "cityblock")))


def _counts(poses: Sequence[_Pose]) -> FloatArray:
    return np.array([pose.cluster.count for pose in poses], dtype=np.float64)


def _gains(scans: Sequence[VideoScan], poses: Sequence[_Pose]) -> dict[int, float]:
    """Return for each video the factor to the first one's brightness, estimated from their first thumbnails."""
    first = {
        video: scans[video].clusters[0].members[0].thumbnail
        for video in sorted({pose.video for pose in poses})
    }
    reference = next(iter(first.values()))
    return {video: brightness_ratio(reference, thumbnail) for video, thumbnail in first.items()}


def _thumbnails(scans: Sequence[VideoScan], poses: Sequence[_Pose]) -> FloatArray:
    """Return the poses' thumbnails, (n, P) float32."""
    gain = _gains(scans, poses)
    return np.stack([_centred(pose.cluster.members[0], gain[pose.video]) for pose in poses])


def _centred(descriptor: FrameDescriptor, gain: float) -> FloatArray:
    """Return a thumbnail (P,) minus a grey of 128, so that float32 keeps differences of long vectors exact."""
    return np.asarray(descriptor.thumbnail.ravel() * np.float32(gain) - np.float32(128))


def _tile_weights(motion: Motion, descriptor: FrameDescriptor) -> FloatArray:
    """Return the share of the moving pixels in each tile of the sharpness map, (rows, columns), with sum 1."""
    moving = motion.moving.reshape(descriptor.thumbnail.shape).astype(np.float32)
    rows, columns = descriptor.sharpness.shape
    weights = cv2.resize(moving, (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(weights / weights.sum())
