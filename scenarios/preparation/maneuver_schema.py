"""The schema of ``maneuvers.toml`` (pydantic); imported only when one is read."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field, StringConstraints

from scenarios.files.vehicles_schema import STRICT

Name = Annotated[str, StringConstraints(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False)]


class PartEntry(BaseModel):
    """A part of the record."""

    model_config = STRICT
    number: Annotated[int, Field(ge=1)] | None = None
    name: Name | None = None
    from_: Number = Field(alias="from")
    to: Number
    axis: str | None = None
    kind: str | None = None


class FileEntry(BaseModel):
    """The whole file."""

    model_config = STRICT
    record: Name | None = None
    sha256: Name | None = None
    maneuvers: list[PartEntry] = []
