"""The pydantic schema of a channel map; imported only when one is read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model
from pydantic_core import PydanticCustomError

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True)


class ColumnEntry(BaseModel):
    """``{column = "AoA1", unit = "deg"}``."""

    model_config = STRICT
    column: Annotated[str, Field(min_length=1)]
    unit: str | None = None


def _table(value: object) -> object:
    if isinstance(value, str):
        return {"column": value}
    if not isinstance(value, dict):
        context = {"what": f"{value!r} names no column", "remedy": 'write {column = "HEADER", unit = "UNIT"}'}
        raise PydanticCustomError("channel", "not a column", context)
    return value


_Entry = Annotated[ColumnEntry | None, BeforeValidator(_table)]


def channel_map(known: Sequence[str]) -> type[BaseModel]:
    """The schema of a map of these channels, each behind an alias: an own model may use names that pydantic needs for itself."""
    fields: dict[str, Any] = {f"channel_{place}": (_Entry, Field(None, alias=name)) for place, name in enumerate(known)}
    return create_model("ChannelMap", __config__=STRICT, **fields)
