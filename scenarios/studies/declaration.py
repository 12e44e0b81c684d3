"""Declaration of a scenario: flight, measurement, estimations, published values, and values that no
source gives.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from sim.errors import DeclarationError

if TYPE_CHECKING:
    from ident.flying_qualities.levels import FlightPhase
    from scenarios.files.sources import InputFile
    from sim.declaration.model import Model


# ---- What a scenario declares

EMPTY: Mapping[str, Any] = MappingProxyType({})
FILTERS = ("ekf", "ukf")  # methods that may make several passes


@dataclass(frozen=True)
class Start:
    """A starting value and its standard deviation, SI; the deviation is infinite where nothing is
    known.
    """

    value: float
    std: float


@dataclass(frozen=True)
class ManeuverPlan:
    """One maneuver: the input it moves, its kind and the numbers of that kind (SI)."""

    input: str
    kind: str
    numbers: Mapping[str, Any]


@dataclass(frozen=True)
class FlightPlan:
    """How the truth is flown.

    Attributes
    ----------
    vehicle : name of a built-in vehicle, or a user's model file; ``own`` is its model with the true
    values. modes : elastic modes that act. duration, rate : s, 1/s. maneuvers : in order; several
    on one input add up. integration : ``"tolerance"``, or by steps, ``"rk4"`` or ``"euler"``. step
    : of these, and wherever only steps serve, s. process_noise : spectral densities of forcing that
    really acts, by state or parameter. noise_std : measurement noise, by output. derivatives : true
    values in the place of the vehicle's. feedback : by input, then by output, gains with which what
    is measured moves the input. frequency_factor : of the modal frequencies against the vehicle's:
    above one a stiffer structure, below one a softer one.
    """

    vehicle: str
    duration: float
    rate: float
    maneuvers: tuple[ManeuverPlan, ...]
    noise_std: Mapping[str, float]
    modes: int = 0
    step: float = 0.001
    integration: str = "tolerance"
    process_noise: Mapping[str, float] = field(default_factory=lambda: EMPTY)
    derivatives: Mapping[str, float] = field(default_factory=lambda: EMPTY)
    feedback: Mapping[str, Mapping[str, float]] = field(default_factory=lambda: EMPTY)
    own: Model | None = None
    frequency_factor: float = 1.0


@dataclass(frozen=True)
class Variation:
    """A flight to be repeated: ``label`` for tables and figures, and the names of the estimations
    that its records go to.
    """

    label: str
    flight: FlightPlan
    methods: tuple[str, ...]


@dataclass(frozen=True)
class Repeated:
    """Flights that are flown ``runs`` times each, with a seed a run."""

    runs: int
    flights: tuple[Variation, ...]


@dataclass(frozen=True)
class Choice:
    """A value that no source gives: its key in the file, what stands there as text, and why that
    was chosen.
    """

    key: str
    value: str
    reason: str


@dataclass(frozen=True)
class PublishedChoice:
    """Which column of which published table stands beside an estimate."""

    file: str
    table: str
    column: str


@dataclass(frozen=True)
class Mark:
    """A structure of a sweep that has a name, and where its rigid equivalents are printed."""

    label: str
    frequency_factor: float
    published: PublishedChoice | None = None


@dataclass(frozen=True)
class SweepPlan:
    """Frequency factors at which a flight is flown and estimated again, from stiff to soft, and
    those of them that have a name.
    """

    frequency_factors: tuple[float, ...]
    marks: tuple[Mark, ...] = ()


@dataclass(frozen=True)
class Estimation:
    """How a record is estimated; everything an estimator is told stands here.

    Attributes
    ----------
    name : key in the study. label : for tables and figures. explanation : what a reader should know
    of the result. model, modes : estimation model; of a user's file ``own``, as the file declares
    it. outputs : those used. method : ``"ekf"``, ``"ukf"``, ``"output-error"``, ``"filter-error"``
    or ``"equation-error"``. start : starting values and priors of the free parameters. initial : of
    the states. held : parameters that are not estimated and not constants of the vehicle. noise_std
    : measurement noise that the estimator assumes; empty takes that of the record's sensors.
    process_noise : spectral densities that the filter assumes, by state or parameter. integration,
    terms, max_step, passes : of a filter; ``terms`` Taylor terms of the fundamental matrix, 0 the
    exponential. spread : a pass after the first starts from the result of the one before with at
    most ``spread`` of its standard
        deviations, so that it linearises near that result; infinite keeps the declared priors. 20
        counts the data 1 + 1/400 times.
    use_priors : whether a whole-record fit counts the priors of ``start`` too; filters always do.
    flown_noise_std : the same flight measured with sensors of this noise; empty takes the record as
    flown. flight : what was flown for this estimation alone, with its ``distance``; None takes the
    scenario's. choices : values of this estimation that no source gives. engine : of an extended
    Kalman filter, a key of ``ident.banks.delays.ENGINES``; both give the same result to rounding.
    """

    name: str
    label: str
    model: str
    outputs: tuple[str, ...]
    start: Mapping[str, Start]
    initial: Mapping[str, Start]
    method: str = "ekf"
    modes: int = 0
    held: Mapping[str, float] = field(default_factory=lambda: EMPTY)
    noise_std: Mapping[str, float] = field(default_factory=lambda: EMPTY)
    process_noise: Mapping[str, float] = field(default_factory=lambda: EMPTY)
    integration: str = "rk4"
    terms: int = 3
    max_step: float = float("inf")
    passes: int = 1
    spread: float = float("inf")
    use_priors: bool = False
    explanation: str = ""
    published: PublishedChoice | None = None
    flown_noise_std: Mapping[str, float] = field(default_factory=lambda: EMPTY)
    own: Model | None = None
    flight: FlightPlan | None = None
    distance: str = ""
    choices: tuple[Choice, ...] = ()
    engine: str = "filterpy"


@dataclass(frozen=True)
class Scenario:
    """A named study.

    Attributes
    ----------
    name, title, about : for people.
    distance : how far the truth is from the model that is fitted.
    flight : the truth recipe. estimations : the main one first.
    condensed : compare with the coefficients that static condensation gives, of those elastic modes
    that fly and that
        an estimation's model lacks.
    display : unit to show a parameter in besides SI, e.g. ``{"beta": "lb/ft2"}``.
    seed : the default seed.
    flown : class of the aircraft and category of the flight phase, by which levels of flying
    qualities are told; None tells none. files : users' model files that it names, with their
    hashes. repeated : flights that show how the estimates scatter; None where one flight is all.
    determination : tell what the records determine and what only the priors do. sweep : structures
    with which the flight is flown and estimated again; None where one is all. choices : values of
    the flight and of the main estimation that no source gives.
    """

    name: str
    title: str
    about: str
    distance: str
    flight: FlightPlan
    estimations: tuple[Estimation, ...]
    condensed: bool = False
    display: Mapping[str, str] = field(default_factory=lambda: EMPTY)
    seed: int = 1
    flown: FlightPhase | None = None
    files: tuple[InputFile, ...] = ()
    repeated: Repeated | None = None
    sweep: SweepPlan | None = None
    determination: bool = False
    choices: tuple[Choice, ...] = ()


def seen_by(scenario: Scenario, estimation: Estimation) -> Scenario:
    """Return the scenario with the flight whose record an estimation gets: its own where it has
    one, of the same vehicle.
    """
    if estimation.flight is None:
        return scenario
    return replace(
        scenario, flight=estimation.flight, distance=estimation.distance or scenario.distance
    )


# ---- The table own of a scenario file

MOST_ENTRIES = 6  # of a list of numbers that is told one by one


def choices_of(
    own: Mapping[str, Any], document: Mapping[str, Any], where: str
) -> tuple[Choice, ...]:
    """Return the choices that ``own`` declares of ``document``, whose keys it repeats with a reason
    in the place of each value.

    The value is read from the document, so that a study tells what it really used; ``where`` is the
    key of ``own`` in messages.

    Raises
    ------
    DeclarationError : a key that the document does not have, or a reason that is no text.
    """
    return tuple(_choices(own, document, where, ""))


def _choices(own: Mapping[str, Any], found: Any, where: str, above: str) -> Iterator[Choice]:
    for name, reason in own.items():
        key, value = f"{above}{name}", _inside(found, name)
        if value is None:
            raise DeclarationError(
                "the file has no such value",
                where=f"{where}.{key}",
                remedy="name a key that stands in it, or leave it out",
            )
        if isinstance(reason, Mapping):
            yield from _choices(reason, value, where, f"{key}.")
        elif isinstance(reason, str) and reason.strip():
            yield Choice(key, value_text(value), " ".join(reason.split()))
        else:
            raise DeclarationError(
                f"{reason!r} is no reason",
                where=f"{where}.{key}",
                remedy="say in words why this value was chosen",
            )


def without_gone(own: Mapping[str, Any], before: Any, after: Any) -> dict[str, Any]:
    """Leave out the entries of ``own`` for values that a change of the document removed."""
    out: dict[str, Any] = {}
    for name, reason in own.items():
        old, new = _inside(before, name), _inside(after, name)
        if new is None and old is not None:
            continue
        kept = without_gone(reason, old, new) if isinstance(reason, Mapping) else reason
        if kept != {} or reason == {}:
            out[name] = kept
    return out


def methods_without_gone(before: Mapping[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Return a changed document likewise in the table ``own`` of each method; what a method does
    not declare is the main one's.
    """
    were, now = before.get("methods"), after.get("methods")
    if not (isinstance(were, list) and isinstance(now, list) and len(were) == len(now)):
        return after
    return {
        **after,
        "methods": [_method(old, new, before, after) for old, new in zip(were, now, strict=True)],
    }


