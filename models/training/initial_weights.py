"""The weights that a training starts from, put into its networks.

Where they lie is known to `networks.initialisation`; how heads are taken over, to `transfer`.
"""

from __future__ import annotations

from ..networks.cascade import Cascade
from ..networks.checkpoint import Checkpoint
from ..networks.initialisation import load_backbone, starting_weights
from .keypoint_matching import match_keypoints
from .training_data import TrainingData
from .transfer import keypoint_mapping, source_checkpoint, transfer_weights


def load_initial_weights(network: Cascade, start: str, backbone: str, data: TrainingData) -> dict[str, str]:
    """Put a start's weights into both networks of a cascade.

    Parameters
    ----------
    network : Cascade
        With random weights; changed in place, as `load_state_dict` does.
    start : str
        From `initialisation.resolve_init`.
    backbone : str
        A key of `heatmap_network.BACKBONES`.
    data : TrainingData
        Its labels tell which keypoints the source network knows where names do not.

    Returns
    -------
    dict from str to str
        The source network's keypoint for each of ours that it knows; empty where the start is no network of ours.

    Raises
    ------
    WeightsError
        The weights cannot be loaded.
    """
    source = source_checkpoint(start, backbone)
    if source is not None:
        mapping = _mapping_to(source, data)
        transfer_weights(network, data.keypoints, source, mapping)
        return mapping
    weights = starting_weights(start, backbone)
    if weights is not None:
        load_backbone(network.locator, weights, start)
        load_backbone(network.refiner, weights, start)
    return {}


def _mapping_to(source: Checkpoint, data: TrainingData) -> dict[str, str]:
    """The source network's keypoint for each of ours that it knows: by name, else by where the labels lie."""
    if set(data.keypoints) & set(source.keypoints):
        return keypoint_mapping(data.keypoints, source.keypoints)
    rows = data.trained
    matched = match_keypoints(
        source,
        data.keypoints,
        data.labels[rows],
        [data.images[i] for i in rows],
        [data.frames[i].video for i in rows],
    )
    return keypoint_mapping(data.keypoints, source.keypoints, matched)
