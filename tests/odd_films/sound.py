"""The catalogue of sound films: every codec in every container that takes it, and every oddity that is no damage."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from .encoding import Recipe, write
from .scene import FRAMES, RATE

_X264 = {"g": "10", "crf": "18", "preset": "ultrafast"}
_SVT = {"preset": "10", "crf": "5", "g": "10", "svtav1-params": "lp=1"}
_X265 = {
    "preset": "ultrafast",
    "crf": "18",
    "g": "10",
    "x265-params": "log-level=none:pools=none:frame-threads=1",
}

CODECS: dict[str, tuple[str, str, dict[str, str]]] = {
    "h264": ("libx264", "yuv420p", _X264 | {"bf": "0"}),
    "h264b": ("libx264", "yuv420p", _X264 | {"bf": "3"}),
    "hevc": ("libx265", "yuv420p", _X265),
    "mpeg4": ("mpeg4", "yuv420p", {"g": "10", "b": "6M"}),
    "mpeg4b": ("mpeg4", "yuv420p", {"g": "10", "bf": "2", "b": "6M"}),
    "mjpeg": ("mjpeg", "yuvj420p", {"b": "12M"}),
    "vp8": ("libvpx", "yuv420p", {"g": "10", "deadline": "realtime", "cpu-used": "5", "b": "2M"}),
    "vp9": ("libvpx-vp9", "yuv420p", {"g": "10", "deadline": "realtime", "cpu-used": "8", "b": "2M"}),
    "av1": ("libsvtav1", "yuv420p", _SVT),
    "ffv1": ("ffv1", "yuv420p", {"level": "3", "slicecrc": "1", "g": "1"}),
    "ffv1g": ("ffv1", "yuv420p", {"level": "3", "g": "10"}),
    "prores": ("prores_ks", "yuv422p10le", {}),
    "huffyuv": ("huffyuv", "yuv422p", {}),
    "ffvhuff": ("ffvhuff", "yuv420p", {}),
    "utvideo": ("utvideo", "yuv420p", {}),
    "rawvideo": ("rawvideo", "yuv420p", {}),
    "mpeg2": ("mpeg2video", "yuv420p", {"g": "10", "b": "6M"}),
    "mpeg1": ("mpeg1video", "yuv420p", {"g": "10", "b": "6M"}),
    "wmv2": ("wmv2", "yuv420p", {"g": "10", "b": "6M"}),
    "msmpeg4": ("msmpeg4", "yuv420p", {"g": "10", "b": "6M"}),
    "flv1": ("flv", "yuv420p", {"g": "10", "b": "6M"}),
    "png": ("png", "rgb24", {}),
    "jpeg2000": ("jpeg2000", "yuv420p", {}),
    "magicyuv": ("magicyuv", "yuv420p", {}),
    "cfhd": ("cfhd", "yuv422p10le", {}),
    "qtrle": ("qtrle", "rgb24", {}),
}

_CONTAINERS: dict[str, tuple[str, ...]] = {
    ".mp4": ("h264", "h264b", "hevc", "mpeg4", "mpeg4b", "mjpeg", "vp9", "av1", "mpeg2"),
    ".mov": ("h264b", "mpeg4", "mjpeg", "prores", "png", "cfhd", "qtrle", "hevc", "jpeg2000"),
    ".mkv": (*("h264", "h264b", "hevc", "mpeg4b", "mjpeg", "vp8", "vp9", "av1", "ffv1", "ffv1g", "mpeg2"),),
    ".webm": ("vp8", "vp9", "av1"),
    ".avi": (
        "h264",
        "h264b",
        "mpeg4",
        "mpeg4b",
        "mjpeg",
        "huffyuv",
        "ffvhuff",
        "utvideo",
        "rawvideo",
        "png",
        "ffv1",
        "magicyuv",
        "msmpeg4",
    ),
    ".ts": ("h264", "h264b", "hevc", "mpeg2", "mpeg4"),
    ".mxf": ("mpeg2", "prores", "h264", "jpeg2000"),
    ".flv": ("h264", "h264b", "flv1"),
    ".wmv": ("wmv2", "msmpeg4"),
    ".mpg": ("mpeg1", "mpeg2"),
    ".3gp": ("h264", "mpeg4"),
    ".nut": ("h264b", "ffv1", "mjpeg"),
    ".ogv": ("vp8",),
    ".ivf": ("vp8", "vp9", "av1"),
    ".h264": ("h264",),
    ".hevc": ("hevc",),
    ".mjpeg": ("mjpeg",),
    ".obu": ("av1",),
    ".m4v": ("mpeg4",),
    ".m2v": ("mpeg2",),
    ".y4m": ("rawvideo",),
}
_FORMATS = {".hevc": "hevc", ".obu": "obu", ".wmv": "asf", ".m4v": "m4v", ".y4m": "yuv4mpegpipe"}
# A title, and what a program that writes the signs of its own land makes of it, in as many bytes.
_LATIN_1 = ("MUELLER versuch", b"M\xfcLLER  versuch")
WITHOUT_TIMES = (".h264", ".hevc", ".mjpeg", ".obu", ".m2v")
"""Elementary streams: times must be said to be counted."""

# Encoders that the containers take only with a tag of their own.
_WRAPPED = {(".y4m", "rawvideo"): "wrapped_avframe"}


def recipe(codec: str, suffix: str) -> Recipe:
    """The plain film of a codec in a container."""
    encoder, pix_fmt, options = CODECS[codec]
    return Recipe(
        _WRAPPED.get((suffix, codec), encoder), suffix, pix_fmt, options=options, format=_FORMATS.get(suffix)
    )


def write_film(name: str, recipe: Recipe, folder: Path) -> Path:
    """Write a sound film into a folder."""
    path = write(recipe, folder / name)
    if recipe.metadata:
        path.write_bytes(path.read_bytes().replace(_LATIN_1[0].encode(), _LATIN_1[1]))
    return path


def sound_films() -> Iterator[tuple[str, Recipe]]:
    """Name and recipe of every sound film."""
    for suffix, codecs in _CONTAINERS.items():
        for codec in codecs:
            yield f"{codec}{suffix}", recipe(codec, suffix)
    yield "gif.gif", Recipe("gif", ".gif", "rgb8", rate=Fraction(25))
    yield (
        "dv.dv",
        Recipe(
            "dvvideo",
            ".dv",
            "yuv420p",
            size_wh=(720, 576),
            pixel_aspect=Fraction(16, 15),
            rate=Fraction(25),
            format="dv",
        ),
    )
    yield from _timed()
    yield from _shaped()
    yield from _contained()


def _timed() -> Iterator[tuple[str, Recipe]]:
    random = np.random.default_rng(5)
    uneven = np.round(np.cumsum(random.uniform(0.008, 0.06, FRAMES)), 3)
    pausing = np.arange(FRAMES) / RATE + 0.0
    pausing[12:] += 0.7
    pausing[20:] += 1.3
    dropped = np.delete(np.arange(FRAMES + 6), [4, 9, 10, 17, 25, 26]) / RATE
    long_last = np.arange(FRAMES) / RATE
    long_last[-1] += 0.5
    slow = np.arange(FRAMES) * 2.0
    times = {
        "uneven": uneven,
        "late": uneven + 3600.0,
        "negative": uneven - 0.5,
        "pauses": pausing,
        "dropped": dropped,
        "long_last": long_last,
        "slow": slow,
    }
    for name, values in times.items():
        for codec, suffix in (
            ("h264b", ".mp4"),
            ("h264", ".mkv"),
            ("vp9", ".webm"),
            ("h264", ".mov"),
            ("h264", ".ts"),
        ):
            if name == "negative" and suffix != ".mkv":
                continue  # MP4 and MOV hide what is before 0 (see `negative_hidden`)
            yield f"{name}_{codec}{suffix}", replace(recipe(codec, suffix), times_s=tuple(values.tolist()))
    yield "ntsc_h264b.mp4", replace(recipe("h264b", ".mp4"), rate=Fraction(30000, 1001))
    yield "fast_h264.mkv", replace(recipe("h264", ".mkv"), rate=Fraction(240))


def _shaped() -> Iterator[tuple[str, Recipe]]:
    plain = recipe("h264b", ".mp4")
    for turn in (90, 180, 270):
        yield f"turned_{turn}.mp4", replace(plain, rotation_deg=turn)
        yield f"turned_{turn}.mov", replace(recipe("mpeg4", ".mov"), rotation_deg=turn)
    yield "mirrored.mp4", replace(plain, flip=True)
    for aspect in (Fraction(16, 11), Fraction(4, 3), Fraction(8, 9), Fraction(1, 2), Fraction(2)):
        name = f"{aspect.numerator}x{aspect.denominator}"
        width = round(160 / float(aspect) / 2) * 2
        yield (
            f"aspect_{name}.mp4",
            replace(plain, pix_fmt="yuv444p", pixel_aspect=aspect, size_wh=(width, 120)),
        )
    yield "aspect.mkv", replace(recipe("h264", ".mkv"), pixel_aspect=Fraction(4, 3), size_wh=(120, 120))
    yield "aspect.mov", replace(recipe("mpeg4", ".mov"), pixel_aspect=Fraction(4, 3), size_wh=(120, 120))
    yield "aspect.mpg", replace(recipe("mpeg2", ".mpg"), pixel_aspect=Fraction(4, 3), size_wh=(240, 180))
    interlaced = {
        "x264.mp4": replace(plain, options=_X264 | {"flags": "+ildct+ilme", "bf": "0"}),
        "x264.mkv": replace(recipe("h264b", ".mkv"), options=_X264 | {"flags": "+ildct+ilme", "bf": "2"}),
        "mpeg2.mpg": replace(recipe("mpeg2", ".mpg"), options={"flags": "+ildct+ilme", "b": "6M", "g": "10"}),
        "mpeg2.ts": replace(recipe("mpeg2", ".ts"), options={"flags": "+ildct+ilme", "b": "6M", "g": "10"}),
        "prores.mov": replace(recipe("prores", ".mov"), options={"flags": "+ildct"}),
        "mpeg4.avi": replace(
            recipe("mpeg4", ".avi"), options={"flags": "+ildct+ilme", "b": "12M", "g": "10"}
        ),
        "ffv1.mkv": recipe("ffv1", ".mkv"),
    }
    for name, base in interlaced.items():
        for order in ("tff", "bff"):
            yield f"interlaced_{order}_{name}", replace(base, interlaced=order, size_wh=(320, 240))
    # Written as if progressive, as many capture programs do.
    unmarked = {
        "x264.mp4": plain,
        "ffv1.mkv": recipe("ffv1", ".mkv"),
        "mjpeg.avi": recipe("mjpeg", ".avi"),
        "prores.mov": recipe("prores", ".mov"),
    }
    for name, base in unmarked.items():
        for order in ("tff", "bff"):
            yield (
                f"unmarked_{order}_{name}",
                replace(base, interlaced=order, is_marked=False, size_wh=(320, 240)),
            )
    yield "odd.mkv", replace(recipe("ffv1", ".mkv"), size_wh=(161, 121), pix_fmt="yuv444p")
    yield "odd.mp4", replace(plain, size_wh=(162, 122))
    yield "tall.mp4", replace(plain, size_wh=(240, 320))
    yield "ten_bit.mp4", replace(recipe("h264", ".mp4"), pix_fmt="yuv420p10le")
    yield "ten_bit_hevc.mp4", replace(recipe("hevc", ".mp4"), pix_fmt="yuv420p10le")
    yield "ten_bit_av1.mkv", replace(recipe("av1", ".mkv"), pix_fmt="yuv420p10le")
    yield "444.mp4", replace(recipe("h264", ".mp4"), pix_fmt="yuv444p")
    yield "422.mkv", replace(recipe("h264", ".mkv"), pix_fmt="yuv422p")
    yield (
        "rgb.mkv",
        Recipe("libx264rgb", ".mkv", "rgb24", options={"g": "10", "preset": "ultrafast", "crf": "15"}),
    )
    yield "sixteen_bit.mkv", replace(recipe("ffv1", ".mkv"), pix_fmt="yuv420p16le")
    yield "alpha_png.mov", replace(recipe("png", ".mov"), pix_fmt="rgba")
    yield (
        "alpha_prores.mov",
        replace(recipe("prores", ".mov"), pix_fmt="yuva444p10le", options={"profile": "4444"}),
    )
    yield (
        "alpha_vp9.webm",
        replace(recipe("vp9", ".webm"), pix_fmt="yuva420p", options=CODECS["vp9"][2] | {"auto-alt-ref": "0"}),
    )
    yield "alpha_utvideo.avi", replace(recipe("utvideo", ".avi"), pix_fmt="gbrap")
    yield "one_frame.mp4", replace(plain, times_s=(0.0,))
    yield "two_frames.mkv", replace(recipe("h264", ".mkv"), times_s=(0.0, 0.1))


def _contained() -> Iterator[tuple[str, Recipe]]:
    plain = recipe("h264b", ".mp4")
    yield "fragmented.mp4", replace(plain, container_options={"movflags": "frag_keyframe+empty_moov"})
    yield "faststart.mp4", replace(plain, container_options={"movflags": "+faststart"})
    for suffix in (".mp4", ".mkv", ".ts", ".mov", ".avi"):
        yield f"audio{suffix}", replace(recipe("h264", suffix), audio=True)
    yield "audio.webm", replace(recipe("vp9", ".webm"), audio=True)
    yield "live.webm", replace(recipe("vp8", ".webm"), container_options={"live": "1"})
    yield "one_group.mp4", replace(plain, options={**_X264, "g": "250"})
    yield "intra_refresh.mp4", replace(plain, options={**_X264, "x264-params": "intra-refresh=1:keyint=12"})
    yield "sliced.mp4", replace(plain, options={**_X264, "x264-params": "slices=4"})
    yield (
        "open_groups.mp4",
        replace(plain, options={**_X264, "bf": "3", "x264-params": "open-gop=1:keyint=10"}),
    )
    yield (
        "lookahead.webm",
        replace(
            recipe("vp8", ".webm"),
            options={"auto-alt-ref": "1", "lag-in-frames": "16", "cpu-used": "5", "b": "2M"},
        ),
    )
    for suffix in (".mp4", ".mkv", ".avi", ".mov", ".flv"):
        codec = "mpeg4" if suffix in (".mp4", ".mov", ".avi") else "h264"
        yield f"latin1_title{suffix}", replace(recipe(codec, suffix), metadata={"title": _LATIN_1[0]})
