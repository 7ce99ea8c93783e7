"""Mirrored prediction: errors to one side cancel, and of two distant predictions the likelier is taken."""

from __future__ import annotations

import numpy as np

from bendtrack.models.denoising.mirroring import MirroredPredictor, average_predictions
from bendtrack.tracker.types import Detections, ImageArray


class BrightestPredictor:
    """Predicts `off_px` below the brightest px; the likelihood is the first px."""

    def __init__(self, off_px: float) -> None:
        self.off_px = off_px

    def __call__(self, images: ImageArray) -> Detections:
        n, _, _, w = images.shape
        row, column = np.divmod(images[:, 1].reshape(n, -1).argmax(axis=1), w)
        xy = np.stack([column, row + self.off_px], axis=-1)[:, None].astype(float)
        covariance = np.tile([[4.0, 1.0], [1.0, 2.0]], (n, 1, 1, 1))
        return Detections(xy, images[:, 0, 0, :1] / 255, covariance)


def image_of(x: int, y: int, top: int = 255, bottom: int = 255) -> ImageArray:
    one = np.zeros((1, 3, 64, 64), np.uint8)
    one[0, 1, y, x] = 255
    one[0, 0, 0, 0], one[0, 0, -1, 0] = top, bottom
    return one


def test_errors_to_one_side_cancel() -> None:
    found = MirroredPredictor(BrightestPredictor(1.5))(np.concatenate([image_of(20, 30), image_of(40, 5)]))
    np.testing.assert_allclose(found.xy[:, 0], [(20, 30), (40, 5)])
    np.testing.assert_allclose(found.covariance[0, 0], [[4, 0], [0, 2]])


def test_of_two_distant_predictions_the_likelier_is_taken() -> None:
    predictor = MirroredPredictor(BrightestPredictor(10.0))
    for top, bottom, y in ((250, 50, 40), (50, 250, 20)):
        found = predictor(image_of(20, 30, top, bottom))
        np.testing.assert_allclose(found.xy[0, 0], (20, y))
        np.testing.assert_allclose(found.likelihood[0, 0], 250 / 255)


def test_average_of_two_predictions_is_their_mean_or_the_likelier() -> None:
    one, other = (
        Detections(np.full((1, 2, 2), x), np.array([[0.8, 0.4]]), np.full((1, 2, 2, 2), x))
        for x in (10.0, 13.0)
    )
    both = average_predictions(one, other)
    np.testing.assert_array_equal(both.xy, np.full((1, 2, 2), 11.5))
    far = Detections(other.xy + 20.0, np.array([[0.5, 0.6]]), other.covariance)
    both = average_predictions(one, far)
    np.testing.assert_array_equal(both.xy[0, :, 0], [10.0, 33.0])
    np.testing.assert_array_equal(both.likelihood, [[0.8, 0.6]])
    np.testing.assert_array_equal(both.covariance[0, :, 0, 0], [10.0, 13.0])
