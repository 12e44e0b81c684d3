"""The schema of flights by JSBSim (pydantic), and the way from a checked file to a JsbsimFlight;
imported only when one is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from scenarios.files.declarations import checked, closest
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT
from scenarios.studies.schema import Quantity, positive, si
from scenarios.trials.jsbsim.declaration import (
    CONDITIONS,
    CONTROLS,
    DURATIONS,
    MANEUVERS,
    OUTPUTS,
    SURFACES,
    JsbsimFlight,
    refuse_unknown_aircraft,
)
from sim.errors import DeclarationError

SHORTEST = 8.0  # s
FASTEST = 400.0  # Hz


class _Jsbsim(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT

    schema_: Literal["flightid/scenario/1"] = Field(alias="schema")
    kind: Literal["jsbsim"]
    title: Annotated[str, Field(min_length=1)]
    about: str = ""
    seed: int = Field(default=1, ge=0)
    aircraft: Annotated[str, Field(min_length=1)] | int  # there is a 737
    altitude: Quantity | None = None
    airspeed: Quantity | None = None
    axis: str
    maneuver: str = "3-2-1-1"
    size: Annotated[float, Field(gt=0, le=5)] = 1.0
    duration: Quantity | None = None
    rate: Quantity = 50.0
    noise: Annotated[float, Field(ge=0)] = 1.0
    noise_std: dict[str, Quantity] = {}
    rough_air: Annotated[int, Field(ge=0, le=7)] = 0
    wrong: Annotated[float, Field(ge=0, lt=1)] = 0.3
    late: dict[str, Quantity] = {}
    backlash: dict[str, Quantity] = {}
    vane_ahead: Quantity = 0.0


def jsbsim_of(document: Mapping[str, Any], name: str, where: str) -> JsbsimFlight:
    """A JsbsimFlight from the content of its file; ``where`` names the file in messages.

    Raises
    ------
    DeclarationError : an unknown or missing key, name, unit or value, JSBSim not installed: one
        line with file and key.
    """
    content = checked(_Jsbsim, document, where)
    aircraft = str(content.aircraft)
    refuse_unknown_aircraft(aircraft, f"{where}, key aircraft")
    _one_of(content.axis, tuple(CONTROLS), "axis", where)
    _one_of(content.maneuver, MANEUVERS, "maneuver", where)
    duration = (
        DURATIONS[content.axis]
        if content.duration is None
        else si(content.duration, "s", f"{where}, key duration")
    )
    if not duration >= SHORTEST:
        raise DeclarationError(
            f"{duration:g} s hold no maneuver",
            where=f"{where}, key duration",
            remedy=f"give {SHORTEST:g} s or more",
        )
    rate = positive(
        si(content.rate, "1/s", f"{where}, key rate", {"hz": "1/s"}), f"{where}, key rate"
    )
    if rate > FASTEST:
        raise DeclarationError(
            f"{rate:g} samples a second",
            where=f"{where}, key rate",
            remedy=f"give {FASTEST:g} Hz or less",
        )
    altitude, airspeed = _condition(content, where)
    return JsbsimFlight(
        name,
        content.title,
        " ".join(content.about.split()),
        aircraft,
        altitude,
        airspeed,
        content.axis,
        content.maneuver,
        content.size,
        duration,
        rate,
        content.noise,
        _by_channel(content.noise_std, tuple(OUTPUTS), OUTPUTS, where, "noise_std"),
        content.rough_air,
        content.wrong,
        _by_channel(
            content.late,
            (*SURFACES, *OUTPUTS),
            dict.fromkeys((*SURFACES, *OUTPUTS), "s"),
            where,
            "late",
        ),
        _by_channel(content.backlash, SURFACES, dict.fromkeys(SURFACES, "rad"), where, "backlash"),
        si(content.vane_ahead, "m", f"{where}, key vane_ahead"),
        content.seed,
    )


def _condition(content: _Jsbsim, where: str) -> tuple[float, float]:
    """Altitude and airspeed as given, else those of the aircraft."""
    own = CONDITIONS.get(str(content.aircraft))
    result = []
    for place, (key, unit, value) in enumerate(
        (("altitude", "m", content.altitude), ("airspeed", "m/s", content.airspeed))
    ):
        if value is None and own is None:
            what = f"no usual {key} is known of {content.aircraft}"
            raise DeclarationError(
                what,
                where=f"{where}, key {key}",
                remedy=f"give it, or an aircraft of {', '.join(CONDITIONS)}",
            )
        result.append(
            si(value, unit, f"{where}, key {key}")
            if value is not None
            else own[place]
            if own
            else 0.0
        )
    return result[0], positive(result[1], f"{where}, key airspeed")


def _one_of(name: str, allowed: tuple[str, ...], what: str, where: str) -> None:
    if name not in allowed:
        raise DeclarationError(
            f"there is no {what} {name!r}",
            where=f"{where}, key {what}",
            remedy=closest(name, allowed),
        )


def _by_channel(
    given: Mapping[str, Quantity],
    allowed: tuple[str, ...],
    units: Mapping[str, str],
    where: str,
    key: str,
) -> dict[str, float]:
    for name in given:
        if name not in allowed:
            raise DeclarationError(
                f"there is no channel {name!r} here",
                where=f"{where}, key {key}",
                remedy=closest(name, allowed),
            )
    return {
        name: positive(
            si(value, units[name], f"{where}, key {key}.{name}"), f"{where}, key {key}.{name}"
        )
        for name, value in given.items()
    }
