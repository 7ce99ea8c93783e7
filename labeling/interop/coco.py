"""COCO keypoints: one json of images, categories and annotations, and pictures beside it. In and out.

The format is that of cocodataset.org (Data format, Keypoint Detection): an annotation has `keypoints`
[x1, y1, v1, ...], v = 0 not labelled, 1 labelled but hidden, 2 labelled and visible; a category names the
keypoints and pairs them, counted from 1, into a skeleton. CVAT and Label Studio write it too.

Positions. COCO's keypoints are indices of pixels, so (0, 0) is the centre of the top-left pixel as everywhere
here, and they are used as they are; readers such as Detectron2 add 0.5 to keypoints, and not to boxes, for that
reason. Boxes are measured from the picture's corner. CVAT and Label Studio measure points from the corner as
well: theirs are 0.5 px too large in x and y, alike for all points, which no bending angle depends on.

Actuators. One annotation a picture; its category is the actuator.
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
from ...tracker.project import Project
from ...tracker.types import FloatArray
from ..label_table import LabelRow
from .exporting import ExportReport, copy_pictures, labelled_videos, new_folder, skeleton_edges
from .source import PictureFinder, Source, SourceVideo, distinct_names, foreign_path

_ACTUATOR = "actuator"  # the supercategory of our categories
_ANNOTATIONS, _IMAGES = "annotations", "images"
# The name under which CVAT takes such a file back.
_FILE = "person_keypoints_default.json"


# --- in --------------------------------------------------------------------------------------------------


@dataclass
class _Found:
    """What has been read so far, over all files."""

    keypoints: dict[str, None] = field(default_factory=dict)
    pictures: list[_Picture] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    hidden: int = 0


@dataclass(frozen=True)
class _Picture:
    """An image of the json, its path made safe, and its points."""

    name: PurePosixPath
    written: str
    cells: Mapping[tuple[str, str], str]
    category: str | None
    where: str


def open_coco(path: str | Path, images: str | Path | None = None) -> Source:
    """Read a json of COCO keypoints, or all of them in a folder or its annotations/.

    A folder in an image's `file_name` is the video; images without one belong to a video named after the folder
    of the json. A folder that shows several categories becomes one video for each.

    Parameters
    ----------
    path : file or folder
    images : where the pictures are; None looks beside the json, and in images/ there

    Raises
    ------
    LabelError
        Not such a file, or no labelled keypoints in it.
    """
    path = Path(path)
    files = coco_files(path) if path.is_dir() else [path]
    root = path if path.is_dir() else path.resolve().parent
    if root.name == _ANNOTATIONS:
        root = root.parent
    found, ours = _Found(), True
    for file in files:
        ours &= _read(file, found)
    if not any(picture.cells for picture in found.pictures):
        reasons = f" ({found.skipped[0]})" if found.skipped else ""
        raise LabelError(f"{path}: expected labelled COCO keypoints, got none{reasons}")
    finder = PictureFinder([Path(images)] if images is not None else [root])
    warnings = []
    if found.hidden:
        warnings.append(f"{found.hidden} points are marked as hidden (v = 1); their positions are taken")
    videos = _videos(found, root.resolve().name, finder, ours)
    return Source(path, tuple(found.keypoints), None, tuple(videos), tuple(warnings), tuple(found.skipped))


def coco_files(folder: Path) -> list[Path]:
    """The json files of a folder, or else of its annotations/, that hold COCO keypoints."""
    for place in (folder, folder / _ANNOTATIONS):
        files = [file for file in sorted(place.glob("*.json")) if _holds_keypoints(file)]
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
    try:
        document = json.loads(file.read_bytes().decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise LabelError(f"{file}: expected JSON, got a mistake ({error})") from error
    if not isinstance(document, dict):
        raise LabelError(f"{file}: expected COCO keypoints, got a JSON {type(document).__name__}")
    return document


def _read(file: Path, found: _Found) -> bool:
    """Add what a file holds; whether its categories are actuators by bendtrack's own word."""
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
            kinds[category.get("id")] = category
            found.keypoints |= dict.fromkeys(names)
    if not kinds:
        raise LabelError(f"{file}: expected COCO keypoints, got no category with keypoints")
    by_image = defaultdict(list)
    for annotation in annotations:
        by_image[annotation.get("image_id")].append(annotation)
    for image in images:
        written = image.get("file_name")
        if not isinstance(written, str) or not foreign_path(written).name:
            raise LabelError(f"{file}: expected every image to have a file_name, got {str(image)[:60]}")
        found.pictures.append(_picture(written, by_image.pop(image.get("id"), []), kinds, file, found))
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


