"""The fast engine: a checkpoint's networks compiled for the CPU, in float32 and in 8-bit integers.

Built once beside the checkpoint and keyed by its hash. What rounding to integers does is measured on labelled frames
that it was not fitted on: an engine that moves keypoints or angles by more than `MAX_DRIFT` allows is refused. How
the files are run is in `compiled.py`.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import openvino
import torch
from torch import Tensor, nn

from ..tracker.angle import bending_angle
from ..tracker.atomic import atomic_path, atomic_write_text
from ..tracker.errors import CheckpointError, reason
from ..tracker.types import Detections, ImageArray
from ..tracker.video import file_sha256
from .data.images import read_image_file
from .data.synthetic import rendered_samples
from .inference.coarse_to_fine import CoarseToFineEstimator, Predictor, concatenated
from .inference.crops import END_SIDE
from .inference.metadata import weights_file
from .inference.runtime import (
    ALIGNER,
    ENGINES,
    FORMAT,
    PARTS,
    RECORD,
    OpenVINOEndRegressor,
    OpenVINOPredictor,
    engine_folder,
)
from .networks.cascade import Cascade
from .networks.checkpoint import Checkpoint, load_checkpoint
from .networks.end_regressor import EndRegressionNetwork
from .networks.heatmap_network import HeatmapNetwork, Maps
from .networks.heatmaps import decode

MAX_DRIFT_PX = 0.1
MAX_DRIFT_DEG = 0.1
"""Root mean squares over labelled frames, against float32 in torch."""

LEAST_FRAMES = 4
"""Labelled frames without which the integers' ranges are not looked for."""

RENDERED_FRAMES = 32
"""Pictures of the stream for a network that was pretrained on it."""


@dataclass(frozen=True)
class Drift:
    """What an engine changes against float32 in torch: root mean squares over frames."""

    px: float
    deg: float

    @property
    def acceptable(self) -> bool:
        """Whether the engine may be used."""
        return self.px <= MAX_DRIFT_PX and self.deg <= MAX_DRIFT_DEG


def build_beside(path: Path) -> dict[str, Any]:
    """Build the engines of a checkpoint from the pictures that it was trained on.

    They are a project's labelled ones, as far as they are still there; of a pretrained network, some of the stream's.

    Parameters
    ----------
    path : the checkpoint's file or folder; a project's lies in its models/<name>/

    Returns
    -------
    `build`'s record.

    Raises
    ------
    CheckpointError
        The checkpoint cannot be read, or the engine not be written.
    """
    file = weights_file(path)
    checkpoint = load_checkpoint(file)
    if checkpoint.pretrained:
        seed = checkpoint.training["settings"]["seed"]
        frames = [sample.picture for sample, _ in rendered_samples(seed, range(RENDERED_FRAMES))]
    else:
        labels = file.resolve().parent.parent.parent / "labeled-data"  # of a file in / that is / itself
        known = [labels / name for name in checkpoint.training.get("trained_on", [])]
        frames = [read_image_file(path) for path in known if path.is_file()]
    return build(checkpoint, file, file_sha256(file), frames)


