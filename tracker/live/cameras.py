"""Cameras of this machine: listing, choosing, and FFmpeg's options for opening."""

from __future__ import annotations

import re
import stat
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import av

from ..errors import VideoError

# FFmpeg's input for the cameras of a system, and what it calls their pixel format or codec.
_INPUTS = {
    "linux": ("v4l2", "input_format"),
    "darwin": ("avfoundation", "pixel_format"),
    "win32": ("dshow", "vcodec"),
}
# AVFoundation's default, 29.97, is not supported by most cameras.
_DARWIN_RATE = "30"


@dataclass(frozen=True)
class Camera:
    """A camera: its `address` for FFmpeg, and its `name` for users.

    Attributes
    ----------
    address : str
        Address for FFmpeg.
    name : str
        Name for users.
    """

    address: str
    name: str


@dataclass(frozen=True)
class CameraMode:
    """Requested mode of a camera; None leaves the choice to the camera.

    Attributes
    ----------
    size_wh : tuple of (int, int) or None
        Width and height, px.
    rate : float or None
        Frames/s.
    format : str or None
        Pixel format or codec in FFmpeg's spelling: many cameras are fast only in "mjpeg".
    """

    size_wh: tuple[int, int] | None = None
    rate: float | None = None
    format: str | None = None


def cameras() -> list[Camera]:
    """The cameras of this machine, in the order of their numbers.

    Returns
    -------
    list of Camera
        The cameras; none where the system cannot list them.
    """
    format, _ = _input()
    try:
        found = av.enumerate_input_devices(format)
    except (av.FFmpegError, OSError, ValueError):
        return []
    listed = [
        device for device in found if "audio" not in device.media_types or "video" in device.media_types
    ]
    prefix = "video=" if format == "dshow" else ""
    known = [Camera(f"{prefix}{device.name}", device.description or device.name) for device in listed]
    return sorted(known, key=lambda camera: _number(camera.address)) if format == "v4l2" else known


def find_camera(wanted: str | None, among: Sequence[Camera]) -> Camera:
    """The camera with a number, device or name (or a part of its name); None takes the first.

    Parameters
    ----------
    wanted : str or None
        A number, device or (part of a) name; None for the first camera.
    among : sequence of Camera
        The cameras to choose from.

    Returns
    -------
    Camera
        The camera.

    Raises
    ------
    VideoError
        No camera matches, or more than one.
    """
    there = "; ".join(f"{_shown_number(index, camera)}: {camera.name}" for index, camera in enumerate(among))
    got = f"the cameras here are {there}" if among else "no camera was found"
    if wanted is None:
        if not among:
            raise VideoError("expected a camera, a video file or a URL: no camera was found")
        return among[0]
    if wanted.isdecimal():
        matches = [c for index, c in enumerate(among) if _shown_number(index, c) == int(wanted)]
    else:
        matches = [c for c in among if wanted.casefold() in (c.name.casefold(), c.address.casefold())]
        matches = matches or [c for c in among if wanted.casefold() in c.name.casefold()]
    if len(matches) != 1:
        problem = "more than one camera is called so" if matches else "no such camera, video file or URL"
        raise VideoError(f"{wanted}: {problem}; {got}")
    return matches[0]


def is_camera_device(path: str) -> bool:
    """Whether a path is a device of the system, such as /dev/video0.

    Parameters
    ----------
    path : str
        A path.

    Returns
    -------
    bool
        Whether it is a character device.
    """
    try:
        return stat.S_ISCHR(Path(path).stat().st_mode)
    except OSError:
        return False


def opening(mode: CameraMode | None) -> tuple[str, dict[str, str]]:
    """FFmpeg's input and options for a camera in this mode.

    Parameters
    ----------
    mode : CameraMode or None
        Requested mode, None for the camera's own.

    Returns
    -------
    format : str
        FFmpeg's input format.
    options : dict of str to str
        FFmpeg's options.
    """
    format, format_option = _input()
    options = {"framerate": _DARWIN_RATE} if format == "avfoundation" else {}
    if mode is not None:
        if mode.size_wh is not None:
            options["video_size"] = "{}x{}".format(*mode.size_wh)
        if mode.rate is not None:
            options["framerate"] = f"{mode.rate:g}"
        if mode.format is not None:
            options[format_option] = mode.format
    return format, options


def _input() -> tuple[str, str]:
    return _INPUTS.get(sys.platform, _INPUTS["linux"])


def _shown_number(index: int, camera: Camera) -> int:
    """The number of a camera: that of its device on Linux, elsewhere its index in the list."""
    return _number(camera.address) if camera.address.startswith("/dev/video") else index


def _number(address: str) -> int:
    digits = re.search(r"\d+$", address)
    return int(digits.group()) if digits else sys.maxsize
