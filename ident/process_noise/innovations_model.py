"""Noise model of a fit with process noise (Maine and Iliff 1981; Jategaonkar, Flight Vehicle System
Identification, ch. 5), and restricted likelihood (REML) of its noise levels.

The likelihood is that of the innovations of a Kalman filter linearised about the fitted trajectory.
The parameters and noise levels change this filter. The gradient and the expected information of the
likelihood include this change (`ident.process_noise.likelihood_slopes`), so that Fisher scoring
estimates all unknowns together.

Maximum likelihood underestimates noise levels, since initial states, biases and derivatives follow
a part of the noise. This bias grows as records get shorter. The adjusted profile likelihood
therefore adds -0.5 ln det I, with I the information on those unknowns (Cox and Reid, J. Royal
Statistical Society B 49(1), 1987). `restricted_levels` takes one step from the maximum of the
likelihood towards the maximum of the adjusted profile likelihood.

Sigmas of the other unknowns are computed with these noise levels. `AdjustedLevels.log_variance` is
the effect of uncertain noise levels on the variances (Giesbrecht and Burns, Biometrics 41(2), 1985;
Kenward and Roger, Biometrics 53(3), 1997).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.process_noise.likelihood_slopes import (
    LikelihoodSlopes,
    likelihood_slopes,
    noise_slopes,
    slope_pairs,
)
from ident.process_noise.linear_noise import Variation, discretised_noise
from ident.process_noise.whitener import Filtered, Whitener, filtered, whitener
from ident.statistics.intervals import inverse_information
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.linearise import Linearisation
from ident.whole_record.noise_model import LayoutView, WeightedResiduals
from ident.whole_record.record_problem import DIFFERENCE_STEP_SHARE, RecordProblem
from sim.declaration.model import System

# ---- Noise model of a fit with process noise

SCALE = "process_noise_scale"  # name of the factor on declared process noise
_LARGEST_NOISE_STEP_FACTOR = 4.0  # largest factor on a noise level in one step
_LOWEST_LEVEL, _HIGHEST_LEVEL = 1e-3, 1e3  # bounds of a noise level, relative to its start
_DENSITY_CHANGE = 1.01  # factor on a parameter that shows whether it changes the process noise


@dataclass(frozen=True, eq=False)
class Filter:
    """Kalman filter of one record, and the residual of the record passed through it."""

    problem: RecordProblem
    whitener: Whitener
    residual: Filtered

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return the innovations of ``columns (m, N, c)`` over their standard deviations, zero
        where a sample is missing.
        """
        innovations = filtered(self.whitener, _at_nodes(self.problem, columns)).normalised
        return _at_samples(self.problem, innovations)


