"""The command that measures as it films: bendtrack live."""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
from array import array
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, nullcontext
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import BendtrackError, ResultsError
from . import console
from .arguments import DeviceOption, EngineOption, ModelOption, ProjectArgument, opened
from .render_command import size_wh

if TYPE_CHECKING:
    from ...models.detector import NetworkDetector
    from ..angle import AngleDefinition
    from ..live.cameras import CameraMode
    from ..live.low_latency import LiveSource, LiveValue
    from ..live.output import UdpTarget
    from ..project import Project


class LineFormat(StrEnum):
    """Forms of a value on stdout and in a datagram."""

    CSV = "csv"
    JSONL = "jsonl"


def live(
    project: ProjectArgument,
    source: Annotated[
        str | None,
        typer.Argument(
            help="Number or name of a camera, a video file, or an RTSP or HTTP URL.",
            metavar="[SOURCE]",
            show_default="the first camera",
        ),
    ] = None,
    udp: Annotated[
        str | None,
        typer.Option(
            help="Also send each value to this address, one UDP datagram each.",
            metavar="HOST:PORT",
            show_default="no datagrams",
        ),
    ] = None,
    format: Annotated[
        LineFormat, typer.Option(help="Format of the values: csv or jsonl.", metavar="FORMAT")
    ] = LineFormat.CSV,
    duration: Annotated[
        float | None,
        typer.Option(
            help="End after this many seconds.",
            metavar="SECONDS",
            min=0,
            show_default="at Ctrl-C or the end of the source",
        ),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(
            help="Write a table of this name into PROJECT/results.",
            metavar="NAME",
            show_default="no table",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            help="Size of the camera's frames in px, such as 640x480.",
            metavar="WIDTHxHEIGHT",
            show_default="the camera's own",
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            help="Frame rate of the camera, frames/s.", metavar="HZ", min=0.1, show_default="the camera's own"
        ),
    ] = None,
    camera_format: Annotated[
        str | None,
        typer.Option(
            help="Pixel format of the camera, as FFmpeg calls it. Many cameras reach 60 frames/s only with mjpeg.",
            metavar="NAME",
            show_default="the camera's own",
        ),
    ] = None,
    model: ModelOption = None,
    engine: EngineOption = "auto",
    device: DeviceOption = "auto",
    threads: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of processor cores for the network.",
            metavar="N",
            show_default="all, at most 4",
        ),
    ] = None,
) -> None:
    """Measure a camera's angle while it films, for closed-loop control.

    Prints a line with the bending angle as soon as it is known; messages for people go to stderr. The newest frame is
    measured and older ones are dropped, so the values never fall behind. A file is played in real time. Ctrl-C ends it.
    """
    console.leave_stdout_to_programs()
    from ... import model_folders
    from ...measuring import network_line
    from ...networks import load_network, measured_angle
    from ..batch import check_writable
    from ..interruption import stop_event
    from ..live.low_latency import measure_live
    from ..live.output import UdpTarget
    from ..live.sources import open_source
    from .reporter import ConsoleReporter

    reporter = ConsoleReporter()
    folder = opened(project, *(() if source is None else (source,))).folder
    if out is not None:
        _check_free(folder, out)
        check_writable(folder.results_dir)
    mode = _camera_mode(size, rate, camera_format)
    target = None if udp is None else UdpTarget(udp)
    network = load_network(
        model_folders.chosen(folder, model, reporter),
        engine,
        device,
        threads,
        low_latency=True,
        reporter=reporter,
    )
    definition = measured_angle(folder, network, reporter)
    options: dict[str, Any] = {}
    if folder.settings.tracking.min_likelihood is not None:
        options["min_likelihood"] = folder.settings.tracking.min_likelihood
    filmed = open_source(source, mode)  # last, for a camera that runs and is not read falls behind
    if rate is not None and filmed.rate is not None and abs(filmed.rate - rate) > 0.01 * rate:
        console.warn(f"{filmed.name} delivers {filmed.rate:g} frames/s, not {rate:g}")
    console.say(network_line(network))
    console.say(f"Source: {filmed.name}, {filmed.size_wh[0]} x {filmed.size_wh[1]} px; Ctrl-C ends it")

    kept = None if out is None else _Kept(folder.results_dir, out, filmed, network, definition, options)
    tally = _Tally()
    try:
        with _little_to_sweep(), stop_event(signal.SIGINT, signal.SIGTERM) as stop, target or nullcontext():
            values = measure_live(filmed, network, definition, duration_s=duration, stop=stop, **options)
            with closing(values):
                for value in _told(values, format, target, kept):
                    tally.add(value)
    finally:
        console.say(tally.line())
        for warning in filmed.warnings:
            console.warn(f"{filmed.name}: {warning}")
        if kept is not None:
            kept.write()


