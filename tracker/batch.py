"""Many videos into one folder: what is up to date is skipped, what fails does not stop the others.

Each video gives a `VideoOutcome`; nothing is printed here. How one video is measured is in `tracking.py`, how a table
is written in `results.py`, when its files are up to date in `bookkeeping.py`.
"""

from __future__ import annotations

import glob
import secrets
import shlex
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from .angle import AngleDefinition, strongest_bend_deg
from .atomic import remove_leftovers
from .bookkeeping import choose_stem, is_recorded, is_up_to_date, overlay_of_record, record_file
from .errors import (
    AngleError,
    BendtrackError,
    CheckpointError,
    MissingPackageError,
    UnwritableResultsError,
    VideoError,
    WeightsError,
    reason,
)
from .hashing import file_sha256
from .links import make_folder
from .overlay import write_overlay
from .project_settings import VIDEO_SUFFIXES
from .results import AngleTable, read_results, write_results
from .tracking import Progress, track, tracking_settings
from .types import Detector, Flag, Frames
from .video import Video, spread_frames

PROBE_FRAMES = 32
"""Frames in which an actuator is looked for that nobody has labelled."""

BACKWARDS_DEG = 20.0
"""Where the frames that bend most are this far below 0, the sign may be another actuator's, degrees."""

MOST_ELONGATED = 50
"""Longer over shorter side of a frame beyond which no actuator is looked for: scaled down, nothing is left of it."""

LEAST_SOUND = 0.6
"""Share of the rows without a flag below which a user is warned, where nobody has labelled anything."""

_OF_THE_BATCH = (AngleError, CheckpointError, MissingPackageError, UnwritableResultsError, WeightsError)
"""Errors that every video of a batch would have."""

_LONGEST_REASON = 200

_DEEPEST = 3
"""Levels of sub-folders in which videos are looked for, to say where they are. They are not taken unasked."""

OVERLAY_SUFFIX = ".overlay.mp4"
"""Ends the name of every overlay video, so that none is taken for a video to track."""

Counting = Callable[[str, str], AbstractContextManager[Progress]]
"""A title and a unit -> a context that gives what is called with the number done and the number in all."""

Localize = Callable[[Frames, Progress], tuple[Detector, AngleDefinition]]
"""Probe frames of a video that nobody has labelled -> a detector for this video, and the angle to measure.

Raises VideoError where no actuator can be seen.
"""


class State(StrEnum):
    """What became of a video."""

    TRACKED = "tracked"
    UP_TO_DATE = "up to date"
    FAILED = "failed"


@dataclass(frozen=True)
class AngleSummary:
    """An angle table in a few numbers.

    Attributes
    ----------
    rows : int
        Rows of the table: frames of the video.
    min_deg, max_deg : float
        Range of the known angles, degrees; NaN where none is known.
    sd_deg : float
        Median of the known standard deviations, degrees; NaN where none is known.
    flags : Mapping of str to int
        Flag (a value of `types.Flag`) -> rows that have it, the most frequent first. Rows without a flag do not count.
    """

    rows: int
    min_deg: float
    max_deg: float
    sd_deg: float
    flags: Mapping[str, int] = field(default_factory=dict)

    @property
    def flagged(self) -> int:
        """How many rows have a flag."""
        return sum(self.flags.values())


@dataclass(frozen=True)
class VideoOutcome:
    """What became of one video of a batch.

    Attributes
    ----------
    video : Path
        The video file.
    state : State
        Tracked now, skipped because it was up to date, or failed.
    table : AngleTable or None
        The angle table; None where the video failed.
    csv_path : Path or None
        The table on disk; the .h5 and .json lie next to it. None where the video failed.
    overlay_path : Path or None
        The overlay video, where this run wrote one.
    seconds : float
        How long tracking took; 0 where nothing was tracked.
    warnings : tuple of str
        What was worked around, one sentence each.
    problem : str or None
        Why the video failed or is damaged. A damaged one is tracked as far as it goes.
    error : Exception or None
        What ended the work on a video that failed.
    """

    video: Path
    state: State
    table: AngleTable | None = None
    csv_path: Path | None = None
    overlay_path: Path | None = None
    seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    problem: str | None = None
    error: Exception | None = None


@contextmanager
def _silent(title: str, unit: str) -> Iterator[Progress]:
    yield lambda done, total: None


