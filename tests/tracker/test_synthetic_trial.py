import csv
import dataclasses
import inspect
import json

import numpy as np
import pytest

from bendtrack.tracker.cli.render_command import render
from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.synthetic.stream import TRAINING, Renderer
from bendtrack.tracker.synthetic.trial import labelled_sample, read_trial, render_trial, write_labels
from bendtrack.tracker.synthetic.trial_looks import trial_look
from bendtrack.tracker.video import Video

SMALL = {"size_wh": (320, 240), "end_vector_px": 25.0}


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    return render_trial(
        tmp_path_factory.mktemp("trial") / "rig, 2 Hz",
        seed=2,
        frequency_hz=0.5,
        cycles=2,
        pressure_peak_kpa=45.0,
        angle_min_deg=-5.0,
        angle_max_deg=200.0,
        hysteresis_ratio=0.2,
        **SMALL,
    )


def table(path):
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    return rows[0], np.array(rows[1:], float)


def test_files_agree_with_each_other(trial):
    header, truth = table(trial.truth_path)
    points = [f"{keypoint}_{axis}" for keypoint in trial.keypoints for axis in "xy"]
    assert header == ["frame", "time_s", "pressure_kpa", "angle_deg", *points]
    assert len(truth) == 4 * 30 + 1 == len(trial.time_s)
    with Video(trial.video_path) as video:
        assert video.size_wh == (320, 240)
        times = [frame.time_s for frame in video]
    np.testing.assert_allclose(times, truth[:, 1], atol=2e-5)
    np.testing.assert_allclose(truth[:, 3], trial.angle_deg, atol=1e-4)
    np.testing.assert_allclose(truth[:, 4:], trial.xy.reshape(len(truth), -1), atol=1e-3)
    header, log = table(trial.pressure_path)
    assert header == ["time_s", "pressure_kpa"]
    np.testing.assert_allclose(np.diff(log[:, 0]), 1 / 400, atol=1e-6)
    at_frames = np.interp(truth[:, 1], log[:, 0], log[:, 1])
    assert np.std(at_frames - truth[:, 2]) < 0.1
    settings = json.loads(trial.settings_path.read_text())
    assert settings["seed"] == 2
    assert settings["hysteresis_ratio"] == 0.2
    assert settings["frames"] == len(truth)
    assert sorted(path.name for path in trial.folder.iterdir()) == [
        "pressure.csv", "rig, 2 Hz.mp4", "trial.json", "truth.csv",
    ]  # fmt: skip


def test_angles_of_the_points_are_the_angles_of_the_table(trial):
    """Turn from base to tip vector, followed through time so that it goes past 180 degrees."""
    base, tip = trial.xy[:, 1] - trial.xy[:, 0], trial.xy[:, 3] - trial.xy[:, 2]
    turn = np.arctan2(
        base[:, 0] * tip[:, 1] - base[:, 1] * tip[:, 0], (base * tip).sum(axis=1)
    ) * trial.look.place.side  # fmt: skip
    np.testing.assert_allclose(np.degrees(np.unwrap(turn)), trial.angle_deg, atol=1e-6)
    assert trial.angle_deg.max() > 190


def test_ratio_can_be_measured_from_the_frames(trial):
    p, a = trial.pressure_kpa[:60], trial.angle_deg[:60]
    area = 0.5 * abs(np.dot(p, np.roll(a, -1)) - np.dot(a, np.roll(p, -1)))
    assert area / (p.max() * a.max()) == pytest.approx(0.2, abs=2e-3)


def test_video_shows_the_truth(trial):
    """The decoded frames are the pictures of the truth: nearer to their own than to their neighbours'."""
    renderer = Renderer(trial.look)
    with Video(trial.video_path) as video:
        frames = {frame.index: frame.image.astype(float) for frame in video if frame.index in (10, 14)}

    def image(index):
        return renderer.frame(trial.angle_deg[index], trial.pressure_kpa[index] / 45.0).image.astype(float)

    for index in (10, 14):
        distances = [np.abs(frames[index] - image(other)).mean() for other in (index - 1, index, index + 1)]
        assert np.argmin(distances) == 1
        assert distances[1] < 8


def test_read_back(trial):
    again = read_trial(trial.folder)
    assert again.video_path == trial.video_path
    assert again.look == trial.look
    assert again.keypoints == trial.keypoints
    assert again.hysteresis_ratio == trial.hysteresis_ratio
    np.testing.assert_allclose(again.angle_deg, trial.angle_deg, atol=1e-4)
    np.testing.assert_allclose(again.xy, trial.xy, atol=1e-3)
    with pytest.raises(BendtrackError, match="expected a rendered trial"):
        read_trial(trial.folder / "nowhere")


