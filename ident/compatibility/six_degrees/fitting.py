"""Fits of the kinematics of six degrees of freedom, in full and to first order.

Slopes with respect to delays and lags are secants: at size zero, the derivatives of a delay and of
a lag are equal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.fitting import (
    MOST_PASSES,
    KinematicDescent,
    KinematicFit,
    descend,
    least_misfit,
    misfit,
    residual_of,
    starting_sizes,
)
from ident.compatibility.instruments import (
    instrument_projection,
    instrumented,
    projected_whitener,
    reduced_whitener,
)
from ident.compatibility.kinematics import BIAS, DELAY, LAG, SensorFault
from ident.compatibility.signals import (
    KinematicSignals,
    walk_gains,
    whitener,
)
from ident.compatibility.six_degrees.kinematics import evaluate, linearised, start_of, unknowns_of
from ident.compatibility.six_degrees.noise import estimated_noise, noise_from_roughness
from ident.statistics.intervals import bounded_inverse
from ident.statistics.residual_spectrum import autocovariance

# ---- Fits of the kinematics of six degrees of freedom

_MOST_STEPS = 4  # most Gauss-Newton steps under one noise
_STEP_SHARES = (1.0, 0.5, 0.2, 0.05)  # shares of a step, tried in turn until one gains
_NEGLIGIBLE_GAIN = 2e-3  # a descent ends after a smaller gain of log likelihood
_SETTLED_LOG_CHANGE = 0.05  # a fit ends when the logarithms of all noise variances change less


def fit(
    signals: Sequence[KinematicSignals],
    faults: Sequence[SensorFault] = (),
    begin: KinematicFit | None = None,
) -> KinematicFit:
    """Return the smoother fit of R records with some faults.

    ``begin`` is a fit of the same records. It gives the noise, and starting values of the unknowns
    and of the faults that it has; other faults start at zero. None starts from `start_of`.
    """
    unknowns = [unknowns_of(s) for s in signals]
    if begin is None:
        own = [start_of(s, items) for s, items in zip(signals, unknowns, strict=True)]
    else:
        own = [np.array(values) for values in begin.own]
    sizes = starting_sizes(faults, begin)
    starting_noise = noise_from_roughness(signals)
    noise = begin.noise if begin is not None else starting_noise
    priors = [np.array([item.prior**-2 for item in u]) for u in unknowns]
    linear = [
        linearised(s, u, faults, o, sizes) for s, u, o in zip(signals, unknowns, own, strict=True)
    ]
    search = KinematicDescent(
        tuple(signals),
        tuple(unknowns),
        tuple(faults),
        tuple(priors),
        evaluate,
        linearised,
        _STEP_SHARES,
        _MOST_STEPS,
        _NEGLIGIBLE_GAIN,
    )
    for _ in range(MOST_PASSES):
        whiteners = [reduced_whitener(s, noise) for s in signals]
        own, sizes, linear = descend(search, (own, sizes, linear), whiteners)
        residuals = [residual_of(s, y) for s, (y, _) in zip(signals, linear, strict=True)]
        before, noise = (
            noise,
            estimated_noise(signals, residuals, [slope for _, slope in linear], starting_noise),
        )
        if np.all(np.abs(noise.logs - before.logs) < _SETTLED_LOG_CHANGE):
            break
    residuals = [residual_of(s, y) for s, (y, _) in zip(signals, linear, strict=True)]
    whiteners = [reduced_whitener(s, noise) for s in signals]
    cost = misfit(signals, priors, own, [y for y, _ in linear], whiteners)
    slopes, outputs = tuple(slope for _, slope in linear), tuple(y for y, _ in linear)
    return KinematicFit(
        tuple(signals),
        tuple(faults),
        sizes,
        tuple(own),
        noise,
        cost,
        tuple(residuals),
        slopes,
        outputs,
    )


def negative_log_likelihoods(fits: Sequence[KinematicFit]) -> np.ndarray:
    """Return minus the log likelihood of each of some fits of the same records, up to a constant.

    If the records have instruments, the results are the projected misfits, all under the noise of
    the likeliest fit.
    """
    costs = np.array(
        [
            candidate.cost
            + 0.5 * sum(whitener(s, candidate.noise).log_determinant for s in candidate.signals)
            for candidate in fits
        ]
    )
    if not instrumented(fits[0].signals):
        return costs
    likeliest = fits[int(np.argmin(costs))]
    whiteners = [reduced_whitener(s, likeliest.noise) for s in likeliest.signals]
    priors = [np.array([item.prior**-2 for item in unknowns_of(s)]) for s in likeliest.signals]
    return np.array([least_misfit(candidate, whiteners, priors) for candidate in fits])


# ---- All faults, linearised at a fit

_FEWEST_LAGS, _SAMPLES_PER_LAG = 10, 5  # lags of the autocovariance of a residual
LEAST_SECANT = 0.02  # s: the slope of a time shift is a secant over at least this size


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of k faults, with the unknowns of each record projected out.

    Attributes
    ----------
    information : ``(k, k)``.
    gradient : ``(k,)`` of the log likelihood at sensors without a fault.
    scatter : ``(k, k)`` covariance of the gradient; with white residuals it equals ``information``.
    """

    information: np.ndarray
    gradient: np.ndarray
    scatter: np.ndarray

    def plus(self, other: NormalEquations) -> NormalEquations:
        """Return the normal equations of two records together."""
        return NormalEquations(
            self.information + other.information,
            self.gradient + other.gradient,
            self.scatter + other.scatter,
        )


