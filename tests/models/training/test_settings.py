"""Default settings: initial weights, number of steps and learning rates."""

from __future__ import annotations

import pytest

from bendtrack.models.networks.initialisation import resolve_init
from bendtrack.models.networks.shipped import actuator_file
from bendtrack.models.training.settings import TrainingSettings


def test_auto_starts_from_the_shipped_network_where_there_is_one_with_the_backbone() -> None:
    assert actuator_file("resnet18").is_file()
    assert resolve_init("auto", "resnet18") == "actuator"
    assert not actuator_file("resnet34").is_file()
    assert resolve_init("auto", "resnet34") != "actuator"
    assert resolve_init("random", "resnet18") == "random"


@pytest.mark.parametrize(("frames", "steps"), [(5, 300), (30, 300), (58, 580), (1000, 3000)])
def test_the_shipped_network_is_trained_for_fewer_steps(frames: int, steps: int) -> None:
    settings = TrainingSettings()
    assert settings.steps_for(frames, "random") == steps
    assert settings.steps_for(frames, "imagenet") == steps
    assert settings.steps_for(frames, "actuator") == 2 * steps // 3
    assert TrainingSettings(steps=7).steps_for(frames, "actuator") == 7


def test_the_shipped_refiner_is_trained_faster_and_its_locator_more_slowly() -> None:
    settings = TrainingSettings()
    rates = {start: settings.learning_rate_from(start) for start in ("actuator", "imagenet", "random")}
    assert rates["actuator"] > rates["random"] == rates["imagenet"]
    located = {start: rate * settings.locator_share_from(start) for start, rate in rates.items()}
    assert located["actuator"] < located["random"] == rates["random"] == located["imagenet"]
    for start in ("actuator", "random"):
        assert TrainingSettings(learning_rate=0.01).learning_rate_from(start) == 0.01
