"""Faults of a sensor or a unit that show in the pressure signal itself. They are reported; nothing is changed."""

from __future__ import annotations

import numpy as np

from ..types import BoolArray, FloatArray
from .log_clock import usual_step_s

# A smaller range is noise, no actuation.
_CONSTANT_KPA = 0.5
# Below gauge zero by more than a sensor's offset: a vacuum, a wrong zero or a wrong sign.
_NEGATIVE_KPA = 1.0
# Silicone pneu-nets burst far below; logs above it are in another unit.
_TOO_MUCH_KPA = 1000.0
# About atmospheric pressure: a log that stays above it is absolute, not gauge.
_ATMOSPHERE_KPA = 80.0
# A constant value of this duration, where neighbours otherwise differ, is a saturated sensor.
_HELD_S = 0.05


def pressure_faults(time_s: FloatArray, pressure_kpa: FloatArray) -> tuple[list[str], BoolArray]:
    """Faults of a pressure signal.

    Parameters
    ----------
    time_s : ndarray of float
        (M,) rising times, s.
    pressure_kpa : ndarray of float
        (M,) pressures, kPa; NaN where missing.

    Returns
    -------
    warnings : list of str
        A line for each fault, which begins with the fault's name.
    saturated : ndarray of bool
        (M,) samples at a limit of the sensor's range.
    """
    warnings = []
    saturated = np.zeros(len(pressure_kpa), dtype=bool)
    lost = int(np.isnan(pressure_kpa).sum())
    if lost:
        warnings.append(f"gap: {lost} of {len(pressure_kpa)} samples of the pressure are empty or no number")
    known = ~np.isnan(pressure_kpa)
    time_s, pressure_kpa = time_s[known], pressure_kpa[known]
    low, high = (float(v) for v in np.percentile(pressure_kpa, [0.5, 99.5]))
    if high - low < _CONSTANT_KPA:
        warnings.append(
            f"constant pressure: it stays between {pressure_kpa.min():.3g} and {pressure_kpa.max():.3g} kPa"
        )
        return warnings, saturated
    if low < -max(_NEGATIVE_KPA, 0.02 * (high - low)):
        warnings.append(
            f"negative pressure: it goes down to {low:.3g} kPa; a vacuum, or the sensor's zero or sign is wrong"
        )
    if low > _ATMOSPHERE_KPA and high < _TOO_MUCH_KPA:
        warnings.append(
            f"absolute pressure: it stays above {low:.4g} kPa, as a sensor that counts the atmosphere does; "
            "give offset_kpa = -101.3 if so"
        )
    if max(abs(low), abs(high)) > _TOO_MUCH_KPA:
        warnings.append(f"implausible pressure: it reaches {high:.4g} kPa; is the unit right?")
    held = _held_samples(pressure_kpa)
    step_s = usual_step_s(time_s)
    if held > 1:
        warnings.append(
            f"held values: the pressure changes at every {held}th sample only, every {held * step_s * 1000:.3g} ms; "
            f"it is {(held - 1) / 2 * step_s * 1000:.3g} ms late on average"
        )
    found, saturated[known] = _saturation(pressure_kpa, held, step_s)
    return warnings + found, saturated


def _held_samples(values: FloatArray) -> int:
    """How many samples in a row repeat one reading of a sensor that is slower than the log; 1 if none do."""
    changes = np.flatnonzero(np.diff(values) != 0) + 1
    if len(changes) < 100:
        return 1
    apart = int(np.gcd.reduce(np.diff(changes)))
    return apart if apart < 100 else 1


def _saturation(values: FloatArray, held: int, step_s: float) -> tuple[list[str], BoolArray]:
    """An upper or lower limit held exactly, unlike the other values: warnings, and a mask of the samples."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1])
    lengths = np.diff(np.concatenate([starts, [len(values)]]))
    level = values[starts]
    inner = np.ones(len(starts), dtype=bool)
    inner[[0, -1]] = False  # a rest at the bottom, before and after the waves, is none
    found, saturated = [], np.zeros(len(starts), dtype=bool)
    for end, extreme in (("upper", values.max()), ("lower", values.min())):
        at_end = (level == extreme) & (inner | (end == "upper"))
        elsewhere = lengths[(level != extreme) & inner]
        if not at_end.any() or not len(elsewhere):
            continue
        needed = max(_HELD_S / step_s, 5 * held, 3 * float(np.percentile(elsewhere, 99)))
        long = at_end & (lengths >= needed)
        if long.any():
            saturated |= at_end  # short runs at a known limit are saturated too
            found.append(
                f"saturation: the {end} end, {extreme:.4g} kPa, is held exactly {int(long.sum())} times, "
                f"{float(lengths[long].sum()) * step_s:.3g} s in all; the true pressure went beyond what the sensor "
                f"or the logger can say"
            )
    return found, np.repeat(saturated, lengths)
