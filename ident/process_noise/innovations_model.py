"""Noise model of a fit with process noise: filter error (Maine and Iliff 1981; Jategaonkar, ch. 5).

The likelihood is that of the innovations of a Kalman filter linearised about the fitted trajectory. Its gradient and
expected information include how the filter depends on the parameters, noise levels among them, so that all unknowns
are estimated together by Fisher scoring.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.process_noise.discretised import Variation, discretised_noise
from ident.process_noise.likelihood_slopes import LikelihoodSlopes, likelihood_slopes
from ident.process_noise.noise_slopes import noise_slopes, slope_pairs
from ident.process_noise.whitener import Filtered, Whitener, filtered, whitener
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.linearise import Linearisation
from ident.whole_record.noise_model import LaidOut, WeightedResiduals
from ident.whole_record.record_problem import INCREMENT, RecordProblem
from sim.declaration.model import System

SCALE = "process_noise_scale"
_FACTOR = 4.0  # by which one step changes a noise level at most
_LEAST, _MOST = 1e-3, 1e3  # range of a noise level, relative to its start


@dataclass(frozen=True, eq=False)
class Filter:
    """The whitener of one record and the residual that went through it."""

    problem: RecordProblem
    whitener: Whitener
    residual: Filtered

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Innovations of the columns over their standard deviation, zero where a sample is missing."""
        return _at_samples(self.problem, filtered(self.whitener, _at_nodes(self.problem, columns)).standard)


@dataclass(frozen=True, eq=False)
class ProcessNoise:
    """Measurement noise with the levels ``std (m,)``, and forcing of the states as ``System.noise`` says.

    ``estimated`` are positions of the outputs whose level is an unknown, started at ``std``. ``scale`` multiplies the standard
    deviation of process noise declared on states, and is an unknown where ``scaled``. Sensors with memory are taken as
    without it by the filter: their lag acts on the deterministic part only. ``quick`` : slopes of the gains by what sets the noise alone.
    ``least`` ``(m,)`` : smallest levels; None sets them by the start alone.
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
        return (*(f"std_{self.outputs[i]}" for i in self.estimated), *([SCALE] if self.scaled else []))

    @property
    def start(self) -> np.ndarray:
        return np.append(self.std[list(self.estimated)], [self.scale] if self.scaled else [])

    @property
    def low(self) -> np.ndarray:
        low = _LEAST * self.std if self.least is None else np.maximum(_LEAST * self.std, self.least)
        return np.append(low[list(self.estimated)], [0.0] if self.scaled else [])

    @property
    def high(self) -> np.ndarray:
        return np.append(_MOST * self.std[list(self.estimated)], [np.inf] if self.scaled else [])

    def levels(self, theta: np.ndarray) -> tuple[np.ndarray, float]:
        """Measurement noise ``(m,)`` and scale at ``theta``."""
        own = theta[len(theta) - len(self.names) :]
        std = self.std.copy()
        std[list(self.estimated)] = own[: len(self.estimated)]
        return std, float(own[-1]) if self.scaled else self.scale

    def weight_residuals(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], residuals: Sequence[np.ndarray], counts: np.ndarray
    ) -> WeightedResiduals | None:
        """Innovations of residuals and sensitivities; None where an innovation covariance is not positive definite."""
        try:
            return self._innovations(layout, theta, lines, residuals, counts)
        except np.linalg.LinAlgError:
            return None

    def covariance_terms(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], weighted: WeightedResiduals
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Terms through the filter's dependence on parameters and noise levels."""
        n = len(theta)
        gradient, information = np.zeros(n), np.zeros((n, n))
        for moving, part in self._slopes(layout, theta, lines, weighted):
            gradient[moving] += part.gradient
            information[np.ix_(moving, moving)] += part.information
        return gradient, information

    def _slopes(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], weighted: WeightedResiduals
    ) -> Iterator[tuple[np.ndarray, LikelihoodSlopes]]:
        """Of each record the positions of what moves its filter, and how the likelihood moves with it."""
        std, scale = self.levels(theta)
        n, estimated = len(theta), list(self.estimated)
        own = np.arange(n - len(self.names), n)
        by_variance = np.zeros((len(estimated), len(std)))
        by_variance[np.arange(len(estimated)), estimated] = 2.0 * std[estimated]
        acting = [q for q, index in enumerate(layout.order) if not layout.system.parameters.items[index].name.startswith("bias_")]
        for r, (problem, line, filter) in enumerate(zip(layout.problems, lines, filters_of(weighted), strict=True)):
            if self.quick:
                setting = set(self.setting_noise(layout, theta).tolist())
                acting = [q for q in acting if int(layout.columns(r)[q]) in setting]
            at = Variation(layout.split(theta, r)[0], scale)
            pairs = slope_pairs(at, [layout.order[q] for q in acting], (problem.increment[acting] / INCREMENT).tolist(), self.scaled)
            slopes = noise_slopes(problem, line.states, at, pairs)
            mine = layout.columns(r)
            moving = np.array([*(mine[acting[i]] if i < len(acting) else n - 1 for i in slopes.of), *own[: len(estimated)]], dtype=int)
            if moving.size:
                yield moving, likelihood_slopes(filter.whitener, filter.residual, slopes, by_variance)
            else:
                nodes = len(problem.grid.nodes)
                yield moving, LikelihoodSlopes(np.zeros(0), np.zeros((0, 0)), np.zeros((nodes, 0)))

    def step_bounds(self, layout: LaidOut, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """At most a factor on what sets the noise: far from the optimum the likelihood is anything but quadratic in it."""
        low, high = np.concatenate([layout.low, self.low]), np.concatenate([layout.high, self.high])
        for i in self.setting_noise(layout, theta):
            if theta[i] > 0:
                low[i], high[i] = max(low[i], theta[i] / _FACTOR), min(high[i], theta[i] * _FACTOR)
        return low, high

    def setting_noise(self, layout: LaidOut, theta: np.ndarray) -> np.ndarray:
        """Positions of the unknowns that set the noise: its own, and parameters of the System that move the forcing's density."""
        n = len(theta)
        positions = set(range(n - len(self.names), n))
        for r in range(len(layout.problems)):
            p, _ = layout.split(theta, r)
            density = _density(layout.system, p)
            setting = [q for q, index in enumerate(layout.order) if np.any(_density(layout.system, _stretched(p, index)) != density)]
            positions |= set(layout.columns(r)[setting].tolist())
        return np.array(sorted(positions), dtype=int)

    def _innovations(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], residuals: Sequence[np.ndarray], counts: np.ndarray
    ) -> WeightedResiduals | None:
        std, scale = self.levels(theta)
        cost, filters, whitened, jacobians = -0.5 * float(counts.sum()), [], [], []
        for r, (problem, line, residual) in enumerate(zip(layout.problems, lines, residuals, strict=True)):
            motion = discretised_noise(problem, line.states, Variation(layout.split(theta, r)[0], scale))
            made = whitener(motion, std**2, _at_nodes(problem, problem.valid[:, :, None])[:, :, 0])
            passed = filtered(made, _at_nodes(problem, np.concatenate([residual[:, :, None], line.jacobian], axis=2)))
            own = Filtered(passed.innovation[:, :, 0], passed.standard[:, :, 0], passed.state[:, :, 0])
            filters.append(Filter(problem, made, own))
            both = _at_samples(problem, passed.standard)
            whitened.append(both[:, :, 0])
            jacobians.append(both[:, :, 1:])
            cost += 0.5 * (made.log_determinant + float(np.sum(own.standard**2)))
        if not (np.isfinite(cost) and all(np.all(np.isfinite(jacobian)) for jacobian in jacobians)):
            return None
        return WeightedResiduals(tuple(whitened), tuple(jacobians), np.ones(len(std)), cost, tuple(filters))


