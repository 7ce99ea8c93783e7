"""README's tour, as a new user goes it: every command does what is said, or says what to do next."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bendtrack.labeling.store import LabelStore, frame_index
from bendtrack.tracker.project import Project
from bendtrack.tracker.results import read_results


@pytest.mark.slow
def test_each_step_leads_to_the_next(
    bendtrack, tmp_path: Path, monkeypatch, write_arm_video, arm_in_frame, tiny_training: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("videos").mkdir()
    frames = 120
    write_arm_video(Path("videos/bend.mp4"), frames)

    ran = bendtrack("new", "my study")
    assert (ran.status, ran.err) == (0, "")
    assert "Next: bendtrack frames 'my study' VIDEO..." in ran.out
    toml = Path("my study/bendtrack.toml")
    toml.write_text(toml.read_text().replace("[training]\n", f"[training]\n{tiny_training}"))

    ran = bendtrack("frames", "my study", "videos", "--count", 8)
    assert (ran.status, ran.err) == (0, "")
    assert "Next: bendtrack label 'my study'" in ran.out

    ran = bendtrack("train", "my study")  # too early
    assert ran.status == 2
    assert "`bendtrack label 'my study'` opens the page" in ran.err

    # What a user clicks on the page.
    store = LabelStore.of(Project.open("my study"))
    images = [path.name for path in store.images("bend")]
    store.write("bend", {name: arm_in_frame(frame_index(name), frames) for name in images})

    ran = bendtrack("train", "my study")
    assert (ran.status, ran.err) == (0, "")
    assert "Next: bendtrack track 'my study' VIDEO..." in ran.out
    assert bendtrack("evaluate", "my study").status == 0

    ran = bendtrack("track", "my study", "videos", "--overlay", "--engine", "torch")
    assert (ran.status, ran.err) == (0, "")
    assert len(read_results("my study/results/bend.csv")) == frames
    assert Path("my study/results/bend.overlay.mp4").is_file()

    ran = bendtrack("analyze", "--init", "my study")
    assert ran.status == 2
    wanted = re.search(r"copy the one of 'bend' to (.*)$", ran.err)
    assert wanted is not None
    log = Path(wanted[1])
    log.parent.mkdir()
    time_s = np.arange(0, frames / 30, 0.01)
    rows = "".join(f"{t:.2f},{20 - 20 * np.cos(2 * np.pi * t / (frames / 30)):.3f}\n" for t in time_s)
    log.write_text(f"time_s,pressure_kpa\n{rows}")
    ran = bendtrack("analyze", "--init", "my study")
    assert (ran.status, ran.err) == (0, "")
    assert "bendtrack analyze 'my study/study.toml'" in ran.out
    # This network has learnt next to nothing, so its angles may be refused; that is said, without a traceback.
    ran = bendtrack("analyze", "my study/study.toml")
    assert ran.status in (0, 2)
    assert "Traceback" not in ran.err
