"""Tracking speed, decode to finished CSV, beside decoding alone and, when given its environment, beside DeepLabCut.

    python benchmarks/speed.py                                    640 x 480, ResNet-18, 20 s of video, five rounds
    python benchmarks/speed.py --size 1280x720 --size 1920x1080 --backbone resnet50    further cases: one for each
    python benchmarks/speed.py --dlc DLC/bin/python               DeepLabCut's analyze_videos on the same file
    python benchmarks/speed.py --long-minutes 60                  memory over an hour of video
    python benchmarks/speed.py --study                            194,000 frames of 54 trials, as the paper's study has
    python benchmarks/speed.py --clips 1000                       short clips: one second each
    python benchmarks/speed.py --seconds 1.5 --rounds 1 --steps 2     a run to see that it runs

Every case is rendered, labelled with 1 px of noise, trained on as `bendtrack train` does, and tracked by the default
engine; what that changes is measured against the same network in float32 that finds the keypoints of every frame anew.
Machines are noisy: everything is taken in turn, `--rounds` times, and printed as median and range.

DLC/bin/python is made by: python3.11 -m venv DLC && DLC/bin/pip install deeplabcut==3.0.2 (6 GB). Its default network
(resnet_50) runs with random weights, as its own come from a hub: that does not change its speed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from deeplabcut_opens import first_frames
from rendered import LabelledTrial, labelled_trial, rms

from bendtrack.labeling.interop.dlc import export_dlc
from bendtrack.models.detector import NetworkDetector
from bendtrack.models.export import build_beside
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.trainer import train
from bendtrack.tracker.angle import bending_angle
from bendtrack.tracker.project import Project
from bendtrack.tracker.results import write_results
from bendtrack.tracker.tracking import track
from bendtrack.tracker.types import FloatArray
from bendtrack.tracker.video import Video
from bendtrack.tracker.video_writer import VideoWriter

BENDTRACK = Path(sys.executable).parent / "bendtrack"

STUDY_TRIALS, STUDY_FRAMES = 54, 194_000
CLIP_FRAMES = 30
DIFFERENT_CLIPS = 20


@dataclass(frozen=True)
class Case:
    """A trained network and a video that it was trained for."""

    made: LabelledTrial
    project: Path
    model: Path
    train_minutes: float

    @property
    def video(self) -> Path:
        return self.made.trial.video_path


def prepared(folder: Path, size_wh: tuple[int, int], backbone: str, args: argparse.Namespace) -> Case:
    """Render, label and train."""
    made = labelled_trial(
        folder,
        seed=args.seed,
        # Actuators fill a larger frame as they fill a small one.
        end_vector_px=60.0 * size_wh[1] / 480,
        n_labels=30 if args.steps is None else 10,
        noise_px=1.0,
        seconds=args.seconds,
        size_wh=size_wh,
    )
    project = folder / "project"
    settings = TrainingSettings(init="random", steps=args.steps, backbone=backbone)
    begun = time.perf_counter()
    train(made.frames, made.trial.keypoints, made.definition, project / "models" / "model", settings)
    minutes = (time.perf_counter() - begun) / 60
    build_beside(project / "models" / "model")
    return Case(made, project, project / "models" / "model", minutes)


def frames_per_s(work: Callable[[], int]) -> float:
    """Frames that `work` handled, over the time it took."""
    begun = time.perf_counter()
    count = work()
    return count / (time.perf_counter() - begun)


def speeds(case: Case, rounds: int) -> dict[str, FloatArray]:
    """Frames/s of decoding and of tracking, taken in turn."""
    detector = NetworkDetector.load(case.model)

    def decode() -> int:
        with Video(case.video) as source:
            return sum(1 for _ in source)

    def whole() -> int:
        table = track(case.video, detector, case.made.definition)
        write_results(table, case.project / "results", "video")
        return len(table.time_s)

    whole()
    works = {"decoding alone": decode, f"decode to CSV ({detector.engine})": whole}
    mapping: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            mapping[name].append(frames_per_s(work))
    return {name: np.array(values) for name, values in mapping.items()}


@dataclass(frozen=True)
class Drift:
    """The default engine beside float32, and both beside the truth, over the frames without a label."""

    px: float
    deg: float
    rmse_deg: float
    float32_rmse_deg: float


def drift(case: Case) -> Drift:
    """What the default engine changes."""
    ours = track(case.video, NetworkDetector.load(case.model), case.made.definition)
    exact = NetworkDetector.load(case.model, engine="torch", device="cpu")
    xy = np.concatenate(
        [exact.detect([frame.image]).xy for frame in Video(case.video) if frame.image is not None]
    )
    angle_deg, _, _ = bending_angle(xy, exact.keypoints, case.made.definition)
    rest = case.made.unlabelled() & np.isfinite(ours.angle_deg) & np.isfinite(angle_deg)
    truth = case.made.trial.angle_deg
    return Drift(
        px=rms(np.linalg.norm(ours.xy - xy, axis=2)[rest]),
        deg=rms((ours.angle_deg - angle_deg)[rest]),
        rmse_deg=rms((ours.angle_deg - truth)[rest]),
        float32_rmse_deg=rms((angle_deg - truth)[rest]),
    )


def run_measured(words: Sequence[object]) -> tuple[float, float, list[float]]:
    """A bendtrack command: seconds, peak memory, and memory while it ran, in MiB."""
    begun = time.perf_counter()
    process = subprocess.Popen([BENDTRACK, *map(str, words)], stdout=subprocess.DEVNULL)
    over_time, peaks = [], [0.0]
    while True:
        try:
            process.wait(0.2)
            break
        except subprocess.TimeoutExpired:
            memory = memory_mib(process.pid)
            peaks.append(memory.get("VmHWM", 0.0))
            over_time.append(memory.get("VmRSS", 0.0))
    if process.returncode not in (0, 1):
        sys.exit(f"bendtrack {words[0]} ended with {process.returncode}")
    return time.perf_counter() - begun, max(peaks), over_time


def memory_mib(pid: int) -> dict[str, float]:
    """What Linux says of a process's memory now (VmRSS) and at most (VmHWM)."""
    status = Path(f"/proc/{pid}/status")
    lines = status.read_text().splitlines() if status.is_file() else []
    return {
        line.split(":")[0]: int(line.split()[1]) / 1024
        for line in lines
        if line.startswith(("VmRSS", "VmHWM"))
    }


