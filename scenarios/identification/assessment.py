"""Result of an identification and its assessment: parameters at bounds, intervals, simulations, and
the change with the other hold of the inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.flying_qualities.modes import Characteristics
from ident.statistics.intervals import variance_along
from ident.statistics.profile_likelihood import ProfileInterval
from ident.statistics.residuals import ErrorFigures, ResidualTest, error_figures
from ident.tracing.diagnosis import Trained
from ident.whole_record.gauss_newton import fit_whole_records
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.output_error import cut_into_pieces
from ident.whole_record.output_error import join_pieces as of_pieces
from scenarios.files.declarations import closest
from scenarios.files.user_models import side_at
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.model_checks import Considered
from scenarios.preparation.declared_model import DECISIVE_LOG_LIKELIHOOD_RATIO
from scenarios.preparation.filtering import PartedRecord, parts_of, put_together
from scenarios.preparation.recording import NOTHING_SEEN, RecordCheck, repeated_without_outliers
from scenarios.report.document import BY_ROW, SIGMAS, Column, Table, estimate, formatted, table
from scenarios.studies.declaration import Row
from sim.declaration.model import Model, System
from sim.errors import DeclarationError
from sim.record import Hold, Record

# ---- Parameters that end at a bound, and parameters that follow others


@dataclass(frozen=True)
class AtBound:
    """A parameter that a fit pressed against its ``"lower"`` or ``"upper"`` bound."""

    name: str
    value: float
    unit: str
    side: str

    @property
    def words(self) -> str:
        """Sentence such as ``"Cm_q is at its lower bound, -30 1/rad"``."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} is at its {self.side} bound, {self.value:g}{unit}"


def fit_within_bounds(
    model: Model, fit: Callable[[Model], tuple[System, Estimate]], *, respected: bool = True
) -> tuple[Model, System, Estimate, tuple[AtBound, ...]]:
    """Fit a model; fix parameters that end at a bound, and estimate the others again.

    The sigmas are then those of the free parameters. The outcome is ``AT_BOUND`` if a parameter is
    at a bound and the others converged. ``respected``: whether the method has bounds.

    Returns
    -------
    The model with fixed parameters, its system, the estimate, and the parameters at bounds.
    """
    system, estimate = fit(model)
    at_bounds: list[AtBound] = []
    while respected and (pressed := _pressed(model, estimate)):
        if len(pressed) == sum(name in model.parameters for name in estimate.names):
            break  # no parameter would stay free
        at_bounds += pressed
        finite = {
            name: value
            for name, value in estimate.as_dict().items()
            if name in model.parameters and np.isfinite(value)
        }
        parameters = model.parameters.with_values(
            {**finite, **{parameter.name: parameter.value for parameter in pressed}}
        )
        model = model.with_parameters(parameters.hold([parameter.name for parameter in pressed]))
        system, estimate = fit(model)
    if at_bounds and estimate.outcome is Outcome.CONVERGED:
        estimate = replace(estimate, outcome=Outcome.AT_BOUND)
    return model, system, estimate, tuple(at_bounds)


def tied_rows(model: Model, estimate: Estimate) -> tuple[Row, ...]:
    """Return a row for each tied parameter; its sigma follows from those of its sources."""
    rows = []
    values: Mapping[str, float] = {
        **{item.name: item.value for item in model.parameters},
        **estimate.as_dict(),
    }
    for tie in model.ties:
        slope = np.zeros(len(estimate.names))
        for source, factor in tie.terms:
            if source in estimate.names:
                slope[estimate.names.index(source)] += factor
        std = float(np.sqrt(variance_along(estimate.covariance, slope[None])[0]))
        rows.append(
            Row(tie.name, model.parameters[tie.name].unit, float(tie.of(values.__getitem__)), std)
        )
    return tuple(rows)


def _pressed(model: Model, estimate: Estimate) -> list[AtBound]:
    return [
        AtBound(name, item.bounds[0 if side == "lower" else 1], item.unit, side)
        for name, value in estimate.as_dict().items()
        if name in model.parameters and np.isfinite(value)
        for item in (model.parameters[name],)
        if (side := side_at(value, item.bounds))
    ]


# ---- Profile-likelihood intervals of an identification

