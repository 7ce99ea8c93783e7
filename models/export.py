"""Export: a checkpoint's networks compiled for the CPU, in float32 and in 8-bit integers.

Engines are built once, next to the checkpoint, and keyed by its hash. The quantisation error is measured on labelled
frames that the integers were not fitted on: an engine that moves keypoints or angles by more than the limits is not
used. How the files are run is in `inference/runtime.py`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..tracker.angle import bending_angle
from ..tracker.atomic import atomic_path, atomic_write_text
from ..tracker.errors import CheckpointError, reason
from ..tracker.folder_lock import folder_lock
from ..tracker.hashing import file_sha256
from ..tracker.links import make_folder
from ..tracker.types import Detections, ImageArray
from .adaptation.propagated_frames import FOLDER
from .data.images import read_image_file
from .data.synthetic import rendered_samples
from .inference.coarse_to_fine import CoarseToFineEstimator, Predictor, concatenated
from .inference.metadata import read_metadata, weights_file
from .inference.runtime import (
    END_REGRESSOR_FILE,
    ENGINES,
    PARTS,
    RECORD,
    EngineCheck,
    EngineRecord,
    OpenVINOEndRegressor,
    OpenVINOPredictor,
    engine_folder,
    engine_record,
    is_whole,
    load_openvino,
)
from .networks.cascade import Cascade
from .networks.checkpoint import Checkpoint, load_checkpoint
from .networks.conversion import (
    candidates_of_parts,
    converted,
    converted_end_regressor,
    quiet_converters,
    with_decoding,
)

MAX_DRIFT_PX = 0.1
MAX_DRIFT_DEG = 0.1
"""Largest quantisation error, root mean squares over labelled frames, against float32 in torch."""

MIN_FRAMES = 4
"""Labelled frames without which the integers' ranges are not fitted."""

RENDERED_FRAMES = 32
"""Rendered frames that fit and judge the engines of a pretrained network."""


def build_beside(path: Path) -> EngineRecord:
    """Build the engines of a checkpoint from the frames that it was trained on, unless they are there and whole.

    They are a project's labelled frames, as far as they are still there; for a pretrained network, rendered ones. Of
    two processes that come at once, one builds, and the other waits for it.

    Parameters
    ----------
    path : Path
        The checkpoint's file or folder. A project's lies in its models/<name>/; of one that lies elsewhere the
        labelled frames are not known, and only the float32 engine is built. The record says so.

    Returns
    -------
    EngineRecord

    Raises
    ------
    CheckpointError
        The checkpoint cannot be read, or the engine cannot be written.
    """
    file = weights_file(path)
    folder = engine_folder(file)
    try:
        make_folder(folder, parents=False)
    except OSError as error:
        raise CheckpointError(f"{folder}: the engine cannot be written ({reason(error)})") from error
    with folder_lock(folder, wait=True):
        sha256 = file_sha256(file)
        record = engine_record(file, sha256)
        if record is None or not is_whole(file, record):
            record = build(load_checkpoint(file), file, sha256, _frames_for(file))
        return record


def _frames_for(file: Path) -> list[ImageArray]:
    """The frames that fit and judge the engines of a checkpoint's file."""
    checkpoint = read_metadata(file)
    if checkpoint.pretrained:
        seed = checkpoint.training["settings"]["seed"]
        return [sample.image for sample, _ in rendered_samples(seed, range(RENDERED_FRAMES))]
    labels = file.resolve().parent.parent.parent / "labeled-data"  # of models/<name>/weights.safetensors
    known = [labels / name for name in checkpoint.training.get("trained_on", [])]
    known += [file.resolve().parent / FOLDER / name for name in checkpoint.training.get("propagated", [])]
    return [read_image_file(path) for path in known if path.is_file()]


