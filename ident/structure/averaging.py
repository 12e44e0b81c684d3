"""Standard deviations that count the uncertainty of which terms belong to a coefficient.

The terms were chosen from the data that also give their values. A term that was left out although
the data nearly support it is a bias of its neighbours, and a term that took the place of a similar
one has a value of which only a part is its own. Other models explain the data almost as well; their
values are averaged with the probabilities of the models [1]_. The variance of a value is its mean
square distance from the value of the chosen model,

    s_i^2 = sum_m P_m (s_im^2 + (x_im - x_i)^2),

where a model without the term has x_im = 0 and s_im = 0. The models are the chosen one and those
that differ from it by one term: added, removed, or exchanged. A product is not exchanged for one of
its own factors: where the other factor is constant, both explain the same. The probabilities follow
from the Bayesian information criterion [2]_ with residuals that are not white, and from prior odds:
1 for each linear term that the symmetry of the aircraft allows, and 1 for all other terms together
[3]_.

The criterion compares sums of squares from which the noise of the signals is taken out, as from the
normal equations [4]_. As measured, they contain the noise that passes through the terms, more of it
in one model than in another whatever is true.

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
    further_of,
    losses_of,
    normal_of,
    values_of,
    variance_of,
)

NEGLIGIBLE = 1e-3  # probability over that of the likeliest model, below which a model is left out
CLEARLY_LARGER = 2.0  # ratio of standard deviations, above which the likeliest other model is named


@dataclass(frozen=True)
class Alternative:
    """A model that differs from the chosen one by one term.

    Attributes
    ----------
    added, removed : columns; None where there is none.
    probability : among the models that were averaged.
    """

    added: int | None
    removed: int | None
    probability: float


def averaged_covariance(
    products: Products,
    chosen: Sequence[int],
    covariance: np.ndarray,
    equal: np.ndarray,
    linear: Collection[int],
    constituents: Sequence[Collection[int]],
) -> tuple[np.ndarray, Alternative | None]:
    """Covariance ``(n, n)`` of the chosen values over the models that explain the data as well.

    Parameters
    ----------
    products : of all offered columns.
    chosen : columns of the model.
    covariance : ``(n, n)`` of its values.
    equal : their variances ``(n,)`` for coloured residuals with equal variances at all samples.
    linear : columns of linear terms.
    constituents : by column the terms of its signals or factors alone; a model that contains the
        column contains them too.

    Returns
    -------
    The covariance with each standard deviation increased as the models require, never decreased;
    and the likeliest other model where some standard deviation is clearly larger than before.
    """
    chosen = list(chosen)
    products = replace(
        products,
        gram=products.gram.sum(axis=0)[None],
        cross=products.cross.sum(axis=0)[None],
        gram_noise=products.gram_noise.sum(axis=0)[None],
        cross_noise=products.cross_noise.sum(axis=0)[None],
    )
    values, own = values_of(products, chosen), variance_of(products, chosen)
    movable = [i for i in chosen if products.terms[i].factors]
    if not movable:
        return covariance, None
    sse = losses_of(products, chosen)[1]
    n = float(products.counts.sum())
    white = sse / max(n - len(chosen), 1.0)
    colouring = float(np.median(equal / np.maximum(own * white, 1e-300)))
    models = _neighbours(
        products, chosen, movable, colouring * white, n / colouring, linear, constituents
    )
    likeliest = max(log for log, _ in models)
    models = [(log, model) for log, model in models if log > likeliest + math.log(NEGLIGIBLE)]
    shares = np.exp([log - likeliest for log, _ in models])
    shares /= shares.sum()
    square = np.zeros(len(chosen))
    for share, (_, model) in zip(shares, models, strict=True):
        at = {column: place for place, column in enumerate(model)}
        there = values_of(products, model)
        spread = variance_of(products, model)
        for place, column in enumerate(chosen):
            if column in at:
                larger = spread[at[column]] / max(own[place], 1e-300)
                off = there[at[column]] - values[place]
                square[place] += share * (larger * covariance[place, place] + off**2)
            else:
                square[place] += share * values[place] ** 2
    ratio = np.sqrt(np.maximum(square / np.maximum(np.diag(covariance), 1e-300), 1.0))
    other = _likeliest_other(shares, models, chosen) if ratio.max() > CLEARLY_LARGER else None
    return np.asarray(covariance * np.outer(ratio, ratio)), other


def _likeliest_other(
    shares: np.ndarray, models: Sequence[tuple[float, list[int]]], chosen: Sequence[int]
) -> Alternative | None:
    """Return the likeliest of the models that is not the chosen one."""
    others = [
        (float(share), model)
        for share, (_, model) in zip(shares, models, strict=True)
        if set(model) != set(chosen)
    ]
    if not others:
        return None
    share, model = max(others)
    added, removed = (sorted(a) for a in (set(model) - set(chosen), set(chosen) - set(model)))
    return Alternative(added[0] if added else None, removed[0] if removed else None, share)


def _neighbours(
    products: Products,
    chosen: list[int],
    movable: Sequence[int],
    variance: float,
    count: float,
    linear: Collection[int],
    constituents: Sequence[Collection[int]],
) -> list[tuple[float, list[int]]]:
    """Return the chosen model and those with one term added, removed or exchanged, each with the
    logarithm of its probability over that of the chosen one.

    Parameters
    ----------
    count : of independent residuals, fewer than the samples if residuals are coloured.
    variance : of each of these residuals.
    """
    others = sum(bool(term.factors) for term in products.terms) - len(linear)
    prior = [0.0 if i in linear else -math.log(max(others, 1)) for i in range(len(products.terms))]
    gain_to_enter = np.array(prior) - 0.5 * math.log(max(count, 1.0))
    squares = float(products.squares.sum())
    left = normal_of(products, chosen).clean_left(squares)

    def with_further(model: list[int], base: float) -> list[tuple[float, list[int]]]:
        n, removed = normal_of(products, model), set(chosen) - set(model)
        here = base - 0.5 * (n.clean_left(squares) - left) / variance
        further = further_of(n)
        logs = here + 0.5 * further.reductions / variance + gain_to_enter
        every = [
            (float(logs[i]), [*model, i])
            for i in np.flatnonzero(further.good).tolist()
            if not removed & {i, *constituents[i]}
        ]
        return [(here, model), *every]

    found = with_further(chosen, 0.0)
    for gone in movable:
        rest = [i for i in chosen if i != gone]
        if not any(gone in constituents[i] for i in rest):
            found += with_further(rest, -float(gain_to_enter[gone]))
    return found
