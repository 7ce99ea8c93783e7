"""An estimator of coloured spots, and the metadata of its networks."""

from __future__ import annotations

import pytest
from spots import REGION, SpotPredictor

from bendtrack.models.inference.calibration import Calibration
from bendtrack.models.inference.coarse_to_fine import CoarseToFineEstimator
from bendtrack.models.inference.metadata import CheckpointMetadata
from bendtrack.tracker.angle import AngleDefinition


@pytest.fixture
def estimator() -> CoarseToFineEstimator:
    return CoarseToFineEstimator(SpotPredictor(), SpotPredictor())


@pytest.fixture
def metadata() -> CheckpointMetadata:
    keypoints = ("base", "middle", "tip")
    return CheckpointMetadata(
        backbone="resnet18",
        keypoints=keypoints,
        definition=AngleDefinition("three-point", keypoints),
        regions=(REGION,),
        reference=(1, 2, 1),
        calibration=Calibration(reference_peak=(0.8, 0.8, 0.8)),
    )
