"""The figure of a pretraining: its loss, and the errors of both networks on validation images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ...tracker.atomic import atomic_path

_COLOUR = "#0072B2"


def write_curve(rows: Sequence[dict[str, float]], folder: Path) -> None:
    """Write learning-curve.png into `folder`, from the rows of training.csv."""
    figure = Figure(figsize=(9, 2.9), layout="constrained")
    FigureCanvasAgg(figure)
    panels = {
        "loss": ("Training loss", ""),
        "located_share": ("Located within 5 % of the body", "share of keypoints"),
        "refined_px": ("Refined", "median error (px)"),
    }
    step = [row["step"] for row in rows]
    for axes, (column, (title, label)) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        axes.plot(step, [row[column] for row in rows], color=_COLOUR, marker=".", markersize=4, linewidth=1)
        axes.set_title(title, fontsize=10)
        axes.set(xlabel="step", ylabel=label)
        axes.set_ylim(0, 1 if column == "located_share" else None)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    with atomic_path(folder / "learning-curve.png") as temporary:
        figure.savefig(temporary, dpi=150, format="png")
