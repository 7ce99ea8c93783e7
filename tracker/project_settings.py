"""Contents of bendtrack.toml: the settings as pydantic models, and one clear line for each mistake.

Where the file lies and how a project is created or opened is in `project.py`. Training and tracking settings
are overrides: one that is not given takes the default of the code that uses it, which is written there once.
"""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from .angle import AngleDefinition, default_points
from .errors import AngleError, ProjectError
from .toml_files import Section, validation_message

# The actuator of every video that is not listed: a project without a list is a study of one actuator.
DEFAULT_ACTUATOR = "default"

# Names become CSV column heads, figure legends and DeepLabCut body parts: letters and digits of any script,
# and a few other characters within, nothing that a spreadsheet takes for a formula or a separator.
_NAME = re.compile(r"\w(?:[\w .+-]*[\w+])?")
VIDEO_SUFFIXES = (
    *(".avi", ".flv", ".m2ts", ".m4v", ".mj2", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg"),
    *(".mts", ".ogv", ".ts", ".webm", ".wmv", ".y4m"),
)

# TOML arrays arrive as lists; what is in them stays strict.
Names = Annotated[tuple[str, ...], Field(strict=False)]


class AngleSettings(Section):
    """Which bending angle the project measures (see `angle.py`).

    Attributes
    ----------
    definition : {'two-vector', 'three-point', 'chord', 'arc-fit'}
        One of `angle.DEFINITIONS`.
    points : tuple of str or None
        The chain from base to tip; left out, `angle.default_points` of the keypoints.
    sign : {'auto', '+', '-'}
        "auto" makes the bending of the labelled frames positive; "+" is clockwise on the screen, "-" not.
    """

    definition: Literal["two-vector", "three-point", "chord", "arc-fit"] = "two-vector"
    points: Names | None = None
    sign: Literal["auto", "+", "-"] = "auto"


class TrainingSettings(Section):
    """Overrides of the training defaults, which are in `bendtrack.models`.

    Attributes
    ----------
    backbone : {'resnet18', 'resnet34', 'resnet50'} or None
        Network that features are taken from.
    init : str or None
        Starting weights.
    max_minutes : float or None
        Time limit of a training, minutes.
    seed : int or None
        Seed of the random numbers.
    steps : int or None
        Number of optimisation steps.
    batch_frames : int or None
        Frames per step.
    held_out : float or None
        Fraction of the labelled frames that is kept for evaluation.
    """

    backbone: Literal["resnet18", "resnet34", "resnet50"] | None = None
    init: str | None = None
    max_minutes: float | None = Field(default=None, gt=0)
    seed: int | None = Field(default=None, ge=0)
    steps: int | None = Field(default=None, ge=1)
    batch_frames: int | None = Field(default=None, ge=1)
    held_out: float | None = Field(default=None, ge=0, lt=1)


class TrackingSettings(Section):
    """Overrides of the tracking defaults, which are in `tracking.py`.

    Attributes
    ----------
    min_likelihood : float or None
        A row with a keypoint of the angle below this is flagged `low_likelihood`.
    """

    min_likelihood: float | None = Field(default=None, ge=0, le=1)


class ProjectSettings(Section):
    """All of bendtrack.toml.

    Attributes
    ----------
    keypoints : tuple of str
        Distinct names, from base to tip where the angle names no points.
    scorer : str
        Who labels, part of the name of the label files (CollectedData_<scorer>.csv).
    angle : AngleSettings
        Which bending angle is measured.
    training : TrainingSettings
        Overrides of the training defaults.
    tracking : TrackingSettings
        Overrides of the tracking defaults.
    actuators : dict of str to tuple of str
        Actuator name -> its videos, as stems or file names. Labels of one actuator train and are
        judged together. A video that no actuator lists belongs to the actuator `DEFAULT_ACTUATOR`.
    """

    keypoints: Names
    scorer: str = "bendtrack"
    angle: AngleSettings = AngleSettings()
    actuators: dict[str, Names] = Field(default_factory=dict)
    training: TrainingSettings = TrainingSettings()
    tracking: TrackingSettings = TrackingSettings()

    @field_validator("keypoints")
    @classmethod
    def _keypoint_names(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            _check_name(name, "keypoint name")
            if value.count(name) > 1:
                raise PydanticCustomError(
                    "keypoints", "expected distinct names, got '{name}' twice", {"name": name}
                )
        if not value:
            raise PydanticCustomError("keypoints", "expected at least one name, got none")
        return value

    @field_validator("scorer")
    @classmethod
    def _scorer_name(cls, value: str) -> str:
        _check_name(value, "name")
        return value

    @field_validator("actuators")
    @classmethod
    def _one_actuator_a_video(cls, value: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
        owner: dict[str, str] = {}
        for actuator, videos in value.items():
            _check_name(actuator, "actuator name")
            for stem in map(listed_stem, videos):
                if owner.setdefault(stem, actuator) != actuator:
                    raise PydanticCustomError(
                        "actuators",
                        "expected a video in one actuator, got '{stem}' in '{first}' and in '{second}'",
                        {"stem": stem, "first": owner[stem], "second": actuator},
                    )
        return value

    @model_validator(mode="after")
    def _angle_fits_keypoints(self) -> ProjectSettings:
        try:
            definition = self.angle_definition(sign=1)
        except AngleError as error:
            raise PydanticCustomError("angle", "{reason}", {"reason": str(error)}) from error
        unknown = [point for point in definition.points if point not in self.keypoints]
        if unknown:
            raise PydanticCustomError(
                "angle",
                "angle.points: expected some of the keypoints {keypoints}, got {unknown}",
                {"keypoints": ", ".join(self.keypoints), "unknown": ", ".join(unknown)},
            )
        return self

    def angle_definition(self, sign: int) -> AngleDefinition:
        """The definition with its points filled in, and the given sign.

        Parameters
        ----------
        sign : int
            +1 or -1.

        Returns
        -------
        AngleDefinition
            Which angle, of which keypoints, with which sign.
        """
        points = self.angle.points or default_points(self.angle.definition, self.keypoints)
        return AngleDefinition(self.angle.definition, points, sign)

    def actuator_of(self, video: str) -> str:
        """Actuator that a video (its stem) shows.

        Parameters
        ----------
        video : str
            Stem of the video.

        Returns
        -------
        str
            Name of the actuator.
        """
        for actuator, videos in self.actuators.items():
            if video in map(listed_stem, videos):
                return actuator
        return DEFAULT_ACTUATOR


def listed_stem(video: str) -> str:
    """Stem of a video as listed under `actuators`: a stem, a file name, or a path of either system.

    A dot within a stem does not begin a suffix.

    Parameters
    ----------
    video : str
        An entry of the list.

    Returns
    -------
    str
        The stem.

    Examples
    --------
    >>> [listed_stem(v) for v in ("trial 1.5Hz", "trial 1.5Hz.mp4", "videos\\\\a.MOV")]
    ['trial 1.5Hz', 'trial 1.5Hz', 'a']
    """
    name = PurePosixPath(video.replace("\\", "/"))
    return name.stem if name.suffix.lower() in VIDEO_SUFFIXES else name.name


def parse_settings(raw: dict[str, Any], where: str) -> ProjectSettings:
    """Validate the parsed TOML; `where` (the file's name) opens the message.

    Parameters
    ----------
    raw : dict of str to Any
        The parsed TOML.
    where : str
        Name of the file.

    Returns
    -------
    ProjectSettings
        The validated settings.

    Raises
    ------
    ProjectError
        The message gives the key, what was expected and what was found, for the first mistake, and counts the others.
    """
    try:
        return ProjectSettings.model_validate(raw)
    except ValidationError as error:
        raise ProjectError(f"{where}: {validation_message(error, ProjectSettings)}") from error


def _check_name(name: str, what: str) -> None:
    if not _NAME.fullmatch(name):
        raise PydanticCustomError(
            "name",
            "expected a {what} of letters, digits, spaces and _ . + - (beginning with a letter, digit or _), "
            "got {name}",
            {"what": what, "name": repr(name)},
        )
