"""The search in the whole frame for a keypoint that the region of interest does not show, with a stand-in network."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from bendtrack.models.inference.crops import CropGeometry
from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.models.networks.cascade import Cascade
from bendtrack.models.networks.heatmap_network import STRIDE, Maps


class ColourNetwork(torch.nn.Module):
    """Heatmaps that peak at a red and at a blue spot, where there is one: a network whose output is known."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(1))

    def forward(self, images: torch.Tensor) -> Maps:
        pixels = images.float()
        red, blue = pixels[:, 0] - pixels[:, 2], pixels[:, 2] - pixels[:, 0]
        seen = torch.nn.functional.max_pool2d(torch.stack([red, blue], dim=1), STRIDE)
        heat = torch.where(seen > 100, 3.0, -6.0)
        n, _, h, w = heat.shape
        return Maps(heat, torch.zeros(n, 2, 2, h, w), torch.zeros(n, 2, 3, h, w))


@pytest.fixture
def cascade() -> Cascade:
    cascade = Cascade("resnet18", 2)
    cascade.locator = cascade.refiner = ColourNetwork()
    return cascade


def frame(red_xy: tuple[int, int], blue_xy: tuple[int, int]) -> np.ndarray:
    image = np.full((240, 320, 3), 120, np.uint8)
    for (x, y), colour in ((red_xy, (255, 0, 0)), (blue_xy, (0, 0, 255))):
        image[y - 3 : y + 4, x - 3 : x + 4] = colour
    return image


GEOMETRY = CropGeometry(RegionOfInterest((320, 240), 20, 20, 140, 140, 1.0, 1.0), reference=(1, 0))


def test_a_keypoint_outside_the_region_is_found_in_the_whole_frame(cascade: Cascade) -> None:
    found = cascade.detect(frame((60, 60), (280, 200))[None], GEOMETRY)
    np.testing.assert_allclose(found.xy[0], [[60, 60], [280, 200]], atol=3)
    assert found.likelihood.min() > 0.9


def test_a_keypoint_inside_the_region_needs_no_search_in_the_whole_frame(cascade: Cascade) -> None:
    shapes: list[tuple[int, ...]] = []
    cascade.locator.register_forward_hook(lambda module, given, out: shapes.append(tuple(given[0].shape)))
    image = frame((60, 60), (120, 100))
    # The same colour outside the region does not matter.
    image[200:210, 290:300] = (0, 0, 255)
    found = cascade.detect(np.stack([image, image]), GEOMETRY)
    np.testing.assert_allclose(found.xy[1], [[60, 60], [120, 100]], atol=3)
    assert {shape[-1] for shape in shapes} <= {160, 64}


def test_a_keypoint_that_is_not_in_the_frame_is_unlikely(cascade: Cascade) -> None:
    image = frame((60, 60), (120, 100))
    image[90:110, 110:130] = 120
    found = cascade.detect(image[None], GEOMETRY)
    assert found.likelihood[0, 0] > 0.9
    assert found.likelihood[0, 1] < 0.1
    assert np.isfinite(found.xy).all()
