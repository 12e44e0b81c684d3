"""Refusal of records that no fit or prediction can use, and the choice of the held-out part."""

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

LONGEST_MANEUVER_RECORD = 120.0  # s, of all records together; shorter records are maneuvers
# A record is almost all cruise if inputs move for a smaller share of its time. In 40 simulated
# flights of 20 minutes with a maneuver every one to two minutes, this share is 0.27 to 0.72.
LEAST_MOVING_SHARE = 0.1


def cruise_caution(records: Sequence[Record], name: str, opening: Sequence[str] = ()) -> str:
    """Return a sentence if long records are almost all cruise; else an empty text.

    Parameters
    ----------
    records : the records.
    name : name of the first file, for the command that finds its maneuvers.
    opening : options that open this file.
    """
    signals = [
        FlightSignals(
            record.time,
            {channel.name: channel.values for channel in record.inputs if channel.name in AXES},
            {},
        )
        for record in records
    ]
    durations = [float(record.time[-1] - record.time[0]) for record in records]
    total = sum(durations)
    if total < LONGEST_MANEUVER_RECORD or not any(flight.inputs for flight in signals):
        return ""
    moving_time = sum(
        duration * active_share(flight) for duration, flight in zip(durations, signals, strict=True)
    )
    share = moving_time / total
    if share >= LEAST_MOVING_SHARE:
        return ""
    return (
        f"an input moves beyond its noise in {100.0 * share:.1f} % of {total:.0f} s: the record is "
        f"almost all cruise; flightid maneuvers {' '.join([name, *opening])} --out DIR finds its "
        "maneuvers, and --maneuver N uses one of them"
    )


# ---- Records that cannot be fitted or predicted

# Fewest samples of a prediction for each number that is fitted to them: initial states and biases.
# k numbers fitted to N samples reduce the error by the factor sqrt(1 - k/N), at least 0.95.
PER_UNKNOWN = 10
MEDIAN_SAMPLES = 5  # samples of a median, which a single wrong sample does not change
MOTION_SIGMAS = 4.0  # sigmas of the noise, which such medians of noise alone do not reach
MANEUVER = "give a record with a maneuver, or more of this one"


def refuse_still(records: Sequence[Record], model: Model) -> None:
    """Raise an error for records without motion.

    Raises
    ------
    RecordError : all samples of an output are the same; all controls rest in all records; or no
        channel moves above its noise.
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
        what = f"the {last} never moves: nothing shows what it does"
        if first:
            what = f"{', '.join(first)} and {last} never move: nothing shows what they do"
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
    """Raise an error for records with fewer samples than the fit of a model has unknowns.

    Raises
    ------
    RecordError : there are not more samples of outputs than parameters, initial states and biases.
    """
    names = [signal.name for signal in model.equations.outputs]
    biases = 0
    for record in records:
        measured = [name for name in names if name in record.output_names]
        biases += len(outputs_with_bias(model, measured))
    free = [name for name in model.parameters.free_names if not name.startswith("bias_")]
    counts = len(free), len(records) * len(model.initial), biases
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
    """Raise an error for records that do not belong together.

    Raises
    ------
    RecordError : the stick has different units, which are never converted; or a record to be
        predicted measures none of the fitted channels.
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
    """Raise RecordError for a record that is too short or has too little motion to be predicted.

    ``option`` is the option that names the records; empty for the command's main argument.
    """
    for record in records:
        reason = why_unpredictable(record, model)
        if not reason:
            continue
        where, remedy = record.name, "name a longer record with a maneuver"
        if option:
            where, remedy = f"{where} ({option})", f"{remedy}, or leave {option} out"
        raise RecordError(reason, where=where, remedy=remedy)


def why_unpredictable(record: Record, model: Model) -> str:
    """Return the reason why a prediction of a record would not test a model; else an empty text.

    Reasons are too few samples, a constant channel, and no motion.
    """
    biases = [channel for channel in record.outputs if channel.name in model.biases]
    unknowns = len(model.initial) + len(biases)
    samples = sum(int(np.count_nonzero(channel.valid)) for channel in record.outputs)
    if samples < PER_UNKNOWN * unknowns:
        fitted = f"{len(model.initial)} initial states"
        if biases:
            fitted += f" and {len(biases)} biases"
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

    A moving channel has a median over five samples that differs from its median over all samples by
    more than ``MOTION_SIGMAS``. Sigma follows from differences of successive samples.
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


# ---- Choice of the held-out part if the user names no record for validation

HELD_OUT_EXCITATION_SHARE = 0.3  # share of the excitation that the held-out part should have
LEAST_HELD_OUT_EXCITATION = 0.1  # least share of the excitation in the held-out part
LEAST_FITTED_EXCITATION = 0.5  # least share of the excitation in the fitted part
EXCITATION_TOLERANCE = 0.02  # difference of the share of the excitation that does not matter
EARLIEST_CUT_SHARE, LATEST_CUT_SHARE = 0.1, 0.8  # earliest and latest cut, share of the duration
FEWEST_PART_SAMPLES = 20  # samples in either part
# Share of all samples that the other records need if the last is held out whole.
LEAST_REMAINING_SHARE = 0.3
FEWEST_TRIM_SAMPLES = 5  # fewest samples from which the trim is taken
TRIM_SAMPLE_SHARE = 0.02  # share of the samples from which the trim is taken
# A resting input is within this share of its largest deflection, or these sigmas of its noise, for
# this time (s).
_REST_SHARE, _REST_NOISE_SIGMAS, _REST_TIME = 0.02, 4.0, 0.5
_REMEDY = "give another record with --validate, or use more of this one"


