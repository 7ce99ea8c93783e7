"""Importing and exporting SLEAP's .slp labels with sleap-io (the extra `sleap`).

sleap-io keeps float64 positions, reads every version of the format, and loads in a tenth of a second. It is an extra
because it takes 280 MB with its dependencies. The HDF5 is not read here directly.

Positions. Since version 1.1 of the format (0, 0) is the centre of the top-left pixel, as in bendtrack. Older files are
measured from the corner, and sleap-io subtracts 0.5 px from their positions. Positions are used as it returns them.

Frames. A .slp file refers to videos and frame indices. It may contain the images (.pkg.slp), or refer to images instead
of a video. Only labels by a person are imported, not predictions. A node that is not visible counts as not labelled.

Actuators. In files that bendtrack has written, an instance's track is the actuator; elsewhere tracks mean other things.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Mapping, Sequence
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from ...tracker.atomic import atomic_path, remove_leftovers
from ...tracker.errors import LabelError, reason
from ...tracker.extras import install_command
from ...tracker.hdf5_files import open_hdf5
from ...tracker.links import make_folder
from ...tracker.project import Project
from ...tracker.project_settings import listed_stem
from ..label_table import LabelRow
from ..store import frame_index, image_name
from .exporting import ExportReport, LabelledVideo, labelled_videos, skeleton_edges
from .importing import by_stem
from .source import ImageFinder, ReadImage, Source, SourceVideo, distinct_names, foreign_path

_WRITER = "bendtrack"  # key in the provenance of files that bendtrack has written


def _sleap_io(path: Path) -> ModuleType:
    try:
        import sleap_io
    except ImportError as error:
        raise LabelError(
            f"{path}: expected sleap-io for SLEAP's files, got none: {install_command('sleap')}"
        ) from error
    return sleap_io


# --- in --------------------------------------------------------------------------------------------------


def open_sleap(path: str | Path, images: str | Path | None = None) -> Source:
    """Read a .slp file.

    Parameters
    ----------
    path : str or Path
        The file.
    images : str, Path or None, optional
        Folder of the videos or images that it refers to. None looks at their own paths and next to the file.

    Returns
    -------
    Source
        The images and labels.

    Raises
    ------
    LabelError
        sleap-io is not installed, the file has another format, or it has no labels by a person.
    """
    path = Path(path)
    sleap_io = _sleap_io(path)
    try:
        _check_hdf5(path)
        labels = sleap_io.load_slp(str(path), open_videos=False)
    except Exception as error:  # whatever h5py, json and sleap-io raise at a file that is none
        raise LabelError(
            f"{path}: expected SLEAP labels (.slp), got a file that does not open as such ({reason(error)})"
        ) from error
    finder = ImageFinder([Path(images)] if images is not None else [path.resolve().parent])
    by_video = defaultdict(list)
    for frame in labels.labeled_frames:
        by_video[id(frame.video)].append(frame)
    suggested = defaultdict(list)
    for suggestion in labels.suggestions:
        suggested[id(suggestion.video)].append(int(suggestion.frame_idx))
    ours = _WRITER in labels.provenance
    skipped: list[str] = []
    names = _video_names(labels.videos)
    videos = []
    for video, name in zip(labels.videos, names, strict=True):
        frames, indices = by_video[id(video)], suggested[id(video)]
        if video.is_cropped:
            skipped.append(f"{name}: expected whole frames, got a cropped video")
        elif frames or indices:
            videos.append(_video(video, name, frames, indices, finder, ours, skipped))
    if not any(row.cells for video in videos for row in video.rows):
        raise LabelError(f"{path}: expected frames that a person labelled, got none")
    keypoints = dict.fromkeys(name for skeleton in labels.skeletons for name in skeleton.node_names)
    return Source(path, tuple(keypoints), None, tuple(videos), (), tuple(skipped))


def _check_hdf5(path: Path) -> None:
    """Refuse a file that asks for far more memory than its size, or takes data sets from other files.

    Raises
    ------
    LabelError
        It does.
    """
    with open_hdf5(path, LabelError, "SLEAP labels (.slp)") as file:
        file.check_all()


def _origin(video: Any) -> Any:
    """Return the video that the frames come from, also where the file contains copies of them."""
    return video.original_video or video


def _video_names(videos: Sequence[Any]) -> list[str]:
    """Return each video's name: the stem of a video file; for a list of images, their folder."""
    paths = []
    for number, video in enumerate(videos):
        filename = _origin(video).filename
        if isinstance(filename, list):
            path = foreign_path(filename[0]).parent if filename else PurePosixPath()
        else:
            path = foreign_path(str(filename))
            path = path.with_name(listed_stem(path.name)) if path.name else path
        paths.append(path if path.name else PurePosixPath(f"video_{number}"))
    names = distinct_names(paths)
    return [names[path] for path in paths]


