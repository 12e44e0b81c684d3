"""Noise model of a fit with process noise (Maine and Iliff 1981; Jategaonkar, ch. 5), its
derivatives, and REML.

Derivatives of the process noise are central differences of the linearised motion. Where the motion
is smooth, they are computed at every eighth step and interpolated linearly.

The likelihood is that of the innovations of a Kalman filter linearised about the fitted trajectory.
Its gradient and expected information include the dependence of the filter on the parameters and
noise levels, so that Fisher scoring estimates all unknowns together.

Maximum likelihood underestimates noise levels: part of the noise is fitted by initial states,
biases and derivatives. The bias grows as records get shorter. The adjusted profile likelihood adds
-0.5 ln det I, with I the information on those unknowns (Cox and Reid, J. Royal Statistical Society
B 49(1), 1987). One step towards its maximum is taken.

Sigmas of the other unknowns are computed with these noise levels. `Levels.spread` is the effect of
the levels' own uncertainty on the variances (Giesbrecht and Burns, Biometrics 41(2), 1985; Kenward
and Roger, Biometrics 53(3), 1997).
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
# largest error of interpolation, relative to the largest entry of F: that of Phi is 10 to 100 times
# smaller
_LARGEST_INTERPOLATION_ERROR = 0.005


@dataclass(frozen=True, eq=False)
class NoiseSlopes:
    """Derivatives of the discretised noise by the quantities ``of``, positions among those
    requested; quantities without influence are left out.
    """

    of: tuple[int, ...]
    motion: DiscretisedNoise


def noise_slopes(
    problem: RecordProblem,
    states: np.ndarray,
    at: Variation,
    pairs: Sequence[tuple[Variation, Variation, float]],
) -> NoiseSlopes:
    """Return the derivatives of the process noise at the given trajectory, which itself is held
    fixed.

    ``pairs`` : for each quantity two variations and the distance between them, from
    ``slope_pairs``.
    """
    F, H, density, stationary = linear_motion(
        problem, states, [at, *(end for low, high, _ in pairs for end in (low, high))]
    )
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
    at_these = _computed_steps(np.concatenate([F[:, :1], slope(F)], axis=1), steps)
    by_Phi, by_Q, start = discrete_motion(
        F[at_these], steps[at_these] if len(F) > 1 else steps, density[chosen], stationary, slope
    )
    by_Phi, by_Q = (_interpolated(slopes, at_these, len(steps)) for slopes in (by_Phi, by_Q))
    return NoiseSlopes(
        of, DiscretisedNoise(by_Phi, by_Q, slope(H[:, chosen]), slope(start[None])[0])
    )


def slope_pairs(
    at: Variation, positions: Sequence[int], sizes: Sequence[float], scale: bool
) -> list[tuple[Variation, Variation, float]]:
    """Return the pairs of parameter sets for central differences by the parameters at ``positions``
    (with their sizes), then by the scale if wanted.
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
    """Return the steps at which derivatives are computed: every eighth if all ``values (K, D,
    n, n)`` are smooth, else all.
    """
    every = np.arange(len(values))
    if len(values) < 2 * _STEPS_BETWEEN_SLOPES or np.ptp(steps) > 1e-9 * steps.max():
        return every
    some = np.append(every[:-1:_STEPS_BETWEEN_SLOPES], every[-1])
    away = np.abs(_interpolated(values[some], some, len(values)) - values).max(axis=0)
    largest = np.abs(values).max(axis=0).max(axis=(-2, -1), keepdims=True)
    return some if np.all(away <= _LARGEST_INTERPOLATION_ERROR * largest) else every


def _interpolated(values: np.ndarray, at: np.ndarray, count: int) -> np.ndarray:
    """Return ``values (len(at), ...)`` interpolated linearly at ``count`` steps; unchanged if
    constant or known at each step.
    """
    if len(values) in (1, count):
        return values
    left = np.clip(np.searchsorted(at, np.arange(count), side="right") - 1, 0, len(at) - 2)
    share = ((np.arange(count) - at[left]) / (at[left + 1] - at[left])).reshape(
        -1, *(1,) * (values.ndim - 1)
    )
    return np.asarray(values[left] + share * (values[left + 1] - values[left]))


# ---- Derivatives of the likelihood through the filter's gains

# covariance derivatives computed together; more do not fit the processor's cache
_LARGEST_BATCH = 800_000


