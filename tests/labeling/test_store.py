"""The label store against files as DeepLabCut, spreadsheets and killed processes leave them."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bendtrack.labeling.label_table import LabelRow, format_label_table, read_label_table
from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.tracker.errors import LabelError
from bendtrack.tracker.project import Project

OLD_FORM = """\
scorer,Ana,Ana,Ana,Ana
bodyparts,base,base,tip,tip
coords,x,y,x,y
labeled-data/v/img00007.png,1.5,2.25,250.05599999999998,4
labeled-data/v/img00010.png,,,30,40
"""
NEW_FORM = """\
scorer,,,Ana,Ana,Ana,Ana
bodyparts,,,base,base,tip,tip
coords,,,x,y,x,y
labeled-data,v,img00007.png,1.5,2.25,250.05599999999998,4
labeled-data,v,img00010.png,,,30,40
"""
EXPECTED = np.array([[[1.5, 2.25], [250.05599999999998, 4.0]], [[np.nan, np.nan], [30.0, 40.0]]])


@pytest.fixture
def store(tmp_path: Path) -> LabelStore:
    """A store of two keypoints over one video `v` with images of the frames 7, 10 and 100."""
    folder = tmp_path / "labeled-data" / "v"
    folder.mkdir(parents=True)
    for name in ("img00007.png", "img00010.png", "img00100.png"):
        cv2.imwrite(str(folder / name), np.zeros((48, 64, 3), np.uint8))
    return LabelStore(tmp_path / "labeled-data", ("base", "tip"), "Ana", lambda video: f"actuator of {video}")


def put(store: LabelStore, text: str, scorer: str = "Ana") -> Path:
    path = store.labels_dir / "v" / f"CollectedData_{scorer}.csv"
    path.write_text(text, encoding="utf-8", newline="")
    return path


@pytest.mark.parametrize(
    "text",
    [
        OLD_FORM,
        NEW_FORM,
        OLD_FORM.replace("/", "\\"),
        OLD_FORM.replace("\n", "\r\n"),
        "\ufeff" + OLD_FORM,
        NEW_FORM.replace(",,,30", ",nan,NaN,30"),
        NEW_FORM + ",,,,,,\n",
    ],
    ids=["old", "new", "backslashes", "crlf", "byte-order-mark", "nan", "blank-row"],
)
def test_every_form_reads_the_same(store: LabelStore, text: str) -> None:
    put(store, text)
    frames = store.read()
    np.testing.assert_array_equal([f.xy for f in frames], EXPECTED)
    assert [f.frame for f in frames] == [7, 10]
    assert [f.image_path.name for f in frames] == ["img00007.png", "img00010.png"]
    assert {(f.video, f.actuator) for f in frames} == {("v", "actuator of v")}


def test_columns_in_another_order_and_foreign_body_parts_do_not_shift_anything(store: LabelStore) -> None:
    put(
        store,
        "scorer,Ana,Ana,Ana,Ana,Ana,Ana\nbodyparts,tip,tip,ear,ear,base,base\ncoords,y,x,x,y,x,y\n"
        "labeled-data/v/img00007.png,4,3,9,9,1,2\n",
    )
    np.testing.assert_array_equal(store.read()[0].xy, [[1, 2], [3, 4]])


def test_a_first_row_that_is_all_empty_is_not_lost(store: LabelStore) -> None:
    empty_first = NEW_FORM.replace("1.5,2.25,250.05599999999998,4", ",,,")
    put(store, empty_first)
    assert [f.frame for f in store.read(unlabelled=True)] == [7, 10]
    assert np.isnan(store.read(unlabelled=True)[0].xy).all()
    assert [f.frame for f in store.read()] == [10]
    store.write("v", {"img00100.png": np.array([[1.0, 2.0], [3.0, 4.0]])})
    assert [f.frame for f in store.read(unlabelled=True)] == [7, 10, 100]


def test_pandas_reads_what_is_written_as_deeplabcut_reads_it(store: LabelStore) -> None:
    store.write("v", {"img00007.png": EXPECTED[0], "img00010.png": EXPECTED[1]})
    path = store.csv_path("v")
    assert path.read_text().splitlines()[3].split(",")[0] == "labeled-data"  # how DeepLabCut tells the form
    frame = pd.read_csv(path, header=[0, 1, 2], index_col=[0, 1, 2])
    assert frame.columns.names == ["scorer", "bodyparts", "coords"]
    assert list(frame.index) == [("labeled-data", "v", "img00007.png"), ("labeled-data", "v", "img00010.png")]
    np.testing.assert_array_equal(frame["Ana"].to_numpy().reshape(2, 2, 2), EXPECTED)


coordinates = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=50)
@given(values=st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=5))
def test_numbers_read_back_bit_for_bit(values: list[tuple[float, float]]) -> None:
    import tempfile

    rows = [LabelRow(f"img{i}.png", {}).with_points({"tip": value}) for i, value in enumerate(values)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "CollectedData_Ana.csv"
        path.write_text(format_label_table(rows, ["tip"], "v", "Ana"), newline="")
        again = [row.point("tip") for row in read_label_table(path).rows]
    assert [np.array(p).tobytes() for p in again] == [np.array(v, dtype=float).tobytes() for v in values]


def test_writing_changes_what_it_is_given_and_keeps_everything_else(store: LabelStore) -> None:
    path = put(
        store,
        "scorer,Ana,Ana,Ana,Ana,Ana,Ana,Ana\nbodyparts,base,base,base,tip,tip,ear,ear\n"
        "coords,x,y,visible,x,y,x,y\n"
        "labeled-data/v/img00007.png,1.50,2.5,1,3,4,77.70,88\nlabeled-data/v/img00010.png,5,6,,7,8,,\n",
    )
    store.write("v", {"img00010.png": np.array([[50.0, 60.0], [np.nan, np.nan]])})
    assert path.read_text() == (
        "scorer,,,Ana,Ana,Ana,Ana,Ana,Ana,Ana\nbodyparts,,,base,base,base,tip,tip,ear,ear\n"
        "coords,,,x,y,visible,x,y,x,y\n"
        "labeled-data,v,img00007.png,1.50,2.5,1,3,4,77.70,88\n"
        "labeled-data,v,img00010.png,50.0,60.0,,,,,\n"
    )


def test_rows_are_in_the_order_of_the_frames(store: LabelStore) -> None:
    (store.labels_dir / "v" / "img9.png").write_bytes((store.labels_dir / "v" / "img00007.png").read_bytes())
    for name in ("img00100.png", "img9.png", "img00007.png"):
        store.write("v", {name: EXPECTED[0]})
    assert [f.frame for f in store.read()] == [7, 9, 100]
    assert [p.name for p in store.images("v")] == ["img00007.png", "img9.png", "img00010.png", "img00100.png"]


# --- several scorers -------------------------------------------------------------------------------------


def test_the_own_scorers_row_counts_and_others_fill_in_frames(store: LabelStore) -> None:
    put(store, NEW_FORM.replace("Ana", "Bo").replace("30,40", "31,41"), scorer="Bo")
    store.write("v", {"img00010.png": np.array([[np.nan, np.nan], [30.0, 40.0]])})
    frames = store.read()
    np.testing.assert_array_equal([f.xy for f in frames], EXPECTED)
    assert "31" in (store.labels_dir / "v" / "CollectedData_Bo.csv").read_text()


def test_correcting_one_point_of_someone_elses_row_keeps_the_other_points(store: LabelStore) -> None:
    put(store, NEW_FORM.replace("Ana", "Bo"), scorer="Bo")
    store.write_points("v", {"img00007.png": {"tip": (9.0, 9.0)}})
    np.testing.assert_array_equal(store.read()[0].xy, [[1.5, 2.25], [9.0, 9.0]])


def test_others_who_disagree_about_a_frame_are_not_guessed_between(store: LabelStore) -> None:
    put(store, NEW_FORM.replace("Ana", "Bo"), scorer="Bo")
    put(store, NEW_FORM.replace("Ana", "Cy").replace("30,40", "31,40"), scorer="Cy")
    with pytest.raises(
        LabelError, match=r"Cy\.csv line 5, column tip x.*labelled twice, expected 30 as in .*Bo.*got 31"
    ):
        store.read()  # fmt: skip


def test_two_scorers_side_by_side_in_one_file(store: LabelStore) -> None:
    put(
        store,
        "scorer,Bo,Bo,Ana,Ana,Bo,Bo\nbodyparts,base,base,base,base,tip,tip\ncoords,x,y,x,y,x,y\n"
        "labeled-data/v/img00007.png,9,9,1,2,3,4\n",
    )
    np.testing.assert_array_equal(store.read()[0].xy, [[1, 2], [3, 4]])


# --- mistakes --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (NEW_FORM.replace("2.25", "2,25"), r"line 4: expected 7 cells, got 8"),
        (NEW_FORM.replace(",30,40", ",30"), r"line 5: expected 7 cells, got 6"),
        (NEW_FORM.replace("2.25", "abc"), r"line 4, column base y: expected a number of px, got 'abc'"),
        (NEW_FORM.replace("2.25", "inf"), r"line 4, column base y: expected a number of px, got 'inf'"),
        (NEW_FORM.replace("2.25", ""), r"line 4, column base: expected x and y, got x without y"),
        (
            NEW_FORM.replace("img00010", "img00011"),
            r"line 5: expected the image .*img00011.png, got no such file",
        ),
        (NEW_FORM.replace("img00010", "img00007"), r"line 5, column tip x: img00007.png is labelled twice"),
        (
            NEW_FORM.replace("labeled-data,v,img00010.png", ",,"),
            "line 5: expected the name of an image, got ''",
        ),
        (NEW_FORM.replace("v,img00010", "..,img00010"), r"name of an image, got 'labeled-data/\.\./img"),
        (NEW_FORM.replace(",", ";"), r"first rows begin with scorer, bodyparts, coords, got 'scorer;;;Ana"),
        ("", "got an empty file"),
        ("frame,x\n1,2\n", "got 'frame', '1'"),
        (NEW_FORM.replace("bodyparts", "individuals", 1), "multi-animal"),
        (NEW_FORM.replace("coords,,,x,y,x,y", "coords,,,x,y,x"), "header rows of one length"),
    ],
)
def test_a_mistake_in_a_file_says_where_it_is(store: LabelStore, text: str, message: str) -> None:
    put(store, text)
    with pytest.raises(LabelError, match=message) as caught:
        store.read()
    assert "CollectedData_Ana.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_text(store: LabelStore) -> None:
    (store.labels_dir / "v" / "CollectedData_Ana.csv").write_bytes(b"\x89PNG\xff\x00")
    with pytest.raises(LabelError, match="expected a CSV file in UTF-8"):
        store.read()


@pytest.mark.parametrize(
    ("image", "xy", "message"),
    [
        ("img00099.png", np.zeros((2, 2)), "expected an image to label"),
        ("img00007.png", np.zeros((3, 2)), r"expected positions \(2, 2\), got \(3, 2\)"),
        ("img00007.png", np.array([[1, np.nan], [2, 3]]), "x and y, or NaN for both"),
        ("img00007.png", np.array([[1, np.inf], [2, 3]]), "x and y, or NaN for both"),
    ],
)
def test_labels_that_cannot_be_are_not_written(
    store: LabelStore, image: str, xy: np.ndarray, message: str
) -> None:
    path = put(store, NEW_FORM)
    with pytest.raises(LabelError, match=message):
        store.write("v", {"img00010.png": np.zeros((2, 2)), image: xy})
    assert path.read_text() == NEW_FORM


def test_nothing_labelled_yet(tmp_path: Path) -> None:
    project = Project.create(tmp_path / "study", keypoints=("a", "b", "c"))
    store = LabelStore.of(project)
    assert store.read() == []
    assert store.videos() == []
    path = store.add_image("trial 1.5Hz", image_name(42), np.full((4, 6, 3), (255, 0, 0), np.uint8))
    assert path.name == "img00042.png"
    assert cv2.imread(str(path))[0, 0].tolist() == [0, 0, 255]  # red, in OpenCV's order
    assert store.read() == []
    store.write("trial 1.5Hz", {path.name: np.ones((3, 2))})
    assert [(f.video, f.actuator, f.frame) for f in store.read()] == [("trial 1.5Hz", "default", 42)]


# --- crashes ---------------------------------------------------------------------------------------------

WRITER = """
import sys
from pathlib import Path
import numpy as np
from bendtrack.labeling.store import LabelStore
store = LabelStore(Path(sys.argv[1]), ("base", "tip"), "Ana", str)
images = [p.name for p in store.images("v")]
print("ready", flush=True)
value = 1.0
while True:
    store.write("v", {name: np.full((2, 2), value) for name in images})
    value += 1.0
"""


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is a POSIX signal")
def test_a_killed_writer_leaves_the_old_or_the_new_labels(tmp_path: Path) -> None:
    folder = tmp_path / "v"
    folder.mkdir()
    for i in range(300):
        (folder / f"img{i:05d}.png").touch()
    store = LabelStore(tmp_path, ("base", "tip"), "Ana", str)
    store.write("v", {p.name: np.zeros((2, 2)) for p in store.images("v")})
    pause = random.Random(3)
    for _ in range(4):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE)
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"ready\n"
        time.sleep(pause.uniform(0.02, 0.2))
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        writer.stdout.close()
        frames = store.read()
        assert len(frames) == 300
        assert len({float(value) for f in frames for value in f.xy.ravel()}) == 1
    assert store.read()[0].xy[0, 0] > 0
