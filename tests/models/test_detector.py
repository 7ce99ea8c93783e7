"""`NetworkDetector.for_video`: which stages without labels are set up. How they compute is tested where they live."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from bendtrack.models import detector as detector_module
from bendtrack.models.detector import NetworkDetector
from bendtrack.models.inference.stages import StageSettings
from bendtrack.models.networks.checkpoint import Checkpoint
from bendtrack.models.networks.shipped import shipped_network
from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.types import Detections


def test_a_network_that_is_anchored_nowhere_measures_the_fixed_end(shipped: Checkpoint) -> None:
    detector = NetworkDetector.load(shipped_network("resnet18"), engine="torch", device="cpu")
    assert detector.findings == {"fixed_end": "measured"}


@pytest.mark.parametrize("off", [None, "end_regression", "self_training"])
def test_stages_without_labels(off: str | None, shipped: Checkpoint, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each stage is handed to `find_actuator` unless it is off."""
    handed: list[object] = []

    def find_actuator(probe_frames, metadata, *given):
        handed.extend(given)
        raise VideoError("expected nothing more")

    monkeypatch.setattr(detector_module, "find_actuator", find_actuator)
    stages = StageSettings(**({off: False} if off else {}))
    estimator = shipped.network.estimator(shipped.candidates)
    monkeypatch.setattr(
        detector_module, "_torch_estimator", lambda *given: replace(estimator, stages=given[-1])
    )
    detector = NetworkDetector.load(shipped_network("resnet18"), engine="torch", device="cpu", stages=stages)
    assert detector.stages == stages
    assert detector.provenance["stages"] == asdict(stages)
    with pytest.raises(VideoError):
        detector.for_video(np.zeros((2, 48, 64, 3), np.uint8))
    own, fit_ends, fit_network = handed
    assert (fit_ends is None) == (off == "end_regression")
    assert (fit_network is None) == (off == "self_training")
    assert own.stages == stages


def test_only_a_network_with_labels_is_calibrated_for_a_film(shipped: Checkpoint) -> None:
    """The shipped network's peaks are calibrated when it has found the actuator of a video."""
    detector = NetworkDetector.load(shipped_network("resnet18"), engine="torch", device="cpu")
    k = len(detector.keypoints)
    dim = Detections(np.zeros((9, k, 2)), np.full((9, k), 0.6), np.zeros((9, k, 2, 2)))
    assert detector.film_calibrated(dim) == (dim, {})
    detector.metadata = replace(detector.metadata, kind="project")
    found, findings = detector.film_calibrated(dim)
    assert found.likelihood.tolist() == [[1.0] * k] * 9
    assert set(findings["peak_share"].values()) == {0.6}
    detector._estimator = replace(detector._estimator, stages=StageSettings(film_calibration=False))
    assert detector.film_calibrated(dim) == (dim, {})
