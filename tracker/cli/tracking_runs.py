"""Tracking of many videos into a folder: what is up to date is passed over, what fails does not stop the others."""

from __future__ import annotations

import glob
import secrets
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import BendtrackError, VideoError, reason
from . import console

if TYPE_CHECKING:
    from ...models.detector import NetworkDetector
    from ..angle import AngleDefinition
    from ..results import AngleTable

VideosArgument = Annotated[
    list[str], typer.Argument(help="Files, folders of videos, or patterns such as 'day1/*.mp4'.")
]
OverlayOption = Annotated[
    bool, typer.Option("--overlay", help="Also write a video with what was found drawn on it.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Also what is up to date.")]

GLIMPSES = 32
"""Frames in which an actuator is looked for that nobody has labelled."""

LEAST_SOUND = 0.6
"""Share of the frames without a flag below which a user is warned, where nobody has labelled anything."""

_OVERLAY = "overlay"
"""In the name of an overlay that could be taken for a video of the user's."""


def listed_videos(names: list[str]) -> list[Path]:
    """Files of the given files, folders and patterns, each once, in the order given.

    Raises
    ------
    VideoError
        Nothing is there, or a folder holds no videos.
    """
    from ..project_settings import VIDEO_SUFFIXES

    found: dict[Path, Path] = {}
    for name in names:
        path = Path(name)
        if path.exists() and not path.is_dir():
            own = [path]
        else:
            among = path.iterdir() if path.is_dir() else map(Path, glob.glob(name, recursive=True))
            own = sorted(
                file
                for file in among
                if file.suffix.lower() in VIDEO_SUFFIXES
                and file.is_file()
                and not file.name.startswith(".")
                and not file.stem.endswith(f".{_OVERLAY}")
            )
            if not own and path.is_dir():
                raise VideoError(f"expected videos in {path}, got a folder without any")
            if not own:
                raise VideoError(f"expected a video, got a path where nothing is: {name}")
        for file in own:
            found.setdefault(file.resolve(), file)
    return list(found.values())


@dataclass
class _Job:
    """Tracking with one network into one folder.

    Attributes
    ----------
    definition : the angle; None where the actuator is to be found in each video first
    drawing : draws a video's figure while the next one is tracked: of a short clip it takes as long as the frames
    drawn : what it was last asked for
    """

    detector: NetworkDetector
    definition: AngleDefinition | None
    folder: Path
    drawing: Executor
    options: dict[str, Any]
    drawn: Future[None] | None = None

    def wait_for_figure(self) -> None:
        """See the figure asked for last finished, or raise what prevented it."""
        if self.drawn is not None:
            self.drawn.result()
            self.drawn = None


def track_videos(
    detector: NetworkDetector,
    definition: AngleDefinition | None,
    videos: list[Path],
    folder: Path,
    *,
    overlay: bool,
    force: bool = False,
    min_likelihood: float | None = None,
) -> dict[Path, str]:
    """Track videos one after the other and write tables, figures and overlays.

    Parameters
    ----------
    definition : the angle; None finds the actuator in each video first, and measures the network's own
    min_likelihood : as `tracking.track`'s, where the user wants another

    Returns
    -------
    The videos that failed or are damaged, and why. A damaged one is tracked as far as it goes.
    """
    console.say(
        f"Network: {detector.name} ({detector.header.backbone}, {detector.engine} on {detector.device})"
    )
    problems: dict[Path, str] = {}
    options = {} if min_likelihood is None else {"min_likelihood": min_likelihood}
    with ThreadPoolExecutor(max_workers=1) as drawing:
        job = _Job(detector, definition, folder, drawing, options)
        for video in videos:
            try:
                damage = _track_one(job, video, overlay, force)
            except VideoError as error:
                console.say(f"{video}: failed")
                problems[video] = str(error).removeprefix(f"{video}: ")
            else:
                if damage:
                    problems[video] = damage
        job.wait_for_figure()
    return problems


def list_problems(problems: dict[Path, str], videos: list[Path]) -> None:
    """Say which videos failed, last and together, and end with status 1 when some did."""
    if not problems:
        return
    if len(videos) > 1:
        console.complain(
            f"{len(problems)} of {len(videos)} videos failed or are damaged, the others are done:"
        )
    for path, problem in problems.items():
        console.complain(f"{path}: {problem}")
    raise typer.Exit(1)


