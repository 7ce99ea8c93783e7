"""Suggested points of a frame without a network: interpolated between the labelled frames next to it.

The network's own predictions come from `predictions.py`.
"""

from __future__ import annotations

from collections.abc import Sequence

from .annotations import VideoFolder
from .label_table import Point


def interpolated_points(folder: VideoFolder, image: str, keypoints: Sequence[str]) -> dict[str, Point]:
    """Interpolate each keypoint between the nearest frames before and after in which it is labelled.

    Positions are linear in the frame index; before the first and after the last label they are constant. Where an
    image's name gives no frame index, images count as evenly spaced.

    Parameters
    ----------
    folder : VideoFolder
        The video's frames.
    image : str
        File name of the frame's image.
    keypoints : sequence of str
        Keypoints to interpolate.

    Returns
    -------
    dict of str to Point
        Keypoint -> (x, y) px. A keypoint that no other frame of the video has is left out.
    """
    names = list(folder.images)
    frames = [folder.images[name].frame for name in names]
    known = [frame for frame in frames if frame is not None]
    index_of = dict(zip(names, known if len(known) == len(names) else range(len(names)), strict=True))
    here = names.index(image)
    suggestions = {}
    for keypoint in keypoints:
        before = next((n for n in reversed(names[:here]) if keypoint in folder.states[n].points), None)
        after = next((n for n in names[here + 1 :] if keypoint in folder.states[n].points), None)
        if before is None or after is None:
            only = before or after
            if only is not None:
                suggestions[keypoint] = folder.states[only].points[keypoint]
            continue
        span = index_of[after] - index_of[before]
        share = (index_of[image] - index_of[before]) / span if span else 0.5
        (x0, y0), (x1, y1) = (folder.states[n].points[keypoint] for n in (before, after))
        suggestions[keypoint] = (x0 + share * (x1 - x0), y0 + share * (y1 - y0))
    return suggestions
