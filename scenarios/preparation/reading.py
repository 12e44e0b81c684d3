"""Prepare records for a fit: parts, units, gaps, filter, trim.

Also refuses records from which the model ``aircraft`` cannot be fitted.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from math import pi

import numpy as np

from ident.recording.kinematic_relations import LENGTH_UNITS
from scenarios.files.declarations import ColumnChoice
from scenarios.files.measured.columns import RecordFile, with_names
from scenarios.files.user_models import channel_units, is_own
from scenarios.preparation.declared_model import (
    DECISIVE_LOG_LIKELIHOOD_RATIO,
    compared_interpretations,
    gain_of_linear_inputs,
    with_hold,
)
from scenarios.preparation.drafting import LARGEST_IN_FLIGHT, recorder_names
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
    about_trim,
    accelerometers_for,
    flow_doubts,
    flow_sentence,
    measured_flow,
    of_totals,
    trim_sentence,
    unused_airspeed,
    usable_flow_channels,
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

# Largest angles, rad, and rates, rad/s. Bank is recorded from -pi to pi, and noise adds to it.
LARGEST = {
    **dict.fromkeys(("alpha", "beta", "theta"), LARGEST_IN_FLIGHT["rad"]),
    "phi": 1.01 * pi,
    **dict.fromkeys(("p", "q", "r"), LARGEST_IN_FLIGHT["rad/s"]),
}
# Percentile that is compared with a limit, so that single wrong samples do not count.
LIMIT_PERCENTILE = 97.0
# Ranges of the median specific force of a flight, about one g, if its column is in g or in ft/s2.
IN_G = (0.7, 1.6)
IN_FEET = (0.9 * G0 / LENGTH_UNITS["ft"], 1.1 * G0 / LENGTH_UNITS["ft"])
# Two surfaces move together if a smaller share of the motion of one is independent of the other.
# Noise alone gives a larger share.
LEAST_UNSHARED_MOTION = 1e-6


def refuse_unfit_records(records: Sequence[Record], model: Model) -> None:
    """Raise RecordError for records from which the model ``aircraft`` cannot be fitted.

    Other models are not checked.

    Parameters
    ----------
    records : all records of the fit, SI.
    model : the model; its free parameters are those that are estimated.

    Raises
    ------
    RecordError : angles or accelerations have wrong units; or two surfaces with free terms in one
        coefficient move together in all records.
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
    limits = {**dict.fromkeys(deflections, LARGEST_IN_FLIGHT["rad"]), **LARGEST}
    for record in records:
        for channel in record.channels:
            limit = limits.get(channel.name)
            if limit is None:
                continue
            size = _upper_size(channel)
            if size > limit:
                rate = "/s" if channel.name in ("p", "q", "r") else ""
                raise RecordError(
                    f"samples are beyond {size:.3g} rad{rate}, which no aircraft "
                    "does: the column is in degrees",
                    where=f"{record.name}, channel {channel.name}",
                    remedy=f"name its unit in the header, as in {channel.name}_deg, or in a "
                    "channel map",
                )
        _refuse_accelerations(record)


