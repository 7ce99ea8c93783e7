"""What a rig records of a synthetic trial: a pressure log and an angle table, each on its own clock, with noise."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from ..angle import AngleDefinition
from ..results import AngleTable
from ..types import Flag, FloatArray
from .cycling import CyclingTrial
from .stairs import StaircaseTrial
from .stream.chain import END_KEYPOINTS as KEYPOINTS

FRAME_RATE = 30.0
LOG_RATE_HZ = 400.0
# Of one sample, standard deviations.
PRESSURE_NOISE_KPA = 0.1
ANGLE_NOISE_DEG = 0.5
# The camera stops this long before the log.
_CAMERA_STOPS_S = 0.3
# The actuator in the picture: length between the inner points, and of each end vector.
_LENGTH_PX, _END_PX, _CLAMP_PX = 260.0, 60.0, (260.0, 120.0)


@dataclass(frozen=True)
class Recording:
    """A trial as recorded. Video time = log time + `delay_s`, exactly.

    Attributes
    ----------
    log_time_s, log_kpa, reference_kpa : ndarray
        (M,) on the log's clock, from 0.
    frame_time_s, angle_deg : ndarray
        (T,) on the video's clock, from 0; NaN where the angle is missing.
    delay_s : float
        True delay.
    """

    log_time_s: FloatArray
    log_kpa: FloatArray
    reference_kpa: FloatArray
    frame_time_s: FloatArray
    angle_deg: FloatArray
    delay_s: float

    def angle_table(self, name: str) -> AngleTable:
        """The angle as tracking would have written it, with points that make this angle."""
        missing = np.isnan(self.angle_deg)
        count = len(self.angle_deg)
        flag: NDArray[np.str_] = np.where(missing, str(Flag.UNDECODABLE), str(Flag.NONE))
        return AngleTable(
            time_s=self.frame_time_s,
            angle_deg=self.angle_deg,
            angle_sd_deg=np.where(missing, np.nan, ANGLE_NOISE_DEG),
            flag=flag,
            xy=_points(self.angle_deg),
            likelihood=np.where(missing, np.nan, 0.99)[:, None].repeat(len(KEYPOINTS), axis=1),
            covariance=np.full((count, len(KEYPOINTS), 2, 2), np.nan),
            keypoints=KEYPOINTS,
            definition=AngleDefinition("two-vector", KEYPOINTS),
            provenance={"bendtrack": version("bendtrack"), "simulated": name},
        )


def record(
    trial: CyclingTrial | StaircaseTrial,
    *,
    seed: int,
    delay_s: float = 0.0,
    angle_noise_deg: float = ANGLE_NOISE_DEG,
    pressure_noise_kpa: float = PRESSURE_NOISE_KPA,
    missing_share: float = 0.0,
) -> Recording:
    """Record a trial.

    Parameters
    ----------
    seed : int
        Draws noise and missing frames.
    delay_s : float
        Video time - log time; negative when the log began before the camera.
    missing_share : float
        Share of frames, each by itself, without an angle.
    """
    log_time_s = np.arange(int(trial.duration_s * LOG_RATE_HZ + 1e-6) + 1) / LOG_RATE_HZ
    noise = np.random.default_rng([seed, 31]).standard_normal(len(log_time_s))
    frames = int((trial.duration_s - _CAMERA_STOPS_S + delay_s) * FRAME_RATE)
    frame_time_s = np.arange(frames) / FRAME_RATE
    rng = np.random.default_rng([seed, 32])
    angle_deg = trial.angle_deg(frame_time_s - delay_s) + angle_noise_deg * rng.standard_normal(frames)
    angle_deg[rng.random(frames) < missing_share] = np.nan
    return Recording(
        log_time_s=log_time_s,
        log_kpa=trial.pressure_kpa(log_time_s) + pressure_noise_kpa * noise,
        reference_kpa=trial.reference_kpa(log_time_s),
        frame_time_s=frame_time_s,
        angle_deg=angle_deg,
        delay_s=delay_s,
    )


def _points(angle_deg: FloatArray) -> FloatArray:
    """Points (T, 4, 2) in px of an arc that leaves its clamp to the right and bends down by these angles."""
    half = np.deg2rad(angle_deg) / 2
    chord = _LENGTH_PX * np.sinc(half / np.pi)
    x, y = np.full_like(half, _CLAMP_PX[0]), np.full_like(half, _CLAMP_PX[1])
    tip_x, tip_y = x + chord * np.cos(half), y + chord * np.sin(half)
    xs = [x - _END_PX, x, tip_x, tip_x + _END_PX * np.cos(2 * half)]
    ys = [y, y, tip_y, tip_y + _END_PX * np.sin(2 * half)]
    points: FloatArray = np.stack([np.stack(xs, axis=1), np.stack(ys, axis=1)], axis=2)
    points[np.isnan(angle_deg)] = np.nan
    return points
