"""The report's summary: the main findings as sentences with intervals, from the results alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from .number_text import counted, plain_number
from .paper_tables import best_comparisons, interval_of, percent_of

if TYPE_CHECKING:
    from .analysis import StudyResults


def main_findings(results: StudyResults, labels: Mapping[str, str]) -> list[str]:
    """One or two sentences for each finding, the most important first; only what the data support.

    Parameters
    ----------
    results : StudyResults
        Results of the study.
    labels : mapping of str to str
        Label of each design, by its name.

    Returns
    -------
    list of str
        Plain text, one string for each finding.
    """
    return [
        *_ratios(results, labels),
        *_responses(results, labels),
        *_models(results, labels),
        *_control(results),
        *_trust(results),
    ]


def _ratios(results: StudyResults, labels: Mapping[str, str]) -> list[str]:
    found = []
    table = results.constant_angle
    for frequency, here in table.groupby("frequency_hz"):
        if here["improvement"].isna().all():
            reasons = _listed(list(dict.fromkeys(here["refused"])), most=2)
            found.append(
                f"At {frequency:g} Hz no hysteresis ratios could be compared at one angle: {reasons}."
            )
    for row in best_comparisons(table).to_dict("records"):
        own, other = labels[row["design"]], labels[row["baseline"]]
        where = f"At {row['angle_deg']:g}° and {row['frequency_hz']:g} Hz"
        ratio, other_ratio = interval_of(row, "design_ratio", 3), interval_of(row, "baseline_ratio", 3)
        verdict = f"an improvement of {percent_of(row, 'improvement')}, the largest of all designs"
        if row["improvement"] < 0:
            verdict = f"no design improves on {other} there (nearest: {percent_of(row, 'improvement')})"
        elif not row["improvement_low"] > 0:
            verdict += ", though the interval holds no difference as well"
        found.append(
            f"{where}, {own} has a hysteresis ratio of {ratio} and {other} one of {other_ratio}: {verdict}."
        )
    return found


def _responses(results: StudyResults, labels: Mapping[str, str]) -> list[str]:
    table = results.ranking
    table = table[(table["metric"] == "dynamic_response_deg") & table["pressure_pp_kpa"].notna()]
    if table.empty:  # no trial names its pressure: nothing is compared at one
        return []
    has_others = table.groupby(["frequency_hz", "pressure_pp_kpa"])["rank"].transform("size") > 1
    best = table[(table["rank"] == 1) & has_others]
    found = []
    for frequency, here in best.groupby("frequency_hz"):
        # The design that bends furthest at most pressures; at equal numbers the one that bends furthest of all.
        counts = here.groupby("design")["value"].agg(["size", "max"]).sort_values(["size", "max"])
        design = counts.index[-1]
        own = here[here["design"] == design]
        furthest = own.loc[own["value"].idxmax()].to_dict()
        pressures = _listed([f"{value:g}" for value in sorted(own["pressure_pp_kpa"])])
        sentence = (
            f"At {frequency:g} Hz, {labels[design]} bends furthest at {pressures} kPa peak to peak, to "
            f"{interval_of(furthest, 'value', 1)}° at {furthest['pressure_pp_kpa']:g} kPa"
        )
        gains = results.improvements
        gains = gains[
            (gains["metric"] == "dynamic_response_deg")
            & (gains["frequency_hz"] == frequency)
            & (gains["design"] == design)
            & gains["pressure_pp_kpa"].isin(own["pressure_pp_kpa"])
            & gains["improvement"].notna()
        ]["improvement"]
        if len(gains) and results.baseline is not None:
            span = sorted({f"{100 * value:.0f}" for value in (gains.min(), gains.max())}, key=float)
            sentence += f"; that is {' to '.join(span)} % more than {labels[results.baseline]}"
        found.append(f"{sentence}.")
    return found


def _models(results: StudyResults, labels: Mapping[str, str]) -> list[str]:
    compared = results.static[results.static["rmse_deg"].notna()].sort_values("nrmse")
    if compared.empty:
        return []
    each = [
        f"{labels[row['design']]} {interval_of(row, 'rmse_deg', 2)}° ({percent_of(row, 'nrmse')} of its range)"
        for row in compared.to_dict("records")
    ]
    return [f"Model against measured static curve, RMSE: {_listed(each)}."]


def _control(results: StudyResults) -> list[str]:
    known = results.control.dropna(subset=["rmse_kpa"])
    if known.empty:
        return []
    return [
        f"The pressure followed its reference with an RMSE of {plain_number(known['rmse_kpa'].max(), 2)} kPa or less, "
        f"{plain_number(100 * known['nrmse'].max(), 1)} % of its peak-to-peak or less, in "
        + (f"all {len(known)} trials that have one." if len(known) > 1 else "the trial that has one.")
    ]


def _trust(results: StudyResults) -> list[str]:
    found = []
    moved = results.dynamic.assign(size=results.dynamic["ratio_per_frame_shift"].abs()).dropna(
        subset=["size"]
    )
    if len(moved):
        worst = moved.sort_values("size").iloc[-1]
        found.append(
            f"A clock that is off by one frame would change a hysteresis ratio by "
            f"{plain_number(moved['size'].median(), 3)} (median), at most {plain_number(worst['size'], 3)} "
            f"(trial {worst['trial']}); the uncertainty of the clocks' shift is part of every interval."
        )
    lost = results.dynamic[results.dynamic["hysteresis_ratio"].isna()]["trial"]
    if len(lost):
        found.append(f"No hysteresis ratio could be given for {_listed(list(lost))}; the warnings say why.")
    if len(results.warnings):
        found.append(
            f"{counted(len(results.warnings), 'warning')} in"
            f" {counted(results.warnings['trial'].nunique(), 'trial')}: see the trials below."
        )
    return found


def _listed(words: list[str], most: int = 6) -> str:
    """Words joined as "a, b and c"; beyond `most` the rest are counted.

    >>> _listed(["40", "45", "50"])
    '40, 45 and 50'
    """
    if len(words) > most:
        words = [*words[:most], f"{len(words) - most} more"]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
