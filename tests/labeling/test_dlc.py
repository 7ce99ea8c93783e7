"""DeepLabCut projects in and out: foreign projects built here, and a real one where it is at hand."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

from bendtrack.labeling.interop.dlc import export_dlc, import_dlc, project_for
from bendtrack.labeling.interop.dlc_source import open_dlc
from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.tracker.errors import LabelError, ProjectError
from bendtrack.tracker.project import Project
from bendtrack.tracker.types import LabelledFrame
from bendtrack.tracker.video_writer import VideoWriter

FOUR = ("base_1", "base_2", "tip_1", "tip_2")
WH = (64, 48)
XY = np.array([[1.5, 2.0], [10.1, 20.2], [30.0, 40.0], [63.4, -0.4]])


def image(seed: int, size_wh: tuple[int, int] = WH) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (size_wh[1], size_wh[0], 3), dtype=np.uint8)


def row_text(image: str, xy: np.ndarray = XY, video: str = "v") -> str:
    clusters = ",".join("" if np.isnan(value) else repr(float(value)) for value in xy.ravel())
    return f"labeled-data/{video}/{image},{clusters}\n"


def header(bodyparts: tuple[str, ...] = FOUR, scorer: str = "Ana") -> str:
    twice = [name for name in bodyparts for _ in "xy"]
    lines = (
        ["scorer", *[scorer] * len(twice)],
        ["bodyparts", *twice],
        ["coords", *["x", "y"] * len(bodyparts)],
    )
    return "".join(",".join(line) + "\n" for line in lines)


def config(root: Path, **changes: object) -> None:
    settings = {"Task": "t", "scorer": "Ana", "multianimalproject": False, "bodyparts": list(FOUR)} | changes
    (root / "config.yaml").write_text(yaml.safe_dump(settings))


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A DeepLabCut project with one video `v`: frames 0 and 7 labelled, 9 extracted only, 12 an empty row."""
    root = tmp_path / "dlc-Ana-2024"
    folder = root / "labeled-data" / "v"
    folder.mkdir(parents=True)
    for frame in (0, 7, 9, 12):
        cv2.imwrite(str(folder / f"img{frame:03d}.png"), image(frame))
    partly = XY + 1.25
    partly[3] = np.nan
    (folder / "CollectedData_Ana.csv").write_text(
        header()
        + row_text("img000.png")
        + row_text("img007.png", np.where(np.isnan(partly), np.nan, partly))
        + row_text("img012.png", XY * np.nan)
    )
    (root / "labeled-data" / "v_labeled").mkdir()
    config(root)
    return root


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return Project.create(tmp_path / "study", keypoints=FOUR)


def labels(project: Project) -> list[LabelledFrame]:
    return LabelStore.of(project).read()


def same(first: list[LabelledFrame], second: list[LabelledFrame]) -> bool:
    return [
        (f.video, f.image_path.name, f.frame, f.xy.tobytes(), f.image_path.read_bytes()) for f in first
    ] == [(f.video, f.image_path.name, f.frame, f.xy.tobytes(), f.image_path.read_bytes()) for f in second]


# --- in --------------------------------------------------------------------------------------------------


def test_a_project_comes_in_whole(source: Path, project: Project) -> None:
    report = import_dlc(source, project)
    frames = labels(project)
    assert [(f.video, f.frame, f.actuator) for f in frames] == [("v", 0, "default"), ("v", 7, "default")]
    np.testing.assert_array_equal(frames[0].xy, XY)
    assert np.isnan(frames[1].xy[3]).all()
    assert frames[0].image_path.read_bytes() == (source / "labeled-data" / "v" / "img000.png").read_bytes()
    assert (report.videos, report.labelled, report.unchanged, report.images, report.unlabelled) == (
        1,
        2,
        0,
        4,
        2,
    )
    assert report.skipped == []
    assert report.warnings == []
    assert report.summary() == (
        "2 labelled frames imported, 0 already there, 4 images copied, 2 have no labels, 0 left out"
    )


def files_of(root: Path) -> dict[str, tuple[bytes, int]]:
    return {
        str(p.relative_to(root)): (p.read_bytes(), p.stat().st_mtime_ns)
        for p in root.rglob("*")
        if p.is_file()
    }


