"""Frame extraction: videos are scanned, frames selected, and saved as images to label in labeled-data/.

How frames are selected is in `selection.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..tracker.atomic import remove_leftovers
from ..tracker.errors import BendtrackError, LabelError, PressureLogError, VideoError
from ..tracker.project import Project
from ..tracker.study.pressure_log import read_pressure_log
from ..tracker.video import Video, video_stem
from .frame_descriptors import FrameDescriptor
from .image_folders import candidate_stems, images_by_frame, resolve_stem
from .pressure_signal import PressureSignal
from .selection import PositionOf, select_frames
from .store import LabelStore, image_name
from .stream_clustering import AppearanceClusters, BinnedClusters
from .video_record import remember_video
from .video_scan import DECODING_THREADS, Progress, SampleBy, VideoScan, clusters_for, scan_video

Counting = Callable[[str], AbstractContextManager[Progress]]


@dataclass
class ExtractionReport:
    """Outcome of a frame extraction.

    Attributes
    ----------
    saved : dict of Path to list of Path
        Video -> its new images; only videos with some.
    actuators : dict of str to tuple of int
        Actuator -> (number of new images, number of images in all).
    failed : dict of Path to str
        Video that could not be used -> the reason.
    warnings : list of str
        Warnings, one line each.
    """

    saved: dict[Path, list[Path]] = field(default_factory=dict)
    actuators: dict[str, tuple[int, int]] = field(default_factory=dict)
    failed: dict[Path, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@contextmanager
def _silent(title: str) -> Iterator[Progress]:
    yield lambda done, total: None


@dataclass(frozen=True)
class _ScannedVideo:
    """A video's scan, the name of its folder of images, and its pressure where frames are selected by it."""

    scan: VideoScan
    stem: str
    pressure: PressureSignal | None = None


def extract_frames(
    project: Project,
    videos: Sequence[str | Path],
    *,
    count: int = 30,
    by: SampleBy | None = None,
    pressure_logs: Sequence[str | Path] = (),
    actuator: str | None = None,
    counting: Counting = _silent,
) -> ExtractionReport:
    """Select frames of videos and save them as images to label. Frames that are saved already are not selected.

    Parameters
    ----------
    project : Project
        The project that gets the images. With `actuator`, its bendtrack.toml lists the videos afterwards.
    videos : sequence of str or Path
        Video files.
    count : int, optional
        Number of new images for each actuator, spread over its videos.
    by : SampleBy or None, optional
        Quantity over which frames are spread evenly. None takes the pressure where there are logs, else the
        appearance.
    pressure_logs : sequence of str or Path, optional
        One log for each video in the same order, on the video's clock. Or one folder, in which a video's log has
        the video's stem.
    actuator : str or None, optional
        Actuator that all these videos show; None keeps what the project has for them.
    counting : Counting, optional
        Takes a title and returns a context whose value is called with the frames done and the frames in all.

    Returns
    -------
    ExtractionReport
        What was saved, and what could not be.

    Raises
    ------
    LabelError
        `count` is not positive; there are logs without `by` pressure, or the reverse; there is not one log for each
        video.
    PressureLogError
        A log cannot be read.
    ProjectError
        The actuator's name is not valid.
    """
    paths = list(dict.fromkeys(Path(video) for video in videos))
    if count < 1:
        raise LabelError(f"expected at least 1 frame to select, got {count}")
    by = by or (SampleBy.PRESSURE if pressure_logs else SampleBy.APPEARANCE)
    logs = _logs_of(paths, pressure_logs, by)
    report = ExtractionReport()
    pressures = {}
    for path, log_path in logs.items():
        log = read_pressure_log(log_path)
        report.warnings += [f"{log_path}: {warning}" for warning in log.warnings]
        pressures[path] = PressureSignal(log.time_s, log.pressure_kpa)
    remove_leftovers(project.root)
    store = LabelStore.of(project)
    store.remove_leftovers()
    scanned: list[_ScannedVideo] = []
    for path in paths:
        try:
            with counting(f"{path.name}: scanning") as progress:
                clusters = clusters_for(by, len(paths), pressures.get(path))
                found = _scan(store, path, clusters, [other.stem for other in scanned], progress)
                scanned.append(replace(found, pressure=pressures.get(path)))
        except BendtrackError as error:
            report.failed[path] = str(error).removeprefix(f"{path}: ")
        else:
            report.warnings += [f"{path}: {warning}" for warning in scanned[-1].scan.warnings]
    if actuator is not None and scanned:
        project.assign_actuator(actuator, [found.stem for found in scanned])
    groups: dict[str, list[_ScannedVideo]] = {}
    for found in scanned:
        groups.setdefault(project.actuator_of(found.stem), []).append(found)
    for name, group in groups.items():
        chosen = select_frames([found.scan for found in group], count, _positions(group, by))
        new = sum(len(descriptors) for descriptors in chosen)
        if new < count:
            report.warnings.append(
                f"{name}: {new} of {count} frames selected: the videos show no more images that differ"
            )
        for found, descriptors in zip(group, chosen, strict=True):
            with counting(f"{found.scan.video.name}: saving") as progress:
                _save(store, found, descriptors, report, progress)
        in_all = sum(len(store.images(stem)) for stem in store.videos() if project.actuator_of(stem) == name)
        report.actuators[name] = (new, in_all)
    return report


