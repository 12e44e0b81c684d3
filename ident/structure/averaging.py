"""Standard deviations of derivatives that include the uncertainty of the model structure.

The same data determine the terms of a coefficient and their values. A term that was wrongly left
out biases the values of similar terms, and other models explain the data almost as well. Bayesian
model averaging [1]_ weights the models by their probabilities P_m. The variance of the value x_i is
its mean square distance from the value of the chosen model,

    s_i^2 = sum_m P_m (s_im^2 + (x_im - x_i)^2),

where a model without the term has x_im = 0 and s_im = 0. The models are the chosen one and those
that differ from it by one term: added, removed, or exchanged. A product is not exchanged for one of
its own factors: where the other factor is constant, both explain the same. The probabilities follow
from the Bayesian information criterion [2]_, corrected for coloured residuals, and from prior odds:
1 for each linear term that the symmetry of the aircraft allows, and 1 for all other terms together
[3]_.

The criterion compares residual sums of squares from which the effect of noise in the measured
signals is subtracted, as in the normal equations [4]_. Otherwise the noise that passes through the
terms, which differs between models, would affect the comparison.

References
----------
.. [1] J. A. Hoeting, D. Madigan, A. E. Raftery and C. T. Volinsky, Bayesian model averaging: a
   tutorial, Statistical Science 14(4), 1999.
.. [2] A. E. Raftery, Bayesian model selection in social research, Sociological Methodology 25,
   1995.
.. [3] J. G. Scott and J. O. Berger, Bayes and empirical-Bayes multiplicity adjustment in the
   variable-selection problem, Annals of Statistics 38(5), 2010.
.. [4] T. Nakamura, Corrected score function for errors-in-variables models, Biometrika 77(1), 1990.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.structure.products import (
    Products,
    further_columns,
    losses_of,
    normal_equations,
    values_of,
    variance_of,
)

# models of a smaller probability, relative to the likeliest model, are left out
NEGLIGIBLE_PROBABILITY_RATIO = 1e-3
# the likeliest other model is returned if a standard deviation increases by a larger factor
NOTABLE_STD_RATIO = 2.0


@dataclass(frozen=True)
class Alternative:
    """A model that differs from the chosen one by one term.

    Attributes
    ----------
    added, removed : positions of the columns; None where no column is added or removed.
    probability : of this model among all averaged models.
    """

    added: int | None
    removed: int | None
    probability: float


def averaged_covariance(
    products: Products,
    chosen: Sequence[int],
    covariance: np.ndarray,
    equal_variances: np.ndarray,
    linear: Collection[int],
    constituents: Sequence[Collection[int]],
) -> tuple[np.ndarray, Alternative | None]:
    """Return the covariance ``(n, n)`` of the chosen values, averaged over similar models.

    Parameters
    ----------
    products : scalar products of all candidate columns.
    chosen : positions of the n columns of the chosen model.
    covariance : ``(n, n)`` of the values of the chosen model.
    equal_variances : ``(n,)`` variances of these values for coloured residuals that have the same
        variance at all samples.
    linear : positions of the linear terms.
    constituents : by column, the positions of its lower-order terms, which a model with this column
        must contain.

    Returns
    -------
    The covariance, in which no standard deviation is decreased; and the likeliest other model, or
    None if no standard deviation increases by more than ``NOTABLE_STD_RATIO``.
    """
    chosen = list(chosen)
    products = replace(
        products,
        gram=products.gram.sum(axis=0)[None],
        cross=products.cross.sum(axis=0)[None],
        gram_noise=products.gram_noise.sum(axis=0)[None],
        cross_noise=products.cross_noise.sum(axis=0)[None],
    )
    values, unit_variances = values_of(products, chosen), variance_of(products, chosen)
    removable = [i for i in chosen if products.terms[i].factors]
    if not removable:
        return covariance, None
    residual_squares = losses_of(products, chosen)[1]
    count = float(products.counts.sum())
    residual_variance = residual_squares / max(count - len(chosen), 1.0)
    white_variances = np.maximum(unit_variances * residual_variance, 1e-300)
    colouring = float(np.median(equal_variances / white_variances))
    models = _similar_models(
        products,
        chosen,
        removable,
        colouring * residual_variance,
        count / colouring,
        linear,
        constituents,
    )
    greatest = max(log for log, _ in models)
    least = greatest + math.log(NEGLIGIBLE_PROBABILITY_RATIO)
    models = [(log, model) for log, model in models if log > least]
    probabilities = np.exp([log - greatest for log, _ in models])
    probabilities /= probabilities.sum()
    mean_squares = np.zeros(len(chosen))
    for probability, (_, model) in zip(probabilities, models, strict=True):
        place_in_model = {column: place for place, column in enumerate(model)}
        model_values = values_of(products, model)
        model_variances = variance_of(products, model)
        for i, column in enumerate(chosen):
            if column not in place_in_model:
                mean_squares[i] += probability * values[i] ** 2
                continue
            k = place_in_model[column]
            variance = model_variances[k] / max(unit_variances[i], 1e-300) * covariance[i, i]
            difference = model_values[k] - values[i]
            mean_squares[i] += probability * (variance + difference**2)
    std_ratios = np.sqrt(np.maximum(mean_squares / np.maximum(np.diag(covariance), 1e-300), 1.0))
    other = None
    if std_ratios.max() > NOTABLE_STD_RATIO:
        other = _likeliest_other(probabilities, models, chosen)
    return np.asarray(covariance * np.outer(std_ratios, std_ratios)), other


def _likeliest_other(
    probabilities: np.ndarray, models: Sequence[tuple[float, list[int]]], chosen: Sequence[int]
) -> Alternative | None:
    """Return the likeliest model other than the chosen one; None if there is none."""
    others = [
        (float(probability), model)
        for probability, (_, model) in zip(probabilities, models, strict=True)
        if set(model) != set(chosen)
    ]
    if not others:
        return None
    probability, model = max(others)
    added, removed = sorted(set(model) - set(chosen)), sorted(set(chosen) - set(model))
    return Alternative(added[0] if added else None, removed[0] if removed else None, probability)


def _similar_models(
    products: Products,
    chosen: list[int],
    removable: Sequence[int],
    variance: float,
    count: float,
    linear: Collection[int],
    constituents: Sequence[Collection[int]],
) -> list[tuple[float, list[int]]]:
    """Return the chosen model and the models with one term added, removed or exchanged, as pairs:
    the log odds against the chosen model, and the columns of the model.

    Parameters
    ----------
    removable : positions of the chosen columns except the constant.
    variance : of an independent residual.
    count : number of independent residuals, which is less than that of the samples if residuals are
        coloured.
    """
    nonlinear = sum(bool(term.factors) for term in products.terms) - len(linear)
    log_odds = np.array(
        [0.0 if i in linear else -math.log(max(nonlinear, 1)) for i in range(len(products.terms))]
    )
    log_odds = log_odds - 0.5 * math.log(max(count, 1.0))  # prior odds and the criterion's penalty
    squares = float(products.squares.sum())
    chosen_squares = normal_equations(products, chosen).clean_residual_squares(squares)

    def with_one_more(model: list[int], log_prior: float) -> list[tuple[float, list[int]]]:
        """Return a model, and the models with one column more."""
        equations, removed = normal_equations(products, model), set(chosen) - set(model)
        log = (
            log_prior
            - 0.5 * (equations.clean_residual_squares(squares) - chosen_squares) / variance
        )
        further = further_columns(equations)
        logs = log + 0.5 * further.reductions / variance + log_odds
        larger = [
            (float(logs[i]), [*model, i])
            for i in np.flatnonzero(further.good).tolist()
            if not removed & {i, *constituents[i]}
        ]
        return [(log, model), *larger]

    models = with_one_more(chosen, 0.0)
    for removed in removable:
        kept = [i for i in chosen if i != removed]
        if not any(removed in constituents[i] for i in kept):
            models += with_one_more(kept, -float(log_odds[removed]))
    return models
