"""Random changes to training pictures that a webcam on an actuator could have made: light, colour, blur, noise,
things in the way. Geometry (rotation, scale, shift) is drawn where the views are cut, in `dataset.py`.
"""

from __future__ import annotations

import cv2
import numpy as np

from ...tracker.types import ImageArray

Rng = np.random.Generator

OTHER_ROOM, FURTHER = 0.5, 2.5
"""Share of pictures whose light is changed as much as between two rooms, and how much more that is."""


def change_light(image: ImageArray, rng: Rng) -> ImageArray:
    """Exposure, contrast, gamma and colour cast, one random draw for the picture: half as between two hours of a
    day, half as between two rooms."""
    level = np.arange(256, dtype=np.float32) / 255
    far = FURTHER if rng.random() < OTHER_ROOM else 1.0
    gamma = np.exp(rng.normal(0, 0.15 * far))
    gain = np.exp(rng.normal(0, 0.12 * far) + rng.normal(0, 0.04 * far, size=3))
    shift = rng.normal(0, 0.05 * far) + rng.normal(0, 0.02 * far, size=3)
    table = (level[:, None] ** gamma - 0.5) * gain + 0.5 + shift
    return cv2.LUT(image, np.clip(table * 255, 0, 255).astype(np.uint8)[None])


def blur(image: ImageArray, rng: Rng) -> ImageArray:
    """Defocus or motion blur, about a px, in two of five pictures."""
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
    """Sensor noise of up to 3 % in half of the pictures."""
    if rng.random() < 0.5:
        return image
    noise = rng.standard_normal(image.shape, dtype=np.float32) * rng.uniform(1.0, 8.0)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def occlude(image: ImageArray, rng: Rng) -> tuple[ImageArray, ImageArray]:
    """Put something in the way in half of the pictures.

    Returns
    -------
    the picture, and a mask uint8 (H, W) that is 255 where it is hidden
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
    # What hides is of one colour, often the actuator's own, or another piece of the scene: colour alone never tells.
    if rng.random() < 0.5:
        cover = np.empty_like(image)
        own = image[rng.integers(h), rng.integers(w)]
        cover[:] = own if rng.random() < 0.5 else rng.integers(0, 256, size=3, dtype=np.uint8)
    else:
        cover = np.roll(image, (int(rng.integers(h)), int(rng.integers(w))), axis=(0, 1))
    hidden = mask[..., None] > 0
    return np.where(hidden, cover, image), mask


def change_picture(image: ImageArray, rng: Rng) -> ImageArray:
    """Light, blur and noise together, in the order in which a camera applies them."""
    return add_noise(blur(change_light(image, rng), rng), rng)
