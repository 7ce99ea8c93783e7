"""New pictures to label: videos are surveyed, frames chosen, and saved into labeled-data/ under the right names.

How frames are chosen is in `selection.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..tracker.errors import BendtrackError, LabelError, PressureLogError, VideoError
from ..tracker.project import Project
from ..tracker.study.pressure_log import read_pressure_log
from ..tracker.video import Video, video_stem
from .glimpses import Glimpse
from .picture_folders import numbered_pictures, own_stem, possible_stems
from .pose_cells import BinCells, LookCells
from .pressure_order import PressureOrder
from .selection import PlaceOf, choose
from .store import LabelStore, image_name
from .survey import DECODING_THREADS, By, Progress, Survey, cells_for, survey

Counting = Callable[[str], AbstractContextManager[Progress]]


@dataclass
class FramesReport:
    """What came of choosing frames.

    Attributes
    ----------
    saved : new pictures of each video that gave some
    actuators : actuator -> new pictures and pictures in all
    failed : videos that could not be used, and why
    warnings : what is worth a look, a line each
    """

    saved: dict[Path, list[Path]] = field(default_factory=dict)
    actuators: dict[str, tuple[int, int]] = field(default_factory=dict)
    failed: dict[Path, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@contextmanager
def _silent(title: str) -> Iterator[Progress]:
    yield lambda done, total: None


@dataclass(frozen=True)
class _Surveyed:
    """A video, under which name its pictures go, and where its times lie on the line to be spread over."""

    survey: Survey
    stem: str
    pressure: PressureOrder | None = None


def add_frames(
    project: Project,
    videos: Sequence[str | Path],
    *,
    count: int = 30,
    by: By | None = None,
    pressure_logs: Sequence[str | Path] = (),
    actuator: str | None = None,
    counting: Counting = _silent,
) -> FramesReport:
    """Choose frames of videos and save them as pictures to label, without those that are there already.

    Parameters
    ----------
    project : where they go; with `actuator`, its bendtrack.toml lists the videos afterwards
    videos : video files
    count : new pictures of each actuator, spread over its videos
    by : what frames are spread evenly over; None takes the pressure where there are logs, else the appearance
    pressure_logs : one log a video in the same order, on the video's clock; or one folder, in which the log of
        a video has its name
    actuator : which actuator all these videos show; None leaves what the project says of them
    counting : a title -> context that gives what is called with frames done and frames in all

    Raises
    ------
    LabelError
        `count` is not positive; logs without `by` pressure or the other way round; not one log a video.
    PressureLogError
        A log cannot be read.
    ProjectError
        The actuator's name cannot be one.
    """
    paths = list(dict.fromkeys(Path(video) for video in videos))
    if count < 1:
        raise LabelError(f"expected at least 1 frame to choose, got {count}")
    by = by or (By.PRESSURE if pressure_logs else By.APPEARANCE)
    logs = _logs_of(paths, pressure_logs, by)
    report = FramesReport()
    orders = {}
    for path, log_path in logs.items():
        log = read_pressure_log(log_path)
        report.warnings += [f"{log_path}: {warning}" for warning in log.warnings]
        orders[path] = PressureOrder(log.time_s, log.pressure_kpa)
    store = LabelStore.of(project)
    surveyed: list[_Surveyed] = []
    for path in paths:
        try:
            with counting(f"{path.name}: looking") as progress:
                cells = cells_for(by, len(paths), orders.get(path))
                found = _look_through(store, path, cells, [other.stem for other in surveyed], progress)
                surveyed.append(replace(found, pressure=orders.get(path)))
        except BendtrackError as error:
            report.failed[path] = str(error).removeprefix(f"{path}: ")
        else:
            report.warnings += [f"{path}: {warning}" for warning in surveyed[-1].survey.warnings]
    if actuator is not None and surveyed:
        project.assign_actuator(actuator, [found.stem for found in surveyed])
    groups: dict[str, list[_Surveyed]] = {}
    for found in surveyed:
        groups.setdefault(project.actuator_of(found.stem), []).append(found)
    for name, group in groups.items():
        chosen = choose([found.survey for found in group], count, _places(group, by))
        new = sum(len(glimpses) for glimpses in chosen)
        if new < count:
            report.warnings.append(
                f"{name}: {new} of {count} frames chosen: the videos show no more pictures that differ"
            )
        for found, glimpses in zip(group, chosen, strict=True):
            with counting(f"{found.survey.video.name}: saving") as progress:
                _save(store, found, glimpses, report, progress)
        in_all = sum(len(store.images(stem)) for stem in store.videos() if project.actuator_of(stem) == name)
        report.actuators[name] = (new, in_all)
    return report


def _logs_of(videos: Sequence[Path], logs: Sequence[str | Path], by: By) -> dict[Path, Path]:
    """The pressure log of each video, none unless frames are chosen by pressure."""
    if bool(logs) != (by is By.PRESSURE):
        wanted = "pressure logs" if by is By.PRESSURE else f"no pressure log with frames by {by}"
        raise LabelError(f"expected {wanted}, got {len(logs) or 'none'}")
    paths = [Path(log) for log in logs]
    if len(paths) == 1 and paths[0].is_dir():
        return {video: _log_in(paths[0], video) for video in videos}
    if logs and len(paths) != len(videos):
        raise LabelError(
            f"expected one pressure log a video, in the same order, got {len(paths)} logs and {len(videos)} videos"
        )
    return dict(zip(videos, paths, strict=False))


def _log_in(folder: Path, video: Path) -> Path:
    stem = video_stem(video)
    found = sorted(p for p in folder.iterdir() if p.stem == stem and p != video and p.is_file())
    if len(found) != 1:
        names = ", ".join(p.name for p in found) or "none"
        raise PressureLogError(f"{folder}: expected one pressure log named {stem}, got {names}")
    return found[0]


def _look_through(
    store: LabelStore, video: Path, cells: LookCells | BinCells, taken: Sequence[str], progress: Progress
) -> _Surveyed:
    """Survey a video and find the name for its pictures."""
    stems = possible_stems(video)
    known = {index for stem in stems for index in numbered_pictures(store, stem)}
    found = survey(video, cells, known=known, progress=progress)
    if not found.cells and not found.known:
        raise VideoError(f"{video}: expected frames that are sound, within the times of a log, got none")
    stem = own_stem(store, stems, taken, found.known)
    pictures = numbered_pictures(store, stem)
    warnings = list(found.warnings)
    if stem != stems[0]:
        warnings.append(f"pictures named '{stems[0]}' belong to another video, so these are named '{stem}'")
    return _Surveyed(
        replace(
            found,
            known=[glimpse for glimpse in found.known if glimpse.frame in pictures],
            warnings=warnings,
        ),
        stem,
    )


def _places(group: Sequence[_Surveyed], by: By) -> list[PlaceOf] | None:
    """For each video, where its times lie on the line: pressures as they are, times one video after the other."""
    if by is By.APPEARANCE:
        return None
    places: list[PlaceOf] = []
    before_s = 0.0
    for found in group:
        places.append(_after(before_s) if found.pressure is None else _pressure_at(found.pressure))
        before_s += found.survey.duration_s
    return places


def _after(before_s: float) -> PlaceOf:
    return lambda time_s: before_s + time_s


def _pressure_at(pressure: PressureOrder) -> PlaceOf:
    def place(time_s: float) -> float | None:
        found = pressure.at(time_s)
        return None if found is None else found[0]

    return place


def _save(
    store: LabelStore, found: _Surveyed, glimpses: Sequence[Glimpse], report: FramesReport, progress: Progress
) -> None:
    """Decode once more, up to the last chosen frame, and write the pictures."""
    wanted = {glimpse.frame for glimpse in glimpses}
    if not wanted:
        return
    saved = report.saved.setdefault(found.survey.video, [])
    last = max(wanted)
    with closing(iter(Video(found.survey.video, threads=DECODING_THREADS))) as frames:
        for frame in frames:
            if frame.index in wanted and frame.image is not None:
                saved.append(store.add_image(found.stem, image_name(frame.index), frame.image))
            if frame.index % 32 == 0:
                progress(frame.index, last)
            if frame.index >= last:
                return
