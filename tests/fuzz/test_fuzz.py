"""A bounded fuzz of every reader: what failed before (corpus/), then mutated files for some seconds."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"
SECONDS = 12


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory and time are Linux's")
def test_every_file_gives_a_result_or_one_line(tmp_path: Path) -> None:
    # In a process of its own, whose memory is limited. The seed is fixed: a failure comes again.
    ran = subprocess.run(
        [sys.executable, FUZZ, "--minutes", str(SECONDS / 60), "--seed", "27", "--keep", tmp_path],
        capture_output=True,
        text=True,
        timeout=20 * SECONDS,
        check=False,
    )
    assert ran.returncode == 0, f"{ran.stdout}\n{ran.stderr[-2000:]}\nkept in {tmp_path}"
    assert " 0 kinds of failures" in ran.stdout.splitlines()[-1]


def test_what_failed_before_is_read_again() -> None:
    kept = {path.parent.name for path in (FUZZ.parents[1] / "tests" / "fuzz" / "corpus").glob("*/*")}
    listed = subprocess.run(
        [sys.executable, FUZZ, "--help"], capture_output=True, text=True, check=True
    ).stdout
    assert kept
    assert all(name in listed for name in kept)
