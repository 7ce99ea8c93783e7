"""The geometry that a set of frames shares while its labels are denoised: reference keypoints, scales and videos.

Holds no images and no positions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...tracker.types import BoolArray, FloatArray
from ..inference.roi import RegionOfInterest, orientations


@dataclass(frozen=True)
class FrameGeometry:
    """How N frames relate to the refiner's patches and to each other.

    Attributes
    ----------
    reference : tuple of int
        For each of the K keypoints the one that gives its patch a direction, from `roi.reference_keypoints`.
    patch_scale : (N,) float array
        Patch px per frame px, one value a frame.
    videos : tuple of str
        The video that each frame is from.
    """

    reference: tuple[int, ...]
    patch_scale: FloatArray
    videos: tuple[str, ...]

    @classmethod
    def of(
        cls, regions: Sequence[RegionOfInterest], reference: Sequence[int], videos: Sequence[str]
    ) -> FrameGeometry:
        """The geometry of frames with these regions of interest.

        Parameters
        ----------
        regions : sequence of N RegionOfInterest
            The region of interest of each frame.
        reference : sequence of K int
            From `roi.reference_keypoints`.
        videos : sequence of N str
            The video that each frame is from.

        Returns
        -------
        FrameGeometry
        """
        scale = np.array([region.refiner_scale for region in regions])
        return cls(tuple(reference), scale, tuple(videos))

    def __len__(self) -> int:
        return len(self.videos)

    def orientations(self, xy: FloatArray) -> FloatArray:
        """Orientation (N, K) rad of each keypoint's patch in frames with positions `xy` (N, K, 2) px."""
        return orientations(xy, self.reference)

    def frames_by_video(self) -> Iterator[tuple[str, BoolArray]]:
        """Each video's name, in alphabetical order, and a mask (N,) of its frames."""
        names = np.array(self.videos)
        for video in sorted(set(self.videos)):
            yield video, names == video
