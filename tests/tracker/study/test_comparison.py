"""Designs compared: interpolation, refusals, improvements, ranking and pairs, worked out by hand."""

import math

import numpy as np
import pytest

from bendtrack.tracker.study.comparison import (
    Condition,
    TrialPoint,
    conditions,
    differences,
    improvements,
    ranking,
    ratio_at_angle,
    value_under,
)
from bendtrack.tracker.study.intervals import Estimate


def point(design, pressure, angle, ratio, frequency=0.25, angle_sd=0.1, ratio_sd=0.002, trial=""):
    return TrialPoint(
        trial=trial or f"{design} {frequency} {pressure}",
        design=design,
        frequency_hz=frequency,
        pressure_pp_kpa=pressure,
        dynamic_response_deg=Estimate(angle, angle_sd, 10),
        hysteresis_ratio=Estimate(ratio, ratio_sd, 10),
    )


# The paper's dynamic responses at 0.25 Hz, and ratios on straight lines.
ORIGINAL = [
    point("original", 40, 29.34, 0.34),
    point("original", 45, 40.57, 0.33),
    point("original", 50, 63.92, 0.31),
]
SMALLER = [
    point("smaller", 40, 50.19, 0.26),
    point("smaller", 45, 85.91, 0.24),
    point("smaller", 50, 118.06, 0.23),
]
POINTS = [*ORIGINAL, *SMALLER]


def test_the_ratio_between_two_trials_lies_on_their_line():
    ratio, refused = ratio_at_angle(SMALLER, 70.0)
    share = (70 - 50.19) / (85.91 - 50.19)
    assert refused == ""
    assert ratio.value == pytest.approx(0.26 + share * (0.24 - 0.26))
    slope = -0.02 / (85.91 - 50.19)
    by_ratio = np.hypot((1 - share) * 0.002, share * 0.002)
    by_angle = abs(slope) * np.hypot((1 - share) * 0.1, share * 0.1)
    assert ratio.sd == pytest.approx(np.hypot(by_ratio, by_angle))


@pytest.mark.parametrize(("angle", "expected"), [(50.19, 0.26), (85.91, 0.24), (118.06, 0.23)])
def test_at_a_trial_the_ratio_is_that_trials(angle, expected):
    assert ratio_at_angle(SMALLER, angle)[0].value == pytest.approx(expected)
    assert ratio_at_angle(SMALLER[::-1], angle)[0].value == pytest.approx(expected)


@pytest.mark.parametrize("angle", [50.0, 118.1, -5.0, 500.0])
def test_outside_what_the_trials_reach_it_is_refused(angle):
    ratio, refused = ratio_at_angle(SMALLER, angle)
    assert math.isnan(ratio.value)
    assert refused == f"its trials reach 50.2 to 118.1 deg, not {angle:g} deg"


def test_one_trial_is_no_line():
    assert "50.2 deg only" in ratio_at_angle(SMALLER[:1], 50.19)[1]
    assert "no trial has both" in ratio_at_angle([point("a", 40, math.nan, 0.3)], 50)[1]


def test_improvements_as_the_paper_counts_them():
    found = improvements(POINTS, "original")
    at_pressure = {
        i.condition.pressure_pp_kpa: i for i in found if i.condition.metric == "dynamic_response_deg"
    }
    # The paper's table of dynamic response at 0.25 Hz: 71, 112 and 85 %.
    percent = [round(100 * at_pressure[p].improvement.value) for p in (40, 45, 50)]
    assert percent == [71, 112, 85]
    first = at_pressure[40].improvement
    assert first.sd == pytest.approx(np.hypot(0.1 / 29.34, 50.19 * 0.1 / 29.34**2))
    at_angle = {i.condition.angle_deg: i for i in found if i.condition.metric == "hysteresis_ratio"}
    assert list(at_angle) == [55.0, 60.0]  # the multiples of 5 from 50.19 to 63.92
    old, new = ratio_at_angle(ORIGINAL, 60)[0].value, ratio_at_angle(SMALLER, 60)[0].value
    assert at_angle[60].improvement.value == pytest.approx((old - new) / old)
    assert at_angle[60].improvement.value > 0  # less hysteresis is better


def test_an_angle_that_one_does_not_reach_is_refused_with_both_reasons():
    (found,) = [
        i for i in improvements(POINTS, "original", [130.0]) if i.condition.metric == "hysteresis_ratio"
    ]
    assert math.isnan(found.improvement.value)
    assert found.refused == (
        "smaller: its trials reach 50.2 to 118.1 deg, not 130 deg; "
        "original: its trials reach 29.3 to 63.9 deg, not 130 deg"
    )


