"""Power spectra of residuals by autoregressions, and parameter covariance corrected for coloured
residuals.

The correction follows Morelli and Klein, "Accuracy of Aerodynamic Model Parameters Estimated from
Flight Test Data", J. Guidance, Control and Dynamics 20(1), 1997: the information matrix is that for
white noise, and the covariance of the gradient is computed with the spectrum of the residuals.

The residuals of a fit are the noise minus the part of it that the unknowns have absorbed. For noise
with a long correlation time, this part is large at the low frequencies of maneuvers. The
autocovariances of the residuals are then too small, and tapering reduces them further (Kiefer and
Vogelsang, Econometric Theory 21(6), 2005). Here the noise is modelled as an autoregression, whose
order is chosen by Akaike's criterion (Berk, Annals of Statistics 2(3), 1974; den Haan and Levin,
NBER technical paper 197, 1996). Each output has an autoregression of its own, or all outputs have
one together if a common cause such as gusts acts. The autoregression implies a difference between
the autocovariances of noise and residuals. The autocovariance is corrected by this difference until
both agree.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import ndtr, stdtrit

# ---- Power spectra of the residuals of a fit

_MOST_AUTOCOVARIANCE_PASSES = 8  # largest number of corrections of the autocovariance
# the corrections end when no variance of the gradient changes by more than this share, which is
# half a percent of a sigma
_SETTLED_VARIANCE_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Autoregression:
    """Autoregression of m outputs e: ``w[k] = e[k] + sum A[j] e[k - 1 - j]`` is white.

    Attributes
    ----------
    coefficients : ``(p, m, m)`` matrices A of the lags 1 to p.
    free : ``(p, m, m)`` True where a coefficient was fitted.
    covariance : ``(m, m)`` of w.
    count : number of samples of an output.
    """

    coefficients: np.ndarray
    free: np.ndarray
    covariance: np.ndarray
    count: float

    @property
    def criterion(self) -> float:
        """Akaike's criterion; infinite if the covariance is not positive definite."""
        sign, log_determinant = np.linalg.slogdet(self.covariance)
        if sign <= 0:
            return np.inf
        return float(self.count * log_determinant + 2.0 * np.count_nonzero(self.free))

    def transfer(self, size: int) -> np.ndarray:
        """Return ``1 + sum A[j] exp(-i w (j + 1))``, ``(F, m, m)``, at the F frequencies of a real
        transform of length ``size``.
        """
        p, m, _ = self.coefficients.shape
        padded = np.zeros((p + 1, m, m))
        padded[0] = np.eye(m)
        padded[1:] = self.coefficients
        return np.asarray(np.fft.rfft(padded, size, axis=0))


@dataclass(frozen=True, eq=False)
class RecordScores:
    """Contribution of one record to the gradient (score) of a fit.

    Attributes
    ----------
    at : ``(c,)`` positions of the unknowns of the record among all unknowns.
    weights : ``(m, N, c)`` factors of the residuals, whose sum is the gradient.
    jacobian : ``(m, N, c)`` derivatives of the fitted outputs.
    residual, valid : ``(m, N)``; all arrays are zero where a sample is missing.
    """

    at: np.ndarray
    weights: np.ndarray
    jacobian: np.ndarray
    residual: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True, eq=False)
class ScoreCovariance:
    """Covariance of the gradient of a fit.

    Attributes
    ----------
    middle : ``(n, n)`` the covariance: the middle matrix of the sandwich ``inverse middle
        inverse^T``, which is the covariance of the estimate.
    spread : ``(n,)`` variance of each diagonal entry of the sandwich, since the spectrum is
        uncertain.
    """

    middle: np.ndarray
    spread: np.ndarray


