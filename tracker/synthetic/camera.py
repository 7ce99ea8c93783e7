"""What the camera does to the picture: blur, sharpening, noise, JPEG. Never moves anything."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import FloatArray, ImageArray
from .looks import Camera


def blurred(picture: FloatArray, camera: Camera) -> FloatArray:
    """Defocus, then the sharpening that webcams apply."""
    result = cv2.GaussianBlur(picture, (0, 0), camera.blur_px) if camera.blur_px > 0 else picture
    if camera.sharpening > 0:
        soft = cv2.GaussianBlur(result, (0, 0), 1.2)
        result = cv2.addWeighted(result, 1 + camera.sharpening, soft, -camera.sharpening, 0)
    return np.asarray(result, np.float32)


def blur_reach_px(camera: Camera) -> int:
    """How far a pixel reaches through `blurred`."""
    return int(np.ceil(4 * camera.blur_px + (5 if camera.sharpening > 0 else 0))) + 1


class NoisePool:
    """Sensor noise of one look, drawn once and cut out anew for every frame.

    A cut from a pool half as large again costs a tenth of fresh Gaussian numbers and no two cuts of a trial
    are likely to be the same.
    """

    def __init__(self, camera: Camera, size_wh: tuple[int, int], seed: int) -> None:
        rng = np.random.default_rng([seed, 4])
        width, height = size_wh
        self._room = (height // 2, width // 2)
        shape = (height + self._room[0], width + self._room[1])
        grey = rng.standard_normal((*shape, 1), dtype=np.float32) * camera.noise
        colour = rng.standard_normal((*shape, 3), dtype=np.float32) * camera.colour_noise
        # The colour filter array spreads colour noise over neighbours.
        self._pool = grey + 2.0 * cv2.GaussianBlur(colour, (0, 0), 0.8)
        self._size_wh = size_wh

    def cut(self, rng: np.random.Generator) -> FloatArray:
        """Noise for one frame, (H, W, 3) float32."""
        top, left = int(rng.integers(self._room[0] + 1)), int(rng.integers(self._room[1] + 1))
        noise: FloatArray = self._pool[top : top + self._size_wh[1], left : left + self._size_wh[0]]
        return noise if rng.integers(2) else -noise


def developed(picture: FloatArray, camera: Camera, gain: float, noise: FloatArray | None) -> ImageArray:
    """Grey levels 0..255 (H, W, 3) float32 to the uint8 picture that the camera hands over."""
    if noise is None:
        image: ImageArray = np.asarray(cv2.convertScaleAbs(np.maximum(picture, 0), alpha=gain), np.uint8)
    else:
        image = np.asarray(cv2.addWeighted(picture, gain, noise, 1.0, 0.0, dtype=cv2.CV_8U), np.uint8)
    if camera.jpeg_quality:
        coded = cv2.imencode(
            ".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, camera.jpeg_quality]
        )[1]
        image = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR_RGB), np.uint8)
    return image