def _refuse_accelerations(record: Record) -> None:
    """Raise RecordError if the median of az shows that it is in g or ft/s2."""
    if "az" not in record.output_names:
        return
    values = record["az"].values[record["az"].valid]
    median = float(np.median(np.abs(values))) if len(values) else G0
    for unit, (low, high) in (("g", IN_G), ("ft/s2", IN_FEET)):
        if low < median < high:
            raise RecordError(
                f"its median is {median:.3g} m/s2 where the lift of level flight is 9.81 m/s2: the "
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
    records : all records of the fit.
    aircraft : declares surfaces and mixes.
    groups : groups of surfaces or mixes; the effects of each in a group are estimated separately.
    """
    motion = surface_motion(records, aircraft)
    pairs = {tuple(sorted(pair)) for group in groups for pair in combinations(sorted(group), 2)}
    for first, second in sorted(pairs):
        if first not in motion or second not in motion:
            continue
        a, b = motion[first], motion[second]
        if not np.any(a) or not np.any(b):
            continue
        shared = float(a @ b) / float(a @ a)
        if np.linalg.norm(b - shared * a) < LEAST_UNSHARED_MOTION * np.linalg.norm(b):
            raise RecordError(
                f"{first} and {second} move together in all records: no fit tells their effects "
                "apart",
                where=", ".join(dict.fromkeys(record.name for record in records)),
                remedy="move one after the other, declare one mix of both, or hold the terms of "
                "one under fixed",
            )


def separate_controls(aircraft: Aircraft) -> tuple[str, ...]:
    """Return the mixes of an aircraft and the surfaces that are in no mix."""
    mixed = {part for parts in aircraft.mixes.values() for part in parts}
    return tuple(name for name in (*aircraft.surfaces, *aircraft.mixes) if name not in mixed)


def surface_motion(records: Sequence[Record], aircraft: Aircraft) -> Mapping[str, np.ndarray]:
    """Return the surfaces and mixes that all records have, without their means.

    The records follow each other; each result has as many values as all records have samples.
    """
    motion: dict[str, list[np.ndarray]] = {}
    for record in records:
        in_record = {
            name: record[name].values for name in aircraft.surfaces if name in record.input_names
        }
        for name, mix in aircraft.mixes.items():
            if all(part in in_record for part in mix):
                total = sum(factor * in_record[part] for part, factor in mix.items())
                in_record[name] = np.asarray(total)
        for name, values in in_record.items():
            motion.setdefault(name, []).append(values - np.mean(values))
    return {
        name: np.concatenate(pieces)
        for name, pieces in motion.items()
        if len(pieces) == len(records)
    }


def _surfaces_of(term: Term, aircraft: Aircraft) -> set[str]:
    """Return the surface or mix of a term that is linear in it alone; empty for products."""
    names = term.signals & {*aircraft.surfaces, *aircraft.mixes}
    return set(names) if len(term.factors) == 1 and term.factors[0].power == 1 else set()


def _upper_size(channel: Channel) -> float:
    """Return the absolute value that few samples of a channel exceed (``LIMIT_PERCENTILE``)."""
    values = np.abs(channel.values[channel.valid])
    return float(np.percentile(values, LIMIT_PERCENTILE)) if len(values) else 0.0


Read = tuple[Record, bool]  # record, and whether its file states the hold of the inputs
# The trim lift is left out if that reduces a residual by a larger share. Other missing effects
# change the residual by less.
MISSING_TRIM_LIFT_SHARE = 0.15
THRUST = "thrust_command"
IN_PARTS = "predicted in {count} part{s}; initial states and biases are fitted to each"
STEADY_PRESSURE_SHARE = 0.01  # a pressure that changes by a smaller share counts as constant


@dataclass(frozen=True)
class Decided:
    """Decisions on fitted records, for later records whose files do not state them.

    Attributes
    ----------
    hold : behaviour of the inputs between samples.
    trim_lift : whether the trim lift follows the measured pressure.
    """

    hold: Hold
    trim_lift: bool


@dataclass(frozen=True, eq=False)
class PreparedData:
    """Model and records from which a fit starts.

    Attributes
    ----------
    model : the declared model, with the measured flow as further inputs if a record has one.
    fitted : records to fit, split at gaps in time.
    validation : records to predict, split at gaps in time.
    measured : the records to fit, before trims are subtracted and the flow becomes an input.
    notes : sentences on the preparation.
    doubts : sentences on likely faults of the files, with the remedy.
    look : check of the raw columns.
    parted : records to predict, each with the number of its parts in ``validation``.
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
            put_together(parted, self.validation[span], ())[0]
            for parted, span in parts_of(self.parted, self.validation)
        )


def prepared(
    record: Record, plan: Plan, *, own: bool = False, untouched: Collection[str] = ()
) -> tuple[Record, tuple[str, ...]]:
    """Convert accelerometers to load factors and apply the filter of the plan.

    Parameters
    ----------
    own : whether the model is a user's: then no accelerometer is converted.
    untouched : accelerometers that are not converted.

    Returns
    -------
    The record, which is the same object if nothing changes, and sentences on both steps.
    """
    sentences: tuple[str, ...] = ()
    if not own:
        record, sentences = with_load_factors(record, untouched)
    record, filter_sentence = filtered(record, plan)
    return record, (*sentences, filter_sentence) if filter_sentence else sentences


def unscaled_commands(choices: Mapping[str, ColumnChoice] | None) -> tuple[str, ...]:
    """Return a warning for each control of a channel map whose column is a command from -1 to 1
    and has neither a unit nor a factor.
    """
    return tuple(
        f"{channel} seems to be an unscaled command: {choice.column} is from -1 to 1, read as an "
        f"angle; write its throw in the channel map, {channel} = {{column = "
        f'"25 * {choice.column}", unit = "deg"}} if a full command is 25 deg'
        for channel, choice in (choices or {}).items()
        if choice.unit is None
        and not choice.computed
        and recorder_names().get(channel, {}).get("units", {}).get(choice.column) == "rad"
    )


