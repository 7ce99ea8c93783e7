"""Hand-made maps: decoding returns the position put in, and the losses are least there."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from bendtrack.models.networks.heatmap_network import STRIDE, Maps
from bendtrack.models.networks.heatmaps import cell_centres, cell_loss, decode, heatmap_loss


def exact_maps(xy: np.ndarray, h: int = 12, w: int = 16, sd_px: float = 0.5) -> Maps:
    """Maps of one picture that say exactly `xy` (K, 2), with a peak of about 0.9."""
    k = len(xy)
    cx, cy = cell_centres(h, w, torch.device("cpu"))
    point = torch.tensor(xy, dtype=torch.float32)
    dx = point[:, 0, None, None] - cx[None, None, :].expand(k, h, w)
    dy = point[:, 1, None, None] - cy[None, :, None].expand(k, h, w)
    p = 0.9 * torch.exp(-(dx**2 + dy**2) / (2 * (1.25 * STRIDE) ** 2)) + 1e-4
    spread = torch.zeros(k, 3, h, w)
    spread[:, :2] = np.log(sd_px)
    return Maps(torch.logit(p)[None], torch.stack([dx, dy], dim=1)[None], spread[None])


@pytest.mark.parametrize("xy", [(20.3, 17.8), (1.5, 1.5), (0.0, 0.0), (61.9, 46.2), (63.4, 47.4)])
def test_decoding_returns_the_maps_position_up_to_the_border(xy: tuple[float, float]) -> None:
    found = decode(exact_maps(np.array([xy])))
    np.testing.assert_allclose(found.xy[0, 0].numpy(), xy, atol=1e-3)
    assert 0.5 < found.likelihood.item() < 0.91
    np.testing.assert_allclose(found.covariance[0, 0].numpy(), np.eye(2) * 0.25, atol=1e-4)


def test_shifting_the_maps_by_a_cell_shifts_the_position_by_the_stride() -> None:
    first = decode(exact_maps(np.array([[20.3, 17.8]]))).xy
    second = decode(exact_maps(np.array([[20.3 + STRIDE, 17.8]]))).xy
    np.testing.assert_allclose((second - first)[0, 0].numpy(), [STRIDE, 0], atol=1e-3)


def test_several_positions_are_peaks_apart_the_likeliest_first() -> None:
    one, other = np.array([[20.3, 17.8], [8.0, 40.0]]), np.array([[50.2, 30.1], [40.0, 8.0]])
    first, second = exact_maps(one), exact_maps(other)
    nearer = (first.offset.norm(dim=2, keepdim=True) < second.offset.norm(dim=2, keepdim=True)).float()
    both = Maps(
        torch.logit((first.heat.sigmoid() + 0.5 * second.heat.sigmoid()).clamp(max=0.99)),
        nearer * first.offset + (1 - nearer) * second.offset,
        first.spread,
    )
    found = decode(both, peaks=2)
    np.testing.assert_allclose(found.xy[0].numpy(), np.stack([one, other], axis=1).reshape(4, 2), atol=0.05)
    likelihood = found.likelihood[0].numpy()
    np.testing.assert_allclose(likelihood[1::2] / likelihood[::2], 0.5, atol=0.1)
    np.testing.assert_array_equal(decode(both).xy[0].numpy(), found.xy[0, ::2].numpy())
    assert found.covariance.shape == (1, 4, 2, 2)


def test_an_empty_heatmap_has_a_low_likelihood() -> None:
    maps = exact_maps(np.array([[20.0, 20.0]]))._replace(heat=torch.full((1, 1, 12, 16), -6.0))
    assert decode(maps).likelihood.item() < 0.01


def loss(maps: Maps, xy: np.ndarray, known: bool = True, present: bool = True) -> dict[str, float]:
    shape = (1, len(xy))
    parts = heatmap_loss(
        maps,
        torch.tensor(xy, dtype=torch.float32)[None],
        torch.full(shape, known),
        torch.full(shape, present),
    )
    return {name: value.item() for name, value in parts.items()}


def test_offset_loss_is_zero_at_the_truth_and_grows_away_from_it() -> None:
    xy = np.array([[20.3, 17.8]])
    maps = exact_maps(xy)
    assert loss(maps, xy)["offset"] == pytest.approx(0.0, abs=1e-9)
    near, far = (loss(maps, xy + d)["offset"] for d in (0.5, 2.0))
    assert 0 < near < far
    assert loss(maps, xy)["heat"] < loss(maps, xy + 8)["heat"]


def test_an_error_weighs_more_in_the_certain_direction() -> None:
    """A spread that is four times as long along (3, 4) as across: errors count two times and half as much."""
    xy = np.array([[20.3, 17.8]])
    along = np.array([0.6, 0.8])
    across = np.array([-0.8, 0.6])
    cov = 4.0 * np.outer(along, along) + 0.25 * np.outer(across, across)
    maps, round_ = exact_maps(xy), exact_maps(xy)
    sx, sy = np.sqrt(np.diag(cov))
    maps.spread[:, :, 0], maps.spread[:, :, 1] = np.log(sx), np.log(sy)
    maps.spread[:, :, 2] = np.arctanh(cov[0, 1] / (sx * sy) / 0.95)
    small = 0.1  # px: where the loss grows with the square
    as_before = loss(round_, xy + small * along)["offset"]
    assert loss(round_, xy + small * across)["offset"] == pytest.approx(as_before, rel=0.02)
    # The bump moves by the error too, which changes the weights a little.
    assert loss(maps, xy + small * along)["offset"] == pytest.approx(as_before / 4, rel=0.02)
    assert loss(maps, xy + small * across)["offset"] == pytest.approx(as_before * 4, rel=0.02)


def test_an_unlabelled_keypoint_has_no_loss_and_no_gradient() -> None:
    maps = Maps(*(part.requires_grad_() for part in exact_maps(np.array([[20.0, 20.0]]))))
    parts = heatmap_loss(
        maps, torch.zeros(1, 1, 2), torch.zeros(1, 1, dtype=torch.bool), torch.ones(1, 1, dtype=torch.bool)
    )
    total = sum(parts.values())
    assert total.item() == 0.0
    total.backward()
    assert all(float(part.grad.abs().max()) == 0.0 for part in maps)


def test_an_occluded_keypoint_needs_an_empty_heatmap_and_has_no_offset_loss() -> None:
    xy = np.array([[20.0, 20.0]])
    full = exact_maps(xy)
    empty = full._replace(heat=torch.full_like(full.heat, -9.0))
    assert loss(empty, xy, present=False)["heat"] < 1e-3 < loss(full, xy, present=False)["heat"]
    assert loss(full, xy + 3, present=False)["offset"] == 0.0


def test_spread_loss_is_least_at_the_residuals_own_size() -> None:
    xy = np.array([[20.3, 17.8]])
    off = 1.2
    costs = {
        sd: loss(exact_maps(xy, sd_px=sd), xy + np.array([off, 0.0]))["spread"] for sd in (0.3, 0.85, 3.0)
    }
    assert costs[0.85] < costs[0.3]
    # However far off, claiming less spread never pays.
    assert (
        loss(exact_maps(xy, sd_px=0.1), xy + 5.0)["spread"]
        > loss(exact_maps(xy, sd_px=0.3), xy + 5.0)["spread"]
    )
    assert costs[0.85] < costs[3.0]


def test_cell_loss_is_least_at_the_truth_and_zero_for_invisible_keypoints() -> None:
    xy = torch.tensor([[[20.3, 17.8]]])
    yes, no = torch.tensor([[True]]), torch.tensor([[False]])
    maps = exact_maps(np.array([[20.3, 17.8]]))
    at_truth = cell_loss(maps, xy, yes, yes).item()
    assert cell_loss(exact_maps(np.array([[28.3, 17.8]])), xy, yes, yes).item() > at_truth + 1
    # A choice: heat that is higher everywhere chooses the same.
    lifted = maps._replace(heat=maps.heat + 3.0)
    assert cell_loss(lifted, xy, yes, yes).item() == pytest.approx(at_truth, rel=1e-5)
    assert cell_loss(maps, xy, no, yes).item() == 0
    assert cell_loss(maps, xy, yes, no).item() == 0
