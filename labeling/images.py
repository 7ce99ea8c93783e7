"""Images in the form in which a browser gets them: size, thumbnail, and TIFF converted to PNG.

Which images there are is in `annotations.py`. EXIF orientation is not applied, as in training.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from ..tracker import image_files
from ..tracker.errors import LabelError
from .annotations import ImageFile

THUMBNAIL_WH = (240, 160)
MEDIA_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".bmp": "image/bmp"}
_THUMBNAIL_QUALITY = 80


@lru_cache(maxsize=65536)
def header_size_wh(image_file: ImageFile) -> tuple[int, int] | None:
    """Return (width, height) in px from the file's header alone, None where it does not open as an image."""
    try:
        return image_files.header_size_wh(image_file.path.read_bytes())
    except (OSError, LabelError):
        return None


def image_for_browser(image_file: ImageFile) -> tuple[bytes, str]:
    """Return an image as a browser can show it: the file's bytes, or PNG for a TIFF.

    Parameters
    ----------
    image_file : ImageFile
        The image.

    Returns
    -------
    tuple of bytes and str
        The encoded image and its media type.

    Raises
    ------
    LabelError
        A TIFF cannot be decoded.
    """
    media_type = MEDIA_TYPES.get(image_file.path.suffix.lower())
    if media_type is not None:
        return image_file.path.read_bytes(), media_type
    _, data = cv2.imencode(".png", decode_image(image_file, cv2.IMREAD_COLOR))
    return data.tobytes(), "image/png"


@lru_cache(maxsize=4096)
def thumbnail(image_file: ImageFile) -> bytes:
    """Return a JPEG of at most `THUMBNAIL_WH`; the last 4096 (of a few kB each) are cached.

    Parameters
    ----------
    image_file : ImageFile
        The image.

    Returns
    -------
    bytes
        The encoded JPEG.

    Raises
    ------
    LabelError
        The image cannot be decoded.
    """
    # A JPEG decodes faster at half its size.
    image = decode_image(image_file, cv2.IMREAD_REDUCED_COLOR_2)
    height, width = image.shape[:2]
    scale = min(THUMBNAIL_WH[0] / width, THUMBNAIL_WH[1] / height, 1.0)
    size_wh = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _THUMBNAIL_QUALITY])
    return data.tobytes()


def decode_image(image_file: ImageFile, mode: int = cv2.IMREAD_COLOR) -> np.ndarray:
    """Decode an image without applying EXIF orientation.

    Parameters
    ----------
    image_file : ImageFile
        The image.
    mode : int, optional
        OpenCV's IMREAD flag.

    Returns
    -------
    ndarray
        (H, W, 3) uint8, BGR; (H, W) in a grey mode.

    Raises
    ------
    LabelError
        The image cannot be decoded.
    """
    try:
        image = image_files.decode_image(image_file.path.read_bytes(), mode | cv2.IMREAD_IGNORE_ORIENTATION)
    except LabelError as error:
        raise LabelError(f"{image_file.path}: {error}") from error
    if image is None:
        raise LabelError(f"{image_file.path}: expected an image, got a file that does not open as one")
    return image
