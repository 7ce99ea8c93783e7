"""Frame descriptors: a grey thumbnail of a frame and a map of its sharpness.

They compare thousands of frames in little memory. Which are kept of a video is decided in `stream_clustering.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import av
import cv2
import numpy as np

from ..tracker.types import FloatArray, ImageArray
from ..tracker.video import Frame

# Longer side of a thumbnail in px, or a little more. At 48 px a tip that moves by a hundredth of the image's width is
# visible; noise and blur, which the sharpness measures, are not.
THUMBNAIL_PX = 48
_TILES = 16  # tiles of the sharpness map along the longer side
_WORK_PX = 960  # larger frames are downsampled first: blur that this hides does not hurt a label
_DARK = 8.0  # grey levels; darker pixels give no usable ratio of brightness


@dataclass(frozen=True)
class FrameDescriptor:
    """Descriptor of one frame.

    Attributes
    ----------
    frame : int
        Index of the frame in its video.
    time_s : float
        Seconds from the first frame.
    thumbnail : ndarray of float
        (h, w) float32 grey levels, scaled to the brightness of the video's first thumbnail.
    sharpness : ndarray of float
        (rows, columns) float32, mean absolute Laplacian of each tile of the frame, grey levels; smaller where the
        frame is blurred.
    """

    frame: int
    time_s: float
    thumbnail: FloatArray
    sharpness: FloatArray


class DescriptorExtractor:
    """Computes the descriptors of one video's frames, scaled to the first one's brightness.

    The scaling removes drift of lamps and exposure.
    """

    def __init__(self) -> None:
        self._reference: FloatArray | None = None

    def describe(self, frame: Frame) -> FrameDescriptor:
        """Compute the descriptor of a frame, which must be decoded."""
        assert frame.decoded is not None
        grey = _luma(frame.decoded)
        grey = _downsample(grey, -(-max(grey.shape) // _WORK_PX))
        edges = cv2.convertScaleAbs(cv2.Laplacian(grey, cv2.CV_16S))
        thumbnail, sharpness = (
            frame.orientation.apply(_downsample(array, max(1, max(array.shape) // longer))).astype(np.float32)
            for array, longer in ((grey, THUMBNAIL_PX), (edges, _TILES))
        )
        if self._reference is None:
            self._reference = thumbnail
        thumbnail = thumbnail * np.float32(brightness_ratio(self._reference, thumbnail))
        return FrameDescriptor(frame.index, frame.time_s, thumbnail, sharpness)


def grey_thumbnail(grey: ImageArray) -> FloatArray:
    """Downsample a grey image (H, W), as displayed, to a thumbnail (h, w) float32; grey levels stay."""
    grey = _downsample(grey, -(-max(grey.shape) // _WORK_PX))
    return _downsample(grey, max(1, max(grey.shape) // THUMBNAIL_PX)).astype(np.float32)


def brightness_ratio(reference: FloatArray, thumbnail: FloatArray) -> float:
    """Return the factor from a thumbnail's brightness to a reference's.

    It is the median ratio over the pixels, as most of an image does not move.

    Parameters
    ----------
    reference, thumbnail : ndarray of float
        (h, w) grey levels.

    Returns
    -------
    float
        The factor; 1 where everything is dark.
    """
    lit = (reference > _DARK) & (thumbnail > _DARK)
    return float(np.median(reference[lit] / thumbnail[lit])) if lit.any() else 1.0


def _luma(decoded: av.VideoFrame) -> ImageArray:
    """Return the luma (H, W) of a decoded frame, without a copy where it has a plane of its own."""
    first = decoded.format.components[0]
    if decoded.format.name == "gray" or (first.is_luma and first.bits == 8 and len(decoded.planes) > 1):
        plane = decoded.planes[0]
        rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
        return rows[: decoded.height, : decoded.width]
    return np.asarray(decoded.to_ndarray(format="gray"))


def _downsample(grey: ImageArray, factor: int) -> ImageArray:
    """Average blocks of `factor` by `factor` px; incomplete blocks at the right and bottom are cut off."""
    if factor == 1:
        return grey
    height, width = (max(1, side // factor) for side in grey.shape)
    return np.asarray(
        cv2.resize(grey[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
    )