def build(
    checkpoint: Checkpoint, checkpoint_file: Path, sha256: str, frames: Sequence[ImageArray]
) -> dict[str, Any]:
    """Compile a checkpoint's networks, and write the engines that pass with a record of what was measured.

    Parameters
    ----------
    frames : labelled pictures (H, W, 3) uint8; every second one fits the integers' ranges, the others judge

    Returns
    -------
    The record. Its "engines" maps each engine tried to its drift in px and degrees, whether it passed, and its CPU
    time for a frame in ms.

    Raises
    ------
    CheckpointError
        The files cannot be written.
    """
    folder = engine_folder(checkpoint_file)
    network = checkpoint.network.float().cpu().eval()
    fit, judge = frames[::2], frames[1::2]
    kept = _Keeping(network)
    for frame in fit:
        _found(kept.finder, checkpoint, [frame])
    with _quietly():
        maps = {part: _converted(getattr(network, part)) for part in PARTS}
    in_integers, in_floats = ENGINES
    candidates: dict[str, Callable[[str], openvino.Model]] = {in_floats: lambda part: maps[part].clone()}
    if len(frames) >= LEAST_FRAMES:
        candidates[in_integers] = lambda part: _in_integers(maps[part], kept.pictures[part])
    align = None
    if network.aligner is not None:
        aligner = _converted_aligner(network.aligner)
        align = OpenVINOEndRegressor(aligner, network.aligner.pairs)
    engines: dict[str, Any] = {}
    # Without labelled pictures anything will do to see that a plain compilation does what torch does.
    judge = judge or [np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)]
    peaks = _peaks(checkpoint.peaks)
    reference = _found(network.finder(checkpoint.peaks), checkpoint, judge)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if align:
            _save(aligner, folder / f"{ALIGNER}.xml")
        for name, make in candidates.items():
            with _quietly():
                models = {part: _with_votes(make(part), peaks[part]) for part in PARTS}
            locate, refine = (OpenVINOPredictor(models[part]) for part in PARTS)
            finder = CoarseToFineEstimator(locate, refine, checkpoint.peaks, align)
            drift = _drift(_found(finder, checkpoint, judge), reference, checkpoint)
            # Once more, as the first time a network also makes itself ready.
            begun = time.process_time()
            _found(finder, checkpoint, judge)
            mapping = time.process_time() - begun
            # The same numbers in another order: of two points that nearly fall together they turn the direction.
            passed = drift.acceptable if name == in_integers else drift.px <= MAX_DRIFT_PX
            engines[name] = {
                "drift_px": round(drift.px, 5),
                "drift_deg": round(drift.deg, 5),
                "passed": passed,
                "cpu_ms": round(1e3 * mapping / len(judge), 2),
            }
            if passed:
                for part, model in models.items():
                    _save(model, folder / f"{part}-{name}.xml")
        record = {
            "format": FORMAT,
            "checkpoint_sha256": sha256,
            "openvino": openvino.__version__,
            "frames_fitted": len(fit) if in_integers in engines else 0,
            "frames_judged": len(frames[1::2]),
            "ends": align.ends if align else [],
            "engines": engines,
        }
        atomic_write_text(folder / RECORD, json.dumps(record, indent=2) + "\n")
    except OSError as error:
        raise CheckpointError(f"{folder}: the engine cannot be written ({reason(error)})") from error
    return record


class _Keeping:
    """The networks in float32, keeping every picture that they are shown, by part."""

    def __init__(self, network: Cascade) -> None:
        own = network.finder()
        self.pictures: dict[str, list[ImageArray]] = {part: [] for part in PARTS}
        self.finder = replace(
            own, locate=self._kept("locator", own.locate), refine=self._kept("refiner", own.refine)
        )

    def _kept(self, part: str, reader: Predictor) -> Predictor:
        def read(pictures: ImageArray) -> Detections:
            self.pictures[part].append(pictures)
            return reader(pictures)

        return read


