"""Least squares on sums of products, with the noise of the signals taken out of them.

All columns of terms are multiplied with each other and with the coefficient and summed over each
maneuver, so that fifty maneuvers cost as much as one, and whole maneuvers are left out by
subtraction. A term is formed of measured signals. Their noise makes its sum of squares too large,
and the value of the term too small: by 4 % where the noise has a fifth of the size of the motion.
The noise of the signals is known, and so is what it adds to the sums on the average [1]_,

    E[X' X] = X0' X0 + sum_s D_s' D_s,   E[X' z] = X0' z0 + sum_s D_s' d_s,

with D_s, d_s the slopes of the terms and of the coefficient by signal s, times the standard
deviation of its noise. Both are subtracted.

Standard deviations that count the uncertainty of which terms belong to a coefficient.

The terms were chosen from the data that also give their values. A term that was left out although
the data nearly support it is a bias of its neighbours, and a term that took the place of a similar
one has a value of which only a part is its own. Other models explain the data almost as well; their
values are averaged with the probabilities of the models [2]_. The variance of a value is its mean
square distance from the value of the chosen model,

    s_i^2 = sum_m P_m (s_im^2 + (x_im - x_i)^2),

where a model without the term has x_im = 0 and s_im = 0. The models are the chosen one and those
that differ from it by one term: added, removed, or exchanged. A product takes no place of its own
factor: both explain the same where the other factor stands still. The probabilities follow from the
Bayesian information criterion [3]_ with residuals that are not white, and from prior odds: 1 for
each linear term that the symmetry of the aircraft allows, and 1 for all other terms together [4]_.

References
----------
.. [1] W. A. Fuller, Measurement Error Models, Wiley 1987, sections 2.2 and 3.1.
.. [2] J. A. Hoeting, D. Madigan, A. E. Raftery and C. T. Volinsky, Bayesian model averaging: a
   tutorial, Statistical Science 14(4), 1999.
.. [3] A. E. Raftery, Bayesian model selection in social research, Sociological Methodology 25,
   1995.
.. [4] J. G. Scott and J. O. Berger, Bayes and empirical-Bayes multiplicity adjustment in the
   variable-selection problem, Annals of Statistics 38(5), 2010.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.structure.coefficients import Histories
from sim.aerodynamics import Term

LARGE_RESIDUAL_RATIO = 1.3  # residual over noise, above which a share of the residual is enough
OF_RESIDUAL = 0.02
# share of a column that the others leave, below which it is no column of its own
INDEPENDENT_COLUMN_SHARE = 1e-9
# share of that part which has to be motion; the rest is noise of the signals
LEAST_MOTION_SHARE = 0.3
_WINDOW_LAGS = 8  # of windows that overlap by half


@dataclass(frozen=True, eq=False)
class Products:
    """Sums of products over maneuvers: of all columns with each other and with the coefficient.

    Attributes
    ----------
    terms : k columns. gram : ``(g, k, k)`` by maneuver; cross : ``(g, k)`` with the coefficient;
        total, squares : ``(g,)`` its sum and sum of squares; counts : ``(g,)`` samples.
    gram_noise, cross_noise : what the noise of the signals adds to ``gram`` and ``cross``; 0 where
        it is unknown.
    noise : sum of squares that the sensors' noise explains; infinite where it is unknown.
    """

    terms: tuple[Term, ...]
    gram: np.ndarray
    cross: np.ndarray
    total: np.ndarray
    squares: np.ndarray
    counts: np.ndarray
    gram_noise: np.ndarray
    cross_noise: np.ndarray
    noise: float = math.inf

    def least_gain(self, least: float, sse: float) -> float:
        """Sum of squares that a term has to explain where ``sse`` is left: ``least`` of the
        variance, or less while the residual is clearly larger than the noise.
        """
        of_variance = least * self.spread
        return (
            min(of_variance, OF_RESIDUAL * sse)
            if sse > LARGE_RESIDUAL_RATIO**2 * self.noise
            else of_variance
        )

    @property
    def spread(self) -> float:
        """Sum of squares about the mean, over all maneuvers."""
        n = float(self.counts.sum())
        return float(self.squares.sum()) - float(self.total.sum()) ** 2 / n


def columns_of(history: Histories, terms: Sequence[Term], axis: str) -> np.ndarray:
    """Averaged values of terms, ``(M, k)``, as they go with a coefficient."""
    return np.stack([history.column(term, axis) for term in terms], axis=1)


def noise_columns(history: Histories, terms: Sequence[Term]) -> np.ndarray:
    """Return the slopes of terms by each signal times the standard deviation of its noise, ``(s, M,
    k)``; the signals in the order of ``signal_noise``.
    """
    at = history.rows + len(history.averaging) // 2
    found = np.zeros((len(history.signal_noise), len(at), len(terms)))
    if not len(found):
        return found
    values = {name: row[at] for name, row in history.samples.items()}
    for row, (name, std) in zip(found, history.signal_noise.items(), strict=True):
        high, low = ({**values, name: values[name] + 0.5 * sign * std} for sign in (1.0, -1.0))
        for place, term in enumerate(terms):
            if name in term.signals and std > 0.0:
                row[:, place] = term.of(high) - term.of(low)
    return found


def products_of(
    blocks: Sequence[np.ndarray],
    rows: Sequence[np.ndarray],
    terms: Sequence[Term],
    noises: Sequence[tuple[np.ndarray, np.ndarray]] = (),
) -> Products:
    """Return the products of columns ``(M, k)`` and a coefficient ``(M,)``, by maneuver.

    Parameters
    ----------
    blocks, rows : by maneuver. terms : k.
    noises : by maneuver, of `noise_columns` and ``(s, M)`` of the coefficient by the same signals.
    """
    k = len(terms)
    gram_noise, cross_noise = np.zeros((len(blocks), k, k)), np.zeros((len(blocks), k))
    for g, (columns, own) in enumerate(noises):
        gram_noise[g] = sum((each.T @ each for each in columns), np.zeros((k, k)))
        cross_noise[g] = sum(
            (each.T @ z for each, z in zip(columns, own, strict=True)), np.zeros(k)
        )
    return Products(
        tuple(terms),
        np.array([block.T @ block for block in blocks]),
        np.array([block.T @ row for block, row in zip(blocks, rows, strict=True)]),
        np.array([row.sum() for row in rows]),
        np.array([row @ row for row in rows]),
        np.array([len(row) for row in rows]),
        gram_noise,
        cross_noise,
    )


@dataclass(frozen=True, eq=False)
class ScaledEquations:
    """Normal equations of chosen columns, each scaled to a unit sum of squares.

    Attributes
    ----------
    chosen : their places. scale : ``(k,)`` of all columns. gram, cross : of all, scaled, as
        measured; clean_gram, clean_cross : without the noise of the signals.
    inverse : ``(n, n)`` of the chosen ones, clean. share : of the noise that was taken out; below 1
        where more would leave less of some direction than ``LEAST_MOTION_SHARE``.
    """

    chosen: list[int]
    scale: np.ndarray
    gram: np.ndarray
    cross: np.ndarray
    clean_gram: np.ndarray
    clean_cross: np.ndarray
    inverse: np.ndarray
    share: float

    @property
    def values(self) -> np.ndarray:
        """Scaled values of the chosen columns, ``(n,)``."""
        return np.asarray(self.inverse @ self.clean_cross[self.chosen])

    @property
    def variance(self) -> np.ndarray:
        """Variances of the scaled values for residuals of unit variance, ``(n,)``."""
        part = self.gram[np.ix_(self.chosen, self.chosen)]
        return np.asarray(np.diag(self.inverse @ part @ self.inverse))

    def left(self, squares: float) -> float:
        """Sum of squares of the residual as measured; ``squares`` is that of the coefficient."""
        values = self.values
        part = self.gram[np.ix_(self.chosen, self.chosen)]
        sse = squares - 2.0 * values @ self.cross[self.chosen] + values @ part @ values
        return max(float(sse), 0.0)


def normal_of(products: Products, chosen: Sequence[int]) -> ScaledEquations:
    """Return the normal equations of the chosen columns over all maneuvers."""
    at = list(chosen)
    sums = [products.gram, products.cross, products.gram_noise, products.cross_noise]
    gram, cross, gram_noise, cross_noise = (each.sum(axis=0) for each in sums)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram, gram_noise = gram / np.outer(scale, scale), gram_noise / np.outer(scale, scale)
    cross, cross_noise = cross / scale, cross_noise / scale
    inverse, share = clean_inverse(gram[np.ix_(at, at)], gram_noise[np.ix_(at, at)])
    clean_gram, clean_cross = gram - share * gram_noise, cross - share * cross_noise
    return ScaledEquations(at, scale, gram, cross, clean_gram, clean_cross, inverse, share)


def clean_inverse(gram: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the inverse of a scaled matrix of products less that of its noise, and the share of
    the noise that was subtracted.
    """
    inverse = np.linalg.pinv(gram, rcond=1e-12, hermitian=True)
    if not np.any(noise):
        return inverse, 1.0
    largest = float(np.max(np.linalg.eigvals(inverse @ noise).real))
    share = min(1.0, (1.0 - LEAST_MOTION_SHARE) / max(largest, 1e-300))
    return np.linalg.pinv(gram - share * noise, rcond=1e-12, hermitian=True), share


