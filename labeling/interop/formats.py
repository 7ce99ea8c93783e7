"""Which form foreign labels have, and the way in and out for each.

What the forms look like is in their own files.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...tracker.errors import LabelError
from ...tracker.project import Project
from .coco import coco_files, export_coco, open_coco
from .dlc_export import export_dlc
from .dlc_source import open_source
from .exporting import ExportReport
from .lightning_pose import export_lightning_pose, has_visible_column, label_csvs, open_lightning_pose
from .sleap import export_sleap, open_sleap
from .source import Source

FORMATS = ("dlc", "coco", "sleap", "lightning-pose")


def open_labels(path: str | Path, form: str | None = None, images: str | Path | None = None) -> Source:
    """Read foreign labels.

    Parameters
    ----------
    path : a file or a folder
    form : one of `FORMATS`; None recognises it
    images : where the pictures (for SLEAP, also the videos) are that the labels name; None looks beside them

    Raises
    ------
    LabelError
        Nothing is there, an unknown form, or labels that cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise LabelError(f"expected labels to import, got a path where nothing is: {path}")
    if images is not None and not Path(images).is_dir():
        raise LabelError(f"expected a folder of pictures, got {images}")
    form = _known(form) if form is not None else recognise(path)
    match form:
        case "coco":
            return open_coco(path, images)
        case "sleap":
            return open_sleap(_the_slp(path), images)
        case "lightning-pose":
            return open_lightning_pose(path, images)
    if images is not None:
        raise LabelError(f"{path}: DeepLabCut's pictures lie beside its labels, expected no folder for them")
    return open_source(path)


def recognise(path: Path) -> str:
    """The form, one of `FORMATS`, of a file or folder that is there.

    A folder that could be several is the first of: a DeepLabCut project, a Lightning Pose project, the one .slp
    in it, COCO. What is none of them is left to DeepLabCut's reader, whose message says what it expects.

    Raises
    ------
    LabelError
        An archive, or a folder with several .slp files.
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
    project: Project, out: str | Path, form: str | None = None, *, videos: Sequence[str | Path] = ()
) -> ExportReport:
    """Write the labels in a foreign form.

    Parameters
    ----------
    project : whose labels
    out : a new folder; for SLEAP a new .slp file
    form : one of `FORMATS`; None is SLEAP for a name that ends in .slp, and else DeepLabCut
    videos : video files that the outcome may name

    Raises
    ------
    LabelError
        An unknown form, nothing to export, or `out` is there already.
    OSError
        `out` cannot be written.
    """
    form = _known(form) if form is not None else ("sleap" if Path(out).suffix == ".slp" else "dlc")
    match form:
        case "coco":
            return export_coco(project, out)
        case "sleap":
            return export_sleap(project, out, videos=videos)
        case "lightning-pose":
            return export_lightning_pose(project, out)
    return export_dlc(project, out, videos=videos)


def _known(form: str) -> str:
    if form not in FORMATS:
        raise LabelError(f"expected a format, one of {', '.join(FORMATS)}, got '{form}'")
    return form