# Methods with a likelihood of whole records.
PROFILED = ("output-error", "filter-error", "frequency-domain")
SETTLED = (Outcome.CONVERGED, Outcome.AT_BOUND)


def refuse_profile(method: str) -> None:
    """Raise DeclarationError if a method has no likelihood of whole records."""
    if method not in PROFILED:
        what = f"{method} has no likelihood of whole records that a profile could follow"
        raise DeclarationError(
            what, where="--profile", remedy=f"use --method {' or '.join(PROFILED)}"
        )


def chosen_names(
    wanted: Sequence[str], estimate: Estimate, held: Collection[str] = ()
) -> tuple[str, ...]:
    """Return the wanted parameters; all estimated parameters if ``wanted`` is empty.

    Raises DeclarationError for a parameter that is not estimated; ``held`` are not.
    """
    estimated_names = [name for name in estimate.names if not name.startswith("bias_")]
    for name in wanted:
        if name not in estimated_names and name in held:
            what = f"{name} is fixed, tied or at its bound: no interval is its own"
            raise DeclarationError(
                what, where="--profile", remedy=f"use one of {', '.join(estimated_names)}"
            )
        if name not in estimated_names:
            raise DeclarationError(
                f"no parameter {name!r} is estimated",
                where="--profile",
                remedy=closest(name, estimated_names),
            )
    return tuple(wanted) or tuple(estimated_names)


def profiled(
    estimate: Estimate,
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    wanted: Sequence[str],
    *,
    without_noise: System | None = None,
    local: Collection[str] = (),
    delays: Mapping[str, str] | None = None,
    band: tuple[float, float] | None = None,
) -> tuple[ProfileInterval, ...]:
    """Return profile-likelihood intervals; none if the estimate has not converged.

    The fit is repeated from the estimate, which takes one or two iterations.

    Parameters
    ----------
    system : the system that was estimated.
    wanted : parameters; empty: all.
    without_noise : for filter error, the system without process noise.
    local : parameters with a separate value for each record.
    delays : for the frequency domain, delay parameter by input.
    band : for the frequency domain, Hz.
    """
    names = chosen_names(
        wanted, estimate, [item.name for item in system.parameters if not item.free]
    )
    if estimate.outcome not in SETTLED:
        return ()
    known = {name: value for name, value in estimate.as_dict().items() if name in system.parameters}
    names = tuple(name for name in names if name in known)
    n = [estimate.names.index(name) for name in estimate.names if name in known]
    covariance = estimate.covariance[:, n][n]
    # Priors are about the starts of the file: only a fit without priors may start elsewhere.
    start_system = (
        system
        if settings.use_priors
        else replace(system, parameters=system.parameters.with_values(known))
    )
    if estimate.method == "frequency-domain":
        from ident.frequency_domain import output_error as frequency
        from ident.frequency_domain.output_error import FrequencySettings, frequency_fit

        found, _ = frequency_fit(
            records, start_system, FrequencySettings(band, settings.use_priors), delays=delays
        )
        return () if found is None else frequency.profile_intervals(found, names, covariance)
    from ident.whole_record.gauss_newton import profile_intervals

    pieces = cut_into_pieces(records, without_noise or system, settings, local)
    layout = lay_out([*chain.from_iterable(pieces)], start_system, settings, local=local)
    if estimate.method == "filter-error":
        from ident.process_noise.best_start import fit_from_best_start as fit_with_filter
        from ident.process_noise.innovations_model import noise_started_at

        fit = fit_with_filter(layout, without_noise)
        return () if fit is None else profile_intervals(fit, names, covariance, noise_started_at)
    from ident.whole_record.output_error import fit_from_best_start

    fit = fit_from_best_start(layout)
    return () if fit is None else profile_intervals(fit, names, covariance)


# ---- Values of an estimate for the prediction of other records


def values_for_prediction(
    system: System, values: Mapping[str, float], settings: FitSettings
) -> Trained:
    """Return the parameter values for the free simulation of another record.

    ``values`` if given, else those of the system.
    """
    all_values = {item.name: float(values.get(item.name, item.value)) for item in system.parameters}
    biases = {name: value for name, value in all_values.items() if name.startswith("bias_")}
    shared = {name: value for name, value in all_values.items() if name not in biases}
    return Trained((), system.output_names, shared, (biases,), settings)