def values_of(products: Products, chosen: Sequence[int]) -> np.ndarray:
    """Return the values of the chosen columns, ``(n,)``."""
    found = normal_of(products, chosen)
    return np.asarray(found.values / found.scale[found.chosen])


def variance_of(products: Products, chosen: Sequence[int]) -> np.ndarray:
    """Return the variances of the chosen values for white residuals of unit variance, ``(n,)``."""
    found = normal_of(products, chosen)
    return np.asarray(found.variance / found.scale[found.chosen] ** 2)


def gains_of(products: Products, chosen: Sequence[int]) -> tuple[np.ndarray, float]:
    """Return the sum of squares that each further column would explain, ``(k,)``, and the present
    residual's.

    A column explains nothing if its part independent of the others is mostly noise.
    """
    squares = float(products.squares.sum())
    n = normal_of(products, chosen)
    weights = n.inverse @ n.clean_gram[n.chosen]
    clean = np.diag(n.clean_gram) - np.einsum("ij,ij->j", n.clean_gram[n.chosen], weights)
    part = n.clean_cross - n.clean_cross[n.chosen] @ weights
    own = n.gram[np.ix_(n.chosen, n.chosen)]
    measured = (
        np.diag(n.gram)
        - 2.0 * np.einsum("ij,ij->j", n.gram[n.chosen], weights)
        + np.einsum("ij,ij->j", weights, own @ weights)
    )
    good = (measured > INDEPENDENT_COLUMN_SHARE) & (clean > LEAST_MOTION_SHARE * measured)
    gains = np.where(good, part**2 / np.maximum(measured, INDEPENDENT_COLUMN_SHARE), 0.0)
    gains[n.chosen] = 0.0
    return gains, n.left(squares)


