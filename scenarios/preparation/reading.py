"""Prepare records for a fit: parts, units, gaps, filter, trim.

Also refuses records that no fit of model `aircraft` should start from.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from math import pi

import numpy as np

from ident.recording.kinematic_relations import LENGTHS
from scenarios.files.declarations import ColumnChoice
from scenarios.files.measured.columns import RecordFile, with_names
from scenarios.files.user_models import channel_units, is_own
from scenarios.preparation.declared_model import (
    DECISIVE_LOG_LIKELIHOOD_RATIO,
    better_by,
    linear_by,
    with_hold,
)
from scenarios.preparation.drafting import NEVER, recorder_names
from scenarios.preparation.filtering import (
    PartedRecord,
    filtered,
    named,
    parts_of,
    put_together,
    split_at_gaps,
)
from scenarios.preparation.measured_inputs import (
    Flow,
    able,
    about_trim,
    flow_doubts,
    flow_sentence,
    instead_of,
    measured_flow,
    of_totals,
    trim_sentence,
    unused_airspeed,
    wants_attitude,
    with_attitude,
    with_flow,
    with_load_factors,
)
from scenarios.preparation.plan import ATTITUDE, BY_HAND, WHOLE, Plan, Segment
from scenarios.preparation.recording import (
    NOTHING_SEEN,
    RecordCheck,
    checked_records,
    expectations_of,
)
from sim.aerodynamics import Term
from sim.declaration.model import Model
from sim.errors import RecordError
from sim.maths import G0
from sim.record import Channel, Hold, Record
from sim.vehicles.aircraft import Aircraft, declaration_of

LARGEST = {  # Bank is recorded from -pi to pi.
    **dict.fromkeys(("alpha", "beta", "theta"), NEVER["rad"]),
    "phi": 1.01 * pi,
    **dict.fromkeys(("p", "q", "r"), NEVER["rad/s"]),
}
# Percentile compared with a limit, so that single wrong samples do not count.
LIMIT_PERCENTILE = 97.0
# Median specific force of a flight, m/s2: about one g.
IN_G = (0.7, 1.6)  # range if it is in g
IN_FEET = (0.9 * G0 / LENGTHS["ft"], 1.1 * G0 / LENGTHS["ft"])  # range if it is in ft/s2
# Least share of a surface's motion that is independent of another's; noise alone gives more.
LEAST_UNSHARED_MOTION = 1e-6


def refuse_unfit_records(records: Sequence[Record], model: Model) -> None:
    """Raise RecordError for records that a fit of model ``aircraft`` cannot use.

    Other models are not checked.

    Parameters
    ----------
    records : of one call, SI.
    model : with its free parameters.

    Raises
    ------
    RecordError : wrong units of angles or accelerations; two surfaces with free terms in one
        coefficient that move together in all records.
    """
    aircraft = declaration_of(model)
    if aircraft is None:
        return
    refuse_other_units(records, aircraft)
    free = {item.name for item in model.parameters if item.free}
    used: dict[str, set[str]] = {}
    for name, (axis, term) in aircraft.terms.items():
        if name in free:
            used.setdefault(axis, set()).update(_surfaces_of(term, aircraft))
    refuse_moving_together(records, aircraft, list(used.values()))


def refuse_other_units(records: Sequence[Record], aircraft: Aircraft) -> None:
    """Raise RecordError if numbers show that angles or accelerations are not in SI."""
    deflections = [name for name, unit in aircraft.surfaces.items() if unit == "rad"]
    limits = {**dict.fromkeys(deflections, NEVER["rad"]), **LARGEST}
    for record in records:
        for channel in record.channels:
            limit = limits.get(channel.name)
            common = _common(channel) if limit is not None else 0.0
            if limit is not None and common > limit:
                rate = "/s" if channel.name in ("p", "q", "r") else ""
                raise RecordError(
                    f"samples are beyond {common:.3g} rad{rate}, which no aircraft "
                    "does: the column is in degrees",
                    where=f"{record.name}, channel {channel.name}",
                    remedy=f"name its unit in the header, as in {channel.name}_deg, or in a "
                    "channel map",
                )
        _refuse_accelerations(record)


def _refuse_accelerations(record: Record) -> None:
    if "az" not in record.output_names:
        return
    values = record["az"].values[record["az"].valid]
    felt = float(np.median(np.abs(values))) if len(values) else G0
    for unit, (low, high) in (("g", IN_G), ("ft/s2", IN_FEET)):
        if low < felt < high:
            raise RecordError(
                f"its median is {felt:.3g} m/s2 where the lift of level flight is 9.81 m/s2: the "
                f"column is in {unit}",
                where=f"{record.name}, channel az",
                remedy="give its unit in a channel map",
            )


def refuse_moving_together(
    records: Sequence[Record], aircraft: Aircraft, groups: Sequence[Collection[str]]
) -> None:
    """Raise RecordError if two surfaces of one group are proportional to each other.

    Parameters
    ----------
    records : of one call.
    groups : surfaces or mixes whose effects are estimated separately.
    """
    rows = surface_motion(records, aircraft)
    pairs = {tuple(sorted(pair)) for group in groups for pair in combinations(sorted(group), 2)}
    for one, other in sorted(pairs):
        if one not in rows or other not in rows:
            continue
        a, b = rows[one], rows[other]
        shared = float(a @ b) / float(a @ a) if np.any(a) else 0.0
        if (
            np.any(a)
            and np.any(b)
            and np.linalg.norm(b - shared * a) < LEAST_UNSHARED_MOTION * np.linalg.norm(b)
        ):
            raise RecordError(
                f"{one} and {other} move together in all records: no fit tells their effects apart",
                where=", ".join(dict.fromkeys(record.name for record in records)),
                remedy="move one after the other, declare one mix of both, or hold the terms of "
                "one under fixed",
            )


def commanded(aircraft: Aircraft) -> tuple[str, ...]:
    """Return surfaces and mixes whose effects are estimated, without the parts of mixes.

    Parameters
    ----------
    aircraft : what declares them.
    """
    mixed = {part for parts in aircraft.mixes.values() for part in parts}
    return tuple(name for name in (*aircraft.surfaces, *aircraft.mixes) if name not in mixed)


def surface_motion(records: Sequence[Record], aircraft: Aircraft) -> Mapping[str, np.ndarray]:
    """Return surfaces and mixes that all records have, minus their means, ``(N,)`` each.

    Parameters
    ----------
    records : of one call.
    aircraft : what declares surfaces and mixes.
    """
    parts: dict[str, list[np.ndarray]] = {}
    for record in records:
        here = {
            name: record[name].values for name in aircraft.surfaces if name in record.input_names
        }
        for name, mix in aircraft.mixes.items():
            if all(part in here for part in mix):
                total = sum(factor * here[part] for part, factor in mix.items())
                here[name] = np.asarray(total)
        for name, row in here.items():
            parts.setdefault(name, []).append(row - np.mean(row))
    whole = len(records)
    return {name: np.concatenate(rows) for name, rows in parts.items() if len(rows) == whole}


def _surfaces_of(term: Term, aircraft: Aircraft) -> set[str]:
    """Return the surface or mix of a term that is linear in it alone; empty for products."""
    names = term.signals & {*aircraft.surfaces, *aircraft.mixes}
    return set(names) if len(term.factors) == 1 and term.factors[0].power == 1 else set()


def _common(channel: Channel) -> float:
    values = np.abs(channel.values[channel.valid])
    return float(np.percentile(values, LIMIT_PERCENTILE)) if len(values) else 0.0


Read = tuple[Record, bool]  # record, whether its file states the hold of the inputs
# Share by which the residual must fall to drop the trim lift; other missing effects do less.
MISSING_TRIM_LIFT_SHARE = 0.15
THRUST = "thrust_command"
IN_PARTS = "predicted in {count} part{s}; initial states and biases are fitted to each"
STEADY_PRESSURE_SHARE = 0.01  # relative change of pressure below which it counts as constant


@dataclass(frozen=True)
class Decided:
    """Reading of earlier records, for later ones whose files do not state it.

    ``hold``: of the inputs. ``weight``: the trim lift follows the measured pressure.
    """

    hold: Hold
    weight: bool


@dataclass(frozen=True, eq=False)
class PreparedData:
    """Model and records from which a fit starts.

    Attributes
    ----------
    model : the declared one, with the measured flow as further inputs if a record has one.
    fitted, validation : fitted and predicted records, split at gaps in time.
    measured : the fitted records before trims are subtracted and the flow becomes an input.
    notes : sentences on the preparation.
    doubts : likely faults of the files, with the remedy.
    look : check of the raw columns.
    parted : predicted records, with the number of their parts in ``validation``.
    """

    model: Model
    fitted: tuple[Record, ...]
    validation: tuple[Record, ...]
    measured: tuple[Record, ...]
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    look: RecordCheck = NOTHING_SEEN
    parted: tuple[PartedRecord, ...] = ()

    @property
    def predicted(self) -> tuple[Record, ...]:
        """The records that are predicted, each complete."""
        return tuple(
            put_together(one, self.validation[span], ())[0]
            for one, span in parts_of(self.parted, self.validation)
        )


def prepared(
    record: Record, plan: Plan, *, own: bool = False, untouched: Collection[str] = ()
) -> tuple[Record, tuple[str, ...]]:
    """Convert accelerometers to load factors, except ``untouched``, and apply the plan's filter.

    Returns the record, the same object if nothing is to be done, and sentences on both steps.
    """
    record, of_accelerometers = (record, ()) if own else with_load_factors(record, untouched)
    record, of_filter = filtered(record, plan)
    return record, (*of_accelerometers, *([of_filter] if of_filter else []))


def unscaled_commands(choices: Mapping[str, ColumnChoice] | None) -> tuple[str, ...]:
    """Return a warning for each channel whose column is a command from -1 to 1, read as an angle.

    Parameters
    ----------
    choices : of a channel map.
    """
    return tuple(
        f"{channel} seems to be an unscaled command: {choice.column} is from -1 to 1, read as an "
        f"angle; write its throw in the channel map, {channel} = {{column = "
        f'"25 * {choice.column}", unit = "deg"}} if a full command is 25 deg'
        for channel, choice in (choices or {}).items()
        if choice.column in recorder_names().get(channel, {}).get("units", {})
    )


def prepare(
    files: Sequence[RecordFile],
    model: Model,
    plan: Plan,
    channels: Mapping[str, ColumnChoice] | None = None,
    validate: Sequence[RecordFile] = (),
    *,
    flow: bool = True,
    attitude: bool = False,
    decided: Decided | None = None,
    part: Segment = WHOLE[0],
) -> PreparedData:
    """Read and prepare the channels of a model from files.

    Fitted are the plan's segments of ``files``; predicted is ``part`` of each file of ``validate``.
    ``flow``: use a measured speed. ``attitude``: use a measured pitch attitude, for effects.
    ``decided``: reading that files do not state; None: the one that the declared model fits best.

    Raises
    ------
    RecordError : a file cannot be used; the message is one line.
    """
    split = len(files) * len(plan.segments)
    beside = [
        (named(file.identity.name, each, several=len(plan.segments) > 1), *unused)
        for file in files
        for each in plan.segments
        if any(
            unused := unused_airspeed(file, model, channels, each.start, each.stop, rate=plan.rate)
        )
    ]
    parts = [(file, segment) for file in files for segment in plan.segments] + [
        (file, part) for file in validate
    ]
    optional = (
        *(able(model) if flow else ()),
        *((ATTITUDE,) if attitude and wants_attitude(model) else ()),
    )
    parted = [
        _read(file, segment, n < split and len(plan.segments) > 1, model, optional, channels, plan)
        for n, (file, segment) in enumerate(parts)
    ]
    texts = [f"{each[0].name}: {note}" for each, notes in parted for note in notes]
    texts += [f"{name}: {sentence}" for name, sentence, _ in beside]
    read: list[Read] = []
    for (record, stated), _ in parted[:split]:
        pieces, of_gaps = split_at_gaps(record)
        read += [(piece, stated) for piece in pieces]
        texts += [f"{record.name}: {of_gaps}"] if of_gaps else []
    names = [record for (record, _), _ in parted]
    first, split, whole = split, len(read), []
    for (record, stated), _ in parted[first:]:
        pieces, of_gaps = split_at_gaps(record, IN_PARTS)
        read += [(piece, stated) for piece in pieces]
        whole.append(
            PartedRecord(record.name, record.time if plan.rate is None else None, len(pieces))
        )
        texts += [f"{record.name}: {of_gaps}"] if of_gaps else []
    records, look = checked_records([record for record, _ in read], expectations_of(model), plan)
    read = [(record, stated) for record, (_, stated) in zip(records, read, strict=True)]
    ready = for_model(read[:split], model, plan, read[split:], decided)
    notes = (*plan.chosen, *grouped(texts, names), *ready.notes)
    return replace(
        ready,
        notes=notes,
        doubts=(
            *unscaled_commands(channels),
            *look.doubts,
            *ready.doubts,
            *(f"{name}: {doubt}" for name, _, doubt in beside if doubt),
        ),
        look=look,
        parted=tuple(whole),
    )


def for_model(
    fitted: Sequence[Read],
    model: Model,
    plan: Plan | None = None,
    validation: Sequence[Read] = (),
    decided: Decided | None = None,
) -> PreparedData:
    """Return records prepared for a model; ``validation`` is read as the fitted records are."""
    plan, split = plan or Plan(), len(fitted)
    read = [*fitted, *validation]
    own, all_stated = is_own(model), all(stated for _, stated in read)
    outputs = [signal.name for signal in model.equations.outputs]
    first = [record if own else with_load_factors(record, outputs)[0] for record, _ in fitted]
    hold, weight, notes = (
        _readings(first, model, plan, all_stated=all_stated)
        if decided is None
        else (plan.hold or decided.hold, decided.weight, [])
    )
    records: list[Record] = []
    told: list[str] = []
    for record, stated in read:
        as_read = (
            record if hold is None or (stated and plan.hold is None) else replace(record, hold=hold)
        )
        one, sentences = prepared(as_read, plan, own=own, untouched=outputs)
        records.append(one)
        told += sentences
    # numbers beyond all measure are for the fit to refuse
    with np.errstate(over="ignore", invalid="ignore"):
        trimmed = [(record, {}) if of_totals(model) else about_trim(record) for record in records]
    for record, trims in trimmed:
        units = {channel.name: channel.unit for channel in record.inputs}
        told += [
            f"{record.name}: trim of {name} taken off, {_shown(value, units[name])}"
            for name, value in trims.items()
        ]
    if not of_totals(model):
        told += [
            sentence
            for record, trims in trimmed
            for name in record.input_names
            if name not in trims and (sentence := trim_sentence(record, name))
        ]
    told += [sentence for record in records if (sentence := flow_sentence(record, model))]
    wider, ready = with_flow(model, [record for record, _ in trimmed], weight=weight)
    flown = wider is not model
    wider, ready, sentence = with_attitude(wider, ready)
    told += [sentence] if sentence else []
    told += ["the airspeed is measured: speed-variation is no candidate"] if flown else []
    doubts = (*_idle_motors(records), *flow_doubts(records, model))
    return PreparedData(
        wider,
        tuple(ready[:split]),
        tuple(ready[split:]),
        tuple(records[:split]),
        (*grouped(told, records), *notes),
        doubts,
    )


def _idle_motors(records: Sequence[Record]) -> list[str]:
    """Return a sentence on each multirotor record without thrust: no command caused its motion."""
    idle = [
        record.name
        for record in records
        if THRUST in record.input_names and not np.any(record[THRUST].values)
    ]
    return [
        f"{name}: {THRUST} is zero throughout, so the motors moved nothing; use a part of the log "
        "in flight (--from, --to)"
        for name in idle
    ]


def _shown(value: float, unit: str) -> str:
    return f"{math.degrees(value):.4g} deg" if unit == "rad" else f"{value:.4g} {unit}"


def grouped(notes: Sequence[str], records: Sequence[Record]) -> list[str]:
    """Sentences on single records, ``"NAME: text"``; the same text on several of them once."""
    names: dict[str, list[str]] = {}
    for sentence in notes:
        of = next(
            (record.name for record in records if sentence.startswith(f"{record.name}: ")), ""
        )
        names.setdefault(sentence.removeprefix(f"{of}: ") if of else sentence, []).append(of)
    return [f"{', '.join(each)}: {text}" if each[0] else text for text, each in names.items()]


def _read(
    file: RecordFile,
    segment: Segment,
    several: bool,
    model: Model,
    optional: Sequence[str],
    channels: Mapping[str, ColumnChoice] | None,
    plan: Plan,
) -> tuple[Read, tuple[str, ...]]:
    """Return a segment of a file, whether its sidecar states the hold, and notes on reading it."""
    from scenarios.files.records import read_with_notes

    inputs, outputs = (
        [signal.name for signal in some]
        for some in (model.equations.inputs, model.equations.outputs)
    )
    instead, units = {} if is_own(model) else instead_of(outputs), channel_units(model)
    record, notes = read_with_notes(
        with_names(file, plan.columns),
        inputs,
        outputs,
        channels,
        segment.start,
        segment.stop,
        optional=optional,
        hold=plan.hold,
        instead=instead,
        channel_units=units,
        rate=plan.rate,
    )
    # Named by their files: a sidecar's name may be the same for all of them.
    record = replace(record, name=named(file.identity.name, segment, several=several))
    return (record, file.sidecar.says_hold), notes


def _readings(
    fitted: Sequence[Record], model: Model, plan: Plan, *, all_stated: bool
) -> tuple[Hold | None, bool, list[str]]:
    """Return the hold of the inputs (None: as read), `Decided.weight`, and notes."""
    weight, of_weight = _weight(fitted, model)
    if not model.equations.inputs:
        return None, weight, of_weight
    if plan.hold is not None:
        word = "held" if plan.hold is Hold.PREVIOUS else "linear"
        weight, of_weight = _weight(with_hold(fitted, plan.hold), model)
        return plan.hold, weight, [f"inputs {word} between samples: {BY_HAND}", *of_weight]
    gain = 0.0 if all_stated else linear_by(fitted, model, partial(with_flow, weight=weight))
    if gain < DECISIVE_LOG_LIKELIHOOD_RATIO:
        return None, weight, of_weight
    weight, of_weight = _weight(with_hold(fitted, Hold.LINEAR), model)
    sentence = (
        "inputs linear between samples: the declared model fits better than with held ones "
        f"(likelihood ratio test: {gain:.1f}, {DECISIVE_LOG_LIKELIHOOD_RATIO:g} needed)"
    )
    return Hold.LINEAR, weight, [f"{sentence}; --hold previous holds them", *of_weight]


def _weight(fitted: Sequence[Record], model: Model) -> tuple[bool, list[str]]:
    """Return whether the trim lift follows the measured pressure, as in flight, and notes.

    It does not in simulated records of perturbations.
    """
    flows = [measured_flow(record, model) for record in fitted]
    if not any(flow is not None and _varies(flow) for flow in flows):
        return True, []
    outputs = [
        signal.name
        for signal in model.equations.outputs
        if any(signal.name in record.output_names for record in fitted)
    ]
    result = better_by(
        with_flow(model, fitted),
        with_flow(model, fitted, weight=False),
        outputs,
        MISSING_TRIM_LIFT_SHARE,
    )
    if result.gain < DECISIVE_LOG_LIKELIHOOD_RATIO:
        undecided = (
            f" (as in flight; fits do not decide it: {result.why_open})" if result.why_open else ""
        )
        return True, [f"the lift that carries the weight follows the measured pressure{undecided}"]
    return False, [
        "the lift that carries the weight is left out: perturbations alone fit better (twice the "
        f"log likelihood {result.gain:.1f})"
    ]


def _varies(flow: Flow) -> bool:
    pressure = flow.speed**2 * (1.0 if flow.density is None else flow.density)
    return bool(pressure.max() > (1.0 + STEADY_PRESSURE_SHARE) * pressure.min())
