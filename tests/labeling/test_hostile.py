"""Pages and programs that mean harm: nothing of the project gets out, nothing on disk changes."""

from __future__ import annotations

import json
import socket
import subprocess
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from page_client import credential

SECRET = b"what lies outside the project"
POINTS = {"base_1": [10.25, 20.5], "base_2": [30.0, 20.75], "tip_1": [50.125, 30.0], "tip_2": [60.0, 45.375]}


@pytest.fixture(scope="module")
def hostile_study(make_study, serve_for_module):
    """A study with labels and traps, and a page on a server: (study, page). Shared, as nothing may change it."""
    study = make_study()
    (study.root.parent / "outside.txt").write_bytes(SECRET)
    (study.root.parent / "outside").mkdir()
    (study.root.parent / "outside" / "img00000.png").write_bytes(SECRET)
    (study.root.parent / "outside.png").write_bytes(SECRET)
    page = serve_for_module(study).page()
    assert page.put(0, points=POINTS, note="mine").status == 200
    # Links that lead out, as an image and as a whole video's folder.
    (study.folder / "img09990.png").symlink_to(study.root.parent / "outside.png")
    (study.root / "labeled-data" / "elsewhere").symlink_to(study.root.parent / "outside")
    (study.folder / "img09980.png").mkdir()
    return study, page


@pytest.fixture
def unchanged(hostile_study) -> Iterator[None]:
    """Holds that a test changed no file."""
    study, _ = hostile_study
    before = study.fingerprint()
    journal = (study.root / ".bendtrack" / "journal.jsonl").read_bytes()
    yield
    assert study.fingerprint() == before
    assert (study.root / ".bendtrack" / "journal.jsonl").read_bytes() == journal


def refused(answer, *statuses: int) -> None:
    """A refusal says nothing but its number."""
    assert answer.status in statuses, answer
    assert answer.body == b""
    assert "set-cookie" not in answer.headers
    assert "access-control-allow-origin" not in answer.headers


def an_edit(page, study, index: int = 0, **fields: object) -> dict[str, object]:
    return {
        "edit_id": str(uuid.uuid4()),
        "client_id": "mallory",
        "base_revision": page.get(study.address(index))["revision"],
        "points": {"tip_1": [1.0, 1.0]},
        **fields,
    }


