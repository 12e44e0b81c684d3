"""A record that took no part in a diagnosis, predicted with what the diagnosis found: as records that are held out are, but at any later time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.tracing.diagnosis import ErrorFigures, Prediction, Trained
from ident.tracing.result import spike_masks_of
from ident.tracing.spikes.masks import held_out_masks, measured_masks, with_mended
from ident.tracing.validation.error_figures import error_figures, prediction
from ident.tracing.validation.held_out import frozen_on
from sim.declaration.model import Model
from sim.record import Record


@dataclass(frozen=True, eq=False)
class Predicted:
    """The free simulations before and after, and their errors; ``finite`` False where what was found cannot be simulated on this record."""

    prediction: Prediction
    before: ErrorFigures
    after: ErrorFigures
    finite: bool


def predict(before: Trained, after: Trained, declared: Model, record: Record, spiked: Sequence[str] = ()) -> Predicted:
    """Predict a record with the declared model as fitted, and with the effects found.

    Parameters, and effects but for what belongs to one record, are frozen; initial states, biases and events are fitted. ``declared`` : the
    model with its biases, prepared as for the fit. ``spiked`` : inputs whose isolated wrong samples are mended, as those of the fit were.
    """
    outputs = after.outputs
    mended = [with_mended(record, spiked)]
    masks = held_out_masks(frozen_on(before, declared, mended, None), mended, outputs)
    fits = [frozen_on(trained, declared, mended, masks).frozen for trained in (before, after)]
    channels = tuple(name for name in outputs if name in record.output_names)
    rows = [prediction(fit, 0, record, channels) for fit in fits]
    counted = measured_masks([record], outputs)
    counted = spike_masks_of(fits[1], counted) if fits[1] is not None else counted
    at = [outputs.index(name) for name in channels]
    figures = [error_figures([row], [record], [np.asarray(counted[0][at])], channels) for row in rows]
    return Predicted(Prediction(record, channels, rows[0], rows[1]), figures[0], figures[1], fits[1] is not None)
