"""The random number generator that looks are sampled from: single plain numbers, words and colours.

Fields of noise over an image are in `noise.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from .look import Colour

T = TypeVar("T")


def hue_colour(turn: float, saturation: float, level: float) -> Colour:
    """The colour of a hue.

    Parameters
    ----------
    turn : float
        Place on the colour wheel in [0, 6), 0 is red.
    saturation, level : float
        In [0, 1].
    """
    r, g, b = (level * (1 - saturation * min(max(abs((turn + k) % 6 - 3) - 1, 0), 1)) for k in (3, 1, 5))
    return r, g, b


class Rng:
    """Draws single numbers, several times faster than numpy's own generator with its array checks.

    Parameters
    ----------
    *key : int
        The same key draws the same numbers.

    Attributes
    ----------
    generator : numpy.random.Generator
        What all numbers come from.
    """

    def __init__(self, *key: int) -> None:
        self._key = key
        self.generator = np.random.default_rng(list(key))

    def spawn(self, number: int) -> Rng:
        """An independent generator: what it draws changes nothing of what this one draws."""
        return Rng(*self._key, number)

    def uniform(self, low: float, high: float) -> float:
        """A float from [low, high)."""
        return low + (high - low) * float(self.generator.random())

    def log_uniform(self, low: float, high: float) -> float:
        """A float from [low, high), evenly spread on a logarithmic scale."""
        return low * (high / low) ** float(self.generator.random())

    def normal(self, mean: float, sd: float) -> float:
        """A normal number, clipped at two standard deviations."""
        return mean + sd * min(max(float(self.generator.standard_normal()), -2.0), 2.0)

    def bernoulli(self, probability: float) -> bool:
        """True with this probability."""
        return float(self.generator.random()) < probability

    def integer(self, low: int, high: int) -> int:
        """An integer, both ends included."""
        return int(self.generator.integers(low, high + 1))

    def choice(self, options: Sequence[T]) -> T:
        """One of the options, all equally likely."""
        return options[int(self.generator.integers(len(options)))]

    def jittered(self, colour: Colour, sd: float = 0.05) -> Colour:
        """A similar colour: relative brightness differs by 2 `sd`, each channel by half an `sd`."""
        factor = 1 + self.normal(0, 2 * sd)
        r, g, b = (min(max(c * factor + self.normal(0, 0.5 * sd), 0.01), 0.99) for c in colour)
        return r, g, b

    def any_hue(self, saturation: float, level: float) -> Colour:
        """A colour of any hue."""
        return hue_colour(self.uniform(0, 6), saturation, level)

    def seed(self) -> int:
        """A seed for a generator that draws details later."""
        return int(self.generator.integers(2**31))
