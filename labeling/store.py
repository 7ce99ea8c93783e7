"""The labels of a project: labeled-data/<video stem>/ with images and CollectedData_<scorer>.csv beside them.

The form of the CSV itself is in `label_table.py`. One file for each video, replaced whole: who reads while
another writes sees the labels before or after, never half of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from ..tracker.atomic import atomic_write_bytes, atomic_write_text
from ..tracker.errors import LabelError
from ..tracker.project import Project
from ..tracker.types import FloatArray, ImageArray, LabelledFrame
from .label_table import LabelRow, LabelTable, Point, format_label_table, read_label_table, same_number

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


class LabelStore:
    """Reads and writes the labels of one labeled-data folder.

    Every CollectedData_*.csv beside the images is read; only the own scorer's is written. Where several files
    label one image, the own scorer's row counts.

    Parameters
    ----------
    labels_dir : the labeled-data folder; need not exist yet
    keypoints : names, in the order of the arrays; other body parts in the files are kept, unread
    scorer : whose file is written
    actuator_of : video stem -> actuator
    """

    def __init__(
        self, labels_dir: Path, keypoints: Sequence[str], scorer: str, actuator_of: Callable[[str], str]
    ) -> None:
        self.labels_dir = labels_dir
        self.keypoints = tuple(keypoints)
        self.scorer = scorer
        self._actuator_of = actuator_of

    @classmethod
    def of(cls, project: Project) -> LabelStore:
        """The labels of a project."""
        return cls(project.labels_dir, project.keypoints, project.settings.scorer, project.actuator_of)

    def videos(self) -> list[str]:
        """Stems of the videos that have a folder, sorted."""
        if not self.labels_dir.is_dir():
            return []
        return sorted(f.name for f in self.labels_dir.iterdir() if f.is_dir() and not f.name.startswith("."))

    def images(self, video: str) -> list[Path]:
        """Pictures of a video, labelled or not, in the order of their frames."""
        return images_in(self.labels_dir / video)

    def csv_path(self, video: str) -> Path:
        """The file that `write` writes."""
        return self.labels_dir / video / f"CollectedData_{self.scorer}.csv"

    def read(self, *, unlabelled: bool = False) -> list[LabelledFrame]:
        """All labelled frames, by video and then by frame.

        Parameters
        ----------
        unlabelled : also give the rows in which no keypoint of the project is labelled (all NaN)

        Raises
        ------
        LabelError
            A file is malformed, an image of a labelled row is missing, or two people's labels contradict each
            other; with file, line and column.
        """
        frames = []
        for video in self.videos():
            for row in self.table(video).rows:
                xy = self._xy(row)
                if np.isnan(xy).all() and not unlabelled:
                    continue
                path = self.labels_dir / video / row.image
                if not path.is_file():
                    raise LabelError(f"{row.where}: expected the image {path}, got no such file")
                index = frame_index(row.image)
                frames.append(LabelledFrame(video, path, xy, self._actuator_of(video), index))
        return frames

    def table(self, video: str) -> LabelTable:
        """The rows of a video merged over its label files, with every body part that they name.

        Raises
        ------
        LabelError
            As `read`.
        """
        own = self._own_table(video)
        bodyparts = dict.fromkeys([*self.keypoints, *own.bodyparts])
        rows: dict[str, LabelRow] = {}
        for path in label_files(self.labels_dir / video):
            if path != self.csv_path(video):
                table = read_label_table(path)
                bodyparts |= dict.fromkeys(table.bodyparts)
                rows = merge_rows([*rows.values(), *table.rows])
        return LabelTable(tuple(bodyparts), sorted_rows((rows | merge_rows(own.rows)).values()))

    def write(self, video: str, labels: Mapping[str, FloatArray]) -> None:
        """Set the labels of some images of a video; all others stay as they are.

        Parameters
        ----------
        video : stem, the name of the folder
        labels : image name -> (K, 2) px in the order of the keypoints; NaN takes a point's label away

        Raises
        ------
        LabelError
            An image is not in the folder, an array has another shape or an infinite number, or the existing
            file is malformed.
        OSError
            The file cannot be written; the old one is then as it was.
        """
        points: dict[str, dict[str, Point | None]] = {}
        for image, xy in labels.items():
            array = np.asarray(xy, dtype=np.float64)
            if array.shape != (len(self.keypoints), 2):
                raise LabelError(
                    f"{video}/{image}: expected positions ({len(self.keypoints)}, 2), got {array.shape}"
                )
            missing = np.logical_or(np.isnan(array[:, 0]), np.isnan(array[:, 1]))
            if np.isinf(array).any() or (np.isnan(array).all(axis=1) != missing).any():
                raise LabelError(f"{video}/{image}: expected x and y, or NaN for both, got {array.tolist()}")
            points[image] = {
                name: None if gone else (float(x), float(y))
                for name, (x, y), gone in zip(self.keypoints, array, missing, strict=True)
            }
        self.write_points(video, points)

    def write_points(self, video: str, points: Mapping[str, Mapping[str, Point | None]]) -> None:
        """As `write`, by body part: one that is not named stays; the project need not know it."""
        for image in points:
            if not (self.labels_dir / video / image).is_file():
                raise LabelError(
                    f"expected an image to label, got no such file: {self.labels_dir / video / image}"
                )
        merged = self.table(video)
        rows = merge_rows(self._own_table(video).rows)
        inherited = {row.image: row for row in merged.rows}
        for image, changes in points.items():
            # The first own label of an image that someone else labelled takes the other points along.
            before = rows.get(image) or inherited.get(image) or LabelRow(image, {})
            rows[image] = before.with_points(changes)
        bodyparts = dict.fromkeys([*merged.bodyparts, *(part for named in points.values() for part in named)])
        text = format_label_table(sorted_rows(rows.values()), bodyparts, video, self.scorer)
        atomic_write_text(self.csv_path(video), text)

    def add_image(self, video: str, name: str, image: ImageArray) -> Path:
        """Save a frame of a video (RGB uint8 (H, W, 3)) under a name (see `image_name`); its path."""
        path = self.labels_dir / video / name
        coded, data = cv2.imencode(path.suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        if not coded:
            raise LabelError(f"{path}: expected a picture that can be saved, got {image.shape}")
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write_bytes(path, data.tobytes())
        return path

    def _own_table(self, video: str) -> LabelTable:
        path = self.csv_path(video)
        return read_label_table(path, self.scorer) if path.is_file() else LabelTable()

    def _xy(self, row: LabelRow) -> FloatArray:
        points = [row.point(keypoint) for keypoint in self.keypoints]
        return np.array([point or (np.nan, np.nan) for point in points], dtype=np.float64)


def image_name(frame: int) -> str:
    """File name of the picture of a frame.

    >>> image_name(42)
    'img00042.png'
    """
    return f"img{frame:05d}.png"


def frame_index(image: str) -> int | None:
    """Index of the frame that a picture's name tells, None when it does not.

    >>> frame_index("img00042.png"), frame_index("img7.jpg"), frame_index("close-up.png")
    (42, 7, None)
    """
    found = re.fullmatch(r"img(\d+)\.\w+", image)
    return int(found[1]) if found else None


def image_size_wh(path: Path) -> tuple[int, int] | None:
    """(width, height) in px of a picture, None where the file does not open as one."""
    return picture_size_wh(path.read_bytes())


def picture_size_wh(contents: bytes) -> tuple[int, int] | None:
    """(width, height) in px of a picture, given the contents of its file; None where they are none."""
    data = np.frombuffer(contents, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    return None if image is None else (image.shape[1], image.shape[0])


def label_files(folder: Path) -> list[Path]:
    """The CollectedData CSVs of a folder, sorted."""
    return sorted(p for p in folder.glob("CollectedData_*.csv") if p.is_file())


def images_in(folder: Path) -> list[Path]:
    """The pictures of a folder in the order of their frames."""
    if not folder.is_dir():
        return []
    found = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
    return sorted(found, key=lambda path: _image_order(path.name))


def merge_rows(rows: Iterable[LabelRow]) -> dict[str, LabelRow]:
    """Rows by image; an image that stands there twice is one row, if its rows agree.

    Raises
    ------
    LabelError
        They do not agree.
    """
    merged: dict[str, LabelRow] = {}
    for row in rows:
        merged[row.image] = merge_row(merged[row.image], row) if row.image in merged else row
    return merged


def merge_row(first: LabelRow, second: LabelRow) -> LabelRow:
    """Both rows' cells, for two rows of one image that do not contradict each other."""
    for cell, text in first.cells.items():
        if not same_number(text, second.cells.get(cell, text)):
            raise LabelError(
                f"{second.where}, column {' '.join(cell)}: {second.image} is labelled twice, expected "
                f"{text} as in {first.where}, got {second.cells[cell]}"
            )
    return LabelRow(first.image, {**second.cells, **first.cells}, first.video, first.where)


def sorted_rows(rows: Iterable[LabelRow]) -> tuple[LabelRow, ...]:
    """Rows in the order of their frames, then of their names."""
    return tuple(sorted(rows, key=lambda row: _image_order(row.image)))


def sorted_by_frame(images: Iterable[str]) -> list[str]:
    """Image names in the order of their frames, then of their names."""
    return sorted(images, key=_image_order)


def _image_order(image: str) -> tuple[bool, int, str]:
    index = frame_index(image)
    return (index is None, index or 0, image)