def _told(
    values: Iterator[LiveValue], format: LineFormat, target: UdpTarget | None, kept: _Kept | None
) -> Generator[LiveValue, None, None]:
    """The values, each told to whoever wants it, until there are no more or nobody reads stdout any longer."""
    from ..live.output import HEADER, line_of

    try:
        if format == LineFormat.CSV:
            print(HEADER, flush=True)
        for value in values:
            line = line_of(value, format)
            if target is not None:  # before stdout, whose reader may be slow
                target.send(f"{line}\n")
            if kept is not None:  # no row that somebody has read is lost
                kept.add(value)
            print(line, flush=True)
            yield value
    except BrokenPipeError:
        # Python would complain at exit of what it could not write.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Tally:
    """What there is to say at the end."""

    def __init__(self) -> None:
        self.latency_ms = array("d")
        self._passed_over = 0
        self._first_s = self._last_s = 0.0

    def add(self, value: LiveValue) -> None:
        self._last_s = time.monotonic()
        if not self.latency_ms:
            self._first_s = self._last_s
        self.latency_ms.append(value.latency_ms)
        self._passed_over += value.dropped

    def line(self) -> str:
        import numpy as np

        n = len(self.latency_ms)
        if not n:
            return "No values"
        taken_s = self._last_s - self._first_s
        rate = f" in {taken_s:.1f} s ({(n - 1) / taken_s:.1f}/s)" if n > 1 else ""
        median, high, most = np.percentile(self.latency_ms, (50, 95, 100))
        return (
            f"{n} value{'s' if n > 1 else ''}{rate}, {self._passed_over} frames dropped;"
            f" capture to value: median {median:.1f} ms, 95 % within {high:.1f} ms, at most {most:.1f} ms"
        )


class _Kept:
    """What --out writes: rows as they come, and at the end the whole table instead."""

    def __init__(
        self,
        folder: Path,
        stem: str,
        source: LiveSource,
        network: NetworkDetector,
        definition: AngleDefinition,
        options: dict[str, Any],
    ) -> None:
        from ..live.recording import PARTIAL_SUFFIX, PartialTable, Recording
        from ..tracking import tracking_settings

        self._recording = Recording(network.keypoints, definition)
        self._partial = PartialTable(folder / f"{stem}{PARTIAL_SUFFIX}", network.keypoints)
        self._grows = True
        self._folder, self._stem, self._source = folder, stem, source
        self._provenance = network.provenance
        self._settings = tracking_settings(definition, **options)

    def add(self, value: LiveValue) -> None:
        self._recording.add(value)
        if self._grows:
            try:
                self._partial.add(value)
            except ResultsError as error:
                # Whoever steers by the values needs the next one more than this row.
                self._grows = False
                console.warn(str(error))

    def write(self) -> None:
        if not len(self._recording):
            self._partial.close(keep=False)
            return
        try:
            self._write_whole()
        except BaseException:
            self._partial.close(keep=True)
            console.say(f"The rows are in {self._partial.path}")
            raise
        self._partial.close(keep=False)

    def _write_whole(self) -> None:
        from ..bookkeeping import record_file
        from ..figures import write_angle_figure
        from ..results import write_results

        table = self._recording.table(
            self._source.name, self._provenance, self._settings, self._source.warnings
        )
        csv_path, _, _ = write_results(table, self._folder, self._stem)
        figure_path = csv_path.with_suffix(".png")
        write_angle_figure(table, figure_path)
        record_file(self._folder, self._stem, figure_path)
        console.say(f"{len(table)} frames -> {csv_path}")


@contextmanager
def _little_to_sweep() -> Iterator[None]:
    """Python's collector leaves alone what is loaded by now: looking through it takes it up to 0.1 s."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _camera_mode(size: str | None, rate: float | None, format: str | None) -> CameraMode | None:
    from ..live.cameras import CameraMode

    if size is None and rate is None and format is None:
        return None
    return CameraMode(None if size is None else size_wh(size), rate, format)


def _check_free(project: Project, name: str) -> None:
    """See that a table of this name would overwrite nothing."""
    from ..live.recording import PARTIAL_SUFFIX

    folder = project.results_dir
    if Path(name).name != name or name.startswith("."):
        raise BendtrackError(f"--out: expected the name of a table, got '{name}'")
    taken = [folder / f"{name}{suffix}" for suffix in (".csv", ".h5", ".json", ".png")]
    for path in (*taken, folder / f"{name}{PARTIAL_SUFFIX}"):
        if path.exists():
            raise ResultsError(f"--out: expected a new name, got '{name}': {path} is there already")