# ---- Free simulations of records with parameters as estimated


@dataclass(frozen=True, eq=False)
class RecordFit:
    """A record and its free simulation, to which only initial state and biases were fitted.

    Attributes
    ----------
    record : the record.
    outputs : the simulated outputs.
    simulated : shape ``(m, N)``; NaN if the simulation diverged.
    figures : error figures of the outputs that the record has; None if the simulation diverged.
    held_out : whether the record took no part in the estimate.
    """

    record: Record
    outputs: tuple[str, ...]
    simulated: np.ndarray
    figures: ErrorFigures | None
    held_out: bool


def record_fits(
    fitted: Sequence[Record],
    held_out: Sequence[Record],
    system: System,
    values: Mapping[str, float],
    settings: FitSettings,
    local: Collection[str] = (),
    known: Sequence[np.ndarray] = (),
    *,
    trusted: bool = False,
) -> tuple[RecordFit, ...]:
    """Simulate each record with given parameters; initial states and biases are fitted to it.

    Parameters
    ----------
    fitted : records of the estimate.
    held_out : other records.
    values : parameter values.
    local : further parameters that are fitted to each record.
    known : simulations of the first fitted records, ``(m, N)``, which are not repeated.
    trusted : whether wild points of ``held_out`` are kept. They would change initial states and
        biases.

    Returns
    -------
    The simulations, those of the fitted records first.
    """

    def run(records: Sequence[Record]) -> list[np.ndarray | None]:
        return [simulated(record, system, values, settings, local) for record in records]

    fitted_rows = [*known, *run(fitted[len(known) :])]

    def finite(predicted: Sequence[np.ndarray | None]) -> tuple[tuple[str, ...], list[np.ndarray]]:
        return system.output_names, [
            np.full((len(system.outputs), len(record)), np.nan) if rows is None else rows
            for record, rows in zip(held_out, predicted, strict=True)
        ]

    predicted, kept, _ = repeated_without_outliers(
        run, finite, held_out, 0 if trusted or not held_out else 2
    )
    return tuple(
        _assessed(record, system, rows, held_out=is_held_out)
        for records, simulations, is_held_out in (
            (fitted, fitted_rows, False),
            (kept, predicted, True),
        )
        for record, rows in zip(records, simulations, strict=True)
    )


def pooled_fits(fits: Sequence[RecordFit], parted: Sequence[PartedRecord]) -> tuple[RecordFit, ...]:
    """Return the simulations with the parts of each predicted record put together.

    The error figures are those of all parts of a record.
    """
    fitted = [fit for fit in fits if not fit.held_out]
    parts = [fit for fit in fits if fit.held_out]
    spans = parts_of(parted, [fit.record for fit in parts])
    return (*fitted, *(_whole(parted_record, parts[span]) for parted_record, span in spans))


def _whole(parted: PartedRecord, parts: Sequence[RecordFit]) -> RecordFit:
    record, (rows,) = put_together(
        parted, [part.record for part in parts], [[part.simulated for part in parts]]
    )
    if len(parts) == 1 and len(record) == len(parts[0].record):
        return replace(parts[0], record=record)
    if any(part.figures is None for part in parts):
        return replace(parts[0], record=record, simulated=np.full_like(rows, np.nan), figures=None)
    return _with_figures(record, parts[0].outputs, rows, held_out=parts[0].held_out)


def _assessed(
    record: Record, system: System, rows: np.ndarray | None, *, held_out: bool
) -> RecordFit:
    """Return a simulation, ``(m, N)`` or None, with its error figures."""
    if rows is None:
        blank = np.full((len(system.outputs), len(record)), np.nan)
        return RecordFit(record, system.output_names, blank, None, held_out)
    return _with_figures(record, system.output_names, rows, held_out=held_out)


def _with_figures(
    record: Record, outputs: tuple[str, ...], rows: np.ndarray, *, held_out: bool
) -> RecordFit:
    channels = tuple(name for name in outputs if name in record.output_names)
    masks = np.array([record[name].valid for name in channels])
    at = [outputs.index(name) for name in channels]
    figures = error_figures([rows[at]], [record], [masks], channels)
    return RecordFit(record, outputs, rows, figures, held_out)