def test_importing_twice_changes_nothing(source: Path, project: Project) -> None:
    import_dlc(source, project)
    before = files_of(project.root)
    report = import_dlc(source, project)
    assert files_of(project.root) == before
    assert (report.labelled, report.unchanged, report.images, report.skipped) == (0, 2, 0, [])


@pytest.mark.parametrize("part", ["labeled-data", "labeled-data/v", "labeled-data/v/CollectedData_Ana.csv"])
def test_a_part_of_a_project_will_do(source: Path, project: Project, part: str) -> None:
    import_dlc(source / part, project)
    assert len(labels(project)) == 2


def test_a_project_is_created_with_the_sources_keypoints_and_scorer(source: Path, tmp_path: Path) -> None:
    made = project_for(tmp_path / "new", source)
    assert (made.keypoints, made.settings.scorer) == (FOUR, "Ana")
    assert project_for(tmp_path / "new", source).settings == made.settings


def test_a_source_whose_names_cannot_be_keypoints_creates_nothing(source: Path, tmp_path: Path) -> None:
    config(source, bodyparts=["a,b", *FOUR])
    with pytest.raises(ProjectError, match=r"cannot create a project from .*got 'a,b'"):
        project_for(tmp_path / "new", source)
    assert not (tmp_path / "new").exists()


def test_contradicting_labels_are_reported_and_kept_unless_told(source: Path, project: Project) -> None:
    import_dlc(source, project)
    store = LabelStore.of(project)
    corrected = XY.copy()
    corrected[2] += 3
    store.write("v", {"img000.png": corrected})
    report = import_dlc(source, project)
    assert report.skipped == ["v/img000.png: labelled otherwise in the project (tip_1), kept"]
    np.testing.assert_array_equal(labels(project)[0].xy, corrected)
    report = import_dlc(source, project, overwrite=True)
    assert report.skipped == []
    np.testing.assert_array_equal(labels(project)[0].xy, XY)


def test_points_that_the_project_lacks_are_filled_in(source: Path, project: Project) -> None:
    import_dlc(source, project)
    store = LabelStore.of(project)
    partly = XY.copy()
    partly[1] = np.nan
    store.write("v", {"img000.png": partly})
    assert import_dlc(source, project).labelled == 1
    np.testing.assert_array_equal(labels(project)[0].xy, XY)


def test_another_image_of_that_name_stays_and_its_labels_are_left_out(source: Path, project: Project) -> None:
    LabelStore.of(project).add_image("v", "img000.png", image(99))
    report = import_dlc(source, project)
    assert report.skipped == ["v/img000.png: the project has another image of that name, kept"]
    assert [f.frame for f in labels(project)] == [7]
    assert import_dlc(source, project, overwrite=True).skipped == []
    assert [f.frame for f in labels(project)] == [0, 7]


def test_what_cannot_be_used_is_left_out_and_said(source: Path, project: Project) -> None:
    folder = source / "labeled-data" / "v"
    (folder / "img001.png").write_bytes(b"no image")
    (folder / "img002.png").touch()
    cv2.imwrite(str(folder / "img003.png"), image(3, (32, 24)))
    for frame in (4, 5, 6):
        cv2.imwrite(str(folder / f"img{frame:03d}.png"), image(frame))
    outside, on_the_edge = XY.copy(), XY.copy()
    outside[1] = [64.0, 10.0]
    on_the_edge[1] = [63.5, 47.5]
    with (folder / "CollectedData_Ana.csv").open("a") as file:
        for frame in (1, 2, 3, 8):
            file.write(row_text(f"img{frame:03d}.png"))
        file.write(row_text("img004.png", outside))
        file.write(row_text("img005.png", on_the_edge))
        file.write(row_text("img006.png").replace("30.0", "thirty"))
        file.write(row_text("img000.png", XY + 1))
    report = import_dlc(source, project)
    said = "\n".join(report.skipped)
    for expected in (
        "v/img001.png: expected an image, got a file that does not open as one",
        "v/img002.png: expected an image, got a file that does not open as one",
        "v/img003.png: expected 64 x 48 px as other images of this video, got 32 x 24",
        "v/img008.png: no such image in ",
        "v/img004.png: expected 'base_2' inside the 64 x 48 px, got (64, 10)",
        "column tip_1 x: expected a number of px, got 'thirty'",
        "img000.png is labelled twice, expected 1.5",
    ):
        assert expected in said
    assert len(report.skipped) == 7
    frames = {f.frame: f.xy for f in labels(project)}
    assert sorted(frames) == [0, 4, 5, 6, 7]
    np.testing.assert_array_equal(frames[0], XY)
    np.testing.assert_array_equal(np.isnan(frames[4][:, 0]), [False, True, False, False])
    np.testing.assert_array_equal(frames[5], on_the_edge)
    np.testing.assert_array_equal(np.isnan(frames[6][:, 0]), [False, False, True, False])


