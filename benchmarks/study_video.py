"""Hysteresis through video: trials rendered, labelled with 1 px noise, trained on, tracked, analysed; beside the truth.

    python benchmarks/study_video.py                       two designs, both frequencies, three cycles each
    python benchmarks/study_video.py --designs 1 --fast-only --cycles 1 --labels 6 --steps 3 --init random \\
        --keep-doubtful                                    a run to see that it runs

Four trials as the paper has them at 50 kPa (largest angles and ratios of `study_plan`): each design is one look, filmed
at 640 x 480 in a slow and in a fast trial. 30 frames of each actuator are labelled, half in either video; one network
learns both. Files go the way a user's go: results by `track`, a study file, `bendtrack analyze`'s own calls.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from bendtrack.labeling.interop.dlc import import_dlc, project_for
from bendtrack.labeling.store import LabelStore
from bendtrack.models.detector import NetworkDetector
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.trainer import train
from bendtrack.tracker.angle import end_vector_px, label_noise_floor_deg
from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.project import Project
from bendtrack.tracker.results import write_results
from bendtrack.tracker.study.analysis import analyse_study
from bendtrack.tracker.study.study_file import read_study
from bendtrack.tracker.study.trial_data import load_trial
from bendtrack.tracker.synthetic.stream import HELD_OUT, Look
from bendtrack.tracker.synthetic.study_plan import DYNAMIC, RESIDUAL
from bendtrack.tracker.synthetic.trial import Trial, labelled_sample, render_trial, write_labels
from bendtrack.tracker.synthetic.trial_looks import trial_look
from bendtrack.tracker.tracking import track

DESIGNS = ("original", "mid-width smaller")
PEAK_KPA = 50.0
RATIO_GOAL, ANGLE_GOAL_DEG = 0.01, 1.0
METRICS = ("hysteresis_ratio", "dynamic_response_deg")


@dataclass(frozen=True)
class Filmed:
    """A rendered trial and what it stands for."""

    trial: Trial
    design: str
    frequency_hz: float
    angle_max_deg: float

    @property
    def name(self) -> str:
        return self.trial.video_path.stem


@dataclass(frozen=True)
class Row:
    """One trial, found beside true."""

    trial: str
    end_vector_px: float
    floor_deg: float
    angle_rmse_deg: float
    angle_bias_deg: float
    angle_true_deg: float
    angle_deg: float
    angle_low_deg: float
    angle_high_deg: float
    ratio_true: float
    ratio: float
    ratio_low: float
    ratio_high: float

    @property
    def ratio_error(self) -> float:
        return self.ratio - self.ratio_true

    @property
    def angle_error_deg(self) -> float:
        return self.angle_deg - self.angle_true_deg


def looks_of(designs: int, first_seed: int, length_px: float) -> list[Look]:
    """Looks of held-out words that bend to one side, as actuators in one rig do: a project has one sign."""
    found: list[Look] = []
    seed = first_seed
    while len(found) < designs:
        look = trial_look(seed, end_vector_px=length_px, families=HELD_OUT)
        if not found or look.place.side == found[0].place.side:
            found.append(look)
        seed += 1
    return found


def film(folder: Path, args: argparse.Namespace) -> list[Filmed]:
    """Render all trials."""
    made = []
    looks = looks_of(args.designs, args.first_seed, args.end_vector)
    for design, look in zip(DESIGNS[: args.designs], looks, strict=True):
        for frequency_hz in (0.25,) if args.fast_only else (0.0625, 0.25):
            angle_deg, ratio = next(row[1:] for row in DYNAMIC[design, frequency_hz] if row[0] == PEAK_KPA)
            trial = render_trial(
                folder / f"{design.replace(' ', '-')}_{frequency_hz:g}Hz",
                seed=args.first_seed + len(made),
                frequency_hz=frequency_hz,
                cycles=args.cycles,
                pressure_peak_kpa=PEAK_KPA,
                angle_min_deg=RESIDUAL[frequency_hz] * angle_deg,
                angle_max_deg=angle_deg,
                hysteresis_ratio=ratio,
                look=look,
            )
            made.append(Filmed(trial, design, frequency_hz, angle_deg))
    return made


def label(folder: Path, filmed: list[Filmed], args: argparse.Namespace) -> Project:
    """A project with noisy labels of all videos, those of one design under one actuator."""
    project: Project | None = None
    for index, one in enumerate(filmed):
        videos = sum(other.design == one.design for other in filmed)
        frames, xy = labelled_sample(one.trial, args.labels // videos, args.noise, seed=args.seed + index)
        labels = one.trial.folder / "labels.csv"
        write_labels(one.trial, labels, frames, xy)
        project = project_for(folder / "project", labels)
        import_dlc(labels, project, videos=[one.trial.video_path])
        project.assign_actuator(one.design, [one.name])
    assert project is not None
    return Project.open(project.root)


def study_text(filmed: list[Filmed], floors_deg: dict[str, float], keep_doubtful: bool) -> str:
    """The study file: angle tables in results/, logs beside the videos, one clock, what the labels leave unsure."""
    trials = [
        f"""
