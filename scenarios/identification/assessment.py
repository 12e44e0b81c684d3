"""Result of an identification and its assessment: bounds, intervals, predictions, inputs read
otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.flying_qualities.modes import Characteristics
from ident.recording.series import Certainty, FindingQuantity, Kind, RecordFinding, shown
from ident.statistics.intervals import ProfileInterval, variance_along
from ident.statistics.noise_levels import input_edges, isolated_wrong
from ident.statistics.residuals import ErrorFigures, ResidualTest, error_figures
from ident.tracing.diagnosis import Trained
from ident.whole_record.gauss_newton import fit_whole_records
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.output_error import in_pieces
from ident.whole_record.output_error import put_together as of_pieces
from scenarios.files.declarations import closest
from scenarios.files.user_models import side_at
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.model_checks import Considered
from scenarios.preparation.declared_model import DECISIVE_LOG_LIKELIHOOD_RATIO
from scenarios.preparation.filtering import PartedRecord, parts_of, put_together
from scenarios.preparation.recording import NOTHING_SEEN, HandledFinding, RecordCheck
from scenarios.report.document import BY_ROW, SIGMAS, Column, Table, estimate, formatted, table
from scenarios.studies.published import Row
from sim.declaration.model import Model, System
from sim.errors import DeclarationError, instant
from sim.record import Channel, Hold, Record

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
        """``"Cm_q is at its lower bound, -30 1/rad"``."""
        return (
            f"{self.name} is at its {self.side} bound, "
            f"{self.value:g}{'' if self.unit == '1' else f' {self.unit}'}"
        )


def within_bounds(
    model: Model, estimated: Callable[[Model], tuple[System, Estimate]], *, kept: bool = True
) -> tuple[Model, System, Estimate, tuple[AtBound, ...]]:
    """Return estimate and model with parameters at bounds fixed, the others estimated again.

    The sigmas are then those of the free parameters. The outcome is ``AT_BOUND`` if a parameter is
    at a bound and the others converged. ``kept``: the method respects bounds.
    """
    system, estimate = estimated(model)
    found: list[AtBound] = []
    while kept and (pressed := _pressed(model, estimate)):
        if len(pressed) == sum(name in model.parameters for name in estimate.names):
            break  # nothing would be left to estimate
        found += pressed
        sound = {
            name: value
            for name, value in estimate.as_dict().items()
            if name in model.parameters and np.isfinite(value)
        }
        parameters = model.parameters.with_values(
            {**sound, **{each.name: each.value for each in pressed}}
        )
        model = model.with_parameters(parameters.hold([each.name for each in pressed]))
        system, estimate = estimated(model)
    if found and estimate.outcome is Outcome.CONVERGED:
        estimate = replace(estimate, outcome=Outcome.AT_BOUND)
    return model, system, estimate, tuple(found)


def tied_rows(model: Model, estimate: Estimate) -> tuple[Row, ...]:
    """Return a row for each parameter that follows others, its sigma from theirs."""
    rows = []
    known: Mapping[str, float] = {
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
            Row(tie.name, model.parameters[tie.name].unit, float(tie.of(known.__getitem__)), std)
        )
    return tuple(rows)


def _pressed(model: Model, estimate: Estimate) -> list[AtBound]:
    out = []
    for name, value in estimate.as_dict().items():
        if name not in model.parameters or not np.isfinite(value):
            continue
        item = model.parameters[name]
        side = side_at(value, item.bounds)
        if side:
            out.append(AtBound(name, item.bounds[0 if side == "lower" else 1], item.unit, side))
    return out


# ---- Profile-likelihood intervals of an identification

# methods with a likelihood of whole records
PROFILED = ("output-error", "filter-error", "frequency-domain")
SETTLED = (Outcome.CONVERGED, Outcome.AT_BOUND)


def refuse_profile(method: str) -> None:
    """Raise DeclarationError if a method has no likelihood to be followed."""
    if method not in PROFILED:
        what = f"{method} has no likelihood of whole records that a profile could follow"
        raise DeclarationError(
            what, where="--profile", remedy=f"use --method {' or '.join(PROFILED)}"
        )


def chosen_names(
    wanted: Sequence[str], estimate: Estimate, held: Collection[str] = ()
) -> tuple[str, ...]:
    """Return the parameters asked for, all where none is named. Raises DeclarationError for one
    that is not estimated, as those that are ``held``.
    """
    known = [name for name in estimate.names if not name.startswith("bias_")]
    for name in wanted:
        if name not in known and name in held:
            what = f"{name} is fixed, tied or at its bound: no interval is its own"
            raise DeclarationError(what, where="--profile", remedy=f"use one of {', '.join(known)}")
        if name not in known:
            raise DeclarationError(
                f"no parameter {name!r} is estimated",
                where="--profile",
                remedy=closest(name, known),
            )
    return tuple(wanted) or tuple(known)


def profiled(
    estimate: Estimate,
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    wanted: Sequence[str],
    *,
    calm: System | None = None,
    local: Collection[str] = (),
    delays: Mapping[str, str] | None = None,
    band: tuple[float, float] | None = None,
) -> tuple[ProfileInterval, ...]:
    """Return the intervals of the parameters ``wanted`` (all where none is named) of a settled
    estimate; none if it did not settle.

    ``system`` is the one that was estimated; ``calm`` (filter error) the same without forcing;
    ``delays`` and ``band`` (frequency domain). The fit is made once more from what it found, which
    takes a step or two.
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
    if estimate.method == "frequency-domain":
        from ident.frequency_domain import output_error as frequency
        from ident.frequency_domain.output_error import FrequencySettings, frequency_fit

        # Priors stay where the file's starts are: only a fit without them may begin elsewhere.
        start_system = (
            system
            if settings.use_priors
            else replace(system, parameters=system.parameters.with_values(known))
        )
        found, _ = frequency_fit(
            records, start_system, FrequencySettings(band, settings.use_priors), delays=delays
        )
        return () if found is None else frequency.profile_intervals(found, names, covariance)
    from ident.whole_record.gauss_newton import profile_intervals

    pieces = [
        piece for each in in_pieces(records, calm or system, settings, local) for piece in each
    ]
    start_system = (
        system
        if settings.use_priors
        else replace(system, parameters=system.parameters.with_values(known))
    )
    layout = lay_out(pieces, start_system, settings, local=local)
    if estimate.method == "filter-error":
        from ident.process_noise.best_start import fit_from_best_start as fit_with_filter
        from ident.process_noise.innovations_model import noise_started_at

        fit = fit_with_filter(layout, calm)
        return () if fit is None else profile_intervals(fit, names, covariance, noise_started_at)
    from ident.whole_record.output_error import fit_from_best_start

    fit = fit_from_best_start(layout)
    return () if fit is None else profile_intervals(fit, names, covariance)


