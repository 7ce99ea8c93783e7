"""Training on drawn fingers: accuracy, resuming to the bit after SIGKILL, time limits and refusals."""

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
import torch
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
from bendtrack.models.training.training_data import load_training_data
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import LabelError, TrainingError
from bendtrack.tracker.synthetic.stream import KEYPOINTS as canonical
from bendtrack.tracker.synthetic.stream import TRAINING, Renderer, drawn_look, inflation_deg
from bendtrack.tracker.types import LabelledFrame

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
MakeFrames = Callable[..., list[LabelledFrame]]
TINY = TrainingSettings(init="random", steps=6, batch_frames=2)


@pytest.mark.slow
def test_detects_keypoints_with_calibrated_likelihoods_after_a_short_training(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 190, 16), noise_px=0.5)
    reported: list[Progress] = []
    settings = TrainingSettings(init="random", steps=120, batch_frames=6, held_out=0.15)
    checkpoint = train(frames, KEYPOINTS, definition, tmp_path / "model", settings, progress=reported.append)

    unseen = make_frames(np.linspace(6, 180, 12), start=100)
    result = evaluate(checkpoint, unseen)
    assert np.sqrt((result.error_px**2).mean()) < 1.0
    assert np.sqrt((result.angle_error_deg**2).mean()) < 3.5
    assert result.found.likelihood.min() > 0.5
    sd = np.sqrt(np.trace(result.found.covariance, axis1=2, axis2=3) / 2)
    assert 0.05 < np.median(sd) < 2.0

    # An image without a finger gives low likelihoods.
    blank = np.full((1, 120, 160, 3), 120, np.uint8)
    assert checkpoint.detect(blank).likelihood.max() < 0.5

    assert [p.step for p in reported] == list(range(1, 121))
    assert reported[-1].loss < reported[0].loss / 4
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


