"""A whole simulated study through `bendtrack analyze`: how long it takes, and its tables beside the truth.

    python benchmarks/study.py                                     54 trials and four staircases, three rounds
    python benchmarks/study.py --designs 2 --fast-only --rounds 1 --studies 1      a run to see that it runs

Time is that of the command, from start to report, figures included. The two tables of the paper are printed from the
files that the command wrote. Then the two designs of those tables are simulated again and again, noise, clocks and
cycles drawn anew, so that the errors are seen with their spread and not for one lucky draw.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from bendtrack.tracker.study.analysis import StudyResults, analyse_study
from bendtrack.tracker.study.study_file import read_study
from bendtrack.tracker.study.trial_data import load_trials
from bendtrack.tracker.synthetic.study import SimulatedStudy, simulate_study
from bendtrack.tracker.synthetic.study_plan import BASELINE, COMPARISONS, DESIGNS

RATIO_GOAL, ANGLE_GOAL_DEG, SECONDS_GOAL = 0.002, 0.2, 30
# What the truth calls the columns of the table of trials.
METRICS = {
    "hysteresis_ratio": "hysteresis_ratio",
    "dynamic_response_deg": "angle_max_deg",
    "hysteresis_deg_kpa": "area_deg_kpa",
}


def timed_analysis(study: SimulatedStudy, out: Path) -> tuple[float, float]:
    """Seconds that the command takes, by the clock and of processor time."""
    command = [
        str(Path(sys.executable).with_name("bendtrack")),
        "analyze",
        str(study.study_path),
        "--out",
        str(out),
    ]
    before, begun = os.times(), time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True)
    seconds, after = time.perf_counter() - begun, os.times()
    if done.returncode:
        sys.exit(done.stderr)
    spent = after.children_user - before.children_user + after.children_system - before.children_system
    return seconds, spent


def print_tables(truth: dict, constant_angle: pd.DataFrame, improvements: pd.DataFrame) -> None:
    """The paper's two tables of results: found (95 % interval) beside true."""
    print("\nhysteresis ratio at one angle")
    for row in truth["constant_angle"]:
        found = _found(constant_angle, row, "angle_deg", row["angle_deg"])
        print(
            f"  {row['frequency_hz']:6g} Hz {row['angle_deg']:5g} deg"
            f"   {BASELINE} {_beside(found, 'baseline_ratio', row['ratio_baseline'], '.4f')}"
            f"   {row['design']} {_beside(found, 'design_ratio', row['ratio'], '.4f')}"
            f"   improvement {_beside(found, 'improvement', row['improvement'], '.1%')}"
        )
    print("dynamic response, deg")
    response = improvements[improvements.metric == "dynamic_response_deg"]
    for row in truth["dynamic_response"]:
        if row["design"] == COMPARISONS[0].design:
            found = _found(response, row, "pressure_pp_kpa", row["pressure_pp_kpa"])
            print(
                f"  {row['frequency_hz']:6g} Hz {row['pressure_pp_kpa']:5g} kPa"
                f"   {BASELINE} {_beside(found, 'baseline_value', row['baseline_deg'], '.2f')}"
                f"   {row['design']} {_beside(found, 'design_value', row['angle_deg'], '.2f')}"
                f"   improvement {_beside(found, 'improvement', row['improvement'], '.1%')}"
            )


def _found(table: pd.DataFrame, row: dict, key: str, value: float) -> pd.Series:
    same = (
        (table.frequency_hz == row["frequency_hz"]) & (table[key] == value) & (table.design == row["design"])
    )
    return table[same].iloc[0]


def _beside(found: pd.Series, name: str, true: float, form: str) -> str:
    return f"{found[name]:{form}} ({found[name + '_low']:{form}} to {found[name + '_high']:{form}}), true {true:{form}}"


def print_trials(truth: dict, dynamic: pd.DataFrame) -> None:
    """Errors of all trials, and how often their intervals hold the truth."""
    print(f"all {len(dynamic)} dynamic trials")
    for name, key in METRICS.items():
        true = np.array([truth["trials"][trial][key] for trial in dynamic.trial])
        error = dynamic[name].to_numpy() - true
        error = error / true if name == "hysteresis_deg_kpa" else error
        held = (dynamic[f"{name}_low"] <= true) & (true <= dynamic[f"{name}_high"])
        what = f"{name} (relative)" if name == "hysteresis_deg_kpa" else name
        print(
            f"  {what:30} error RMS {np.sqrt(np.mean(error**2)):.4f}, largest {np.abs(error).max():.4f};"
            f" 95 % intervals hold the truth in {held.sum()} of {len(held)}"
        )


