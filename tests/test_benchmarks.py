"""The benchmarks run, small: their figures mean nothing here, but they must not rot."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"

SMALL = {
    "accuracy.py": (
        ["--looks", "1", "--steps", "3", "--labels", "6", "--seconds", "1.5", "--init", "random"],
        "angle RMSE over label-noise floor",
    ),
    "films.py": (["--only", "gif"], "sound films called damaged"),
    "frames.py": (["--looks", "1", "--seconds", "4", "--size", "200x150"], "largest gap: at most"),
    "kills.py": (
        [
            *("--trials", "1", "--command", "export", "--command", "first-study", "--command", "label"),
            *("--trouble", "killed", "--trouble", "full", "--trouble", "twice"),
        ],
        ", 0 wrong",
    ),
    "label_server.py": (["--clicks", "4", "--large", "1"], "a click, saved"),
    "look_alikes.py": (
        ["--films", "1", "--frames", "8", "--trouble", "body", "--trouble", "shaking"],
        "the actuator in at least 90 % of its frames: 1 of 1",
    ),
    "study.py": (
        ["--designs", "2", "--fast-only", "--rounds", "1", "--studies", "1"],
        "the tables' errors over 1 studies",
    ),
    "study_video.py": (
        [
            *("--steps", "3", "--labels", "6", "--cycles", "1", "--designs", "1", "--fast-only"),
            *("--init", "random", "--keep-doubtful"),
        ],
        "largest error of a hysteresis ratio",
    ),
    "stream.py": (["--pictures", "12", "--frames", "3"], "256 x 256, every look"),
    "few_labels.py": (
        # The seventh look is seen surely everywhere: nothing is learnt of it without labels, which takes long.
        [
            *("--first", "6", "--looks", "1", "--labels", "0", "--labels", "5"),
            *("--steps", "3", "--frames", "24", "--init", "actuator"),
        ],
        "goals: 3 degrees and 95 % found",
    ),
    "coverage.py": (
        [*("--known", "--looks", "1", "--labels", "5"), *("--steps", "3", "--frames", "24")],
        "over the looks; goal: 93 to 97 % in each",
    ),
    "ablation.py": (
        [*("--looks", "1", "--seeds", "1", "--labels", "5"), *("--steps", "3", "--frames", "12")],
        "without the stage, minus with it",
    ),
    "speed.py": (["--seconds", "1.5", "--rounds", "1", "--steps", "2"], "ratio to decoding alone"),
}


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Torch with one thread, as two tests run at a time."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("name", SMALL)
def test_benchmark_prints_its_figures(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # In this process: a new one would load torch and compile the shipped network again for each benchmark.
    arguments, expected = SMALL[name]
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        module = importlib.import_module(Path(name).stem)
        module.main()
    assert expected in capsys.readouterr().out
