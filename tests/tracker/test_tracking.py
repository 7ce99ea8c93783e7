"""From encoded video to angle table, with a detector that finds coloured discs."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.bookkeeping import is_up_to_date
from bendtrack.tracker.errors import AngleError, VideoError
from bendtrack.tracker.hashing import file_sha256
from bendtrack.tracker.measuring import measure
from bendtrack.tracker.results import read_results, write_results
from bendtrack.tracker.tracking import track, tracking_settings
from bendtrack.tracker.types import Correlation, Detections, Flag
from bendtrack.tracker.video import video_stem

NAMES = ("base_1", "base_2", "tip_1", "tip_2")
DEFINITION = AngleDefinition("two-vector", NAMES)


def test_angles_of_a_real_video(arm_video, arm_angles_deg, film):
    detector = film.DiscDetector(batch_size=7)
    seen = []
    table = track(arm_video, detector, DEFINITION, progress=lambda done, total: seen.append((done, total)))
    assert np.abs(table.angle_deg - arm_angles_deg).max() < 2.5
    assert np.all(table.flag == "")
    np.testing.assert_allclose(table.time_s, np.arange(60) / 30, atol=1e-4)
    truth = np.array([film.arm_xy(angle) for angle in arm_angles_deg])
    assert np.sqrt(np.mean((table.xy - truth) ** 2)) < 0.5
    assert np.isfinite(table.angle_sd_deg).all()
    assert detector.batches == [7] * 8 + [4]
    assert seen == [(min(7 * n, 60), 60) for n in range(1, 10)]


def test_provenance_tells_where_the_numbers_come_from(arm_video, film):
    table = track(arm_video, film.DiscDetector(), DEFINITION, min_likelihood=0.5)
    video = table.provenance["video"]
    assert video["name"] == "arm.mp4"
    assert video["sha256"] == file_sha256(arm_video)
    assert (video["frames_claimed"], video["frames_decoded"], video["frames_undecodable"]) == (60, 60, 0)
    assert video["size_wh"] == [160, 120]
    assert table.provenance["settings"] == tracking_settings(DEFINITION, 0.5)
    assert table.provenance["detector"] == {"name": "discs"}
    assert table.provenance["rows"]["sound"] == 60
    assert table.provenance["warnings"] == []
    json.dumps(table.provenance, allow_nan=False)


def test_what_a_detector_found_out_is_recorded_and_keeps_results_up_to_date(arm_video, film, tmp_path):
    class Reporting(film.DiscDetector):
        @property
        def findings(self):
            return {"fixed_end": "measured"}

    table = track(arm_video, Reporting(), DEFINITION)
    assert table.provenance["findings"] == {"fixed_end": "measured"}
    assert "findings" not in track(arm_video, film.DiscDetector(), DEFINITION).provenance
    write_results(table, tmp_path, "arm")
    sha = file_sha256(arm_video)
    assert is_up_to_date(tmp_path, "arm", sha, {"name": "discs"}, tracking_settings(DEFINITION))
    assert read_results(tmp_path / "arm.h5").provenance == table.provenance


def test_tracked_table_is_up_to_date_once_written(arm_video, film, tmp_path):
    table = track(arm_video, film.DiscDetector(), DEFINITION)
    write_results(table, tmp_path, "arm")
    sha = file_sha256(arm_video)
    assert is_up_to_date(tmp_path, "arm", sha, {"name": "discs"}, tracking_settings(DEFINITION))
    other = tracking_settings(AngleDefinition("two-vector", NAMES, -1))
    assert not is_up_to_date(tmp_path, "arm", sha, {"name": "discs"}, other)
    assert read_results(tmp_path / "arm.h5").provenance == table.provenance


def test_damaged_video_keeps_every_row(arm_video, arm_angles_deg, film, tmp_path):
    places = film.packet_places(arm_video)
    data = bytearray(arm_video.read_bytes())
    position, size = places[30]
    data[position + 6 : position + size] = bytes(size - 6)
    path = tmp_path / "hole.mp4"
    path.write_bytes(data)
    table = track(path, film.DiscDetector(), DEFINITION)
    assert len(table) == 60
    lost = np.flatnonzero(table.flag == "undecodable")
    assert len(lost) == 1
    assert np.isnan(table.angle_deg[lost]).all()
    assert np.isnan(table.xy[lost]).all()
    assert np.isfinite(table.time_s).all()
    damaged = table.flag == "damaged"
    assert 1 <= damaged.sum() < 20
    assert np.isfinite(table.angle_deg[damaged]).all()
    sound = table.flag == ""
    assert np.abs(table.angle_deg[sound] - arm_angles_deg[sound]).max() < 2.5
    assert table.provenance["video"]["frames_undecodable"] == 1
    assert not table.provenance["video"]["complete"]
    assert "could not be decoded" in table.provenance["warnings"][0]


class Script:
    """A detector that answers by frame number from a list, whatever the image."""

    keypoints = NAMES
    batch_size = 3

    def __init__(self, xy: np.ndarray, likelihood: np.ndarray) -> None:
        self.provenance: dict[str, str] = {}
        self._xy, self._likelihood, self._next = xy, likelihood, 0

    def detect(self, frames: np.ndarray) -> Detections:
        rows = slice(self._next, self._next + len(frames))
        self._next += len(frames)
        xy = self._xy[rows]
        return Detections(xy, self._likelihood[rows], np.ones((*xy.shape, 2)) * np.eye(2))


def test_flags_say_why(arm_video, film):
    xy = np.tile(film.arm_xy(40), (60, 1, 1))
    likelihood = np.ones((60, 4))
    likelihood[5, 2] = 0.3  # doubtful
    xy[6, 3] = xy[6, 2]  # no direction
    xy[7, 3] = (159.6, 50)  # beyond the outer edge of the last pixel
    xy[8, 3] = (159.4, 50)  # still in it
    xy[9, 0] = np.nan  # not found, though the detector is sure
    xy[10, 3], likelihood[10] = (-3, 50), 0.1  # two reasons: the graver one
    table = track(arm_video, Script(xy, likelihood), DEFINITION)
    expected = {
        5: "low_likelihood",
        6: "coincident_points",
        7: "out_of_frame",
        8: "",
        9: "low_likelihood",
        10: "out_of_frame",
    }
    assert {row: str(table.flag[row]) for row in expected} == expected
    assert list(np.flatnonzero(np.isnan(table.angle_deg))) == [6, 7, 9, 10]
    assert np.isfinite(table.angle_deg[5])
    assert table.xy[7, 3, 0] == 159.6
    assert np.sum(table.flag != "") == 5


def test_an_angle_that_its_neighbours_contradict_is_flagged_where_it_is_asked_for():
    angle = np.concatenate([np.linspace(0, 90, 10), np.linspace(90, 0, 10)])  # 10 degrees a frame, and back
    angle[[4, 13]] += 40
    angle[17] = np.nan
    xy = np.zeros((20, 4, 2))
    turn = np.radians(angle)
    xy[:, 1], xy[:, 2] = (50, 0), (100, 0)
    xy[:, 3] = xy[:, 2] + 50 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    found = Detections(xy, np.ones((20, 4)), np.tile(4.0 * np.eye(2), (20, 4, 1, 1)))  # sd 4.6 degrees
    kept = {"decoded": ~np.isnan(angle), "damaged": np.zeros(20, bool)}

    def flagged(check_jumps: bool) -> list[int]:
        rows = measure(found, NAMES, DEFINITION, (200, 200), check_jumps=check_jumps, **kept)
        return np.flatnonzero(rows.flag == Flag.JUMP).tolist()

    assert flagged(check_jumps=True) == [4, 13]
    assert flagged(check_jumps=False) == []


def test_keypoints_outside_the_angle_do_not_flag(arm_video, film):
    xy = np.tile(film.arm_xy(40), (60, 1, 1))
    xy[:, 2] = (-50, -50)
    likelihood = np.ones((60, 4))
    likelihood[:, 2] = 0
    definition = AngleDefinition("three-point", ("base_1", "base_2", "tip_2"))
    assert np.all(track(arm_video, Script(xy, likelihood), definition).flag == "")


def test_wrong_keypoint_and_wrong_video_are_one_line(arm_video, film, tmp_path):
    with pytest.raises(AngleError, match="needs keypoint 'middle', the detector finds base_1"):
        track(arm_video, film.DiscDetector(), AngleDefinition("three-point", ("base_1", "middle", "tip_1")))
    with pytest.raises(VideoError, match="no such file"):
        track(tmp_path / "none.mp4", film.DiscDetector(), DEFINITION)


def test_a_name_that_is_no_text_does_not_stop_anything(arm_video, film, tmp_path):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/gr\xf6\xdfe.mp4"))
    try:
        path.write_bytes(arm_video.read_bytes())
    except OSError:
        pytest.skip("this file system takes only UTF-8")
    table = track(path, film.DiscDetector(), DEFINITION)
    csv_path, _, json_path = write_results(table, tmp_path / "results", video_stem(path))
    assert csv_path.stem == path.stem
    assert read_results(json_path).provenance["video"]["name"] == "gr\ufffd\ufffde.mp4"


def test_failing_detector_stops_decoding_at_once(arm_video, film):
    class Failing(film.DiscDetector):
        def detect(self, frames: np.ndarray) -> Detections:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track(arm_video, Failing(), DEFINITION)
    assert not [thread for thread in threading.enumerate() if thread.name == "bendtrack-read-ahead"]


KILLED = """
import sys
from pathlib import Path
import numpy as np
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.results import write_results
from bendtrack.tracker.tracking import track
from bendtrack.tracker.types import Correlation, Detections, Flag

