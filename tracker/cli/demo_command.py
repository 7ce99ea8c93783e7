"""The command that shows the whole job on the bundled sample trial: bendtrack demo."""

from __future__ import annotations

import time
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import BendtrackError
from . import console

if TYPE_CHECKING:
    from ..results import AngleTable

_SAMPLE = ("video.mp4", "pressure.csv", "labels.csv", "truth.csv", "trial.json", "README.md")
_LABEL_NOISE_PX = 1.0
_MAX_MINUTES = 3.5
"""For the training on a slow machine; the sample's thirty labels need about two on two cores."""


def demo(
    out: Annotated[
        Path, typer.Option(help="A new folder, or the folder of an earlier demo.", metavar="FOLDER")
    ] = Path("bendtrack-demo"),
) -> None:
    """Do the whole job on a bundled sample trial.

    Labels, network, angles, figure, overlay video, and the errors against the exact truth, in a few minutes. Run it
    again to go on where it was stopped.
    """
    from ...labeling.interop.dlc import import_dlc, project_for
    from ...model_folders import finished, unfinished
    from ...project import Project
    from ..batch import OVERLAY_SUFFIX
    from ..results import read_results
    from .network_commands import show_training
    from .outcomes import show_outcomes
    from .project_commands import print_report
    from .reporter import ConsoleReporter

    begun = time.monotonic()
    trial = out / "trial"
    video = trial / "video.mp4"
    console.say("1. A project with the labels of 30 frames")
    folder = project_for(out, sample_folder() / "labels.csv")
    project = Project(folder, ConsoleReporter())
    _copy_sample(trial)
    print_report(import_dlc(trial / "labels.csv", folder, videos=[video]))

    console.say("\n2. A network, trained on them")
    networks, stopped = finished(folder), unfinished(folder)
    if networks:
        network = networks[-1]
        console.say(f"'{network.name}' is trained already")
    elif stopped:
        network = project.train(stopped[-1].name, resume=True).folder
    else:
        trained = project.train(max_minutes=_MAX_MINUTES)
        show_training(trained)
        network = trained.folder

    console.say("\n3. The angle in every frame of the video")
    show_outcomes(project.track_each([video], model=network.name, overlay=True))

    table = read_results(folder.results_dir / "video.h5")
    console.say(f"\n4. Next to the truth ({time.monotonic() - begun:.0f} s in all)")
    _compare(table, trial / "truth.csv", network)
    results = folder.results_dir
    console.show(
        f"table    {results / 'video.csv'} (and .h5, .json)\n"
        f"figure   {results / 'video.png'}\n"
        f"overlay  {results / f'video{OVERLAY_SUFFIX}'}\n"
        f"network  {network} (its errors: errors.png, worst-frames.png)"
    )
    console.say(
        "\nYour own videos:\n"
        "    bendtrack new my-study\n"
        "    bendtrack frames my-study VIDEO...\n"
        "    bendtrack label my-study\n"
        "    bendtrack train my-study\n"
        "    bendtrack track my-study VIDEO... --overlay"
    )


def sample_folder() -> Path:
    """Where the bundled sample trial lies.

    Raises
    ------
    BendtrackError
        It is not there.
    """
    try:
        folder = Path(str(files("bendtrack.data_samples")))
    except ModuleNotFoundError:
        folder = Path("bendtrack/data_samples")
    missing = [name for name in _SAMPLE if not (folder / name).is_file()]
    if missing:
        raise BendtrackError(
            f"the sample trial is not installed ({missing[0]} is missing): install bendtrack again"
        )
    return folder


def _copy_sample(trial: Path) -> None:
    from ..atomic import atomic_write_bytes
    from ..links import make_folder

    make_folder(trial)
    for name in _SAMPLE:
        data = (sample_folder() / name).read_bytes()
        if not (trial / name).is_file() or (trial / name).read_bytes() != data:
            atomic_write_bytes(trial / name, data)


def _compare(table: AngleTable, truth_path: Path, network: Path) -> None:
    import numpy as np
    import pandas as pd

    from ...models.inference.metadata import read_metadata
    from ..angle import end_vector_px, label_noise_floor_deg

    truth = pd.read_csv(truth_path)
    error = table.angle_deg - truth["angle_deg"].to_numpy()
    known = np.isfinite(error)
    rms = float(np.sqrt(np.mean(error[known] ** 2)))
    assert table.definition is not None
    columns = [f"{keypoint}_{axis}" for keypoint in table.keypoints for axis in "xy"]
    exact = truth[columns].to_numpy().reshape(len(truth), -1, 2)
    trained = len(read_metadata(network).training["trained_on"])
    floor = label_noise_floor_deg(
        _LABEL_NOISE_PX,
        trained,
        end_vector_px(exact, table.keypoints, table.definition),
    )
    angle = truth["angle_deg"]
    console.show(
        f"angle    {angle.min():.0f} to {angle.max():.0f}° in {len(table)} frames; RMS error {rms:.2f}°,"
        f" {int((~known).sum())} frames without an angle\n"
        f"         (label-noise floor {floor:.2f}°, what label noise alone allows: {trained} labels train, each"
        f" {_LABEL_NOISE_PX:g} px off, as a steady hand's are)"
    )
