"""The contents of a foreign project, in the one form that every format is read into.

Each format's own file creates it; `importing.py` uses it. Also here: finding an image by a path from another machine,
and distinct names for folders and images.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path, PurePosixPath, PureWindowsPath

from ...tracker.errors import LabelError
from ..label_table import LabelRow
from ..store import IMAGE_SUFFIXES

ReadImage = Callable[[], bytes]
"""Returns an image as the contents of an image file."""


@dataclass(frozen=True)
class SourceVideo:
    """The images and labels of one video.

    Attributes
    ----------
    video : str
        Its name in the project, the video's stem.
    rows : tuple of LabelRow
        Its labels, those of the source's own scorer first.
    images : mapping of str to ReadImage
        Image name -> function that reads the image, for the images that the source has.
    where : str
        Where images were searched, for messages.
    actuator : str or None
        The actuator that it shows, None where the source gives none.
    file : Path or None
        The video file, where the source names it and it exists.
    not_visible : mapping of str to tuple of str
        Image name -> keypoints that a person has marked as not visible.
    """

    video: str
    rows: tuple[LabelRow, ...]
    images: Mapping[str, ReadImage]
    where: str
    actuator: str | None = None
    file: Path | None = None
    not_visible: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Source:
    """The contents of a foreign project.

    Attributes
    ----------
    path : Path
        The file or folder that was read.
    keypoints : tuple of str
        Names, in the source's order.
    scorer : str or None
        Name of the scorer, None where the source gives none.
    videos : tuple of SourceVideo
        Videos with labels.
    warnings : tuple of str
        Warnings about what was read, one line each.
    skipped : tuple of str
        What cannot be used, "<video>/<image>: <reason>" each.
    """

    path: Path
    keypoints: tuple[str, ...]
    scorer: str | None
    videos: tuple[SourceVideo, ...]
    warnings: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()


def foreign_path(text: str) -> PurePosixPath:
    r"""Make a relative path of safe names from another machine's path: no drive, no root, no "..".

    >>> foreign_path("C:\\study\\..\\arm\\img1.png"), foreign_path("/data/.hidden/img1.png")
    (PurePosixPath('study/arm/img1.png'), PurePosixPath('data/hidden/img1.png'))
    """
    plain = checked_name(text).replace("\\", "/").removeprefix(PureWindowsPath(text).drive)
    parts = (part.strip().lstrip(".") for part in plain.split("/"))
    return PurePosixPath(*(part for part in parts if part))


def checked_name(text: str) -> str:
    """Return a name or path that a file can have.

    Parameters
    ----------
    text : str
        The name as a foreign project gives it.

    Returns
    -------
    str
        The same text.

    Raises
    ------
    LabelError
        It holds a control character or half a character.
    """
    if any(char < " " or char == "\x7f" or "\ud800" <= char <= "\udfff" for char in text):
        raise LabelError(f"expected a name of printable characters, got {text[:60]!a}")
    return text


def distinct_names(paths: Iterable[PurePosixPath]) -> dict[PurePosixPath, str]:
    """Return a distinct name for each path: its last part, or as many last parts as make paths of one name differ.

    Names also differ on a case-insensitive file system.

    >>> list(distinct_names(map(PurePosixPath, ("d/a/arm", "d/b/arm", "d/b/leg"))).values())
    ['a_arm', 'b_arm', 'leg']
    """
    alike: dict[str, list[PurePosixPath]] = defaultdict(list)
    for path in dict.fromkeys(paths):
        alike[path.name.casefold()].append(path)
    names: dict[PurePosixPath, str] = {}
    taken: set[str] = set()
    for group in alike.values():
        deepest = max(len(path.parts) for path in group)
        depth = next(
            (d for d in range(1, deepest) if len({_tail(p, d) for p in group}) == len(group)), deepest
        )
        for path in group:
            joined = PurePosixPath("_".join(path.parts[-depth:]))
            numbered = (f"{joined.stem}_{number}{joined.suffix}" for number in count(2))
            candidates = chain([joined.name], numbered)
            names[path] = next(name for name in candidates if name.casefold() not in taken)
            taken.add(names[path].casefold())
    return names


def _tail(path: PurePosixPath, depth: int) -> str:
    return "/".join(path.parts[-depth:]).casefold()


class ImageFinder:
    """Finds images in folders by the path that a foreign project gives them.

    Parameters
    ----------
    folders : iterable of Path
        Folders to search, in this order. Their subfolders are searched where the path itself does not exist.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self.folders = tuple(folders)
        self._by_name: dict[str, list[Path]] | None = None

    @property
    def where(self) -> str:
        """Names of the folders, for messages."""
        return " or ".join(map(str, self.folders))

    def find(self, text: str) -> Path | None:
        """Find the image whose path shares the most last parts with a foreign path.

        Parameters
        ----------
        text : str
            Path as the foreign project gives it.

        Returns
        -------
        Path or None
            The image file, None where there is none.

        Raises
        ------
        LabelError
            Several images fit equally well.
        """
        wanted = foreign_path(text)
        for folder in self.folders:
            for path in (folder / wanted, folder / "images" / wanted):
                if path.is_file():
                    return path
        if Path(text).is_absolute() and Path(text).is_file():
            return Path(text)
        fits = [(_common_tail(path, wanted), path) for path in self._below().get(wanted.name.casefold(), [])]
        best = max((n_parts for n_parts, _ in fits), default=0)
        found = sorted(path for n_parts, path in fits if n_parts == best)
        if len(found) > 1:
            raise LabelError(f"expected one image of that name, got {found[0]} and {found[1]}")
        return found[0] if found else None

    def _below(self) -> dict[str, list[Path]]:
        if self._by_name is None:
            self._by_name = defaultdict(list)
            for folder in self.folders:
                for subfolder, _, names in os.walk(folder):
                    for name in names:
                        if name.lower().endswith(IMAGE_SUFFIXES):
                            self._by_name[name.casefold()].append(Path(subfolder, name))
        return self._by_name


def _common_tail(path: Path, wanted: PurePosixPath) -> int:
    pairs = zip(reversed(path.parts), reversed(wanted.parts), strict=False)
    return next((n for n, (a, b) in enumerate(pairs) if a.casefold() != b.casefold()), len(wanted.parts))
