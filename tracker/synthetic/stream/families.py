"""The words that say what kind of thing is drawn, and which of them pretraining never sees."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Families:
    """Words that a look may be drawn from, each a tuple: materials, backgrounds, body shapes and clamps."""

    materials: tuple[str, ...]
    backgrounds: tuple[str, ...]
    shapes: tuple[str, ...]
    clamps: tuple[str, ...]


@dataclass(frozen=True)
class Words:
    """One word of each family: what a sample shows."""

    material: str
    background: str
    shape: str
    clamp: str


TRAINING = Families(
    materials=(
        *("translucent white", "white", "pigmented", "dark rubber"),
        *("printed", "fabric", "graded", "banded"),
    ),
    backgrounds=(
        *("plain paper", "lined paper", "squared paper", "dark bench", "wood"),
        *("cutting mat", "breadboard", "room", "studio", "cluttered bench", "collage"),
    ),
    shapes=(
        *("separated chambers", "fast chambers", "smooth chambers", "bellows"),
        *("fibre tube", "PneuFlex", "flat strip", "ribbed tentacle"),
    ),
    clamps=("block", "vice", "printed holder", "clip", "fingers"),
)

HELD_OUT = Families(
    materials=("tinted translucent", "speckled"),
    backgrounds=("optical table", "curtain"),
    shapes=("sawtooth", "knuckled"),
    clamps=("pipe", "boss head"),
)
