"""A network made ready to track with: which engine, on which device, compiled first where that was not done yet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import BendtrackError
from . import talk

if TYPE_CHECKING:
    from ...models.detector import NetworkDetector


def load_network(
    folder: Path, engine: str = "auto", device: str = "auto", threads: int | None = None
) -> NetworkDetector:
    """A network ready to track with; compiled first where that was not done yet and can be."""
    from ...models.compiled import ENGINES, engine_record
    from ...models.detector import CHOICES, DEVICES, NetworkDetector
    from ...models.header import weights_file
    from ..video import file_sha256

    for option, value, choices in (("--engine", engine, CHOICES), ("--device", device, DEVICES)):
        if value not in choices:
            raise BendtrackError(f"{option}: expected {', '.join(choices)}, got '{value}'")
    file = weights_file(folder)
    on_cpu = device == "cpu" or engine in ENGINES or not NetworkDetector.gpu_is_likely()
    if on_cpu and engine != "torch" and file.is_file() and engine_record(file, file_sha256(file)) is None:
        _compile(folder)
    return NetworkDetector.load(folder, engine=engine, device=device, threads=threads)


def _compile(folder: Path) -> None:
    """Build the fast engines of a network beside it, and say what they change."""
    from ...models.engine import build_beside

    talk.say(f"Compiling '{folder.name}' for the CPU (once)")
    try:
        record = build_beside(folder)
    except (BendtrackError, OSError) as error:
        talk.warn(f"'{folder.name}' could not be compiled and will be slower: {error}")
        return
    for name, tried in record["engines"].items():
        said = f"{name}: {tried['drift_px']:.3f} px and {tried['drift_deg']:.3f}° from float32"
        talk.say(said if tried["passed"] else f"{said}: refused")