def test_a_training_leaves_torchs_random_state_as_it_was(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    state = torch.get_rng_state()
    train(make_frames(np.linspace(0, 180, 6)), KEYPOINTS, definition, tmp_path, replace(TINY, steps=1))
    assert torch.equal(torch.get_rng_state(), state)


KILLED = """
import sys
import numpy as np
import torch
from pathlib import Path
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.trainer import train
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.types import LabelledFrame

torch.set_num_threads(1)
folder, keypoints = Path(sys.argv[1]), sys.argv[2].split(",")
labels = np.load(folder / "labels.npy")
frames = [
    LabelledFrame("finger", folder / f"img{i:05d}.png", xy, "default", i) for i, xy in enumerate(labels)
]
train(
    frames, keypoints, AngleDefinition("two-vector", keypoints), folder / sys.argv[3],
    TrainingSettings(init="actuator", steps=20, batch_frames=2), resume="--resume" in sys.argv,
    progress=lambda p: print(p.step, flush=True), evaluate_every=4,
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
def test_experience_replay_keeps_accuracy_on_other_actuators(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = make_frames(np.linspace(0, 180, 8))
    settings = TrainingSettings(init="actuator", steps=80, batch_frames=4)
    others = rendered_frames(1000, range(60), KEYPOINTS, {name: name for name in KEYPOINTS})

    def error_px(per_batch: int) -> float:
        """Median error of the refiner on rendered actuators of neither training."""
        monkeypatch.setattr(batches, "REPLAY_PER_BATCH", per_batch)
        checkpoint = train(frames, KEYPOINTS, definition, tmp_path / str(per_batch), settings)
        estimator = checkpoint.network.estimator()
        found = [
            estimator.refine(f.fine[None], f.xy[None], CropGeometry(f.region, checkpoint.reference))
            for f in others
        ]
        error = np.stack([np.linalg.norm(p.xy[0] - f.xy, axis=1) for p, f in zip(found, others, strict=True)])
        return float(np.median(error[np.stack([f.visible for f in others])]))

    assert error_px(2) < 0.7 * error_px(0)


def test_resuming_with_other_labels_or_nothing_to_resume_is_refused(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 180, 6))
    with pytest.raises(TrainingError, match="expected an unfinished training"):
        train(frames, KEYPOINTS, definition, tmp_path / "model", TINY, resume=True)

    def interrupt(progress: Progress) -> None:
        if progress.step == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(frames, KEYPOINTS, definition, tmp_path / "model", TINY, progress=interrupt, evaluate_every=2)
    moved = [replace(frames[0], xy=frames[0].xy + 1), *frames[1:]]
    with pytest.raises(TrainingError, match="settings and labels that the training was started with"):
        train(moved, KEYPOINTS, definition, tmp_path / "model", TINY, resume=True)
    state = tmp_path / "model" / "training-state.safetensors"
    state.write_bytes(state.read_bytes()[:500])
    with pytest.raises(TrainingError, match="damaged"):
        train(frames, KEYPOINTS, definition, tmp_path / "model", TINY, resume=True)


def test_ctrl_c_before_the_first_evaluation_saves_what_was_learnt(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 180, 6))
    folder = frames[0].image_path.parent
    np.save(folder / "labels.npy", np.stack([frame.xy for frame in frames]))
    # A process of its own, as Ctrl-C goes to a program's main thread.
    script = KILLED.replace("evaluate_every=4", "evaluate_every=50").replace("actuator", "random")
    command = [sys.executable, "-u", "-c", script, str(folder), ",".join(KEYPOINTS)]
    process = subprocess.Popen(
        [*command, "stopped"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) == 3:
            process.send_signal(signal.SIGINT)
            break
    _, errors = process.communicate()
    assert errors.splitlines()[-1] == "KeyboardInterrupt"
    assert [path.name for path in (folder / "stopped").iterdir()] == ["training-state.safetensors"]
    subprocess.run([*command, "stopped", "--resume"], check=True, capture_output=True)
    subprocess.run([*command, "unbroken"], check=True, capture_output=True)
    one, other = (load_file(folder / name / "weights.safetensors") for name in ("stopped", "unbroken"))
    assert all(one[name].equal(other[name]) for name in other)


def test_the_end_of_training_is_within_the_time_limit(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock on which the first targets take 20 s, a step takes 1 s, and 100 s went by before."""
    now_s = [0.0]
    monkeypatch.setattr(training.time, "monotonic", lambda: now_s[0])
    trainer = trainer_from(
        "random", make_frames(np.linspace(0, 180, 6)), definition, tmp_path, max_minutes=3.0, steps=500
    )
    trainer.state.mapping["base_1"] = "base_1"

    def initial_targets(estimator: object, known: object) -> np.ndarray:
        now_s[0] += 20
        return trainer.data.labels[trainer.data.trained]

    denoiser = replace(trainer.denoiser)
    object.__setattr__(denoiser, "initial_targets", initial_targets)
    trainer.denoiser = denoiser
    now_s[0] = 100

    def tick(progress: Progress) -> None:
        now_s[0] += 1

    monkeypatch.setattr(trainer, "_evaluate", lambda loss: None)
    trainer.run(0.0, tick)
    # 180 s in all: 100 before, 20 for the targets, 1.6 x 20 kept for the end, so 28 steps, or one that had begun.
    assert 27 <= trainer.state.step <= 29


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


def test_frames_with_missing_labels_are_trained_on_and_a_keypoint_without_labels_is_refused(
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


def test_missing_labels_are_accepted_with_the_shipped_network_as_start(
    make_frames: MakeFrames, definition: AngleDefinition, tmp_path: Path
) -> None:
    frames = make_frames(np.linspace(0, 180, 8), noise_px=1.0)
    frames[2].xy[3] = np.nan
    frames[5].xy[0] = np.nan
    settings = TrainingSettings(init="actuator", steps=2, batch_frames=2, held_out=0.0)
    checkpoint = train(frames, KEYPOINTS, definition, tmp_path / "model", settings)
    assert np.isfinite(checkpoint.calibration.label_sd_px)
    for value in checkpoint.network.state_dict().values():
        assert value.isfinite().all()


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[LabelledFrame], np.ndarray]:
    """Frames of a bending rendered actuator with noisy labels (sd 1 px), and the truth (N, 4, 2) px."""
    look = drawn_look(21, 3, size_wh=(400, 300), families=TRAINING, bend_deg=(0.0, 150.0))
    folder = tmp_path_factory.mktemp("rendered")
    renderer, rng, frames, truth = Renderer(look), np.random.default_rng(0), [], []
    for i, bend in enumerate(inflation_deg(look, 24)):
        sample = renderer.frame(bend)
        truth.append(sample.keypoints_xy[[canonical.index(name) for name in KEYPOINTS]])
        path = folder / f"img{i:05d}.png"
        cv2.imwrite(str(path), sample.image[..., ::-1])
        frames.append(LabelledFrame("film", path, truth[-1] + rng.normal(0, 1, (4, 2)), "default", i))
    return frames, np.stack(truth)


def trainer_from(
    start: str, frames: list[LabelledFrame], definition: AngleDefinition, folder: Path, **other: object
) -> training._Trainer:
    settings = TrainingSettings(init=start, held_out=0.0, **other)
    return training._Trainer(load_training_data(frames, KEYPOINTS, settings), definition, folder, settings)


def tip_sd_deg(xy: np.ndarray, truth: np.ndarray) -> float:
    """Standard deviation of the tip's direction about the truth, degrees."""
    vectors = [points[:, 3] - points[:, 2] for points in (xy, truth)]
    angles = [np.unwrap(np.arctan2(v[:, 1], v[:, 0])) for v in vectors]
    return float(np.degrees(angles[0] - angles[1]).std())


def test_initial_targets_of_the_shipped_network_are_nearer_to_the_truth_than_labels(
    rendered: tuple[list[LabelledFrame], np.ndarray], definition: AngleDefinition, tmp_path: Path
) -> None:
    frames, truth = rendered[0][::2], rendered[1][::2]
    trainer = trainer_from("actuator", frames, definition, tmp_path / "model")
    positions = trainer.denoiser.initial_targets(trainer.networks.average.estimator(), np.ones(4, bool))
    labels = np.stack([frame.xy for frame in frames])
    assert tip_sd_deg(labels, truth) > 1.5
    assert tip_sd_deg(positions, truth) < 0.4 * tip_sd_deg(labels, truth)
    assert trainer_from("random", frames, definition, tmp_path / "model").denoiser.features is None


def test_the_end_regressor_of_a_training_lowers_the_tips_scatter(
    rendered: tuple[list[LabelledFrame], np.ndarray], definition: AngleDefinition, tmp_path: Path
) -> None:
    frames, truth = rendered
    images = np.stack([cv2.imread(str(frame.image_path))[..., ::-1] for frame in frames])
    # Labelled in every second frame, evaluated in the others, before the first step.
    trained = trainer_from("actuator", frames[::2], definition, tmp_path / "model").finish()
    assert trained.network.aligner.pairs == ((2, 3),)
    with_it = tip_sd_deg(trained.detect(images[1::2]).xy, truth[1::2])
    trained.network.aligner = None
    assert with_it < 0.7 * tip_sd_deg(trained.detect(images[1::2]).xy, truth[1::2])
    half = trainer_from("actuator", frames[::2], definition, tmp_path / "model", consensus=0.5).finish()
    assert half.network.aligner.pairs == ((2, 3),)
    for settings in ({"start": "random"}, {"start": "actuator", "consensus": 0.0}):
        start = settings.pop("start")
        other = trainer_from(start, frames[::2], definition, tmp_path / "model", **settings)
        assert other.finish().network.aligner is None


def test_every_actuator_is_held_out_in_its_share() -> None:
    frames = [LabelledFrame(a, Path("x"), np.zeros((4, 2)), a) for a in ["p"] * 30 + ["q"] * 10 + ["r"] * 3]
    trained, held_out = split(frames, 0.1, seed=0)
    assert sorted(trained + held_out) == list(range(43))
    assert [sum(frames[i].actuator == a for i in held_out) for a in "pqr"] == [3, 1, 0]

    # The only frame that has a keypoint is trained on.
    for frame in frames:
        if frame is not frames[held_out[1]]:
            frame.xy[2] = np.nan
    assert held_out[1] in split(frames, 0.1, seed=0)[0]


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
