"""A checkpoint as the detector that `tracker.tracking.track` takes: with which engine, on which device.

Torch is loaded only where it computes: on a GPU, where there is no compiled engine, or where a network is fitted to a
video without labels.
"""

from __future__ import annotations

import math
import os
import shutil
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..tracker.errors import BendtrackWarning, CheckpointError
from ..tracker.hashing import file_sha256
from ..tracker.types import Correlation, Detections, Frames
from .inference.calibration import film_scale
from .inference.coarse_to_fine import CoarseToFineEstimator
from .inference.crops import CropGeometry
from .inference.metadata import CheckpointMetadata, read_metadata, weights_file
from .inference.runtime import ENGINES, EngineError, EngineRecord, compiled_estimator, engine_record
from .inference.stages import ALL_STAGES, StageSettings
from .inference.tracking import KeypointTracker
from .localization.localize import find_actuator

TORCH = "torch"
CHOICES = ("auto", *ENGINES, TORCH)
DEVICES = ("auto", "cpu", "cuda")

CHUNK_FRAMES = 48
"""Frames of 640 x 480 that are tracked from one search, which takes as long as tracking two or three of them."""

MIN_CHUNK_FRAMES = 8
"""Frames of a chunk of the largest videos."""

LOW_LATENCY_CORES = 4
"""Cores that share one frame in low-latency mode unless told otherwise: networks this small cannot use more."""