def _logs_of(videos: Sequence[Path], logs: Sequence[str | Path], by: SampleBy) -> dict[Path, Path]:
    """Return the pressure log of each video; none unless frames are selected by pressure."""
    if bool(logs) != (by is SampleBy.PRESSURE):
        wanted = "pressure logs" if by is SampleBy.PRESSURE else f"no pressure log with frames by {by}"
        raise LabelError(f"expected {wanted}, got {len(logs) or 'none'}")
    paths = [Path(log) for log in logs]
    if len(paths) == 1 and paths[0].is_dir():
        return {video: _log_in(paths[0], video) for video in videos}
    if logs and len(paths) != len(videos):
        raise LabelError(
            f"expected one pressure log for each video, in the same order, got {len(paths)} logs and"
            f" {len(videos)} videos"
        )
    return dict(zip(videos, paths, strict=False))


def _log_in(folder: Path, video: Path) -> Path:
    stem = video_stem(video)
    found = sorted(p for p in folder.iterdir() if p.stem == stem and p != video and p.is_file())
    if len(found) != 1:
        names = ", ".join(p.name for p in found) or "none"
        raise PressureLogError(f"{folder}: expected one pressure log named {stem}, got {names}")
    return found[0]


def _scan(
    store: LabelStore,
    video: Path,
    clusters: AppearanceClusters | BinnedClusters,
    taken: Sequence[str],
    progress: Progress,
) -> _ScannedVideo:
    """Scan a video and find the name of its folder of images."""
    stems = candidate_stems(video)
    known = {index for stem in stems for index in images_by_frame(store, stem)}
    found = scan_video(video, clusters, known=known, progress=progress)
    if not found.clusters and not found.known:
        raise VideoError(f"{video}: expected frames that are sound, within the times of a log, got none")
    stem = resolve_stem(store, stems, taken, found.known)
    images = images_by_frame(store, stem)
    warnings = list(found.warnings)
    if stem != stems[0]:
        warnings.append(f"images named '{stems[0]}' belong to another video, so these are named '{stem}'")
    return _ScannedVideo(
        replace(
            found,
            known=[descriptor for descriptor in found.known if descriptor.frame in images],
            warnings=warnings,
        ),
        stem,
    )


def _positions(group: Sequence[_ScannedVideo], by: SampleBy) -> list[PositionOf] | None:
    """Return for each video a function from time_s to the position on the axis that frames are spread over.

    The position is the pressure, or the time with all videos one after another; None for selection by appearance.
    """
    if by is SampleBy.APPEARANCE:
        return None
    positions: list[PositionOf] = []
    before_s = 0.0
    for found in group:
        positions.append(_after(before_s) if found.pressure is None else _pressure_at(found.pressure))
        before_s += found.scan.duration_s
    return positions


def _after(before_s: float) -> PositionOf:
    return lambda time_s: before_s + time_s


def _pressure_at(pressure: PressureSignal) -> PositionOf:
    def position(time_s: float) -> float | None:
        found = pressure.at(time_s)
        return None if found is None else found[0]

    return position


def _save(
    store: LabelStore,
    found: _ScannedVideo,
    descriptors: Sequence[FrameDescriptor],
    report: ExtractionReport,
    progress: Progress,
) -> None:
    """Decode the video again, up to the last selected frame, and write the images."""
    wanted = {descriptor.frame for descriptor in descriptors}
    if not wanted:
        return
    saved = report.saved.setdefault(found.scan.video, [])
    last = max(wanted)
    with closing(iter(Video(found.scan.video, threads=DECODING_THREADS))) as frames:
        for frame in frames:
            if frame.index in wanted and frame.image is not None:
                saved.append(store.add_image(found.stem, image_name(frame.index), frame.image))
            if frame.index % 32 == 0:
                progress(frame.index, last)
            if frame.index >= last:
                break
    remember_video(store.labels_dir / found.stem, found.scan.video)
