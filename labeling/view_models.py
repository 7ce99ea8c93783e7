"""View models of the labelling page: the project, its frames, the network's state and the blind repeats.

They are JSON-ready values in the form of page/API.md. `server.py` sends them over HTTP. Nothing is changed here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version
from itertools import pairwise
from typing import Any
from urllib.parse import quote

import numpy as np

from ..tracker.angle import AngleDefinition
from ..tracker.errors import AngleError
from .annotations import Annotations, ImageFile, VideoFolder, by_actuator
from .edits import Editor
from .frame_state import FrameState, Progress
from .images import header_size_wh
from .predictions import Prediction, Predictions
from .repeatability import N_RECENT_FRAMES, RepeatPlan, project_repeatability, repeat_plan
from .suggestions import interpolated_points
from .summary import labels_summary

_PREFETCHED = 3  # frames after the open one whose images the page should fetch


class FrameNotFoundError(LookupError):
    """The requested frame does not exist, or no longer."""


class ViewModels:
    """Builds the view models of one project.

    Parameters
    ----------
    annotations : Annotations
        The project's frames.
    editor : Editor
        Source of the frames that were edited last.
    repeat_share : float
        Share in [0, 1] of the labelled frames that is shown again for a blind repeat label.
    sign_address : callable, optional
        Takes the address of an image and returns one that can be fetched without a header.

    Attributes
    ----------
    predictions : Predictions or None
        Predictions of the network; None without a network.
    """

    def __init__(
        self,
        annotations: Annotations,
        editor: Editor,
        repeat_share: float,
        sign_address: Callable[[str], str] = str,
    ) -> None:
        self._sign_address = sign_address
        self._annotations = annotations
        self._editor = editor
        self._repeat_share = repeat_share
        self.predictions: Predictions | None = None

    def project(self) -> dict[str, Any]:
        """Return the project: keypoints, angle definition and actuators."""
        self._annotations.refresh()
        project = self._annotations.project
        folders = self._annotations.folders()
        definition = self.definition(folders)
        chain = [project.keypoints.index(name) for name in definition.points]
        groups = by_actuator(project, folders)
        return {
            "name": self._annotations.project.root.resolve().name,
            "scorer": project.settings.scorer,
            "keypoints": list(project.keypoints),
            "definition": {
                "name": definition.name,
                "points": list(definition.points),
                "sign": definition.sign,
            },
            "signs": {name: self.definition(own).sign for name, own in groups.items()},
            "skeleton": [list(pair) for pair in pairwise(chain)],
            "actuators": list(groups),
            "model": None if self.predictions is None else self.predictions.name,
            "repeat_share": self._repeat_share,
            "version": version("bendtrack"),
        }

    def frame_list(self, after: str | None) -> dict[str, Any]:
        """Return all frames with their progress, and the next frame to label.

        Parameters
        ----------
        after : str or None
            Id of a frame, "<video>/<image>": the search for the next frame to label starts behind it.

        Returns
        -------
        dict of str to Any
            Body of GET /api/frames.
        """
        self._annotations.refresh()
        folders = self._annotations.folders()
        frames = [self._list_entry(folder, image) for folder in folders for image in folder.states]
        states = [frame["state"] for frame in frames]
        plan = self.current_repeat_plan(folders)
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

    def _list_entry(self, folder: VideoFolder, image: str) -> dict[str, Any]:
        """Return a frame's entry of the frame list."""
        image_file, state = folder.images[image], folder.states[image]
        keypoints = self._annotations.project.keypoints
        prediction = self._prediction(image_file)
        farthest = None if prediction is None else prediction.farthest(state)
        size_wh = header_size_wh(image_file)
        return {
            "id": f"{folder.video}/{image}",
            **self._urls(folder.video, image_file),
            "video": folder.video,
            "image": image,
            "frame": image_file.frame,
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
        """Return one frame: its points, suggestions for them, and the images to prefetch.

        Parameters
        ----------
        video : str
            Stem of the video.
        image : str
            File name of the image.

        Returns
        -------
        dict of str to Any
            Body of GET /api/frames/<video>/<image>.

        Raises
        ------
        FrameNotFoundError
            There is no such frame.
        """
        folder, image_file = self.image_file(video, image)
        state = folder.states[image]
        keypoints = self._annotations.project.keypoints
        names = list(folder.images)
        here = names.index(image)
        soon = [folder.images[name] for name in names[here + 1 : here + 1 + _PREFETCHED]]
        soon += [folder.images[name] for name in names[max(0, here - 1) : here]]
        if self.predictions is not None:
            self.predictions.prioritise([image_file, *soon])
        before = next((name for name in reversed(names[:here]) if folder.states[name].points), None)
        prediction = self._prediction(image_file)
        suggestions: dict[str, Any]
        if prediction is not None:
            source: str | None = "model"
            suggestions = {
                name: {"xy": list(point), "sd_px": prediction.sd_px[name]}
                for name, point in prediction.points.items()
                if name in keypoints
            }
        else:
            neighbours = interpolated_points(folder, image, keypoints)
            source = "neighbours" if neighbours else None
            suggestions = {name: {"xy": list(point), "sd_px": None} for name, point in neighbours.items()}
        return {
            **self._list_entry(folder, image),
            "points": _points(state, keypoints),
            "not_visible": list(state.not_visible),
            "skipped": state.skipped,
            "suggestions": suggestions,
            "suggestion_source": source,
            "previous": None
            if before is None
            else {"id": f"{video}/{before}", "points": _points(folder.states[before], keypoints)},
            "prefetch": [self._urls(video, other)["image_url"] for other in soon],
        }

    def has_whole_frame(self) -> bool:
        """Whether every keypoint is placed in some frame."""
        keypoints = set(self._annotations.project.keypoints)
        return any(
            keypoints <= set(state.points) and not state.skipped
            for folder in self._annotations.folders()
            for state in folder.states.values()
        )

    def summary(self) -> dict[str, Any]:
        """Return figures of the labels so far, the body of GET /api/summary."""
        folders = self._annotations.folders()
        repeatability = project_repeatability(self._annotations)
        return labels_summary(self._annotations.project, folders, self.definition, repeatability)

    def next_repeat(self) -> dict[str, Any] | None:
        """Return the next frame for a blind repeat label, None while none is due."""
        plan = self.current_repeat_plan(self._annotations.folders())
        for video, image in plan.waiting if plan.due else ():
            folder, image_file = self.image_file(video, image)
            size_wh = header_size_wh(image_file)
            if size_wh is None:
                continue
            urls = self._urls(video, image_file)
            return {
                "id": f"{video}/{image}",
                **urls,
                "put_url": urls["url"].replace("/api/frames/", "/api/repeats/", 1),
                "video": video,
                "image": image,
                "frame": image_file.frame,
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

    def image_file(self, video: str, image: str) -> tuple[VideoFolder, ImageFile]:
        """Return a frame's folder and image file.

        Parameters
        ----------
        video : str
            Stem of the video.
        image : str
            File name of the image.

        Returns
        -------
        tuple of VideoFolder and ImageFile
            The folder and, in it, the image file.

        Raises
        ------
        FrameNotFoundError
            There is no such frame.
        """
        folder = self._annotations.folder(video)
        if folder is None or image not in folder.images:
            raise FrameNotFoundError(f"{video}/{image}")
        return folder, folder.images[image]

    def _urls(self, video: str, image_file: ImageFile) -> dict[str, str]:
        url = f"/api/frames/{quote(video, safe='')}/{quote(image_file.name, safe='')}"
        return {
            "url": url,
            "image_url": self._sign_address(f"{url}/image?v={image_file.stamp}"),
            "thumb_url": self._sign_address(f"{url}/thumb?v={image_file.stamp}"),
        }

    def _prediction(self, image_file: ImageFile) -> Prediction | None:
        return None if self.predictions is None else self.predictions.get(image_file)

    def model_state(self) -> dict[str, Any]:
        """Return the network's state and progress. There must be a network."""
        predictions = self.predictions
        assert predictions is not None
        return {
            "name": predictions.name,
            "state": predictions.state,
            "reason": predictions.reason,
            "done": predictions.done,
            "total": predictions.total,
        }

    def current_repeat_plan(self, folders: Sequence[VideoFolder]) -> RepeatPlan:
        """Return which frames are to be labelled again."""
        recent = self._editor.recently_edited(N_RECENT_FRAMES)
        return repeat_plan(folders, self._annotations.project.keypoints, recent, self._repeat_share)

    def definition(self, folders: Sequence[VideoFolder]) -> AngleDefinition:
        """Return the angle definition of some videos of the project, its sign estimated from their labels so far."""
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
    """Return the first frame that is not done, searching from `after` to the end and then from the start."""
    names = [name for name, _ in frames]
    start = names.index(after) + 1 if after in names else 0
    open_states = (Progress.UNLABELLED, Progress.PARTIAL)
    for name, state in (*frames[start:], *frames[:start]):
        if state in open_states and name != after:
            return name
    return None


def _points(state: FrameState, keypoints: Sequence[str]) -> dict[str, list[float] | None]:
    return {name: list(state.points[name]) if name in state.points else None for name in keypoints}
