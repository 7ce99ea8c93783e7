"""Transfer from a source network of ours: the weights of both its networks, and its heads of keypoints that match.

Which keypoints match is decided here by name and by order; by image content in `keypoint_matching`.
"""

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
"""Canonical names of the first two and the last two keypoints of a chain whose names are not known."""


def source_checkpoint(start: str, backbone: str) -> Checkpoint | None:
    """The checkpoint of ours that a training starts from.

    Parameters
    ----------
    start : str
        From `initialisation.resolve_init`.
    backbone : str
        Of the network to train.

    Returns
    -------
    Checkpoint or None
        None where the start is no checkpoint of ours, or has another backbone.

    Raises
    ------
    WeightsError
        The start is "actuator", and no shipped network has this backbone.
    """
    if start == "actuator":
        return load_checkpoint(shipped_network(backbone))
    if start in WORDS:  # never a file, even where one has that name
        return None
    try:
        source = load_checkpoint(Path(start))
    except CheckpointError:
        return None
    return source if source.backbone == backbone else None


def transfer_weights(
    network: Cascade, keypoints: Sequence[str], source: Checkpoint, mapping: Mapping[str, str]
) -> None:
    """Load a source's weights into a network with keypoints of its own.

    Residual stages that the source does not have contribute zero at first.

    Parameters
    ----------
    network : Cascade
        Changed in place.
    keypoints : sequence of str
        Its keypoints.
    source : Checkpoint
    mapping : mapping from str to str
        The source's keypoint for each of ours whose head is transferred; the other heads keep their weights.
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
    keypoints: Sequence[str], known: Sequence[str], matched: Mapping[str, str] | None = None
) -> dict[str, str]:
    """The source's keypoint for each of ours that it knows.

    They match by name. Where no name is known, the first two and the last two of the chain are its ends, in the order
    of the chain or reversed, whichever agrees with what matched by image content.

    Parameters
    ----------
    keypoints : sequence of str
        Ours, in the order of the chain.
    known : sequence of str
        The source's.
    matched : mapping from str to str, optional
        From `keypoint_matching.match_keypoints`.

    Returns
    -------
    dict from str to str

    Examples
    --------
    >>> keypoint_mapping(["root", "neck", "wrist", "nail"], ["base_1", "base_2", "mid_1", "tip_1", "tip_2"])
    {'root': 'base_1', 'neck': 'base_2', 'wrist': 'tip_1', 'nail': 'tip_2'}
    >>> keypoint_mapping(["nail", "root"], ["base_1", "tip_2"], {"nail": "tip_2", "root": "base_1"})
    {'nail': 'tip_2', 'root': 'base_1'}
    >>> keypoint_mapping(["nail", "wrist", "neck", "root"], [*ENDS], {"nail": "tip_2"})
    {'root': 'base_1', 'neck': 'base_2', 'wrist': 'tip_1', 'nail': 'tip_2'}
    >>> keypoint_mapping(["a", "b", "c", "d", "e"], [*ENDS], {"c": "tip_1"})
    {'c': 'tip_1'}
    >>> keypoint_mapping(["tip_2", "ear"], ["tip_1", "tip_2"])
    {'tip_2': 'tip_2'}
    """
    named = {name: name for name in keypoints if name in known}
    if named:
        return named
    mapping = dict(matched or {})
    if len(keypoints) < len(ENDS) or not set(ENDS) <= set(known):
        return mapping
    for chain in (keypoints, keypoints[::-1]):
        placed = {**dict(zip((*chain[:2], *chain[-2:]), ENDS, strict=True)), **mapping}
        ends = [placed[name] for name in (*chain[:2], *chain[-2:])]
        if ends == list(ENDS) and len(set(placed.values())) == len(placed):
            return placed
    return mapping


def _rows(keypoints: Sequence[str], name: str) -> list[int]:
    """Rows of a head that belong to a keypoint: its heat, two of its offset, three of its spread (`Maps`)."""
    k, i = len(keypoints), list(keypoints).index(name)
    return [i, *(k + 2 * i + j for j in range(2)), *(3 * k + 3 * i + j for j in range(3))]
