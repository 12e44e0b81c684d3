"""Predictive test: whether held-out data are more probable with the claimed effects.

The gains are of log density of the held-out data, from one fitted set of effects to another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.process_noise.filter_error import (
    fit_with_fixed_noise,
    noise_levels,
    one_step_prediction,
)
from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.noise_levels import final_spikes
from ident.statistics.residuals import ErrorFigures, error_figures
from ident.tracing.diagnosis import OneStep, Prediction, Trained
from ident.tracing.fitted_model import FittedModel, local_names
from ident.tracing.held_out import HeldOut, HeldOutData, frozen_on, predicted_by
from ident.tracing.steady_search import SUPPORTED_Z
from ident.tracing.wrong_samples import held_out_masks, measured_masks, with_mended
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.layout import FitSettings
from sim.declaration.model import Model
from sim.record import Record


def frozen_gain(held: HeldOutData, out: HeldOut) -> float:
    """Return the gain of log density of held-out data from the declared model to a fitted set.

    Both are simulated freely with all shared parameters frozen. The gain is minus infinity if the
    set cannot be simulated, and infinity if there is nothing to compare.
    """
    if held.records and out.frozen is None:
        return -math.inf
    if out.frozen is None or held.declared.frozen is None:
        return math.inf
    return held.declared.frozen.cost - out.frozen.cost


@dataclass(frozen=True)
class PredictiveGain:
    """Gains of log density of held-out data, and the smallest sum of them that supports a claim.

    Attributes
    ----------
    values : one gain for all records, or one for each.
    least : smallest sum that does not contradict the effects: zero, or less if the records test
        the effects weakly and a negative gain is likely by chance.
    one_step : errors of one-step predictions; None if free simulations are compared.
    """

    values: tuple[float, ...] = ()
    least: float = 0.0
    one_step: OneStep | None = None

    @property
    def total(self) -> float:
        """Sum of the gains; infinite where nothing could be compared."""
        return sum(self.values) if self.values else math.inf

    @property
    def contradicts(self) -> bool:
        """Whether the data contradict the effects."""
        return self.total <= self.least


def least_gain(less: Fit, more: Fit) -> float:
    """Return the smallest gain of log density that is likely if ``more`` is true, at most zero.

    With the difference d of the two free simulations and the noise sigma, the gain is normal with
    mean E = sum((d/sigma)^2)/2 and variance 2 E.
    """
    mean = 0.0
    for problem, one, other in zip(
        more.layout.problems, less.linearisations, more.linearisations, strict=True
    ):
        difference = np.where(problem.valid, one.y - other.y, 0.0)
        mean += 0.5 * float(np.sum(difference**2 / more.variance[:, None]))
    return min(0.0, mean - SUPPORTED_Z * math.sqrt(2.0 * mean))


def predictive_gains(
    less: FittedModel, more: FittedModel, held: HeldOutData, out: HeldOut
) -> PredictiveGain:
    """Return the gains of log density of held-out data from one fitted set to another.

    Without process noise: one gain of free simulations of all records, first with frozen values;
    without gain, with the training posterior as prior. With process noise: gains of one-step
    predictions, one a record, since free simulations do not contain random loads.

    Parameters
    ----------
    less, more : two fitted sets on the same records; ``more`` has the claimed effects.
    held : the held-out data. out : fits of ``more`` to them.

    Returns
    -------
    The gains; minus infinity where ``more`` cannot be simulated; empty without held-out data.
    """
    if not held.records:
        return PredictiveGain()
    gain = frozen_gain(held, out)
    if math.isinf(gain):
        return PredictiveGain((gain,))
    if not has_process_noise(more.system):
        # Frozen values reject correct sets with correlated parameters (``held_out``).
        plain = None if gain > 0.0 else predicted_by(less, held).informed
        if plain is None or out.informed is None:
            return PredictiveGain((gain,))
        return PredictiveGain((plain.cost - out.informed.cost,), least_gain(plain, out.informed))
    pairs = [
        (
            _one_step_fit(less, r, {}, held, out, more.fit.layout.settings),
            _one_step_fit(more, r, own, held, out, more.fit.layout.settings),
        )
        for r, own in enumerate(_own_values(more, out))
    ]
    differences = [_log_likelihood(after) - _log_likelihood(before) for before, after in pairs]
    gains = tuple(math.inf if math.isnan(each) else each for each in differences)
    return PredictiveGain(gains, one_step=_one_step(pairs, gains, held))


def _log_likelihood(fit: Fit | None) -> float:
    """Return the log likelihood of a fit; minus infinity if the fit failed."""
    return -math.inf if fit is None else fit.log_likelihood


def _one_step_fit(
    fitted: FittedModel,
    r: int,
    own: Mapping[str, float],
    held: HeldOutData,
    out: HeldOut,
    settings: FitSettings,
) -> Fit | None:
    """Return the filter of a fitted model on one held-out record; None where its predictions are
    not finite.

    ``own`` : starting values of the parameters of this record. ``settings`` : of the filter, equal
    for both models.
    """
    fit = out.informed or out.frozen
    assert fit is not None
    return fit_with_fixed_noise(
        [held.records[r]],
        fitted.system,
        fitted.values.shared,
        noise_levels(fitted.fit),
        settings,
        local=[name for effect in fitted.effects for name in local_names(effect)],
        masks=[fit.layout.problems[r].valid],
        begin=[own],
    )


def _one_step(
    pairs: Sequence[tuple[Fit | None, Fit | None]], gains: tuple[float, ...], held: HeldOutData
) -> OneStep | None:
    """Return the errors of one-step predictions of both models, with the gains; None if one of them
    has no process noise, or its predictions are not finite.

    ``pairs`` : in each record, the filters of the two models.
    """
    figures_by_model = []
    for fits in zip(*pairs, strict=True):
        found = [fit for fit in fits if fit is not None and has_process_noise(fit.layout.system)]
        if len(found) < len(held.records):
            return None
        names = found[0].layout.system.output_names
        channels = [
            name for name in names if any(name in record.output_names for record in held.records)
        ]
        rows = [names.index(name) for name in channels]
        figures_by_model.append(
            error_figures(
                [one_step_prediction(fit, 0)[rows] for fit in found],
                held.records,
                [fit.layout.problems[0].valid[rows] for fit in found],
                channels,
            )
        )
    return OneStep(figures_by_model[0], figures_by_model[1], gains)


def _own_values(fitted: FittedModel, out: HeldOut) -> list[dict[str, float]]:
    """Return, for each held-out record, the values of its own parameters, such as the onset of an
    event in this record.
    """
    fit = out.informed or out.frozen
    assert fit is not None
    layout = fit.layout
    names = {name for effect in fitted.effects for name in local_names(effect)}
    found = []
    for r in range(len(layout.problems)):
        positions = layout.columns(r)[len(layout.shared) :]
        values = zip(layout.local, positions, strict=False)
        found.append({name: float(fit.theta[at]) for name, at in values if name in names})
    return found


# ---- Prediction of a further record


def spike_masks_of(fit: Fit, masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the masks of held-out samples less isolated spikes; they serve error figures only."""
    system = fit.layout.system
    every = zip(masks, fit.layout.problems, fit.linearisations, strict=True)
    everything = [np.where(mask, problem.z - line.y, 0.0) for mask, problem, line in every]
    blocked = [np.zeros(residual.shape[1], dtype=bool) for residual in everything]
    kept, _ = final_spikes([], system.output_names, everything, list(masks), blocked)
    return [mask & keep for mask, keep in zip(masks, kept, strict=True)]


