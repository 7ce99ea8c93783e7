"""How well the frames that are chosen by appearance alone span the motion, over many looks.

    python benchmarks/frames.py                              twelve trials, 640 x 480
    python benchmarks/frames.py --looks 1 --seconds 2 --size 200x150     a run to see that it runs

Each trial is rendered (two cycles of a triangle wave, noise, shadows, wandering light), so the true angle of every
frame is known. Goal: 30 frames cover 95 % of the range and leave no gap above 8 % of it. Looking through a video is
timed beside decoding alone in the same run; machines are noisy, the ratio counts.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from bendtrack.labeling.selection import select_frames
from bendtrack.labeling.video_scan import SampleBy, clusters_for, scan_video
from bendtrack.tracker.synthetic.trial import render_trial
from bendtrack.tracker.video import Video

# A small bend, a usual one, one beyond 180 degrees.
LARGEST_DEG = (60.0, 120.0, 205.0)


def measure(folder: Path, seed: int, args: argparse.Namespace) -> dict[str, float]:
    """One trial's figures."""
    width, height = (int(side) for side in args.size.split("x"))
    trial = render_trial(
        folder,
        seed=seed,
        frequency_hz=2 / args.seconds,
        cycles=2,
        frame_rate=args.frame_rate,
        angle_max_deg=LARGEST_DEG[seed % len(LARGEST_DEG)],
        size_wh=(width, height),
        end_vector_px=width / 16,
    )
    begun = time.perf_counter()
    frames = sum(1 for _ in Video(trial.video_path))
    decoded = time.perf_counter()
    found = scan_video(trial.video_path, clusters_for(SampleBy.APPEARANCE, 1))
    surveyed = time.perf_counter()
    chosen = select_frames([found], args.count)[0]
    done = time.perf_counter()
    angle_deg = trial.angle_deg
    reached = np.sort(angle_deg[[descriptor.frame for descriptor in chosen]])
    return {
        "seed": seed,
        "range_deg": float(np.ptp(angle_deg)),
        "chosen": len(chosen),
        "covered": float(np.ptp(reached) / np.ptp(angle_deg)),
        "gap": float(np.diff(reached).max(initial=0.0) / np.ptp(angle_deg)),
        "frames_per_s": frames / (surveyed - decoded),
        "over_decoding": (surveyed - decoded) / (decoded - begun),
        "choosing_s": done - surveyed,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--looks", type=int, default=12)
    parser.add_argument("--first-seed", type=int, default=9001)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=16.0, help="length of a trial, two cycles")
    parser.add_argument("--frame-rate", type=float, default=30.0)
    parser.add_argument("--size", default="640x480")
    args = parser.parse_args()

    rows = []
    print(" seed  range deg  chosen  covered    gap  frames/s  over decoding  choosing s")
    for seed in range(args.first_seed, args.first_seed + args.looks):
        with tempfile.TemporaryDirectory(prefix="bendtrack-frames-") as folder:
            row = measure(Path(folder), seed, args)
        rows.append(row)
        print(
            f"{row['seed']:5.0f} {row['range_deg']:10.1f} {row['chosen']:7.0f} {row['covered']:8.3f} {row['gap']:6.3f}"
            f" {row['frames_per_s']:9.0f} {row['over_decoding']:14.2f} {row['choosing_s']:11.2f}",
            flush=True,
        )
    covered, gap, over = (np.array([row[key] for row in rows]) for key in ("covered", "gap", "over_decoding"))
    print(f"covered: at least {covered.min():.3f} of the range (goal 0.95), median {np.median(covered):.3f}")
    print(f"largest gap: at most {gap.max():.3f} of the range (goal 0.08), median {np.median(gap):.3f}")
    print(f"looking over decoding: {np.median(over):.2f} ({over.min():.2f} to {over.max():.2f})")


if __name__ == "__main__":
    main()
