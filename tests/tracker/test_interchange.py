"""Angle tables in other programs' words: xarray with movement's dimensions, and Neurodata Without Borders."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import MissingPackageError, ResultsError
from bendtrack.tracker.results import AngleTable

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
EVEN_S = np.arange(6) / 25


def needs(*packages: str) -> pytest.MarkDecorator:
    """Skips, and says so, without the packages of an extra.

    Where one of the extras' packages is there, as in .ci/run's second environment, all must be: nothing is skipped.
    """
    if any(importlib.util.find_spec(name) for name in ("xarray", "movement", "pynwb")) and os.environ.get(
        "CI"
    ):
        return pytest.mark.skipif(False, reason="")
    missing = [name for name in packages if importlib.util.find_spec(name) is None]
    return pytest.mark.skipif(bool(missing), reason=f"needs {', '.join(missing)}, an extra of bendtrack")


def table_at(time_s: np.ndarray) -> AngleTable:
    rng = np.random.default_rng(4)
    t, k = len(time_s), len(KEYPOINTS)
    flag = np.array(["", "low_likelihood"] + [""] * (t - 2))
    angle = 10.0 * np.arange(t)
    angle[-1] = np.nan
    return AngleTable(
        time_s=time_s,
        angle_deg=angle,
        angle_sd_deg=np.full(t, 0.3),
        flag=flag,
        xy=rng.uniform(0, 100, (t, k, 2)),
        likelihood=rng.uniform(0, 1, (t, k)),
        covariance=rng.uniform(0, 1, (t, k, 2, 2)),
        keypoints=KEYPOINTS,
        definition=AngleDefinition("two-vector", KEYPOINTS, -1),
        provenance={"video": {"name": "a.mp4", "sha256": "0" * 64}, "bendtrack": "0.1"},
    )


def assert_equal(a: AngleTable, b: AngleTable) -> None:
    for field in dataclasses.fields(AngleTable):
        one, other = getattr(a, field.name), getattr(b, field.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other)
        else:
            assert one == other, field.name


@needs("xarray")
def test_a_dataset_has_the_angle_on_time_with_units_and_goes_back() -> None:
    table = table_at(EVEN_S)
    dataset = table.to_xarray()
    assert dataset["position"].dims == ("time", "space", "keypoints", "individuals")
    assert dataset["angle"].dims == ("time",)
    assert dataset["angle"].attrs["units"] == "degree"
    assert dataset["angle_sd"].attrs["units"] == "degree"
    assert dataset.attrs["ds_type"] == "poses"
    assert dataset.attrs["time_unit"] == "seconds"
    assert dataset.attrs["fps"] == pytest.approx(25)
    y = dataset["position"].sel(space="y", keypoints="tip_1", individuals="actuator")
    np.testing.assert_array_equal(y, table.xy[:, 2, 1])
    assert_equal(AngleTable.from_xarray(dataset), table)


@needs("xarray")
def test_frames_at_uneven_times_have_no_rate() -> None:
    times = EVEN_S.copy()
    times[3:] += 0.04  # one frame was lost
    dataset = table_at(times).to_xarray()
    assert "fps" not in dataset.attrs
    np.testing.assert_array_equal(dataset["time"], times)


@needs("xarray")
def test_a_dataset_of_something_else_is_refused() -> None:
    dataset = table_at(EVEN_S).to_xarray()
    with pytest.raises(ResultsError, match="got one without angle"):
        AngleTable.from_xarray(dataset.drop_vars("angle"))


@needs("movement")
def test_movement_takes_the_dataset_and_it_comes_back() -> None:
    from movement.filtering import filter_by_confidence
    from movement.kinematics import compute_velocity
    from movement.validators.datasets import ValidPosesInputs

    table = table_at(EVEN_S)
    dataset = table.to_xarray()
    ValidPosesInputs.validate(dataset)
    velocity = compute_velocity(dataset["position"])
    expected = np.gradient(table.xy, table.time_s, axis=0)
    np.testing.assert_allclose(
        velocity.squeeze("individuals").transpose("time", "keypoints", "space"), expected
    )
    kept = filter_by_confidence(dataset["position"], dataset["confidence"], threshold=0.5)
    assert bool(
        np.isnan(
            kept.squeeze().transpose("time", "keypoints", "space").to_numpy()[table.likelihood < 0.5]
        ).all()
    )
    assert_equal(AngleTable.from_xarray(dataset), table)


@needs("pynwb", "ndx_pose")
def test_an_nwb_file_has_the_frames_own_times(tmp_path: Path) -> None:
    from pynwb import NWBHDF5IO

    times = EVEN_S.copy()
    times[3:] += 0.04
    table = table_at(times)
    path = table.to_nwb(tmp_path / "a.nwb")
    with NWBHDF5IO(str(path), "r") as io:
        behavior = io.read().processing["behavior"]
        poses = behavior["PoseEstimation"]
        assert tuple(poses.skeleton.nodes[:]) == KEYPOINTS
        for k, name in enumerate(KEYPOINTS):
            series = poses.pose_estimation_series[name]
            assert series.rate is None
            np.testing.assert_array_equal(series.timestamps[:], times)
            np.testing.assert_array_equal(series.data[:], table.xy[:, k])
            np.testing.assert_array_equal(series.confidence[:], table.likelihood[:, k])
        angle = behavior["bending_angle"]
        assert angle.rate is None
        assert angle.unit == "degrees"
        np.testing.assert_array_equal(angle.timestamps[:], times)
        np.testing.assert_array_equal(angle.data[:], table.angle_deg)
        np.testing.assert_array_equal(behavior["bending_angle_sd"].data[:], table.angle_sd_deg)


@pytest.mark.parametrize(
    ("method", "package", "extra"), [("to_xarray", "xarray", "xarray"), ("to_nwb", "ndx_pose", "nwb")]
)
def test_without_the_extra_one_line_says_which(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str, package: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)  # as if it were not installed
    arguments = [tmp_path / "a.nwb"] if method == "to_nwb" else []
    with pytest.raises(MissingPackageError, match=rf"needs {package}.*pip install '\.\[{extra}\]'"):
        getattr(table_at(EVEN_S), method)(*arguments)
