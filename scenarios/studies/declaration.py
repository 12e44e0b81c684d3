"""Declaration of a scenario: flight with its maneuvers, measurement, estimations, published values,
and values that no source gives.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.errors import DeclarationError
from sim.maneuvers import (
    Maneuver,
    MultiStep,
    Sum,
    Sweep,
    doublet,
    pulse,
    schroeder_multisine,
    step,
    three_two_one_one,
)

if TYPE_CHECKING:
    from ident.estimate import Estimate
    from ident.flying_qualities.levels import FlightPhase
    from scenarios.files.sources import InputFile
    from sim.declaration.model import Model

# ---- What a scenario declares

EMPTY: Mapping[str, Any] = MappingProxyType({})
FILTERS = ("ekf", "ukf")  # methods that may make several passes


@dataclass(frozen=True)
class Start:
    """A starting value and its standard deviation (infinite if unknown), SI."""

    value: float
    std: float


@dataclass(frozen=True)
class ManeuverPlan:
    """One maneuver of one input; ``numbers``: amplitude, times and the like of its kind, SI."""

    input: str
    kind: str
    numbers: Mapping[str, Any]


@dataclass(frozen=True)
class FlightPlan:
    """How the truth is simulated.

    Attributes
    ----------
    vehicle : name of a built-in vehicle, or a user's model file.
    duration, rate : s, samples per second.
    maneuvers : in order; several on one input add up.
    noise_std : measurement noise, by output.
    modes : number of elastic modes.
    step : integration step of ``"rk4"`` and ``"euler"``, s.
    integration : ``"tolerance"`` (adaptive step), ``"rk4"`` or ``"euler"``.
    process_noise : true spectral densities, by state or parameter.
    derivatives : true values that replace the vehicle's.
    feedback : gains from measured outputs to inputs, by input, then by output.
    own : the user's model with its true values.
    frequency_factor : factor on the vehicle's modal frequencies.
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
    """A flight to be repeated; ``methods``: names of the estimations applied to its records."""

    label: str
    flight: FlightPlan
    methods: tuple[str, ...]


@dataclass(frozen=True)
class Repeated:
    """Flights that are simulated ``runs`` times each, every run with its own seed."""

    runs: int
    flights: tuple[Variation, ...]


@dataclass(frozen=True)
class Choice:
    """A value that no source gives: key in the file, value as text, reason for the choice."""

    key: str
    value: str
    reason: str


@dataclass(frozen=True)
class PublishedChoice:
    """Column of a published table that an estimate is compared with."""

    file: str
    table: str
    column: str


@dataclass(frozen=True)
class Mark:
    """A named structure of a sweep; ``published``: its published rigid equivalents."""

    label: str
    frequency_factor: float
    published: PublishedChoice | None = None


@dataclass(frozen=True)
class SweepPlan:
    """Frequency factors of a sweep, from stiff to soft; ``marks``: the named ones."""

    frequency_factors: tuple[float, ...]
    marks: tuple[Mark, ...] = ()


