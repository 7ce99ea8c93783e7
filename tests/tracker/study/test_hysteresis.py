"""The geometry of a loop against shapes whose area everybody knows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bendtrack.tracker.study.hysteresis import (
    hysteresis_ratio,
    hysteresis_ratio_extremes,
    loop_area_deg_kpa,
    mid_pressure_width_deg,
)

# Up from (0, 0) over (30, 0) to (50, 80), down over (20, 80): a parallelogram of 80 deg and 30 kPa, 20 kPa at its top.
PARALLELOGRAM = np.array([[0, 0], [30, 0], [50, 80], [20, 80]], float)


def ellipse(pressure_kpa, angle_deg, lag_rad, count=2000):
    phase = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack(
        [pressure_kpa * (1 - np.cos(phase)) / 2, angle_deg * (1 - np.cos(phase - lag_rad)) / 2], axis=1
    )


def test_area_of_a_parallelogram():
    assert loop_area_deg_kpa(PARALLELOGRAM) == pytest.approx(30 * 80)


def test_area_of_an_ellipse():
    loop = ellipse(50, 120, 0.3)
    assert loop_area_deg_kpa(loop) == pytest.approx(np.pi * 25 * 60 * np.sin(0.3), rel=1e-4)


def test_an_angle_that_leads_has_a_negative_area():
    assert loop_area_deg_kpa(ellipse(50, 120, -0.3)) == pytest.approx(
        -np.pi * 25 * 60 * np.sin(0.3), rel=1e-4
    )
    assert loop_area_deg_kpa(PARALLELOGRAM[::-1]) == pytest.approx(-30 * 80)


@given(st.floats(-50, 50), st.floats(-90, 90), st.floats(0.1, 10), st.floats(0.1, 10), st.integers(0, 3))
def test_area_moves_with_nothing_and_scales_with_both_axes(kpa, deg, times_kpa, times_deg, first):
    loop = np.roll(PARALLELOGRAM, first, axis=0) * [times_kpa, times_deg] + [kpa, deg]
    assert loop_area_deg_kpa(loop) == pytest.approx(2400 * times_kpa * times_deg, rel=1e-6, abs=1e-6)


def test_the_papers_ratio_is_to_the_axes():
    assert hysteresis_ratio(2400, 50, 80) == pytest.approx(0.6)
    # The same loop at a higher angle has a larger rectangle, but the same extremes.
    assert hysteresis_ratio(2400, 50, 100) == pytest.approx(0.48)
    assert hysteresis_ratio_extremes(2400, (0, 50), (20, 100)) == pytest.approx(0.6)


@pytest.mark.parametrize(("kpa", "deg"), [(-50, 80), (50, -80), (-50, -80), (0, 80), (np.nan, 80)])
def test_no_rectangle_to_the_axes_no_ratio(kpa, deg):
    assert np.isnan(hysteresis_ratio(2400, kpa, deg))


def test_no_extremes_no_ratio():
    assert np.isnan(hysteresis_ratio_extremes(0, (50, 50), (0, 80)))


def test_width_half_way_up():
    pressure = np.linspace(0, 50, 60)
    up = np.stack([pressure, 0.02 * pressure**2], axis=1)
    down = np.stack([pressure, 10 + 0.02 * pressure**2], axis=1)[::-1]
    assert mid_pressure_width_deg(up, down, 0, 50) == pytest.approx(10, abs=1e-6)
    assert mid_pressure_width_deg(down, up, 0, 50) == pytest.approx(-10, abs=1e-6)


def test_no_width_where_a_branch_has_no_points_in_the_middle():
    pressure = np.linspace(0, 50, 60)
    up = np.stack([pressure, pressure], axis=1)
    gap = up[(pressure < 15) | (pressure > 35)]
    assert np.isnan(mid_pressure_width_deg(up, gap, 0, 50))