def copies(video: Path, out: Path, count: int) -> None:
    """The video's packets again and again as one video."""
    with av.open(str(out), "w") as target, av.open(str(video)) as first:
        stream = target.add_stream_from_template(first.streams.video[0])
        assert first.streams.video[0].duration is not None
        length = first.streams.video[0].duration
        for turn in range(count):
            with av.open(str(video)) as source:
                for packet in source.demux(source.streams.video[0]):
                    if packet.dts is None:
                        continue
                    assert packet.pts is not None
                    packet.pts, packet.dts = packet.pts + turn * length, packet.dts + turn * length
                    packet.stream = stream
                    target.mux(packet)


def clips(video: Path, folder: Path, count: int) -> None:
    """So many files of one second each, cut from the video at places spread over it."""
    folder.mkdir()
    with Video(video) as source:
        images = [frame.image for frame in source if frame.image is not None]
    starts = np.linspace(0, len(images) - CLIP_FRAMES, min(DIFFERENT_CLIPS, count)).astype(int)
    for i in range(count):
        path = folder / f"clip_{i:04d}.mp4"
        if i >= len(starts):
            shutil.copyfile(folder / f"clip_{i % len(starts):04d}.mp4", path)
            continue
        with VideoWriter(path, (images[0].shape[1], images[0].shape[0]), frame_rate=30) as writer:
            for image in images[starts[i] : starts[i] + CLIP_FRAMES]:
                writer.write(image)


