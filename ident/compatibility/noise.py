"""The residual of an integrated relation: white noise of the measured state on top of the walk that the inputs' noise makes.

Differences between neighbouring samples are correlated with their neighbours alone, so that the exact likelihood takes
one banded Cholesky factorisation: what a Kalman filter with the inputs' noise as process noise gives, at once for all columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ident.compatibility.signals import Signals, differences

_MISSING = 1e8  # times the noise variance: such a sample says nothing
_INPUTS = {"alpha": ("q", "nz", "az"), "theta": ("q",), "airspeed": ("ax", "nx")} | {
    **{"phi": ("p",), "psi": ("r",), "beta": ("r", "ny", "ay"), "height": ("theta",), "altitude": ("theta",)},
}


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """``white (m,)``: variance of each output's noise. ``inputs``: names, and ``density (n,)`` variance of each input's samples."""

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    white: np.ndarray
    density: np.ndarray

    @property
    def logs(self) -> np.ndarray:
        return np.log(np.concatenate([self.white, self.density]))

    def with_logs(self, logs: np.ndarray) -> NoiseModel:
        m = len(self.outputs)
        return NoiseModel(self.outputs, self.inputs, np.exp(logs[:m]), np.exp(logs[m:]))


def walking_inputs(outputs: Sequence[str]) -> tuple[str, ...]:
    """Inputs whose noise can be told apart: where alpha alone is integrated, q stands for nz too."""
    if tuple(outputs) == ("alpha",):
        return ("q",)
    return tuple(dict.fromkeys(name for output in outputs for name in _INPUTS[output] if name in ("q", "nz", "ax")))


def inputs_of(output: str) -> tuple[str, ...]:
    """Channels whose noise walks in an output."""
    return _INPUTS[output]


def first_noise(all_signals: Sequence[Signals]) -> NoiseModel:
    """A start from the roughness of the channels: third differences hold noise, and of a smooth motion next to nothing."""
    outputs = all_signals[0].outputs
    inputs = walking_inputs(outputs)
    rough = {
        name: float(np.mean([roughness(s.channels[name]) for s in all_signals])) for name in {*outputs, *inputs, *(["nz"] if "nz" in inputs else [])}
    }
    return NoiseModel(outputs, inputs, np.array([rough[name] for name in outputs]), np.array([rough[name] for name in inputs]))


def resolution(x: np.ndarray) -> float:
    """Variance of what a column cannot show: rounding to its least step, or to single precision, in which recorders store at best.

    A value rounded to steps of d has an error of variance d^2/12. A single-precision number of size x has steps of 2^-23 x. The least
    step of a column is its smallest third difference beyond that, of smooth or noisy samples far less than their noise: differences of
    multiples are multiples.
    """
    single = 2.0**-23 * float(np.max(np.abs(x), initial=0.0))
    third = np.abs(np.diff(x, 3))
    moved = third[third > 8.0 * single]  # of four rounded values with weights 1, 3, 3, 1
    return max(float(np.min(moved, initial=np.inf)) if moved.size else 0.0, single) ** 2 / 12.0


def floors(all_signals: Sequence[Signals], names: Sequence[str]) -> np.ndarray:
    """The least variance that each of the channels can have, by the finest record."""
    return np.array([max(min(resolution(s.channels[name]) for s in all_signals), 1e-20) for name in names])


def roughness(x: np.ndarray) -> float:
    """Variance of a channel's noise as its third differences show it."""
    third = np.diff(x, 3)
    # The median is not moved by the few samples at which a held input switches.
    middle = float(np.median(np.abs(third))) / 0.6745 if third.size else 0.0
    return max(middle**2 / 20.0, 1e-10 * float(np.var(x)), resolution(x), 1e-20)


def walk_gains(s: Signals, noise: NoiseModel) -> np.ndarray:
    """How each input's noise moves each output's walk over one second, ``(m, n)``."""
    out = np.zeros((len(noise.outputs), len(noise.inputs)))
    for i, output in enumerate(noise.outputs):
        for j, name in enumerate(noise.inputs):
            if name in _INPUTS[output]:
                out[i, j] = _gain(s, output, name)
    return out


def _gain(s: Signals, output: str, name: str) -> float:
    speed = float(np.mean(s.speed))
    if name in ("nz", "ny"):
        return s.gravity / speed
    if name in ("az", "ay"):
        return 1.0 / speed
    if name == "theta":
        return speed
    return {"nx": s.gravity}.get(name, -1.0 if (output, name) == ("beta", "r") else 1.0)


