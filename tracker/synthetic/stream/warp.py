"""Warps a body's texture along the midline into the image, exactly for every px.

What the texture shows is drawn in `body_texture.py`; the layers are blended in `renderer.py`."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...types import FloatArray
from .body_texture import INNER, OUTER, BodyTexture
from .chain import SEGMENTS, Chain, Projection

# From this turn on the tip's half may come over the base's half.
_OVERLAP_DEG = 110.0
_FAR = -1000.0


@dataclass(frozen=True)
class Layer:
    """A part of the image that is blended over it.

    Attributes
    ----------
    x0, y0 : int
        Its top left pixel.
    rgba : ndarray
        (h, w, 4) uint8, premultiplied.
    """

    x0: int
    y0: int
    rgba: NDArray[np.uint8]


def _quads(chain: Chain, projection: Projection, s0: float) -> FloatArray:
    """Corners of what each piece of the midline can cover, (P, 4, 2) px of the image."""
    line, inward = (
        np.concatenate([chain.origin, chain.end_xy[None]]),
        chain.inward[[*range(len(chain.s)), -1]],
    )
    # The body begins under the clamp and may reach a little beyond its end.
    line[0] += s0 * chain.along[0]
    line[-1] += 3 * chain.along[-1]
    half = chain.half_px_at(np.append(chain.s, chain.length_px))[:, None]
    inner = projection.to_image(line + INNER * half * inward)
    outer = projection.to_image(line - OUTER * half * inward)
    return np.stack([inner[:-1], inner[1:], outer[1:], outer[:-1]], axis=1)


def warped(
    texture: BodyTexture,
    chain: Chain,
    projection: Projection,
    size_wh: tuple[int, int],
    tip_over: bool,
    fine: int = 2,
) -> tuple[Layer | None, Layer | None]:
    """The body as layers of the image, the hinder half and the front half.

    Parameters
    ----------
    tip_over : bool
        Whether the tip's half is the one in front.
    fine : int
        Samples a px, in x and in y.

    Returns
    -------
    behind, front : `behind` is None where one layer holds the whole body, both where it is out of the image
    """
    quads = _quads(chain, projection, texture.s0)
    low = np.maximum(np.floor(quads.min(axis=(0, 1))).astype(int) - 1, 0)
    high = np.minimum(np.ceil(quads.max(axis=(0, 1))).astype(int) + 2, size_wh)
    if (high <= low).any():
        return None, None
    # Samples lie at (i + 0.5) / fine - 0.5 of a px.
    corners = np.round(((quads - low + 0.5) * fine - 0.5) * 16).astype(np.int32)
    box = (int(high[1] - low[1]) * fine, int(high[0] - low[0]) * fine)
    everything = range(SEGMENTS + 2)
    # A line that turns back on itself in the middle of an S overlaps nothing, but to look is cheap.
    if np.ptp(np.degrees(chain.heading)) < _OVERLAP_DEG:
        return None, _warped_pieces(texture, chain, projection, corners, everything, box, low, fine, None)
    half = SEGMENTS // 2 + 1
    cut = float(chain.s[half])
    base = _warped_pieces(
        texture, chain, projection, corners, range(half + 1), box, low, fine, (-np.inf, cut)
    )
    tip = _warped_pieces(
        texture, chain, projection, corners, range(half - 1, SEGMENTS + 2), box, low, fine, (cut, np.inf)
    )
    return (base, tip) if tip_over else (tip, base)


def _warped_pieces(
    texture: BodyTexture,
    chain: Chain,
    projection: Projection,
    corners: NDArray[np.int32],
    pieces: range,
    box: tuple[int, int],
    low: NDArray[np.int_],
    fine: int,
    span: tuple[float, float] | None,
) -> Layer:
    owner = np.zeros(box, np.uint8)
    for piece in pieces:
        cv2.fillConvexPoly(owner, corners[piece], piece + 1, cv2.LINE_8, 4)
    index = np.flatnonzero(owner)
    rgba = np.zeros((*box, 4), np.uint8)
    if len(index):
        rows, columns = np.divmod(index.astype(np.int32), np.int32(box[1]))
        x, y = projection.to_plane(
            (columns.astype(np.float32) + 0.5) * np.float32(1 / fine) + np.float32(low[0] - 0.5),
            (rows.astype(np.float32) + 0.5) * np.float32(1 / fine) + np.float32(low[1] - 0.5),
        )
        s, t = chain.body_coordinates(x, y, owner.ravel().take(index).astype(np.intp) - 1)
        taken = (s - np.float32(texture.s0)) * np.float32(texture.per_px)
        across = np.asarray(t / chain.half_px_at(s), np.float32)
        v = (across + np.float32(INNER)) * np.float32(texture.per_half)
        if span is not None:
            taken = np.where((s >= span[0]) & (s < span[1]), taken, np.float32(_FAR))
        # The four bytes of a px move as one number.
        rgba.view(np.uint32).ravel()[index] = _looked_up(texture.rgba, taken, v)
    if fine == 1:
        return Layer(int(low[0]), int(low[1]), rgba)
    size = (box[1] // fine, box[0] // fine)
    return Layer(int(low[0]), int(low[1]), cv2.resize(rgba, size, interpolation=cv2.INTER_AREA))


def _looked_up(texture: NDArray[np.uint8], u: FloatArray, v: FloatArray) -> NDArray[np.uint32]:
    """Texture at a list of places, its four bytes as one number, (N,); OpenCV wants the places as an image."""
    wide = 256
    room = -(-len(u) // wide) * wide
    maps = np.empty((2, room), np.float32)
    maps[0, : len(u)], maps[1, : len(v)] = u, v
    maps[:, len(u) :] = _FAR
    found = cv2.remap(
        texture, maps[0].reshape(-1, wide), maps[1].reshape(-1, wide), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=(0, 0, 0, 0),
    )  # fmt: skip
    result: NDArray[np.uint32] = found.view(np.uint32).ravel()[: len(u)]
    return result
