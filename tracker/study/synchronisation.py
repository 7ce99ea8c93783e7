"""Synchronisation of the log's clock with the video's, with its uncertainty. Never by making a loop small.

A shift between the two looks like hysteresis: a loop is wider by twice the angle's rate times the shift. Onsets in one
signal are detected in `onset.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC
from pathlib import Path

import numpy as np

from ..errors import StudyError
from ..types import FloatArray
from ..video import Video
from .onset import Onset, onset_from_rest, rising_edges
from .pressure_log import PressureLog
from .study_file import SyncSettings
from .trial import Shift

# A shift with a larger uncertainty gets a warning: it widens every interval of hysteresis.
_UNSURE_FRAMES = 2.0


@dataclass(frozen=True)
class Synchronised:
    """The shift, and warnings about it, a line each.

    Attributes
    ----------
    shift : Shift
        The shift and its uncertainty.
    warnings : tuple of str
        A line each.
    """

    shift: Shift
    warnings: tuple[str, ...]


def synchronise(
    settings: SyncSettings,
    log: PressureLog,
    time_s: FloatArray,
    angle_deg: FloatArray,
    video: Path | None,
    where: str,
) -> Synchronised:
    """The shift between the clocks: video time = log time + delay.

    The standard uncertainty combines that of the method (of the event in both signals, or given by the user) and
    that of the log's clock (coarse resolution). It is at least half a frame, because a frame's time defines neither
    the begin nor the end of its exposure.

    Parameters
    ----------
    settings : SyncSettings
        Settings of the study file.
    log : PressureLog
        The log, on its own clock.
    time_s, angle_deg : ndarray of float
        (T,) times and angles of the video, NaN where the angle is missing.
    video : Path or None
        The video file, read only for a lamp.
    where : str
        Begins messages.

    Returns
    -------
    Synchronised
        The shift and its warnings.

    Raises
    ------
    StudyError
        The event is not found, or the settings do not fit the log.
    VideoError
        The video cannot be read.
    """
    warnings: list[str] = []
    if settings.method == "given delay":
        delay_s, sd_s = settings.delay_s or 0.0, 0.0
    elif settings.method == "shared clock":
        delay_s, sd_s = _shared_clock(settings, log, where, warnings), 0.0
    else:
        delay_s, sd_s = _by_event(settings, log, time_s, angle_deg, video, where, warnings)
    frame_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    sd_s = max(float(np.sqrt(sd_s**2 + settings.sd_s**2 + log.time_sd_s**2)), 0.5 * frame_s)
    if sd_s > _UNSURE_FRAMES * frame_s:
        warnings.append(
            f"{settings.method}: the shift is known to {sd_s:.3f} s only, {sd_s / frame_s:.1f} frames"
        )
    return Synchronised(Shift(delay_s, sd_s, settings.method), tuple(warnings))


def led_brightness(
    video: str | Path, region_px: tuple[int, int, int, int], window_s: tuple[float, float] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Times (T,) s of a video's frames and mean brightness (T,), 0 to 255, of a region; NaN where undecodable.

    Parameters
    ----------
    video : str or Path
        The video file.
    region_px : tuple of (int, int, int, int)
        X, y, width and height in px of the frame as displayed.
    window_s : tuple of (float, float) or None, optional
        Only frames within this time window are read.

    Returns
    -------
    time_s : ndarray of float
        (T,) times of the frames, s.
    brightness : ndarray of float
        (T,) mean of the region, 0 to 255; NaN where a frame is undecodable.

    Raises
    ------
    StudyError
        The region does not lie within the frame.
    VideoError
        The video cannot be read.
    """
    source = Video(video)
    x, y, width, height = region_px
    if x + width > source.size_wh[0] or y + height > source.size_wh[1]:
        raise StudyError(
            f"{video}: led_region_px: expected a region in a frame of {source.size_wh[0]} x "
            f"{source.size_wh[1]} px, got {list(region_px)}"
        )
    times, means = [], []
    for frame in source:
        if window_s is not None and frame.time_s < window_s[0]:
            continue
        if window_s is not None and frame.time_s > window_s[1]:
            break
        image = frame.image
        times.append(frame.time_s)
        means.append(np.nan if image is None else float(image[y : y + height, x : x + width].mean()))
    return np.array(times), np.array(means)


