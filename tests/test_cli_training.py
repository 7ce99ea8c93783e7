"""bendtrack train and evaluate: settings, names, what is written, going on after a stop."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from safetensors.torch import load_file

from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.models.detector import NetworkDetector
from bendtrack.models.inference.metadata import WEIGHTS_FILE, read_metadata
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.state import STATE_FILE
from bendtrack.networks import sign_for
from bendtrack.tracker.project import Project
from bendtrack.tracker.synthetic.stream import TRAINING, Renderer, drawn_look

FILES = {
    "weights.safetensors",
    "checkpoint.json",
    "training-settings.json",
    "training.csv",
    "evaluation.json",
    "learning-curve.png",
    "errors.png",
    "worst-frames.png",
}


def settings_of(folder: Path) -> dict[str, object]:
    return json.loads((folder / "checkpoint.json").read_text())["training"]["settings"]


def set_training(project: Project, **values: object) -> None:
    """Put values into [training] of bendtrack.toml, in place of what is there."""
    path = project.root / "bendtrack.toml"
    head, rest = path.read_text().split("[training]\n")
    kept = [line for line in rest.splitlines() if line.split(" =")[0] not in values]
    lines = [f"{key} = {value}" for key, value in values.items()]
    path.write_text("\n".join([f"{head}[training]", *lines, *kept]) + "\n")


def test_a_trained_network_has_all_its_files(trained_project: Project) -> None:
    # And the networks compiled from them, which the first tracking makes.
    assert {path.name for path in (trained_project.models_dir / "model").iterdir()} == FILES | {"engine"}


def test_options_go_before_the_file_and_that_before_the_defaults(bendtrack, project: Project) -> None:
    set_training(project, seed=3, steps=1)
    ran = bendtrack("train", project.root, "--name", "mine", "--seed", 4, "--init", "random")
    assert (ran.status, ran.err) == (0, "")
    settings = settings_of(project.models_dir / "mine")
    assert (settings["seed"], settings["steps"], settings["held_out"]) == (4, 1, 0.2)
    assert settings["backbone"] == "resnet18"
    assert "Start: resnet18 with random weights" in ran.out
    assert "1 steps in" in ran.out
    assert "from random weights" in ran.out


def test_a_network_starts_from_what_comes_with_bendtrack_where_nobody_says_otherwise(
    bendtrack, project: Project
) -> None:
    set_training(project, init='"auto"', steps=1)
    ran = bendtrack("train", project.root)
    assert (ran.status, ran.err) == (0, "")
    assert "Start: resnet18 with actuator weights" in ran.out
    facts = json.loads((project.models_dir / "model" / "checkpoint.json").read_text())["training"]
    assert facts["started_from"] == "actuator"


def test_no_actuator_comes_with_every_backbone(bendtrack, project: Project) -> None:
    ran = bendtrack("train", project.root, "--backbone", "resnet34", "--init", "actuator")
    assert ran.status == 2
    assert (
        "actuator weights: expected a backbone that they come with (resnet18, resnet50), got resnet34"
        in ran.err
    )


def test_a_network_starts_from_a_file_the_project_names(bendtrack, trained_project: Project) -> None:
    # Its path counts from the project's folder, wherever the command is called.
    set_training(trained_project, init='"models/model/weights.safetensors"')
    ran = bendtrack("train", trained_project.root)
    assert ran.status == 0
    start = trained_project.models_dir / "model" / "weights.safetensors"
    assert f"Start: resnet18 with {start} weights" in ran.out


def test_names_are_counted_up_and_nothing_is_overwritten_unasked(bendtrack, trained_project: Project) -> None:
    models = trained_project.models_dir
    before = (models / "model" / "weights.safetensors").read_bytes()
    assert bendtrack("train", trained_project.root, "--seed", 1).status == 0
    assert sorted(path.name for path in models.iterdir()) == ["model", "model-2"]
    taken = bendtrack("train", trained_project.root, "--model", "model")
    assert taken.status == 2
    assert "choose another, or --overwrite" in taken.err
    assert (models / "model" / "weights.safetensors").read_bytes() == before
    assert bendtrack("train", trained_project.root, "--name", "model", "--overwrite", "--seed", 2).status == 0
    assert (models / "model" / "weights.safetensors").read_bytes() != before


def test_the_newest_network_is_judged_or_the_one_named(bendtrack, trained_project: Project) -> None:
    assert bendtrack("train", trained_project.root, "--model", "b").status == 0
    assert "'b' on 2 frames" in bendtrack("evaluate", trained_project.root).out
    ran = bendtrack("evaluate", trained_project.root, "--model", "model")
    assert "'model' on 2 frames that it was not trained on" in ran.out
    assert "bending angle" in ran.out
    assert "L = 18 px apart" in ran.out
    assert "Advice: L is short" in ran.out
    # A held-out frame was clicked once: 2 / 18 rad. An error of this size is no false label.
    assert "One label of 1 px error is then itself 6." in " ".join(ran.out.split())
    assert "no fault of the network" in " ".join(ran.out.split())
    figures = json.loads((trained_project.models_dir / "model" / "evaluation.json").read_text())
    assert figures["n_frames"] == 2
    missing = bendtrack("evaluate", trained_project.root, "--model", "c")
    assert missing.status == 2
    assert "--model: expected one of model, b, got 'c'" in missing.err


def test_quiet_leaves_the_table(bendtrack, trained_project: Project) -> None:
    ran = bendtrack("evaluate", trained_project.root, "--quiet")
    assert ran.out.splitlines()[0].split() == ["n", "mean", "median", "95", "%", "max"]


def test_folds_judge_every_frame_once(bendtrack, project: Project) -> None:
    ran = bendtrack("evaluate", project.root, "--folds", 2)
    assert (ran.status, ran.err) == (0, "")
    folder = project.models_dir / "cross-validation"
    figures = json.loads((folder / "evaluation.json").read_text())
    assert (figures["n_frames"], figures["folds"], figures["n_trained"]) == (10, 2, 5)
    assert len({frame["image"] for frame in figures["frames"]}) == 10
    # It is no network.
    assert f"got none: `bendtrack train {project.root}` trains one" in bendtrack("evaluate", project.root).err
    assert bendtrack("evaluate", project.root, "--folds", 11).status == 2
    assert bendtrack("train", project.root, "--model", "cross-validation").status == 2


def test_without_held_out_frames_there_is_nothing_to_judge(bendtrack, project: Project) -> None:
    ran = bendtrack("train", project.root, "--held-out", 0)
    assert ran.status == 0
    assert "its error is not known" in ran.out
    ran = bendtrack("evaluate", project.root)
    assert ran.status == 2
    assert "was not trained on, got none" in ran.err


def start(bendtrack, *args: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [bendtrack.command, *map(str, args)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 240
    while not path.exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end, f"{path} did not come"
        time.sleep(0.005)


@pytest.mark.slow
@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT], ids=["killed", "interrupted"])
def test_a_stopped_training_goes_on_as_if_it_had_not_stopped(bendtrack, project: Project, stop: int) -> None:
    set_training(project, steps=70)
    folder = project.models_dir / "model"
    process = start(bendtrack, "train", project.root, "--seed", 6)
    wait_for(folder / STATE_FILE, process)
    process.send_signal(stop)
    _, err = process.communicate()
    if stop == signal.SIGINT:
        assert process.returncode == 130
        assert err.startswith("error: interrupted")
        assert err.count("\n") == 1
        assert "--resume` goes on with 'model'" in err
    assert not (folder / "weights.safetensors").exists()

    other = bendtrack("train", project.root, "--model", "model")
    assert other.status == 2
    assert "an unfinished training: go on with --resume" in other.err

    # The seed was an option of the first call: it is remembered.
    ran = bendtrack("train", project.root, "--resume")
    assert ran.status == 0, ran.err
    assert "Going on with 'model'" in ran.out
    assert {path.name for path in folder.iterdir()} == FILES
    assert settings_of(folder)["seed"] == 6

    assert bendtrack("train", project.root, "--seed", 6, "--model", "unbroken").status == 0
    rows = [line.split(",") for line in (folder / "training.csv").read_text().splitlines()]
    assert [row[0] for row in rows] == ["step", "50", "70"]
    weights, unbroken = (
        load_file(path / "weights.safetensors") for path in (folder, project.models_dir / "unbroken")
    )
    assert all(weights[name].equal(unbroken[name]) for name in unbroken)


def test_ctrl_c_before_anything_was_saved_keeps_it_and_says_what_goes_on(bendtrack, project: Project) -> None:
    set_training(project, steps=40)  # saved at the 40th without being stopped
    read, write = os.openpty()
    process = subprocess.Popen(
        [bendtrack.command, "train", project.root, "--seed", "6"],
        stdout=subprocess.PIPE,
        stderr=write,
        text=True,
        env={**os.environ, "COLUMNS": "200", "TERM": "xterm"},
    )
    os.close(write)
    said = b""
    while not re.search(rb"step [1-9]", said):  # a terminal is shown every step
        said += os.read(read, 4096)
    process.send_signal(signal.SIGINT)
    with suppress(OSError):  # Linux: the other end is closed
        while more := os.read(read, 4096):
            said += more
    process.communicate()
    os.close(read)
    assert process.returncode == 130
    last = said.decode().split("error: ")[-1]
    again = shlex.join(["bendtrack", "train", str(project.root), "--resume"])
    assert last.startswith(f"interrupted, its state is saved: `{again}` goes on with 'model'")
    assert (project.models_dir / "model" / STATE_FILE).is_file()
    ran = bendtrack("train", project.root, "--resume")
    assert (ran.status, ran.err) == (0, "")
    assert "'model': 40 steps" in ran.out


def test_without_labels_frames_and_label_come_first(bendtrack, tmp_path: Path) -> None:
    root = tmp_path / "my study"
    assert bendtrack("new", root).status == 0
    ran = bendtrack("train", root)
    assert ran.status == 2
    assert ran.err.count("\n") == 1
    for command in ("frames", "label", "import"):
        assert f"`{shlex.join(['bendtrack', command, str(root)])}" in ran.err
    assert not (root / "models").exists()


def test_a_limit_that_leaves_no_time_to_learn_is_warned_of(bendtrack, project: Project) -> None:
    set_training(project, steps=100)
    ran = bendtrack("train", project.root, "--max-minutes", 0.001)
    assert ran.status == 0
    assert "0.001 min were enough for 10 of 100 steps" in ran.err


def test_defaults_in_the_help_are_those_of_the_settings(bendtrack) -> None:
    said = " ".join(bendtrack("train", "--help").out.split())
    defaults = TrainingSettings()
    for option, value in (
        ("--backbone", defaults.backbone),
        ("--seed", defaults.seed),
        ("--held-out", defaults.held_out),
    ):
        assert f"[default: ({value})]" in said.split(f"{option} ")[1].split(" --")[0]


def test_a_name_is_given_as_before_too(bendtrack, project: Project) -> None:
    assert "--name" not in bendtrack("train", "--help").out
    assert bendtrack("train", project.root, "--name", "mine").status == 0
    assert (project.models_dir / "mine" / "weights.safetensors").is_file()


def test_other_labels_do_not_fit_a_stopped_training(bendtrack, project: Project) -> None:
    folder = project.models_dir / "model"
    folder.mkdir(parents=True)
    (folder / "training-settings.json").write_text("{}")
    (folder / STATE_FILE).write_bytes(b"half")
    ran = bendtrack("train", project.root, "--resume")
    assert ran.status == 2
    assert "expected a training state" in ran.err
    assert "got a damaged file" in ran.err
    (folder / "training-settings.json").write_text("{")
    assert "expected training settings" in bendtrack("train", project.root, "--resume").err


def test_which_keypoints_of_other_names_the_network_knew_is_said(bendtrack, tmp_path: Path) -> None:
    """On an actuator, which the pretrained network finds; its labels have names of their own."""
    look = drawn_look(778, 3, size_wh=(480, 360), families=TRAINING, bend_deg=(0.0, 170.0))
    project = Project.create(tmp_path / "study", keypoints=("root_1", "root_2", "top_1", "top_2"))
    store, labels = LabelStore.of(project), {}
    for index in range(8):
        sample = Renderer(look).frame(170.0 * index / 7, noise_seed=index)
        store.add_image("film", image_name(index), sample.image)
        labels[image_name(index)] = sample.keypoints_xy[[0, 1, -2, -1]]
    store.write("film", labels)
    set_training(project, init='"actuator"', steps=1)
    ran = bendtrack("train", project.root)
    assert (ran.status, ran.err) == (0, "")
    assert "They knew root_1 as base_1, root_2 as base_2, top_1 as tip_1, top_2 as tip_2" in ran.out


def test_every_actuator_has_its_own_sign(bendtrack, project: Project, arm_mirrored: tuple) -> None:
    """Two actuators that bend to different sides of the picture: both bend by positive angles."""
    images, labels = arm_mirrored
    store = LabelStore.of(project)
    for index, image in enumerate(images):
        store.add_image("mirrored", image_name(index), image)
    store.write("mirrored", {image_name(index): xy for index, xy in enumerate(labels)})
    project.assign_actuator("other", ["mirrored"])
    assert bendtrack("train", project.root).status == 0
    checkpoint = read_metadata(project.models_dir / "model" / WEIGHTS_FILE)
    assert checkpoint.training["signs"] == {"default": 1, "other": -1}
    network = NetworkDetector.load(project.models_dir / "model", engine="torch")
    own = Project.open(project.root)
    signs = [sign_for(own, network, Path(f"{stem}.mp4")) for stem in ("arm", "mirrored", "new")]
    assert signs == [1, -1, 1]
    # An earlier network, or one that someone has changed.
    for stored in ({}, {"signs": [1]}, {"signs": {"other": "-"}}):
        network.metadata = replace(network.metadata, training=stored)
        assert sign_for(own, network, Path("mirrored.mp4")) == network.metadata.definition.sign


def test_with_few_labels_it_is_said_what_else_is_learnt_from(
    bendtrack, tmp_path: Path, write_arm_video, arm_in_frame
) -> None:
    """Two labelled frames of a drawn arm: the pretrained network finds it in others, but nothing elsewhere."""
    video = write_arm_video(tmp_path / "arm.mp4")
    project = Project.create(tmp_path / "study", keypoints=("base_1", "base_2", "tip_1", "tip_2"))
    assert bendtrack("frames", project.root, video, "--count", 2).status == 0
    store = LabelStore.of(project)
    labels = {path.name: arm_in_frame(int(path.stem[3:]), 12) for path in store.images("arm")}
    store.write("arm", labels)
    set_training(project, steps=1, batch_frames=1, init='"actuator"')
    said = bendtrack("train", project.root)
    assert said.status == 0, said.err
    assert re.search(r"Few frames are labelled: \d+ more of arm are learnt from", said.out)
    store.write("arm", {name: (95, 71) - xy for name, xy in labels.items()})
    said = bendtrack("train", project.root)
    assert "arm: few frames are labelled, and the actuator is not found in its other frames" in said.err
    video.rename(tmp_path / "elsewhere.mp4")
    said = bendtrack("train", project.root)
    assert "arm: few frames are labelled, and where its video lies is not known" in said.err
    set_training(project, init='"random"')
    assert "few frames" not in bendtrack("train", project.root).err
