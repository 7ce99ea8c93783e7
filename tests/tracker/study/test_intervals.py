"""Estimates, their combination, lines and Holm's correction, against numbers worked out by hand or in tables."""

import math

import numpy as np
import pytest

from bendtrack.tracker.study.intervals import Estimate, combined, holm_adjusted, line_through, mean_of


def test_the_mean_has_students_interval():
    # Student's table: t(0.975, 3) = 3.1824463; of 1, 2, 3, 4 the sd is 1.2909944.
    low, high = mean_of([1, 2, 3, 4]).interval(0.95)
    assert (low, high) == pytest.approx(
        (2.5 - 3.1824463 * 1.2909944 / 2, 2.5 + 3.1824463 * 1.2909944 / 2), rel=1e-6
    )


def test_a_single_value_has_no_interval():
    one = mean_of([3.0])
    assert one.value == 3.0
    assert np.isnan(one.interval(0.95)).all()
    assert np.isnan(mean_of([]).value)


def test_a_known_uncertainty_has_the_normal_interval():
    assert Estimate(0.0, 1.0).interval(0.95) == pytest.approx((-1.959964, 1.959964), abs=1e-6)
    assert Estimate(1.959964, 1.0).p_value() == pytest.approx(0.05, abs=1e-6)
    assert Estimate(3.1824463, 1.0, 3).p_value() == pytest.approx(0.05, abs=1e-6)


def test_independent_inputs_add_in_squares_with_welchs_degrees_of_freedom():
    # Two inputs of the same variance and 4 degrees of freedom each: 8 together.
    whole = combined(5.0, [(1, Estimate(2, 3, 4)), (-1, Estimate(3, 3, 4))])
    assert (whole.value, whole.sd, whole.dof) == pytest.approx((5, 3 * math.sqrt(2), 8))
    # A source whose uncertainty is known adds none of its own doubt.
    assert combined(0, [(1, Estimate(0, 3, 4)), (2, Estimate(0, 2))]).dof == pytest.approx(4 * (25 / 9) ** 2)


def test_an_unknown_uncertainty_stays_unknown():
    assert math.isnan(combined(1.0, [(1, Estimate(0, 1)), (1, Estimate(1))]).sd)


def test_a_line_has_its_slope_and_value_with_their_uncertainty():
    # By hand: y = 1, 3, 2, 5 at x = 0..3 has slope 1.1, intercept 1.1, residual variance 2.7 / 2.
    slope, at_three = line_through(np.arange(4.0), np.array([1.0, 3, 2, 5]), 3.0)
    assert (slope.value, slope.sd, slope.dof) == pytest.approx((1.1, math.sqrt(1.35 / 5), 2))
    assert (at_three.value, at_three.sd) == pytest.approx((4.4, math.sqrt(1.35 * (1 / 4 + 2.25 / 5))))


def test_holm_multiplies_by_the_comparisons_left_and_never_falls():
    assert holm_adjusted([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm_adjusted([0.5, 0.9]) == pytest.approx([1.0, 1.0])


def test_holm_leaves_out_what_is_not_known():
    adjusted = holm_adjusted([0.02, float("nan"), 0.01])
    assert adjusted[0] == pytest.approx(0.02)
    assert math.isnan(adjusted[1])
    assert adjusted[2] == pytest.approx(0.02)
