"""Parameters from the sums of a stream, by weighted regression, and their covariance.

The method differs from that of Morelli, Journal of Guidance, Control, and Dynamics 23(5), 2000, in
four points:

- Sensor noise in the regressors biases the estimate towards zero. The contribution of this noise to
  the normal matrix is known from the noise of the samples and is subtracted (Soderstrom,
  "Errors-in-Variables Methods in System Identification", Springer 2018, chapter 5).
- Errors at frequencies closer than one over the length of the stream are correlated. The covariance
  accounts for this, and for the correlation between equations.
- The spectrum of the residuals is that of the sensor noise, which the samples show, plus a fitted
  a + b omega^2. Without the sensor noise, the few low frequencies of a short stream may have small
  residuals by chance, and would then have most of the weight.
- At low frequencies, a sum of increments of white noise is mostly the error of its two end samples.
  These errors are common to all frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.frequency_domain.online import OnlineEquations, Sums

# passes of the regression, each with the noise spectrum of the previous one
NOISE_SPECTRUM_PASSES = 4
# smallest share of the information that remains after the noise is subtracted
LEAST_INFORMATION_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class OnlineEstimate:
    """Estimate of q parameters from the sums of a stream.

    Attributes
    ----------
    values : ``(q,)`` estimates.
    covariance : ``(q, q)``, enlarged so that two standard deviations contain the true value with a
        probability of 95 % by Student's distribution. An undetermined parameter has an infinite
        variance.
    cost : minus the log likelihood without constants.
    residuals : ``(e, F)`` complex residuals of e equations at F frequencies.
    levels : ``(e, F)`` spectrum of the residuals.
    degrees : real degrees of freedom of the noise.
    """

    values: np.ndarray
    covariance: np.ndarray
    cost: float
    residuals: np.ndarray
    levels: np.ndarray
    degrees: float

    @property
    def std(self) -> np.ndarray:
        """Standard deviations ``(q,)``."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def estimate(
    equations: OnlineEquations, sums: Sums, further: np.ndarray | None = None
) -> OnlineEstimate | None:
    """Return the parameters by weighted regression; None if there are too few rows, or if noise
    dominates the regressors.

    ``further (e, k, F)`` are further regressors. Their coefficients follow the parameters.
    """
    if sums.rows < 3:
        return None
    e, f = sums.known_side.shape
    regressors = (
        sums.regressors if further is None else np.concatenate([sums.regressors, further], axis=1)
    )
    q = regressors.shape[1]
    all_regressors = np.zeros((e, q + e, f), dtype=complex)
    all_regressors[:, :q] = regressors
    all_regressors[range(e), range(q, q + e)] = sums.constant
    # The scale of each equation starts the spectrum of its residuals.
    sizes = np.sqrt(np.mean(np.abs(sums.known_side) ** 2, axis=1))
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    count = max(float(np.abs(sums.at_differences[0])), 1.0)
    levels = np.tile((sizes**2)[:, None], (1, f))
    near = np.abs(sums.at_differences) ** 2
    pairs = near[0] * f + 2.0 * float(near[1:] @ np.arange(f - 1, 0, -1))
    independent = f * f * near[0] / pairs  # complex values of one equation
    degrees = 2.0 * independent * e - np.count_nonzero(
        np.any(np.abs(all_regressors) > 0.0, axis=(0, 2))
    )
    if degrees < 3.0:
        return None
    result = None
    for _ in range(NOISE_SPECTRUM_PASSES):
        result = _regressed(sums, all_regressors, levels, q - sums.regressors.shape[1])
        if result is None:
            return None
        theta, gain, unknown = result
        residuals = sums.known_side - np.einsum("ecf,c->ef", all_regressors, theta)
        # Degrees of freedom used by the regression in each equation: the trace of its part of the
        # hat matrix.
        spare = 2.0 * independent - np.einsum("aef,eaf->e", gain, all_regressors).real
        if np.any(spare < 2.0):
            return None
        sensors = _sensor_levels(equations, sums, theta[: len(equations.names)], count)
        known = sensors.within + sensors.ends
        levels = _levels(residuals, equations.omega, 2.0 * independent / spare, sizes, known)
    assert result is not None
    covariance = _covariance(gain, residuals, levels, sensors, sums, equations.omega, count)
    from scipy.stats import t

    # 1.959964 is the 0.975 quantile of the normal distribution.
    enlargement = float(t.ppf(0.975, degrees)) / 1.959964
    covariance = enlargement**2 * covariance
    covariance[unknown, :] = covariance[:, unknown] = 0.0
    covariance[unknown, unknown] = np.inf
    cost = independent / f * float(np.sum(np.log(levels) + np.abs(residuals) ** 2 / levels))
    return OnlineEstimate(theta[:q], covariance[:q, :q], cost, residuals, levels, degrees)


