"""Label propagation: one labelled frame of a rendered actuator, whose truth is known in all frames."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bendtrack.models.adaptation import propagated_frames as own
from bendtrack.models.adaptation.propagation import propagate_labels
from bendtrack.models.networks.checkpoint import load_checkpoint
from bendtrack.models.networks.shipped import shipped_network
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.split import split
from bendtrack.models.training.transfer import keypoint_mapping
from bendtrack.tracker.angle import AngleDefinition, bending_angle
from bendtrack.tracker.synthetic.stream import KEYPOINTS
from bendtrack.tracker.types import LabelledFrame
from bendtrack.tracker.video_writer import VideoWriter

NAMES = ("root", "neck", "wrist", "nail")  # not the network's own
ENDS = [KEYPOINTS.index(name) for name in ("base_1", "base_2", "tip_1", "tip_2")]
DEFINITION = AngleDefinition("two-vector", NAMES)
FRAMES, LABELLED = 16, 7


@pytest.fixture(scope="module")
def film(render_film):
    found = render_film(FRAMES)
    return found.images, found.keypoints_xy[:, ENDS]


@pytest.fixture(scope="module")
def propagate(film):
    """Propagate labels (1, 4, 2) px of one frame to all frames."""
    images, _ = film
    source = load_checkpoint(shipped_network("resnet18"))
    estimator = source.network.estimator(source.candidates)

    def propagated(xy: np.ndarray, names: tuple[str, ...] = NAMES):
        mapping = keypoint_mapping(names, source.keypoints)
        labelled = images[LABELLED : LABELLED + 1]
        return propagate_labels(source, estimator, mapping, names, labelled, xy, images)

    return propagated


@pytest.fixture(scope="module")
def plain(film, propagate):
    """From one exact label."""
    return propagate(film[1][LABELLED : LABELLED + 1])


def angles_deg(xy: np.ndarray) -> np.ndarray:
    return bending_angle(xy, NAMES, DEFINITION)[0]


def test_one_labelled_frame_measures_the_others(film, plain) -> None:
    (_, truth), found = film, plain
    assert found.sure.mean() > 0.9
    error = (angles_deg(found.xy) - angles_deg(truth))[found.sure]
    assert np.sqrt((error**2).mean()) < 2
    assert np.isnan(found.xy[~found.sure]).all()
    # The fixed end is where it was labelled, in every frame.
    np.testing.assert_allclose(found.xy[found.sure][:, 0], truth[found.sure][:, 0], atol=1.5)


def test_points_lie_where_they_were_clicked_on_the_end(film, plain, propagate) -> None:
    """Someone who takes other points of the tip than the network does gets these."""
    _, truth = film
    label = truth[LABELLED : LABELLED + 1].copy()
    along = label[:, 3] - label[:, 2]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    label[:, 2:] += 0.3 * across[:, None] + 0.2 * along[:, None]
    found = propagate(label)
    tips = plain.xy[plain.sure][:, 2:]
    direction = tips[:, 1] - tips[:, 0]
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    expected = tips + 0.3 * normal[:, None] + 0.2 * direction[:, None]
    moved_px = np.linalg.norm(expected - tips, axis=2).min()
    np.testing.assert_allclose(found.xy[plain.sure][:, 2:], expected, atol=moved_px / 8)


def test_a_click_that_is_off_turns_the_tip_by_less_than_it_says(film, plain, propagate) -> None:
    _, truth = film
    label = truth[LABELLED : LABELLED + 1].copy()
    along = label[0, 3] - label[0, 2]
    label[0, 3] += np.tan(np.radians(5)) * np.array([-along[1], along[0]])
    turned = angles_deg(propagate(label).xy) - angles_deg(plain.xy)
    assert 0.5 < np.nanmedian(np.abs(turned)) < 4.5


def test_without_both_ends_nothing_is_propagated(film, propagate) -> None:
    _, truth = film
    label = truth[LABELLED : LABELLED + 1].copy()
    label[0, 1] = np.nan
    assert propagate(label) is None
    assert propagate(truth[LABELLED : LABELLED + 1, :3], NAMES[:3]) is None


def test_where_the_label_is_elsewhere_nothing_is_propagated(film, propagate) -> None:
    images, truth = film
    height, width = images.shape[1:3]
    assert propagate((width, height) - truth[LABELLED : LABELLED + 1]) is None


def frame(video: str, actuator: str = "a", xy: float = 1.0, **more: bool) -> LabelledFrame:
    return LabelledFrame(video, Path(f"{video}.png"), np.full((4, 2), xy), actuator, **more)


def test_an_actuator_with_five_labels_needs_none() -> None:
    few = [frame("v"), frame("w"), frame("w"), frame("u", xy=np.nan)]
    assert own.videos_with_few_labels([*few, *[frame("x", "b")] * 5]) == ["v", "w"]
    assert own.videos_with_few_labels([*few, frame("x"), frame("y")]) == []


def test_frames_that_nobody_labelled_judge_nothing() -> None:
    frames = [frame("v")] * 6 + [frame("v", propagated=True)] * 30
    trained, held_out = split(frames, 0.5, 0)
    assert len(held_out) == 3
    assert max(held_out) < 6
    assert set(range(6, 36)) < set(trained)


def test_a_resumed_training_has_the_same_frames(film, tmp_path: Path) -> None:
    images, truth = film
    with VideoWriter(tmp_path / "v.mp4", images.shape[2:0:-1], frame_rate=30) as writer:
        for image in images:
            writer.write(image)
    picture = own.cv2.imencode(".png", images[LABELLED][..., ::-1])[1].tobytes()
    (tmp_path / "img.png").write_bytes(picture)
    labelled = [LabelledFrame("v", tmp_path / "img.png", truth[LABELLED], "a", LABELLED)]
    videos, settings = {"v": tmp_path / "v.mp4"}, TrainingSettings(init="actuator")
    made = own.propagated_frames(labelled, NAMES, videos, tmp_path, settings)
    assert len(made) > 12
    assert all(one.propagated and one.image_path.is_file() for one in made)
    again = own.propagated_frames(labelled, NAMES, {}, tmp_path, settings)
    assert [one.image_path for one in again] == [one.image_path for one in made]
    for one, other in zip(again, made, strict=True):
        np.testing.assert_array_equal(one.xy, other.xy)
    # What was not written to its end is made again.
    positions = tmp_path / own.FOLDER / own.POSITIONS_FILE
    positions.write_text(json.dumps([{"video": "v"}]))
    assert own.read_propagated(tmp_path, labelled) == []
    assert own.propagated_frames(labelled, NAMES, videos, tmp_path, TrainingSettings(init="random")) == []
    own.forget_propagated(tmp_path)
    assert not (tmp_path / own.FOLDER).exists()
