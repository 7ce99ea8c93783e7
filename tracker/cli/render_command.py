"""The command `render`: a synthetic trial with its exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import BendtrackError
from . import console


def render(
    out: Annotated[Path, typer.Argument(help="A new folder.", metavar="OUT")],
    seed: Annotated[int, typer.Option(help="Draws the look and the noise.")] = 0,
    wave: Annotated[str | None, typer.Option(help="triangle or staircase.")] = None,
    frequency_hz: Annotated[float | None, typer.Option(help="Of the triangle.")] = None,
    cycles: Annotated[float | None, typer.Option(help="Of the triangle.")] = None,
    step_kpa: Annotated[float | None, typer.Option(help="Of the staircase.")] = None,
    hold_s: Annotated[float | None, typer.Option(help="How long the staircase rests on a step.")] = None,
    pressure_peak_kpa: Annotated[float | None, typer.Option(help="The largest pressure.")] = None,
    angle_min_deg: Annotated[float | None, typer.Option(help="Angle at zero pressure.")] = None,
    angle_max_deg: Annotated[float | None, typer.Option(help="Angle at the largest pressure.")] = None,
    hysteresis_ratio: Annotated[float | None, typer.Option(help="Of every cycle of the triangle.")] = None,
    frame_rate: Annotated[float | None, typer.Option(help="Frames per second.")] = None,
    size: Annotated[str | None, typer.Option(help="Of the frames, px, such as 640x480.")] = None,
    end_vector_px: Annotated[float | None, typer.Option(help="Distance of the two points of an end.")] = None,
    labels: Annotated[int, typer.Option(min=0, help="Also label so many frames (labels.csv).")] = 0,
    noise_px: Annotated[float | None, typer.Option(help="Error of the labels.")] = None,
) -> None:
    """Render a synthetic trial with its exact truth.

    A video, a pressure log, and the angle and the keypoints of every frame.
    """
    from ..synthetic.trial import labelled_sample, render_trial, write_labels
    from . import progress_bars

    given = {
        "wave": wave,
        "frequency_hz": frequency_hz,
        "cycles": cycles,
        "step_kpa": step_kpa,
        "hold_s": hold_s,
        "pressure_peak_kpa": pressure_peak_kpa,
        "angle_min_deg": angle_min_deg,
        "angle_max_deg": angle_max_deg,
        "hysteresis_ratio": hysteresis_ratio,
        "frame_rate": frame_rate,
        "size_wh": None if size is None else size_wh(size),
        "end_vector_px": end_vector_px,
    }
    settings: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if out.is_dir() and any(out.iterdir()):
        raise BendtrackError(
            f"expected a new or an empty folder to render into, got one with files in it: {out}"
        )
    with progress_bars.counting("rendering") as progress:
        trial = render_trial(out, seed=seed, progress=progress, **settings)
    if labels:
        noise = {} if noise_px is None else {"noise_px": noise_px}
        write_labels(trial, out / "labels.csv", *labelled_sample(trial, labels, seed=seed, **noise))
    made = f"{out}: {len(trial.time_s)} frames, {trial.angle_deg.min():.1f} to {trial.angle_deg.max():.1f}°"
    # A staircase rises once: there is no loop to speak of.
    console.say(made if wave == "staircase" else f"{made}, hysteresis ratio {trial.hysteresis_ratio:g}")
    if labels:
        console.say(f"Next: bendtrack import PROJECT {out / 'labels.csv'} --video {trial.video_path}")


def size_wh(text: str) -> tuple[int, int]:
    """Width and height of a size such as 640x480.

    >>> size_wh("640x480")
    (640, 480)
    """
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise BendtrackError(f"--size: expected width x height in px such as 640x480, got '{text}'")
    return int(width), int(height)