# ---- What an estimate leaves for the prediction of other records


def trained_by(system: System, values: Mapping[str, float], settings: FitSettings) -> Trained:
    """Return the parameter values for the free simulation of another record.

    ``values`` if given, else those of the system.
    """
    known = {item.name: float(values.get(item.name, item.value)) for item in system.parameters}
    biases = {name: value for name, value in known.items() if name.startswith("bias_")}
    shared = {name: value for name, value in known.items() if name not in biases}
    return Trained((), system.output_names, shared, (biases,), settings)


# ---- Isolated wrong samples of a measured record

MOST_NAMED_TIMES = 3  # times that a sentence names


def isolated_outliers(
    outputs: Sequence[str], simulated: Sequence[np.ndarray], records: Sequence[Record]
) -> list[dict[str, np.ndarray]]:
    """Return, for each record, masks ``(N,)`` by channel that are True at its outliers, found from
    the residuals of the simulations; channels without any are left out.

    ``simulated``: ``(m, N)`` of the ``outputs`` of each record. ``records``: with all their
    samples.
    """
    out: list[dict[str, np.ndarray]] = [{} for _ in records]
    if len(simulated) != len(records):
        return out
    for row, name in enumerate(outputs if simulated else ()):
        which = [k for k, record in enumerate(records) if name in record.output_names]
        if not which:
            continue  # no record has this output
        valid = [records[k][name].valid & np.isfinite(simulated[k][row]) for k in which]
        residuals = [
            np.where(known, records[k][name].values - simulated[k][row], 0.0)
            for k, known in zip(which, valid, strict=True)
        ]
        wrong = isolated_wrong(residuals, valid, [input_edges(records[k]) for k in which])
        for k, mask in zip(which, wrong, strict=True):
            if np.any(mask):
                out[k][name] = mask
    return out