@dataclass(frozen=True)
class Batch:
    """How all videos of a batch are tracked, and into which folder.

    Attributes
    ----------
    detector : Detector
        Finds the keypoints.
    definition : AngleDefinition or None
        The angle. None localizes the actuator in each video first, by `localize`.
    sign_of : callable or None
        From a video file to the sign of its angle as the labels have it; None takes the definition's own for all, which
        someone chose.
    folder : Path
        Receives the results.
    localize : callable or None
        As `Localize`; needed where there is no definition.
    min_likelihood : float or None
        As `tracking.track`'s; None takes its default.
    overlay : bool
        Whether overlay videos are written too.
    force : bool
        Whether videos are tracked again that are up to date.
    counting : callable
        As `Counting`; called for every long step.
    """

    detector: Detector
    definition: AngleDefinition | None
    folder: Path
    localize: Localize | None = None
    min_likelihood: float | None = None
    overlay: bool = False
    force: bool = False
    counting: Counting = _silent
    sign_of: Callable[[Path], int] | None = None

    def definition_for(self, video: Path) -> AngleDefinition | None:
        """The angle of one video."""
        if self.definition is None or self.sign_of is None:
            return self.definition
        return replace(self.definition, sign=self.sign_of(video))

    @property
    def options(self) -> dict[str, Any]:
        """Keyword arguments of `tracking.track` that are not left to their defaults."""
        return {} if self.min_likelihood is None else {"min_likelihood": self.min_likelihood}


def track_batch(batch: Batch, videos: Sequence[Path]) -> Iterator[VideoOutcome]:
    """Bring the results of videos up to date, one after the other.

    Whatever goes wrong with one video, the others are done. A video's figure is drawn while the next video is tracked:
    for a short film that takes as long as its frames.

    Parameters
    ----------
    batch : Batch
        How, and into which folder.
    videos : sequence of Path
        Video files, as `listed_videos` gives them.

    Yields
    ------
    VideoOutcome
        For every video in order, as soon as its table is on disk.

    Raises
    ------
    BendtrackError
        The network cannot measure any video: it does not find a point of the angle, or cannot run. Or a figure cannot
        be written; this is raised once all videos are done.
    """
    with ThreadPoolExecutor(max_workers=1) as drawing:
        figures = _Figures(drawing)
        for video in videos:
            try:
                yield _track_one(batch, video, figures)
            except _OF_THE_BATCH:
                raise
            except Exception as error:
                yield VideoOutcome(video, State.FAILED, problem=_problem(video, error), error=error)
        figures.wait()
        for video, failure in figures.errors:
            if not isinstance(failure, BendtrackError):
                problem = f"its table is written, its figure is not ({_problem(video, failure)})"
                yield VideoOutcome(video, State.FAILED, problem=problem, error=failure)
        for _, failure in figures.errors:
            if isinstance(failure, BendtrackError):
                raise failure


def measured(
    batch: Batch,
    video: Path,
    *,
    sha256: str | None = None,
    before_localizing: Callable[[], None] | None = None,
) -> tuple[AngleTable, float]:
    """Track one video as a batch says, without writing anything.

    Parameters
    ----------
    batch : Batch
        How; its folder is not touched.
    video : Path
        The video file.
    sha256 : str or None
        The file's hash, where it is known.
    before_localizing : callable or None
        Called before the actuator is looked for in a video that nobody has labelled.

    Returns
    -------
    table : AngleTable
        A row for every frame.
    seconds : float
        How long tracking took, without looking for the actuator.

    Raises
    ------
    VideoError
        The video cannot be read, or no actuator can be seen in it.
    """
    detector, definition = batch.detector, batch.definition_for(video)
    # Without labels nobody said where the actuator is: every row is held against its neighbours.
    unlabelled = definition is None
    if definition is None:
        if batch.localize is None:
            raise ValueError("expected a definition of the angle, or localize, got neither")
        if before_localizing is not None:
            before_localizing()
        with batch.counting(f"{video.name}: finding the actuator", "steps") as progress:
            probe = spread_frames(video, PROBE_FRAMES)
            if not probe:
                raise VideoError(f"{video}: expected frames that are sound, got none")
            height, width = probe[0].shape[:2]
            if max(width, height) > MOST_ELONGATED * min(width, height):
                raise VideoError(
                    f"{video}: expected a frame in which an actuator fits, got {width} x {height} px"
                )
            detector, definition = batch.localize(probe, progress)
    begun = time.monotonic()
    with batch.counting(video.name, "frames") as progress:
        table = track(
            video,
            detector,
            definition,
            check_jumps=unlabelled,
            progress=progress,
            video_sha256=sha256,
            **batch.options,
        )
    return table, time.monotonic() - begun


