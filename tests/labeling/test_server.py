"""The labelling server as a page meets it: over real sockets, with the files on disk as the judge."""

from __future__ import annotations

import http.client
import json
import shutil
import signal
import socket
import subprocess
import uuid

import cv2
import numpy as np
import pytest
from page_client import credential, log_in

POINTS = {"base_1": [10.25, 20.5], "base_2": [30.0, 20.75], "tip_1": [50.125, 30.0], "tip_2": [60.0, 45.375]}


def test_the_project_is_described(page) -> None:
    project = page.get("/api/project")
    assert project["name"] == "study"
    assert project["keypoints"] == ["base_1", "base_2", "tip_1", "tip_2"]
    assert project["skeleton"] == [[0, 1], [1, 2], [2, 3]]
    assert project["definition"] == {
        "name": "two-vector",
        "points": ["base_1", "base_2", "tip_1", "tip_2"],
        "sign": 1,
    }
    assert project["signs"] == {"default": 1}
    assert project["can_finish"] is False
    assert project["model"] is None


def test_frames_are_listed_with_where_they_are(study, page) -> None:
    listed = page.get("/api/frames")
    assert [f["id"] for f in listed["frames"]] == [study.id(i) for i in range(12)]
    first = listed["frames"][0]
    assert (first["url"], first["size_wh"], first["state"]) == (study.address(0), [96, 72], "unlabelled")
    assert listed["progress"] == {"labelled": 0, "partial": 0, "skipped": 0, "total": 12}
    assert listed["next"] == study.id(0)


def test_an_edit_is_on_disk_before_the_answer(study, page) -> None:
    answer = page.put(3, points=POINTS, note="glare", flagged=True)
    assert answer.status == 200
    assert study.saved() == {study.image(3): POINTS}
    assert study.notes() == {study.image(3): {"note": "glare", "flagged": True}}
    assert answer.json == page.get(study.address(3))
    assert answer.json["state"] == "labelled"


def test_points_that_are_not_named_stay(study, page) -> None:
    page.put(0, points=POINTS)
    page.put(0, points={"tip_2": None, "tip_1": [51.0, 30.0]})
    expected = {**POINTS, "tip_1": [51.0, 30.0]}
    del expected["tip_2"]
    assert study.saved() == {study.image(0): expected}
    assert page.get(study.address(0))["state"] == "partial"


def test_positions_are_kept_to_a_thousandth_and_foreign_digits_stay(study, page) -> None:
    # Another program's label, with all its digits, is not touched by an edit of its neighbour.
    page.put(0, points=POINTS)
    text = study.csv.read_text()
    study.csv.write_text(text.replace("10.25", "10.251234567890123"))
    frame = page.get(study.address(0))
    page.put(0, points={**frame["points"], "tip_1": [1 / 3, 30.0]})
    saved = study.saved()[study.image(0)]
    assert saved["tip_1"] == [0.333, 30.0]
    assert saved["base_1"] == [10.251234567890123, 20.5]


def test_not_visible_is_kept_beside_the_labels_and_never_in_them(study, page) -> None:
    page.put(0, points=POINTS)
    answer = page.put(0, not_visible=["tip_2", "base_1"])
    assert (answer.json["not_visible"], answer.json["state"]) == (["base_1", "tip_2"], "labelled")
    assert set(study.saved()[study.image(0)]) == {"base_2", "tip_1"}
    assert "tip_2" in study.notes()[study.image(0)]["not_visible"]
    # Placing it makes it visible again.
    assert page.put(0, points={"tip_2": [5, 5]}).json["not_visible"] == ["base_1"]


def test_a_skipped_frame_is_not_suggested(study, page) -> None:
    page.put(0, skipped=True)
    listed = page.get("/api/frames")
    assert listed["frames"][0]["state"] == "skipped"
    assert listed["next"] == study.id(1)


