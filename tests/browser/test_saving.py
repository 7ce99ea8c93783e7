"""Nothing is lost and nothing is overwritten: undo over a reload, a killed server, two tabs."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from playwright.sync_api import Route, expect


def test_undo_and_redo_over_a_reload(labeller, sample_truth) -> None:
    image, other = "img00086.png", "img00098.png"
    page, truth = labeller.page, sample_truth[image]
    labeller.open(image)
    for xy in truth:
        labeller.click(xy)
    labeller.saved()
    placed = labeller.xy_on_disk(image)
    labeller.open(other)
    labeller.click(truth[0])
    page.reload()  # in the middle of saving, perhaps
    labeller.opened(other)  # the same frame is open again
    expect(page.locator("#points .point-value").nth(1)).to_have_text("next")
    labeller.saved()
    assert np.isnan(labeller.xy_on_disk(other)).any(axis=1).tolist() == [False, True, True, True]
    labeller.press("z")
    labeller.saved()
    expect(page.locator("#points .point-value").nth(0)).to_have_text("next")
    assert np.isnan(labeller.xy_on_disk(other)).all()
    page.locator("#undo").click()  # goes to the frame that it concerns
    labeller.opened(image)
    labeller.press("Control+z")
    expect(page.locator("#points .point-value").nth(2)).to_have_text("next")
    assert np.isnan(labeller.xy_on_disk(image)).any(axis=1).tolist() == [False, False, True, True]
    labeller.press("Shift+Z")
    expect(page.locator("#points .point-value").nth(3)).to_have_text("next")
    page.locator("#redo").click()
    expect(page.locator("#angle")).not_to_have_text("–")
    assert labeller.xy_on_disk(image) == pytest.approx(placed)


def test_server_killed_in_the_middle(session, sample_truth) -> None:
    image = "img00111.png"
    labeller, truth = session.page(), sample_truth[image]
    page, sent = labeller.page, []
    page.on("request", lambda request: request.method == "PUT" and sent.append(request.post_data))
    labeller.open(image)
    labeller.click(truth[0])
    labeller.saved()
    # The first answer is lost on the way: the server has done the edit, the page does not know.
    page.route(
        "**/api/frames/**", lambda route: (route.fetch(), session.server.kill(), route.abort()), times=1
    )
    clicked = labeller.click(truth[1])
    page.wait_for_selector('#saving[data-state="offline"]')
    assert labeller.xy_on_disk(image)[1] == pytest.approx(clicked, abs=0.0051)
    # Labelling goes on without it.
    labeller.click(truth[2])
    labeller.press("ArrowLeft")
    assert "3 edits" in page.locator("#saving").inner_text()
    session.start_again()
    labeller.saved()
    labeller.click(truth[3])
    labeller.saved()
    assert np.abs(labeller.xy_on_disk(image) - truth).max() < 1.0
    assert labeller.xy_on_disk(image) == pytest.approx(shown(labeller))
    ids = [json.loads(body)["edit_id"] for body in sent]
    assert ids.count(ids[1]) > 1  # sent again, under its own name: done once,
    for _ in range(4):  # so four steps back are before the second click
        before = page.locator("#points").inner_text()
        labeller.press("z")
        page.wait_for_function("before => document.querySelector('#points').innerText !== before", arg=before)
    expect(page.locator("#points .point-value").nth(1)).to_have_text("next")
    assert np.isnan(labeller.xy_on_disk(image)).any(axis=1).tolist() == [False, True, True, True]
    page.close()


def test_edits_outlive_their_tab(session, sample_truth) -> None:
    """The server is gone, then the browser's tab too: the next tab sends what the first could not."""
    image = "img00136.png"
    labeller, truth = session.page(), sample_truth[image]
    labeller.open(image)
    labeller.click(truth[0])
    labeller.saved()
    session.server.kill()
    for xy in truth[1:]:
        labeller.click(xy)
    labeller.page.wait_for_selector('#saving[data-state="offline"]')
    labeller.page.close()
    session.start_again()
    again = session.page()
    expect(again.page.locator(f'[data-id="video/{image}"]')).to_have_attribute("data-state", "labelled")
    again.saved()
    assert np.abs(again.xy_on_disk(image) - truth).max() < 1.0
    assert again.page.evaluate("Object.keys(localStorage).filter(key => key.includes('/queue/')).length") == 0
    again.page.close()