@dataclass(frozen=True)
class Estimation:
    """How a record is estimated: everything that the estimator knows besides the record.

    Attributes
    ----------
    name : key in the study.
    label : name in tables and figures.
    model, modes : name and number of elastic modes of the estimation model.
    outputs : measured outputs that are used.
    start : starting values and priors of the free parameters.
    initial : initial values and priors of the states.
    method : ``"ekf"``, ``"ukf"``, ``"output-error"``, ``"filter-error"`` or ``"equation-error"``.
    held : fixed parameters that are not constants of the vehicle.
    noise_std : assumed measurement noise; empty: that of the record's sensors.
    process_noise : assumed spectral densities, by state or parameter.
    integration, max_step, passes : integration method, longest step (s) and number of passes of a
        filter.
    terms : Taylor terms of a filter's transition matrix; 0 for the matrix exponential.
    spread : priors of each further pass, at most ``spread`` times the standard deviations of the
        previous pass, from whose result it starts. Infinite keeps the declared priors; 20 counts
        the data 1 + 1/400 times.
    use_priors : whether a whole-record fit uses the priors of ``start``; filters always do.
    explanation : note for the reader of the result.
    published : published values to compare with.
    flown_noise_std : sensor noise of this estimation's record; empty: that of the flight.
    own : the user's model, as its file declares it.
    flight, distance : flight of this estimation alone, and how it differs from the fitted model;
        None and empty: those of the scenario.
    choices : values of this estimation that no source gives.
    engine : implementation of an extended Kalman filter, a key of ``ident.banks.engines.ENGINES``;
        the results of all engines agree to rounding.
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
    name, title, about : name, one line and a paragraph on the study.
    distance : how the truth differs from the fitted model.
    flight : the simulated flight.
    estimations : methods, the main one first.
    condensed : compare with coefficients in which the elastic modes that the estimation model lacks
        are statically condensed.
    display : further display unit of a parameter, e.g. ``{"beta": "lb/ft2"}``.
    seed : the default seed.
    flown : aircraft class and flight phase for levels of flying qualities; None: no levels.
    files : users' model files, with hashes.
    repeated : flights that are simulated several times, to show the scatter of the estimates.
    sweep : structures from stiff to soft that the flight is repeated with.
    determination : report what the records determine and what only the priors do.
    choices : values of the flight and of the main estimation that no source gives.
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
    """Return the scenario with the flight of an estimation: its own flight if it has one."""
    if estimation.flight is None:
        return scenario
    return replace(
        scenario, flight=estimation.flight, distance=estimation.distance or scenario.distance
    )


# ---- The table own of a scenario file

MOST_ENTRIES = 6  # longest list whose numbers are printed one by one


def choices_of(
    own: Mapping[str, Any], document: Mapping[str, Any], where: str
) -> tuple[Choice, ...]:
    """Return the choices that ``own`` declares.

    ``own`` repeats keys of ``document``, with a reason instead of each value. The values are read
    from the document, so that a study reports the values it used. ``where`` is the key of ``own``
    in messages.

    Raises
    ------
    DeclarationError : a key that the document does not have, or a reason that is no text.
    """
    return tuple(_choices(own, document, where, ""))


def _choices(own: Mapping[str, Any], table: Any, where: str, above: str) -> Iterator[Choice]:
    """Yield the choices of a table; ``above``: key of the table with a dot, or empty."""
    for name, reason in own.items():
        key, value = f"{above}{name}", _entry(table, name)
        if value is None:
            raise DeclarationError(
                "the file has no such value",
                where=f"{where}.{key}",
                remedy="name a key of it, or leave it out",
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


def without_removed(own: Mapping[str, Any], before: Any, after: Any) -> dict[str, Any]:
    """Return ``own`` without the entries whose values a change of the document removed."""
    out: dict[str, Any] = {}
    for name, reason in own.items():
        old, new = _entry(before, name), _entry(after, name)
        if new is None and old is not None:
            continue
        kept = without_removed(reason, old, new) if isinstance(reason, Mapping) else reason
        if kept != {} or reason == {}:
            out[name] = kept
    return out


def methods_without_removed(before: Mapping[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Return the document ``after`` with ``without_removed`` applied to ``own`` of each method.

    A method that does not give a value uses that of the main method.
    """
    old_methods, new_methods = before.get("methods"), after.get("methods")
    if not (isinstance(old_methods, list) and isinstance(new_methods, list)):
        return after
    if len(old_methods) != len(new_methods):
        return after
    old_main, new_main = (
        document["estimate"] if isinstance(document.get("estimate"), Mapping) else {}
        for document in (before, after)
    )
    methods = []
    for old, new in zip(old_methods, new_methods, strict=True):
        if not (isinstance(old, Mapping) and isinstance(_entry(new, "own"), Mapping)):
            methods.append(new)
            continue
        own = without_removed(new["own"], {**old_main, **old}, {**new_main, **new})
        methods.append({**new, "own": own})
    return {**after, "methods": methods}


