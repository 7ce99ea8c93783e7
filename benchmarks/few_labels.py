"""How many labels an actuator needs that pretraining has not seen the like of: angle error from every start.

    python benchmarks/few_labels.py                                     six looks; 5, 10 and 30 labels; random numbers
    python benchmarks/few_labels.py --init random --init actuators/weights.safetensors --init resnet18.pth
    python benchmarks/few_labels.py --looks 1 --labels 5 --steps 3 --frames 40      a run to see that it runs

Looks are drawn from the families that are held out from pretraining (`stream.HELD_OUT`: materials, backgrounds, body
shapes and clamps), every one filmed in a slow inflation, encoded, labelled with 1 px of noise on decoded frames,
trained on and tracked as a user's; labelled frames are left out of every figure. The last figure of a start is of the
same actuator in other light before another background, tracked with the network of the most labels.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rendered import rms

from bendtrack.models.detector import NetworkDetector
from bendtrack.models.settings import TrainingSettings
from bendtrack.models.training import train
from bendtrack.tracker.angle import AngleDefinition, end_vector_px, label_noise_floor_deg
from bendtrack.tracker.synthetic.stream import (
    HELD_OUT,
    KEYPOINTS,
    Look,
    Stage,
    before_other_background,
    drawn_look,
    in_other_light,
    inflation_deg,
)
from bendtrack.tracker.tracking import track
from bendtrack.tracker.types import FloatArray, LabelledFrame
from bendtrack.tracker.video import Video
from bendtrack.tracker.video_writer import VideoWriter

STREAM = 777
"""Seed of the looks. Nothing was tuned on them."""

ENDS = ("base_1", "base_2", "tip_1", "tip_2")
DEFINITION = AngleDefinition("two-vector", ENDS)
SIZE_WH = (640, 480)
NOISE_PX = 1.0
OTHER_LIGHT = "light"


@dataclass(frozen=True)
class Film:
    """A video of one actuator and its truth: xy (T, 4, 2) px, angle_deg (T,), seen (T,) all four points in sight."""

    path: Path
    xy: FloatArray
    angle_deg: FloatArray
    seen: NDArray[np.bool_]


def filmed(path: Path, look: Look, frames: int) -> Film:
    """A slow inflation of a look, encoded."""
    stage = Stage(look)
    ends = [KEYPOINTS.index(name) for name in ENDS]
    xy, angle_deg, seen = [], [], []
    with VideoWriter(path, SIZE_WH, frame_rate=30) as writer:
        for index, bend in enumerate(inflation_deg(look, frames)):
            sample = stage.frame(float(bend), noise_seed=index)
            writer.write(sample.picture)
            xy.append(sample.keypoints_xy[ends])
            angle_deg.append(sample.angle_deg)
            seen.append(sample.visible[ends].all())
    return Film(path, np.array(xy), np.array(angle_deg), np.array(seen))


def labels_of(film: Film, count: int, folder: Path) -> list[LabelledFrame]:
    """Frames spread evenly over the angles, in which all points are seen, labelled by an unsteady hand."""
    rng = np.random.default_rng([STREAM, count])
    seen_deg = film.angle_deg[film.seen]
    wanted = np.linspace(seen_deg.min(), seen_deg.max(), count)
    free = film.seen.copy()
    chosen = []
    for angle in wanted:
        chosen.append(int(np.argmin(np.where(free, np.abs(film.angle_deg - angle), np.inf))))
        free[chosen[-1]] = False
    labelled = []
    for frame in Video(film.path):
        if frame.index in chosen and frame.image is not None:
            picture = folder / f"img{frame.index:05d}.png"
            folder.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(picture), cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
            xy = film.xy[frame.index] + rng.normal(0, NOISE_PX, (len(ENDS), 2))
            labelled.append(LabelledFrame(film.path.stem, picture, xy, "actuator", frame.index))
    return labelled


@dataclass(frozen=True)
class Result:
    """Angle RMSE over the frames that are not labelled and show all points, and the share of them without a flag."""

    rmse_deg: float
    sound: float
    minutes: float = 0.0


def judged(film: Film, model: Path, labelled: Sequence[int]) -> Result:
    """Track a film and compare with its truth."""
    table = track(film.path, NetworkDetector.load(model), DEFINITION)
    rest = film.seen.copy()
    rest[list(labelled)] = False
    error = (table.angle_deg - film.angle_deg)[rest]
    return Result(rms(error[np.isfinite(error)]), float((table.flag[rest] == "").mean()))


def results_of(
    film: Film, other: Film, folder: Path, counts: Sequence[int], init: str, steps: int | None
) -> dict[str, Result]:
    """Results by number of labels, and in the other film, which is of other light."""
    results = {}
    for count in counts:
        model = folder / f"model-{count}"
        labelled = labels_of(film, count, folder / f"labels-{count}")
        settings = TrainingSettings(init=init, steps=steps, held_out=0.0 if count < 10 else 0.1)
        begun = time.perf_counter()
        train(labelled, ENDS, DEFINITION, model, settings)
        minutes = (time.perf_counter() - begun) / 60
        frames = [frame.frame for frame in labelled if frame.frame is not None]
        got = judged(film, model, frames)
        results[str(count)] = Result(got.rmse_deg, got.sound, minutes)
    results[OTHER_LIGHT] = judged(other, folder / f"model-{max(counts)}", [])
    return results


def rows_of(
    look: Look, counts: Sequence[int], starts: Sequence[str], args: argparse.Namespace
) -> Iterator[tuple[str, str, Result, float]]:
    """Start, number of labels or `OTHER_LIGHT`, result, and length of the shorter end in px, as they come."""
    with tempfile.TemporaryDirectory(prefix="bendtrack-few-labels-") as name:
        folder = Path(name)
        film = filmed(folder / "film.mp4", look, args.frames)
        moved = before_other_background(in_other_light(look, STREAM), STREAM)
        other = filmed(folder / "other.mp4", moved, args.frames)
        length = end_vector_px(film.xy, ENDS, DEFINITION)
        for number, init in enumerate(starts):
            results = results_of(film, other, folder / str(number), counts, init, args.steps)
            for key, result in results.items():
                yield init, key, result, length


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--looks", type=int, default=6)
    parser.add_argument("--first", type=int, default=0, help="number of the first look")
    parser.add_argument("--labels", type=int, action="append", help="may be given again; 5, 10 and 30")
    parser.add_argument("--init", action="append", help="as train's; may be given again")
    parser.add_argument("--frames", type=int, default=180)
    parser.add_argument("--steps", type=int, help="of a training, fewer than usual")
    args = parser.parse_args()
    counts, starts = sorted(args.labels or (5, 10, 30)), args.init or ["random"]
    ratios: dict[tuple[str, str], list[float]] = {}
    for index in range(args.first, args.first + args.looks):
        look = drawn_look(STREAM, index, size_wh=SIZE_WH, families=HELD_OUT, bend_deg=(0.0, 180.0))
        print(f"\nlook {index}: {', '.join(vars(look.words).values())}")
        for init, key, result, length in rows_of(look, counts, starts, args):
            floor = label_noise_floor_deg(NOISE_PX, max(counts) if key == OTHER_LIGHT else int(key), length)
            ratios.setdefault((init, key), []).append(result.rmse_deg / floor)
            print(
                f"  {Path(init).name:24s} {key:>6s}  L {length:5.1f} px  angle RMSE {result.rmse_deg:7.3f} degrees"
                f"  {result.rmse_deg / floor:6.2f} of the floor  {100 * result.sound:5.1f} % sound"
                f"  training {result.minutes:.1f} min",
                flush=True,
            )
    print("\nangle RMSE over the label-noise floor: median (lowest to highest) over the looks; goal 1.5")
    for (init, key), values in ratios.items():
        print(
            f"  {Path(init).name:24s} {key:>6s}  {np.median(values):6.2f} ({min(values):.2f} to {max(values):.2f})"
        )


if __name__ == "__main__":
    main()
