"""What coding, and the way from the camera at a smaller size, take from an image."""

from __future__ import annotations

from fractions import Fraction

import av
import cv2
import numpy as np

from ...types import ImageArray
from .look import Sensor

# Fast ones leave more behind, as a camera's own chip does.
_H264 = {"preset": "ultrafast", "tune": "zerolatency"}


def coded(image: ImageArray, sensor: Sensor) -> ImageArray:
    """The image as it comes out of the camera's stream."""
    height, width = image.shape[:2]
    if sensor.shrink > 1:
        small = (round(width / sensor.shrink), round(height / sensor.shrink))
        image = cv2.resize(image, small, interpolation=cv2.INTER_AREA)
    if sensor.h264_crf:
        image = _h264(image, sensor.h264_crf)
    elif sensor.jpeg_quality:
        image = _jpeg(image, sensor.jpeg_quality, sensor.subsampled)
    if sensor.shrink > 1:
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    return image


def _jpeg(image: ImageArray, quality: int, subsampled: bool) -> ImageArray:
    sampling = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420 if subsampled else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
    settings = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    # Red and blue change places on the way in and out alike.
    return np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, settings)[1], cv2.IMREAD_COLOR), np.uint8)


def _h264(image: ImageArray, crf: int) -> ImageArray:
    """A key frame of a film, with what its colours at half the size lose."""
    height, width = image.shape[:2]
    even = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    encoder = av.CodecContext.create("libx264", "w")
    encoder.height, encoder.width = even.shape[:2]
    encoder.pix_fmt, encoder.time_base = "yuv420p", Fraction(1, 30)
    encoder.thread_count, encoder.options = 1, {**_H264, "crf": str(crf)}
    decoder = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    packets = encoder.encode(av.VideoFrame.from_ndarray(even, format="rgb24")) + encoder.encode(None)
    # None at the end: hand over what is still held.
    (frame,) = (frame for packet in [*packets, None] for frame in decoder.decode(packet))
    return np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)[:height, :width]
