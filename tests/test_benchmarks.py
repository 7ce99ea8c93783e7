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
    "label_server.py": (["--clicks", "4", "--large", "1"], "a click, saved"),
    "speed.py": (["--seconds", "1.5", "--rounds", "1", "--steps", "2"], "decode to table / decoding"),
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