def unreadable(videos: Sequence[Path]) -> list[VideoOutcome]:
    """What fails before a network is needed: the outcomes of all videos, where not one can be opened.

    Parameters
    ----------
    videos : sequence of Path
        Video files, as `listed_videos` gives them.

    Returns
    -------
    list of VideoOutcome
        Empty as soon as one video can be opened: the others are then said in their turn.
    """
    failed = []
    for video in videos:
        try:
            _check_not_empty(video)
            Video(video)
        except Exception as error:
            failed.append(VideoOutcome(video, State.FAILED, problem=_problem(video, error), error=error))
        else:
            return []
    return failed


def _in_sub_folders(folder: Path) -> str:
    """Where a folder's sub-folders hold videos: the pattern that names them, as the end of a message."""
    for depth in range(1, _DEEPEST + 1):
        pattern = "/".join("*" * depth)
        found = next((file for file in folder.glob(f"{pattern}/*") if _is_video(file)), None)
        if found is not None:
            wanted = shlex.quote(f"{folder}/{pattern}/*{found.suffix}")
            return f". Videos lie in its sub-folders: write {wanted}, quotes included"
    return ""


def listed_videos(names: Sequence[str | Path]) -> list[Path]:
    """List the video files that are meant by files, folders and patterns.

    Parameters
    ----------
    names : sequence of str or Path
        Files, folders of videos, or patterns such as ``day1/*.mp4``. In folders and patterns, overlay videos and
        hidden files are skipped.

    Returns
    -------
    list of Path
        Each file once, in the order given.

    Raises
    ------
    VideoError
        Nothing is there, or a folder holds no videos.
    """
    found: dict[Path, Path] = {}
    for name in names:
        path = Path(name)
        if path.exists() and not path.is_dir():
            own = [path]
        else:
            among = path.iterdir() if path.is_dir() else map(Path, glob.glob(str(name), recursive=True))
            own = sorted(file for file in among if _is_video(file))
            if not own and path.is_dir():
                raise VideoError(
                    f"expected videos in {path}, got a folder without any{_in_sub_folders(path)}"
                )
            if not own and glob.has_magic(str(name)):
                raise VideoError(f"expected videos, got no file that fits the pattern {name}")
            if not own:
                raise VideoError(f"expected a video, got no such file or folder: {name}")
        for file in own:
            found.setdefault(file.resolve(), file)
    return list(found.values())


def check_writable(folder: Path) -> None:
    """Find out now, not after an hour, whether results can be written.

    Parameters
    ----------
    folder : Path
        Made with its parents where it is not there.

    Raises
    ------
    BendtrackError
        It cannot be written.
    """
    probe = folder / f".{secrets.token_hex(6)}.tmp"
    try:
        make_folder(folder)
        probe.write_bytes(b"bendtrack")
    except OSError as error:
        raise BendtrackError(
            f"--out: expected a folder that can be written, got {folder} ({reason(error)})"
        ) from error
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)


def summarize(table: AngleTable) -> AngleSummary:
    """Put an angle table into a few numbers.

    Parameters
    ----------
    table : AngleTable
        With any number of rows, also none.

    Returns
    -------
    AngleSummary
        Range, uncertainty and flags.
    """
    angle, sd = (values[np.isfinite(values)] for values in (table.angle_deg, table.angle_sd_deg))
    counts = {kind.value: int((table.flag == kind).sum()) for kind in Flag if kind.value}
    return AngleSummary(
        rows=len(table),
        min_deg=float(angle.min()) if angle.size else float("nan"),
        max_deg=float(angle.max()) if angle.size else float("nan"),
        sd_deg=float(np.median(sd)) if sd.size else float("nan"),
        flags=dict(sorted(((k, n) for k, n in counts.items() if n), key=lambda item: -item[1])),
    )


class _Figures:
    """Draws the figure of one video while the next one is tracked; what goes wrong waits in `errors`."""

    def __init__(self, drawing: Executor) -> None:
        self.errors: list[tuple[Path, Exception]] = []
        self._drawing = drawing
        self._last: tuple[Path, Future[None]] | None = None

    def draw(self, video: Path, table: AngleTable, folder: Path, stem: str, path: Path) -> None:
        """Begin to draw a figure."""
        self._last = video, self._drawing.submit(_draw, table, folder, stem, path)

    def wait(self) -> None:
        """See the last figure finished."""
        if self._last is None:
            return
        video, drawn = self._last
        self._last = None
        try:
            drawn.result()
        except Exception as error:
            self.errors.append((video, error))


def _problem(video: Path, error: Exception) -> str:
    """One line for what ended the work on a video."""
    if isinstance(error, BendtrackError):
        return " ".join(str(error).removeprefix(f"{video}: ").split())
    if isinstance(error, MemoryError):
        return "there is not enough memory for it"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    lines = str(error).split("\n")
    return (
        f"cannot be measured ({type(error).__name__}: {' '.join(' '.join(lines).split())[:_LONGEST_REASON]})"
    )