def test_two_tabs(session, sample_truth) -> None:
    one, two = session.page(), session.page()
    held: list[Route] = []
    for image, choice in (("img00149.png", "mine"), ("img00178.png", "theirs")):
        truth = sample_truth[image]
        for labeller in (one, two):
            labeller.open(image)
        # What one saves, two sees without doing anything.
        first = one.click(truth[0])
        one.saved()
        expect(two.page.locator("#points .point-value").nth(1)).to_have_text("next")
        assert shown(two)[0] == pytest.approx(first, abs=0.0051)

        # Both at once: two's edit is on its way while one's is being saved.
        held.clear()
        two.page.route("**/api/frames/**", lambda route: held.append(route), times=1)
        mine = two.click(truth[1] + 6)
        two.until(lambda: bool(held))
        theirs = one.click(truth[1])
        one.saved()
        held[0].continue_()
        two.page.wait_for_selector("#conflict[open]")
        assert "base_2" in two.page.locator(".differences").inner_text()
        assert one.xy_on_disk(image)[1] == pytest.approx(theirs, abs=0.0051)
        two.press("Escape")  # a choice cannot be got round
        assert two.page.locator("#conflict").is_visible()
        assert two.page.locator("#saving").get_attribute("data-state") == "conflict"
        two.page.locator(f"#choose-{choice}").click()
        two.saved()
        kept = {"mine": mine, "theirs": theirs}[choice]
        assert one.xy_on_disk(image)[1] == pytest.approx(kept, abs=0.0051)
        expect(one.page.locator("#points .point-value").nth(1)).to_contain_text(f"{shown(two)[1][0]:.2f}")
        assert shown(one)[1] == pytest.approx(kept, abs=0.0051)
    one.page.close()
    two.page.close()


def shown(labeller) -> np.ndarray:
    """Points as the list on the right has them, (K, 2) px, NaN where there is none."""
    words = labeller.page.locator("#points .point-value").all_inner_texts()
    return np.array([[float(c) for c in w.split()] if len(w.split()) == 2 else [np.nan] * 2 for w in words])


def test_an_answer_while_the_button_is_down_takes_no_point_away(labeller, sample_truth) -> None:
    image, truth = "img00400.png", sample_truth["img00400.png"]
    page, held = labeller.page, []
    labeller.open(image)
    page.route(
        "**/api/**", lambda route: held.append(route) if route.request.method == "PUT" else route.continue_()
    )
    labeller.click(truth[0])
    page.mouse.move(*labeller.screen(truth[1]))
    page.mouse.down()
    expect(page.locator("#points .point-value").nth(1)).to_have_class(re.compile(r"\bnumbers\b"))
    labeller.until(lambda: bool(held))
    with page.expect_response(lambda answer: answer.request.method == "PUT"):
        held.pop().continue_()
    labeller.saved()  # the answer has been taken in
    page.mouse.up()
    labeller.until(lambda: bool(held))
    held.pop().continue_()
    labeller.saved()
    assert np.abs(labeller.xy_on_disk(image)[:2] - truth[:2]).max() < 1.0


def test_a_list_from_before_an_edit_does_not_hide_it(labeller, sample_truth) -> None:
    image, other, truth = "img00260.png", "img00300.png", sample_truth["img00260.png"]
    page, held, asked = labeller.page, [], []

    def hold_second(route: Route) -> None:
        asked.append(route)
        if len(asked) == 2:  # the server has answered it, the page does not have it yet
            held.append((route, route.fetch()))
        else:
            route.continue_()

    labeller.open(image)
    page.route("**/api/frames", hold_second)
    page.reload()
    labeller.opened(image)
    labeller.until(lambda: bool(held))
    for xy in truth:
        labeller.click(xy)
    labeller.saved()
    frame = page.locator(f'[data-id="video/{image}"]')
    expect(frame).to_have_attribute("data-state", "labelled")
    labeller.open(other)
    route, answer = held.pop()
    listed: list[str] = []
    page.on("requestfinished", lambda request: request.url.endswith("/api/frames") and listed.append("once"))
    route.fulfill(response=answer)
    labeller.until(lambda: len(listed) == 2)  # the old list, and the one that is fetched in its place
    labeller.view()
    expect(frame).to_have_attribute("data-state", "labelled")
