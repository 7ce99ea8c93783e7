"""Training on drawn fingers: it learns, it resumes to the bit after SIGKILL, it stops when it must."""

from __future__ import annotations

import csv
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from safetensors.torch import load_file

from bendtrack.models.data.synthetic import rendered_frames
from bendtrack.models.detector import NetworkDetector
from bendtrack.models.evaluation import evaluate, not_trained_on
from bendtrack.models.inference.crops import CropGeometry
from bendtrack.models.networks.checkpoint import load_checkpoint
from bendtrack.models.training import batches
from bendtrack.models.training import trainer as training
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.split import split
from bendtrack.models.training.trainer import Progress, train
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import LabelError, TrainingError
from bendtrack.tracker.synthetic.stream import KEYPOINTS as canonical
from bendtrack.tracker.synthetic.stream import TRAINING, Stage, drawn_look, inflation_deg
from bendtrack.tracker.types import LabelledFrame

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
MakeFrames = Callable[..., list[LabelledFrame]]
TINY = TrainingSettings(init="random", steps=6, batch_frames=2)


@pytest.mark.slow
def test_learns_where_the_points_are_and_says_how_sure_it_is(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 190, 16), noise_px=0.5)
    told: list[Progress] = []
    settings = TrainingSettings(init="random", steps=120, batch_frames=6, held_out=0.15)
    checkpoint = train(frames, KEYPOINTS, definition, tmp_path / "model", settings, progress=told.append)

    unseen = make_frames(np.linspace(6, 180, 12), start=100)
    result = evaluate(checkpoint, unseen)
    assert np.sqrt((result.error_px**2).mean()) < 1.0
    assert np.sqrt((result.angle_error_deg**2).mean()) < 3.5
    assert result.found.likelihood.min() > 0.5
    sd = np.sqrt(np.trace(result.found.covariance, axis1=2, axis2=3) / 2)
    assert 0.05 < np.median(sd) < 2.0

    # A finger that is not there is not found.
    blank = np.full((1, 120, 160, 3), 120, np.uint8)
    assert checkpoint.detect(blank).likelihood.max() < 0.5

    assert [p.step for p in told] == list(range(1, 121))
    assert told[-1].loss < told[0].loss / 4
    rows = list(csv.DictReader((tmp_path / "model" / "training.csv").read_text().splitlines()))
    assert [int(row["step"]) for row in rows] == [50, 100, 120]
    assert not list((tmp_path / "model").glob("training-state*")), "a finished training leaves no state"

    # The file alone says everything: another object gives the same answer.
    again = NetworkDetector.load(tmp_path / "model")
    image = np.repeat(blank, 3, axis=0)
    np.testing.assert_array_equal(again.detect(image).xy, checkpoint.detect(image).xy)
    assert len(not_trained_on(load_checkpoint(tmp_path / "model"), [*frames, *unseen])) == 2 + 12


def test_the_same_seed_gives_the_same_network_and_another_seed_another(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 180, 6))
    weights = []
    for index, seed in enumerate((0, 0, 1)):
        folder = tmp_path / str(index)
        train(frames, KEYPOINTS, definition, folder, replace(TINY, seed=seed))
        weights.append(load_file(folder / "weights.safetensors"))
    same = [all(bool((weights[0][n] == w[n]).all()) for n in w) for w in weights[1:]]
    assert same == [True, False]


KILLED = """
import sys
import numpy as np
import torch
from pathlib import Path
from bendtrack.models.training import trainer as training
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.types import LabelledFrame

torch.set_num_threads(1)
training.EVALUATE_EVERY = 4
folder, keypoints = Path(sys.argv[1]), sys.argv[2].split(",")
labels = np.load(folder / "labels.npy")
frames = [
    LabelledFrame("finger", folder / f"img{i:05d}.png", xy, "default", i) for i, xy in enumerate(labels)
]
training.train(
    frames, keypoints, AngleDefinition("two-vector", keypoints), folder / sys.argv[3],
    TrainingSettings(init="actuator", steps=20, batch_frames=2), resume="--resume" in sys.argv,
    progress=lambda p: print(p.step, flush=True),
)
"""