def test_two_names_for_one_frame_are_pointed_out(source: Path, project: Project) -> None:
    folder = source / "labeled-data" / "v"
    shutil.copy(folder / "img007.png", folder / "img00007.png")
    with (folder / "CollectedData_Ana.csv").open("a") as file:
        file.write(row_text("img00007.png"))
    assert import_dlc(source, project).warnings == ["v: img007.png and img00007.png name the same frame"]


def test_foreign_keypoints_are_kept_but_not_used(source: Path, project: Project) -> None:
    names = ("base_1", "base_2", "tip1", "tip_2")
    (source / "labeled-data" / "v" / "CollectedData_Ana.csv").write_text(
        header(names) + row_text("img000.png")
    )
    config(source, bodyparts=list(names))
    report = import_dlc(source, project)
    assert report.warnings == [
        "'tip1' is no keypoint of the project (did someone mean 'tip_1'?): its labels are kept, not used",
        "keypoint 'tip_1' is not labelled in the source",
    ]
    assert np.isnan(labels(project)[0].xy[2]).all()
    row = LabelStore.of(project).table("v").rows[0]
    assert row.point("tip1") == (30.0, 40.0)


def test_a_source_of_something_else_is_refused(source: Path, tmp_path: Path) -> None:
    mouse = Project.create(tmp_path / "mouse", keypoints=("snout", "ear", "tail"))
    with pytest.raises(LabelError, match=r"keypoints snout, ear, tail, got base_1, base_2, tip_1, tip_2"):
        import_dlc(source, mouse)
    assert not mouse.labels_dir.exists()


def test_the_configs_scorer_comes_first_where_two_people_labelled(source: Path, project: Project) -> None:
    folder = source / "labeled-data" / "v"
    (folder / "CollectedData_Aaron.csv").write_text(
        header(scorer="Aaron") + row_text("img000.png", XY + 2) + row_text("img009.png", XY)
    )
    report = import_dlc(source, project)
    assert len(report.skipped) == 1
    assert "img000.png is labelled twice" in report.skipped[0]
    frames = labels(project)
    assert [f.frame for f in frames] == [0, 7, 9]
    np.testing.assert_array_equal(frames[0].xy, XY)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bodyparts: [a\nscorer: b", "expected YAML, got a mistake: .*line 2"),
        ("- 1", "expected the settings of a DeepLabCut project, got list"),
        ("multianimalproject: true\nbodyparts: MULTI!", "got a multi-animal project"),
        ("bodyparts: base_1", "expected bodyparts to be a list of names, got 'base_1'"),
    ],
)
def test_a_config_that_cannot_be_says_why(source: Path, project: Project, text: str, message: str) -> None:
    (source / "config.yaml").write_text(text)
    with pytest.raises(LabelError, match=message):
        import_dlc(source, project)


def test_sources_without_labels(source: Path, project: Project, tmp_path: Path) -> None:
    with pytest.raises(LabelError, match="got no such file or folder"):
        import_dlc(tmp_path / "nowhere", project)
    (source / "labeled-data" / "v" / "CollectedData_Ana.csv").unlink()
    with pytest.raises(LabelError, match=r"expected labels .*, got none"):
        import_dlc(source, project)
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(LabelError, match="expected a label file"):
        import_dlc(tmp_path / "notes.txt", project)


# --- in, with the video instead of the images ----------------------------------------------------------


