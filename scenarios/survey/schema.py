"""The schema of a survey's file (pydantic); imported only when one is read."""

from __future__ import annotations

import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, Field, StringConstraints

from scenarios.files.vehicles_schema import STRICT
from scenarios.preparation.maneuver_schema import Name, Number

FOLDER_NAME = r"^[A-Za-z0-9][A-Za-z0-9._+-]*$"  # a flight's results have a folder of its name


def _day(value: object) -> object:
    return value.isoformat() if isinstance(value, datetime.date | datetime.datetime) else value


class Reading(BaseModel):
    """How records are read; in a flight's table it takes the place of what stands above."""

    model_config = STRICT
    channels: Name | None = None
    columns: Name | Annotated[list[Name], Field(min_length=1)] | None = None
    from_: Number | None = Field(None, alias="from")
    to: Number | None = None
    maneuver: int | Name | Annotated[list[int | Name], Field(min_length=1)] | None = None
    maneuvers: Name | None = None
    hold: Literal["previous", "linear"] | None = None
    rate: Annotated[float, Field(gt=0)] | None = None
    lowpass: Annotated[float, Field(gt=0)] | None = None


class FlightEntry(Reading):
    """One flight."""

    name: Annotated[str, StringConstraints(pattern=FOLDER_NAME)] | None = None
    record: Name | None = None
    records: Annotated[list[Name], Field(min_length=1)] | None = None
    vehicle: dict[str, Any] = {}
    condition: dict[str, float | str] = {}
    date: Annotated[str | None, BeforeValidator(_day)] = None
    tail: Name | None = None


class SurveyEntry(Reading):
    """The whole file."""

    title: Name | None = None
    model: Name
    vehicle: Name | None = None
    effort: Literal["normal", "thorough"] = "normal"
    effects: Name | None = None
    records: Name | Annotated[list[Name], Field(min_length=1)] | None = None
    flights: list[FlightEntry] = []
