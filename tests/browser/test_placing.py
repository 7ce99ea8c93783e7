"""Points: what is clicked, dragged and nudged is what the label file says."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from page_driver import KEYPOINTS
from playwright.sync_api import expect


def test_five_frames_of_the_sample_trial(labeller, sample_truth, capsys) -> None:
    page, click_to_saved_ms, frame_to_frame_ms = labeller.page, [], []
    page.evaluate(
        """() => {
            window.times = {down: 0, saved: [], opened: []};
            document.addEventListener("pointerup", () => window.times.up = performance.now(), true);
            new MutationObserver(() => {
                if (document.getElementById("saving").dataset.state === "saved" && window.times.up)
                    window.times.saved.push(performance.now() - window.times.up);
            }).observe(document.getElementById("saving"), {attributes: true, attributeFilter: ["data-state"]});
        }"""
    )
    for index, (image, truth) in enumerate(list(sample_truth.items())[:5]):
        labeller.open(image)
        if index >= 2:  # the last three: each point in the middle of the stage, four times as large
            labeller.zoom_to(4.0, truth[0])
        for k, xy in enumerate(truth):
            if index >= 2:
                labeller.pan_to_middle(xy)
            clicked = labeller.click(xy)
            labeller.saved()
            at_zoom_4 = 0.25 if index >= 2 else 0.5 / labeller.view()[0] + 0.01
            assert np.abs(clicked - xy).max() <= at_zoom_4  # the mouse knows whole screen pixels only
            assert labeller.xy_on_disk(image)[k] == pytest.approx(
                clicked, abs=0.0051
            )  # two decimals are kept
        assert labeller.xy_on_disk(image) == pytest.approx(truth, abs=at_zoom_4)
    done = page.locator('.film-frame[data-state="labelled"]').count()
    assert (done, page.locator("#progress-text").inner_text()) == (5, "5 of 10 labelled")
    click_to_saved_ms = page.evaluate("window.times.saved")
    frame_to_frame_ms = page.evaluate("performance.getEntriesByName('frame opened').map(e => e.duration)")[1:]
    with capsys.disabled():
        print(
            f"\nclick to saved: median {np.median(click_to_saved_ms):.0f} ms of {len(click_to_saved_ms)};"
            f" frame to frame: median {np.median(frame_to_frame_ms):.0f} ms of {len(frame_to_frame_ms)}"
        )


def test_the_open_frame_chosen_again_takes_clicks_at_once(labeller, sample_truth) -> None:
    image = labeller.page.locator("#stage").get_attribute("data-frame").removeprefix("video/")
    held = []
    labeller.page.route("**/api/frames/**", lambda route: held.append(route), times=1)  # a slow server
    labeller.open(image)
    labeller.until(lambda: bool(held))
    clicked = labeller.click(sample_truth[image][0])
    held[0].continue_()
    labeller.saved()
    assert labeller.xy_on_disk(image)[0] == pytest.approx(clicked, abs=0.0051)


def test_what_is_seen_is_what_is_saved(make_session, discs_project) -> None:
    """Where a disc is on the screen is taken from a screenshot, not from the page; on screens of both kinds."""
    project, truth = discs_project
    session = make_session(project.root)
    for image, ratio in (("img00000.png", 1), ("img00001.png", 2)):
        labeller = session.page(pixel_ratio=ratio)
        labeller.open(image)
        labeller.press("l")  # no loupe over the discs
        for k, (xy, zoom) in enumerate(zip(truth, (None, 4.0), strict=False)):
            if zoom:
                labeller.zoom_to(zoom, xy)
            labeller.page.mouse.click(*seen_disc(labeller, xy, ratio))
            labeller.saved()
            saved = np.array(labeller.on_disk(image)[KEYPOINTS[k]])
            assert saved == pytest.approx(xy, abs=0.15 if zoom else 0.4)
        labeller.page.close()


def seen_disc(labeller, xy: np.ndarray, ratio: int) -> tuple[float, float]:
    """Where in the window the disc near a position is, by its light."""
    labeller.page.mouse.move(5, 5)
    near, reach = np.floor(labeller.screen(xy)), np.ceil(9 * labeller.view()[0])
    clip = {"x": near[0] - reach, "y": near[1] - reach, "width": 2 * reach, "height": 2 * reach}
    shot = np.frombuffer(labeller.page.screenshot(clip=clip), np.uint8)
    light = cv2.imdecode(shot, cv2.IMREAD_GRAYSCALE).astype(float)
    light[light < 40] = 0  # the surround of the image is not quite black
    y, x = (np.mgrid[: light.shape[0], : light.shape[1]] + 0.5) / ratio
    return clip["x"] + (light * x).sum() / light.sum(), clip["y"] + (light * y).sum() / light.sum()


def test_drag_nudge_remove_and_not_visible(labeller, sample_truth) -> None:
    image, truth = "img00178.png", sample_truth["img00178.png"]
    labeller.open(image)
    placed = [labeller.click(xy) for xy in truth[:2]]
    labeller.saved()
    before = labeller.xy_on_disk(image)
    assert before[:2] == pytest.approx(np.array(placed), abs=0.0051)

    start = labeller.screen(before[0])
    labeller.page.mouse.move(start[0] + 2, start[1] - 1)  # not quite in its middle
    labeller.page.mouse.down()
    labeller.page.mouse.move(start[0] + 22, start[1] + 9, steps=5)
    labeller.page.mouse.up()
    labeller.saved()
    scale = labeller.view()[0]
    assert labeller.xy_on_disk(image)[0] == pytest.approx(before[0] + np.array([20, 10]) / scale, abs=0.011)

    dragged = labeller.xy_on_disk(image)[0]
    labeller.press("ArrowRight", "ArrowRight", "ArrowUp", "Shift+ArrowDown", "Shift+ArrowLeft")
    labeller.saved()
    assert labeller.xy_on_disk(image)[0] == pytest.approx(dragged + np.array([0.5 - 1, -0.25 + 1]), abs=1e-6)

    labeller.press("3", "x")
    labeller.saved()
    assert labeller.page.locator("#points .point").nth(2).inner_text().split("\n")[1] == "not visible"
    labeller.press("2", "Delete")
    labeller.saved()
    assert np.isnan(labeller.xy_on_disk(image)).all(axis=1).tolist() == [False, True, True, True]
    # A click fills the gap first, then goes on where it was.
    labeller.click(truth[1])
    labeller.click(truth[3])
    labeller.saved()
    assert np.isnan(labeller.xy_on_disk(image)).all(axis=1).tolist() == [False, False, True, False]
    assert labeller.state(image) == "labelled"


def test_a_click_beside_the_picture_places_nothing(labeller, sample_truth) -> None:
    image = "img00260.png"
    labeller.open(image)
    labeller.click(np.array([-6.0, 100.0]))
    assert "outside" in labeller.page.locator("#message").inner_text()
    labeller.click(np.array([0.0, 0.0]))
    labeller.saved()
    assert np.abs(labeller.xy_on_disk(image)[0]).max() < 0.5


def test_all_by_keyboard(labeller, sample_truth) -> None:
    """A frame without touching the mouse: aim with the arrows, place with Enter, go on with Enter."""
    image, truth = "img00300.png", sample_truth["img00300.png"]
    for _ in range(len(sample_truth)):
        opened = labeller.page.locator("#stage").get_attribute("data-frame")
        if opened == f"video/{image}":
            break
        labeller.press("d")
        expect(labeller.page.locator("#stage")).not_to_have_attribute("data-frame", str(opened))
    for k, xy in enumerate(truth):
        labeller.press("Enter")  # the crosshair
        target = np.round(xy * 4) / 4
        for _ in range(200):
            at = np.array([float(c) for c in aimed(labeller).split(", ")])
            away = target - at
            axis = int(np.argmax(np.abs(away)))
            if np.abs(away).max() < 0.3:
                break
            arrow = (("ArrowLeft", "ArrowRight"), ("ArrowUp", "ArrowDown"))[axis][int(away[axis] > 0)]
            big = 16  # a fortieth of what is visible, as the page has it at this size
            labeller.press(
                ("Alt+" if abs(away[axis]) > big else "Shift+" if abs(away[axis]) >= 1 else "") + arrow
            )
        labeller.press("Enter")
        labeller.saved()
        assert np.abs(labeller.xy_on_disk(image)[k] - xy).max() < 0.5
    assert labeller.angle_deg() is not None
    labeller.press("Enter")
    labeller.opened("img00358.png")
    # Tab reaches every control, in an order; each says what it is.
    seen = []
    for _ in range(40):
        labeller.press("Tab")
        seen.append(
            labeller.page.evaluate(
                """() => {
                    const e = document.activeElement;
                    return e.id || e.getAttribute("aria-label") || e.textContent;
                }"""
            )
        )
    for control in (
        "undo",
        "redo",
        "open-summary",
        "theme",
        "open-help",
        "stage",
        "fit",
        "flag",
        "note",
        "gamma",
    ):
        assert control in seen
    unnamed = labeller.page.evaluate(
        """() => [...document.querySelectorAll("button, input, textarea, [role]")].filter(e =>
            e.checkVisibility() && !(e.getAttribute("aria-label") || e.textContent.trim() ||
            (e.labels && e.labels.length) || e.getAttribute("aria-labelledby") || e.tagName === "OUTPUT" ||
            ["status", "presentation", "alert"].includes(e.getAttribute("role")))).map(e => e.outerHTML)"""
    )
    assert unnamed == []


def aimed(labeller) -> str:
    labeller.view()
    return labeller.page.locator("#position").inner_text()
