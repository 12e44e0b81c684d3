"""Model structure: from records to coefficients, chosen terms, and a vehicle file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np

from ident.structure.averaging import Collinearity, collinearity_of, multiples_of
from ident.structure.coefficients import (
    DERIVATIVE_BANDWIDTH,
    MOMENTS,
    NEEDED_CHANNELS,
    Airframe,
    Histories,
    filled,
    histories_of,
)
from ident.structure.products import TermColumns, columns_of, noise_columns
from ident.structure.selection import ORTHOGONAL, STEPWISE, Selection, select
from scenarios.files.aircraft_files import AXES, read_aircraft
from scenarios.files.declarations import closest, read_toml_source, toml_of
from scenarios.files.measured.columns import RecordFile, read_record_files, refuse_duplicates
from scenarios.files.sources import InputFile
from scenarios.files.vehicles import VEHICLE_FILE_NAME, with_plain_terms
from scenarios.preparation.declared_model import (
    DECISIVE_LOG_LIKELIHOOD_RATIO,
    held_by_computer,
    log_likelihood_gain,
    with_hold,
)
from scenarios.preparation.plan import WHOLE, Request, column_choices
from scenarios.preparation.reading import (
    prepare,
    refuse_moving_together,
    refuse_other_units,
    separate_controls,
)
from sim.aerodynamics import Term, parse_term
from sim.errors import DeclarationError, RecordError
from sim.record import Hold, Record
from sim.vehicles.aircraft import SENSORS, Aircraft, aircraft_model

METHODS = (STEPWISE, ORTHOGONAL)
DEFAULT_DEGREE = 2
LARGEST_DEGREE = 4
MOST_SPLINES = 5
DRAG = ("CX", "CD")  # a surface adds drag to whichever side it is deflected
_UNMOVED_SHARE = 1e-6  # least peak-to-peak change of a signal that moved


@dataclass(frozen=True)
class StructureOptions:
    """How terms are offered and chosen.

    Attributes
    ----------
    method : ``stepwise`` or ``orthogonal``.
    bandwidth : Hz, of the angular accelerations.
    degree : of the products of signals that are offered.
    splines : knots in alpha.
    terms : a TOML file with the terms offered, ``Cm = ["alpha", "alpha*elevator"]``.
    baseline : the vehicle file's terms stay, and increments to them are found.
    hierarchical : stepwise regression offers a product after the linear terms of its symmetry.
    """

    method: str = STEPWISE
    bandwidth: float = DERIVATIVE_BANDWIDTH
    degree: int = DEFAULT_DEGREE
    splines: int = 0
    terms: Path | None = None
    baseline: bool = False
    hierarchical: bool = False

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            what = f"there is no method {self.method!r}"
            raise DeclarationError(what, where="--method", remedy=f"use {' or '.join(METHODS)}")
        if self.hierarchical and self.method != STEPWISE:
            what = f"{self.method} functions take all offered terms in their order"
            remedy = f"use --method {STEPWISE}"
            raise DeclarationError(what, where="--hierarchical", remedy=remedy)
        if not (math.isfinite(self.bandwidth) and self.bandwidth > 0.0):
            raise DeclarationError(
                f"{self.bandwidth:g} Hz is no bandwidth", where="--bandwidth", remedy="above zero"
            )
        for option, value, least, most in (
            ("--degree", self.degree, 1, LARGEST_DEGREE),
            ("--splines", self.splines, 0, MOST_SPLINES),
        ):
            if not least <= value <= most:
                remedy = f"give a number from {least} to {most}"
                raise DeclarationError(f"{value} is out of range", where=option, remedy=remedy)


@dataclass(frozen=True, eq=False)
class FoundStructure:
    """The structure that was found.

    Attributes
    ----------
    aircraft : with the terms found, in addition to the baseline if there is one.
    selections : by coefficient.
    other : selections by the other method.
    collinearity : by coefficient.
    histories : of each maneuver.
    files : that were read.
    predicted : R2 by record and coefficient of records that were not fitted.
    """

    aircraft: Aircraft
    selections: Mapping[str, Selection]
    other: Mapping[str, Selection]
    collinearity: Mapping[str, Collinearity]
    histories: tuple[Histories, ...]
    files: tuple[InputFile, ...]
    options: StructureOptions
    notes: tuple[str, ...] = ()
    predicted: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviation of each value by parameter."""
        return {
            f"{axis}_{term.label}": float(sigma)
            for axis, found in self.selections.items()
            for term, sigma in zip(found.terms, found.sigma, strict=True)
        }