class NetworkDetector:
    """Finds the keypoints of a checkpoint in frames (the `Detector` protocol of `tracker.types`).

    `load` makes one from a checkpoint.

    Parameters
    ----------
    name : str
        Of the folder that the checkpoint lies in.
    metadata : CheckpointMetadata
        What the checkpoint means.
    estimator : CoarseToFineEstimator
        Its networks.
    file : Path
        The checkpoint's file.
    sha256 : str
        Hash of that file.
    engine : str
        "openvino-int8", "openvino" or "torch".
    device : str
        "cpu" or "cuda".
    workers : int
        Chunks of a video that are tracked at once.
    threads : int
        Cores for the networks.
    anchored : callable, optional
        From calibrated detections to those anchored at the actuator of one video (`for_video`).
    base_is_held : bool, optional
        Whether `anchored` holds the fixed end at one place.
    """

    def __init__(
        self,
        name: str,
        metadata: CheckpointMetadata,
        estimator: CoarseToFineEstimator,
        *,
        file: Path,
        sha256: str,
        engine: str,
        device: str,
        workers: int = 1,
        threads: int = 1,
        anchored: Callable[[Detections], Detections] | None = None,
        base_is_held: bool = False,
    ) -> None:
        self.name = name
        self.metadata = metadata
        self.file = file
        self.sha256 = sha256
        self.engine = engine
        self.device = device
        self._estimator = estimator
        self._workers = workers
        self._threads = threads
        self._anchored = anchored
        self._base_is_held = base_is_held

    @classmethod
    def load(
        cls,
        path: Path,
        *,
        engine: str = "auto",
        device: str = "auto",
        threads: int | None = None,
        low_latency: bool = False,
        stages: StageSettings = ALL_STAGES,
        require_compiled: bool = False,
    ) -> NetworkDetector:
        """Read a checkpoint file or folder.

        Parameters
        ----------
        path : Path
            The file, or the folder that it lies in.
        engine : str, optional
            One of `CHOICES`. "auto" takes torch on a GPU, and on a CPU the fastest compiled engine that was built
            (`export.build`) and passed its check, or else torch.
        device : str, optional
            One of `DEVICES`. "auto" takes a GPU when there is one.
        threads : int, optional
            Cores for the networks. Default: all.
        low_latency : bool, optional
            Whether all cores share one frame, whose result is known sooner, instead of one frame per core, which
            measures more frames per second.
        stages : StageSettings, optional
            Which stages of inference run.
        require_compiled : bool, optional
            Whether a network that should be compiled (it runs on a CPU, and `engine` is not "torch") and is not raises
            an `EngineError`, so that it can be compiled. Otherwise torch takes its place where `engine` is "auto".

        Raises
        ------
        EngineError
            The compiled network is damaged, and `engine` names it; or `require_compiled`.
        CheckpointError
            The checkpoint cannot be read, or the engine or the device asked for is not there.
        """
        file = weights_file(path)
        metadata = read_metadata(file)
        sha256 = file_sha256(file)
        device = _device(device if engine in ("auto", TORCH) else "cpu")
        record = None if device == "cuda" or engine == TORCH else engine_record(file, sha256)
        if require_compiled and record is None and device == "cpu" and engine != TORCH:
            raise EngineError(
                f"{file}: expected a network compiled for this machine, got none", damaged=False
            )
        wanted, estimator = engine, None
        if engine == "auto":
            engine = (record.fastest if record else None) or TORCH
        if engine != TORCH:
            if record is None or engine not in record.engines or not record.engines[engine].passed:
                raise CheckpointError(_why_not(engine, record))
            cores_used = threads or (min(cores(), LOW_LATENCY_CORES) if low_latency else cores())
            workers = 1 if low_latency else cores_used
            try:
                estimator = compiled_estimator(
                    file, engine, record, workers, cores_used, metadata.candidates, stages
                )
            except EngineError as error:
                if wanted != "auto" or require_compiled:
                    raise
                warnings.warn(f"{error}; torch computes, which is slower", BendtrackWarning, stacklevel=2)
                engine = TORCH
        if estimator is None:
            workers, estimator = 1, _torch_estimator(file, device, threads, stages)
            cores_used = threads or cores()
        return cls(
            file.resolve().parent.name,
            metadata,
            estimator,
            file=file,
            sha256=sha256,
            engine=engine,
            device=device,
            workers=workers,
            threads=cores_used,
        )

    @staticmethod
    def gpu_is_likely() -> bool:
        """Whether torch is worth asking for a GPU: the driver's tool answers at once, torch takes seconds."""
        return shutil.which("nvidia-smi") is not None

    @property
    def keypoints(self) -> tuple[str, ...]:
        """Names of the keypoints, in the order of the arrays."""
        return self.metadata.keypoints

    @property
    def correlations(self) -> tuple[Correlation, ...]:
        """Keypoints whose errors go together, where their ends are regressed."""
        return self.metadata.correlations if self.stages.end_regression else ()

    @property
    def label_variance_px2(self) -> float:
        """Variance of each point that its labels' errors leave, px^2."""
        return self.metadata.calibration.label_variance_px2

    @property
    def stages(self) -> StageSettings:
        """Which stages of inference run."""
        return self._estimator.stages

    @property
    def batch_size(self) -> int:
        """A CPU's caches hold the maps of a few frames; a GPU wants many, as long as the frames are small."""
        most = 64 if self.device == "cuda" else 4
        largest = max(w * h for w, h in (region.frame_wh for region in self.metadata.regions))
        return max(1, min(most, most * 2 * 640 * 480 // largest))

    @property
    def provenance(self) -> Mapping[str, Any]:
        """What identifies the output for a video. A GPU changes what is found in a frame by rounding only."""
        return {
            "checkpoint_sha256": self.sha256,
            "backbone": self.metadata.backbone,
            "engine": self.engine,
            "follows": self._tracks,
            "stages": asdict(self.stages),
        }

    @property
    def findings(self) -> Mapping[str, Any]:
        """What was decided for the video at hand: `fixed_end` is "held" at one place, or "measured" in every frame."""
        return {"fixed_end": "held" if self._base_is_held else "measured"}

    def detect(self, frames: Frames) -> Detections:
        """Keypoints of frames of one size, each found by itself.

        Parameters
        ----------
        frames : sequence of ndarray of uint8, shape (H, W, 3)
            RGB.

        Returns
        -------
        Detections
            (N, K), calibrated.
        """
        h, w = frames[0].shape[:2]
        geometry = self.metadata.geometry_for((w, h))
        return self.calibrated(self._estimator.detect(frames, geometry), geometry)

    def calibrated(self, found: Detections, geometry: CropGeometry) -> Detections:
        """Calibrated detections, anchored at the video's actuator after `for_video`."""
        found = self.metadata.calibrated(found, geometry, self.stages)
        return found if self._anchored is None else self._anchored(found)

    def film_calibrated(self, found: Detections) -> tuple[Detections, Mapping[str, Any]]:
        """Detections (T, K) of a film with likelihoods calibrated for it, and by what they were divided.

        Not after `for_video`, which calibrates for its video itself.
        """
        if not self.stages.film_calibration or self.metadata.pretrained or self._anchored is not None:
            return found, {}
        scale = film_scale(found.likelihood)
        shares = {name: round(float(own), 3) for name, own in zip(self.keypoints, scale, strict=True)}
        return replace(found, likelihood=np.minimum(found.likelihood / scale, 1.0)), {"peak_share": shares}

    def for_video(
        self, probe_frames: Frames, progress: Callable[[int, int | None], None] | None = None
    ) -> NetworkDetector:
        """This network for one video without labels, from frames spread over it.

        Where it is fitted to the video first (`StageSettings.self_training`), which takes about a minute on two cores,
        the fitted networks run in float32, whatever the engine.

        Parameters
        ----------
        probe_frames : ndarray of uint8, shape (N, H, W, 3)
            RGB.
        progress : callable, optional
            Called with the number of self-training steps done and to be done.

        Raises
        ------
        VideoError
            No actuator can be seen.
        """
        estimator = self._estimator
        fit_ends = fit_network = None
        if self.metadata.pretrained:
            from .adaptation.adapt import VideoAdaptation

            adaptation = VideoAdaptation(
                file=self.file,
                metadata=self.metadata,
                source=estimator,
                device=self.device,
                compiled=self.engine != TORCH,
                workers=self._workers,
                threads=self._threads,
                progress=progress,
            )
            fit_ends = adaptation.fit_ends if self.stages.end_regression else None
            fit_network = adaptation.fit_network if self.stages.self_training else None
        actuator = find_actuator(probe_frames, self.metadata, estimator, fit_ends, fit_network)
        return NetworkDetector(
            self.name,
            actuator.metadata,
            actuator.estimator,
            file=self.file,
            sha256=self.sha256,
            engine=self.engine,
            device=self.device,
            workers=self._workers,
            threads=self._threads,
            anchored=actuator.anchored,
            base_is_held=actuator.base is None,
        )

    @property
    def workers(self) -> int:
        """Chunks of a video at once: the network is small, so each takes one core."""
        return self._workers

    def chunk_frames(self, size_wh: tuple[int, int], frames: int | None) -> int:
        """Frames of a chunk that is tracked from one search, few enough that several chunks fit into memory."""
        if not self._tracks:
            return self.batch_size
        most = min(CHUNK_FRAMES, CHUNK_FRAMES * 640 * 480 // (size_wh[0] * size_wh[1]))
        # A short video has two chunks, so that a second core has something to do. The result depends on where chunks
        # begin, so their number must not depend on the cores.
        own = most if frames is None else min(most, math.ceil(frames / 2))
        return max(MIN_CHUNK_FRAMES, own)

    def follow(self) -> NetworkDetector | TrackingDetector:
        """A detector for consecutive frames, fresh."""
        if not self._tracks:
            return self
        return TrackingDetector(self, KeypointTracker(self._estimator, self.metadata, self.calibrated))

    @property
    def _tracks(self) -> bool:
        # A GPU is quicker with many frames at once, which can only be searched.
        return self.device != "cuda"


class TrackingDetector:
    """A `NetworkDetector` that tracks the keypoints through consecutive frames."""

    batch_size = 1

    def __init__(self, own: NetworkDetector, tracker: KeypointTracker) -> None:
        self.keypoints = own.keypoints
        self.provenance = own.provenance
        self.detect = tracker.detect
        self.correlations = own.correlations
        self.label_variance_px2 = own.label_variance_px2
        self.skip_frames = tracker.skip_frames


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _device(wanted: str) -> str:
    if wanted == "cpu" or (wanted == "auto" and not NetworkDetector.gpu_is_likely()):
        return "cpu"
    import torch

    if torch.cuda.is_available():
        return "cuda"
    if wanted == "cuda":
        raise CheckpointError("--device cuda: expected a GPU that torch can use, got none")
    return "cpu"


def _torch_estimator(
    file: Path, device: str, threads: int | None, stages: StageSettings
) -> CoarseToFineEstimator:
    import torch

    from .networks.checkpoint import load_checkpoint

    checkpoint = load_checkpoint(file)
    network = checkpoint.network.to(torch.device(device))
    return replace(network.estimator(checkpoint.candidates, threads), stages=stages)


def _why_not(engine: str, record: EngineRecord | None) -> str:
    if record is None:
        return f"--engine {engine}: expected a compiled network, got none: `bendtrack train` builds it"
    if engine not in record.engines:
        reason = record.skipped.get(engine, "it was not built")
        return f"--engine {engine}: expected a compiled network, got none: {reason}"
    check = record.engines[engine]
    return (
        f"--engine {engine}: expected to stay within its limits, got {check.drift_px} px and"
        f" {check.drift_deg} degrees of drift from float32"
    )
