"""A frame at a glance: a small grey look of it, and how much detail it has where.

For comparing thousands of frames in little memory. What is kept of a video is in `pose_cells.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import av
import cv2
import numpy as np

from ..tracker.types import FloatArray, ImageArray
from ..tracker.video import Frame

# Longer sides in px, or a little more. A look of 48 px shows a tip that moves by a hundredth of the picture's width,
# and hides noise and the blur that detail is to tell.
LOOK_PX = 48
_TILES = 16
_WORK_PX = 960  # larger frames are made smaller first: blur that this hides does not hurt a label
_DARK = 8.0  # grey levels under which a ratio of brightness says nothing


@dataclass(frozen=True)
class Glimpse:
    """What is remembered of a frame.

    Attributes
    ----------
    frame, time_s : as in `video.Frame`
    look : (h, w) float32 grey levels, as bright as the first look of its video
    detail : (rows, columns) float32, mean absolute Laplacian of the picture's tiles in grey levels: less where blurred
    """

    frame: int
    time_s: float
    look: FloatArray
    detail: FloatArray


class Glimpser:
    """Makes glimpses of the frames of one video, all as bright as the first: lamps and exposure wander."""

    def __init__(self) -> None:
        self._reference: FloatArray | None = None

    def glimpse(self, frame: Frame) -> Glimpse:
        """A glimpse of a frame that was decoded."""
        assert frame.decoded is not None
        grey = _luma(frame.decoded)
        grey = _shrunk(grey, -(-max(grey.shape) // _WORK_PX))
        edges = cv2.convertScaleAbs(cv2.Laplacian(grey, cv2.CV_16S))
        look, detail = (
            frame.orientation.apply(_shrunk(array, max(1, max(array.shape) // longer))).astype(np.float32)
            for array, longer in ((grey, LOOK_PX), (edges, _TILES))
        )
        if self._reference is None:
            self._reference = look
        look = look * np.float32(brightness_ratio(self._reference, look))
        return Glimpse(frame.index, frame.time_s, look, detail)


def look_of(grey: ImageArray) -> FloatArray:
    """Look of a grey picture (H, W) as it is displayed, grey levels as they are."""
    grey = _shrunk(grey, -(-max(grey.shape) // _WORK_PX))
    return _shrunk(grey, max(1, max(grey.shape) // LOOK_PX)).astype(np.float32)


def brightness_ratio(reference: FloatArray, look: FloatArray) -> float:
    """What makes a look as bright as a reference: the median over their pixels. Most of a picture stands still."""
    lit = (reference > _DARK) & (look > _DARK)
    return float(np.median(reference[lit] / look[lit])) if lit.any() else 1.0


def _luma(picture: av.VideoFrame) -> ImageArray:
    """Brightness (H, W) of a decoded picture, without a copy where it has a plane of its own."""
    first = picture.format.components[0]
    if picture.format.name == "gray" or (first.is_luma and first.bits == 8 and len(picture.planes) > 1):
        plane = picture.planes[0]
        rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
        return rows[: picture.height, : picture.width]
    return np.asarray(picture.to_ndarray(format="gray"))


def _shrunk(grey: ImageArray, factor: int) -> ImageArray:
    """Means of blocks of `factor` by `factor` px; what is left over at the right and below is cut off."""
    if factor == 1:
        return grey
    height, width = (max(1, side // factor) for side in grey.shape)
    return np.asarray(
        cv2.resize(grey[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
    )
