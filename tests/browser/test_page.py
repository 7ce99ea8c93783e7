"""Everything else on the page: the angle, suggestions, the film strip, notes, repeats, large images, the look."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_driver import KEYPOINTS
from playwright.sync_api import expect

from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.models.networks.checkpoint import load_checkpoint
from bendtrack.tracker.angle import DEFINITIONS, AngleDefinition, bending_angle
from bendtrack.tracker.project import Project

RNG_SEED = 7


def test_the_angle_is_the_trackers(labeller) -> None:
    """Four definitions over random chains, straight ones, ones beyond 180 degrees and ones with gaps."""
    rng = np.random.default_rng(RNG_SEED)
    cases = []
    for name in DEFINITIONS:
        for count in (3, 4, 5, 7):
            if count < {"two-vector": 4}.get(name, 3) or (name == "three-point" and count != 3):
                continue
            names = [f"p{i}" for i in range(count)]
            along = np.linspace(0, 1, count)
            for sweep_deg in (*rng.uniform(-300, 300, 30), 0.0):
                heading = np.radians(rng.uniform(0, 360) + sweep_deg * along)
                steps = rng.uniform(20, 60) * np.stack([np.cos(heading), np.sin(heading)], axis=1)
                noise_px = 0.0 if sweep_deg == 0 else 0.7
                cases.append(
                    (name, names, 200 + np.cumsum(steps, axis=0) + rng.normal(0, noise_px, (count, 2)))
                )
            cases += [(name, names, rng.uniform(0, 600, (count, 2))) for _ in range(20)]
            cases.append((name, names, np.vstack([cases[-1][2][:1]] * count)))
            cases.append((name, names, np.vstack([cases[-2][2][:-1], [[np.nan, np.nan]]])))
    sent = [
        {
            "definition": {"name": name, "points": names, "sign": -1 if i % 3 else 1},
            "points": {n: None if np.isnan(p).any() else list(p) for n, p in zip(names, xy, strict=True)},
        }
        for i, (name, names, xy) in enumerate(cases)
    ]
    shown = labeller.page.evaluate(
        """async cases => { const { bendingAngleDeg } = await import("/page/angle.js");
            return cases.map(({ points, definition }) => bendingAngleDeg(points, definition)); }""",
        sent,
    )
    for (name, names, xy), case, angle in zip(cases, sent, shown, strict=True):
        definition = AngleDefinition(name, tuple(names), case["definition"]["sign"])
        expected = bending_angle(xy[None], names, definition)[0][0]
        assert (np.nan if angle is None else angle) == pytest.approx(expected, abs=1e-6, nan_ok=True), case


def test_the_angle_on_the_page(labeller, sample_truth) -> None:
    """Live, in the tracker's definition and sign, beyond 180 degrees."""
    image, truth = "img00300.png", sample_truth["img00300.png"]
    labeller.open(image)
    for xy in truth:
        assert labeller.angle_deg() is None
        labeller.click(xy)
    labeller.saved()
    definition = AngleDefinition("two-vector", KEYPOINTS)
    clicked = labeller.xy_on_disk(image)
    unsigned = bending_angle(clicked[None], KEYPOINTS, definition)[0][0]
    assert abs(unsigned) > 180
    # The labels themselves say which way is positive, as soon as there are some.
    expect(labeller.page.locator("#angle")).not_to_contain_text("\N{MINUS SIGN}")
    assert labeller.angle_deg() == pytest.approx(abs(unsigned), abs=0.006)
    at = labeller.screen(clicked[3])
    labeller.page.mouse.move(*at)
    labeller.page.mouse.down()
    labeller.page.mouse.move(at[0] + 30, at[1] + 12, steps=3)
    moved = clicked.copy()
    moved[3] += np.array([30, 12]) / labeller.view()[0]
    expected = abs(bending_angle(moved[None], KEYPOINTS, definition)[0][0])
    assert labeller.angle_deg() == pytest.approx(expected, abs=0.05)  # before the button is let go
    labeller.press("Escape")  # and back
    assert labeller.angle_deg() == pytest.approx(abs(unsigned), abs=0.006)
    labeller.page.mouse.up()
    labeller.saved()
    assert labeller.xy_on_disk(image) == pytest.approx(clicked)


