"""Pages and programs that mean harm: nothing of the project gets out, nothing on disk changes."""

from __future__ import annotations

import http.client
import json
import signal
import socket
import subprocess
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from page_client import credential, log_in, signature, signed_address

from bendtrack.labeling.event_stream import MAX_STREAMS

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
        ("path", "status", "words"),
        [
            ("/", 401, "This page needs a new address"),
            ("/?token=guess", 403, "This address was used already"),
            ("/?token=a&token=b", 403, "This address was used already"),
        ],
    )
    def test_a_browser_gets_what_to_do_in_words_and_nothing_else(
        self, hostile_study, path, status, words
    ) -> None:
        study, page = hostile_study
        answer = page("GET", path, Cookie=None, X_Bendtrack_Auth=None, Accept="text/html,*/*;q=0.8")
        assert answer.status == status
        text = answer.body.decode()
        assert words in text
        assert "run <code>bendtrack label</code> again" in text
        assert "default-src 'self'" in answer.headers["content-security-policy"]
        assert answer.headers["content-type"].startswith("text/html")
        assert (answer.headers["cache-control"], "set-cookie" in answer.headers) == ("no-store", False)
        # The same for everyone: nothing of the request or the project is in it.
        for secret in ("guess", study.root.name, page.cookie, page.key, "token"):
            assert secret not in text

    def test_only_the_page_itself_is_answered_in_words(self, hostile_study) -> None:
        study, page = hostile_study
        html = "text/html"
        refused(page("GET", "/api/frames", Cookie=None, Accept=html), 401)
        refused(page("GET", "/page/main.js", Cookie=None, Accept=html), 401)
        refused(page("GET", "/", Host="evil.example", Accept=html), 403)
        refused(page("GET", "/?token=guess", Cookie=None, Origin="http://evil.example", Accept=html), 403)
        refused(page("PUT", study.address(0), an_edit(page, study), Cookie=None, Accept=html), 401)
        refused(page("HEAD", "/?token=guess", Cookie=None, Accept=html), 403)

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


@pytest.mark.usefixtures("unchanged")
class TestWhoHasOnlyTheCookie:
    """A browser sends the cookie to every port of this machine, so whoever listens on one may have it."""

    @pytest.mark.parametrize(
        "path",
        ["/api/project", "/api/frames", "/api/events", "/api/summary", "/api/key", "/api/proof", "/api/x"],
    )
    def test_it_opens_nothing_of_the_project(self, hostile_study, path) -> None:
        _, page = hostile_study
        assert page("GET", "/page/main.js", X_Bendtrack_Auth=None).status == 200
        refused(page("GET", path, X_Bendtrack_Auth=None), 401)

    def test_it_changes_nothing(self, hostile_study) -> None:
        study, page = hostile_study
        refused(page("PUT", study.address(0), an_edit(page, study), X_Bendtrack_Auth=None), 401)
        undo = {"edit_id": str(uuid.uuid4()), "client_id": "anna"}
        refused(page("POST", "/api/undo", undo, X_Bendtrack_Auth=None), 401)

    def test_it_shows_no_image(self, hostile_study) -> None:
        study, page = hostile_study
        listed = page.get("/api/frames")["frames"]
        for kind in ("image_url", "thumb_url"):
            address = listed[0][kind]
            assert (
                page("GET", address, X_Bendtrack_Auth=None).status == 200
            )  # signed by the server for this image
            refused(page("GET", address, X_Bendtrack_Auth=None, Cookie=None), 401)
            unsigned, _, sig = address.partition("&sig=")
            other = listed[1][kind].partition("&sig=")[0]
            for forged in (unsigned, f"{other}&sig={sig}", address[:-1], f"{address}&sig=", f"{address}&x=1"):
                refused(page("GET", forged, X_Bendtrack_Auth=None), 401)
        refused(page("PUT", signed_address(page.key, study.address(0)), {}, X_Bendtrack_Auth=None), 401)

    @pytest.mark.parametrize(
        "forge", ["another address", "another method", "another key", "no nonce", "cut", "twice"]
    )
    def test_a_signature_is_for_one_request(self, hostile_study, forge) -> None:
        _, page = hostile_study
        good = credential(page.key, "GET", "/api/frames")
        value = {
            "another address": credential(page.key, "GET", "/api/project"),
            "another method": credential(page.key, "PUT", "/api/frames"),
            "another key": credential("a" * 43, "GET", "/api/frames"),
            "no nonce": "." + signature(page.key, "page", "", "GET", "/api/frames"),
            "cut": good[:-1],
            "twice": f"{good}, {good}",
        }[forge]
        assert page("GET", "/api/frames", X_Bendtrack_Auth=good).status == 200
        refused(page("GET", "/api/frames", X_Bendtrack_Auth=value), 401)

    def test_an_answer_without_a_signature_is_no_proof(self, hostile_study) -> None:
        _, page = hostile_study
        assert "x-bendtrack-proof" not in page("GET", "/api/frames", X_Bendtrack_Auth=None).headers
        for path, status in (("/api/frames", 200), ("/api/proof", 204), ("/api/nothing", 404)):
            sent = credential(page.key, "GET", path)
            answer = page("GET", path, X_Bendtrack_Auth=sent)
            proof = signature(page.key, "server", sent.partition(".")[0], str(status))
            assert (answer.status, answer.headers["x-bendtrack-proof"]) == (status, proof)


