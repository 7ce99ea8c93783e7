"""Edits and their journal: killed servers, full disks, damaged journals; every acknowledged edit stays, once."""

from __future__ import annotations

import http.client
import random
import resource
import shutil
import threading
import time
import uuid

import pytest

from bendtrack.labeling.annotations import Annotations
from bendtrack.labeling.edits import Change, Edited, Editor
from bendtrack.labeling.private_folder import PrivateFolder

POINTS = {"base_1": (10.25, 20.5), "base_2": (30.0, 20.75)}
KILLS = 15


class Hand:
    """Edits a study's frames without a server."""

    def __init__(self, study, client_id: str = "anna") -> None:
        private = PrivateFolder(study.root)
        self.study, self.client_id = study, client_id
        self.annotations = Annotations(study.project, private.lock)
        self.editor = Editor(self.annotations, private)

    def state(self, index: int):
        folder = self.annotations.folder(self.study.video)
        assert folder is not None
        return folder.states[self.study.image(index)]

    def edit(self, index: int, edit_id: str | None = None, **change: object) -> Edited:
        change.setdefault("points", {})
        return self.editor.edit(
            self.study.video,
            self.study.image(index),
            Change(**change),
            base_revision=self.state(index).revision,
            edit_id=edit_id or str(uuid.uuid4()),
            client_id=self.client_id,
        )

    def undo(self) -> Edited | None:
        return self.editor.undo(edit_id=str(uuid.uuid4()), client_id=self.client_id)


def journal_lines(study) -> list[str]:
    return (study.root / ".bendtrack" / "journal.jsonl").read_text().splitlines(keepends=True)


def write_journal(study, lines: list[str]) -> None:
    (study.root / ".bendtrack" / "journal.jsonl").write_text("".join(lines))


def test_a_server_killed_again_and_again_loses_nothing(study, serve) -> None:
    # One page writes without pause and sends again what was not answered; after each kill every edit that was
    # answered is on disk, and in the end each can be undone exactly once.
    served = serve(study)
    page = served.page()
    rng = random.Random(7)
    sent: list[dict[str, object]] = []  # edits in their order, the last one perhaps without an answer
    answered = 0
    stop = threading.Event()

    def write() -> None:
        nonlocal answered
        revisions = {index: page.get(study.address(index))["revision"] for index in range(12)}
        while not stop.is_set() or answered < len(sent):
            if answered == len(sent):
                index = rng.randrange(12)
                count = len(sent)
                sent.append(
                    {
                        "index": index,
                        "edit_id": str(uuid.uuid4()),
                        "base_revision": revisions[index],
                        "points": {rng.choice(study.keypoints): [count % 90, count / 1000]},
                        # Two of three edits change both files.
                        **({"note": f"edit {count}"} if count % 3 else {}),
                    }
                )
            edit = dict(sent[-1])
            index = edit.pop("index")
            try:
                answer = page.put(index, **edit)
            except (OSError, http.client.HTTPException):
                time.sleep(0.02)
                continue
            if answer.status == 401:  # a new server, which this page is not let in to yet
                time.sleep(0.02)
                continue
            assert answer.status == 200, answer
            revisions[index] = answer.json["revision"]
            answered = len(sent)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(KILLS):
            enough = answered + 2
            while answered < enough:
                assert writer.is_alive()
                time.sleep(0.005)
            time.sleep(rng.uniform(0, 0.05))
            served.kill()
            certain = answered
            found = study.saved(), study.notes()
            assert found in [expected(study, sent[:n]) for n in (certain, certain + 1)] + [
                half_written(study, sent[: certain + 1])
            ]
            served.start()
    finally:
        stop.set()
        writer.join(30)
    assert answered >= 2 * KILLS
    page.hang_up()
    assert (study.saved(), study.notes()) == expected(study, sent[:answered])
    undone = 0
    while page.step("undo").status == 200:
        undone += 1
    assert undone == len(sent)
    assert (study.saved(), study.notes()) == ({}, {})


def expected(study, edits: list[dict[str, object]]) -> tuple[dict[str, object], dict[str, object]]:
    """Labels and notes after edits, worked out from what was sent."""
    points: dict[str, dict[str, object]] = {}
    notes: dict[str, dict[str, object]] = {}
    for edit in edits:
        image = study.image(edit["index"])
        points.setdefault(image, {}).update(edit["points"])
        if "note" in edit:
            notes[image] = {"note": edit["note"]}
    return points, notes


def half_written(study, edits: list[dict[str, object]]) -> tuple[object, object]:
    """After a kill between the two files: the last edit's points, without its note."""
    return expected(study, edits)[0], expected(study, edits[:-1])[1]


