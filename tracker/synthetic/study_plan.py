"""Which trials a simulated study has, and what is true of them: eight designs, after the paper's tables.

Angles of `original` and `mid-width smaller` are the paper's (table of dynamic response); their ratios are set so
that straight lines between neighbouring trials pass through the paper's comparisons at one angle (table of
hysteresis ratio). What the paper gives in figures only is set here as it could be.
"""

from __future__ import annotations

from dataclasses import dataclass

BASELINE = "original"

# A trial: peak-to-peak pressure (kPa), largest angle (deg), hysteresis ratio.
_Trials = list[tuple[float, float, float]]


@dataclass(frozen=True)
class Comparison:
    """Two designs at one angle (paper, table of hysteresis ratio)."""

    frequency_hz: float
    angle_deg: float
    design: str
    ratio_baseline: float
    ratio: float

    @property
    def improvement(self) -> float:
        return (self.ratio_baseline - self.ratio) / self.ratio_baseline


COMPARISONS = (
    Comparison(0.0625, 140.0, "mid-width smaller", 0.279, 0.219),
    Comparison(0.25, 85.0, "mid-width smaller", 0.303, 0.238),
)


def _through(angle_deg: float, ratio: float, trials: _Trials, angle_after_deg: float) -> float:
    """Ratio at `angle_after_deg` so that the line from the last of `trials` passes through (angle, ratio)."""
    _, before_deg, before = trials[-1]
    return before + (ratio - before) * (angle_after_deg - before_deg) / (angle_deg - before_deg)


def _dynamic() -> dict[tuple[str, float], _Trials]:
    slow, fast = COMPARISONS
    original_slow = [(40.0, 45.44, 0.318), (45.0, 76.30, 0.304), (50.0, 119.48, 0.288)]
    original_fast = [(40.0, 29.34, 0.338), (45.0, 40.57, 0.329), (50.0, 63.92, 0.314)]
    width_slow = [(40.0, 93.28, 0.229)]
    width_fast = [(40.0, 50.19, 0.253)]
    for trials, comparison, ratio, after in (
        (original_slow, slow, slow.ratio_baseline, (55.0, 141.80)),
        (original_fast, fast, fast.ratio_baseline, (55.0, 92.60)),
        (width_slow, slow, slow.ratio, (45.0, 155.83)),
        (width_fast, fast, fast.ratio, (45.0, 85.91)),
    ):
        trials.append((*after, _through(comparison.angle_deg, ratio, trials, after[1])))
    width_slow.append((50.0, 191.66, 0.212))
    width_fast.append((50.0, 118.06, 0.229))
    return {
        ("original", 0.0625): original_slow,
        ("original", 0.25): original_fast,
        ("mid-side walls thicker", 0.0625): [(40, 90.15, 0.297), (45, 141.30, 0.284), (50, 174.62, 0.271)],
        ("mid-side walls thicker", 0.25): [(40, 46.72, 0.331), (45, 74.18, 0.312), (50, 104.75, 0.296)],
        ("mid-top wall thicker", 0.0625): [
            *[(40, 25.31, 0.342), (45, 38.94, 0.333), (50, 58.27, 0.321)],
            *[(55, 82.66, 0.309), (60, 104.88, 0.300)],
        ],
        ("mid-top wall thicker", 0.25): [
            *[(40, 17.82, 0.356), (45, 25.46, 0.349), (50, 37.13, 0.340)],
            *[(55, 52.09, 0.329), (60, 67.35, 0.318)],
        ],
        ("mid-length smaller", 0.0625): [(40, 52.73, 0.309), (45, 88.41, 0.294), (50, 131.20, 0.280)],
        ("mid-length smaller", 0.25): [(40, 32.90, 0.334), (45, 47.24, 0.322), (50, 74.06, 0.307)],
        ("mid-length larger", 0.0625): [(40, 41.85, 0.322), (45, 69.52, 0.310), (50, 108.33, 0.295)],
        ("mid-length larger", 0.25): [(40, 27.41, 0.343), (45, 37.68, 0.336), (50, 58.95, 0.322)],
        ("mid-width larger", 0.0625): [(40, 36.94, 0.331), (45, 60.17, 0.321), (50, 97.42, 0.306)],
        ("mid-width larger", 0.25): [(40, 24.58, 0.351), (45, 33.79, 0.344), (50, 52.36, 0.330)],
        ("mid-width smaller", 0.0625): width_slow,
        ("mid-width smaller", 0.25): width_fast,
        ("mid-height smaller", 0.0625): [(40, 66.03, 0.298), (45, 112.49, 0.281), (50, 158.30, 0.263)],
        ("mid-height smaller", 0.25): [(40, 38.77, 0.325), (45, 61.35, 0.309), (50, 92.18, 0.290)],
    }


# (design, frequency): its trials by rising pressure. 54 in all.
DYNAMIC = _dynamic()
DESIGNS = tuple(dict.fromkeys(design for design, _ in DYNAMIC))

# Design: steady angle at 50 kPa, and RMSE of the model curve (paper, table of model validation; the range is
# RMSE / NRMSE). The last has no model curve.
STATIC: dict[str, tuple[float, float | None]] = {
    "mid-side walls thicker": (182.0, 7.29),
    "mid-top wall thicker": (108.75, 4.35),
    "mid-width smaller": (199.8, 9.99),
    "original": (143.6, None),
}

# How late the pressure follows its reference, so that with sensor noise of 0.1 kPa the error at 55 kPa peak to
# peak is the paper's (table of pneumatic control): 0.4 kPa (0.7 %) slow, 0.5 kPa (1.0 %) fast.
LAG_S = {0.0625: 0.052, 0.25: 0.0170}

# Angle that is left at 0 kPa after a cycle, as a share of the largest: a fast cycle leaves more.
RESIDUAL = {0.0625: 0.015, 0.25: 0.04}
