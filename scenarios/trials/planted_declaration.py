"""Declaration of a tracing scenario, its hidden terms, and terms that are not in the library.

The terms here are written like the effects of `sim/effects`, but the tracing loop never tries them.
To add one that a scenario hides, write an effect named `own:NAME` and put it into ``TERMS``. Terms
that no scenario hides are in `exam/hidden_terms`.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from scenarios.studies.declaration import ManeuverPlan
from sim.closed_loop.airframe import X29
from sim.declaration.effect import Effect, Parameter, Regularity, Signal, Station, full_name
from sim.declaration.model import Equations, Model, Noise
from sim.errors import DeclarationError
from sim.maths import clip, cos, exp

if TYPE_CHECKING:
    from ident.tracing.diagnosis import Claim
    from scenarios.diagnosis.diagnose import Tracing


@dataclass(frozen=True)
class AlphaControlProduct:
    """Elevator that loses effectiveness in the wing's wake.

    moment += ``moment`` alpha elevator, lift += ``lift`` alpha elevator, both in 1/rad2.
    """

    name: ClassVar[str] = "own:alpha-control-product"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment", "lift")
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("moment", 6.0, "1/rad2"),
        Parameter("lift", -2.0, "1/rad2"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"moment": 0.0, "lift": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The tail works in the wake of the wing: the power of the elevator changes with the angle "
        "of attack."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        product = s.alpha_air * (s.delta if hasattr(s, "delta") else s.elevator)
        return {"moment": p.moment * product, "lift": p.lift * product}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


@dataclass(frozen=True)
class DragBucket:
    """Drag bucket: low drag within a narrow range of the angle of attack, gust included.

    drag += ``depth`` x^2 / (1 + x^2), x = (alpha - ``middle``)/``width``; ``depth`` has unit 1,
    ``middle`` and ``width`` rad.
    """

    name: ClassVar[str] = "own:drag-bucket"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("depth", 0.03, "1"),
        Parameter("middle", 0.0, "rad"),
        Parameter("width", 0.05, "rad", bounds=(1e-6, 10.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"depth": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ("drag-nonlinearity",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Within a narrow range of lift the flow stays laminar and the drag is low; outside it "
        "rises and levels off."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        square = ((s.alpha_air - p.middle) / p.width) ** 2
        return {"drag": p.depth * square / (1.0 + square)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


@dataclass(frozen=True)
class HalfSineGust:
    """Single gust of half a sine, which begins and ends with a kink.

    w = ``peak`` sin(pi (t - start)/duration), m/s up, from ``start`` to ``start + duration`` (s).
    """

    name: ClassVar[str] = "own:half-sine-gust"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("gust",)
    needs_constants: ClassVar[tuple[str, ...]] = ("airspeed",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("peak", 3.0, "m/s"),
        Parameter("start", 2.0, "s"),
        Parameter("duration", 1.0, "s", bounds=(0.01, math.inf)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"peak": 0.0})
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ("gust-discrete",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "A single gust whose speed follows half a sine: it begins and ends with a kink, as a gust "
        "does behind an obstacle."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        phase = clip((s.time - p.start) / p.duration, 0.0, 1.0)
        return {"gust": p.peak * cos(math.pi * (phase - 0.5)) / vehicle.airspeed}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


@dataclass(frozen=True)
class PeriodicMoment:
    """Periodic pitching moment, as of sloshing fuel or vortex shedding.

    moment += ``size`` sin(``frequency`` t), frequency in rad/s.
    """

    name: ClassVar[str] = "own:periodic-moment"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("size", 0.003, "1"),
        Parameter("frequency", 5.0, "rad/s"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Something aboard swings at its own rhythm and pushes the nose up and down, whatever the "
        "controls do."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": p.size * cos(p.frequency * s.time - 0.5 * math.pi)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


@dataclass(frozen=True)
class TanhMoment:
    """Pitching moment whose slope grows by ``loss`` (1/rad) beyond ``width`` (rad).

    moment += ``loss`` (alpha - ``width`` tanh(alpha/width)).
    """

    name: ClassVar[str] = "own:tanh-moment"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("loss", 0.5, "1/rad"),
        Parameter("width", 0.04, "rad", bounds=(1e-6, 10.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"loss": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ("moment-nonlinearity",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The pitching moment is steep near trim and flattens on both sides, as where a strake's "
        "vortex loses its grip."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        # tanh by the exponential, which broadcasts and allows complex steps.
        grown = exp(2.0 * s.alpha_air / p.width)
        return {"moment": p.loss * (s.alpha_air - p.width * (grown - 1.0) / (grown + 1.0))}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERMS: tuple[Effect, ...] = (
    AlphaControlProduct(),
    DragBucket(),
    HalfSineGust(),
    PeriodicMoment(),
    TanhMoment(),
)


# ---- What a tracing scenario declares

_NONE: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class HiddenTerm:
    """A term of the truth that the declared model lacks.

    Attributes
    ----------
    name : name of a library effect or, with ``own:``, of a term of ``TERMS``.
    values : its parameters by local name, SI.
    elsewhere : values that differ in the other two records, such as the time of an event.
    """

    name: str
    values: Mapping[str, float]
    elsewhere: Mapping[str, float] = field(default_factory=lambda: _NONE)


@dataclass(frozen=True)
class RecordPlan:
    """Plan of one record: duration (s) and maneuvers."""

    duration: float
    maneuvers: tuple[ManeuverPlan, ...] = ()


@dataclass(frozen=True)
class TraceFlight:
    """How the records of a tracing scenario are simulated.

    Attributes
    ----------
    vehicle : name of a built-in vehicle, ``"x29-S"`` for the closed loop with that airframe, or a
        user's model file.
    own : the user's model with its true values.
    modes : number of elastic modes.
    rate : samples a second; in a closed loop that of the telemetry.
    step : integration step, s.
    noise_std : measurement noise by output; in a closed loop that of the telemetry.
    train, validate : the fitted and the predicted record.
    hidden : terms that act in addition to the vehicle.
    test : a third record, not used for fitting or model selection; None: with the maneuvers of
        ``validate``.
    """

    vehicle: str
    train: RecordPlan
    validate: RecordPlan
    hidden: tuple[HiddenTerm, ...]
    noise_std: Mapping[str, float] = field(default_factory=lambda: _NONE)
    rate: float = 50.0
    step: float = 0.001
    modes: int = 0
    own: Model | None = None
    test: RecordPlan | None = None

    @property
    def test_plan(self) -> RecordPlan:
        """Plan of the third record."""
        return self.validate if self.test is None else self.test


@dataclass(frozen=True)
class Expectation:
    """Expected diagnosis: any of ``verdicts`` and, if effects are claimed, any of the sets
    ``effects``.
    """

    verdicts: tuple[str, ...]
    effects: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class TraceScenario:
    """A named study of the tracing loop.

    Attributes
    ----------
    name, title, about : name, one line and a paragraph on the study.
    distance : how the truth differs from the model, and whether the library has this effect.
    flight : how the records are simulated.
    model : declared model, a name or a user's model file.
    wrong : relative error of the vehicle file's starting values, with alternating sign.
    start : starting values that replace these.
    expect : expected diagnosis.
    seed : the default seed.
    effort : effort of the search, normal or thorough.
    """

    name: str
    title: str
    about: str
    distance: str
    flight: TraceFlight
    model: str
    expect: Expectation
    wrong: float = 0.3
    start: Mapping[str, float] = field(default_factory=lambda: _NONE)
    seed: int = 1
    effort: str = "normal"


# ---- Hidden terms by name

OWN = "own:"
CLOSED_LOOP = "x29-"
BREAKOUT = "input-deadband"


def own_terms(package_name: str | None = None) -> Mapping[str, Effect]:
    """Return terms that are not in the library by name: ``TERMS``, or those of a package."""
    if package_name is None:
        return {term.name: term for term in TERMS}
    package = importlib.import_module(package_name)
    names = sorted(
        module.name for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    )
    modules = [importlib.import_module(name) for name in names]
    return {module.TERM.name: module.TERM for module in modules if hasattr(module, "TERM")}


def true_vehicle(flight: TraceFlight) -> Model:
    """Return the vehicle of a flight without hidden effects."""
    from scenarios.studies.estimating import vehicle_model

    if flight.own is not None:
        return flight.own.with_noise(Noise(flight.noise_std))
    return vehicle_model(flight.vehicle, flight.modes, Noise(flight.noise_std))


def hidden_units(name: str, vehicle: str | Model, where: str) -> Mapping[str, str]:
    """Return the units of a hidden term's parameters by local name.

    ``vehicle``: name of a built-in vehicle, or a user's model.

    Raises
    ------
    DeclarationError : there is no such term for this vehicle.
    """
    if isinstance(vehicle, str) and vehicle.startswith(CLOSED_LOOP):
        if name != BREAKOUT:
            raise DeclarationError(
                f"{name!r} in a closed loop",
                where=f"{where}.name",
                remedy=f"use {BREAKOUT}, the break-out of its stick",
            )
        return {"half_width": "in"}
    if isinstance(vehicle, str):
        from sim.vehicles.factory import model_of
        from sim.vehicles.library import read_parameter_set

        vehicle = model_of(read_parameter_set(vehicle))
    effect = find_term(name, vehicle.equations, where)
    return {item.name: item.unit for item in effect.parameters}


def find_term(
    name: str, equations: Equations, where: str, terms: Mapping[str, Effect] | None = None
) -> Effect:
    """Return a hidden term that acts on these equations.

    ``terms``: terms that are not in the library; None: ``own_terms()``.

    Raises
    ------
    DeclarationError : there is no such term.
    """
    from sim.effects.library import applies, find_effect
    from sim.errors import ModelError

    if name.startswith(OWN):
        terms = own_terms() if terms is None else terms
        if name not in terms or not applies(terms[name], equations):
            raise DeclarationError(
                f"there is no term {name!r} for {equations.name}",
                where=f"{where}.name",
                remedy=f"use one of {', '.join(terms)}",
            )
        return terms[name]
    try:
        return find_effect(name, equations)
    except ModelError as fault:
        raise DeclarationError(fault.what, where=f"{where}.name", remedy=fault.remedy) from None


def with_hidden(model: Model, hidden: tuple[HiddenTerm, ...], *, validation: bool) -> Model:
    """Return the vehicle with the effects hidden in one of its two records.

    Raises
    ------
    DeclarationError : a parameter of a hidden term has no value.
    """
    for term in hidden:
        effect = find_term(term.name, model.equations, term.name)
        values = {**term.values, **(term.elsewhere if validation else {})}
        model = model.with_effects(effect).with_values(
            {full_name(effect, local): value for local, value in values.items()}
        )
    return model


def with_breakout(x29: X29, hidden: tuple[HiddenTerm, ...]) -> X29:
    """Return the closed loop with the hidden break-out of its stick; without it, with none."""
    width = next((term.values["half_width"] for term in hidden if term.name == BREAKOUT), 0.0)
    return replace(x29, stick=replace(x29.stick, dead_band=width))


# ---- Grade of a diagnosis


class Grade(Enum):
    """Grade of a diagnosis compared with the truth."""

    RIGHT = "right"
    AMBIGUOUS = "the right effects, one of them named as an alternative"
    UNDECIDED = "no effect is claimed where one should be"
    WRONG = "not what was expected"


def grade(expect: Expectation, tracing: Tracing) -> Grade:
    """Compare verdict and effects with the expectation; a named alternative counts as ambiguous."""
    verdict = tracing.diagnosis.verdict.value
    claims = [claim for claim in tracing.diagnosis.effects if claim.claimed]
    names = tuple(sorted(claim.name for claim in claims))
    without_effects = not names and (not expect.effects or verdict == "unexplained")
    if verdict in expect.verdicts and (names in expect.effects or without_effects):
        return Grade.RIGHT
    if verdict == "ambiguous" and names in expect.effects:
        return Grade.AMBIGUOUS
    if verdict != "unexplained" and any(
        _right_with_alternative(claims, accepted) for accepted in expect.effects
    ):
        return Grade.AMBIGUOUS
    return Grade.UNDECIDED if verdict == "unexplained" and not names else Grade.WRONG


def _right_with_alternative(claims: list[Claim], accepted: tuple[str, ...]) -> bool:
    """Return whether the claims are correct after replacing one by one of its alternatives."""
    names = [claim.name for claim in claims]
    return any(
        tuple(sorted([*names[:place], other, *names[place + 1 :]])) == accepted
        for place, claim in enumerate(claims)
        for other in claim.alternatives
    )