def simulated(
    record: Record,
    system: System,
    values: Mapping[str, float],
    settings: FitSettings,
    local: Collection[str] = (),
) -> np.ndarray | None:
    """Return the outputs of a free simulation of a record, ``(m, N)``; None if they are not finite.

    Biases and the parameters ``local`` are fitted to the record. An unstable motion is simulated in
    pieces, as in a fit.
    """
    shared = {
        name: value
        for name, value in values.items()
        if name in system.parameters and not name.startswith("bias_") and name not in local
    }
    with_values = replace(system, parameters=system.parameters.with_values(shared))
    fitted_names = [
        name for name in system.parameters.free_names if name.startswith("bias_") or name in local
    ]
    frozen = replace(with_values, parameters=with_values.parameters.only_free(fitted_names))
    pieces = cut_into_pieces([record], with_values, settings, local)
    fit = fit_whole_records(
        FitProblem(lay_out(pieces[0], frozen, replace(settings, use_priors=False), local=local))
    )
    return None if fit is None else of_pieces([line.y for line in fit.linearisations], pieces)[0]


# ---- The same identification with the other hold of the inputs

WORDS = {Hold.PREVIOUS: "held", Hold.LINEAR: "linear"}
MOVED_SIGMAS = 1.0  # a parameter that moves by more sigmas depends on the hold


@dataclass(frozen=True, eq=False)
class OtherReading:
    """Changes of a result if the inputs are read with the other hold between samples.

    Attributes
    ----------
    used : hold that was used.
    other : the other hold.
    moved : derivatives that differ by more than one sigma, as pairs of rows (used, other).
    gain : twice the log likelihood ratio of the other hold to the used one, for the effective
        number of samples.
    """

    used: Hold
    other: Hold
    moved: tuple[tuple[Row, Row], ...]
    gain: float

    @property
    def decided(self) -> bool:
        """Whether the data prefer the hold that was used."""
        return self.gain <= -DECISIVE_LOG_LIKELIHOOD_RATIO

    @property
    def decision(self) -> str:
        """Sentence on the hold that the data prefer, with the test."""
        return (
            f"inputs are {WORDS[self.used]} between samples: {WORDS[self.other]} inputs fit worse "
            f"(likelihood ratio test: {-self.gain:.1f}, "
            f"{DECISIVE_LOG_LIKELIHOOD_RATIO:g} needed); --hold {self.other.value} "
            "selects them all the same"
        )

    @property
    def sentence(self) -> str:
        """Sentence that derivatives depend on the hold, with the option that selects the other."""
        names = ", ".join(row.name for row, _ in self.moved)
        how = "as well" if abs(self.gain) < 0.05 else "better" if self.gain > 0.0 else "worse"
        fits = f"fits {how} (likelihood ratio test: {self.gain:+.1f})"
        return (
            f"{names}: changes by more than one sigma if inputs are {WORDS[self.other]} between "
            f"samples, which {fits}; "
            f"inputs were read as {WORDS[self.used]}; --hold {self.other.value} selects the other "
            "reading"
        )


def opposite(hold: Hold) -> Hold:
    """Return the other hold of inputs between samples."""
    return Hold.LINEAR if hold is Hold.PREVIOUS else Hold.PREVIOUS


def other_reading(
    used: Hold, rows: Sequence[Row], other_rows: Sequence[Row], gain: float
) -> OtherReading | None:
    """Return the changes with the other hold; None if no derivative changes by more than a sigma.

    ``rows``: with the hold ``used``. ``other_rows``: with the other hold. ``gain``: as in the
    result.
    """
    by_name = {row.name: row for row in other_rows}
    pairs = [(row, by_name[row.name]) for row in rows if row.name in by_name]
    moved = tuple(
        (row, new)
        for row, new in pairs
        if abs(new.estimate - row.estimate) > MOVED_SIGMAS * row.std > 0.0
    )
    return OtherReading(used, opposite(used), moved, gain) if moved else None


