"""What tests of every package share: the command line, in this process or as installed, and a small project."""

from __future__ import annotations

import ctypes
import io
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.models.export import build_beside
from bendtrack.tracker.cli import app
from bendtrack.tracker.project import Project
from bendtrack.tracker.video_writer import VideoWriter

# A run that was started in the background ignores Ctrl-C, and so would every program that the tests start and stop.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

COMMAND = Path(sys.executable).parent / "bendtrack"
KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
SIZE_WH = (96, 72)
# As little as there can be: these networks are right about nothing, and everything around them must hold.
TINY_TRAINING = {"init": '"random"', "steps": 2, "batch_frames": 1, "held_out": 0.2}


def pytest_configure(config: pytest.Config) -> None:
    # Tests share a machine's cores with the processes that they start.
    os.environ.setdefault("OMP_NUM_THREADS", "1")


@dataclass(frozen=True)
class Ran:
    """How a command ended."""

    status: int
    out: str
    err: str


class Bendtrack:
    """Runs bendtrack commands."""

    command = COMMAND

    def __call__(self, *args: object) -> Ran:
        """In this process: quick, and library warnings are errors as in every test."""
        out, err, status = io.StringIO(), io.StringIO(), 0
        with redirect_stdout(out), redirect_stderr(err):
            try:
                app([str(arg) for arg in args], prog_name="bendtrack")
            except SystemExit as end:
                status = int(end.code or 0)
        return Ran(status, out.getvalue(), err.getvalue())

    def installed(
        self, *args: object, file_size: int | None = None, obey_modes: bool = False, cwd: Path | None = None
    ) -> Ran:
        """As users run it: the installed console command, in a process of its own.

        Parameters
        ----------
        file_size : no file can grow larger (bytes); beyond, writing fails as on a full disk
        obey_modes : root does without its right to read and write anywhere
        """

        def prepare() -> None:
            if file_size is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (file_size, file_size))
            if obey_modes and os.geteuid() == 0:
                cap_dac_override, cap_dac_read_search, pr_capbset_drop = 1, 2, 24
                libc = ctypes.CDLL(None, use_errno=True)
                for capability in (cap_dac_override, cap_dac_read_search):
                    if libc.prctl(pr_capbset_drop, capability, 0, 0, 0):
                        raise OSError(ctypes.get_errno(), "prctl")

        done = subprocess.run(
            [COMMAND, *map(str, args)],
            capture_output=True,
            text=True,
            preexec_fn=prepare,
            cwd=cwd,
            check=False,
        )
        return Ran(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="session")
def bendtrack() -> Bendtrack:
    return Bendtrack()


def arm_xy(angle_deg: float) -> np.ndarray:
    """Four points (4, 2) px of an arm in a picture of `SIZE_WH`, the far end turned clockwise."""
    turn = np.radians(angle_deg)
    base = np.array([[12.0, 22.0], [30.0, 22.0]])
    tip = base[1] + 16 * np.array([np.cos(turn / 2), np.sin(turn / 2)])
    return np.stack([*base, tip, tip + 18 * np.array([np.cos(turn), np.sin(turn)])])


def arm_image(angle_deg: float) -> np.ndarray:
    """A thick bent line with a disc at each point, RGB."""
    image = np.full((SIZE_WH[1], SIZE_WH[0], 3), 70, np.uint8)
    points = np.round(arm_xy(angle_deg) * 8).astype(np.int32)
    cv2.polylines(image, [points[:, None]], False, (200, 190, 170), 7, cv2.LINE_AA, shift=3)
    for point, colour in zip(
        points.tolist(), ((220, 40, 40), (40, 200, 40), (40, 60, 220), (230, 210, 40)), strict=True
    ):
        cv2.circle(image, point, 28, colour, -1, cv2.LINE_AA, shift=3)
    return image


def sweep(frames: int) -> np.ndarray:
    """Angles (T,) degrees up to 100 and back."""
    return 50 - 50 * np.cos(np.linspace(0, 2 * np.pi, frames))


WriteVideo = Callable[..., Path]


@pytest.fixture(scope="session")
def write_arm_video() -> WriteVideo:
    def write(path: Path, frames: int = 12) -> Path:
        with VideoWriter(path, SIZE_WH, 30.0) as writer:
            for index, angle in enumerate(sweep(frames)):
                writer.write(arm_image(angle), index / 30)
        return path

    return write


@pytest.fixture(scope="session")
def arm_in_frame() -> Callable[[int, int], np.ndarray]:
    """The points (4, 2) px in a frame of `write_arm_video`'s film of so many frames."""
    return lambda index, frames: arm_xy(float(sweep(frames)[index]))


@pytest.fixture(scope="session")
def tiny_training() -> str:
    """Lines for [training] in bendtrack.toml."""
    return "".join(f"{key} = {value}\n" for key, value in TINY_TRAINING.items())


def make_project(root: Path, training: Mapping[str, object]) -> Project:
    """A project with ten labelled pictures of the arm."""
    project = Project.create(root, keypoints=KEYPOINTS)
    text = (root / "bendtrack.toml").read_text()
    lines = "".join(f"{key} = {value}\n" for key, value in training.items())
    (root / "bendtrack.toml").write_text(text.replace("[training]\n", f"[training]\n{lines}"))
    store = LabelStore.of(project)
    labels = {}
    for index, angle in enumerate(np.linspace(0, 100, 10)):
        store.add_image("arm", image_name(index), arm_image(angle))
        labels[image_name(index)] = arm_xy(angle)
    store.write("arm", labels)
    return Project.open(root)


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """Labels of an arm, nothing trained; a training takes a second."""
    return make_project(tmp_path / "study", TINY_TRAINING)


@pytest.fixture(scope="session")
def trained_once(tmp_path_factory: pytest.TempPathFactory, bendtrack: Bendtrack) -> Path:
    root = tmp_path_factory.mktemp("trained") / "study"
    make_project(root, TINY_TRAINING)
    ran = bendtrack("train", root, "--quiet")
    assert ran.status == 0, ran.err
    # Compiled once here, or every test that tracks would wait for it.
    build_beside(root / "models" / "model")
    return root


@pytest.fixture
def trained_project(tmp_path: Path, trained_once: Path) -> Project:
    """The same with a network, 'model', that has learnt next to nothing."""
    return Project.open(shutil.copytree(trained_once, tmp_path / "study"))


@pytest.fixture(scope="session")
def arm_mirrored() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Pictures of the arm that bends the other way, and their points (4, 2) px."""
    angles = np.linspace(0, 100, 10)
    labels = [arm_xy(angle) * (1, -1) + (0, SIZE_WH[1] - 1) for angle in angles]
    return [arm_image(angle)[::-1] for angle in angles], labels
