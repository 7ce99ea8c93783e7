"""Compiled networks at work: OpenVINO models as `Predictor`s and `EndRegressor`s, read from files. Imports no torch.

A file computes only if its SHA-256 is the one that was recorded when it was built. How the files are made, and how far
an engine may differ from float32, is in `export.py`.
"""

from __future__ import annotations

import hashlib
import json
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...tracker.errors import CheckpointError, reason
from ...tracker.hashing import file_sha256
from ...tracker.types import Detections, FloatArray, ImageArray
from .coarse_to_fine import CoarseToFineEstimator
from .stages import ALL_STAGES, StageSettings

ENGINES = ("openvino-int8", "openvino")
"""The compiled engines, the faster one first."""

PARTS = ("locator", "refiner")
END_REGRESSOR_FILE = "aligner"
"""Name of the file of every engine that has an end regressor, which computes in float32."""

RECORD = "engine.json"
FORMAT = 6


class EngineError(CheckpointError):
    """A compiled network is damaged, or there is none from this checkpoint and this version of OpenVINO.

    Attributes
    ----------
    damaged : bool
        Whether there is one that is not what was built.
    """

    def __init__(self, message: str, *, damaged: bool = True) -> None:
        super().__init__(message)
        self.damaged = damaged


@dataclass(frozen=True)
class EngineCheck:
    """What was measured of one engine when it was built.

    Attributes
    ----------
    drift_px, drift_deg : float
        Quantisation error against float32 in torch: root mean squares over keypoints (px) and angles (degrees).
    passed : bool
        Whether the engine may be used.
    cpu_ms : float
        Processor time per frame, ms.
    """

    drift_px: float
    drift_deg: float
    passed: bool
    cpu_ms: float


@dataclass(frozen=True)
class EngineRecord:
    """The engines next to a checkpoint.

    Attributes
    ----------
    checkpoint_sha256, openvino : str
        What they were built from, and the version of OpenVINO that built them.
    frames_fitted, frames_judged : int
        Labelled frames that the integers' ranges were fitted to, and that judged the engines.
    ends : tuple of (int, int)
        Ends of the end regressor; empty where there is none.
    engines : mapping of str to EngineCheck
        The engines that were tried.
    skipped : mapping of str to str
        The engines that were not tried, and why.
    files : mapping of str to str
        SHA-256 of each file of the engines that passed, by its name.
    """

    checkpoint_sha256: str
    openvino: str
    frames_fitted: int
    frames_judged: int
    ends: tuple[tuple[int, int], ...]
    engines: Mapping[str, EngineCheck]
    skipped: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def fastest(self) -> str | None:
        """The engine that passed its check with the least processor time; None where none passed."""
        passed = {name: check for name, check in self.engines.items() if check.passed}
        return min(passed, key=lambda name: passed[name].cpu_ms, default=None)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready with a checksum over all of it, and read back by `from_dict`."""
        values = {"format": FORMAT, **asdict(self), "ends": [list(end) for end in self.ends]}
        return {**values, "sha256": _checksum(values)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> EngineRecord:
        """The record that `to_dict` wrote; KeyError, TypeError or ValueError where it is not one."""
        return cls(
            values["checkpoint_sha256"],
            values["openvino"],
            int(values["frames_fitted"]),
            int(values["frames_judged"]),
            tuple((int(first), int(second)) for first, second in values["ends"]),
            {name: EngineCheck(**check) for name, check in values["engines"].items()},
            dict(values.get("skipped", {})),
            dict(values.get("files", {})),
        )


def _checksum(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def load_openvino() -> ModuleType:
    """OpenVINO, without its telemetry.

    OpenVINO and NNCF report each use to their makers, the former as soon as it is imported. They do without where
    their package for that cannot be imported; so it is hidden before the first of them is.
    """
    if "openvino" not in sys.modules:
        sys.modules["openvino_telemetry"] = None  # type: ignore[assignment]
    import openvino

    module: ModuleType = openvino
    return module


class _CompiledModel:
    """An OpenVINO model as a function from images to arrays.

    Parameters
    ----------
    model : openvino.Model
    workers : int
        Threads that may call it at once.
    threads : int
        Cores, shared among those who call: with one each most images are processed per second; with all for one caller
        each image is processed with the least latency.
    """

    def __init__(self, model: Any, workers: int = 1, threads: int = 1) -> None:
        # Left to itself, a processor with AMX would take bfloat16 for float32, which rounds positions by half a px.
        config = {
            "NUM_STREAMS": workers,
            "INFERENCE_NUM_THREADS": threads,
            "INFERENCE_PRECISION_HINT": "f32",
        }
        self._model = load_openvino().Core().compile_model(model, "CPU", config)
        self._own = threading.local()

    def _outputs(self, images: ImageArray) -> list[FloatArray]:
        if not hasattr(self._own, "request"):
            self._own.request = self._model.create_infer_request()
        request = self._own.request
        request.infer([images], share_inputs=True)
        return [tensor.data.astype(np.float64) for tensor in request.output_tensors]


class OpenVINOPredictor(_CompiledModel):
    """An OpenVINO model from images to positions, likelihoods and covariances, as a `Predictor`."""

    def __call__(self, images: ImageArray) -> Detections:
        """Predict every keypoint in images (N, 3, H, W) uint8."""
        return Detections(*self._outputs(images))


class OpenVINOEndRegressor(_CompiledModel):
    """An OpenVINO model from high-resolution crops of ends to corrections of their poses, as an `EndRegressor`.

    Parameters
    ----------
    model, workers, threads
        As `_CompiledModel`.
    ends : sequence of (int, int)
        The two keypoints of each end.
    """

    def __init__(self, model: Any, ends: Sequence[Sequence[int]], workers: int = 1, threads: int = 1) -> None:
        super().__init__(model, workers, threads)
        self.ends = tuple((first, second) for first, second in ends)

    def __call__(self, images: ImageArray) -> FloatArray:
        """Corrections (N, E, 3) from images (N, 3, END_SIDE, END_SIDE) uint8."""
        (steps,) = self._outputs(images)
        return steps


def engine_folder(checkpoint_file: Path) -> Path:
    """The folder of a checkpoint's engines, next to it."""
    return checkpoint_file.parent / "engine"