def same_points(
    some: Sequence[dict[str, np.ndarray]], others: Sequence[dict[str, np.ndarray]]
) -> bool:
    """Return whether two lists of masks name the same samples."""
    pairs = zip(some, others, strict=True)
    return all(
        a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)
        for a, b in pairs
    )


def left_out(before: Record, after: Record) -> dict[str, np.ndarray]:
    """The samples by channel, ``(N,)``, that one record has and the same record after it does not;
    channels without any are left out."""
    masks = {channel.name: before[channel.name].valid & ~channel.valid for channel in after.outputs}
    return {name: mask for name, mask in masks.items() if np.any(mask)}


def without(record: Record, masks: dict[str, np.ndarray]) -> Record:
    """Return a record with some samples of its outputs marked as missing."""
    if not masks:
        return record

    def of(channel: Channel) -> Channel:
        mask = masks.get(channel.name)
        return (
            channel
            if mask is None
            else Channel.of(channel.name, channel.unit, np.where(mask, np.nan, channel.with_gaps()))
        )

    return replace(record, outputs=tuple(map(of, record.outputs)))


def with_outliers(
    look: RecordCheck, records: Sequence[Record], masks: Sequence[dict[str, np.ndarray]]
) -> RecordCheck:
    """Return the record check with the outliers of the records added."""
    seen = [
        _seen(record, name, mask)
        for record, some in zip(records, masks, strict=True)
        for name, mask in some.items()
    ]
    return replace(look, seen=(*look.seen, *seen))


def _seen(record: Record, name: str, mask: np.ndarray) -> HandledFinding:
    times, count = record.time[mask].tolist(), int(np.count_nonzero(mask))
    places = ", ".join(f"{instant(time)} s" for time in times[:MOST_NAMED_TIMES]) + (
        " and so on" if count > MOST_NAMED_TIMES else ""
    )
    channel = record[name]
    away = np.abs(channel.values - np.median(channel.values[channel.valid]))[mask]
    told = (
        f"has {count} wild point{'s' if count > 1 else ''}, far from the samples around and from "
        f"the fit ({places})"
    )
    told += f", up to {shown(float(np.max(away)), channel.unit)} from the middle of the channel"
    numbers = {"samples": FindingQuantity(float(count), "1")}
    finding = RecordFinding(
        name,
        Kind.WILD_POINTS,
        Certainty.COSTS_INFORMATION,
        told,
        "",
        tuple((t, t) for t in times),
        numbers,
        mask,
    )
    return HandledFinding(record.name, finding, "set aside", count)


# ---- Free simulations of records with parameters as estimated


