"""Frame states as they are read from a project's files, whoever has written them."""

from __future__ import annotations

import json

import pytest

from bendtrack.labeling.annotations import Annotations
from bendtrack.labeling.frame_state import FrameState, Progress
from bendtrack.labeling.notes_file import read_notes, write_notes
from bendtrack.labeling.private_folder import PrivateFolder
from bendtrack.labeling.store import LabelStore
from bendtrack.tracker.errors import LabelError, ProjectError

POINTS = {"base_1": (10.25, 20.5), "base_2": (30.0, 20.75)}


def read(study, index: int) -> FrameState:
    folder = Annotations(study.project).folder(study.video)
    assert folder is not None
    return folder.states[study.image(index)]


def notes_text(study, images: object) -> None:
    document = {"format": "bendtrack-notes-1", "images": images}
    (study.folder / "bendtrack-notes.json").write_text(json.dumps(document))


def test_what_is_written_is_read_back(study) -> None:
    state = FrameState(POINTS, ("tip_1",), "blurred, left", flagged=True, skipped=True)
    annotations = Annotations(study.project)
    annotations.write(study.video, study.image(4), FrameState(), state)
    assert read(study, 4) == annotations.folder(study.video).states[study.image(4)] == state
    assert read(study, 5) == FrameState()
    annotations.write(study.video, study.image(4), state, FrameState())
    assert read(study, 4) == FrameState()
    assert study.notes() == {}


def test_what_is_equal_is_not_written(study) -> None:
    annotations = Annotations(study.project)
    annotations.write(study.video, study.image(0), FrameState(), FrameState(POINTS))
    assert not (study.folder / "bendtrack-notes.json").exists()
    csv = study.csv.read_bytes()
    annotations.write(study.video, study.image(0), FrameState(POINTS), FrameState(POINTS, note="a"))
    assert study.csv.read_bytes() == csv


@pytest.mark.parametrize(
    "other",
    [
        FrameState({**POINTS, "base_1": (10.25, 20.501)}, ("tip_1",), "a"),
        FrameState(POINTS, ("tip_2",), "a"),
        FrameState(POINTS, ("tip_1",), "b"),
        FrameState(POINTS, ("tip_1",), "a", flagged=True),
        FrameState(POINTS, ("tip_1",), "a", skipped=True),
    ],
)
def test_another_state_has_another_revision(other: FrameState) -> None:
    state = FrameState(POINTS, ("tip_1",), "a")
    again = FrameState(dict(reversed(POINTS.items())), ("tip_1",), "a")
    assert state.revision == again.revision
    assert state.revision != other.revision
    assert 0 <= state.revision < 2**53  # JavaScript's integers end there


def test_how_far_a_frame_is() -> None:
    keypoints = ("base_1", "base_2", "tip_1")
    assert FrameState().progress(keypoints) is Progress.UNLABELLED
    assert FrameState({"other": (1, 1)}).progress(keypoints) is Progress.UNLABELLED
    assert FrameState(POINTS).progress(keypoints) is Progress.PARTIAL
    assert FrameState(POINTS, ("tip_1",)).progress(keypoints) is Progress.LABELLED
    assert FrameState(POINTS, ("tip_1",), skipped=True).progress(keypoints) is Progress.SKIPPED


def test_changes_by_another_program_are_seen(study) -> None:
    annotations = Annotations(study.project)
    annotations.write(study.video, study.image(0), FrameState(), FrameState(POINTS))
    first = annotations.folder(study.video)
    assert annotations.folder(study.video) is first  # nothing has changed, nothing is read
    study.csv.write_text(study.csv.read_text().replace("10.25", "11.25"))
    assert annotations.folder(study.video).states[study.image(0)].points["base_1"] == (11.25, 20.5)
    notes_text(study, {study.image(0): {"note": "theirs"}})
    assert annotations.folder(study.video).states[study.image(0)].note == "theirs"
    (study.folder / study.image(5)).unlink()
    assert study.image(5) not in annotations.folder(study.video).images


