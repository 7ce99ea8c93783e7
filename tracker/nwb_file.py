"""An angle table as a file of Neurodata Without Borders: poses by its extension ndx-pose, the angle as time series.

All times are the frames' own timestamps, never a rate: cameras drop frames. Knows nothing of how tables come about.
"""

from __future__ import annotations

import datetime
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from .atomic import atomic_write_bytes, remove_leftovers
from .errors import ResultsError, reason
from .extras import install_command, needed
from .results import AngleTable

_ORIGIN = "(0, 0) is the centre of the top-left pixel of the frame as displayed; x to the right, y down"


def write_nwb(table: AngleTable, path: str | Path, *, session_start: datetime.datetime | None = None) -> Path:
    """Write an angle table as an .nwb file.

    Parameters
    ----------
    table : AngleTable
        T rows, K keypoints.
    path : str or Path
        The file; written whole or not at all.
    session_start : datetime.datetime or None
        When the video began, with a time zone. Tables do not know it; None takes the time of writing.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MissingPackageError
        pynwb or ndx-pose is not installed.
    ResultsError
        The file cannot be written.
    """
    with needed("AngleTable.to_nwb()", ("pynwb", "ndx_pose", "hdmf"), install_command("nwb")):
        from ndx_pose import PoseEstimation, PoseEstimationSeries, Skeleton, Skeletons
        from pynwb import NWBHDF5IO, NWBFile, TimeSeries

    video = str(table.provenance.get("video", {}).get("name", "a video"))
    file = NWBFile(
        session_description=f"Bending angle of a soft actuator in {video}",
        identifier=str(table.provenance.get("video", {}).get("sha256", video)),
        session_start_time=session_start or datetime.datetime.now(datetime.UTC),
    )
    skeleton = Skeleton(
        name="actuator",
        nodes=list(table.keypoints),
        edges=np.array([[i, i + 1] for i in range(len(table.keypoints) - 1)], dtype=np.uint8).reshape(-1, 2),
    )
    series = [
        PoseEstimationSeries(
            name=name,
            data=table.xy[:, k],
            unit="pixels",
            reference_frame=_ORIGIN,
            timestamps=table.time_s,
            confidence=table.likelihood[:, k],
            confidence_definition="Probability that the keypoint is where it was found",
        )
        for k, name in enumerate(table.keypoints)
    ]
    behavior = file.create_processing_module(name="behavior", description="Keypoints and bending angle")
    behavior.add(Skeletons(skeletons=[skeleton]))
    behavior.add(
        PoseEstimation(
            name="PoseEstimation",
            pose_estimation_series=series,
            description=f"Keypoints of the actuator, found in {video}",
            source_software="bendtrack",
            source_software_version=version("bendtrack"),
            skeleton=skeleton,
        )
    )
    definition: Any = "" if table.definition is None else f" ({table.definition.name})"
    for name, values, words in (
        ("bending_angle", table.angle_deg, f"Bending angle{definition}"),
        ("bending_angle_sd", table.angle_sd_deg, "Standard deviation of the bending angle"),
    ):
        behavior.add(
            TimeSeries(name=name, data=values, unit="degrees", timestamps=table.time_s, description=words)
        )
    out = Path(path)
    try:
        # HDF5 locks what it writes, and wants a file of its own.
        with tempfile.TemporaryDirectory(prefix="bendtrack-nwb-") as folder:
            written = Path(folder) / "table.nwb"
            with NWBHDF5IO(str(written), "w") as io:
                io.write(file)
            remove_leftovers(out.parent, out.stem)
            atomic_write_bytes(out, written.read_bytes())
    except OSError as error:
        raise ResultsError(f"{out}: cannot be written ({reason(error)})") from error
    return out
