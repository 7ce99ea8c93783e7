"""The whole way of a new user, small: its figures mean nothing here, but it must not rot."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "labelling.py"


@pytest.mark.slow
def test_frames_labelled_on_the_page_make_a_network(browser_file: str) -> None:
    words = ["--seconds", "1.5", "--count", "12", "--steps", "3"]
    done = subprocess.run([sys.executable, str(BENCHMARK), *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "12 of 12 labelled" in done.stdout
    # Every point reached the file that was meant for it: a wrong frame would be tens of px off.
    [line] = [line for line in done.stdout.splitlines() if line.startswith("labels: ")]
    assert float(line.split()[3]) < 1.5
    assert "of the label-noise floor" in done.stdout
