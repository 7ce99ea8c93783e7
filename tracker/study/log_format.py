"""User settings for pressure logs: columns, units, rate, gain. Logs are read by `pressure_log.py`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from ..toml_files import Section
from .units import PRESSURE_UNITS, SECONDS_IN, known_unit

ColumnChoice = Annotated[int, Field(ge=1)] | str


class LogFormat(Section):
    """User settings for logs. A setting left out is detected in the file, or the log is refused.

    Attributes
    ----------
    time_column, pressure_column, reference_column, sync_column : int or str or None
        A column's name, or its number from 1.
    time_unit, pressure_unit : str or None
        Unit, where the header has none.
    rate_hz : float or None
        Samples per second, for a log without times.
    gain_kpa_per_v : float or None
        Gain of a sensor whose voltage was logged.
    offset_kpa : float
        Added to the pressure after its unit (and to a reference from the same sensor's scale).
    lag_s : float
        Delay of the logged pressure by a filter before the log; subtracted from its times.
    """

    time_column: ColumnChoice | None = None
    pressure_column: ColumnChoice | None = None
    reference_column: ColumnChoice | None = None
    sync_column: ColumnChoice | None = None
    time_unit: str | None = None
    pressure_unit: str | None = None
    rate_hz: float | None = Field(default=None, gt=0)
    gain_kpa_per_v: float | None = None
    offset_kpa: float = 0.0
    lag_s: float = Field(default=0.0, ge=0)

    @field_validator("time_unit")
    @classmethod
    def _time_unit(cls, value: str | None) -> str | None:
        return _one_of(value, SECONDS_IN, "time")

    @field_validator("pressure_unit")
    @classmethod
    def _pressure_unit(cls, value: str | None) -> str | None:
        return _one_of(value, PRESSURE_UNITS, "pressure")


def _one_of(value: str | None, units: tuple[str, ...] | dict[str, float], what: str) -> str | None:
    unit = None if value is None else known_unit(value)
    if value is not None and unit not in units:
        raise PydanticCustomError(
            "unit",
            "expected a unit of {what} ({units}), got '{value}'",
            {"what": what, "units": ", ".join(units), "value": value},
        )
    return unit
