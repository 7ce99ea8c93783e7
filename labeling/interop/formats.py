"""Foreign label formats: detecting the format, and reading and writing labels in each.

Each format is in its own file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...tracker.errors import LabelError
from ...tracker.project import Project
from .coco import coco_files, export_coco, open_coco
from .dlc_export import export_dlc
from .dlc_source import open_dlc
from .exporting import ExportReport
from .lightning_pose import export_lightning_pose, has_visible_column, label_csvs, open_lightning_pose
from .sleap import export_sleap, open_sleap
from .source import Source

FORMATS = ("dlc", "coco", "sleap", "lightning-pose")


def open_labels(
    path: str | Path, label_format: str | None = None, images: str | Path | None = None
) -> Source:
    """Read foreign labels.

    Parameters
    ----------
    path : str or Path
        A file or a folder.
    label_format : str or None, optional
        One of `FORMATS`; None detects it.
    images : str, Path or None, optional
        Folder of the images (for SLEAP, also of the videos) that the labels name; None looks next to the labels.

    Returns
    -------
    Source
        The foreign project's labels.

    Raises
    ------
    LabelError
        The path does not exist, the format is unknown, or the labels cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise LabelError(f"expected labels to import, got no such file or folder: {path}")
    if images is not None and not Path(images).is_dir():
        raise LabelError(f"expected a folder of images, got {images}")
    label_format = _known(label_format) if label_format is not None else detect_format(path)
    match label_format:
        case "coco":
            return open_coco(path, images)
        case "sleap":
            return open_sleap(_the_slp(path), images)
        case "lightning-pose":
            return open_lightning_pose(path, images)
    if images is not None:
        raise LabelError(f"{path}: DeepLabCut's images are next to its labels, expected no folder for them")
    return open_dlc(path)


def detect_format(path: Path) -> str:
    """Detect the format of labels.

    A folder that matches several formats is the first of: a DeepLabCut project, a Lightning Pose project, a folder of
    one .slp file, COCO. Anything else counts as DeepLabCut's, whose reader says what it expects.

    Parameters
    ----------
    path : Path
        A file or folder that exists.

    Returns
    -------
    str
        One of `FORMATS`.

    Raises
    ------
    LabelError
        The file is an archive.
    """
    if path.is_file():
        if path.suffix.lower() in (".zip", ".gz", ".tar", ".7z"):
            raise LabelError(f"{path}: expected labels, got an archive: unpack it first")
        if path.suffix.lower() == ".slp":
            return "sleap"
        if path.suffix.lower() == ".json":
            return "coco"
        return "lightning-pose" if has_visible_column(path) else "dlc"
    if (path / "config.yaml").is_file() or any(path.glob("labeled-data/*/CollectedData_*")):
        return "dlc"
    csvs = label_csvs(path)
    if csvs and (
        (path / "labeled-data").is_dir() or not all(c.name.startswith("CollectedData_") for c in csvs)
    ):
        return "lightning-pose"
    if any(path.glob("*.slp")):
        return "sleap"
    return "coco" if coco_files(path) else "dlc"


def _the_slp(path: Path) -> Path:
    if path.is_file():
        return path
    found = sorted(path.glob("*.slp"))
    if len(found) != 1:
        got = ", ".join(file.name for file in found) or "none"
        raise LabelError(f"{path}: expected one .slp file, got {got}")
    return found[0]


def export_labels(
    project: Project, out: str | Path, label_format: str | None = None, *, videos: Sequence[str | Path] = ()
) -> ExportReport:
    """Write the labels in a foreign format.

    Parameters
    ----------
    project : Project
        Project whose labels are written.
    out : str or Path
        A new folder, or for SLEAP a new .slp file.
    label_format : str or None, optional
        One of `FORMATS`; None is SLEAP for a name that ends in .slp, and else DeepLabCut.
    videos : sequence of str or Path, optional
        Video files that the exported project may refer to.

    Returns
    -------
    ExportReport
        What was written.

    Raises
    ------
    LabelError
        The format is unknown, there is nothing to export, or `out` exists already.
    OSError
        `out` cannot be written.
    """
    label_format = (
        _known(label_format)
        if label_format is not None
        else ("sleap" if Path(out).suffix == ".slp" else "dlc")
    )
    match label_format:
        case "coco":
            return export_coco(project, out)
        case "sleap":
            return export_sleap(project, out, videos=videos)
        case "lightning-pose":
            return export_lightning_pose(project, out)
    return export_dlc(project, out, videos=videos)


def _known(label_format: str) -> str:
    if label_format not in FORMATS:
        raise LabelError(f"expected a format, one of {', '.join(FORMATS)}, got '{label_format}'")
    return label_format
