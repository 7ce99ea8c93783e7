"""Importing DeepLabCut's labels into a project.

Reading a DeepLabCut project is in `dlc_source.py`, the part that all formats share in `importing.py`, and the export in
`dlc_export.py`. Positions are used as they are: DeepLabCut's labels are px with (0, 0) at the centre of the top-left
pixel, as its labelling tool shows images.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...tracker.project import Project
from .dlc_export import export_dlc
from .dlc_source import open_dlc
from .importing import ImportReport, import_source, project_of

__all__ = ["ImportReport", "export_dlc", "import_dlc", "project_for"]


def project_for(root: str | Path, source: str | Path) -> Project:
    """Open the project to import into; where there is none, create it with the source's keypoints and scorer.

    Parameters
    ----------
    root : str or Path
        Folder of the project.
    source : str or Path
        Labels as `import_dlc` takes them.

    Returns
    -------
    Project
        The project.

    Raises
    ------
    ProjectError
        The folder holds something else, or the source's body parts are not valid keypoints.
    LabelError
        The source cannot be read.
    """
    return project_of(root, open_dlc(source))


def import_dlc(
    source: str | Path,
    project: Project,
    *,
    videos: Sequence[str | Path] = (),
    overwrite: bool = False,
) -> ImportReport:
    """Import the labelled images of a DeepLabCut project, a labeled-data folder or a label file.

    See `import_source`, which this calls.

    Parameters
    ----------
    source : str or Path
        A folder with config.yaml or labeled-data/, one folder of labels, or a CollectedData CSV.
    project : Project
        The project that gets them.
    videos : sequence of str or Path, optional
        Video files. An image that the source lacks is decoded from the video of the same stem.
    overwrite : bool, optional
        Replace labels and images of the project that differ.

    Returns
    -------
    ImportReport
        What was imported, and what was left out.

    Raises
    ------
    LabelError
        The source is none of these, none of its body parts is a keypoint of the project, or two of `videos` have one
        name.
    VideoError
        One of `videos` cannot be read.
    OSError
        The project cannot be written.
    """
    return import_source(open_dlc(source), project, videos=videos, overwrite=overwrite)