def structure_of_files(request: Request, options: StructureOptions) -> FoundStructure:
    """Read the records and the vehicle file of a request, and find the terms.

    Raises
    ------
    DeclarationError, RecordError : one line.
    """
    first = request.records[0]
    given = request.vehicle
    if given is None:
        path = first if isinstance(first, Path) else first.path
        given = path.parent / VEHICLE_FILE_NAME
        if not given.is_file():
            raise DeclarationError(
                "no vehicle file is named", where="--vehicle", remedy="name one of model aircraft"
            )
    source = with_plain_terms(read_toml_source(given))
    aircraft, _ = read_aircraft(source)
    refuse_duplicates((*request.records, *request.validate))
    sources = read_record_files(request.records)
    fitted, notes = _prepared(sources, aircraft, request)
    refuse_other_units(fitted, aircraft)
    if options.terms is None:
        refuse_moving_together(fitted, aircraft, [separate_controls(aircraft)])
    open_hold = request.plan.hold is None and not any(each.sidecar.states_hold for each in sources)
    if open_hold:
        hold, sentence = hold_of_inputs(fitted, aircraft, options.bandwidth)
        fitted, notes = tuple(with_hold(fitted, hold)), (*notes, *sentence)
    left_out = read_record_files(request.validate)
    identities = (*(each.identity for each in (*sources, *left_out)), source.identity)
    found = structure_of(fitted, aircraft, options, identities, notes)
    if not left_out:
        return found
    whole = replace(request, plan=replace(request.plan, segments=WHOLE, chosen=()))
    records, further = _prepared(left_out, aircraft, whole)
    if open_hold and not any(each.sidecar.states_hold for each in left_out):
        records = tuple(with_hold(records, hold))
    predicted = predicted_r2(found, records)
    return replace(found, predicted=predicted, notes=(*notes, *further))


def hold_of_inputs(
    records: Sequence[Record], aircraft: Aircraft, bandwidth: float = DERIVATIVE_BANDWIDTH
) -> tuple[Hold, list[str]]:
    """Return how surfaces move between samples: held, or linearly.

    The six coefficients are regressed on their linear terms under both readings. Held surfaces that
    in truth move linearly act half a sample late, which biases control and damping terms.

    Parameters
    ----------
    records : prepared, as of ``structure_of``; those that are linear already stay so.
    aircraft : airframe and surfaces.
    bandwidth : Hz, of the angular accelerations.

    Returns
    -------
    The reading to use, and sentences on the choice.

    Raises
    ------
    RecordError : a channel is missing, or no signal moves.
    """
    if any(record.hold is Hold.LINEAR for record in records):
        return Hold.LINEAR, []
    if all(held_by_computer(record) for record in records):
        return Hold.PREVIOUS, []
    readings = [
        [coefficients_of(record, aircraft, bandwidth) for record in with_hold(records, hold)]
        for hold in (Hold.PREVIOUS, Hold.LINEAR)
    ]
    terms = (Term(), *_products(readings[0], aircraft, 1))
    held, linear = (_linear_residuals(each, terms) for each in readings)
    gain = log_likelihood_gain(held, linear, [np.ones(each.shape, dtype=bool) for each in held])
    if gain >= DECISIVE_LOG_LIKELIHOOD_RATIO:
        return Hold.LINEAR, [
            "inputs linear between samples: linear terms explain the coefficients better than with "
            f"held ones (likelihood ratio test: {gain:.1f}); --hold previous holds them"
        ]
    if gain <= -DECISIVE_LOG_LIKELIHOOD_RATIO:
        return Hold.PREVIOUS, [
            "inputs held between samples: linear terms explain the coefficients better than with "
            f"linear ones (likelihood ratio test: {-gain:.1f}); --hold linear joins the samples "
            "by lines"
        ]
    return Hold.PREVIOUS, [
        "inputs held between samples: these records do not tell whether surfaces are held or move "
        "linearly; compare the values with --hold linear"
    ]


def _linear_residuals(histories: Sequence[Histories], terms: Sequence[Term]) -> list[np.ndarray]:
    """Return the residuals, ``(6, M)``, of each maneuver after regression of each coefficient on
    ``terms``.
    """
    ends = np.cumsum([len(each.time) for each in histories])[:-1]
    rows = []
    for axis in histories[0].coefficients:
        columns = np.concatenate([columns_of(each, terms, axis) for each in histories])
        measured = np.concatenate([each.coefficients[axis] for each in histories])
        size = np.linalg.norm(columns, axis=0)
        scaled = columns / np.where(size > 0.0, size, 1.0)
        rows.append(measured - scaled @ np.linalg.lstsq(scaled, measured, rcond=1e-10)[0])
    return np.split(np.array(rows), ends, axis=1)


