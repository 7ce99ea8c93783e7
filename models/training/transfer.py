"""A training that starts from another network of ours: both its networks, and its heads for keypoints that it knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch

from ...tracker.errors import CheckpointError
from ..networks.cascade import Cascade
from ..networks.checkpoint import Checkpoint, load_checkpoint
from ..networks.initialisation import WORDS
from ..networks.shipped import shipped_network

ENDS = ("base_1", "base_2", "tip_1", "tip_2")
"""What the first two and the last two keypoints of a chain are, where no name says it."""


def source_checkpoint(start: str, backbone: str) -> Checkpoint | None:
    """The network that a training's start names; None where it names something else, or one with other layers.

    Raises
    ------
    WeightsError
        The start is "actuator", and no such network comes with this backbone.
    """
    if start == "actuator":
        return load_checkpoint(shipped_network(backbone))
    if start in WORDS:  # whatever lies under such a name
        return None
    try:
        source = load_checkpoint(Path(start))
    except CheckpointError:
        return None
    return source if source.backbone == backbone else None


def transfer_weights(
    network: Cascade, keypoints: Sequence[str], source: Checkpoint, mapping: Mapping[str, str]
) -> None:
    """Put a parent's weights into a network with keypoints of its own.

    Residual stages that the parent does not have say nothing at first.

    Parameters
    ----------
    taken : the parent's keypoint for each of ours whose head is taken over; the other heads stay as they are
    """
    rows = [row for name in mapping for row in _rows(keypoints, name)]
    source_rows = [row for name in mapping.values() for row in _rows(source.keypoints, name)]
    for own, other in ((network.locator, source.network.locator), (network.refiner, source.network.refiner)):
        state = own.state_dict()
        for lateral in own.lateral[len(other.lateral) :].parameters():
            torch.nn.init.zeros_(lateral)
        for name, value in other.state_dict().items():
            if name.startswith("head."):
                state[name][rows] = value[source_rows]
            else:
                state[name] = value
        own.load_state_dict(state)


def keypoint_mapping(
    keypoints: Sequence[str], known: Sequence[str], match_keypoints: Mapping[str, str] | None = None
) -> dict[str, str]:
    """For each keypoint the known one that it is: by name, or where no name is known, by its place in the chain,
    whichever end of that comes first, as far as the labels do not say otherwise.

    recognised : what the labels say (`recognition.recognised`)

    >>> counterparts(["root", "neck", "wrist", "nail"], ["base_1", "base_2", "mid_1", "tip_1", "tip_2"])
    {'root': 'base_1', 'neck': 'base_2', 'wrist': 'tip_1', 'nail': 'tip_2'}
    >>> counterparts(["nail", "root"], ["base_1", "tip_2"], {"nail": "tip_2", "root": "base_1"})
    {'nail': 'tip_2', 'root': 'base_1'}
    >>> counterparts(["nail", "wrist", "neck", "root"], [*ENDS], {"nail": "tip_2"})
    {'root': 'base_1', 'neck': 'base_2', 'wrist': 'tip_1', 'nail': 'tip_2'}
    >>> counterparts(["a", "b", "c", "d", "e"], [*ENDS], {"c": "tip_1"})
    {'c': 'tip_1'}
    >>> counterparts(["tip_2", "ear"], ["tip_1", "tip_2"])
    {'tip_2': 'tip_2'}
    """
    named = {name: name for name in keypoints if name in known}
    if named:
        return named
    told = dict(match_keypoints or {})
    if len(keypoints) < len(ENDS) or not set(ENDS) <= set(known):
        return told
    for chain in (keypoints, keypoints[::-1]):
        placed = {**dict(zip((*chain[:2], *chain[-2:]), ENDS, strict=True)), **told}
        ends = [placed[name] for name in (*chain[:2], *chain[-2:])]
        if ends == list(ENDS) and len(set(placed.values())) == len(placed):
            return placed
    return told


def _rows(keypoints: Sequence[str], name: str) -> list[int]:
    """Rows of a head that belong to a keypoint: its heat, its two offsets, the three of its spread (`network.Maps`)."""
    k, i = len(keypoints), list(keypoints).index(name)
    return [i, *(k + 2 * i + j for j in range(2)), *(3 * k + 3 * i + j for j in range(3))]
