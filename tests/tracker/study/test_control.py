"""Tracking error of the pressure against its reference, for errors that are known."""

import dataclasses

import numpy as np
import pytest

from bendtrack.tracker.study.control import tracking_error
from bendtrack.tracker.study.trial import Kind, Shift, TrialData

LOG_S = np.arange(0, 48, 1 / 400)
REFERENCE_KPA = 55 * (1 - np.abs(2 * (LOG_S / 4 % 1) - 1))


def trial(pressure_kpa, reference_kpa=REFERENCE_KPA):
    time_s = np.arange(0, 48, 1 / 30)
    nothing = np.full(time_s.size, np.nan)
    return TrialData(
        name="trial",
        design="original",
        kind=Kind.DYNAMIC,
        frequency_hz=0.25,
        pressure_pp_kpa=55.0,
        time_s=time_s,
        angle_deg=nothing,
        angle_sd_deg=nothing,
        pressure_kpa=nothing,
        pressure_rate_kpa_s=nothing,
        log_time_s=LOG_S,
        log_pressure_kpa=pressure_kpa,
        shift=Shift(0.0, 0.0, "shared clock"),
        log_reference_kpa=reference_kpa,
    )


def test_a_constant_error():
    error = tracking_error(trial(REFERENCE_KPA + 0.5))
    assert error.rmse_kpa.value == pytest.approx(0.5)
    assert error.nrmse.value == pytest.approx(0.5 / 55, rel=1e-3)
    assert error.reference_pp_kpa == pytest.approx(55, abs=0.1)
    assert error.readings == LOG_S.size
    assert error.rmse_kpa.sd == pytest.approx(0, abs=1e-12)


def test_noise_is_an_error_and_its_interval_holds_it():
    held = []
    for seed in range(60):
        noise = 0.4 * np.random.default_rng(seed).standard_normal(LOG_S.size)
        low, high = tracking_error(trial(REFERENCE_KPA + noise)).rmse_kpa.interval(0.95)
        held.append(low < 0.4 < high)
    assert 0.85 < np.mean(held) < 1


def test_readings_that_are_missing_on_either_side_do_not_count():
    pressure, reference = REFERENCE_KPA + 0.5, REFERENCE_KPA.copy()
    pressure[:4000], reference[-2000:] = np.nan, np.nan
    error = tracking_error(trial(pressure, reference))
    assert error.readings == LOG_S.size - 6000
    assert error.rmse_kpa.value == pytest.approx(0.5)


@pytest.mark.parametrize("reference", [None, np.full(LOG_S.size, 20.0), np.full(LOG_S.size, np.nan)])
def test_no_reference_no_error(reference):
    assert tracking_error(dataclasses.replace(trial(REFERENCE_KPA), log_reference_kpa=reference)) is None