def _track_one(job: _Job, video: Path, overlay: bool, force: bool) -> str | None:
    """Bring one video's files up to date; what is wrong with the video, when its frames are not all there."""
    from ..atomic import remove_leftovers
    from ..bookkeeping import choose_stem, is_recorded, is_up_to_date, record_file
    from ..overlay import write_overlay
    from ..results import read_results, write_results
    from ..tracking import track, tracking_settings
    from ..video import file_sha256, spread_frames
    from . import progress_bars

    try:
        if not video.stat().st_size:
            raise VideoError(f"{video}: expected a video, got an empty file")
        sha256 = file_sha256(video)
    except OSError as error:
        raise VideoError(
            f"{video}: expected a video, got a file that cannot be read ({reason(error)})"
        ) from error
    stem, note = choose_stem(job.folder, video, sha256)
    if note:
        console.warn(note)
    figure_path = _beside(job.folder, stem, ".png", "angle", video)
    overlay_path = _beside(job.folder, stem, ".mp4", _OVERLAY, video)
    for name in {stem, figure_path.stem, overlay_path.stem}:
        remove_leftovers(job.folder, name)
    settings = None if job.definition is None else tracking_settings(job.definition, **job.options)
    fresh = not force and is_up_to_date(job.folder, stem, sha256, job.detector.provenance, settings)
    table: AngleTable
    if fresh:
        table = read_results(job.folder / f"{stem}.h5")
        console.say(f"{video}: up to date")
    else:
        detector, definition = job.detector, job.definition
        if definition is None:
            job.wait_for_figure()  # a network is converted meanwhile, which keeps the whole process quiet
            with progress_bars.counting(f"{video.name}: finding the actuator", "steps") as progress:
                detector = detector.for_video(spread_frames(video, GLIMPSES), progress)
            definition = detector.header.definition
        # Nobody said where the actuator is: what a frame says is held against those beside it.
        steady = job.definition is None
        begun = time.monotonic()
        with progress_bars.counting(video.name) as progress:
            table = track(
                video,
                detector,
                definition,
                steady=steady,
                progress=progress,
                video_sha256=sha256,
                **job.options,
            )
        rate = len(table) / (time.monotonic() - begun)
        csv_path, _, _ = write_results(table, job.folder, stem)
        flagged = int((table.flag != "").sum())
        console.say(f"{video}: {len(table)} frames, {flagged} flagged, {rate:.0f} frames/s -> {csv_path}")
    warnings, complete = table.provenance["warnings"], table.provenance["video"]["complete"]
    for warning in warnings if complete else ():
        console.warn(f"{video}: {warning}")
    sound = float((table.flag == "").mean())
    if job.definition is None and sound < LEAST_SOUND:
        console.warn(
            f"{video}: expected the actuator in most frames, got it without a flag in {100 * sound:.0f} %, and those"
            " may be wrong too; look at --overlay, or label some frames: `bendtrack new`"
        )
    job.wait_for_figure()
    if not is_recorded(job.folder, stem, figure_path):
        job.drawn = job.drawing.submit(_draw, table, job.folder, stem, figure_path)
    if overlay and not is_recorded(job.folder, stem, overlay_path):
        with progress_bars.counting(f"{video.name}: overlay") as progress:
            write_overlay(video, table, overlay_path, progress)
        job.wait_for_figure()  # both are entered into the same JSON
        record_file(job.folder, stem, overlay_path)
        console.say(f"{video}: overlay -> {overlay_path}")
    return None if complete else f"damaged, tracked as far as it goes: {'; '.join(warnings)}"


def _draw(table: AngleTable, folder: Path, stem: str, figure_path: Path) -> None:
    from ..bookkeeping import record_file
    from ..figures import write_angle_figure

    write_angle_figure(table, figure_path)
    record_file(folder, stem, figure_path)


def _beside(folder: Path, stem: str, suffix: str, word: str, video: Path) -> Path:
    """The path of a file beside a table: a name that may be a file of the user's is not taken.

    Such are the names in the folder of the videos themselves, and what was there before there were results.
    """
    path = folder / f"{stem}{suffix}"
    foreign = path.exists() and not (folder / f"{stem}.json").exists()
    if foreign or folder.resolve() == video.resolve().parent:
        return folder / f"{stem}.{word}{suffix}"
    return path


def check_writable(folder: Path) -> None:
    """Find out now, not after an hour, whether results can be written."""
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / f".{secrets.token_hex(6)}.tmp"
    try:
        probe.write_bytes(b"bendtrack")
    except OSError as error:
        raise BendtrackError(
            f"--out: expected a folder that can be written, got {folder} ({reason(error)})"
        ) from error
    finally:
        probe.unlink(missing_ok=True)
