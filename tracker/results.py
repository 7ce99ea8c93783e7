"""The angle table: its contents, and how it is written (CSV, HDF5, JSON) and read back.

The numbers are computed in `tracking.py`; `bookkeeping.py` finds out whether files on disk are up to date;
`figures.py` and `overlay.py` draw them.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .angle import AngleDefinition
from .atomic import atomic_path, atomic_write_bytes, atomic_write_text
from .csv_tables import read_csv_table, spreadsheet_cell, spreadsheet_text
from .errors import AngleError, ResultsError, UnwritableResultsError, reason
from .hashing import file_sha256
from .hdf5_files import open_hdf5
from .json_files import load_json, parse_json
from .links import make_folder
from .types import FloatArray

if TYPE_CHECKING:
    from datetime import datetime

    import xarray

# Raised when the files' layout changes, so that older results count as out of date.
FORMAT = 1

_UNITS = {
    "time_s": "s",
    "angle_deg": "degree",
    "angle_sd_deg": "degree",
    "xy": "px",
    "likelihood": "1",
    "covariance": "px^2",
}
# Decimals in the CSV: finer than any camera, label or clock; the HDF5 holds the full numbers.
_DECIMALS = {"time_s": 6, "angle_deg": 4, "angle_sd_deg": 4, "x": 3, "y": 3, "likelihood": 4}

# Characters of a flag and of a keypoint's name, which every row of an array in memory makes room for.
MAX_FLAG_CHARS = 64
_MAX_NAME_CHARS = 200


@dataclass(frozen=True)
class AngleTable:
    """Bending angle over time, one row for every frame of a video.

    Attributes
    ----------
    time_s : ndarray of float
        (T,) seconds from the first frame.
    angle_deg, angle_sd_deg : ndarray of float
        (T,) degrees, NaN where unknown.
    flag : ndarray of str
        (T,) values of `types.Flag`; "" is a sound row.
    xy : ndarray of float
        (T, K, 2) px of the full frame.
    likelihood : ndarray of float
        (T, K) in [0, 1].
    covariance : ndarray of float
        (T, K, 2, 2) px^2.
    keypoints : tuple of str
        K names.
    definition : AngleDefinition or None
        Which angle; None if the file read (a CSV alone) does not say.
    provenance : dict of str to Any
        JSON-ready: versions, video, detector, settings, warnings.
    """

    time_s: FloatArray
    angle_deg: FloatArray
    angle_sd_deg: FloatArray
    flag: NDArray[np.str_]
    xy: FloatArray
    likelihood: FloatArray
    covariance: FloatArray
    keypoints: tuple[str, ...]
    definition: AngleDefinition | None
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "flag", np.asarray([str(flag) for flag in self.flag], dtype=np.str_))
        object.__setattr__(self, "keypoints", tuple(self.keypoints))
        t, k = len(self.time_s), len(self.keypoints)
        expected = {
            "angle_deg": (t,),
            "angle_sd_deg": (t,),
            "flag": (t,),
            "xy": (t, k, 2),
            "likelihood": (t, k),
            "covariance": (t, k, 2, 2),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"expected {name} {shape}, got {getattr(self, name).shape}")

    def __len__(self) -> int:
        return len(self.time_s)

    def to_dataframe(self) -> pd.DataFrame:
        """The CSV's columns: frame, time_s, angle_deg, angle_sd_deg, flag; x, y, likelihood a keypoint."""
        columns: dict[str, Any] = {
            "frame": np.arange(len(self)),
            "time_s": self.time_s,
            "angle_deg": self.angle_deg,
            "angle_sd_deg": self.angle_sd_deg,
            "flag": self.flag.astype(object),
        }
        for k, name in enumerate(self.keypoints):
            columns[f"{name}_x"] = self.xy[:, k, 0]
            columns[f"{name}_y"] = self.xy[:, k, 1]
            columns[f"{name}_likelihood"] = self.likelihood[:, k]
        return pd.DataFrame(columns)

    def to_xarray(self) -> xarray.Dataset:
        """Give the table as a dataset with movement's dimensions for poses, and the angle on time.

        Returns
        -------
        xarray.Dataset
            `position` (time, space, keypoints, individuals) px, `confidence`, `angle` and `angle_sd` (time) degrees,
            `flag` (time); see `xarray_dataset.to_dataset`.

        Raises
        ------
        MissingPackageError
            xarray is not installed (``.venv/bin/pip install '.[xarray]'`` in the copy
            of the repository).

        Examples
        --------
        >>> dataset = read_results("results/a.h5").to_xarray()  # doctest: +SKIP
        >>> dataset.angle.sel(time=slice(0, 10)).max()  # doctest: +SKIP
        """
        from .xarray_dataset import to_dataset

        return to_dataset(self)

    @staticmethod
    def from_xarray(dataset: xarray.Dataset) -> AngleTable:
        """Read a table back from what `to_xarray` gave.

        Parameters
        ----------
        dataset : xarray.Dataset
            As `to_xarray` gives it, also when it went through movement.

        Returns
        -------
        AngleTable
            The same table.

        Raises
        ------
        ResultsError
            A variable is missing, or there is more than one individual.
        """
        from .xarray_dataset import from_dataset

        return from_dataset(dataset)

    def to_nwb(self, path: str | Path, *, session_start: datetime | None = None) -> Path:
        """Write the table as a file of Neurodata Without Borders, every time the frame's own timestamp.

        Parameters
        ----------
        path : str or Path
            The .nwb file.
        session_start : datetime.datetime or None
            When the video began, with a time zone; None takes the time of writing.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        MissingPackageError
            pynwb or ndx-pose is not installed (``.venv/bin/pip install '.[nwb]'`` in the
            copy of the repository).
        ResultsError
            The file cannot be written.
        """
        from .nwb_file import write_nwb

        return write_nwb(self, path, session_start=session_start)