def build(
    checkpoint: Checkpoint, checkpoint_file: Path, sha256: str, frames: Sequence[ImageArray]
) -> EngineRecord:
    """Compile a checkpoint's networks, and write the engines that pass with a record of what was measured.

    Parameters
    ----------
    checkpoint : Checkpoint
    checkpoint_file : Path
        Next to which the engines are written.
    sha256 : str
        Of that file.
    frames : sequence of ndarray of uint8, shape (H, W, 3)
        Labelled frames; every second one fits the integers' ranges, the others judge.

    Returns
    -------
    EngineRecord

    Raises
    ------
    CheckpointError
        The files cannot be written.
    """
    openvino = load_openvino()
    folder = engine_folder(checkpoint_file)
    network = checkpoint.network.float().cpu().eval()
    fit, judge = frames[::2], frames[1::2]
    recorder = _InputRecorder(network)
    for frame in fit:
        _detect(recorder.estimator, checkpoint, [frame])
    with quiet_converters():
        maps = {part: converted(getattr(network, part)) for part in PARTS}
    in_integers, in_floats = ENGINES
    variants: dict[str, Callable[[str], Any]] = {in_floats: lambda part: maps[part].clone()}
    skipped: dict[str, str] = {}
    if len(frames) >= MIN_FRAMES:
        variants[in_integers] = lambda part: _quantised(maps[part], recorder.images[part])
    else:
        skipped[in_integers] = (
            f"expected at least {MIN_FRAMES} of the labelled frames that it was trained on, got {len(frames)}"
        )
    regressor = None
    if network.aligner is not None:
        regression_model = converted_end_regressor(network.aligner)
        regressor = OpenVINOEndRegressor(regression_model, network.aligner.pairs)
    checks: dict[str, EngineCheck] = {}
    files: dict[str, str] = {}
    # Without labelled frames any image shows that a plain compilation computes what torch does.
    judge = judge or [np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)]
    candidates = candidates_of_parts(checkpoint.candidates)
    expected = _detect(network.estimator(checkpoint.candidates), checkpoint, judge)
    try:
        make_folder(folder)
        if regressor:
            files |= _save(regression_model, folder / f"{END_REGRESSOR_FILE}.xml")
        for name, make in variants.items():
            with quiet_converters():
                models = {part: with_decoding(make(part), candidates[part]) for part in PARTS}
            locator, refiner = (OpenVINOPredictor(models[part]) for part in PARTS)
            estimator = CoarseToFineEstimator(locator, refiner, checkpoint.candidates, regressor)
            drift_px, drift_deg = _drift(_detect(estimator, checkpoint, judge), expected, checkpoint)
            # Once more, as the first run of a network includes its preparation.
            begun = time.process_time()
            _detect(estimator, checkpoint, judge)
            taken = time.process_time() - begun
            # In floats only the order of sums differs: it turns the direction of two points that nearly coincide.
            passed = drift_px <= MAX_DRIFT_PX and (name == in_floats or drift_deg <= MAX_DRIFT_DEG)
            checks[name] = EngineCheck(
                round(drift_px, 5), round(drift_deg, 5), passed, round(1e3 * taken / len(judge), 2)
            )
            if passed:
                for part, model in models.items():
                    files |= _save(model, folder / f"{part}-{name}.xml")
        record = EngineRecord(
            checkpoint_sha256=sha256,
            openvino=openvino.__version__,
            frames_fitted=len(fit) if in_integers in checks else 0,
            frames_judged=len(frames[1::2]),
            ends=regressor.ends if regressor else (),
            engines=checks,
            skipped=skipped,
            files=files,
        )
        _make_way(folder / RECORD)
        atomic_write_text(folder / RECORD, json.dumps(record.to_dict(), indent=2) + "\n")
    except OSError as error:
        raise CheckpointError(f"{folder}: the engine cannot be written ({reason(error)})") from error
    return record


class _InputRecorder:
    """The networks in float32, recording every image that they are given, by part."""

    def __init__(self, network: Cascade) -> None:
        own = network.estimator()
        self.images: dict[str, list[ImageArray]] = {part: [] for part in PARTS}
        self.estimator = replace(
            own,
            locator=self._recorded("locator", own.locator),
            refiner=self._recorded("refiner", own.refiner),
        )

    def _recorded(self, part: str, predictor: Predictor) -> Predictor:
        def predict(images: ImageArray) -> Detections:
            self.images[part].append(images)
            return predictor(images)

        return predict


def _quantised(maps: Any, images: Sequence[ImageArray]) -> Any:
    """A network in 8-bit integers, their ranges fitted to images.

    Only up to the maps: where heat is rounded to 256 levels, the peak is a tie between cells. The 1 x 1 convolutions
    that gather the stages and make the maps stay in float32: they take a tenth of the time, and their rounding would
    reach the output undiminished.
    """
    import nncf

    return nncf.quantize(
        maps,
        nncf.Dataset(list(images)),
        subset_size=len(images),
        fast_bias_correction=False,
        ignored_scope=nncf.IgnoredScope(patterns=[r".*\.(lateral|head)\b.*_convolution/Convolution"]),
    )


def _detect(
    estimator: CoarseToFineEstimator, checkpoint: Checkpoint, frames: Sequence[ImageArray]
) -> Detections:
    """Detections (N, K) in frames that may differ in size."""
    found = []
    for frame in frames:
        h, w = frame.shape[:2]
        found.append(estimator.detect(frame[None], checkpoint.geometry_for((w, h))))
    return concatenated(found)


def _drift(found: Detections, expected: Detections, checkpoint: Checkpoint) -> tuple[float, float]:
    """Root mean square differences of keypoints (px) and angles (degrees)."""
    angles = [
        bending_angle(one.xy, checkpoint.keypoints, checkpoint.definition)[0] for one in (found, expected)
    ]
    distance = np.linalg.norm(found.xy - expected.xy, axis=2)
    known = ~np.isnan(angles[0] - angles[1])
    return (
        float(np.sqrt(np.mean(distance**2))),
        float(np.sqrt(np.mean((angles[0] - angles[1])[known] ** 2))),
    )


def _save(model: Any, path: Path) -> dict[str, str]:
    """Write a model's two files, and give the SHA-256 of each by its name."""
    files = (path, path.with_suffix(".bin"))
    for file in files:
        _make_way(file)
    with atomic_path(files[0]) as temporary, atomic_path(files[1]) as weights:
        load_openvino().serialize(model, temporary, weights)
        return {
            file.name: file_sha256(written) for file, written in zip(files, (temporary, weights), strict=True)
        }


def _make_way(path: Path) -> None:
    """Remove a link or an empty folder that has the name of a file; a folder with something in it stays.

    A link is not followed: what it points to is not an engine's file.
    """
    with suppress(OSError):
        if path.is_symlink():
            path.unlink()
        else:
            path.rmdir()