def _track_one(batch: Batch, video: Path, figures: _Figures) -> VideoOutcome:
    """Bring one video's files up to date."""
    folder = batch.folder
    sha256 = _hash_of(video)
    stem, note = choose_stem(folder, video, sha256)
    warnings = [] if note is None else [note]
    figure_path = _figure_path(folder, stem, video)
    overlay_path = folder / f"{stem}{OVERLAY_SUFFIX}"
    for name in {stem, figure_path.stem, overlay_path.stem}:
        remove_leftovers(folder, name)
    definition = batch.definition_for(video)
    settings = None if definition is None else tracking_settings(definition, **batch.options)
    seconds = 0.0
    if not batch.force and is_up_to_date(folder, stem, sha256, batch.detector.provenance, settings):
        state, table, csv_path = State.UP_TO_DATE, read_results(folder / f"{stem}.h5"), folder / f"{stem}.csv"
    else:
        state = State.TRACKED
        # Where a network is converted, Python waits: no figure is drawn meanwhile.
        table, seconds = measured(batch, video, sha256=sha256, before_localizing=figures.wait)
        csv_path, _, _ = write_results(table, folder, stem)
    said, complete = table.provenance["warnings"], table.provenance["video"]["complete"]
    warnings += [f"{video}: {warning}" for warning in said] if complete else []
    sound = float((table.flag == "").mean()) if len(table) else 0.0
    if batch.sign_of is not None and _bends_backwards(table):
        warnings.append(
            f"{video}: expected angles above 0 where it bends most, got angles below: if it bends the other way than"
            " the labelled actuator, name it as an actuator of its own in bendtrack.toml and label a frame of it"
        )
    if definition is None and sound < LEAST_SOUND:
        warnings.append(
            f"{video}: expected the actuator in most frames, got it without a flag in {100 * sound:.0f} %, and those"
            " may be wrong too; look at --overlay, or label one frame: `bendtrack angle --label`"
        )
    figures.wait()
    if not is_recorded(folder, stem, figure_path):
        figures.draw(video, table, folder, stem, figure_path)
    written = None
    if batch.overlay and overlay_of_record(folder, stem) is None:
        with batch.counting(f"{video.name}: overlay", "frames") as progress:
            write_overlay(video, table, overlay_path, progress)
        figures.wait()  # both are entered into the same JSON
        record_file(folder, stem, overlay_path)
        written = overlay_path
    return VideoOutcome(
        video,
        state,
        table,
        csv_path,
        written,
        seconds,
        tuple(warnings),
        None if complete else f"damaged, tracked as far as it goes: {'; '.join(said)}",
    )


def _bends_backwards(table: AngleTable) -> bool:
    """Whether the frames that bend most bend to the side that counts as negative, by more than a doubtful bit."""
    angle_deg = table.angle_deg[np.isfinite(table.angle_deg) & (table.flag == "")]
    return bool(angle_deg.size) and strongest_bend_deg(angle_deg) < -BACKWARDS_DEG


def _check_not_empty(video: Path) -> None:
    if not video.stat().st_size:
        raise VideoError(f"{video}: expected a video, got an empty file")


def _hash_of(video: Path) -> str:
    try:
        _check_not_empty(video)
        return file_sha256(video)
    except OSError as error:
        raise VideoError(
            f"{video}: expected a video, got a file that cannot be read ({reason(error)})"
        ) from error


def _draw(table: AngleTable, folder: Path, stem: str, path: Path) -> None:
    from .figures import write_angle_figure  # matplotlib takes as long to load as a short film to track

    write_angle_figure(table, path)
    record_file(folder, stem, path)


def _figure_path(folder: Path, stem: str, video: Path) -> Path:
    """Where a video's figure goes: a name that may be a file of the user's is not taken.

    Such are the names in the folder of the videos themselves, and what was there before there were results.
    """
    path = folder / f"{stem}.png"
    foreign = path.exists() and not (folder / f"{stem}.json").exists()
    if foreign or folder.resolve() == video.resolve().parent:
        return folder / f"{stem}.angle.png"
    return path


def _is_video(file: Path) -> bool:
    """Whether a file found in a folder is a video to track: no overlay of ours, under its name of today or before."""
    if file.suffix.lower() not in VIDEO_SUFFIXES or file.name.startswith(".") or not file.is_file():
        return False
    return not file.name.endswith(OVERLAY_SUFFIX) and overlay_of_record(file.parent, file.stem) != file
