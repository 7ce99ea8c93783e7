"""Pressure at the frames' times: a straight line fitted to the samples of each frame's own time.

A frame shows the mean of its exposure, so the pressure that belongs to it is the mean over about the same time. The
line over one frame interval, centred on the frame, is that mean where samples are even, and is

- exact on a slope, and therefore without delay, however the samples lie (a mean would not be where they are uneven);
- an anti-alias filter with zeros at every multiple of the frame rate, which would alias to a constant error
  (pump ripple at 60 Hz, seen at 30 fps, say), and 1 / sqrt(n) of the noise of n samples (n = 13 at 400 Hz, 30 fps);
- low by (slope x interval / 4) on the one frame that meets a triangle's peak exactly (0.2 kPa at 25 kPa/s), as
  the angle of that frame is; nowhere else.
"""

from __future__ import annotations

import numpy as np

from ..types import FloatArray
from .log_clock import GAP_STEPS

# Number of samples fitted at once, which bounds the memory for a log at 100 kHz.
_BLOCK = 2_000_000


def pressure_at_frames(
    frame_time_s: FloatArray, log_time_s: FloatArray, log_pressure_kpa: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Pressure and its slope at the frames' times.

    Parameters
    ----------
    frame_time_s : ndarray of float
        (T,) rising times, s.
    log_time_s, log_pressure_kpa : ndarray of float
        (M,) rising times on the same clock, s, and kPa; NaN pressures are missing samples.

    Returns
    -------
    pressure_kpa : ndarray of float
        (T,) NaN for frames before or after the log or in a gap of it. Where the log has fewer samples
        than there are frames, or they are uneven, the line goes through the two samples on the frame's sides.
    rate_kpa_s : ndarray of float
        (T,) slope of that pressure from frame to frame, kPa/s.
    """
    known = np.isfinite(log_pressure_kpa)
    log_time_s, log_pressure_kpa = log_time_s[known], log_pressure_kpa[known]
    pressure = np.full(len(frame_time_s), np.nan)
    if len(log_time_s) < 2 or len(frame_time_s) < 2:
        return pressure, pressure.copy()
    interval_s = float(np.median(np.diff(frame_time_s)))
    step_s = float(np.median(np.diff(log_time_s)))
    half_s = max(interval_s / 2, step_s)
    # Samples on the window's edge belong to it, regardless of rounding.
    first = np.searchsorted(log_time_s, frame_time_s - half_s - 1e-9)
    last = np.searchsorted(log_time_s, frame_time_s + half_s + 1e-9)
    width = int((last - first).max())
    if width < 2:
        return pressure, pressure.copy()
    per_block = max(1, _BLOCK // width)
    for begin in range(0, len(frame_time_s), per_block):
        block = slice(begin, begin + per_block)
        index = first[block, None] + np.arange(width)
        inside = index < last[block, None]
        index = np.minimum(index, len(log_time_s) - 1)
        dt = np.where(inside, log_time_s[index] - frame_time_s[block, None], 0.0)
        value = np.where(inside, log_pressure_kpa[index], 0.0)
        n = inside.sum(axis=1)
        # A line must not reach beyond its samples: at an end or next to a gap of the log they lie on one side only.
        before = np.where(inside, dt, np.inf).min(axis=1) <= 1e-9
        after = np.where(inside, dt, -np.inf).max(axis=1) >= -1e-9
        sound = before & after & (n >= 2)
        pressure[block] = np.where(sound, _line_at_zero(dt, value, n), np.nan)
    apart_s = _sides_apart_s(frame_time_s, log_time_s)
    between = np.isnan(pressure) & (apart_s <= max(interval_s, GAP_STEPS * step_s))
    pressure[between] = np.interp(frame_time_s[between], log_time_s, log_pressure_kpa)
    rate = np.full(len(frame_time_s), np.nan)
    for begin, end in _runs(np.isfinite(pressure)):
        if end - begin > 1:
            rate[begin:end] = np.gradient(pressure[begin:end], frame_time_s[begin:end])
    return pressure, rate


def _sides_apart_s(frame_time_s: FloatArray, log_time_s: FloatArray) -> FloatArray:
    """Time (T,) from the last sample before each frame to the first one after it; infinite outside the log."""
    after = np.searchsorted(log_time_s, frame_time_s)
    inside = (after > 0) & (after < len(log_time_s))
    after = np.clip(after, 1, len(log_time_s) - 1)
    return np.where(inside, log_time_s[after] - log_time_s[after - 1], np.inf)


def _line_at_zero(dt: FloatArray, value: FloatArray, n: np.ndarray) -> FloatArray:
    """Height (T,) at 0 of the lines fitted to rows (T, W) of points, n of them in each, the rest 0."""
    count = np.maximum(n, 1)
    mean_t, mean_v = dt.sum(axis=1) / count, value.sum(axis=1) / count
    spread = (dt**2).sum(axis=1) - count * mean_t**2
    together = (dt * value).sum(axis=1) - count * mean_t * mean_v
    slope = np.divide(together, spread, out=np.zeros_like(spread), where=spread > 0)
    return np.asarray(mean_v - slope * mean_t)


def _runs(known: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