@dataclass(frozen=True, eq=False)
class Split:
    """Fitted and held-out records.

    Attributes
    ----------
    fitted, held_out : the records.
    cut : time at which the last record is cut, s; None if it is held out whole.
    sentence : sentence on the held-out part.
    """

    fitted: tuple[Record, ...]
    held_out: Record
    cut: float | None
    sentence: str


def split_off(records: Sequence[Record], model: Model) -> Split:
    """Hold out the whole last record if the others can replace it, else its last part.

    The others must measure every channel and move every control of the last record, and have at
    least ``LEAST_REMAINING_SHARE`` of all samples. The last record must be predictable. Without
    controls, the last part is held out, because whole records may show the same motion.

    Raises
    ------
    RecordError : the last record cannot be cut, although it must be.
    """
    *others, last = records
    replaceable = bool(others) and bool(model.equations.inputs) and _can_replace(others, last)
    if replaceable and not why_unpredictable(last, model):
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


def _can_replace(others: Sequence[Record], last: Record) -> bool:
    """Return whether the others measure every channel and move every control of the last record,
    and have enough samples.
    """
    remaining = sum(len(record) for record in others)
    enough = remaining >= LEAST_REMAINING_SHARE * (remaining + len(last))
    measured = {
        channel.name for record in others for channel in record.outputs if np.any(channel.valid)
    }
    moved = {channel.name for record in others for channel in record.inputs if moves(channel)}
    needed_outputs = {channel.name for channel in last.outputs}
    return enough and needed_outputs <= measured and set(_moving_controls(last)) <= moved


def _moving_controls(record: Record) -> list[str]:
    """Return the inputs that move above their noise and are not measured motion."""
    return [
        channel.name
        for channel in record.inputs
        if channel.name not in MEASURED_MOTION and moves(channel)
    ]


def hold_out(record: Record) -> tuple[Record, Record]:
    """Cut a record into a fitted part and a last part, which is predicted.

    The cut is after 70 % of the excitation, the sum of squared deflections from the initial trim,
    and within 10 to 80 % of the duration. Preferred are times at which every input has rested for
    half a second, so that lags, delays and hysteresis do not act across the cut; both parts must
    then have enough excitation. A record without inputs is cut at 70 % of its duration.

    Raises
    ------
    RecordError : there are fewer than 40 rows, 20 for each part; a part has no sample of a channel;
        or no control moves in the fitted part.
    """
    if len(record) < 2 * FEWEST_PART_SAMPLES:
        raise RecordError(
            f"{len(record)} rows are too few to hold a part out", where=record.name, remedy=_REMEDY
        )
    cut = min(max(_cut(record), FEWEST_PART_SAMPLES), len(record) - FEWEST_PART_SAMPLES)
    first = _part(record, slice(0, cut), "fitted")
    held_out = _part(record, slice(cut, len(record)), "held-out")
    controls = _moving_controls(record)
    if controls and not any(moves(first[name]) for name in controls):
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
    allowed = np.flatnonzero(
        (time >= time[0] + EARLIEST_CUT_SHARE * span) & (time <= time[0] + LATEST_CUT_SHARE * span)
    )
    if allowed.size == 0:  # all samples are at the ends
        return len(record) // 2
    fitted_share = 1.0 - HELD_OUT_EXCITATION_SHARE
    weight = np.gradient(time)
    excitation = np.zeros(len(record))
    resting = np.ones(len(record), dtype=bool)
    for channel in record.inputs:
        # Measured motion drifts; only controls excite.
        if channel.name in MEASURED_MOTION:
            continue
        deflection = np.abs(channel.values - _trim(channel.values))
        peak = float(deflection.max())
        if peak > 0.0:
            excitation += (deflection / peak) ** 2 * weight
            resting &= deflection <= max(
                _REST_SHARE * peak, _REST_NOISE_SIGMAS * _noise_sigma(channel.values)
            )
    if not np.any(excitation > 0.0):
        return int(allowed[np.argmin(np.abs(time[allowed] - time[0] - fitted_share * span))])
    before = np.concatenate([[0.0], np.cumsum(excitation)[:-1]]) / excitation.sum()
    last_motion = np.maximum.accumulate(np.where(resting, -np.inf, time))
    rested = allowed[resting[allowed] & (time[allowed] - last_motion[allowed] >= _REST_TIME)]
    rested = rested[
        (1.0 - before[rested] >= LEAST_HELD_OUT_EXCITATION)
        & (before[rested] >= LEAST_FITTED_EXCITATION)
    ]
    possible = rested if rested.size else allowed
    distance = np.abs(before[possible] - fitted_share)
    # At rest the share is constant. The row nearest to 70 % of the duration is taken.
    best = possible[distance <= distance.min() + EXCITATION_TOLERANCE]
    return int(best[np.argmin(np.abs(time[best] - time[0] - fitted_share * span))])


def _trim(values: np.ndarray) -> float:
    """Return the initial value of a control; the median of all samples would follow a long step."""
    count = max(FEWEST_TRIM_SAMPLES, round(TRIM_SAMPLE_SHARE * len(values)))
    return float(np.median(values[:count]))


def _noise_sigma(values: np.ndarray) -> float:
    """Return the standard deviation of the noise on an input, from the median of its steps; zero
    for an input that is constant between updates.
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
