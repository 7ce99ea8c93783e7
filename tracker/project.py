"""A project on disk: a folder with bendtrack.toml, labelled frames, models and results. It can be moved.

What may stand in the file is in `project_settings.py`; labels are read and written by `bendtrack.labeling`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

import tomlkit

from .angle import AngleDefinition, sign_from_labels
from .atomic import atomic_write_text
from .errors import ProjectError
from .links import PROJECT_FILE, make_folder
from .project_settings import ProjectSettings, listed_stem, parse_settings
from .toml_files import toml_text
from .types import FloatArray

SETTINGS_FILE = PROJECT_FILE

_TEMPLATE = """\
# A bendtrack project. Keys that are not known are refused; lines that begin with # are comments.

# The points to label, from the fixed end (base) to the moving end (tip).
keypoints = []

[angle]
# two-vector (the turn from the first two points to the last two), three-point, chord or arc-fit.
definition = ""
# points = ["base_1", "base_2", "tip_1", "tip_2"]     # base to tip; left out: chosen from the keypoints
# What counts as positive: "auto" (as the labelled frames bend), "+" (clockwise on the screen) or "-".
sign = "auto"

# Which videos show which actuator; a video not listed here belongs to the actuator "default".
# original = ["original_40kPa", "original_45kPa"]
[actuators]

[training]
# backbone = "resnet18"     # resnet18, resnet34 or resnet50
# max_minutes = 5
# seed = 0

[tracking]
# min_likelihood = 0.6      # under it, a row is flagged low_likelihood
"""


class Project:
    """An opened project. Everything it writes lies under `root`, and no file in it contains that path.

    Attributes
    ----------
    root : Path
        The project's folder.
    settings : ProjectSettings
        Contents of bendtrack.toml, validated.
    """

    def __init__(self, root: Path, settings: ProjectSettings) -> None:
        self.root = root
        self.settings = settings

    def __repr__(self) -> str:
        return f"Project({str(self.root)!r})"

    @classmethod
    def create(
        cls,
        root: str | Path,
        *,
        keypoints: Sequence[str],
        angle: str | None = None,
        scorer: str | None = None,
    ) -> Project:
        """Make a new project in a folder that does not exist or is empty.

        Parameters
        ----------
        root : str or Path
            The project's folder, made with its parents.
        keypoints : sequence of str
            Names, base to tip.
        angle : str or None, optional
            An angle definition; None takes `two-vector`, or `three-point` where there are three keypoints.
        scorer : str or None, optional
            Who labels; None takes the default of `ProjectSettings`.

        Returns
        -------
        Project
            The new project, opened.

        Raises
        ------
        ProjectError
            The folder has something in it, is a project already, or keypoints and angle do not fit.
        """
        root = Path(root)
        if (root / SETTINGS_FILE).exists():
            raise ProjectError(f"expected a new folder, got a bendtrack project: {root}")
        if root.exists() and not root.is_dir():
            raise ProjectError(f"expected a new folder, got a file: {root}")
        if root.is_dir() and any(root.iterdir()):
            raise ProjectError(f"expected a new or an empty folder, got one with files in it: {root}")
        document = tomlkit.parse(_TEMPLATE)
        document["keypoints"] = list(keypoints)
        document["angle"]["definition"] = angle or ("three-point" if len(keypoints) == 3 else "two-vector")
        if scorer is not None:
            document.add("scorer", tomlkit.item(scorer))
        text = tomlkit.dumps(document)
        settings = parse_settings(tomllib.loads(text), "the new project")
        make_folder(root)
        atomic_write_text(root / SETTINGS_FILE, text)
        return cls(root, settings)

    @classmethod
    def open(cls, root: str | Path) -> Project:
        """Open a project by its folder.

        Parameters
        ----------
        root : str or Path
            The project's folder.

        Returns
        -------
        Project
            The project.

        Raises
        ------
        ProjectError
            Not a folder, no bendtrack.toml, not TOML (with the line), an unknown key, a wrong value.
        """
        root = Path(root)
        if not root.exists():
            raise ProjectError(f"expected a project folder, got no such file or folder: {root}")
        if not root.is_dir():
            raise ProjectError(f"expected a project folder, got a file: {root}")
        path = root / SETTINGS_FILE
        if not path.is_file():
            raise ProjectError(f"expected a project folder with {SETTINGS_FILE} in it, got {root}")
        return cls(root, parse_settings(tomllib.loads(toml_text(path, ProjectError)), str(path)))

    @property
    def keypoints(self) -> tuple[str, ...]:
        """Names of the keypoints, in the order of every array of this project."""
        return self.settings.keypoints

    @property
    def labels_dir(self) -> Path:
        """labeled-data/, in DeepLabCut's layout."""
        return self.root / "labeled-data"

    @property
    def models_dir(self) -> Path:
        """models/, one folder a trained network."""
        return self.root / "models"

    @property
    def results_dir(self) -> Path:
        """results/, the angle tables."""
        return self.root / "results"

    def angle_definition(self, labelled_xy: FloatArray | None = None) -> AngleDefinition:
        """Angle definition of this project, with its sign determined.

        Parameters
        ----------
        labelled_xy : ndarray of float or None, optional
            (N, K, 2) px of the labelled frames, used only where the project's sign is "auto";
            None then leaves the sign +1, clockwise on the screen.

        Returns
        -------
        AngleDefinition
            Which angle, of which keypoints, with which sign.

        Raises
        ------
        AngleError
            The sign is "auto" and no labelled frame has all points of the angle.
        """
        if self.settings.angle.sign != "auto":
            return self.settings.angle_definition(sign=1 if self.settings.angle.sign == "+" else -1)
        definition = self.settings.angle_definition(sign=1)
        if labelled_xy is None:
            return definition
        return self.settings.angle_definition(sign=sign_from_labels(labelled_xy, self.keypoints, definition))

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
        return self.settings.actuator_of(video)

    def assign_actuator(self, actuator: str, videos: Sequence[str]) -> None:
        """List videos (stems or file names) under an actuator in bendtrack.toml, keeping the file's comments.

        A video listed under another actuator moves. The file is replaced only when the outcome is valid.

        Parameters
        ----------
        actuator : str
            Name of the actuator; it is added where it is new.
        videos : sequence of str
            Stems or file names.

        Raises
        ------
        ProjectError
            The actuator's name is not valid, or the file was damaged after it was opened.
        """
        path = self.root / SETTINGS_FILE
        document = tomlkit.parse(toml_text(path, ProjectError))
        table = document.setdefault("actuators", tomlkit.table())
        stems = list(dict.fromkeys(listed_stem(video) for video in videos))
        for name, listed in table.items():
            if name != actuator:
                for entry in [entry for entry in listed if listed_stem(entry) in stems]:
                    listed.remove(entry)
        own = table.setdefault(actuator, tomlkit.array())
        own.extend(stem for stem in stems if stem not in map(listed_stem, own))
        text = tomlkit.dumps(document)
        settings = parse_settings(tomllib.loads(text), str(path))
        atomic_write_text(path, text)
        self.settings = settings
