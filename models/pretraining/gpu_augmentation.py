"""Photometric augmentation of a whole batch on the training device: occluders, light, colour, blur and noise.

Rendered images come with light and a camera of their own (`tracker.synthetic.stream`); this varies each rendered image
every time that it is used.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ...tracker.types import BoolArray, FloatArray

Rng = np.random.Generator

OCCLUDED_SHARE = 0.4
"""Share of images with an occluder."""

HUE_SHARE, GREY_SHARE = 0.4, 0.05
"""Shares of images whose hues are rotated by any angle, and of images without colour."""

NOISE_SHARE, BLUR_SHARE = 0.25, 0.2
"""Shares of images with added noise, and of images with a 3 x 3 blur."""

_GREY_AXIS = np.full((3, 3), 1 / 3)
_HUE_ROTATION = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]]) / np.sqrt(3)


def occlude_batch(images: Tensor, xy: FloatArray, rng: Rng) -> tuple[Tensor, BoolArray]:
    """Put an ellipse or a box into some of the images, of one colour or cut from another image.

    Parameters
    ----------
    images : (N, 3, side, side) float tensor
    xy : (N, K, 2) float array
        Positions of keypoints, px.
    rng : numpy Generator

    Returns
    -------
    images : (N, 3, side, side) float tensor
    occluded : (N, K) bool array
        Which positions lie under an occluder.
    """
    n, side = len(images), images.shape[-1]
    centre = rng.random((n, 2)) * side
    half = rng.uniform(0.05, 0.2, (n, 2)) * side
    turn, is_box = rng.uniform(0, np.pi, n), rng.random(n) < 0.5
    half *= (rng.random(n) < OCCLUDED_SHARE)[:, None]
    cos, sin = np.cos(turn), np.sin(turn)
    to_shape = (
        np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], -2)
        / np.maximum(half, 1e-6)[..., None]
    )

    local = np.einsum("nij,nkj->nki", to_shape, xy - centre[:, None])
    occluded = np.where(is_box[:, None], np.abs(local).max(axis=2), np.linalg.norm(local, axis=2)) <= 1

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
    return torch.where(mask[:, None], cover, images), occluded


def change_batch(images: Tensor, rng: Rng) -> Tensor:
    """Change colours and light of images, then blur, then add noise, in the order in which a camera applies them.

    Parameters
    ----------
    images : (N, 3, H, W) float tensor
        RGB in [0, 255].
    rng : numpy Generator

    Returns
    -------
    (N, 3, H, W) float tensor
        In [0, 255].
    """
    n, device = len(images), images.device

    def on_device(values: FloatArray) -> Tensor:
        return torch.from_numpy(values.astype(np.float32)).to(device)

    turn = np.where(rng.random(n) < HUE_SHARE, rng.uniform(-np.pi, np.pi, n), rng.normal(0, 0.05, n))[
        :, None, None
    ]
    saturation = np.where(rng.random(n) < GREY_SHARE, 0.0, rng.uniform(0.5, 1.3, n))[:, None, None]
    chroma = np.eye(3) - _GREY_AXIS
    mix = _GREY_AXIS + saturation * (np.cos(turn) * chroma + np.sin(turn) * _HUE_ROTATION)
    gain = np.exp(rng.normal(0, 0.12, (n, 1)) + rng.normal(0, 0.04, (n, 3)))
    shift = rng.normal(0, 0.05, (n, 1)) + rng.normal(0, 0.02, (n, 3))
    gamma = np.exp(rng.normal(0, 0.15, n))
    level = torch.einsum("nij,njhw->nihw", on_device(mix), images / 255).clamp(1e-4, 1)
    level = level ** on_device(gamma)[:, None, None, None]
    level = (level - 0.5) * on_device(gain)[..., None, None] + 0.5 + on_device(shift)[..., None, None]
    blur = torch.from_numpy(rng.random(n) < BLUR_SHARE).to(device)[:, None, None, None]
    kernel = torch.tensor([1.0, 2.0, 1.0], device=device) / 4
    kernel = (kernel[:, None] * kernel).expand(3, 1, 3, 3)
    blurred = F.conv2d(F.pad(level, (1, 1, 1, 1), mode="replicate"), kernel, groups=3)
    level = torch.where(blur, blurred, level)
    sd = np.where(rng.random(n) < NOISE_SHARE, rng.uniform(1, 8, n) / 255, 0.0)
    generator = torch.Generator(device).manual_seed(int(rng.integers(2**31)))
    noise = torch.randn(images.shape, generator=generator, device=device)
    return ((level + noise * on_device(sd)[:, None, None, None]) * 255).clamp(0, 255)
