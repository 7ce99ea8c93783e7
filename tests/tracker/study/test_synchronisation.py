"""Bringing log and video together: each event is found where it is, as surely as is said, and never guessed."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bendtrack.tracker.errors import StudyError
from bendtrack.tracker.study.onset import onset_from_rest, rising_edges
from bendtrack.tracker.study.pressure_log import PressureLog
from bendtrack.tracker.study.study_file import SyncSettings
from bendtrack.tracker.study.synchronisation import Synchronised, led_brightness, synchronise
from bendtrack.tracker.video_writer import VideoWriter

FRAME_S = 1 / 30
FRAMES_S = np.arange(300) * FRAME_S
LOG_S = np.arange(4000) / 400
RNG = np.random.default_rng(11)


def log_with(**fields: Any) -> PressureLog:
    return PressureLog(**{"time_s": LOG_S, "pressure_kpa": np.zeros_like(LOG_S), **fields})


def bring(
    log: PressureLog, angle_deg: np.ndarray | None = None, video: Path | None = None, **settings: Any
) -> Synchronised:
    angle = np.zeros_like(FRAMES_S) if angle_deg is None else angle_deg
    return synchronise(SyncSettings(**settings), log, FRAMES_S, angle, video, "trial 'a'")


def film(path: Path, on: list[tuple[float, float]], at_xy: tuple[int, int] = (50, 20)) -> Path:
    """A video with a noisy ground and a lamp of 8 x 8 px that is on in the given intervals of time."""
    x, y = at_xy
    with VideoWriter(path, (96, 72), 30.0) as writer:
        for time_s in FRAMES_S:
            image = RNG.integers(60, 90, (72, 96, 3), dtype=np.uint8)
            if any(begin <= time_s < end for begin, end in on):
                image[y : y + 8, x : x + 8] = 250
            writer.write(image, float(time_s))
    return path


def test_a_shared_clock_has_no_delay_and_half_a_frame_of_doubt() -> None:
    found = bring(log_with())
    assert found.shift.delay_s == 0
    assert found.shift.sd_s == pytest.approx(FRAME_S / 2)
    assert (found.shift.method, found.warnings) == ("shared clock", ())


def test_a_shared_clock_of_dates() -> None:
    log = log_with(started_s=datetime(2024, 5, 17, 11, 0, 2, 250_000, tzinfo=UTC).timestamp())
    for start in (datetime(2024, 5, 17, 11, 0, 1), datetime(2024, 5, 17, 11, 0, 1, tzinfo=UTC)):
        assert bring(log, video_start=start).shift.delay_s == pytest.approx(1.25, abs=1e-6)
    assert any("holds dates" in warning for warning in bring(log).warnings)
    with pytest.raises(StudyError, match="video_start needs a log with dates"):
        bring(log_with(), video_start=datetime(2024, 5, 17))


def test_a_given_delay_is_taken_as_it_is() -> None:
    found = bring(log_with(), method="given delay", delay_s=-0.8, sd_s=0.04)
    assert (found.shift.delay_s, found.shift.sd_s) == (-0.8, 0.04)
    assert bring(log_with(), method="given delay", delay_s=-0.8).shift.sd_s == pytest.approx(FRAME_S / 2)


def test_a_coarse_log_clock_adds_to_the_doubt() -> None:
    found = bring(log_with(time_sd_s=0.03), method="given delay", delay_s=0.0, sd_s=0.04)
    assert found.shift.sd_s == pytest.approx(0.05)
    assert bring(log_with(time_sd_s=0.1)).warnings == (
        "shared clock: the shift is known to 0.100 s only, 3.0 frames",
    )


LAMP = {"method": "sync event", "led_region_px": (50, 20, 8, 8)}


def test_a_lamp_and_a_trigger(tmp_path: Path) -> None:
    # On at 2.5 s of the video and at 3.7 s of the log.
    video = film(tmp_path / "a.mp4", [(2.5, 3.5)])
    found = bring(log_with(sync=((LOG_S >= 3.7) & (LOG_S < 4.7)) * 5.0), video=video, **LAMP)
    assert found.shift.delay_s == pytest.approx(-1.2, abs=FRAME_S / 2 + 1 / 400)
    assert found.shift.sd_s == pytest.approx(FRAME_S / 2)
    assert found.warnings == ()


def test_several_flashes_show_a_drift(tmp_path: Path) -> None:
    video = film(tmp_path / "a.mp4", [(1, 1.5), (5, 5.5), (9, 9.5)])
    sync = np.zeros_like(LOG_S)
    for begin in (1.0, 5.0, 9.0):
        sync[round(400 * begin) : round(400 * begin) + 200] = 1
    steady = bring(log_with(sync=sync), video=video, **LAMP)
    assert abs(steady.shift.delay_s) < FRAME_S / 2 + 1 / 400
    assert steady.warnings == ()
    drifting = bring(log_with(sync=sync, time_s=LOG_S * 1.02), video=video, **LAMP)
    assert drifting.shift.delay_s == pytest.approx(-0.1, abs=0.02)
    assert drifting.shift.sd_s > 0.05
    assert any("clock drift: the shift changes by 0.1" in warning for warning in drifting.warnings)
    fewer = bring(log_with(sync=sync * (LOG_S < 6)), video=video, **LAMP)
    assert abs(fewer.shift.delay_s) < FRAME_S / 2 + 1 / 400
    assert any("2 in the log, 3 in the video" in warning for warning in fewer.warnings)
    windowed = bring(log_with(sync=sync), video=video, **LAMP, log_window_s=(4, 6), video_window_s=(8, 9.6))
    assert windowed.shift.delay_s == pytest.approx(4, abs=FRAME_S / 2 + 1 / 400)


def test_a_lamp_that_is_not_there(tmp_path: Path) -> None:
    log = log_with(sync=(LOG_S > 3) * 1.0)
    video = film(tmp_path / "a.mp4", [])
    with pytest.raises(StudyError, match=r"lamp in a\.mp4: expected a step between two levels, found none"):
        bring(log, video=video, **LAMP)
    with pytest.raises(StudyError, match=r"in a frame of 96 x 72 px, got \[90, 20, 8, 8\]"):
        bring(log, video=video, method="sync event", led_region_px=(90, 20, 8, 8))
    with pytest.raises(StudyError, match="needs the trial's video"):
        bring(log, **LAMP)
    with pytest.raises(StudyError, match="needs a sync column"):
        bring(log_with(), video=video, **LAMP)


def test_brightness_is_read_at_the_region(tmp_path: Path) -> None:
    video = film(tmp_path / "a.mp4", [(2, 4)], at_xy=(8, 56))
    time_s, brightness = led_brightness(video, (8, 56, 8, 8), window_s=(1, 5))
    assert (time_s[0], time_s[-1]) == (pytest.approx(1), pytest.approx(5))
    lit = (time_s >= 2 - 1e-6) & (time_s < 4 - 1e-6)
    assert brightness[lit].min() > 200
    assert brightness[~lit].max() < 110


EDGE_KPA = 20 * np.clip((LOG_S - 3.0) / 0.4, 0, 1) + 0.1 * RNG.standard_normal(LOG_S.size)


def test_a_pressure_step_and_the_movement_it_makes() -> None:
    angle = 60 * np.clip((FRAMES_S - 2.2) / 0.4, 0, 1) + 0.5 * RNG.standard_normal(FRAMES_S.size)
    found = bring(
        log_with(pressure_kpa=EDGE_KPA), angle, method="sync event", log_event="pressure", video_event="angle"
    )
    assert abs(found.shift.delay_s + 0.8) < 3 * found.shift.sd_s < 0.1
    assert any("how late the actuator follows counts as shift" in warning for warning in found.warnings)
    gappy = np.where(RNG.random(FRAMES_S.size) < 0.1, np.nan, angle)
    again = bring(
        log_with(pressure_kpa=EDGE_KPA), gappy, method="sync event", log_event="pressure", video_event="angle"
    )
    assert abs(again.shift.delay_s + 0.8) < 3 * again.shift.sd_s < 0.15


SHAPES = {
    "slow ramp": (lambda t: 6.25 * t, 400, 0.1),
    "step over 0.3 s": (lambda t: 5 * np.minimum(t / 0.3, 1), 400, 0.1),
    "approach": (lambda t: 5 * -np.expm1(-t / 0.1), 400, 0.1),
    "fall": (lambda t: -25 * t, 400, 0.1),
    "frames": (lambda t: 20 * t, 30, 0.5),
    "frames, gradual": (lambda t: 5 * t**2, 30, 0.5),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_an_onset_is_as_sure_as_it_says(shape: str) -> None:
    rise, rate_hz, noise = SHAPES[shape]
    time_s = np.arange(0, 6, 1 / rate_hz)
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(12):
        true_s = rng.uniform(1.5, 3)
        value = 7 + rise(np.maximum(time_s - true_s, 0)) + noise * rng.standard_normal(time_s.size)
        onset = onset_from_rest(time_s, value, "here")
        errors.append((onset.time_s - true_s) / onset.sd_s)
    assert np.sqrt(np.mean(np.square(errors))) < 1.6


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.zeros(300), "stays at 0"),
        (RNG.standard_normal(300), "stays at"),
        (FRAMES_S * 20, "expected a rest of 0.5 s before the onset"),
        (np.full(300, np.nan), "got 0 samples"),
    ],
)
def test_no_onset(value: np.ndarray, message: str) -> None:
    with pytest.raises(StudyError, match=message):
        onset_from_rest(FRAMES_S, value, "here")


def test_edges_of_a_noisy_trigger() -> None:
    signal = 5.0 * ((LOG_S > 2) & (LOG_S < 3) | (LOG_S > 7)) + 0.2 * RNG.standard_normal(LOG_S.size)
    edges = rising_edges(LOG_S, signal, "here")
    assert [edge.time_s for edge in edges] == [pytest.approx(2, abs=0.003), pytest.approx(7, abs=0.003)]
    assert edges[0].sd_s == pytest.approx(1 / 400 / 12**0.5)
    with pytest.raises(StudyError, match="on from the beginning"):
        rising_edges(LOG_S, (LOG_S < 3) * 1.0, "here")
    with pytest.raises(StudyError, match="found none"):
        rising_edges(LOG_S, RNG.standard_normal(LOG_S.size), "here")
