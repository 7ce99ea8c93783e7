"""Schemas of the request bodies that change something; pydantic validates them."""

from __future__ import annotations

from typing import Annotated
from uuid import UUID

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from .label_table import Point

_Revision = Annotated[int, Field(ge=0, lt=2**53)]
_ClientId = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
_Coordinates = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]
_Points = dict[str, _Coordinates | None]


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    edit_id: UUID
    client_id: _ClientId


class StepRequest(_Request):
    """Body of an undo or a redo."""


class EditRequest(_Request):
    """Body of an edit of a frame; a field that is left out stays as it is."""

    base_revision: _Revision
    points: _Points = Field(default_factory=dict)
    not_visible: list[str] | None = None
    note: Annotated[str, Field(max_length=2000)] | None = None
    flagged: bool | None = None
    skipped: bool | None = None


class RepeatRequest(_Request):
    """Body of a repeat label."""

    points: _Points


def points_from_request(points: _Points) -> dict[str, Point | None]:
    """Convert the points of a request to those of the label store: keypoint -> (x, y) px, None to remove it."""
    return {name: None if xy is None else (float(xy[0]), float(xy[1])) for name, xy in points.items()}
