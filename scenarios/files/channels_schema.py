"""The pydantic schema of a channel map; imported only when one is read."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model
from pydantic_core import PydanticCustomError

from scenarios.files.channel_names import CHANNEL_UNITS

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

ChannelMap = create_model("ChannelMap", __config__=STRICT, **{name: (_Entry, None) for name in CHANNEL_UNITS})  # type: ignore[call-overload]
