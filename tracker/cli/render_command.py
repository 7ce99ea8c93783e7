"""The command `render`: a synthetic trial with its exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import BendtrackError
from . import console


def render(
    out: Annotated[Path, typer.Argument(help="A new folder.", metavar="OUT")],
    seed: Annotated[int, typer.Option(min=0, help="Draws the look and the noise.")] = 0,
    wave: Annotated[str, typer.Option(help="triangle or staircase.")] = "triangle",
    frequency_hz: Annotated[float, typer.Option(help="Cycles of the triangle per second.")] = 0.1,
    cycles: Annotated[float, typer.Option(help="Number of cycles of the triangle.")] = 3.0,
    step_kpa: Annotated[float, typer.Option(help="Height of a step of the staircase.")] = 5.0,
    hold_s: Annotated[float, typer.Option(help="How long the staircase holds each step.")] = 3.0,
    pressure_peak_kpa: Annotated[float, typer.Option(help="The largest pressure.")] = 50.0,
    angle_min_deg: Annotated[float, typer.Option(help="Angle at zero pressure.")] = 0.0,
    angle_max_deg: Annotated[float, typer.Option(help="Angle at the largest pressure.")] = 190.0,
    hysteresis_ratio: Annotated[float, typer.Option(help="Of every cycle of the triangle.")] = 0.25,
    frame_rate: Annotated[float, typer.Option(help="Frames per second.")] = 30.0,
    size: Annotated[str, typer.Option(help="Of the frames, px.")] = "640x480",
    end_vector_px: Annotated[float, typer.Option(help="Distance of the two points of an end, px.")] = 40.0,
    labels: Annotated[int, typer.Option(min=0, help="Number of frames to label (labels.csv).")] = 0,
    noise_px: Annotated[float, typer.Option(help="Standard deviation of the labels' error, px.")] = 1.0,
) -> None:
    """Render a synthetic trial with its exact truth.

    Writes a video, a pressure log, and the angle and the keypoints of every frame. By default three cycles in 30 s: 901
    frames, which take about half a minute to draw.
    """
    from ..synthetic.trial import labelled_sample, render_trial, write_labels
    from . import progress_bars

    size_px = size_wh(size)
    if out.is_dir() and any(out.iterdir()):
        raise BendtrackError(
            f"expected a new or an empty folder to render into, got one with files in it: {out}"
        )
    with progress_bars.counting("rendering") as progress:
        trial = render_trial(
            out,
            seed=seed,
            wave=wave,
            frequency_hz=frequency_hz,
            cycles=cycles,
            pressure_peak_kpa=pressure_peak_kpa,
            step_kpa=step_kpa,
            hold_s=hold_s,
            angle_min_deg=angle_min_deg,
            angle_max_deg=angle_max_deg,
            hysteresis_ratio=hysteresis_ratio,
            frame_rate=frame_rate,
            size_wh=size_px,
            end_vector_px=end_vector_px,
            progress=progress,
        )
    if labels:
        frames, xy = labelled_sample(trial, labels, noise_px=noise_px, seed=seed)
        write_labels(trial, out / "labels.csv", frames, xy)
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
