"""Numbers with their intervals as text, for the report, figures and LaTeX tables."""

from __future__ import annotations

import math

MISSING = "–"
MINUS = "\u2212"
# No line breaks within a value and its interval.
_PLUS_MINUS = "\u00a0±\u00a0"


def plain_number(value: float, decimals: int) -> str:
    """A value with this number of decimals, or a dash where it is missing.

    Parameters
    ----------
    value : float
        The number.
    decimals : int
        Number of decimals.

    Returns
    -------
    str
        The number, with a typographic minus sign.

    Examples
    --------
    >>> plain_number(-0.00004, 3), plain_number(float("nan"), 3), plain_number(-1.26, 1)
    ('0.000', '–', '−1.3')
    """
    if not math.isfinite(value):
        return MISSING
    text = f"{value:.{decimals}f}"
    if not text.strip("-0."):
        text = text.lstrip("-")  # no minus zero
    return text.replace("-", MINUS)


def with_interval(value: float, low: float, high: float, decimals: int) -> str:
    """A value and half the width of its interval, with more decimals where the half width needs more.

    The value alone where there is no interval.

    Parameters
    ----------
    value : float
        The number.
    low, high : float
        Limits of its interval.
    decimals : int
        Least number of decimals.

    Returns
    -------
    str
        For example "0.279 ± 0.004".

    Examples
    --------
    >>> with_interval(0.27912, 0.2756, 0.2826, 3).split()
    ['0.279', '±', '0.004']
    >>> with_interval(4.0, 3.983, 4.017, 1).split()
    ['4.00', '±', '0.02']
    >>> with_interval(45.44, float("nan"), float("nan"), 1)
    '45.4'
    """
    half = (high - low) / 2
    if not (math.isfinite(value) and math.isfinite(half)):
        return plain_number(value, decimals)
    while half > 0 and float(f"{half:.{decimals}f}") == 0:
        decimals += 1
    return f"{plain_number(value, decimals)}{_PLUS_MINUS}{plain_number(half, decimals)}"


def counted(number: int, thing: str) -> str:
    """A number of things, in the singular for one.

    Parameters
    ----------
    number : int
        How many.
    thing : str
        What, in the singular, with an s in the plural.

    Returns
    -------
    str
        With thin spaces between thousands.

    Examples
    --------
    >>> counted(1, "trial"), counted(2, "trial")
    ('1 trial', '2 trials')
    """
    return f"{number:,} {thing}{'' if number == 1 else 's'}".replace(",", "\u202f")
