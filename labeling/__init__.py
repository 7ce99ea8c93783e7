"""People: the label store, foreign label formats, choosing frames, the labelling page."""

if __name__ != "bendtrack.labeling":
    raise ImportError(f"import this package as bendtrack.labeling, not as {__name__}")

from .interop.dlc import ImportReport, import_dlc
from .interop.dlc_export import export_dlc
from .store import LabelStore

__all__ = ["ImportReport", "LabelStore", "export_dlc", "import_dlc"]
