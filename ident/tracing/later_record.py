"""A record that took no part in a search, predicted later; samples that count in the errors of what was predicted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.tracing.diagnosis import ErrorFigures, Prediction, Trained
from ident.tracing.spikes.detection import final_spikes
from ident.tracing.spikes.masks import held_out_masks, measured_masks, with_mended
from ident.tracing.validation.error_figures import error_figures, prediction
from ident.tracing.validation.held_out import frozen_on
from ident.whole_record.gauss_newton import Fit
from sim.declaration.model import Model
from sim.record import Record


def spike_masks_of(fit: Fit, masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Validity of held-out samples with isolated spikes set aside, for error figures only."""
    system = fit.layout.system
    every = zip(masks, fit.layout.problems, fit.lines, strict=True)
    everything = [np.where(mask, problem.z - line.y, 0.0) for mask, problem, line in every]
    blocked = [np.zeros(residual.shape[1], dtype=bool) for residual in everything]
    kept, _ = final_spikes([], system.output_names, everything, list(masks), blocked)
    return [mask & keep for mask, keep in zip(masks, kept, strict=True)]


@dataclass(frozen=True, eq=False)
class Predicted:
    """The free simulations before and after, and their errors; ``finite`` False where what was found cannot be simulated on this record."""

    prediction: Prediction
    before: ErrorFigures
    after: ErrorFigures
    finite: bool


def predict(before: Trained, after: Trained, declared: Model, record: Record, spiked: Sequence[str] = ()) -> Predicted:
    """Predict a record with the declared model as fitted, and with the effects found.

    All is frozen but initial states, biases and events. ``declared`` has its biases, prepared as for the fit; ``spiked`` inputs are mended.
    """
    outputs = after.outputs
    mended = [with_mended(record, spiked)]
    masks = held_out_masks(frozen_on(before, declared, mended, None), mended, outputs)
    fits = [frozen_on(trained, declared, mended, masks).frozen for trained in (before, after)]
    channels = tuple(name for name in outputs if name in record.output_names)
    rows = [prediction(fit, 0, record, channels) for fit in fits]
    (counted,) = spike_masks_of(fits[1], measured_masks([record], outputs)) if fits[1] is not None else measured_masks([record], outputs)
    figures = [error_figures([row], [record], [counted[[*map(outputs.index, channels)]]], channels) for row in rows]
    return Predicted(Prediction(record, channels, rows[0], rows[1]), figures[0], figures[1], fits[1] is not None)