def kill_at_step(command: list[str], step: int) -> None:
    """Start a training that prints its steps, and kill it when it has done so many."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) == step:
            break
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()


@pytest.mark.slow
def test_killed_and_resumed_equals_never_killed(make_frames: MakeFrames, tmp_path: Path) -> None:
    frames = make_frames(np.linspace(0, 180, 8))
    np.save(tmp_path / "labels.npy", np.stack([frame.xy for frame in frames]))
    command = [sys.executable, "-c", KILLED, str(tmp_path), ",".join(KEYPOINTS)]
    subprocess.run([*command, "whole"], check=True, capture_output=True)

    kill_at_step([*command, "killed"], 10)
    assert not (tmp_path / "killed" / "weights.safetensors").exists()
    resumed = subprocess.run([*command, "killed", "--resume"], check=True, capture_output=True, text=True)
    assert resumed.stdout.split()[0] == "9", "goes on from the state saved at step 8"

    first, second = (load_file(tmp_path / n / "weights.safetensors") for n in ("whole", "killed"))
    assert all(bool((first[name] == second[name]).all()) for name in first)


@pytest.mark.slow
def test_what_a_network_knew_of_other_actuators_it_keeps(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = make_frames(np.linspace(0, 180, 8))
    settings = TrainingSettings(init="actuator", steps=80, batch_frames=4)
    others = rendered_frames(1000, range(60), KEYPOINTS, {name: name for name in KEYPOINTS})

    def px_off(at_once: int) -> float:
        """How far the refiner is off on rendered actuators that neither training has seen, median."""
        monkeypatch.setattr(batches, "REPLAY_PER_BATCH", at_once)
        checkpoint = train(frames, KEYPOINTS, definition, tmp_path / str(at_once), settings)
        estimator = checkpoint.network.estimator()
        found = [
            estimator.refine(f.fine[None], f.xy[None], CropGeometry(f.region, checkpoint.reference))
            for f in others
        ]
        off = np.stack([np.linalg.norm(p.xy[0] - f.xy, axis=1) for p, f in zip(found, others, strict=True)])
        return float(np.median(off[np.stack([f.in_sight for f in others])]))

    assert px_off(2) < 0.7 * px_off(0)


def test_resuming_with_other_labels_or_nothing_to_resume_is_refused(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = make_frames(np.linspace(0, 180, 6))
    with pytest.raises(TrainingError, match="expected an unfinished training"):
        train(frames, KEYPOINTS, definition, tmp_path / "model", TINY, resume=True)

    monkeypatch.setattr(training, "EVALUATE_EVERY", 2)

    def interrupt(progress: Progress) -> None:
        if progress.step == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(frames, KEYPOINTS, definition, tmp_path / "model", TINY, progress=interrupt)
    moved = [replace(frames[0], xy=frames[0].xy + 1), *frames[1:]]
    with pytest.raises(TrainingError, match="settings and labels that the training was started with"):
        train(moved, KEYPOINTS, definition, tmp_path / "model", TINY, resume=True)
    state = tmp_path / "model" / "training-state.safetensors"
    state.write_bytes(state.read_bytes()[:500])
    with pytest.raises(TrainingError, match="damaged"):
        train(frames, KEYPOINTS, definition, tmp_path / "model", TINY, resume=True)


def test_a_loss_that_is_not_finite_stops_the_training(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 180, 6))
    with pytest.raises(TrainingError, match=r"expected (a finite loss|finite gradients), got (nan|inf)"):
        train(frames, KEYPOINTS, definition, tmp_path, replace(TINY, learning_rate=1e30))


def test_a_time_limit_shortens_the_training(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 180, 6))
    checkpoint = train(
        frames, KEYPOINTS, definition, tmp_path, replace(TINY, steps=100_000, max_minutes=0.05)
    )
    assert 10 <= checkpoint.training["steps"] < 100_000
    assert (tmp_path / "weights.safetensors").is_file()


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("backbone", "vgg16"),
        ("steps", 0),
        ("held_out", 1.0),
        ("max_minutes", float("inf")),
        ("max_minutes", 0.0),
        ("seed", -1),
        ("batch_frames", 0),
        ("consensus", 1.5),
    ],
)
def test_a_setting_out_of_range_is_named(setting: str, value: object) -> None:
    with pytest.raises(TrainingError, match=rf"^{setting}: expected .*, got "):
        TrainingSettings(**{setting: value})


def test_missing_points_train_and_a_point_that_nobody_labelled_is_named(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 180, 6))
    for frame in frames[:4]:
        frame.xy[1] = np.nan
    frames[5].xy[:] = np.nan
    checkpoint = train(frames, KEYPOINTS, definition, tmp_path / "model", TINY)
    assert len(checkpoint.training["trained_on"]) + len(checkpoint.training["held_out"]) == 5
    for frame in frames:
        frame.xy[1] = np.nan
    with pytest.raises(LabelError, match="got none for base_2"):
        train(frames, KEYPOINTS, definition, tmp_path / "other", TINY)
    with pytest.raises(LabelError, match="got 0 without any"):
        train([], KEYPOINTS, definition, tmp_path / "other", TINY)


def test_missing_points_train_where_the_network_knew_them_before(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 180, 8), noise_px=1.0)
    frames[2].xy[3] = np.nan
    frames[5].xy[0] = np.nan
    settings = TrainingSettings(init="actuator", steps=2, batch_frames=2, held_out=0.0)
    checkpoint = train(frames, KEYPOINTS, definition, tmp_path / "model", settings)
    assert np.isfinite(np.concatenate([np.ravel(of) for of in checkpoint.systematic_bias])).all()
    for value in checkpoint.network.state_dict().values():
        assert value.isfinite().all()


@pytest.fixture
def rendered(tmp_path: Path) -> tuple[list[LabelledFrame], np.ndarray]:
    """Frames of a rendered actuator while it bends, labelled by an unsteady hand, and the truth (N, 4, 2) px."""
    look = drawn_look(21, 3, size_wh=(400, 300), families=TRAINING, bend_deg=(0.0, 150.0))
    stage, rng, frames, truth = Stage(look), np.random.default_rng(0), [], []
    for i, bend in enumerate(inflation_deg(look, 24)):
        sample = stage.frame(bend)
        truth.append(sample.keypoints_xy[[canonical.index(name) for name in KEYPOINTS]])
        path = tmp_path / f"img{i:05d}.png"
        cv2.imwrite(str(path), sample.picture[..., ::-1])
        frames.append(LabelledFrame("film", path, truth[-1] + rng.normal(0, 1, (4, 2)), "default", i))
    return frames, np.stack(truth)


def trainer_from(
    start: str, frames: list[LabelledFrame], definition: AngleDefinition, folder: Path, **other: object
) -> training._Trainer:
    settings = TrainingSettings(init=start, held_out=0.0, **other)
    return training._Trainer(frames, KEYPOINTS, definition, folder, settings, resume=False)


def tip_sd_deg(xy: np.ndarray, truth: np.ndarray) -> float:
    """How the tip's direction scatters about the truth."""
    vectors = [points[:, 3] - points[:, 2] for points in (xy, truth)]
    angles = [np.unwrap(np.arctan2(v[:, 1], v[:, 0])) for v in vectors]
    return float(np.degrees(angles[0] - angles[1]).std())