def _video(
    video: Any,
    stem: str,
    frames: Sequence[Any],
    suggested: Sequence[int],
    finder: ImageFinder,
    ours: bool,
    skipped: list[str],
) -> SourceVideo:
    indices = sorted({int(frame.frame_idx) for frame in frames} | set(suggested))
    names = _image_names(_origin(video).filename, indices)
    images: dict[str, ReadImage] = {}
    file = None
    where = finder.where
    if video.backend_metadata.get("dataset"):
        names = {index: _as_png(names, index) for index in indices}
        stored = _stored_indices(video)
        images = {names[index]: _read_stored(video, index) for index in indices if index in stored}
        where = str(video.filename)
    elif isinstance(video.filename, list):
        for index in indices:
            try:
                found = finder.find(video.filename[index]) if index < len(video.filename) else None
            except LabelError as error:
                skipped.append(f"{stem}/{names[index]}: {error}")
                continue
            if found is not None:
                images[names[index]] = found.read_bytes
    else:
        file = _video_file(video.filename, finder)
    rows, actuators = [], set()
    if file is not None:
        rows = [LabelRow(names[index], {}, stem) for index in sorted(set(suggested))]
    for frame in sorted(frames, key=lambda frame: frame.frame_idx):
        image = names[int(frame.frame_idx)]
        labelled = [instance for instance in frame.user_instances if not np.isnan(instance.numpy()).all()]
        if len(labelled) > 1:
            skipped.append(
                f"{stem}/{image}: expected one actuator in each image, got {len(labelled)} instances"
            )
        elif labelled:
            rows.append(LabelRow(image, _cells(labelled[0]), stem, f"{stem} frame {frame.frame_idx}"))
            if labelled[0].track is not None:
                actuators.add(labelled[0].track.name)
    actuator = actuators.pop() if ours and len(actuators) == 1 else None
    return SourceVideo(stem, tuple(rows), images, where, actuator, file)


def _image_names(filename: str | list[str], indices: Sequence[int]) -> Mapping[int, str]:
    """Return the image names of these frames: their own where they have one, else by the frame index."""
    if not isinstance(filename, list):
        return {index: image_name(index) for index in indices}
    paths = {index: foreign_path(filename[index]) for index in indices if index < len(filename)}
    names = distinct_names(paths.values())
    return {index: names[paths[index]] if index in paths else image_name(index) for index in indices}


def _as_png(images: Mapping[int, str], index: int) -> str:
    """Return a PNG name for an image contained in the file; images of one stem get distinct names."""
    name = PurePosixPath(images[index])
    alike = [i for i, other in images.items() if PurePosixPath(other).stem == name.stem]
    return f"{name.stem}.png" if len(alike) == 1 else f"{name.stem}_{name.suffix[1:]}.png"


def _stored_indices(video: Any) -> Container[int]:
    """Return the indices of the frames whose images the .slp contains, or all of a video stored as HDF5."""
    try:
        video.open()
    except (OSError, ValueError):
        return ()
    if not video.backend.has_embedded_images:
        return range(len(video))
    return {int(index) for index in video.backend.frame_map}


def _read_stored(video: Any, index: int) -> ReadImage:
    def read() -> bytes:
        image = video[index]
        code = cv2.COLOR_GRAY2BGR if image.shape[-1] == 1 else cv2.COLOR_RGB2BGR
        return cv2.imencode(".png", cv2.cvtColor(image, code))[1].tobytes()

    return read


def _video_file(filename: str, finder: ImageFinder) -> Path | None:
    for path in (Path(filename), *(folder / foreign_path(filename).name for folder in finder.folders)):
        if path.is_file():
            return path
    return None