def reading_table(caption: str, reading: OtherReading) -> Table:
    """Return a table with the values by both holds, a row for each derivative that changes."""
    rows = reading.moved
    moves = [(new.estimate - row.estimate) / row.std for row, new in rows]
    return table(
        caption,
        (Column("derivative"), [row.name for row, _ in rows]),
        (
            Column(f"{WORDS[reading.used]} (used)", BY_ROW, together=True),
            [estimate(row.estimate, row.std) for row, _ in rows],
        ),
        (
            Column(WORDS[reading.other], BY_ROW, together=True),
            [estimate(new.estimate, new.std) for _, new in rows],
        ),
        (Column("moved by", SIGMAS), [formatted(move, "+.1f") for move in moves]),
        units=[row.unit for row, _ in rows],
    )


def reading_content(reading: OtherReading) -> dict[str, Any]:
    """Return both holds and the values by each as content of ``comparison.json``."""
    return {
        "used": reading.used.value,
        "other": reading.other.value,
        "log_likelihood_gain": 0.5 * reading.gain,
        "parameters": {
            row.name: {
                reading.used.value: {"estimate": row.estimate, "std": row.std},
                reading.other.value: {"estimate": new.estimate, "std": new.std},
                "unit": row.unit,
            }
            for row, new in reading.moved
        },
    }


# ---- Result of an identification


@dataclass(frozen=True, eq=False, repr=False)
class IdentificationResult:
    """Result of an identification from measured records.

    Attributes
    ----------
    record : the first fitted record.
    vehicle : the vehicle file.
    method : name of the method.
    estimate : values and covariance of all unknowns.
    rows : rows of the estimated parameters.
    biases : rows of the sensor biases.
    derived : value and sigma of modal quantities and of a delay.
    fixed : value and unit of each fixed parameter.
    tests : tests of the residuals.
    others : further fitted records.
    notes : sentences on the preparation of the records and on the fit.
    doubts : sentences on likely faults of the files.
    cautions : sentences on likely faults of the result.
    reading : changes with the other hold of the inputs; None if they are below one sigma, or if
        only one hold was tried.
    decided : the same, if the data prefer one hold.
    look : check of the raw columns.
    modes : modes for levels of flying qualities; None if the model has none.
    system : the compiled model.
    tied : rows of the tied parameters.
    at_bounds : parameters at a bound, which are not among ``rows``.
    intervals : profile-likelihood intervals, if requested.
    fits : each record simulated with the estimate, held-out records last.
    band : band of a fit in the frequency domain, Hz.
    trained : values for the prediction of another record.
    engine : ``name`` and ``sentence`` of the filter's engine; empty without a filter.
    considered : contribution of uncertain constants to the sigmas; None if all are exact.
    """

    record: Record
    vehicle: VehicleFile
    method: str
    estimate: Estimate
    rows: tuple[Row, ...]
    biases: tuple[Row, ...]
    derived: dict[str, tuple[float, float]]
    fixed: dict[str, tuple[float, str]]
    tests: tuple[ResidualTest, ...]
    others: tuple[Record, ...] = ()
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    cautions: tuple[str, ...] = ()
    reading: OtherReading | None = None
    decided: OtherReading | None = None
    look: RecordCheck = NOTHING_SEEN
    modes: Characteristics | None = None
    system: System | None = None
    tied: tuple[Row, ...] = ()
    at_bounds: tuple[AtBound, ...] = ()
    intervals: tuple[ProfileInterval, ...] = ()
    fits: tuple[RecordFit, ...] = ()
    band: tuple[float, float] | None = None
    trained: Trained | None = None
    engine: Mapping[str, Any] = field(default_factory=dict)
    considered: Considered | None = None

    @property
    def units(self) -> dict[str, str]:
        """Unit of each output that a fitted record has."""
        records = (self.record, *self.others)
        return {channel.name: channel.unit for record in records for channel in record.outputs}

    def __repr__(self) -> str:
        return (
            f"<Identification: {self.vehicle.model} model of {self.vehicle.name} from "
            f"{self.record!r}: {self.estimate!r}>"
        )


@dataclass(frozen=True)
class Options:
    """Options of an identification.

    Attributes
    ----------
    profile : parameters that get a profile-likelihood interval; empty: all; None: none.
    band : band of a fit in the frequency domain, Hz; None: from the data.
    engine : engine of the extended Kalman filter, a key of ``ident.banks.engines.ENGINES``; None:
        filterpy for a single filter, batched for a bank.
    """

    profile: tuple[str, ...] | None = None
    band: tuple[float, float] | None = None
    engine: str | None = None


DEFAULT_OPTIONS = Options()
