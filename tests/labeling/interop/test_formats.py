"""Which form labels have is found by looking; every form goes out and comes in through the command line."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from pathlib import Path, PurePosixPath

import numpy as np
import pytest

from bendtrack.labeling.interop.formats import FORMATS, detect_format, export_labels, open_labels
from bendtrack.labeling.interop.source import ImageFinder, distinct_names, foreign_path
from bendtrack.labeling.store import LabelStore
from bendtrack.tracker.cli.project_commands import LabelFormat
from bendtrack.tracker.errors import LabelError
from bendtrack.tracker.project import Project

FORMS = [
    "dlc",
    "coco",
    "lightning-pose",
    pytest.param(
        "sleap",
        marks=pytest.mark.skipif(
            importlib.util.find_spec("sleap_io") is None,
            reason="sleap-io is not installed (bendtrack[sleap])",
        ),
    ),
]


@pytest.mark.parametrize("form", FORMS)
def test_every_form_goes_out_and_comes_back(
    bendtrack, rich: Project, contents, tmp_path: Path, form: str
) -> None:
    out = tmp_path / ("out.slp" if form == "sleap" else "out")
    ran = bendtrack("export", rich.root, out, "--format", form)
    assert ran.status == 0, ran.err
    assert "9 labelled frames and 12 pictures" in ran.out
    assert detect_format(out) == form
    ran = bendtrack("import", tmp_path / "again", out)
    assert (ran.status, ran.err) == (0, "")
    assert "9 labelled frames imported" in ran.out
    assert contents(Project.open(tmp_path / "again")) == contents(rich)
    before = sorted(path for path in tmp_path.rglob("*") if path.is_file())
    ran = bendtrack("export", rich.root, out, "--format", form)
    assert ran.status == 2
    assert ran.err.startswith("error: expected a new ")
    assert sorted(path for path in tmp_path.rglob("*") if path.is_file()) == before


def test_the_forms_are_known_by_the_same_names_everywhere(rich: Project, tmp_path: Path) -> None:
    assert tuple(LabelFormat) == FORMATS
    for attempt in (
        lambda: export_labels(rich, tmp_path / "out", "yolo"),
        lambda: open_labels(rich.root, "yolo"),
    ):
        with pytest.raises(LabelError, match="one of dlc, coco, sleap, lightning-pose, got 'yolo'"):
            attempt()


@pytest.mark.parametrize("form", FORMS)
def test_a_form_may_be_named(bendtrack, rich: Project, tmp_path: Path, form: str) -> None:
    out = tmp_path / ("out.slp" if form == "sleap" else "out")
    export_labels(rich, out, form)
    ran = bendtrack("import", tmp_path / "again", out, "--format", form)
    assert (ran.status, ran.err) == (0, "")


@pytest.mark.parametrize("form", FORMS)
def test_labels_move_on_from_form_to_form(rich: Project, take, contents, tmp_path: Path, form: str) -> None:
    names = {"dlc": "a", "coco": "b", "lightning-pose": "c", "sleap": "d.slp"}
    export_labels(rich, tmp_path / names[form], form)
    project, _ = take(tmp_path / names[form])
    export_labels(project, tmp_path / "last", "coco")
    last, _ = take(tmp_path / "last")
    assert contents(last) == contents(rich)


@pytest.mark.parametrize(
    ("files", "form"),
    [
        ({"a.slp": ""}, "sleap"),
        ({"a.json": "{}"}, "coco"),
        ({"a.csv": "scorer,s\nbodyparts,a\ncoords,x\n"}, "dlc"),
        ({"a.csv": "scorer,s,s\nbodyparts,a,a\ncoords,x,visible\n"}, "lightning-pose"),
        ({"a.h5": ""}, "dlc"),
        ({"config.yaml": "", "CollectedData.csv": "scorer,"}, "dlc"),
        ({"labeled-data/v/CollectedData_a.csv": "scorer,", "x.csv": "scorer,"}, "dlc"),
        ({"CollectedData_a.csv": "scorer,", "img1.png": ""}, "dlc"),
        ({"v/CollectedData_a.csv": "scorer,"}, "dlc"),
        ({"CollectedData.csv": "scorer,", "labeled-data/v/img1.png": ""}, "lightning-pose"),
        ({"CollectedData_top.csv": "\ufeffscorer,", "labeled-data/v/img1.png": ""}, "lightning-pose"),
        ({"readme.csv": "a,b", "labeled-data/v/img1.png": ""}, "dlc"),
        ({"labels.slp": "", "notes.json": "{}"}, "sleap"),
        ({"annotations/a.json": '{"categories": [{"keypoints": ["a"]}]}', "images/a.png": ""}, "coco"),
        ({"annotations/a.json": '{"categories": [{"name": "a"}]}'}, "dlc"),
    ],
)
def test_a_form_is_recognised(tmp_path: Path, files: dict[str, str], form: str) -> None:
    root = tmp_path / "in"
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    [*_, only] = [root / name for name in files]
    assert detect_format(only if len(files) == 1 and only.parent == root else root) == form


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("nowhere", (), "expected labels to import, got no such file or folder"),
        ("task.zip", (), "expected labels, got an archive: unpack it first"),
        ("notes.txt", (), "expected a label file whose first rows begin with scorer"),
        ("video.mp4", (), "expected a CSV file in UTF-8"),
        ("notes.txt", ("--format", "coco"), "expected JSON, got a mistake"),
        ("notes.txt", ("--format", "lightning-pose"), "expected a label file whose first rows"),
        ("empty", (), "expected labels (labeled-data/<video>/CollectedData_<scorer>.csv), got none"),
        ("empty", ("--format", "coco"), "expected labelled COCO keypoints, got none"),
        (
            "empty",
            ("--format", "lightning-pose"),
            "expected labels of Lightning Pose (CollectedData.csv), got none",
        ),
        ("empty", ("--format", "sleap"), "expected one .slp file, got none"),
        ("two", (), "expected one .slp file, got a.slp, b.slp"),
        ("empty", ("--images", "nowhere"), "expected a folder of images, got"),
        ("empty", ("--images", "empty"), "DeepLabCut's images are next to its labels"),
    ],
)
def test_bad_input_is_one_line(
    bendtrack, tmp_path: Path, name: str, options: tuple[str, ...], message: str
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "two").mkdir()
    for file in ("two/a.slp", "two/b.slp", "task.zip"):
        (tmp_path / file).touch()
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "video.mp4").write_bytes(bytes(range(256)))
    options = tuple(str(tmp_path / o) if o in ("nowhere", "empty") else o for o in options)
    ran = bendtrack("import", tmp_path / "project", tmp_path / name, *options)
    assert ran.status == 2
    assert ran.out == ""
    assert message in ran.err
    assert ran.err.startswith("error: ")
    assert ran.err.count("\n") == 1
    assert not (tmp_path / "project").exists()


def test_export_refuses_in_one_line(bendtrack, rich: Project, tmp_path: Path) -> None:
    Project.create(tmp_path / "new", keypoints=("a", "b", "c", "d"))
    for form in ("dlc", "coco", "lightning-pose"):
        ran = bendtrack("export", tmp_path / "new", tmp_path / "out", "--format", form)
        assert ran.status == 2
        assert ran.err.startswith("error: expected labelled frames to export, got none in ")
    assert not (tmp_path / "out").exists()


def test_deeplabcuts_h5_alone(rich: Project, take, contents, tmp_path: Path) -> None:
    pytest.importorskip("tables", reason="PyTables is not installed (bendtrack[dlc-h5])")
    export_labels(rich, tmp_path / "out", "dlc")
    for path in (tmp_path / "out").rglob("*.csv"):
        path.unlink()
    project, report = take(tmp_path / "out")
    assert (report.labelled, report.skipped) == (9, [])
    assert contents(project) == contents(rich)
    shutil.rmtree(project.root)
    folder = tmp_path / "out" / "labeled-data" / "größe 1.5Hz"
    project, report = take(folder / "CollectedData_bendtrack.h5")
    assert (report.labelled, report.skipped) == (3, [])
    assert contents(project) == contents(rich)[6:]


def test_deeplabcuts_h5_as_another_pandas_wrote_it(rich: Project, take, tmp_path: Path) -> None:
    pytest.importorskip("tables", reason="PyTables is not installed (bendtrack[dlc-h5])")
    import pandas as pd

    # Older projects: one index column, in whatever form a path had on Windows.
    export_labels(rich, tmp_path / "out", "dlc")
    path = tmp_path / "out" / "labeled-data" / "arm" / "CollectedData_bendtrack.h5"
    frame = pd.read_hdf(path)
    assert isinstance(frame, pd.DataFrame)
    frame.index = pd.Index(["\\".join(parts) for parts in frame.index])
    frame.to_hdf(path, key="df_with_missing", mode="w")
    path.with_suffix(".csv").unlink()
    project, report = take(path)
    assert (report.labelled, report.skipped) == (3, [])
    ours = [f.xy for f in LabelStore.of(rich).read()[:3]]
    np.testing.assert_array_equal([f.xy for f in LabelStore.of(project).read()], ours)


def test_h5_without_pytables_says_what_to_do(
    bendtrack, rich: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "tables", None)
    ran = bendtrack("export", rich.root, tmp_path / "out")
    assert ran.status == 0
    assert "PyTables is not installed (the extra dlc-h5)" in ran.err
    assert list((tmp_path / "out").rglob("*.h5")) == []
    (tmp_path / "labels.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    ran = bendtrack("import", tmp_path / "new", tmp_path / "labels.h5")
    assert ran.status == 2
    # Reading needs no PyTables: the file itself is what is wrong.
    assert f"{tmp_path / 'labels.h5'}: cannot be read as DeepLabCut's labels in HDF5" in ran.err


# --- names and places ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("a/b.png", ("a", "b.png")),
        ("../../etc/x.png", ("etc", "x.png")),
        ("C:\\data\\arm\\x.png", ("data", "arm", "x.png")),
        ("\\\\server\\share\\x.png", ("server", "share", "x.png")),
        ("/abs/.hidden/x.png", ("abs", "hidden", "x.png")),
        ("./a//b/", ("a", "b")),
        ("..", ()),
        ("", ()),
    ],
)
def test_a_foreign_path_leads_nowhere_else(text: str, parts: tuple[str, ...]) -> None:
    assert foreign_path(text).parts == parts


def test_names_tell_paths_apart() -> None:
    paths = ["a/x/v.png", "a/y/v.png", "b/w.png", "B/W.png", "u.png", "y_v.png"]
    names = distinct_names(map(PurePosixPath, paths))
    assert list(names.values()) == ["x_v.png", "y_v.png", "b_w.png", "B_W_2.png", "u.png", "y_v_2.png"]


def test_an_image_is_found_by_what_fits_best(tmp_path: Path, save_image) -> None:
    for name in ("deep/monday/arm/img1.png", "deep/tuesday/arm/img1.png", "images/leg/img1.png", "img2.PNG"):
        save_image(tmp_path / name, 1)
    finder = ImageFinder([tmp_path])
    assert finder.find("D:\\rig\\tuesday\\arm\\img1.png") == tmp_path / "deep/tuesday/arm/img1.png"
    assert finder.find("leg/img1.png") == tmp_path / "images/leg/img1.png"
    assert finder.find("else/where/IMG2.png") == tmp_path / "img2.PNG"
    assert finder.find("img3.png") is None
    with pytest.raises(LabelError, match=r"expected one image of that name, got .*monday.* and .*tuesday"):
        finder.find("arm/img1.png")


def test_a_folder_that_is_given_is_where_images_are(rich: Project, tmp_path: Path) -> None:
    export_labels(rich, tmp_path / "out", "coco")
    with pytest.raises(LabelError, match="expected a folder of images"):
        open_labels(tmp_path / "out", images=tmp_path / "none")