def write_results(table: AngleTable, out_dir: str | Path, stem: str) -> tuple[Path, Path, Path]:
    """Write `<stem>.h5`, `<stem>.csv` and `<stem>.json`, each whole or not at all.

    The JSON comes last and holds the hashes of the other two, so after a kill at any moment it either
    matches them, or `bookkeeping.is_up_to_date` returns False. The HDF5 comes first: it records whose results
    these are.

    Parameters
    ----------
    table : AngleTable
        The table to write.
    out_dir : str or Path
        Folder, made with its parents.
    stem : str
        Name of the files, without suffix.

    Returns
    -------
    csv_path, h5_path, json_path : Path
        The files written.

    Raises
    ------
    ResultsError
        The files cannot be written.
    """
    folder = Path(out_dir)
    csv_path, h5_path, json_path = (folder / f"{stem}{suffix}" for suffix in (".csv", ".h5", ".json"))
    try:
        make_folder(folder)
        atomic_write_bytes(h5_path, _h5_bytes(table))
        with atomic_path(csv_path) as temporary:
            _write_csv(table, temporary)
        record = {
            "bendtrack": None,
            **json_ready(table.provenance),
            "format": FORMAT,
            "keypoints": list(table.keypoints),
            "definition": json_ready(_definition_fields(table)),
            "files": {path.suffix[1:]: file_sha256(path) for path in (csv_path, h5_path)},
        }
        atomic_write_text(json_path, json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
    except OSError as error:
        raise UnwritableResultsError(
            f"{folder / stem}.*: results cannot be written ({reason(error)})"
        ) from error
    return csv_path, h5_path, json_path


def read_results(path: str | Path) -> AngleTable:
    """Read an angle table from its .h5 (exact), its .csv, or its .json (the .h5 or else the .csv next to it).

    A CSV holds no covariances: they are NaN. Definition and provenance come from the JSON next to it
    where its hash of the CSV matches, else they are None and empty.

    Parameters
    ----------
    path : str or Path
        The .h5, .csv or .json of a table.

    Returns
    -------
    AngleTable
        The table.

    Raises
    ------
    ResultsError
        The file is missing, malformed or not an angle table.
    """
    path = Path(path)
    if not path.is_file():
        raise ResultsError(f"{path}: no such results file")
    if path.suffix == ".h5":
        return _read_h5(path)
    if path.suffix == ".csv":
        return _read_csv(path)
    if path.suffix == ".json":
        read_record(path)
        for reader, table in ((_read_h5, path.with_suffix(".h5")), (_read_csv, path.with_suffix(".csv"))):
            if table.is_file():
                return reader(table)
        raise ResultsError(f"{path}: expected its .h5 or .csv next to it, found neither")
    raise ResultsError(f"{path}: expected results in .csv, .h5 or .json, got '{path.suffix}'")


def read_record(path: Path) -> dict[str, Any]:
    """The JSON record of a table, unchanged.

    Parameters
    ----------
    path : Path
        The .json of a table.

    Returns
    -------
    dict of str to Any
        Contents of the file.

    Raises
    ------
    ResultsError
        The file cannot be read or was not written by bendtrack.
    """
    try:
        record = load_json(path)
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path}: cannot be read as JSON ({reason(error)})") from error
    if not isinstance(record, dict) or "bendtrack" not in record:
        raise ResultsError(f"{path}: expected bendtrack's results record, got other JSON")
    return record


