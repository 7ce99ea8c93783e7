"""Labelled frames' image files: how they are read, and what a labelled frame is called."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ...tracker.errors import LabelError
from ...tracker.types import ImageArray, LabelledFrame


def read_image(frame: LabelledFrame) -> ImageArray:
    """The frame's picture, RGB uint8 (H, W, 3).

    Raises
    ------
    LabelError
        If the file is missing or not a picture.
    """
    return read_image_file(frame.image_path)


def read_image_file(path: Path) -> ImageArray:
    """A picture file as RGB uint8 (H, W, 3); errors as `read_image`."""
    # Bytes first: OpenCV opens no path beyond the Latin ones on Windows, and prints warnings of its own.
    # A camera's orientation tag is ignored, as the labelling tools and the label store ignore it.
    raw = np.fromfile(path, np.uint8) if path.is_file() else np.empty(0, np.uint8)
    data = cv2.imdecode(raw, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION) if raw.size else None
    if data is None:
        raise LabelError(f"expected a picture at {path}, got a missing or unreadable file")
    return cv2.cvtColor(data, cv2.COLOR_BGR2RGB)


def frame_id(frame: LabelledFrame) -> str:
    """What a labelled frame is called in a checkpoint: its folder and picture."""
    return f"{frame.video}/{frame.image_path.name}"
