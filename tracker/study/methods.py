"""Methods section of the report: definitions with their formulas, and how intervals are computed."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .analysis import StudyResults


def methods_text(results: StudyResults) -> list[str]:
    """The methods, one string for each paragraph.

    Parameters
    ----------
    results : StudyResults
        Results of the study.

    Returns
    -------
    list of str
        Plain text.
    """
    confidence = f"{100 * results.confidence:g} %"
    return [
        "Angles were measured on every frame of the video and pressures by a log of its own clock. The log was brought "
        "to the video's clock by a shared clock, a given delay or an event seen in both, as each trial says, "
        "and never by making a loop small. Pressure was then filtered to the frames' times. Frames without an angle "
        "stay gaps.",
        "Cycles were found from the pressure alone, from lowest to lowest pressure. Incomplete first and last cycles, "
        "cycles with long gaps and cycles unlike the others are not used, each with its reason; a first cycle that "
        "lies outside the prediction interval of those after it is reported separately.",
        "The largest angle of a cycle is where curves fitted to the angle on the way up and on the way down meet at "
        "the largest pressure: the largest single reading would be too large by the noise.",
        f"Intervals hold {confidence}. For a trial they combine the spread over its cycles (Student's t) with what "
        f"all its cycles share: the uncertainty of the clocks' shift, at least half a frame, carried through by "
        f"moving the pressure against the angle; and of the angle itself, where given. Effective degrees of freedom "
        f"follow Welch and Satterthwaite. Comparisons between designs take trials as independent; p-values are "
        f"corrected after Holm for all pairs under the same condition.",
    ]


DEFINITIONS: tuple[tuple[str, str, str], ...] = (
    (
        "Dynamic response (°)",
        "The largest bending angle of a trial: the mean over its cycles' largest angles.",
        "",
    ),
    (
        "Cumulative hysteresis (° kPa)",
        "Area within the loop of angle against pressure of a cycle, its leaf; positive where the angle lags.",
        "A = ∮ θ dp",
    ),
    (
        "Hysteresis ratio",
        "That area over the area of the bounding rectangle, whose sides are the axes and the lines at the trial's "
        "largest pressure and largest angle; from 0 to 1.",
        "h = A / (p_max · θ_max)",
    ),
    (
        "Ratio to own extremes",
        "The same area over the rectangle between the loop's own smallest and largest pressure and angle. It equals "
        "the hysteresis ratio only for a loop that begins at 0 kPa and 0°.",
        "h′ = A / ((p_max − p_min) · (θ_max − θ_min))",
    ),
    (
        "Comparison at one angle",
        "Hysteresis ratio as a piecewise-linear function of the largest angle over a design's trials at one "
        "frequency. Two designs are compared where both reach the angle; elsewhere the comparison is refused.",
        "",
    ),
    (
        "Improvement",
        "Of the dynamic response and of the hysteresis ratio, against the baseline; above 0 is better.",
        "(θ_new − θ_original) / θ_original and (h_original − h_new) / h_original",
    ),
    (
        "Width at mid pressure (°)",
        "Angle on the way down minus that on the way up, half-way between the cycle's lowest and largest pressure.",
        "",
    ),
    ("Residual angle (°)", "Angle left at the lowest pressure at the end of a cycle.", ""),
    (
        "Repeatability (°)",
        "Spread (standard deviation) of the angle between cycles at the same phase, root mean square over the cycle.",
        "",
    ),
    (
        "Static RMSE and NRMSE",
        "Root mean square of measured minus model angle over the stairs of the first pressurisation; NRMSE divides "
        "it by the range of the measured curve.",
        "",
    ),
    (
        "Tracking error",
        "Root mean square of measured minus reference pressure over the whole log, the sensor's noise included; "
        "NRMSE divides it by the reference's peak-to-peak.",
        "",
    ),
)
