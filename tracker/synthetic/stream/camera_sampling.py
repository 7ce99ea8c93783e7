"""Cameras and lamps of a look, sampled at random.

What they do to an image is in `exposure.py` and `coding.py`."""

from __future__ import annotations

import math
from dataclasses import replace

from .look import Body, Light, Sensor, View
from .rng import Rng


def drawn_view(rng: Rng) -> View:
    """How the plane is seen."""
    tilted, bowed = rng.bernoulli(0.6), rng.bernoulli(0.4)
    return View(
        tilt_x_deg=rng.normal(0, 12) if tilted else 0.0,
        tilt_y_deg=rng.normal(0, 12) if tilted else 0.0,
        nearness=rng.uniform(0.0, 0.8) if tilted else 0.0,
        lens=rng.normal(-0.05, 0.12) if bowed else 0.0,
    )


def drawn_light(rng: Rng, body: Body, size_wh: tuple[int, int]) -> Light:
    """Lamps and exposure."""
    unit = max(size_wh) / 256
    warm = rng.normal(0, 0.09) if rng.bernoulli(0.7) else rng.normal(0, 0.2)
    green = rng.normal(0, 0.03)
    hard = rng.bernoulli(0.4)
    exposure = rng.uniform(0.85, 1.15) if rng.bernoulli(0.7) else rng.log_uniform(0.55, 1.6)
    return Light(
        azimuth_deg=rng.uniform(0, 360),
        elevation_deg=rng.uniform(25, 72),
        ambient=rng.uniform(0.3, 0.8),
        tint=(1 + warm, 1 + green, 1 - warm),
        gradient=rng.uniform(0, 0.4) if rng.bernoulli(0.6) else 0.0,
        vignette=rng.uniform(0, 0.3) if rng.bernoulli(0.5) else 0.0,
        shadow=rng.uniform(0.15, 0.7),
        shadow_px=rng.uniform(0.2, 1.6) * body.half_px,
        softness_px=(rng.uniform(0.5, 2) if hard else rng.uniform(2, 9)) * unit,
        gain=exposure,
        gamma=rng.uniform(0.8, 1.25),
        drift=_drawn_drift(rng.spawn(1)),
    )


def _drawn_drift(rng: Rng) -> float:
    """Of a camera that sets its exposure itself, or lamps and windows that are not steady."""
    return rng.uniform(0.03, 0.2) if rng.bernoulli(0.5) else 0.0


def drawn_sensor(rng: Rng, size_wh: tuple[int, int]) -> Sensor:
    """What the camera does to the image."""
    unit = max(size_wh) / 256
    kind = rng.uniform(0, 1)
    return Sensor(
        kind="colour" if kind < 0.84 else "grey" if kind < 0.93 else "infrared",
        blur_px=rng.uniform(0.0, 1.0) if rng.bernoulli(0.8) else rng.uniform(1.0, 2.3) * math.sqrt(unit),
        motion_px=rng.uniform(2, 7) if rng.bernoulli(0.12) else 0.0,
        motion_deg=rng.uniform(0, 180),
        sharpening=rng.uniform(0.2, 1.0) if rng.bernoulli(0.3) else 0.0,
        noise=rng.log_uniform(0.6, 5) if rng.bernoulli(0.88) else rng.uniform(5, 12),
        noise_cell=rng.choice((1.0, 1.0, 2.0)),
        jpeg_quality=rng.integer(18, 92) if rng.bernoulli(0.65) else 0,
        subsampled=rng.bernoulli(0.7),
        h264_crf=0,
        shrink=rng.uniform(1.3, 2.2) if rng.bernoulli(0.12) else 1.0,
    )


def as_of_a_film(sensor: Sensor, rng: Rng) -> Sensor:
    """The same camera, whose image is one of a coded film."""
    return replace(sensor, jpeg_quality=0, h264_crf=rng.integer(22, 42))
