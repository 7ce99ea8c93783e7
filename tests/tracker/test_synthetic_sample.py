"""The shipped sample is what its README says and what the renderer would make again from its settings."""

import csv
from pathlib import Path

import numpy as np
import pytest

from bendtrack.tracker.synthetic.geometry import Midline
from bendtrack.tracker.synthetic.response import HystereticResponse
from bendtrack.tracker.synthetic.trial import labelled_sample, read_trial
from bendtrack.tracker.video import Video

SAMPLE = Path(__file__).parents[2] / "data_samples"


@pytest.fixture(scope="module")
def trial():
    return read_trial(SAMPLE)


def test_truth_follows_from_the_settings(trial):
    response = HystereticResponse(50.0, 0.0, 200.0, trial.hysteresis_ratio)
    np.testing.assert_allclose(response.angle_deg(trial.pressure_kpa), trial.angle_deg, atol=0.01)
    body = trial.look.body
    for index in (0, 55, 100, 300, 600):
        line = Midline(body, trial.look.pose, trial.angle_deg[index])
        xy = line.point(np.array(body.keypoint_s), body.keypoint_t)
        np.testing.assert_allclose(xy, trial.xy[index], atol=1e-3)


def test_video_has_a_frame_for_every_row(trial):
    with Video(trial.video_path) as video:
        assert video.size_wh == trial.look.size_wh
        assert sum(frame.image is not None for frame in video) == len(trial.time_s)


def test_labels_are_the_ones_the_readme_makes(trial):
    with (SAMPLE / "labels.csv").open(newline="") as file:
        rows = list(csv.reader(file))[3:]
    frames, xy = labelled_sample(trial, count=30, noise_px=1.0, seed=386)
    assert [row[2] for row in rows] == [f"img{frame:05d}.png" for frame in frames]
    written = np.array([row[3:] for row in rows], float).reshape(30, 4, 2)
    np.testing.assert_allclose(written, xy, atol=1e-3)


def test_it_is_small():
    assert sum(path.stat().st_size for path in SAMPLE.iterdir() if path.is_file()) < 4e6