def losses_of(products: Products, chosen: Sequence[int]) -> tuple[list[float], float]:
    """Return the sum of squares that each chosen column alone explains, and the sum of squares of
    the residual.
    """
    n = normal_of(products, chosen)
    losses = n.values**2 / np.maximum(n.variance, 1e-300)
    return losses.tolist(), n.left(float(products.squares.sum()))


def ratio_of(products: Products, gain: float, sse: float, count: int) -> float:
    """Partial F ratio of a term that explains ``gain``, with ``sse`` left by ``count`` terms."""
    freedom = float(products.counts.sum()) - count
    return float(gain / max(sse / max(freedom, 1.0), 1e-300))


def held_out_of(products: Products, chosen: Sequence[int]) -> float:
    """R2 of maneuvers that the others predict; NaN with one maneuver."""
    groups = len(products.counts)
    if groups < 2:
        return math.nan
    at = list(chosen)
    whole = normal_of(products, at)
    scale, block = whole.scale[at], np.ix_(range(groups), at, at)
    outer = np.outer(scale, scale)
    gram, cross = products.gram[block] / outer, products.cross[:, at] / scale
    clean = gram - whole.share * products.gram_noise[block] / outer
    aimed = cross - whole.share * products.cross_noise[:, at] / scale
    others = np.linalg.pinv(clean.sum(axis=0) - clean, rcond=1e-12, hermitian=True)
    values = np.einsum("gij,gj->gi", others, aimed.sum(axis=0) - aimed)
    model = np.einsum("gi,gij,gj->g", values, gram, values)
    error = float(np.sum(products.squares - 2.0 * np.sum(values * cross, axis=1) + model))
    return 1.0 - error / max(products.spread, 1e-300)


