"""Plain fits of a surrogate flight's declared model, for the size of hidden effects, for the
residuals by the small causes, and for pseudo-true values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.estimate import Estimate
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.output_error import estimate_of
from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, full_name
from sim.declaration.model import Model
from sim.errors import ModelError
from sim.record import Record


def declared_model(
    declared: Model,
    starts: Mapping[str, float],
    effects: Sequence[tuple[Effect, Mapping[str, float]]] = (),
) -> Model:
    """Return the declared model of the loop, with biases, and with effects that start at the given
    values.
    """
    model = declared.with_values(starts).with_biases(measured_by(declared))
    for effect, values in effects:
        model = model.with_effects(effect).with_values(
            {full_name(effect, local): value for local, value in values.items()}
        )
    return model


def measured_by(model: Model) -> tuple[str, ...]:
    """Return the outputs of a model, all of which are fitted."""
    return tuple(signal.name for signal in model.equations.outputs)


def fitted(
    records: Sequence[Record], model: Model, *, coloured: bool = False, step: float = 0.01
) -> Fit:
    """Fit all records by output error; raise ModelError if no finite cost is found."""
    names = measured_by(model)
    layout = lay_out(
        [record.only(names) for record in records],
        compile_model(model, names),
        FitSettings(max_step=step, coloured=coloured),
    )
    fit = fit_whole_records(FitProblem(layout))
    if fit is None:
        raise ModelError(
            "the declared model has no finite cost on these records",
            where=records[0].name,
            remedy="check the declared levels",
        )
    return fit


def estimated(fit: Fit) -> Estimate:
    """Return the shared parameters of a fit."""
    return estimate_of(fit)


def misfit(records: Sequence[Record], model: Model) -> np.ndarray:
    """Return the root mean square residual of a fit by channel, ``(m,)``, in the channels'
    units.
    """
    residuals = np.concatenate(fitted(records, model).residuals, axis=1)
    return np.sqrt(np.mean(residuals**2, axis=1))


def left_over(
    records: Sequence[Record], model: Model, noise: Mapping[str, float]
) -> dict[str, np.ndarray]:
    """Return properties of the residuals of each record, fitted alone, by channel.

    ``correlation`` is that of residuals one sample apart, and ``excess`` the root mean square over
    the sensor noise (if there is any). ``inflation`` is, by derivative, the scatter between records
    over the median sigma for white residuals.
    """
    fits = [fitted([record], model) for record in records]
    estimates = [estimated(fit) for fit in fits]
    residuals = [fit.residuals[0] for fit in fits]
    sigma, spread = (
        np.median([e.std for e in estimates], axis=0),
        np.std([e.values for e in estimates], axis=0, ddof=1),
    )
    levels = np.array([noise.get(name, np.inf) for name in measured_by(model)])
    return {
        "correlation": np.median(
            [[np.corrcoef(row[:-1], row[1:])[0, 1] for row in r] for r in residuals], axis=0
        ),
        "excess": np.median([np.std(r, axis=1) for r in residuals], axis=0) / levels,
        "inflation": spread / sigma,
    }