def engine_record(checkpoint_file: Path, sha256: str) -> EngineRecord | None:
    """The record of the engines next to a checkpoint; None where it is missing, damaged or of another checkpoint."""
    try:
        values = json.loads((engine_folder(checkpoint_file) / RECORD).read_text(encoding="utf-8"))
        built_for = (values["format"], values["checkpoint_sha256"], values["openvino"])
        if built_for != (FORMAT, sha256, load_openvino().__version__):
            return None
        if values.pop("sha256") != _checksum(values):
            return None
        return EngineRecord.from_dict(values)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def built_from(checkpoint_file: Path) -> str | None:
    """SHA-256 of the checkpoint that the engines next to it were built from, whoever built them; None if unknown."""
    try:
        values = json.loads((engine_folder(checkpoint_file) / RECORD).read_text(encoding="utf-8"))
        known = values["checkpoint_sha256"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return known if isinstance(known, str) else None


def is_whole(checkpoint_file: Path, record: EngineRecord) -> bool:
    """Whether every file that a record names is there and unchanged."""
    folder = engine_folder(checkpoint_file)
    try:
        return all(file_sha256(folder / name) == sha256 for name, sha256 in record.files.items())
    except OSError:
        return False


def compiled_estimator(
    checkpoint_file: Path,
    engine: str,
    record: EngineRecord,
    workers: int = 1,
    threads: int = 1,
    candidates: int = 1,
    stages: StageSettings = ALL_STAGES,
) -> CoarseToFineEstimator:
    """The networks of an engine that was built and passed its check.

    Parameters
    ----------
    checkpoint_file : Path
    engine : str
        One of `ENGINES`.
    record : EngineRecord
        Of the engines next to the checkpoint.
    workers, threads : int
        As `_CompiledModel`.
    candidates : int
        Candidate peaks that the engine was built with.
    stages : StageSettings, optional
        Which stages run.

    Returns
    -------
    CoarseToFineEstimator

    Raises
    ------
    EngineError
        A file is missing, or is not the one that was recorded.
    """
    folder = engine_folder(checkpoint_file)
    locator, refiner = (
        OpenVINOPredictor(_read_model(folder, f"{part}-{engine}", record), workers, threads) for part in PARTS
    )
    regressor = None
    if record.ends:
        model = _read_model(folder, END_REGRESSOR_FILE, record)
        regressor = OpenVINOEndRegressor(model, record.ends, workers, threads)
    return CoarseToFineEstimator(locator, refiner, candidates, regressor, stages)


def _read_model(folder: Path, name: str, record: EngineRecord) -> Any:
    """An OpenVINO model from its two files, read once: the bytes that were hashed are those that compute."""
    model, weights = (_recorded_bytes(folder / f"{name}{suffix}", record) for suffix in (".xml", ".bin"))
    try:
        return load_openvino().Core().read_model(model, weights)
    except RuntimeError as error:
        raise EngineError(
            f"{folder / name}.xml: expected a compiled network, got one that does not load"
        ) from error


def _recorded_bytes(path: Path, record: EngineRecord) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise EngineError(
            f"{path}: expected a compiled network, got no file to read ({reason(error)})"
        ) from error
    if hashlib.sha256(data).hexdigest() != record.files.get(path.name):
        raise EngineError(
            f"{path}: expected the compiled network that was built, got a damaged or foreign file"
        )
    return data
