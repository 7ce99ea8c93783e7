"""The command that serves the labelling page: bendtrack label."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import BendtrackError, CheckpointError
from . import console
from .arguments import ProjectArgument, opened

if TYPE_CHECKING:
    from ...labeling.predictions import Network
    from ..project import Project
    from ..types import Detector


def label(
    project: ProjectArgument,
    port: Annotated[
        int | None,
        typer.Option(
            help="Port of the page on this machine.",
            metavar="PORT",
            show_default="the last one used, or any free one",
            min=1,
            max=65535,
        ),
    ] = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Only print the address; open no browser.")
    ] = False,
    model: Annotated[
        str | None,
        typer.Option(
            help="Name of the network whose predictions are shown; 'none' shows none.",
            metavar="NAME",
            show_default="the newest",
        ),
    ] = None,
    repeats: Annotated[
        float | None,
        typer.Option(
            help="Share of the labelled frames that are shown once more without their labels, to measure your own"
            " spread.",
            metavar="SHARE",
            show_default="0.1",
            min=0,
            max=1,
        ),
    ] = None,
) -> None:
    """Label frames on a page in the browser.

    The page is served on this machine only, and needs no internet. Every edit is saved at once. Several pages, and
    several servers, can be open on one project.
    """
    from ...labeling.repeatability import REPEAT_SHARE
    from ...labeling.serving import serve_labelling
    from ...labeling.store import LabelStore
    from ..atomic import remove_leftovers

    folder = opened(project).folder
    for place in (folder.root, folder.root / ".bendtrack"):
        if not place.is_symlink():
            remove_leftovers(place)
    LabelStore.of(folder).remove_leftovers()

    def ready(new_address: Callable[[], str]) -> None:
        if not no_browser:
            _open_browser(new_address())
        console.show(f"Labelling {folder.root} at {new_address()}")
        console.say("The address opens the page once. Everything is saved at once; Ctrl+C ends the server.")

    share = REPEAT_SHARE if repeats is None else repeats
    try:
        serve_labelling(folder, port=port, network=_network(folder, model), ready=ready, repeat_share=share)
    except KeyboardInterrupt:
        console.say("Ended; all labels are saved.")  # the usual end, so status 0


def label_first(project: Project, no_browser: bool) -> None:
    """Serve the page until all points of a frame are placed and the user goes on; at once where some frame has them.

    Parameters
    ----------
    project : Project
        With frames to label.
    no_browser : bool
        Whether the address is printed only.
    """
    import numpy as np

    from ...labeling.serving import serve_labelling
    from ...labeling.store import LabelStore

    if any(np.isfinite(frame.xy).all() for frame in LabelStore.of(project).read()):
        console.say(f"Labels: {project.root} (more: {console.command('label', project.root)})")
        return

    def ready(new_address: Callable[[], str]) -> None:
        if not no_browser:
            _open_browser(new_address())
        console.show(f"Label one frame at {new_address()}")
        console.say("Click its points, and press Measure on the page. Every click is saved at once.")

    serve_labelling(project, ready=ready, until_finished=True)


def _open_browser(address: str) -> None:
    import threading
    import webbrowser

    # Some browsers are waited for by the call that opens them.
    threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()


def _network(project: Project, name: str | None) -> Network | None:
    """The network of that name or the newest; None where there is none, or none is wanted."""
    if name == "none" or (name is None and not _has_models(project.models_dir)):
        return None
    from ... import model_folders
    from ...labeling.predictions import Network
    from .reporter import ConsoleReporter

    try:
        folder = model_folders.chosen(project, name, ConsoleReporter())
    except CheckpointError:
        if name is not None:
            raise
        return None
    from ...models.inference.metadata import WEIGHTS_FILE
    from ..hashing import file_sha256

    def load() -> Detector:
        from ...models.detector import NetworkDetector

        detector = NetworkDetector.load(folder)
        missing = set(project.keypoints) - set(detector.keypoints)
        if missing:
            raise BendtrackError(
                f"'{folder.name}' does not find {', '.join(sorted(missing))}: train a new network"
            )
        return detector

    return Network(folder.name, file_sha256(folder / WEIGHTS_FILE), load)


def _has_models(models_dir: Path) -> bool:
    return models_dir.is_dir() and any(models_dir.iterdir())