def covariance_of(
    parts: Sequence[np.ndarray],
    residuals: Sequence[np.ndarray],
    drifts: Sequence[np.ndarray] | None = None,
    noise: np.ndarray | None = None,
    *,
    local: bool = True,
) -> np.ndarray:
    """Return the covariance ``(n, n)`` of the values with the autocorrelation of the residuals, as
    of one variance throughout, and where ``local`` as of residuals that are larger in places, as
    where a noisy alpha turns a large lift into drag (White; Newey and West): the larger of both.

    Lags are weighted by a trapezoid, 1 up to half of them [1]_: noise of angular accelerations is
    weak at low frequencies, which Bartlett's triangle hides. The triangle serves where the
    trapezoid leaves a variance that is not positive.

    Parameters
    ----------
    parts, residuals : ``(M, n)`` and ``(M,)`` by maneuver.
    drifts : ``(n,)`` by maneuver, mean of column times residual, by the noise of the signals.
    noise : ``(n, n)`` that the noise of the signals adds to the products of the columns.

    References
    ----------
    .. [1] D. N. Politis and J. P. Romano, Bias-corrected nonparametric spectral estimation, Journal
       of Time Series Analysis 16(1), 1995.
    """
    gram = sum(part.T @ part for part in parts)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    outer = np.outer(scale, scale)
    noise = np.zeros_like(gram) if noise is None else noise
    inverse, _ = clean_inverse(gram / outer, noise / outer)
    shifts: Any = np.zeros((len(parts), len(gram))) if drifts is None else drifts
    n, count = sum(len(e) for e in residuals), len(gram)
    scores = [
        (X * e[:, None] - shift) / scale
        for X, e, shift in zip(parts, residuals, shifts, strict=True)
    ]
    even: list[Any] = []
    uneven: list[Any] = []
    for lag in range(min(_WINDOW_LAGS, min(len(e) for e in residuals) - 1) + 1):
        together = sum(float(e[: len(e) - lag] @ e[lag:]) for e in residuals)
        pairs = [(X[: len(X) - lag] / scale, X[lag:] / scale) for X in parts]
        even.append(together / n * sum(a.T @ b for a, b in pairs))
        uneven.append(sum(each[: len(each) - lag].T @ each[lag:] for each in scores))
    freedom = n / max(n - count, 1)
    one, other = (freedom * inverse @ _over_lags(each) @ inverse for each in (even, uneven))
    larger = np.maximum(local * np.diag(other) / np.maximum(np.diag(one), 1e-300), 1.0)
    return np.asarray(one * np.sqrt(np.outer(larger, larger)) / outer)


def _over_lags(products: Sequence[np.ndarray]) -> np.ndarray:
    """Weighted sum of ``(n, n)`` products by lag and their transposes."""
    triangle = 1.0 - np.arange(len(products)) / (_WINDOW_LAGS + 1.0)
    for weights in (np.minimum(2.0 * triangle, 1.0), triangle):
        weights[0] = 0.5
        half = np.tensordot(weights, np.array(products), 1)
        whole = np.asarray(half + half.T)
        if np.linalg.eigvalsh(whole)[0] > 0.0:
            break
    return whole


NEGLIGIBLE = 1e-3  # probability over that of the likeliest model, below which one is left out
CLEARLY_LARGER = 2.0  # standard deviation over that of the chosen model, above which it is told why


@dataclass(frozen=True)
class Alternative:
    """A model that differs from the chosen one by one term.

    Attributes
    ----------
    added, removed : columns; None where none is. probability : among the models that were averaged.
    """

    added: int | None
    removed: int | None
    probability: float


def averaged_covariance(
    products: Products,
    chosen: Sequence[int],
    covariance: np.ndarray,
    even: np.ndarray,
    linear: Collection[int],
    made_of: Sequence[Collection[int]],
) -> tuple[np.ndarray, Alternative | None]:
    """Covariance ``(n, n)`` of the chosen values over the models that explain the data as well.

    Parameters
    ----------
    products : of all offered columns. chosen : columns of the model.
    covariance : ``(n, n)`` of its values; even : their variances ``(n,)`` for coloured residuals of
        one variance. linear : columns of linear terms. made_of : by column those of
        its signals or factors alone, which no model with it loses.

    Returns
    -------
    The same with each standard deviation as large as the models ask, and never smaller than before;
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
    colour = float(np.median(even / np.maximum(own * white, 1e-300)))
    models = _neighbours(products, chosen, movable, colour * white, n / colour, linear, made_of)
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
    made_of: Sequence[Collection[int]],
) -> list[tuple[float, list[int]]]:
    """Return the chosen model and those with one term added, removed or exchanged, each with the
    logarithm of its probability over that of the chosen one.

    Parameters
    ----------
    variance : of the residual, as of one white residual for each of ``count`` samples.
    """
    others = sum(bool(term.factors) for term in products.terms) - len(linear)
    prior = [0.0 if i in linear else -math.log(max(others, 1)) for i in range(len(products.terms))]
    entry = np.array(prior) - 0.5 * math.log(max(count, 1.0))

    def further(model: list[int], base: float) -> list[tuple[float, list[int]]]:
        removed = set(chosen) - set(model)
        gains, left = gains_of(products, model)
        logs = base - 0.5 * (left - sse - gains) / variance + entry
        return [
            (float(logs[i]), [*model, i])
            for i, gain in enumerate(gains)
            if gain > 0.0 and i not in chosen and not removed & set(made_of[i])
        ]

    sse = losses_of(products, chosen)[1]
    found = [(0.0, chosen), *further(chosen, 0.0)]
    for gone in movable:
        rest = [i for i in chosen if i != gone]
        if any(gone in made_of[i] for i in rest):
            continue
        left = gains_of(products, rest)[1]
        found.append((-0.5 * (left - sse) / variance - float(entry[gone]), rest))
        found += further(rest, -float(entry[gone]))
    return found