def score_covariance(records: Sequence[RecordScores], inverse: np.ndarray) -> ScoreCovariance:
    """Return the covariance of the gradient for the noise that the residuals of each record imply.

    ``inverse (n, n)`` times the gradient is a step of the unknowns.
    """
    spectra = [
        _ScoreTransforms(scores) for scores in records if np.any(scores.residual[scores.valid])
    ]
    n = len(inverse)
    middle = np.zeros((n, n))
    for correction in range(_MOST_AUTOCOVARIANCE_PASSES):
        before, middle = middle, np.zeros((n, n))
        for transforms in spectra:
            middle[np.ix_(transforms.scores.at, transforms.scores.at)] += (
                transforms.score_covariance()
            )
        variance, earlier = np.diag(middle), np.diag(before)
        if correction == _MOST_AUTOCOVARIANCE_PASSES - 1 or np.all(
            np.abs(variance - earlier) <= _SETTLED_VARIANCE_SHARE * variance
        ):
            break
        covariance = inverse @ middle @ inverse.T
        for transforms in spectra:
            at = np.ix_(transforms.scores.at, transforms.scores.at)
            transforms.refit(inverse[at], covariance[at])
    spread = np.zeros(n)
    for transforms in spectra:
        spread += transforms.spread(inverse[:, transforms.scores.at])
    return ScoreCovariance(middle, spread)


