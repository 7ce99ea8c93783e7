"""The page in a small window, 1000 x 700 px: nothing is pushed out, nothing jumps; and what it says to a keyboard."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect


@pytest.fixture
def small(labeller):
    labeller.page.set_viewport_size({"width": 1000, "height": 700})
    return labeller


def test_nothing_is_pushed_out_and_the_panel_does_not_jump(small, sample_truth) -> None:
    page = small.page
    image = list(sample_truth)[8]
    small.open(image)
    expect(page.locator("#hint")).to_have_text("Click to place base_1: fixed end, first")
    expect(page.locator("#ends")).to_have_text("two-vector")  # no lengths before there are any
    expect(page.locator("#repeats-due")).to_be_hidden()

    def tops() -> list[float]:
        return [
            page.locator(one).bounding_box()["y"] for one in ("#points", "#copy-previous", "#frame-panel")
        ]

    before = tops()
    for xy in sample_truth[image]:
        small.click(xy)
    small.saved()
    page.mouse.move(*small.screen(sample_truth[image][0]))  # its position is shown, too
    expect(page.locator("#position")).not_to_be_empty()
    assert tops() == before
    assert page.locator("#ends").inner_text().startswith("ends ")
    stage = page.locator("#stage").bounding_box()
    for one in ("#hint", "#position", "#fit", "#toggle-loupe", "#toggle-suggestions"):
        box = page.locator(one).bounding_box()
        assert stage["x"] <= box["x"]
        assert box["x"] + box["width"] <= stage["x"] + stage["width"], one
    button, label = (page.locator(one).bounding_box() for one in ("#accept-suggestions", "#accept-label"))
    assert label["height"] < button["height"]
    assert label["x"] + label["width"] <= button["x"] + button["width"]


def test_an_arrow_key_says_what_it_moved(small, sample_truth) -> None:
    image = list(sample_truth)[9]
    small.open(image)
    for xy in sample_truth[image]:
        small.click(xy)
    for key, moved in (("ArrowRight", "0.25"), ("Shift+ArrowDown", "1")):
        small.press(key)
        expect(small.page.locator("#message")).to_have_text(f"tip_2 moved by {moved} px. Z undoes it.")
    small.saved()