@dataclass(frozen=True, eq=False)
class LikelihoodSlopes:
    """Derivatives of the log likelihood through the filter's dependence on D quantities.

    ``gradient (D,)`` and expected ``information (D, D)`` of the log likelihood through gains and
    innovation covariances; ``scores (K + 1, D)`` are the contributions of the nodes to the
    gradient.
    """

    gradient: np.ndarray
    information: np.ndarray
    scores: np.ndarray


def likelihood_slopes(
    filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray
) -> LikelihoodSlopes:
    """Return the derivatives of the log likelihood with respect to the quantities of the process
    noise, then of the measurement variances.

    ``residual`` is one column; ``by_variance (d, m)`` are derivatives of the measurement variances.
    """
    T, n, D = len(filter.covariance), filter.covariance.shape[-1], len(slopes.of) + len(by_variance)
    by_variance = np.concatenate([np.zeros((len(slopes.of), len(filter.variance))), by_variance])
    batch = max(1, _LARGEST_BATCH // max(1, T * n * n))
    parts = [
        _covariance_derivatives(filter, residual, slopes, by_variance, slice(k, k + batch))
        for k in range(0, D, batch)
    ]
    flat = (
        np.concatenate([dS for dS, _ in parts])
        if parts
        else np.zeros((0, residual.standard[:T].size * filter.valid.shape[1]))
    )
    e, m = residual.standard, filter.valid.shape[1]
    counts = np.bincount(filter.at, minlength=T).astype(float)[:, None, None]
    information = 0.5 * (flat * np.broadcast_to(counts, (T, m, m)).reshape(-1)) @ flat.T
    beyond = e[:, :, None] * e[:, None, :] - np.where(filter.valid[:, :, None], np.eye(m), 0.0)
    by_node = flat.reshape(len(flat), T, m * m)
    scores = np.empty((len(e), D))
    scores[:T] = 0.5 * np.einsum("dtm,tm->td", by_node, beyond[:T].reshape(T, m * m))
    scores[T:] = 0.5 * beyond[T:].reshape(len(e) - T, m * m) @ by_node[:, -1].T
    if n == 0:
        return LikelihoodSlopes(scores.sum(axis=0), information, scores)
    columns = np.concatenate([moved for _, moved in parts], axis=1)
    scores += np.einsum("kmd,km->kd", columns.reshape(len(e), m, D), e)
    return LikelihoodSlopes(scores.sum(axis=0), information + columns.T @ columns, scores)


def _covariance_derivatives(
    filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray, some: slice
) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives by ``some`` of the D quantities: of normalised innovation covariances
    ``(d, T m m)``, and of normalised innovations ``((K + 1) m, d)``.
    """
    T, m, n = len(filter.covariance), filter.valid.shape[1], filter.covariance.shape[-1]
    of_variance = by_variance[some]
    d = len(of_variance)
    e, x, K = residual.standard, residual.state[..., None], filter.gain
    P, Phi = filter.covariance, filter.motion.Phi
    present = np.where(filter.valid[:1] if len(filter.seen) == 1 else filter.valid, 1.0, 0.0)
    by_Phi, by_Q, by_start = (
        _padded(M, some, d) for M in (slopes.motion.Phi, slopes.motion.Q, slopes.motion.start[None])
    )
    by_H = _padded(slopes.motion.H, some, d) * present[:, :, None, None]
    by_R = np.zeros((len(present), m, d, m))
    for i in range(m):
        by_R[:, i, :, i] = of_variance[:, i] * present[:, i, None]
    H, dH = rows(filter.seen, slice(T)), rows(by_H, slice(T))
    dR = rows(by_R, slice(T))
    open_loop = np.eye(n) - K @ H
    # Covariance after an update: dP = (I - KH) dP_before (I - KH)^T + K dR K^T - P dH^T K^T - K dH
    # P.
    K_dH_P = from_left(K, from_right(dH, P))
    own = from_right(from_left(K, dR), turned(K)) - K_dH_P - transposed(K_dH_P)
    first = (from_right(from_left(open_loop[:1], by_start), turned(open_loop[:1])) + own[:1])[0]
    dP = np.empty((T, n, d, n))
    dP_before = np.empty((T, n, d, n))
    dP[0], dP_before[0] = first, by_start[0]
    if T > 1:
        F, dF, dQ = (rows(M, slice(T - 1)) for M in (Phi, by_Phi, by_Q))
        pushed = from_right(dF, P[:-1] @ turned(F))
        forcing = pushed + transposed(pushed) + dQ
        inside = open_loop[1:]
        through, added = scan(
            combine_affine,
            (inside @ F, from_right(from_left(inside, forcing), turned(inside)) + own[1:]),
        )
        dP[1:] = (
            from_right(
                from_left(through, np.broadcast_to(first, (T - 1, n, d, n))), turned(through)
            )
            + added
        )
        dP_before[1:] = from_right(from_left(F, dP[:-1]), turned(F)) + forcing
    crossed = from_right(dH, filter.predicted @ turned(H))
    dS = crossed + transposed(crossed) + from_right(from_left(H, dP_before), turned(H)) + dR
    flat = (
        from_right(from_left(filter.root, dS), turned(filter.root))
        .transpose(2, 0, 1, 3)
        .reshape(d, -1)
    )
    if n == 0:
        return flat, np.zeros((e.size, d))
    # K = P H^T R^-1; the state changes with the gain.
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
    moved = pushed_state
    moved[1:] += Phi @ joined(closed_loop(filter), source)[:-1]
    return flat, (every_node(filter.root, filter) @ (change_by_H + filter.seen @ moved)).reshape(
        -1, d
    )


def _padded(stack: np.ndarray, some: slice, d: int) -> np.ndarray:
    """Return the derivatives ``(B, D, a, b)`` by ``some``, padded with zeros, in the axis order
    ``(B, a, d, b)`` of `ident.process_noise.whitener`.
    """
    found = stack[:, some].swapaxes(1, 2)
    out = np.zeros((*found.shape[:2], d, found.shape[3]))
    out[:, :, : found.shape[2]] = found
    return out


def _right_transposed(left: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """Return ``left`` times the transpose of each matrix of ``stack (B, m, D, n)``: ``(T, n, D,
    m)``.
    """
    return transposed(from_right(stack, turned(left)))


# ---- Noise model of a fit with process noise

SCALE = "process_noise_scale"
_LARGEST_NOISE_STEP_FACTOR = 4.0  # largest factor on a noise level in one step
_LOWEST_LEVEL, _HIGHEST_LEVEL = 1e-3, 1e3  # range of a noise level, relative to its start


@dataclass(frozen=True, eq=False)
class Filter:
    """The whitener of one record, with the whitened residual."""

    problem: RecordProblem
    whitener: Whitener
    residual: Filtered

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return the innovations of the columns over their standard deviation, zero where a sample
        is missing.
        """
        return _at_samples(
            self.problem, filtered(self.whitener, _at_nodes(self.problem, columns)).standard
        )


@dataclass(frozen=True, eq=False)
class ProcessNoise:
    """Measurement noise with levels ``std (m,)``, and process noise as ``System.noise`` declares
    it.

    ``estimated`` : positions of the outputs whose level is an unknown, started at ``std``.

    ``scale`` : factor on the standard deviation of process noise declared on states; an unknown if
    ``scaled``.

    ``quick`` : derivatives of the gains by the noise's own unknowns alone.

    ``least`` : ``(m,)`` smallest levels; None sets them from the start.
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
        low = (
            _LOWEST_LEVEL * self.std
            if self.least is None
            else np.maximum(_LOWEST_LEVEL * self.std, self.least)
        )
        return np.append(low[list(self.estimated)], [0.0] if self.scaled else [])

    @property
    def high(self) -> np.ndarray:
        return np.append(
            _HIGHEST_LEVEL * self.std[list(self.estimated)], [np.inf] if self.scaled else []
        )

    def levels(self, theta: np.ndarray) -> tuple[np.ndarray, float]:
        """Measurement noise ``(m,)`` and scale at ``theta``."""
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
        """Return the gradient and information through the filter's dependence on the unknowns."""
        n = len(theta)
        gradient, information = np.zeros(n), np.zeros((n, n))
        for moving, part in self._slopes(layout, theta, lines, weighted):
            gradient[moving] += part.gradient
            information[np.ix_(moving, moving)] += part.information
        return gradient, information

    def _slopes(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        weighted: WeightedResiduals,
    ) -> Iterator[tuple[np.ndarray, LikelihoodSlopes]]:
        """Yield, for each record, the positions of the unknowns of its filter, and the derivatives
        of the likelihood by them.
        """
        std, scale = self.levels(theta)
        n, estimated = len(theta), list(self.estimated)
        own = np.arange(n - len(self.names), n)
        by_variance = np.zeros((len(estimated), len(std)))
        by_variance[np.arange(len(estimated)), estimated] = 2.0 * std[estimated]
        acting = [
            q
            for q, index in enumerate(layout.order)
            if not layout.system.parameters.items[index].name.startswith("bias_")
        ]
        for r, (problem, line, filter) in enumerate(
            zip(layout.problems, lines, filters_of(weighted), strict=True)
        ):
            if self.quick:
                setting = set(self.noise_positions(layout, theta).tolist())
                acting = [q for q in acting if int(layout.columns(r)[q]) in setting]
            at = Variation(layout.split(theta, r)[0], scale)
            pairs = slope_pairs(
                at,
                [layout.order[q] for q in acting],
                (problem.increment[acting] / DIFFERENCE_STEP_SHARE).tolist(),
                self.scaled,
            )
            slopes = noise_slopes(problem, line.states, at, pairs)
            mine = layout.columns(r)
            moving = np.array(
                [
                    *(mine[acting[i]] if i < len(acting) else n - 1 for i in slopes.of),
                    *own[: len(estimated)],
                ],
                dtype=int,
            )
            if moving.size:
                yield (
                    moving,
                    likelihood_slopes(filter.whitener, filter.residual, slopes, by_variance),
                )
            else:
                nodes = len(problem.grid.nodes)
                yield moving, LikelihoodSlopes(np.zeros(0), np.zeros((0, 0)), np.zeros((nodes, 0)))

    def step_bounds(self, layout: LaidOut, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of one step, in which a noise level changes at most by a factor: far from
        the optimum the likelihood is not quadratic in it.
        """
        low, high = np.concatenate([layout.low, self.low]), np.concatenate([layout.high, self.high])
        for i in self.noise_positions(layout, theta):
            if theta[i] > 0:
                low[i], high[i] = (
                    max(low[i], theta[i] / _LARGEST_NOISE_STEP_FACTOR),
                    min(high[i], theta[i] * _LARGEST_NOISE_STEP_FACTOR),
                )
        return low, high

    def noise_positions(self, layout: LaidOut, theta: np.ndarray) -> np.ndarray:
        """Return the positions of the unknowns of the noise: the model's own, and parameters of the
        System that change the density of process noise.
        """
        n = len(theta)
        positions = set(range(n - len(self.names), n))
        for r in range(len(layout.problems)):
            p, _ = layout.split(theta, r)
            density = _density(layout.system, p)
            setting = [
                q
                for q, index in enumerate(layout.order)
                if np.any(_density(layout.system, _slightly_changed(p, index)) != density)
            ]
            positions |= set(layout.columns(r)[setting].tolist())
        return np.array(sorted(positions), dtype=int)

    def _innovations(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None:
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
            own = Filtered(
                columns.innovation[:, :, 0], columns.standard[:, :, 0], columns.state[:, :, 0]
            )
            filters.append(Filter(problem, record_whitener, own))
            standard = _at_samples(problem, columns.standard)
            whitened.append(standard[:, :, 0])
            jacobians.append(standard[:, :, 1:])
            cost += 0.5 * (record_whitener.log_determinant + float(np.sum(own.standard**2)))
        if not (np.isfinite(cost) and all(np.all(np.isfinite(jacobian)) for jacobian in jacobians)):
            return None
        return WeightedResiduals(
            tuple(whitened), tuple(jacobians), np.ones(len(std)), cost, tuple(filters)
        )


def filters_of(weighted: WeightedResiduals) -> tuple[Filter, ...]:
    """Return the Kalman filters, one a record, of residuals that a ProcessNoise weighted."""
    filters = tuple(item for item in weighted.filters if isinstance(item, Filter))
    assert len(filters) == len(weighted.filters)
    return filters


def _density(system: System, p: np.ndarray) -> np.ndarray:
    return np.array(system.noise(p.tolist())[0], dtype=float)


def _slightly_changed(p: np.ndarray, index: int) -> np.ndarray:
    moved = p.copy()
    moved[index] *= 1.01
    return moved


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
    """Return the noise model of a System: the levels of the outputs in ``present`` start at ``std``
    and are estimated, unless ``fixed``.

    Process noise declared on states then gets an unknown scale as well.
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
    """Return the noise model of a fit, started at its unknowns in ``theta (n,)``."""
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    std, scale = noise_model.levels(theta)
    return replace(noise_model, std=np.maximum(std, 1e-300), scale=scale)


def _at_nodes(problem: RecordProblem, values: np.ndarray) -> np.ndarray:
    """Return ``(m, N, c)`` at the samples as ``(K + 1, m, c)`` at the nodes, zero between
    samples.
    """
    nodes, at = len(problem.grid.nodes), problem.grid.sample // problem.grid.substeps
    turned = np.ascontiguousarray(values.transpose(1, 0, 2))
    if nodes == len(at):
        return turned
    out = np.zeros((nodes, *turned.shape[1:]), dtype=turned.dtype)
    out[at] = turned
    return out


def _at_samples(problem: RecordProblem, values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(
        values[problem.grid.sample // problem.grid.substeps].transpose(1, 0, 2)
    )


# ---- Restricted likelihood (REML)

_NOISE_DIFFERENCE_SHARE = 0.02  # relative step of a noise level for differences
_LARGEST_LOG_CHANGE = 0.7  # largest change of a level's logarithm


@dataclass(frozen=True, eq=False)
class Levels:
    """All unknowns ``theta (n,)`` with adjusted noise levels, and the ``factor (n,)`` of the
    adjustment.

    ``spread (n,)`` : variance of the logarithm of each unknown's variance due to uncertain noise
    levels; zero for the levels.
    """

    theta: np.ndarray
    factor: np.ndarray
    spread: np.ndarray


def restricted_levels(fit: Fit, covariance: np.ndarray) -> Levels:
    """Return the adjusted noise levels, from the fit's ``covariance (n, n)``. A level at its bound
    is kept; sigmas of the levels scale with them.
    """
    noise_model, theta, low, high = fit.noise_model, fit.theta, fit.problem.low, fit.problem.high
    assert isinstance(noise_model, ProcessNoise)
    setting = noise_model.noise_positions(fit.layout, theta)
    inside = (theta[setting] > low[setting]) & (theta[setting] < high[setting])
    moved, others = setting[inside], np.setdiff1d(np.arange(len(theta)), setting)
    base, variance = _information_of(fit, theta, others)
    slope, moves = np.zeros(len(moved)), np.zeros((len(moved), len(others)))
    for i, position in enumerate(moved):
        stretched = theta.copy()
        stretched[position] *= 1.0 + _NOISE_DIFFERENCE_SHARE
        determinant, other = _information_of(fit, stretched, others)
        slope[i] = 0.5 * (determinant - base) / (_NOISE_DIFFERENCE_SHARE * theta[position])
        moves[i] = np.log(other / variance) / (_NOISE_DIFFERENCE_SHARE * theta[position])
    among = covariance[np.ix_(moved, moved)]
    change = np.clip(-among @ slope / theta[moved], -_LARGEST_LOG_CHANGE, _LARGEST_LOG_CHANGE)
    factor, spread = np.ones(len(theta)), np.zeros(len(theta))
    if np.all(np.isfinite(change)):
        factor[moved] = np.exp(change)
    if np.all(np.isfinite(moves)):
        spread[others] = np.maximum(np.einsum("ij,ik,kj->j", moves, among, moves), 0.0)
    adjusted = np.clip(theta * factor, low, high)
    factor[moved] = adjusted[moved] / theta[moved]
    return Levels(adjusted, factor, spread)


def _information_of(fit: Fit, theta: np.ndarray, positions: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the log determinant of the information on the unknowns at ``positions``, with the
    noise of ``theta``, and the diagonal of its inverse.

    Computed about the fitted trajectories; NaN where the likelihood is not finite.
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
        at = layout.columns(r)
        J = jacobian.reshape(-1, len(at))
        information[np.ix_(at, at)] += J.T @ J
    part = information[np.ix_(positions, positions)]
    seen = np.flatnonzero(np.diag(part) > 0)
    size = np.sqrt(np.diag(part)[seen])
    determinant = float(
        np.linalg.slogdet(part[np.ix_(seen, seen)] / np.outer(size, size))[1]
        + 2.0 * np.log(size).sum()
    )
    return determinant, np.diag(inverse_information(part)[0])
