"""The label store of a project: labeled-data/<video stem>/ with images and CollectedData_<scorer>.csv.

The CSV's format is in `label_table.py`. There is one file for each video. It is replaced atomically, so a reader gets
the labels before or after a write, never a part of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from ..tracker.atomic import atomic_write_bytes, atomic_write_text
from ..tracker.errors import LabelError
from ..tracker.links import make_folder
from ..tracker.project import Project
from ..tracker.types import FloatArray, ImageArray, LabelledFrame
from .label_table import LabelRow, LabelTable, Point, format_label_table, read_label_table, same_number

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


class LabelStore:
    """Reads and writes the labels of one labeled-data folder.

    Every CollectedData_*.csv next to the images is read; only that of `scorer` is written. Where several files label
    one image, the row of `scorer` counts.

    Parameters
    ----------
    labels_dir : Path
        The labeled-data folder; it need not exist yet.
    keypoints : sequence of str
        Names of the K keypoints, in the order of the arrays. Other body parts in the files are kept, but not read.
    scorer : str
        Scorer whose file is written.
    actuator_of : callable
        Takes a video stem and returns its actuator.
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
        """Return the label store of a project."""
        return cls(project.labels_dir, project.keypoints, project.settings.scorer, project.actuator_of)

    def videos(self) -> list[str]:
        """Return the stems of the videos that have a folder, sorted."""
        if not self.labels_dir.is_dir():
            return []
        return sorted(f.name for f in self.labels_dir.iterdir() if f.is_dir() and not f.name.startswith("."))

    def images(self, video: str) -> list[Path]:
        """Return the images of a video, labelled or not, in the order of their frames."""
        return images_in(self.labels_dir / video)

    def csv_path(self, video: str) -> Path:
        """Return the path of the label file that `write` writes."""
        return self.labels_dir / video / f"CollectedData_{self.scorer}.csv"

    def read(self, *, unlabelled: bool = False) -> list[LabelledFrame]:
        """Read all labelled frames.

        Parameters
        ----------
        unlabelled : bool, optional
            Also return rows in which no keypoint of the project is labelled (all NaN).

        Returns
        -------
        list of LabelledFrame
            By video, then by frame; `xy` is (K, 2) px with NaN where a point is not labelled.

        Raises
        ------
        LabelError
            A file is malformed, an image of a labelled row is missing, or labels of two scorers contradict each
            other. The message gives file, line and column.
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
        """Read the rows of a video, merged over its label files.

        Parameters
        ----------
        video : str
            Stem, the name of the folder.

        Returns
        -------
        LabelTable
            One row for each image, with every body part that the files name.

        Raises
        ------
        LabelError
            A file is malformed, or labels of two scorers contradict each other.
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
        video : str
            Stem, the name of the folder.
        labels : mapping of str to ndarray of float
            Image name -> (K, 2) px in the order of the keypoints; NaN removes a point's label.

        Raises
        ------
        LabelError
            An image is not in the folder, an array has another shape or an infinite number, or the existing
            file is malformed.
        OSError
            The file cannot be written; the old one is unchanged.
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
        """Set the labels of single body parts; all others stay as they are.

        Parameters
        ----------
        video : str
            Stem, the name of the folder.
        points : mapping of str to mapping of str to Point or None
            Image name -> body part -> (x, y) px, None to remove the label. Body parts need not be keypoints of the
            project.

        Raises
        ------
        LabelError
            An image is not in the folder, or the existing file is malformed.
        OSError
            The file cannot be written; the old one is unchanged.
        """
        for image in points:
            if not (self.labels_dir / video / image).is_file():
                raise LabelError(
                    f"expected an image to label, got no such file: {self.labels_dir / video / image}"
                )
        merged = self.table(video)
        rows = merge_rows(self._own_table(video).rows)
        inherited = {row.image: row for row in merged.rows}
        for image, changes in points.items():
            # The first own label of an image that another scorer has labelled copies that scorer's other points.
            before = rows.get(image) or inherited.get(image) or LabelRow(image, {})
            rows[image] = before.with_points(changes)
        bodyparts = dict.fromkeys([*merged.bodyparts, *(part for named in points.values() for part in named)])
        text = format_label_table(sorted_rows(rows.values()), bodyparts, video, self.scorer)
        atomic_write_text(self.csv_path(video), text)

    def add_image(self, video: str, name: str, image: ImageArray) -> Path:
        """Save a frame of a video as an image file.

        Parameters
        ----------
        video : str
            Stem, the name of the folder, which is made if needed.
        name : str
            File name, see `image_name`.
        image : ndarray of uint8
            (H, W, 3), RGB.

        Returns
        -------
        Path
            The image file.

        Raises
        ------
        LabelError
            The image cannot be encoded.
        OSError
            The file cannot be written.
        """
        path = self.labels_dir / video / name
        coded, data = cv2.imencode(path.suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        if not coded:
            raise LabelError(f"{path}: expected an image that can be saved, got {image.shape}")
        make_folder(path.parent)
        atomic_write_bytes(path, data.tobytes())
        return path

    def _own_table(self, video: str) -> LabelTable:
        path = self.csv_path(video)
        return read_label_table(path, self.scorer) if path.is_file() else LabelTable()

    def _xy(self, row: LabelRow) -> FloatArray:
        points = [row.point(keypoint) for keypoint in self.keypoints]
        return np.array([point or (np.nan, np.nan) for point in points], dtype=np.float64)


def image_name(frame: int) -> str:
    """Return the file name of a frame's image.

    >>> image_name(42)
    'img00042.png'
    """
    return f"img{frame:05d}.png"


def frame_index(image: str) -> int | None:
    """Return the frame index in an image's name, None where there is none.

    >>> frame_index("img00042.png"), frame_index("img7.jpg"), frame_index("close-up.png")
    (42, 7, None)
    """
    found = re.fullmatch(r"img(\d+)\.\w+", image)
    return int(found[1]) if found else None


def image_size_wh(path: Path) -> tuple[int, int] | None:
    """Return (width, height) in px of an image file, None where it does not open as an image."""
    return encoded_size_wh(path.read_bytes())


def encoded_size_wh(contents: bytes) -> tuple[int, int] | None:
    """Return (width, height) in px of an encoded image, None where the bytes do not decode as an image."""
    data = np.frombuffer(contents, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    return None if image is None else (image.shape[1], image.shape[0])


def label_files(folder: Path) -> list[Path]:
    """Return the CollectedData CSVs of a folder, sorted."""
    return sorted(p for p in folder.glob("CollectedData_*.csv") if p.is_file())


def images_in(folder: Path) -> list[Path]:
    """Return the images of a folder in the order of their frames."""
    if not folder.is_dir():
        return []
    found = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
    return sorted(found, key=lambda path: _image_order(path.name))


def merge_rows(rows: Iterable[LabelRow]) -> dict[str, LabelRow]:
    """Merge rows by image.

    Parameters
    ----------
    rows : iterable of LabelRow
        Rows, several of which may be of one image.

    Returns
    -------
    dict of str to LabelRow
        Image name -> its row.

    Raises
    ------
    LabelError
        Rows of one image contradict each other.
    """
    merged: dict[str, LabelRow] = {}
    for row in rows:
        merged[row.image] = merge_row(merged[row.image], row) if row.image in merged else row
    return merged


def merge_row(first: LabelRow, second: LabelRow) -> LabelRow:
    """Merge the cells of two rows of one image.

    Parameters
    ----------
    first, second : LabelRow
        The rows; where both have a cell, the text of the first one is kept.

    Returns
    -------
    LabelRow
        The merged row.

    Raises
    ------
    LabelError
        The rows contradict each other.
    """
    for cell, text in first.cells.items():
        if not same_number(text, second.cells.get(cell, text)):
            raise LabelError(
                f"{second.where}, column {' '.join(cell)}: {second.image} is labelled twice, expected "
                f"{text} as in {first.where}, got {second.cells[cell]}"
            )
    return LabelRow(first.image, {**second.cells, **first.cells}, first.video, first.where)


def sorted_rows(rows: Iterable[LabelRow]) -> tuple[LabelRow, ...]:
    """Sort rows by frame, then by image name."""
    return tuple(sorted(rows, key=lambda row: _image_order(row.image)))


def sorted_by_frame(images: Iterable[str]) -> list[str]:
    """Sort image names by frame, then by name."""
    return sorted(images, key=_image_order)


def _image_order(image: str) -> tuple[bool, int, str]:
    index = frame_index(image)
    return (index is None, index or 0, image)
