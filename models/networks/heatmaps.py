"""What the network's maps should be (training) and what positions they say (decoding), in input px.

Decoding is a vote: the cells around the peak each say where the keypoint lies, and the mean of what they say,
weighted by their heat, is far steadier than the arg-max cell's own word.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .heatmap_network import STRIDE, Maps

HEAT_SD_CELLS = 1.25
"""Standard deviation of the target bump in cells. Narrower starves the heat of gradient, wider melts marks together."""

VOTE_RADIUS_CELLS = 2
"""Cells to each side of the peak that vote, and within whose reach offsets are trained."""


_FAR_DISTANCE2 = 50.0
"""Squared Mahalanobis distance beyond which a residual's cost grows linearly."""


class Decoded(NamedTuple):
    """Positions read from maps. xy (N, K, 2) input px, likelihood (N, K), covariance (N, K, 2, 2) px^2."""

    xy: Tensor
    likelihood: Tensor
    covariance: Tensor


def cell_centres(h: int, w: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """x (w,) and y (h,) of the cells' centres in input px, (0, 0) the centre of the first pixel."""
    centre = (STRIDE - 1) / 2
    return (
        torch.arange(w, device=device, dtype=torch.float32) * STRIDE + centre,
        torch.arange(h, device=device, dtype=torch.float32) * STRIDE + centre,
    )


def heatmap_loss(maps: Maps, xy: Tensor, known: Tensor, present: Tensor) -> dict[str, Tensor]:
    """Losses of maps against positions.

    Parameters
    ----------
    xy : (N, K, 2) input px of the keypoints
    known : (N, K) bool; False where nobody labelled the keypoint: no loss there at all
    present : (N, K) bool; False where it is known that the keypoint cannot be seen (occluded, outside): the
        heatmap must be empty, the offsets are not judged

    Returns
    -------
    dict with scalar tensors: heat (penalty-reduced focal loss, Law & Deng 2018 eq. 1), offset (Huber, in cells, of
    residuals that are `_evened`), spread (Gaussian negative log likelihood of the offsets' residuals, which are held
    fixed)
    """
    n, k, h, w = maps.heat.shape
    dx, dy = _steps(maps, xy)
    seen = (known & present)[..., None, None]
    distance2 = _cells2(dx, dy)
    distance2 = torch.where(seen, distance2, torch.full_like(distance2, 1e9))
    target = _bump(distance2)

    log_p, log_q = F.logsigmoid(maps.heat), F.logsigmoid(-maps.heat)
    # Focal weights on a soft target: a cell is pushed by how far its probability is from the bump's height.
    p = maps.heat.sigmoid()
    heat = -(target * log_p + (1 - target) * log_q) * (target - p).abs().detach() ** 2
    heat = (heat * known[..., None, None]).sum() / known.sum().clamp(min=1)

    reach = (VOTE_RADIUS_CELLS + 0.5) ** 2
    near = (distance2 <= reach).float()
    weight = near * target
    total = weight.sum().clamp(min=1e-6)
    residual = maps.offset - torch.stack([dx.expand(n, k, h, w), dy.expand(n, k, h, w)], dim=2)
    evened = _evened(residual, maps.spread.detach()) / STRIDE
    size = F.huber_loss(evened, torch.zeros_like(evened), reduction="none", delta=0.5).sum(dim=2)
    offset = (torch.where(weight > 0, size, torch.zeros_like(size)) * weight).sum() / total
    nll = _gaussian_nll(residual.detach(), maps.spread)
    spread = (torch.where(weight > 0, nll, torch.zeros_like(nll)) * weight).sum() / total
    return {"heat": heat, "offset": offset, "spread": spread}


def cell_loss(maps: Maps, xy: Tensor, known: Tensor, present: Tensor) -> Tensor:
    """Cross-entropy of which cell holds each keypoint that can be seen, the heat taken as a choice among all cells.

    Parameters and target bump as in `heatmap_loss`. A choice has a steady gradient however many cells there are, which
    helps where looks are endless; for thirty frames the focal loss does.
    """
    dx, dy = _steps(maps, xy)
    target = _bump(_cells2(dx, dy)).flatten(2)
    target = target / target.sum(dim=2, keepdim=True).clamp(min=1e-6)
    seen = (known & present).float()
    entropy = -(target * maps.heat.flatten(2).log_softmax(dim=2)).sum(dim=2)
    return (entropy * seen).sum() / seen.sum().clamp(min=1)


def _steps(maps: Maps, xy: Tensor) -> tuple[Tensor, Tensor]:
    """From the cells' centres to keypoints (N, K, 2): x (N, K, 1, w) and y (N, K, h, 1) input px."""
    h, w = maps.heat.shape[2:]
    cx, cy = cell_centres(h, w, maps.heat.device)
    return xy[..., 0, None, None] - cx[None, None, None, :], xy[..., 1, None, None] - cy[None, None, :, None]


def _cells2(dx: Tensor, dy: Tensor) -> Tensor:
    """Squared distances in cells, from steps in input px."""
    return (dx**2 + dy**2) / STRIDE**2


def _bump(distance2: Tensor) -> Tensor:
    """What the heat should be, at squared distances in cells from a keypoint."""
    return torch.exp(-distance2 / (2 * HEAT_SD_CELLS**2))


def _gaussian_nll(residual: Tensor, spread: Tensor) -> Tensor:
    """-log N(residual; 0, covariance of spread) without the constant, (N, K, h, w) from (N, K, 2 | 3, h, w)."""
    log_sx, log_sy, rho = _spread_parts(spread)
    zx, zy = residual[:, :, 0] * torch.exp(-log_sx), residual[:, :, 1] * torch.exp(-log_sy)
    one = 1 - rho**2
    mahalanobis = (zx**2 - 2 * rho * zx * zy + zy**2) / one
    # A residual of many sd early in training must not blow the step up: beyond the limit the cost grows with the
    # distance, no longer with its square. It must go on growing, or the spread would shrink where it is most wrong.
    far = 2 * (_FAR_DISTANCE2 * mahalanobis.clamp(min=_FAR_DISTANCE2)).sqrt() - _FAR_DISTANCE2
    mahalanobis = torch.where(mahalanobis < _FAR_DISTANCE2, mahalanobis, far)
    return 0.5 * mahalanobis + log_sx + log_sy + 0.5 * torch.log(one)


def _evened(residual: Tensor, spread: Tensor) -> Tensor:
    """Residuals (N, K, 2, h, w) times det(C)^(1/4) C^(-1/2), C the covariance of spread (N, K, 3, h, w).

    They are as large in all, but each direction counts by how sure one can be in it.

    A point along the body may lie here or there; what it says of its distance from the midline, and with that of an
    end's direction, would otherwise be drowned.
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
    """Read positions from the maps: one for each keypoint, or as many, the likeliest first.

    Parameters
    ----------
    peaks : M positions for each keypoint, those of one keypoint next to each other: K is K M in what is returned
    """
    n, k, h, w = maps.heat.shape
    p = maps.heat.sigmoid()
    if peaks == 1:
        likelihood, peak = p.flatten(2).max(dim=2)
    else:
        highest = F.max_pool2d(p, 2 * VOTE_RADIUS_CELLS + 1, stride=1, padding=VOTE_RADIUS_CELLS)
        apart = torch.where(p == highest, p, torch.zeros_like(p)).flatten(2)
        likelihood, peak = (part.flatten(1) for part in apart.topk(peaks, dim=2))
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
    said = maps.offset.flatten(3).gather(3, index[:, :, None].expand(-1, -1, 2, -1)) + centre
    xy = (said * votes[:, :, None]).sum(dim=3)

    spread = maps.spread.flatten(3).gather(3, index[:, :, None].expand(-1, -1, 3, -1))
    log_sx, log_sy, rho = _spread_parts(spread)
    sx, sy = torch.exp(log_sx), torch.exp(log_sy)
    entries = torch.stack([sx**2, rho * sx * sy, rho * sx * sy, sy**2], dim=2)
    covariance = (entries * votes[:, :, None]).sum(dim=3).reshape(n, k, 2, 2)
    return Decoded(xy, likelihood, covariance)