@dataclass(frozen=True, eq=False)
class FaultLinearisation:
    """Linearisation of the outputs with respect to k faults at a fit.

    Attributes
    ----------
    fit : the fit at which the outputs are linearised.
    faults : the k faults, among them those of the fit.
    smoother : normal equations of each record under the noise of the fit.
    biases : the b biases of a record.
    information_with_biases : ``(k + b, k + b)`` information of the faults, then of the biases
        without their priors. All other unknowns of the records are projected out.
    full_equations : information ``(n + k, n + k)`` and gradient ``(n + k,)`` of each record, of its
        unknowns, then of the faults, with priors. The gradient is taken at the unknowns of the fit
        and at sensors without a fault.
    columns : ``(m, N, n + k + 1)`` of each record: derivatives with respect to its unknowns and to
        the faults, then the residual without faults.
    """

    fit: KinematicFit
    faults: tuple[SensorFault, ...]
    smoother: tuple[NormalEquations, ...]
    biases: tuple[SensorFault, ...]
    information_with_biases: np.ndarray
    full_equations: tuple[tuple[np.ndarray, np.ndarray], ...]
    columns: tuple[np.ndarray, ...]

    @property
    def joint(self) -> NormalEquations:
        """The normal equations of all records together."""
        return sum_of_equations(self.smoother)


def linearise_faults(
    kinematic_fit: KinematicFit, faults: Sequence[SensorFault], secants: np.ndarray
) -> FaultLinearisation:
    """Linearise the outputs with respect to all ``faults`` at a fit.

    ``secants (k,)`` are the sizes, s, over which the slopes of time shifts are taken.
    """
    smoother, bias_information, full_equations, all_columns = [], [], [], []
    biases: tuple[SensorFault, ...] = ()
    for r, s in enumerate(kinematic_fit.signals):
        unknowns = unknowns_of(s)
        slopes, delay_slopes = _fault_slopes(kinematic_fit, r, faults, secants)
        own, fault_slopes = kinematic_fit.own[r], slopes[:, :, len(kinematic_fit.own[r]) :]
        members = [faults.index(fault) for fault in kinematic_fit.faults]
        fault_part = fault_slopes[:, :, members] @ kinematic_fit.sizes
        residual = np.where(s.valid, kinematic_fit.residuals[r] + fault_part, 0.0)
        prior = np.array([item.prior**-2 for item in unknowns])
        columns = np.concatenate(
            [np.where(s.valid[:, :, None], slopes, 0.0), residual[:, :, None]], axis=2
        )
        delay_columns = np.where(s.valid[:, :, None], delay_slopes, 0.0)
        white, white_delays = np.split(
            projected_whitener(s, kinematic_fit.noise)(
                np.concatenate([columns, delay_columns], axis=2)
            ),
            [columns.shape[2]],
            axis=2,
        )
        innovations = whitener(s, kinematic_fit.noise)(kinematic_fit.residuals[r][:, :, None])
        smoother.append(_fault_equations(white, prior, own, innovations[:, :, 0]))
        all_columns.append(columns)
        bias_places = [i for i, item in enumerate(unknowns) if item.key[1] == BIAS]
        biases = tuple(SensorFault(unknowns[i].key[0], BIAS) for i in bias_places)
        flat = white.reshape(-1, white.shape[2])
        gram = flat.T @ flat
        extended_prior = np.append(prior, np.zeros(len(faults)))
        full_equations.append(
            (
                gram[:-1, :-1] + np.diag(extended_prior),
                gram[:-1, -1] - extended_prior * np.append(own, np.zeros(len(faults))),
            )
        )
        # A delay common to all channels is unobservable. Only derivatives show this exactly:
        # secants of the channels over different times would not cancel.
        delays = [len(own) + j for j, fault in enumerate(faults) if fault.kind == DELAY]
        flat[:, delays] = white_delays.reshape(len(flat), -1)
        bias_information.append(
            _information_with_biases(flat[:, :-1].T @ flat[:, :-1], prior, bias_places)
        )
    return FaultLinearisation(
        kinematic_fit,
        tuple(faults),
        tuple(smoother),
        biases,
        np.sum(bias_information, axis=0),
        tuple(full_equations),
        tuple(all_columns),
    )


