"""Least squares on sums of products, with the noise of the signals taken out of them.

All columns of terms are multiplied with each other and with the coefficient and summed over each
maneuver, so that fifty maneuvers cost as much as one, and whole maneuvers are left out by
subtraction. A term is formed of measured signals. Their noise makes its sum of squares too large,
and the value of the term too small: by 4 % where the noise has a fifth of the size of the motion.
The noise of the signals is known, and so is what it adds to the sums on the average [1]_,

    E[X' X] = X0' X0 + sum_s D_s' D_s,   E[X' z] = X0' z0 + sum_s D_s' d_s,

with D_s, d_s the slopes of the terms and of the coefficient by signal s, times the standard
deviation of its noise. Both are subtracted.

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
    terms : k columns.
    gram : ``(g, k, k)`` by maneuver.
    cross : ``(g, k)`` with the coefficient.
    total, squares : ``(g,)`` its sum and sum of squares.
    counts : ``(g,)`` samples.
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
    blocks, rows : by maneuver.
    terms : k.
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
    chosen : their places.
    scale : ``(k,)`` of all columns.
    gram, cross : of all, scaled, as measured.
    clean_gram, clean_cross : without the noise of the signals.
    inverse : ``(n, n)`` of the chosen ones, clean.
    share : of the noise that was taken out; below 1 where more would leave less of some direction
        than ``LEAST_MOTION_SHARE``.
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

    def clean_left(self, squares: float) -> float:
        """The same without what the noise of the signals adds to it; it may be negative."""
        return squares - float(self.values @ self.clean_cross[self.chosen])


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


@dataclass(frozen=True, eq=False)
class FurtherColumns:
    """What each column would bring to a model; columns scaled to a unit sum of squares.

    Attributes
    ----------
    value : ``(k,)`` of each beside the chosen ones.
    clean, measured : sums of squares of its part independent of the others, without and with the
        noise of the signals.
    good : columns whose part is motion and not mostly noise; no chosen one is.
    """

    value: np.ndarray
    clean: np.ndarray
    measured: np.ndarray
    good: np.ndarray

    @property
    def gains(self) -> np.ndarray:
        """Square of the value over its variance for residuals of unit variance, ``(k,)``."""
        own = np.maximum(self.measured, INDEPENDENT_COLUMN_SHARE)
        return np.where(self.good, (self.value * self.clean) ** 2 / own, 0.0)

    @property
    def reductions(self) -> np.ndarray:
        """By how much `ScaledEquations.clean_left` becomes smaller, ``(k,)``."""
        return np.where(self.good, self.value**2 * self.clean, 0.0)


def further_of(n: ScaledEquations) -> FurtherColumns:
    """Return what each column would bring to the model of some normal equations."""
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
    good[n.chosen] = False
    return FurtherColumns(part / np.where(good, clean, 1.0), clean, measured, good)


def gains_of(products: Products, chosen: Sequence[int]) -> tuple[np.ndarray, float]:
    """Return the sum of squares that each further column would explain, ``(k,)``, and the present
    residual's.

    A column explains nothing if its part independent of the others is mostly noise.
    """
    n = normal_of(products, chosen)
    return further_of(n).gains, n.left(float(products.squares.sum()))


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
    unbiased: bool = False,
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
    unbiased : autocovariances as of `autocovariances_of` where all variances are then positive;
        else as if each lag lost by the fit what the variance loses.

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
    lags = range(_lags(residuals))
    uneven = [sum(each[: len(each) - lag].T @ each[lag:] for each in scores) for lag in lags]
    lagged = _lagged(parts, scale, len(lags))
    for fair in (unbiased, False):
        together = autocovariances_of(parts, residuals, unbiased=fair)
        even = _over_lags([row * X for row, X in zip(together, lagged, strict=True)])
        if _positive(even):
            break
    one = inverse @ even @ inverse
    other = freedom * inverse @ _over_lags(uneven) @ inverse
    larger = np.maximum(local * np.diag(other) / np.maximum(np.diag(one), 1e-300), 1.0)
    return np.asarray(one * np.sqrt(np.outer(larger, larger)) / np.outer(scale, scale))


def autocovariances_of(
    parts: Sequence[np.ndarray], residuals: Sequence[np.ndarray], *, unbiased: bool = True
) -> np.ndarray:
    """Autocovariances of the noise from what a fit leaves, from lag 0 to the last of the window.

    A fit takes most from the residual where its columns are slow, and so more from the products at
    larger lags than from the variance. With R the matrix that makes residuals of noise, D_l the
    shift by l samples and r_k the autocovariances,

        E[e' D_l e] = sum_k r_k tr(R D_l R S_k),   S_0 = I,  S_k = D_k + D_k',

    which is solved for r_k [1]_. Where the solution is no autocovariance (one larger than the
    variance), and without ``unbiased``, each product is divided by the samples less the columns.

    Parameters
    ----------
    parts, residuals : ``(M, n)`` and ``(M,)`` by maneuver.

    References
    ----------
    .. [1] K. J. Worsley and others, A general statistical analysis for fMRI data, NeuroImage 15(1),
       2002, appendix A.
    """
    lags = _lags(residuals)
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
    found = np.linalg.lstsq(matrix, sums, rcond=None)[0]
    return np.asarray(found if np.all(np.abs(found) <= found[0]) else plain)


def _scaled_inverse(
    parts: Sequence[np.ndarray], noise: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of the columns, and the inverse of their products at unit length without noise."""
    gram = np.asarray(sum(part.T @ part for part in parts))
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    outer = np.outer(scale, scale)
    return scale, clean_inverse(gram / outer, 0.0 * gram if noise is None else noise / outer)[0]


def _lags(residuals: Sequence[np.ndarray]) -> int:
    """Return how many lags the window has, lag 0 included."""
    return min(_WINDOW_LAGS, min(len(e) for e in residuals) - 1) + 1


def _lagged(parts: Sequence[np.ndarray], scale: np.ndarray, lags: int) -> list[np.ndarray]:
    """Products of the columns at unit length with themselves some samples later, by lag."""
    pairs = [X / scale for X in parts]
    return [np.asarray(sum(X[: len(X) - lag].T @ X[lag:] for X in pairs)) for lag in range(lags)]


def _over_lags(products: Sequence[np.ndarray]) -> np.ndarray:
    """Weighted sum of ``(n, n)`` products by lag and their transposes."""
    triangle = 1.0 - np.arange(len(products)) / (_WINDOW_LAGS + 1.0)
    for weights in (np.minimum(2.0 * triangle, 1.0), triangle):
        weights[0] = 0.5
        half = np.tensordot(weights, np.array(products), 1)
        whole = np.asarray(half + half.T)
        if _positive(whole):
            break
    return whole


def _positive(matrix: np.ndarray) -> bool:
    return bool(np.linalg.eigvalsh(matrix)[0] > 0.0)
