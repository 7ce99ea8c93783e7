"""A rendered trial turned into what a user has: a video, and a label store with n noisy labels of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bendtrack.labeling.interop.dlc import import_dlc, project_for
from bendtrack.labeling.store import LabelStore
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.project import Project
from bendtrack.tracker.synthetic.stream import HELD_OUT
from bendtrack.tracker.synthetic.trial import Trial, labelled_sample, render_trial, write_labels
from bendtrack.tracker.types import FloatArray, LabelledFrame


@dataclass(frozen=True)
class LabelledTrial:
    """A trial, its labelled frames read back from the encoded video, and the angle as the project means it."""

    trial: Trial
    frames: Sequence[LabelledFrame]
    labelled: Sequence[int]
    definition: AngleDefinition

    def unlabelled(self) -> FloatArray:
        """Mask (T,) of the frames that no label belongs to."""
        mask = np.ones(len(self.trial.time_s), bool)
        mask[list(self.labelled)] = False
        return mask


def labelled_trial(
    folder: Path,
    *,
    seed: int,
    end_vector_px: float,
    n_labels: int,
    noise_px: float,
    seconds: float = 12.0,
    size_wh: tuple[int, int] = (640, 480),
) -> LabelledTrial:
    """Render two triangle cycles to 205 degrees, and label them as a person with `noise_px` of error would.

    The look is of the words that pretraining has not seen: material, background, shape and clamp.
    """
    trial = render_trial(
        folder / "trial",
        seed=seed,
        frequency_hz=2 / seconds,
        cycles=2,
        angle_max_deg=205.0,
        end_vector_px=end_vector_px,
        size_wh=size_wh,
        families=HELD_OUT,
    )
    labelled, xy = labelled_sample(trial, count=n_labels, noise_px=noise_px, seed=seed)
    labels = folder / "labels.csv"
    write_labels(trial, labels, labelled, xy)
    project: Project = project_for(folder / "project", labels)
    import_dlc(labels, project, videos=[trial.video_path])
    frames = LabelStore.of(project).read()
    definition = project.angle_definition(np.stack([frame.xy for frame in frames]))
    return LabelledTrial(trial, frames, [int(i) for i in labelled], definition)


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