@dataclass(frozen=True, eq=False)
class Predicted:
    """Free simulations of a record by the declared model and by the model with the effects found.

    Attributes
    ----------
    predictions : of each part of the record.
    before, after : errors of the two models over all parts.
    counted : mask ``(m, N)`` of each part, True where a sample counts in the errors; rows in the
        order of the channels of the prediction.
    finite : whether the model with the effects can be simulated on this record.
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
    """Return the predictions of a record by the declared model and by the model with effects.

    Only initial states, biases and events are fitted, for each part.

    Parameters
    ----------
    before, after : estimates of the declared model, and of the model with the effects found.
    declared : the declared model with its biases.
    parts : the record, or its parts between gaps, prepared as for the fit.
    spiked : names of inputs whose spikes are mended.
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


# ---- Errors of a free simulation


def prediction(
    fit: Fit | None, record_number: int, record: Record, channels: Sequence[str]
) -> np.ndarray:
    """Return the simulated outputs ``(m, N)`` of a record; if the fit failed, the mean of each
    measured channel, and zero for others.
    """
    if fit is not None:
        rows = dict(
            zip(fit.layout.system.output_names, fit.linearisations[record_number].y, strict=True)
        )
        return np.array([rows[name] for name in channels])
    means = [
        float(record[name].values[record[name].valid].mean())
        if name in record.output_names
        else 0.0
        for name in channels
    ]
    return np.array([np.full(len(record), mean) for mean in means])