def write_video(path: Path, frames: int) -> None:
    """Every frame a flat grey of its own: 8 x its index."""
    with VideoWriter(path, WH, 30.0) as writer:
        for index in range(frames):
            writer.write(np.full((WH[1], WH[0], 3), 8 * index, np.uint8))


def test_images_that_are_missing_come_out_of_the_video(tmp_path: Path, project: Project) -> None:
    video = tmp_path / "trial 1.5Hz.mp4"
    write_video(video, 20)
    file = tmp_path / "labels.csv"
    file.write_text(
        header() + "".join(row_text(image_name(i), XY * (1 - i / 1000), "trial 1.5Hz") for i in (17, 3, 11))
        + row_text(image_name(20), XY, "trial 1.5Hz")
    )  # fmt: skip
    report = import_dlc(file, project, videos=[video])
    assert report.skipped == [
        "trial 1.5Hz/img00020.png: expected frame 20, but trial 1.5Hz.mp4 has 20 frames"
    ]
    frames = labels(project)
    assert [f.frame for f in frames] == [3, 11, 17]
    for frame in frames:
        assert frame.frame is not None
        grey = cv2.imread(str(frame.image_path)).mean()
        assert grey == pytest.approx(8 * frame.frame, abs=3)
        np.testing.assert_array_equal(frame.xy, XY * (1 - frame.frame / 1000))
    again = import_dlc(file, project, videos=[video])
    assert (again.images, again.labelled, again.unchanged) == (0, 0, 3)


def test_two_videos_of_one_name_are_not_guessed_between(
    source: Path, project: Project, tmp_path: Path
) -> None:
    for folder in ("monday", "tuesday"):
        (tmp_path / folder).mkdir()
        write_video(tmp_path / folder / "v.mp4", 2)
    videos = [tmp_path / "monday" / "v.mp4", tmp_path / "tuesday" / "v.mp4"]
    with pytest.raises(LabelError, match=r"different names.*monday.*tuesday"):
        import_dlc(source, project, videos=videos)
    assert labels(project) == []
    import_dlc(source, project, videos=[videos[0], videos[0]])
    with pytest.raises(LabelError, match="different names"):
        export_dlc(project, tmp_path / "out", videos=videos)
    assert not (tmp_path / "out").exists()


def test_labels_without_images_and_without_their_video(tmp_path: Path, project: Project) -> None:
    write_video(tmp_path / "other.mp4", 2)
    file = tmp_path / "labels.csv"
    file.write_text(header() + row_text("img00003.png"))
    report = import_dlc(file, project, videos=[tmp_path / "other.mp4"])
    assert len(report.skipped) == 1
    assert "v/img00003.png: no such image in " in report.skipped[0]
    assert report.warnings == ["other.mp4: no labels are named after this video"]
    assert labels(project) == []


# --- out -------------------------------------------------------------------------------------------------


def test_out_and_in_again_is_exact(source: Path, project: Project, tmp_path: Path) -> None:
    import_dlc(source, project)
    report = export_dlc(project, tmp_path / "out")
    assert (report.labelled, report.images) == (2, 4)
    again = project_for(tmp_path / "again", tmp_path / "out")
    assert import_dlc(tmp_path / "out", again).skipped == []
    assert same(labels(project), labels(again))
    assert [p.name for p in LabelStore.of(again).images("v")] == [
        p.name for p in LabelStore.of(project).images("v")
    ]


def test_the_exported_project_is_what_deeplabcut_opens(
    source: Path, project: Project, tmp_path: Path
) -> None:
    import_dlc(source, project)
    export_dlc(project, tmp_path / "out", videos=[tmp_path / "rig" / "v.avi"])
    settings = yaml.safe_load((tmp_path / "out" / "config.yaml").read_text())
    assert settings["bodyparts"] == list(FOUR)
    assert settings["scorer"] == "bendtrack"
    assert settings["multianimalproject"] is False
    assert settings["video_sets"] == {(tmp_path / "rig" / "v.avi").as_posix(): {"crop": "0, 64, 0, 48"}}
    assert settings["skeleton"] == [["base_1", "base_2"], ["base_2", "tip_1"], ["tip_1", "tip_2"]]
    # DeepLabCut's convertcsv2h5 and merge_annotateddatasets read like this.
    path = tmp_path / "out" / "labeled-data" / "v" / "CollectedData_bendtrack.csv"
    frame = pd.read_csv(path, index_col=[0, 1, 2], header=[0, 1, 2])
    assert list(frame.index[:2]) == [("labeled-data", "v", "img000.png"), ("labeled-data", "v", "img007.png")]
    np.testing.assert_array_equal(frame["bendtrack"].iloc[0].to_numpy(), XY.ravel())


