"""Cycles found from the pressure alone: any wave, noise, parts of cycles, and records that hold none."""

import numpy as np
import pytest

from bendtrack.tracker.study.cycles import find_cycles

RATE_HZ = 400
PERIOD_S, PEAK_KPA = 4.0, 50.0


def triangle(phase):
    return 1 - np.abs(2 * (phase % 1) - 1)


def sine(phase):
    return (1 - np.cos(2 * np.pi * phase)) / 2


def trapezoid(phase):
    """Rises for 0.3 of a period, holds for 0.2, falls for 0.3, rests for 0.2 (half of it before the rise)."""
    return np.interp(phase % 1, [0, 0.1, 0.4, 0.6, 0.9, 1], [0, 0, 1, 1, 0, 0])


def sawtooth(phase):
    """Rises for 0.8 of a period, falls for 0.2."""
    return np.interp(phase % 1, [0, 0.8, 1], [0, 1, 0])


def record(wave, begin=0.0, end=6.0, noise_kpa=0.2, seed=0):
    """Times and pressures of a wave from one phase to another (in periods), with noise."""
    time_s = np.arange(begin * PERIOD_S, end * PERIOD_S, 1 / RATE_HZ)
    noise = noise_kpa * np.random.default_rng(seed).standard_normal(time_s.size)
    return time_s, PEAK_KPA * wave(time_s / PERIOD_S) + noise


@pytest.mark.parametrize(
    ("wave", "turn"),
    [(triangle, 0.5), (sine, 0.5), (trapezoid, 0.5), (sawtooth, 0.8)],
    ids=lambda w: getattr(w, "__name__", None),
)
@pytest.mark.parametrize("noise_kpa", [0.0, 0.2, 1.0])
def test_period_amplitude_and_phase_of_any_wave(wave, turn, noise_kpa):
    train = find_cycles(*record(wave, noise_kpa=noise_kpa))
    assert train.start_s.size == 6
    assert train.period_s == pytest.approx(PERIOD_S, abs=0.03)
    assert train.amplitude_kpa == pytest.approx(PEAK_KPA, abs=0.5 + 2 * noise_kpa)  # 0.02 s of a flank
    assert train.phase_s == pytest.approx(0.0, abs=0.03)
    inner = slice(1, -1)  # a first and a last one have no neighbour that defines their rest
    np.testing.assert_allclose(train.start_s[inner], np.arange(1, 5) * PERIOD_S, atol=0.06)
    np.testing.assert_allclose(train.turn_s, (np.arange(6) + turn) * PERIOD_S, atol=0.06)
    assert train.irregular == ("",) * 6
    assert train.warnings == ()
    assert train.incomplete == ()


def test_a_phase_is_found_where_the_record_begins_late():
    train = find_cycles(*record(triangle, begin=-0.25, end=5.25))
    assert train.phase_s == pytest.approx(0.0, abs=0.03)
    assert train.start_s.size == 5


def test_rest_before_and_after_is_no_part_of_a_cycle():
    time_s, pressure_kpa = record(triangle)
    rest_s = np.arange(0, 5, 1 / RATE_HZ)
    rest_kpa = 0.2 * np.random.default_rng(1).standard_normal(rest_s.size)
    train = find_cycles(
        np.concatenate([rest_s, 5 + time_s, 29 + rest_s]), np.concatenate([rest_kpa, pressure_kpa, rest_kpa])
    )
    np.testing.assert_allclose(train.start_s, 5 + np.arange(6) * PERIOD_S, atol=0.06)
    np.testing.assert_allclose(train.end_s, 9 + np.arange(6) * PERIOD_S, atol=0.06)


def test_incomplete_first_and_last_cycles_are_named():
    train = find_cycles(*record(triangle, begin=0.2, end=3.7))
    assert train.start_s.size == 2
    assert len(train.incomplete) == 2
    assert "first cycle is incomplete: the record begins at 20." in train.incomplete[0]
    assert "last cycle is incomplete: the record ends at 30." in train.incomplete[1]
    np.testing.assert_allclose(train.start_s, [4, 8], atol=0.06)


def test_a_record_that_begins_on_the_way_down():
    train = find_cycles(*record(triangle, begin=0.7, end=3.3))
    assert train.start_s.size == 2
    assert train.incomplete[0].startswith("the first cycle is incomplete: the record begins at 29.9 kPa")
    assert train.incomplete[1].startswith("the last cycle is incomplete: the record ends at 29.")
    np.testing.assert_allclose(train.start_s, [4, 8], atol=0.06)


@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.5), (0.5, 1.0), (0.3, 0.8), (0.6, 1.4), (0.0, 0.8)])
def test_less_than_a_cycle_is_none(begin, end):
    train = find_cycles(*record(triangle, begin, end))
    assert train.start_s.size == 0
    assert np.isnan(train.period_s)
    assert "no complete cycle" in train.warnings[0]


@pytest.mark.parametrize("noise_kpa", [0.0, 0.1, 2.0])
def test_pressure_that_does_not_move(noise_kpa):
    train = find_cycles(*record(lambda phase: 0.6 + 0 * phase, noise_kpa=noise_kpa))
    assert train.start_s.size == 0
    assert train.warnings[0].startswith("constant pressure: ")


def test_a_drift_of_the_pressure_is_said_and_its_cycles_are_found():
    time_s, pressure_kpa = record(triangle)
    train = find_cycles(time_s, pressure_kpa + 0.4 * time_s)
    assert train.start_s.size >= 5
    assert any("pressure drift: the largest pressure of a cycle moves by +8" in w for w in train.warnings)


def test_a_cycle_unlike_the_others_is_told_from_them():
    time_s, pressure_kpa = record(triangle)
    third = (time_s >= 2 * PERIOD_S) & (time_s < 3 * PERIOD_S)
    train = find_cycles(time_s, np.where(third, 0.8 * pressure_kpa, pressure_kpa))
    assert [bool(reason) for reason in train.irregular] == [False, False, True, False, False, False]
    assert (
        train.irregular[2]
        == f"reaches {train.high_kpa[2]:.1f} kPa, the others {np.median(train.high_kpa):.1f} kPa"
    )


def test_a_longer_cycle_is_told_from_the_others():
    time_s, pressure_kpa = record(triangle)
    later = time_s > 3.5 * PERIOD_S
    train = find_cycles(time_s + np.where(later, 1.0, 0.0), pressure_kpa)
    assert train.irregular[3] == f"lasts {train.end_s[3] - train.start_s[3]:.2f} s, the others 4.00 s"
    assert train.end_s[3] - train.start_s[3] == pytest.approx(5.0, abs=0.06)
    assert sum(bool(reason) for reason in train.irregular) == 1


def test_missing_readings_do_not_matter_where_they_are_few():
    time_s, pressure_kpa = record(triangle)
    pressure_kpa[np.random.default_rng(3).random(time_s.size) < 0.2] = np.nan
    train = find_cycles(time_s, pressure_kpa)
    np.testing.assert_allclose(train.start_s, np.arange(6) * PERIOD_S, atol=0.06)


def test_a_record_without_readings():
    nothing = find_cycles(np.arange(100.0), np.full(100, np.nan))
    assert "too few to hold a cycle" in nothing.warnings[0]
