import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.synthetic.response import (
    HystereticResponse,
    staircase_duration_s,
    staircase_kpa,
    triangle_kpa,
)


def shoelace(x, y):
    return 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.279, 0.45])
@pytest.mark.parametrize("angle_min", [-10.0, 0.0, 8.0])
def test_every_cycle_has_the_ratio_asked_for(ratio, angle_min):
    response = HystereticResponse(50.0, angle_min, 208.0, ratio)
    pressure = triangle_kpa(np.arange(3 * 1600 + 1) / 400, 50.0, 0.25)
    angle = response.angle_deg(pressure)
    for cycle in range(3):
        part = slice(cycle * 1600, (cycle + 1) * 1600)
        area = shoelace(pressure[part], angle[part])
        assert area / (pressure.max() * angle.max()) == pytest.approx(ratio, abs=1e-3)
    assert angle.max() == pytest.approx(208.0)
    assert angle.min() == pytest.approx(angle_min)


def test_unloading_lies_above_loading():
    response = HystereticResponse(50.0, 0.0, 180.0, 0.25)
    pressure = np.concatenate([np.linspace(0, 50, 51), np.linspace(49, 0, 50)])
    angle = response.angle_deg(pressure)
    up, down = angle[1:50], angle[51:100][::-1]
    assert (down > up).all()
    assert (np.diff(angle[:51]) > 0).all()
    assert (np.diff(angle[50:]) < 0).all()


turning_points = st.lists(st.floats(0, 50), min_size=2, max_size=9)


@given(turning_points, st.integers(2, 40))
def test_time_does_not_matter(turns, samples):
    """Sampled finely or only at its turns, quickly or slowly, a path leads to the same angles."""
    response = HystereticResponse(50.0, -5.0, 190.0, 0.3)
    path = np.concatenate([np.linspace(a, b, samples) for a, b in itertools.pairwise(turns)])
    coarse = response.angle_deg(np.array(turns))
    fine = response.angle_deg(path)
    np.testing.assert_allclose(fine[samples - 1 :: samples], coarse[1:], atol=1e-9)


@given(st.floats(5, 45), st.floats(0.05, 1), st.floats(0.05, 1))
def test_a_small_loop_closes_and_is_forgotten(start, down, inner):
    response = HystereticResponse(50.0, 0.0, 180.0, 0.3)
    low = start * (1 - down)
    high = low + (start - low) * inner
    with_loops = response.angle_deg(np.array([start, low, high, low, start, 50.0]))
    straight = response.angle_deg(np.array([start, low, start, 50.0]))
    assert with_loops[3] == pytest.approx(with_loops[1], abs=1e-9)
    assert with_loops[4] == pytest.approx(with_loops[0], abs=1e-9)
    assert with_loops[5] == pytest.approx(straight[-1], abs=1e-9)
    assert with_loops[5] == pytest.approx(180.0)


@given(turning_points)
def test_angles_stay_between_the_ends(turns):
    angle = HystereticResponse(50.0, -5.0, 190.0, 0.3).angle_deg(np.array(turns))
    assert (angle >= -5 - 1e-9).all()
    assert (angle <= 190 + 1e-9).all()


def test_what_cannot_be_reached_is_refused():
    with pytest.raises(BendtrackError, match=r"hysteresis ratio from 0 to 0\.500"):
        HystereticResponse(50.0, 0.0, 180.0, 0.6)
    with pytest.raises(BendtrackError, match="largest angle"):
        HystereticResponse(50.0, 30.0, 20.0, 0.1)
    with pytest.raises(BendtrackError, match="largest pressure"):
        HystereticResponse(0.0, 0.0, 180.0, 0.1)


def test_waves():
    time = np.arange(0, 16.0, 1 / 400)
    wave = triangle_kpa(time, 45.0, 0.0625)
    assert wave[0] == 0
    assert wave.max() == pytest.approx(45.0)
    assert time[wave.argmax()] == pytest.approx(8.0)
    duration = staircase_duration_s(50.0, step_kpa=5.0, hold_s=2.0, ramp_s=0.5)
    stairs = staircase_kpa(np.arange(0, duration, 0.01), 50.0, step_kpa=5.0, hold_s=2.0, ramp_s=0.5)
    levels, counts = np.unique(stairs.round(9), return_counts=True)
    np.testing.assert_allclose(levels[counts > 100], np.arange(0, 51, 5))
    assert (np.diff(stairs) >= 0).all()