def test_export_never_writes_over_something(source: Path, project: Project, tmp_path: Path) -> None:
    with pytest.raises(LabelError, match="expected labelled frames to export, got none"):
        export_dlc(project, tmp_path / "out")
    import_dlc(source, project)
    with pytest.raises(LabelError, match="with something in it"):
        export_dlc(project, source)
    (tmp_path / "empty").mkdir()
    export_dlc(project, tmp_path / "empty")
    assert (tmp_path / "empty" / "config.yaml").is_file()
    assert [p.name for p in tmp_path.iterdir() if p.name.endswith(".tmp")] == []


def test_an_export_that_fails_leaves_nothing(source: Path, project: Project, tmp_path: Path) -> None:
    import_dlc(source, project)
    (project.labels_dir / "w").mkdir()
    (project.labels_dir / "w" / "img0.png").write_bytes(b"no image")
    before = sorted(p.name for p in tmp_path.iterdir())
    with pytest.raises(LabelError, match="does not open as one"):
        export_dlc(project, tmp_path / "out")
    assert sorted(p.name for p in tmp_path.iterdir()) == before


# --- .h5 -------------------------------------------------------------------------------------------------


def test_h5_labels_say_what_the_csv_says(source: Path, project: Project, tmp_path: Path) -> None:
    pytest.importorskip("tables", reason="PyTables is not installed (bendtrack[dlc-h5])")
    import_dlc(source, project)
    export_dlc(project, tmp_path / "out")
    path = tmp_path / "out" / "labeled-data" / "v" / "CollectedData_bendtrack.h5"
    frame = pd.read_hdf(path, key="df_with_missing")
    assert isinstance(frame, pd.DataFrame)
    assert frame.columns.names == ["scorer", "bodyparts", "coords"]
    path.with_suffix(".csv").unlink()
    again = Project.create(tmp_path / "again", keypoints=FOUR)
    import_dlc(tmp_path / "out", again)
    assert same(labels(project), labels(again))


# --- a real project --------------------------------------------------------------------------------------

OPENFIELD = Path(
    os.environ.get("BENDTRACK_OPENFIELD", Path(__file__).parents[3] / "shared" / "data" / "openfield")
)


@pytest.mark.skipif(
    not OPENFIELD.is_dir(),
    reason="DeepLabCut's openfield example is not at ../shared/data/openfield nor at $BENDTRACK_OPENFIELD",
)
def test_a_real_project_goes_in_and_out_without_a_difference(tmp_path: Path) -> None:
    project = project_for(tmp_path / "study", OPENFIELD)
    report = import_dlc(OPENFIELD, project)
    assert (report.labelled, report.skipped, report.warnings) == (116, [], [])
    export_dlc(project, tmp_path / "out")
    again = project_for(tmp_path / "again", tmp_path / "out")
    import_dlc(tmp_path / "out", again)
    assert same(labels(project), labels(again))

    # Against the file as pandas reads it, and the images byte for byte.
    original = pd.read_csv(next(OPENFIELD.glob("labeled-data/m4s1/*.csv")), header=[0, 1, 2], index_col=0)
    frames = labels(again)
    np.testing.assert_array_equal([f.xy.ravel() for f in frames], original.to_numpy())
    for frame, name in zip(frames, original.index, strict=True):
        assert frame.image_path.read_bytes() == (OPENFIELD / name).read_bytes()


def test_the_real_config_is_read() -> None:
    if not OPENFIELD.is_dir():
        pytest.skip("DeepLabCut's openfield example is not at hand (see $BENDTRACK_OPENFIELD)")
    source = open_dlc(OPENFIELD)
    assert source.keypoints == ("snout", "leftear", "rightear", "tailbase")
    assert source.scorer == "Pranav"
