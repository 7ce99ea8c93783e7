"""DeepLabCut's labels into a project, and back by `export_dlc`.

Where a source keeps its labels is in `dlc_source.py`, the way back in `dlc_export.py`; what every format's import
has in common, in `importing.py`. Positions are used as they are: DeepLabCut's labels are px with (0, 0) at the
centre of the top-left pixel, as its labelling tool shows pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...tracker.project import Project
from .dlc_export import export_dlc
from .dlc_source import open_source
from .importing import ImportReport, import_source, project_of

__all__ = ["ImportReport", "export_dlc", "import_dlc", "project_for"]


def project_for(root: str | Path, source: str | Path) -> Project:
    """Open the project to import into; where there is none, create it with the source's keypoints and scorer.

    Raises
    ------
    ProjectError
        The folder holds something else, or the source's body parts cannot be keypoints of a project.
    LabelError
        The source cannot be read.
    """
    return project_of(root, open_source(source))


def import_dlc(
    source: str | Path,
    project: Project,
    *,
    videos: Sequence[str | Path] = (),
    overwrite: bool = False,
) -> ImportReport:
    """Take over the labelled pictures of a DeepLabCut project, a labeled-data folder or a label file.

    Parameters, outcome and errors are those of `import_source`; also

    Parameters
    ----------
    source : a folder with config.yaml or labeled-data/, one folder of labels, or a CollectedData CSV

    Raises
    ------
    LabelError
        The source is none of these.
    """
    return import_source(open_source(source), project, videos=videos, overwrite=overwrite)
