"""Frames to train on besides one to four labelled ones: found in the labelled video, and kept next to the network.

How the positions are found is in `propagation.py`.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch

from ...tracker.atomic import atomic_write_bytes, atomic_write_text
from ...tracker.batch import PROBE_FRAMES
from ...tracker.errors import BendtrackError, VideoError
from ...tracker.json_files import read_json
from ...tracker.links import make_folder
from ...tracker.types import FloatArray, LabelledFrame
from ...tracker.video import spread_frames
from ..data.images import read_image
from ..networks.checkpoint import Checkpoint, best_device
from ..networks.initialisation import resolve_init
from ..networks.shipped import shipped_network
from ..training.settings import TrainingSettings
from ..training.transfer import keypoint_mapping, source_checkpoint
from .adapt import VideoAdaptation
from .propagation import MAX_LABELS, PropagatedLabels, propagate_labels

FOLDER, POSITIONS_FILE = "propagated", "positions.json"


def videos_with_few_labels(frames: Sequence[LabelledFrame]) -> list[str]:
    """Videos of the actuators that have one to four labelled frames.

    Parameters
    ----------
    frames : sequence of LabelledFrame
        Those without any label do not count.

    Returns
    -------
    list of str
        Stems, in the order in which they come.
    """
    labelled = [frame for frame in frames if not np.isnan(frame.xy).all()]
    counts: dict[str, int] = {}
    for frame in labelled:
        counts[frame.actuator] = counts.get(frame.actuator, 0) + 1
    return list(dict.fromkeys(f.video for f in labelled if counts[f.actuator] <= MAX_LABELS))


def pretrained_start(settings: TrainingSettings) -> tuple[Checkpoint, Path] | None:
    """The pretrained network that a training starts from.

    Parameters
    ----------
    settings : TrainingSettings

    Returns
    -------
    tuple of Checkpoint and Path, or None
        The network and its file; None where the training starts from something else.

    Raises
    ------
    WeightsError
        No network ships with the backbone of the settings.
    """
    start = resolve_init(settings.init, settings.backbone)
    source = source_checkpoint(start, settings.backbone)
    if source is None or not source.pretrained:
        return None
    return source, shipped_network(settings.backbone) if start == "actuator" else Path(start)


def propagated_frames(
    frames: Sequence[LabelledFrame],
    keypoints: Sequence[str],
    videos: Mapping[str, Path],
    folder: Path,
    settings: TrainingSettings,
    progress: Callable[[int, int | None], None] | None = None,
) -> list[LabelledFrame]:
    """Frames of the labelled videos with the labels propagated to them, of actuators with few labels.

    They are written into a folder of their own, from which a resumed training reads them again, and which shows what
    was trained on.

    Parameters
    ----------
    frames : sequence of LabelledFrame
    keypoints : sequence of K str
        Their keypoints.
    videos : mapping from str to Path
        Video files by stem; a video that is not among them, or cannot be read, gives no frames.
    folder : Path
        Of the training; `FOLDER` is made in it.
    settings : TrainingSettings
        Where no pretrained network of ours is the start, there are no such frames.
    progress : callable, optional
        Called with the number of self-training steps done and to be done.

    Returns
    -------
    list of LabelledFrame
        Their `propagated` is true.

    Raises
    ------
    OSError
        The folder cannot be written.
    WeightsError
        No network ships with the backbone of the settings.
    """
    start = pretrained_start(settings)
    if start is None:
        return []
    source, file = start
    if kept := read_propagated(folder, frames):
        return kept
    own = folder / FOLDER
    made: list[LabelledFrame] = []
    for video in videos_with_few_labels(frames):
        if video not in videos:
            continue
        labelled = [frame for frame in frames if frame.video == video and not np.isnan(frame.xy).all()]
        try:
            probe = np.stack(spread_frames(videos[video], PROBE_FRAMES))
        except (VideoError, ValueError):  # nothing in it can be decoded, or its frames change their size
            continue
        found = _propagated(source, file, keypoints, labelled, probe, progress)
        if found is None:
            continue
        make_folder(own / video)
        for i in np.flatnonzero(found.sure).tolist():
            path = own / video / f"probe{i:03d}.png"
            png = cv2.imencode(".png", cv2.cvtColor(probe[i], cv2.COLOR_RGB2BGR))[1]
            atomic_write_bytes(path, png.tobytes())
            made.append(LabelledFrame(video, path, found.xy[i], labelled[0].actuator, propagated=True))
    if made:
        rows = [{"video": f.video, "image": f.image_path.name, "xy": _with_nulls(f.xy)} for f in made]
        atomic_write_text(own / POSITIONS_FILE, json.dumps(rows) + "\n")
    return made


def forget_propagated(folder: Path) -> None:
    """Remove what `propagated_frames` wrote for an earlier training in a folder."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)


def _propagated(
    source: Checkpoint,
    file: Path,
    keypoints: Sequence[str],
    labelled: Sequence[LabelledFrame],
    probe: np.ndarray,
    progress: Callable[[int, int | None], None] | None,
) -> PropagatedLabels | None:
    """Labels of one video in its probe frames (N, H, W, 3)."""
    images = [read_image(frame) for frame in labelled]
    same = [i for i, image in enumerate(images) if image.shape == probe.shape[1:]]
    if not same:
        return None
    device = best_device()
    network = source.network.to(device)
    estimator = network.estimator(source.candidates)
    adaptation = VideoAdaptation(
        file=file,
        metadata=source,
        source=estimator,
        device=str(device),
        compiled=False,
        workers=1,
        threads=torch.get_num_threads(),
        progress=progress,
    )
    return propagate_labels(
        source,
        estimator,
        keypoint_mapping(keypoints, source.keypoints),
        keypoints,
        np.stack([images[i] for i in same]),
        np.stack([labelled[i].xy for i in same]),
        probe,
        adaptation.fit_ends,
        adaptation.fit_network,
    )


def _with_nulls(xy: FloatArray) -> list[list[float | None]]:
    """Positions (K, 2) for JSON, which knows no NaN."""
    return [[None if np.isnan(value) else float(value) for value in point] for point in xy]


def read_propagated(folder: Path, frames: Sequence[LabelledFrame]) -> list[LabelledFrame]:
    """Read what `propagated_frames` wrote into the folder of a training.

    Parameters
    ----------
    folder : Path
    frames : sequence of LabelledFrame
        From which the labels were propagated.

    Returns
    -------
    list of LabelledFrame
        Empty where nothing was written, or not all of it.
    """
    own = folder / FOLDER
    actuators = {frame.video: frame.actuator for frame in frames}
    try:
        rows = read_json(own / POSITIONS_FILE, BendtrackError)
        if any(Path(row["image"]).name != row["image"] for row in rows):
            return []
        return [
            LabelledFrame(
                row["video"],
                own / row["video"] / row["image"],
                np.asarray(row["xy"], dtype=np.float64),
                actuators[row["video"]],
                propagated=True,
            )
            for row in rows
        ]
    except (OSError, BendtrackError, KeyError, TypeError, ValueError):
        return []
