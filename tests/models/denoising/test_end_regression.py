"""The end-pose regressor, fitted on some rendered frames and evaluated on others with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bendtrack.models.denoising.end_regression import fit_end_regression
from bendtrack.models.denoising.registration import MIN_FRAMES
from bendtrack.models.inference.crops import crop_end, move_ends
from bendtrack.models.inference.roi import RegionOfInterest, orientations, regions_of_interest
from bendtrack.models.networks.end_regressor import EndRegressionNetwork, TorchEndRegressor
from bendtrack.models.networks.heatmap_network import FirstStage
from bendtrack.tracker.synthetic.stream import (
    KEYPOINTS,
    TRAINING,
    Renderer,
    drawn_look,
    in_other_light,
    inflation_deg,
)

FRAMES = 24
FITTED, OTHERS = np.arange(0, FRAMES, 2), np.arange(1, FRAMES, 2)
REFERENCE = (1, 0, 3, 2)
ENDS = [KEYPOINTS.index(name) for name in ("base_1", "base_2", "tip_1", "tip_2")]
SIZE_WH = (400, 300)

Film = tuple[list[np.ndarray], np.ndarray, RegionOfInterest]


def film_of(other_light: bool) -> Film:
    """Frames of one actuator while it bends, where its ends are, (N, 4, 2) px, and the working region."""
    look = drawn_look(21, 3, size_wh=SIZE_WH, families=TRAINING, bend_deg=(0.0, 150.0))
    renderer = Renderer(in_other_light(look, 5) if other_light else look)
    samples = [
        renderer.frame(float(bend), noise_seed=i) for i, bend in enumerate(inflation_deg(look, FRAMES))
    ]
    truth = np.stack([sample.keypoints_xy[ENDS] for sample in samples])
    (region,) = regions_of_interest(truth, [SIZE_WH] * FRAMES)
    return [sample.image for sample in samples], truth, region


@pytest.fixture(scope="module")
def film() -> Film:
    return film_of(other_light=False)


def fit(
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
def regressor(film: Film, features: FirstStage) -> EndRegressionNetwork:
    fitted = fit(film, FITTED, features)
    assert fitted is not None
    return fitted


def perturbed(truth: np.ndarray) -> np.ndarray:
    """Tips (N, 2, 2) px, shifted and turned by chance."""
    rng = np.random.default_rng(3)
    steps = rng.normal(size=(len(truth), 3)) * (1.5, 1.5, 0.035)
    return move_ends(truth[:, 2:], steps, 1.0)


def corrected(regressor: EndRegressionNetwork, film: Film, tips: np.ndarray) -> np.ndarray:
    pictures, _, region = film
    cut = [crop_end(picture, tip, region).image for picture, tip in zip(pictures, tips, strict=True)]
    steps = TorchEndRegressor(regressor)(np.ascontiguousarray(np.stack(cut).transpose(0, 3, 1, 2)))
    return move_ends(tips, steps[:, 0], region.refiner_scale)


def errors(tips: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far tips (N, 2, 2) are off: their direction, degrees, and their middle, px."""
    directions = [orientations(xy, (1, 0))[:, 1] for xy in (tips, truth[:, 2:])]
    turn = np.degrees((directions[0] - directions[1] + np.pi) % (2 * np.pi) - np.pi)
    return turn, np.linalg.norm(tips.mean(axis=1) - truth[:, 2:].mean(axis=1), axis=1)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_tip_poses_improve_in_frames_that_it_was_not_fitted_on(
    film: Film, regressor: EndRegressionNetwork
) -> None:
    assert regressor.pairs == ((2, 3),)
    _, truth, _ = film
    before = [rms(error[OTHERS]) for error in errors(perturbed(truth), truth)]
    after = [rms(error[OTHERS]) for error in errors(corrected(regressor, film, perturbed(truth)), truth)]
    assert before[0] > 1.2
    assert before[1] > 0.8
    assert after[0] < 0.5 * before[0]
    assert after[1] < 0.6 * before[1]


def test_tip_poses_improve_in_other_light(regressor: EndRegressionNetwork) -> None:
    other = film_of(other_light=True)
    before, after = (
        rms(errors(tips, other[1])[0])
        for tips in (perturbed(other[1]), corrected(regressor, other, perturbed(other[1])))
    )
    assert after < 0.6 * before


def test_noise_of_the_training_positions_is_averaged_out(film: Film, features: FirstStage) -> None:
    _, truth, _ = film
    noisy = truth + np.random.default_rng(1).normal(0, 0.5, truth.shape)
    noisy[:, :2] = truth[:, :2]
    fitted = fit(film, FITTED, features, noisy)
    assert fitted is not None
    noise = rms(errors(noisy[:, 2:], truth)[0])
    assert rms(errors(corrected(fitted, film, perturbed(truth)), truth)[0][OTHERS]) < 0.9 * noise


def test_fitting_is_reproducible(film: Film, regressor: EndRegressionNetwork, features: FirstStage) -> None:
    again = fit(film, FITTED, features)
    assert again is not None
    tips = perturbed(film[1])
    np.testing.assert_allclose(corrected(again, film, tips), corrected(regressor, film, tips), atol=1e-3)


def test_images_without_information_give_no_regressor(film: Film, features: FirstStage) -> None:
    pictures, truth, region = film
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 256, picture.shape, dtype=np.uint8) for picture in pictures]
    for blind in (noise, [np.full_like(picture, 90) for picture in pictures]):
        assert fit((blind, truth, region), FITTED, features) is None


def test_ends_at_rest_or_in_too_few_frames_give_no_regressor(film: Film, features: FirstStage) -> None:
    _, truth, _ = film
    assert fit(film, FITTED[: MIN_FRAMES - 1], features) is None
    assert fit(film, FITTED, features, reference=(1, 2, 3, 0)) is None
    known = np.ones((len(FITTED), 4), bool)
    known[MIN_FRAMES - 1 :, 3] = False
    assert fit(film, FITTED, features, known=known) is None
    resting = truth.copy()
    resting[:, 2:] = truth[0, 2:]
    assert fit(film, FITTED, features, resting) is None


def test_frames_of_several_sizes_are_fitted_together(film: Film, features: FirstStage) -> None:
    """A frame twice as large, and the region's scale half of it: the closer pictures are the same but for blur."""
    pictures, truth, region = film
    large = [np.kron(picture, np.ones((2, 2, 1), np.uint8)) for picture in pictures]
    half = replace(region, frame_wh=(800, 600), refiner_scale=region.refiner_scale / 2)
    mixed = [large[i] if i % 4 else pictures[i] for i in FITTED]
    videos = ["large" if i % 4 else "small" for i in FITTED]
    regions = [half if i % 4 else region for i in FITTED]
    xy = np.stack([2 * truth[i] + 0.5 if i % 4 else truth[i] for i in FITTED])
    fitted = fit_end_regression(
        mixed, regions, xy, np.ones(xy.shape[:2], bool), REFERENCE, videos, features, 0
    )
    assert fitted is not None
    after = errors(corrected(fitted, film, perturbed(truth)), truth)[0]
    assert rms(after[OTHERS]) < 0.5 * rms(errors(perturbed(truth), truth)[0][OTHERS])
