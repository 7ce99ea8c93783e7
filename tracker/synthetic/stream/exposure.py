"""From the lit scene to the image that the camera hands over. Moves nothing."""

from __future__ import annotations

import cv2
import numpy as np

from ...types import FloatArray, ImageArray
from .coding import coded
from .look import Light, Sensor
from .noise import sensor_noise


def light_map(light: Light, size_wh: tuple[int, int]) -> FloatArray:
    """Light on each pixel: a fall away from the lamp and a vignette, tinted; (H, W, 3) float32, around 1."""
    width, height = size_wh
    x = np.linspace(-1, 1, 8, dtype=np.float32)[None, :] * (width / max(size_wh))
    y = np.linspace(-1, 1, 8, dtype=np.float32)[:, None] * (height / max(size_wh))
    azimuth = np.radians(light.azimuth_deg)
    level = 1 + np.float32(light.gradient) * (
        x * np.float32(np.cos(azimuth)) + y * np.float32(np.sin(azimuth))
    )
    level = level * (1 - np.float32(light.vignette) * (x * x + y * y))
    coarse = level[..., None] * np.asarray(light.tint, np.float32)
    return np.asarray(cv2.resize(coarse, size_wh, interpolation=cv2.INTER_LINEAR), np.float32)


def expose(
    image: ImageArray, lit: FloatArray, light: Light, sensor: Sensor, rng: np.random.Generator
) -> ImageArray:
    """Expose, blur, add noise and code.

    Parameters
    ----------
    image : ndarray
        RGB uint8 (H, W, 3).
    lit : ndarray
        `light_map`.
    rng : numpy.random.Generator
        Of the noise.
    """
    height, width = image.shape[:2]
    if sensor.blur_px > 0.3:
        image = cv2.GaussianBlur(image, (0, 0), sensor.blur_px)
    if sensor.motion_px > 1:
        image = cv2.filter2D(image, -1, _streak(sensor.motion_px, sensor.motion_deg))
    if sensor.sharpening:
        image = cv2.addWeighted(image, 1 + sensor.sharpening, cv2.blur(image, (3, 3)), -sensor.sharpening, 0)
    exposed = cv2.multiply(image, lit, dtype=cv2.CV_32F)
    if sensor.kind != "colour":
        # Silicone is bright in infrared light, and the red channel comes nearest to that.
        weights = (0.30, 0.59, 0.11) if sensor.kind == "grey" else (0.75, 0.2, 0.05)
        exposed = cv2.cvtColor(cv2.transform(exposed, np.array([weights], np.float32)), cv2.COLOR_GRAY2RGB)
    noise = sensor_noise(rng, (height, width), sensor.noise_cell)
    if sensor.kind != "colour":
        noise = cv2.cvtColor(np.ascontiguousarray(noise[..., 1]), cv2.COLOR_GRAY2RGB)
    image = cv2.addWeighted(exposed, light.gain, noise, sensor.noise, 0.0, dtype=cv2.CV_8U)
    if light.gamma != 1:
        curve = 255 * np.power(np.arange(256) / 255, light.gamma)
        image = cv2.LUT(image, np.round(curve).astype(np.uint8))
    return coded(image, sensor)


def _streak(length_px: float, direction_deg: float) -> FloatArray:
    """Kernel of a movement during the exposure, even about its middle."""
    half = int(np.ceil(length_px / 2))
    kernel = np.zeros((2 * half + 1,) * 2, np.uint8)
    step = 0.5 * length_px * np.array([np.cos(np.radians(direction_deg)), np.sin(np.radians(direction_deg))])
    ends = [tuple(np.round((half + sign * step) * 16).astype(int).tolist()) for sign in (-1, 1)]
    cv2.line(kernel, ends[0], ends[1], 255, 1, cv2.LINE_AA, 4)
    # The drawn line may be uneven by a shade; turned about, it is not.
    even = kernel.astype(np.float32) + kernel[::-1, ::-1]
    return np.asarray(even / even.sum(), np.float32)
