"""A model's static curve (FEM): pressure and angle, from a text table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import PressureLogError, StudyError
from ..hashing import file_sha256
from ..types import FloatArray
from .csv_log import csv_columns
from .log_columns import pressure_column
from .units import KPA_IN, words_of

_ANGLE_WORDS = {"angle", "angles", "bending", "theta"}


@dataclass(frozen=True)
class ModelCurve:
    """Pressure (S,) kPa and angle (S,) degrees of a model, in the order of the file, and their provenance.

    Attributes
    ----------
    pressure_kpa : ndarray of float
        (S,) kPa.
    angle_deg : ndarray of float
        (S,) degrees.
    provenance : dict of str to Any
        JSON-ready: name, hash and size of the file.
    """

    pressure_kpa: FloatArray
    angle_deg: FloatArray
    provenance: dict[str, Any]


def read_model_curve(path: Path) -> ModelCurve:
    """Read a curve from a text table with a column of pressure (unit in its header) and one of the angle in degrees.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    ModelCurve
        The curve.

    Raises
    ------
    StudyError
        Missing, no such columns, no unit, or fewer than two points.
    """
    if not path.is_file():
        raise StudyError(f"expected a model curve, got no file: {path}")
    try:
        columns, _ = csv_columns(path)
        angles = [column for column in columns if words_of(column.name) & _ANGLE_WORDS]
        if len(angles) != 1:
            raise StudyError(
                f"{path}: expected one column of angles such as angle_deg, got {len(angles)} "
                f"among {', '.join(column.name for column in columns)}"
            )
        pressure = pressure_column([c for c in columns if c not in angles], str(path))
    except PressureLogError as error:
        raise StudyError(str(error)) from error
    if pressure.unit not in KPA_IN:
        raise StudyError(f"{path}: column '{pressure.name}': expected a unit such as pressure_kpa, got none")
    if "rad" in words_of(angles[0].name) or angles[0].unit in ("rad", "radians"):
        raise StudyError(f"{path}: column '{angles[0].name}': expected degrees, got radians")
    known = np.isfinite(pressure.values) & np.isfinite(angles[0].values)
    if known.sum() < 2:
        raise StudyError(f"{path}: expected a curve of two points or more, got {known.sum()}")
    return ModelCurve(
        pressure.values[known] * KPA_IN[pressure.unit],
        angles[0].values[known],
        {"name": path.name, "sha256": file_sha256(path), "points": int(known.sum())},
    )