def test_suggestions_copies_and_the_film_strip(make_session, sample_project, sample_truth) -> None:
    store = LabelStore.of(sample_project)
    images = list(sample_truth)
    store.write("video", {image: sample_truth[image] for image in (images[0], images[2])})
    labeller = make_session(sample_project.root).page()
    page = labeller.page
    assert page.locator("#stage").get_attribute("data-frame") == f"video/{images[1]}"  # the first to do
    labeller.press("g")
    labeller.saved()
    accepted = labeller.xy_on_disk(images[1])
    low, high = np.sort([sample_truth[images[0]], sample_truth[images[2]]], axis=0)
    assert ((accepted > low - 0.02) & (accepted < high + 0.02)).all()  # between its neighbours

    labeller.press("n")
    labeller.opened(images[3])
    labeller.press("c")
    labeller.saved()
    assert labeller.xy_on_disk(images[3]) == pytest.approx(sample_truth[images[2]], abs=0.0051)

    counts = page.locator("#filters b").all_inner_texts()
    assert counts == ["10", "6", "0", "0"]
    labeller.press("f", "m")
    page.keyboard.type("glare; a k and an x in it")
    labeller.press("Escape")
    labeller.saved()
    page.reload()
    labeller.opened(images[3])
    assert page.locator("#note").input_value() == "glare; a k and an x in it"
    assert page.locator("#flag").get_attribute("aria-pressed") == "true"
    assert labeller.xy_on_disk(images[3]) == pytest.approx(sample_truth[images[2]], abs=0.0051)
    page.get_by_role("radio", name="Flagged").click()
    assert page.locator(".film-frame").count() == 1
    page.get_by_role("radio", name="To do").click()
    labeller.press("d")  # from the flagged one, which stays while it is open, to the next to do
    labeller.opened(images[4])
    labeller.press("k")
    labeller.saved()
    page.get_by_role("radio", name="All").click()
    assert page.locator('.film-frame[data-state="skipped"]').count() == 1
    assert page.locator("#progress-text").inner_text() == "4 of 9 labelled"


@pytest.mark.slow
def test_the_network_as_suggestions(make_session, trained_project) -> None:
    """A network that has learnt next to nothing and is sure of it: it disagrees with labels, and the page says so."""
    network = trained_project.models_dir / "model"
    checkpoint = load_checkpoint(network)
    sure = replace(checkpoint.calibration, scale=1e-9, label_sd_px=0.0)
    replace(checkpoint, calibration=sure).save(network)
    labeller = make_session(trained_project.root).page()
    page = labeller.page
    worst = page.get_by_role("radio", name="Worst")
    expect(worst).to_contain_text("10", timeout=60_000)  # looked at one after the other, unasked
    worst.click()
    expect(page.locator(".film-frame .fine").filter(has_not_text="Δ")).to_have_count(0)
    distances = [float(w.split()[1]) for w in page.locator(".film-frame .fine").all_inner_texts()]
    assert distances == sorted(distances, reverse=True)
    assert distances[0] > 5
    image = page.locator(".film-frame").first.get_attribute("data-id").partition("/")[2]
    labeller.open(image, "arm")
    expect(page.locator(".point.warning")).not_to_have_count(0)
    assert f"{distances[0]:.1f} px" in page.locator("#points").inner_text()
    label = labeller.xy_on_disk(image, "arm")
    labeller.press("g")  # nothing is missing: no label is replaced by accident
    assert labeller.xy_on_disk(image, "arm") == pytest.approx(label)
    labeller.press("Shift+G")
    labeller.saved()
    expect(page.locator(".point.warning")).to_have_count(0)
    assert np.abs(labeller.xy_on_disk(image, "arm") - label).max() > 2


def test_blind_repeats(make_session, sample_project, sample_truth) -> None:
    store = LabelStore.of(sample_project)
    store.write("video", sample_truth)
    labeller = make_session(sample_project.root).page()
    page = labeller.page
    answers: list[str] = []
    page.on(
        "response", lambda r: "/api/repeats/next" in r.url and r.status == 200 and answers.append(r.text())
    )
    page.locator("#repeats-due").click()
    page.wait_for_selector(".repeating")
    for _ in range(20):
        expect(page.locator(".point.target")).to_have_count(1)
        assert np.isnan(points_shown(labeller)).all()
        repeated = json.loads(answers[-1])
        assert "points" not in repeated
        for xy in sample_truth[repeated["image"]] + [3.0, 0.0]:  # a steady hand, 3 px to the right
            labeller.click(xy)
        assert labeller.angle_deg() is None  # not even that is told
        labeller.press("Enter")
        page.wait_for_selector("body:not(.repeating), .point.target")
        if not page.locator(".repeating").count():
            break
    assert len(answers) >= 1
    labeller.press("i")
    page.wait_for_selector("#summary[open]")
    words = page.locator("#summary").inner_text()
    spread_px = float(page.locator(".figure b").first.inner_text().removesuffix(" px"))
    # Both labels are off: the spread of one is the difference over the root of two, over two axes.
    assert spread_px == pytest.approx(3 / 2, abs=0.5)
    assert "60 px" in words  # the end vectors of the sample
    assert "0.3" in words or "0.9" in words or "1.0" in words
    assert LabelStore.of(sample_project).read()[0].xy == pytest.approx(sample_truth["img00086.png"])