def prepare(
    files: Sequence[RecordFile],
    model: Model,
    plan: Plan,
    channels: Mapping[str, ColumnChoice] | None = None,
    validate: Sequence[RecordFile] = (),
    *,
    use_measured_airspeed: bool = True,
    attitude: bool = False,
    decided: Decided | None = None,
    part: Segment = WHOLE[0],
) -> PreparedData:
    """Read and prepare the channels of a model from files.

    Parameters
    ----------
    files : files to fit; of each the segments of ``plan`` are read.
    channels : channel map; None: that of each file.
    validate : files to predict; of each ``part`` is read.
    use_measured_airspeed : whether a measured airspeed or dynamic pressure is used.
    attitude : whether a measured pitch attitude is used, by effects.
    decided : hold of the inputs and trim lift, if files do not state them; None: those with which
        the declared model fits best.

    Raises
    ------
    RecordError : a file cannot be used; the message is one line.
    """
    fit_count = len(files) * len(plan.segments)
    unused_airspeeds = []  # name of the record, note, doubt
    for file in files:
        for segment in plan.segments:
            note, doubt = unused_airspeed(
                file, model, channels, segment.start, segment.stop, rate=plan.rate
            )
            if note or doubt:
                name = named(file.identity.name, segment, several=len(plan.segments) > 1)
                unused_airspeeds.append((name, note, doubt))
    parts = [(file, segment) for file in files for segment in plan.segments]
    parts += [(file, part) for file in validate]
    optional = (
        *(usable_flow_channels(model) if use_measured_airspeed else ()),
        *((ATTITUDE,) if attitude and wants_attitude(model) else ()),
    )
    whole = [
        _read(
            file, segment, n < fit_count and len(plan.segments) > 1, model, optional, channels, plan
        )
        for n, (file, segment) in enumerate(parts)
    ]
    texts = [f"{record.name}: {note}" for (record, _), notes in whole for note in notes]
    texts += [f"{name}: {note}" for name, note, _ in unused_airspeeds]
    read: list[Read] = []  # pieces of all records, those to fit first
    parted: list[PartedRecord] = []
    fit_pieces = 0
    for n, ((record, stated), _) in enumerate(whole):
        is_fitted = n < fit_count
        pieces, gap_note = split_at_gaps(record) if is_fitted else split_at_gaps(record, IN_PARTS)
        read += [(piece, stated) for piece in pieces]
        if is_fitted:
            fit_pieces += len(pieces)
        else:
            time = record.time if plan.rate is None else None
            parted.append(PartedRecord(record.name, time, len(pieces)))
        if gap_note:
            texts.append(f"{record.name}: {gap_note}")
    records, look = checked_records([record for record, _ in read], expectations_of(model), plan)
    read = [(record, stated) for record, (_, stated) in zip(records, read, strict=True)]
    ready = for_model(read[:fit_pieces], model, plan, read[fit_pieces:], decided)
    notes = (*plan.chosen, *grouped(texts, [record for (record, _), _ in whole]), *ready.notes)
    airspeed_doubts = [f"{name}: {doubt}" for name, _, doubt in unused_airspeeds if doubt]
    doubts = (*unscaled_commands(channels), *look.doubts, *ready.doubts, *airspeed_doubts)
    return replace(ready, notes=notes, doubts=doubts, look=look, parted=tuple(parted))


