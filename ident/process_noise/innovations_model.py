"""Noise model of a fit with process noise (Maine and Iliff 1981; Jategaonkar, ch. 5), its
derivatives, and REML.

The likelihood is that of the innovations of a Kalman filter linearised about the fitted trajectory.
The parameters and noise levels change this filter. The gradient and the expected information of the
likelihood include this, so that Fisher scoring estimates all unknowns together. The derivatives of
the process noise are central differences of the linearised motion. Where the motion is smooth, they
are computed at every eighth step and interpolated linearly.

Maximum likelihood underestimates noise levels, since initial states, biases and derivatives fit a
part of the noise. This bias grows as records get shorter. The adjusted profile likelihood therefore
adds -0.5 ln det I, with I the information on those unknowns (Cox and Reid, J. Royal Statistical
Society B 49(1), 1987). One step is made from the maximum of the likelihood towards that of the
adjusted one.

Sigmas of the other unknowns are computed with these noise levels. `Levels.spread` is the effect of
uncertain noise levels on the variances (Giesbrecht and Burns, Biometrics 41(2), 1985; Kenward and
Roger, Biometrics 53(3), 1997).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.process_noise.linear_noise import (
    DiscretisedNoise,
    Variation,
    discrete_motion,
    discretised_noise,
    linear_motion,
)
from ident.process_noise.whitener import (
    Filtered,
    Whitener,
    closed_loop,
    combine_affine,
    every_node,
    filtered,
    from_left,
    from_right,
    joined,
    rows,
    scan,
    transposed,
    turned,
    whitener,
)
from ident.statistics.intervals import inverse_information
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.layout import LaidOut, WeightedResiduals
from ident.whole_record.linearise import Linearisation
from ident.whole_record.record_problem import DIFFERENCE_STEP_SHARE, RecordProblem
from sim.declaration.model import System

# ---- Derivatives of the process noise along a trajectory

_DIFFERENCE_STEP_SHARE = 1e-5  # step of central differences, relative to the parameter
# steps between computed derivatives where linear interpolation is good enough
_STEPS_BETWEEN_SLOPES = 8
# largest error of interpolated derivatives of F, relative to its largest entry; the error of those
# of Phi is 10 to 100 times smaller
_LARGEST_INTERPOLATION_ERROR = 0.005
_EVEN_SAMPLING_TOLERANCE = 1e-9  # largest relative difference of even steps


@dataclass(frozen=True, eq=False)
class NoiseSlopes:
    """Derivatives of the discretised process noise.

    Attributes
    ----------
    of : positions of the quantities, among those requested, that change the noise.
    motion : derivatives with respect to these quantities.
    """

    of: tuple[int, ...]
    motion: DiscretisedNoise


def noise_slopes(
    problem: RecordProblem,
    states: np.ndarray,
    at: Variation,
    pairs: Sequence[tuple[Variation, Variation, float]],
) -> NoiseSlopes:
    """Return the derivatives of the process noise about the fixed trajectory ``states (nx, K +
    1)``.

    ``pairs`` from `slope_pairs` has two variations for each quantity, and the difference of the
    quantity between them.
    """
    # variation 0 is the base; quantity i has the variations 1 + 2 i and 2 + 2 i
    ends = [end for low, high, _ in pairs for end in (low, high)]
    F, H, density, stationary = linear_motion(problem, states, [at, *ends])
    parts = (F, H, density[None])
    of = tuple(
        i
        for i in range(len(pairs))
        if any(np.any(part[:, 1 + 2 * i] != part[:, 2 + 2 * i]) for part in parts)
    )
    chosen = [0, *(end for i in of for end in (1 + 2 * i, 2 + 2 * i))]
    width = np.array([pairs[i][2] for i in of])[:, None, None]

    def slope(part: np.ndarray) -> np.ndarray:
        return np.asarray((part[:, 2::2] - part[:, 1::2]) / width)

    F, steps = F[:, chosen], np.diff(problem.grid.nodes)
    computed = _computed_steps(np.concatenate([F[:, :1], slope(F)], axis=1), steps)
    by_Phi, by_Q, start = discrete_motion(
        F[computed], steps[computed] if len(F) > 1 else steps, density[chosen], stationary, slope
    )
    by_Phi, by_Q = (_interpolated(slopes, computed, len(steps)) for slopes in (by_Phi, by_Q))
    return NoiseSlopes(
        of, DiscretisedNoise(by_Phi, by_Q, slope(H[:, chosen]), slope(start[None])[0])
    )


def slope_pairs(
    at: Variation, positions: Sequence[int], sizes: Sequence[float], scale: bool
) -> list[tuple[Variation, Variation, float]]:
    """Return pairs of variations for central differences, each with the difference between the two.

    The first pairs change one of the parameters at ``positions`` each, by a step relative to its
    entry in ``sizes``. The last pair changes the scale, where ``scale`` is True.
    """
    pairs = []
    for position, size in zip(positions, sizes, strict=True):
        step, ends = _DIFFERENCE_STEP_SHARE * size, []
        for sign in (-1.0, 1.0):
            p = at.p.copy()
            p[position] += sign * step
            ends.append(Variation(p, at.scale))
        pairs.append((ends[0], ends[1], ends[1].p[position] - ends[0].p[position]))
    if scale:
        step = _DIFFERENCE_STEP_SHARE * max(at.scale, 1.0)
        pairs.append(
            (Variation(at.p, at.scale - step), Variation(at.p, at.scale + step), 2.0 * step)
        )
    return pairs


def _computed_steps(values: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the steps at which derivatives are computed: every eighth step where all ``values (K,
    D, n, n)`` are smooth, else every step.
    """
    every = np.arange(len(values))
    uneven = np.ptp(steps) > _EVEN_SAMPLING_TOLERANCE * steps.max()
    if len(values) < 2 * _STEPS_BETWEEN_SLOPES or uneven:
        return every
    eighths = np.append(every[:-1:_STEPS_BETWEEN_SLOPES], every[-1])
    error = np.abs(_interpolated(values[eighths], eighths, len(values)) - values).max(axis=0)
    largest = np.abs(values).max(axis=0).max(axis=(-2, -1), keepdims=True)
    return eighths if np.all(error <= _LARGEST_INTERPOLATION_ERROR * largest) else every


