"""How the camera and the lamps of a look are drawn by chance."""

from __future__ import annotations

import math
from dataclasses import replace

from .dice import Dice
from .look import Body, Light, Sensor, View


def drawn_view(dice: Dice) -> View:
    """How the plane is seen."""
    tilted, bowed = dice.maybe(0.6), dice.maybe(0.4)
    return View(
        tilt_x_deg=dice.about(0, 12) if tilted else 0.0,
        tilt_y_deg=dice.about(0, 12) if tilted else 0.0,
        nearness=dice.between(0.0, 0.8) if tilted else 0.0,
        lens=dice.about(-0.05, 0.12) if bowed else 0.0,
    )


def drawn_light(dice: Dice, body: Body, size_wh: tuple[int, int]) -> Light:
    """Lamps and exposure."""
    unit = max(size_wh) / 256
    warm = dice.about(0, 0.09) if dice.maybe(0.7) else dice.about(0, 0.2)
    green = dice.about(0, 0.03)
    hard = dice.maybe(0.4)
    exposure = dice.between(0.85, 1.15) if dice.maybe(0.7) else dice.steeply(0.55, 1.6)
    return Light(
        azimuth_deg=dice.between(0, 360),
        elevation_deg=dice.between(25, 72),
        ambient=dice.between(0.3, 0.8),
        tint=(1 + warm, 1 + green, 1 - warm),
        gradient=dice.between(0, 0.4) if dice.maybe(0.6) else 0.0,
        vignette=dice.between(0, 0.3) if dice.maybe(0.5) else 0.0,
        shadow=dice.between(0.15, 0.7),
        shadow_px=dice.between(0.2, 1.6) * body.half_px,
        softness_px=(dice.between(0.5, 2) if hard else dice.between(2, 9)) * unit,
        gain=exposure,
        gamma=dice.between(0.8, 1.25),
        drift=_drawn_drift(dice.apart(1)),
    )


def _drawn_drift(dice: Dice) -> float:
    """Of a camera that sets its exposure itself, or lamps and windows that are not steady."""
    return dice.between(0.03, 0.2) if dice.maybe(0.5) else 0.0


def drawn_sensor(dice: Dice, size_wh: tuple[int, int]) -> Sensor:
    """What the camera does to the picture."""
    unit = max(size_wh) / 256
    kind = dice.between(0, 1)
    return Sensor(
        kind="colour" if kind < 0.84 else "grey" if kind < 0.93 else "infrared",
        blur_px=dice.between(0.0, 1.0) if dice.maybe(0.8) else dice.between(1.0, 2.3) * math.sqrt(unit),
        motion_px=dice.between(2, 7) if dice.maybe(0.12) else 0.0,
        motion_deg=dice.between(0, 180),
        sharpening=dice.between(0.2, 1.0) if dice.maybe(0.3) else 0.0,
        noise=dice.steeply(0.6, 5) if dice.maybe(0.88) else dice.between(5, 12),
        noise_cell=dice.one_of((1.0, 1.0, 2.0)),
        jpeg_quality=dice.whole(18, 92) if dice.maybe(0.65) else 0,
        subsampled=dice.maybe(0.7),
        h264_crf=0,
        shrink=dice.between(1.3, 2.2) if dice.maybe(0.12) else 1.0,
    )


def as_of_a_film(sensor: Sensor, dice: Dice) -> Sensor:
    """The same camera, whose picture is one of a coded film."""
    return replace(sensor, jpeg_quality=0, h264_crf=dice.whole(22, 42))