def table_errors(results: StudyResults, truth: dict) -> tuple[list[float], list[float], list[float]]:
    """Errors in the paper's two tables: ratios, angles (deg), and improvements (all of both)."""
    ratios, angles, gains = [], [], []
    for row in truth["constant_angle"]:
        found = _found(results.constant_angle, row, "angle_deg", row["angle_deg"])
        ratios += [found.baseline_ratio - row["ratio_baseline"], found.design_ratio - row["ratio"]]
        gains.append(found.improvement - row["improvement"])
    response = results.improvements[results.improvements.metric == "dynamic_response_deg"]
    for row in truth["dynamic_response"]:
        found = _found(response, row, "pressure_pp_kpa", row["pressure_pp_kpa"])
        angles += [found.baseline_value - row["baseline_deg"], found.design_value - row["angle_deg"]]
        gains.append(found.improvement - row["improvement"])
    return ratios, angles, gains


def print_spread(frequencies_hz: tuple[float, ...], studies: int, first_seed: int) -> None:
    """Errors of the two tables over studies whose noise, clocks and cycles are drawn anew."""
    all_ratios, all_angles, all_gains = [], [], []
    for seed in range(first_seed, first_seed + studies):
        with tempfile.TemporaryDirectory(prefix="bendtrack-study-") as name:
            designs = (BASELINE, COMPARISONS[0].design)
            made = simulate_study(
                name, seed=seed, designs=designs, frequencies_hz=frequencies_hz, static=False
            )
            trials = load_trials(read_study(made.study_path))
            ratios, angles, gains = table_errors(analyse_study(trials, baseline=BASELINE), made.truth)
        all_ratios.append(ratios)
        all_angles.append(angles)
        all_gains.append(gains)
    print(f"the tables' errors over {studies} studies (noise, clocks and cycles drawn anew)")
    for what, errors, goal in (
        ("hysteresis ratio", all_ratios, RATIO_GOAL),
        ("largest angle, deg", all_angles, ANGLE_GOAL_DEG),
        ("improvement, share", all_gains, None),
    ):
        error = np.abs(np.array(errors))
        text = f"  {what:20} RMS {np.sqrt(np.mean(error**2)):.4f}, largest {error.max():.4f}"
        if goal is not None:
            within, whole = np.mean(error <= goal), np.mean((error <= goal).all(axis=1))
            text += f"; within {goal:g}: {within:.1%} of the values, {whole:.0%} of the studies in all values"
        print(text)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3, help="times that the command is run")
    parser.add_argument("--studies", type=int, default=10, help="studies for the spread of the tables")
    parser.add_argument("--seed", type=int, default=0, help="of the study that is timed")
    parser.add_argument("--designs", type=int, default=len(DESIGNS), help="how many of the eight")
    parser.add_argument("--fast-only", action="store_true", help="leave the slow trials out")
    args = parser.parse_args()
    # The designs of the paper's tables first.
    wanted = [BASELINE, COMPARISONS[0].design, *DESIGNS]
    designs = tuple(dict.fromkeys(wanted))[: max(args.designs, 2)]
    frequencies_hz = (0.25,) if args.fast_only else (0.0625, 0.25)
    with tempfile.TemporaryDirectory(prefix="bendtrack-study-") as name:
        study = simulate_study(
            Path(name, "study"), seed=args.seed, designs=designs, frequencies_hz=frequencies_hz
        )
        times = [timed_analysis(study, Path(name, "report")) for _ in range(args.rounds)]
        tables = {
            key: pd.read_csv(Path(name, "report", "tables", f"{key}.csv"))
            for key in ("dynamic", "constant_angle", "improvements")
        }
    seconds, spent = np.array(times).T
    print(f"{len(study.truth['trials'])} trials, {study.truth['frames']} frames, on {os.cpu_count()} cores")
    print(
        f"bendtrack analyze: {np.median(seconds):.1f} s ({seconds.min():.1f} to {seconds.max():.1f}),"
        f" processor time {np.median(spent):.1f} s ({spent.min():.1f} to {spent.max():.1f});"
        f" goal {SECONDS_GOAL} s on 2 cores for the whole study"
    )
    print_tables(study.truth, tables["constant_angle"], tables["improvements"])
    print_trials(study.truth, tables["dynamic"])
    print_spread(frequencies_hz, args.studies, args.seed)


if __name__ == "__main__":
    main()
