"""Pictures as a browser gets them: their size, thumbnails, and TIFF turned into PNG.

Which pictures there are is `annotations.py`'s business. EXIF orientation is not applied, as in training.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from PIL import Image

from ..tracker.errors import LabelError
from .annotations import Picture

THUMBNAIL_WH = (240, 160)
MEDIA_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".bmp": "image/bmp"}
_THUMBNAIL_QUALITY = 80


@lru_cache(maxsize=65536)
def picture_size_wh(picture: Picture) -> tuple[int, int] | None:
    """(width, height) px from the file's head alone, None where it does not open as a picture."""
    try:
        with Image.open(picture.path) as image:
            return image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def picture_for_browser(picture: Picture) -> tuple[bytes, str]:
    """The file's bytes and media type; what browsers do not show (TIFF) as PNG.

    Raises
    ------
    LabelError
        A TIFF that cannot be read.
    """
    media_type = MEDIA_TYPES.get(picture.path.suffix.lower())
    if media_type is not None:
        return picture.path.read_bytes(), media_type
    _, data = cv2.imencode(".png", decoded_picture(picture, cv2.IMREAD_COLOR))
    return data.tobytes(), "image/png"


@lru_cache(maxsize=4096)
def thumbnail(picture: Picture) -> bytes:
    """A small JPEG; the latest few thousand (of a few kB) are kept.

    Raises
    ------
    LabelError
        The picture cannot be read.
    """
    # A JPEG can be decoded at half its size, in less of the time.
    image = decoded_picture(picture, cv2.IMREAD_REDUCED_COLOR_2)
    height, width = image.shape[:2]
    scale = min(THUMBNAIL_WH[0] / width, THUMBNAIL_WH[1] / height, 1.0)
    size_wh = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _THUMBNAIL_QUALITY])
    return data.tobytes()


def decoded_picture(picture: Picture, mode: int = cv2.IMREAD_COLOR) -> np.ndarray:
    """The picture as OpenCV has it (BGR), not turned.

    Raises
    ------
    LabelError
        It cannot be read.
    """
    raw = np.frombuffer(picture.path.read_bytes(), np.uint8)
    image = cv2.imdecode(raw, mode | cv2.IMREAD_IGNORE_ORIENTATION) if raw.size else None
    if image is None:
        raise LabelError(f"{picture.path}: expected a picture, got a file that does not open as one")
    return np.asarray(image)
