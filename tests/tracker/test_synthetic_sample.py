"""The shipped sample is what its README says and what the renderer would make again from its settings."""

import csv
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from bendtrack.tracker.synthetic.response import HystereticResponse, triangle_kpa
from bendtrack.tracker.synthetic.stream import Renderer
from bendtrack.tracker.synthetic.stream.chain import ENDS, Chain
from bendtrack.tracker.synthetic.trial import labelled_sample, read_trial
from bendtrack.tracker.synthetic.trial_looks import trial_look
from bendtrack.tracker.video import Video

SAMPLE = Path(__file__).parents[2] / "data_samples"
SEED = 1892


@pytest.fixture(scope="module")
def trial():
    return read_trial(SAMPLE)


def test_truth_follows_from_the_settings(trial):
    response = HystereticResponse(50.0, 0.0, 200.0, trial.hysteresis_ratio)
    np.testing.assert_allclose(response.angle_deg(trial.pressure_kpa), trial.angle_deg, atol=0.01)
    body = trial.look.body
    for index in (0, 55, 100, 300, 600):
        chain = Chain(body, trial.look.place, trial.angle_deg[index])
        xy = chain.point(chain.keypoint_s[ENDS])
        np.testing.assert_allclose(xy, trial.xy[index], atol=1e-3)


def test_the_readme_names_the_command_that_made_it(trial):
    """Rendering all of it again would take half a minute; its settings, look, log and a frame tell as much."""
    command = re.search(r"^    bendtrack render .*$", (SAMPLE / "README.md").read_text(), re.MULTILINE)
    assert command is not None
    _, _, folder, *options = shlex.split(command[0])
    given = {
        name[2:].replace("-", "_"): float(value)
        for name, value in zip(options[::2], options[1::2], strict=True)
    }
    settings = json.loads(trial.settings_path.read_text())
    end_vector_px, labels = given.pop("end_vector_px"), given.pop("labels")
    assert (folder + ".mp4", labels) == (trial.video_path.name, 30)
    assert {name: settings[name] for name in given} == given
    assert trial.look == trial_look(SEED, end_vector_px=end_vector_px, angle_range_deg=(-20.0, 220.0))

    log = np.loadtxt(trial.pressure_path, delimiter=",", skiprows=1)
    noise_kpa = settings["pressure_noise_kpa"] * np.random.default_rng([SEED, 12]).standard_normal(len(log))
    np.testing.assert_allclose(log[:, 1], triangle_kpa(log[:, 0], 50.0, 0.15) + noise_kpa, atol=6e-4)
    with Video(trial.video_path) as video:
        shown = next(frame.image for frame in video if frame.index == 30)
    drawn = Renderer(trial.look).frame(trial.angle_deg[30], trial.pressure_kpa[30] / 50.0).image
    assert np.abs(shown.astype(float) - drawn).mean() < 4


def test_video_has_a_frame_for_every_row(trial):
    with Video(trial.video_path) as video:
        assert video.size_wh == trial.look.size_wh
        assert sum(frame.image is not None for frame in video) == len(trial.time_s)


def test_labels_are_the_ones_the_readme_makes(trial):
    with (SAMPLE / "labels.csv").open(newline="") as file:
        rows = list(csv.reader(file))[3:]
    frames, xy = labelled_sample(trial, count=30, noise_px=1.0, seed=SEED)
    assert [row[2] for row in rows] == [f"img{frame:05d}.png" for frame in frames]
    written = np.array([row[3:] for row in rows], float).reshape(30, 4, 2)
    np.testing.assert_allclose(written, xy, atol=1e-3)


def test_it_is_small():
    assert sum(path.stat().st_size for path in SAMPLE.iterdir() if path.is_file()) < 4e6
