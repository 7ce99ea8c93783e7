"""Onset detection: a lamp or a trigger that goes on, a pressure or an angle that begins to change.

Two signals are synchronised by their onsets in `synchronisation.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import StudyError
from ..types import FloatArray

# Least distance of two levels, in standard deviations of the noise.
_CLEAR = 6.0
# Required rest at the start of a signal, and the time before the onset that is fitted.
_REST_S = 0.5
_BEFORE_S = 1.0
# Least duration of a departure from rest.
_LASTING_S = 0.1
# The onset is fitted over two durations after it: where no shape fits, they differ by about the error of each.
_AFTER_S = (0.4, 0.8)
_MIN_SAMPLES = 10
_MAX_SAMPLES = 180


@dataclass(frozen=True)
class Onset:
    """Time of an onset, s on the signal's own clock, and its standard uncertainty, s.

    Attributes
    ----------
    time_s : float
        Time of the onset, s.
    sd_s : float
        Its standard uncertainty, s.
    """

    time_s: float
    sd_s: float


def rising_edges(time_s: FloatArray, value: FloatArray, where: str) -> list[Onset]:
    """Every time at which a signal of two levels goes from the lower to the higher one.

    An edge lies anywhere between the last sample below the middle of the levels and the first one above: its
    uncertainty is that of a rectangular distribution.

    Parameters
    ----------
    time_s, value : ndarray of float
        (M,) rising times in s, and the signal; NaN values are ignored.
    where : str
        Begins error messages.

    Returns
    -------
    list of Onset
        All rising edges, in the order of time.

    Raises
    ------
    StudyError
        The signal has no two levels, or is on from the beginning and never goes on again.
    """
    time_s, value = _known(time_s, value, where)
    low, high = float(value.min()), float(value.max())
    on = value > (low + high) / 2
    if high == low or value[on].mean() - value[~on].mean() <= _CLEAR * max(value[on].std(), value[~on].std()):
        raise StudyError(f"{where}: expected a step between two levels, found none ({low:g} to {high:g})")
    after = np.flatnonzero(on[1:] & ~on[:-1]) + 1
    if not len(after):
        raise StudyError(f"{where}: expected a step upward, found a signal that is on from the beginning")
    gaps = time_s[after] - time_s[after - 1]
    middles = (time_s[after] + time_s[after - 1]) / 2
    return [Onset(float(t), float(gap / 12**0.5)) for t, gap in zip(middles, gaps, strict=True)]


def onset_from_rest(time_s: FloatArray, value: FloatArray, where: str) -> Onset:
    """Time at which a signal that is at rest begins to rise or fall.

    A rest followed by a change is fitted around the first departure above the noise, over two durations; the
    difference between the two results is added to the uncertainty of the fit.

    Parameters
    ----------
    time_s, value : ndarray of float
        (M,) rising times in s, and the signal; NaN values are ignored.
    where : str
        Begins error messages.

    Returns
    -------
    Onset
        The onset.

    Raises
    ------
    StudyError
        The signal does not begin with a rest, or stays at rest.
    """
    time_s, value = _known(time_s, value, where)
    n_rest = int(np.searchsorted(time_s, time_s[0] + _REST_S))
    step_s = float(np.median(np.diff(time_s)))
    n_lasting = max(3, round(_LASTING_S / step_s))
    if n_rest < n_lasting or n_rest + n_lasting >= len(time_s):
        raise StudyError(
            f"{where}: expected a rest of {_REST_S:g} s and an onset after it, got too few samples"
        )
    rest = float(np.mean(value[:n_rest]))
    # Noise around a fitted line, so that a drift is not counted as noise.
    line = np.polynomial.Polynomial.fit(time_s[:n_rest], value[:n_rest], 1)
    noise = float(np.std(value[:n_rest] - line(time_s[:n_rest]), ddof=2))
    # A running mean over the least duration; a signal without noise still has rounding.
    smooth = np.convolve(value - rest, np.full(n_lasting, 1 / n_lasting), mode="valid")
    clear = max(_CLEAR * noise / n_lasting**0.5, 1e-3 * float(np.ptp(value)))
    beyond = np.abs(smooth) > clear
    if not beyond.any():
        raise StudyError(f"{where}: expected an onset, found a signal that stays at {rest:.4g}")
    first = int(np.argmax(beyond)) + n_lasting - 1
    if first < n_rest:
        raise StudyError(f"{where}: expected a rest of {_REST_S:g} s before the onset, found none")
    begin = int(np.searchsorted(time_s, time_s[first] - _BEFORE_S))
    ends = [int(np.searchsorted(time_s, time_s[first] + after)) for after in _AFTER_S]
    short, long = (_begin_of(time_s[begin:end], value[begin:end]) for end in ends)
    return Onset(short.time_s, float(np.hypot(short.sd_s, long.time_s - short.time_s)))


def _begin_of(t: FloatArray, v: FloatArray) -> Onset:
    """Onset of samples (N,) that rest and then begin to change: the posterior mean over all onsets.

    The change is one of three shapes: a ramp to a level, an exponential approach to a level, a gradual slope; each
    with its own time constant. All onsets, shapes and time constants are weighted by their likelihood (Gaussian
    noise with the variance of the best fit), so their ambiguity is part of the uncertainty.
    """
    t, v = _thinned(t, v)
    begins = np.linspace(t[0], t[-1], 42)[1:-1]
    lasts = (t[-1] - t[0]) * np.geomspace(0.01, 3, 40)
    for _ in range(3):  # on a finer grid around the likely onsets
        squares = np.stack([_misfits(t, v, begins, last) for last in lasts])
        noise = max(float(squares.min()) / max(1, len(t) - 4), 1e-300)
        weight = np.exp(-(squares - squares.min()) / (2 * noise)).sum(axis=(0, 1))
        weight /= weight.sum()
        mean = float(weight @ begins)
        sd = float(np.sqrt(weight @ (begins - mean) ** 2 + (begins[1] - begins[0]) ** 2 / 12))
        begins = np.linspace(max(t[0], mean - 5 * sd), min(t[-1], mean + 5 * sd), 40)
    # The onset is unknown between two samples.
    return Onset(mean, float(np.hypot(sd, np.median(np.diff(t)) / 12**0.5)))


def _thinned(t: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of neighbouring samples where there are more than needed; no information is lost."""
    n = max(1, len(t) // _MAX_SAMPLES)
    whole = len(t) // n * n
    return t[:whole].reshape(-1, n).mean(axis=1), v[:whole].reshape(-1, n).mean(axis=1)


def _misfits(t: FloatArray, v: FloatArray, begins: FloatArray, last: float) -> FloatArray:
    """Residual sums of squares (3, B) of the shapes for B onsets, with the best rest level and height."""
    since = np.maximum(t - begins[:, None], 0) / last
    shapes = np.stack([np.minimum(since, 1), -np.expm1(-since), since**2 / (1 + since)])
    shapes -= shapes.mean(axis=2, keepdims=True)
    away = v - v.mean()
    power = np.maximum((shapes**2).sum(axis=2), 1e-12)
    return np.asarray((away**2).sum() - (shapes @ away) ** 2 / power)


def _known(time_s: FloatArray, value: FloatArray, where: str) -> tuple[FloatArray, FloatArray]:
    known = np.isfinite(value)
    if known.sum() < _MIN_SAMPLES:
        raise StudyError(f"{where}: expected a signal with an event in it, got {int(known.sum())} samples")
    return time_s[known], value[known]