@pytest.mark.usefixtures("unchanged")
class TestWhoIsLetIn:
    @pytest.mark.parametrize(
        "path", ["/", "/page/main.js", "/api/project", "/api/frames", "/api/events", "/nothing"]
    )
    def test_nobody_without_the_cookie(self, hostile_study, path) -> None:
        _, page = hostile_study
        refused(page("GET", path, Cookie=None), 401)
        refused(page("GET", path, Cookie=f"bendtrack-{page.port}=guess"), 401)
        refused(page("GET", path, Cookie=page.cookie[:-1]), 401)
        refused(page("GET", path, Cookie=page.cookie.replace(str(page.port), "1")), 401)
        refused(page("GET", path, Cookie='"; =;;'), 401)

    def test_no_edit_without_the_cookie(self, hostile_study) -> None:
        study, page = hostile_study
        refused(page("PUT", study.address(0), an_edit(page, study), Cookie=None), 401)

    @pytest.mark.parametrize(
        "query", ["token=", "token=guess", "token=a&token=b", "token=%00%ff", "token=%C3%A9"]
    )
    def test_nobody_by_a_wrong_token(self, hostile_study, query) -> None:
        _, page = hostile_study
        refused(page("GET", f"/?{query}", Cookie=None), 403)

    @pytest.mark.parametrize(
        "host",
        ["evil.example", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example:{port}", "[::1]:{port}", ""],
    )
    def test_nobody_under_another_name(self, hostile_study, host) -> None:
        # A name of a stranger's that leads to 127.0.0.1 (DNS rebinding).
        study, page = hostile_study
        host = host.format(port=page.port)
        refused(page("GET", "/api/frames", Host=host), 403)
        refused(page("PUT", study.address(0), an_edit(page, study), Host=host), 403)

    def test_localhost_is_this_machine_too(self, hostile_study) -> None:
        _, page = hostile_study
        assert page("GET", "/api/project", Host=f"localhost:{page.port}").status == 200

    @pytest.mark.parametrize(
        "origin",
        [
            "http://evil.example",
            "null",
            "http://127.0.0.1:1",
            "https://127.0.0.1:{port}",
            "http://localhost:{port}",
        ],
    )
    def test_no_other_page(self, hostile_study, origin) -> None:
        study, page = hostile_study
        origin = origin.format(port=page.port)
        refused(page("GET", "/api/frames", Origin=origin), 403)
        refused(page("PUT", study.address(0), an_edit(page, study), Origin=origin), 403)
        refused(
            page("POST", "/api/undo", {"edit_id": str(uuid.uuid4()), "client_id": "anna"}, Origin=origin), 403
        )

    def test_no_image_for_another_page(self, hostile_study) -> None:
        _, page = hostile_study
        address = page.get("/api/frames")["frames"][0]["image_url"]
        for site in ("cross-site", "same-site"):
            refused(page("GET", address, Sec_Fetch_Site=site, Sec_Fetch_Mode="no-cors"), 403)
        assert page("GET", address, Sec_Fetch_Site="same-origin", Sec_Fetch_Mode="cors").status == 200

    @pytest.mark.parametrize(
        ("missing", "status"), [("Origin", 403), ("X_Bendtrack", 403), ("Content_Type", 415)]
    )
    def test_no_change_by_a_form(self, hostile_study, missing, status) -> None:
        study, page = hostile_study
        refused(page("PUT", study.address(0), an_edit(page, study), **{missing: None}), status)

    @pytest.mark.parametrize(
        "kind", ["text/plain", "application/x-www-form-urlencoded", "application/jsonp", ""]
    )
    def test_no_change_by_what_is_not_json(self, hostile_study, kind) -> None:
        study, page = hostile_study
        refused(page("PUT", study.address(0), an_edit(page, study), Content_Type=kind), 415)

    @pytest.mark.parametrize("method", ["DELETE", "OPTIONS", "PATCH", "TRACE", "CONNECT", "PROPFIND"])
    def test_no_other_method(self, hostile_study, method) -> None:
        study, page = hostile_study
        refused(page(method, study.address(0)), 400, 404, 405)

    def test_methods_where_they_belong(self, hostile_study) -> None:
        study, page = hostile_study
        refused(page("POST", study.address(0), an_edit(page, study)), 405)
        refused(page("GET", "/api/undo"), 405)
        refused(page("PUT", "/api/frames", an_edit(page, study)), 405)

    def test_the_page_allows_nothing_from_elsewhere(self, hostile_study) -> None:
        _, page = hostile_study
        for path in ("/", "/api/project"):
            headers = page("GET", path).headers
            assert "default-src 'self'" in headers["content-security-policy"]
            assert "unsafe" not in headers["content-security-policy"]
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["cross-origin-resource-policy"] == "same-origin"
            assert headers["x-frame-options"] == "DENY"
            assert "access-control-allow-origin" not in headers
            assert "server" not in headers


OUTSIDE = [
    "/../outside.txt",
    "/%2e%2e/outside.txt",
    "/page/../../../outside.txt",
    "/page/..%2f..%2f..%2foutside.txt",
    "/page/%2e%2e%2fserver.py",
    "/page/..%5cserver.py",
    "/page/API.md",
    "/page//etc/passwd",
    "/page/%2fetc%2fpasswd",
    "/page/main.js%00.css",
    "/page/",
    "/page",
    "//etc/passwd",
    "/etc/passwd",
    "/.bendtrack/secret",
    "/bendtrack.toml",
    "/api/frames/../../bendtrack.toml",
    "/api/frames/../outside/image",
    "/api/frames/..%2f../outside.txt/image",
    "/api/frames/%2e%2e/bendtrack.toml/image",
    "/api/frames/%2e/%2e/image",
    "/api/frames/.bendtrack/secret/image",
    "/api/frames/{video}/..%2f..%2fbendtrack.toml/image",
    "/api/frames/{video}/%2e%2e%2f%2e%2e%2f%2e%2e%2foutside.png/image",
    "/api/frames/{video}/%2fetc%2fpasswd/image",
    "/api/frames/{video}/CollectedData_bendtrack.csv/image",
    "/api/frames/{video}/bendtrack-notes.json/image",
    "/api/frames/{video}/img00000.png%00/image",
    "/api/frames/{video}/IMG00000.PNG/image",
    "/api/frames/{video}/img09990.png/image",  # a link out of the project
    "/api/frames/{video}/img09990.png/thumb",
    "/api/frames/{video}/img09990.png",
    "/api/frames/{video}/img09980.png/image",  # a folder
    "/api/frames/elsewhere/img00000.png/image",  # a link out of the project
    "/api/frames/elsewhere/img00000.png",
    "/api/frames/nothing/img00000.png/image",
    "/api/frames/{video}/img99999.png/image",
    "/api/frames/{video}/%ff%fe/image",
    "/api/frames/{video}/" + "a" * 5000 + "/image",
]


@pytest.mark.usefixtures("unchanged")
class TestWhatIsServed:
    @pytest.mark.parametrize("path", OUTSIDE)
    def test_nothing_but_images_and_the_page(self, hostile_study, path) -> None:
        study, page = hostile_study
        refused(page("GET", path.format(video=study.address(0).split("/")[3])), 404, 400)

    def test_nothing_but_images_and_the_page_by_raw_requests(self, hostile_study) -> None:
        # Clients mend such addresses before they send them.
        _, page = hostile_study
        for path in (
            b"/../../outside.txt",
            b"http://127.0.0.1/outside.txt",
            b"*",
            b"/\xff\xfe",
            b"/page/..\\server.py",
        ):
            reply = raw(page, b"GET " + path + b" HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nCookie: %s\r\n\r\n")
            assert reply.split(b" ")[1].startswith(b"4"), reply
            assert SECRET not in reply

    def test_links_out_of_the_project_are_not_even_listed(self, hostile_study) -> None:
        study, page = hostile_study
        listed = page.get("/api/frames")["frames"]
        assert {f["id"] for f in listed} == {study.id(i) for i in range(12)}

    def test_labels_behind_a_link_are_neither_read_nor_written(self, study, serve) -> None:
        outside = study.root.parent / "outside.csv"
        outside.write_bytes(SECRET)
        page = serve(study).page()
        study.csv.symlink_to(outside)
        for answer in (page("GET", "/api/frames"), page("GET", study.address(0))):
            assert answer.status == 503
            assert b"outside the" not in answer.body
        body = {"edit_id": str(uuid.uuid4()), "client_id": "a", "base_revision": 0, "points": {}}
        assert page("PUT", study.address(0), body).status == 503
        assert outside.read_bytes() == SECRET


@pytest.mark.usefixtures("unchanged")
class TestBodies:
    @pytest.mark.parametrize(
        "body",
        [
            b"",
            b"{",
            b"[]",
            b"null",
            b"\xff\xfe",
            b"\x00" * 100,
            b"[" * 60000,
            b'{"a":' * 10000,
            b"1e400",
            b'{"edit_id": "\\ud800"}',
        ],
    )
    def test_what_is_no_json(self, hostile_study, body) -> None:
        study, page = hostile_study
        for method, path in (("PUT", study.address(0)), ("POST", "/api/undo"), ("POST", "/api/redo")):
            refused(page(method, path, body or b" "), 400)

    @pytest.mark.parametrize(
        "fields",
        [
            {"edit_id": "no uuid"},
            {"edit_id": 7},
            {"edit_id": None},
            {"client_id": ""},
            {"client_id": "a" * 65},
            {"client_id": "a\n"},
            {"client_id": "../../x"},
            {"client_id": 1},
            {"base_revision": "1"},
            {"base_revision": -1},
            {"base_revision": 2**60},
            {"base_revision": 1.5},
            {"base_revision": True},
            {"points": []},
            {"points": None},
            {"points": {"tip_1": [1]}},
            {"points": {"tip_1": [1, 2, 3]}},
            {"points": {"tip_1": ["1", "2"]}},
            {"points": {"tip_1": [1, None]}},
            {"points": {"tip_1": {"x": 1, "y": 2}}},
            {"points": {"tip_1": "12"}},
            {"points": {"tip_1": [True, False]}},
            {"points": {"tip_1": [float("nan"), 1]}},
            {"points": {"tip_1": [1, float("inf")]}},
            {"points": {"tip_1": [float("-inf"), 1]}},
            {"not_visible": "tip_1"},
            {"not_visible": {"tip_1": True}},
            {"not_visible": [1]},
            {"note": 5},
            {"note": "a" * 2001},
            {"flagged": 1},
            {"flagged": "yes"},
            {"skipped": "no"},
            {"unknown": 1},
            {"__proto__": {}},
        ],
        ids=str,
    )
    def test_what_is_of_the_wrong_kind(self, hostile_study, fields) -> None:
        study, page = hostile_study
        refused(page("PUT", study.address(0), an_edit(page, study, **fields)), 400)

    @pytest.mark.parametrize("number", ["1e400", "-1e999", "NaN", "Infinity", "1" * 400])
    def test_numbers_that_are_none(self, hostile_study, number) -> None:
        study, page = hostile_study
        body = json.dumps(an_edit(page, study)).replace("[1.0, 1.0]", f"[{number}, 1.0]").encode()
        refused(page("PUT", study.address(0), body), 400, 422)

    @pytest.mark.parametrize(
        "fields",
        [
            {"points": {"tip_3": [1, 1]}},
            {"points": {"": [1, 1]}},
            {"points": {"tip_1\n": [1, 1]}},
            {"points": {"tip_1": [-0.6, 1]}},
            {"points": {"tip_1": [95.6, 1]}},
            {"points": {"tip_1": [1, 71.6]}},
            {"points": {"tip_1": [1e300, 1e300]}},
            {"not_visible": ["tip_3"]},
            {"not_visible": ["tip_1"], "points": {"tip_1": [1, 1]}},
        ],
        ids=str,
    )
    def test_what_cannot_be(self, hostile_study, fields) -> None:
        study, page = hostile_study
        refused(page("PUT", study.address(0), an_edit(page, study, **fields)), 422)

    @pytest.mark.parametrize(
        "frame", ["img99999.png", "img09990.png", "img09980.png", "..", "bendtrack.toml"]
    )
    def test_frames_that_are_not_there(self, hostile_study, frame) -> None:
        study, page = hostile_study
        address = study.address(0).rpartition("/")[0] + "/" + frame
        refused(page("PUT", address, an_edit(page, study)), 404)
        body = {"edit_id": str(uuid.uuid4()), "client_id": "mallory", "points": {}}
        refused(page("PUT", address.replace("/frames/", "/repeats/"), body), 404)

    def test_repeats_that_nobody_asked_for(self, hostile_study) -> None:
        study, page = hostile_study
        body = {"edit_id": str(uuid.uuid4()), "client_id": "mallory", "points": {"tip_1": [1, 1]}}
        refused(page("PUT", study.address(1).replace("/frames/", "/repeats/"), body), 404)

    def test_what_is_too_large(self, hostile_study) -> None:
        study, page = hostile_study
        edit = an_edit(page, study)
        refused(page("PUT", study.address(0), edit | {"note": "a" * 70000}), 413)
        # Without saying so before: in pieces, whose sum is not told.
        head = (
            f"PUT {study.address(0)} HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\nCookie: {page.cookie}\r\n"
            f"Origin: http://127.0.0.1:{page.port}\r\nX-Bendtrack: 1\r\nContent-Type: application/json\r\n"
            f"X-Bendtrack-Auth: {credential(page.key, 'PUT', study.address(0))}\r\n"
            "Transfer-Encoding: chunked\r\n\r\n"
        ).encode()
        chunk = b"4000\r\n" + b" " * 0x4000 + b"\r\n"
        assert b" 413 " in raw(page, head + 5 * chunk).split(b"\r\n")[0]

    @pytest.mark.parametrize("length", ["-1", "abc", "1e3", "99999999999999999999"])
    def test_a_length_that_is_a_lie(self, hostile_study, length) -> None:
        study, page = hostile_study
        head = (
            f"PUT {study.address(0)} HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\nCookie: {page.cookie}\r\n"
            f"Origin: http://127.0.0.1:{page.port}\r\nX-Bendtrack: 1\r\nContent-Type: application/json\r\n"
            f"Content-Length: {length}\r\n\r\n{{}}"
        ).encode()
        assert raw(page, head).split(b" ")[1].startswith(b"4")

    def test_headers_that_never_end(self, hostile_study) -> None:
        _, page = hostile_study
        assert raw(page, b"GET / HTTP/1.1\r\n" + b"X-A: " + b"a" * 200_000).split(b" ")[1].startswith(b"4")

    def test_two_hosts(self, hostile_study) -> None:
        _, page = hostile_study
        two = b"GET /api/frames HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nHost: evil.example\r\nCookie: %s\r\n\r\n"
        assert raw(page, two).split(b" ")[1].startswith(b"4")

    def test_no_websocket(self, hostile_study) -> None:
        _, page = hostile_study
        upgrade = (
            b"GET /api/events HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        assert raw(page, upgrade % page.port).split(b" ")[1] == b"401"


def raw(page, request: bytes) -> bytes:
    """Send bytes as they are; whatever comes back."""
    if request.count(b"%d") and request.count(b"%s"):
        request = request % (page.port, page.cookie.encode())
    with socket.create_connection(("127.0.0.1", page.port), timeout=10) as connection:
        try:
            connection.sendall(request)
            connection.shutdown(socket.SHUT_WR)
        except OSError:
            pass  # it has heard enough
        reply = b""
        try:
            while data := connection.recv(65536):
                reply += data
        except ConnectionResetError:
            pass
        return reply


def test_after_all_of_it_the_page_works(hostile_study) -> None:
    study, page = hostile_study
    assert page.get(study.address(0))["points"] == POINTS
    assert page.put(0, note="still mine").status == 200


def test_only_this_machine_is_listened_to(study, bendtrack) -> None:
    process = subprocess.Popen(
        [bendtrack.command, "label", study.root, "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        port = int(process.stdout.readline().split("127.0.0.1:")[1].split("/")[0])
        listening = {
            line.split()[1]
            for table in ("tcp", "tcp6")
            if (path := Path("/proc/net") / table).is_file()
            for line in path.read_text().splitlines()[1:]
        }
        assert {s for s in listening if s.endswith(f":{port:04X}")} == {f"0100007F:{port:04X}"}
    finally:
        process.kill()
        process.communicate()