def _shared_clock(settings: SyncSettings, log: PressureLog, where: str, warnings: list[str]) -> float:
    if settings.video_start is None:
        if log.started_s is not None:
            warnings.append(
                "shared clock: the log holds dates; its first sample is taken for the video's first frame"
            )
        return 0.0
    if log.started_s is None:
        raise StudyError(f"{where}: video_start needs a log with dates, got one with times from a start")
    start = settings.video_start
    video_s = (start if start.tzinfo else start.replace(tzinfo=UTC)).timestamp()
    return log.started_s - video_s


def _by_event(
    settings: SyncSettings,
    log: PressureLog,
    time_s: FloatArray,
    angle_deg: FloatArray,
    video: Path | None,
    where: str,
    warnings: list[str],
) -> tuple[float, float]:
    in_log = _log_events(settings, log, where)
    in_video = _video_events(settings, time_s, angle_deg, video, where)
    if settings.log_event == "pressure" or settings.video_event == "angle":
        warnings.append(
            "sync event: a movement begins when its cause does; how late the actuator follows counts as shift"
        )
    if len(in_log) != len(in_video):
        warnings.append(
            f"sync event: {len(in_log)} in the log, {len(in_video)} in the video; the first of each is taken"
        )
    pairs = (
        list(zip(in_log, in_video, strict=False))
        if len(in_log) == len(in_video)
        else [(in_log[0], in_video[0])]
    )
    delays = np.array([seen.time_s - logged.time_s for logged, seen in pairs])
    own = np.array([np.hypot(seen.sd_s, logged.sd_s) for logged, seen in pairs])
    sd_s = float(np.sqrt(np.mean(own**2) / len(own)))
    if len(delays) > 1:
        apart = float(np.ptp(delays))
        if apart > 4 * float(own.max()):
            warnings.append(
                f"clock drift: the shift changes by {apart:.4f} s from one sync event to another; their mean is taken"
            )
        sd_s = float(np.hypot(sd_s, np.std(delays, ddof=1)))
    return float(delays.mean()), sd_s


def _log_events(settings: SyncSettings, log: PressureLog, where: str) -> list[Onset]:
    inside = _within(log.time_s, settings.log_window_s)
    if settings.log_event == "pressure":
        return [
            onset_from_rest(log.time_s[inside], log.pressure_kpa[inside], f"{where}: pressure in the log")
        ]
    if log.sync is None:
        raise StudyError(f"{where}: log_event = 'sync' needs a sync column in the log; give sync_column")
    return rising_edges(log.time_s[inside], log.sync[inside], f"{where}: sync column in the log")


def _video_events(
    settings: SyncSettings, time_s: FloatArray, angle_deg: FloatArray, video: Path | None, where: str
) -> list[Onset]:
    if settings.video_event == "angle":
        inside = _within(time_s, settings.video_window_s)
        return [onset_from_rest(time_s[inside], angle_deg[inside], f"{where}: angle in the video")]
    if video is None or settings.led_region_px is None:
        raise StudyError(f"{where}: video_event = 'led' needs the trial's video")
    seen_s, brightness = led_brightness(video, settings.led_region_px, settings.video_window_s)
    return rising_edges(seen_s, brightness, f"{where}: lamp in {video.name}")


def _within(time_s: FloatArray, window_s: tuple[float, float] | None) -> np.ndarray:
    if window_s is None:
        return np.ones(len(time_s), dtype=bool)
    return np.asarray((time_s >= window_s[0]) & (time_s <= window_s[1]))
