"""The report's tables, after the paper's: selected rows and columns, rounded to their intervals, as text.

Full precision and every row are in the CSVs (`tables.py`); tables are typeset by `latex.py` and `report_parts.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from .number_text import MISSING, plain_number, with_interval

if TYPE_CHECKING:
    from .analysis import StudyResults

Row = Mapping[Any, Any]


@dataclass(frozen=True)
class TableColumn:
    """A heading with its unit, and whether the column is set as numbers.

    Attributes
    ----------
    heading : str
        Heading, with the unit.
    numeric : bool
        Whether the cells are aligned as numbers.
    """

    heading: str
    numeric: bool = True


@dataclass(frozen=True)
class PaperTable:
    """A table as text.

    Attributes
    ----------
    name : str
        Name of its file, and of its label in LaTeX.
    caption, note : str
        Text above and below the table.
    columns : tuple of TableColumn
        Headings of the columns.
    rows : tuple of tuple of str
        One string for each column.
    grouped : bool
        Rows with the same first cell form a group; groups are separated by a line.
    """

    name: str
    caption: str
    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    grouped: bool = False


def paper_tables(results: StudyResults, labels: Mapping[str, str]) -> list[PaperTable]:
    """All tables of a study that have rows, the most important first.

    Parameters
    ----------
    results : StudyResults
        Results of the study.
    labels : mapping of str to str
        Label of each design, by its name.

    Returns
    -------
    list of PaperTable
        The tables.
    """
    tables = [
        _constant_angle(results, labels),
        _responses(results, labels),
        _ranking(results, labels),
        _trials(results, labels),
        _static(results, labels),
        _control(results),
    ]
    return [table for table in tables if table.rows]


def widest_comparisons(constant_angle: pd.DataFrame) -> pd.DataFrame:
    """Of each design at each frequency the comparison at the largest angle, where one could be made.

    Parameters
    ----------
    constant_angle : DataFrame
        `StudyResults.constant_angle`.

    Returns
    -------
    DataFrame
        Rows of it.
    """
    made = constant_angle.dropna(subset=["design_ratio", "baseline_ratio"])
    if made.empty:
        return made
    return made.loc[made.groupby(["frequency_hz", "design"], sort=False)["angle_deg"].idxmax()]


def best_comparisons(constant_angle: pd.DataFrame) -> pd.DataFrame:
    """At each frequency the design that improves most, of those in `widest_comparisons`.

    Parameters
    ----------
    constant_angle : DataFrame
        `StudyResults.constant_angle`.

    Returns
    -------
    DataFrame
        Rows of it, one per frequency.
    """
    widest = widest_comparisons(constant_angle).dropna(subset=["improvement"])
    if widest.empty:
        return widest
    return widest.loc[widest.groupby("frequency_hz")["improvement"].idxmax()]


def interval_note(results: StudyResults) -> str:
    """What "±" means in the tables.

    Parameters
    ----------
    results : StudyResults
        Results of the study.

    Returns
    -------
    str
        Text for the note of a table.
    """
    return f"± is half the {100 * results.confidence:g} % interval"


def interval_of(row: Row, column: str, decimals: int, *, scale: float = 1.0) -> str:
    """A column with its interval from a row of the results, times `scale`.

    Parameters
    ----------
    row : Row
        A row of a table of the results.
    column : str
        Name of a column with an interval.
    decimals : int
        Least number of decimals.
    scale : float, optional
        Factor.

    Returns
    -------
    str
        For example "0.279 ± 0.004".
    """
    value, low, high = (scale * float(row[name]) for name in (column, f"{column}_low", f"{column}_high"))
    return with_interval(value, low, high, decimals)


def percent_of(row: Row, column: str) -> str:
    """A fraction with its interval, in per cent.

    Parameters
    ----------
    row : Row
        A row of a table of the results.
    column : str
        Name of a column with an interval.

    Returns
    -------
    str
        For example "21.5 ± 1.2 %".
    """
    if not math.isfinite(row[column]):
        return MISSING
    return f"{interval_of(row, column, 1, scale=100)}\u00a0%"


def with_unit(value: float, unit: str) -> str:
    """A nominal value with its unit, as given; a dash where none was given.

    Parameters
    ----------
    value : float
        The number, NaN where not given.
    unit : str
        Its unit.

    Returns
    -------
    str
        For example "45 kPa".
    """
    return f"{value:g} {unit}" if math.isfinite(value) else MISSING


def _constant_angle(results: StudyResults, labels: Mapping[str, str]) -> PaperTable:
    baseline = labels.get(results.baseline or "", "baseline")
    widest = widest_comparisons(results.constant_angle)
    return PaperTable(
        name="hysteresis_ratio_at_one_angle",
        caption="Hysteresis ratio at one angle",
        columns=(
            TableColumn("Frequency"),
            TableColumn("Angle"),
            TableColumn("Design", numeric=False),
            TableColumn("Ratio"),
            TableColumn(f"Ratio, {baseline}"),
            TableColumn("Improvement"),
        ),
        rows=tuple(
            (
                with_unit(row["frequency_hz"], "Hz"),
                f"{row['angle_deg']:g}°",
                labels[row["design"]],
                interval_of(row, "design_ratio", 3),
                interval_of(row, "baseline_ratio", 3),
                percent_of(row, "improvement"),
            )
            for row in widest.sort_values(["frequency_hz", "improvement"], ascending=[True, False]).to_dict(
                "records"
            )
        ),
        note=(
            f"At the largest compared angle that the design and {baseline} both reach, by straight lines between "
            f"trials; all angles, and what was refused, in constant_angle.csv. {interval_note(results)}."
        ),
        grouped=True,
    )


def _responses(results: StudyResults, labels: Mapping[str, str]) -> PaperTable:
    baseline = labels.get(results.baseline or "", "baseline")
    table = results.improvements
    made = table[(table["metric"] == "dynamic_response_deg") & table["improvement"].notna()]
    order = made.sort_values(
        ["frequency_hz", "pressure_pp_kpa", "improvement"], ascending=[True, True, False]
    )
    return PaperTable(
        name="dynamic_response",
        caption="Dynamic response (largest bending angle) at one pressure",
        columns=(
            TableColumn("Frequency"),
            TableColumn("Pressure"),
            TableColumn("Design", numeric=False),
            TableColumn("Response (°)"),
            TableColumn(f"Response, {baseline} (°)"),
            TableColumn("Improvement"),
        ),
        rows=tuple(
            (
                with_unit(row["frequency_hz"], "Hz"),
                with_unit(row["pressure_pp_kpa"], "kPa"),
                labels[row["design"]],
                interval_of(row, "design_value", 2),
                interval_of(row, "baseline_value", 2),
                percent_of(row, "improvement"),
            )
            for row in order.to_dict("records")
        ),
        note=f"{interval_note(results)}.",
        grouped=True,
    )


def _ranking(results: StudyResults, labels: Mapping[str, str]) -> PaperTable:
    words = {"dynamic_response_deg": "dynamic response (°)", "hysteresis_ratio": "hysteresis ratio"}
    rows = []
    for row in results.ranking.to_dict("records"):
        by_angle = row["metric"] == "hysteresis_ratio"
        held = f"{row['angle_deg']:g}°" if by_angle else with_unit(row["pressure_pp_kpa"], "kPa")
        apart = row["apart_from_next"]
        rows.append(
            (
                f"{words[row['metric']]}, {with_unit(row['frequency_hz'], 'Hz')}, {held}",
                f"{row['rank']}",
                labels[row["design"]],
                interval_of(row, "value", 3 if by_angle else 2),
                MISSING if apart is None or apart != apart else ("yes" if apart else "no"),
            )
        )
    return PaperTable(
        name="ranking",
        caption="Designs in order, best first",
        columns=(
            TableColumn("Compared in", numeric=False),
            TableColumn("Rank"),
            TableColumn("Design", numeric=False),
            TableColumn("Value"),
            TableColumn("Apart from the next", numeric=False),
        ),
        rows=tuple(rows),
        note=(
            f"Larger dynamic responses and smaller ratios are better. Apart: the difference to the next design is "
            f"significant at {100 * (1 - results.confidence):g} % after Holm's correction for all pairs "
            f"compared under the same condition. {interval_note(results)}."
        ),
        grouped=True,
    )


_TRIAL_METRICS = (
    ("dynamic_response_deg", "Dynamic response (°)", 2),
    ("hysteresis_deg_kpa", "Hysteresis (° kPa)", 1),
    ("hysteresis_ratio", "Hysteresis ratio", 3),
    ("hysteresis_ratio_extremes", "Ratio to own extremes", 3),
    ("mid_width_deg", "Width at mid pressure (°)", 2),
    ("residual_angle_deg", "Residual angle (°)", 2),
)


def _trials(results: StudyResults, labels: Mapping[str, str]) -> PaperTable:
    used = results.cycles.groupby("trial")["used"].sum().astype(int).to_dict()
    complete = results.cycles.groupby("trial").size().to_dict()
    return PaperTable(
        name="dynamic_trials",
        caption="Dynamic trials",
        columns=(
            TableColumn("Design", numeric=False),
            TableColumn("Frequency"),
            TableColumn("Pressure"),
            TableColumn("Cycles used"),
            *(TableColumn(heading) for _, heading, _ in _TRIAL_METRICS),
            TableColumn("Ratio, one frame of shift"),
            TableColumn("Repeatability (°)"),
        ),
        rows=tuple(
            (
                labels[row["design"]],
                with_unit(row["frequency_hz"], "Hz"),
                with_unit(row["pressure_pp_kpa"], "kPa"),
                f"{used.get(row['trial'], 0)} of {complete.get(row['trial'], 0)}",
                *(interval_of(row, column, decimals) for column, _, decimals in _TRIAL_METRICS),
                plain_number(row["ratio_per_frame_shift"], 4),
                plain_number(row["repeatability_deg"], 2),
            )
            for row in results.dynamic.to_dict("records")
        ),
        note=(
            f"{interval_note(results)}. Shift: by how much the ratio would grow if the pressure were one frame "
            f"earlier. Repeatability: spread (standard deviation) of the angle between cycles, "
            f"one frame's noise included. More columns in dynamic.csv, every cycle in cycles.csv."
        ),
        grouped=True,
    )


def _static(results: StudyResults, labels: Mapping[str, str]) -> PaperTable:
    compared = results.static[results.static["rmse_deg"].notna()]
    return PaperTable(
        name="static_against_model",
        caption="Static curves against the model",
        columns=(
            TableColumn("Design", numeric=False),
            TableColumn("RMSE (°)"),
            TableColumn("NRMSE"),
            TableColumn("Range measured (°)"),
            TableColumn("Stairs"),
        ),
        rows=tuple(
            (
                labels[row["design"]],
                interval_of(row, "rmse_deg", 2),
                percent_of(row, "nrmse"),
                plain_number(row["range_deg"], 1),
                f"{row['stairs_compared']}",
            )
            for row in compared.to_dict("records")
        ),
        note=f"First pressurisation; NRMSE over the range of the measured curve. {interval_note(results)}.",
    )


def _control(results: StudyResults) -> PaperTable:
    table = results.control
    rows = []
    if len(table):
        waves = table.assign(frequency_hz=table["frequency_hz"].where(table["kind"] == "dynamic", 0.0))
        for _, here in waves.groupby(["frequency_hz", "pressure_pp_kpa"], dropna=False):
            frequency, pressure = here[["frequency_hz", "pressure_pp_kpa"]].to_numpy(float)[0]
            wave = "Staircase" if frequency == 0 else f"{frequency:g} Hz wave"
            pooled = {name: float(np.sqrt(np.mean(here[name] ** 2))) for name in ("rmse_kpa", "nrmse")}
            rows.append(
                (
                    wave,
                    with_unit(pressure, "kPa"),
                    f"{len(here)}",
                    plain_number(pooled["rmse_kpa"], 2),
                    f"{plain_number(100 * pooled['nrmse'], 2)} %",
                )
            )
    return PaperTable(
        name="control",
        caption="Tracking error of the pressure control",
        columns=(
            TableColumn("Reference", numeric=False),
            TableColumn("Pressure"),
            TableColumn("Trials"),
            TableColumn("RMSE (kPa)"),
            TableColumn("NRMSE"),
        ),
        rows=tuple(rows),
        note=(
            "Root mean square over the trials of a wave; NRMSE over the reference's peak-to-peak. "
            "Each trial in control.csv."
        ),
        grouped=True,
    )
