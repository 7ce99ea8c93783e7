"""The schedule: warm-up, plateau, decay; an early decay when the held-out error stalls; time limits."""

from __future__ import annotations

from itertools import pairwise

import pytest

from bendtrack.models.training.schedule import PATIENCE, Schedule


def test_warms_up_stays_and_decays() -> None:
    schedule = Schedule(planned=300, decay_share=0.5)
    factors = [schedule.factor(step) for step in range(300)]
    assert factors[0] < 0.1
    assert factors[40] == factors[149] == 1.0
    assert factors[-1] < 0.02
    assert all(a >= b for a, b in pairwise(factors[150:]))


def test_a_stalled_held_out_error_starts_the_decay_early() -> None:
    schedule = Schedule(planned=2000, decay_share=0.5)
    assert schedule.validate(50, 3.0)
    for i in range(PATIENCE):
        assert not schedule.validate(100 + 50 * i, 2.99)
    step = 100 + 50 * (PATIENCE - 1)
    assert schedule.decay_start == step
    assert schedule.total == 2 * step
    assert schedule.factor(step + 1) < 1.0


def test_an_improving_held_out_error_keeps_the_plan() -> None:
    schedule = Schedule(planned=2000, decay_share=0.5)
    for i in range(10):
        assert schedule.validate(50 * (i + 1), 3.0 * 0.9**i)
    assert schedule.total == 2000


def test_fits_a_time_limit_at_the_measured_speed() -> None:
    schedule = Schedule(planned=1000, decay_share=0.5)
    schedule.fit(step=20, elapsed_s=20.0, limit_s=120.0)
    assert schedule.total == 120
    schedule.fit(step=60, elapsed_s=30.0, limit_s=120.0)
    assert schedule.total == 240, "the first steps are slow: what they seemed to leave out is taken back"
    schedule.fit(step=100, elapsed_s=1e6, limit_s=120.0)
    assert schedule.total == 100, "the time is over: no further step"
    schedule.fit(step=101, elapsed_s=1.0, limit_s=1e9)
    assert schedule.total == 1000
    schedule.fit(step=19, elapsed_s=19.0, limit_s=20.0)
    assert [schedule.factor(step) for step in (0, 1, 2)] == [0.5, 1.0, 1.0], (
        "a short training warms up shortly"
    )
    assert schedule.factor(19) < 0.2


@pytest.mark.parametrize("total", [1, 2, 5])
def test_tiny_trainings_have_a_schedule_too(total: int) -> None:
    schedule = Schedule(planned=total, decay_share=0.5)
    assert all(0 < schedule.factor(step) <= 1 for step in range(total))
