"""From video to bending angle without project or labels, by the network that comes with bendtrack."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .networks import Localizer, load_network
from .reporting import SILENT, Reporter
from .tracker.batch import Batch, VideoOutcome, check_writable, measured, track_batch

if TYPE_CHECKING:
    from .models.detector import NetworkDetector
    from .tracker.results import AngleTable

BACKBONE = "resnet18"
"""Of the network that comes with bendtrack and is taken here."""


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
