"""Least squares on sums of products, from which the effect of noise in the signals is subtracted.

The products of all columns of terms with each other and with the coefficient are summed over each
maneuver. The computing time then hardly depends on the number of samples, and a maneuver can be
left out by subtraction.

A term is a function of measured signals. Their noise makes its sum of squares too large, and its
estimated value too small: by 4 % where the noise is a fifth of the motion. The noise of the signals
is known, and so is its mean contribution to the sums [1]_,

    E[X' X] = X0' X0 + sum_s D_s' D_s,   E[X' z] = X0' z0 + sum_s D_s' d_s,

with D_s and d_s the derivatives of the terms and of the coefficient with respect to signal s, times
the standard deviation of its noise. Both contributions are subtracted.

References
----------
.. [1] W. A. Fuller, Measurement Error Models, Wiley 1987, sections 2.2 and 3.1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.structure.coefficients import Histories
from sim.aerodynamics import Term

LARGE_RESIDUAL_RATIO = 1.3  # smallest ratio of a large residual to the noise
LEAST_RESIDUAL_SHARE = 0.02  # smallest share of a large residual that a term has to explain
# smallest share of the sum of squares of a column that is independent of other columns
INDEPENDENT_COLUMN_SHARE = 1e-9
# smallest share of the independent part of a column that is motion and not noise of the signals
LEAST_MOTION_SHARE = 0.3
_WINDOW_LAGS = 8  # largest lag of autocovariances, in windows that overlap by half


@dataclass(frozen=True, eq=False)
class Products:
    """Sums of products of k columns and a coefficient over each of g maneuvers.

    Attributes
    ----------
    terms : the k terms, one for each column.
    gram : ``(g, k, k)`` columns with each other.
    cross : ``(g, k)`` columns with the coefficient.
    total, squares : ``(g,)`` sum and sum of squares of the coefficient.
    counts : ``(g,)`` samples.
    gram_noise, cross_noise : mean contribution of the noise of the signals to ``gram`` and
        ``cross``; zero if it is unknown.
    noise : sum of squares due to sensor noise; infinite if it is unknown.
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
        """Return the sum of squares that a term has to explain: the share ``least`` of the
        variance, or less while the residual, with sum of squares ``sse``, is large.
        """
        of_variance = least * self.spread
        if sse > LARGE_RESIDUAL_RATIO**2 * self.noise:
            return min(of_variance, LEAST_RESIDUAL_SHARE * sse)
        return of_variance

    @property
    def spread(self) -> float:
        """Sum of squares of the coefficient about its mean, over all maneuvers."""
        n = float(self.counts.sum())
        return float(self.squares.sum()) - float(self.total.sum()) ** 2 / n


def columns_of(history: Histories, terms: Sequence[Term], axis: str) -> np.ndarray:
    """Return the values ``(M, k)`` of terms, averaged as the coefficient ``axis`` is."""
    return np.stack([history.column(term, axis) for term in terms], axis=1)


def noise_columns(history: Histories, terms: Sequence[Term]) -> np.ndarray:
    """Return the derivatives ``(s, M, k)`` of terms with respect to each signal, times the standard
    deviation of its noise. The signals are in the order of ``signal_noise``.
    """
    at = history.rows + len(history.averaging) // 2
    derivatives = np.zeros((len(history.signal_noise), len(at), len(terms)))
    if not len(derivatives):
        return derivatives
    values = {name: row[at] for name, row in history.samples.items()}
    for row, (name, std) in zip(derivatives, history.signal_noise.items(), strict=True):
        high, low = ({**values, name: values[name] + 0.5 * sign * std} for sign in (1.0, -1.0))
        for column, term in enumerate(terms):
            if name in term.signals and std > 0.0:
                row[:, column] = term.of(high) - term.of(low)
    return derivatives


