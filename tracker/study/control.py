"""How well the pressure followed its reference wave: the study's tracking error.

Source: the study's table of tracking errors (RMSE, and NRMSE over the reference's peak-to-peak).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .intervals import Estimate, mean_of
from .trial import TrialData

# Segments of the log whose errors are compared for the interval: as many as the study's trials have cycles.
_SEGMENTS = 12


@dataclass(frozen=True)
class ControlNumbers:
    """RMSE in kPa with its uncertainty, NRMSE (fraction of the reference's peak-to-peak), and number of readings.

    Attributes
    ----------
    rmse_kpa : Estimate
        Root mean square of measured minus reference pressure, kPa.
    nrmse : Estimate
        `rmse_kpa` over `reference_pp_kpa`.
    reference_pp_kpa : float
        Peak-to-peak of the reference wave, kPa.
    readings : int
        Number of readings compared.
    """

    rmse_kpa: Estimate
    nrmse: Estimate
    reference_pp_kpa: float
    readings: int


def tracking_error(trial: TrialData) -> ControlNumbers | None:
    """Tracking error over the whole log; None where the trial has no reference or it never moves.

    The sensor's noise is part of it, as in the paper. Its uncertainty comes from the mean squared errors of
    twelve equal segments of the log.

    Parameters
    ----------
    trial : TrialData
        The trial.

    Returns
    -------
    ControlNumbers or None
        The tracking error.
    """
    if trial.log_reference_kpa is None:
        return None
    both = np.isfinite(trial.log_pressure_kpa) & np.isfinite(trial.log_reference_kpa)
    if both.sum() < _SEGMENTS:
        return None
    reference = trial.log_reference_kpa[both]
    squares = (trial.log_pressure_kpa[both] - reference) ** 2
    peak_to_peak = float(np.ptp(reference))
    if not peak_to_peak > 0:
        return None
    rmse = math.sqrt(float(squares.mean()))
    spread = mean_of([float(part.mean()) for part in np.array_split(squares, _SEGMENTS)])
    sd = spread.sd / (2 * rmse) if rmse > 0 else 0.0
    return ControlNumbers(
        rmse_kpa=Estimate(rmse, sd, spread.dof),
        nrmse=Estimate(rmse / peak_to_peak, sd / peak_to_peak, spread.dof),
        reference_pp_kpa=peak_to_peak,
        readings=int(both.sum()),
    )