@dataclass(frozen=True, eq=False)
class RecordFit:
    """One record and its free simulation ``simulated (m, N)`` of ``outputs``; only initial state
    and biases were fitted to it.

    ``figures`` of the outputs that it has; None if the simulation left all measure.
    ``held_out``: it took no part in the estimate.
    """

    record: Record
    outputs: tuple[str, ...]
    simulated: np.ndarray
    figures: ErrorFigures | None
    held_out: bool

    def fit_percent(self, channel: str) -> float:
        """100 (1 - rms error over the spread of the measurement)."""
        assert self.figures is not None
        return 100.0 * (1.0 - self.figures.nrmse[channel])


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
    """Each record simulated with the parameters at ``values``, those that were fitted first.

    Wild points of those that were not fitted are set aside, unless they are ``trusted``: they would
    bend the initial states and biases.
    Initial states, ``bias_*`` and the parameters ``local`` to a record are fitted to it. ``known``:
    simulations ``(m, N)`` that are there already.
    """

    def run(records: Sequence[Record]) -> list[np.ndarray | None]:
        return [simulated(record, system, values, settings, local) for record in records]

    rows = [*known, *run(fitted[len(known) :])]
    out = [
        _assessed(record, system, one, held_out=False)
        for record, one in zip(fitted, rows, strict=True)
    ]
    masks: list[dict[str, np.ndarray]] = [{} for _ in held_out]
    predicted, kept = run(held_out), list(held_out)
    for _ in range(0 if trusted or not held_out else 2):
        blank = [np.full((len(system.outputs), len(record)), np.nan) for record in held_out]
        finite = [
            one if one is not None else none for one, none in zip(predicted, blank, strict=True)
        ]
        again = isolated_outliers(system.output_names, finite, held_out)
        if same_points(again, masks):
            break
        masks = again
        kept = [without(record, some) for record, some in zip(held_out, again, strict=True)]
        predicted = run(kept)
    return (
        *out,
        *(
            _assessed(record, system, one, held_out=True)
            for record, one in zip(kept, predicted, strict=True)
        ),
    )


def pooled_fits(fits: Sequence[RecordFit], parted: Sequence[PartedRecord]) -> tuple[RecordFit, ...]:
    """The fits with the parts of each record that was predicted put together: the errors are those
    of all its parts."""
    fitted, held = [fit for fit in fits if not fit.held_out], [fit for fit in fits if fit.held_out]
    return (
        *fitted,
        *(_whole(one, held[span]) for one, span in parts_of(parted, [fit.record for fit in held])),
    )


def _whole(parted: PartedRecord, parts: Sequence[RecordFit]) -> RecordFit:
    record, (rows,) = put_together(
        parted, [part.record for part in parts], [[part.simulated for part in parts]]
    )
    if len(parts) == 1 and len(record) == len(parts[0].record):
        return replace(parts[0], record=record)
    if any(part.figures is None for part in parts):
        return replace(parts[0], record=record, simulated=np.full_like(rows, np.nan), figures=None)
    outputs = parts[0].outputs
    channels = tuple(name for name in outputs if name in record.output_names)
    masks = np.array([record[name].valid for name in channels])
    figures = error_figures(
        [rows[[outputs.index(name) for name in channels]]], [record], [masks], channels
    )
    return RecordFit(record, outputs, rows, figures, parts[0].held_out)


def _assessed(
    record: Record, system: System, rows: np.ndarray | None, *, held_out: bool
) -> RecordFit:
    channels = tuple(name for name in system.output_names if name in record.output_names)
    if rows is None:
        blank = np.full((len(system.outputs), len(record)), np.nan)
        return RecordFit(record, system.output_names, blank, None, held_out)
    at = [system.output_names.index(name) for name in channels]
    masks = np.array([record[name].valid for name in channels])
    return RecordFit(
        record,
        system.output_names,
        rows,
        error_figures([rows[at]], [record], [masks], channels),
        held_out,
    )


def simulated(
    record: Record,
    system: System,
    values: Mapping[str, float],
    settings: FitSettings,
    local: Collection[str] = (),
) -> np.ndarray | None:
    """Outputs ``(m, N)`` of a free simulation; None if it is not finite. A motion that grows is
    followed in pieces, as in a fit.
    """
    known = {
        name: value
        for name, value in values.items()
        if name in system.parameters and not name.startswith("bias_") and name not in local
    }
    started = replace(system, parameters=system.parameters.with_values(known))
    own = [
        name for name in system.parameters.free_names if name.startswith("bias_") or name in local
    ]
    frozen = replace(started, parameters=started.parameters.only_free(own))
    pieces = in_pieces([record], started, settings, local)
    fit = fit_whole_records(
        FitProblem(lay_out(pieces[0], frozen, replace(settings, use_priors=False), local=local))
    )
    return None if fit is None else of_pieces([line.y for line in fit.lines], pieces)[0]


# ---- The same identification with the inputs read the other way between samples

