"""Small images with known keypoints: four discs of different colours along a bending finger.

The shipped network is loaded once for all tests; no test changes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from bendtrack.models.denoising.registration import shipped_features
from bendtrack.models.networks.checkpoint import Checkpoint, load_checkpoint
from bendtrack.models.networks.heatmap_network import FirstStage
from bendtrack.models.networks.shipped import shipped_network
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.synthetic.stream import TRAINING, Renderer, drawn_look, inflation_deg
from bendtrack.tracker.types import LabelledFrame

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
SIZE_WH = (160, 120)
_COLOURS = ((220, 60, 40), (240, 200, 40), (60, 200, 90), (60, 110, 230))


def finger_xy(angle_deg: float) -> np.ndarray:
    """Four points of a finger with a fixed base at (40, 60) and its last segment turned by `angle_deg`."""
    turn = np.deg2rad(angle_deg)
    directions = np.array([0.0, turn / 2, turn])
    steps = np.stack([np.cos(directions), np.sin(directions)], axis=1) * [[24.0], [34.0], [24.0]]
    return np.array([40.0, 60.0]) + np.vstack([[0, 0], np.cumsum(steps, axis=0)])


def drawn(angle_deg: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """An image RGB uint8 (120, 160, 3) of the finger and its keypoints (4, 2) px."""
    rng = np.random.default_rng(seed)
    xy = finger_xy(angle_deg)
    big = np.full((480, 640, 3), (120, 125, 130), np.uint8)
    points = [tuple(int(v) for v in np.round((p + 0.5) * 4 * 16 - 8)) for p in xy]
    for first, second in pairwise(points):
        cv2.line(big, first, second, (200, 195, 190), 28, cv2.LINE_AA, 4)
    for point, colour in zip(points, _COLOURS, strict=True):
        cv2.circle(big, point, 14 * 16, colour, -1, cv2.LINE_AA, 4)
    image = cv2.resize(big, SIZE_WH, interpolation=cv2.INTER_AREA)
    return np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8), xy


@pytest.fixture(scope="session")
def definition() -> AngleDefinition:
    return AngleDefinition("two-vector", KEYPOINTS)


@pytest.fixture(scope="session")
def shipped() -> Checkpoint:
    """The shipped ResNet-18 network."""
    return load_checkpoint(shipped_network("resnet18"))


@pytest.fixture(scope="session")
def features() -> FirstStage:
    """The first stage of the shipped network."""
    return shipped_features()


@pytest.fixture
def make_frames(tmp_path: Path) -> Callable[..., list[LabelledFrame]]:
    """Labelled frames at given angles, written as image files."""

    def make(angles_deg: np.ndarray, noise_px: float = 0.0, start: int = 0) -> list[LabelledFrame]:
        rng = np.random.default_rng(start)
        frames = []
        for index, angle in enumerate(angles_deg, start=start):
            image, xy = drawn(float(angle), index)
            path = tmp_path / f"img{index:05d}.png"
            cv2.imwrite(str(path), image[..., ::-1])
            frames.append(
                LabelledFrame("finger", path, xy + rng.normal(0, noise_px, xy.shape), "default", index)
            )
        return frames

    return make


@dataclass(frozen=True)
class Film:
    """Frames of one rendered actuator while it bends, and their truth; do not write into them, tests share them.

    Attributes
    ----------
    images : ndarray of uint8, shape (N, 300, 400, 3)
    keypoints_xy : ndarray of float, shape (N, 9, 2)
        px.
    angle_deg : ndarray of float, shape (N,)
    """

    images: np.ndarray
    keypoints_xy: np.ndarray
    angle_deg: np.ndarray


@pytest.fixture(scope="session")
def render_film() -> Callable[[int], Film]:
    """Renders a film of so many frames, once."""

    @cache
    def render(frames: int) -> Film:
        look = drawn_look(21, 3, size_wh=(400, 300), families=TRAINING, bend_deg=(0.0, 150.0))
        renderer = Renderer(look)
        samples = [
            renderer.frame(float(bend), noise_seed=i) for i, bend in enumerate(inflation_deg(look, frames))
        ]
        return Film(
            np.stack([sample.image for sample in samples]),
            np.stack([sample.keypoints_xy for sample in samples]),
            np.array([sample.angle_deg for sample in samples]),
        )

    return render


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    """Sums in the same order everywhere: resuming is tested to the bit. Small images gain nothing from two threads."""
    torch.set_num_threads(1)