def _method(old: Any, new: Any, before: Mapping[str, Any], after: Mapping[str, Any]) -> Any:
    if not (
        isinstance(old, Mapping)
        and isinstance(new, Mapping)
        and isinstance(new.get("own"), Mapping)
    ):
        return new
    main = [
        document["estimate"] if isinstance(document.get("estimate"), Mapping) else {}
        for document in (before, after)
    ]
    return {**new, "own": without_gone(new["own"], {**main[0], **old}, {**main[1], **new})}


def _inside(table: Any, name: str) -> Any:
    """An entry of a table, or of a list by its number from one; None where it is not there."""
    if isinstance(table, list):
        return (
            table[int(name) - 1]
            if name.isascii() and name.isdigit() and 1 <= int(name) <= len(table)
            else None
        )
    return table.get(name) if isinstance(table, Mapping) else None


def value_text(value: Any) -> str:
    """Return a value of a scenario file in one line: ``"100 Hz"``, ``"550 lb/ft2 +- 110 lb/ft2"``,
    ``"CL_q -11 +- 6, CL_de 0.35 +- 0.2"``.
    """
    if isinstance(value, Mapping):
        if value.keys() == {"value", "std"}:
            return f"{value_text(value['value'])} +- {value_text(value['std'])}"
        return ", ".join(f"{name} {value_text(entry)}" for name, entry in value.items())
    if isinstance(value, list):
        told = len(value) <= MOST_ENTRIES and not any(isinstance(entry, Mapping) for entry in value)
        return (
            ", ".join(value_text(entry) for entry in value) if told else f"({len(value)} entries)"
        )
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)