def products_of(
    blocks: Sequence[np.ndarray],
    rows: Sequence[np.ndarray],
    terms: Sequence[Term],
    noises: Sequence[tuple[np.ndarray, np.ndarray]] = (),
) -> Products:
    """Return the sums of products over each maneuver.

    Parameters
    ----------
    blocks : ``(M, k)`` columns of each maneuver.
    rows : ``(M,)`` coefficient of each maneuver.
    terms : the k terms.
    noises : of each maneuver, the result of `noise_columns`, and the noise ``(s, M)`` of the
        coefficient by the same signals.
    """
    k = len(terms)
    gram_noise, cross_noise = np.zeros((len(blocks), k, k)), np.zeros((len(blocks), k))
    for g, (columns, coefficient_noise) in enumerate(noises):
        gram_noise[g] = sum((D.T @ D for D in columns), np.zeros((k, k)))
        cross_noise[g] = sum(
            (D.T @ d for D, d in zip(columns, coefficient_noise, strict=True)), np.zeros(k)
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
    """Normal equations of n chosen columns among k, each scaled to a unit sum of squares.

    Attributes
    ----------
    chosen : positions of the chosen columns.
    scale : ``(k,)`` scale of each column.
    gram, cross : ``(k, k)`` and ``(k,)`` scaled products as measured.
    clean_gram, clean_cross : the same without the noise of the signals.
    inverse : ``(n, n)`` inverse of ``clean_gram`` of the chosen columns.
    share : share of the noise that was subtracted. It is below 1 where some direction would keep
        less motion than ``LEAST_MOTION_SHARE``.
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
        """Variances ``(n,)`` of the scaled values, for white residuals of unit variance."""
        part = self.gram[np.ix_(self.chosen, self.chosen)]
        return np.asarray(np.diag(self.inverse @ part @ self.inverse))

    def residual_squares(self, squares: float) -> float:
        """Return the sum of squares of the measured residual; ``squares`` is that of the
        coefficient.
        """
        values = self.values
        part = self.gram[np.ix_(self.chosen, self.chosen)]
        sse = squares - 2.0 * values @ self.cross[self.chosen] + values @ part @ values
        return max(float(sse), 0.0)

    def clean_residual_squares(self, squares: float) -> float:
        """Return the sum of squares of the residual without the contribution of the noise of the
        signals; it may be negative.
        """
        return squares - float(self.values @ self.clean_cross[self.chosen])


def normal_equations(products: Products, chosen: Sequence[int]) -> ScaledEquations:
    """Return the normal equations of the chosen columns over all maneuvers."""
    columns = list(chosen)
    sums = [products.gram, products.cross, products.gram_noise, products.cross_noise]
    gram, cross, gram_noise, cross_noise = (part.sum(axis=0) for part in sums)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram, gram_noise = gram / np.outer(scale, scale), gram_noise / np.outer(scale, scale)
    cross, cross_noise = cross / scale, cross_noise / scale
    inverse, share = clean_inverse(
        gram[np.ix_(columns, columns)], gram_noise[np.ix_(columns, columns)]
    )
    clean_gram, clean_cross = gram - share * gram_noise, cross - share * cross_noise
    return ScaledEquations(columns, scale, gram, cross, clean_gram, clean_cross, inverse, share)


def clean_inverse(gram: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the inverse of ``gram`` minus ``noise``, both scaled ``(n, n)``, and the share of the
    noise that was subtracted.
    """
    inverse = np.linalg.pinv(gram, rcond=1e-12, hermitian=True)
    if not np.any(noise):
        return inverse, 1.0
    largest = float(np.max(np.linalg.eigvals(inverse @ noise).real))
    share = min(1.0, (1.0 - LEAST_MOTION_SHARE) / max(largest, 1e-300))
    return np.linalg.pinv(gram - share * noise, rcond=1e-12, hermitian=True), share


def values_of(products: Products, chosen: Sequence[int]) -> np.ndarray:
    """Return the values of the chosen columns, ``(n,)``."""
    equations = normal_equations(products, chosen)
    return np.asarray(equations.values / equations.scale[equations.chosen])


def variance_of(products: Products, chosen: Sequence[int]) -> np.ndarray:
    """Return the variances of the chosen values for white residuals of unit variance, ``(n,)``."""
    equations = normal_equations(products, chosen)
    return np.asarray(equations.variance / equations.scale[equations.chosen] ** 2)


@dataclass(frozen=True, eq=False)
class FurtherColumns:
    """Gain of each of k columns when it is added to a model alone; columns are scaled to a unit sum
    of squares.

    Attributes
    ----------
    value : ``(k,)`` estimated value in addition to the chosen columns.
    clean, measured : ``(k,)`` sum of squares of the part that is independent of the chosen columns,
        without and with the noise of the signals.
    good : ``(k,)`` whether a column is not chosen and its independent part is not mostly noise.
    """

    value: np.ndarray
    clean: np.ndarray
    measured: np.ndarray
    good: np.ndarray

    @property
    def gains(self) -> np.ndarray:
        """Square of the value over its variance, ``(k,)``, for residuals of unit variance."""
        own = np.maximum(self.measured, INDEPENDENT_COLUMN_SHARE)
        return np.where(self.good, (self.value * self.clean) ** 2 / own, 0.0)

    @property
    def reductions(self) -> np.ndarray:
        """Decrease of `ScaledEquations.clean_residual_squares`, ``(k,)``."""
        return np.where(self.good, self.value**2 * self.clean, 0.0)


def further_columns(equations: ScaledEquations) -> FurtherColumns:
    """Return the gain of each further column in the model of the normal equations ``equations``."""
    chosen = equations.chosen
    weights = equations.inverse @ equations.clean_gram[chosen]
    clean = np.diag(equations.clean_gram) - np.einsum(
        "ij,ij->j", equations.clean_gram[chosen], weights
    )
    part = equations.clean_cross - equations.clean_cross[chosen] @ weights
    chosen_gram = equations.gram[np.ix_(chosen, chosen)]
    measured = (
        np.diag(equations.gram)
        - 2.0 * np.einsum("ij,ij->j", equations.gram[chosen], weights)
        + np.einsum("ij,ij->j", weights, chosen_gram @ weights)
    )
    good = (measured > INDEPENDENT_COLUMN_SHARE) & (clean > LEAST_MOTION_SHARE * measured)
    good[chosen] = False
    return FurtherColumns(part / np.where(good, clean, 1.0), clean, measured, good)


def gains_of(products: Products, chosen: Sequence[int]) -> tuple[np.ndarray, float]:
    """Return the sum of squares ``(k,)`` that each further column would explain, and the sum of
    squares of the residual. The gain of a column is zero if its independent part is mostly noise.
    """
    n = normal_equations(products, chosen)
    return further_columns(n).gains, n.residual_squares(float(products.squares.sum()))


def losses_of(products: Products, chosen: Sequence[int]) -> tuple[list[float], float]:
    """Return the sum of squares that each chosen column alone explains, and the sum of squares of
    the residual.
    """
    n = normal_equations(products, chosen)
    losses = n.values**2 / np.maximum(n.variance, 1e-300)
    return losses.tolist(), n.residual_squares(float(products.squares.sum()))


def partial_f_ratio(products: Products, gain: float, sse: float, count: int) -> float:
    """Return the partial F ratio of a term that explains the sum of squares ``gain``; ``sse`` is
    that of the residual of ``count`` terms.
    """
    freedom = float(products.counts.sum()) - count
    return float(gain / max(sse / max(freedom, 1.0), 1e-300))


def cross_validated_r2(products: Products, chosen: Sequence[int]) -> float:
    """Return R2 of the predictions of each maneuver by a fit of all others; NaN with one
    maneuver.
    """
    groups = len(products.counts)
    if groups < 2:
        return math.nan
    at = list(chosen)
    whole = normal_equations(products, at)
    scale, block = whole.scale[at], np.ix_(range(groups), at, at)
    outer = np.outer(scale, scale)
    gram, cross = products.gram[block] / outer, products.cross[:, at] / scale
    clean = gram - whole.share * products.gram_noise[block] / outer
    clean_cross = cross - whole.share * products.cross_noise[:, at] / scale
    others = np.linalg.pinv(clean.sum(axis=0) - clean, rcond=1e-12, hermitian=True)
    values = np.einsum("gij,gj->gi", others, clean_cross.sum(axis=0) - clean_cross)
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
    unbiased: bool = False,
) -> np.ndarray:
    """Return the covariance ``(n, n)`` of the values for autocorrelated residuals.

    The covariance for residuals with the same variance everywhere is compared with that for
    residuals that may be larger in some parts of a maneuver (White; Newey and West), for example
    where noise of alpha changes the direction of a large lift. The larger one is returned.

    Lags have the weights of a trapezoid, which is 1 up to half of them [1]_. Noise of angular
    accelerations is weak at low frequencies, and Bartlett's triangle hides this. The triangle is
    used where the trapezoid makes a variance that is not positive.

    Parameters
    ----------
    parts : ``(M, n)`` columns of each maneuver.
    residuals : ``(M,)`` of each maneuver.
    drifts : ``(n,)`` of each maneuver, mean of columns times residual by the noise of the signals.
    noise : ``(n, n)`` contribution of the noise of the signals to the products of the columns.
    local : whether residuals may be larger in some parts of a maneuver.
    unbiased : whether the autocovariances are the unbiased ones of `autocovariances_of`, if these
        give positive variances. Otherwise the fit is assumed to reduce all lags equally.

    References
    ----------
    .. [1] D. N. Politis and J. P. Romano, Bias-corrected nonparametric spectral estimation, Journal
       of Time Series Analysis 16(1), 1995.
    """
    scale, inverse = _scaled_inverse(parts, noise)
    shifts: Any = np.zeros((len(parts), len(scale))) if drifts is None else drifts
    n = sum(len(e) for e in residuals)
    freedom = n / max(n - len(scale), 1)
    scores = [
        (X * e[:, None] - shift) / scale
        for X, e, shift in zip(parts, residuals, shifts, strict=True)
    ]
    lags = range(_lag_count(residuals))
    uneven = [sum(each[: len(each) - lag].T @ each[lag:] for each in scores) for lag in lags]
    lagged = _lagged_products(parts, scale, len(lags))
    for corrected in (unbiased, False):
        autocovariances = autocovariances_of(parts, residuals, unbiased=corrected)
        even = _sum_over_lags([row * X for row, X in zip(autocovariances, lagged, strict=True)])
        if _is_positive_definite(even):
            break
    even_covariance = inverse @ even @ inverse
    uneven_covariance = freedom * inverse @ _sum_over_lags(uneven) @ inverse
    larger = np.maximum(
        local * np.diag(uneven_covariance) / np.maximum(np.diag(even_covariance), 1e-300), 1.0
    )
    return np.asarray(even_covariance * np.sqrt(np.outer(larger, larger)) / np.outer(scale, scale))


