"""Photometric augmentation of single training images, as a webcam could have taken them: light, colour, blur, noise,
occluders. Geometric augmentation (rotation, scale, shift) happens where crops are cut, in `training.batches`.
"""

from __future__ import annotations

import cv2
import numpy as np

from ...tracker.types import ImageArray

Rng = np.random.Generator

STRONG_SHARE, STRONG_FACTOR = 0.5, 2.5
"""Share of images whose light changes as strongly as between two rooms, and the factor on the standard deviations
there; the others change as between two hours of a day."""


def change_light(image: ImageArray, rng: Rng) -> ImageArray:
    """Change exposure, contrast, gamma and colour cast by one random draw for the whole image.

    Parameters
    ----------
    image : (H, W, 3) uint8 array
        RGB.
    rng : numpy Generator

    Returns
    -------
    (H, W, 3) uint8 array
    """
    level = np.arange(256, dtype=np.float32) / 255
    strength = STRONG_FACTOR if rng.random() < STRONG_SHARE else 1.0
    gamma = np.exp(rng.normal(0, 0.15 * strength))
    gain = np.exp(rng.normal(0, 0.12 * strength) + rng.normal(0, 0.04 * strength, size=3))
    shift = rng.normal(0, 0.05 * strength) + rng.normal(0, 0.02 * strength, size=3)
    table = (level[:, None] ** gamma - 0.5) * gain + 0.5 + shift
    return cv2.LUT(image, np.clip(table * 255, 0, 255).astype(np.uint8)[None])


def blur(image: ImageArray, rng: Rng) -> ImageArray:
    """Blur an image (H, W, 3) uint8 by defocus (25 % of images) or motion (15 %), about 1 px."""
    draw = rng.random()
    if draw < 0.25:
        return cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 1.0))
    if draw < 0.4:
        length, angle = rng.uniform(1.0, 4.0), rng.uniform(0, np.pi)
        along = np.array([np.cos(angle), np.sin(angle)]) * length / 2
        kernel = np.zeros((7, 7), np.float32)
        for t in np.linspace(-1, 1, 9):
            x, y = 3 + along * t
            x0, y0 = int(np.floor(x)), int(np.floor(y))
            fx, fy = x - x0, y - y0
            for dx, wx in ((0, 1 - fx), (1, fx)):
                for dy, wy in ((0, 1 - fy), (1, fy)):
                    kernel[min(y0 + dy, 6), min(x0 + dx, 6)] += wx * wy
        return cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
    return image


def add_noise(image: ImageArray, rng: Rng) -> ImageArray:
    """Add sensor noise, sd up to 8 of 255 levels, to half of the images (H, W, 3) uint8."""
    if rng.random() < 0.5:
        return image
    noise = rng.standard_normal(image.shape, dtype=np.float32) * rng.uniform(1.0, 8.0)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def occlude(image: ImageArray, rng: Rng) -> tuple[ImageArray, ImageArray]:
    """Put one or two occluders into half of the images.

    Parameters
    ----------
    image : (H, W, 3) uint8 array
    rng : numpy Generator

    Returns
    -------
    image : (H, W, 3) uint8 array
    mask : (H, W) uint8 array
        255 where the image is occluded, else 0.
    """
    h, w = image.shape[:2]
    mask = np.zeros((h, w), np.uint8)
    if rng.random() >= 0.5:
        return image, mask
    for _ in range(rng.integers(1, 3)):
        centre = (int(rng.integers(0, w)), int(rng.integers(0, h)))
        axes = tuple(int(a) for a in np.maximum(rng.uniform(0.04, 0.16, size=2) * max(h, w), 2))
        if rng.random() < 0.5:
            cv2.ellipse(mask, centre, axes, float(rng.uniform(0, 180)), 0, 360, 255, -1)
        else:
            box = cv2.boxPoints((centre, (2 * axes[0], 2 * axes[1]), float(rng.uniform(0, 180))))
            cv2.fillPoly(mask, [np.round(box).astype(np.int32)], 255)
    # An occluder has one colour, often the actuator's own, or shows another part of the scene: colour alone must not
    # give it away.
    if rng.random() < 0.5:
        cover = np.empty_like(image)
        from_scene = image[rng.integers(h), rng.integers(w)]
        cover[:] = from_scene if rng.random() < 0.5 else rng.integers(0, 256, size=3, dtype=np.uint8)
    else:
        cover = np.roll(image, (int(rng.integers(h)), int(rng.integers(w))), axis=(0, 1))
    return np.where(mask[..., None] > 0, cover, image), mask


def change_image(image: ImageArray, rng: Rng) -> ImageArray:
    """Change light, blur and noise of an image (H, W, 3) uint8, in the order in which a camera applies them."""
    return add_noise(blur(change_light(image, rng), rng), rng)
