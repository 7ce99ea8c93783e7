"""A study's trials in, all its numbers out as tidy tables: one row per cycle, trial, stair or comparison.

The numbers are defined in `dynamic.py`, `static.py`, `control.py` and `comparison.py`. They are drawn and written
elsewhere.

Columns. A value with an interval is three columns, `x`, `x_low` and `x_high`; `x_sd` is its standard uncertainty.
Units end the names (`_deg`, `_kpa`, `_s`); ratios, relative changes and `nrmse` have none. NaN is a number
that the data do not support; `warnings`, or the column `reason` or `refused`, says why.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import pandas as pd

from ..errors import BendtrackError
from ..types import FloatArray
from .comparison import (
    Condition,
    Difference,
    Improvement,
    Rank,
    TrialPoint,
    conditions,
    differences,
    improvements,
    ranking,
)
from .control import ControlNumbers, tracking_error
from .dynamic import CycleNumbers, DynamicNumbers, measure_dynamic
from .intervals import NAN, Estimate
from .static import Stair, StaticNumbers, measure_static
from .trial import Kind, TrialData

# A measured wave whose frequency or pressure differs from the study file's by this fraction gets a warning.
_NOMINAL_FRACTION = 0.1


@dataclass(frozen=True)
class StudyResults:
    """All numbers of a study (columns: see `analysis.py`).

    Attributes
    ----------
    cycles : DataFrame
        One row a complete cycle of a dynamic trial; `used`, and the `reason` where it is not.
    dynamic : DataFrame
        One row a dynamic trial.
    static_steps : DataFrame
        One row a stair.
    static : DataFrame
        One row a static trial: model against measurement.
    control : DataFrame
        One row a trial with a reference wave: tracking error of the pressure.
    constant_angle : DataFrame
        Hysteresis ratio of each design and of the baseline at one angle, or why it is refused.
    improvements : DataFrame
        Each design against the baseline, dynamic response at each pressure and ratio at each angle.
    ranking : DataFrame
        Designs from best to worst under each condition; `apart_from_next` after Holm's correction.
    pairwise : DataFrame
        Every difference of two designs; `p_holm` corrects for all pairs under the same condition.
    loops : dict of str to list of ndarray of float
        (N, 2) kPa and deg of every cycle that could be measured, by trial.
    warnings : DataFrame
        Columns trial, warning.
    confidence : float
        Confidence level of all intervals.
    baseline : str or None
        The design that improvements refer to, or None.
    """

    cycles: pd.DataFrame
    dynamic: pd.DataFrame
    static_steps: pd.DataFrame
    static: pd.DataFrame
    control: pd.DataFrame
    constant_angle: pd.DataFrame
    improvements: pd.DataFrame
    ranking: pd.DataFrame
    pairwise: pd.DataFrame
    loops: dict[str, list[FloatArray]]
    warnings: pd.DataFrame
    confidence: float
    baseline: str | None


def analyse_study(
    trials: Iterable[TrialData],
    *,
    baseline: str | None,
    confidence: float = 0.95,
    angles_deg: Sequence[float] | None = None,
) -> StudyResults:
    """Analyse all trials of a study.

    Parameters
    ----------
    trials : iterable of TrialData
        Trials, each read once and not kept.
    baseline : str or None
        Design that the improvements refer to; None for no improvements.
    confidence : float, optional
        Confidence level of the intervals, between 0 and 1.
    angles_deg : sequence of float or None, optional
        Angles at which hysteresis ratios are compared; None for the multiples of 5 degrees that both designs reach.

    Returns
    -------
    StudyResults
        All tables of the study.

    Raises
    ------
    BendtrackError
        No trial at all, two of one name, a confidence out of range, or a baseline that no trial has.
    """
    if not 0 < confidence < 1:
        raise BendtrackError(f"expected a confidence between 0 and 1, got {confidence:g}")
    gathered = _TableRows(confidence)
    for trial in trials:
        gathered.add(trial)
    if not gathered.names:
        raise BendtrackError("expected at least one trial, got none")
    if baseline is not None and baseline not in gathered.designs:
        raise BendtrackError(
            f"expected a baseline among the designs ({', '.join(gathered.designs)}), got '{baseline}'"
        )
    points = gathered.points
    compared = [] if baseline is None else improvements(points, baseline, angles_deg)
    improved = _table(Improvement, compared, confidence)
    under = conditions(points, angles_deg)
    ranks = [rank for condition in under for rank in ranking(points, condition, confidence)]
    pairs = [pair for condition in under for pair in differences(points, condition)]
    pairwise = _table(Difference, pairs, confidence)
    pairwise["differs"] = [None if math.isnan(p) else p < 1 - confidence for p in pairwise["p_holm"]]
    return StudyResults(
        cycles=pd.DataFrame(gathered.cycles, columns=[*_TRIAL_COLUMNS, *_columns(CycleNumbers)]),
        dynamic=pd.DataFrame(
            gathered.dynamic, columns=[*_TRIAL_COLUMNS, *_columns(DynamicNumbers), *_CLOCK_COLUMNS]
        ),
        static_steps=pd.DataFrame(gathered.stairs, columns=[*_TRIAL_COLUMNS, *_columns(Stair)]),
        static=pd.DataFrame(gathered.static, columns=[*_TRIAL_COLUMNS, *_columns(StaticNumbers)]),
        control=pd.DataFrame(gathered.control, columns=[*_TRIAL_COLUMNS, *_columns(ControlNumbers)]),
        constant_angle=_constant_angle(improved),
        improvements=improved,
        ranking=_table(Rank, ranks, confidence),
        pairwise=pairwise,
        loops=gathered.loops,
        warnings=pd.DataFrame(gathered.warnings, columns=["trial", "warning"]),
        confidence=confidence,
        baseline=baseline,
    )


class _TableRows:
    """Rows of the tables, collected trial by trial."""

    def __init__(self, confidence: float) -> None:
        self.confidence = confidence
        self.names: set[str] = set()
        self.designs: list[str] = []
        self.points: list[TrialPoint] = []
        self.cycles: list[dict[str, Any]] = []
        self.dynamic: list[dict[str, Any]] = []
        self.stairs: list[dict[str, Any]] = []
        self.static: list[dict[str, Any]] = []
        self.control: list[dict[str, Any]] = []
        self.loops: dict[str, list[FloatArray]] = {}
        self.warnings: list[tuple[str, str]] = []

    def add(self, trial: TrialData) -> None:
        if trial.name in self.names:
            raise BendtrackError(f"expected trials of different names, got two called '{trial.name}'")
        self.names.add(trial.name)
        if trial.design not in self.designs:
            self.designs.append(trial.design)
        self._warn(trial, trial.warnings)
        if trial.kind is Kind.DYNAMIC:
            self._add_dynamic(trial)
        else:
            self._add_static(trial)
        control = tracking_error(trial)
        if control is not None:
            self.control.append(self._row(trial, control))

    def _add_dynamic(self, trial: TrialData) -> None:
        numbers = measure_dynamic(trial)
        self._warn(trial, numbers.warnings)
        self._warn(trial, _off_nominal(trial, numbers))
        self.loops[trial.name] = list(numbers.loops)
        self.cycles += [self._row(trial, cycle) for cycle in numbers.cycles]
        clock = (trial.shift.method, trial.shift.delay_s, trial.shift_sd_s, trial.frame_s)
        self.dynamic.append({**self._row(trial, numbers), **dict(zip(_CLOCK_COLUMNS, clock, strict=True))})
        # As measured where the study file does not say; rounded, so that equal trials are grouped.
        measured_hz = _rounded(1 / numbers.period_s)
        frequency_hz = measured_hz if trial.frequency_hz is None else trial.frequency_hz
        if math.isfinite(frequency_hz):
            self.points.append(
                TrialPoint(
                    trial=trial.name,
                    design=trial.design,
                    frequency_hz=frequency_hz,
                    pressure_pp_kpa=NAN if trial.pressure_pp_kpa is None else trial.pressure_pp_kpa,
                    dynamic_response_deg=numbers.dynamic_response_deg,
                    hysteresis_ratio=numbers.hysteresis_ratio,
                )
            )

    def _add_static(self, trial: TrialData) -> None:
        numbers = measure_static(trial)
        self._warn(trial, numbers.warnings)
        self.stairs += [self._row(trial, stair) for stair in numbers.stairs]
        self.static.append(self._row(trial, numbers))

    def _row(self, trial: TrialData, numbers: object) -> dict[str, Any]:
        nominal = (NAN if value is None else value for value in (trial.frequency_hz, trial.pressure_pp_kpa))
        of_trial = (trial.name, trial.design, str(trial.kind), *nominal)
        return {**dict(zip(_TRIAL_COLUMNS, of_trial, strict=True)), **_flat(numbers, self.confidence)}

    def _warn(self, trial: TrialData, warnings: Iterable[str]) -> None:
        self.warnings += [(trial.name, warning) for warning in warnings]


_TRIAL_COLUMNS = ("trial", "design", "kind", "frequency_hz", "pressure_pp_kpa")
_CLOCK_COLUMNS = ("shift_method", "shift_delay_s", "shift_sd_s", "frame_s")
_INTERVAL = ("", "_low", "_high", "_sd")
# Fields that are no numbers: they have a table of their own.
_NOT_COLUMNS = ("cycles", "loops", "stairs", "warnings")


def _columns(kind: type) -> list[str]:
    """Columns of a dataclass of numbers: one a plain field, four an Estimate, a Condition's own."""
    found: list[str] = []
    for field in fields(kind):
        if field.type == "Condition":
            found += _columns(Condition)
        elif field.type == "Estimate":
            found += [field.name + ending for ending in _INTERVAL]
        elif field.name not in _NOT_COLUMNS:
            found.append(field.name)
    return found


