"""What a labelling page is told: of the project, its frames, the network's state and the blind repeats.

Plain JSON-ready values as page/API.md has them; asked for over HTTP in `server.py`. Nothing is changed here.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from itertools import pairwise
from typing import Any
from urllib.parse import quote

import numpy as np

from ..tracker.angle import AngleDefinition
from ..tracker.errors import AngleError
from .annotations import Annotations, Picture, VideoFolder
from .edits import Editor
from .frame_state import FrameState, Progress
from .ghosts import neighbour_points
from .pictures import picture_size_wh
from .predictions import Prediction, Predictions
from .repeats import REMEMBERED, RepeatPlan, project_spread, repeat_plan
from .summary import labels_summary

_PREFETCHED = 3


class NoFrameError(LookupError):
    """A page asks for a frame that is not there, or no longer."""


class PageFacts:
    """What is told of a project.

    Parameters
    ----------
    annotations, editor : the project's frames
    repeat_share : share of the labelled frames that comes back blind

    Attributes
    ----------
    predictions : the network at work, None without one
    """

    def __init__(self, annotations: Annotations, editor: Editor, repeat_share: float) -> None:
        self._annotations = annotations
        self._editor = editor
        self._repeat_share = repeat_share
        self.predictions: Predictions | None = None

    def project(self) -> dict[str, Any]:
        """The project: its keypoints, angle, actuators."""
        self._annotations.refresh()
        project = self._annotations.project
        folders = self._annotations.folders()
        definition = self.definition(folders)
        chain = [project.keypoints.index(name) for name in definition.points]
        return {
            "name": self._annotations.project.root.resolve().name,
            "scorer": project.settings.scorer,
            "keypoints": list(project.keypoints),
            "definition": {
                "name": definition.name,
                "points": list(definition.points),
                "sign": definition.sign,
            },
            "skeleton": [list(pair) for pair in pairwise(chain)],
            "actuators": sorted({project.actuator_of(folder.video) for folder in folders}),
            "model": None if self.predictions is None else self.predictions.name,
            "repeat_share": self._repeat_share,
            "version": version("bendtrack"),
        }

    def frame_list(self, after: str | None) -> dict[str, Any]:
        """All frames, how far they are, and the next to label after the one named."""
        self._annotations.refresh()
        folders = self._annotations.folders()
        frames = [self._line(folder, image) for folder in folders for image in folder.states]
        states = [frame["state"] for frame in frames]
        plan = self.plan_of_repeats(folders)
        return {
            "frames": frames,
            "progress": {
                **{kind.value: states.count(kind) for kind in Progress if kind is not Progress.UNLABELLED},
                "total": len(frames),
            },
            "next": _next_frame([(f["id"], f["state"]) for f in frames], after),
            "repeats": {"due": plan.due, "done": plan.done, "target": plan.target},
            "model": None if self.predictions is None else self.model_state(),
        }

    def _line(self, folder: VideoFolder, image: str) -> dict[str, Any]:
        """One frame as the list has it."""
        picture, state = folder.pictures[image], folder.states[image]
        keypoints = self._annotations.project.keypoints
        prediction = self._prediction(picture)
        farthest = None if prediction is None else prediction.farthest(state)
        size_wh = picture_size_wh(picture)
        return {
            "id": f"{folder.video}/{image}",
            **_addresses(folder.video, picture),
            "video": folder.video,
            "image": image,
            "frame": picture.frame,
            "time_s": None,
            "actuator": self._annotations.project.actuator_of(folder.video),
            "state": state.progress(keypoints).value,
            "n_placed": len(state.points),
            "n_not_visible": len(state.not_visible),
            "flagged": state.flagged,
            "note": state.note,
            "revision": state.revision,
            "size_wh": None if size_wh is None else list(size_wh),
            "model_px": None if farthest is None else farthest[1],
            "model_worst": None if farthest is None else farthest[0],
            "likelihood": min(prediction.likelihood.values())
            if prediction and prediction.likelihood
            else None,
            "repeat": False,
        }

    def frame(self, video: str, image: str) -> dict[str, Any]:
        """One frame: its points, what may be in them, and what a page should fetch next."""
        folder, picture = self.picture(video, image)
        state = folder.states[image]
        keypoints = self._annotations.project.keypoints
        names = list(folder.pictures)
        here = names.index(image)
        soon = [folder.pictures[name] for name in names[here + 1 : here + 1 + _PREFETCHED]]
        soon += [folder.pictures[name] for name in names[max(0, here - 1) : here]]
        if self.predictions is not None:
            self.predictions.want([picture, *soon])
        before = next((name for name in reversed(names[:here]) if folder.states[name].points), None)
        prediction = self._prediction(picture)
        ghosts: dict[str, Any]
        if prediction is not None:
            source: str | None = "model"
            ghosts = {
                name: {"xy": list(point), "sd_px": prediction.sd_px[name]}
                for name, point in prediction.points.items()
                if name in keypoints
            }
        else:
            neighbours = neighbour_points(folder, image, keypoints)
            source = "neighbours" if neighbours else None
            ghosts = {name: {"xy": list(point), "sd_px": None} for name, point in neighbours.items()}
        return {
            **self._line(folder, image),
            "points": _points(state, keypoints),
            "not_visible": list(state.not_visible),
            "skipped": state.skipped,
            "ghosts": ghosts,
            "ghost_source": source,
            "previous": None
            if before is None
            else {"id": f"{video}/{before}", "points": _points(folder.states[before], keypoints)},
            "prefetch": [_addresses(video, other)["image_url"] for other in soon],
        }

    def summary(self) -> dict[str, Any]:
        """Figures of the labels so far."""
        folders = self._annotations.folders()
        spread = project_spread(self._annotations)
        return labels_summary(self._annotations.project, folders, self.definition(folders), spread)

    def next_repeat(self) -> dict[str, Any] | None:
        """The frame to label blind once more; None while none is due."""
        plan = self.plan_of_repeats(self._annotations.folders())
        for video, image in plan.waiting if plan.due else ():
            folder, picture = self.picture(video, image)
            size_wh = picture_size_wh(picture)
            if size_wh is None:
                continue
            addresses = _addresses(video, picture)
            return {
                "id": f"{video}/{image}",
                **addresses,
                "put_url": addresses["url"].replace("/api/frames/", "/api/repeats/", 1),
                "video": video,
                "image": image,
                "frame": picture.frame,
                "actuator": self._annotations.project.actuator_of(video),
                "size_wh": list(size_wh),
                "repeat": True,
                "keypoints": [
                    name
                    for name in self._annotations.project.keypoints
                    if name in folder.states[image].points
                ],
            }
        return None

    def picture(self, video: str, image: str) -> tuple[VideoFolder, Picture]:
        """A frame's folder and picture; `NoFrameError` where there is none."""
        folder = self._annotations.folder(video)
        if folder is None or image not in folder.pictures:
            raise NoFrameError(f"{video}/{image}")
        return folder, folder.pictures[image]

    def _prediction(self, picture: Picture) -> Prediction | None:
        return None if self.predictions is None else self.predictions.of(picture)

    def model_state(self) -> dict[str, Any]:
        """How far the network is."""
        predictions = self.predictions
        assert predictions is not None
        return {
            "name": predictions.name,
            "state": predictions.state,
            "reason": predictions.reason,
            "done": predictions.done,
            "total": predictions.total,
        }

    def plan_of_repeats(self, folders: Sequence[VideoFolder]) -> RepeatPlan:
        """Which frames come back blind."""
        lately = self._editor.lately_edited(REMEMBERED)
        return repeat_plan(folders, self._annotations.project.keypoints, lately, self._repeat_share)

    def definition(self, folders: Sequence[VideoFolder]) -> AngleDefinition:
        """The project's angle, with the sign that the labels so far give it."""
        project = self._annotations.project
        rows = [
            [state.points.get(name, (np.nan, np.nan)) for name in project.keypoints]
            for folder in folders
            for state in folder.states.values()
            if state.points
        ]
        with suppress(AngleError):  # no frame has all points of the angle yet
            if rows:
                return project.angle_definition(np.array(rows, dtype=float))
        return project.angle_definition(None)


def _next_frame(frames: Sequence[tuple[str, str]], after: str | None) -> str | None:
    """The first frame that is not done, looking from the one named onwards and then from the start."""
    names = [name for name, _ in frames]
    start = names.index(after) + 1 if after in names else 0
    open_states = (Progress.UNLABELLED, Progress.PARTIAL)
    for name, state in (*frames[start:], *frames[:start]):
        if state in open_states and name != after:
            return name
    return None


def _addresses(video: str, picture: Picture) -> dict[str, str]:
    url = f"/api/frames/{quote(video, safe='')}/{quote(picture.name, safe='')}"
    return {
        "url": url,
        "image_url": f"{url}/image?v={picture.stamp}",
        "thumb_url": f"{url}/thumb?v={picture.stamp}",
    }


def _points(state: FrameState, keypoints: Sequence[str]) -> dict[str, list[float] | None]:
    return {name: list(state.points[name]) if name in state.points else None for name in keypoints}
