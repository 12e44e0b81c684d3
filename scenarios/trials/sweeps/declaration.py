"""What a sweep of a loop declares, its file (pydantic), and the way from one to the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from scenarios.files.declarations import checked
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT
from scenarios.studies.schema import Quantity, positive, si
from sim.errors import DeclarationError

MOST_SAMPLES = 200_000  # of all flights together


@dataclass(frozen=True)
class RollLoop:
    """The roll axis of a small aircraft under a sampled rate law.

    p_dot = gain command(t - delay) - inv_T_roll p; returned = proportional p + integral (integral
    of p).

    Attributes
    ----------
    gain : rad/s2 of a full command. inv_T_roll : 1/s. delay : s, of servo and computer.
    proportional, integral : command per rad/s, per rad. rate : frames a second.
    """

    gain: float
    inv_T_roll: float
    delay: float
    proportional: float
    integral: float
    rate: float


@dataclass(frozen=True)
class SweepScenario:
    """A named sweep.

    Attributes
    ----------
    loop : the roll axis of a small aircraft; None where ``airframe`` of the X-29-like aircraft
    flies. amplitude : of the excitation, in the unit of the command. low, high : Hz. duration : s.
    flights :
        how many are pooled. gyro : rad/s, rough_air : rad/s2, standard deviations.
    form : of the transfer function that is fitted, empty for none. band : Hz, of the estimate.
    """

    name: str
    title: str
    about: str
    distance: str
    loop: RollLoop | None
    airframe: str
    amplitude: float
    low: float
    high: float
    duration: float
    flights: int
    gyro: float
    rough_air: float
    form: str
    band: tuple[float, float]
    seed: int


class _Roll(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT

    gain: Quantity
    inv_T_roll: Quantity
    delay: Quantity
    proportional: float = Field(gt=0)
    integral: float = Field(ge=0)
    rate: Quantity


class _Excitation(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT

    amplitude: float = Field(gt=0)
    low: Quantity
    high: Quantity
    duration: Quantity
    flights: int = Field(default=1, ge=1, le=20)


class _Noise(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT

    gyro: Quantity = 0.0
    rough_air: Quantity = 0.0


class _Sweep(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT

    schema_: Literal["flightid/scenario/1"] = Field(alias="schema")
    kind: Literal["sweep"]
    title: Annotated[str, Field(min_length=1)]
    about: str = ""
    distance: Literal["same equations, finer step", "no model"]
    seed: int = Field(default=1, ge=0)
    airframe: Literal["P", "S", "F", "D", "R"] | None = None
    loop: _Roll | None = None
    sweep: _Excitation
    noise: _Noise = _Noise()
    form: str = ""
    band: Annotated[list[Quantity], Field(min_length=2, max_length=2)]


def sweep_scenario_of(document: Mapping[str, Any], name: str, where: str) -> SweepScenario:
    """A SweepScenario from the content of its file; ``where`` names the file in messages.

    Raises
    ------
    DeclarationError : an unknown or missing key, a value or unit that is wrong: one line with file
    and key.
    """
    content = checked(_Sweep, document, where)
    if (content.airframe is None) == (content.loop is None):
        remedy = "give the table [loop], or airframe of the X-29-like aircraft"
        raise DeclarationError("one of loop and airframe is due", where=where, remedy=remedy)
    if content.airframe is not None and content.form:
        what = "the airframe is behind its sensors and the law, which no form describes"
        raise DeclarationError(what, where=f"{where}, key form", remedy="leave form out")
    hertz = {"hz": "1/s"}

    def number(value: Quantity, unit: str, key: str) -> float:
        return positive(si(value, unit, f"{where}, key {key}", hertz), f"{where}, key {key}")

    def spread(value: Quantity, unit: str, key: str) -> float:
        found = si(value, unit, f"{where}, key {key}")
        return found if found == 0.0 else positive(found, f"{where}, key {key}")

    loop = None
    if content.loop is not None:
        r = content.loop
        loop = RollLoop(
            number(r.gain, "rad/s2", "loop.gain"),
            number(r.inv_T_roll, "1/s", "loop.inv_T_roll"),
            number(r.delay, "s", "loop.delay"),
            r.proportional,
            r.integral,
            number(r.rate, "1/s", "loop.rate"),
        )
    low, high = (
        number(content.sweep.low, "1/s", "sweep.low"),
        number(content.sweep.high, "1/s", "sweep.high"),
    )
    duration = number(content.sweep.duration, "s", "sweep.duration")
    rate = loop.rate if loop is not None else 80.0
    if not low < high < 0.4 * rate:
        what = f"a sweep from {low:g} to {high:g} Hz at {rate:g} Hz"
        raise DeclarationError(
            what,
            where=f"{where}, key sweep",
            remedy=f"give low below high, and that below {0.4 * rate:g} Hz",
        )
    if duration * rate * content.sweep.flights > MOST_SAMPLES or duration < 5.0 / low:
        what = f"{content.sweep.flights} flights of {duration:g} s"
        remedy = (
            f"give {5.0 / low:g} s or more, five periods of the lowest, and {MOST_SAMPLES} samples "
            "in all at most"
        )
        raise DeclarationError(what, where=f"{where}, key sweep.duration", remedy=remedy)
    band = (number(content.band[0], "1/s", "band"), number(content.band[1], "1/s", "band"))
    return SweepScenario(
        name,
        content.title,
        " ".join(content.about.split()),
        content.distance,
        loop,
        content.airframe or "",
        content.sweep.amplitude,
        low,
        high,
        duration,
        content.sweep.flights,
        spread(content.noise.gyro, "rad/s", "noise.gyro"),
        spread(content.noise.rough_air, "rad/s2", "noise.rough_air"),
        content.form,
        band,
        content.seed,
    )
