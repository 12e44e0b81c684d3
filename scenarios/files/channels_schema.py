"""The pydantic schema of a channel map; imported only when one is read."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model, model_validator
from pydantic_core import PydanticCustomError

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True)
ABSENT = "\0"  # the column of a channel that a map declares as not there, which no header can be


_Number = Annotated[float, Field(allow_inf_nan=False)]
_Text = Annotated[str, Field(min_length=1, max_length=500)]


class ColumnEntry(BaseModel):
    """``{column = "AoA1", unit = "deg"}`` and what may be computed from a column or a sum of columns."""

    model_config = STRICT
    column: _Text | Annotated[int, Field(ge=1)] | None = None
    sum: Annotated[list[_Text], Field(min_length=1, max_length=20)] | None = None
    unit: str | None = None
    scale: _Number = 1.0
    offset: _Number = 0.0
    bias: _Number | None = None
    sign: Literal[1, -1] = 1
    delay: _Number = 0.0
    table: Annotated[list[list[_Number]], Field(min_length=2, max_length=2)] | None = None
    hold: Literal["previous", "linear"] | None = None

    @model_validator(mode="after")
    def _sound(self) -> ColumnEntry:
        if (self.column is None) == (self.sum is None):
            context = {"what": "neither column nor sum, or both", "remedy": 'write column = "HEADER", or sum = ["HEADER", "HEADER"]'}
            raise PydanticCustomError("channel", "not a column", context)
        if self.table is not None and (len(self.table[0]) != len(self.table[1]) or len(self.table[0]) < 2 or not _increasing(self.table[0])):
            context = {"what": "table is no calibration", "remedy": "write [[x1, x2, ...], [y1, y2, ...]] of one length, x increasing"}
            raise PydanticCustomError("channel", "not a table", context)
        return self


def _increasing(values: Sequence[float]) -> bool:
    return all(later > earlier for earlier, later in pairwise(values))


def _table(value: object) -> object:
    if value is False:
        return {"column": ABSENT}
    if isinstance(value, str | int) and not isinstance(value, bool):
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