def _regressed(
    sums: Sums, all_regressors: np.ndarray, levels: np.ndarray, further: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the coefficients ``(c,)``, the gains ``(c, e, F)`` by which they follow from the known
    sides, and the positions of undetermined coefficients; None if noise dominates the regressors.

    Parameters
    ----------
    all_regressors : ``(e, c, F)``.
    levels : ``(e, F)`` spectrum of the residuals.
    """
    weights = 1.0 / levels
    normal = np.einsum("eaf,ef,ebf->ab", all_regressors.conj(), weights, all_regressors).real
    scale = np.sqrt(np.maximum(np.diag(normal), 0.0))
    unknown = scale <= 1e-12 * max(float(scale.max()), 1e-300)
    scale = np.where(unknown, 1.0, scale)
    scaled = normal / np.outer(scale, scale)
    scaled[unknown, :] = scaled[:, unknown] = 0.0
    noise_share = np.zeros_like(normal)
    p = sums.regressors.shape[1]
    noise, n = sums.noise_variance, sums.squared_slopes.shape[1]
    share = sums.squared_slopes[:, :, :p, :p]
    noise_share[:p, :p] = np.einsum("esab,s,e->ab", share, noise[:n], weights.sum(axis=1))
    without_noise = scaled - noise_share / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    undetermined = values < 1e-10 * max(float(values[-1]), 1e-300)
    inverse = _inverse(scaled, values, vectors)
    # share of the information that remains, in the direction with the largest share of noise
    root = vectors[:, ~undetermined] / np.sqrt(values[~undetermined])
    kept = np.linalg.eigvalsh(root.T @ without_noise @ root)
    if kept.size and kept[0] >= LEAST_INFORMATION_SHARE:
        inverse = np.linalg.pinv(without_noise, rcond=1e-10, hermitian=True)
    elif kept.size:
        return None
    weak = (
        np.any(np.abs(vectors[:, undetermined]) > 1e-3, axis=1)
        if undetermined.any()
        else np.zeros(len(scale), dtype=bool)
    )
    inverse = inverse / np.outer(scale, scale)
    gain = np.einsum("ab,ebf,ef->aef", inverse, all_regressors.conj(), weights)
    theta = np.einsum("aef,ef->a", gain, sums.known_side).real
    return theta, gain, np.flatnonzero(unknown | weak)


def _inverse(matrix: np.ndarray, values: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    significant = values >= 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray((vectors[:, significant] / values[significant]) @ vectors[:, significant].T)


@dataclass(frozen=True, eq=False)
class SensorLevels:
    """Spectrum of the residuals that the noise of the samples causes.

    Attributes
    ----------
    within : ``(e, F)`` by all samples except the two ends of a sum of increments.
    ends : ``(e, F)`` by these two samples, whose errors are common to all frequencies.
    """

    within: np.ndarray
    ends: np.ndarray


def _sensor_levels(
    equations: OnlineEquations, sums: Sums, theta: np.ndarray, count: float
) -> SensorLevels:
    """Return the spectrum of the residuals due to white noise of the samples.

    The noise of a state acts on its increments, and on the rates that depend on it. The noise of an
    output acts on its own equation. ``theta (q,)`` are the parameters, and ``count`` is the number
    of steps.
    """
    noise, e, n = sums.noise_variance, len(equations.states), sums.squared_slopes.shape[1]
    step = (sums.time - sums.first) / count
    turned = np.abs(1.0 - np.exp(-1j * equations.omega * step)) ** 2
    one = np.append(theta, 1.0)
    shared = np.einsum("a,esab,b,s->e", one, sums.squared_slopes, one, noise[:n])
    within = np.tile(shared[:, None], (1, turned.size))
    ends = np.zeros_like(within)
    of_states = noise[list(equations.states)][:, None]
    within[:e] += count * of_states * turned
    within[e:] += count * noise[n:][:, None]
    ends[:e] = 2.0 * of_states
    return SensorLevels(within, ends)


def _levels(
    residuals: np.ndarray,
    omega: np.ndarray,
    larger: np.ndarray,
    sizes: np.ndarray,
    known: np.ndarray,
) -> np.ndarray:
    """Return the spectrum ``(e, F)`` of the residuals of each equation: the ``known (e, F)``
    spectrum by white noise of the samples, plus a fitted a + b omega^2 for process noise and
    coloured sensor noise.

    Parameters
    ----------
    larger : ``(e,)`` factors on the squared residuals that correct for the degrees of freedom used
        by the regression.
    sizes : ``(e,)`` rms of the known sides, which set the smallest level.
    """
    from scipy.optimize import nnls

    shapes = np.column_stack([np.ones(omega.size), (omega / omega[-1]) ** 2])
    out = np.empty(residuals.shape)
    for k, row in enumerate(residuals):
        power = larger[k] * np.abs(row) ** 2
        floor = 1e-24 * sizes[k] ** 2
        level = np.maximum(max(float(power.mean()), floor), known[k])
        for _ in range(3):
            solution = nnls(shapes / level[:, None], (power - known[k]) / level)[0]
            level = known[k] + shapes @ solution
            level = np.maximum(level, 1e-3 * max(float(level.max()), floor))
        out[k] = np.maximum(level, floor)
    return out


def _covariance(
    gain: np.ndarray,
    residuals: np.ndarray,
    levels: np.ndarray,
    sensors: SensorLevels,
    sums: Sums,
    omega: np.ndarray,
    count: float,
) -> np.ndarray:
    """Return the covariance of the coefficients ``gain @ residuals`` for noise that is correlated
    between frequencies and between equations. The errors of the two end samples of a sum of
    increments are added separately.
    """
    e, f = residuals.shape
    spread = np.sqrt(np.maximum(levels - sensors.ends, 0.0))
    scaled = residuals / np.sqrt(levels)
    correlation = np.real(scaled @ np.conj(scaled).T)
    size = np.sqrt(np.maximum(np.diag(correlation), 1e-300))
    correlation = correlation / np.outer(size, size)
    lag = np.subtract.outer(np.arange(f), np.arange(f))
    differences = sums.at_differences[np.abs(lag)] / count
    near = np.where(lag >= 0, differences, differences.conj())
    far = sums.at_sums[np.add.outer(np.arange(f), np.arange(f))] / count
    # The variance of Re(g e) for real noise is half of the real part of g N g* + g P g^T.
    g = gain * spread
    total = np.zeros((gain.shape[0],) * 2)
    for k in range(e):
        near_sum, turned = g[:, k] @ near, g[:, k] @ far
        for m in range(e):
            both = near_sum @ g[:, m].conj().T + turned @ g[:, m].T
            total += 0.5 * correlation[k, m] * both.real
    for at in (sums.first, sums.time):
        reached = np.einsum("aef,f->ae", gain, np.exp(-1j * omega * at)).real
        total += (reached * 0.5 * sensors.ends[:, 0]) @ reached.T
    return 0.5 * (total + total.T)
