"""Evaluation against detections with known errors, its files, and cross-validation."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bendtrack.models.cross_validation import cross_validate, fold_of_each
from bendtrack.models.evaluation import Evaluation, write_evaluation
from bendtrack.models.figures import _errors, _learning_curve, write_figures
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import TrainingError
from bendtrack.tracker.types import Detections, LabelledFrame

MakeFrames = Callable[..., list[LabelledFrame]]


def off_by(frames: list[LabelledFrame], shift: np.ndarray, definition: AngleDefinition) -> Evaluation:
    """An evaluation in which every point is found `shift` (K, 2) px away."""
    xy = np.stack([frame.xy for frame in frames]) + shift
    covariance = np.broadcast_to(np.eye(2), (*xy.shape[:2], 2, 2))
    return Evaluation(
        frames, Detections(xy, np.ones(xy.shape[:2]), covariance), definition.points, definition, n_trained=25
    )


def test_statistics_are_those_of_the_known_error(
    make_frames: MakeFrames, definition: AngleDefinition
) -> None:
    frames = make_frames(np.linspace(0, 150, 8))
    frames = [replace(frame, actuator="ab"[i % 2]) for i, frame in enumerate(frames)]
    frames[2].xy[3] = np.nan
    # base_2 a hundredth of its vector's length to the side: the base turns by 0.01 rad, every angle by as much.
    shift = np.zeros((4, 2))
    shift[1] = [0.0, 0.24]
    summary = off_by(frames, shift, definition).summary()
    assert summary["error_px"]["n"] == 31
    assert summary["per_keypoint_px"]["base_2"] == {
        "n": 8, "rms": 0.24, "mean": 0.24, "median": 0.24, "p95": 0.24, "max": 0.24
    }  # fmt: skip
    assert summary["per_keypoint_px"]["tip_2"]["n"] == 7
    assert summary["angle_error_deg"]["n"] == 7
    assert summary["angle_error_deg"]["mean"] == pytest.approx(np.rad2deg(np.arctan(0.01)), abs=1e-3)
    assert summary["per_actuator"]["a"]["error_px"]["n"] + summary["per_actuator"]["b"]["error_px"]["n"] == 31
    assert summary["end_vector_px"] == pytest.approx(24.0, abs=1e-3)
    assert summary["floor_for_1px_labels_deg"] == pytest.approx(np.rad2deg(2 / (5 * 24)), abs=1e-3)
    # A frame that is held out was clicked once: n = 1.
    assert summary["one_label_of_1px_deg"] == pytest.approx(np.rad2deg(2 / 24), abs=1e-3)


def test_files_and_figures_are_written(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 150, 5))
    frames[1].xy[2] = np.nan
    result = off_by(frames, np.full((4, 2), 1.0), definition)
    written = write_evaluation(result, tmp_path / "evaluation.json", model="m")
    assert json.loads((tmp_path / "evaluation.json").read_text()) == written
    assert written["model"] == "m"
    rows = [{"step": s, "loss": 1 / s, "held_out_px": 3 / s} for s in (50, 100)]
    paths = write_figures(result, rows, tmp_path)
    assert sorted(p.name for p in paths) == ["errors.png", "learning-curve.png", "worst-frames.png"]
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in paths)


@pytest.mark.parametrize("losses", [(1.425, 1.41, 1.38), (3.0, 0.5, 0.02), (0.0213, 0.0209, 0.0201)])
def test_the_learning_curve_has_plain_numbers_on_its_axis(losses: tuple[float, ...]) -> None:
    rows = [{"step": 50 * i, "loss": loss, "held_out_px": 2 * loss} for i, loss in enumerate(losses, 1)]
    figure = _learning_curve(rows)
    figure.canvas.draw()
    for axes in figure.axes:
        low, high = axes.get_ylim()
        labels = [
            tick.get_text()
            for place, tick in zip(axes.get_yticks(), axes.get_yticklabels(), strict=True)
            if low <= place <= high
        ]
        assert len(labels) >= 2
        assert all(re.fullmatch(r"[0-9.]+", label) for label in labels), labels  # 1.42, and no 1.425 x 10^0
        assert not [tick for tick in axes.get_yticklabels(minor=True) if tick.get_text()]


def test_the_learning_curve_has_whole_steps_and_is_not_drawn_from_two_points() -> None:
    rows = [{"step": step, "loss": 1 / step, "held_out_px": 3 / step} for step in (1, 2, 3)]
    figure = _learning_curve(rows)
    figure.canvas.draw()
    for axes in figure.axes:
        assert all(tick == round(tick) for tick in axes.get_xticks())
        assert len(axes.lines) == 1
    for few in (rows[:1], rows[:2]):
        for axes in _learning_curve(few).axes:
            assert len(axes.lines) == 0
            assert "too few for a curve" in axes.texts[0].get_text()


@pytest.mark.parametrize(("n", "style"), [(3, ("None", "o")), (12, ("-", "None"))])
def test_few_errors_are_dots(
    make_frames: MakeFrames, definition: AngleDefinition, n: int, style: tuple[str, str]
) -> None:
    figure = _errors(off_by(make_frames(np.linspace(0, 150, n)), np.full((4, 2), 1.0), definition))
    for axes in figure.axes:
        for line in axes.lines:
            assert (line.get_linestyle(), line.get_marker()) == style
            # Steps begin at (0, 0); each dot is a frame.
            assert len(line.get_xdata()) == n + (style[1] == "None")


def test_actuators_are_spread_evenly_over_folds() -> None:
    frames = [LabelledFrame(a, Path(f"{i}.png"), np.zeros((4, 2)), a) for i, a in enumerate("pppppppppqqqq")]
    part = fold_of_each(frames, 3, seed=0)
    for actuator, most in (("p", 3), ("q", 2)):
        own = [p for p, frame in zip(part, frames, strict=True) if frame.actuator == actuator]
        assert max(own.count(fold) for fold in range(3)) <= most


def test_cross_validation_evaluates_every_frame_once(
    make_frames: MakeFrames, definition: AngleDefinition
) -> None:
    frames = make_frames(np.linspace(0, 150, 6))
    settings = TrainingSettings(init="random", steps=2, batch_frames=2)
    reported = []
    result = cross_validate(
        frames,
        definition.points,
        definition,
        settings,
        2,
        progress=lambda fold, p: reported.append((fold, p.step)),
    )
    assert sorted(f.image_path.name for f in result.frames) == sorted(f.image_path.name for f in frames)
    assert result.n_trained == 3
    assert reported == [(0, 1), (0, 2), (1, 1), (1, 2)]
    with pytest.raises(TrainingError, match=r"expected 2 to 6 .* got 9"):
        cross_validate(frames, definition.points, definition, settings, 9)
