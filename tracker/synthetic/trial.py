"""A whole rendered trial on disk: video, pressure log, truth and the settings that made them."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..atomic import atomic_write_text
from ..errors import BendtrackError
from ..types import FloatArray
from ..video_writer import VideoWriter
from .response import HystereticResponse, staircase_duration_s, staircase_kpa, triangle_kpa
from .stream.chain import END_KEYPOINTS as KEYPOINTS
from .stream.chain import ENDS
from .stream.families import TRAINING, Families
from .stream.look import Look
from .stream.renderer import Renderer
from .trial_looks import trial_look

WAVES = ("triangle", "staircase")
PRESSURE_RATE_HZ = 400.0  # the study's log (paper, section on data acquisition)
_PRESSURE_NOISE_KPA = 0.05
# How long the shutter is open: moving parts are blurred by their way in that time.
_EXPOSURE_S = 0.008


@dataclass(frozen=True)
class Trial:
    """A rendered trial.

    Attributes
    ----------
    folder : Path
        Holds `video_path`, `pressure_path`, `truth_path` and `settings_path`.
    video_name : str
        File name of the video.
    look : Look
        What the video shows.
    keypoints : tuple of str
        Names, in the order of `xy`.
    time_s, pressure_kpa, angle_deg : ndarray
        (T,), exact, one value for every frame of the video. The angle is positive toward `look.place.side`.
    xy : ndarray
        (T, 4, 2) px, exact.
    hysteresis_ratio : float
        Of every cycle of a triangle wave.
    """

    folder: Path
    video_name: str
    look: Look
    keypoints: tuple[str, ...]
    time_s: FloatArray
    pressure_kpa: FloatArray
    angle_deg: FloatArray
    xy: FloatArray
    hysteresis_ratio: float

    @property
    def video_path(self) -> Path:
        return self.folder / self.video_name

    @property
    def pressure_path(self) -> Path:
        return self.folder / "pressure.csv"

    @property
    def truth_path(self) -> Path:
        return self.folder / "truth.csv"

    @property
    def settings_path(self) -> Path:
        return self.folder / "trial.json"


def render_trial(
    out_dir: str | Path,
    *,
    seed: int,
    wave: str = "triangle",
    frequency_hz: float = 0.1,
    cycles: float = 3,
    pressure_peak_kpa: float = 50.0,
    step_kpa: float = 5.0,
    hold_s: float = 3.0,
    angle_min_deg: float = 0.0,
    angle_max_deg: float = 190.0,
    hysteresis_ratio: float = 0.25,
    frame_rate: float = 30.0,
    size_wh: tuple[int, int] = (640, 480),
    end_vector_px: float = 40.0,
    families: Families = TRAINING,
    look: Look | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Trial:
    """Render a trial and write it.

    Writes `<name of the folder>.mp4`, so that several trials go into one project; `pressure.csv` (time_s,
    pressure_kpa at 400 Hz, with a little sensor noise); `truth.csv` (frame, time_s, pressure_kpa, angle_deg,
    <keypoint>_x, <keypoint>_y, exact); `trial.json`. Each file is written whole or not at all,
    `trial.json` last. Frames are not kept in memory.

    Parameters
    ----------
    out_dir : str or Path
        The folder; it is made if it does not exist.
    seed : int
        Draws the look and the noise.
    wave : str
        "triangle" (`cycles` at `frequency_hz`) or "staircase" (`step_kpa`, each level held for `hold_s`).
    frequency_hz, cycles : float
        Of the triangle. By default three cycles in 30 s, which take about half a minute to draw.
    pressure_peak_kpa : float
        The largest pressure.
    step_kpa, hold_s : float
        Of the staircase: height of a step, and how long each level is held.
    angle_min_deg, angle_max_deg : float
        Angle at zero and at the largest pressure.
    hysteresis_ratio : float
        Of a triangle's cycle, as the paper defines it (see `response`).
    frame_rate : float
        Frames per second.
    size_wh : tuple of int
        Size of the frames, px.
    end_vector_px : float
        Distance between the two points of an end.
    families : Families
        The words that the look is drawn from.
    look : Look or None
        Instead of a look drawn from the seed; its size and end vectors are then taken.
    progress : callable or None
        Called with the number of frames done and of frames in all.

    Returns
    -------
    Trial
        What was rendered.

    Raises
    ------
    BendtrackError
        A setting that cannot be rendered.
    VideoError, OSError
        The folder cannot be written.
    """
    if wave not in WAVES:
        raise BendtrackError(f"expected one of {', '.join(WAVES)}, got {wave!r}")
    for name, value in (
        ("frequency", frequency_hz),
        ("number of cycles", cycles),
        ("frame rate", frame_rate),
    ):
        if not value > 0:
            raise BendtrackError(f"expected a {name} above 0, got {value:g}")
    response = HystereticResponse(pressure_peak_kpa, angle_min_deg, angle_max_deg, hysteresis_ratio)
    if look is None:
        angles = (min(angle_min_deg, -20.0), max(angle_max_deg, 220.0))
        look = trial_look(
            seed, size_wh=size_wh, end_vector_px=end_vector_px, angle_range_deg=angles, families=families
        )
    if wave == "triangle":
        duration_s = cycles / frequency_hz
    else:
        duration_s = staircase_duration_s(pressure_peak_kpa, step_kpa, hold_s)

    def pressure_at(time_s: FloatArray) -> FloatArray:
        if wave == "triangle":
            return triangle_kpa(time_s, pressure_peak_kpa, frequency_hz)
        return staircase_kpa(time_s, pressure_peak_kpa, step_kpa, hold_s)

    time_s = np.arange(int(duration_s * frame_rate + 1e-6) + 1) / frame_rate
    angle_deg, sweep_deg = _angles(response, pressure_at, time_s, _EXPOSURE_S)
    pressure_kpa = pressure_at(time_s)
    folder = Path(out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    # A name that begins with a dot would be skipped wherever videos are listed.
    video_name = f"{folder.resolve().name.lstrip('.') or 'trial'}.mp4"
    renderer = Renderer(look)
    xy = np.empty((len(time_s), len(KEYPOINTS), 2))
    trial = Trial(folder, video_name, look, KEYPOINTS, time_s, pressure_kpa, angle_deg, xy, hysteresis_ratio)
    with VideoWriter(trial.video_path, look.size_wh, frame_rate) as writer:
        for index, angle in enumerate(angle_deg):
            relative = float(pressure_kpa[index] / pressure_peak_kpa)
            frame = renderer.frame(
                float(angle),
                relative,
                noise_seed=seed * len(time_s) + index,
                moment=index / len(time_s),
                sweep_deg=float(sweep_deg[index]),
            )
            xy[index] = frame.keypoints_xy[ENDS]
            writer.write(frame.image, time_s[index])
            if progress is not None:
                progress(index + 1, len(time_s))
    log_time_s = np.arange(int(duration_s * PRESSURE_RATE_HZ + 1e-6) + 1) / PRESSURE_RATE_HZ
    noise_kpa = _PRESSURE_NOISE_KPA * np.random.default_rng([seed, 12]).standard_normal(len(log_time_s))
    log = np.stack([log_time_s, pressure_at(log_time_s) + noise_kpa], axis=1)
    atomic_write_text(trial.pressure_path, _csv("time_s,pressure_kpa", log, "{:.4f},{:.3f}"))
    atomic_write_text(trial.truth_path, _truth_csv(trial))
    settings = {
        "made_by": f"bendtrack {version('bendtrack')}",
        "video": video_name,
        "seed": seed,
        "wave": wave,
        "frequency_hz": frequency_hz if wave == "triangle" else None,
        "cycles": cycles if wave == "triangle" else None,
        "step_kpa": step_kpa if wave == "staircase" else None,
        "hold_s": hold_s if wave == "staircase" else None,
        "pressure_peak_kpa": pressure_peak_kpa,
        "pressure_rate_hz": PRESSURE_RATE_HZ,
        "pressure_noise_kpa": _PRESSURE_NOISE_KPA,
        "exposure_s": _EXPOSURE_S,
        "angle_min_deg": angle_min_deg,
        "angle_max_deg": angle_max_deg,
        "hysteresis_ratio": hysteresis_ratio,
        "frame_rate": frame_rate,
        "frames": len(time_s),
        "keypoints": list(KEYPOINTS),
        "look": asdict(look),
    }
    atomic_write_text(trial.settings_path, json.dumps(settings, indent=2) + "\n")
    return trial


def labelled_sample(
    trial: Trial, count: int = 30, noise_px: float = 1.0, seed: int = 0
) -> tuple[NDArray[np.intp], FloatArray]:
    """Frames spread evenly over the trial's angles, with labels as an unsteady hand would set them.

    Parameters
    ----------
    trial : Trial
        What is labelled.
    count : int
        Number of frames.
    noise_px : float
        Standard deviation of the labels' error in x and in y, px.
    seed : int
        Draws the frames and the noise.

    Returns
    -------
    frames : ndarray
        (count,) frame indices, increasing. Take the images from the video, not from the renderer.
    xy : ndarray
        (count, 4, 2) px, truth plus Gaussian noise.

    Raises
    ------
    BendtrackError
        The trial has fewer frames than that.
    """
    if not 0 < count <= len(trial.angle_deg):
        raise BendtrackError(f"expected 1 to {len(trial.angle_deg)} frames to label, got {count}")
    rng = np.random.default_rng([seed, 13])
    # Cycles repeat angles; rounded, equal ones keep the order of time, also when the truth comes from disk.
    angle_deg = trial.angle_deg.round(3)
    free = np.ones(len(angle_deg), bool)
    frames = np.empty(count, np.intp)
    for index, target in enumerate(np.linspace(angle_deg.min(), angle_deg.max(), count)):
        # Any of the few nearest: they come from different cycles, of loading and of unloading.
        distance = np.where(free, np.abs(angle_deg - target).round(3), np.inf)
        near = np.argsort(distance, kind="stable")[: min(6, free.sum())]
        frames[index] = rng.choice(near)
        free[frames[index]] = False
    frames.sort()
    xy: FloatArray = trial.xy[frames] + noise_px * rng.standard_normal((count, len(trial.keypoints), 2))
    return frames, xy


def write_labels(
    trial: Trial, path: str | Path, frames: NDArray[np.intp], xy: FloatArray, scorer: str = "rendered"
) -> None:
    """Write labels as DeepLabCut's table, images named labeled-data/<video stem>/imgNNNNN.png by frame index.

    The images themselves are the decoded frames of the video; whoever imports the labels extracts them.
    """
    columns = [(keypoint, axis) for keypoint in trial.keypoints for axis in "xy"]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["scorer", "", "", *([scorer] * len(columns))])
    table.writerow(["bodyparts", "", "", *(keypoint for keypoint, _ in columns)])
    table.writerow(["coords", "", "", *(axis for _, axis in columns)])
    for frame, points in zip(frames, xy, strict=True):
        image = ["labeled-data", trial.video_path.stem, f"img{frame:05d}.png"]
        table.writerow([*image, *(f"{value:.4f}" for value in points.ravel())])
    atomic_write_text(path, text.getvalue())


def read_trial(folder: str | Path) -> Trial:
    """The trial that `render_trial` wrote into a folder.

    Raises
    ------
    BendtrackError
        The folder holds no whole trial.
    """
    folder = Path(folder)
    try:
        settings = json.loads((folder / "trial.json").read_text(encoding="utf-8"))
        rows = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1, ndmin=2)
        look = Look.from_dict(settings["look"])
        return Trial(
            folder=folder,
            video_name=settings["video"],
            look=look,
            keypoints=tuple(settings["keypoints"]),
            time_s=rows[:, 1],
            pressure_kpa=rows[:, 2],
            angle_deg=rows[:, 3],
            xy=rows[:, 4:].reshape(len(rows), -1, 2),
            hysteresis_ratio=settings["hysteresis_ratio"],
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BendtrackError(
            f"{folder}: expected a rendered trial (trial.json, truth.csv), got {error}"
        ) from error


def _angles(
    response: HystereticResponse,
    pressure_at: Callable[[FloatArray], FloatArray],
    time_s: FloatArray,
    exposure_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Angle at each frame's time, and how far it moves during its exposure; (T,) both, degrees.

    The response is followed through the log's times too, so that no turn of the wave falls between frames.
    """
    shutter = np.concatenate([time_s, np.maximum(time_s - exposure_s / 2, 0), time_s + exposure_s / 2])
    between = np.arange(0, time_s[-1] + exposure_s, 1 / PRESSURE_RATE_HZ)
    times, place = np.unique(np.concatenate([shutter, between]), return_inverse=True)
    angle = response.angle_deg(pressure_at(times))[place]
    middle, opened, closed = np.split(angle[: 3 * len(time_s)], 3)
    return middle, closed - opened


def _csv(header: str, rows: FloatArray, pattern: str) -> str:
    return "\n".join([header, *(pattern.format(*row) for row in rows.tolist())]) + "\n"


def _truth_csv(trial: Trial) -> str:
    names = [f"{keypoint}_{axis}" for keypoint in trial.keypoints for axis in "xy"]
    header = ",".join(["frame", "time_s", "pressure_kpa", "angle_deg", *names])
    count = len(trial.time_s)
    rows = np.column_stack(
        [np.arange(count), trial.time_s, trial.pressure_kpa, trial.angle_deg, trial.xy.reshape(count, -1)]
    )
    return _csv(header, rows, "{:.0f},{:.6f},{:.4f},{:.5f}," + ",".join(["{:.4f}"] * len(names)))
