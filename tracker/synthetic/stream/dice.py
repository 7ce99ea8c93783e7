"""Random numbers as a look is drawn from them: quick for single ones, and read like a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from .look import Colour

T = TypeVar("T")


def hue_colour(turn: float, saturation: float, level: float) -> Colour:
    """The colour of a hue, `turn` in [0, 6) about the wheel from red."""
    r, g, b = (level * (1 - saturation * min(max(abs((turn + k) % 6 - 3) - 1, 0), 1)) for k in (3, 1, 5))
    return r, g, b


class Dice:
    """Draws single plain numbers and words."""

    def __init__(self, *key: int) -> None:
        self._key = key
        self.rng = np.random.default_rng(list(key))

    def apart(self, number: int) -> Dice:
        """Other dice, for what is drawn beside: what these draw stays as it is."""
        return Dice(*self._key, number)

    def between(self, low: float, high: float) -> float:
        """Evenly spread."""
        return low + (high - low) * float(self.rng.random())

    def steeply(self, low: float, high: float) -> float:
        """Small ones as often as large ones on a logarithmic scale."""
        return low * (high / low) ** float(self.rng.random())

    def about(self, mean: float, spread: float) -> float:
        """Normal, cut at two standard deviations."""
        return mean + spread * min(max(float(self.rng.standard_normal()), -2.0), 2.0)

    def maybe(self, chance: float) -> bool:
        """True as often as `chance`."""
        return float(self.rng.random()) < chance

    def whole(self, low: int, high: int) -> int:
        """Whole number, both ends included."""
        return int(self.rng.integers(low, high + 1))

    def one_of(self, things: Sequence[T]) -> T:
        """Any of them."""
        return things[int(self.rng.integers(len(things)))]

    def near(self, colour: Colour, spread: float = 0.05) -> Colour:
        """A colour like it: another brightness, a little other hue."""
        factor = 1 + self.about(0, 2 * spread)
        r, g, b = (min(max(c * factor + self.about(0, 0.5 * spread), 0.01), 0.99) for c in colour)
        return r, g, b

    def hue(self, saturation: float, level: float) -> Colour:
        """Any hue."""
        return hue_colour(self.between(0, 6), saturation, level)

    def seed(self) -> int:
        """For what is drawn later."""
        return int(self.rng.integers(2**31))
