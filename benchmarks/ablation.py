"""The ablation table: what each stage of inference is worth, with the same weights.

    python benchmarks/ablation.py                            eight looks, two seeds each, 30 labels
    python benchmarks/ablation.py --labels 0 --looks 16      without labels: nothing is drawn from a seed
    python benchmarks/ablation.py --stage end_regression --stage self_training+edge_orientation      these alone
    python benchmarks/ablation.py --looks 1 --seeds 1 --steps 3 --frames 12      a run to see that it runs

Looks are drawn from the training families: what this table decides must not be decided on held-out looks. A network is
trained once for each look and seed. The film is tracked with all stages, and once with each stage switched off
(`models.inference.stages.StageSettings`); so is a film of the same actuator in other light before another background.
The table gives the paired difference in angle RMSE, off minus on, over looks and seeds: mean, standard error and range.
A stage earns its place where the mean is above two standard errors in one of the columns.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from few_labels import (
    DEFINITION,
    LEAST_SEEN,
    NOTHING,
    SIZE_WH,
    STREAM,
    Film,
    Result,
    filmed,
    judged,
    labels_of,
)

from bendtrack.models.detector import NetworkDetector
from bendtrack.models.inference.stages import ALL_STAGES, StageSettings
from bendtrack.models.networks.shipped import working_copy
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.trainer import train
from bendtrack.models.training.transfer import ENDS
from bendtrack.tracker.batch import PROBE_FRAMES
from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.synthetic.stream import (
    TRAINING,
    before_other_background,
    drawn_look,
    in_other_light,
)
from bendtrack.tracker.video import spread_frames

WITH_LABELS = (
    "whole_frame_search",
    "iterative_refinement",
    "end_regression",
    "agreement_check",
    "static_patches",
    "backward_pass",
    "distance_check",
    "film_calibration",
)
WITHOUT_LABELS = (
    "end_regression",
    "backward_pass",
    "motion_evidence",
    "base_measurement",
    "self_training",
    "edge_orientation",
)
ALL = "all stages"


@dataclass(frozen=True)
class Row:
    """One film tracked with some stages: look, seed, the stage that is off, light, and the result."""

    look: int
    seed: int
    off: str
    light: str
    result: Result


def settings_without(stages: str) -> StageSettings:
    """All stages but one, or but several joined by `+`; all for `ALL`."""
    return ALL_STAGES if stages == ALL else replace(ALL_STAGES, **dict.fromkeys(stages.split("+"), False))


def rows_with_labels(
    look_index: int, films: dict[str, Film], seed: int, folder: Path, args: argparse.Namespace
) -> Iterator[Row]:
    """Train once, then track every film with each stage off."""
    labelled = labels_of(films["same"], args.labels, folder / f"labels-{seed}")
    model = folder / f"model-{seed}"
    train(labelled, ENDS, DEFINITION, model, TrainingSettings(steps=args.steps, seed=seed))
    frames = [frame.frame for frame in labelled if frame.frame is not None]
    for off in (ALL, *(args.stage or WITH_LABELS)):
        detector = NetworkDetector.load(model, engine="torch", stages=settings_without(off))
        for light, film in films.items():
            result = judged(film, detector, frames if light == "same" else ())
            yield Row(look_index, seed, off, light, result)


def rows_without_labels(look_index: int, film: Film, seed: int, args: argparse.Namespace) -> Iterator[Row]:
    """Measure a film without labels with each stage off."""
    for off in (ALL, *(args.stage or WITHOUT_LABELS)):
        detector = NetworkDetector.load(
            working_copy("resnet18"), engine="torch", stages=settings_without(off)
        )
        try:
            detector = detector.for_video(spread_frames(film.path, PROBE_FRAMES))
            result = judged(film, detector, check_jumps=True)
            result = replace(result, rmse_deg=result.sound_deg, found=result.sound)
        except VideoError as error:
            print(f"    {off}: {error}")
            result = NOTHING
        yield Row(look_index, seed, off, "same", result)


def print_table(rows: Sequence[Row]) -> None:
    """Print the paired differences, off minus on."""
    for light in dict.fromkeys(row.light for row in rows):
        own = [row for row in rows if row.light == light]
        on = {(row.look, row.seed): row.result for row in own if row.off == ALL}
        values = np.array([result.rmse_deg for result in on.values()])
        sound = np.array([result.sound_deg for result in on.values()])
        kept = np.array([100 * result.sound for result in on.values()])
        print(f"\n{light} light, all stages, {len(on)} films: angle RMSE {spread(values)} degrees,")
        print(f"  over rows without a flag {spread(sound)} degrees, {spread(kept)} % of the rows")
        print("  without the stage, minus with it: mean +- standard error (lowest to highest)")
        print(
            f"  {'stage':22s} {'degrees, all rows':>34s} {'degrees, not flagged':>34s} {'not flagged, %':>34s}"
        )
        for off in dict.fromkeys(row.off for row in own if row.off != ALL):
            pairs = [(row.result, on[row.look, row.seed]) for row in own if row.off == off]
            print(
                f"  {off:22s}"
                f" {paired([without.rmse_deg - result.rmse_deg for without, result in pairs]):>34s}"
                f" {paired([without.sound_deg - result.sound_deg for without, result in pairs]):>34s}"
                f" {paired([100 * (without.sound - result.sound) for without, result in pairs]):>34s}"
            )


def spread(values: np.ndarray) -> str:
    """Median, lowest and highest of what is known."""
    known = values[np.isfinite(values)]
    return f"{np.median(known):.3f} ({known.min():.3f} to {known.max():.3f})" if len(known) else "unknown"


def paired(differences: Sequence[float]) -> str:
    """Mean, standard error and range of what is known in both."""
    known = np.array([value for value in differences if np.isfinite(value)])
    if len(known) < 2:
        return "unknown"
    error = known.std(ddof=1) / np.sqrt(len(known))
    return f"{known.mean():+.3f} +- {error:.3f} ({known.min():+.3f} to {known.max():+.3f})"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--looks", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="number of the first look")
    parser.add_argument("--seeds", type=int, default=2, help="trainings of each look")
    parser.add_argument("--labels", type=int, default=30)
    parser.add_argument("--frames", type=int, default=90)
    parser.add_argument(
        "--stage", action="append", metavar="STAGE[+STAGE]", help="switch off these only (repeatable)"
    )
    parser.add_argument("--steps", type=int, help="of a training, fewer than usual")
    args = parser.parse_args()
    rows: list[Row] = []
    index, todo = args.first, args.looks
    while todo:
        look = drawn_look(STREAM + 1, index, size_wh=SIZE_WH, families=TRAINING, bend_deg=(0.0, 180.0))
        with tempfile.TemporaryDirectory(prefix="bendtrack-ablation-") as name:
            folder = Path(name)
            film = filmed(folder / "film.mp4", look, args.frames)
            index += 1
            if film.seen.mean() < LEAST_SEEN:
                continue
            todo -= 1
            films = {"same": film}
            if args.labels:
                moved = before_other_background(in_other_light(look, STREAM), STREAM)
                films["other"] = filmed(folder / "other.mp4", moved, args.frames // 2)
            for seed in range(args.seeds if args.labels else 1):
                own = (
                    rows_with_labels(index - 1, films, seed, folder, args)
                    if args.labels
                    else rows_without_labels(index - 1, film, seed, args)
                )
                for row in own:
                    rows.append(row)
                    print(
                        f"look {row.look} seed {row.seed} {row.light:5s} {row.off:22s}"
                        f" {row.result.rmse_deg:8.3f} degrees; not flagged {row.result.sound_deg:8.3f} degrees,"
                        f" {100 * row.result.sound:5.1f} %",
                        flush=True,
                    )
    print_table(rows)


if __name__ == "__main__":
    main()