WORDS = {Hold.PREVIOUS: "held", Hold.LINEAR: "linear"}
MOVED_SIGMAS = 1.0  # change in sigmas above which the reading matters more than noise


@dataclass(frozen=True, eq=False)
class OtherReading:
    """Result with the other reading of the inputs (held or linear between samples).

    ``used``, ``other``: the two readings. ``moved``: rows of derivatives that differ by more than
    one sigma, as pairs (used, other). ``gain``: twice the log likelihood ratio of the other to the
    used reading, for the effective number of samples.
    """

    used: Hold
    other: Hold
    moved: tuple[tuple[Row, Row], ...]
    gain: float

    @property
    def decided(self) -> bool:
        """Whether the data prefer the reading used."""
        return self.gain <= -DECISIVE_LOG_LIKELIHOOD_RATIO

    @property
    def decision(self) -> str:
        """The reading that the data chose, and by how much."""
        return (
            f"inputs are {WORDS[self.used]} between samples: {WORDS[self.other]} inputs fit worse "
            f"(likelihood ratio test: {-self.gain:.1f}, "
            f"{DECISIVE_LOG_LIKELIHOOD_RATIO:g} needed); --hold {self.other.value} "
            "selects them all the same"
        )

    @property
    def sentence(self) -> str:
        """Sentence that derivatives depend on the reading of the record, and how to choose it."""
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
    """Return the other way to read inputs between samples."""
    return Hold.LINEAR if hold is Hold.PREVIOUS else Hold.PREVIOUS


def other_reading(
    used: Hold, rows: Sequence[Row], read_otherwise: Sequence[Row], gain: float
) -> OtherReading | None:
    """Return the values that change by more than a sigma with the other reading; None without."""
    again = {row.name: row for row in read_otherwise}
    pairs = [(row, again[row.name]) for row in rows if row.name in again]
    moved = tuple(
        (row, new)
        for row, new in pairs
        if abs(new.estimate - row.estimate) > MOVED_SIGMAS * row.std > 0.0
    )
    return OtherReading(used, opposite(used), moved, gain) if moved else None


def reading_table(caption: str, reading: OtherReading) -> Table:
    """Return the values under each reading, a row for each derivative that moves."""
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
    """Return the same for ``comparison.json``: the reading used, the other, values under each."""
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


# ---- What an identification from a measured record returns


@dataclass(frozen=True, eq=False, repr=False)
class IdentificationResult:
    """Result of an identification from measured records.

    Attributes
    ----------
    rows : parameters.
    biases : sensor biases that have a sigma.
    record, others : first fitted record, and the further ones.
    notes : on the preparation of records and on the fit.
    doubts : likely faults of the files.
    cautions : likely faults of the result.
    look : check of the raw columns.
    reading : changes with the other reading of the inputs; None if below one sigma, or not tried.
    decided : the same, if the data prefer one of the two readings.
    modes : modes for levels of flying qualities, None without.
    system : the compiled model.
    tied : parameters that follow others.
    at_bounds : parameters at a bound, not among ``rows``.
    intervals : by profile likelihood, if requested.
    fits : each record simulated with the estimate, held-out ones last.
    band : Hz, of a fit in the frequency domain.
    trained : values for predicting another record.
    engine : ``name`` and ``sentence`` of the filter's engine; empty without a filter.
    considered : contribution of uncertain constants to the sigmas, None if none is stated.
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

    def __repr__(self) -> str:
        return (
            f"<Identification: {self.vehicle.model} model of {self.vehicle.name} from "
            f"{self.record!r}: {self.estimate!r}>"
        )


@dataclass(frozen=True)
class Options:
    """Options of an identification.

    ``profile``: parameters with a profile-likelihood interval, empty for all, None for none.
    ``band``: Hz, of the frequency domain; None: from the data. ``engine``: of the extended Kalman
    filter, a key of ``ident.banks.delays.ENGINES``; None: filterpy for one filter, batched for a
    bank.
    """

    profile: tuple[str, ...] | None = None
    band: tuple[float, float] | None = None
    engine: str | None = None


DEFAULT_OPTIONS = Options()