def test_a_4k_frame_is_ready_before_it_is_wanted(make_session, tmp_path: Path, capsys) -> None:
    rng = np.random.default_rng(RNG_SEED)
    project = Project.create(tmp_path / "large", keypoints=KEYPOINTS)
    for frame in range(3):
        coarse = rng.integers(0, 255, (135, 240, 3), dtype=np.uint8)
        LabelStore.of(project).add_image(
            "video", image_name(frame), np.kron(coarse, np.ones((16, 16, 1), np.uint8))
        )
    asked: list[str] = []
    session = make_session(project.root)
    session.on_request = lambda url: "/image?" in url and asked.append(url.split("/")[-2])
    labeller = session.page()
    page = labeller.page
    labeller.until(lambda: len(set(asked)) == 3)
    page.wait_for_function(
        "() => performance.getEntriesByType('resource').filter(e => e.name.includes('/image?')).length === 3"
    )
    asked.clear()
    for frame in (1, 2):
        labeller.press("d")
        labeller.opened(image_name(frame))
    assert asked == []
    times = page.evaluate("performance.getEntriesByName('frame opened').map(e => e.duration)")
    with capsys.disabled():
        print(f"\n3840 x 2160: first frame {times[0]:.0f} ms, then {times[1]:.0f} and {times[2]:.0f} ms")


def test_tone_theme_help_and_loupe(labeller) -> None:
    page = labeller.page

    def middle() -> bytes:
        box = page.locator("#stage").bounding_box()
        page.mouse.move(5, 5)
        labeller.view()  # what hung on the pointer is gone
        clip = {"x": box["x"] + 300, "y": box["y"] + 200, "width": 200, "height": 200}
        return page.screenshot(clip=clip)

    plain = middle()
    for slider in ("brightness", "contrast", "gamma"):
        page.locator(f"#{slider}").focus()
        labeller.press("ArrowRight", "ArrowRight", "ArrowRight")
        assert middle() != plain
        page.locator("#tone-reset").click()
        assert middle() == plain
    dark = "() => getComputedStyle(document.querySelector('header')).backgroundColor"
    before = page.evaluate(dark)
    page.locator("#theme").click()
    assert page.evaluate(dark) != before
    page.reload()
    page.wait_for_selector("#stage[data-frame]")
    assert page.evaluate(dark) != before  # remembered
    labeller.press("?")
    expect(page.locator("#help[open]")).to_be_visible()
    assert "next frame" in page.locator("#help").inner_text()
    labeller.press("Escape")
    expect(page.locator("#help")).not_to_be_visible()
    page.mouse.move(*labeller.screen(np.array([300.0, 200.0])))
    expect(page.locator("#loupe")).to_be_visible()
    labeller.press("l")
    expect(page.locator("#loupe")).not_to_be_visible()


def points_shown(labeller) -> np.ndarray:
    words = labeller.page.locator("#points .point-value").all_inner_texts()
    return np.array([[float(c) for c in w.split()] if len(w.split()) == 2 else [np.nan] * 2 for w in words])


def test_frames_that_come_and_go(make_session, sample_project) -> None:
    session = make_session(sample_project.root)
    labeller = session.page()
    page, folder = labeller.page, sample_project.labels_dir / "video"
    images = {path: path.read_bytes() for path in folder.glob("*.png")}
    for path in images:
        path.unlink()
    expect(page.locator("#empty")).to_contain_text("bendtrack frames", timeout=15_000)
    for path, data in list(images.items())[:3]:
        path.write_bytes(data)
    expect(page.locator(".film-frame")).to_have_count(3, timeout=15_000)
    expect(page.locator("#points")).to_be_visible()
    # What was not there was asked for, and refused.
    session.problems[:] = [problem for problem in session.problems if not re.search("404|503", problem)]
