"""Which folder of labeled-data/ is a video's: the one of its name whose pictures are frames of it.

Two videos of one name never share a folder; the second one's has the first digits of its hash in its name.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from ..tracker.video import file_sha256, video_stem
from .glimpses import Glimpse, look_of
from .store import LabelStore, frame_index

# A saved picture and the frame of its number differ by less than this (grey levels): by coding alone.
_OTHER_PICTURE = 2.5


def possible_stems(video: Path) -> list[str]:
    """Names that a video's folder may have, the plain one first."""
    stem = video_stem(video)
    return [stem, f"{stem}-{file_sha256(video)[:8]}"] if video.is_file() else [stem]


def numbered_pictures(store: LabelStore, stem: str) -> dict[int, Path]:
    """Pictures of a folder by the frame that their names tell."""
    found = ((frame_index(path.name), path) for path in store.images(stem))
    return {index: path for index, path in found if index is not None}


def own_stem(
    store: LabelStore, stems: Sequence[str], taken: Collection[str], known: Sequence[Glimpse]
) -> str:
    """The first of the names that is not another video's.

    Parameters
    ----------
    stems : as `possible_stems` gives them
    taken : names of other videos that are at hand
    known : glimpses of those of the video's frames for which a folder of these names has a picture
    """
    looks = {glimpse.frame: glimpse for glimpse in known}
    free = [stem for stem in stems if stem not in taken]
    return next((stem for stem in free if _is_of(numbered_pictures(store, stem), looks)), stems[-1])


def _is_of(pictures: Mapping[int, Path], looks: Mapping[int, Glimpse]) -> bool:
    """Whether pictures are frames of a video; one of another size (a crop) is taken for another's."""
    return all(index in looks and _shows(path, looks[index]) for index, path in pictures.items())


def _shows(picture: Path, glimpse: Glimpse) -> bool:
    grey = cv2.imdecode(np.frombuffer(picture.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    look = None if grey is None else look_of(grey)
    if look is None or look.shape != glimpse.look.shape:
        return False
    # What remains after the best brightness and contrast: formats differ in both.
    seen = np.stack([look.ravel(), np.ones(look.size)], axis=1)
    fit = np.linalg.lstsq(seen, glimpse.look.ravel(), rcond=None)[0]
    return bool(np.sqrt(np.mean((seen @ fit - glimpse.look.ravel()) ** 2)) < _OTHER_PICTURE)
