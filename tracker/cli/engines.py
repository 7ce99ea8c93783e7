"""A network made ready to track with: which engine, on which device, compiled first where that was not done yet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import BendtrackError
from . import console

if TYPE_CHECKING:
    from ...models.detector import NetworkDetector
    from ..angle import AngleDefinition
    from ..project import Project

ModelOption = Annotated[str | None, typer.Option(help="Name of the network.", show_default="the newest")]
EngineOption = Annotated[
    str, typer.Option(help="auto, openvino-int8, openvino or torch. auto takes the fastest that is exact.")
]
DeviceOption = Annotated[str, typer.Option(help="auto, cpu or cuda. auto takes a GPU when there is one.")]
ThreadsOption = Annotated[int | None, typer.Option(min=1, help="Cores for the network.", show_default="all")]


def load_network(
    folder: Path,
    engine: str = "auto",
    device: str = "auto",
    threads: int | None = None,
    *,
    soonest: bool = False,
    learns: bool = False,
) -> NetworkDetector:
    """A network ready to track with; compiled first where that was not done yet and can be.

    The arguments are those of `NetworkDetector.load`.
    """
    from ...models.compiled import ENGINES, engine_record
    from ...models.detector import CHOICES, DEVICES, NetworkDetector
    from ...models.finding.header import read_header, weights_file
    from ..video import file_sha256

    for option, value, choices in (("--engine", engine, CHOICES), ("--device", device, DEVICES)):
        if value not in choices:
            raise BendtrackError(f"{option}: expected {', '.join(choices)}, got '{value}'")
    file = weights_file(folder)
    read_header(file)  # a file that is no network is not compiled
    on_cpu = device == "cpu" or engine in ENGINES or not NetworkDetector.gpu_is_likely()
    if on_cpu and engine != "torch" and engine_record(file, file_sha256(file)) is None:
        _compile(folder)
    return NetworkDetector.load(
        folder, engine=engine, device=device, threads=threads, soonest=soonest, learns=learns
    )


def measured_angle(project: Project, network: NetworkDetector) -> AngleDefinition:
    """The angle that a network was trained for, which is what is measured; said where the project means another."""
    definition = network.header.definition
    angle = project.settings.angle_definition(definition.sign)
    signs = {"auto": definition.sign, "+": 1, "-": -1}
    if angle != definition or signs[project.settings.angle.sign] != definition.sign:
        console.warn(
            f"bendtrack.toml names another angle than '{network.name}' was trained for, which is measured"
            f" ({definition.name}, {', '.join(definition.points)}, sign {definition.sign:+d});"
            " train again for the new one"
        )
    return definition


def _compile(folder: Path) -> None:
    """Build the fast engines of a network beside it, and say what they change."""
    from ...models.engine import build_beside

    console.say(f"Compiling '{folder.name}' for the CPU (once)")
    try:
        record = build_beside(folder)
    except (BendtrackError, OSError) as error:
        console.warn(f"'{folder.name}' could not be compiled and will be slower: {error}")
        return
    for name, tried in record["engines"].items():
        said = f"{name}: {tried['drift_px']:.3f} px and {tried['drift_deg']:.3f}° from float32"
        console.say(said if tried["passed"] else f"{said}: refused")
