"""Staircases: stairs found from the pressure, the angle at their steady end, and the model curve."""

import dataclasses

import numpy as np
import pytest

from bendtrack.tracker.study.static import measure_static
from bendtrack.tracker.study.trial import Kind, Shift, TrialData

HOLD_S, RAMP_S, FPS = 4.0, 0.4, 30
UP_KPA = np.arange(0, 51, 5.0)


def settled_deg(pressure_kpa):
    return 3 + 0.05 * pressure_kpa**2


def staircase(levels_kpa=UP_KPA, noise_deg=0.5, noise_kpa=0.1, creep_deg=0.0, seed=0, **changed):
    """Frames of a staircase; the angle comes to its end on each stair as exp(-t / 0.4 s), then creeps."""
    rng = np.random.default_rng(seed)
    starts_s = np.arange(len(levels_kpa)) * (HOLD_S + RAMP_S)
    time_s = np.arange(0.005, starts_s[-1] + HOLD_S, 1 / FPS)
    knots_s = np.stack([starts_s, starts_s + HOLD_S], axis=1).ravel()
    pressure = np.interp(time_s, knots_s, np.repeat(levels_kpa, 2))
    on_stair = np.clip(np.searchsorted(starts_s, time_s, side="right") - 1, 0, None)
    since_s = np.clip(time_s - starts_s[on_stair], 0, None)
    before = settled_deg(np.asarray(levels_kpa)[np.maximum(on_stair - 1, 0)])
    after = settled_deg(np.asarray(levels_kpa)[on_stair])
    angle = after + (before - after) * np.exp(-since_s / 0.4) + creep_deg * since_s / HOLD_S
    trial = TrialData(
        name="stairs",
        design="original",
        kind=Kind.STATIC,
        frequency_hz=None,
        pressure_pp_kpa=None,
        time_s=time_s,
        angle_deg=angle + noise_deg * rng.standard_normal(time_s.size),
        angle_sd_deg=np.full(time_s.size, noise_deg),
        pressure_kpa=pressure + noise_kpa * rng.standard_normal(time_s.size),
        pressure_rate_kpa_s=np.gradient(pressure, time_s),
        log_time_s=time_s,
        log_pressure_kpa=pressure,
        shift=Shift(0.0, 0.01, "shared clock"),
    )
    return dataclasses.replace(trial, **changed)


def model(off_deg=0.0, until_kpa=50.0):
    pressure = np.linspace(0, until_kpa, 200)
    return {"model_pressure_kpa": pressure, "model_angle_deg": settled_deg(pressure) + off_deg}


def test_every_stair_is_found_and_read_at_its_end():
    numbers = measure_static(staircase())
    assert [stair.direction for stair in numbers.stairs] == ["up"] * 11
    assert [stair.number for stair in numbers.stairs] == list(range(1, 12))
    np.testing.assert_allclose([stair.pressure_kpa for stair in numbers.stairs], UP_KPA, atol=0.1)
    for stair, true in zip(numbers.stairs, settled_deg(UP_KPA), strict=True):
        assert stair.angle_deg.value == pytest.approx(true, abs=0.35)
        assert stair.spread_deg == pytest.approx(0.5, abs=0.25)
        assert stair.angle_deg.sd == pytest.approx(stair.spread_deg / stair.frames**0.5, rel=1e-6)
    assert numbers.range_deg == pytest.approx(125, abs=0.5)


def test_the_intervals_hold_the_angles():
    held = [
        low <= true <= high
        for seed in range(15)
        for stair, true in zip(measure_static(staircase(seed=seed)).stairs, settled_deg(UP_KPA), strict=True)
        for low, high in [stair.angle_deg.interval(0.95)]
    ]
    assert np.mean(held) > 0.9


def test_stairs_up_and_down_again():
    levels = [*UP_KPA, *UP_KPA[-2::-1]]
    numbers = measure_static(staircase(levels, **model(2.0)))
    assert [stair.direction for stair in numbers.stairs] == ["up"] * 11 + ["down"] * 10
    np.testing.assert_allclose([stair.pressure_kpa for stair in numbers.stairs], levels, atol=0.1)
    assert numbers.stairs_compared == 11  # the first pressurisation


def test_a_model_that_is_off_by_a_constant():
    numbers = measure_static(staircase(**model(4.0)))
    assert numbers.rmse_deg.value == pytest.approx(4, abs=0.1)
    assert numbers.nrmse.value == pytest.approx(4 / 125, rel=0.03)
    low, high = numbers.rmse_deg.interval(0.99)
    assert low < 4 < high
    assert high - low < 0.3
    assert [round(s.model_angle_deg - settled_deg(s.pressure_kpa), 1) for s in numbers.stairs] == [4.0] * 11


def test_stairs_beyond_the_model_are_not_compared():
    numbers = measure_static(staircase(**model(4.0, until_kpa=41.0)))
    assert numbers.stairs_compared == 9
    assert numbers.rmse_deg.value == pytest.approx(4, abs=0.15)
    assert any("2 of 11 stairs lie outside the model curve" in warning for warning in numbers.warnings)


def test_no_model_no_rmse():
    numbers = measure_static(staircase())
    assert np.isnan(numbers.rmse_deg.value)
    assert numbers.stairs_compared == 0
    assert numbers.warnings == ()


def test_an_angle_that_has_not_settled_is_said():
    numbers = measure_static(staircase(creep_deg=6.0))
    assert sum("the angle still moves by +" in warning for warning in numbers.warnings) == 11


def test_a_stair_whose_end_has_no_angle_is_left_out():
    trial = staircase()
    fourth_s = 3 * (HOLD_S + RAMP_S)
    gap = (trial.time_s > fourth_s + 2) & (trial.time_s < fourth_s + HOLD_S)
    numbers = measure_static(dataclasses.replace(trial, angle_deg=np.where(gap, np.nan, trial.angle_deg)))
    assert [stair.number for stair in numbers.stairs] == [1, 2, 3, 5, 6, 7, 8, 9, 10, 11]
    assert any("stair 4 at 15" in warning and "left out" in warning for warning in numbers.warnings)


@pytest.mark.parametrize("noise_kpa", [0.0, 0.1])
def test_a_triangle_has_no_stairs(noise_kpa):
    trial = staircase()
    wave = 50 * (1 - np.abs(2 * (trial.time_s / 8 % 1) - 1))
    noise = noise_kpa * np.random.default_rng(1).standard_normal(wave.size)
    numbers = measure_static(dataclasses.replace(trial, pressure_kpa=wave + noise))
    assert numbers.stairs == ()
    assert any("no stair found" in warning for warning in numbers.warnings)


def test_constant_pressure_has_no_stairs():
    trial = staircase([20.0, 20.0, 20.0])
    numbers = measure_static(trial)
    assert numbers.stairs == ()
    assert np.isnan(numbers.range_deg)
    assert any("no stair found" in warning for warning in numbers.warnings)
