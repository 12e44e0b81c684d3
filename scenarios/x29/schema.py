"""Schema of closed-loop scenario files (pydantic), and conversion to a LoopScenario."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from scenarios.files.declarations import checked
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT
from scenarios.studies.catalogue import with_change
from scenarios.studies.declaration import choices_of
from scenarios.studies.schema import Quantity, positive_si, si, standard_deviations
from scenarios.x29.declaration import (
    METHODS,
    OUTPUTS,
    Against,
    LoopEstimation,
    LoopFlight,
    LoopScenario,
    MarginPlan,
    Spike,
    StickPlan,
    Variant,
    printed_columns,
)
from sim.errors import DeclarationError
from sim.vehicles.factory import LOES_DERIVATIVES

Name = Annotated[str, Field(min_length=1)]
_STATES = {"alpha": "rad", "q": "rad/s", "delta": "1"}


class _LoopStrict(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT


class _Stick(_LoopStrict):
    kind: Literal["3-2-1-1", "doublet", "levels", "hand-flown"]
    amplitude: float = 1.0
    unit: Quantity = 0.5
    start: Quantity = 1.0
    bandwidth: float = Field(default=10.0, gt=0)
    pilot_seed: int = Field(default=1, ge=0)
    times: list[float] = []
    levels: list[float] = []


class _Spike(_LoopStrict):
    time: Quantity
    size: float


class _LoopFlight(_LoopStrict):
    airframe: Literal["P", "S", "F", "D", "R"]
    duration: Quantity
    stick: _Stick
    noise: bool = True
    dead_band: float | None = Field(default=None, ge=0)
    curvature: float | None = Field(default=None, ge=0)
    rate_limits: bool = True
    low_order: bool = False
    gust: float = Field(default=0.0, ge=0)
    spike: _Spike | None = None
    noise_variance: dict[str, str] = {}


class _LoopEstimate(_LoopStrict):
    start: dict[str, Quantity] = {}
    start_from: str = ""
    noise_from: Literal["sensors", "envelope"]
    noise_share: float = Field(default=1.0, gt=0)
    process_noise: dict[str, Annotated[float, Field(ge=0)]]
    initial_std: dict[str, Quantity] = {}
    window_start: Quantity | None = None
    window_stop: Quantity | None = None
    restarts: int = Field(default=0, ge=0, le=30)
    prior: Literal["quarter", "printed"] = "quarter"
    engine: Literal["filterpy", "batched"] = "batched"


class _Margins(_LoopStrict):
    samples: int = Field(ge=0, le=10_000)
    seed: int = Field(default=1, ge=0)
    beside: Literal["P", "S", "F", "D", "R"] | None = None


class _Against(_LoopStrict):
    scenario: Name
    label: Name
    set: list[str] = []


class _Variant(_LoopStrict):
    name: Name
    label: Name
    set: list[str] = []


class _Scenario(_LoopStrict):
    schema_: Literal["flightid/scenario/1"] = Field(alias="schema")
    kind: Literal["x29"]
    title: Name
    about: str = ""
    distance: Literal["model of lower order", "same equations, finer step"]
    seed: int = Field(default=1, ge=0)
    flight: _LoopFlight
    estimate: _LoopEstimate
    published: list[str] = []
    against: _Against | None = None
    together: list[str] = []
    variants: list[_Variant] = []
    stretch: Annotated[list[Quantity], Field(min_length=2, max_length=2)] | None = None
    peak: Annotated[list[Quantity], Field(min_length=2, max_length=2)] | None = None
    methods: list[str] = []
    seeds: int = Field(default=0, ge=0, le=1000)
    margins: _Margins | None = None
    findings: str = ""
    own: dict[str, Any] = {}


def loop_scenario_of(document: Mapping[str, Any], name: str, where: str) -> LoopScenario:
    """Return a LoopScenario from the content of its file; ``where`` names the file in messages.

    Raises
    ------
    DeclarationError : an unknown or missing key, a value or unit that is wrong: one line with file
        and key.
    """
    content = checked(_Scenario, document, where)
    against = content.against
    return LoopScenario(
        name,
        content.title,
        " ".join(content.about.split()),
        content.distance,
        _flight(content.flight, f"{where}, key flight"),
        _estimation(content.estimate, f"{where}, key estimate"),
        _refuse_unknown(content.published, printed_columns(), "column", f"{where}, key published"),
        None if against is None else Against(against.scenario, against.label, tuple(against.set)),
        tuple(content.together),
        tuple(
            _variant(variant, document, f"{where}, variants[{i}]")
            for i, variant in enumerate(content.variants, start=1)
        ),
        _span(content.stretch, f"{where}, key stretch"),
        _span(content.peak, f"{where}, key peak"),
        " ".join(content.findings.split()),
        _refuse_unknown(content.methods, METHODS, "method", f"{where}, key methods"),
        _margins(content, where),
        content.seed,
        choices_of(content.own, document, f"{where}, key own"),
        content.seeds,
    )


def _variant(variant: _Variant, document: Mapping[str, Any], place: str) -> Variant:
    changed = {key: value for key, value in document.items() if key != "variants"}
    for change in variant.set:
        changed = with_change(changed, change)
    content = checked(_Scenario, changed, place)
    flight = _flight(content.flight, f"{place}, key flight")
    estimation = _estimation(content.estimate, f"{place}, key estimate")
    return Variant(variant.name, variant.label, flight, estimation)


def _flight(flight: _LoopFlight, where: str) -> LoopFlight:
    stick = flight.stick
    place = f"{where}.stick"
    if stick.kind == "levels" and (not stick.times or len(stick.times) != len(stick.levels)):
        what = f"{len(stick.times)} times and {len(stick.levels)} levels"
        raise DeclarationError(
            what, where=place, remedy="give as many of one as of the other, at least one"
        )
    plan = StickPlan(
        stick.kind,
        stick.amplitude,
        positive_si(stick.unit, "s", f"{place}.unit"),
        si(stick.start, "s", f"{place}.start"),
        stick.bandwidth,
        stick.pilot_seed,
        tuple(stick.times),
        tuple(stick.levels),
    )
    spike = None
    if flight.spike is not None:
        spike = Spike(si(flight.spike.time, "s", f"{where}.spike.time"), flight.spike.size)
    duration = positive_si(flight.duration, "s", f"{where}.duration")
    if spike is not None and not 0.0 <= spike.time <= duration:
        raise DeclarationError(
            f"{spike.time:g} s is not within the flight",
            where=f"{where}.spike.time",
            remedy=f"give 0 to {duration:g} s",
        )
    if flight.gust and not flight.low_order:
        raise DeclarationError(
            "a gust acts on the low-order truth only",
            where=f"{where}.gust",
            remedy="set low_order = true, or gust = 0",
        )
    for name in flight.noise_variance:
        if name not in OUTPUTS:
            raise DeclarationError(
                f"there is no output {name!r}",
                where=f"{where}.noise_variance",
                remedy=f"use {', '.join(OUTPUTS)}",
            )
    return LoopFlight(
        flight.airframe,
        duration,
        plan,
        flight.noise,
        flight.dead_band,
        flight.curvature,
        flight.rate_limits,
        flight.low_order,
        flight.gust,
        spike,
        standard_deviations({}, flight.noise_variance, where),
    )


def _estimation(estimate: _LoopEstimate, where: str) -> LoopEstimation:
    if bool(estimate.start) == bool(estimate.start_from):
        raise DeclarationError(
            "one of start and start_from is due",
            where=where,
            remedy="give starting values, or the scenario they come from",
        )
    for name in estimate.start:
        if name not in LOES_DERIVATIVES or name == "delay":
            available = ", ".join(known for known in LOES_DERIVATIVES if known != "delay")
            raise DeclarationError(
                f"there is no parameter {name!r}", where=f"{where}.start", remedy=f"use {available}"
            )
    for table, content in (
        ("process_noise", estimate.process_noise),
        ("initial_std", estimate.initial_std),
    ):
        for name in content:
            if name not in _STATES:
                raise DeclarationError(
                    f"there is no state {name!r}",
                    where=f"{where}.{table}",
                    remedy=f"use {', '.join(_STATES)}",
                )
    missing = [name for name in LOES_DERIVATIVES if name != "delay" and name not in estimate.start]
    if estimate.start and missing:
        raise DeclarationError(
            f"no starting value of {', '.join(missing)}", where=f"{where}.start", remedy="give it"
        )
    initial = {
        name: positive_si(value, _STATES[name], f"{where}.initial_std.{name}")
        for name, value in estimate.initial_std.items()
    }
    window_start, window_stop = (
        None if end is None else si(end, "s", f"{where}.{name}")
        for name, end in (
            ("window_start", estimate.window_start),
            ("window_stop", estimate.window_stop),
        )
    )
    return LoopEstimation(
        {
            name: si(value, LOES_DERIVATIVES[name], f"{where}.start.{name}")
            for name, value in estimate.start.items()
        },
        estimate.start_from,
        estimate.noise_from,
        estimate.noise_share,
        dict(estimate.process_noise),
        initial,
        window_start,
        window_stop,
        estimate.restarts,
        estimate.prior,
        estimate.engine,
    )


def _margins(content: _Scenario, where: str) -> MarginPlan | None:
    plan = content.margins
    if plan is not None and content.against is None:
        what = "margins are those of two loops, and there is one"
        raise DeclarationError(
            what, where=f"{where}, key margins", remedy="declare [against], or leave it out"
        )
    return None if plan is None else MarginPlan(plan.samples, plan.seed, plan.beside or "")


def _refuse_unknown(
    names: list[str], allowed: Collection[str], what: str, where: str
) -> tuple[str, ...]:
    for name in names:
        if name not in allowed:
            raise DeclarationError(
                f"there is no {what} {name!r}", where=where, remedy=f"use {', '.join(allowed)}"
            )
    return tuple(names)


def _span(pair: list[Quantity] | None, where: str) -> tuple[float, float] | None:
    if pair is None:
        return None
    low, high = (si(value, "s", where) for value in pair)
    if not low < high:
        raise DeclarationError(
            f"{low:g} s to {high:g} s is no stretch",
            where=where,
            remedy="give an earlier and a later time",
        )
    return low, high