@dataclass(frozen=True, eq=False)
class ProcessNoise:
    """Noise model with white measurement noise and the process noise that `System.noise` gives.

    Attributes
    ----------
    outputs : names of the m outputs.
    std : ``(m,)`` standard deviation of the measurement noise (noise level): a starting value where
        the level is an unknown.
    estimated : positions of the outputs whose noise level is an unknown.
    scale : factor on the standard deviation of process noise that the model declares on states.
    scaled : whether the scale is an unknown; it then starts at ``scale``.
    quick : neglect that parameters other than those of the noise change the gains.
    least : ``(m,)`` smallest noise levels; None takes ``_LOWEST_LEVEL`` times the start.
    """

    outputs: tuple[str, ...]
    std: np.ndarray
    estimated: tuple[int, ...]
    scale: float = 1.0
    scaled: bool = False
    quick: bool = False
    least: np.ndarray | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return (
            *(f"std_{self.outputs[i]}" for i in self.estimated),
            *([SCALE] if self.scaled else []),
        )

    @property
    def start(self) -> np.ndarray:
        return np.append(self.std[list(self.estimated)], [self.scale] if self.scaled else [])

    @property
    def low(self) -> np.ndarray:
        low = _LOWEST_LEVEL * self.std
        if self.least is not None:
            low = np.maximum(low, self.least)
        return np.append(low[list(self.estimated)], [0.0] if self.scaled else [])

    @property
    def high(self) -> np.ndarray:
        return np.append(
            _HIGHEST_LEVEL * self.std[list(self.estimated)], [np.inf] if self.scaled else []
        )

    def levels(self, theta: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the standard deviations of the measurement noise ``(m,)`` and the scale at
        ``theta``.
        """
        noise_unknowns = theta[len(theta) - len(self.names) :]
        std = self.std.copy()
        std[list(self.estimated)] = noise_unknowns[: len(self.estimated)]
        return std, float(noise_unknowns[-1]) if self.scaled else self.scale

    def weight_residuals(
        self,
        layout: LayoutView,
        theta: np.ndarray,
        linearisations: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None:
        """Return the normalised innovations of residuals and sensitivities; None where an
        innovation covariance is not positive definite or a value is not finite.

        The parameters are those of `NoiseModel`.
        """
        try:
            return self._innovations(layout, theta, linearisations, residuals, counts)
        except np.linalg.LinAlgError:
            return None

    def covariance_terms(
        self,
        layout: LayoutView,
        theta: np.ndarray,
        linearisations: Sequence[Linearisation],
        weighted: WeightedResiduals,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the part of the gradient ``(n,)`` and of the information ``(n, n)`` that is due to
        changes of the filter by the unknowns.
        """
        n = len(theta)
        gradient, information = np.zeros(n), np.zeros((n, n))
        for positions, slopes in self._slopes(layout, theta, linearisations, weighted):
            gradient[positions] += slopes.gradient
            information[np.ix_(positions, positions)] += slopes.information
        return gradient, information

    def _slopes(
        self,
        layout: LayoutView,
        theta: np.ndarray,
        linearisations: Sequence[Linearisation],
        weighted: WeightedResiduals,
    ) -> Iterator[tuple[np.ndarray, LikelihoodSlopes]]:
        """Yield for each record the positions of the unknowns that change its filter, and the
        derivatives of the log likelihood with respect to these.
        """
        std, scale = self.levels(theta)
        n, estimated = len(theta), list(self.estimated)
        noise_unknowns = np.arange(n - len(self.names), n)
        by_variance = np.zeros((len(estimated), len(std)))
        by_variance[np.arange(len(estimated)), estimated] = 2.0 * std[estimated]
        # Biases act on the outputs only, so that they do not change the filter.
        acting = [
            position
            for position, index in enumerate(layout.order)
            if not layout.system.parameters.items[index].name.startswith("bias_")
        ]
        for r, (problem, linearisation, filter) in enumerate(
            zip(layout.problems, linearisations, filters_of(weighted), strict=True)
        ):
            if self.quick:
                of_noise = set(self.noise_positions(layout, theta).tolist())
                acting = [
                    position for position in acting if int(layout.columns(r)[position]) in of_noise
                ]
            at = Variation(layout.split(theta, r)[0], scale)
            pairs = slope_pairs(
                at,
                [layout.order[position] for position in acting],
                (problem.increment[acting] / DIFFERENCE_STEP_SHARE).tolist(),
                self.scaled,
            )
            slopes = noise_slopes(problem, linearisation.states, at, pairs)
            columns = layout.columns(r)
            scale_position = n - 1
            of_process = [
                columns[acting[i]] if i < len(acting) else scale_position for i in slopes.positions
            ]
            positions = np.array([*of_process, *noise_unknowns[: len(estimated)]], dtype=int)
            if positions.size:
                derivatives = likelihood_slopes(
                    filter.whitener, filter.residual, slopes, by_variance
                )
            else:
                nodes = len(problem.grid.nodes)
                derivatives = LikelihoodSlopes(np.zeros(0), np.zeros((0, 0)), np.zeros((nodes, 0)))
            yield positions, derivatives

    def step_bounds(self, layout: LayoutView, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds ``(n,)`` of all unknowns for one step. A noise level may change by
        ``_LARGEST_NOISE_STEP_FACTOR``: farther away the likelihood is not quadratic in it.
        """
        low, high = np.concatenate([layout.low, self.low]), np.concatenate([layout.high, self.high])
        for i in self.noise_positions(layout, theta):
            if theta[i] > 0:
                low[i] = max(low[i], theta[i] / _LARGEST_NOISE_STEP_FACTOR)
                high[i] = min(high[i], theta[i] * _LARGEST_NOISE_STEP_FACTOR)
        return low, high

    def noise_positions(self, layout: LayoutView, theta: np.ndarray) -> np.ndarray:
        """Return the positions in theta of the unknowns of the noise.

        These are the noise levels, the scale, and the parameters of the System that change the
        density of the process noise.
        """
        n = len(theta)
        positions = set(range(n - len(self.names), n))
        for r in range(len(layout.problems)):
            p, _ = layout.split(theta, r)
            density = _density(layout.system, p)
            of_density = [
                position
                for position, index in enumerate(layout.order)
                if np.any(_density(layout.system, _slightly_changed(p, index)) != density)
            ]
            positions |= set(layout.columns(r)[of_density].tolist())
        return np.array(sorted(positions), dtype=int)

    def _innovations(
        self,
        layout: LayoutView,
        theta: np.ndarray,
        linearisations: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None:
        """Return the normalised innovations as `weight_residuals` does, but raise ``LinAlgError``
        where an innovation covariance is not positive definite.
        """
        std, scale = self.levels(theta)
        cost, filters, whitened, jacobians = -0.5 * float(counts.sum()), [], [], []
        for r, (problem, linearisation, residual) in enumerate(
            zip(layout.problems, linearisations, residuals, strict=True)
        ):
            motion = discretised_noise(
                problem, linearisation.states, Variation(layout.split(theta, r)[0], scale)
            )
            record_whitener = whitener(
                motion, std**2, _at_nodes(problem, problem.valid[:, :, None])[:, :, 0]
            )
            columns = filtered(
                record_whitener,
                _at_nodes(
                    problem, np.concatenate([residual[:, :, None], linearisation.jacobian], axis=2)
                ),
            )
            filtered_residual = Filtered(
                columns.innovation[:, :, 0], columns.normalised[:, :, 0], columns.state[:, :, 0]
            )
            filters.append(Filter(problem, record_whitener, filtered_residual))
            standard = _at_samples(problem, columns.normalised)
            whitened.append(standard[:, :, 0])
            jacobians.append(standard[:, :, 1:])
            squares = float(np.sum(filtered_residual.normalised**2))
            cost += 0.5 * (record_whitener.log_determinant + squares)
        if not (np.isfinite(cost) and all(np.all(np.isfinite(jacobian)) for jacobian in jacobians)):
            return None
        return WeightedResiduals(
            tuple(whitened), tuple(jacobians), np.ones(len(std)), cost, tuple(filters)
        )


def filters_of(weighted: WeightedResiduals) -> tuple[Filter, ...]:
    """Return the Kalman filter of each record, from residuals that a `ProcessNoise` weighted."""
    filters = tuple(item for item in weighted.filters if isinstance(item, Filter))
    assert len(filters) == len(weighted.filters)
    return filters


def _density(system: System, p: np.ndarray) -> np.ndarray:
    """Return the spectral density ``(nx,)`` of the white noise on each state."""
    return np.array(system.noise(p.tolist())[0], dtype=float)


def _slightly_changed(p: np.ndarray, index: int) -> np.ndarray:
    """Return all parameters ``p (np,)`` with one of them multiplied by ``_DENSITY_CHANGE``."""
    changed = p.copy()
    changed[index] *= _DENSITY_CHANGE
    return changed


def has_process_noise(system: System) -> bool:
    """Return whether white noise acts on a state."""
    return bool(np.any(_density(system, system.parameters.values()) > 0))


def process_noise(
    system: System,
    std: Mapping[str, float],
    present: Sequence[str],
    *,
    fixed: bool = False,
    scale: float = 1.0,
) -> ProcessNoise:
    """Return the noise model of a System.

    Parameters
    ----------
    std : output -> standard deviation of the measurement noise, or its starting value.
    present : names of the outputs whose noise levels are unknowns.
    fixed : neither levels nor scale are unknowns. Otherwise the scale is an unknown where the model
        declares process noise on a state.
    scale : factor on the standard deviation of the declared process noise, or its starting value.
    """
    names = system.output_names
    levels = np.array([std[name] for name in names])
    declared = any(
        value > 0 and name in system.state_names
        for name, value in system.declared_noise.process_density.items()
    )
    estimated = () if fixed else tuple(i for i, name in enumerate(names) if name in present)
    return ProcessNoise(names, levels, estimated, scale, declared and not fixed)


def noise_started_at(fit: Fit, theta: np.ndarray) -> ProcessNoise:
    """Return the noise model of a fit with the noise levels in ``theta (n,)`` as its start."""
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    std, scale = noise_model.levels(theta)
    return replace(noise_model, std=np.maximum(std, 1e-300), scale=scale)


def _at_nodes(problem: RecordProblem, values: np.ndarray) -> np.ndarray:
    """Return ``values (m, N, c)`` at the samples as ``(K + 1, m, c)`` at the nodes, with zeros at
    nodes without a sample.
    """
    nodes, at = len(problem.grid.nodes), problem.grid.sample // problem.grid.substeps
    by_sample = np.ascontiguousarray(values.transpose(1, 0, 2))
    if nodes == len(at):
        return by_sample
    by_node = np.zeros((nodes, *by_sample.shape[1:]), dtype=by_sample.dtype)
    by_node[at] = by_sample
    return by_node


def _at_samples(problem: RecordProblem, values: np.ndarray) -> np.ndarray:
    """Return ``values (K + 1, m, c)`` at the nodes as ``(m, N, c)`` at the samples."""
    return np.ascontiguousarray(
        values[problem.grid.sample // problem.grid.substeps].transpose(1, 0, 2)
    )


# ---- Restricted likelihood (REML)

_NOISE_DIFFERENCE_SHARE = 0.02  # relative step of a noise level for finite differences
_LARGEST_LOG_CHANGE = 0.7  # largest change of the logarithm of a noise level by the adjustment


@dataclass(frozen=True, eq=False)
class AdjustedLevels:
    """Unknowns of a fit with adjusted noise levels.

    Attributes
    ----------
    theta : ``(n,)`` all unknowns, the noise levels adjusted.
    factor : ``(n,)`` adjusted value over fitted value of each unknown; 1 for all but noise levels.
    log_variance : ``(n,)`` uncertainty of the variance of each unknown because noise levels are
        uncertain: variance of its natural logarithm; zero for the noise levels themselves.
    """

    theta: np.ndarray
    factor: np.ndarray
    log_variance: np.ndarray


def restricted_levels(fit: Fit, covariance: np.ndarray) -> AdjustedLevels:
    """Return the noise levels adjusted by restricted likelihood. A level at its bound stays there.

    ``covariance (n, n)`` is the covariance of all unknowns of the fit.
    """
    noise_model, theta, low, high = fit.noise_model, fit.theta, fit.problem.low, fit.problem.high
    assert isinstance(noise_model, ProcessNoise)
    of_noise = noise_model.noise_positions(fit.layout, theta)
    inside = (theta[of_noise] > low[of_noise]) & (theta[of_noise] < high[of_noise])
    free_levels, others = of_noise[inside], np.setdiff1d(np.arange(len(theta)), of_noise)
    base_determinant, variance = _log_determinant_and_variances(fit, theta, others)
    slope, log_slopes = np.zeros(len(free_levels)), np.zeros((len(free_levels), len(others)))
    for i, position in enumerate(free_levels):
        changed = theta.copy()
        changed[position] *= 1.0 + _NOISE_DIFFERENCE_SHARE
        determinant, changed_variance = _log_determinant_and_variances(fit, changed, others)
        slope[i] = (
            0.5 * (determinant - base_determinant) / (_NOISE_DIFFERENCE_SHARE * theta[position])
        )
        log_slopes[i] = np.log(changed_variance / variance) / (
            _NOISE_DIFFERENCE_SHARE * theta[position]
        )
    level_covariance = covariance[np.ix_(free_levels, free_levels)]
    change = np.clip(
        -level_covariance @ slope / theta[free_levels], -_LARGEST_LOG_CHANGE, _LARGEST_LOG_CHANGE
    )
    factor, log_variance = np.ones(len(theta)), np.zeros(len(theta))
    if np.all(np.isfinite(change)):
        factor[free_levels] = np.exp(change)
    if np.all(np.isfinite(log_slopes)):
        log_variance[others] = np.maximum(
            np.einsum("ij,ik,kj->j", log_slopes, level_covariance, log_slopes), 0.0
        )
    adjusted = np.clip(theta * factor, low, high)
    factor[free_levels] = adjusted[free_levels] / theta[free_levels]
    return AdjustedLevels(adjusted, factor, log_variance)


def _log_determinant_and_variances(
    fit: Fit, theta: np.ndarray, positions: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the log determinant of the information on the unknowns at ``positions``, and their
    variances, with the noise levels in ``theta``.

    The variances are the diagonal of the inverse information. The trajectories are those of the
    fit. Both results are NaN where the likelihood is not finite.
    """
    layout, n = fit.layout, len(theta)
    residuals = [
        np.where(problem.valid, problem.z - linearisation.y, 0.0)
        for problem, linearisation in zip(layout.problems, fit.linearisations, strict=True)
    ]
    weighted = fit.noise_model.weight_residuals(
        layout, theta, fit.linearisations, residuals, fit.counts
    )
    if weighted is None:
        return float("nan"), np.full(len(positions), np.nan)
    information = np.zeros((n, n))
    for r, jacobian in enumerate(weighted.jacobians):
        columns = layout.columns(r)
        J = jacobian.reshape(-1, len(columns))
        information[np.ix_(columns, columns)] += J.T @ J
    block = information[np.ix_(positions, positions)]
    determined = np.flatnonzero(np.diag(block) > 0)
    size = np.sqrt(np.diag(block)[determined])
    determinant = float(
        np.linalg.slogdet(block[np.ix_(determined, determined)] / np.outer(size, size))[1]
        + 2.0 * np.log(size).sum()
    )
    return determinant, np.diag(inverse_information(block)[0])