def for_model(
    fitted: Sequence[Read],
    model: Model,
    plan: Plan | None = None,
    validation: Sequence[Read] = (),
    decided: Decided | None = None,
) -> PreparedData:
    """Return records prepared for a model.

    The hold and the trim lift that are decided for ``fitted`` apply to ``validation``, too.
    """
    plan, split = plan or Plan(), len(fitted)
    read = [*fitted, *validation]
    own, all_stated = is_own(model), all(stated for _, stated in read)
    outputs = [signal.name for signal in model.equations.outputs]
    loads = [record if own else with_load_factors(record, outputs)[0] for record, _ in fitted]
    if decided is None:
        hold, trim_lift, notes = _decisions(loads, model, plan, all_stated=all_stated)
    else:
        hold, trim_lift, notes = plan.hold or decided.hold, decided.trim_lift, []
    records: list[Record] = []
    texts: list[str] = []
    for record, stated in read:
        with_decided_hold = record
        if hold is not None and (plan.hold is not None or not stated):
            with_decided_hold = replace(record, hold=hold)
        ready_record, sentences = prepared(with_decided_hold, plan, own=own, untouched=outputs)
        records.append(ready_record)
        texts += sentences
    # Numbers may overflow here; the fit refuses them.
    with np.errstate(over="ignore", invalid="ignore"):
        trimmed = [(record, {}) if of_totals(model) else about_trim(record) for record in records]
    for record, trims in trimmed:
        units = {channel.name: channel.unit for channel in record.inputs}
        texts += [
            f"{record.name}: trim of {name} taken off, {_shown(value, units[name])}"
            for name, value in trims.items()
        ]
    if not of_totals(model):
        texts += [
            sentence
            for record, trims in trimmed
            for name in record.input_names
            if name not in trims and (sentence := trim_sentence(record, name))
        ]
    texts += [sentence for record in records if (sentence := flow_sentence(record, model))]
    with_inputs, ready = with_flow(model, [record for record, _ in trimmed], trim_lift=trim_lift)
    has_flow = with_inputs is not model
    with_inputs, ready, sentence = with_attitude(with_inputs, ready)
    if sentence:
        texts.append(sentence)
    if has_flow:
        texts.append("the airspeed is measured: speed-variation is no candidate")
    doubts = (*_idle_motors(records), *flow_doubts(records, model))
    return PreparedData(
        with_inputs,
        tuple(ready[:split]),
        tuple(ready[split:]),
        tuple(records[:split]),
        (*grouped(texts, records), *notes),
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
    """Return sentences ``"NAME: text"`` on records, where equal texts become one sentence."""
    names_by_text: dict[str, list[str]] = {}
    for sentence in notes:
        name = next(
            (record.name for record in records if sentence.startswith(f"{record.name}: ")), ""
        )
        text = sentence.removeprefix(f"{name}: ") if name else sentence
        names_by_text.setdefault(text, []).append(name)
    return [
        f"{', '.join(names)}: {text}" if names[0] else text for text, names in names_by_text.items()
    ]


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

    inputs = [signal.name for signal in model.equations.inputs]
    outputs = [signal.name for signal in model.equations.outputs]
    instead, units = {} if is_own(model) else accelerometers_for(outputs), channel_units(model)
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
    return (record, file.sidecar.states_hold), notes


def _decisions(
    fitted: Sequence[Record], model: Model, plan: Plan, *, all_stated: bool
) -> tuple[Hold | None, bool, list[str]]:
    """Return the hold of the inputs (None: that of each record), ``Decided.trim_lift``, and notes.

    ``all_stated``: whether the files of all records state the hold.
    """
    trim_lift, lift_notes = _trim_lift(fitted, model)
    if not model.equations.inputs:
        return None, trim_lift, lift_notes
    if plan.hold is not None:
        word = "held" if plan.hold is Hold.PREVIOUS else "linear"
        trim_lift, lift_notes = _trim_lift(with_hold(fitted, plan.hold), model)
        return plan.hold, trim_lift, [f"inputs {word} between samples: {BY_HAND}", *lift_notes]
    gain = (
        0.0
        if all_stated
        else gain_of_linear_inputs(fitted, model, partial(with_flow, trim_lift=trim_lift))
    )
    if gain < DECISIVE_LOG_LIKELIHOOD_RATIO:
        return None, trim_lift, lift_notes
    trim_lift, lift_notes = _trim_lift(with_hold(fitted, Hold.LINEAR), model)
    sentence = (
        "inputs linear between samples: the declared model fits better than with held ones "
        f"(likelihood ratio test: {gain:.1f}, {DECISIVE_LOG_LIKELIHOOD_RATIO:g} needed)"
    )
    return Hold.LINEAR, trim_lift, [f"{sentence}; --hold previous holds them", *lift_notes]


def _trim_lift(fitted: Sequence[Record], model: Model) -> tuple[bool, list[str]]:
    """Return whether the trim lift follows the measured pressure, and notes.

    In flight it does; in simulated records of perturbations it does not.
    """
    flows = [measured_flow(record, model) for record in fitted]
    if not any(flow is not None and _varies(flow) for flow in flows):
        return True, []
    outputs = [
        signal.name
        for signal in model.equations.outputs
        if any(signal.name in record.output_names for record in fitted)
    ]
    comparison = compared_interpretations(
        with_flow(model, fitted),
        with_flow(model, fitted, trim_lift=False),
        outputs,
        MISSING_TRIM_LIFT_SHARE,
    )
    if comparison.gain < DECISIVE_LOG_LIKELIHOOD_RATIO:
        undecided = ""
        if comparison.why_open:
            undecided = f" (as in flight; fits do not decide it: {comparison.why_open})"
        return True, [f"the lift that carries the weight follows the measured pressure{undecided}"]
    return False, [
        "the lift that carries the weight is left out: perturbations alone fit better (twice the "
        f"log likelihood {comparison.gain:.1f})"
    ]


def _varies(flow: Flow) -> bool:
    pressure = flow.speed**2 * (1.0 if flow.density is None else flow.density)
    return bool(pressure.max() > (1.0 + STEADY_PRESSURE_SHARE) * pressure.min())