class _Votes(nn.Module):
    """Maps to positions: `heatmaps.decode` as a network's last layer."""

    def __init__(self, peaks: int) -> None:
        super().__init__()
        self.peaks = peaks

    def forward(self, heat: Tensor, offset: Tensor, spread: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        found = decode(Maps(heat, offset, spread), self.peaks)
        return found.xy, found.likelihood, found.covariance


class _AsTuple(nn.Module):
    def __init__(self, network: HeatmapNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.network(images))


def _converted(network: HeatmapNetwork) -> openvino.Model:
    """A network up to its maps, for pictures of any size and number."""
    example = torch.zeros((2, 3, 64, 64), dtype=torch.uint8)
    return openvino.convert_model(
        _AsTuple(network), example_input=example, input=[openvino.PartialShape([-1, 3, -1, -1])]
    )


def compiled_networks(
    network: Cascade, peaks: int, workers: int = 1, threads: int = 1
) -> CoarseToFineEstimator:
    """Locator and refiner at work on the CPU in float32, without files.

    peaks : as `CoarseToFineEstimator`'s; `workers` and `threads` are those of `OpenVINOPredictor`
    """
    network = network.float().cpu().eval()
    with _quietly():
        models = [_with_votes(_converted(getattr(network, part)), n) for part, n in _peaks(peaks).items()]
    locate, refine = (OpenVINOPredictor(model, workers, threads) for model in models)
    return CoarseToFineEstimator(locate, refine, peaks)


def _peaks(offered: int) -> dict[str, int]:
    """Positions that each part reads for a keypoint: the locator offers so many."""
    return dict(zip(PARTS, (offered, 1), strict=True))


def compiled_end_regressor(
    aligner: EndRegressionNetwork, workers: int = 1, threads: int = 1
) -> OpenVINOEndRegressor:
    """An aligner at work on the CPU, without a file; the arguments are those of `OpenVINOEndRegressor`."""
    return OpenVINOEndRegressor(_converted_aligner(aligner), aligner.pairs, workers, threads)


def _converted_aligner(aligner: EndRegressionNetwork) -> openvino.Model:
    """An aligner for any number of pictures."""
    shape = (3, END_SIDE, END_SIDE)
    example = torch.zeros((2, *shape), dtype=torch.uint8)
    with _quietly():
        return openvino.convert_model(
            aligner, example_input=example, input=[openvino.PartialShape([-1, *shape])]
        )


def _in_integers(maps: openvino.Model, pictures: Sequence[ImageArray]) -> openvino.Model:
    """A network in 8-bit integers, their ranges fitted to pictures.

    Only up to the maps: where heat is rounded to 256 levels, the peak is a tie between cells. The convolutions of one
    px that gather the stages and make the maps stay in float32: they take a tenth of the time, and what they round
    comes out as it is.
    """
    import nncf

    return nncf.quantize(
        maps,
        nncf.Dataset(list(pictures)),
        subset_size=len(pictures),
        fast_bias_correction=False,
        ignored_scope=nncf.IgnoredScope(patterns=[r".*\.(lateral|head)\b.*_convolution/Convolution"]),
    )


def _with_votes(maps: openvino.Model, peaks: int) -> openvino.Model:
    """A network up to its maps, and on to positions, so many for each keypoint."""
    heads = [result.input_value(0) for result in maps.get_results()]
    k = heads[0].get_partial_shape()[1].get_length()
    example = (torch.zeros(2, k, 16, 16), torch.zeros(2, k, 2, 16, 16), torch.zeros(2, k, 3, 16, 16))
    votes = openvino.convert_model(_Votes(peaks), example_input=example)
    for parameter, head in zip(votes.get_parameters(), heads, strict=True):
        parameter.output(0).replace(head)
    return openvino.Model(votes.get_results(), maps.get_parameters(), "bendtrack")


def _found(finder: CoarseToFineEstimator, checkpoint: Checkpoint, frames: Sequence[ImageArray]) -> Detections:
    found = []
    for frame in frames:
        h, w = frame.shape[:2]
        found.append(finder.detect(frame[None], checkpoint.region_for((w, h)), checkpoint.reference))
    return concatenated(found)


def _drift(found: Detections, reference: Detections, checkpoint: Checkpoint) -> Drift:
    angles = [
        bending_angle(one.xy, checkpoint.keypoints, checkpoint.definition)[0] for one in (found, reference)
    ]
    distance = np.linalg.norm(found.xy - reference.xy, axis=2)
    known = ~np.isnan(angles[0] - angles[1])
    return Drift(
        float(np.sqrt(np.mean(distance**2))), float(np.sqrt(np.mean((angles[0] - angles[1])[known] ** 2)))
    )


def _save(model: openvino.Model, path: Path) -> None:
    """Write a model's two files; the .xml, which counts, last."""
    with atomic_path(path) as temporary, atomic_path(path.with_suffix(".bin")) as weights:
        openvino.serialize(model, temporary, weights)


@contextmanager
def _quietly() -> Iterator[None]:
    """The converters at work without a word on the terminal."""
    loggers = [logging.getLogger(name) for name in ("nncf", "torch.utils.cpp_extension")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
