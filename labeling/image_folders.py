"""Folders of images in labeled-data/: which one belongs to a video, checked by comparing images with its frames.

Two videos of one name never share a folder. The folder of the second has the first digits of its hash in its name.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from ..tracker.errors import LabelError
from ..tracker.hashing import file_sha256
from ..tracker.image_files import decode_image
from ..tracker.video import video_stem
from .frame_descriptors import FrameDescriptor, grey_thumbnail
from .store import LabelStore, frame_index

# Grey levels. A saved image and its own frame differ by less, by the codec alone.
_MAX_RMS_DIFFERENCE = 2.5


def candidate_stems(video: Path) -> list[str]:
    """Return the names that a video's folder may have: its stem, then its stem with a hash."""
    stem = video_stem(video)
    return [stem, f"{stem}-{file_sha256(video)[:8]}"] if video.is_file() else [stem]


def images_by_frame(store: LabelStore, stem: str) -> dict[int, Path]:
    """Return the images of a folder by the frame index in their names; images without one are left out."""
    found = ((frame_index(path.name), path) for path in store.images(stem))
    return {index: path for index, path in found if index is not None}


def resolve_stem(
    store: LabelStore, stems: Sequence[str], taken: Collection[str], known: Sequence[FrameDescriptor]
) -> str:
    """Return the first of the names that does not belong to another video.

    Parameters
    ----------
    store : LabelStore
        The project's label store.
    stems : sequence of str
        The names, as from `candidate_stems`.
    taken : collection of str
        Names given to other videos already.
    known : sequence of FrameDescriptor
        Descriptors of the video's frames that have an image in a folder of one of these names.

    Returns
    -------
    str
        Name of the video's folder; the last of `stems` where all others belong to other videos.
    """
    descriptors = {descriptor.frame: descriptor for descriptor in known}
    free = [stem for stem in stems if stem not in taken]
    return next((stem for stem in free if _all_match(images_by_frame(store, stem), descriptors)), stems[-1])


def _all_match(images: Mapping[int, Path], descriptors: Mapping[int, FrameDescriptor]) -> bool:
    """Whether all images are frames of the video. An image of another size (a crop) is not."""
    return all(index in descriptors and _matches(path, descriptors[index]) for index, path in images.items())


def _matches(path: Path, descriptor: FrameDescriptor) -> bool:
    try:
        grey = decode_image(path.read_bytes(), cv2.IMREAD_GRAYSCALE)
    except LabelError:  # larger than any frame
        return False
    thumbnail = None if grey is None else grey_thumbnail(grey)
    if thumbnail is None or thumbnail.shape != descriptor.thumbnail.shape:
        return False
    # The residual after fitting brightness and contrast, in which image formats differ.
    seen = np.stack([thumbnail.ravel(), np.ones(thumbnail.size)], axis=1)
    fit = np.linalg.lstsq(seen, descriptor.thumbnail.ravel(), rcond=None)[0]
    return bool(np.sqrt(np.mean((seen @ fit - descriptor.thumbnail.ravel()) ** 2)) < _MAX_RMS_DIFFERENCE)