@pytest.mark.parametrize("reached", ["neither file", "the label file", "both files"])
def test_what_a_killed_server_had_begun_is_carried_out(study, tmp_path, reached: str) -> None:
    Hand(study).edit(0, points=POINTS, note="before")
    before = shutil.copytree(study.folder, tmp_path / "before")
    edit_id = str(uuid.uuid4())
    Hand(study).edit(0, edit_id, points={"tip_1": (1.0, 2.0)}, note="after", not_visible=("base_1",))
    wanted = study.saved(), study.notes()
    # As a server leaves it that is killed after the journal's line is on disk.
    lines = journal_lines(study)
    assert "done" in lines[-1]
    write_journal(study, lines[:-1])
    if reached != "both files":
        shutil.copy(before / "bendtrack-notes.json", study.folder)
    if reached == "neither file":
        shutil.copy(before / study.csv.name, study.folder)
    hand = Hand(study)
    assert (study.saved(), study.notes()) == wanted
    assert hand.edit(0, edit_id, points={"tip_1": (1.0, 2.0)}, note="after").changed is False
    hand.undo()
    assert hand.state(0).points == POINTS
    assert hand.state(0).note == "before"


def test_what_was_begun_is_given_up_when_someone_else_came_first(study) -> None:
    Hand(study).edit(0, points=POINTS)
    edit_id = str(uuid.uuid4())
    Hand(study).edit(0, edit_id, points={"base_1": (1.0, 2.0)})
    write_journal(study, journal_lines(study)[:-1])
    theirs = study.csv.read_text().replace("1.0,2.0", "3.0,4.0")
    study.csv.write_text(theirs)
    hand = Hand(study)
    assert study.csv.read_text() == theirs
    assert hand.undo().conflict  # of the first edit, which their change lies upon
    assert study.csv.read_text() == theirs


def test_a_line_cut_short_by_a_power_failure_is_skipped(study) -> None:
    Hand(study).edit(0, points=POINTS)
    lines = journal_lines(study)
    write_journal(study, [*lines, lines[0][:57]])
    hand = Hand(study)
    hand.edit(1, points=POINTS)
    assert Hand(study).state(1).points == POINTS
    again = Hand(study)
    assert [again.undo().image, again.undo().image, again.undo()] == [study.image(1), study.image(0), None]


def test_without_its_journal_a_project_is_whole(study) -> None:
    hand = Hand(study)
    hand.edit(0, points=POINTS, note="kept")
    shutil.rmtree(study.root / ".bendtrack")
    fresh = Hand(study)
    assert (fresh.state(0).points, fresh.state(0).note) == (POINTS, "kept")
    assert fresh.undo() is None


def test_the_private_folder_can_be_deleted_under_a_server(study) -> None:
    hand = Hand(study)
    hand.edit(0, points=POINTS)
    shutil.rmtree(study.root / ".bendtrack")
    hand.edit(1, points=POINTS)
    assert [hand.undo().image, hand.undo()] == [study.image(1), None]
    assert hand.state(0).points == POINTS


def test_a_full_disk_is_an_error_and_the_edit_is_not_lost(study) -> None:
    hand = Hand(study)
    for index in range(12):
        hand.edit(index, points={**POINTS, "tip_1": (1 / 7, 2 / 7), "tip_2": (3 / 7, 4 / 7)})
    before = study.fingerprint()
    shutil.rmtree(study.root / ".bendtrack")  # a short journal
    hand = Hand(study)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    edit_id = str(uuid.uuid4())
    # Room for the journal's line, none for the label file.
    assert study.csv.stat().st_size > 900
    resource.setrlimit(resource.RLIMIT_FSIZE, (900, limits[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            hand.edit(3, edit_id, points={"base_1": (5.0, 6.0)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert study.fingerprint() == before  # nothing half-written, nothing left behind
    assert hand.edit(3, edit_id, points={"base_1": (5.0, 6.0)}).conflict is False
    assert study.saved()[study.image(3)]["base_1"] == [5.0, 6.0]
    assert hand.undo().changed
    assert hand.undo() is None


def test_two_editors_take_turns(study) -> None:
    # Neither reads what the other is writing, and nobody's edit is lost.
    hands = [Hand(study, name) for name in ("anna", "ben")]

    def work(hand: Hand, start: int) -> None:
        for count in range(20):
            while hand.edit(count % 6, points={study.keypoints[start]: (float(count), 1.0)}).conflict:
                pass

    threads = [threading.Thread(target=work, args=(hand, n)) for n, hand in enumerate(hands)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    saved = study.saved()
    for index in range(6):
        last = max(count for count in range(20) if count % 6 == index)
        assert saved[study.image(index)] == {"base_1": [last, 1.0], "base_2": [last, 1.0]}


def test_the_private_folder_is_private(study) -> None:
    Hand(study).edit(0, points=POINTS)
    PrivateFolder(study.root)
    private = study.root / ".bendtrack"
    assert oct(private.stat().st_mode)[-3:] == "700"
    for name in ("project-id", "journal.jsonl"):
        assert oct((private / name).stat().st_mode)[-3:] == "600", name


def test_no_secret_lies_in_the_project(study) -> None:
    # One that came with a project would be known to whoever made it.
    (study.root / ".bendtrack").mkdir()
    (study.root / ".bendtrack" / "secret").write_text("known to somebody else")
    PrivateFolder(study.root)
    assert not (study.root / ".bendtrack" / "secret").exists()
