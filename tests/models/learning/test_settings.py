"""What a training takes by itself: how long and how fast it learns, from what it starts."""

from __future__ import annotations

import pytest

from bendtrack.models.learning.initialisation import resolve_init
from bendtrack.models.learning.settings import TrainingSettings
from bendtrack.models.shipped import actuator_file


def test_what_knows_actuators_is_the_start_where_it_comes_with_the_backbone() -> None:
    assert actuator_file("resnet18").is_file()
    assert resolve_init("auto", "resnet18") == "actuator"
    assert not actuator_file("resnet34").is_file()
    assert resolve_init("auto", "resnet34") != "actuator"
    assert resolve_init("random", "resnet18") == "random"


@pytest.mark.parametrize(("frames", "steps"), [(5, 300), (30, 300), (58, 580), (1000, 3000)])
def test_who_knows_actuators_learns_half_as_long(frames: int, steps: int) -> None:
    settings = TrainingSettings()
    assert settings.steps_for(frames, "random") == steps
    assert settings.steps_for(frames, "imagenet") == steps
    assert settings.steps_for(frames, "actuator") == steps // 2
    assert TrainingSettings(steps=7).steps_for(frames, "actuator") == 7


def test_who_knows_actuators_learns_more_slowly() -> None:
    assert TrainingSettings().learning_rate_from("actuator") < TrainingSettings().learning_rate_from("random")
    for start in ("actuator", "random"):
        assert TrainingSettings(learning_rate=0.01).learning_rate_from(start) == 0.01