def _picture(
    written: str,
    annotations: Sequence[Mapping[str, Any]],
    kinds: Mapping[Any, Mapping[str, Any]],
    file: Path,
    found: _Found,
) -> _Picture:
    labelled = []
    for annotation in annotations:
        kind = kinds.get(annotation.get("category_id"))
        if kind is None:
            continue  # a box or an outline beside the points
        where = f"{file.name} annotation {annotation.get('id')}"
        try:
            cells, n_hidden = _cells(annotation.get("keypoints", []), kind["keypoints"])
        except LabelError as error:
            found.skipped.append(f"{written}: {where}: {error}")
            continue
        if cells:
            labelled.append((cells, n_hidden, str(kind.get("name", "")), where))
    if len(labelled) > 1:
        found.skipped.append(f"{written}: expected one actuator a picture, got {len(labelled)}")
    if len(labelled) != 1:
        return _Picture(foreign_path(written), written, {}, None, str(file))
    cells, n_hidden, category, where = labelled[0]
    found.hidden += n_hidden
    return _Picture(foreign_path(written), written, cells, category, where)


def _cells(values: Any, names: Sequence[str]) -> tuple[dict[tuple[str, str], str], int]:
    """Label cells of one annotation, and how many of its points are hidden."""
    if not isinstance(values, list) or len(values) not in (0, 3 * len(names)):
        got = len(values) if isinstance(values, list) else str(values)[:40]
        raise LabelError(f"expected {3 * len(names)} numbers as keypoints (x, y, v each), got {got}")
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
        return str(value)


def _videos(found: _Found, default: str, finder: PictureFinder, ours: bool) -> list[SourceVideo]:
    """Pictures by the folder that they lie in, and by category where a folder shows several."""
    folders = {picture.name: _folder(picture.name, default) for picture in found.pictures}
    shown: dict[PurePosixPath, set[str]] = defaultdict(set)
    for picture in found.pictures:
        if picture.category is not None:
            shown[folders[picture.name]].add(picture.category)
    several = len(set().union(*shown.values())) > 1
    groups: dict[tuple[PurePosixPath, str | None], list[_Picture]] = defaultdict(list)
    for picture in found.pictures:
        folder = folders[picture.name]
        actuator = next(iter(shown[folder]), None)
        if len(shown[folder]) > 1:
            actuator = picture.category
            if actuator is not None:
                folder = folder.with_name(f"{folder.name}_{actuator.replace('/', '_')}")
        groups[folder, actuator].append(picture)
    videos = distinct_names(folder for folder, _ in groups)
    return [
        _video(videos[folder], pictures, finder, actuator if ours or several else None, found.skipped)
        for (folder, actuator), pictures in groups.items()
    ]


def _folder(name: PurePosixPath, default: str) -> PurePosixPath:
    parts = name.parent.parts
    if parts[:1] == (_IMAGES,):
        parts = parts[1:]
    return PurePosixPath(*parts) if parts else PurePosixPath(default)


def _video(
    video: str,
    pictures: Sequence[_Picture],
    finder: PictureFinder,
    actuator: str | None,
    skipped: list[str],
) -> SourceVideo:
    names = distinct_names(picture.name for picture in pictures)
    rows, files = [], {}
    for picture in pictures:
        image = names[picture.name]
        try:
            path = finder.find(picture.written)
        except LabelError as error:
            skipped.append(f"{video}/{image}: {error}")
            continue
        if path is not None:
            files[image] = path.read_bytes
        if picture.cells:
            rows.append(LabelRow(image, picture.cells, video, picture.where))
    return SourceVideo(video, tuple(rows), files, finder.where, actuator)


# --- out -------------------------------------------------------------------------------------------------


def export_coco(project: Project, out: str | Path) -> ExportReport:
    """Write images/<video>/ and annotations/person_keypoints_default.json, which CVAT and others take as it is.

    Pictures are copied byte for byte, positions keep every digit: importing the outcome gives the same labels.
    The folder appears whole or not at all.

    Parameters
    ----------
    project : whose labels
    out : must not exist, or be empty

    Raises
    ------
    LabelError
        Nothing is labelled, the labels are malformed, or `out` has something in it.
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
            copy_pictures(video, folder / _IMAGES / video.video)
            for picture in video.pictures:
                image_id = len(images) + 1
                images.append(
                    {
                        "id": image_id,
                        "width": video.size_wh[0],
                        "height": video.size_wh[1],
                        "file_name": f"{video.video}/{picture.name}",
                    }
                )
                if picture.name in video.xy:
                    category = actuators.index(video.actuator) + 1
                    annotations.append(
                        {
                            "id": len(annotations) + 1,
                            "image_id": image_id,
                            "category_id": category,
                            "iscrowd": 0,
                            **_annotation(video.xy[picture.name]),
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
    """Points of one picture. The box, measured from the picture's corner, holds the pixels of all of them."""
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
