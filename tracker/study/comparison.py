"""Designs compared: at one angle, at one pressure, against the baseline, ranked, and in pairs.

The trials' values come from `dynamic.py`. Trials are taken as independent, their clock shifts included.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby

import numpy as np

from .intervals import NAN, Estimate, combined, holm_adjusted

# Without given angles, designs are compared at the multiples of this that both reach.
_ANGLE_STEP_DEG = 5.0


@dataclass(frozen=True)
class TrialPoint:
    """Values of a dynamic trial that enter the comparison.

    Attributes
    ----------
    trial, design : str
        Names of the trial and of its design.
    frequency_hz : float
        Frequency of the wave, Hz.
    pressure_pp_kpa : float
        Nominal peak-to-peak pressure, kPa.
    dynamic_response_deg : Estimate
        Largest bending angle, degrees.
    hysteresis_ratio : Estimate
        The paper's ratio, 0 to 1.
    """

    trial: str
    design: str
    frequency_hz: float
    pressure_pp_kpa: float
    dynamic_response_deg: Estimate
    hysteresis_ratio: Estimate


@dataclass(frozen=True)
class Condition:
    """A condition of comparison: the wave's frequency, and either a pressure or an angle (the other is NaN).

    Attributes
    ----------
    metric : str
        "dynamic_response_deg" or "hysteresis_ratio".
    frequency_hz : float
        Frequency of the wave, Hz.
    pressure_pp_kpa : float
        Peak-to-peak pressure, kPa; NaN for a condition at one angle.
    angle_deg : float
        Largest angle, degrees; NaN for a condition at one pressure.
    """

    metric: str
    frequency_hz: float
    pressure_pp_kpa: float = NAN
    angle_deg: float = NAN

    @property
    def higher_is_better(self) -> bool:
        """Whether a larger value is the better one (dynamic response) or a smaller one (hysteresis ratio)."""
        return self.metric == "dynamic_response_deg"


@dataclass(frozen=True)
class Improvement:
    """A design against the baseline under one condition; NaN and a reason where they cannot be compared.

    `improvement` is (new - original) / original for the dynamic response and (original - new) / original for the
    hysteresis ratio: above 0 is better.

    Attributes
    ----------
    condition : Condition
        The condition.
    design, baseline : str
        Names of the two designs.
    design_value, baseline_value : Estimate
        Values of the two designs under the condition.
    improvement : Estimate
        Fraction of the baseline's value.
    refused : str
        Reason why there is no improvement, else empty.
    """

    condition: Condition
    design: str
    baseline: str
    design_value: Estimate
    baseline_value: Estimate
    improvement: Estimate
    refused: str


@dataclass(frozen=True)
class Difference:
    """Design a minus design b under one condition. `p_holm` is adjusted over all pairs under the condition.

    Attributes
    ----------
    condition : Condition
        The condition.
    design_a, design_b : str
        Names of the two designs.
    difference : Estimate
        Value of a minus value of b.
    p_value : float
        Two-sided p-value of the difference.
    p_holm : float
        The same after Holm's correction.
    """

    condition: Condition
    design_a: str
    design_b: str
    difference: Estimate
    p_value: float
    p_holm: float


@dataclass(frozen=True)
class Rank:
    """A design's rank under one condition, 1 the best. `apart_from_next`: it differs from the next.

    None for the last, and where the uncertainty is not known.

    Attributes
    ----------
    condition : Condition
        The condition.
    rank : int
        From 1, the best.
    design : str
        Name of the design.
    value : Estimate
        Its value under the condition.
    apart_from_next : bool or None
        Whether the difference to the next design is significant.
    """

    condition: Condition
    rank: int
    design: str
    value: Estimate
    apart_from_next: bool | None


def ratio_at_angle(points: Sequence[TrialPoint], angle_deg: float) -> tuple[Estimate, str]:
    """Hysteresis ratio of one design at one frequency, at an angle between its trials' largest angles.

    Piecewise linear in the largest angle (the study's constant-angle comparison), with the uncertainty of the
    ratios and angles of the two trials between which it is interpolated.

    Parameters
    ----------
    points : sequence of TrialPoint
        Trials of one design at one frequency.
    angle_deg : float
        Largest angle, degrees.

    Returns
    -------
    ratio : Estimate
        NaN where refused.
    refused : str
        The reason for a refusal, empty where the ratio is given.
    """
    nodes = sorted(_nodes(points), key=lambda node: node[0].value)
    if not nodes:
        return Estimate(NAN), "no trial has both a largest angle and a hysteresis ratio"
    angles = [angle.value for angle, _ in nodes]
    if len(nodes) == 1 or not angles[0] <= angle_deg <= angles[-1]:
        reach = f"{angles[0]:.1f} deg only" if len(nodes) == 1 else f"{angles[0]:.1f} to {angles[-1]:.1f} deg"
        return Estimate(NAN), f"its trials reach {reach}, not {angle_deg:g} deg"
    index = min(max(int(np.searchsorted(angles, angle_deg)), 1), len(nodes) - 1)
    (angle_a, ratio_a), (angle_b, ratio_b) = nodes[index - 1], nodes[index]
    step = angle_b.value - angle_a.value
    if not step > 0:
        return combined((ratio_a.value + ratio_b.value) / 2, [(0.5, ratio_a), (0.5, ratio_b)]), ""
    fraction = (angle_deg - angle_a.value) / step
    slope = (ratio_b.value - ratio_a.value) / step
    value = (1 - fraction) * ratio_a.value + fraction * ratio_b.value
    parts = [
        (1 - fraction, ratio_a),
        (fraction, ratio_b),
        (-slope * (1 - fraction), angle_a),
        (-slope * fraction, angle_b),
    ]
    return combined(value, [(weight, part) for weight, part in parts if weight != 0]), ""


def improvements(
    points: Sequence[TrialPoint], baseline: str, angles_deg: Sequence[float] | None = None
) -> list[Improvement]:
    """Every design against the baseline: dynamic response at each pressure, hysteresis ratio at each angle.

    `angles_deg` None: at the multiples of 5 degrees that both reach. A comparison that cannot be made is listed
    with its reason.

    Parameters
    ----------
    points : sequence of TrialPoint
        All dynamic trials.
    baseline : str
        Name of the baseline design.
    angles_deg : sequence of float or None, optional
        Angles at which ratios are compared, degrees.

    Returns
    -------
    list of Improvement
        One entry per design and condition.
    """
    found: list[Improvement] = []
    for frequency, here in _by_frequency(points):
        designs = _designs(here)
        if baseline not in designs:
            continue
        original = [point for point in here if point.design == baseline]
        for design in designs:
            if design == baseline:
                continue
            own = [point for point in here if point.design == design]
            for pressure in _pressures(here):
                condition = Condition("dynamic_response_deg", frequency, pressure_pp_kpa=pressure)
                found.append(_improvement(condition, design, baseline, own, original))
            for angle in _angles(own, original) if angles_deg is None else angles_deg:
                condition = Condition("hysteresis_ratio", frequency, angle_deg=angle)
                found.append(_improvement(condition, design, baseline, own, original))
    return found


def conditions(points: Sequence[TrialPoint], angles_deg: Sequence[float] | None = None) -> list[Condition]:
    """Conditions of the ranking and the pairwise comparison: every pressure, and angles at every frequency.

    `angles_deg` None: the multiple of 5 degrees that most designs reach, the largest if there are several.

    Parameters
    ----------
    points : sequence of TrialPoint
        All dynamic trials.
    angles_deg : sequence of float or None, optional
        Angles at which ratios are compared, degrees.

    Returns
    -------
    list of Condition
        The conditions, by frequency.
    """
    found: list[Condition] = []
    for frequency, here in _by_frequency(points):
        found += [Condition("dynamic_response_deg", frequency, pressure_pp_kpa=p) for p in _pressures(here)]
        angles = _common_angle(here) if angles_deg is None else angles_deg
        found += [Condition("hysteresis_ratio", frequency, angle_deg=angle) for angle in angles]
    return found


def value_under(points: Sequence[TrialPoint], condition: Condition) -> tuple[Estimate, str]:
    """One design's value under a condition, or the reason why there is none; repeated trials are averaged.

    Parameters
    ----------
    points : sequence of TrialPoint
        Trials of one design.
    condition : Condition
        The condition.

    Returns
    -------
    value : Estimate
        NaN where there is none.
    refused : str
        The reason for it, else empty.
    """
    here = [point for point in points if point.frequency_hz == condition.frequency_hz]
    if condition.metric == "hysteresis_ratio":
        return ratio_at_angle(here, condition.angle_deg)
    values = [
        point.dynamic_response_deg
        for point in here
        if point.pressure_pp_kpa == condition.pressure_pp_kpa
        and math.isfinite(point.dynamic_response_deg.value)
    ]
    if not values:
        return Estimate(NAN), f"no trial at {condition.pressure_pp_kpa:g} kPa with a largest angle"
    return _averaged(values), ""


def differences(points: Sequence[TrialPoint], condition: Condition) -> list[Difference]:
    """Every pair of designs that both have a value under the condition; Holm's correction over these pairs.

    Parameters
    ----------
    points : sequence of TrialPoint
        All dynamic trials.
    condition : Condition
        The condition.

    Returns
    -------
    list of Difference
        One entry per pair.
    """
    values = _values(points, condition)
    pairs = list(combinations(values, 2))
    found = [combined(values[a].value - values[b].value, [(1, values[a]), (1, values[b])]) for a, b in pairs]
    p_values = [estimate.p_value() for estimate in found]
    return [
        Difference(condition, a, b, estimate, p, adjusted)
        for (a, b), estimate, p, adjusted in zip(pairs, found, p_values, holm_adjusted(p_values), strict=True)
    ]


def ranking(points: Sequence[TrialPoint], condition: Condition, confidence: float) -> list[Rank]:
    """Designs from best to worst; neighbours differ significantly where their Holm-adjusted p-value is small.

    Parameters
    ----------
    points : sequence of TrialPoint
        All dynamic trials.
    condition : Condition
        The condition.
    confidence : float
        Confidence level, 0 to 1; differences are tested at 1 - `confidence`.

    Returns
    -------
    list of Rank
        One entry per design, the best first.
    """
    values = _values(points, condition)
    order = sorted(values, key=lambda design: values[design].value, reverse=condition.higher_is_better)
    adjusted = {frozenset((d.design_a, d.design_b)): d.p_holm for d in differences(points, condition)}
    ranks = []
    for index, design in enumerate(order):
        p = adjusted[frozenset((design, order[index + 1]))] if index + 1 < len(order) else NAN
        apart = None if math.isnan(p) else p < 1 - confidence
        ranks.append(Rank(condition, index + 1, design, values[design], apart))
    return ranks


def _improvement(
    condition: Condition,
    design: str,
    baseline: str,
    own: Sequence[TrialPoint],
    original: Sequence[TrialPoint],
) -> Improvement:
    if condition.metric == "hysteresis_ratio" and math.isnan(condition.angle_deg):
        reason = f"there is no multiple of {_ANGLE_STEP_DEG:g} deg that both reach: " + "; ".join(
            f"{name} {_reach(points)}" for name, points in ((design, own), (baseline, original))
        )
        return Improvement(condition, design, baseline, Estimate(NAN), Estimate(NAN), Estimate(NAN), reason)
    new, new_refused = value_under(own, condition)
    old, old_refused = value_under(original, condition)
    refused = "; ".join(
        f"{name}: {reason}" for name, reason in ((design, new_refused), (baseline, old_refused)) if reason
    )
    improvement = Estimate(NAN)
    if not refused and not old.value > 0:
        refused = f"{baseline}: its value is {old.value:g}, not above 0"
    if not refused:
        sign = 1 if condition.higher_is_better else -1
        improvement = combined(
            sign * (new.value - old.value) / old.value,
            [(1 / old.value, new), (new.value / old.value**2, old)],
        )
    return Improvement(condition, design, baseline, new, old, improvement, refused)


def _nodes(points: Iterable[TrialPoint]) -> list[tuple[Estimate, Estimate]]:
    """(largest angle, ratio) at each pressure; repeated trials at one pressure are averaged."""
    known = [p for p in points if math.isfinite(p.hysteresis_ratio.value * p.dynamic_response_deg.value)]
    known.sort(key=lambda point: point.pressure_pp_kpa)
    nodes = []
    for pressure, group in groupby(known, key=lambda point: point.pressure_pp_kpa):
        same = list(group)
        apart = [[p] for p in same] if math.isnan(pressure) else [same]
        nodes += [
            (_averaged([p.dynamic_response_deg for p in part]), _averaged([p.hysteresis_ratio for p in part]))
            for part in apart
        ]
    return nodes


def _averaged(values: Sequence[Estimate]) -> Estimate:
    """Mean of trials under the same condition; its uncertainty is the larger of the trials' own and their spread."""
    if len(values) == 1:
        return values[0]
    mean = float(np.mean([value.value for value in values]))
    own = combined(mean, [(1 / len(values), value) for value in values])
    spread = float(np.std([value.value for value in values], ddof=1)) / math.sqrt(len(values))
    if spread > own.sd:
        return Estimate(mean, spread, len(values) - 1)
    return own


def _values(points: Sequence[TrialPoint], condition: Condition) -> dict[str, Estimate]:
    found = {
        design: value_under([p for p in points if p.design == design], condition)[0]
        for design in _designs(points)
    }
    return {design: value for design, value in found.items() if math.isfinite(value.value)}


def _by_frequency(points: Iterable[TrialPoint]) -> list[tuple[float, list[TrialPoint]]]:
    ordered = sorted(points, key=lambda point: point.frequency_hz)
    return [(frequency, list(group)) for frequency, group in groupby(ordered, key=lambda p: p.frequency_hz)]


def _designs(points: Iterable[TrialPoint]) -> list[str]:
    return list(dict.fromkeys(point.design for point in points))


def _pressures(points: Iterable[TrialPoint]) -> list[float]:
    return sorted({p.pressure_pp_kpa for p in points if math.isfinite(p.pressure_pp_kpa)})


def _reached(points: Iterable[TrialPoint]) -> tuple[float, float]:
    """Smallest and largest of the trials' largest angles; (inf, -inf) with fewer than two trials."""
    angles = [angle.value for angle, _ in _nodes(points)]
    return (min(angles), max(angles)) if len(angles) > 1 else (math.inf, -math.inf)


def _reach(points: Iterable[TrialPoint]) -> str:
    low, high = _reached(points)
    return f"reaches {low:.1f} to {high:.1f} deg" if low <= high else "has fewer than two trials with a ratio"


def _angles(own: Sequence[TrialPoint], original: Sequence[TrialPoint]) -> list[float]:
    """Multiples of 5 degrees that both reach; [NaN] where there is none, so that the refusal is listed."""
    (low_a, high_a), (low_b, high_b) = _reached(own), _reached(original)
    low, high = max(low_a, low_b), min(high_a, high_b)
    return _multiples(low, high) or [NAN]


def _common_angle(points: Sequence[TrialPoint]) -> list[float]:
    reaches = [_reached([p for p in points if p.design == design]) for design in _designs(points)]
    reaches = [reach for reach in reaches if reach[0] <= reach[1]]
    if len(reaches) < 2:
        return []
    angles = _multiples(min(low for low, _ in reaches), max(high for _, high in reaches))
    if not angles:
        return []
    counts = [sum(low <= angle <= high for low, high in reaches) for angle in angles]
    most = max(counts)
    return (
        [max(angle for angle, count in zip(angles, counts, strict=True) if count == most)] if most > 1 else []
    )


def _multiples(low: float, high: float) -> list[float]:
    if not low <= high:
        return []
    first, last = math.ceil(low / _ANGLE_STEP_DEG), math.floor(high / _ANGLE_STEP_DEG)
    return [number * _ANGLE_STEP_DEG for number in range(first, last + 1)]