def test_next_goes_on_from_where_one_is_and_round(study, page) -> None:
    for index in range(12):
        if index not in (2, 7):
            page.put(index, points=POINTS)

    def next_after(index: int) -> str | None:
        after = f"{page.get('/api/frames')['frames'][index]['id']}"
        answer = page(
            "GET", f"/api/frames?after={after.replace('%', '%25').replace('#', '%23').replace(' ', '%20')}"
        )
        return answer.json["next"]

    assert next_after(4) == study.id(7)
    assert next_after(7) == study.id(2)
    page.put(2, points=POINTS)
    assert next_after(7) is None  # it is the one at hand
    page.put(7, points=POINTS)
    assert next_after(0) is None


def test_who_has_seen_an_older_state_is_told(study, page) -> None:
    seen = page.get(study.address(0))["revision"]
    assert page.put(0, points=POINTS).status == 200
    late = page.put(0, points={"base_1": [1, 1]}, base_revision=seen)
    assert late.status == 409
    assert late.json["frame"] == page.get(study.address(0))
    assert study.saved()[study.image(0)] == POINTS


def test_two_who_want_the_same_have_no_conflict(study, page) -> None:
    seen = page.get(study.address(0))["revision"]
    page.put(0, points=POINTS)
    assert page.put(0, points=POINTS, base_revision=seen).status == 200


def test_a_change_by_another_program_is_a_conflict_too(study, page) -> None:
    page.put(0, points=POINTS)
    seen = page.get(study.address(0))["revision"]
    study.csv.write_text(study.csv.read_text().replace("60.0", "61.5"))
    assert page.put(0, points={"tip_2": [1, 1]}, base_revision=seen).status == 409
    assert page.get(study.address(0))["points"]["tip_2"] == [61.5, 45.375]


def test_two_servers_on_one_project_see_each_other(study, serve) -> None:
    first, second = serve(study).page("anna"), serve(study).page("ben")
    seen = second.get(study.address(0))["revision"]
    assert first.put(0, points=POINTS).status == 200
    assert second.put(0, points={"tip_2": [1, 1]}, base_revision=seen).status == 409
    assert second.put(0, points={"tip_2": [2, 2]}).status == 200
    assert first.get(study.address(0))["points"] == {**POINTS, "tip_2": [2, 2]}
    # Anna's edit is no longer as she left it: her undo must not take Ben's away.
    refused = first.step("undo")
    assert (refused.status, refused.json["frame"]["points"]["tip_2"]) == (409, [2, 2])
    assert study.saved()[study.image(0)] == {**POINTS, "tip_2": [2, 2]}


def test_the_same_edit_twice_is_done_once(study, page) -> None:
    edit_id = str(uuid.uuid4())
    seen = page.get(study.address(0))["revision"]
    first = page.put(0, points=POINTS, edit_id=edit_id, base_revision=seen)
    again = page.put(0, points=POINTS, edit_id=edit_id, base_revision=seen)
    assert (first.status, again.status) == (200, 200)
    assert first.json == again.json
    page.put(0, points={"tip_2": [1, 1]})
    # What came later stands; the first is not done again over it.
    late = page.put(0, points=POINTS, edit_id=edit_id, base_revision=seen)
    assert (late.status, late.json["points"]["tip_2"]) == (200, [1, 1])
    page.step("undo")
    assert study.saved()[study.image(0)] == POINTS


def test_undo_and_redo_go_all_the_way_across_a_kill(study, serve) -> None:
    served = serve(study)
    page = served.page()
    before = study.fingerprint()
    for index in range(5):
        page.put(index, points=POINTS, note=f"frame {index}")
    after = study.fingerprint()
    page.step("undo")
    served.kill()
    served.start()
    page.hang_up()
    assert [page.step("undo").status for _ in range(5)] == [200] * 4 + [204]
    assert study.saved() == {}
    assert study.notes() == {}
    assert all(study.fingerprint()[name] == value for name, value in before.items())
    assert [page.step("redo").status for _ in range(6)] == [200] * 5 + [204]
    assert study.fingerprint() == after


