"""The overlay video: an angle table drawn on the frames of its video.

Lines, marks and text are in `drawing.py`, the chart in `curve_inset.py`, encoding in `video_writer.py`.

Colours carry one meaning each: blue the fixed end, orange the moving end, yellow the angle (arc, number,
curve), red-orange a doubtful point or a flagged row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from . import drawing
from .angle import end_vector_px
from .curve_inset import CurveInset
from .drawing import DARK, ORANGE, SKY_BLUE, VERMILLION, WHITE, YELLOW
from .errors import ResultsError
from .measuring import MIN_LIKELIHOOD
from .prefetch import read_ahead
from .results import AngleTable
from .types import Flag, FloatArray, ImageArray
from .video import Video
from .video_writer import VideoWriter

_Arrow = tuple[FloatArray, FloatArray, drawing.Colour]  # from, to, colour

_FLAG_TEXT = {
    Flag.PASSED_OVER: "frame dropped: no angle",
    Flag.UNDECODABLE: "frame could not be decoded",
    Flag.COINCIDENT_POINTS: "points coincide: no angle",
    Flag.OUT_OF_FRAME: "point outside the frame: no angle",
    Flag.DAMAGED: "damaged frame: values doubtful",
    Flag.LOW_LIKELIHOOD: "low likelihood",
    Flag.JUMP: "neighbouring frames have another angle",
}


def write_overlay(
    video: str | Path,
    table: AngleTable,
    out_path: str | Path,
    progress: Callable[[int, int | None], None] | None = None,
) -> None:
    """Write a video (H.264 mp4) of the table's points, vectors, angle and curve over the frames.

    Frames keep their times. A frame that cannot be decoded shows the one before it, darkened.

    Parameters
    ----------
    video : str or Path
        The video file.
    table : AngleTable
        The angle table of that video.
    out_path : str or Path
        The mp4 to write or replace.
    progress : callable or None, optional
        Called after each frame with the number of frames done and the number in all.

    Raises
    ------
    VideoError
        The video cannot be read or the overlay cannot be written.
    ResultsError
        The table has another number of rows than the video has frames, or does not say which angle it holds.
    """
    source = Video(video)
    overlay = Overlay(table, source.size_wh)
    count = 0
    with (
        closing(read_ahead(_drawn(source, overlay, len(table)), 4)) as drawn,
        VideoWriter(out_path, source.size_wh, source.frame_rate or 30.0) as writer,
    ):
        for image, time_s in drawn:
            writer.write(image, time_s)
            count += 1
            if progress is not None:
                progress(count, len(table))
        if count < len(table):
            raise ResultsError(f"{video}: expected the {len(table)} frames of the table, got {count}")


def _drawn(source: Video, overlay: Overlay, n_rows: int) -> Iterator[tuple[ImageArray, float]]:
    """Decode, convert and draw in this thread, in parallel with encoding."""
    for frame in source:
        if frame.index >= n_rows:
            raise ResultsError(f"{source.path}: expected the {n_rows} frames of the table, got more")
        yield overlay.draw(frame.image, frame.index), frame.time_s


class Overlay:
    """Draws rows of a table on their frames, one after the other.

    Parameters
    ----------
    table : AngleTable
        Rows to draw; its `definition` must be known.
    size_wh : tuple of (int, int)
        Width and height of the frames, px.

    Raises
    ------
    ResultsError
        The table does not say which angle it holds.
    """

    def __init__(self, table: AngleTable, size_wh: tuple[int, int]) -> None:
        if table.definition is None:
            raise ResultsError(
                "the table does not say which angle it holds: expected the .h5, or the .json next to it"
            )
        self._table, self._definition = table, table.definition
        self._size_wh = size_wh
        # 1 at 640 x 480 and at 480 x 640; marks grow with the frame, and stay readable on a very small one.
        self._scale = max(0.5, min(size_wh) / 480)
        # Points and arrows are slimmer where the two points of an end lie close together.
        length = end_vector_px(table.xy, table.keypoints, table.definition)
        room = 1.0 if np.isnan(length) else float(np.clip(length / (40 * self._scale), 0.65, 1.0))
        self._mark = room * self._scale
        self._letter = max(9, round(14 * self._scale))
        self._chain = [table.keypoints.index(name) for name in table.definition.points]
        self._others = [k for k in range(len(table.keypoints)) if k not in self._chain]
        self._inset = CurveInset(table.time_s, table.angle_deg, table.xy, size_wh, self._scale)
        line = drawing.text_size("0", self._letter)[1]
        self._readout_box = (0.0, 0.0, 12.0 * self._letter, 2.2 * line)
        self._last = np.zeros((size_wh[1], size_wh[0], 3), np.uint8)

    def draw(self, image: ImageArray | None, index: int) -> ImageArray:
        """Frame `index` with everything on it; call for 0, 1, 2, ... in order.

        Parameters
        ----------
        image : ndarray of uint8 or None
            RGB uint8 (H, W, 3), not changed; None for a frame that could not be decoded.
        index : int
            Index of the frame, and of its row in the table.

        Returns
        -------
        ndarray of uint8
            A new image (H, W, 3) with everything drawn on it.
        """
        if image is None:
            canvas = (0.35 * self._last).astype(np.uint8)
        else:
            self._last = image
            canvas = image.copy()
        points = self._table.xy[index, self._chain]
        angle_deg = float(self._table.angle_deg[index])
        arrows = self._arrows(points, self._definition.sign * np.radians(angle_deg))
        self._draw_chain(canvas, points, arrows)
        if np.isfinite(angle_deg) and len(arrows) == 2:
            self._draw_angle(canvas, points, arrows, angle_deg)
        for k in self._chain + self._others:
            self._draw_point(canvas, index, k)
        self._inset.draw(canvas, index)
        self._draw_readout(canvas, index)
        return canvas

    def _draw_chain(self, canvas: ImageArray, points: FloatArray, arrows: list[_Arrow]) -> None:
        """The skeleton, and on it the arrows of the two ends, each with a dark casing."""
        s = self._mark
        known = points[np.isfinite(points).all(axis=1)]
        if len(known) > 1:
            drawing.lines(canvas, known, DARK, 4 * s)
            drawing.lines(canvas, known, (225, 225, 225), 1.6 * s)
        for start, end, colour in arrows:
            shaft, head = drawing.arrow_points(start, end, 3.4 * s)
            drawing.lines(canvas, shaft, DARK, 6.2 * s)
            drawing.lines(canvas, head[[0, 1, 2, 0]], DARK, 2.8 * s)
            drawing.lines(canvas, shaft, colour, 3.4 * s)
            drawing.polygon(canvas, head, colour)

    def _arrows(self, points: FloatArray, sweep: float) -> list[_Arrow]:
        """The arrows of the fixed and the moving end, those that can be drawn.

        `two-vector` and `three-point` compare pieces of the chain. `chord` and `arc-fit` compare tangents:
        they start at the end points, and are as long as the first piece of the chain.
        """
        first = points[1] - points[0]
        if self._definition.name in ("two-vector", "three-point"):
            arrows = [(points[0], points[1], SKY_BLUE), (points[-2], points[-1], ORANGE)]
        else:
            base = float(np.arctan2(first[1], first[0]))
            if self._definition.name == "arc-fit":
                # A circle's tangents are turned against its chord by half of the arc's angle.
                chord = points[-1] - points[0]
                base = float(np.arctan2(chord[1], chord[0])) - sweep / 2
            length = float(np.linalg.norm(first))
            arrows = [
                (point, point + length * np.array([np.cos(turn), np.sin(turn)]), colour)
                for point, turn, colour in ((points[0], base, SKY_BLUE), (points[-1], base + sweep, ORANGE))
            ]
        return [arrow for arrow in arrows if np.linalg.norm(arrow[1] - arrow[0]) > 1e-3]  # not NaN either

    def _draw_angle(
        self, canvas: ImageArray, points: FloatArray, arrows: list[_Arrow], angle_deg: float
    ) -> None:
        """The arc at the moving end, from the fixed end's direction (dashed) to the moving end's; the number."""
        s = self._scale
        (base_start, base_end, _), (centre, tip, _) = arrows
        sweep = self._definition.sign * np.radians(angle_deg)
        forward = base_end - base_start
        start = float(np.arctan2(forward[1], forward[0]))
        length = float(min(np.linalg.norm(forward), np.linalg.norm(tip - centre)))
        radius = float(np.clip(0.62 * length, 32 * s, 64 * s))
        reach = radius + 0.55 * min(radius, 40 * s)
        _dashes(canvas, centre, centre + reach * forward / np.linalg.norm(forward), SKY_BLUE, s)
        if np.linalg.norm(tip - centre) < radius:  # a short end vector is extended to the arc
            _dashes(canvas, tip, centre + reach * (tip - centre) / np.linalg.norm(tip - centre), ORANGE, s)
        arc = centre + drawing.arc_points(radius, start, sweep)
        drawing.sector(canvas, centre, arc, YELLOW, 0.22)
        drawing.lines(canvas, arc, DARK, 4.6 * s)
        drawing.lines(canvas, arc, YELLOW, 2.4 * s)

        label = f"{angle_deg:.1f}°".replace("-", "\N{MINUS SIGN}")
        size = max(11, round(20 * s))
        width, height = drawing.text_size(label, size, bold=True)
        # Outside the arc; next to it, on the outside of the bend, where the arc is too narrow.
        middle, clear = start + sweep / 2, radius + 6 * s
        if abs(sweep) < np.radians(50):
            middle, clear = middle - np.copysign(np.pi / 2, sweep), 14 * s
        x, y = self._label_position(centre, middle, clear, (width, height), points)
        drawing.text(canvas, label, (x, y), size, YELLOW, anchor=(0.5, 0.5), bold=True)

    def _label_position(
        self,
        centre: FloatArray,
        direction_rad: float,
        clear: float,
        wh: tuple[int, int],
        points: FloatArray,
    ) -> tuple[float, float]:
        """Centre of a label near the wanted direction, clear of the frame's edge, the readout, the chart and points."""
        half = np.array(wh) / 2
        best, best_cost = np.zeros(2), np.inf
        for step in (0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6):
            turn = direction_rad + step * np.pi / 6
            along = np.array([np.cos(turn), np.sin(turn)])
            at = centre + (clear + np.hypot(*(half * along))) * along
            inside = np.clip(at, half, np.array(self._size_wh) - half)
            low, high = inside - half, inside + half
            cost = 0.2 * abs(step) + 4 * (np.linalg.norm(inside - at) > 1)
            cost += ((points > low) & (points < high)).all(axis=1).sum()
            for left, top, right, bottom in (self._readout_box, self._inset.box):
                cost += 3 * (low[0] < right and high[0] > left and low[1] < bottom and high[1] > top)
            if cost < best_cost:
                best, best_cost = inside, cost
        return float(best[0]), float(best[1])

    def _draw_point(self, canvas: ImageArray, index: int, k: int) -> None:
        """A point, filled by its likelihood, and its 2-sd ellipse where that is larger than the point."""
        s = self._mark
        centre = self._table.xy[index, k]
        if not np.isfinite(centre).all():
            return
        likelihood = float(np.nan_to_num(self._table.likelihood[index, k]))
        colour = VERMILLION if likelihood < MIN_LIKELIHOOD else WHITE
        radius = 5.6 * s
        ellipse = _ellipse_points(self._table.covariance[index, k])
        if ellipse is not None and np.abs(ellipse).max() > 1.1 * radius:
            drawing.lines(canvas, centre + ellipse, DARK, 3.2 * s)
            drawing.lines(canvas, centre + ellipse, colour, 1.4 * s)
        drawing.disc(canvas, centre, radius, DARK)
        drawing.disc(canvas, centre, (radius - 1.3 * s) * np.sqrt(max(likelihood, 0.1)), colour)

    def _draw_readout(self, canvas: ImageArray, index: int) -> None:
        """Time, frame, uncertainty and, on a separate bar, the row's flag."""
        s = self._scale
        size = self._letter
        left, top = 10 * s, 7 * s
        _, line = drawing.text(canvas, f"{self._table.time_s[index]:.2f} s", (left, top), size, bold=True)
        line_2 = f"frame {index}"
        sd_deg = self._table.angle_sd_deg[index]
        if np.isfinite(sd_deg):
            line_2 += f"   sd {sd_deg:.1f}°"
        drawing.text(canvas, line_2, (left, top + 0.95 * line), size, (230, 230, 230))
        flag = str(self._table.flag[index])
        if flag:
            known = flag in set(Flag)
            message = _FLAG_TEXT.get(Flag(flag), flag) if known else flag
            if flag == Flag.LOW_LIKELIHOOD and np.isnan(self._table.angle_deg[index]):
                message = "points not found: no angle"
            width, height = drawing.text_size(message, size, bold=True)
            x, y, pad = round(left), round(top + 2.05 * line), round(5 * s)
            bar = np.full((height + pad // 2, width + 2 * pad), 255, np.uint8)
            drawing.shade(canvas, bar, VERMILLION, x, y, 0.92)
            drawing.text(canvas, message, (x + pad, y + pad // 4), size, DARK, bold=True, halo=False)


def _dashes(
    canvas: ImageArray, start: FloatArray, end: FloatArray, colour: drawing.Colour, scale: float
) -> None:
    length = float(np.linalg.norm(end - start))
    count = max(2, round(length / (7 * scale)))
    for n in range(count):
        piece = start + np.array([[n], [n + 0.55]]) / count * (end - start)
        drawing.lines(canvas, piece, DARK, 3.4 * scale)
        drawing.lines(canvas, piece, colour, 1.6 * scale)


def _ellipse_points(covariance: FloatArray) -> FloatArray | None:
    """Outline (N, 2) of the 2-sd ellipse of a position, around (0, 0)."""
    if not np.isfinite(covariance).all():
        return None
    variances, axes = np.linalg.eigh(covariance)
    radii = 2 * np.sqrt(np.maximum(variances, 0))
    turn = np.linspace(0, 2 * np.pi, 40)
    return (np.stack([np.cos(turn), np.sin(turn)], axis=1) * radii) @ axes.T
