"""Importing and exporting COCO keypoints: one JSON of images, categories and annotations, and images next to it.

The format is that of cocodataset.org (Data format, Keypoint Detection): an annotation has `keypoints`
[x1, y1, v1, ...], v = 0 not labelled, 1 labelled but hidden, 2 labelled and visible; a category names the
keypoints and pairs them, counted from 1, into a skeleton. CVAT and Label Studio write it too.

Positions. COCO's keypoints are indices of pixels, so (0, 0) is the centre of the top-left pixel, and they are used as
they are. For that reason readers such as Detectron2 add 0.5 to keypoints, but not to boxes, which are measured from the
image's corner. CVAT and Label Studio measure points from the corner, too: theirs are 0.5 px too large in x and y. The
offset is the same for all points, so no bending angle depends on it.

Actuators. Each image has one annotation; its category is the actuator.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ...tracker.errors import LabelError
from ...tracker.json_files import read_json
from ...tracker.project import Project
from ...tracker.types import FloatArray
from ..label_table import LabelRow
from .exporting import ExportReport, copy_images, labelled_videos, new_folder, skeleton_edges
from .source import ImageFinder, Source, SourceVideo, checked_name, distinct_names, foreign_path

_ACTUATOR = "actuator"  # the supercategory of our categories
_ANNOTATIONS, _IMAGES = "annotations", "images"
# The file name that CVAT accepts for import.
_FILE = "person_keypoints_default.json"


# --- in --------------------------------------------------------------------------------------------------


@dataclass
class _Found:
    """What has been read so far from all files."""

    keypoints: dict[str, None] = field(default_factory=dict)
    images: list[_CocoImage] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    hidden: int = 0


@dataclass(frozen=True)
class _CocoImage:
    """An image of the JSON, with a safe path, and its points."""

    name: PurePosixPath
    written: str
    cells: Mapping[tuple[str, str], str]
    category: str | None
    where: str


def open_coco(path: str | Path, images: str | Path | None = None) -> Source:
    """Read a JSON file of COCO keypoints, or all of them in a folder or its annotations/.

    The folder in an image's `file_name` is the video. Images without one belong to a video named after the folder of
    the JSON file. A folder with several categories becomes one video for each.

    Parameters
    ----------
    path : str or Path
        File or folder.
    images : str, Path or None, optional
        Folder of the images; None looks next to the JSON file, and in images/ there.

    Returns
    -------
    Source
        The images and labels.

    Raises
    ------
    LabelError
        The file has another format, or no labelled keypoints.
    """
    path = Path(path)
    files = coco_files(path) if path.is_dir() else [path]
    root = path if path.is_dir() else path.resolve().parent
    if root.name == _ANNOTATIONS:
        root = root.parent
    found, ours = _Found(), True
    for file in files:
        ours &= _read(file, found)
    if not any(image.cells for image in found.images):
        reasons = f" ({found.skipped[0]})" if found.skipped else ""
        raise LabelError(f"{path}: expected labelled COCO keypoints, got none{reasons}")
    finder = ImageFinder([Path(images)] if images is not None else [root])
    warnings = []
    if found.hidden:
        warnings.append(f"{found.hidden} points are marked as hidden (v = 1); their positions are taken")
    videos = _videos(found, root.resolve().name, finder, ours)
    return Source(path, tuple(found.keypoints), None, tuple(videos), tuple(warnings), tuple(found.skipped))


def coco_files(folder: Path) -> list[Path]:
    """Return the JSON files of a folder, or else of its annotations/, that hold COCO keypoints."""
    for subfolder in (folder, folder / _ANNOTATIONS):
        files = [file for file in sorted(subfolder.glob("*.json")) if _holds_keypoints(file)]
        if files:
            return files
    return []


def _holds_keypoints(file: Path) -> bool:
    try:
        categories = _document(file).get("categories")
    except LabelError:
        return False
    return isinstance(categories, list) and any(
        isinstance(c, dict) and c.get("keypoints") for c in categories
    )


def _document(file: Path) -> dict[str, Any]:
    document = read_json(file, LabelError, finite=False)
    if not isinstance(document, dict):
        raise LabelError(f"{file}: expected COCO keypoints, got a JSON {type(document).__name__}")
    return document


def _read(file: Path, found: _Found) -> bool:
    """Add a file's contents to `found`; return whether its categories are marked as bendtrack's actuators."""
    document = _document(file)
    images, annotations, categories = (
        _entries(document, key, file) for key in ("images", "annotations", "categories")
    )
    kinds = {}
    for category in categories:
        names = category.get("keypoints")
        if names:
            if not isinstance(names, list) or not all(isinstance(n, str) and n.strip() for n in names):
                raise LabelError(
                    f"{file}: expected a category's keypoints to be names, got {str(names)[:60]}"
                )
            if len(set(names)) < len(names):
                raise LabelError(f"{file}: expected distinct keypoints, got {', '.join(names)}")
            kinds[_id(category, "id", file)] = category
            found.keypoints |= dict.fromkeys(names)
    if not kinds:
        raise LabelError(f"{file}: expected COCO keypoints, got no category with keypoints")
    by_image = defaultdict(list)
    for annotation in annotations:
        by_image[_id(annotation, "image_id", file)].append(annotation)
    for image in images:
        written = image.get("file_name")
        if not isinstance(written, str) or not foreign_path(written).name:
            raise LabelError(f"{file}: expected every image to have a file_name, got {str(image)[:60]}")
        found.images.append(_image(written, by_image.pop(_id(image, "id", file), []), kinds, file, found))
    if by_image:
        found.skipped.append(
            f"{file.name}: {sum(map(len, by_image.values()))} annotations of images that it does not list"
        )
    return all(kind.get("supercategory") == _ACTUATOR for kind in kinds.values())


def _entries(document: Mapping[str, Any], key: str, file: Path) -> list[dict[str, Any]]:
    value = document.get(key)
    if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
        raise LabelError(f"{file}: expected COCO keypoints with a list of {key}, got {str(value)[:40]}")
    return value


def _id(entry: Mapping[str, Any], key: str, file: Path) -> int | str | float | None:
    value = entry.get(key)
    if isinstance(value, list | dict):
        raise LabelError(f"{file}: expected {key} to be a number or a text, got {str(value)[:40]}")
    return value


def _image(
    written: str,
    annotations: Sequence[Mapping[str, Any]],
    kinds: Mapping[Any, Mapping[str, Any]],
    file: Path,
    found: _Found,
) -> _CocoImage:
    labelled = []
    for annotation in annotations:
        kind = kinds.get(_id(annotation, "category_id", file))
        if kind is None:
            continue  # a box or an outline without points
        where = f"{file.name} annotation {annotation.get('id')}"
        try:
            cells, n_hidden = _cells(annotation.get("keypoints", []), kind["keypoints"])
        except LabelError as error:
            found.skipped.append(f"{written}: {where}: {error}")
            continue
        if cells:
            labelled.append((cells, n_hidden, _category_name(kind), where))
    if len(labelled) > 1:
        found.skipped.append(f"{written}: expected one actuator in each image, got {len(labelled)}")
    if len(labelled) != 1:
        return _CocoImage(foreign_path(written), written, {}, None, str(file))
    cells, n_hidden, category, where = labelled[0]
    found.hidden += n_hidden
    return _CocoImage(foreign_path(written), written, cells, category, where)


def _category_name(kind: Mapping[str, Any]) -> str:
    """Name of a category, which becomes part of a folder's name."""
    return checked_name(str(kind.get("name", ""))).strip()


