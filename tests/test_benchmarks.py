"""The benchmarks run, small: their figures mean nothing here, but they must not rot."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"

SMALL = {
    "accuracy.py": (
        ["--looks", "1", "--steps", "3", "--labels", "6", "--seconds", "1.5", "--init", "random"],
        "angle RMSE over label-noise floor",
    ),
    "frames.py": (["--looks", "1", "--seconds", "4", "--size", "200x150"], "largest gap: at most"),
    "label_server.py": (["--clicks", "4", "--large", "1"], "a click, saved"),
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
    "speed.py": (["--seconds", "1.5", "--rounds", "1", "--steps", "2"], "ratio to decoding alone"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_benchmark_prints_its_figures(name: str) -> None:
    arguments, expected = SMALL[name]
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / name), *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    assert expected in done.stdout
