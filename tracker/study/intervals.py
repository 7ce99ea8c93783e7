"""A value with its standard uncertainty and degrees of freedom, and combinations of several.

Student's t throughout; a combination of several sources gets the effective degrees of freedom of Welch and
Satterthwaite (GUM, G.4). Independent of angles and pressures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from ..types import FloatArray

NAN = float("nan")


@dataclass(frozen=True)
class Estimate:
    """A value, its standard uncertainty (NaN: not known) and the degrees of freedom of that uncertainty.

    Attributes
    ----------
    value : float
        The value, NaN where unknown.
    sd : float
        Its standard uncertainty.
    dof : float
        Degrees of freedom of `sd`.
    """

    value: float
    sd: float = NAN
    dof: float = math.inf

    def interval(self, confidence: float) -> tuple[float, float]:
        """Two-sided Student interval; NaN where the uncertainty is not known.

        Parameters
        ----------
        confidence : float
            Confidence level, 0 to 1.

        Returns
        -------
        low : float
            Lower limit.
        high : float
            Upper limit.
        """
        half = student_quantile(0.5 + confidence / 2, self.dof) * self.sd
        return self.value - half, self.value + half

    def p_value(self) -> float:
        """Two-sided p-value of the null hypothesis that the true value is 0.

        Returns
        -------
        float
            Probability; NaN where the uncertainty is not known.
        """
        if not self.sd > 0:
            return NAN
        off = -abs(self.value / self.sd)
        return 2 * float(special.ndtr(off) if math.isinf(self.dof) else special.stdtr(self.dof, off))


def student_quantile(probability: float, dof: float) -> float:
    """Quantile of Student's distribution at `probability`; of the normal one for infinite `dof`.

    Parameters
    ----------
    probability : float
        Probability below the quantile, 0 to 1.
    dof : float
        Degrees of freedom.

    Returns
    -------
    float
        The quantile.
    """
    return float(special.ndtri(probability) if math.isinf(dof) else special.stdtrit(dof, probability))


def mean_of(values: ArrayLike) -> Estimate:
    """Mean of repeated measurements and its standard uncertainty; NaN uncertainty from a single one.

    Parameters
    ----------
    values : ArrayLike
        (N,) repeated measurements.

    Returns
    -------
    Estimate
        The mean, with N - 1 degrees of freedom.
    """
    values = np.asarray(values, dtype=float)
    if values.size < 2:
        return Estimate(float(values[0]) if values.size else NAN, NAN, 1)
    return Estimate(float(values.mean()), float(values.std(ddof=1)) / math.sqrt(values.size), values.size - 1)


def combined(value: float, parts: Sequence[tuple[float, Estimate]]) -> Estimate:
    """`value` with the uncertainty of independent inputs: a pair (derivative by that input, the input) each.

    Source: GUM 5.1.2 and the Welch-Satterthwaite formula G.2b.

    Parameters
    ----------
    value : float
        The value computed from the inputs.
    parts : sequence of tuple of (float, Estimate)
        Pairs (derivative of the value with respect to an input, the input).

    Returns
    -------
    Estimate
        The value with its combined uncertainty and effective degrees of freedom.
    """
    variances = [(slope * part.sd) ** 2 for slope, part in parts if slope != 0]
    total = sum(variances)
    if not total > 0:
        return Estimate(value, math.sqrt(total) if total == total else NAN)
    reciprocal_dof = sum(
        variance**2 / part.dof
        for variance, part in zip(variances, (part for slope, part in parts if slope != 0), strict=True)
    )
    return Estimate(value, math.sqrt(total), total**2 / reciprocal_dof if reciprocal_dof > 0 else math.inf)


def line_through(x: FloatArray, y: FloatArray, at: float) -> tuple[Estimate, Estimate]:
    """Least-squares line through three points or more: its slope, and its value at `at`.

    Parameters
    ----------
    x, y : ndarray of float
        (N,) points, N >= 3.
    at : float
        Where the line is evaluated.

    Returns
    -------
    slope : Estimate
        Slope of the line.
    value : Estimate
        Value of the line at `at`.
    """
    centre = x.mean()
    spread = float(((x - centre) ** 2).sum())
    slope = float(((x - centre) * y).sum()) / spread
    residual = y - y.mean() - slope * (x - centre)
    dof = x.size - 2
    sd = math.sqrt(float(residual @ residual) / dof)
    value = float(y.mean()) + slope * (at - centre)
    return (
        Estimate(slope, sd / math.sqrt(spread), dof),
        Estimate(value, sd * math.sqrt(1 / x.size + (at - centre) ** 2 / spread), dof),
    )


def holm_adjusted(p_values: Sequence[float]) -> list[float]:
    """Holm's adjusted p-values (Scand. J. Statist. 6, 1979) of one family; NaN stays NaN and does not count.

    Parameters
    ----------
    p_values : sequence of float
        p-values of one family of tests.

    Returns
    -------
    list of float
        Adjusted p-values, in the same order.
    """
    known = sorted((p, index) for index, p in enumerate(p_values) if p == p)
    adjusted = [NAN] * len(p_values)
    largest = 0.0
    for rank, (p, index) in enumerate(known):
        largest = max(largest, min(1.0, p * (len(known) - rank)))
        adjusted[index] = largest
    return adjusted