[[trials]]
name = "{one.name}"
design = "{one.design}"
kind = "dynamic"
frequency_hz = {one.frequency_hz}
pressure_pp_kpa = {PEAK_KPA}
angles = "results/{one.name}.csv"
log = "{one.name}/pressure.csv"
sync = {{ method = "shared clock" }}
angle_common_sd_deg = {floors_deg[one.name]:.3f}
"""
        for one in filmed
    ]
    kept = 'keep_flagged = ["low_likelihood"]\n' if keep_doubtful else ""
    return f'title = "Hysteresis through video"\n{kept}' + "".join(trials)


def analysed(path: Path) -> pd.DataFrame:
    """The table of trials by name, without those that cannot be read."""
    study = read_study(path)
    trials = []
    for settings in study.trials:
        try:
            trials.append(load_trial(study, settings))
        except BendtrackError as error:
            print(f"failed: {error}")
    if not trials:
        return pd.DataFrame(columns=[metric + end for metric in METRICS for end in ("", "_low", "_high")])
    results = analyse_study(trials, baseline=None)
    for warning in results.warnings.itertuples():
        print(f"warning: {warning.trial}: {warning.warning}")
    return results.dynamic.set_index("trial")


def measure(folder: Path, args: argparse.Namespace) -> list[Row]:
    """Everything, and one row a trial."""
    filmed = film(folder, args)
    print(f"rendered {sum(len(one.trial.time_s) for one in filmed)} frames", flush=True)
    project = label(folder, filmed, args)
    frames = LabelStore.of(project).read()
    definition = project.angle_definition(np.stack([frame.xy for frame in frames]))
    begun = time.perf_counter()
    settings = TrainingSettings(
        init=args.init, steps=args.steps, seed=args.seed, max_minutes=args.max_minutes
    )
    train(frames, project.keypoints, definition, folder / "model", settings)
    print(f"trained on {len(frames)} frames in {(time.perf_counter() - begun) / 60:.1f} min", flush=True)
    detector = NetworkDetector.load(folder / "model")
    errors_deg, lengths_px, floors_deg = {}, {}, {}
    for one in filmed:
        table = track(one.trial.video_path, detector, definition)
        write_results(table, folder / "results", one.name)
        errors_deg[one.name] = table.angle_deg - one.trial.angle_deg
        lengths_px[one.name] = end_vector_px(one.trial.xy, one.trial.keypoints, definition)
        floors_deg[one.name] = label_noise_floor_deg(args.noise, args.labels, lengths_px[one.name])
    (folder / "study.toml").write_text(study_text(filmed, floors_deg, args.keep_doubtful), encoding="utf-8")
    dynamic = analysed(folder / "study.toml").reindex([one.name for one in filmed])
    rows = []
    for one in filmed:
        ratio, angle = (
            [float(dynamic.loc[one.name, metric + end]) for end in ("", "_low", "_high")]
            for metric in METRICS
        )
        error_deg = errors_deg[one.name]
        rows.append(
            Row(
                trial=one.name,
                end_vector_px=lengths_px[one.name],
                floor_deg=floors_deg[one.name],
                angle_rmse_deg=float(np.sqrt(np.nanmean(error_deg**2))),
                angle_bias_deg=float(np.nanmean(error_deg)),
                angle_true_deg=one.angle_max_deg,
                angle_deg=angle[0],
                angle_low_deg=angle[1],
                angle_high_deg=angle[2],
                ratio_true=one.trial.hysteresis_ratio,
                ratio=ratio[0],
                ratio_low=ratio[1],
                ratio_high=ratio[2],
            )
        )
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--designs", type=int, default=2, choices=(1, 2))
    parser.add_argument("--fast-only", action="store_true", help="leave the slow trials out")
    parser.add_argument("--cycles", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=9101, help="seed of the first look")
    parser.add_argument("--end-vector", type=float, default=60.0, help="distance of an end's points, px")
    parser.add_argument("--labels", type=int, default=30, help="labelled frames an actuator")
    parser.add_argument("--noise", type=float, default=1.0, help="label noise, px")
    parser.add_argument("--init", default="auto")
    parser.add_argument("--steps", type=int, default=None)
    parser.add_argument("--max-minutes", type=float, default=None)
    parser.add_argument("--seed", type=int, default=0, help="of the labels and the training")
    parser.add_argument(
        "--keep-doubtful",
        action="store_true",
        help="use angles of low likelihood too (a network hardly trained)",
    )
    parser.add_argument("--out", type=Path, help="keep all files here")
    parser.add_argument("--json", type=Path, help="write all figures here")
    args = parser.parse_args()

    print(
        f"{args.designs} designs, {args.cycles} cycles a trial, {args.labels} labels an actuator with "
        f"{args.noise:g} px of noise, end vectors of {args.end_vector:g} px"
    )
    if args.out is None:
        with tempfile.TemporaryDirectory(prefix="bendtrack-study-video-") as folder:
            rows = measure(Path(folder), args)
    else:
        rows = measure(args.out, args)
    print(
        f"{'trial':28} ratio: true  found    low   high  error"
        "   largest angle: true   found     low    high   error   floor  RMSE   bias"
    )
    for row in rows:
        print(
            f"{row.trial:28} {row.ratio_true:11.4f} {row.ratio:6.4f} {row.ratio_low:6.4f} {row.ratio_high:6.4f}"
            f" {row.ratio_error:+6.4f} {row.angle_true_deg:21.2f} {row.angle_deg:7.2f} {row.angle_low_deg:7.2f}"
            f" {row.angle_high_deg:7.2f} {row.angle_error_deg:+7.2f} {row.floor_deg:7.2f}"
            f" {row.angle_rmse_deg:5.2f} {row.angle_bias_deg:+6.2f}"
        )
    ratio = np.max([abs(row.ratio_error) for row in rows])
    angle = np.max([abs(row.angle_error_deg) for row in rows])
    print(f"largest error of a hysteresis ratio: {ratio:.4f} (goal {RATIO_GOAL})")
    print(f"largest error of a largest angle: {angle:.2f} deg (goal {ANGLE_GOAL_DEG:g})")
    if args.json:
        settings = {key: value for key, value in vars(args).items() if key not in ("out", "json")}
        trials = [asdict(row) for row in rows]
        args.json.write_text(json.dumps({"settings": settings, "trials": trials}, indent=2) + "\n")


if __name__ == "__main__":
    main()
