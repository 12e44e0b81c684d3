"""Parameters from the sums of a stream, by weighted regression, and their covariance.

Departures from the form of Morelli, Journal of Guidance, Control, and Dynamics 23(5), 2000:

- sensor noise in the regressors lowers the estimate; its share of the normal matrix, known from the
  noise of the samples, is taken off (Soderstrom, "Errors-in-Variables Methods in System
  Identification", Springer 2018, chapter 5);
- frequencies closer than one over the length of the stream share their errors: the covariance is
  that of noise with one spectrum between all frequencies and equations;
- the spectrum of the residuals is at least that of the sensors' noise, which the samples show by
  themselves; a + b omega^2 beyond it is fitted. Fitted alone the few low frequencies of a short
  stream looked quiet by chance, and had most of the weight;
- a sum of increments of white noise is for the most part that of its two ends at low frequencies:
  two samples, not as many as there are frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.frequency_domain.online import OnlineEquations, Sums

# passes of the regression, each with the noise spectrum of the previous one
NOISE_SPECTRUM_PASSES = 4
LEAST_INFORMATION_SHARE = 0.5  # smallest share of the information without that of the noise


@dataclass(frozen=True, eq=False)
class OnlineEstimate:
    """Parameters from the sums.

    Attributes
    ----------
    values, covariance : ``(q,)`` and ``(q, q)``, the latter by Student's distribution: two standard
        deviations hold 95 %. A parameter that nothing determines has an infinite variance.
    cost : minus the log likelihood less constants.
    residuals : ``(e, F)`` complex.
    levels : ``(e, F)``, their spectrum.
    degrees : real ones of the noise.
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
    equations: OnlineEquations, sums: Sums, more: np.ndarray | None = None
) -> OnlineEstimate | None:
    """The parameters by weighted regression; None while the sums do not determine the equations.

    ``more`` : ``(e, k, F)``, further regressors, whose coefficients follow the parameters'.
    """
    if sums.rows < 3:
        return None
    e, f = sums.left.shape
    regressors = (
        sums.regressors if more is None else np.concatenate([sums.regressors, more], axis=1)
    )
    q = regressors.shape[1]
    whole = np.zeros((e, q + e, f), dtype=complex)
    whole[:, :q] = regressors
    whole[range(e), range(q, q + e)] = sums.constant
    # Columns and equations of like size, so that squares neither vanish nor overflow.
    sizes = np.sqrt(np.mean(np.abs(sums.left) ** 2, axis=1))
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    count = max(float(np.abs(sums.apart[0])), 1.0)
    levels = np.tile((sizes**2)[:, None], (1, f))
    near = np.abs(sums.apart) ** 2
    pairs = near[0] * f + 2.0 * float(near[1:] @ np.arange(f - 1, 0, -1))
    independent = f * f * near[0] / pairs  # complex values of one equation
    degrees = 2.0 * independent * e - np.count_nonzero(np.any(np.abs(whole) > 0.0, axis=(0, 2)))
    if degrees < 3.0:
        return None
    result = None
    for _ in range(NOISE_SPECTRUM_PASSES):
        result = _regressed(sums, whole, levels, q - sums.regressors.shape[1])
        if result is None:
            return None
        theta, gain, unknown = result
        residuals = sums.left - np.einsum("ecf,c->ef", whole, theta)
        # Degrees of freedom used by the regression in each equation: the trace of its part of the
        # hat matrix.
        spare = 2.0 * independent - np.einsum("aef,eaf->e", gain, whole).real
        if np.any(spare < 2.0):
            return None
        sensors = _sensor_levels(equations, sums, theta[: len(equations.names)], count)
        known = sensors.within + sensors.ends
        levels = _levels(residuals, equations.omega, 2.0 * independent / spare, sizes, known)
    assert result is not None
    covariance = _covariance(gain, residuals, levels, sensors, sums, equations.omega, count)
    from scipy.stats import t

    wide = float(t.ppf(0.975, degrees)) / 1.959964
    covariance = wide**2 * covariance
    covariance[unknown, :] = covariance[:, unknown] = 0.0
    covariance[unknown, unknown] = np.inf
    cost = independent / f * float(np.sum(np.log(levels) + np.abs(residuals) ** 2 / levels))
    return OnlineEstimate(theta[:q], covariance[:q, :q], cost, residuals, levels, degrees)


