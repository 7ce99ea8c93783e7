"""A whole simulated study on disk, with exact truth: angle tables, pressure logs, model curves, study.toml, truth.json.

What is true is `study_plan.py`'s and the trials' own (`cycling.py`, `stairs.py`); noise and clocks are
`recording.py`'s. Nothing here knows how a study is analysed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from ..atomic import atomic_write_text
from ..errors import BendtrackError
from ..results import write_results
from ..types import FloatArray
from . import study_plan
from .cycling import CyclingTrial
from .log_files import write_csv_log, write_matlab_5_log, write_matlab_73_log, write_simulink_log
from .recording import PRESSURE_NOISE_KPA, Recording, record
from .stairs import StaircaseTrial

# Cycles of one actuator are nearly equal (the paper's leaves overlap): share of the largest angle, and ratio.
_PEAK_SD = 0.0005
_RATIO_SD = 0.001
# Frames without an angle, each by itself.
_MISSING_SHARE = 0.001
# The camera starts up to this long after the log.
_LATEST_START_S = 0.8
_KPA_IN_PSI = 6.894757293168


@dataclass(frozen=True)
class SimulatedStudy:
    """What was written.

    Attributes
    ----------
    folder : Path
        All of it.
    truth : dict[str, Any]
        What is in truth.json: "trials" (name: numbers of `CyclingTrial.truth` or `StaircaseTrial.truth`,
        with design, kind, frequency, pressure, delays), "constant_angle", "dynamic_response", "frames".
    """

    folder: Path
    truth: dict[str, Any]

    @property
    def study_path(self) -> Path:
        return self.folder / "study.toml"

    @property
    def truth_path(self) -> Path:
        return self.folder / "truth.json"


@dataclass(frozen=True)
class _Planned:
    """A trial of the plan and its place in the study."""

    name: str
    design: str
    trial: CyclingTrial | StaircaseTrial
    index: int
    seed: int


def simulate_study(
    out_dir: str | Path,
    *,
    seed: int = 0,
    designs: Sequence[str] = study_plan.DESIGNS,
    frequencies_hz: Sequence[float] = (0.0625, 0.25),
    static: bool = True,
    delay_sd_s: float = 0.005,
    delay_error: bool = False,
) -> SimulatedStudy:
    """Simulate a study of the paper's size, or a part of it, and write it.

    All of it are 54 dynamic trials of 12 cycles and four staircases: about 200,000 frames at 30 per second and
    logs at 400 Hz. Most logs are CSV; every ninth is MATLAB 5, MATLAB 7.3, Simulink's structure with time, or a
    CSV in psi and milliseconds. Dynamic trials are given their delay, static ones are to find it in the first step.

    Parameters
    ----------
    seed : int
        Draws noise, clocks, missing frames and the differences between cycles.
    designs, frequencies_hz, static : Sequence[str] or Sequence[float] or bool
        Which part of the plan.
    delay_sd_s : float
        Standard uncertainty that the study file gives with every delay.
    delay_error : bool
        Whether the given delays are wrong by draws from that uncertainty, or exact.

    Raises
    ------
    BendtrackError
        A design or frequency that the plan does not have.
    OSError
        The folder cannot be written.
    """
    for what, asked, known in (
        ("design", designs, study_plan.DESIGNS),
        ("frequency", frequencies_hz, tuple(study_plan.LAG_S)),
    ):
        for value in asked:
            if value not in known:
                raise BendtrackError(f"expected a {what} of {', '.join(map(str, known))}, got {value}")
    folder = Path(out_dir)
    for part in ("angles", "logs", "models"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    entries, truths, frames = [], {}, 0
    for planned in _plan(seed, designs, frequencies_hz, static):
        rng = np.random.default_rng([planned.seed, 41])
        delay_s = -rng.uniform(0, _LATEST_START_S)
        error_s = rng.normal(0, delay_sd_s)
        given = {"delay_s": round(delay_s + (error_s if delay_error else 0.0), 6), "sd_s": delay_sd_s}
        recording = record(planned.trial, seed=planned.seed, delay_s=delay_s, missing_share=_MISSING_SHARE)
        truth = planned.trial.truth(PRESSURE_NOISE_KPA)
        common = {"design": planned.design, **_nominal(planned.trial)}
        entries.append({"name": planned.name, **common, **_write(folder, planned, recording, given)})
        truths[planned.name] = {**common, "delay_s": delay_s, **truth}
        frames += len(recording.frame_time_s)
    whole = {"frames": frames, "trials": truths, **_tables(designs, frequencies_hz)}
    study = SimulatedStudy(folder, whole)
    atomic_write_text(study.study_path, _study_text(seed, entries))
    atomic_write_text(study.truth_path, json.dumps(whole, indent=2) + "\n")
    return study


def _plan(
    seed: int, designs: Sequence[str], frequencies_hz: Sequence[float], static: bool
) -> Iterator[_Planned]:
    """The trials asked for; a trial of a part is the same as in the whole."""
    index = 0
    for (design, frequency_hz), trials in study_plan.DYNAMIC.items():
        for peak_kpa, angle_deg, ratio in trials:
            index += 1
            if design not in designs or frequency_hz not in frequencies_hz:
                continue
            own_seed = _own_seed(seed, index)
            trial = CyclingTrial(
                frequency_hz=frequency_hz,
                peak_kpa=float(peak_kpa),
                angle_max_deg=angle_deg,
                hysteresis_ratio=ratio,
                residual_deg=study_plan.RESIDUAL[frequency_hz] * angle_deg,
                lag_s=study_plan.LAG_S[frequency_hz],
                peak_sd_deg=_PEAK_SD * angle_deg,
                ratio_sd=_RATIO_SD,
                seed=own_seed,
            )
            name = f"{design.replace(' ', '-')}_{frequency_hz:g}Hz_{peak_kpa:g}kPa"
            yield _Planned(name, design, trial, index, own_seed)
    for design, (angle_deg, rmse_deg) in study_plan.STATIC.items():
        index += 1
        if static and design in designs:
            stairs = StaircaseTrial(angle_deg, rmse_deg)
            yield _Planned(
                f"{design.replace(' ', '-')}_static", design, stairs, index, _own_seed(seed, index)
            )


def _own_seed(seed: int, index: int) -> int:
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


def _nominal(trial: CyclingTrial | StaircaseTrial) -> dict[str, Any]:
    if isinstance(trial, StaircaseTrial):
        return {"kind": "static"}
    return {"kind": "dynamic", "frequency_hz": trial.frequency_hz, "pressure_pp_kpa": trial.peak_kpa}


def _write(
    folder: Path, planned: _Planned, recording: Recording, given_delay: dict[str, float]
) -> dict[str, Any]:
    """Write the files of a trial; returns what the study file says of them."""
    name, trial = planned.name, planned.trial
    write_results(recording.angle_table(name), folder / "angles", name)
    entry: dict[str, Any] = {
        "angles": f"angles/{name}.csv",
        "log": _write_log(folder, name, recording, planned.index),
    }
    if isinstance(trial, CyclingTrial):
        return {**entry, "sync": {"method": "given delay", **given_delay}}
    if trial.model_rmse_deg is not None:
        entry["model"] = f"models/{name}.csv"
        pressure_kpa, angle_deg = trial.model_curve()
        write_csv_log(folder / entry["model"], {"pressure_kpa": pressure_kpa, "angle_deg": angle_deg})
    return {**entry, "sync": {"method": "sync event", "log_event": "pressure", "video_event": "angle"}}


def _write_log(folder: Path, name: str, recording: Recording, index: int) -> str:
    """Write the log in one of the forms; returns its path in the folder."""
    columns: dict[str, FloatArray] = {
        "time_s": recording.log_time_s,
        "pressure_kpa": recording.log_kpa,
        "reference_kpa": recording.reference_kpa,
    }
    form = index % 9
    path = f"logs/{name}.{'mat' if form in (2, 4, 6) else 'csv'}"
    if form == 2:
        write_matlab_5_log(folder / path, columns)
    elif form == 4:
        write_matlab_73_log(folder / path, columns)
    elif form == 6:
        write_simulink_log(folder / path, columns)
    elif form == 8:
        columns = {
            "Time (ms)": recording.log_time_s * 1000,
            "Pressure (psi)": recording.log_kpa / _KPA_IN_PSI,
            "Reference (psi)": recording.reference_kpa / _KPA_IN_PSI,
        }
        write_csv_log(folder / path, columns)
    else:
        write_csv_log(folder / path, columns)
    return path


def _tables(designs: Sequence[str], frequencies_hz: Sequence[float]) -> dict[str, Any]:
    """The paper's two tables of results, as far as the part of the study has their trials."""
    constant_angle = [
        asdict(row) | {"improvement": row.improvement}
        for row in study_plan.COMPARISONS
        if row.frequency_hz in frequencies_hz and {row.design, study_plan.BASELINE} <= set(designs)
    ]
    response = []
    for (design, frequency_hz), trials in study_plan.DYNAMIC.items():
        if design not in designs or frequency_hz not in frequencies_hz or study_plan.BASELINE not in designs:
            continue
        baseline = {kpa: angle for kpa, angle, _ in study_plan.DYNAMIC[study_plan.BASELINE, frequency_hz]}
        response += [
            {
                "frequency_hz": frequency_hz,
                "pressure_pp_kpa": float(kpa),
                "design": design,
                "baseline_deg": baseline[kpa],
                "angle_deg": angle,
                "improvement": (angle - baseline[kpa]) / baseline[kpa],
            }
            for kpa, angle, _ in trials
            if kpa in baseline and design != study_plan.BASELINE
        ]
    return {"constant_angle": constant_angle, "dynamic_response": response}


def _study_text(seed: int, entries: Sequence[dict[str, Any]]) -> str:
    document = tomlkit.document()
    document["title"] = f"Simulated study, seed {seed}"
    document["baseline"] = study_plan.BASELINE
    document["compare_angles_deg"] = sorted({row.angle_deg for row in study_plan.COMPARISONS})
    trials = tomlkit.aot()
    for entry in entries:
        table = tomlkit.table()
        for key, value in entry.items():
            if isinstance(value, dict):
                inline = tomlkit.inline_table()
                inline.update(value)
                value = inline
            table[key] = value
        trials.append(table)
    document["trials"] = trials
    return tomlkit.dumps(document)