def _interpolated(values: np.ndarray, at: np.ndarray, count: int) -> np.ndarray:
    """Return ``values``, given at the steps ``at``, interpolated linearly at all ``count`` steps. A
    single value is constant and stays as it is.
    """
    if len(values) in (1, count):
        return values
    left = np.clip(np.searchsorted(at, np.arange(count), side="right") - 1, 0, len(at) - 2)
    share = ((np.arange(count) - at[left]) / (at[left + 1] - at[left])).reshape(
        -1, *(1,) * (values.ndim - 1)
    )
    return np.asarray(values[left] + share * (values[left + 1] - values[left]))


# ---- Derivatives of the likelihood through the filter's gains

# most numbers in covariance derivatives that are computed together; more do not fit the processor's
# cache
_LARGEST_BATCH = 800_000


@dataclass(frozen=True, eq=False)
class LikelihoodSlopes:
    """Derivatives of the log likelihood with respect to D quantities, as far as these change the
    gains and innovation covariances of the filter.

    Attributes
    ----------
    gradient : ``(D,)``.
    information : ``(D, D)`` expected information.
    scores : ``(K + 1, D)`` contribution of each node to the gradient.
    """

    gradient: np.ndarray
    information: np.ndarray
    scores: np.ndarray


def likelihood_slopes(
    filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray
) -> LikelihoodSlopes:
    """Return the derivatives of the log likelihood of one record.

    Parameters
    ----------
    residual : the residual through the filter, a single column.
    slopes : derivatives of the process noise with respect to the first quantities.
    by_variance : ``(d, m)`` derivatives of the measurement variances with respect to the last d
        quantities.
    """
    T, n, D = len(filter.covariance), filter.covariance.shape[-1], len(slopes.of) + len(by_variance)
    by_variance = np.concatenate([np.zeros((len(slopes.of), len(filter.variance))), by_variance])
    batch = max(1, _LARGEST_BATCH // max(1, T * n * n))
    parts = [
        _covariance_derivatives(filter, residual, slopes, by_variance, slice(k, k + batch))
        for k in range(0, D, batch)
    ]
    e, m = residual.standard, filter.valid.shape[1]
    flat = np.zeros((0, e[:T].size * m))
    if parts:
        flat = np.concatenate([dS for dS, _ in parts])
    counts = np.bincount(filter.at, minlength=T).astype(float)[:, None, None]
    information = 0.5 * (flat * np.broadcast_to(counts, (T, m, m)).reshape(-1)) @ flat.T
    # squares of the normalised innovations minus their expected values
    excess = e[:, :, None] * e[:, None, :] - np.where(filter.valid[:, :, None], np.eye(m), 0.0)
    by_node = flat.reshape(len(flat), T, m * m)
    scores = np.empty((len(e), D))
    scores[:T] = 0.5 * np.einsum("dtm,tm->td", by_node, excess[:T].reshape(T, m * m))
    scores[T:] = 0.5 * excess[T:].reshape(len(e) - T, m * m) @ by_node[:, -1].T
    if n == 0:
        return LikelihoodSlopes(scores.sum(axis=0), information, scores)
    columns = np.concatenate([by_innovation for _, by_innovation in parts], axis=1)
    scores += np.einsum("kmd,km->kd", columns.reshape(len(e), m, D), e)
    return LikelihoodSlopes(scores.sum(axis=0), information + columns.T @ columns, scores)


def _covariance_derivatives(
    filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray, part: slice
) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives with respect to d of the D quantities, those in ``part``: of the
    normalised innovation covariances ``(d, T m m)``, and of the normalised innovations ``((K + 1)
    m, d)``.
    """
    T, m, n = len(filter.covariance), filter.valid.shape[1], filter.covariance.shape[-1]
    of_variance = by_variance[part]
    d = len(of_variance)
    e, x, K = residual.standard, residual.state[..., None], filter.gain
    P, Phi = filter.covariance, filter.motion.Phi
    present = np.where(filter.valid[:1] if len(filter.seen) == 1 else filter.valid, 1.0, 0.0)
    by_Phi, by_Q, by_start = (
        _padded(M, part, d) for M in (slopes.motion.Phi, slopes.motion.Q, slopes.motion.start[None])
    )
    by_H = _padded(slopes.motion.H, part, d) * present[:, :, None, None]
    by_R = np.zeros((len(present), m, d, m))
    for i in range(m):
        by_R[:, i, :, i] = of_variance[:, i] * present[:, i, None]
    H, dH = rows(filter.seen, slice(T)), rows(by_H, slice(T))
    dR = rows(by_R, slice(T))
    open_loop = np.eye(n) - K @ H
    # Covariance after an update: dP = (I - KH) dP_before (I - KH)^T + K dR K^T - P dH^T K^T - K dH
    # P.
    K_dH_P = from_left(K, from_right(dH, P))
    update = from_right(from_left(K, dR), turned(K)) - K_dH_P - transposed(K_dH_P)
    first = (from_right(from_left(open_loop[:1], by_start), turned(open_loop[:1])) + update[:1])[0]
    dP = np.empty((T, n, d, n))
    dP_before = np.empty((T, n, d, n))
    dP[0], dP_before[0] = first, by_start[0]
    if T > 1:
        F, dF, dQ = (rows(M, slice(T - 1)) for M in (Phi, by_Phi, by_Q))
        dF_P_Ft = from_right(dF, P[:-1] @ turned(F))
        forcing = dF_P_Ft + transposed(dF_P_Ft) + dQ
        closed = open_loop[1:]
        transition, added = scan(
            combine_affine,
            (closed @ F, from_right(from_left(closed, forcing), turned(closed)) + update[1:]),
        )
        dP[1:] = (
            from_right(
                from_left(transition, np.broadcast_to(first, (T - 1, n, d, n))), turned(transition)
            )
            + added
        )
        dP_before[1:] = from_right(from_left(F, dP[:-1]), turned(F)) + forcing
    dH_P_Ht = from_right(dH, filter.predicted @ turned(H))
    dS = dH_P_Ht + transposed(dH_P_Ht) + from_right(from_left(H, dP_before), turned(H)) + dR
    flat = (
        from_right(from_left(filter.root, dS), turned(filter.root))
        .transpose(2, 0, 1, 3)
        .reshape(d, -1)
    )
    if n == 0:
        return flat, np.zeros((e.size, d))
    # K = P H^T R^-1. The state changes with the gain.
    dK = (from_right(dP, turned(H)) + _right_transposed(P, dH) - from_left(K, dR)) / filter.variance
    predicted = np.zeros((len(e), n, 1))
    predicted[1:] = Phi @ x[:-1]
    pushed_state = np.zeros((len(e), n, d))
    pushed_state[1:] = from_right(by_Phi, x[:-1])[..., 0]
    change_by_H = from_right(by_H, predicted)[..., 0]
    source = (
        from_right(every_node(dK, filter), residual.innovation[..., None])[..., 0]
        + every_node(open_loop, filter) @ pushed_state
        - every_node(K, filter) @ change_by_H
    )
    by_state = pushed_state
    by_state[1:] += Phi @ joined(closed_loop(filter), source)[:-1]
    return flat, (every_node(filter.root, filter) @ (change_by_H + filter.seen @ by_state)).reshape(
        -1, d
    )


def _padded(stack: np.ndarray, part: slice, d: int) -> np.ndarray:
    """Return the derivatives ``part`` of a stack ``(B, D, a, b)`` in the axes ``(B, a, d, b)``
    of `ident.process_noise.whitener`; zeros fill up to d quantities.
    """
    derivatives = stack[:, part].swapaxes(1, 2)
    padded = np.zeros((*derivatives.shape[:2], d, derivatives.shape[3]))
    padded[:, :, : derivatives.shape[2]] = derivatives
    return padded


def _right_transposed(left: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """Return ``left`` times the transpose of each matrix of ``stack (B, m, D, n)``: ``(T, n, D,
    m)``.
    """
    return transposed(from_right(stack, turned(left)))


# ---- Noise model of a fit with process noise

SCALE = "process_noise_scale"  # name of the factor on declared process noise
_LARGEST_NOISE_STEP_FACTOR = 4.0  # largest factor on a noise level in one step
_LOWEST_LEVEL, _HIGHEST_LEVEL = 1e-3, 1e3  # bounds of a noise level, relative to its start
_DENSITY_CHANGE = 1.01  # factor on a parameter that shows whether it changes the process noise


@dataclass(frozen=True, eq=False)
class Filter:
    """Kalman filter of one record, with the residual through it."""

    problem: RecordProblem
    whitener: Whitener
    residual: Filtered

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return the innovations of ``columns (m, N, c)`` over their standard deviations, zero
        where a sample is missing.
        """
        innovations = filtered(self.whitener, _at_nodes(self.problem, columns)).standard
        return _at_samples(self.problem, innovations)


@dataclass(frozen=True, eq=False)
class ProcessNoise:
    """White measurement noise, and the process noise that `System.noise` gives.

    Attributes
    ----------
    outputs : names of the m outputs.
    std : ``(m,)`` measurement noise: a starting value where the level is an unknown.
    estimated : positions of the outputs whose level is an unknown.
    scale : factor on the standard deviation of process noise that the model declares on states.
    scaled : whether the scale is an unknown; it then starts at ``scale``.
    quick : neglect that parameters other than those of the noise change the gains.
    least : ``(m,)`` smallest levels; None sets them from the start.
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
        """Return the measurement noise ``(m,)`` and the scale at ``theta``."""
        own = theta[len(theta) - len(self.names) :]
        std = self.std.copy()
        std[list(self.estimated)] = own[: len(self.estimated)]
        return std, float(own[-1]) if self.scaled else self.scale

    def weight_residuals(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None:
        """Return the innovations of residuals and sensitivities; None where an innovation
        covariance is not positive definite.
        """
        try:
            return self._innovations(layout, theta, lines, residuals, counts)
        except np.linalg.LinAlgError:
            return None

    def covariance_terms(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        weighted: WeightedResiduals,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the part of the gradient ``(n,)`` and of the information ``(n, n)`` that is due to
        changes of the filter by the unknowns.
        """
        n = len(theta)
        gradient, information = np.zeros(n), np.zeros((n, n))
        for positions, slopes in self._slopes(layout, theta, lines, weighted):
            gradient[positions] += slopes.gradient
            information[np.ix_(positions, positions)] += slopes.information
        return gradient, information

    def _slopes(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        weighted: WeightedResiduals,
    ) -> Iterator[tuple[np.ndarray, LikelihoodSlopes]]:
        """Yield for each record the positions of the unknowns that change its filter, and the
        derivatives of the log likelihood with respect to these.
        """
        std, scale = self.levels(theta)
        n, estimated = len(theta), list(self.estimated)
        own = np.arange(n - len(self.names), n)
        by_variance = np.zeros((len(estimated), len(std)))
        by_variance[np.arange(len(estimated)), estimated] = 2.0 * std[estimated]
        acting = [
            position
            for position, index in enumerate(layout.order)
            if not layout.system.parameters.items[index].name.startswith("bias_")
        ]
        for r, (problem, line, filter) in enumerate(
            zip(layout.problems, lines, filters_of(weighted), strict=True)
        ):
            if self.quick:
                of_noise = set(self.noise_positions(layout, theta).tolist())
                acting = [q for q in acting if int(layout.columns(r)[q]) in of_noise]
            at = Variation(layout.split(theta, r)[0], scale)
            pairs = slope_pairs(
                at,
                [layout.order[q] for q in acting],
                (problem.increment[acting] / DIFFERENCE_STEP_SHARE).tolist(),
                self.scaled,
            )
            slopes = noise_slopes(problem, line.states, at, pairs)
            columns = layout.columns(r)
            scale_position = n - 1
            of_process = [
                columns[acting[i]] if i < len(acting) else scale_position for i in slopes.of
            ]
            positions = np.array([*of_process, *own[: len(estimated)]], dtype=int)
            if positions.size:
                derivatives = likelihood_slopes(
                    filter.whitener, filter.residual, slopes, by_variance
                )
            else:
                nodes = len(problem.grid.nodes)
                derivatives = LikelihoodSlopes(np.zeros(0), np.zeros((0, 0)), np.zeros((nodes, 0)))
            yield positions, derivatives

    def step_bounds(self, layout: LaidOut, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds ``(n,)`` of all unknowns for one step. A noise level may change by
        ``_LARGEST_NOISE_STEP_FACTOR``: farther away the likelihood is not quadratic in it.
        """
        low, high = np.concatenate([layout.low, self.low]), np.concatenate([layout.high, self.high])
        for i in self.noise_positions(layout, theta):
            if theta[i] > 0:
                low[i] = max(low[i], theta[i] / _LARGEST_NOISE_STEP_FACTOR)
                high[i] = min(high[i], theta[i] * _LARGEST_NOISE_STEP_FACTOR)
        return low, high

    def noise_positions(self, layout: LaidOut, theta: np.ndarray) -> np.ndarray:
        """Return the positions in theta of the unknowns of the noise: noise levels, the scale, and
        the parameters of the System that change the density of the process noise.
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
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None:
        """Return the innovations as `weight_residuals` does; an innovation covariance that is not
        positive definite raises.
        """
        std, scale = self.levels(theta)
        cost, filters, whitened, jacobians = -0.5 * float(counts.sum()), [], [], []
        for r, (problem, line, residual) in enumerate(
            zip(layout.problems, lines, residuals, strict=True)
        ):
            motion = discretised_noise(
                problem, line.states, Variation(layout.split(theta, r)[0], scale)
            )
            record_whitener = whitener(
                motion, std**2, _at_nodes(problem, problem.valid[:, :, None])[:, :, 0]
            )
            columns = filtered(
                record_whitener,
                _at_nodes(problem, np.concatenate([residual[:, :, None], line.jacobian], axis=2)),
            )
            filtered_residual = Filtered(
                columns.innovation[:, :, 0], columns.standard[:, :, 0], columns.state[:, :, 0]
            )
            filters.append(Filter(problem, record_whitener, filtered_residual))
            standard = _at_samples(problem, columns.standard)
            whitened.append(standard[:, :, 0])
            jacobians.append(standard[:, :, 1:])
            squares = float(np.sum(filtered_residual.standard**2))
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
    std : output -> measurement noise, or its starting value.
    present : outputs whose levels are unknowns.
    fixed : nothing is an unknown. Otherwise the scale is one too, where the model declares process
        noise on a state.
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
class Levels:
    """Unknowns of a fit with adjusted noise levels.

    Attributes
    ----------
    theta : ``(n,)`` all unknowns, the noise levels adjusted.
    factor : ``(n,)`` factor of the adjustment on each unknown, 1 where it is no noise level.
    spread : ``(n,)`` variance of the logarithm of the variance of each unknown, from uncertain
        noise levels; zero for the levels themselves.
    """

    theta: np.ndarray
    factor: np.ndarray
    spread: np.ndarray


def restricted_levels(fit: Fit, covariance: np.ndarray) -> Levels:
    """Return the adjusted noise levels, from the ``covariance (n, n)`` of the fit. A level at its
    bound stays there.
    """
    noise_model, theta, low, high = fit.noise_model, fit.theta, fit.problem.low, fit.problem.high
    assert isinstance(noise_model, ProcessNoise)
    of_noise = noise_model.noise_positions(fit.layout, theta)
    inside = (theta[of_noise] > low[of_noise]) & (theta[of_noise] < high[of_noise])
    free_levels, others = of_noise[inside], np.setdiff1d(np.arange(len(theta)), of_noise)
    base, variance = _information_of(fit, theta, others)
    slope, log_slopes = np.zeros(len(free_levels)), np.zeros((len(free_levels), len(others)))
    for i, position in enumerate(free_levels):
        changed = theta.copy()
        changed[position] *= 1.0 + _NOISE_DIFFERENCE_SHARE
        determinant, changed_variance = _information_of(fit, changed, others)
        slope[i] = 0.5 * (determinant - base) / (_NOISE_DIFFERENCE_SHARE * theta[position])
        log_slopes[i] = np.log(changed_variance / variance) / (
            _NOISE_DIFFERENCE_SHARE * theta[position]
        )
    level_covariance = covariance[np.ix_(free_levels, free_levels)]
    change = np.clip(
        -level_covariance @ slope / theta[free_levels], -_LARGEST_LOG_CHANGE, _LARGEST_LOG_CHANGE
    )
    factor, spread = np.ones(len(theta)), np.zeros(len(theta))
    if np.all(np.isfinite(change)):
        factor[free_levels] = np.exp(change)
    if np.all(np.isfinite(log_slopes)):
        spread[others] = np.maximum(
            np.einsum("ij,ik,kj->j", log_slopes, level_covariance, log_slopes), 0.0
        )
    adjusted = np.clip(theta * factor, low, high)
    factor[free_levels] = adjusted[free_levels] / theta[free_levels]
    return Levels(adjusted, factor, spread)


def _information_of(fit: Fit, theta: np.ndarray, positions: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the log determinant of the information on the unknowns at ``positions``, and the
    diagonal of its inverse, with the noise levels in ``theta``.

    The trajectories are those of the fit. Both are NaN where the likelihood is not finite.
    """
    layout, n = fit.layout, len(theta)
    residuals = [
        np.where(problem.valid, problem.z - line.y, 0.0)
        for problem, line in zip(layout.problems, fit.lines, strict=True)
    ]
    weighted = fit.noise_model.weight_residuals(layout, theta, fit.lines, residuals, fit.counts)
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