def filters_of(weighted: WeightedResiduals) -> tuple[Filter, ...]:
    """The Kalman filters, one a record, of residuals that a ProcessNoise weighted."""
    filters = tuple(item for item in weighted.filters if isinstance(item, Filter))
    assert len(filters) == len(weighted.filters)
    return filters


def _density(system: System, p: np.ndarray) -> np.ndarray:
    return np.array(system.noise(p.tolist())[0], dtype=float)


def _stretched(p: np.ndarray, index: int) -> np.ndarray:
    moved = p.copy()
    moved[index] *= 1.01
    return moved


def has_process_noise(system: System) -> bool:
    """Whether white noise acts on a state."""
    return bool(np.any(_density(system, system.parameters.values()) > 0))


def process_noise(system: System, std: Mapping[str, float], present: Sequence[str], *, fixed: bool = False, scale: float = 1.0) -> ProcessNoise:
    """Noise model for a System: noise levels started (or ``fixed``) at ``std``, those of the outputs in ``present`` estimated.

    Process noise declared on states gets an unknown scale, unless fixed.
    """
    names = system.output_names
    levels = np.array([std[name] for name in names])
    declared = any(value > 0 and name in system.state_names for name, value in system.declared_noise.process_density.items())
    estimated = () if fixed else tuple(i for i, name in enumerate(names) if name in present)
    return ProcessNoise(names, levels, estimated, scale, declared and not fixed)


def noise_started_at(fit: Fit, theta: np.ndarray) -> ProcessNoise:
    """The noise model of a fit with its unknowns started where ``theta (n,)`` has them."""
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    std, scale = noise_model.levels(theta)
    return replace(noise_model, std=np.maximum(std, 1e-300), scale=scale)


def _at_nodes(problem: RecordProblem, values: np.ndarray) -> np.ndarray:
    """``(m, N, c)`` at the samples to ``(K + 1, m, c)`` at the nodes, zero between samples."""
    nodes, at = len(problem.grid.nodes), problem.grid.sample // problem.grid.substeps
    turned = np.ascontiguousarray(values.transpose(1, 0, 2))
    if nodes == len(at):
        return turned
    out = np.zeros((nodes, *turned.shape[1:]), dtype=turned.dtype)
    out[at] = turned
    return out


def _at_samples(problem: RecordProblem, values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values[problem.grid.sample // problem.grid.substeps].transpose(1, 0, 2))