@dataclass(frozen=True, eq=False)
class Whitener:
    """Cholesky factor of the differences' covariance; ``log_determinant`` without what missing samples add."""

    band: np.ndarray
    log_determinant: float

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Columns ``(m, N, c)``, zero where a sample is missing, as those of independent samples of variance one: ``(m, N, c)``."""
        m, n, c = columns.shape
        return np.ascontiguousarray(self.of_differences(differences(columns)).reshape(n, m, c).transpose(1, 0, 2))

    def of_differences(self, flat: np.ndarray) -> np.ndarray:
        """The same of ``differences`` of columns ``(N m, c)``, in their order."""
        from scipy.linalg.lapack import dtbtrs

        if flat.shape[1] == 0:  # SciPy 1.17's dtbtrs writes beyond its memory for no right-hand side
            return np.empty(flat.shape)
        return np.asarray(dtbtrs(self.band, flat, uplo="L")[0])


def whitener(s: Signals, noise: NoiseModel) -> Whitener:
    """The whitener of one record. Raises numpy.linalg.LinAlgError for variances that are no longer positive in rounding."""
    from scipy.linalg.lapack import dpbtrf

    m, n = s.valid.shape
    own = np.where(s.valid, noise.white[:, None], _MISSING * noise.white[:, None])
    gains = walk_gains(s, noise)
    walk = (gains * noise.density) @ gains.T
    band = np.zeros((2 * m, n, m))
    h2 = np.concatenate([[0.0], s.steps**2])
    for lower in range(m):
        for j in range(m - lower):
            band[lower, :, j] = walk[j + lower, j] * h2
    band[0] += own.T
    band[0, 1:] += own.T[:-1]
    band[m, :-1] -= own.T[:-1]
    # The diagonal at distance m runs from (k, i) to (k + 1, i); entries between belong to other channels and are zero.
    factor, fault = dpbtrf(band.reshape(2 * m, n * m)[: m + 1], lower=1)
    if fault:
        raise np.linalg.LinAlgError("the covariance is not positive definite")
    lost = float(np.sum(np.log(own[~s.valid])))
    return Whitener(factor, 2.0 * float(np.sum(np.log(factor[0]))) - lost)


@dataclass(frozen=True, eq=False)
class NoiseEvidence:
    """What variances are estimated from: residuals ``(m, N)`` of each record and the sensitivities ``(m, N, n)`` to its own unknowns, whose
    fit has taken some of the noise away; ``priors (n,)`` information on these."""

    signals: tuple[Signals, ...]
    residuals: tuple[np.ndarray, ...]
    sensitivities: tuple[np.ndarray, ...]
    priors: tuple[np.ndarray, ...]
    begun: NoiseModel

    @cached_property
    def differences(self) -> tuple[np.ndarray, ...]:
        """``differences`` of each record's residual and, after it, its sensitivities: the same whatever the noise."""
        return tuple(
            np.asfortranarray(differences(np.concatenate([residual[:, :, None], columns], axis=2)))
            for residual, columns in zip(self.residuals, self.sensitivities, strict=True)
        )


def settled_noise(evidence: NoiseEvidence, noise: NoiseModel, passes: int) -> tuple[NoiseModel, float]:
    """Variances of greatest restricted likelihood, and minus its logarithm: Newton steps on their logarithms, one by one.

    No variance falls below what the column resolves (``floors``).
    """
    cost = noise_cost(evidence, noise)
    least = np.log(floors(evidence.signals, (*noise.outputs, *noise.inputs)))
    for _ in range(passes):
        logs, before = noise.logs, cost
        ahead, behind = np.empty(len(logs)), np.empty(len(logs))
        for i in range(len(logs)):
            up, down = logs.copy(), logs.copy()
            up[i] += 0.2
            down[i] -= 0.2
            ahead[i], behind[i] = (noise_cost(evidence, noise.with_logs(x)) for x in (up, down))
        slope, bend = (ahead - behind) / 0.4, (ahead + behind - 2.0 * cost) / 0.04
        step = np.clip(-slope / np.maximum(bend, 0.4 * np.abs(slope) + 1e-3), -2.5, 2.5)
        for share in (1.0, 0.4, 0.1):
            trial = noise.with_logs(np.clip(logs + share * step, least, 20.0))
            trial_cost = noise_cost(evidence, trial)
            if trial_cost < cost:
                noise, cost = trial, trial_cost
                break
        if before - cost < 5e-3:
            break
    return noise, cost


def noise_cost(evidence: NoiseEvidence, noise: NoiseModel) -> float:
    """Minus the log restricted likelihood (Patterson and Thompson, Biometrika 58(3), 1971), without constants; infinite where it fails.

    The inputs' densities have a prior about the roughness of their channels: hardly less, for white noise shows there in full; far more
    where a filter has taken the roughness away.
    """
    total = 0.0
    for s, flat, prior in zip(evidence.signals, evidence.differences, evidence.priors, strict=True):
        try:
            white = whitener(s, noise)
            columns = white.of_differences(flat)
            e, J = columns[:, 0], columns[:, 1:]
            sign, determinant = np.linalg.slogdet(J.T @ J + np.diag(prior))
        except np.linalg.LinAlgError:
            return float("inf")
        total += 0.5 * white.log_determinant + 0.5 * float(np.sum(e**2)) + (0.5 * float(determinant) if sign > 0 else 0.0)
    away = np.log(noise.density / evidence.begun.density)
    return total + 0.5 * float(np.sum(np.where(away < 0, away / 0.5, away / 3.0) ** 2))


def smoothed_walk(s: Signals, noise: NoiseModel, residual: np.ndarray) -> np.ndarray:
    """The walk ``(m, N)`` that the inputs' noise has most likely made, given residuals ``(m, N)`` of the whole record.

    The fixed-interval smoother in one solve: the residual less the expected noise of the measurement, R S^-1 r.
    """
    from scipy.linalg.lapack import dpbtrs

    m, n = residual.shape
    solved, _ = dpbtrs(whitener(s, noise).band, differences(residual[:, :, None]), lower=1)
    y = solved.reshape(n, m).T
    back = y.copy()
    back[:, :-1] -= y[:, 1:]
    own = np.where(s.valid, noise.white[:, None], _MISSING * noise.white[:, None])
    return np.asarray(residual - own * back)