def _entry(table: Any, name: str) -> Any:
    """Return an entry of a table, or of a list (numbered from 1); None if missing."""
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
        listed = len(value) <= MOST_ENTRIES and not any(
            isinstance(entry, Mapping) for entry in value
        )
        return (
            ", ".join(value_text(entry) for entry in value) if listed else f"({len(value)} entries)"
        )
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


# ---- Maneuvers of a flight plan

START_OF_REST = -1e6  # s; inputs are at rest from then on: earlier than any delay reaches back
SMOOTH = ("sweep", "multisine")  # maneuvers without steps


def maneuvers_by_input(
    plans: Sequence[ManeuverPlan],
    inputs: Collection[str],
    place: str,
    rest: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, Maneuver]:
    """Return the sum of the maneuvers of each input, about its value at rest.

    Parameters
    ----------
    plans : the maneuvers.
    inputs : names of the inputs.
    place : key of the flight, for errors.
    rest : value at rest by input; zero for others.

    Raises
    ------
    DeclarationError : a maneuver lacks a number or moves an unknown input.
    """
    by_input = {name: Sum((step(value, START_OF_REST),)) for name, value in rest.items()}
    for number, plan in enumerate(plans, start=1):
        if plan.input not in inputs:
            known = ", ".join(sorted(inputs)) or "none"
            raise DeclarationError(
                f"there is no input {plan.input!r}",
                where=f"{place}.maneuvers[{number}]",
                remedy=f"its inputs are {known}",
            )
        before = by_input.get(plan.input, Sum())
        by_input[plan.input] = Sum(
            (*before.parts, maneuver_of(plan, f"{place}.maneuvers[{number}]"))
        )
    return {**by_input}


def with_common_hold(
    by_input: Mapping[str, Maneuver], plans: Sequence[ManeuverPlan], time: np.ndarray
) -> dict[str, Maneuver]:
    """Return maneuvers in which all inputs behave alike between samples, as in a record.

    If any input has steps, smooth inputs are held between the samples ``time`` (s), too.
    """
    smooth = {plan.input for plan in plans if plan.kind in SMOOTH}
    if all(plan.kind in SMOOTH for plan in plans):
        return {**by_input}
    times = (START_OF_REST, *time[1:].tolist(), math.inf)
    return {
        **by_input,
        **{
            name: MultiStep(tuple(np.asarray(by_input[name](time)).tolist()), times)
            for name in smooth
        },
    }


def maneuver_of(plan: ManeuverPlan, where: str) -> Maneuver:
    """Return the maneuver that a plan describes.

    Raises
    ------
    DeclarationError : a number is missing, or the kind of maneuver has no such number.
    """
    needed, build = KINDS[plan.kind]
    for name in needed:
        if name not in plan.numbers:
            raise DeclarationError(
                f"{name} is missing", where=where, remedy=f"a {plan.kind} needs {', '.join(needed)}"
            )
    for name in plan.numbers:
        if name not in (*needed, "start"):
            raise DeclarationError(
                f"a {plan.kind} takes no {name}",
                where=where,
                remedy=f"it takes {', '.join((*needed, 'start'))}",
            )
    return build(**plan.numbers)


def _tapered_sweep(
    amplitude: float,
    first_frequency: float,
    last_frequency: float,
    duration: float,
    start: float = 0.0,
) -> Maneuver:
    return Sweep(amplitude, first_frequency, last_frequency, duration, start, taper=0.1 * duration)


def _multisine(
    amplitude: float, duration: float, harmonics: Sequence[int], start: float = 0.0
) -> Maneuver:
    return schroeder_multisine(amplitude, duration, tuple(harmonics), start)


