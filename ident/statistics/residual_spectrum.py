"""Power spectra of residuals by autoregressions, and parameter covariance corrected for coloured
residuals.

The residuals of a fit are the noise minus the part that the unknowns have fitted. For noise of long
correlation this part is large at the low frequencies of maneuvers: autocovariances of residuals are
too small, and tapering reduces them further (Kiefer and Vogelsang, Econometric Theory 21(6), 2005).
Here the noise is an autoregression, its order by Akaike's criterion (Berk, Annals of Statistics
2(3), 1974; den Haan and Levin, NBER technical paper 197, 1996): one for each output, or one for all
if a common cause such as gusts acts. Its autocovariance is corrected by the difference between
noise and residual that it implies, until both agree.

Morelli and Klein, "Accuracy of Aerodynamic Model Parameters Estimated from Flight Test Data", J.
Guidance, Control and Dynamics 20(1), 1997: the information matrix stays, the scatter of the
gradient is formed with the spectrum of the residuals instead of that of white noise
(`ident.statistics.residual_spectrum`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import ndtr, stdtrit

# ---- Power spectra of the residuals of a fit

_MOST_AUTOCOVARIANCE_PASSES = 8  # most corrections of the autocovariance
# largest relative change of a gradient variance at convergence: half a percent of a sigma
_SETTLED_VARIANCE_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Autoregression:
    """``w[k] = e[k] + sum A[j] e[k - 1 - j]`` is white with ``covariance (m, m)``, for m outputs
    ``e``.

    ``coefficients`` A ``(p, m, m)``; ``free (p, m, m)`` True where one was fitted. ``count``:
    samples of an output.
    """

    coefficients: np.ndarray
    free: np.ndarray
    covariance: np.ndarray
    count: float

    @property
    def criterion(self) -> float:
        """Akaike's criterion; infinite if the covariance is not positive definite."""
        sign, log = np.linalg.slogdet(self.covariance)
        return float(self.count * log + 2.0 * np.count_nonzero(self.free)) if sign > 0 else np.inf

    def transfer(self, size: int) -> np.ndarray:
        """``1 + sum A[j] exp(-i w (j + 1))`` at the frequencies of a real transform of ``size``,
        ``(F, m, m)``.
        """
        p, m, _ = self.coefficients.shape
        padded = np.zeros((p + 1, m, m))
        padded[0] = np.eye(m)
        padded[1:] = self.coefficients
        return np.asarray(np.fft.rfft(padded, size, axis=0))


@dataclass(frozen=True, eq=False)
class RecordScores:
    """Contribution of one record to the gradient of a fit.

    Attributes
    ----------
    at : ``(c,)`` positions of its unknowns.
    weights : ``(m, N, c)`` such that the gradient is their sum with the residuals.
    jacobian : ``(m, N, c)`` by which a change of the unknowns changes the fitted outputs.
    residual, valid : ``(m, N)``; all zero where missing.
    """

    at: np.ndarray
    weights: np.ndarray
    jacobian: np.ndarray
    residual: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True, eq=False)
class ScoreCovariance:
    """Covariance ``middle (n, n)`` of the gradient, and the variance ``spread (n,)`` of each
    diagonal entry of ``inverse middle inverse^T``.
    """

    middle: np.ndarray
    spread: np.ndarray


def score_covariance(records: Sequence[RecordScores], inverse: np.ndarray) -> ScoreCovariance:
    """Return the covariance of the gradient under the noise that the residuals of each record show.

    Parameters
    ----------
    inverse : ``(n, n)`` factor from a gradient to a step of the unknowns.
    """
    spectra = [_ScoreTransforms(each) for each in records if np.any(each.residual[each.valid])]
    n = len(inverse)
    middle = np.zeros((n, n))
    for turn in range(_MOST_AUTOCOVARIANCE_PASSES):
        before, middle = middle, np.zeros((n, n))
        for each in spectra:
            middle[np.ix_(each.scores.at, each.scores.at)] += each.middle()
        now, earlier = np.diag(middle), np.diag(before)
        if turn == _MOST_AUTOCOVARIANCE_PASSES - 1 or np.all(
            np.abs(now - earlier) <= _SETTLED_VARIANCE_SHARE * now
        ):
            break
        covariance = inverse @ middle @ inverse.T
        for each in spectra:
            at = np.ix_(each.scores.at, each.scores.at)
            each.refit(inverse[at], covariance[at])
    spread = np.zeros(n)
    for each in spectra:
        spread += each.spread(inverse[:, each.scores.at])
    return ScoreCovariance(middle, spread)


