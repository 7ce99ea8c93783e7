"""Writing the scene into video files, with PyAV alone; and reading where in a file its packets lie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from .scene import FRAMES, RATE, SIZE_WH, angle_deg, draw

_AUDIO = {".webm": "libopus", ".avi": "pcm_s16le"}
_TICK = Fraction(1, 90_000)


@dataclass(frozen=True)
class Recipe:
    """How a film is written.

    Attributes
    ----------
    codec : str
        FFmpeg's encoder.
    suffix : str
        Suffix of the file, which chooses the container.
    pix_fmt : str
        FFmpeg's pixel format.
    options : mapping of str to str
        The encoder's.
    container_options : mapping of str to str
        The container's.
    format : str or None
        FFmpeg's name of the container, where the suffix does not say.
    size_wh : tuple of (int, int)
        As stored, px.
    times_s : tuple of float or None
        Presentation times, s; None: `FRAMES` frames at `RATE`.
    rate : Fraction
        Nominal frames/s.
    rotation_deg : int
        Counterclockwise turn that the file asks for, degrees.
    flip : bool
        Whether the file asks for a mirrored picture.
    pixel_aspect : Fraction
        Width over height of a pixel.
    interlaced : {"", "tff", "bff"}
        Which field comes first; empty: progressive.
    is_marked : bool
        Whether the file says that it is interlaced.
    audio : bool
        Whether there is a silent sound track.
    metadata : mapping of str to str
        Of the container.
    """

    codec: str
    suffix: str
    pix_fmt: str = "yuv420p"
    options: Mapping[str, str] = field(default_factory=dict)
    container_options: Mapping[str, str] = field(default_factory=dict)
    format: str | None = None
    size_wh: tuple[int, int] = SIZE_WH
    times_s: tuple[float, ...] | None = None
    rate: Fraction = Fraction(RATE)
    rotation_deg: int = 0
    flip: bool = False
    pixel_aspect: Fraction = Fraction(1)
    interlaced: str = ""
    is_marked: bool = True
    audio: bool = False
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def frame_times_s(self) -> np.ndarray:
        """When each frame is shown, s."""
        if self.times_s is not None:
            return np.array(self.times_s)
        return np.arange(FRAMES) / float(self.rate)


def write(recipe: Recipe, path: Path) -> Path:
    """Encode the scene. The picture at t seconds after the first one shows `scene.angle_deg(t)`."""
    times_s = recipe.frame_times_s
    with av.open(str(path), "w", format=recipe.format, options=dict(recipe.container_options)) as container:
        for key, value in recipe.metadata.items():
            container.metadata[key] = value
        stream = container.add_stream(recipe.codec, rate=recipe.rate, options=dict(recipe.options))
        width, height = recipe.size_wh
        stream.width, stream.height = (height, width) if recipe.rotation_deg % 180 else (width, height)
        stream.pix_fmt = recipe.pix_fmt
        stream.codec_context.thread_count = 1
        if recipe.pixel_aspect != 1:
            stream.codec_context.sample_aspect_ratio = recipe.pixel_aspect
        if recipe.times_s is not None:
            stream.codec_context.time_base = _TICK
        if recipe.rotation_deg or recipe.flip:
            stream.set_display_rotation(recipe.rotation_deg, hflip=recipe.flip)
        sound = container.add_stream(_AUDIO.get(recipe.suffix, "aac"), rate=48_000) if recipe.audio else None
        marked = _FieldOrder(recipe.interlaced)
        for number, image in enumerate(_images(recipe, times_s - times_s[0])):
            frame = av.VideoFrame.from_ndarray(image)
            if recipe.times_s is not None:
                frame.pts, frame.time_base = round(times_s[number] / _TICK), _TICK
            if recipe.pix_fmt != "rgb24":
                frame = frame.reformat(format=recipe.pix_fmt)
            if recipe.times_s is None:
                frame.pts, frame.time_base = number, 1 / recipe.rate
            if recipe.interlaced and recipe.is_marked:
                frame = marked.mark(frame)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
        if sound is not None:
            _add_silence(container, sound, float(times_s[-1] - times_s[0]))
    return path


class _FieldOrder:
    """Marks frames as interlaced, with the filter that FFmpeg has for it."""

    def __init__(self, order: str) -> None:
        self._order = order
        self._graph: av.filter.Graph | None = None

    def mark(self, frame: av.VideoFrame) -> av.VideoFrame:
        if self._graph is None:
            self._graph = av.filter.Graph()
            source = self._graph.add_buffer(
                width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base
            )
            field_order = self._graph.add("setfield", self._order)
            sink = self._graph.add("buffersink")
            source.link_to(field_order)
            field_order.link_to(sink)
            self._graph.configure()
        self._graph.push(frame)
        return self._graph.pull()


def _images(recipe: Recipe, shown_s: np.ndarray) -> Sequence[np.ndarray]:
    options = {"size_wh": recipe.size_wh, "pixel_aspect": float(recipe.pixel_aspect)}
    if not recipe.interlaced:
        drawn = [draw(float(angle_deg(t)), noise_seed=n, **options) for n, t in enumerate(shown_s)]
    else:
        drawn = []
        first = 0 if recipe.interlaced == "tff" else 1
        for t in shown_s:
            image = draw(float(angle_deg(t)), **options)
            later = draw(float(angle_deg(t + 0.5 / float(recipe.rate))), **options)
            image[1 - first :: 2] = later[1 - first :: 2]
            drawn.append(image)
    # Stored turned, so that it is upright once the player has turned and mirrored it.
    if recipe.flip:
        drawn = [image[:, ::-1] for image in drawn]
    return [np.ascontiguousarray(np.rot90(image, -recipe.rotation_deg // 90)) for image in drawn]


def _add_silence(container: av.container.OutputContainer, sound: av.AudioStream, length_s: float) -> None:
    for n in range(int(length_s * 48_000 / 960)):
        silence = av.AudioFrame.from_ndarray(np.zeros((1, 960), np.int16), "s16", "mono")
        silence.sample_rate, silence.pts = 48_000, 960 * n
        container.mux(sound.encode(silence))
    container.mux(sound.encode(None))


def packet_places(path: Path) -> list[tuple[int, int]]:
    """(position, size) in the file of each video packet, in decoding order; those without a position are left out."""
    with av.open(str(path), metadata_errors="replace") as container:
        return [
            (p.pos, p.size) for p in container.demux(video=0) if p.size and p.pos is not None and p.pos >= 0
        ]