def test_labels_cover_the_angles_with_the_noise_asked_for(trial):
    frames, xy = labelled_sample(trial, count=30, noise_px=1.0, seed=3)
    assert len(np.unique(frames)) == 30
    angles = np.sort(trial.angle_deg[frames])
    assert angles[0] < trial.angle_deg.min() + 10
    assert angles[-1] > trial.angle_deg.max() - 10
    # Frames lie where the wave put them: the widest gap is a fast part of a fast wave.
    assert np.diff(angles).max() < 25
    noise = xy - trial.xy[frames]
    assert noise.std() == pytest.approx(1.0, rel=0.15)
    assert abs(noise.mean()) < 0.2
    again, xy_again = labelled_sample(trial, count=30, noise_px=1.0, seed=3)
    np.testing.assert_array_equal(frames, again)
    np.testing.assert_array_equal(xy, xy_again)
    assert (labelled_sample(trial, count=30, seed=4)[1] != xy).any()
    np.testing.assert_array_equal(
        labelled_sample(trial, 5, noise_px=0.0)[1], trial.xy[labelled_sample(trial, 5)[0]]
    )
    with pytest.raises(BendtrackError, match="frames to label"):
        labelled_sample(trial, count=1000)


def test_labels_on_disk(trial, tmp_path):
    frames, xy = labelled_sample(trial, count=4)
    write_labels(trial, tmp_path / "labels.csv", frames, xy)
    with (tmp_path / "labels.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[1][3:] == ["base_1", "base_1", "base_2", "base_2", "tip_1", "tip_1", "tip_2", "tip_2"]
    assert rows[3][:3] == ["labeled-data", "rig, 2 Hz", f"img{frames[0]:05d}.png"]
    np.testing.assert_allclose(np.array([row[3:] for row in rows[3:]], float).reshape(4, 4, 2), xy, atol=1e-4)


def test_staircase_holds_its_levels(tmp_path):
    trial = render_trial(
        tmp_path,
        seed=5,
        wave="staircase",
        pressure_peak_kpa=20.0,
        step_kpa=10.0,
        hold_s=0.5,
        frame_rate=20.0,
        **SMALL,
    )
    levels, counts = np.unique(trial.pressure_kpa.round(6), return_counts=True)
    assert levels[counts > 5].tolist() == [0.0, 10.0, 20.0]
    held = trial.angle_deg[trial.pressure_kpa == 10.0]
    assert np.ptp(held) < 1e-9
    assert (np.diff(trial.angle_deg) >= 0).all()


def test_the_same_seed_makes_the_same_trial(tmp_path):
    short = {"seed": 7, "frequency_hz": 2.0, "cycles": 1, "frame_rate": 10.0, **SMALL}
    first, again = (
        render_trial(tmp_path / "a" / "same", **short),
        render_trial(tmp_path / "b" / "same", **short),
    )
    for name in ("truth.csv", "pressure.csv", "trial.json", "same.mp4"):
        assert (first.folder / name).read_bytes() == (again.folder / name).read_bytes()
    other = render_trial(tmp_path / "c", **{**short, "seed": 8})
    assert other.look != first.look


def test_the_video_is_named_after_its_folder(tmp_path, monkeypatch):
    short = {"seed": 6, "frequency_hz": 5.0, "cycles": 1, "frame_rate": 10.0, **SMALL}
    (tmp_path / ".trial 1.5 Hz").mkdir()
    monkeypatch.chdir(tmp_path / ".trial 1.5 Hz")
    trial = render_trial(".", **short)
    assert trial.video_path.is_file()
    assert trial.video_path.name == "trial 1.5 Hz.mp4"  # a dot in front would hide it
    moved = (tmp_path / ".trial 1.5 Hz").rename(tmp_path / "elsewhere")
    assert read_trial(moved).video_path == moved / "trial 1.5 Hz.mp4"


def test_wrong_settings_leave_nothing_behind(tmp_path):
    for wrong, message in (
        ({"wave": "sine"}, "triangle, staircase"),
        ({"frequency_hz": 0.0}, "frequency above 0"),
        ({"hysteresis_ratio": 0.9}, "hysteresis ratio"),
    ):
        with pytest.raises(BendtrackError, match=message):
            render_trial(tmp_path / "out", seed=1, **wrong)
    assert not (tmp_path / "out").exists()


def test_a_look_can_be_given(tmp_path):
    families = dataclasses.replace(TRAINING, backgrounds=("squared paper",))
    look = trial_look(11, families=families, **SMALL)
    trial = render_trial(tmp_path, seed=0, look=look, frequency_hz=5.0, cycles=1)
    assert trial.look == look


def test_the_words_of_a_look_can_be_chosen(tmp_path):
    families = dataclasses.replace(TRAINING, materials=("dark rubber",), shapes=("bellows",))
    trial = render_trial(tmp_path, seed=4, families=families, frequency_hz=5.0, cycles=1, **SMALL)
    assert (trial.look.words.material, trial.look.words.shape) == ("dark rubber", "bellows")


def test_the_command_has_the_defaults_of_the_function():
    drawn = inspect.signature(render_trial).parameters
    asked = inspect.signature(render).parameters
    for name in asked.keys() & drawn.keys() - {"seed"}:
        assert asked[name].default == drawn[name].default, name
    width, height = drawn["size_wh"].default
    assert asked["size"].default == f"{width}x{height}"
    assert asked["noise_px"].default == inspect.signature(labelled_sample).parameters["noise_px"].default