def json_ready(value: Any) -> Any:
    """Plain JSON values: tuples as lists, numpy scalars as numbers, NaN and infinities as null.

    Parameters
    ----------
    value : Any
        Nested mappings, sequences, arrays, numbers, strings and paths.

    Returns
    -------
    Any
        Nested dicts and lists of JSON values.
    """
    if isinstance(value, Mapping):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [json_ready(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, str | Path) else value


def _definition_fields(table: AngleTable) -> dict[str, Any] | None:
    return None if table.definition is None else asdict(table.definition)


def _write_csv(table: AngleTable, path: Path) -> None:
    frame = table.to_dataframe()
    for column in frame.columns:
        decimals = _DECIMALS.get(column, _DECIMALS.get(column.rpartition("_")[2]))
        if decimals is not None:
            values = np.round(frame[column].to_numpy(dtype=float), decimals) + 0.0  # no "-0.000"
            frame[column] = np.where(np.isnan(values), "", np.char.mod(f"%.{decimals}f", values))
    frame.columns = [spreadsheet_cell(column) for column in frame.columns]
    frame.to_csv(path, index=False, lineterminator="\n")


def _read_csv(path: Path) -> AngleTable:
    try:
        frame = read_csv_table(path)
    except (OSError, ValueError, OverflowError) as error:
        raise ResultsError(f"{path}: cannot be read as a CSV ({reason(error)})") from error
    expected = ["frame", "time_s", "angle_deg", "angle_sd_deg", "flag"]
    frame.columns = [spreadsheet_text(str(column)) for column in frame.columns]
    points = list(frame.columns[len(expected) :])
    keypoints = tuple(column.removesuffix("_x") for column in points[::3])
    wanted = [f"{name}_{part}" for name in keypoints for part in ("x", "y", "likelihood")]
    if list(frame.columns[: len(expected)]) != expected or points != wanted:
        raise ResultsError(
            f"{path}: expected columns {','.join(expected)},<keypoint>_x,<keypoint>_y,<keypoint>_likelihood "
            f"got {','.join(frame.columns)[:200]}"
        )
    if not np.array_equal(frame["frame"], np.arange(len(frame))):
        raise ResultsError(f"{path}: expected the rows of frames 0 to {len(frame) - 1} in order")
    try:
        numbers = frame.drop(columns=["frame", "flag"]).astype(float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ResultsError(f"{path}: expected numbers or empty cells ({reason(error)})") from error
    values = numbers[wanted].to_numpy().reshape(len(frame), len(keypoints), 3)
    definition, provenance = _recorded_definition(path)
    return AngleTable(
        time_s=numbers["time_s"].to_numpy(),
        angle_deg=numbers["angle_deg"].to_numpy(),
        angle_sd_deg=numbers["angle_sd_deg"].to_numpy(),
        flag=_flags(path, frame["flag"]),
        xy=values[:, :, :2].copy(),
        likelihood=values[:, :, 2].copy(),
        covariance=np.full((len(frame), len(keypoints), 2, 2), np.nan),
        keypoints=keypoints,
        definition=definition,
        provenance=provenance,
    )


def _flags(path: Path, column: pd.Series) -> NDArray[np.str_]:
    """Flags of an array that is as wide as the longest of them."""
    flags = [
        spreadsheet_text(str(flag)) if known else ""
        for flag, known in zip(column, column.notna(), strict=True)
    ]
    longest = max(map(len, flags), default=0)
    if longest > MAX_FLAG_CHARS:
        raise ResultsError(f"{path}: expected flags of at most {MAX_FLAG_CHARS} characters, got {longest}")
    return np.array(flags, dtype=np.str_)


def _recorded_definition(csv_path: Path) -> tuple[AngleDefinition | None, dict[str, Any]]:
    try:
        record = read_record(csv_path.with_suffix(".json"))
    except ResultsError:
        return None, {}
    files = record.get("files")
    if not isinstance(files, dict) or files.get("csv") != file_sha256(csv_path):
        return None, {}
    added = ("format", "keypoints", "definition", "files")
    provenance = {key: value for key, value in record.items() if key not in added}
    return _definition(csv_path, record.get("definition")), _checked_provenance(csv_path, provenance)


def _checked_provenance(path: Path, provenance: Any) -> dict[str, Any]:
    """The provenance, in which others look up the video and the warnings."""
    sound = (
        isinstance(provenance, dict)
        and isinstance(provenance.get("video", {}), dict)
        and isinstance(warnings := provenance.get("warnings", []), list)
        and all(isinstance(warning, str) for warning in warnings)
    )
    if not sound:
        raise ResultsError(f"{path}: expected bendtrack's provenance, got {str(provenance)[:60]}")
    return dict(provenance)


def _definition(path: Path, fields: Any) -> AngleDefinition | None:
    try:
        return None if fields is None else AngleDefinition(**fields)
    except (TypeError, ValueError, AttributeError, AngleError) as error:
        raise ResultsError(f"{path}: its angle definition cannot be read ({reason(error)})") from error


def _h5_bytes(table: AngleTable) -> bytes:
    """The HDF5 file, made in memory: the library crashes at exit when a disk fills up under an open file."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        for name, unit in _UNITS.items():
            values = getattr(table, name)
            file.create_dataset(name, data=values, compression="gzip", shuffle=True).attrs["units"] = unit
        file.create_dataset("flag", data=table.flag.astype(object), dtype=h5py.string_dtype())
        file.create_dataset("keypoints", data=list(table.keypoints), dtype=h5py.string_dtype())
        file["xy"].attrs["axes"] = (
            "frame, keypoint, (x, y); (0, 0) is the centre of the top-left pixel, y down"
        )
        file["covariance"].attrs["axes"] = "frame, keypoint, (x, y), (x, y)"
        file["likelihood"].attrs["axes"] = "frame, keypoint"
        # As data sets, not attributes: those end at 64 KiB.
        for name, value in (("definition", _definition_fields(table)), ("provenance", table.provenance)):
            text = json.dumps(json_ready(value), ensure_ascii=False, allow_nan=False)
            file.create_dataset(name, data=text, dtype=h5py.string_dtype())
        file.attrs["format"] = FORMAT
    return buffer.getvalue()


def _read_h5(path: Path) -> AngleTable:
    with open_hdf5(path, ResultsError, "bendtrack's HDF5") as file:
        arrays: dict[str, Any] = {name: _floats(name, file.array(file.root, name)) for name in _UNITS}
        flag = file.texts(file.root, "flag", MAX_FLAG_CHARS)
        keypoints = tuple(file.texts(file.root, "keypoints", _MAX_NAME_CHARS))
        fields = parse_json(file.text(file.root, "definition"))
        provenance = parse_json(file.text(file.root, "provenance"))
        table = AngleTable(**arrays, flag=np.array(flag, dtype=np.str_), keypoints=keypoints, definition=None)
    return replace(
        table, definition=_definition(path, fields), provenance=_checked_provenance(path, provenance)
    )


def _floats(name: str, values: np.ndarray) -> FloatArray:
    if values.dtype.kind not in "fiu":
        raise ValueError(f"expected numbers as '{name}', got {values.dtype}")
    return values.astype(np.float64, copy=False)