def _cells(values: Any, names: Sequence[str]) -> tuple[dict[tuple[str, str], str], int]:
    """Return the label cells of one annotation, and the number of its hidden points."""
    if not isinstance(values, list) or len(values) not in (0, 3 * len(names)):
        got = len(values) if isinstance(values, list) else str(values)[:40]
        raise LabelError(f"expected {3 * len(names)} numbers as keypoints (x, y, v each), got {got}")
    if not values:
        return {}, 0
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        raise LabelError("expected numbers as keypoints, got something else")
    cells, n_hidden = {}, 0
    for name, x, y, v in zip(names, values[0::3], values[1::3], values[2::3], strict=True):
        if v not in (0, 1, 2):
            raise LabelError(f"expected 0, 1 or 2 as the visibility of '{name}', got {v}")
        if v:
            cells[name, "x"], cells[name, "y"] = _number(x), _number(y)
            n_hidden += v == 1
    return cells, n_hidden


def _number(value: int | float) -> str:
    try:
        return repr(float(value))
    except OverflowError:
        return "inf"  # refused with the frame's name, as every number that is not finite


def _videos(found: _Found, default: str, finder: ImageFinder, ours: bool) -> list[SourceVideo]:
    """Group images by their folder, and by category where a folder shows several."""
    folders = {image.name: _folder(image.name, default) for image in found.images}
    shown: dict[PurePosixPath, set[str]] = defaultdict(set)
    for image in found.images:
        if image.category is not None:
            shown[folders[image.name]].add(image.category)
    several = len(set().union(*shown.values())) > 1
    groups: dict[tuple[PurePosixPath, str | None], list[_CocoImage]] = defaultdict(list)
    for image in found.images:
        folder = folders[image.name]
        actuator = next(iter(shown[folder]), None)
        if len(shown[folder]) > 1:
            actuator = image.category
            if actuator is not None:
                folder = folder.with_name(
                    f"{folder.name}_{PurePosixPath(foreign_path(actuator)).as_posix().replace('/', '_')}"
                )
        groups[folder, actuator].append(image)
    videos = distinct_names(folder for folder, _ in groups)
    return [
        _video(videos[folder], images, finder, actuator if ours or several else None, found.skipped)
        for (folder, actuator), images in groups.items()
    ]


