"""Lightning Pose projects in and out, built here as its documentation describes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from bendtrack.labeling.interop.lightning_pose import export_lightning_pose, open_lightning_pose
from bendtrack.labeling.notes_file import read_notes, write_notes
from bendtrack.labeling.store import LabelStore
from bendtrack.tracker.errors import LabelError
from bendtrack.tracker.project import Project

PLAIN = """\
scorer,scorer,scorer,scorer,scorer,scorer,scorer,scorer,scorer
bodyparts,base_1,base_1,base_2,base_2,tip_1,tip_1,tip_2,tip_2
coords,x,y,x,y,x,y,x,y
labeled-data/session0/img00000001.png,77.25,36.25,,,12.5,8.0,1e1,5
labeled-data/session1/img00000012.png,37.25,11.75,12.5,70.0,1,2,3,4
"""
VISIBLE = """\
scorer,s,s,s,s,s,s,s,s,s,s,s,s
bodyparts,base_1,base_1,base_1,base_2,base_2,base_2,tip_1,tip_1,tip_1,tip_2,tip_2,tip_2
coords,x,y,visible,x,y,visible,x,y,visible,x,y,visible
labeled-data/session0/img00000001.png,77.25,36.25,2,,,1,12.5,8.0,2,,,0
labeled-data/session0/img00000005.png,77.25,36.25,2.0,1.5,2.5,1,12.5,8.0,2,3.5,4.5,0.0
"""


def labels(project: Project) -> dict[str, list[list[float]]]:
    frames = LabelStore.of(Project.open(project.root)).read()
    return {f"{frame.video}/{frame.image_path.name}": frame.xy.tolist() for frame in frames}


@pytest.fixture
def root(tmp_path: Path, save_image) -> Path:
    """The folder of a Lightning Pose project, without labels yet."""
    root = tmp_path / "lp"
    for name in ("session0/img00000001.png", "session0/img00000005.png", "session1/img00000012.png"):
        save_image(root / "labeled-data" / name, int(name[-6:-4]))
    (root / "project.yaml").write_text("view_names: []\nkeypoint_names: [base_1, base_2, tip_1, tip_2]\n")
    return root


def test_out_and_in_again_is_exact(rich, take, contents, tmp_path: Path) -> None:
    report = export_lightning_pose(rich, tmp_path / "out")
    assert (report.labelled, report.images) == (9, 12)
    assert report.warnings == [
        "a Lightning Pose project cannot store which video shows which actuator (Größer, original): "
        "keep bendtrack.toml"
    ]
    again, report = take(tmp_path / "out")
    assert (report.labelled, report.images, report.skipped, report.warnings) == (9, 9, [], [])
    assert again.keypoints == rich.keypoints
    assert contents(again) == contents(rich)
    _, report = take(tmp_path / "out")
    assert (report.labelled, report.unchanged, report.images) == (0, 9, 0)


def test_the_project_is_what_lightning_pose_defines(rich: Project, tmp_path: Path) -> None:
    export_lightning_pose(rich, tmp_path / "out")
    settings = yaml.safe_load((tmp_path / "out" / "project.yaml").read_text(encoding="utf-8"))
    assert settings == {"view_names": [], "keypoint_names": list(rich.keypoints)}
    assert (tmp_path / "out" / "videos").is_dir()
    # As its documentation has it read.
    table = pd.read_csv(tmp_path / "out" / "CollectedData.csv", header=[0, 1, 2], index_col=0)
    assert [coord for _, _, coord in table.columns] == ["x", "y"] * 4
    assert all((tmp_path / "out" / name).is_file() for name in table.index)
    ours = LabelStore.of(rich).read()
    assert list(table.index) == [f"labeled-data/{f.video}/{f.image_path.name}" for f in ours]
    np.testing.assert_array_equal(table.to_numpy(), [f.xy.ravel() for f in ours])


def test_what_is_not_visible_goes_out_and_comes_back(rich, take, contents, tmp_path: Path) -> None:
    write_notes(rich.labels_dir / "arm", "img00014.png", {"not_visible": ["tip_1"], "note": "glare"})
    export_lightning_pose(rich, tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "CollectedData.csv", header=[0, 1, 2], index_col=0)
    visible = table.xs("visible", axis=1, level=2).to_numpy().tolist()
    assert visible == [[2, 2, 2, 2], [2, 2, 1, 2], [0, 0, 2, 0]] + 2 * [
        [2, 2, 2, 2],
        [2, 2, 0, 2],
        [0, 0, 2, 0],
    ]
    again, report = take(tmp_path / "out" / "CollectedData.csv")
    assert report.skipped == []
    assert contents(again) == contents(rich)
    assert read_notes(again.labels_dir / "arm") == {"img00014.png": {"not_visible": ["tip_1"]}}
    assert read_notes(again.labels_dir / "arm again") == {}
    before = (again.labels_dir / "arm" / "bendtrack-notes.json").stat().st_mtime_ns
    take(tmp_path / "out" / "CollectedData.csv")
    assert (again.labels_dir / "arm" / "bendtrack-notes.json").stat().st_mtime_ns == before


def test_a_project_comes_in(root: Path, take) -> None:
    (root / "CollectedData.csv").write_text(PLAIN)
    project, report = take(root)
    assert project.keypoints == ("base_1", "base_2", "tip_1", "tip_2")
    # session0/img00000005.png, a neighbour kept for context, is not there to be labelled.
    assert (report.videos, report.labelled, report.images, report.unlabelled) == (2, 2, 2, 0)
    found = labels(project)
    assert list(found) == ["session0/img00000001.png", "session1/img00000012.png"]
    assert np.isnan(found["session0/img00000001.png"][1]).all()
    assert found["session0/img00000001.png"][3] == [10.0, 5.0]


def test_only_what_is_visible_has_a_position(root: Path, take) -> None:
    (root / "CollectedData.csv").write_text(VISIBLE)
    project, report = take(root)
    assert report.skipped == []
    for image in ("img00000001.png", "img00000005.png"):
        base_1, base_2, tip_1, tip_2 = labels(project)[f"session0/{image}"]
        assert (base_1, tip_1) == ([77.25, 36.25], [12.5, 8.0])
        assert np.isnan([base_2, tip_2]).all()
        assert read_notes(project.labels_dir / "session0")[image] == {"not_visible": ["base_2"]}


def test_the_views_of_one_project(root: Path, take, save_image) -> None:
    for view in ("left", "right"):
        save_image(root / "labeled-data" / f"session2_{view}" / "img00000003.png", len(view))
        text = "".join(PLAIN.splitlines(keepends=True)[:4])
        text = text.replace("session0/img00000001", f"session2_{view}/img00000003")
        (root / f"CollectedData_{view}.csv").write_text(text)
    project, report = take(root)
    assert (report.labelled, report.skipped) == (2, [])
    assert list(labels(project)) == ["session2_left/img00000003.png", "session2_right/img00000003.png"]


def test_images_in_folders_of_other_names_or_elsewhere(tmp_path: Path, take, save_image) -> None:
    save_image(tmp_path / "in" / "frames" / "s0" / "frame000001.png", 1)
    (tmp_path / "in" / "labels.csv").write_text(
        PLAIN.replace("labeled-data/session0/img00000001", "frames/s0/frame000001").split("labeled-data")[0]
    )
    project, report = take(tmp_path / "in" / "labels.csv", "lightning-pose")
    assert (report.labelled, report.skipped) == (1, [])
    assert list(labels(project)) == ["s0/frame000001.png"]
    (tmp_path / "in" / "frames").rename(tmp_path / "moved")
    _, report = take(tmp_path / "in" / "labels.csv", "lightning-pose")
    assert report.skipped == [f"s0/frame000001.png: no such image in {tmp_path / 'in'}"]
    report = take(tmp_path / "in" / "labels.csv", "lightning-pose", images=tmp_path / "moved")[1]
    assert (report.unchanged, report.skipped) == (1, [])


def test_what_cannot_be_used_is_left_out_and_said(root: Path, take) -> None:
    text = VISIBLE.replace("12.5,8.0,2,,,0", "12.5,8.0,maybe,,,0").replace("2.0,1.5,2.5,1", "2.0,1.5,2.5,3")
    (root / "CollectedData.csv").write_text(
        text + "labeled-data/session0/img00000099.png,1,2,2,3,4,2,5,6,2,7,8,2\n"
    )
    project, report = take(root)
    file = root / "CollectedData.csv"
    assert report.skipped == [
        f"{file} line 4, column tip_1 visible: expected 0, 1 or 2, got 'maybe'",
        f"{file} line 5, column base_2 visible: expected 0, 1 or 2, got '3'",
        f"session0/img00000099.png: no such image in {root}",
    ]
    assert np.isnan(labels(project)["session0/img00000001.png"][2]).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected labels of Lightning Pose"),
        ("a,b\n1,2\n", "expected labels of Lightning Pose"),
        (
            "scorer,a\nbodyparts\n",
            "expected a label file whose first rows begin with scorer, bodyparts, coords",
        ),
        (PLAIN.replace(",5\n", "\n"), "line 4: expected 9 cells, got 8"),
        ("".join(PLAIN.splitlines(keepends=True)[:3]), "expected labelled frames, got none"),
        (PLAIN.replace("scorer", "scorer\xff", 1), "expected labels of Lightning Pose"),
        (PLAIN.replace("session1", "se\xffion"), "expected a CSV file in UTF-8"),
    ],
)
def test_a_file_that_cannot_be_says_why_in_one_line(root: Path, text: str, message: str) -> None:
    (root / "CollectedData.csv").write_bytes(text.encode("latin-1"))
    with pytest.raises(LabelError, match=message) as caught:
        open_lightning_pose(root)
    assert str(caught.value).startswith(str(root))
    assert "\n" not in str(caught.value)


def test_export_never_writes_over_something(rich: Project, root: Path) -> None:
    with pytest.raises(LabelError, match="with something in it"):
        export_lightning_pose(rich, root)