class Detector:
    keypoints = ("base_1", "base_2", "tip_1", "tip_2")
    batch_size = 8
    provenance = {"name": sys.argv[3]}
    def detect(self, frames):
        xy = np.tile([[10.0, 50], [40, 50], [70, 60], [90, 80]], (len(frames), 1, 1))
        return Detections(xy, np.ones((len(frames), 4)), np.zeros((len(frames), 4, 2, 2)))

definition = AngleDefinition("two-vector", Detector.keypoints)
write_results(track(sys.argv[1], Detector(), definition), sys.argv[2], "arm")
print("first", flush=True)
for _ in range(1000):
    write_results(track(sys.argv[1], Detector(), definition), sys.argv[2], "arm")
"""


def test_killed_run_leaves_no_half_file(arm_video, tmp_path):
    """SIGKILL at random moments of tracking and writing, again and again in one folder."""
    moments = random.Random(0)
    results = tmp_path / "results"
    sha = file_sha256(arm_video)
    for run in range(3):
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(arm_video), str(results), f"v{run}"], stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        assert process.stdout.readline() == b"first\n"
        time.sleep(moments.uniform(0, 0.3))
        process.send_signal(signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
        process.wait()
        process.stdout.close()
        shown = sorted(path.name for path in Path(results).iterdir() if not path.name.startswith("."))
        assert shown == ["arm.csv", "arm.h5", "arm.json"]
        tables = [read_results(results / name) for name in shown]
        assert all(len(table) == 60 for table in tables)
        assert tables[1].provenance["detector"] == {"name": f"v{run}"}
        # Every state that passes as current is consistent, and no older detector's does.
        assert not is_up_to_date(results, "arm", sha, {"name": "other"}, tracking_settings(DEFINITION))


def test_memory_does_not_grow_with_the_video(film, short_and_long_video):
    code = KILLED.split("definition =")[0] + (
        "definition = AngleDefinition('two-vector', Detector.keypoints)\n"
        "print(len(track(sys.argv[1], Detector(), definition)))"
    )
    short, long = film.peak_memory(code, short_and_long_video, "", "")
    assert long < 1.1 * short


def test_the_two_parts_of_the_uncertainty_are_recorded(arm_video, film) -> None:
    """What the labels leave is one offset of the film; the rest scatters. Together they are the table's."""

    class Trained(film.DiscDetector):
        correlations = (Correlation("tip_1", "tip_2", 0.9),)
        label_variance_px2 = 0.01

    alone, trained = (
        track(arm_video, film.DiscDetector(), DEFINITION),
        track(arm_video, Trained(), DEFINITION),
    )
    assert alone.provenance["uncertainty"] is None
    parts = trained.provenance["uncertainty"]
    total = np.hypot(parts["offset_sd_deg"], parts["scatter_sd_deg"])
    assert total == pytest.approx(np.nanmedian(trained.angle_sd_deg), rel=0.02)
    tips = [DEFINITION.points.index(name) for name in ("tip_1", "tip_2")]
    length = np.median(np.linalg.norm(np.diff(trained.xy[:, tips], axis=1), axis=2))
    bases = np.median(np.linalg.norm(trained.xy[:, 1] - trained.xy[:, 0], axis=1))
    offset = np.degrees(np.sqrt(2 * 0.01) * np.hypot(1 / length, 1 / bases))
    assert parts["offset_sd_deg"] == pytest.approx(offset, rel=0.02)
    # Errors that the two points of an end share do not turn it.
    assert np.nanmedian(trained.angle_sd_deg) < np.nanmedian(alone.angle_sd_deg)


def test_likelihoods_are_calibrated_for_the_film_and_the_results_say_how(arm_video, film) -> None:
    class Dim(film.DiscDetector):
        def detect(self, frames):
            found = super().detect(frames)
            return replace(found, likelihood=0.5 * found.likelihood)

    class Calibrated(Dim):
        def film_calibrated(self, found):
            return replace(found, likelihood=2 * found.likelihood), {"peak_share": 0.5}

    assert set(track(arm_video, Dim(), DEFINITION).flag) == {"low_likelihood"}
    table = track(arm_video, Calibrated(), DEFINITION)
    assert set(table.flag) == {""}
    assert table.provenance["findings"] == {"peak_share": 0.5}
    assert table.likelihood.max() == 1.0