def _regressed(
    sums: Sums, whole: np.ndarray, levels: np.ndarray, more: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the coefficients ``(c,)``, their gains ``(c, e, F)`` on the known sides, and which are
    unknown.
    """
    weights = 1.0 / levels
    normal = np.einsum("eaf,ef,ebf->ab", whole.conj(), weights, whole).real
    scale = np.sqrt(np.maximum(np.diag(normal), 0.0))
    unknown = scale <= 1e-12 * max(float(scale.max()), 1e-300)
    scale = np.where(unknown, 1.0, scale)
    scaled = normal / np.outer(scale, scale)
    scaled[unknown, :] = scaled[:, unknown] = 0.0
    taken = np.zeros_like(normal)
    p = sums.regressors.shape[1]
    noise, n = sums.noise_variance, sums.noisy.shape[1]
    share = sums.noisy[:, :, :p, :p]
    taken[:p, :p] = np.einsum("esab,s,e->ab", share, noise[:n], weights.sum(axis=1))
    less = scaled - taken / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    open_ = values < 1e-10 * max(float(values[-1]), 1e-300)
    inverse = _inverse(scaled, values, vectors)
    # The share of the information that the noise had, in the direction where it is largest.
    root = vectors[:, ~open_] / np.sqrt(values[~open_])
    kept = np.linalg.eigvalsh(root.T @ less @ root)
    if kept.size and kept[0] >= LEAST_INFORMATION_SHARE:
        inverse = np.linalg.pinv(less, rcond=1e-10, hermitian=True)
    elif kept.size:
        return None
    weak = (
        np.any(np.abs(vectors[:, open_]) > 1e-3, axis=1)
        if open_.any()
        else np.zeros(len(scale), dtype=bool)
    )
    inverse = inverse / np.outer(scale, scale)
    gain = np.einsum("ab,ebf,ef->aef", inverse, whole.conj(), weights)
    theta = np.einsum("aef,ef->a", gain, sums.left).real
    return theta, gain, np.flatnonzero(unknown | weak)


def _inverse(matrix: np.ndarray, values: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    significant = values >= 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray((vectors[:, significant] / values[significant]) @ vectors[:, significant].T)


@dataclass(frozen=True, eq=False)
class SensorLevels:
    """Spectrum of the residuals ``(e, F)`` due to sample noise alone.

    ``within`` : of all samples except the ends of a sum of increments. ``ends`` : of these two
    samples, whose errors are common to all frequencies.
    """

    within: np.ndarray
    ends: np.ndarray


def _sensor_levels(
    equations: OnlineEquations, sums: Sums, theta: np.ndarray, count: float
) -> SensorLevels:
    """Return the variance of the residuals from white noise of the samples: of a state its
    increments and its share of the rates, of an output itself.
    """
    noise, e, n = sums.noise_variance, len(equations.states), sums.noisy.shape[1]
    step = (sums.time - sums.first) / count
    turned = np.abs(1.0 - np.exp(-1j * equations.omega * step)) ** 2
    one = np.append(theta, 1.0)
    shared = np.einsum("a,esab,b,s->e", one, sums.noisy, one, noise[:n])
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
    """Return the spectrum of each equation's residuals, ``(e, F)``: that of the samples' noise,
    which is ``known``, and a + b omega^2 beyond it: noise that acts on the motion, and noise of
    sensors that is not white. ``larger`` : ``(e,)``, for what the regression took.
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
    """Return the covariance of coefficients ``gain @ residuals`` for noise that frequencies and
    equations share; the two ends of a sum of increments are single samples.
    """
    e, f = residuals.shape
    spread = np.sqrt(np.maximum(levels - sensors.ends, 0.0))
    scaled = residuals / np.sqrt(levels)
    alike = np.real(scaled @ np.conj(scaled).T)
    size = np.sqrt(np.maximum(np.diag(alike), 1e-300))
    alike = alike / np.outer(size, size)
    lag = np.subtract.outer(np.arange(f), np.arange(f))
    near = np.where(lag >= 0, sums.apart[np.abs(lag)], sums.apart[np.abs(lag)].conj()) / count
    far = sums.beside[np.add.outer(np.arange(f), np.arange(f))] / count
    # Of real noise, Re(g e): half of the real parts of g N g* and g P g^T.
    g = gain * spread
    total = np.zeros((gain.shape[0],) * 2)
    for k in range(e):
        near_sum, turned = g[:, k] @ near, g[:, k] @ far
        for m in range(e):
            both = near_sum @ g[:, m].conj().T + turned @ g[:, m].T
            total += 0.5 * alike[k, m] * both.real
    for at in (sums.first, sums.time):
        reached = np.einsum("aef,f->ae", gain, np.exp(-1j * omega * at)).real
        total += (reached * 0.5 * sensors.ends[:, 0]) @ reached.T
    return 0.5 * (total + total.T)
