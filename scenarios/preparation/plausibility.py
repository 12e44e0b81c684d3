"""What no fit should start from and no prediction be judged by: stuck channels, resting controls, too few samples."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.statistics.noise_levels import robust_sigma_about_zero
from scenarios.files.channel_names import STICK
from scenarios.preparation.plan import MEASURED_MOTION
from sim.declaration.model import Model
from sim.errors import RecordError
from sim.record import Channel, Record

# A prediction fits the initial states and the biases: k numbers from N samples lower its error by sqrt(1 - k/N), here by a twentieth at most.
PER_UNKNOWN = 10
FIVE = 5  # samples, whose median no single wrong one moves
MANEUVER = "give a record with a maneuver, or more of this one"
ABOVE = 4.0  # sigmas of a channel's noise, which medians of five samples of noise alone do not reach


def refuse_still(records: Sequence[Record], model: Model) -> None:
    """Nothing where something happens in the records.

    Raises
    ------
    RecordError : an output whose samples are all the same; controls that rest in every record; nothing that moves above its noise.
    """
    for record in records:
        for channel in record.outputs:
            if _still(channel):
                what, remedy = "all samples are the same", "leave the column out: a sensor at work shows noise at least"
                raise RecordError(what, where=f"{record.name}, channel {channel.name}", remedy=remedy)
    controls = [signal.name for signal in model.equations.inputs if signal.name not in MEASURED_MOTION]
    if controls and all(_still(record[name]) for record in records for name in controls):
        what = f"the {' and the '.join(controls)} never moves: nothing shows what it does"
        raise RecordError(what, where=_names(records), remedy=MANEUVER)
    if controls and not any(moves(channel) for record in records for channel in record.channels if channel.name not in MEASURED_MOTION):
        what = f"neither the {' nor the '.join(controls)} nor any output moves above its noise: nothing shows what the aircraft does"
        raise RecordError(what, where=_names(records), remedy=MANEUVER)


def refuse_strangers(fitted: Sequence[Record], validation: Sequence[Record]) -> None:
    """Nothing where records of one call belong together.

    Raises
    ------
    RecordError : sticks in two units, which are never converted; a record to be predicted with none of the fitted channels.
    """
    first = fitted[0]
    for record in (*fitted[1:], *validation):
        if STICK in first.input_names and record[STICK].unit != first[STICK].unit:
            what = f"the stick is in {_label(record[STICK].unit)}, in {first.name} it is in {_label(first[STICK].unit)}"
            raise RecordError(what, where=record.name, remedy="give all records of a call the stick in one unit: it is never converted")
    measured = {name for record in fitted for name in record.output_names}
    for record in validation:
        if not measured.intersection(record.output_names):
            known = ", ".join(sorted(measured))
            what = f"none of the fitted channels ({known}) is measured here"
            raise RecordError(what, where=record.name, remedy="validate on a record that has one of them")


def _label(unit: str) -> str:
    return "no unit" if unit in ("", "1") else repr(unit)


def refuse_unpredictable(records: Sequence[Record], model: Model, option: str = "--validate") -> None:
    """Nothing where each record can be predicted by a fit of others. Raises RecordError for one that says nothing, or too little.

    ``option``: by which the records were named, empty where they are what the command is about.
    """
    for record in records:
        why = why_unpredictable(record, model)
        if why:
            where, leave = (f"{record.name} ({option})", f", or leave {option} out") if option else (record.name, "")
            raise RecordError(why, where=where, remedy=f"name a longer record with a maneuver{leave}")


def why_unpredictable(record: Record, model: Model) -> str:
    """Why the prediction of a record would say nothing of a model: a stuck channel, too few samples, no motion; empty where it would."""
    biases = [channel for channel in record.outputs if channel.name in model.biases]
    unknown, samples = len(model.initial) + len(biases), sum(int(np.count_nonzero(channel.valid)) for channel in record.outputs)
    if samples < PER_UNKNOWN * unknown:
        fitted = f"{len(model.initial)} initial states" + (f" and {len(biases)} biases" if biases else "")
        return f"{len(record)} rows with {samples} samples are too few to predict: {fitted} are fitted to them, and each wants {PER_UNKNOWN}"
    stuck = [channel.name for channel in record.outputs if _still(channel)]
    if stuck:
        return f"all samples of {' and '.join(stuck)} are the same: there is nothing to predict"
    if not any(moves(channel) for channel in record.outputs):
        return "no channel moves above its noise: there is nothing to predict"
    return ""


def moves(channel: Channel) -> bool:
    """Whether a channel moves above its noise: a median of five samples leaves the middle by ``ABOVE`` sigmas, taken from the median step."""
    values = channel.values[channel.valid]
    if len(values) < 2 * FIVE:
        return len(values) > 1 and float(np.ptp(values)) > 0.0
    noise = robust_sigma_about_zero(np.diff(values)) / math.sqrt(2.0)
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(values, FIVE), axis=1)
    return float(np.max(np.abs(smooth - np.median(values)))) > ABOVE * noise


def _names(records: Sequence[Record]) -> str:
    return ", ".join(dict.fromkeys(record.name for record in records))


def _still(channel: Channel) -> bool:
    values = channel.values[channel.valid]
    return len(values) > 1 and float(np.ptp(values)) == 0.0
