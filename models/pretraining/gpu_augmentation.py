"""Random changes to a whole batch of training pictures at once, where they lie: something in the way, another light,
other colours, noise and blur. The stream has a camera and lamps of its own; here one picture becomes many.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ...tracker.types import BoolArray, FloatArray

Rng = np.random.Generator

COVERED = 0.4
"""Share of pictures in which something lies in the way."""

RECOLOURED, GREY = 0.4, 0.05
"""Shares of pictures in which all hues are turned, and which have none."""

NOISY, SOFT = 0.25, 0.2

_GREY_AXIS = np.full((3, 3), 1 / 3)
_ACROSS = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]]) / np.sqrt(3)


def covered(images: Tensor, xy: FloatArray, rng: Rng) -> tuple[Tensor, BoolArray]:
    """Put an ellipse or a box in the way in some of the pictures, of one colour or cut from another picture.

    Parameters
    ----------
    images : (N, 3, side, side) float
    xy : (N, K, 2) px

    Returns
    -------
    The pictures, and which positions are hidden, (N, K).
    """
    n, side = len(images), images.shape[-1]
    centre = rng.random((n, 2)) * side
    half = rng.uniform(0.05, 0.2, (n, 2)) * side
    turn, is_box = rng.uniform(0, np.pi, n), rng.random(n) < 0.5
    half *= (rng.random(n) < COVERED)[:, None]
    cos, sin = np.cos(turn), np.sin(turn)
    to_shape = (
        np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], -2)
        / np.maximum(half, 1e-6)[..., None]
    )

    local = np.einsum("nij,nkj->nki", to_shape, xy - centre[:, None])
    hidden = np.where(is_box[:, None], np.abs(local).max(axis=2), np.linalg.norm(local, axis=2)) <= 1

    device = images.device
    step = torch.arange(side, device=device, dtype=torch.float32)
    grid = torch.stack(torch.meshgrid(step, step, indexing="xy"), dim=-1)
    turned, middle = (torch.from_numpy(part.astype(np.float32)).to(device) for part in (to_shape, centre))
    at = torch.einsum("nij,nhwj->nhwi", turned, grid - middle[:, None, None])
    box = torch.from_numpy(is_box).to(device)[:, None, None]
    mask = torch.where(box, at.abs().amax(dim=3), at.norm(dim=3)) <= 1
    colour = rng.uniform(0, 255, (n, 3, 1, 1)).astype(np.float32)
    plain = torch.from_numpy(rng.random(n) < 0.5).to(device)[:, None, None, None]
    cover = torch.where(plain, torch.from_numpy(colour).to(device), images.roll(1, dims=0))
    return torch.where(mask[:, None], cover, images), hidden


def changed(images: Tensor, rng: Rng) -> Tensor:
    """Other colours and light, blur, then noise, in the order in which a camera applies them; in [0, 255]."""
    n, device = len(images), images.device

    def there(values: FloatArray) -> Tensor:
        return torch.from_numpy(values.astype(np.float32)).to(device)

    turn = np.where(rng.random(n) < RECOLOURED, rng.uniform(-np.pi, np.pi, n), rng.normal(0, 0.05, n))[
        :, None, None
    ]
    saturation = np.where(rng.random(n) < GREY, 0.0, rng.uniform(0.5, 1.3, n))[:, None, None]
    about = np.eye(3) - _GREY_AXIS
    mix = _GREY_AXIS + saturation * (np.cos(turn) * about + np.sin(turn) * _ACROSS)
    gain = np.exp(rng.normal(0, 0.12, (n, 1)) + rng.normal(0, 0.04, (n, 3)))
    shift = rng.normal(0, 0.05, (n, 1)) + rng.normal(0, 0.02, (n, 3))
    gamma = np.exp(rng.normal(0, 0.15, n))
    level = torch.einsum("nij,njhw->nihw", there(mix), images / 255).clamp(1e-4, 1)
    level = level ** there(gamma)[:, None, None, None]
    level = (level - 0.5) * there(gain)[..., None, None] + 0.5 + there(shift)[..., None, None]
    soft = torch.from_numpy(rng.random(n) < SOFT).to(device)[:, None, None, None]
    kernel = torch.tensor([1.0, 2.0, 1.0], device=device) / 4
    kernel = (kernel[:, None] * kernel).expand(3, 1, 3, 3)
    blurred = F.conv2d(F.pad(level, (1, 1, 1, 1), mode="replicate"), kernel, groups=3)
    level = torch.where(soft, blurred, level)
    sd = np.where(rng.random(n) < NOISY, rng.uniform(1, 8, n) / 255, 0.0)
    generator = torch.Generator(device).manual_seed(int(rng.integers(2**31)))
    noise = torch.randn(images.shape, generator=generator, device=device)
    return ((level + noise * there(sd)[:, None, None, None]) * 255).clamp(0, 255)