def common_disturbance(residuals: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> bool:
    """Return whether the residuals of several outputs have a common cause, such as gusts.

    They have one where, in at least one record, Akaike's criterion prefers an autoregression of all
    outputs together to one for each output. The arrays of each record are ``(m, N)``.
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
    """Fourier transforms of the scores of one record, and the current autoregression of its
    outputs.

    Outputs that are not recorded or fitted exactly are left out. All others are divided by their
    rms residual.
    """

    def __init__(self, scores: RecordScores) -> None:
        self.scores = scores
        rows = [
            i
            for i in range(len(scores.residual))
            if np.any(scores.valid[i]) and np.any(scores.residual[i])
        ]
        self.count = scores.residual.shape[1]
        self.size = fast_transform_length(2 * self.count)
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
        """Fit one autoregression for each output, or one of all together, by Akaike's criterion."""
        self.autocovariance = autocovariance
        separate = self._separate(autocovariance)
        self.model = min(
            [separate, *joint_autoregressions(autocovariance, self.samples)],
            key=lambda model: model.criterion,
        )
        inverse = np.linalg.inv(self.model.transfer(self.size))
        self.inverse = inverse
        self.density = inverse @ self.model.covariance @ np.conj(inverse.transpose(0, 2, 1))
        # cross-spectrum of the noise of each output and the gradient, (F, m, c)
        self.noise_gradient = np.asarray(self.density @ self.weights)

    @cached_property
    def jacobian_transform(self) -> np.ndarray:
        """Transforms ``(F, m, c)`` of the Jacobian."""
        return np.asarray(np.fft.rfft(self.jacobian.transpose(1, 0, 2), self.size, axis=0))

    @property
    def joint(self) -> bool:
        """Whether all outputs have one autoregression together."""
        return len(self.residual) > 1 and bool(
            np.any(self.model.free[:, ~np.eye(len(self.residual), dtype=bool)])
        )

    def _separate(self, autocovariance: np.ndarray) -> Autoregression:
        """Return one autoregression for each output, as one object. Their white noises may be
        correlated at the same sample.
        """
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

    def score_covariance(self) -> np.ndarray:
        """Return the covariance ``(c, c)`` of the gradient of the record, by Parseval's theorem."""
        c = len(self.scores.at)
        weighted = _stacked(self.weights * self.parseval[:, None, None]).reshape(-1, c)
        total = weighted.T @ _stacked(self.noise_gradient).reshape(-1, c)
        return 0.5 * (total + total.T)

    def refit(self, inverse: np.ndarray, covariance: np.ndarray) -> None:
        """Fit the autoregression again: to the autocovariance of the residuals, corrected for the
        part of the noise that the unknowns have absorbed.

        ``inverse (c, c)`` times the gradient is a step of the unknowns, and ``covariance (c, c)``
        is the covariance of this step.
        """
        n = self.residual.shape[1]
        fitted_part = np.fft.irfft(_times_real(self.noise_gradient, inverse.T), self.size, axis=0)[
            :n
        ]
        fitted_transform = np.fft.rfft(fitted_part, self.size, axis=0)
        jacobian = self.jacobian_transform
        # Products of the transforms give the correlations of the fitted part of the noise.
        other = np.conj(fitted_transform - _times_real(jacobian, covariance)).transpose(0, 2, 1)
        products = jacobian @ other + fitted_transform @ np.conj(jacobian.transpose(0, 2, 1))
        fitted_autocovariance = np.fft.irfft(products, self.size, axis=0)[: self.lags + 1]
        corrected = self.measured + fitted_autocovariance / (self.share * n)
        # The corrected variance may be negative with nearly collinear unknowns. Then the
        # autocovariance of the residuals is used.
        self._fit(corrected if np.all(corrected[0].diagonal() > 0.0) else self.measured)

    def spread(self, inverse: np.ndarray) -> np.ndarray:
        """Return the variance ``(n,)`` of the diagonal of ``inverse middle inverse^T`` due to the
        uncertainty of the autoregression. ``inverse`` is ``(n, c)``.
        """
        model = self.model
        p, m, _ = model.coefficients.shape
        back = np.conj(self.inverse.transpose(0, 2, 1))
        white = _times_real(back @ self.weights, inverse.T).transpose(2, 1, 0)  # (n, m, F)
        left = white * self.parseval
        power = _real_products(left, white)
        weighted_power = power @ model.covariance
        total = 2.0 / model.count * np.einsum("nab,nba->n", weighted_power, weighted_power)
        if p == 0:
            return np.asarray(total)
        right = _times_real(self.noise_gradient, inverse.T).transpose(2, 1, 0)
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
            fitted_lags = np.flatnonzero(model.free[:, i, i])
            slopes_of_output = rows[:, i, fitted_lags * m + i]
            inside = np.linalg.pinv(
                blocks[np.ix_(fitted_lags, fitted_lags)][:, :, i, i], hermitian=True
            )
            total = total + model.covariance[i, i] / model.count * np.einsum(
                "nk,kl,nl->n", slopes_of_output, inside, slopes_of_output
            )
        return np.asarray(total)


def _stacked(z: np.ndarray) -> np.ndarray:
    """Return the real parts, then the imaginary parts of ``z (F, ...)``: ``(2F, ...)``."""
    return np.concatenate([z.real, z.imag])


def _times_real(z: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return ``z @ factor`` of complex ``z (F, m, c)`` and real ``factor``, in half the time."""
    F, m, c = z.shape
    real_product = (_stacked(z).reshape(-1, c) @ factor).reshape(2, F, m, -1)
    product = np.empty(real_product.shape[1:], dtype=complex)
    product.real, product.imag = real_product
    return product


def _real_products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the real part ``(n, m, m)`` of ``conj(a) b^T`` for n pairs ``(n, m, F)``."""
    return np.asarray(a.real @ b.real.swapaxes(1, 2) + a.imag @ b.imag.swapaxes(1, 2))


def autoregression(autocovariance: np.ndarray, count: float) -> tuple[np.ndarray, float]:
    """Return the coefficients ``(p,)`` and the variance of the autoregression with the least Akaike
    criterion, by the recursion of Levinson and Durbin.

    ``autocovariance (P + 1,)`` is that of ``count`` samples at lags 0 to P.
    """
    variance = float(max(autocovariance[0], 1e-300))
    a: np.ndarray = np.zeros(0)
    best, least = (a, variance), count * np.log(variance)
    for p in range(1, len(autocovariance)):
        prediction_error = autocovariance[p] + a @ autocovariance[p - 1 : 0 : -1]
        if not abs(prediction_error) < variance:  # no stationary process has this autocovariance
            break
        reflection = -prediction_error / variance
        a = np.append(a + reflection * a[::-1], reflection)
        variance *= 1.0 - reflection * reflection
        score = count * np.log(variance) + 2.0 * p
        if score < least:
            best, least = (a, variance), score
    return best


def joint_autoregressions(autocovariance: np.ndarray, count: float) -> Iterator[Autoregression]:
    """Yield autoregressions of all outputs together, of rising order, from the autocovariance
    ``(P + 1, m, m)`` of ``count`` samples: the Yule-Walker equations by Whittle's recursion.

    The last order has ten samples for each coefficient, or is the last one with a positive definite
    covariance.

    References
    ----------
    P. Whittle, On the fitting of multivariate autoregressions, and the approximate canonical
    factorization of a spectral density matrix, Biometrika 50(1-2), 1963.
    """
    R, m = autocovariance, autocovariance.shape[1]
    if m < 2:
        return
    # Coefficients that predict e[t] from e[t - j], and backwards e[t] from e[t + j], with the
    # covariances of their errors.
    forward = backward = np.zeros((0, m, m))
    forward_error = backward_error = R[0]
    for p in range(1, min(len(R) - 1, int(count / (10.0 * m))) + 1):
        if not (_positive(forward_error) and _positive(backward_error)):
            return  # no stationary process has these autocovariances
        # R[p] minus its prediction from the autocovariances at smaller lags
        unpredicted = R[p] - (
            forward.transpose(1, 0, 2).reshape(m, -1) @ R[p - 1 : 0 : -1].reshape(-1, m)
        )
        last_forward = np.linalg.solve(backward_error, unpredicted.T).T
        last_backward = np.linalg.solve(forward_error, unpredicted).T
        forward, backward = (
            np.concatenate([forward - last_forward @ backward[::-1], last_forward[None]]),
            np.concatenate([backward - last_backward @ forward[::-1], last_backward[None]]),
        )
        forward_error, backward_error = (
            forward_error - last_forward @ unpredicted.T,
            backward_error - last_backward @ unpredicted,
        )
        forward_error = 0.5 * (forward_error + forward_error.T)
        backward_error = 0.5 * (backward_error + backward_error.T)
        if not _positive(forward_error):
            return
        yield Autoregression(-forward, np.ones_like(forward, dtype=bool), forward_error, count)


def _positive(matrix: np.ndarray) -> bool:
    """Return whether a symmetric matrix is positive definite."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


def paired_autocovariance(residual: np.ndarray, valid: np.ndarray, lags: int) -> np.ndarray:
    """Return the autocovariances R[k] = mean of r[t + k] r[t]^T, ``(lags + 1, m, m)``, of series
    ``(m, N)`` with missing samples.

    They have the factor (N - k)/N of the biased autocovariances of complete series.
    """
    n = residual.shape[1]
    usable = valid.astype(float)
    known = residual * usable
    autocovariances = []
    for k in range(lags + 1):
        products, pairs = known[:, k:] @ known[:, : n - k].T, usable[:, k:] @ usable[:, : n - k].T
        autocovariances.append(products / np.maximum(pairs, 0.5) * (n - k) / n)
    return np.array(autocovariances)


@lru_cache(maxsize=64)
def fast_transform_length(least: int) -> int:
    """Return the smallest length of at least ``least`` whose prime factors are 2, 3 and 5. Fourier
    transforms of such lengths are fast.
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

_NORMAL_DEGREES = 1e6  # with more degrees of freedom Student's distribution is normal
_FEWEST_DEGREES = 2.0  # fewest degrees of freedom of a quantile
# data are exact where a corrected variance is less than this share of the one for white noise
_EXACT_VARIANCE_SHARE = 1e-12


def autocovariance(residual: np.ndarray, lags: int) -> np.ndarray:
    """Return the biased autocovariance of a series ``(N,)`` at lags 0 to ``lags``; its mean is not
    removed.
    """
    n = len(residual)
    size = fast_transform_length(n + lags)
    spectrum = np.abs(np.fft.rfft(residual, size)) ** 2
    return np.fft.irfft(spectrum, size)[: lags + 1] / n


def corrected_covariance(
    inverse: np.ndarray,
    parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]],
    variance: np.ndarray,
    prior: np.ndarray | None = None,
) -> np.ndarray:
    """Return the sandwich covariance ``(n, n)`` of a whole-record fit.

    Parameters
    ----------
    inverse : ``(n, n)`` inverse information matrix for white noise, including the prior.
    parts : for each record the positions of its columns in theta, its Jacobian ``(m, N, c)``, its
        residuals ``(m, N)``, and a mask ``(m, N)`` that is False where a sample is missing.
    variance : ``(m,)`` noise variance of each output.
    prior : ``(n, n)`` information of the prior, which coloured noise does not change; None without.

    Returns
    -------
    The covariance. Each variance is at least the one for white noise, so that a spectrum that is
    weak by chance does not make a sigma smaller. The spectrum of the residuals is uncertain. Sigmas
    include this uncertainty by Student's quantile (`student_factor`).
    """
    records = []
    for at, jacobian, residual, valid in parts:
        usable = np.where(valid[:, :, None], jacobian, 0.0)
        records.append(RecordScores(at, usable / variance[:, None, None], usable, residual, valid))
    result = score_covariance(records, inverse)
    corrected = inverse @ (result.middle if prior is None else result.middle + prior) @ inverse
    white, coloured = np.diag(inverse), np.diag(corrected)
    # exact data keep the variance for white noise
    noisy = coloured > _EXACT_VARIANCE_SHARE * white
    ratio = np.divide(white, coloured, out=np.zeros_like(coloured), where=noisy)
    factor = np.sqrt(np.maximum(ratio, 1.0)) * noisy * student_factor(coloured, result.spread)
    return corrected * np.outer(factor, factor) + np.diag(np.where(noisy, 0.0, white))