def _prepared(
    sources: Sequence[RecordFile], aircraft: Aircraft, request: Request
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    model = aircraft_model(aircraft)
    signals = (*model.equations.inputs, *model.equations.outputs)
    choices = column_choices(request, {each.name: each.unit for each in signals})
    ready = prepare(sources, model, request.plan, choices, use_measured_airspeed=False)
    return ready.measured, ready.notes


def structure_of(
    records: Sequence[Record],
    aircraft: Aircraft,
    options: StructureOptions | None = None,
    files: Sequence[InputFile] = (),
    notes: Sequence[str] = (),
) -> FoundStructure:
    """Return the terms of each coefficient that records support.

    Parameters
    ----------
    records : one a maneuver, with the inputs of the aircraft, airspeed, alpha, beta, p, q, r and
        ax, ay, az; SI and radians.
    aircraft : airframe, surfaces and sensors; its terms are the baseline where that is requested.
    options : see `StructureOptions`.

    Returns
    -------
    FoundStructure.

    Raises
    ------
    RecordError : a channel is missing, or no signal moves.
    """
    options = options or StructureOptions()
    histories = [coefficients_of(record, aircraft, options.bandwidth) for record in records]
    axes = (*aircraft.forces, *MOMENTS)
    if options.baseline:
        histories = [_less_baseline(each, aircraft) for each in histories]
    offered = _offered(histories, aircraft, options)
    further = _products(histories, aircraft, 3)
    known: dict[tuple[bool, tuple[Term, ...]], TermColumns] = {}
    other_method = METHODS[1 - METHODS.index(options.method)]
    selections, others, together = {}, {}, {}
    for axis in axes:
        terms = tuple(offered[axis])
        key = (axis in MOMENTS, terms)
        if key not in known:
            known[key] = TermColumns.of(histories, axis, terms)
        rest = [term for term in further if term not in terms]
        found = select(
            histories,
            axis,
            terms,
            options.method,
            rest,
            known[key],
            hierarchical=options.hierarchical,
            baseline=options.baseline,
        )
        selections[axis] = found
        others[axis] = select(histories, axis, terms, other_method, (), known[key])
        at = [terms.index(term) for term in found.terms]
        columns = np.concatenate(known[key].blocks)
        surfaces = (*aircraft.surfaces, *aircraft.mixes)
        together[axis] = replace(
            collinearity_of(axis, found.terms, columns[:, at], surfaces),
            multiples=multiples_of(terms, columns, found.terms),
        )
    base = aircraft.coefficients if options.baseline else {}
    terms_found = {axis: _sum(base.get(axis, {}), selections[axis].table) for axis in axes}
    return FoundStructure(
        replace(aircraft, coefficients=terms_found),
        selections,
        others,
        together,
        tuple(histories),
        tuple(files),
        options,
        tuple(notes),
    )


def predicted_r2(found: FoundStructure, records: Sequence[Record]) -> dict[str, dict[str, float]]:
    """Return R2 of the coefficients of maneuvers that a structure was not fitted to.

    Parameters
    ----------
    found : the structure.
    records : as of ``structure_of``.

    Returns
    -------
    R2 by name of the record and coefficient: 1 - sum (z - y)^2 / sum (z - mean z)^2.

    Raises
    ------
    RecordError : a channel is missing or half of it is.
    """
    r2: dict[str, dict[str, float]] = {}
    for record in records:
        history = coefficients_of(record, found.aircraft, found.options.bandwidth)
        r2[record.name] = {}
        for axis, terms in found.aircraft.coefficients.items():
            measured = history.coefficients[axis]
            model = sum(value * history.column(term, axis) for term, value in terms.items())
            spread = float(np.sum((measured - measured.mean()) ** 2))
            error = float(np.sum((measured - model) ** 2))
            r2[record.name][axis] = 1.0 - error / spread if spread > 0.0 else 0.0
    return r2


def coefficients_of(
    record: Record, aircraft: Aircraft, bandwidth: float = DERIVATIVE_BANDWIDTH
) -> Histories:
    """Return the coefficient histories of a record.

    Raises
    ------
    RecordError : a channel is missing or half of it is.
    """
    names = (*record.input_names, *record.output_names)
    for name in (*NEEDED_CHANNELS, *aircraft.surfaces):
        if name not in names:
            raise RecordError(
                f"it has no {name}", where=record.name, remedy="map its column with --channels"
            )
    thrust: np.ndarray | float = 0.0
    signal = aircraft.thrust.signal
    if signal:
        if signal not in names:
            remedy = f'map the column of {signal}, or write [thrust] input = "none" for a glider'
            raise RecordError(f"it has no {signal}", where=record.name, remedy=remedy)
        thrust = record[signal].values
        if signal == "throttle":
            thrust = np.interp(thrust, *aircraft.thrust.table)
    channels = {
        name: filled(record[name].values, record[name].valid, name, record.name)
        for name in NEEDED_CHANNELS
    }
    moved = {name: record[name].values for name in aircraft.surfaces}
    for name, parts in aircraft.mixes.items():
        moved[name] = np.sum([factor * moved[part] for part, factor in parts.items()], axis=0)
    varying = {name: record[name].values for name in aircraft.varying}
    sensors = {name: aircraft.sensors[name] for name in SENSORS if name in aircraft.sensors}
    airframe = Airframe(
        {**aircraft.constants, **varying}, sensors, wind_axes="CL" in aircraft.forces
    )
    held = record.hold is Hold.PREVIOUS
    return histories_of(
        record.name, record.time, channels, airframe, moved, thrust, bandwidth, held=held
    )


def _less_baseline(history: Histories, aircraft: Aircraft) -> Histories:
    """Return coefficients minus the declared ones, whose signals add noise."""
    base = aircraft.coefficients
    left = {
        axis: row - sum(value * history.column(t, axis) for t, value in base[axis].items())
        for axis, row in history.coefficients.items()
    }
    slopes = {axis: {**history.slopes.get(axis, {})} for axis in left}
    for axis, table in base.items():
        columns = noise_columns(history, tuple(table))
        through = columns @ np.array(list(table.values()))
        for row, (name, std) in zip(through, history.signal_noise.items(), strict=True):
            if std > 0.0:
                slopes[axis][name] = slopes[axis].get(name, 0.0) - row / std
    return replace(history, coefficients=left, slopes=slopes)


def _sum(first: Mapping[Term, float], second: Mapping[Term, float]) -> dict[Term, float]:
    return {t: first.get(t, 0.0) + second.get(t, 0.0) for t in dict.fromkeys((*first, *second))}


def _offered(
    histories: Sequence[Histories], aircraft: Aircraft, options: StructureOptions
) -> dict[str, list[Term]]:
    """Return the terms offered to each coefficient, the constant first."""
    axes = (*aircraft.forces, *MOMENTS)
    if options.terms is not None:
        return _of_file(options.terms, aircraft)
    terms = _products(histories, aircraft, options.degree)
    moved = _moved(histories, aircraft)
    if "beta" in moved:
        terms.append(parse_term("abs(beta)", aircraft.signals))
    if options.splines and "alpha" in moved:
        alpha = np.concatenate([h.samples["alpha"] for h in histories])
        shares = np.linspace(0.0, 1.0, options.splines + 2)[1:-1]
        for knot in np.quantile(alpha, shares):
            terms.append(parse_term(f"spline(alpha, {knot:.4g}, 1)", aircraft.signals))
    magnitudes = [
        parse_term(f"abs({name})", aircraft.signals)
        for name in separate_controls(aircraft)
        if name in moved
    ]
    return {axis: [Term(), *terms, *(magnitudes if axis in DRAG else ())] for axis in axes}


def _of_file(path: Path, aircraft: Aircraft) -> dict[str, list[Term]]:
    content = toml_of(read_toml_source(path))
    axes = (*aircraft.forces, *MOMENTS)
    offered: dict[str, list[Term]] = {axis: [Term()] for axis in axes}
    for axis, texts in content.items():
        where = f"{path}, key {axis}"
        if axis not in axes:
            remedy = closest(axis, axes) if axis not in AXES else f"use {', '.join(axes)}"
            raise DeclarationError(f"there is no coefficient {axis}", where=where, remedy=remedy)
        if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
            remedy = f'write {axis} = ["alpha", "alpha*elevator"]'
            raise DeclarationError("this is no list of terms", where=where, remedy=remedy)
        for text in texts:
            term = parse_term(text, aircraft.signals, where)
            if term not in offered[axis]:
                offered[axis].append(term)
    return offered


def _moved(histories: Sequence[Histories], aircraft: Aircraft) -> list[str]:
    """Return the signals that moved. Raises RecordError if there are none."""
    mixed = {part for parts in aircraft.mixes.values() for part in parts}
    moved = []
    for name in aircraft.signals:
        if name in mixed:
            continue
        values = np.concatenate([h.samples[name] for h in histories])
        least = 0.03 if name == "mach" else _UNMOVED_SHARE
        if np.ptp(values) > least:
            moved.append(name)
    if not moved:
        raise RecordError(
            "no signal moves in these records",
            where=histories[0].name,
            remedy="give records of maneuvers",
        )
    return moved


def _products(histories: Sequence[Histories], aircraft: Aircraft, degree: int) -> list[Term]:
    """Return products of the signals that moved; above degree 2 powers and those with alpha."""
    moved = _moved(histories, aircraft)
    found: list[Term] = []
    for power in range(1, degree + 1):
        for signals in combinations_with_replacement(moved, power):
            kinds = set(signals)
            if power > 2 and len(kinds) > 1 and "alpha" not in kinds:
                continue
            found.append(parse_term("*".join(signals), aircraft.signals))
    return found
