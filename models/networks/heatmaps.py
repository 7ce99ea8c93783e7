"""Losses on the network's maps (training), and their decoding to positions (inference), in input px.

Decoding averages: every cell around the peak predicts the keypoint's position by its offset, and the mean weighted by
heat scatters far less than the arg-max cell's prediction.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .heatmap_network import STRIDE, Maps

HEAT_SD_CELLS = 1.25
"""Standard deviation of the target Gaussian, cells. A narrower one leaves too few cells with a gradient; a wider one
merges neighbouring marks."""

VOTE_RADIUS_CELLS = 2
"""Cells to each side of the peak that are averaged in decoding, and whose offsets are trained."""

_FAR_DISTANCE2 = 50.0
"""Squared Mahalanobis distance beyond which the spread loss grows linearly with the distance."""


class Decoded(NamedTuple):
    """Positions decoded from maps.

    Attributes
    ----------
    xy : (N, K, 2) tensor
        Input px.
    likelihood : (N, K) tensor
        Height of the heatmap's peak, 0 to 1.
    covariance : (N, K, 2, 2) tensor
        Input px squared.
    """

    xy: Tensor
    likelihood: Tensor
    covariance: Tensor


def cell_centres(h: int, w: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """x (w,) and y (h,) of the centres of h x w cells in input px; (0, 0) is the centre of the first pixel."""
    centre = (STRIDE - 1) / 2
    return (
        torch.arange(w, device=device, dtype=torch.float32) * STRIDE + centre,
        torch.arange(h, device=device, dtype=torch.float32) * STRIDE + centre,
    )


def heatmap_loss(maps: Maps, xy: Tensor, known: Tensor, present: Tensor) -> dict[str, Tensor]:
    """Losses of maps against positions.

    Parameters
    ----------
    maps : Maps
    xy : (N, K, 2) tensor
        Positions of the keypoints, input px.
    known : (N, K) bool tensor
        False where the keypoint is not labelled: it has no loss at all.
    present : (N, K) bool tensor
        False where the keypoint is known not to be visible (occluded, outside): its heatmap must be empty, and its
        offsets have no loss.

    Returns
    -------
    dict from str to scalar tensor
        "heat": penalty-reduced focal loss (Law & Deng 2018, eq. 1). "offset": Huber loss, in cells, of residuals
        whitened by `_whitened`. "spread": Gaussian negative log likelihood of the residuals, without gradient to them.
    """
    n, k, h, w = maps.heat.shape
    dx, dy = _offsets_to(maps, xy)
    visible = (known & present)[..., None, None]
    distance2 = _cells2(dx, dy)
    distance2 = torch.where(visible, distance2, torch.full_like(distance2, 1e9))
    target = _target(distance2)

    log_p, log_q = F.logsigmoid(maps.heat), F.logsigmoid(-maps.heat)
    # Focal weight on a soft target: the squared difference of a cell's probability from the target.
    p = maps.heat.sigmoid()
    heat = -(target * log_p + (1 - target) * log_q) * (target - p).abs().detach() ** 2
    heat = (heat * known[..., None, None]).sum() / known.sum().clamp(min=1)

    reach = (VOTE_RADIUS_CELLS + 0.5) ** 2
    near = (distance2 <= reach).float()
    weight = near * target
    total = weight.sum().clamp(min=1e-6)
    residual = maps.offset - torch.stack([dx.expand(n, k, h, w), dy.expand(n, k, h, w)], dim=2)
    whitened = _whitened(residual, maps.spread.detach()) / STRIDE
    size = F.huber_loss(whitened, torch.zeros_like(whitened), reduction="none", delta=0.5).sum(dim=2)
    offset = (torch.where(weight > 0, size, torch.zeros_like(size)) * weight).sum() / total
    nll = _gaussian_nll(residual.detach(), maps.spread)
    spread = (torch.where(weight > 0, nll, torch.zeros_like(nll)) * weight).sum() / total
    return {"heat": heat, "offset": offset, "spread": spread}


def cell_loss(maps: Maps, xy: Tensor, known: Tensor, present: Tensor) -> Tensor:
    """Cross-entropy of the cell that holds each visible keypoint, with the softmax of the heat over all cells.

    Its gradient does not depend on the number of cells. That helps in pretraining on endlessly many looks; on thirty
    frames the focal loss suffices. Parameters and target are those of `heatmap_loss`.
    """
    dx, dy = _offsets_to(maps, xy)
    target = _target(_cells2(dx, dy)).flatten(2)
    target = target / target.sum(dim=2, keepdim=True).clamp(min=1e-6)
    visible = (known & present).float()
    entropy = -(target * maps.heat.flatten(2).log_softmax(dim=2)).sum(dim=2)
    return (entropy * visible).sum() / visible.sum().clamp(min=1)


def _offsets_to(maps: Maps, xy: Tensor) -> tuple[Tensor, Tensor]:
    """Offsets from the cells' centres to keypoints (N, K, 2): x (N, K, 1, w) and y (N, K, h, 1), input px."""
    h, w = maps.heat.shape[2:]
    cx, cy = cell_centres(h, w, maps.heat.device)
    return xy[..., 0, None, None] - cx[None, None, None, :], xy[..., 1, None, None] - cy[None, None, :, None]