def test_the_address_gives_the_key_once_and_the_key_is_in_no_cookie(study, serve) -> None:
    served = serve(study)
    address = served.addresses[-1]
    page = served.page()
    assert page.key not in page.cookie
    claim = address.partition("#claim=")[2]
    refused(page("GET", "/api/key", X_Bendtrack_Auth=credential(claim, "GET", "/api/key")), 401)
    refused(page("GET", f"/?{address.partition('?')[2].partition('#')[0]}", Cookie=None), 403)


def test_a_new_server_accepts_nothing_of_the_one_before(study, serve) -> None:
    served = serve(study)
    page = served.page()
    old_cookie, old_key, unused = page.cookie, page.key, served.addresses[-1]
    image = page.get("/api/frames")["frames"][0]["image_url"]
    served.kill()
    page.hang_up()
    served.start()
    new_cookie, new_key = page.cookie, page.key
    page.key = old_key
    refused(page("GET", "/api/frames"), 401)
    refused(page("GET", image, X_Bendtrack_Auth=None), 401)
    refused(page("PUT", study.address(0), {}), 401)
    page.key, page.cookie = new_key, old_cookie
    refused(page("GET", "/"), 401)
    refused(page("GET", "/api/frames"), 401)
    page.cookie = new_cookie
    assert page("GET", "/api/frames").status == 200
    with pytest.raises(AssertionError, match="403"):
        log_in(unused)
    files = [path for path in (study.root / ".bendtrack").iterdir() if path.is_file()]
    for secret in (old_key, new_key, old_cookie.partition("=")[2], new_cookie.partition("=")[2]):
        assert not any(secret.encode() in file.read_bytes() for file in files)


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

    @pytest.mark.parametrize(
        ("method", "fields"),
        [
            ("PUT", "Content-Length: {n}\r\nTransfer-Encoding: chunked"),
            ("PUT", "Transfer-Encoding: chunked\r\nContent-Length: {n}"),
            ("PUT", "Content-Length: 0\r\nTransfer-Encoding: chunked"),
            ("PUT", "Content-Length: {n}\r\nContent-Length: 3"),
            ("PUT", "Content-Length: {n}, 3"),
            ("PUT", "Transfer-Encoding: chunked\r\nTransfer-Encoding: chunked"),
            ("PUT", "Transfer-Encoding: chunked, identity"),
            ("PUT", "Transfer-Encoding: xchunked\r\nContent-Length: {n}"),
            ("PUT", "Content-Length : {n}"),
            ("PUT", "Content-Length: +{n}"),
            ("PUT", "Transfer-Encoding:\x0bchunked"),
            ("GET", "Content-Length: {n}"),
            ("GET", "Transfer-Encoding: chunked"),
        ],
    )
    def test_a_body_whose_end_is_in_doubt(self, hostile_study, method, fields) -> None:
        study, page = hostile_study
        body = json.dumps(an_edit(page, study))
        body = f"{len(body):x}\r\n{body}\r\n0\r\n\r\n"
        address = study.address(0)
        request = (
            f"{method} {address} HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\nCookie: {page.cookie}\r\n"
            f"Origin: http://127.0.0.1:{page.port}\r\nX-Bendtrack: 1\r\nContent-Type: application/json\r\n"
            f"X-Bendtrack-Auth: {credential(page.key, method, address)}\r\n"
            f"{fields.format(n=len(body))}\r\n\r\n{body}"
        ).encode()
        reply = raw(page, request)
        assert reply.split(b" ")[1] in (b"400", b"501"), reply
        assert reply.count(b"HTTP/1.1") == 1  # the rest is not taken for a second request

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


def test_silent_connections_keep_nobody_out_and_fill_no_log(study, bendtrack) -> None:
    process = subprocess.Popen(
        ["sh", "-c", 'ulimit -n 200; exec "$0" "$@"', bendtrack.command, "label", study.root, "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    silent = []
    try:
        assert process.stdout is not None
        session = log_in(process.stdout.readline().split()[-1])
        for count in range(300):
            silent.append(socket.create_connection(("127.0.0.1", session.port), timeout=5))
            if count % 3 == 0:
                silent[-1].sendall(b"GET / HTTP/1.1\r\nX-A: ")
            if count % 50 == 49:
                page = http.client.HTTPConnection("127.0.0.1", session.port, timeout=10)
                page.request("GET", "/api/project", headers=session.headers("GET", "/api/project"))
                assert page.getresponse().status == 200
                page.close()
    finally:
        process.send_signal(signal.SIGINT)
        for connection in silent:
            connection.close()
        _, err = process.communicate(timeout=20)
    assert err == ""


def test_event_streams_are_few_and_the_newest_count(study, serve) -> None:
    page = serve(study).page()
    connections, streams = [], []
    for _ in range(MAX_STREAMS + 2):
        connections.append(http.client.HTTPConnection("127.0.0.1", page.port, timeout=10))
        address = signed_address(page.key, "/api/events")
        connections[-1].request("GET", address, headers={"Cookie": page.cookie})
        streams.append(connections[-1].getresponse())
        assert b"hello" in streams[-1].readline()
    for oldest in streams[:2]:
        oldest.read()  # it has ended
    assert page.put(0, note="heard").status == 200
    while b"changed" not in streams[-1].readline():
        pass
    for stream, connection in zip(streams, connections, strict=True):
        stream.close()
        connection.close()


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
