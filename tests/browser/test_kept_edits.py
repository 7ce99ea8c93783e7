"""No edit ends as saved that is not on disk: the folder is away, a frame is gone, another program has the port."""

from __future__ import annotations

import json
import re
import shutil
import threading
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from page_driver import Labeller, PageSession
from playwright.sync_api import Route, expect


@pytest.fixture(scope="module")
def session(make_session, sample_images: Path, tmp_path_factory: pytest.TempPathFactory) -> PageSession:
    """A server on a project of this file's own, which may answer with refusals."""
    session = make_session(shutil.copytree(sample_images, tmp_path_factory.mktemp("kept") / "study"))
    session.expect("40[0-9]|413|422|500|503|ERR_SOCKET_NOT_CONNECTED")
    return session


@pytest.fixture
def clicked(session: PageSession, sample_truth) -> Iterator[tuple[Labeller, str, np.ndarray]]:
    """A page with one point placed and saved in a frame without labels: the page, the frame, the four positions."""
    labeller = session.page()
    image = next(name for name in sample_truth if not labeller.on_disk(name))
    labeller.open(image)
    labeller.click(sample_truth[image][0])
    labeller.saved()
    yield labeller, image, sample_truth[image]
    labeller.page.close()


@pytest.mark.parametrize("place", ["nothing", "an empty mount point", "another project"])
def test_the_folder_is_away_for_a_while(session, clicked, place) -> None:
    labeller, image, truth = clicked
    root = session.server.root
    away = root.with_name("away")
    root.rename(away)
    if place == "an empty mount point":
        root.mkdir()
    elif place == "another project":
        shutil.copytree(away, root, ignore=shutil.ignore_patterns(".bendtrack"))
    there = sorted(root.rglob("*")) if root.exists() else []
    for xy in truth[1:3]:
        labeller.click(xy)
    labeller.page.wait_for_selector('#saving[data-state="disk"]')
    assert "kept" in labeller.page.locator("#saving").inner_text()
    expect(labeller.page.locator("#banner")).to_contain_text("Not on disk")
    labeller.page.reload()  # a restless user
    labeller.page.wait_for_selector("#empty:not([hidden])")
    assert (sorted(root.rglob("*")) if root.exists() else []) == there
    if root.exists():
        shutil.rmtree(root)
    away.rename(root)
    labeller.opened(image)
    labeller.saved()
    assert np.abs(labeller.xy_on_disk(image)[:3] - truth[:3]).max() < 1.0


def test_a_refused_edit_stays_until_it_is_saved_or_dropped(session, clicked) -> None:
    labeller, image, truth = clicked
    page = labeller.page
    before = labeller.view(), page.locator("#stage").bounding_box()
    file = session.server.root / "labeled-data" / "video" / image
    file.rename(file.with_name("gone"))
    labeller.click(truth[1])
    page.wait_for_selector('#saving[data-state="refused"]')
    expect(page.locator("#banner")).to_contain_text(image)
    # Also when the list of frames, in which it is no more, comes from the server.
    page.wait_for_selector(f'[data-id="video/{image}"]', state="detached")
    assert page.locator("#stage").get_attribute("data-frame") == f"video/{image}"
    # A banner comes at any moment, also while someone clicks: the image stays where it is.
    assert (labeller.view(), page.locator("#stage").bounding_box()) == before
    labeller.click(truth[2])  # on top of the refused one
    page.wait_for_selector('#saving[data-state="refused"]')
    assert page.evaluate("Object.keys(localStorage).filter(key => key.includes('/queue/')).length") == 1
    file.with_name("gone").rename(file)
    page.get_by_role("button", name="Send again").click()
    labeller.saved()
    assert np.abs(labeller.xy_on_disk(image)[:3] - truth[:3]).max() < 1.0
    expect(page.locator("#banner")).to_be_hidden()


