"""Where an end lies, learnt from some rendered frames and told in others, whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bendtrack.models.denoising.end_regression import fit_end_regression
from bendtrack.models.denoising.registration import LEAST
from bendtrack.models.inference.crops import crop_end, move_ends
from bendtrack.models.inference.roi import RegionOfInterest, orientations, regions_of_interest
from bendtrack.models.networks.end_regressor import EndRegressionNetwork, TorchEndRegressor
from bendtrack.models.networks.heatmap_network import FirstStage
from bendtrack.tracker.synthetic.stream import (
    KEYPOINTS,
    TRAINING,
    Stage,
    drawn_look,
    in_other_light,
    inflation_deg,
)

FRAMES = 24
LEARNT, OTHERS = np.arange(0, FRAMES, 2), np.arange(1, FRAMES, 2)
REFERENCE = (1, 0, 3, 2)
ENDS = [KEYPOINTS.index(name) for name in ("base_1", "base_2", "tip_1", "tip_2")]
SIZE_WH = (400, 300)

Film = tuple[list[np.ndarray], np.ndarray, RegionOfInterest]


def film_of(other_light: bool) -> Film:
    """Frames of one actuator while it bends, where its ends are, (N, 4, 2) px, and the working region."""
    look = drawn_look(21, 3, size_wh=SIZE_WH, families=TRAINING, bend_deg=(0.0, 150.0))
    stage = Stage(in_other_light(look, 5) if other_light else look)
    samples = [stage.frame(float(bend), noise_seed=i) for i, bend in enumerate(inflation_deg(look, FRAMES))]
    truth = np.stack([sample.keypoints_xy[ENDS] for sample in samples])
    (region,) = regions_of_interest(truth, [SIZE_WH] * FRAMES)
    return [sample.picture for sample in samples], truth, region


@pytest.fixture(scope="module")
def film() -> Film:
    return film_of(other_light=False)


def learn(
    film: Film, rows: np.ndarray, features: FirstStage, xy: np.ndarray | None = None, **other: object
) -> EndRegressionNetwork | None:
    pictures, truth, region = film
    own = (truth if xy is None else xy)[rows]
    given = {
        "known": np.ones(own.shape[:2], bool),
        "reference": REFERENCE,
        "videos": ["one"] * len(rows),
        "seed": 0,
    } | other
    return fit_end_regression(
        [pictures[i] for i in rows], [region] * len(rows), own, features=features, **given
    )


@pytest.fixture(scope="module")
def aligner(film: Film, features: FirstStage) -> EndRegressionNetwork:
    learnt = learn(film, LEARNT, features)
    assert learnt is not None
    return learnt


def off(truth: np.ndarray) -> np.ndarray:
    """Tips (N, 2, 2) px, shifted and turned by chance."""
    rng = np.random.default_rng(3)
    steps = rng.normal(size=(len(truth), 3)) * (1.5, 1.5, 0.035)
    return move_ends(truth[:, 2:], steps, 1.0)


def aligned(aligner: EndRegressionNetwork, film: Film, tips: np.ndarray) -> np.ndarray:
    pictures, _, region = film
    cut = [crop_end(picture, tip, region).picture for picture, tip in zip(pictures, tips, strict=True)]
    steps = TorchEndRegressor(aligner)(np.ascontiguousarray(np.stack(cut).transpose(0, 3, 1, 2)))
    return move_ends(tips, steps[:, 0], region.refiner_scale)


def errors(tips: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far tips (N, 2, 2) are off: their direction, degrees, and their middle, px."""
    directions = [orientations(xy, (1, 0))[:, 1] for xy in (tips, truth[:, 2:])]
    turn = np.degrees((directions[0] - directions[1] + np.pi) % (2 * np.pi) - np.pi)
    return turn, np.linalg.norm(tips.mean(axis=1) - truth[:, 2:].mean(axis=1), axis=1)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_in_frames_that_were_not_learnt_from_tips_come_to_lie_right(
    film: Film, aligner: EndRegressionNetwork
) -> None:
    assert aligner.pairs == ((2, 3),)
    _, truth, _ = film
    before = [rms(error[OTHERS]) for error in errors(off(truth), truth)]
    after = [rms(error[OTHERS]) for error in errors(aligned(aligner, film, off(truth)), truth)]
    assert before[0] > 1.2
    assert before[1] > 0.8
    assert after[0] < 0.5 * before[0]
    assert after[1] < 0.6 * before[1]


def test_in_other_light_too(aligner: EndRegressionNetwork) -> None:
    other = film_of(other_light=True)
    before, after = (
        rms(errors(tips, other[1])[0]) for tips in (off(other[1]), aligned(aligner, other, off(other[1])))
    )
    assert after < 0.6 * before


def test_noise_in_positions_that_it_learns_from_is_not_all_learnt(film: Film, features: FirstStage) -> None:
    _, truth, _ = film
    noisy = truth + np.random.default_rng(1).normal(0, 0.5, truth.shape)
    noisy[:, :2] = truth[:, :2]
    learnt = learn(film, LEARNT, features, noisy)
    assert learnt is not None
    noise = rms(errors(noisy[:, 2:], truth)[0])
    assert rms(errors(aligned(learnt, film, off(truth)), truth)[0][OTHERS]) < 0.9 * noise


def test_the_same_is_learnt_again(film: Film, aligner: EndRegressionNetwork, features: FirstStage) -> None:
    again = learn(film, LEARNT, features)
    assert again is not None
    tips = off(film[1])
    np.testing.assert_allclose(aligned(again, film, tips), aligned(aligner, film, tips), atol=1e-3)


def test_where_pictures_tell_nothing_the_network_is_left_alone(film: Film, features: FirstStage) -> None:
    pictures, truth, region = film
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 256, picture.shape, dtype=np.uint8) for picture in pictures]
    for blind in (noise, [np.full_like(picture, 90) for picture in pictures]):
        assert learn((blind, truth, region), LEARNT, features) is None


def test_ends_that_rest_or_are_seldom_seen_are_not_learnt(film: Film, features: FirstStage) -> None:
    _, truth, _ = film
    assert learn(film, LEARNT[: LEAST - 1], features) is None
    assert learn(film, LEARNT, features, reference=(1, 2, 3, 0)) is None
    known = np.ones((len(LEARNT), 4), bool)
    known[LEAST - 1 :, 3] = False
    assert learn(film, LEARNT, features, known=known) is None
    resting = truth.copy()
    resting[:, 2:] = truth[0, 2:]
    assert learn(film, LEARNT, features, resting) is None


def test_frames_of_several_sizes_are_learnt_from_together(film: Film, features: FirstStage) -> None:
    """A frame twice as large, and the region's scale half of it: the closer pictures are the same but for blur."""
    pictures, truth, region = film
    large = [np.kron(picture, np.ones((2, 2, 1), np.uint8)) for picture in pictures]
    half = replace(region, frame_wh=(800, 600), refiner_scale=region.refiner_scale / 2)
    mixed = [large[i] if i % 4 else pictures[i] for i in LEARNT]
    videos = ["large" if i % 4 else "small" for i in LEARNT]
    regions = [half if i % 4 else region for i in LEARNT]
    xy = np.stack([2 * truth[i] + 0.5 if i % 4 else truth[i] for i in LEARNT])
    learnt = fit_end_regression(
        mixed, regions, xy, np.ones(xy.shape[:2], bool), REFERENCE, videos, features, 0
    )
    assert learnt is not None
    after = errors(aligned(learnt, film, off(truth)), truth)[0]
    assert rms(after[OTHERS]) < 0.5 * rms(errors(off(truth), truth)[0][OTHERS])