def _flat(numbers: Any, confidence: float) -> dict[str, Any]:
    """One row: a value for each of `_columns`."""
    row: dict[str, Any] = {}
    for field in fields(numbers):
        value = getattr(numbers, field.name)
        if isinstance(value, Condition):
            row.update(asdict(value))
        elif isinstance(value, Estimate):
            spread = (value.value, *value.interval(confidence), value.sd)
            row.update(zip([field.name + ending for ending in _INTERVAL], spread, strict=True))
        elif field.name not in _NOT_COLUMNS:
            row[field.name] = value
    return row


def _table(kind: type, items: Sequence[Any], confidence: float) -> pd.DataFrame:
    return pd.DataFrame([_flat(item, confidence) for item in items], columns=_columns(kind))


def _constant_angle(improved: pd.DataFrame) -> pd.DataFrame:
    """The comparisons at one angle, as a table of their own."""
    at_angle = improved[improved["metric"] == "hysteresis_ratio"].drop(columns=["metric", "pressure_pp_kpa"])
    names = {name: name.replace("_value", "_ratio") for name in at_angle.columns}
    return at_angle.rename(columns=names).reset_index(drop=True)


def _off_nominal(trial: TrialData, numbers: DynamicNumbers) -> list[str]:
    """Warnings where the measured wave differs from the study file's."""
    found = []
    checks = (
        ("frequency", trial.frequency_hz, 1 / numbers.period_s if numbers.period_s else NAN, "Hz"),
        ("peak-to-peak pressure", trial.pressure_pp_kpa, numbers.amplitude_kpa, "kPa"),
    )
    for name, nominal, measured, unit in checks:
        if nominal and abs(measured - nominal) > _NOMINAL_FRACTION * nominal:
            found.append(f"the {name} is {measured:.3g} {unit}, the study file says {nominal:g} {unit}")
    return found


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")