def test_an_undo_sent_again_undoes_nothing_more(study, page) -> None:
    page.put(0, points=POINTS)
    page.put(1, points=POINTS)
    edit_id = str(uuid.uuid4())
    assert page.step("undo", edit_id).status == 200
    assert page.step("undo", edit_id).json["frame"]["id"] == study.id(1)
    assert set(study.saved()) == {study.image(0)}


def test_an_edit_after_an_undo_ends_what_could_be_done_again(study, page) -> None:
    page.put(0, points=POINTS)
    page.step("undo")
    page.put(1, points=POINTS)
    assert page.step("redo").status == 204


def test_everyone_undoes_his_own(study, serve) -> None:
    served = serve(study)
    anna, ben = served.page("anna"), served.page("ben")
    anna.put(0, points=POINTS)
    ben.put(1, points=POINTS)
    assert anna.step("undo").json["frame"]["id"] == study.id(0)
    assert anna.step("undo").status == 204
    assert set(study.saved()) == {study.image(1)}


def test_an_undo_that_cannot_be_is_skipped(study, serve) -> None:
    served = serve(study)
    anna, ben = served.page("anna"), served.page("ben")
    anna.put(0, points=POINTS)
    anna.put(1, points=POINTS)
    ben.put(1, points={"tip_1": [1, 2]})
    assert anna.step("undo").status == 409
    assert anna.step("undo").json["frame"]["id"] == study.id(0)
    assert study.saved() == {study.image(1): {**POINTS, "tip_1": [1, 2]}}


def test_the_frame_of_an_undo_may_be_gone(study, page) -> None:
    page.put(0, points=POINTS)
    page.put(1, points=POINTS)
    (study.folder / study.image(1)).unlink()
    lines = study.csv.read_text().splitlines(keepends=True)
    study.csv.write_text("".join(line for line in lines if study.image(1) not in line))
    assert page.step("undo").json["frame"]["id"] == study.id(0)


def test_images_come_as_they_are_and_stay_in_the_cache(study, page) -> None:
    listed = page.get("/api/frames")["frames"][4]
    answer = page("GET", listed["image_url"])
    assert answer.body == (study.folder / study.image(4)).read_bytes()
    assert answer.headers["content-type"] == "image/png"
    assert "immutable" in answer.headers["cache-control"]
    assert page("GET", listed["image_url"], If_None_Match=answer.headers["etag"]).status == 304
    # Another image under the same name has another address.
    assert cv2.imwrite(str(study.folder / study.image(4)), np.zeros((72, 96, 3), np.uint8))
    assert page.get("/api/frames")["frames"][4]["image_url"] != listed["image_url"]


def test_a_tiff_is_shown_as_png(study, page) -> None:
    image = np.arange(72 * 96 * 3, dtype=np.uint8).reshape(72, 96, 3)
    assert cv2.imwrite(str(study.folder / "img00500.tif"), image)
    listed = page.get("/api/frames")["frames"][-1]
    answer = page("GET", listed["image_url"])
    assert answer.headers["content-type"] == "image/png"
    assert np.array_equal(cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_COLOR), image)


def test_thumbnails_are_small(study, page) -> None:
    large = np.zeros((1200, 1600, 3), np.uint8)
    large[:, 800:] = 255
    assert cv2.imwrite(str(study.folder / "img00600.png"), large)
    listed = page.get("/api/frames")["frames"][-1]
    answer = page("GET", listed["thumb_url"])
    small = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert small.shape == (160, 213)
    assert (small[:, :100].max() < 20, small[:, 115:].min() > 235) == (True, True)