def _cells(instance: Any) -> dict[tuple[str, str], str]:
    cells = {}
    for name, (x, y) in zip(instance.skeleton.node_names, instance.numpy().tolist(), strict=True):
        if not (np.isnan(x) or np.isnan(y)):
            cells[name, "x"], cells[name, "y"] = repr(x), repr(y)
    return cells


# --- out -------------------------------------------------------------------------------------------------


def export_sleap(project: Project, out: str | Path, *, videos: Sequence[str | Path] = ()) -> ExportReport:
    """Write a .slp file that contains the project's images and labels, or refers to its videos.

    Positions keep every digit, images every pixel; images without labels become suggestions. Where `videos` has the
    video of every labelled folder, and every image's name has a frame index, the file refers to videos and frame
    indices and contains no images.

    Parameters
    ----------
    project : Project
        Project whose labels are written.
    out : str or Path
        The file, ending in .slp; must not exist.
    videos : sequence of str or Path, optional
        Video files to refer to.

    Returns
    -------
    ExportReport
        What was written.

    Raises
    ------
    LabelError
        sleap-io is not installed, `out` exists or does not end in .slp, nothing is labelled, the labels are malformed,
        a video does not exist, or two have one name.
    OSError
        The file cannot be written.
    """
    out = Path(out)
    sleap_io = _sleap_io(out)
    if out.suffix != ".slp":
        raise LabelError(f"expected the name of a .slp file to export to, got {out}")
    if out.exists():
        raise LabelError(f"expected a new file to export to, got one that is there: {out}")
    report = ExportReport()
    labelled = labelled_videos(project, report)
    files = by_stem(videos)
    for file in files.values():
        if not file.is_file():
            raise LabelError(f"expected a video, got no such file: {file}")
    by_reference = bool(files) and _all_have_videos(labelled, files, report)

    skeleton = sleap_io.Skeleton(
        list(project.keypoints), edges=skeleton_edges(project), name=project.root.resolve().name
    )
    tracks = {video.actuator: sleap_io.Track(video.actuator) for video in labelled}
    foreign: list[Any] = []
    frames, suggestions = [], []
    for video in labelled:
        # One for each kind of image: where they are mixed, sleap-io 0.9.5 stores some with red for blue.
        for images in [video.images] if by_reference else _by_suffix(video.images):
            if by_reference:
                theirs = sleap_io.Video.from_filename(str(files[video.video].resolve()))
            else:
                theirs = sleap_io.Video.from_filename([str(p.resolve()) for p in images], grayscale=False)
            foreign.append(theirs)
            for number, image in enumerate(images):
                index = frame_index(image.name) if by_reference else number
                xy = video.xy.get(image.name)
                if xy is None:
                    suggestions.append(sleap_io.SuggestionFrame(theirs, index))
                    continue
                instance = sleap_io.Instance.from_numpy(xy, skeleton=skeleton, track=tracks[video.actuator])
                frames.append(sleap_io.LabeledFrame(video=theirs, frame_idx=index, instances=[instance]))
    labels = sleap_io.Labels(
        labeled_frames=frames,
        videos=foreign,
        skeletons=[skeleton],
        tracks=list(tracks.values()),
        suggestions=suggestions,
        provenance={_WRITER: "labels written by bendtrack"},
    )
    make_folder(out.parent)
    remove_leftovers(out.parent, out.stem)
    with atomic_path(out) as temporary:
        embed = False if by_reference else "user+suggestions"
        sleap_io.save_slp(labels, str(temporary), embed=embed, verbose=False)
    return report


def _by_suffix(images: Sequence[Path]) -> list[list[Path]]:
    kinds: dict[str, list[Path]] = defaultdict(list)
    for image in images:
        kinds[image.suffix.lower()].append(image)
    return list(kinds.values())


def _all_have_videos(
    labelled: Sequence[LabelledVideo], files: Mapping[str, Path], report: ExportReport
) -> bool:
    missing = [video.video for video in labelled if video.video not in files]
    unnumbered = [
        f"{video.video}/{image.name}"
        for video in labelled
        for image in video.images
        if frame_index(image.name) is None
    ]
    if missing:
        report.warnings.append(f"no video is given for {', '.join(missing)}: images are written to the file")
    elif unnumbered:
        report.warnings.append(
            f"the name of {unnumbered[0]} has no frame index: images are written to the file"
        )
    return not missing and not unnumbered
