"""What a page may send, checked at the door: bodies of the requests that change something."""

from __future__ import annotations

from typing import Annotated
from uuid import UUID

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from .label_table import Point

_Revision = Annotated[int, Field(ge=0, lt=2**53)]
_ClientId = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
_Coordinates = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]
_Points = dict[str, _Coordinates | None]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    edit_id: UUID
    client_id: _ClientId


class StepBody(_Body):
    """Of an undo or a redo."""


class EditBody(_Body):
    """Of a change of a frame; what is left out stays."""

    base_revision: _Revision
    points: _Points = Field(default_factory=dict)
    not_visible: list[str] | None = None
    note: Annotated[str, Field(max_length=2000)] | None = None
    flagged: bool | None = None
    skipped: bool | None = None


class RepeatBody(_Body):
    """Of a repeat label."""

    points: _Points


def points_of(points: _Points) -> dict[str, Point | None]:
    """Points of a body as the label store knows them."""
    return {name: None if xy is None else (float(xy[0]), float(xy[1])) for name, xy in points.items()}
