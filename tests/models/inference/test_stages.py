"""`StageSettings`, and the stages of `CheckpointMetadata.calibrated`; the estimator's are in test_coarse_to_fine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bendtrack.models.inference.calibration import Calibration
from bendtrack.models.inference.metadata import CheckpointMetadata
from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.models.inference.stages import ALL_STAGES, StageSettings
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.types import Detections

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
METADATA = CheckpointMetadata(
    backbone="resnet18",
    keypoints=KEYPOINTS,
    definition=AngleDefinition("two-vector", KEYPOINTS),
    regions=(RegionOfInterest((200, 100), 0, 0, 200, 100, 1.0, 1.0),),
    reference=(1, 0, 3, 2),
    calibration=Calibration(),
    systematic_bias=(((2.0, 0.0),),) * 4,
    distance_range=((18.0, 22.0),) * 4,
)
GEOMETRY = METADATA.geometry_for((200, 100))


def found_at(tip_px: float) -> Detections:
    """Four points on a level line, the moving end `tip_px` long; read-only, as no stage may write into them."""
    xy = np.array([[[20.0, 50.0], [40.0, 50.0], [120.0, 50.0], [120.0 + tip_px, 50.0]]])
    arrays = xy, np.full((1, 4), 0.9), np.tile(np.eye(2), (1, 4, 1, 1))
    for array in arrays:
        array.setflags(write=False)
    return Detections(*arrays)


def test_every_stage_runs_by_default() -> None:
    assert StageSettings() == ALL_STAGES
    assert ALL_STAGES.off() == ()


@pytest.mark.parametrize("name", StageSettings.names())
def test_a_stage_that_is_off_is_named(name: str) -> None:
    assert replace(ALL_STAGES, **{name: False}).off() == (name,)


def test_names_are_in_the_order_in_which_a_frame_meets_them() -> None:
    names = StageSettings.names()
    assert names[:3] == ("whole_frame_search", "iterative_refinement", "end_regression")
    assert len(set(names)) == len(names)
    off = StageSettings(**dict.fromkeys(reversed(names), False)).off()
    assert off == names


def test_distance_check() -> None:
    """An end of 40 px, of which labels know 18 to 22 px, gets likelihood 0."""
    checked = METADATA.calibrated(found_at(40.0), GEOMETRY)
    assert checked.likelihood.tolist() == [[0.9, 0.9, 0.0, 0.0]]
    unchecked = METADATA.calibrated(found_at(40.0), GEOMETRY, StageSettings(distance_check=False))
    assert unchecked.likelihood.tolist() == [[0.9] * 4]
    np.testing.assert_array_equal(checked.xy, unchecked.xy)


def test_a_network_of_an_earlier_version_is_corrected_by_its_bias() -> None:
    """2 px along the direction of each end, which is x here."""
    found = found_at(20.0)
    corrected = METADATA.calibrated(found, GEOMETRY)
    np.testing.assert_allclose(corrected.xy, found.xy + np.array([2.0, 0.0]))