def _folder(name: PurePosixPath, default: str) -> PurePosixPath:
    parts = name.parent.parts
    if parts[:1] == (_IMAGES,):
        parts = parts[1:]
    return PurePosixPath(*parts) if parts else PurePosixPath(default)


def _video(
    video: str,
    images: Sequence[_CocoImage],
    finder: ImageFinder,
    actuator: str | None,
    skipped: list[str],
) -> SourceVideo:
    names = distinct_names(image.name for image in images)
    rows, files = [], {}
    for image in images:
        name = names[image.name]
        try:
            path = finder.find(image.written)
        except LabelError as error:
            skipped.append(f"{video}/{name}: {error}")
            continue
        if path is not None:
            files[name] = path.read_bytes
        if image.cells:
            rows.append(LabelRow(name, image.cells, video, image.where))
    return SourceVideo(video, tuple(rows), files, finder.where, actuator)


# --- out -------------------------------------------------------------------------------------------------


def export_coco(project: Project, out: str | Path) -> ExportReport:
    """Write images/<video>/ and annotations/person_keypoints_default.json, which CVAT and others import.

    Images are copied byte for byte, positions keep every digit: importing the result gives the same labels.
    The folder is created as a whole or not at all.

    Parameters
    ----------
    project : Project
        Project whose labels are written.
    out : str or Path
        The new folder; must not exist, or be empty.

    Returns
    -------
    ExportReport
        What was written.

    Raises
    ------
    LabelError
        Nothing is labelled, the labels are malformed, or `out` is not empty.
    OSError
        The folder cannot be written.
    """
    report = ExportReport()
    videos = labelled_videos(project, report)
    actuators = sorted({video.actuator for video in videos})
    names = list(project.keypoints)
    edges = [[names.index(a) + 1, names.index(b) + 1] for a, b in skeleton_edges(project)]
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    with new_folder(Path(out)) as folder:
        for video in videos:
            copy_images(video, folder / _IMAGES / video.video)
            for image in video.images:
                image_id = len(images) + 1
                images.append(
                    {
                        "id": image_id,
                        "width": video.size_wh[0],
                        "height": video.size_wh[1],
                        "file_name": f"{video.video}/{image.name}",
                    }
                )
                if image.name in video.xy:
                    category = actuators.index(video.actuator) + 1
                    annotations.append(
                        {
                            "id": len(annotations) + 1,
                            "image_id": image_id,
                            "category_id": category,
                            "iscrowd": 0,
                            **_annotation(video.xy[image.name]),
                        }
                    )
        document = {
            "info": {"description": f"{project.root.resolve().name}, written by bendtrack"},
            "licenses": [],
            "images": images,
            "annotations": annotations,
            "categories": [
                {
                    "id": number,
                    "name": actuator,
                    "supercategory": _ACTUATOR,
                    "keypoints": names,
                    "skeleton": edges,
                }
                for number, actuator in enumerate(actuators, start=1)
            ],
        }
        (folder / _ANNOTATIONS).mkdir()
        (folder / _ANNOTATIONS / _FILE).write_text(
            json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
        )
    return report


def _annotation(xy: FloatArray) -> dict[str, Any]:
    """Return the annotation of one image's points; the box, from the image's corner, contains all their pixels."""
    keypoints = []
    for x, y in xy.tolist():
        keypoints += [0, 0, 0] if np.isnan(x) else [x, y, 2]
    x0, y0 = np.nanmin(xy, axis=0).tolist()
    x1, y1 = np.nanmax(xy, axis=0).tolist()
    width, height = x1 - x0 + 1, y1 - y0 + 1
    return {
        "keypoints": keypoints,
        "num_keypoints": int(np.count_nonzero(~np.isnan(xy[:, 0]))),
        "bbox": [x0, y0, width, height],
        "area": width * height,
        "segmentation": [],
    }