def test_designs_without_a_common_angle_are_refused_once():
    high = [point("high", 40, 150, 0.2), point("high", 45, 180, 0.2)]
    (found,) = [
        i for i in improvements([*ORIGINAL, *high], "original") if i.condition.metric == "hysteresis_ratio"
    ]
    assert "no multiple of 5 deg that both reach" in found.refused
    assert "high reaches 150.0 to 180.0 deg" in found.refused
    assert "original reaches 29.3 to 63.9 deg" in found.refused


def test_a_pressure_that_only_one_was_tried_at():
    more = [*POINTS, point("original", 55, 92.6, 0.3)]
    (found,) = [i for i in improvements(more, "original") if i.condition.pressure_pp_kpa == 55]
    assert found.refused == "smaller: no trial at 55 kPa with a largest angle"


def test_frequencies_are_never_mixed():
    slow = [point("original", 40, 45.44, 0.3, frequency=0.0625)]
    value, _ = value_under([*ORIGINAL, *slow], Condition("dynamic_response_deg", 0.0625, pressure_pp_kpa=40))
    assert value.value == 45.44


def test_repeated_trials_are_averaged_with_their_spread():
    twice = [point("a", 40, 50, 0.3), point("a", 40, 54, 0.3, trial="again")]
    value, _ = value_under(twice, Condition("dynamic_response_deg", 0.25, pressure_pp_kpa=40))
    assert (value.value, value.sd, value.dof) == pytest.approx((52, 2, 1))
    alike = [point("a", 40, 50, 0.3), point("a", 40, 50, 0.3, trial="again")]
    value, _ = value_under(alike, Condition("dynamic_response_deg", 0.25, pressure_pp_kpa=40))
    assert (value.value, value.sd) == pytest.approx((50, 0.1 / 2**0.5))


def test_every_pair_with_its_interval_and_holms_correction():
    three = [point("a", 40, 50.0, 0.3), point("b", 40, 50.3, 0.3), point("c", 40, 60.0, 0.3)]
    found = differences(three, Condition("dynamic_response_deg", 0.25, pressure_pp_kpa=40))
    assert [(d.design_a, d.design_b) for d in found] == [("a", "b"), ("a", "c"), ("b", "c")]
    first = found[0]
    assert (first.difference.value, first.difference.sd) == pytest.approx((-0.3, 0.1 * 2**0.5))
    assert first.difference.dof == pytest.approx(20)  # two of 10 with the same variance
    assert first.p_value == pytest.approx(0.0466, abs=0.0005)  # Student, t = 2.121, 20 degrees of freedom
    assert first.p_holm == pytest.approx(first.p_value)  # the largest of three is multiplied by one
    assert found[2].p_holm < 0.001


def test_ranking_knows_what_is_better_and_who_is_apart():
    three = [point("a", 40, 50.0, 0.30), point("b", 40, 50.1, 0.25), point("c", 40, 60.0, 0.2)]
    ranks = ranking(three, Condition("dynamic_response_deg", 0.25, pressure_pp_kpa=40), 0.95)
    assert [(r.rank, r.design, r.apart_from_next) for r in ranks] == [
        (1, "c", True),
        (2, "b", False),
        (3, "a", None),
    ]
    lines = [*three, point("a", 45, 70, 0.30), point("b", 45, 70, 0.25), point("c", 45, 70, 0.2)]
    ranks = ranking(lines, Condition("hysteresis_ratio", 0.25, angle_deg=65), 0.95)
    assert [r.design for r in ranks] == ["c", "b", "a"]


def test_designs_are_ranked_at_the_angle_that_most_of_them_reach():
    found = conditions([*POINTS, point("low", 40, 10, 0.3), point("low", 45, 20, 0.3)])
    assert [c.pressure_pp_kpa for c in found if c.metric == "dynamic_response_deg"] == [40, 45, 50]
    assert [c.angle_deg for c in found if c.metric == "hysteresis_ratio"] == [60]


def test_trials_without_a_number_take_no_part():
    broken = [point("a", 40, math.nan, math.nan), point("b", 40, 50, 0.3)]
    condition = Condition("dynamic_response_deg", 0.25, pressure_pp_kpa=40)
    assert [r.design for r in ranking(broken, condition, 0.95)] == ["b"]
    assert differences(broken, condition) == []
    (found,) = [i for i in improvements(broken, "b") if i.condition.metric == "dynamic_response_deg"]
    assert found.refused == "a: no trial at 40 kPa with a largest angle"
