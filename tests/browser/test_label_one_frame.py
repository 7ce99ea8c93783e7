"""bendtrack angle --label: one frame is chosen, labelled on the page, and the whole video is measured."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from page_driver import Labeller, PageSession, Server
from playwright.sync_api import expect

import bendtrack as bt
from bendtrack.labeling.store import LabelStore
from bendtrack.measuring import LABELS_FOLDER
from bendtrack.tracker.results import read_results
from bendtrack.tracker.synthetic.stream import KEYPOINTS, TRAINING, Renderer, drawn_look, inflation_deg
from bendtrack.tracker.video_writer import VideoWriter

ENDS = [KEYPOINTS.index(name) for name in ("base_1", "base_2", "tip_1", "tip_2")]
STEPS = 60


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, np.ndarray]:
    """A slow inflation, its ends (T, 4, 2) px and its angle (T,) degrees."""
    path = tmp_path_factory.mktemp("film") / "finger.mp4"
    look = drawn_look(21, 3, size_wh=(400, 300), families=TRAINING, bend_deg=(0.0, 150.0))
    renderer, samples = Renderer(look), []
    with VideoWriter(path, (400, 300), frame_rate=30) as writer:
        for index, bend in enumerate(inflation_deg(look, 36)):
            samples.append(renderer.frame(float(bend), noise_seed=index))
            writer.write(samples[-1].image)
    return path, np.array([s.keypoints_xy[ENDS] for s in samples]), np.array([s.angle_deg for s in samples])


@pytest.fixture
def asked(
    film, chromium, bendtrack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[PageSession, Labeller]]:
    """The command at work, and its page."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    out = tmp_path / "out"
    project = bt.new_project(out / LABELS_FOLDER)
    settings = project.path / "bendtrack.toml"
    settings.write_text(settings.read_text().replace("[training]", f"[training]\nsteps = {STEPS}"))
    words = "angle", film[0], "--label", "--out", out, "--engine", "torch"
    session = PageSession(Server(bendtrack.command, project.path, *words), chromium)
    yield session, session.page()
    session.close()
    assert session.problems == []


@pytest.mark.slow
def test_four_clicks_measure_the_whole_video(asked, film, bendtrack, tmp_path: Path) -> None:
    session, labeller = asked
    path, ends, truth_deg = film
    [image] = LabelStore.of(bt.open_project(session.server.root).folder).images("finger")
    frame = int(image.stem.removeprefix("img"))
    assert 0.2 < truth_deg[frame] / truth_deg.max() < 0.8  # from the middle of the motion
    labeller.opened(image.name, "finger")
    measure = labeller.page.get_by_role("button", name="Measure", exact=True)
    expect(measure).to_be_disabled()
    for xy in ends[frame]:
        labeller.click(xy)
    measure.click()
    labeller.page.wait_for_selector("#empty:not([hidden])")
    status, printed = session.server.ended()
    assert status == 0, printed
    assert "more of finger are learnt from" in printed
    table = read_results(tmp_path / "out" / "finger.h5")
    assert (table.flag == "").mean() > 0.95
    assert np.sqrt(np.mean((table.angle_deg - truth_deg) ** 2)) < 2
    # Once more: labelled, trained and measured already.
    again = bendtrack("angle", path, "--label", "--out", tmp_path / "out", "--engine", "torch")
    assert again.status == 0
    assert "up to date" in again.out
    assert "steps in" not in again.out


def test_ctrl_c_before_the_clicks_keeps_the_frame(asked, bendtrack, tmp_path: Path) -> None:
    session, labeller = asked
    labeller.page.close()
    session.server.interrupt()
    status, printed = session.server.ended()
    assert status == 130, printed
    assert "Traceback" not in printed
    assert not list((tmp_path / "out").glob("*.csv"))
    assert len(list((session.server.root / "labeled-data" / "finger").glob("*.png"))) == 1
