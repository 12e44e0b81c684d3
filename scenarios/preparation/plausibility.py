"""Records that no fit should start from, and records held out of the fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.maneuver_detection import AXES, FlightSignals, active_share
from ident.statistics.noise_levels import robust_sigma_about_zero
from scenarios.files.declarations import STICK
from scenarios.preparation.declared_model import outputs_with_bias
from scenarios.preparation.plan import MEASURED_MOTION
from sim.declaration.model import Model
from sim.errors import RecordError, instant
from sim.record import Channel, Record

# ---- Long records that are almost all cruise

# s, of all records together; a shorter one is a maneuver with its rest
LONGEST_MANEUVER_RECORD = 120.0
# Share of the time with moving inputs, below which a record is called almost all cruise. Of 40
# simulated flights of 20 minutes with a maneuver every one to two minutes, which move for 0.27 to
# 0.72 of their time, none is; nor is a measured one.
LEAST_MOVING_SHARE = 0.1


def cruise_caution(records: Sequence[Record], name: str, opening: Sequence[str] = ()) -> str:
    """Return one sentence where long records are almost all cruise: the share of their time in
    which an input moves; empty elsewhere.

    ``name`` : of the first file, for the command that finds the maneuvers in it; ``opening`` : the
    options that open it.
    """
    signals = [
        FlightSignals(
            each.time, {one.name: one.values for one in each.inputs if one.name in AXES}, {}
        )
        for each in records
    ]
    spans = [float(each.time[-1] - each.time[0]) for each in records]
    if sum(spans) < LONGEST_MANEUVER_RECORD or not any(each.inputs for each in signals):
        return ""
    share = sum(span * active_share(each) for span, each in zip(spans, signals, strict=True)) / sum(
        spans
    )
    if share >= LEAST_MOVING_SHARE:
        return ""
    moved = (
        f"an input moves beyond its noise in {100.0 * share:.1f} % of {sum(spans):.0f} s: the "
        "record is almost all cruise"
    )
    return (
        f"{moved}; flightid maneuvers {' '.join([name, *opening])} --out DIR finds its maneuvers, "
        "and --maneuver N uses one of them"
    )


# ---- What no fit should start from and no prediction be judged by

# A prediction fits the initial states and the biases: k numbers from N samples lower its error by
# sqrt(1 - k/N), here by a twentieth at most.
PER_UNKNOWN = 10
MEDIAN_SAMPLES = 5  # samples, whose median no single wrong one moves
MANEUVER = "give a record with a maneuver, or more of this one"
# sigmas of a channel's noise, which medians of five samples of noise alone do not reach
MOTION_SIGMAS = 4.0


def refuse_still(records: Sequence[Record], model: Model) -> None:
    """Nothing where something happens in the records.

    Raises
    ------
    RecordError : an output whose samples are all the same; controls that rest in every record;
        nothing that moves above its noise.
    """
    for record in records:
        for channel in record.outputs:
            if _still(channel):
                what = "all samples are the same"
                remedy = "leave the column out: a sensor at work shows noise at least"
                raise RecordError(
                    what, where=f"{record.name}, channel {channel.name}", remedy=remedy
                )
    controls = [
        signal.name for signal in model.equations.inputs if signal.name not in MEASURED_MOTION
    ]
    if controls and all(_still(record[name]) for record in records for name in controls):
        *first, last = controls
        what = (
            f"{', '.join(first)} and {last} never move: nothing shows what they do"
            if first
            else f"the {last} never moves: nothing shows what it does"
        )
        raise RecordError(what, where=_names(records), remedy=MANEUVER)
    if controls and not any(
        moves(channel)
        for record in records
        for channel in record.channels
        if channel.name not in MEASURED_MOTION
    ):
        what = (
            f"neither the {' nor the '.join(controls)} nor any output moves above its noise: "
            "nothing shows what the aircraft does"
        )
        raise RecordError(what, where=_names(records), remedy=MANEUVER)


def refuse_too_few(records: Sequence[Record], model: Model) -> None:
    """Nothing where records have more samples than a fit of the model has unknowns.

    Raises
    ------
    RecordError : fewer samples of outputs than parameters, initial states and biases.
    """
    names = [signal.name for signal in model.equations.outputs]
    biased = 0
    for record in records:
        measured = [name for name in names if name in record.output_names]
        biased += len(outputs_with_bias(model, measured))
    free = [name for name in model.parameters.free_names if not name.startswith("bias_")]
    counts = len(free), len(records) * len(model.initial), biased
    rows = sum(map(len, records))
    samples = sum(
        int(np.count_nonzero(channel.valid))
        for record in records
        for channel in record.outputs
        if channel.name in names
    )
    if samples <= sum(counts):
        what = (
            f"{rows} rows with {samples} samples of outputs are too few for {sum(counts)} unknowns "
            "({} parameters, {} initial states, {} biases)".format(*counts)
        )
        raise RecordError(what, where=_names(records), remedy=MANEUVER)


def refuse_unrelated_records(fitted: Sequence[Record], validation: Sequence[Record]) -> None:
    """Raise an error unless the records of one call belong together.

    Raises
    ------
    RecordError : sticks in two units, which are never converted; a record to be predicted with none
        of the fitted channels.
    """
    first = fitted[0]
    for record in (*fitted[1:], *validation):
        if STICK in first.input_names and record[STICK].unit != first[STICK].unit:
            what = (
                f"the stick is in {_label(record[STICK].unit)}, in {first.name} it is in "
                f"{_label(first[STICK].unit)}"
            )
            raise RecordError(
                what,
                where=record.name,
                remedy="give all records of a call the stick in one unit: it is never converted",
            )
    measured = {name for record in fitted for name in record.output_names}
    for record in validation:
        if not measured.intersection(record.output_names):
            available = ", ".join(sorted(measured))
            what = f"none of the fitted channels ({available}) is measured here"
            raise RecordError(
                what, where=record.name, remedy="validate on a record that has one of them"
            )


def _label(unit: str) -> str:
    return "no unit" if unit in ("", "1") else repr(unit)


def not_recorded(outputs: Sequence[str], records: Sequence[Record]) -> tuple[str, ...]:
    """Return a note for each predicted record that lacks some of the fitted ``outputs``."""
    notes = []
    for record in records:
        missing = [name for name in outputs if name not in record.output_names]
        if missing:
            verb = "is" if len(missing) == 1 else "are"
            notes.append(
                f"{record.name}: {', '.join(missing)} {verb} not recorded here; only the other "
                "outputs are predicted"
            )
    return tuple(dict.fromkeys(notes))


def refuse_unpredictable(
    records: Sequence[Record], model: Model, option: str = "--validate"
) -> None:
    """Raise RecordError for a record that is too short or too quiet to be predicted.

    ``option``: option that names the records; empty for the command's main argument.
    """
    for record in records:
        why = why_unpredictable(record, model)
        if why:
            where, leave = (
                (f"{record.name} ({option})", f", or leave {option} out")
                if option
                else (record.name, "")
            )
            raise RecordError(
                why, where=where, remedy=f"name a longer record with a maneuver{leave}"
            )


def why_unpredictable(record: Record, model: Model) -> str:
    """Why a prediction of a record would not test a model: a stuck channel, too few samples, no
    motion; else empty.
    """
    biases = [channel for channel in record.outputs if channel.name in model.biases]
    unknown = len(model.initial) + len(biases)
    samples = sum(int(np.count_nonzero(channel.valid)) for channel in record.outputs)
    if samples < PER_UNKNOWN * unknown:
        fitted = f"{len(model.initial)} initial states" + (
            f" and {len(biases)} biases" if biases else ""
        )
        return (
            f"{len(record)} rows with {samples} samples are too few to predict: {fitted} are "
            f"fitted to them, and each wants {PER_UNKNOWN}"
        )
    stuck = [channel.name for channel in record.outputs if _still(channel)]
    if stuck:
        return f"all samples of {' and '.join(stuck)} are the same: there is nothing to predict"
    if not any(moves(channel) for channel in record.outputs):
        return "no channel moves above its noise: there is nothing to predict"
    return ""


def moves(channel: Channel) -> bool:
    """Return whether a channel moves above its noise.

    A median over five samples differs from the middle by more than ``MOTION_SIGMAS`` sigmas; sigma
    follows from the median difference of successive samples.
    """
    values = channel.values[channel.valid]
    if len(values) < 2 * MEDIAN_SAMPLES:
        return len(values) > 1 and float(np.ptp(values)) > 0.0
    noise = robust_sigma_about_zero(np.diff(values)) / math.sqrt(2.0)
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(values, MEDIAN_SAMPLES), axis=1)
    return float(np.max(np.abs(smooth - np.median(values)))) > MOTION_SIGMAS * noise


def _names(records: Sequence[Record]) -> str:
    return ", ".join(dict.fromkeys(record.name for record in records))


def _still(channel: Channel) -> bool:
    values = channel.values[channel.valid]
    return len(values) > 1 and float(np.ptp(values)) == 0.0


# ---- What is kept out of the fit when the user names no record for that

LEAST_EXCITATION_SHARE = 0.3
EARLIEST_CUT_SHARE = 0.1  # earliest cut, share of the duration
LATEST_CUT_SHARE = 0.8  # latest cut, share of the duration
LEAST_HELD_OUT_EXCITATION = 0.1  # share of the excitation in the held-out part
FEWEST_PART_SAMPLES = 20  # samples in either part
# Share of all samples that the other records need if the last is held out whole.
LEAST_REMAINING_SHARE = 0.3
FEWEST_TRIM_SAMPLES = 5  # fewest samples that show the trim
TRIM_SAMPLE_SHARE = 0.02  # share of the samples that show the trim
_REST_SHARE = 0.02  # share of the input's largest movement
_REST_TIME = 0.5  # s
_REST_NOISE_SIGMAS = 4.0  # sigmas of the noise on a recorded input that a resting one stays within
_REMEDY = "give another record with --validate, or use more of this one"


@dataclass(frozen=True, eq=False)
class Split:
    """Fitted and held-out records. ``cut``: time (s); None for a whole held-out record."""

    fitted: tuple[Record, ...]
    held_out: Record
    cut: float | None
    sentence: str


def split_off(records: Sequence[Record], model: Model) -> Split:
    """Hold out the whole last record if the others can replace it, else its last part.

    The others must measure every channel and move every control of it, and have at least 30 % of
    all samples. The last record must be predictable (``why_unpredictable``). Of records without a
    control, the last part is held out, since whole records may show the same motion.

    Raises
    ------
    RecordError : the last record has to be cut and cannot be.
    """
    *others, last = records
    if (
        others
        and model.equations.inputs
        and _stand_for(others, last)
        and not why_unpredictable(last, model)
    ):
        sentence = (
            f"the last record, {last.name}, is not fitted but predicted whole, as no other is "
            "given for it (--validate); the others are fitted"
        )
        return Split(tuple(others), last, None, sentence)
    first, held_out = hold_out(last)
    cut = float(held_out.time[0])
    return Split(
        (*others, first),
        held_out,
        cut,
        f"the last part of {last.name}, from {instant(cut, 6)} s on, is not fitted but predicted, "
        "as no other record is given for it (--validate)",
    )


def _stand_for(others: Sequence[Record], last: Record) -> bool:
    """Return whether some records measure and excite everything that another one does."""
    enough = sum(len(record) for record in others) >= LEAST_REMAINING_SHARE * sum(
        len(record) for record in (*others, last)
    )
    measured = {
        channel.name for record in others for channel in record.outputs if np.any(channel.valid)
    }
    moved = {channel.name for record in others for channel in record.inputs if moves(channel)}
    shown = {channel.name for channel in last.outputs}
    steered = {
        channel.name
        for channel in last.inputs
        if channel.name not in MEASURED_MOTION and moves(channel)
    }
    return enough and shown <= measured and steered <= moved


def hold_out(record: Record) -> tuple[Record, Record]:
    """Cut a record into a fitted part and a last part, which is predicted.

    The cut is where 70 % of the excitation is over (squared deflections from the initial trim), at
    10 to 80 % of the duration. Preferred are moments at which every input has rested for half a
    second, so that lags, delays and hysteresis do not cross the cut, if at least 10 % of the
    excitation is left. A record without inputs is cut at 70 % of its duration.

    Raises
    ------
    RecordError : fewer than 40 rows (either part gets 20 at least), a part without a sample of a
        channel, or a fitted part in which no control moves.
    """
    if len(record) < 2 * FEWEST_PART_SAMPLES:
        raise RecordError(
            f"{len(record)} rows are too few to hold a part out", where=record.name, remedy=_REMEDY
        )
    cut = min(max(_cut(record), FEWEST_PART_SAMPLES), len(record) - FEWEST_PART_SAMPLES)
    first = _part(record, slice(0, cut), "fitted")
    held_out = _part(record, slice(cut, len(record)), "held-out")
    steered = [
        channel.name
        for channel in record.inputs
        if channel.name not in MEASURED_MOTION and moves(channel)
    ]
    if steered and not any(moves(first[name]) for name in steered):
        what = (
            f"no control moves before {instant(record.time[cut], 6)} s, where its last part would "
            "be held out: the rest says nothing of a model"
        )
        raise RecordError(what, where=record.name, remedy=_REMEDY)
    return first, held_out


def _cut(record: Record) -> int:
    """Return the first row of the held-out part."""
    time = record.time
    span = time[-1] - time[0]
    inside = np.flatnonzero(
        (time >= time[0] + EARLIEST_CUT_SHARE * span) & (time <= time[0] + LATEST_CUT_SHARE * span)
    )
    if inside.size == 0:  # all samples at the ends
        return len(record) // 2
    wanted = 1.0 - LEAST_EXCITATION_SHARE
    weight = np.gradient(time)
    moved = np.zeros(len(record))
    resting = np.ones(len(record), dtype=bool)
    for channel in record.inputs:
        # a measured flow or attitude drifts; only controls excite
        if channel.name in MEASURED_MOTION:
            continue
        away = np.abs(channel.values - _trim(channel.values))
        peak = float(away.max())
        if peak > 0.0:
            moved += (away / peak) ** 2 * weight
            resting &= away <= max(
                _REST_SHARE * peak, _REST_NOISE_SIGMAS * _scatter(channel.values)
            )
    if not np.any(moved > 0.0):
        return int(inside[np.argmin(np.abs(time[inside] - time[0] - wanted * span))])
    over = np.concatenate([[0.0], np.cumsum(moved)[:-1]]) / moved.sum()
    last_moved = np.maximum.accumulate(np.where(resting, -np.inf, time))
    rested = inside[resting[inside] & (time[inside] - last_moved[inside] >= _REST_TIME)]
    rested = rested[(1.0 - over[rested] >= LEAST_HELD_OUT_EXCITATION) & (over[rested] >= 0.5)]
    chosen = rested if rested.size else inside
    distance = np.abs(over[chosen] - wanted)
    # During rest the share is constant: take the moment nearest to 70 % of the duration.
    best = chosen[distance <= distance.min() + 0.02]
    return int(best[np.argmin(np.abs(time[best] - time[0] - wanted * span))])


def _trim(values: np.ndarray) -> float:
    """Return the initial value of a control; the median would follow a long step."""
    return float(
        np.median(values[: max(FEWEST_TRIM_SAMPLES, round(TRIM_SAMPLE_SHARE * len(values)))])
    )


def _scatter(values: np.ndarray) -> float:
    """Return the standard deviation of the noise on an input, from the median of its steps; zero
    for one that is held.
    """
    return float(robust_sigma_about_zero(np.diff(values)) / np.sqrt(2.0))


def _part(record: Record, rows: slice, word: str) -> Record:
    for channel in record.outputs:
        if not np.any(channel.valid[rows]):
            raise RecordError(
                f"not a single sample of {channel.name} in the {word} part",
                where=record.name,
                remedy=_REMEDY,
            )
    inputs, outputs = (
        tuple(
            replace(channel, values=channel.values[rows], valid=channel.valid[rows])
            for channel in group
        )
        for group in (record.inputs, record.outputs)
    )
    return replace(record, time=record.time[rows], inputs=inputs, outputs=outputs)
