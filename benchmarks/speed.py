"""Tracking speed, decode to table, beside decoding alone: both measured in turn in one run.

    python benchmarks/speed.py                                    640 x 480, 600 frames, five rounds
    python benchmarks/speed.py --seconds 1 --rounds 1             a run to see that it runs

Machines are noisy: the ratio is what counts, as median and range over the rounds. "decoding" is every frame decoded
and not converted; "decoding to RGB" is what tracking needs of it today.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rendered import labelled_trial

from bendtrack.models.detector import NetworkDetector
from bendtrack.models.settings import TrainingSettings
from bendtrack.models.training import train
from bendtrack.tracker.results import write_results
from bendtrack.tracker.tracking import track
from bendtrack.tracker.video import Video


def frames_per_s(work: Callable[[], int]) -> float:
    """Frames that `work` handled, over the time it took."""
    begun = time.perf_counter()
    count = work()
    return count / (time.perf_counter() - begun)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the video at 30 frames/s")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--steps", type=int, default=60, help="training steps; speed does not need a good network"
    )
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bendtrack-speed-") as name:
        folder = Path(name)
        made = labelled_trial(
            folder, seed=9100, end_vector_px=40.0, n_labels=10, noise_px=0.0, seconds=args.seconds
        )
        video = made.trial.video_path
        settings = TrainingSettings(init="random", steps=args.steps)
        train(made.frames, made.trial.keypoints, made.definition, folder / "model", settings)
        detector = NetworkDetector.load(folder / "model")

        def decode() -> int:
            with Video(video) as source:
                return sum(1 for _ in source)

        def decode_rgb() -> int:
            with Video(video) as source:
                return sum(1 for frame in source if frame.image is not None)

        def whole() -> int:
            table = track(video, detector, made.definition)
            write_results(table, folder / "results", "video")
            return len(table.time_s)

        works = {"decoding": decode, "decoding to RGB": decode_rgb, "decode to table": whole}
        speeds: dict[str, list[float]] = {name: [] for name in works}
        for _ in range(args.rounds):
            for name, work in works.items():
                speeds[name].append(frames_per_s(work))
    print(
        f"{made.trial.look.size_wh[0]} x {made.trial.look.size_wh[1]} H.264, {len(made.trial.time_s)} frames"
    )
    for name, values in speeds.items():
        print(f"{name:16s} {np.median(values):7.1f} frames/s  ({min(values):.1f} to {max(values):.1f})")
    ratio = np.array(speeds["decode to table"]) / np.array(speeds["decoding"])
    print(f"decode to table / decoding: {np.median(ratio):.3f} ({ratio.min():.3f} to {ratio.max():.3f})")


if __name__ == "__main__":
    main()