def sandwich(
    inverse: np.ndarray, records: Sequence[RecordScores], *, coloured: bool = True
) -> np.ndarray:
    """Return the covariance ``(n, n)`` of an estimate whose step is ``inverse (n, n)`` times the
    gradient, as with instrumental variables.

    With ``coloured``, it includes the spectra of the residuals and Student's quantiles, as in
    `corrected_covariance`. Otherwise it is the covariance for white noise.
    """
    if coloured:
        result = score_covariance(records, inverse)
        covariance = inverse @ result.middle @ inverse.T
        factor = student_factor(np.diag(covariance), result.spread)
        return np.asarray(covariance * np.outer(factor, factor))
    middle = np.zeros_like(inverse)
    for scores in records:
        count = np.maximum(scores.valid.sum(axis=1), 1)
        level = (scores.residual**2).sum(axis=1) / count
        middle[np.ix_(scores.at, scores.at)] += np.einsum(
            "eni,e,enj->ij", scores.weights, level, scores.weights
        )
    return np.asarray(inverse @ middle @ inverse.T)


def student_factor(variance: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return the factor ``(n,)`` on sigmas that makes two-sigma intervals include the uncertainty
    of the sigmas.

    The squares of the sigmas, ``variance (n,)``, are themselves estimates with the variance
    ``spread (n,)``. The factor is Student's quantile of 97.7 % over the normal quantile (two
    sigmas), with Satterthwaite's degrees of freedom 2 variance^2/spread.
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
    """Return the sum over i, j of s_i R(i - j) s_j^T, ``(c, c)``, for sensitivities s ``(N, c)``
    and a symmetric autocovariance R. It is computed from spectra of padded series (Parseval's
    theorem).
    """
    n, lags = len(sensitivity), len(covariance) - 1
    size = fast_transform_length(n + 2 * lags + 1)
    kernel = np.zeros(size)
    kernel[: lags + 1] = covariance
    kernel[size - lags :] = covariance[:0:-1]
    spectrum, weight = np.fft.rfft(sensitivity.T, size), np.fft.rfft(kernel).real * (2.0 / size)
    weight[0] *= 0.5
    weight[-1] *= 0.5 if size % 2 == 0 else 1.0
    parts = np.concatenate([spectrum.real, spectrum.imag], axis=1)
    return np.asarray((parts * np.concatenate([weight, weight])) @ parts.T)


def effective_share(residuals: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> float:
    """Return the number of effectively independent squared residuals over the number of samples, 0
    to 1.

    It is 1/(1 + 2 sum rho_k^2) over lags up to a fifth of the record, with rho_k the
    autocorrelation of the residual (Bartlett, 1946). The result is the mean over channels and
    records, weighted by their samples. Residuals and validity of each record are ``(m, N)``.
    Missing samples count as zero.
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
            # Each estimate has the variance (1 + 2 excess)/N, which is subtracted.
            excess = max(0.0, (float(np.sum(rho**2)) - lags / count) / (1.0 + 2.0 * lags / count))
            weight, total = weight + count, total + count / (1.0 + 2.0 * excess)
    return total / weight if weight > 0 else 1.0
