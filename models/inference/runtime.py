"""Compiled networks at work: OpenVINO models read from files, as `finder.Predictor`s and `EndRegressor`s. Needs no torch.

How the files are made, and what each engine may change, is in `engine.py`.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...tracker.types import Detections, FloatArray, ImageArray
from .coarse_to_fine import CoarseToFineEstimator

ENGINES = ("openvino-int8", "openvino")
"""The compiled engines, the faster one first."""

PARTS = ("locator", "refiner")
ALIGNER = "aligner"
"""Part of every engine of a network that has one, in float32."""

RECORD = "engine.json"
FORMAT = 5


class _Compiled:
    """An OpenVINO model from pictures to arrays.

    Parameters
    ----------
    model : an `openvino.Model`, or the path of its .xml
    workers : how many threads may ask it at once
    threads : cores that answer, shared out among those who ask: with one each, most pictures are read; with all for
        one, each is read soonest
    """

    def __init__(self, model: Any, workers: int = 1, threads: int = 1) -> None:
        import openvino

        # Left to itself, a processor with AMX would take bfloat16 for float32, which rounds positions by half a px.
        config = {
            "NUM_STREAMS": workers,
            "INFERENCE_NUM_THREADS": threads,
            "INFERENCE_PRECISION_HINT": "f32",
        }
        source = str(model) if isinstance(model, Path) else model
        self._model = openvino.Core().compile_model(source, "CPU", config)
        self._own = threading.local()

    def _outputs(self, pictures: ImageArray) -> list[FloatArray]:
        if not hasattr(self._own, "request"):
            self._own.request = self._model.create_infer_request()
        request = self._own.request
        request.infer([pictures], share_inputs=True)
        return [tensor.data.astype(np.float64) for tensor in request.output_tensors]


class OpenVINOPredictor(_Compiled):
    """An OpenVINO model from pictures to positions, likelihoods and covariances, as a `finder.Predictor`."""

    def __call__(self, pictures: ImageArray) -> Detections:
        """Every keypoint in pictures (N, 3, H, W) uint8."""
        return Detections(*self._outputs(pictures))


class OpenVINOEndRegressor(_Compiled):
    """An OpenVINO model from closer pictures of ends to how they lie, as a `finder.EndRegressor`.

    Parameters
    ----------
    ends : those that it knows
    """

    def __init__(self, model: Any, ends: Sequence[Sequence[int]], workers: int = 1, threads: int = 1) -> None:
        super().__init__(model, workers, threads)
        self.ends = tuple((first, second) for first, second in ends)

    def __call__(self, pictures: ImageArray) -> FloatArray:
        """Steps (N, E, 3) in pictures (N, 3, END_SIDE, END_SIDE) uint8."""
        (steps,) = self._outputs(pictures)
        return steps


def engine_folder(checkpoint_file: Path) -> Path:
    """Where the engines of a checkpoint lie: beside it."""
    return checkpoint_file.parent / "engine"


def engine_record(checkpoint_file: Path, sha256: str) -> dict[str, Any] | None:
    """What is known of the engines beside a checkpoint; None where there are none, or those of another."""
    import openvino

    try:
        record = json.loads((engine_folder(checkpoint_file) / RECORD).read_text(encoding="utf-8"))
        built_for = (record["format"], record["checkpoint_sha256"], record["openvino"])
        return record if built_for == (FORMAT, sha256, openvino.__version__) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def compiled_estimator(
    checkpoint_file: Path,
    engine: str,
    ends: Sequence[Sequence[int]],
    workers: int = 1,
    threads: int = 1,
    peaks: int = 1,
) -> CoarseToFineEstimator:
    """The networks of an engine that was built and passed; `ends` and `peaks` are those that it was built with."""
    folder = engine_folder(checkpoint_file)
    locate, refine = (OpenVINOPredictor(folder / f"{part}-{engine}.xml", workers, threads) for part in PARTS)
    align = OpenVINOEndRegressor(folder / f"{ALIGNER}.xml", ends, workers, threads) if ends else None
    return CoarseToFineEstimator(locate, refine, peaks, align)
