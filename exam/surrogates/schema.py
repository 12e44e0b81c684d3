"""The schema of surrogate flight scenarios (pydantic), the conversion of a checked file to a
Surrogate, and the declared flights by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from exam.aircraft import AIRCRAFT
from exam.surrogates.declaration import (
    AXES,
    LATERAL,
    LONGITUDINAL,
    Causes,
    FlightLine,
    Hidden,
    Span,
    Surrogate,
)
from exam.surrogates.flights.dominant import OF_AXIS
from exam.surrogates.flights.kinds import SIZES
from exam.surrogates.flights.lateral.drawing import PAIRS
from exam.surrogates.flights.maneuvers import KINDS as MANEUVERS
from exam.surrogates.flights.maneuvers import USUAL
from scenarios.files.declarations import CHANNEL_UNITS, checked, closest
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT
from scenarios.studies.catalogue import load_document
from scenarios.studies.schema import Quantity, positive, si
from sim.errors import DeclarationError

Name = Annotated[str, Field(min_length=1)]
Share = Annotated[float, Field(ge=0, le=1)]
Pair = Annotated[list[Quantity], Field(min_length=2, max_length=2)]
VEHICLES = {
    LONGITUDINAL: (*AIRCRAFT, "bomber_rigid"),
    LATERAL: ("navion_lateral", "dc8_lateral", "boeing747_lateral"),
}
FLOWN = {LONGITUDINAL: tuple(MANEUVERS), LATERAL: tuple(PAIRS)}
FEWEST, MOST = 2, 12


class _Strict(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT


class _Flight(_Strict):
    vehicles: list[Name] = Field(min_length=1)
    variation: Annotated[float, Field(ge=0, lt=0.5)] = 0.2
    records: Annotated[list[int], Field(min_length=2, max_length=2)] = [4, 6]
    duration: Quantity = 25.0
    rates: Annotated[list[Quantity], Field(min_length=1)] = [25.0, 40.0, 50.0]
    maneuvers: Annotated[list[Name], Field(min_length=1)] = list(USUAL)
    amplitude: Pair
    step: Quantity = 0.005
    surface: Quantity = 20.0
    trim_alpha: Pair = [0.0, 0.0]
    total: bool = True
    optional: Share = 0.0
    unrecorded: list[Name] = []
    level: bool = False
    once: Name | None = None
    axis: str = LONGITUDINAL


class _Causes(_Strict):
    anti_alias: Quantity = 0.0
    anti_alias_spread: Share = 0.0
    anti_alias_odd: Share = 0.0
    input_noise: Quantity = 0.0
    turbulence: Quantity = 0.0
    turbulence_length: Quantity = 300.0
    speed_drift: Share = 0.0
    gravity: Share = 0.0
    trim_lift: Share = 0.0
    downwash: Share = 0.0
    downwash_lag: Quantity = 0.1
    elastic: Share = 0.0
    moment_curvature: Share = 0.0
    lift_curvature: Share = 0.0
    mass_scatter: Share = 0.0
    inertia_scatter: Share = 0.0
    airspeed_scatter: Share = 0.0
    density_scatter: Share = 0.0
    trim_scatter: Quantity = 0.0
    noise_std: dict[str, Quantity] = {}
    noise_time: Quantity = 0.05


class _Hidden(_Strict):
    count: int = Field(default=0, ge=0, le=3)
    names: list[Name] = []
    reduction: Annotated[list[float], Field(min_length=2, max_length=2)] = [0.45, 0.65]
    sizes: dict[str, Pair] = {}


class _Estimate(_Strict):
    wrong: Annotated[list[float], Field(min_length=2, max_length=2)] = [0.05, 0.3]
    draws: int = Field(default=20, ge=0)


class _Surrogate(_Strict):
    schema_: Literal["flightid/scenario/1"] = Field(alias="schema")
    kind: Literal["surrogate"]
    title: Name
    about: str = ""
    seed: int = Field(default=1, ge=0)
    flight: _Flight
    causes: _Causes = _Causes()
    hidden: _Hidden = _Hidden()
    estimate: _Estimate = _Estimate()


# SI units of the levels that have one; the others are shares.
CAUSE_UNITS = {
    "anti_alias": "1/s",
    "input_noise": "rad",
    "turbulence": "m/s",
    "turbulence_length": "m",
    "downwash_lag": "s",
    "trim_scatter": "rad",
    "noise_time": "s",
}
HERTZ = {"hz": "1/s"}
# keys of a flight that say nothing of the lateral axis
OF_LONGITUDINAL = ("trim_alpha", "total", "optional", "once", "level")


def surrogate_of(document: Mapping[str, Any], name: str, where: str) -> Surrogate:
    """Return a Surrogate from the content of its file; ``where`` names the file in messages.

    Raises
    ------
    DeclarationError : an unknown or missing key, name, unit or value: one line with file and key.
    """
    content = checked(_Surrogate, document, where)
    axis = content.flight.axis
    _known([axis], tuple(AXES), "axis", f"{where}, key flight.axis")
    return Surrogate(
        name,
        content.title,
        " ".join(content.about.split()),
        _flight(content.flight, f"{where}, key flight"),
        _causes(content.causes, axis, f"{where}, key causes"),
        _hidden(content.hidden, axis, f"{where}, key hidden"),
        _shares(content.estimate.wrong, f"{where}, key estimate.wrong"),
        content.estimate.draws,
        content.seed,
    )


def _flight(flight: _Flight, place: str) -> FlightLine:
    _known(flight.vehicles, VEHICLES[flight.axis], "vehicle", f"{place}.vehicles")
    _known(flight.maneuvers, FLOWN[flight.axis], "maneuver", f"{place}.maneuvers")
    _known([flight.once] if flight.once else [], FLOWN[flight.axis], "maneuver", f"{place}.once")
    _known(flight.unrecorded, AXES[flight.axis].optional, "further channel", f"{place}.unrecorded")
    for key in OF_LONGITUDINAL if flight.axis == LATERAL else ():
        if getattr(flight, key) != _Flight.model_fields[key].default:
            raise DeclarationError(
                "this is for the longitudinal axis", where=f"{place}.{key}", remedy="leave it out"
            )
    fewest, most = flight.records
    if not FEWEST <= fewest <= most <= MOST:
        raise DeclarationError(
            f"{fewest} to {most} records",
            where=f"{place}.records",
            remedy=f"give fewest and most, from {FEWEST} to {MOST}",
        )
    duration = positive(si(flight.duration, "s", f"{place}.duration"), f"{place}.duration")
    if duration < 8.0:
        raise DeclarationError(
            f"{duration:g} s hold no maneuver", where=f"{place}.duration", remedy="give 8 s or more"
        )
    return FlightLine(
        tuple(flight.vehicles),
        flight.variation,
        (fewest, most),
        duration,
        tuple(
            positive(si(rate, "1/s", f"{place}.rates", HERTZ), f"{place}.rates")
            for rate in flight.rates
        ),
        tuple(flight.maneuvers),
        _span(flight.amplitude, "rad", f"{place}.amplitude"),
        positive(si(flight.step, "s", f"{place}.step"), f"{place}.step"),
        positive(si(flight.surface, "rad/s", f"{place}.surface"), f"{place}.surface"),
        _span(flight.trim_alpha, "rad", f"{place}.trim_alpha"),
        flight.total,
        flight.optional,
        tuple(flight.unrecorded),
        flight.level,
        flight.once or "",
        flight.axis,
    )


def _causes(causes: _Causes, axis: str, place: str) -> Causes:
    _known(
        list(causes.noise_std),
        (*AXES[axis].measured, *AXES[axis].optional),
        "channel",
        f"{place}.noise_std",
    )
    levels = causes.model_dump(exclude={"noise_std"})
    for name, unit in CAUSE_UNITS.items():
        levels[name] = si(levels[name], unit, f"{place}.{name}", HERTZ)
        if name in ("turbulence_length", "downwash_lag", "noise_time"):
            positive(levels[name], f"{place}.{name}")
        elif not 0.0 <= levels[name] < float("inf"):
            raise DeclarationError(
                f"{levels[name]:g} is no level",
                where=f"{place}.{name}",
                remedy="give zero or a positive number",
            )
    noise = {
        name: si(value, CHANNEL_UNITS[name], f"{place}.noise_std.{name}")
        for name, value in causes.noise_std.items()
    }
    return Causes(
        **levels,
        noise_std={
            name: positive(value, f"{place}.noise_std.{name}") for name, value in noise.items()
        },
    )


def _hidden(hidden: _Hidden, axis: str, place: str) -> Hidden:
    _known(hidden.names, tuple(OF_AXIS[axis]), "effect that can be hidden here", f"{place}.names")
    if hidden.count > len(hidden.names):
        what = f"{hidden.count} of {len(hidden.names)} names"
        raise DeclarationError(
            what, where=f"{place}.count", remedy="name as many effects as are hidden, or more"
        )
    _known(list(hidden.sizes), tuple(SIZES), "effect of declared size", f"{place}.sizes")
    _known(list(hidden.sizes), tuple(hidden.names), "name hidden here", f"{place}.sizes")
    sizes = {
        name: _size(name, pair, f"{place}.sizes.{name}") for name, pair in hidden.sizes.items()
    }
    return Hidden(
        hidden.count, tuple(hidden.names), _shares(hidden.reduction, f"{place}.reduction"), sizes
    )


def _size(name: str, pair: Sequence[Quantity], where: str) -> Span:
    low, high = _span(pair, SIZES[name].unit, where)
    if high > SIZES[name].most:
        raise DeclarationError(
            f"{high:g} is too large",
            where=where,
            remedy=f"give {SIZES[name].most:g} {SIZES[name].unit} or less",
        )
    return positive(low, where), high


def _span(pair: Sequence[Quantity], unit: str, where: str) -> Span:
    return _ordered(si(pair[0], unit, where), si(pair[1], unit, where), where)


def _shares(pair: Sequence[float], where: str) -> Span:
    if not all(0.0 <= value < 1.0 for value in pair):
        raise DeclarationError(
            f"{list(pair)} are no shares", where=where, remedy="give two numbers from 0 to below 1"
        )
    return _ordered(pair[0], pair[1], where)


def _ordered(low: float, high: float, where: str) -> Span:
    if not low <= high:
        raise DeclarationError(
            f"{low:g} to {high:g}", where=where, remedy="give the lower one first"
        )
    return low, high


def _known(names: Sequence[str], known: tuple[str, ...], what: str, where: str) -> None:
    for name in names:
        if name not in known:
            raise DeclarationError(
                f"there is no {what} {name!r}", where=where, remedy=closest(name, known)
            )


# ---- The declared flights by name

CATALOG = Path(__file__).parent / "catalog"
USUAL_SURROGATE = "surrogate-one"


def surrogate_names() -> tuple[str, ...]:
    """Return the names of the declared surrogate flights, sorted."""
    return tuple(sorted(path.stem for path in CATALOG.glob("*.toml")))


def load_surrogate(name: str, changes: Sequence[str] = ()) -> Surrogate:
    """Return a surrogate flight by its name or the path of its TOML file, with ``"key=value"``
    changes.

    Raises
    ------
    DeclarationError : there is none of that name, or a key or value in its file is wrong.
    """
    if not name.endswith(".toml") and name not in surrogate_names():
        remedy = closest(name, surrogate_names())
        raise DeclarationError(
            f"there is no surrogate flight {name!r}", where="exam", remedy=remedy
        )
    file = name if name.endswith(".toml") else str(CATALOG / f"{name}.toml")
    document, short, where = load_document(file, changes)
    return surrogate_of(document, short, where if file == name else f"{name}.toml")