# Kind of maneuver -> numbers that it needs besides the start, and the function that makes it.
KINDS: Mapping[str, tuple[tuple[str, ...], Callable[..., Maneuver]]] = {
    "3-2-1-1": (("amplitude", "unit"), three_two_one_one),
    "doublet": (("amplitude", "unit"), doublet),
    "pulse": (("amplitude", "unit"), pulse),
    "step": (("amplitude",), step),
    "sweep": (("amplitude", "first_frequency", "last_frequency", "duration"), _tapered_sweep),
    "multisine": (("amplitude", "duration", "harmonics"), _multisine),
}


# ---- Published values of parameters, and the rows of a study's comparison

# Each paper has one TOML file in `published` with its tables; each number has its unit and its
# place in the paper. A remark under `[remarks]` is repeated wherever its column is shown. Published
# values are compared with estimates and never used to form them. To add a paper, write its file and
# name it in a scenario under `published`; a test compares the file with the scenario's parameters.


def published_values(choice: PublishedChoice, units: Mapping[str, str]) -> dict[str, Start]:
    """Return values and standard deviations of a published column.

    ``units``: unit of the result by parameter; 1 for others.

    Raises
    ------
    DeclarationError : no such file, table or column.
    """
    from scenarios.files.units import to_si

    place = f"published {choice.file}, table {choice.table}"
    found = _document(choice.file).get(choice.table)
    table: dict[str, Any] = found if isinstance(found, dict) else {}
    columns = {key: value for key, value in table.items() if isinstance(value, dict)}
    if choice.column not in columns:
        known = ", ".join(columns) if table else "no such table"
        raise DeclarationError(
            f"there is no column {choice.column!r}", where=place, remedy=f"it has {known}"
        )
    published = {}
    for name, row in columns[choice.column].items():
        factor = 1.0
        if "unit" in table:
            unit = units.get(name, "1")
            factor = float(to_si(1.0, table["unit"], unit, place, DeclarationError))
        published[name] = Start(row["value"] * factor, row["std"] * factor)
    return published


def published_remark(choice: PublishedChoice | None) -> str:
    """Return the remark on a published column; empty if there is none, or no column.

    Raises DeclarationError if there is no such file.
    """
    if choice is None:
        return ""
    remarks = _document(choice.file).get("remarks", {})
    return str(remarks.get(choice.table, {}).get(choice.column, ""))


def _document(file: str) -> dict[str, Any]:
    entry = files("scenarios.studies").joinpath("published", f"{file}.toml")
    if not entry.is_file():
        raise DeclarationError(
            "there is no such file of published numbers",
            where=file,
            remedy="look into scenarios/studies/published",
        )
    return tomllib.loads(entry.read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Row:
    """Estimated, true and published value of one parameter, all in ``unit``.

    Attributes
    ----------
    condensed : value that the model should find: the coefficient with the elastic modes that the
        model lacks statically condensed.
    """

    name: str
    unit: str
    estimate: float
    std: float
    true: float | None = None
    condensed: float | None = None
    published: Start | None = None

    @property
    def reference(self) -> float | None:
        """Value that the estimate should have: the condensed value if known, else the true one."""
        return self.true if self.condensed is None else self.condensed

    @property
    def sigmas(self) -> float | None:
        """Error in reported standard deviations."""
        return None if self.reference is None else (self.estimate - self.reference) / self.std

    @property
    def percent(self) -> float | None:
        """Error in percent of the reference; None if that is zero."""
        if not self.reference:
            return None
        return 100.0 * (self.estimate - self.reference) / abs(self.reference)

    @property
    def published_sigmas(self) -> float | None:
        """Error of the published value against the reference, in published sigmas."""
        if self.published is None or self.reference is None:
            return None
        return (self.published.value - self.reference) / self.published.std


def rows_of(estimate: Estimate) -> tuple[Row, ...]:
    """Return the rows of an estimate, without true and published values."""
    numbers = zip(estimate.names, estimate.units, estimate.values, estimate.std, strict=True)
    return tuple(Row(name, unit, float(value), float(std)) for name, unit, value, std in numbers)
