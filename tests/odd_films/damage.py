"""The catalogue of damaged films: bytes cut off, flipped, zeroed, lost, in the picture data and around it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from .encoding import packet_places

Damage = Callable[[bytearray, list[tuple[int, int]], np.random.Generator], bytearray]
"""Bytes of a file, (position, size) of its packets, and where chance comes from -> the damaged bytes."""


def _cut(fraction: float) -> Damage:
    return lambda data, places, random: data[: int(len(data) * fraction)]


def _flip_bits(n_packets: int, n_bits: int) -> Damage:
    """Bits inside packets, behind the headers."""

    def damage(data: bytearray, places: list[tuple[int, int]], random: np.random.Generator) -> bytearray:
        usable = [place for place in places if place[1] > 24]
        for which in random.choice(len(usable), min(n_packets, len(usable)), replace=False):
            position, size = usable[int(which)]
            for offset in random.integers(min(14, size // 2), size, n_bits):
                data[position + int(offset)] ^= 1 << int(random.integers(8))
        return data

    return damage


def _garbage(data: bytearray, places: list[tuple[int, int]], random: np.random.Generator) -> bytearray:
    """The second half of a packet becomes noise."""
    position, size = places[int(random.integers(2, len(places) - 2))]
    data[position + size // 2 : position + size] = random.bytes(size - size // 2)
    return data


def _hole(data: bytearray, places: list[tuple[int, int]], random: np.random.Generator) -> bytearray:
    """Zeroes from the middle of a packet into the next but one: their headers are gone."""
    which = int(random.integers(3, len(places) - 5))
    (start, size), (end, end_size) = places[which], places[which + 2]
    data[start + size // 2 : end + end_size // 2] = bytes(end + end_size // 2 - start - size // 2)
    return data


def _lost(data: bytearray, places: list[tuple[int, int]], random: np.random.Generator) -> bytearray:
    """A packet with what is in front of it is missing from the file: a lost block of a disk."""
    ordered = sorted(places)
    which = int(random.integers(3, len(ordered) - 3))
    begin = ordered[which - 1][0] + ordered[which - 1][1]
    end = ordered[which][0] + ordered[which][1]
    del data[begin:end]
    return data


def _zeroed_chunk(data: bytearray, places: list[tuple[int, int]], random: np.random.Generator) -> bytearray:
    """A packet and its header become zeroes; the rest stays where it is."""
    ordered = sorted(places)
    which = int(random.integers(3, len(ordered) - 3))
    begin = ordered[which - 1][0] + ordered[which - 1][1]
    end = ordered[which][0] + ordered[which][1]
    data[begin:end] = bytes(end - begin)
    return data


def _anywhere(n_bytes: int) -> Damage:
    """Bytes anywhere but in the first 5 %: headers and indices too."""

    def damage(data: bytearray, places: list[tuple[int, int]], random: np.random.Generator) -> bytearray:
        for at in random.integers(len(data) // 20, len(data), n_bytes):
            data[int(at)] = int(random.integers(256))
        return data

    return damage


DAMAGES: dict[str, Damage] = {
    "cut_99": _cut(0.99),
    "cut_90": _cut(0.9),
    "cut_50": _cut(0.5),
    "flip_1": _flip_bits(1, 1),
    "flip_few": _flip_bits(2, 4),
    "flip_many": _flip_bits(6, 8),
    "garbage": _garbage,
    "hole": _hole,
    "lost": _lost,
    "zeroed": _zeroed_chunk,
    "anywhere": _anywhere(6),
}

WITHOUT_CHANCE = ("cut_99", "cut_90", "cut_50")

BASES: tuple[tuple[str, str], ...] = (
    *(
        ("h264", ".mp4"),
        ("h264b", ".mp4"),
        ("h264", ".mkv"),
        ("h264", ".avi"),
        ("h264", ".ts"),
        ("h264b", ".flv"),
    ),
    *(
        ("hevc", ".mp4"),
        ("hevc", ".ts"),
        ("mpeg4", ".avi"),
        ("mpeg4", ".mp4"),
        ("mjpeg", ".avi"),
        ("mjpeg", ".mov"),
    ),
    *(
        ("vp8", ".webm"),
        ("vp9", ".webm"),
        ("vp9", ".mp4"),
        ("av1", ".mkv"),
        ("av1", ".mp4"),
        ("ffv1", ".mkv"),
    ),
    *(("ffv1g", ".mkv"), ("huffyuv", ".avi"), ("prores", ".mov"), ("rawvideo", ".avi"), ("mpeg2", ".mxf")),
    *(("mpeg2", ".mpg"), ("wmv2", ".wmv"), ("mjpeg", ".mjpeg"), ("hevc", ".mkv")),
)
"""(codec, container) of the films that are damaged."""


def damaged(whole: Path, out: Path, name: str, seed: int) -> Path:
    """Write a damaged copy of a film.

    Parameters
    ----------
    whole : Path
        The sound film.
    out : Path
        The copy.
    name : str
        One of `DAMAGES`.
    seed : int
        Of chance.
    """
    data, random = bytearray(whole.read_bytes()), np.random.default_rng(seed)
    out.write_bytes(DAMAGES[name](data, packet_places(whole), random))
    return out


def damaged_films() -> Iterator[tuple[str, str, str]]:
    """(codec, container, damage) of every damaged film; bases in the outer loop."""
    for codec, suffix in BASES:
        for name in DAMAGES:
            # An elementary stream without one of its pictures is a sound stream.
            if (suffix, name) != (".mjpeg", "lost"):
                yield codec, suffix, name