def autocovariances_of(
    parts: Sequence[np.ndarray], residuals: Sequence[np.ndarray], *, unbiased: bool = True
) -> np.ndarray:
    """Return the autocovariances of the noise from the residuals of a fit, from lag 0 to
    ``_WINDOW_LAGS``.

    A fit removes the slow part of the noise, and so reduces the products at larger lags more than
    the variance. Let R be the matrix that makes residuals from noise, D_l the shift by l samples
    and r_k the autocovariances. Then

        E[e' D_l e] = sum_k r_k tr(R D_l R S_k),   S_0 = I,  S_k = D_k + D_k',

    is solved for r_k [1]_. Where the solution has an autocovariance larger than the variance, and
    without ``unbiased``, each product is divided by the number of samples minus that of columns.

    Parameters
    ----------
    parts : ``(M, n)`` columns of each maneuver.
    residuals : ``(M,)`` of each maneuver.

    References
    ----------
    .. [1] K. J. Worsley and others, A general statistical analysis for fMRI data, NeuroImage 15(1),
       2002, appendix A.
    """
    lags = _lag_count(residuals)
    sums = np.array(
        [sum(float(e[: len(e) - lag] @ e[lag:]) for e in residuals) for lag in range(lags)]
    )
    n, count = sum(len(e) for e in residuals), parts[0].shape[1]
    plain = sums / max(n - count, 1)
    if not unbiased:
        return np.asarray(plain)
    ends = np.cumsum([len(X) for X in parts])
    basis = np.split(np.linalg.qr(np.concatenate(parts))[0], ends[:-1])
    ahead, behind = np.zeros((2, lags, n, count))
    for Q, end in zip(basis, ends, strict=True):
        for lag in range(lags):
            ahead[lag, end - len(Q) : end - lag] = Q[lag:]
            behind[lag, end - len(Q) + lag : end] = Q[: len(Q) - lag]
    both = ahead + behind
    both[0] *= 0.5
    inside = np.einsum("ni,lnj->lij", ahead[0], ahead), np.einsum("ni,lnj->lij", ahead[0], both)
    lost = np.einsum("lni,kni->lk", behind, both) + np.einsum("lni,kni->lk", ahead, both)
    kept = np.diag([float(sum(len(Q) - lag for Q in basis)) for lag in range(lags)])
    matrix = kept - lost + np.einsum("lij,kji->lk", *inside)
    solution = np.linalg.lstsq(matrix, sums, rcond=None)[0]
    return np.asarray(solution if np.all(np.abs(solution) <= solution[0]) else plain)