def test_no_refusal_ends_as_saved(session, clicked) -> None:
    labeller, image, _ = clicked
    page = labeller.page
    notes = session.server.root / "labeled-data" / "video" / "bendtrack-notes.json"

    def flagged() -> bool:
        return notes.exists() and json.loads(notes.read_text())["images"].get(image, {}).get("flagged", False)

    def spoil(status: int, route: Route) -> None:
        """Have the server refuse what the page sends, or answer without the server's proof."""
        body = route.request.post_data
        if route.request.method != "PUT":
            route.continue_()
        elif status in (400, 413):
            route.continue_(post_data="{}" if status == 400 else " " * 70_000)
        elif status == 422:
            route.continue_(post_data=re.sub(r"\[[-\d.]+,", "[99999,", body))
        else:
            route.fulfill(status=status, body="{}")

    for status in (400, 413, 422, 200, 404, 409, 500, 503):
        before = flagged()
        page.route("**/api/frames/**", partial(spoil, status))
        labeller.press("f")
        shown = "refused" if status in (400, 413, 422) else "session"
        page.wait_for_selector(f'#saving[data-state="{shown}"]')
        assert flagged() == before
        page.unroute("**/api/frames/**")
        if shown == "refused":
            page.get_by_role("button", name="Send again").click()
        labeller.saved()
        assert flagged() != before, status


class Impostor(ThreadingHTTPServer):
    """A program that listens on the server's port after its death, says yes to everything and keeps what it hears."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, port: int) -> None:
        self.heard: list[str] = []

        class Handler(BaseHTTPRequestHandler):
            def answer(handler) -> None:
                body = handler.rfile.read(int(handler.headers.get("Content-Length") or 0))
                self.heard.append(f"{handler.requestline}\n{handler.headers}\n{body!r}")
                events = handler.path.startswith("/api/events")
                content = b'data: {"type": "hello", "server_id": "x"}\n\n' if events else b"{}"
                handler.send_response(200)
                handler.send_header("Content-Type", "text/event-stream" if events else "application/json")
                handler.send_header("X-Bendtrack-Proof", "a" * 43)
                handler.send_header("Content-Length", str(len(content)))
                handler.end_headers()
                handler.wfile.write(content)

            do_GET = do_PUT = do_POST = answer

            def log_message(self, *args: object) -> None:
                pass

        super().__init__(("127.0.0.1", port), Handler)
        threading.Thread(target=self.serve_forever, daemon=True).start()


def test_an_impostor_on_the_port_learns_nothing_and_is_not_trusted(session, clicked) -> None:
    labeller, image, truth = clicked
    page = labeller.page
    key = page.evaluate("localStorage.getItem('bendtrack/key')")
    port = int(page.url.split(":")[2].split("/")[0])
    session.server.kill()
    impostor = Impostor(port)
    try:
        for xy in truth[1:3]:
            labeller.click(xy)
        labeller.press("z")
        page.wait_for_selector('#saving[data-state="session"]')
        expect(page.locator("#banner")).to_contain_text("bendtrack label")
        assert "2 edits" in page.locator("#saving").inner_text()
        labeller.until(lambda: sum("/api/proof" in request for request in impostor.heard) > 2)
    finally:
        impostor.shutdown()
        impostor.server_close()
    heard = "\n".join(impostor.heard)
    assert "GET /api/proof" in heard
    assert not re.search(r"^(PUT|POST)", heard, re.MULTILINE)
    assert key not in heard
    assert "tip_1" not in heard
    session.start_again()
    labeller.saved()
    assert np.abs(labeller.xy_on_disk(image)[:3] - truth[:3]).max() < 1.0
    assert page.evaluate("localStorage.getItem('bendtrack/key')") != key
    expect(page.locator("#banner")).to_be_hidden()


def test_the_key_goes_to_no_other_port(session, clicked) -> None:
    labeller, _, _ = clicked
    key = labeller.page.evaluate("localStorage.getItem('bendtrack/key')")
    impostor = Impostor(0)
    other = labeller.page.context.new_page()
    try:
        other.goto(f"http://127.0.0.1:{impostor.server_address[1]}/")
    finally:
        other.close()
        impostor.shutdown()
        impostor.server_close()
    heard = "\n".join(impostor.heard)
    assert "Cookie: bendtrack-" in heard  # browsers do that; it opens nothing of the project
    assert key not in heard