def test_a_network_that_knows_actuators_learns_from_positions_nearer_to_the_truth_than_labels(
    rendered: tuple[list[LabelledFrame], np.ndarray], definition: AngleDefinition, tmp_path: Path
) -> None:
    frames, truth = rendered[0][::2], rendered[1][::2]
    knows = trainer_from("actuator", frames, definition, tmp_path / "model")
    positions = knows.evidence.known_before(knows.pair.average.estimator(), np.ones(4, bool))
    labels = np.stack([frame.xy for frame in frames])
    assert tip_sd_deg(labels, truth) > 1.5
    assert tip_sd_deg(positions, truth) < 0.4 * tip_sd_deg(labels, truth)
    assert trainer_from("random", frames, definition, tmp_path / "model").evidence.features is None


def test_a_network_that_knows_actuators_learns_how_tips_lie_from_closer_pictures(
    rendered: tuple[list[LabelledFrame], np.ndarray], definition: AngleDefinition, tmp_path: Path
) -> None:
    frames, truth = rendered
    pictures = np.stack([cv2.imread(str(frame.image_path))[..., ::-1] for frame in frames])
    # Labelled in every second frame, judged in the others, before it has taken a step.
    knows = trainer_from("actuator", frames[::2], definition, tmp_path / "model").finish()
    assert knows.network.aligner.pairs == ((2, 3),)
    with_it = tip_sd_deg(knows.detect(pictures[1::2]).xy, truth[1::2])
    knows.network.aligner = None
    assert with_it < 0.7 * tip_sd_deg(knows.detect(pictures[1::2]).xy, truth[1::2])
    half = trainer_from("actuator", frames[::2], definition, tmp_path / "model", consensus=0.5).finish()
    assert half.network.aligner.pairs == ((2, 3),)
    for settings in ({"start": "random"}, {"start": "actuator", "consensus": 0.0}):
        start = settings.pop("start")
        other = trainer_from(start, frames[::2], definition, tmp_path / "model", **settings)
        assert other.finish().network.aligner is None


def test_every_actuator_is_held_out_in_its_share() -> None:
    frames = [LabelledFrame(a, Path("x"), np.zeros((4, 2)), a) for a in ["p"] * 30 + ["q"] * 10 + ["r"] * 3]
    trained, held = split(frames, 0.1, seed=0)
    assert sorted(trained + held) == list(range(43))
    assert [sum(frames[i].actuator == a for i in held) for a in "pqr"] == [3, 1, 0]

    # The only frame that has a keypoint is trained on.
    for frame in frames:
        if frame is not frames[held[1]]:
            frame.xy[2] = np.nan
    assert held[1] in split(frames, 0.1, seed=0)[0]


def test_a_full_disk_loses_nothing_that_was_saved(make_frames: MakeFrames, tmp_path: Path) -> None:
    frames = make_frames(np.linspace(0, 180, 8))
    np.save(tmp_path / "labels.npy", np.stack([frame.xy for frame in frames]))
    command = [sys.executable, "-c", KILLED, str(tmp_path), ",".join(KEYPOINTS), "model"]
    kill_at_step(command, 5)
    state = tmp_path / "model" / "training-state.safetensors"
    saved = state.read_bytes()

    # A limit on the size of files fails as a full disk does: in the middle of writing.
    limited = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))\n"
    )
    command[2] = limited + KILLED
    done = subprocess.run([*command, "--resume"], capture_output=True, text=True)
    assert "File too large" in done.stderr
    assert done.stdout.split()[-1] == "7", "it fails where it saves, not before"
    assert state.read_bytes() == saved
    assert sorted(path.name for path in (tmp_path / "model").iterdir()) == [
        "training-state.safetensors",
        "training.csv",
    ]