def test_an_image_that_cannot_be_read_is_listed_and_no_more(study, page) -> None:
    (study.folder / "img00700.png").write_bytes(b"no image")
    listed = page.get("/api/frames")["frames"][-1]
    assert (listed["image"], listed["size_wh"]) == ("img00700.png", None)
    answer = page("GET", listed["thumb_url"])
    assert (answer.status, "img00700.png" in answer.json["reason"]) == (503, True)


def test_suggestions_lie_between_the_labelled_neighbours(study, page) -> None:
    page.put(1, points={"tip_1": [10, 10], "tip_2": [20, 10]})
    page.put(5, points={"tip_1": [50, 30]})
    between = page.get(study.address(2))  # a quarter of the way
    assert between["suggestion_source"] == "neighbours"
    assert between["suggestions"] == {
        "tip_1": {"xy": [20.0, 15.0], "sd_px": None},
        "tip_2": {"xy": [20.0, 10.0], "sd_px": None},
    }
    assert between["previous"] == {
        "id": study.id(1),
        "points": {"base_1": None, "base_2": None, "tip_1": [10, 10], "tip_2": [20, 10]},
    }
    assert page.get(study.address(8))["suggestions"]["tip_1"]["xy"] == [50, 30]


def test_pages_hear_of_each_other_and_of_other_programs(study, page) -> None:
    page.put(0, points=POINTS)
    stream = http.client.HTTPConnection("127.0.0.1", page.port, timeout=20)
    stream.request(
        "GET",
        "/api/events",
        headers={"Cookie": page.cookie, "X-Bendtrack-Auth": credential(page.key, "GET", "/api/events")},
    )
    events = stream.getresponse()

    def heard() -> dict[str, object]:
        while not (line := events.fp.readline()).startswith(b"data: "):
            pass
        return json.loads(line[6:])

    assert heard()["type"] == "hello"
    edit_id = str(uuid.uuid4())
    revision = page.put(2, points=POINTS, edit_id=edit_id).json["revision"]
    assert heard() == {
        "type": "changed",
        "id": study.id(2),
        "revision": revision,
        "client_id": "anna",
        "edit_id": edit_id,
    }
    # Until the file's time is another: within one tick of the file system's clock the server could not know.
    before, text = study.csv.stat().st_mtime_ns, study.csv.read_text().replace("60.0", "61.0", 1)
    while study.csv.stat().st_mtime_ns == before:
        study.csv.write_text(text)
    told = heard()
    assert (told["type"], told["id"], told["client_id"]) == ("changed", study.id(0), None)
    shutil.copy(study.folder / study.image(0), study.folder / "img00900.png")
    assert heard() == {"type": "frames"}
    stream.close()


def test_labels_that_cannot_be_read_are_said_and_not_overwritten(study, page) -> None:
    page.put(0, points=POINTS)
    good = study.csv.read_text()
    study.csv.write_text(good.replace("60.0", "sixty"))
    before = study.fingerprint()
    answer = page("GET", study.address(0))
    assert answer.status == 503
    assert "expected a number of px, got 'sixty'" in answer.json["reason"]
    body = {
        "edit_id": str(uuid.uuid4()),
        "client_id": "anna",
        "base_revision": 0,
        "points": {"tip_2": [1, 1]},
    }
    assert page("PUT", study.address(0), body).status == 503
    assert study.fingerprint() == before
    study.csv.write_text(good)
    assert page.put(0, points={"tip_2": [1, 1]}).status == 200


AWAY = {
    "renamed": lambda root: root.rename(root.with_name("elsewhere")),
    "an empty mount point": lambda root: (root.rename(root.with_name("elsewhere")), root.mkdir()),
    "another project": lambda root: (
        root.rename(root.with_name("elsewhere")),
        shutil.copytree(root.with_name("elsewhere"), root, ignore=shutil.ignore_patterns(".bendtrack")),
    ),
    "no settings": lambda root: shutil.copytree(
        root.rename(root.with_name("elsewhere")), root, ignore=shutil.ignore_patterns("bendtrack.toml")
    ),
    "no labeled-data": lambda root: (root / "labeled-data").rename(root.with_name("elsewhere")),
}


