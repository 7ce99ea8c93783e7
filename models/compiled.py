"""Compiled networks at work: OpenVINO models read from files, as `finder.Reader`s. Needs no torch.

How the files are made, and what each engine may change, is in `engine.py`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..tracker.types import Detections, ImageArray
from .finder import Finder

ENGINES = ("openvino-int8", "openvino")
"""The compiled engines, the faster one first."""

PARTS = ("locator", "refiner")
RECORD = "engine.json"
FORMAT = 1


class CompiledReader:
    """An OpenVINO model from pictures to positions, likelihoods and covariances, as a `finder.Reader`.

    Parameters
    ----------
    model : an `openvino.Model`, or the path of its .xml
    threads : how many cores it may use; None takes all
    """

    def __init__(self, model: Any, threads: int | None = None) -> None:
        import openvino

        config: dict[str, Any] = {"PERFORMANCE_HINT": "LATENCY"}
        if threads is not None:
            config["INFERENCE_NUM_THREADS"] = threads
        source = str(model) if isinstance(model, Path) else model
        self._request = openvino.Core().compile_model(source, "CPU", config).create_infer_request()

    def __call__(self, pictures: ImageArray) -> Detections:
        """Every keypoint in pictures (N, 3, H, W) uint8."""
        self._request.infer([pictures])
        xy, likelihood, covariance = (
            self._request.get_output_tensor(i).data.astype(np.float64) for i in range(3)
        )
        return Detections(xy, likelihood, covariance)


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


def compiled_finder(checkpoint_file: Path, engine: str, threads: int | None = None) -> Finder:
    """Locator and refiner of an engine that was built and passed."""
    folder = engine_folder(checkpoint_file)
    locate, refine = (CompiledReader(folder / f"{part}-{engine}.xml", threads) for part in PARTS)
    return Finder(locate, refine)
