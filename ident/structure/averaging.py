"""Standard deviations of derivatives that include the uncertainty of the model structure, and
collinearity of the terms in the maneuvers.

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

The measures of collinearity are variance inflation factors, correlations of pairs of terms, and
condition indices with the variance proportions of the terms [5]_.

References
----------
.. [1] J. A. Hoeting, D. Madigan, A. E. Raftery and C. T. Volinsky, Bayesian model averaging: a
   tutorial, Statistical Science 14(4), 1999.
.. [2] A. E. Raftery, Bayesian model selection in social research, Sociological Methodology 25,
   1995.
.. [3] J. G. Scott and J. O. Berger, Bayes and empirical-Bayes multiplicity adjustment in the
   variable-selection problem, Annals of Statistics 38(5), 2010.
.. [4] T. Nakamura, Corrected score function for errors-in-variables models, Biometrika 77(1), 1990.
.. [5] D. A. Belsley, E. Kuh and R. E. Welsch, Regression Diagnostics, Wiley 1980, chapter 3.
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
from sim.aerodynamics import Term, parents

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


# ---- Collinear terms

HIGH_INFLATION = 10.0  # usual limit of a variance inflation factor
HIGH_CORRELATION = 0.9  # usual limit of the correlation of two terms
HIGH_INDEX = 30.0  # usual limit of a condition index
# smallest variance proportion at a high condition index of a term that is in the collinear group
_COLLINEAR_VARIANCE_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Collinearity:
    """Collinearity of the chosen terms of a coefficient.

    Attributes
    ----------
    axis : name of the coefficient.
    terms : the n chosen terms without the constant.
    inflation : ``(n,)`` variance inflation factors.
    correlations : pairs of terms and their correlation, above ``HIGH_CORRELATION`` in size.
    indices : condition indices of the columns at unit length, descending.
    groups : terms with high variance proportions at one condition index above ``HIGH_INDEX``.
    advice : sentences on the maneuvers that would separate the pairs and groups.
    multiples : pairs of a chosen term and a product that contains it. The product was offered but
        not chosen, and is nearly a multiple of the term: ``alpha*beta`` and ``beta`` if alpha
        hardly changes.
    """

    axis: str
    terms: tuple[Term, ...]
    inflation: np.ndarray
    correlations: tuple[tuple[Term, Term, float], ...]
    indices: np.ndarray
    groups: tuple[tuple[Term, ...], ...]
    advice: tuple[str, ...]
    multiples: tuple[tuple[Term, Term], ...] = ()


def collinearity_of(
    axis: str, terms: Sequence[Term], columns: np.ndarray, surfaces: Collection[str]
) -> Collinearity:
    """Return the collinearity of the terms of a coefficient in the maneuvers.

    Parameters
    ----------
    axis : name of the coefficient.
    terms : the n chosen terms, with the constant.
    columns : ``(N, n)`` values of the terms.
    surfaces : signals that the pilot moves.
    """
    varying = [i for i, term in enumerate(terms) if term.factors]
    chosen = tuple(terms[i] for i in varying)
    if not chosen:
        return Collinearity(axis, (), np.zeros(0), (), np.ones(1), (), ())
    X = columns[:, varying]
    X = X - X.mean(axis=0)
    length = np.sqrt(np.maximum(np.einsum("ij,ij->j", X, X), 1e-300))
    R = (X / length).T @ (X / length)
    inflation = np.diag(np.linalg.pinv(R, rcond=1e-12, hermitian=True)).copy()
    pairs = [
        (chosen[i], chosen[j], float(R[i, j]))
        for i in range(len(chosen))
        for j in range(i)
        if abs(R[i, j]) > HIGH_CORRELATION
    ]
    scaled = columns / np.sqrt(np.maximum(np.einsum("ij,ij->j", columns, columns), 1e-300))
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values = np.maximum(values, 1e-16)
    indices = np.sqrt(values[-1] / values)
    proportions = vectors**2 / values
    proportions = proportions / proportions.sum(axis=1, keepdims=True)
    groups = [
        tuple(terms[i] for i in range(len(terms)) if proportions[i, k] > _COLLINEAR_VARIANCE_SHARE)
        for k in range(len(values))
        if indices[k] > HIGH_INDEX
    ]
    groups = [group for group in groups if len(group) > 1]
    collinear = [{a, b} for a, b, _ in pairs] + [set(group) for group in groups]
    advice = [_advice(sorted(group, key=lambda term: term.text), surfaces) for group in collinear]
    return Collinearity(
        axis,
        chosen,
        inflation,
        tuple(pairs),
        np.sort(indices)[::-1],
        tuple(groups),
        tuple(dict.fromkeys(filter(None, advice))),
    )


def multiples_of(
    terms: Sequence[Term], columns: np.ndarray, chosen: Collection[Term]
) -> tuple[tuple[Term, Term], ...]:
    """Return the pairs of `Collinearity.multiples`: a chosen term, and a product that is nearly a
    multiple of it.

    Parameters
    ----------
    terms : the k candidate terms.
    columns : ``(N, k)`` values of the terms.
    chosen : the chosen ones of these terms.
    """
    X = columns - columns.mean(axis=0)
    squares = np.maximum(np.einsum("ij,ij->j", X, X), 1e-300)
    column = {term: i for i, term in enumerate(terms)}
    least_square_correlation = 1.0 - 1.0 / HIGH_INFLATION
    return tuple(
        (base, term)
        for term in terms
        for base in parents(term)
        if base in chosen
        and term not in chosen
        and base.signals < term.signals
        and (X[:, column[base]] @ X[:, column[term]]) ** 2
        > least_square_correlation * squares[column[base]] * squares[column[term]]
    )


def _advice(terms: Sequence[Term], surfaces: Collection[str]) -> str:
    """Return a sentence on the maneuver that separates the terms; empty without signals."""
    signals = sorted(set().union(*(term.signals for term in terms)))
    controls = [name for name in signals if name in surfaces]
    states = [name for name in signals if name not in surfaces]
    names = ", ".join(term.text for term in terms)
    if len(controls) > 1:
        return (
            f"{names}: move {' and '.join(controls)} one after the other, or together by signals "
            "without correlation (orthogonal multisines)"
        )
    if controls and states:
        follow = "follows" if len(states) == 1 else "follow"
        return (
            f"{names}: move {controls[0]} faster than {' and '.join(states)} {follow}, by short "
            "and long pulses in one maneuver (3-2-1-1) or by a sweep"
        )
    if len(states) > 1 and "alpha" in states and "q" in states:
        return f"{names}: fly pull-ups and turns at several load factors"
    if {"beta", "p", "r"} & set(states) and len(states) > 1:
        return f"{names}: add steady sideslips and rolls (bank to bank) to the rudder doublets"
    if "mach" in states:
        return f"{names}: repeat the maneuver at other airspeeds"
    if states:
        return f"{names}: cover a larger range of {' and '.join(states)}, as in a slow deceleration"
    return f"{names}: use larger deflections of {' and '.join(controls)}" if controls else ""
