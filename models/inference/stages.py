"""Which stages of inference run. Every stage can be switched off for an ablation, and results record what ran."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields


@dataclass(frozen=True)
class StageSettings:
    """One switch for each stage, in the order in which a frame meets them.

    `benchmarks/ablation.py` measures what each is worth; `off()` names those that do not run.

    Attributes
    ----------
    whole_frame_search : bool
        Search the whole frame for a keypoint that the region of interest does not show.
    iterative_refinement : bool
        Crop once more where a keypoint was found far from the centre of its crop.
    end_regression : bool
        Correct the pose of moving ends by regression on a high-resolution crop.
    agreement_check : bool
        A keypoint that the two networks put in different places gets likelihood 0.
    static_patches : bool
        A keypoint at rest whose crop has not changed is not searched again.
    backward_pass : bool
        A keypoint that was lost is searched again from the frames after it.
    distance_check : bool
        A keypoint too near to its reference keypoint or too far from it gets likelihood 0.
    film_calibration : bool
        Likelihoods are calibrated for the film: in other light than the labels' all peaks are lower.
    motion_evidence : bool
        Without labels: what moves in the video is taken for the actuator, not what looks most like one.
    base_measurement : bool
        Without labels: a fixed end that yields is measured in every frame, not held at one place.
    self_training : bool
        Without labels: fit the network to the video first where it is not sure everywhere.
    edge_orientation : bool
        Without labels: estimate the direction of both ends from their edges.
    """

    whole_frame_search: bool = True
    iterative_refinement: bool = True
    end_regression: bool = True
    agreement_check: bool = True
    static_patches: bool = True
    backward_pass: bool = True
    distance_check: bool = True
    film_calibration: bool = True
    motion_evidence: bool = True
    base_measurement: bool = True
    self_training: bool = True
    edge_orientation: bool = True

    def off(self) -> tuple[str, ...]:
        """Names of the stages that do not run.

        Returns
        -------
        tuple of str
            In the order of the attributes; empty by default.
        """
        return tuple(name for name, runs in asdict(self).items() if not runs)

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """All stages' names, in the order in which a frame meets them."""
        return tuple(part.name for part in fields(cls))


ALL_STAGES = StageSettings()
"""The default: every stage runs."""
