"""A checkpoint as the Detector that `tracker.tracking.track` takes: with which engine, on which device.

Torch is loaded only where it computes: on a GPU, where there is no compiled engine, or where an actuator is learnt that
nobody has labelled.
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..tracker.errors import CheckpointError
from ..tracker.types import Detections, Frames
from ..tracker.video import file_sha256
from .compiled import ENGINES, compiled_finder, engine_record
from .finding.finder import Finder
from .finding.following import Follower
from .finding.header import Header, read_header, weights_file
from .finding.mirrored import MirroredReader
from .finding.regions import WorkingRegion
from .finding.sighting import sight

TORCH = "torch"
CHOICES = ("auto", *ENGINES, TORCH)
DEVICES = ("auto", "cpu", "cuda")

STRETCH_FRAMES = 48
"""Frames of 640 x 480 that are followed from one search, which takes as long as two or three of them."""

LEAST_STRETCH_FRAMES = 8

SOONEST_CORES = 4
"""Cores that work on one frame together unless told otherwise: networks this small have little to share out."""


class NetworkDetector:
    """Finds the keypoints of a checkpoint in frames (the `Detector` protocol of `tracker.types`).

    Attributes
    ----------
    name : of the folder that the checkpoint lies in
    header : what the checkpoint means
    engine : "openvino-int8", "openvino" or "torch"
    device : "cpu" or "cuda"
    file : the checkpoint's
    sha256 : its hash
    learns : whether `for_video` lets it learn the actuator where it is not sure of it everywhere
    """

    def __init__(
        self,
        name: str,
        header: Header,
        finder: Finder,
        *,
        file: Path,
        sha256: str,
        engine: str,
        device: str,
        workers: int = 1,
        threads: int = 1,
        learns: bool = False,
        told: Callable[[Detections], Detections] | None = None,
    ) -> None:
        self.name = name
        self.header = header
        self.file = file
        self.sha256 = sha256
        self.engine = engine
        self.device = device
        self.learns = learns and header.pretrained
        self._finder = finder
        self._workers = workers
        self._threads = threads
        self._told = told

    @classmethod
    def load(
        cls,
        path: Path,
        *,
        engine: str = "auto",
        device: str = "auto",
        threads: int | None = None,
        soonest: bool = False,
        learns: bool = False,
    ) -> NetworkDetector:
        """Read a checkpoint file or folder.

        Parameters
        ----------
        path : the file, or the folder that it lies in
        engine : one of `CHOICES`. "auto" takes torch on a GPU, and on a CPU the fastest compiled engine that was
            built (`engine.build`) and passed its check, or else torch.
        device : one of `DEVICES`. "auto" takes a GPU when there is one.
        threads : cores for the network; None takes all
        soonest : whether all cores are to work on one frame, which is known sooner, and not each on one of its own,
            which measures more frames
        learns : whether `for_video` lets a pretrained network learn the actuator where it is not sure of it everywhere

        Raises
        ------
        CheckpointError
            The checkpoint cannot be read, or the engine or the device asked for is not there.
        """
        file = weights_file(path)
        header = read_header(file)
        sha256 = file_sha256(file)
        device = _device(device if engine in ("auto", TORCH) else "cpu")
        record = None if device == "cuda" or engine == TORCH else engine_record(file, sha256)
        passed = {} if record is None else {n: e for n, e in record["engines"].items() if e["passed"]}
        if engine == "auto":
            engine = min(passed, key=lambda name: float(passed[name]["cpu_ms"]), default=TORCH)
        if engine != TORCH and engine not in passed:
            raise CheckpointError(_why_not(engine, record))
        if engine == TORCH:
            workers, finder = 1, _torch_finder(file, device, threads)
            threads = threads or cores()
        else:
            threads = threads or (min(cores(), SOONEST_CORES) if soonest else cores())
            workers = 1 if soonest else threads
            ends = record["ends"] if record else []
            finder = compiled_finder(file, engine, ends, workers, threads, header.peaks)
        return cls(
            file.resolve().parent.name,
            header,
            finder,
            file=file,
            sha256=sha256,
            engine=engine,
            device=device,
            workers=workers,
            threads=threads,
            learns=learns,
        )

    @staticmethod
    def gpu_is_likely() -> bool:
        """Whether torch is worth asking for a GPU: the driver's tool tells at once what torch needs seconds for."""
        return shutil.which("nvidia-smi") is not None

    @property
    def keypoints(self) -> tuple[str, ...]:
        """Names of the keypoints, in the order of the arrays."""
        return self.header.keypoints

    @property
    def batch_size(self) -> int:
        """A CPU's caches hold the maps of a few frames; a GPU wants many, as long as the frames are small."""
        most = 64 if self.device == "cuda" else 4
        largest = max(w * h for w, h in (region.frame_wh for region in self.header.regions))
        return max(1, min(most, most * 2 * 640 * 480 // largest))

    @property
    def provenance(self) -> Mapping[str, Any]:
        """What identifies the output for a video. A GPU changes what is found in a frame by rounding only."""
        return {
            "checkpoint_sha256": self.sha256,
            "backbone": self.header.backbone,
            "engine": self.engine,
            "follows": self._follows,
            **({"learns": True} if self.learns else {}),
        }

    def detect(self, frames: Frames) -> Detections:
        """Keypoints of frames of one size, each found by itself."""
        h, w = frames[0].shape[:2]
        region = self.header.region_for((w, h))
        return self.believed(self._finder.detect(frames, region, self.header.partner), region)

    def believed(self, found: Detections, region: WorkingRegion) -> Detections:
        """What the networks found in frames of a region, calibrated, and what a video tells besides."""
        found = self.header.calibrated(found, region)
        return found if self._told is None else self._told(found)

    def for_video(
        self, glimpses: Frames, progress: Callable[[int, int | None], None] | None = None
    ) -> NetworkDetector:
        """This network for one video in which nobody has labelled anything, from frames spread over it.

        Where it learns the actuator, which takes about a minute on two cores, what it has learnt runs in float32
        beside what it was, whatever the engine.

        Parameters
        ----------
        glimpses : (N, H, W, 3) uint8 RGB
        progress : called with the number of steps done and to be done where the network learns this actuator first

        Raises
        ------
        VideoError
            No actuator can be seen.
        """
        both_ways = replace(self._finder, refine=MirroredReader(self._finder.refine))
        closer = taught = None
        if self.header.pretrained:
            from .unlabelled import Unlabelled

            own = Unlabelled(
                file=self.file,
                header=self.header,
                before=both_ways,
                device=self.device,
                compiled=self.engine != TORCH,
                workers=self._workers,
                threads=self._threads,
                progress=progress,
            )
            closer, taught = own.closer, own.taught if self.learns else None
        seen = sight(glimpses, self.header, both_ways, closer, taught)
        return NetworkDetector(
            self.name,
            seen.header,
            seen.finder,
            file=self.file,
            sha256=self.sha256,
            engine=self.engine,
            device=self.device,
            workers=self._workers,
            threads=self._threads,
            learns=self.learns,
            told=seen.believed,
        )

    @property
    def workers(self) -> int:
        """Stretches of a video at once: the network is small, so each takes one core."""
        return self._workers

    def chunk_frames(self, size_wh: tuple[int, int], frames: int | None) -> int:
        """Frames that are followed together, few enough that several stretches fit into memory."""
        if not self._follows:
            return self.batch_size
        most = min(STRETCH_FRAMES, STRETCH_FRAMES * 640 * 480 // (size_wh[0] * size_wh[1]))
        # A short video has two stretches, so that a second core has something to do. What is found depends on where
        # stretches begin, so their number must not depend on the cores.
        own = most if frames is None else min(most, math.ceil(frames / 2))
        return max(LEAST_STRETCH_FRAMES, own)

    def follow(self) -> NetworkDetector | FollowingDetector:
        """A detector for consecutive frames, fresh."""
        if not self._follows:
            return self
        return FollowingDetector(self, Follower(self._finder, self.header, self.believed))

    @property
    def _follows(self) -> bool:
        # A GPU is quicker with many frames at once, which can only be searched.
        return self.device != "cuda"


class FollowingDetector:
    """A `NetworkDetector` that follows the keypoints through consecutive frames."""

    batch_size = 1

    def __init__(self, own: NetworkDetector, follower: Follower) -> None:
        self.keypoints = own.keypoints
        self.provenance = own.provenance
        self.detect = follower.detect
        self.skip_frames = follower.pass_over


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


def _torch_finder(file: Path, device: str, threads: int | None) -> Finder:
    import torch

    from .checkpoint import load_checkpoint

    if threads is not None:
        torch.set_num_threads(threads)
    checkpoint = load_checkpoint(file)
    return checkpoint.network.to(torch.device(device)).finder(checkpoint.peaks)


def _why_not(engine: str, record: Mapping[str, Any] | None) -> str:
    if record is None:
        return f"--engine {engine}: expected a compiled network, got none: `bendtrack train` builds it"
    tried = record["engines"].get(engine)
    if tried is None:
        return f"--engine {engine}: expected labelled frames to fit it to when it was built, got too few"
    return (
        f"--engine {engine}: expected to stay within its limits, got {tried['drift_px']} px and"
        f" {tried['drift_deg']} degrees of drift from float32"
    )