def common_disturbance(residuals: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> bool:
    """Return whether the residuals of several outputs have a common cause, such as gusts.

    It compares, by Akaike's criterion, one autoregression of all outputs ``(m, N)`` with one for
    each output, in any record.
    """
    for residual, usable in zip(residuals, valid, strict=True):
        blank = np.zeros((*residual.shape, 0))
        scores = RecordScores(
            np.zeros(0, dtype=int), blank, blank, np.where(usable, residual, 0.0), usable
        )
        if np.any(scores.residual) and _ScoreTransforms(scores).joint:
            return True
    return False


class _ScoreTransforms:
    """Transforms of one record's scores, and the current autoregression of its outputs.

    Outputs that were not recorded, or are met exactly, are left out; the others are in units of
    their own scatter.
    """

    def __init__(self, scores: RecordScores) -> None:
        self.scores = scores
        rows = [
            i
            for i in range(len(scores.residual))
            if np.any(scores.valid[i]) and np.any(scores.residual[i])
        ]
        self.count = scores.residual.shape[1]
        self.size = good_length(2 * self.count)
        self.valid = scores.valid[rows]
        self.samples = float(np.count_nonzero(self.valid)) / max(len(rows), 1)
        self.share = max(float(np.mean(self.valid)) if rows else 1.0, 1e-12)
        scale = np.sqrt(
            (scores.residual[rows] ** 2).sum(axis=1) / np.maximum(self.valid.sum(axis=1), 1)
        )
        self.residual = np.where(self.valid, scores.residual[rows] / scale[:, None], 0.0)
        self.jacobian = np.where(
            self.valid[:, :, None], scores.jacobian[rows] / scale[:, None, None], 0.0
        )
        weights = np.where(self.valid[:, :, None], scores.weights[rows] * scale[:, None, None], 0.0)
        # (F, m, c)
        self.weights = np.fft.rfft(weights, self.size, axis=1).transpose(1, 0, 2)
        self.parseval = np.full(self.size // 2 + 1, 2.0 / self.size)
        self.parseval[0] *= 0.5
        self.parseval[-1] *= 0.5 if self.size % 2 == 0 else 1.0
        most = min(int(10.0 * np.log10(max(self.count, 2))), max(self.count // 10, 1))
        self.lags = min(most, self.count - 1)
        self.measured = paired_autocovariance(self.residual, self.valid, self.lags)
        self._fit(self.measured)

    def _fit(self, autocovariance: np.ndarray) -> None:
        """The better, by Akaike's criterion, of one autoregression an output and one of all outputs
        together.
        """
        self.autocovariance = autocovariance
        apart = self._apart(autocovariance)
        self.model = min(
            [apart, *joint_autoregressions(autocovariance, self.samples)],
            key=lambda each: each.criterion,
        )
        inverse = np.linalg.inv(self.model.transfer(self.size))
        self.inverse = inverse
        self.density = inverse @ self.model.covariance @ np.conj(inverse.transpose(0, 2, 1))
        # Covariance between each output's noise and the gradient, (F, m, c).
        self.driven = np.asarray(self.density @ self.weights)

    @cached_property
    def moves(self) -> np.ndarray:
        """Transforms ``(F, m, c)`` of what a change of the unknowns does to the outputs."""
        return np.asarray(np.fft.rfft(self.jacobian.transpose(1, 0, 2), self.size, axis=0))

    @property
    def joint(self) -> bool:
        """Whether the autoregression is one of all outputs together."""
        return len(self.residual) > 1 and bool(
            np.any(self.model.free[:, ~np.eye(len(self.residual), dtype=bool)])
        )

    def _apart(self, autocovariance: np.ndarray) -> Autoregression:
        """An autoregression of each output, their white noises correlated at the same sample."""
        m = len(self.residual)
        fitted = [autoregression(autocovariance[:, i, i], self.samples) for i in range(m)]
        order = max((len(a) for a, _ in fitted), default=0)
        coefficients = np.zeros((order, m, m))
        free = np.zeros((order, m, m), dtype=bool)
        white = np.empty_like(self.residual)
        for i, (a, _) in enumerate(fitted):
            coefficients[: len(a), i, i], free[: len(a), i, i] = a, True
            white[i] = np.convolve(self.residual[i], np.append(1.0, a))[: self.count]
        product = white @ white.T
        size = np.sqrt(np.maximum(np.diag(product), 1e-300))
        level = np.sqrt([variance for _, variance in fitted])
        return Autoregression(
            coefficients,
            free,
            product / np.outer(size, size) * np.outer(level, level),
            self.samples,
        )

    def middle(self) -> np.ndarray:
        """Return the covariance of the record's gradient, ``(c, c)``, by Parseval."""
        c = len(self.scores.at)
        weighted = _stacked(self.weights * self.parseval[:, None, None]).reshape(-1, c)
        total = weighted.T @ _stacked(self.driven).reshape(-1, c)
        return 0.5 * (total + total.T)

    def refit(self, inverse: np.ndarray, covariance: np.ndarray) -> None:
        """Fit the autoregressions again, to autocovariances of the noise that are consistent with
        those of the residuals.
        """
        n = self.residual.shape[1]
        following = np.fft.irfft(_by_real(self.driven, inverse.T), self.size, axis=0)[:n]
        follows = np.fft.rfft(following, self.size, axis=0)
        moves = self.moves
        # Correlations of the fitted part of the noise, by products of the transforms.
        other = np.conj(follows - _by_real(moves, covariance)).transpose(0, 2, 1)
        both = moves @ other + follows @ np.conj(moves.transpose(0, 2, 1))
        taken = np.fft.irfft(both, self.size, axis=0)[: self.lags + 1]
        moved = self.measured + taken / (self.share * n)
        # With nearly collinear unknowns the corrected variance may be negative: then the residuals'
        # own is used.
        self._fit(moved if np.all(moved[0].diagonal() > 0.0) else self.measured)

    def spread(self, inverse: np.ndarray) -> np.ndarray:
        """Return the variance of the diagonal of ``inverse middle inverse^T`` ``(n,)`` due to the
        uncertainty of the autoregressions.
        """
        model = self.model
        p, m, _ = model.coefficients.shape
        back = np.conj(self.inverse.transpose(0, 2, 1))
        white = _by_real(back @ self.weights, inverse.T).transpose(2, 1, 0)  # (n, m, F)
        left = white * self.parseval
        power = _real_products(left, white)
        turned = power @ model.covariance
        total = 2.0 / model.count * np.einsum("nab,nba->n", turned, turned)
        if p == 0:
            return np.asarray(total)
        right = _by_real(self.driven, inverse.T).transpose(2, 1, 0)
        angles = np.exp(
            -2j * np.pi * np.outer(np.arange(1, p + 1), np.arange(self.size // 2 + 1)) / self.size
        )
        slopes = np.zeros((p, len(inverse), m, m))
        if self.joint:
            for j, turn in enumerate(angles):
                slopes[j] = -2.0 * _real_products(left, turn * right)
        else:
            slopes[:, :, np.arange(m), np.arange(m)] = np.moveaxis(
                -2.0 * (np.conj(left) * right @ angles.T).real, 2, 0
            )
        free = np.where(model.free[:, None], slopes, 0.0).transpose(1, 2, 0, 3)
        rows = free.reshape(len(inverse), m, p * m)
        lag = np.subtract.outer(np.arange(p), np.arange(p))
        blocks = np.where(
            (lag <= 0)[:, :, None, None],
            self.autocovariance[np.abs(lag)],
            self.autocovariance[np.abs(lag)].transpose(0, 1, 3, 2),
        )
        if self.joint:
            inside = np.linalg.pinv(
                blocks.transpose(0, 2, 1, 3).reshape(p * m, p * m), hermitian=True
            )
            return np.asarray(
                total
                + np.einsum("nak,kl,nbl,ab->n", rows, inside, rows, model.covariance, optimize=True)
                / model.count
            )
        for i in range(m):
            own = np.flatnonzero(model.free[:, i, i])
            mine = rows[:, i, own * m + i]
            inside = np.linalg.pinv(blocks[np.ix_(own, own)][:, :, i, i], hermitian=True)
            total = total + model.covariance[i, i] / model.count * np.einsum(
                "nk,kl,nl->n", mine, inside, mine
            )
        return np.asarray(total)


def _stacked(z: np.ndarray) -> np.ndarray:
    """Real parts ``(F, ...)``, then imaginary ones: ``(2F, ...)``."""
    return np.concatenate([z.real, z.imag])


def _by_real(z: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """``z @ factor`` of complex ``z (F, m, c)`` and real ``factor (c, n)``, in half the time."""
    F, m, c = z.shape
    product = (_stacked(z).reshape(-1, c) @ factor).reshape(2, F, m, -1)
    out = np.empty(product.shape[1:], dtype=complex)
    out.real, out.imag = product
    return out


def _real_products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Real part of ``conj(a) b^T`` of each of n pairs ``(n, m, F)``: ``(n, m, m)``."""
    return np.asarray(a.real @ b.real.swapaxes(1, 2) + a.imag @ b.imag.swapaxes(1, 2))


def autoregression(autocovariance: np.ndarray, count: float) -> tuple[np.ndarray, float]:
    """Return the coefficients ``(p,)`` and variance of the autoregression of least Akaike
    criterion, by Levinson and Durbin.

    Of an autocovariance at lags 0 to P of ``count`` samples.
    """
    variance = float(max(autocovariance[0], 1e-300))
    a: np.ndarray = np.zeros(0)
    best, least = (a, variance), count * np.log(variance)
    for p in range(1, len(autocovariance)):
        left = autocovariance[p] + a @ autocovariance[p - 1 : 0 : -1]
        if not abs(left) < variance:  # the autocovariance of no process
            break
        reflected = -left / variance
        a = np.append(a + reflected * a[::-1], reflected)
        variance *= 1.0 - reflected * reflected
        score = count * np.log(variance) + 2.0 * p
        if score < least:
            best, least = (a, variance), score
    return best


def joint_autoregressions(autocovariance: np.ndarray, count: float) -> Iterator[Autoregression]:
    """Autoregressions of all outputs together, of rising order, from autocovariances ``(P + 1, m,
    m)``: Yule and Walker's equations by Whittle's recursion.

    Orders end at ten samples a coefficient, or when the noise's covariance is not positive
    definite.

    References
    ----------
    P. Whittle, On the fitting of multivariate autoregressions, and the approximate canonical
    factorization of a spectral density matrix, Biometrika 50(1-2), 1963.
    """
    R, m = autocovariance, autocovariance.shape[1]
    if m < 2:
        return
    # Predictions of e[t] from e[t - j], and backwards of e[t] from e[t + j]; their errors.
    ahead = back = np.zeros((0, m, m))
    error_ahead = error_back = R[0]
    for p in range(1, min(len(R) - 1, int(count / (10.0 * m))) + 1):
        if not (_positive(error_ahead) and _positive(error_back)):
            return  # autocovariances of no process give no stable autoregression
        # R[p] less what the earlier ones predict of it.
        left = R[p] - (ahead.transpose(1, 0, 2).reshape(m, -1) @ R[p - 1 : 0 : -1].reshape(-1, m))
        last_ahead = np.linalg.solve(error_back, left.T).T
        last_back = np.linalg.solve(error_ahead, left).T
        ahead, back = (
            np.concatenate([ahead - last_ahead @ back[::-1], last_ahead[None]]),
            np.concatenate([back - last_back @ ahead[::-1], last_back[None]]),
        )
        error_ahead, error_back = error_ahead - last_ahead @ left.T, error_back - last_back @ left
        error_ahead = 0.5 * (error_ahead + error_ahead.T)
        error_back = 0.5 * (error_back + error_back.T)
        if not _positive(error_ahead):
            return
        yield Autoregression(-ahead, np.ones_like(ahead, dtype=bool), error_ahead, count)


def _positive(matrix: np.ndarray) -> bool:
    """Return whether a symmetric matrix is a covariance."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


def paired_autocovariance(residual: np.ndarray, valid: np.ndarray, lags: int) -> np.ndarray:
    """Autocovariances ``R[k] = mean of r[t + k] r[t]^T`` ``(lags + 1, m, m)`` of series ``(m, N)``
    with missing samples.

    Tapered as those of complete series, the sum over N - k pairs by N.
    """
    n = residual.shape[1]
    usable = valid.astype(float)
    seen = residual * usable
    out = []
    for k in range(lags + 1):
        products, pairs = seen[:, k:] @ seen[:, : n - k].T, usable[:, k:] @ usable[:, : n - k].T
        out.append(products / np.maximum(pairs, 0.5) * (n - k) / n)
    return np.array(out)


@lru_cache(maxsize=64)
def good_length(least: int) -> int:
    """Return the smallest product of twos, threes and fives that is at least ``least``: transforms
    of such lengths are fast.
    """
    result, fives = 1 << (least - 1).bit_length(), 1
    while fives < result:
        threes = fives
        while threes < result:
            result = min(result, threes << max(0, (-(-least // threes) - 1).bit_length()))
            threes *= 3
        fives *= 5
    return result


# ---- Parameter covariance corrected for residuals that are not white

_NORMAL_DEGREES = 1e6  # degrees of freedom from which the distribution is normal
_FEWEST_DEGREES = 2.0  # fewest degrees of freedom for a quantile


def autocovariance(residual: np.ndarray, lags: int) -> np.ndarray:
    """Biased autocovariance of a series ``(N,)`` at lags 0 to ``lags``, its mean not removed."""
    n = len(residual)
    size = good_length(n + lags)
    spectrum = np.abs(np.fft.rfft(residual, size)) ** 2
    return np.fft.irfft(spectrum, size)[: lags + 1] / n


def corrected_covariance(
    inverse: np.ndarray,
    parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]],
    variance: np.ndarray,
    prior: np.ndarray | None = None,
) -> np.ndarray:
    """Sandwich covariance of a whole-record fit.

    Parameters
    ----------
    inverse : ``(n, n)`` inverse information matrix under white noise, that of the prior included.
    parts : for each record the positions of its columns in theta, its jacobian ``(m, N, c)``,
        residuals and validity ``(m, N)``; missing samples count as zero.
    variance : ``(m,)`` noise variance of each output.
    prior : ``(n, n)`` information of the prior, independent of the colour; may be None.

    Returns
    -------
    ``(n, n)``; each diagonal entry is at least that of white noise of the same variance, so that a
    lucky record does not shrink a sigma. Where the spectrum of the residuals is itself uncertain,
    sigmas are Student's: two of them hold as much as two of a normal distribution do
    (``student_factor``).
    """
    records = []
    for at, jacobian, residual, valid in parts:
        usable = np.where(valid[:, :, None], jacobian, 0.0)
        records.append(RecordScores(at, usable / variance[:, None, None], usable, residual, valid))
    result = score_covariance(records, inverse)
    corrected = inverse @ (result.middle if prior is None else result.middle + prior) @ inverse
    white, own = np.diag(inverse), np.diag(corrected)
    # Exact data: the white value is kept.
    shown = own > 1e-12 * white
    factor = np.sqrt(np.maximum(np.divide(white, own, out=np.zeros_like(own), where=shown), 1.0))
    factor *= shown * student_factor(own, result.spread)
    return corrected * np.outer(factor, factor) + np.diag(np.where(shown, 0.0, white))


def sandwich(
    inverse: np.ndarray, records: Sequence[RecordScores], *, coloured: bool = True
) -> np.ndarray:
    """Return the covariance ``(n, n)`` of an estimate of which ``inverse (n, n)`` times the
    gradient is a step: instrumental variables, say.

    ``coloured`` : with the spectra of the residuals and Student's quantiles as in
    ``corrected_covariance``; else as of white noise.
    """
    if coloured:
        result = score_covariance(records, inverse)
        covariance = inverse @ result.middle @ inverse.T
        factor = student_factor(np.diag(covariance), result.spread)
        return np.asarray(covariance * np.outer(factor, factor))
    middle = np.zeros_like(inverse)
    for each in records:
        count = np.maximum(each.valid.sum(axis=1), 1)
        level = (each.residual**2).sum(axis=1) / count
        middle[np.ix_(each.at, each.at)] += np.einsum(
            "eni,e,enj->ij", each.weights, level, each.weights
        )
    return np.asarray(inverse @ middle @ inverse.T)


def student_factor(variance: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return the factor ``(n,)`` by which sigmas grow if their own ``variance (n,)`` is an estimate
    with the variance ``spread (n,)``.

    Satterthwaite's degrees of freedom 2 variance^2/spread, and Student's quantile of 97.7 % over
    the normal one of two sigmas.
    """
    freedom = 2.0 * np.divide(
        variance**2, spread, out=np.full_like(variance, np.inf), where=spread > 0
    )
    return np.where(
        freedom < _NORMAL_DEGREES,
        stdtrit(np.clip(freedom, _FEWEST_DEGREES, _NORMAL_DEGREES), ndtr(2.0)) / 2.0,
        1.0,
    )


def filtered_product(sensitivity: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the sum over i, j of s_i R(i - j) s_j^T for a symmetric autocovariance R, from spectra
    of padded series (Parseval).
    """
    n, lags = len(sensitivity), len(covariance) - 1
    size = good_length(n + 2 * lags + 1)
    kernel = np.zeros(size)
    kernel[: lags + 1] = covariance
    kernel[size - lags :] = covariance[:0:-1]
    spectrum, weight = np.fft.rfft(sensitivity.T, size), np.fft.rfft(kernel).real * (2.0 / size)
    weight[0] *= 0.5
    weight[-1] *= 0.5 if size % 2 == 0 else 1.0
    parts = np.concatenate([spectrum.real, spectrum.imag], axis=1)
    return np.asarray((parts * np.concatenate([weight, weight])) @ parts.T)


def effective_share(residuals: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> float:
    """Return the share of the samples that count as independent where squares of residuals are
    compared, 0 to 1.

    1/(1 + 2 sum rho_k^2) over a fifth of the record, rho the residual's correlation (Bartlett,
    1946), the mean over channels and records by their samples. Residuals and validity ``(m, N)`` a
    record; missing samples count as zero.
    """
    weight, total = 0.0, 0.0
    for residual, mask in zip(residuals, valid, strict=True):
        for row, known in zip(residual, mask, strict=True):
            count = float(np.count_nonzero(known))
            if count < 10 or not np.any(row[known]):
                continue
            lags = max(5, len(row) // 5)
            covariance = autocovariance(np.where(known, row, 0.0), lags)
            rho = covariance[1:] / covariance[0]
            # The variance (1 + 2 excess)/N of the estimates at every lag is subtracted.
            excess = max(0.0, (float(np.sum(rho**2)) - lags / count) / (1.0 + 2.0 * lags / count))
            weight, total = weight + count, total + count / (1.0 + 2.0 * excess)
    return total / weight if weight > 0 else 1.0