def _cells2(dx: Tensor, dy: Tensor) -> Tensor:
    """Squared distances in cells, from offsets in input px."""
    return (dx**2 + dy**2) / STRIDE**2


def _target(distance2: Tensor) -> Tensor:
    """Target of the heat at squared distances, in cells, from a keypoint."""
    return torch.exp(-distance2 / (2 * HEAT_SD_CELLS**2))


def _gaussian_nll(residual: Tensor, spread: Tensor) -> Tensor:
    """-log N(residual; 0, covariance of spread) without the constant, (N, K, h, w) from (N, K, 2 | 3, h, w)."""
    log_sx, log_sy, rho = _spread_parts(spread)
    zx, zy = residual[:, :, 0] * torch.exp(-log_sx), residual[:, :, 1] * torch.exp(-log_sy)
    one = 1 - rho**2
    mahalanobis = (zx**2 - 2 * rho * zx * zy + zy**2) / one
    # A residual of many sd early in training must not blow up the step: beyond the limit the loss grows with the
    # distance, no longer with its square. It must keep growing, or the spread would shrink where it is most wrong.
    far = 2 * (_FAR_DISTANCE2 * mahalanobis.clamp(min=_FAR_DISTANCE2)).sqrt() - _FAR_DISTANCE2
    mahalanobis = torch.where(mahalanobis < _FAR_DISTANCE2, mahalanobis, far)
    return 0.5 * mahalanobis + log_sx + log_sy + 0.5 * torch.log(one)


def _whitened(residual: Tensor, spread: Tensor) -> Tensor:
    """Residuals (N, K, 2, h, w) times det(C)^(1/4) C^(-1/2), C the covariance of spread (N, K, 3, h, w).

    Their size is kept overall, but each direction is weighted by its certainty. A keypoint along the body is uncertain
    along the midline; that error would otherwise hide the one across it, which decides an end's direction.
    """
    log_sx, log_sy, rho = _spread_parts(spread)
    sx, sy = torch.exp(log_sx), torch.exp(log_sy)
    xx, xy, yy = sx**2, rho * sx * sy, sy**2
    root = sx * sy * torch.sqrt(1 - rho**2)
    # The square root of a 2 x 2 matrix C is (C + sqrt(det C)) / sqrt(trace C + 2 sqrt(det C)).
    scale = torch.rsqrt((xx + yy + 2 * root) * root)
    x, y = residual[:, :, 0], residual[:, :, 1]
    return torch.stack([((yy + root) * x - xy * y) * scale, ((xx + root) * y - xy * x) * scale], dim=2)


def _spread_parts(spread: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    log_s = spread[:, :, :2].clamp(-4.0, 4.0)
    rho = 0.95 * torch.tanh(spread[:, :, 2])
    return log_s[:, :, 0], log_s[:, :, 1], rho


def decode(maps: Maps, peaks: int = 1) -> Decoded:
    """Decode positions from maps.

    Parameters
    ----------
    maps : Maps
        Of K keypoints.
    peaks : int
        M, candidate peaks for each keypoint.

    Returns
    -------
    Decoded
        Of K M positions: a keypoint's candidates are next to each other, the most likely first.
    """
    n, k, h, w = maps.heat.shape
    p = maps.heat.sigmoid()
    if peaks == 1:
        likelihood, peak = p.flatten(2).max(dim=2)
    else:
        highest = F.max_pool2d(p, 2 * VOTE_RADIUS_CELLS + 1, stride=1, padding=VOTE_RADIUS_CELLS)
        maxima = torch.where(p == highest, p, torch.zeros_like(p)).flatten(2)
        likelihood, peak = (part.flatten(1) for part in maxima.topk(peaks, dim=2))
        maps = Maps(*(part.repeat_interleave(peaks, dim=1) for part in maps))
        k *= peaks
    row, col = peak // w, peak % w
    r = VOTE_RADIUS_CELLS
    step = torch.arange(-r, r + 1, device=p.device)
    rows = row[..., None] + step
    cols = col[..., None] + step
    inside = ((rows >= 0) & (rows < h))[..., :, None] & ((cols >= 0) & (cols < w))[..., None, :]
    index = (rows.clamp(0, h - 1)[..., :, None] * w + cols.clamp(0, w - 1)[..., None, :]).flatten(2)
    near = (step[:, None] ** 2 + step[None, :] ** 2 <= (r + 0.5) ** 2) & inside
    heat = F.logsigmoid(maps.heat).flatten(2).gather(2, index)
    votes = heat.masked_fill(~near.flatten(2), -torch.inf).softmax(dim=2)

    cx, cy = cell_centres(h, w, p.device)
    centre = torch.stack([cx[index % w], cy[index // w]], dim=2)
    predicted = maps.offset.flatten(3).gather(3, index[:, :, None].expand(-1, -1, 2, -1)) + centre
    xy = (predicted * votes[:, :, None]).sum(dim=3)

    spread = maps.spread.flatten(3).gather(3, index[:, :, None].expand(-1, -1, 3, -1))
    log_sx, log_sy, rho = _spread_parts(spread)
    sx, sy = torch.exp(log_sx), torch.exp(log_sy)
    entries = torch.stack([sx**2, rho * sx * sy, rho * sx * sy, sy**2], dim=2)
    covariance = (entries * votes[:, :, None]).sum(dim=3).reshape(n, k, 2, 2)
    return Decoded(xy, likelihood, covariance)
