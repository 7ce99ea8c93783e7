"""What a foreign project holds, before any of it is used: the one form that every format is read into.

Each format's own file makes it; what becomes of it is in `importing.py`. Also here: finding a picture by a path
that another machine wrote down, and names for folders and pictures of which none hides another.
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

ReadPicture = Callable[[], bytes]
"""Gives a picture as the contents of an image file."""


@dataclass(frozen=True)
class SourceVideo:
    """The labelled pictures of one video.

    Attributes
    ----------
    video : its name in the project, the video's stem
    rows : its labels as they stand, the source's own scorer first
    pictures : image name -> the picture, for those that the source has
    where : where pictures were looked for, for messages
    actuator : which actuator it shows, None where the source does not say
    file : the video itself, where the source names it and it is there
    not_visible : image name -> keypoints that a person has said cannot be seen
    """

    video: str
    rows: tuple[LabelRow, ...]
    pictures: Mapping[str, ReadPicture]
    where: str
    actuator: str | None = None
    file: Path | None = None
    not_visible: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Source:
    """What there is to import.

    Attributes
    ----------
    path : as it was given
    keypoints : names, in the source's order
    scorer : who labelled, None where the source does not say
    videos : with labels
    warnings : what was taken and is worth a look
    skipped : what cannot be used, "<video>/<image>: <reason>" each
    """

    path: Path
    keypoints: tuple[str, ...]
    scorer: str | None
    videos: tuple[SourceVideo, ...]
    warnings: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()


def foreign_path(text: str) -> PurePosixPath:
    """A path that another machine wrote down, as parts that are safe names: no drive, no root, no "..".

    >>> foreign_path("C:\\\\study\\\\..\\\\arm\\\\img1.png"), foreign_path("/data/.hidden/img1.png")
    (PurePosixPath('study/arm/img1.png'), PurePosixPath('data/hidden/img1.png'))
    """
    plain = text.replace("\\", "/").removeprefix(PureWindowsPath(text).drive)
    parts = (part.strip().lstrip(".") for part in plain.split("/"))
    return PurePosixPath(*(part for part in parts if part))


def distinct_names(paths: Iterable[PurePosixPath]) -> dict[PurePosixPath, str]:
    """A name for each path: its last part, or as many of its last parts as tell those apart that end alike.

    No two names are the same on a disk that does not tell upper from lower case.

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


class PictureFinder:
    """Finds pictures under some folders by the path that a foreign project gives them.

    Parameters
    ----------
    folders : looked through in this order; all that is below them only where the plain path leads nowhere
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self.folders = tuple(folders)
        self._by_name: dict[str, list[Path]] | None = None

    @property
    def where(self) -> str:
        """The folders, for messages."""
        return " or ".join(map(str, self.folders))

    def find(self, text: str) -> Path | None:
        """The picture that fits best (most of the path's last parts), None where there is none.

        Raises
        ------
        LabelError
            There are several that fit equally well.
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
            raise LabelError(f"expected one picture of that name, got {found[0]} and {found[1]}")
        return found[0] if found else None

    def _below(self) -> dict[str, list[Path]]:
        if self._by_name is None:
            self._by_name = defaultdict(list)
            for folder in self.folders:
                for place, _, names in os.walk(folder):
                    for name in names:
                        if name.lower().endswith(IMAGE_SUFFIXES):
                            self._by_name[name.casefold()].append(Path(place, name))
        return self._by_name


def _common_tail(path: Path, wanted: PurePosixPath) -> int:
    pairs = zip(reversed(path.parts), reversed(wanted.parts), strict=False)
    return next((n for n, (a, b) in enumerate(pairs) if a.casefold() != b.casefold()), len(wanted.parts))
