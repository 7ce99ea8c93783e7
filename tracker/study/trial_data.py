"""Reads a trial's files and brings them to one clock: angles, the log, their shift, pressure at the frames.

Single files are read by `angle_input.py`, `pressure_log.py` and `model_curve.py`; the analysis is elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from ..errors import StudyError
from ..results import json_ready
from ..types import FloatArray
from .angle_input import find_table, read_angles
from .log_format import LogFormat
from .model_curve import read_model_curve
from .pressure_log import PressureLog, read_pressure_log
from .resampling import pressure_at_frames
from .study_file import Study, TrialSettings
from .synchronisation import synchronise
from .trial import TrialData
from .units import KPA_IN

# Peak-to-peak pressure may differ from the nominal by this fraction without a warning.
_NOMINAL_TOLERANCE = 0.15
# Within this factor of the nominal pressure the unit is taken as right.
_NOMINAL_FACTOR = 1.6


def load_trials(study: Study) -> Iterator[TrialData]:
    """Read the trials of a study one after the other, in the order of the file.

    Parameters
    ----------
    study : Study
        The study.

    Returns
    -------
    iterator of TrialData
        The trials.

    Raises
    ------
    BendtrackError
        As `load_trial`, at the first trial that cannot be read.
    """
    for settings in study.trials:
        yield load_trial(study, settings)


def load_trial(study: Study, settings: TrialSettings) -> TrialData:
    """Read one trial and bring it to the video's clock.

    Parameters
    ----------
    study : Study
        The study.
    settings : TrialSettings
        One of its trials.

    Returns
    -------
    TrialData
        The trial on the video's clock.

    Raises
    ------
    StudyError, PressureLogError, ResultsError, VideoError
        A file is missing or cannot be used, the clocks cannot be synchronised, log and video do not overlap in time,
        or the pressure is in another unit.
    """
    where = f"trial '{settings.name}'"
    table = settings.angles or _table_of(study, settings, where)
    angles = read_angles(table, study.keep_flagged)
    log = read_pressure_log(settings.log, settings.log_format)
    reference_kpa, reference_provenance = _reference(settings, log)
    pressure_pp = float(np.subtract(*np.nanpercentile(log.pressure_kpa, [99.5, 0.5])))
    warnings = [f"log: {warning}" for warning in log.warnings]
    warnings += _check_nominal(pressure_pp, settings, log, where)
    synchronised = synchronise(settings.sync, log, angles.time_s, angles.angle_deg, settings.video, where)
    shift = synchronised.shift
    log_time_s = log.time_s + shift.delay_s
    # At an end of the sensor's range the true pressure is not known.
    saturated = np.zeros(len(log_time_s), dtype=bool) if log.saturated is None else log.saturated
    sound_kpa = np.where(saturated, np.nan, log.pressure_kpa)
    pressure_kpa, rate_kpa_s = pressure_at_frames(angles.time_s, log_time_s, sound_kpa)
    warnings += _coverage(angles.time_s, pressure_kpa, log_time_s, where)
    curve = None if settings.model is None else read_model_curve(settings.model)
    return TrialData(
        name=settings.name,
        design=settings.design,
        kind=settings.kind,
        frequency_hz=settings.frequency_hz,
        pressure_pp_kpa=settings.pressure_pp_kpa,
        time_s=angles.time_s,
        angle_deg=angles.angle_deg,
        angle_sd_deg=angles.angle_sd_deg,
        pressure_kpa=pressure_kpa,
        pressure_rate_kpa_s=rate_kpa_s,
        log_time_s=log_time_s,
        log_pressure_kpa=log.pressure_kpa,
        saturated_s=log_time_s[saturated],
        log_reference_kpa=reference_kpa,
        model_pressure_kpa=None if curve is None else curve.pressure_kpa,
        model_angle_deg=None if curve is None else curve.angle_deg,
        shift=shift,
        warnings=(*angles.warnings, *warnings, *synchronised.warnings),
        provenance=json_ready(
            {
                "angles": angles.provenance,
                "log": log.provenance,
                "reference": reference_provenance,
                "model": None if curve is None else curve.provenance,
                "sync": settings.sync.model_dump(exclude_unset=True, mode="json"),
                "shift": asdict(shift),
            }
        ),
        angle_common_sd_deg=settings.angle_common_sd_deg,
    )


def _table_of(study: Study, settings: TrialSettings, where: str) -> Any:
    if study.results is None or settings.video is None:
        raise StudyError(
            f"{where}: expected angles, or results (a folder of tables or a project) for its video"
        )
    try:
        return find_table(study.results, settings.video)
    except StudyError as error:
        raise StudyError(f"{where}: {error}") from error


def _reference(settings: TrialSettings, log: PressureLog) -> tuple[FloatArray | None, dict[str, Any] | None]:
    """The reference wave at the log's samples: of its own file on the log's clock, or a column of the log."""
    if settings.reference is None:
        return log.reference_kpa, None
    wave = read_pressure_log(settings.reference, LogFormat())
    at_log = np.interp(log.time_s, wave.time_s, wave.pressure_kpa, left=np.nan, right=np.nan)
    if not np.isfinite(at_log).any():
        raise StudyError(
            f"{settings.reference}: expected a reference on the log's clock, got none of its times"
        )
    return at_log, dict(wave.provenance)


def _check_nominal(pp_kpa: float, settings: TrialSettings, log: PressureLog, where: str) -> list[str]:
    """A warning if the pressure differs from the nominal one.

    Raises
    ------
    StudyError
        The difference is explained by another unit.
    """
    nominal = settings.pressure_pp_kpa
    if nominal is None or pp_kpa <= 0 or abs(pp_kpa / nominal - 1) <= _NOMINAL_TOLERANCE:
        return []
    difference = f"peak-to-peak pressure is {pp_kpa:.4g} kPa, {nominal:g} kPa were expected"
    unit = log.provenance["pressure_unit"]
    if not 1 / _NOMINAL_FACTOR < pp_kpa / nominal < _NOMINAL_FACTOR and unit in KPA_IN:
        for other, factor in KPA_IN.items():
            if abs(pp_kpa * factor / KPA_IN[unit] / nominal - 1) <= _NOMINAL_TOLERANCE:
                raise StudyError(
                    f"{where}: {difference}: the log was read in {unit} and looks as if it were in {other}"
                )
    return [f"log: {difference}"]


def _coverage(time_s: FloatArray, pressure_kpa: FloatArray, log_time_s: FloatArray, where: str) -> list[str]:
    """Warnings about frames without pressure.

    Raises
    ------
    StudyError
        No frame has a pressure.
    """
    lost = np.isnan(pressure_kpa)
    log_span = f"{log_time_s[0]:.2f} to {log_time_s[-1]:.2f} s"
    if lost.all():
        raise StudyError(
            f"{where}: log and video have no moment in common: on the video's clock the log goes from {log_span}, "
            f"the video from {time_s[0]:.2f} to {time_s[-1]:.2f} s"
        )
    early, late = time_s < log_time_s[0], time_s > log_time_s[-1]
    warnings = []
    for outside, side in ((early, "before the log begins"), (late, "after the log ends")):
        if outside.any():
            warnings.append(
                f"log shorter than video: {outside.sum()} of {len(time_s)} frames lie {side} (the log goes from "
                f"{log_span} on the video's clock)"
            )
    in_gaps = int((lost & ~early & ~late).sum())
    if in_gaps:
        warnings.append(f"log: {in_gaps} of {len(time_s)} frames lie in gaps of the log")
    return warnings
