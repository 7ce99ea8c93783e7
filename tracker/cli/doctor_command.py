"""The command that says what is there: bendtrack doctor."""

from __future__ import annotations

import os
import platform
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import typer

from ..errors import BendtrackError
from . import console

_PACKAGES = (
    "av",
    "h5py",
    "matplotlib",
    "numpy",
    "opencv-python-headless",
    "openvino",
    "pandas",
    "torch",
    "torchvision",
)
_BACKBONES_SHOWN = ("resnet18", "resnet34", "resnet50")


def doctor() -> None:
    """Check the installation: packages, devices, codecs, networks."""
    import torch

    from ...models.networks.checkpoint import best_device
    from ...models.networks.initialisation import imagenet_file, resolve_init
    from ...models.networks.shipped import actuator_file
    from ...models.training.settings import TrainingSettings
    from .demo_command import sample_folder

    lines: list[tuple[str, str]] = [
        ("bendtrack", f"{version('bendtrack')}, Python {platform.python_version()}, {platform.platform()}"),
        ("packages", ", ".join(f"{name} {_version_of(name)}" for name in _PACKAGES)),
    ]
    device = best_device()
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.processor() or "CPU"
    lines.append(
        ("device", f"{device} ({name}), {torch.get_num_threads()} threads of {os.cpu_count()} cores")
    )
    trouble = []
    for what, check in (("H.264 video", _check_video), ("sample trial", lambda: str(sample_folder()))):
        try:
            lines.append((what, check()))
        except (BendtrackError, OSError, ImportError) as error:
            lines.append((what, f"MISSING: {error}"))
            trouble.append(what)
    for backbone in _BACKBONES_SHOWN:
        path = imagenet_file(backbone)
        lines.append(
            (f"{backbone} weights", f"{'ImageNet' if path.is_file() else 'not on this machine'}, {path}")
        )
    shipped = [backbone for backbone in _BACKBONES_SHOWN if actuator_file(backbone).is_file()]
    lines.append(("actuator weights", f"come with bendtrack for {', '.join(shipped) or 'no backbone'}"))
    settings = TrainingSettings()
    start = resolve_init(settings.init, settings.backbone)
    lines.append(("train would use", f"{settings.backbone} from {start} weights on {device}"))
    width = max(len(what) for what, _ in lines)
    for what, words in lines:
        console.show(f"{what:{width}}  {words}")
    if trouble:
        console.complain(f"not working: {', '.join(trouble)}")
        raise typer.Exit(1)


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "(missing)"


def _check_video() -> str:
    """Write and read back a few frames."""
    import av
    import numpy as np

    from ..video import Video
    from ..video_writer import VideoWriter

    with tempfile.TemporaryDirectory(prefix="bendtrack-doctor-") as folder:
        path = Path(folder) / "test.mp4"
        with VideoWriter(path, (64, 48), 30.0) as writer:
            for level in (0, 120, 240):
                writer.write(np.full((48, 64, 3), level, np.uint8))
        video = Video(path)
        levels = [float(frame.image.mean()) for frame in video if frame.image is not None]
    if len(levels) != 3 or not levels[0] < levels[1] < levels[2]:
        raise BendtrackError(f"three frames were written, {len(levels)} read back")
    codec = av.library_versions.get("libavcodec", ()) if hasattr(av, "library_versions") else ()
    return f"written and read back (libavcodec {'.'.join(map(str, codec)) or 'unknown'}, {sys.platform})"