def _scaled_inverse(
    parts: Sequence[np.ndarray], noise: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lengths of the columns, and the noise-corrected inverse of their unit products."""
    gram = np.asarray(sum(part.T @ part for part in parts))
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    outer = np.outer(scale, scale)
    return scale, clean_inverse(gram / outer, 0.0 * gram if noise is None else noise / outer)[0]


def _lag_count(residuals: Sequence[np.ndarray]) -> int:
    """Return the number of lags, with lag 0."""
    return min(_WINDOW_LAGS, min(len(e) for e in residuals) - 1) + 1


def _lagged_products(parts: Sequence[np.ndarray], scale: np.ndarray, lags: int) -> list[np.ndarray]:
    """Return for each lag the products ``(n, n)`` of the unit columns with their shifted copies."""
    pairs = [X / scale for X in parts]
    return [np.asarray(sum(X[: len(X) - lag].T @ X[lag:] for X in pairs)) for lag in range(lags)]


def _sum_over_lags(products: Sequence[np.ndarray]) -> np.ndarray:
    """Return the weighted sum of products ``(n, n)`` over lags and of their transposes."""
    triangle = 1.0 - np.arange(len(products)) / (_WINDOW_LAGS + 1.0)
    for weights in (np.minimum(2.0 * triangle, 1.0), triangle):
        weights[0] = 0.5
        half = np.tensordot(weights, np.array(products), 1)
        whole = np.asarray(half + half.T)
        if _is_positive_definite(whole):
            break
    return whole


def _is_positive_definite(matrix: np.ndarray) -> bool:
    """Return whether a symmetric matrix is positive definite."""
    return bool(np.linalg.eigvalsh(matrix)[0] > 0.0)


@dataclass(frozen=True, eq=False)
class TermColumns:
    """Values of k terms, averaged as a coefficient is.

    Attributes
    ----------
    terms : the k terms.
    blocks : ``(M, k)`` of each maneuver.
    noises : ``(s, M, k)`` of each maneuver, see `noise_columns`.
    """

    terms: tuple[Term, ...]
    blocks: Sequence[np.ndarray]
    noises: Sequence[np.ndarray]

    @classmethod
    def of(cls, histories: Sequence[Histories], axis: str, terms: Sequence[Term]) -> TermColumns:
        """Return the columns of terms for the coefficient ``axis``, from the histories of all
        maneuvers.
        """
        blocks = [columns_of(h, terms, axis) for h in histories]
        return cls(tuple(terms), blocks, [noise_columns(h, terms) for h in histories])

    def products(self, histories: Sequence[Histories], axis: str) -> Products:
        """Return the sums of products with the coefficient ``axis``, and the part that noise adds
        to them.
        """
        rows = [h.coefficients[axis] for h in histories]
        coefficient_noises = [h.coefficient_noise(axis) for h in histories]
        noises = list(zip(self.noises, coefficient_noises, strict=True))
        return products_of(self.blocks, rows, self.terms, noises)

    def residuals(
        self, rows: Sequence[np.ndarray], chosen: Sequence[int], values: np.ndarray
    ) -> list[np.ndarray]:
        """Return the residuals ``(M,)`` of each maneuver: its coefficient in ``rows`` minus the
        chosen columns times their values.
        """
        pairs = zip(rows, self.blocks, strict=True)
        return [row - block[:, chosen] @ values for row, block in pairs]

    def covariance(
        self,
        products: Products,
        chosen: Sequence[int],
        values: np.ndarray,
        rows: Sequence[np.ndarray],
        *,
        local: bool = True,
        unbiased: bool = False,
    ) -> np.ndarray:
        """Return the covariance of the values, ``(n, n)``; see `covariance_of`."""
        parts = [block[:, chosen] for block in self.blocks]
        noise = products.gram_noise[:, chosen][:, :, chosen]
        drifts = (products.cross_noise[:, chosen] - noise @ values) / products.counts[:, None]
        residuals = self.residuals(rows, chosen, values)
        noises = noise.sum(axis=0)
        return covariance_of(parts, residuals, drifts, noises, local=local, unbiased=unbiased)
