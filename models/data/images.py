"""Image files of labelled frames: reading them, and the id of a labelled frame."""

from __future__ import annotations

from pathlib import Path

import cv2

from ...tracker.errors import LabelError
from ...tracker.image_files import decode_image
from ...tracker.types import ImageArray, LabelledFrame


def read_image(frame: LabelledFrame) -> ImageArray:
    """Read a labelled frame's image.

    Parameters
    ----------
    frame : LabelledFrame

    Returns
    -------
    (H, W, 3) uint8 array
        RGB.

    Raises
    ------
    LabelError
        The file is missing or not an image.
    """
    return read_image_file(frame.image_path)


def read_image_file(path: Path) -> ImageArray:
    """Read an image file as RGB (H, W, 3) uint8.

    Raises
    ------
    LabelError
        The file is missing, not an image, or larger than any frame.
    """
    # Bytes first: on Windows OpenCV opens Latin paths only, and it prints warnings of its own.
    # A camera's orientation tag is ignored, as the labelling tools and the label store ignore it.
    try:
        contents = path.read_bytes() if path.is_file() else b""
        data = decode_image(contents, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except LabelError as error:
        raise LabelError(f"{path}: {error}") from error
    if data is None:
        raise LabelError(f"expected an image at {path}, got a missing or unreadable file")
    return cv2.cvtColor(data, cv2.COLOR_BGR2RGB)


def frame_id(frame: LabelledFrame) -> str:
    """Id of a labelled frame in a checkpoint: `video/image file name`."""
    return f"{frame.video}/{frame.image_path.name}"
