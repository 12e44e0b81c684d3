"""A measured pitch attitude as a recorded input of the equations: of the phugoid's two states it is the one that a record often has.

Counted from its mean over the record's beginning, since where a gyro's zero lies is not known to the thousandth that a phugoid would need.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ident.tracing.spikes.detection import input_spikes
from scenarios.files.own_models import is_own
from scenarios.preparation.airspeed import BEGINNING, held
from scenarios.preparation.plan import ATTITUDE, SPEED
from sim.declaration.effect import Signal
from sim.declaration.model import Model
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.library import applies
from sim.record import Channel, Record

PARTLY = "the pitch attitude is not measured in all records: a phugoid keeps its own"
FEWEST = 0.5  # of the samples, without which a channel with gaps tells no motion


def wants_attitude(model: Model) -> bool:
    """Whether an effect on the model's equations can use an attitude: a phugoid, whose speed is not recorded."""
    recorded = {signal.name for signal in model.equations.inputs}
    return not is_own(model) and applies(Phugoid(), model.equations) and SPEED not in recorded


def with_attitude(model: Model, records: Sequence[Record]) -> tuple[Model, list[Record], str]:
    """The model with ``theta`` (rad, from its value at each record's begin) as a further input, records that carry it, and a sentence.

    Where the model has no use for it, or a record lacks it, the records come back without it; the sentence is empty but where others have it.
    """
    if any(signal.name == ATTITUDE for signal in model.equations.outputs):
        return model, list(records), ""
    plain = [without_attitude(record) for record in records]
    told = [_tells(record) for record in records]
    if not wants_attitude(model) or not all(told):
        return model, plain, PARTLY if wants_attitude(model) and any(told) else ""
    equations: Any = model.equations
    added = Signal(ATTITUDE, "rad", "recorded: pitch attitude above that at the record's begin")
    wider = replace(model, equations=replace(equations, inputs=(*equations.inputs, added)))
    carried = [replace(bare, inputs=(*bare.inputs, _from_begin(record))) for bare, record in zip(plain, records, strict=True)]
    return wider, carried, "the pitch attitude is measured: a phugoid takes it as it is"


def without_attitude(record: Record) -> Record:
    """The record less its measured attitude, which is no output of a model at constant speed."""
    if ATTITUDE not in record.output_names:
        return record
    return replace(record, outputs=tuple(channel for channel in record.outputs if channel.name != ATTITUDE))


def _tells(record: Record) -> bool:
    return ATTITUDE in record.output_names and float(np.mean(record[ATTITUDE].valid)) > FEWEST


def _from_begin(record: Record) -> Channel:
    """The attitude from the mean of its beginning, wrong samples and gaps bridged, as the inputs are held."""
    time, channel = record.time, record[ATTITUDE]
    # Not as an airspeed is despiked: attitude turns within a few samples, and its turning points are no spikes.
    known = np.flatnonzero(channel.valid)
    known = np.delete(known, input_spikes(channel.values[known]))
    values = np.interp(time, time[known], channel.values[known])
    level = float(np.mean(values[: max(1, int(np.searchsorted(time, time[0] + BEGINNING)))]))
    return Channel.of(ATTITUDE, "rad", held(values - level, record.hold))
