"""Angle tables on disk: exact, atomic, known by content."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import h5py
import numpy as np
import pandas as pd
import pytest

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.bookkeeping import choose_stem, is_up_to_date
from bendtrack.tracker.errors import ResultsError
from bendtrack.tracker.results import AngleTable, read_results, write_results
from bendtrack.tracker.types import Flag

SETTINGS = {"angle": {"name": "two-vector"}, "min_likelihood": 0.6}
DETECTOR = {"checkpoint_sha256": "c0ffee", "engine": "torch"}
NAMES = ("base_1", "base_2", "tip_1", "tip_2")


def make_table(n: int = 50, seed: int = 0, video_sha256: str = "ab" * 32) -> AngleTable:
    random = np.random.default_rng(seed)
    flag = np.array([Flag.NONE] * n, dtype=object)
    flag[3], flag[7], flag[9] = Flag.UNDECODABLE, Flag.LOW_LIKELIHOOD, Flag.OUT_OF_FRAME
    table = AngleTable(
        time_s=np.arange(n) / 29.97,
        angle_deg=random.normal(60, 80, n),
        angle_sd_deg=random.uniform(0.1, 1, n),
        flag=flag,
        xy=random.uniform(0, 640, (n, 4, 2)),
        likelihood=random.uniform(0, 1, (n, 4)),
        covariance=random.normal(0, 1, (n, 4, 2, 2)),
        keypoints=NAMES,
        definition=AngleDefinition("two-vector", NAMES, -1),
        provenance={
            "bendtrack": "0.1.0",
            "video": {"name": "Versuch 1 größer.mp4", "sha256": video_sha256},
            "detector": DETECTOR,
            "settings": SETTINGS,
            "warnings": ["x" * 100_000],  # longer than an HDF5 attribute may be
        },
    )
    for values in (table.angle_deg, table.angle_sd_deg, table.xy, table.likelihood, table.covariance):
        values[3] = np.nan
    return table


def assert_equal_tables(a: AngleTable, b: AngleTable) -> None:
    for name in ("time_s", "angle_deg", "angle_sd_deg", "flag", "xy", "likelihood", "covariance"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert (a.keypoints, a.definition, a.provenance) == (b.keypoints, b.definition, b.provenance)


def test_hdf5_round_trip_is_exact(tmp_path):
    table = make_table()
    _, h5_path, json_path = write_results(table, tmp_path, "trial")
    assert_equal_tables(read_results(h5_path), table)
    assert_equal_tables(read_results(json_path), table)
    with h5py.File(h5_path) as file:
        assert file["angle_deg"].attrs["units"] == "degree"
        assert file["xy"].attrs["units"] == "px"
        assert file["covariance"].attrs["units"] == "px^2"


def test_csv_is_the_table_users_open(tmp_path):
    table = make_table()
    csv_path, h5_path, _ = write_results(table, tmp_path, "trial")
    lines = csv_path.read_text().splitlines()
    assert lines[0] == "frame,time_s,angle_deg,angle_sd_deg,flag," + ",".join(
        f"{name}_{part}" for name in NAMES for part in ("x", "y", "likelihood")
    )
    assert len(lines) == 51
    assert lines[4] == "3,0.100100,,,undecodable" + 12 * ","
    assert lines[8].split(",")[4] == "low_likelihood"
    found = read_results(csv_path)
    np.testing.assert_allclose(found.time_s, table.time_s, atol=0.5e-6)
    np.testing.assert_allclose(found.angle_deg, table.angle_deg, atol=0.5e-3)
    np.testing.assert_allclose(found.angle_sd_deg, table.angle_sd_deg, atol=0.5e-3)
    np.testing.assert_allclose(found.xy, table.xy, atol=0.5e-3 + 1e-9)
    np.testing.assert_array_equal(found.flag, table.flag)
    assert np.isnan(found.covariance).all()
    assert found.definition == table.definition  # from the JSON that belongs to it
    h5_path.unlink()
    assert read_results(csv_path.with_suffix(".json")).definition == table.definition


def test_csv_alone_and_csv_changed_by_hand(tmp_path):
    """Without its JSON, or with one that describes another CSV, only what the CSV says is known."""
    csv_path, _, json_path = write_results(make_table(), tmp_path, "trial")
    csv_path.write_text(csv_path.read_text().replace("low_likelihood", ""))
    found = read_results(csv_path)
    assert found.definition is None
    assert found.provenance == {}
    assert found.flag[7] == ""
    json_path.unlink()
    assert read_results(csv_path).keypoints == NAMES


def test_dataframe_has_the_csv_columns(tmp_path):
    table = make_table()
    csv_path, _, _ = write_results(table, tmp_path, "trial")
    frame = table.to_dataframe()
    assert list(frame.columns) == list(pd.read_csv(csv_path).columns)
    assert len(frame) == len(table)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", "", "cannot be read as a CSV"),
        ("a.csv", "scorer,x\nbodyparts,y\n", "expected columns frame,time_s"),
        ("a.csv", "frame,time_s,angle_deg,angle_sd_deg,flag,p_x,p_y\n", "expected columns"),
        ("a.csv", "frame,time_s,angle_deg,angle_sd_deg,flag\n0,0,1,1,\n2,1,1,1,\n", "in order"),
        ("a.csv", "frame,time_s,angle_deg,angle_sd_deg,flag\n0,0,one,1,\n", "expected numbers"),
        ("a.h5", "no hdf5", "cannot be read as bendtrack's HDF5"),
        ("a.json", "{", "cannot be read as JSON"),
        ("a.json", "[1]", "got other JSON"),
        ("a.json", '{"bendtrack": "1"}', "found neither"),
        ("a.txt", "", r"got '\.txt'"),
    ],
)
def test_malformed_files_are_refused_in_one_line(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(ResultsError, match=message) as caught:
        read_results(path)
    assert "\n" not in str(caught.value)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(ResultsError, match="no such results file"):
        read_results(tmp_path / "a.h5")


def test_unwritable_folder_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="results cannot be written"):
        write_results(make_table(), tmp_path / "file" / "results", "trial")


def test_table_refuses_arrays_that_do_not_fit():
    with pytest.raises(ValueError, match=r"expected xy \(50, 4, 2\), got \(50, 3, 2\)"):
        replace(make_table(), xy=np.zeros((50, 3, 2)))


def test_up_to_date_by_hashes_and_settings_not_by_existence(tmp_path):
    video = "ab" * 32

    def current(**changes) -> bool:
        asked = {"video_sha256": video, "detector_provenance": DETECTOR, "settings": SETTINGS} | changes
        return is_up_to_date(tmp_path, "trial", **asked)

    assert not current()
    paths = write_results(make_table(), tmp_path, "trial")
    assert current()
    assert current(settings={**SETTINGS, "angle": {"name": "two-vector"}})
    assert not current(video_sha256="cd" * 32)
    assert not current(detector_provenance={**DETECTOR, "checkpoint_sha256": "beef"})
    assert not current(settings={**SETTINGS, "min_likelihood": 0.5})
    for path in paths:
        content = path.read_bytes()
        path.unlink()
        assert not current()
        path.write_bytes(content[: len(content) // 2])
        assert not current()
        path.write_bytes(content)
        assert current()
    record = json.loads(paths[2].read_text())
    paths[2].write_text(json.dumps({**record, "format": 0}))
    assert not current()


def test_interrupted_rewrite_counts_as_stale(tmp_path, monkeypatch):
    """New HDF5 and CSV next to the old JSON, as a kill between them leaves it."""
    write_results(make_table(seed=0), tmp_path, "trial")
    real_replace = os.replace

    def stop_before_json(source, target):
        if str(target).endswith(".json"):
            raise OSError(28, "No space left on device")
        real_replace(source, target)

    monkeypatch.setattr(os, "replace", stop_before_json)
    with pytest.raises(ResultsError, match="No space left"):
        write_results(make_table(seed=1), tmp_path, "trial")
    assert not is_up_to_date(tmp_path, "trial", "ab" * 32, DETECTOR, SETTINGS)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["trial.csv", "trial.h5", "trial.json"]


def test_videos_of_one_stem_never_share_files(tmp_path):
    first, second = "ab" * 32, "cd" * 32
    assert choose_stem(tmp_path, "monday/trial.mp4", first) == ("trial", None)
    write_results(make_table(video_sha256=first), tmp_path, "trial")
    assert choose_stem(tmp_path, "monday/trial.mp4", first) == ("trial", None)
    chosen = choose_stem(tmp_path, "tuesday/trial.mp4", second)
    assert chosen.stem == "trial-cdcdcdcd"
    assert "'trial' belong to another video" in chosen.note
    write_results(make_table(video_sha256=second), tmp_path, chosen.stem)
    assert choose_stem(tmp_path, "tuesday/trial.mp4", second).stem == chosen.stem
    assert choose_stem(tmp_path, "monday/trial.mp4", first).stem == "trial"


def test_after_a_kill_the_owner_is_still_known(tmp_path):
    """Killed before the JSON: the HDF5 says whose it is. Files of unknown origin belong to somebody else."""
    sha = "ab" * 32
    _, _, json_path = write_results(make_table(video_sha256=sha), tmp_path, "trial")
    json_path.unlink()
    assert choose_stem(tmp_path, "trial.mp4", sha).stem == "trial"
    assert choose_stem(tmp_path, "trial.avi", "cd" * 32).stem == "trial-cdcdcdcd"
    (tmp_path / "mine.csv").write_text("my own notes")
    assert choose_stem(tmp_path, "mine.mp4", sha).stem == "mine-abababab"