def _fault_slopes(
    kinematic_fit: KinematicFit, r: int, faults: Sequence[SensorFault], secants: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays of slopes of the outputs of record ``r`` at the fit.

    The first, ``(m, N, n + k)``, is with respect to the unknowns of the record and to the faults;
    for delays and lags it has secants. The second, ``(m, N, d)``, has the derivatives with respect
    to the d delays.
    """
    s, own = kinematic_fit.signals[r], kinematic_fit.own[r]
    unknowns = unknowns_of(s)
    sizes = np.zeros(len(faults))
    for fault, size in zip(kinematic_fit.faults, kinematic_fit.sizes.tolist(), strict=True):
        sizes[list(faults).index(fault)] = size
    _, slopes = linearised(s, unknowns, faults, own, sizes)
    n = len(own)
    delay_slopes = slopes[:, :, [n + j for j, fault in enumerate(faults) if fault.kind == DELAY]]
    for j, fault in enumerate(faults):
        if fault.kind in (DELAY, LAG):
            # The secant begins without any time shift of this channel.
            shifts_channel = [
                item.channel == fault.channel and item.kind in (DELAY, LAG) for item in faults
            ]
            ends = np.where(shifts_channel, 0.0, np.stack([sizes, sizes]))
            ends[1, j] = secants[j]
            y = evaluate(s, unknowns, faults, np.repeat(own[None], 2, axis=0), ends)
            slopes[:, :, n + j] = (y[:, 1] - y[:, 0]) / secants[j]
    return slopes, delay_slopes


def _fault_equations(
    white: np.ndarray, prior: np.ndarray, own: np.ndarray, innovations: np.ndarray
) -> NormalEquations:
    """Return the normal equations of the faults from the whitened columns of one record.

    Parameters
    ----------
    white : ``(m, N, n + k + 1)`` whitened ``columns`` of `FaultLinearisation`.
    prior : ``(n,)`` one over the prior variances of the unknowns of the record.
    own : ``(n,)`` values of these unknowns.
    innovations : ``(m, N)`` whitened residuals of the fit.
    """
    n = len(prior)
    flat = white.reshape(-1, white.shape[2])
    gram = flat.T @ flat
    k = gram.shape[0] - n - 1
    gradient = gram[: n + k, -1].copy()
    gradient[:n] -= prior * own
    projection = _projection_matrix(gram[: n + k, : n + k], prior)
    scatter = np.sum(
        [
            gradient_covariance(columns[:, : n + k], innovation)
            for columns, innovation in zip(white, innovations, strict=True)
        ],
        axis=0,
    )
    scatter[np.arange(n), np.arange(n)] += prior
    return _projected(gram[: n + k, : n + k], gradient, scatter, projection)


def _projection_matrix(gram: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return the matrix ``(k, n + k)`` that projects the n unknowns of a record out of equations of
    these and k faults, ``gram (n + k, n + k)``.
    """
    n = len(prior)
    inverse = bounded_inverse(gram[:n, :n] + np.diag(prior))
    return np.hstack([-gram[n:, :n] @ inverse, np.eye(len(gram) - n)])


def _projected(
    gram: np.ndarray, gradient: np.ndarray, scatter: np.ndarray, projection: np.ndarray
) -> NormalEquations:
    n = gram.shape[0] - projection.shape[0]
    information = gram[n:, n:] + projection[:, :n] @ gram[:n, n:]
    return NormalEquations(
        0.5 * (information + information.T),
        projection @ gradient,
        projection @ scatter @ projection.T,
    )


def gradient_covariance(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return the covariance ``(c, c)`` of the gradient of one output, if its noise has the
    autocovariance of the residual, as `corrected_covariance` assumes.

    ``columns (N, c)`` and ``residual (N,)`` are those of the output.
    """
    lags = min(max(_FEWEST_LAGS, len(residual) // _SAMPLES_PER_LAG), len(residual) - 1)
    covariance = autocovariance(residual, lags) * (1.0 - np.arange(lags + 1) / (lags + 1.0))
    n = len(columns)
    size = 1 << int(np.ceil(np.log2(n + 2 * lags + 1)))
    kernel = np.zeros(size)
    kernel[: lags + 1] = covariance
    kernel[size - lags :] = covariance[:0:-1]
    spectrum = np.fft.rfft(columns, size, axis=0)
    smooth = np.fft.irfft(spectrum * np.fft.rfft(kernel)[:, None], size, axis=0)[:n]
    return np.asarray(columns.T @ smooth)


def output_error_equations(linearisation: FaultLinearisation, r: int) -> NormalEquations:
    """Return the normal equations of record ``r`` by output error (white residuals)."""
    s, own = linearisation.fit.signals[r], linearisation.fit.own[r]
    prior, n = np.array([item.prior**-2 for item in unknowns_of(s)]), len(own)
    gram, gradient, scatter = output_error_gram(s, linearisation.fit, r, linearisation.columns[r])
    gradient[:n] -= prior * own
    scatter[np.arange(n), np.arange(n)] += prior
    return _projected(gram, gradient, scatter, _projection_matrix(gram, prior))


def output_error_gram(
    s: KinematicSignals, kinematic_fit: KinematicFit, r: int, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the information ``(c, c)``, the gradient ``(c,)`` and its covariance ``(c, c)`` by
    output error, without priors. The weight of each output is one over its mean square residual.

    ``columns (m, N, c + 1)`` are the slopes and, last, the residual. The covariance has these
    weights and the noise of the smoother fit.
    """
    project = instrument_projection(s)
    count = np.maximum(s.valid.sum(axis=1), 1)
    weight = 1.0 / np.maximum((kinematic_fit.residuals[r] ** 2).sum(axis=1) / count, 1e-30)
    slopes, residual = columns[:, :, :-1], columns[:, :, -1]
    weighed = project(slopes) * weight[:, None, None]
    flat, c = weighed.reshape(-1, weighed.shape[2]), weighed.shape[2]
    gram, gradient = flat.T @ slopes.reshape(-1, c), flat.T @ residual.ravel()
    scatter = flat.T @ (weighed * kinematic_fit.noise.white[:, None, None]).reshape(-1, c)
    # A step of the walk acts on all later samples.
    later_sums = np.cumsum(weighed[:, ::-1], axis=1)[:, ::-1][:, 1:] * s.steps[None, :, None]
    for gains, density in zip(
        walk_gains(s, kinematic_fit.noise).T, kinematic_fit.noise.density.tolist(), strict=True
    ):
        walk = np.tensordot(gains, later_sums, axes=1)
        scatter += density * walk.T @ walk
    return gram, gradient, scatter


def _information_with_biases(
    gram: np.ndarray, prior: np.ndarray, bias_places: Sequence[int]
) -> np.ndarray:
    """Return the information on faults and biases, in this order, with all other unknowns of the
    record projected out.

    ``bias_places`` are the positions of the biases among these n unknowns. ``gram (n + k, n + k)``
    has the unknowns first, and ``prior (n,)`` is one over their prior variances.
    """
    n = len(prior)
    kept = [*range(n, len(gram)), *bias_places]
    eliminated = [i for i in range(n) if i not in bias_places]
    inner = gram[np.ix_(eliminated, eliminated)] + np.diag(prior[eliminated])
    return np.asarray(
        gram[np.ix_(kept, kept)]
        - gram[np.ix_(kept, eliminated)] @ bounded_inverse(inner) @ gram[np.ix_(eliminated, kept)]
    )


def sum_of_equations(parts: Sequence[NormalEquations]) -> NormalEquations:
    """Return the normal equations of several records together."""
    total = parts[0]
    for part in parts[1:]:
        total = total.plus(part)
    return total
