"""From video to bending angle without a project of one's own: without labels, or with one labelled frame.

The network that comes with bendtrack finds the actuator; with a labelled frame, one trained from it does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .model_folders import finished, unfinished
from .networks import Localizer, load_network
from .reporting import SILENT, Reporter
from .tracker.batch import Batch, VideoOutcome, check_writable, measured, track_batch
from .tracker.errors import VideoError
from .training import is_trained_on_labels, planned_settings

if TYPE_CHECKING:
    from .models.detector import NetworkDetector
    from .project import Project
    from .tracker.results import AngleTable

BACKBONE = "resnet18"
"""Of the network that comes with bendtrack and is taken here."""

LABELS_FOLDER = "labels"
"""The project with the labelled frame, in the folder of the results."""


def measure(
    video: str | Path,
    *,
    model: str | Path | None = None,
    adapt: bool = True,
    engine: str = "auto",
    device: str = "auto",
    threads: int | None = None,
    reporter: Reporter = SILENT,
) -> AngleTable:
    """Measure the bending angle in a video that nobody has labelled. Nothing is written.

    Finds the actuator, and which of its ends is fixed: the one that does not move. Thirty labels are more exact.

    Parameters
    ----------
    video : str or Path
        The video file.
    model : str, Path or None
        A pretrained network, its folder or file; None takes the one that comes with bendtrack.
    adapt : bool
        Whether the network may first adapt to this actuator, where it is not sure of it everywhere. Takes about a
        minute on two cores; without it fewer frames are found.
    engine : str
        "auto", "openvino-int8", "openvino" or "torch". "auto" takes the fastest that is exact.
    device : str
        "auto", "cpu" or "cuda". "auto" takes a GPU where there is one.
    threads : int or None
        Cores for the network; None takes all.
    reporter : Reporter
        Is told what goes on.

    Returns
    -------
    AngleTable
        One row for every frame: `time_s` (T,) seconds, `angle_deg` and `angle_sd_deg` (T,) degrees, NaN where unknown,
        `flag` (T,) why a row is missing or to be doubted.

    Raises
    ------
    VideoError
        The video cannot be read, or no actuator can be seen in it.
    CheckpointError
        `model` is no network, or the engine or device is not there.

    Examples
    --------
    >>> import bendtrack as bt
    >>> table = bt.measure("a.mp4")  # doctest: +SKIP
    >>> table.angle_deg.max()  # doctest: +SKIP
    """
    network = _network(model, adapt, engine, device, threads, reporter)
    batch = Batch(network, None, Path(), localize=Localizer(network), counting=reporter.counting)
    table, _ = measured(batch, Path(video))
    return table


def measure_each(
    videos: Sequence[Path],
    out: Path,
    *,
    model: str | Path | None = None,
    adapt: bool = True,
    overlay: bool = False,
    force: bool = False,
    engine: str = "auto",
    device: str = "auto",
    threads: int | None = None,
    reporter: Reporter = SILENT,
) -> Iterator[VideoOutcome]:
    """Measure videos that nobody has labelled, and write their tables and figures into a folder.

    Parameters
    ----------
    videos : sequence of Path
        Video files, as `tracker.batch.listed_videos` gives them.
    out : Path
        Receives the results.
    overlay : bool
        Whether overlay videos are written too.
    force : bool
        Whether videos are measured again that are up to date.
    model, adapt, engine, device, threads, reporter
        As `measure`'s.

    Yields
    ------
    VideoOutcome
        For every video in order.

    Raises
    ------
    BendtrackError
        The folder cannot be written.
    CheckpointError
        `model` is no network, or the engine or device is not there.
    """
    check_writable(out)
    network = _network(model, adapt, engine, device, threads, reporter)
    reporter.say(network_line(network))
    batch = Batch(
        network,
        None,
        out,
        localize=Localizer(network),
        overlay=overlay,
        force=force,
        counting=reporter.counting,
    )
    yield from track_batch(batch, videos)


def project_to_label(videos: Sequence[Path], out: Path, *, reporter: Reporter = SILENT) -> Project:
    """Open the project next to the results, in which one frame is to be labelled; make it where there is none.

    The frame is from the middle of the motion in the first video, and sharp.

    Parameters
    ----------
    videos : sequence of Path
        Video files, as `tracker.batch.listed_videos` gives them.
    out : Path
        Folder of the results; the project is `LABELS_FOLDER` in it.
    reporter : Reporter
        Is told what goes on.

    Returns
    -------
    Project
        With at least one frame, labelled or not.

    Raises
    ------
    BendtrackError
        The folder cannot be written.
    ProjectError
        Something else lies where the project would.
    VideoError
        The first video cannot be read, or has no frame to label.
    """
    from .labeling.store import LabelStore
    from .project import Project, new_project
    from .tracker.project import SETTINGS_FILE
    from .tracker.project import Project as ProjectFolder

    check_writable(out)
    root = out / LABELS_FOLDER
    if not (root / SETTINGS_FILE).exists():
        new_project(root)
    project = Project(ProjectFolder.open(root), reporter)
    store = LabelStore.of(project.folder)
    if not any(store.images(video) for video in store.videos()):
        report = project.add_frames(videos[0], count=1)
        for problem in report.failed.values():
            raise VideoError(f"{videos[0]}: {problem}")
        if not any(report.saved.values()):
            raise VideoError(f"{videos[0]}: expected a frame to label, got none that is sound")
    return project


def measure_labelled(
    project: Project, videos: Sequence[Path], out: Path, *, started_s: float | None = None, **options: Any
) -> Iterator[VideoOutcome]:
    """Train a network on a project's labels where that is not done yet, and track videos with it.

    Parameters
    ----------
    project : Project
        From `project_to_label`, with all keypoints labelled in some frame.
    videos : sequence of Path
        Video files.
    out : Path
        Receives the results.
    started_s : float or None
        As `Project.train`'s.
    **options : object
        As `Project.track_each`'s.

    Yields
    ------
    VideoOutcome
        For every video in order.

    Raises
    ------
    LabelError, TrainingError
        As `Project.train`.
    BendtrackError
        As `Project.track_each`.
    """
    settings = planned_settings(project.folder, {})
    newest = finished(project.folder)[-1:]
    if not newest or not is_trained_on_labels(project.folder, newest[0], settings):
        project.train(resume=bool(unfinished(project.folder)), started_s=started_s)
    yield from project.track_each(list(videos), out=out, **options)


def network_line(network: NetworkDetector) -> str:
    """Say in one line which network measures, and where.

    Parameters
    ----------
    network : NetworkDetector
        Any.

    Returns
    -------
    str
        Name, backbone, engine and device.
    """
    return f"Network: {network.name} ({network.metadata.backbone}, {network.engine} on {network.device})"


def _network(
    model: str | Path | None,
    adapt: bool,
    engine: str,
    device: str,
    threads: int | None,
    reporter: Reporter,
) -> NetworkDetector:
    from .models.networks.shipped import working_copy

    folder = working_copy(BACKBONE) if model is None else Path(model)
    return load_network(folder, engine, device, threads, self_training=adapt, reporter=reporter)
