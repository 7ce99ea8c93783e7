"""What is seen in a patch and in its mirror picture, put together."""

from __future__ import annotations

import numpy as np

from bendtrack.models.inference.tta import FlipAugmentedPredictor
from bendtrack.tracker.types import Detections, ImageArray


class Brightest:
    """Finds the brightest px, each time `off_px` too far down, and believes pictures by their first px."""

    def __init__(self, off_px: float) -> None:
        self.off_px = off_px

    def __call__(self, pictures: ImageArray) -> Detections:
        n, _, _, w = pictures.shape
        row, column = np.divmod(pictures[:, 1].reshape(n, -1).argmax(axis=1), w)
        xy = np.stack([column, row + self.off_px], axis=-1)[:, None].astype(float)
        covariance = np.tile([[4.0, 1.0], [1.0, 2.0]], (n, 1, 1, 1))
        return Detections(xy, pictures[:, 0, 0, :1] / 255, covariance)


def picture(x: int, y: int, top: int = 255, bottom: int = 255) -> ImageArray:
    one = np.zeros((1, 3, 64, 64), np.uint8)
    one[0, 1, y, x] = 255
    one[0, 0, 0, 0], one[0, 0, -1, 0] = top, bottom
    return one


def test_what_is_off_to_one_side_cancels() -> None:
    found = FlipAugmentedPredictor(Brightest(1.5))(np.concatenate([picture(20, 30), picture(40, 5)]))
    np.testing.assert_allclose(found.xy[:, 0], [(20, 30), (40, 5)])
    np.testing.assert_allclose(found.covariance[0, 0], [[4, 0], [0, 2]])


def test_of_two_that_disagree_the_likelier_is_taken() -> None:
    reader = FlipAugmentedPredictor(Brightest(10.0))
    for top, bottom, y in ((250, 50, 40), (50, 250, 20)):
        found = reader(picture(20, 30, top, bottom))
        np.testing.assert_allclose(found.xy[0, 0], (20, y))
        np.testing.assert_allclose(found.likelihood[0, 0], 250 / 255)
