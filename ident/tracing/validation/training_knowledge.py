"""What the fitted records say of the shared parameters: a Gaussian under which other records are
fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.statistics.intervals import add_normal_equations, inverse_information
from ident.tracing.candidate_model.fitted_model import FitData, FittedModel, Start, Values, fit_set
from ident.whole_record.layout import Prior


def training_prior(fitted: FittedModel) -> Prior:
    """What training says of the shared parameters: nuisances of its records are projected out."""
    fit, n = fitted.fit, len(fitted.fit.layout.shared)
    normal, _ = fit.normal_equations()
    covariance, _ = inverse_information(normal, fit.theta)
    information, _ = inverse_information(covariance[:n, :n], np.ones(n))
    return Prior(np.arange(n), fit.theta[:n].copy(), information)


def prior_where_both_meet(
    fitted: FittedModel, freer: FittedModel, masks: Sequence[np.ndarray] | None
) -> Prior | None:
    """What training says of the shared parameters about the point at which it meets the held-out
    records; None where no such point is found.

    Training may leave open a curved line of parameters, such as a limit times a derivative: its
    Gaussian holds near its own optimum only.
    """
    trained, other = fitted.fit.layout.problems, freer.fit.layout.problems
    values = Values(
        fitted.values.shared,
        (*fitted.values.own, *freer.values.own),
        (*fitted.values.states, *freer.values.states),
    )
    records = [problem.record for problem in (*trained, *other)]
    valid = [
        *(problem.valid for problem in trained),
        *(masks if masks is not None else (problem.valid for problem in other)),
    ]
    settings = replace(fitted.fit.layout.settings, iterations=40, tolerance=1e-2, enough=0.1)
    both = fit_set(
        FitData(records, valid, fitted.declared, fitted.system.output_names),
        fitted.effects,
        settings,
        Start(values),
    )
    if both is None:
        return None
    fit, n = both.fit, len(both.fit.layout.shared)
    normal, gradient = np.zeros((len(fit.theta),) * 2), np.zeros(len(fit.theta))
    for r, problem in enumerate(fit.layout.problems[: len(trained)]):
        weight = np.where(problem.valid, 1.0 / fitted.fit.variance[:, None], 0.0)
        add_normal_equations(
            normal, gradient, fit.layout.columns(r), fit.jacobians[r], fit.residuals[r], weight
        )
    own = n + len(trained) * fit.layout.own
    inside, scale = normal[:own, :own], np.sqrt(np.maximum(np.diag(normal)[:own], 1e-300))
    covariance, _ = inverse_information(inside, fit.theta[:own])
    step = (
        np.linalg.lstsq(inside / np.outer(scale, scale), gradient[:own] / scale, rcond=1e-10)[0]
        / scale
    )
    information, _ = inverse_information(covariance[:n, :n], np.ones(n))
    return Prior(np.arange(n), fit.theta[:n] + step[:n], information)
