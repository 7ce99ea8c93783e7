"""Decoding image files of any origin: the size in the header is checked before any pixel is decoded.

A picture of one colour is a thousand times smaller as a file than in memory. Which images are read is up to the caller.
"""

from __future__ import annotations

import io

import cv2
import numpy as np
from PIL import Image, TiffImagePlugin

from .errors import LabelError

# 8192 x 8192 px, 200 MB in memory: four times a frame of 8K video.
MAX_PIXELS = 2**26


def header_size_wh(contents: bytes) -> tuple[int, int] | None:
    """Return the size that an image's header gives.

    Parameters
    ----------
    contents : bytes
        The image file.

    Returns
    -------
    tuple of int or None
        (width, height) px; None where it is no known image file.

    Raises
    ------
    LabelError
        It has more than `MAX_PIXELS`.
    """
    size_wh: tuple[int, int] | None
    try:
        with Image.open(io.BytesIO(contents)) as image:
            size_wh = image.size
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise LabelError(
            f"expected an image of at most {MAX_PIXELS / 1e6:.0f} megapixels, got more"
        ) from error
    except Exception:  # Pillow raises many kinds of errors on damaged files
        size_wh = _tiff_size_wh(contents)
    if size_wh is not None and size_wh[0] * size_wh[1] > MAX_PIXELS:
        raise LabelError(
            f"expected an image of at most {MAX_PIXELS / 1e6:.0f} megapixels, got {size_wh[0]} x {size_wh[1]} px"
        )
    return size_wh


def _tiff_size_wh(contents: bytes) -> tuple[int, int] | None:
    """Size of a TIFF whose pixels Pillow does not know (16 bits of three colours), but OpenCV does."""
    if contents[:4] not in (b"II*\0", b"MM\0*"):
        return None
    try:
        directory = TiffImagePlugin.ImageFileDirectory_v2(contents[:8])
        file = io.BytesIO(contents)
        file.seek(directory.next)
        directory.load(file)
        width, height = int(directory[256]), int(directory[257])
    except Exception:  # a damaged directory
        return None
    return (width, height) if width > 0 and height > 0 else None


def decode_image(contents: bytes, mode: int) -> np.ndarray | None:
    """Decode an image file.

    Parameters
    ----------
    contents : bytes
        The image file.
    mode : int
        OpenCV's IMREAD flags.

    Returns
    -------
    ndarray or None
        (H, W, 3) uint8 BGR, or as `mode` says; None where it does not open as an image.

    Raises
    ------
    LabelError
        It has more than `MAX_PIXELS`.
    """
    if header_size_wh(contents) is None:
        return None
    try:
        return cv2.imdecode(np.frombuffer(contents, np.uint8), mode)
    except cv2.error:
        return None
