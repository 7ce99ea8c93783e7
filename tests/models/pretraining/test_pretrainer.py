"""Pretraining on rendered actuators: its data, resuming after a stop, and its checkpoint."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bendtrack.models.data.synthetic import (
    IMAGE_WH,
    REFERENCE,
    render_batch,
    rendered_frames,
    rendered_samples,
)
from bendtrack.models.export import build_beside
from bendtrack.models.inference.metadata import WEIGHTS_FILE
from bendtrack.models.networks.checkpoint import Checkpoint, best_device, load_checkpoint
from bendtrack.models.pretraining.pretrainer import PretrainingSettings, _rendered, pretrain, usual_settings
from bendtrack.models.training.state import STATE_FILE
from bendtrack.models.training.transfer import ENDS
from bendtrack.tracker.angle import bending_angle
from bendtrack.tracker.errors import TrainingError, WeightsError
from bendtrack.tracker.synthetic.stream import KEYPOINTS, KINDS, draw

TINY = PretrainingSettings(steps=4, pictures=2, pool=6, batch=4, patches=2, judged=2)


def test_a_sample_is_a_frame_with_occluded_keypoints_marked() -> None:
    sample, frame = next(pair for pair in rendered_samples(3, range(200)) if not pair[0].visible.all())
    np.testing.assert_array_equal(frame.visible, sample.visible)
    np.testing.assert_array_equal(frame.xy, sample.keypoints_xy)
    assert not frame.visible.all()


def test_a_sample_has_the_projects_keypoints() -> None:
    ((sample, _),) = rendered_samples(3, range(1))
    (frame,) = rendered_frames(
        3, range(1), ("tip_2", "spot", "base_1"), {"tip_2": "tip_2", "base_1": "base_1"}
    )
    np.testing.assert_array_equal(frame.xy[[0, 2]], sample.keypoints_xy[[-1, 0]])
    np.testing.assert_array_equal(frame.visible[[0, 2]], sample.visible[[-1, 0]])
    assert np.isnan(frame.xy[1]).all()
    chain = ("root", "neck", "wrist", "nail")
    (frame,) = rendered_frames(3, range(1), chain, dict(zip(chain, ENDS, strict=True)))
    np.testing.assert_array_equal(frame.xy, sample.keypoints_xy[[0, 1, -2, -1]])


def test_images_that_are_trained_on_have_extras_and_no_others_do() -> None:
    settings = PretrainingSettings(pictures=4, batch=4)
    assert settings.kinds == KINDS
    without = replace(settings, kinds=())
    assert settings.identity != without.identity
    batches = []
    for each in (settings, without):
        with _rendered(each, 0, 4, 1) as rendered:
            batches.append(next(rendered))
    expected = [
        np.stack([draw(0, index, size_wh=IMAGE_WH, kinds=kinds).image for index in range(4)])
        for kinds in (KINDS, ())
    ]
    for batch, images in zip(batches, expected, strict=True):
        np.testing.assert_array_equal(batch.images, images.transpose(0, 3, 1, 2))
    assert (batches[0].images != batches[1].images).any()
    np.testing.assert_array_equal(render_batch(0, range(4)).images, batches[1].images)
    assert {sample.kinds for sample, _ in rendered_samples(0, range(6))} == {()}


def test_reference_keypoints_are_neighbours() -> None:
    assert [KEYPOINTS[i] for i in REFERENCE] == [
        "base_2", "base_1", "mid_2", "mid_1", "mid_4", "mid_3", "mid_4", "tip_2", "tip_1",
    ]  # fmt: skip


@pytest.mark.slow
def test_both_networks_improve(tmp_path: Path) -> None:
    seen = []
    settings = PretrainingSettings(steps=120, pictures=6, batch=12, judged=24, average=0.9)
    first = pretrain(tmp_path / "first", replace(settings, steps=1)).training["judged"]
    last = pretrain(tmp_path / "last", settings, progress=seen.append).training["judged"]
    assert len(seen) == 120
    assert np.mean([p.loss for p in seen[-20:]]) < 0.8 * np.mean([p.loss for p in seen[:20]])
    # A minute is enough to see that they do, on pictures they were not taught with.
    assert last["located_median"] < 0.9 * first["located_median"]
    assert last["refined_px"] < 0.9 * first["refined_px"]


def test_stopped_and_resumed_is_the_same_to_the_bit(tmp_path: Path) -> None:
    whole = pretrain(tmp_path / "whole", TINY)
    stopped = pretrain(tmp_path / "parts", TINY, stop_after_s=0.0)
    assert 0 < stopped.training["steps"] < TINY.steps
    assert (tmp_path / "parts" / STATE_FILE).is_file()
    resumed = pretrain(tmp_path / "parts", TINY, resume=True)
    assert not (tmp_path / "parts" / STATE_FILE).is_file()
    assert resumed.training["steps"] == TINY.steps
    for name, value in whole.network.state_dict().items():
        assert torch.equal(value, resumed.network.state_dict()[name]), name
    rows = (tmp_path / "parts" / "training.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["step", str(stopped.training["steps"]), "4"]


@pytest.mark.parametrize("backbone", ["resnet18", "resnet50"])
def test_the_result_is_a_checkpoint_like_any_other(backbone: str, tmp_path: Path) -> None:
    pretrain(tmp_path, replace(TINY, backbone=backbone))
    checkpoint = load_checkpoint(tmp_path)
    assert checkpoint.keypoints == KEYPOINTS
    assert checkpoint.backbone == backbone
    found = checkpoint.detect(draw(9, 0).image[None])
    angle_deg, sd_deg, _ = bending_angle(found.xy, KEYPOINTS, checkpoint.definition, found.covariance)
    assert np.isfinite([angle_deg[0], sd_deg[0]]).all()
    assert (tmp_path / "learning-curve.png").stat().st_size > 5000
    assert json.loads((tmp_path / "checkpoint.json").read_text())["training"]["settings"]["seed"] == 0


def test_it_is_compiled_with_rendered_images(tmp_path: Path) -> None:
    pretrain(tmp_path, TINY)
    record = build_beside(tmp_path)
    assert (record.frames_fitted, record.frames_judged) == (16, 16)
    assert set(record.engines) == {"openvino", "openvino-int8"}


def test_only_the_same_settings_are_resumed(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="expected an unfinished pretraining"):
        pretrain(tmp_path, TINY, resume=True)
    pretrain(tmp_path, TINY, stop_after_s=0.0)
    with pytest.raises(TrainingError, match="expected the settings"):
        pretrain(tmp_path, replace(TINY, seed=1), resume=True)
    longer = pretrain(tmp_path, replace(TINY, steps=5), resume=True)
    assert longer.training["steps"] == 5


def test_it_starts_from_a_network_of_ours(tmp_path: Path) -> None:
    first = pretrain(tmp_path / "first", TINY)
    settings = replace(TINY, init=str(tmp_path / "first"), seed=2)
    then = pretrain(tmp_path / "then", settings, stop_after_s=0.0)
    afresh = pretrain(tmp_path / "afresh", replace(settings, init="random"), stop_after_s=0.0)
    assert then.training["started_from"] == settings.init
    with pytest.raises(TrainingError, match="--seed: expected one whose pictures"):
        pretrain(tmp_path / "again", replace(settings, seed=TINY.seed))

    def apart(one: Checkpoint, other: Checkpoint) -> float:
        pairs = zip(one.network.parameters(), other.network.parameters(), strict=True)
        return sum(float((a - b).abs().sum()) for a, b in pairs)

    assert apart(first, then) < 0.1 * apart(first, afresh)
    # What is resumed needs it no longer.
    (tmp_path / "first" / WEIGHTS_FILE).unlink()
    assert pretrain(tmp_path / "then", settings, resume=True).training["steps"] == TINY.steps
    with pytest.raises(WeightsError, match="expected random, actuator, or a network with backbone resnet18"):
        pretrain(tmp_path / "other", settings)


def test_a_gpu_gets_larger_batches_and_a_larger_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    assert usual_settings(seed=3) == PretrainingSettings(seed=3) or torch.cuda.is_available()
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(
        torch.cuda, "get_device_properties", lambda device: SimpleNamespace(total_memory=8 << 30)
    )
    assert best_device().type == "cuda"
    large = usual_settings(seed=3, patches=1)
    assert (large.seed, large.patches) == (3, 1)
    assert large.batch > PretrainingSettings().batch
    # Half of 8 GiB, at 300 kB a picture.
    assert 13_000 < large.pool < 15_000


@pytest.mark.parametrize(
    "wrong",
    [
        *({"steps": 0}, {"pictures": 0}, {"backbone": "resnet9"}, {"seed": -1}, {"batch": 8}, {"pool": 20}),
        {"kinds": ("zip ties", "ribbons")},
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict) -> None:
    with pytest.raises(TrainingError, match="expected"):
        PretrainingSettings(**wrong)


@pytest.mark.slow
def test_the_command_stops_and_resumes(bendtrack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # To judge by as many pictures as usual takes longest.
    few = partial(usual_settings, judged=4)
    monkeypatch.setattr("bendtrack.models.pretraining.pretrainer.usual_settings", few)
    out = tmp_path / "actuators"
    ran = bendtrack("pretrain", out, "--steps", "2", "--stop-after", "0")
    assert (ran.status, ran.err) == (0, "")
    assert "1 of 2 steps, 48 images" in ran.out
    ran = bendtrack("pretrain", out, "--steps", "2")
    assert ran.status == 2
    assert "add --resume" in ran.err
    assert bendtrack("pretrain", out, "--steps", "2", "--resume").status == 0
    ran = bendtrack("pretrain", out)
    assert ran.status == 2
    assert "expected a folder without a network" in ran.err