@pytest.mark.parametrize("away", AWAY)
def test_while_the_folder_is_away_nothing_is_lost_or_written(study, page, away) -> None:
    page.put(0, points=POINTS)
    edit = {
        "edit_id": str(uuid.uuid4()),
        "client_id": "anna",
        "base_revision": page.get(study.address(1))["revision"],
        "points": POINTS,
    }
    AWAY[away](study.root)
    there = {path: path.read_bytes() for path in study.root.rglob("*") if path.is_file()}
    for method, path, body in (
        ("PUT", study.address(1), edit),
        ("GET", study.address(1), None),
        ("GET", "/api/frames", None),
        ("GET", "/api/summary", None),
        ("POST", "/api/undo", {"edit_id": str(uuid.uuid4()), "client_id": "anna"}),
    ):
        answer = page(method, path, body)
        assert (answer.status, bool(answer.json["reason"])) == (503, True), (method, path, answer)
    assert {path: path.read_bytes() for path in study.root.rglob("*") if path.is_file()} == there
    # It comes back, and the same edit is sent again.
    if away == "no labeled-data":
        study.root.with_name("elsewhere").rename(study.root / "labeled-data")
    else:
        if study.root.exists():
            shutil.rmtree(study.root)
        study.root.with_name("elsewhere").rename(study.root)
    assert page("PUT", study.address(1), edit).status == 200
    assert study.saved()[study.image(1)] == POINTS
    assert page.step("undo").json["frame"]["id"] == study.id(1)


def test_a_drive_that_comes_back_under_other_numbers_is_the_same(study, page) -> None:
    copy = shutil.copytree(study.root, study.root.with_name("copy"))  # another inode, as on another mount
    study.root.rename(study.root.with_name("elsewhere"))
    copy.rename(study.root)
    assert page.put(0, points=POINTS).status == 200
    assert study.saved() == {study.image(0): POINTS}


def test_a_private_folder_that_is_deleted_is_made_anew(study, page) -> None:
    page.put(0, points=POINTS)
    shutil.rmtree(study.root / ".bendtrack")
    assert page.put(1, points=POINTS).status == 200
    assert set(study.saved()) == {study.image(0), study.image(1)}


@pytest.mark.parametrize(
    "spoil",
    [
        lambda study: (study.root / ".bendtrack" / "journal.jsonl").mkdir(),
        lambda study: (study.root / ".bendtrack" / "journal.jsonl").symlink_to(study.root.parent / "rc"),
        lambda study: study.csv.mkdir(),
        lambda study: (study.folder / "bendtrack-notes.json").mkdir(),
    ],
    ids=["journal is a folder", "journal is a link", "labels are a folder", "notes are a folder"],
)
def test_what_cannot_be_written_is_503(study, page, spoil) -> None:
    (study.root.parent / "rc").write_text("mine\n")
    edit = {
        "edit_id": str(uuid.uuid4()),
        "client_id": "anna",
        "base_revision": page.get(study.address(1))["revision"],
        "points": POINTS,
        "note": "n",
    }
    spoil(study)
    answer = page("PUT", study.address(1), edit)
    assert (answer.status, bool(answer.json["reason"])) == (503, True)
    assert (study.root.parent / "rc").read_text() == "mine\n"


def test_an_image_that_is_gone_is_404(study, page) -> None:
    (study.folder / study.image(1)).unlink()
    body = {"edit_id": str(uuid.uuid4()), "client_id": "anna", "base_revision": 0, "points": POINTS}
    assert page("PUT", study.address(1), body).status == 404


