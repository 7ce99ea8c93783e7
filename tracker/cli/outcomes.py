"""What `track` and `angle` print of each video, and how they end."""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from typing import TYPE_CHECKING

import typer

from . import console

if TYPE_CHECKING:
    from ..batch import AngleSummary, VideoOutcome


def show_outcomes(outcomes: Iterable[VideoOutcome]) -> None:
    """Print each video's outcome as it comes; end with status 1 where some failed or are damaged.

    Parameters
    ----------
    outcomes : iterable of VideoOutcome
        Those of all videos, in order.

    Raises
    ------
    typer.Exit
        Some failed; which ones is printed last.
    """
    done = []
    for outcome in outcomes:
        _show(outcome)
        done.append(outcome)
    problems = [outcome for outcome in done if outcome.problem is not None]
    if not problems:
        return
    videos = {outcome.video for outcome in done}
    if len(videos) > 1:
        bad = {outcome.video for outcome in problems}
        console.complain(f"{len(bad)} of {len(videos)} videos failed or are damaged, the others are done:")
    for outcome in problems:
        console.complain(f"{outcome.video}: {outcome.problem}")
    raise typer.Exit(1)


def summary_line(summary: AngleSummary) -> str:
    """Put the angle's range, its uncertainty and the flags into a sentence.

    Parameters
    ----------
    summary : AngleSummary
        Of an angle table.

    Returns
    -------
    str
        For people.
    """
    known = summary.max_deg == summary.max_deg
    angle = f"angle {summary.min_deg:.1f} to {summary.max_deg:.1f}°" if known else "no angle in any row"
    sd = f", sd {summary.sd_deg:.2f}° (median)" if summary.sd_deg == summary.sd_deg else ""
    if not summary.flagged:
        return f"{angle}{sd}; no row flagged"
    flags = ", ".join(f"{count} {flag}" for flag, count in summary.flags.items())
    return f"{angle}{sd}; {summary.flagged} of {summary.rows} rows flagged: {flags}"


def _show(outcome: VideoOutcome) -> None:
    from ..batch import State, summarize

    if outcome.state is State.FAILED or outcome.table is None:
        console.say(f"{outcome.video}: failed")
        if outcome.error is not None and console.debugging():
            traceback.print_exception(outcome.error)
        return
    if outcome.state is State.UP_TO_DATE:
        console.say(f"{outcome.video}: up to date, skipped")
    else:
        rows = len(outcome.table)
        console.say(
            f"{outcome.video}: {rows} frames, {rows / max(outcome.seconds, 1e-9):.0f} frames/s -> {outcome.csv_path}"
        )
    console.say(f"{outcome.video}: {summary_line(summarize(outcome.table))}")
    for warning in outcome.warnings:
        console.warn(warning)
    if outcome.overlay_path is not None:
        console.say(f"{outcome.video}: overlay -> {outcome.overlay_path}")