def deeplabcut_speed(case: Case, folder: Path, python: Path, frames: int) -> float:
    """Frames/s of DeepLabCut's analyze_videos."""
    export_dlc(Project.open(case.project), folder / "dlc", videos=[case.video])
    cut = first_frames(case.video, frames, folder / "cut.mp4")
    script = Path(__file__).with_name("deeplabcut_opens.py")
    done = subprocess.run(
        [python, script, "--inside", (folder / "dlc").resolve(), cut.resolve()],
        env={**os.environ, "DLClight": "True"},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        sys.exit(f"DeepLabCut ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-4000:]}")
    return float(json.loads((folder / "dlc" / "inside.json").read_text())["analyzed_frames_per_s"])


def spread(values: FloatArray, digits: int) -> str:
    """Median and range."""
    return f"{np.median(values):.{digits}f} ({values.min():.{digits}f} to {values.max():.{digits}f})"


def report(folder: Path, size_wh: tuple[int, int], backbone: str, args: argparse.Namespace) -> None:
    """Measure a case and print it."""
    case = prepared(folder, size_wh, backbone, args)
    print(f"\n{size_wh[0]} x {size_wh[1]} H.264, {len(case.made.trial.time_s)} frames, {backbone}")
    print(f"  training                 {case.train_minutes:.1f} minutes")
    mapping = speeds(case, args.rounds)
    for name, values in mapping.items():
        print(f"  {name:34s} {spread(values, 1)} frames/s")
    alone, whole = mapping.values()
    print(f"  ratio to decoding alone            {spread(whole / alone, 3)}")
    changed = drift(case)
    print(f"  drift from float32                 {changed.px:.3f} px and {changed.deg:.3f} degrees RMS")
    print(
        f"  angle RMSE against the truth       {changed.rmse_deg:.3f} degrees"
        f" (float32, every frame anew: {changed.float32_rmse_deg:.3f})"
    )
    _, peak, _ = run_measured(["track", case.project, case.video, "--force", "--out", folder / "measured"])
    print(f"  peak memory of `bendtrack track`   {peak:.0f} MiB")
    short = first_frames(case.video, 3, folder / "short.mp4")
    seconds = []
    for _ in range(args.rounds):
        begun = time.time()
        run_measured(["track", case.project, short, "--force", "--out", folder / "short"])
        # What comes after the table, the figure, is not what one waits for.
        seconds.append((folder / "short" / "short.csv").stat().st_mtime - begun)
    print(f"  from its start to the table of 3 frames  {spread(np.array(seconds), 2)} s")
    if args.dlc:
        theirs = deeplabcut_speed(case, folder, args.dlc, args.dlc_frames)
        print(f"  DeepLabCut's analyze_videos        {theirs:.2f} frames/s over {args.dlc_frames} frames")
        print(f"  ratio to DeepLabCut                {spread(whole / theirs, 0)}")
    own = len(case.made.trial.time_s)
    if args.long_minutes:
        count = max(1, round(args.long_minutes * 60 / float(case.made.trial.time_s[-1])))
        copies(case.video, folder / "long.mp4", count)
        taken_s, peak, over_time = run_measured(
            ["track", case.project, folder / "long.mp4", "--out", folder / "long"]
        )
        tenth = len(over_time) // 10
        print(
            f"  {args.long_minutes:g} minutes of video: {_rate(count * own, taken_s)}, peak {peak:.0f} MiB;"
            f" memory after a tenth {over_time[tenth]:.0f}, half {over_time[len(over_time) // 2]:.0f},"
            f" nine tenths {over_time[-1 - tenth]:.0f} MiB"
        )
    if args.study:
        count = round(STUDY_FRAMES / STUDY_TRIALS / own) or 1
        (folder / "trials").mkdir()
        for i in range(STUDY_TRIALS):
            copies(case.video, folder / "trials" / f"trial_{i:02d}.mp4", count)
        taken_s, peak, _ = run_measured(["track", case.project, folder / "trials", "--out", folder / "study"])
        print(f"  {STUDY_TRIALS} trials: {_rate(STUDY_TRIALS * count * own, taken_s)}, peak {peak:.0f} MiB")
    if args.clips:
        clips(case.video, folder / "clips", args.clips)
        taken_s, peak, _ = run_measured(
            ["track", case.project, folder / "clips", "--out", folder / "of-clips"]
        )
        frames = args.clips * CLIP_FRAMES
        on_frames = frames / float(np.median(whole)) / taken_s
        print(
            f"  {args.clips} clips of a second: {_rate(frames, taken_s)}, peak {peak:.0f} MiB; at the speed above"
            f" their frames take {100 * on_frames:.0f} % of that"
        )


def _rate(frames: int, taken_s: float) -> str:
    return f"{frames} frames in {taken_s:.0f} s ({frames / taken_s:.0f} frames/s)"


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT."""
    width, height = text.split("x")
    return int(width), int(height)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=size, action="append", help="of the frames; may be given again")
    parser.add_argument("--backbone", action="append", help="may be given again")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the video at 30 frames/s")
    parser.add_argument("--seed", type=int, default=9100, help="of the look")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, help="training steps, fewer than usual")
    parser.add_argument("--dlc", type=Path, metavar="PYTHON", help="of DeepLabCut's environment")
    parser.add_argument("--dlc-frames", type=int, default=100)
    parser.add_argument("--long-minutes", type=float, default=0.0, help="also track a video so long")
    parser.add_argument(
        "--study", action="store_true", help="also track as many trials as the paper's study has"
    )
    parser.add_argument("--clips", type=int, default=0, help="also track so many clips of one second")
    args = parser.parse_args()
    for size_wh in args.size or [(640, 480)]:
        for backbone in args.backbone or ["resnet18"]:
            with tempfile.TemporaryDirectory(prefix="bendtrack-speed-") as folder:
                report(Path(folder), size_wh, backbone, args)


if __name__ == "__main__":
    main()
