"""SLEAP's .slp in and out: foreign files made by sleap-io, the library of SLEAP's makers."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from bendtrack.labeling.interop.sleap import export_sleap, open_sleap
from bendtrack.labeling.store import LabelStore
from bendtrack.tracker.errors import LabelError
from bendtrack.tracker.project import Project

sleap_io = pytest.importorskip("sleap_io", reason="sleap-io is not installed (bendtrack[sleap])")

NODES = ["base_1", "base_2", "tip_1", "tip_2"]
XY = np.array([[10.0, 7.0], [1 / 3, 20.5], [30.25, 40.0], [63.0, 50.125]])


def instance(xy: np.ndarray = XY, **others: Any) -> Any:
    return sleap_io.Instance.from_numpy(xy, skeleton=others.pop("skeleton", SKELETON), **others)


SKELETON = sleap_io.Skeleton(list(NODES))  # which turns the list's names into nodes


def save(path: Path, frames: list[tuple[Any, int, list[Any]]], **others: Any) -> Path:
    """frames: (video, frame index, instances)."""
    labelled = [sleap_io.LabeledFrame(video=v, frame_idx=i, instances=found) for v, i, found in frames]
    videos = list(dict.fromkeys(video for video, _, _ in frames))
    labels = sleap_io.Labels(
        labeled_frames=labelled,
        videos=videos,
        suggestions=others.pop("suggestions", []),
        skeletons=[SKELETON],
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    sleap_io.save_slp(labels, str(path), verbose=False, **others)
    return path


def labels(project: Project) -> dict[str, np.ndarray]:
    frames = LabelStore.of(Project.open(project.root)).read()
    return {f"{frame.video}/{frame.image_path.name}": frame.xy for frame in frames}


# --- out -------------------------------------------------------------------------------------------------


def test_out_and_in_again_is_exact_with_the_images_in_the_file(
    rich, take, contents, actuators, tmp_path: Path
) -> None:
    report = export_sleap(rich, tmp_path / "out.pkg.slp")
    assert (report.labelled, report.images, report.warnings) == (9, 12, [])
    before = contents(rich)
    shutil.move(rich.labels_dir, tmp_path / "gone")
    again, report = take(tmp_path / "out.pkg.slp")
    assert (report.labelled, report.images, report.unlabelled) == (9, 12, 3)
    assert (report.skipped, report.warnings) == ([], [])
    assert again.keypoints == rich.keypoints
    assert contents(again) == before
    assert actuators(again) == {"arm": "original", "arm again": "original", "größe 1.5Hz": "Größer"}
    unlabelled = [
        cv2.imread(str(p / "größe 1.5Hz" / "img00926.png")) for p in (again.labels_dir, tmp_path / "gone")
    ]
    np.testing.assert_array_equal(*unlabelled)
    _, report = take(tmp_path / "out.pkg.slp")
    assert (report.labelled, report.unchanged, report.images) == (0, 9, 0)


def test_sleap_io_finds_in_it_what_there_is(rich: Project, tmp_path: Path) -> None:
    export_sleap(rich, tmp_path / "out.slp")
    theirs = sleap_io.load_slp(str(tmp_path / "out.slp"))
    assert theirs.skeleton.node_names == list(rich.keypoints)
    assert list(theirs.skeleton.edge_inds) == [(0, 1), (1, 2), (2, 3)]
    ours = LabelStore.of(rich).read()
    assert len(theirs.user_labeled_frames) == len(ours) == 9
    for frame, label in zip(theirs, ours, strict=True):
        np.testing.assert_array_equal(frame.instances[0].numpy(), label.xy)
        assert frame.instances[0].track.name == label.actuator
        np.testing.assert_array_equal(frame.image[..., ::-1], cv2.imread(str(label.image_path)))
    assert len(theirs.suggestions) == 3


def test_out_by_video_and_frame(rich, take, contents, write_arm_video, tmp_path: Path) -> None:
    from bendtrack.labeling.interop.dlc import import_dlc

    video = write_arm_video(tmp_path / "arm.mp4")
    shutil.rmtree(rich.labels_dir)
    file = tmp_path / "labels.csv"
    heads = [
        ["scorer", *["me"] * 8],
        ["bodyparts", *[k for k in rich.keypoints for _ in "xy"]],
        ["coords", *"xyxyxyxy"],
    ]
    rows = [[f"labeled-data/arm/img{i:05d}.png", *map(repr, (XY + i / 7).ravel().tolist())] for i in (2, 9)]
    file.write_text("".join(",".join(line) + "\n" for line in [*heads, *rows]), encoding="utf-8")
    assert import_dlc(file, rich, videos=[video]).labelled == 2
    report = export_sleap(rich, tmp_path / "out.slp", videos=[video])
    assert report.warnings == []
    with h5py.File(tmp_path / "out.slp") as stored:
        assert "video0" not in stored
    theirs = sleap_io.load_slp(str(tmp_path / "out.slp"))
    assert [(Path(frame.video.filename), frame.frame_idx) for frame in theirs] == [(video, 2), (video, 9)]
    again, report = take(tmp_path / "out.slp")
    assert (report.labelled, report.skipped) == (2, [])
    assert contents(again) == contents(rich)


def test_images_go_along_where_a_video_is_missing(rich, take, write_arm_video, tmp_path: Path) -> None:
    video = write_arm_video(tmp_path / "arm.mp4")
    report = export_sleap(rich, tmp_path / "out.slp", videos=[video])
    assert report.warnings == ["no video is given for arm again, größe 1.5Hz: images are written to the file"]
    assert take(tmp_path / "out.slp")[1].labelled == 9


def test_export_never_writes_over_something(rich: Project, tmp_path: Path) -> None:
    (tmp_path / "out.slp").write_text("mine")
    with pytest.raises(LabelError, match="expected a new file to export to, got one that is there"):
        export_sleap(rich, tmp_path / "out.slp")
    assert (tmp_path / "out.slp").read_text() == "mine"
    with pytest.raises(LabelError, match=r"expected the name of a \.slp file to export to"):
        export_sleap(rich, tmp_path / "out")
    with pytest.raises(LabelError, match="expected a video, got no such file"):
        export_sleap(rich, tmp_path / "new.slp", videos=[tmp_path / "arm.mp4"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.slp", "study"]


# --- in --------------------------------------------------------------------------------------------------


def test_positions_count_from_the_centre_of_the_first_pixel(tmp_path: Path, take) -> None:
    image = np.zeros((72, 96, 3), np.uint8)
    image[7, 10] = 255
    (tmp_path / "arm").mkdir()
    cv2.imwrite(str(tmp_path / "arm" / "spot.png"), image)
    video = sleap_io.Video.from_filename([str(tmp_path / "arm" / "spot.png")])
    project, report = take(save(tmp_path / "a.slp", [(video, 0, [instance()])]))
    assert report.skipped == []
    [frame] = LabelStore.of(project).read()
    np.testing.assert_array_equal(frame.xy, XY)
    assert cv2.imread(str(frame.image_path))[7, 10, 0] == 255


def test_files_older_than_1_1_counted_from_its_corner(tmp_path: Path, take, save_image) -> None:
    video = sleap_io.Video.from_filename([str(save_image(tmp_path / "arm" / "img1.png", 1))])
    path = save(tmp_path / "a.slp", [(video, 0, [instance(XY + 0.5)])])
    with h5py.File(path, "a") as stored:
        stored["metadata"].attrs["format_id"] = 1.0
        rows = stored["instances"][()]
        fields = [name for name in rows.dtype.names if name != "tracking_score"]  # came with 1.2
        del stored["instances"]
        stored["instances"] = np.array(
            [tuple(row[f] for f in fields) for row in rows], [(f, rows.dtype[f]) for f in fields]
        )
    project, _ = take(path)
    np.testing.assert_array_equal(labels(project)["arm/img1.png"], (XY + 0.5) - 0.5)


def test_a_sleap_project_of_videos(tmp_path: Path, take, write_arm_video) -> None:
    first = write_arm_video(tmp_path / "monday.mp4")
    (tmp_path / "rig").mkdir()
    second = write_arm_video(tmp_path / "rig" / "tuesday.mp4")
    one, two = (sleap_io.Video.from_filename(str(path)) for path in (first, second))
    partly = XY.copy()
    partly[3] = np.nan
    hidden = instance()
    hidden.points["visible"][1] = False
    guess = sleap_io.PredictedInstance.from_numpy(XY + 5, skeleton=SKELETON)
    path = save(
        tmp_path / "project" / "labels.slp",
        [
            (one, 7, [instance()]),
            (one, 3, [instance(partly), guess]),
            (one, 5, [guess]),
            (one, 6, [instance(), instance(XY + 1)]),
            (two, 0, [hidden]),
        ],
        suggestions=[sleap_io.SuggestionFrame(one, 11)],
    )
    project, report = take(path)
    assert project.keypoints == tuple(NODES)
    assert report.skipped == ["monday/img00006.png: expected one actuator in each image, got 2 instances"]
    assert (report.labelled, report.images, report.unlabelled) == (3, 4, 1)
    found = labels(project)
    assert list(found) == ["monday/img00003.png", "monday/img00007.png", "tuesday/img00000.png"]
    np.testing.assert_array_equal(found["monday/img00003.png"], partly)
    np.testing.assert_array_equal(found["monday/img00007.png"], XY)
    assert np.isnan(found["tuesday/img00000.png"][1]).all()
    assert (project.labels_dir / "monday" / "img00011.png").is_file()

    # Moved to another machine: the videos are looked for beside the file, or where one says.
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for file in (first, second, path):
        shutil.move(file, moved / file.name)
    (moved / "tuesday.mp4").rename(tmp_path / "tuesday.mp4")
    _, report = take(moved / "labels.slp")
    assert report.labelled == 0
    assert f"tuesday/img00000.png: no such image in {moved}" in report.skipped
    shutil.rmtree(project.root)
    assert take(moved / "labels.slp", images=tmp_path)[1].labelled == 1
    shutil.rmtree(project.root)
    assert take(moved / "labels.slp", videos=(tmp_path / "tuesday.mp4",))[1].labelled == 3


@pytest.mark.parametrize("older", [False, True])
def test_a_package_of_frames_of_a_video(tmp_path: Path, take, write_arm_video, older: bool) -> None:
    path = write_arm_video(tmp_path / "arm.mp4")
    video = sleap_io.Video.from_filename(str(path), grayscale=False)
    package = save(tmp_path / "a.pkg.slp", [(video, 4, [instance()]), (video, 9, [instance()])], embed=True)
    if older:
        with h5py.File(package, "a") as stored:  # what SLEAP itself said of a video before sleap-io
            backend = {"filename": ".", "dataset": "video0/video", "input_format": "channels_last"}
            stored["videos_json"][0] = json.dumps({"backend": {**backend, "convert_range": False}})
    capture = cv2.VideoCapture(str(path))
    images = [capture.read()[1] for _ in range(12)]
    capture.release()
    path.unlink()
    project, report = take(package)
    assert (report.labelled, report.skipped) == (2, [])
    assert list(labels(project)) == ["arm/img00004.png", "arm/img00009.png"]
    for frame in (4, 9):
        copy = cv2.imread(str(project.labels_dir / "arm" / f"img{frame:05d}.png"))
        np.testing.assert_array_equal(copy, images[frame])


def test_a_cropped_video_is_left_out(tmp_path: Path, take, write_arm_video) -> None:
    whole = sleap_io.Video.from_filename(str(write_arm_video(tmp_path / "arm.mp4")))
    part = sleap_io.Video.from_filename(str(write_arm_video(tmp_path / "leg.mp4"))).crop((10, 10, 90, 70))
    project, report = take(save(tmp_path / "a.slp", [(whole, 0, [instance()]), (part, 0, [instance()])]))
    assert report.skipped == ["leg: expected whole frames, got a cropped video"]
    assert list(labels(project)) == ["arm/img00000.png"]


def test_images_of_one_stem_stay_two(tmp_path: Path, take, save_image) -> None:
    names = ["day1/arm/a.png", "day2/arm/a.png", "arm/b.jpg", "arm/b.png"]
    for seed, name in enumerate(names):
        save_image(tmp_path / name, seed)
    video = sleap_io.Video.from_filename([str(tmp_path / name) for name in names], grayscale=False)
    frames = [(video, i, [instance(XY + i / 10)]) for i in range(4)]
    project, report = take(save(tmp_path / "plain.slp", frames))
    assert (report.labelled, report.images, report.skipped) == (4, 4, [])
    for frame in LabelStore.of(project).read():
        name = names[round(frame.xy[0, 0] * 10 - 100)]
        assert frame.image_path.read_bytes() == (tmp_path / name).read_bytes()
    project, report = take(save(tmp_path / "a.pkg.slp", frames, embed=True))
    assert (report.labelled, report.images, report.skipped) == (4, 4, [])
    kept = sorted(path.name for path in project.labels_dir.rglob("*.png"))
    assert kept == ["b_jpg.png", "b_png.png", "day1_arm_a.png", "day2_arm_a.png"]


def test_images_of_several_kinds_keep_their_colours(rich, take, tmp_path: Path) -> None:
    for name, suffix in (("img00014", "jpg"), ("img00926", "bmp")):
        (rich.labels_dir / "arm" / f"{name}.png").rename(rich.labels_dir / "arm" / f"{name}.{suffix}")
    table = rich.labels_dir / "arm" / "CollectedData_bendtrack.csv"
    table.write_text(table.read_text("utf-8").replace("img00014.png", "img00014.jpg"), encoding="utf-8")
    for path in (rich.labels_dir / "arm").glob("img*"):
        path.write_bytes(cv2.imencode(path.suffix, cv2.imread(str(path)))[1].tobytes())
    export_sleap(rich, tmp_path / "out.slp")
    again, report = take(tmp_path / "out.slp")
    assert (report.labelled, report.images, report.skipped) == (9, 12, [])
    for image in (rich.labels_dir / "arm").glob("img*"):
        copy = (again.labels_dir / "arm" / image.name).with_suffix(".png")
        np.testing.assert_array_equal(cv2.imread(str(copy)), cv2.imread(str(image)))
    for ours, theirs in zip(LabelStore.of(rich).read(), LabelStore.of(again).read(), strict=True):
        np.testing.assert_array_equal(ours.xy, theirs.xy)


def test_tracks_of_others_are_no_actuators(tmp_path: Path, take, save_image) -> None:
    video = sleap_io.Video.from_filename([str(save_image(tmp_path / "arm" / "img1.png", 1))])
    frames = [(video, 0, [instance(track=sleap_io.Track("track_0"))])]
    project, _ = take(save(tmp_path / "a.slp", frames))
    assert project.actuator_of("arm") == "default"


def test_a_file_that_cannot_be_says_why_in_one_line(tmp_path: Path, save_image) -> None:
    def said(path: Path) -> str:
        with pytest.raises(LabelError) as caught:
            open_sleap(path)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    path = tmp_path / "a.slp"
    for contents in (b"", b"hello", b"\x89HDF\r\n\x1a\n" + bytes(100)):
        path.write_bytes(contents)
        assert "expected SLEAP labels (.slp), got a file that does not open as such" in said(path)
    with h5py.File(path, "w") as stored:
        stored["x"] = 1
    assert "expected SLEAP labels (.slp), got a file that does not open as such" in said(path)
    video = sleap_io.Video.from_filename([str(save_image(tmp_path / "arm" / "img1.png", 1))])
    guess = sleap_io.PredictedInstance.from_numpy(XY, skeleton=SKELETON)
    save(tmp_path / "b.slp", [(video, 0, [guess])])
    assert said(tmp_path / "b.slp").endswith("expected frames that a person labelled, got none")


def test_without_sleap_io_it_says_what_to_install(
    rich: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "sleap_io", None)
    for attempt in (lambda: open_sleap(tmp_path / "a.slp"), lambda: export_sleap(rich, tmp_path / "a.slp")):
        with pytest.raises(LabelError, match=r"install '\.\[sleap\]'"):
            attempt()
