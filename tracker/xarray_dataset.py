"""An angle table as an xarray dataset and back: movement's dimensions and names for poses, the angle on time.

movement's datasets of poses have the dimensions time, space, keypoints and individuals, and the variables `position`
and `confidence` (https://movement.neuroinformatics.dev, "movement datasets"); its functions take this one as it is.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from .angle import AngleDefinition
from .errors import AngleError, ResultsError
from .extras import install_command, needed
from .results import AngleTable, json_ready
from .types import FloatArray

if TYPE_CHECKING:
    import xarray

INDIVIDUAL = "actuator"
"""Name of the one individual: a table holds one actuator."""

_DIMS = ("time", "space", "keypoints", "individuals")

CONSTANT_RATE_TOLERANCE = 1e-3
"""Frames count as evenly spaced when no interval differs by more than this share of their median: times in containers
are rounded to a tick, at 30 frames/s mostly of 1/90000 s."""


def to_dataset(table: AngleTable) -> xarray.Dataset:
    """Put an angle table into a dataset.

    Parameters
    ----------
    table : AngleTable
        T rows, K keypoints.

    Returns
    -------
    xarray.Dataset
        Coordinates `time` (seconds), `space` ("x", "y"), `keypoints`, `individuals`. Variables `position` (time, space,
        keypoints, individuals) px, `confidence` (time, keypoints, individuals), `angle` and `angle_sd` (time) degrees,
        `flag` (time), `covariance` (time, keypoints, space, space2) px^2. Attributes as movement's, with `fps` only
        where the frames are evenly spaced.

    Raises
    ------
    MissingPackageError
        xarray is not installed.
    """
    with needed("AngleTable.to_xarray()", ("xarray",), install_command("xarray")):
        import xarray

    attributes: dict[str, Any] = {
        "source_software": "bendtrack",
        "ds_type": "poses",
        "time_unit": "seconds",
        "definition": json.dumps(json_ready(None if table.definition is None else asdict(table.definition))),
        "provenance": json.dumps(json_ready(table.provenance), ensure_ascii=False),
    }
    fps = constant_rate(table.time_s)
    if fps is not None:
        attributes["fps"] = fps
    video = table.provenance.get("video", {}).get("name")
    if video is not None:
        attributes["source_file"] = video
    return xarray.Dataset(
        {
            "position": (_DIMS, table.xy.transpose(0, 2, 1)[..., None], {"units": "px"}),
            "confidence": (("time", "keypoints", "individuals"), table.likelihood[..., None], {"units": "1"}),
            "covariance": (("time", "keypoints", "space", "space2"), table.covariance, {"units": "px^2"}),
            "angle": ("time", table.angle_deg, {"units": "degree", "long_name": "bending angle"}),
            "angle_sd": (
                "time",
                table.angle_sd_deg,
                {"units": "degree", "long_name": "standard deviation of the bending angle"},
            ),
            "flag": (
                "time",
                table.flag.astype(object),
                {"long_name": "why a row is missing or to be doubted"},
            ),
        },
        coords={
            "time": ("time", table.time_s, {"units": "s"}),
            "space": ["x", "y"],
            "keypoints": list(table.keypoints),
            "individuals": [INDIVIDUAL],
        },
        attrs=attributes,
    )


def from_dataset(dataset: xarray.Dataset) -> AngleTable:
    """Read an angle table from a dataset that `to_dataset` made, also when it went through movement.

    Parameters
    ----------
    dataset : xarray.Dataset
        With `position`, `confidence`, `angle`, `angle_sd` and `flag`; a `covariance` that is missing is NaN.

    Returns
    -------
    AngleTable
        Equal to the one that the dataset came from, as far as nothing in it was changed.

    Raises
    ------
    ResultsError
        A variable is missing, or there is more than one individual.
    """
    missing = [n for n in ("position", "confidence", "angle", "angle_sd", "flag") if n not in dataset]
    if missing:
        raise ResultsError(
            f"expected a dataset from AngleTable.to_xarray(), got one without {', '.join(missing)}"
        )
    if dataset.sizes.get("individuals", 1) != 1:
        raise ResultsError(f"expected a dataset of one individual, got {dataset.sizes['individuals']}")
    position = (
        dataset["position"].transpose("time", "keypoints", "space", "individuals").sel(space=["x", "y"])
    )
    t, k = position.sizes["time"], position.sizes["keypoints"]
    covariance = np.full((t, k, 2, 2), np.nan)
    if "covariance" in dataset:
        covariance = dataset["covariance"].transpose("time", "keypoints", "space", "space2").to_numpy()
    try:
        fields = json.loads(dataset.attrs.get("definition", "null"))
        definition = None if fields is None else AngleDefinition(**fields)
    except (ValueError, TypeError, AngleError) as error:
        raise ResultsError(
            f"expected an angle definition in the dataset's attributes, got {error}"
        ) from error
    return AngleTable(
        time_s=dataset["time"].to_numpy().astype(float),
        angle_deg=dataset["angle"].to_numpy(),
        angle_sd_deg=dataset["angle_sd"].to_numpy(),
        flag=dataset["flag"].to_numpy(),
        xy=position.to_numpy()[..., 0],
        likelihood=dataset["confidence"].transpose("time", "keypoints", "individuals").to_numpy()[..., 0],
        covariance=covariance,
        keypoints=tuple(str(name) for name in dataset["keypoints"].to_numpy()),
        definition=definition,
        provenance=json.loads(dataset.attrs.get("provenance", "{}")),
    )


def constant_rate(time_s: FloatArray) -> float | None:
    """Give the rate of evenly spaced frames.

    Parameters
    ----------
    time_s : (T,) float
        Seconds, rising.

    Returns
    -------
    float or None
        Frames/s; None where intervals differ, or there are fewer than two frames.

    Examples
    --------
    >>> constant_rate(np.array([0.0, 0.5, 1.0])), constant_rate(np.array([0.0, 0.5, 2.0]))
    (2.0, None)
    """
    if len(time_s) < 2:
        return None
    steps = np.diff(time_s)
    usual = float(np.median(steps))
    if usual <= 0 or float(np.abs(steps - usual).max()) > CONSTANT_RATE_TOLERANCE * usual:
        return None
    return (len(time_s) - 1) / float(time_s[-1] - time_s[0])