def test_the_summary_says_what_the_labels_are_worth(study, page) -> None:
    nothing = page.get("/api/summary")
    assert nothing["spread"] is None
    assert nothing["actuators"][0]["n_labelled"] == 0
    assert nothing["actuators"][0]["floor_deg"] is None
    # Ends of 20 px; angles of 0, 30 and 90 degrees.
    for index, angle_deg in enumerate((0, 30, 90)):
        turn = np.radians(angle_deg)
        end = (40 + 20 * np.cos(turn), 20 + 20 * np.sin(turn))
        points = {"base_1": [5, 20], "base_2": [25, 20], "tip_1": [40, 20], "tip_2": list(end)}
        assert page.put(index, points=points).status == 200
    (figures,) = page.get("/api/summary")["actuators"]
    assert (figures["name"], figures["n_labelled"], figures["n_frames"]) == ("default", 3, 12)
    assert figures["end_vector_px"] == pytest.approx(20, abs=0.01)
    # 2 sigma / (sqrt(n) L) rad
    assert figures["floor_deg"] == pytest.approx(np.degrees(2 / (np.sqrt(3) * 20)), abs=0.01)
    assert (figures["angle_min_deg"], figures["angle_max_deg"]) == pytest.approx((0, 90), abs=0.01)
    assert figures["largest_gap_deg"] == pytest.approx(60, abs=0.01)
    assert figures["largest_gap_at_deg"] == pytest.approx([30, 90], abs=0.01)


def test_new_settings_are_taken_over(study, page) -> None:
    assert page.get("/api/frames")["frames"][0]["actuator"] == "default"
    study.project.assign_actuator("bellows", [study.video])
    assert page.get("/api/frames")["frames"][0]["actuator"] == "bellows"


def test_the_command_serves_and_comes_back_where_it_was(study, bendtrack) -> None:
    def start() -> tuple[subprocess.Popen[str], str]:
        process = subprocess.Popen(
            [bendtrack.command, "label", study.root, "--no-browser"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        return process, process.stdout.readline().split()[-1]

    def get(address: str, cookie: str = "", key: str = "") -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection(address.split("/")[2], timeout=20)
        path = "/" + address.partition("#")[0].split("/", 3)[3]
        headers = {"Cookie": cookie, "X-Bendtrack-Auth": credential(key, "GET", path)}
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        answer.read()
        connection.close()
        return answer

    process, address = start()
    try:
        first = log_in(address)
        frames = address.split("?")[0] + "api/frames"
        assert get(frames, first.cookie, first.key).status == 200
        assert get(address).status == 403  # the token is used up
        process.kill()
        process.wait(20)
        process.communicate()
        process, again = start()
        assert again.split("?")[0] == address.split("?")[0]
        assert again != address
        assert get(frames, first.cookie, first.key).status == 401  # each start has a key of its own
        session = log_in(again)
        assert get(frames, session.cookie, first.key).status == 401
        assert get(frames, first.cookie, session.key).status == 401
        assert get(frames, session.cookie, session.key).status == 200
        listening = http.client.HTTPConnection(address.split("/")[2], timeout=20)
        listening.request("GET", "/api/events", headers=session.headers("GET", "/api/events"))
        events = listening.getresponse()
        process.send_signal(signal.SIGINT)
        assert b"hello" in events.read()  # a page that listens is let go
        listening.close()
        out, err = process.communicate(timeout=20)
        assert (process.returncode, err) == (0, "")
        assert "all labels are saved" in out
    finally:
        process.kill()
        process.communicate()


def test_what_cannot_be_served_is_one_line(study, bendtrack, tmp_path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        ran = bendtrack("label", study.root, "--no-browser", "--port", port)
        assert ran.status == 2
        assert f"--port: expected a free port, got {port}" in ran.err
    shutil.rmtree(study.folder)
    ran = bendtrack("label", study.root, "--no-browser")
    assert (ran.status, "expected images to label" in ran.err) == (2, True)
    ran = bendtrack("label", tmp_path, "--no-browser")
    assert (ran.status, "expected a project folder" in ran.err) == (2, True)
