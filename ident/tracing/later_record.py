"""A record that took no part in a search, predicted later; samples that count in the errors of what
was predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.statistics.noise_levels import final_spikes
from ident.tracing.diagnosis import ErrorFigures, Prediction, Trained
from ident.tracing.validation.error_figures import error_figures, prediction
from ident.tracing.validation.held_out import frozen_on
from ident.tracing.wrong_samples import held_out_masks, measured_masks, with_mended
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
    """The free simulations before and after, and their errors.

    Attributes
    ----------
    predictions : of each part of the record. before, after : errors of all parts together.
    counted : samples of each part that count in the errors, ``(m, N)`` in the order of the
        prediction's channels.
    finite : False where what was found cannot be simulated on this record.
    """

    predictions: tuple[Prediction, ...]
    before: ErrorFigures
    after: ErrorFigures
    counted: tuple[np.ndarray, ...]
    finite: bool


def predict(
    before: Trained,
    after: Trained,
    declared: Model,
    parts: Sequence[Record],
    spiked: Sequence[str] = (),
) -> Predicted:
    """Predict a record, or its parts between gaps, with the declared model as fitted, and with the
    effects found.

    All is frozen but initial states, biases and events, which each part has for itself.
    ``declared`` has its biases, prepared as for the fit;
    ``spiked`` inputs are mended.
    """
    outputs = after.outputs
    mended = [with_mended(part, spiked) for part in parts]
    masks = held_out_masks(frozen_on(before, declared, mended, None), mended, outputs)
    fits = [frozen_on(trained, declared, mended, masks).frozen for trained in (before, after)]
    channels = tuple(name for name in outputs if any(name in part.output_names for part in parts))
    rows = [
        [prediction(fit, number, part, channels) for number, part in enumerate(parts)]
        for fit in fits
    ]
    every = (
        spike_masks_of(fits[1], measured_masks(parts, outputs))
        if fits[1] is not None
        else measured_masks(parts, outputs)
    )
    counted = tuple(mask[[*map(outputs.index, channels)]] for mask in every)
    figures = [error_figures(of_fit, parts, counted, channels) for of_fit in rows]
    predictions = tuple(
        Prediction(part, channels, rows[0][number], rows[1][number])
        for number, part in enumerate(parts)
    )
    return Predicted(predictions, figures[0], figures[1], counted, fits[1] is not None)