def test_another_persons_labels_are_seen_and_left_alone(study) -> None:
    theirs = LabelStore(study.root / "labeled-data", study.keypoints, "ben", study.project.actuator_of)
    theirs.write_points(study.video, {study.image(0): POINTS})
    before = theirs.csv_path(study.video).read_bytes()
    assert read(study, 0).points == POINTS
    annotations = Annotations(study.project)
    annotations.write(study.video, study.image(0), FrameState(POINTS), FrameState({"base_1": (1.0, 2.0)}))
    assert read(study, 0).points == {"base_1": (1.0, 2.0)}
    assert theirs.csv_path(study.video).read_bytes() == before


def test_a_point_placed_elsewhere_is_visible_again(study) -> None:
    annotations = Annotations(study.project)
    annotations.write(study.video, study.image(0), FrameState(), FrameState(not_visible=("base_1", "tip_1")))
    LabelStore.of(study.project).write_points(study.video, {study.image(0): POINTS})
    assert read(study, 0) == FrameState(POINTS, ("tip_1",))


def test_notes_keep_what_they_do_not_know(study) -> None:
    notes_text(study, {study.image(0): {"note": "a", "weather": "fine"}, "gone.png": {"note": "b"}})
    write_notes(study.folder, study.image(0), {"note": ""})
    assert read_notes(study.folder) == {study.image(0): {"weather": "fine"}, "gone.png": {"note": "b"}}


@pytest.mark.parametrize(
    "images",
    [[], {"img00000.png": 3}, {"img00000.png": {"not_visible": "tip_1"}}, {"img00000.png": {"repeat": 1}}],
)
def test_notes_that_are_none_are_refused(study, images: object) -> None:
    notes_text(study, images)
    with pytest.raises(LabelError, match=r"bendtrack-notes\.json: "):
        read(study, 0)


@pytest.mark.parametrize("text", ["", "{", "[]", "7", '{"format": "other", "images": {}}', "[" * 100000])
def test_a_notes_file_that_is_none_is_refused(study, text: str) -> None:
    (study.folder / "bendtrack-notes.json").write_text(text)
    with pytest.raises(LabelError, match="expected"):
        read(study, 0)


def test_links_within_the_project_are_followed_and_no_others(study) -> None:
    (study.folder / "img00995.png").symlink_to(study.folder / study.image(0))
    outside = study.root.parent / "outside.png"
    outside.write_bytes((study.folder / study.image(0)).read_bytes())
    (study.folder / "img00996.png").symlink_to(outside)
    (study.folder / "img00997.png").symlink_to("nowhere.png")
    names = set(Annotations(study.project).folder(study.video).images)
    assert names == {*(study.image(n) for n in range(12)), "img00995.png"}


def test_labels_outside_the_project_are_refused(study) -> None:
    labels = study.root / "labeled-data"
    labels.rename(study.root.parent / "elsewhere")
    labels.symlink_to(study.root.parent / "elsewhere")
    with pytest.raises(LabelError, match="within the project, got a link"):
        Annotations(study.project)


def test_a_private_folder_that_is_a_link_is_refused(study) -> None:
    (study.root.parent / "elsewhere").mkdir()
    (study.root / ".bendtrack").symlink_to(study.root.parent / "elsewhere")
    with pytest.raises(ProjectError, match="got something else"):
        PrivateFolder(study.root)


def test_images_come_in_the_order_of_their_frames(study) -> None:
    for name in ("img9.png", "close-up.png", "img100000.png"):
        (study.folder / name).write_bytes((study.folder / study.image(0)).read_bytes())
    names = list(Annotations(study.project).folder(study.video).images)
    assert names[:3] == [study.image(0), "img9.png", study.image(1)]
    assert names[-2:] == ["img100000.png", "close-up.png"]
