"""Where points probably are: what a page shows as ghosts when there is no network, from the labelled neighbours.

The network's own predictions come from `predictions.py`.
"""

from __future__ import annotations

from collections.abc import Sequence

from .annotations import VideoFolder
from .label_table import Point


def neighbour_points(folder: VideoFolder, image: str, keypoints: Sequence[str]) -> dict[str, Point]:
    """Each keypoint where the nearest frames before and after that have it put it.

    In between, positions go evenly with the frame index; beyond the first or last, they stay. Where a picture's name
    tells no index, pictures count as evenly spaced.

    Returns
    -------
    keypoint -> (x, y) px; left out where no other frame of the video has it
    """
    names = list(folder.pictures)
    frames = [folder.pictures[name].frame for name in names]
    known = [frame for frame in frames if frame is not None]
    place = dict(zip(names, known if len(known) == len(names) else range(len(names)), strict=True))
    here = names.index(image)
    ghosts = {}
    for keypoint in keypoints:
        before = next((n for n in reversed(names[:here]) if keypoint in folder.states[n].points), None)
        after = next((n for n in names[here + 1 :] if keypoint in folder.states[n].points), None)
        if before is None or after is None:
            only = before or after
            if only is not None:
                ghosts[keypoint] = folder.states[only].points[keypoint]
            continue
        span = place[after] - place[before]
        share = (place[image] - place[before]) / span if span else 0.5
        (x0, y0), (x1, y1) = (folder.states[n].points[keypoint] for n in (before, after))
        ghosts[keypoint] = (x0 + share * (x1 - x0), y0 + share * (y1 - y0))
    return ghosts
