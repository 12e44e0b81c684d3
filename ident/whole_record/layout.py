"""Unknowns of a whole-record fit laid out over its records, and the noise model.

A NoiseModel whitens residuals and sensitivities. It may have unknowns of its own, which follow
those of the layout in theta. `ident.process_noise.innovations_model` is the noise model with a
Kalman filter.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ident.whole_record.linearise import (
    Linearisation,
    guess_states,
    known_states,
    linearise,
)
from ident.whole_record.record_problem import (
    RecordProblem,
    record_problem,
)
from sim.declaration.effect import FROM_OUTPUTS, Parameter
from sim.declaration.model import System
from sim.errors import ModelError
from sim.maths import complex_step_jacobian
from sim.record import Record

# ---- Layout of a whole-record fit: unknowns and their records

ROUNDING_SHARE = 1e-11  # relative rounding error of a whole-record computation


@dataclass(frozen=True)
class FitSettings:
    """Settings of a whole-record fit.

    Attributes
    ----------
    max_step : longest integration sub-step, s.
    iterations : largest number of steps, accepted and rejected ones together.
    tolerance : the fit has converged when a step moves no parameter by more than this share of its
        sigma.
    use_priors : add the Gaussian priors of parameters and initial states to the cost.
    coloured : correct the covariance for residuals that are not white.
    enough : the fit also ends when a step lowers the cost by less than this. A comparison of models
        needs no lower cost.
    quick : neglect that the parameters change the gains of the filter, in a fit with process noise.
        This hardly moves the optimum, and a comparison of models may do so.
    exact : differentiate by complex steps. They take ten times as long as forward differences,
        whose relative error is about a millionth.
    least_damping : smallest damping where noise levels are unknowns. A smaller one makes steps that
        are too long and must be repeated. Only an unstable motion needs a smaller one: its
        best-determined direction is known e^15 times better than the others.
    """

    max_step: float = 0.01
    iterations: int = 60
    tolerance: float = 1e-3
    use_priors: bool = False
    coloured: bool = True
    enough: float = 0.0
    quick: bool = False
    exact: bool = False
    least_damping: float = 1e-4


@dataclass(frozen=True, eq=False)
class Prior:
    """Gaussian prior of k unknowns.

    Attributes
    ----------
    positions : ``(k,)`` positions of these unknowns in theta.
    mean : ``(k,)``.
    information : ``(k, k)`` inverse covariance.
    """

    positions: np.ndarray
    mean: np.ndarray
    information: np.ndarray


@dataclass(frozen=True, eq=False)
class FitLayout:
    """The unknowns of a fit: the shared parameters, then the local parameters and initial states of
    each record in turn.

    Attributes
    ----------
    problems : one for each record.
    shared : names of the parameters with one value for all records.
    local : names of the parameters with one value for each record.
    starts : positions of the free initial states among the states.
    order : positions of the shared, then the local parameters among those of the System.
    start : ``(n,)`` starting values of all unknowns.
    low, high : ``(n,)`` bounds of all unknowns.
    prior : prior of some unknowns; None where no unknown has one.
    used : ``(m,)`` whether an output has at least one valid sample.
    smallest : ``(m,)`` residual variance below which an output is fitted to rounding.
    """

    system: System
    settings: FitSettings
    problems: tuple[RecordProblem, ...]
    shared: tuple[str, ...]
    local: tuple[str, ...]
    starts: tuple[int, ...]
    order: tuple[int, ...]
    start: np.ndarray
    low: np.ndarray
    high: np.ndarray
    prior: Prior | None
    used: np.ndarray
    smallest: np.ndarray

    @property
    def own(self) -> int:
        """Number of unknowns that belong to one record."""
        return len(self.local) + len(self.starts)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns. With several records, the name of a local unknown ends with the
        number of its record, counted from 1.
        """
        local_names = [*self.local, *(f"{self.system.state_names[i]}(0)" for i in self.starts)]
        if len(self.problems) == 1:
            return (*self.shared, *local_names)
        numbers = range(1, len(self.problems) + 1)
        return (*self.shared, *(f"{name}, record {k}" for k in numbers for name in local_names))

    def columns(self, r: int) -> np.ndarray:
        """Return the positions in theta of the shared unknowns and those of record ``r``."""
        shared, own = len(self.shared), self.own
        if not r:
            return np.arange(shared + own)
        return np.concatenate([np.arange(shared), shared + r * own + np.arange(own)])

    def split(self, theta: np.ndarray, r: int) -> tuple[np.ndarray, np.ndarray]:
        """Return all parameters ``(np,)`` and the initial state ``(nx,)`` of record ``r``; what is
        not free has its declared value.
        """
        unknowns = theta[self.columns(r)]
        p, x0 = self.system.parameters.values(), self.system.initial.values()
        p[list(self.order)] = unknowns[: len(self.order)]
        x0[list(self.starts)] = unknowns[len(self.order) :]
        return p, x0

    def guesses(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return a starting trajectory ``(nx, K + 1)`` of each record from measured channels."""
        return [
            guess_states(problem, *self.split(theta, r)) for r, problem in enumerate(self.problems)
        ]


def lay_out(
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    *,
    local: Collection[str] = (),
    masks: Sequence[np.ndarray] | None = None,
    start: np.ndarray | None = None,
) -> FitLayout:
    """Lay out a fit of one or several records.

    Parameters
    ----------
    local : further parameters, besides ``bias_*``, of which each record has its own.
    masks : ``(m, N)`` of each record, False where a sample does not count; None uses all valid
        samples.
    start : ``(n,)`` starting values of all unknowns; None takes them from the System and from the
        first samples.

    Raises
    ------
    ModelError : where a record has none of the outputs, or nothing is free.
    """
    parameters, initial = system.parameters, system.initial
    for record in records:
        if not any(name in record.output_names for name in system.output_names):
            raise ModelError(
                f"it has none of the outputs {', '.join(system.output_names)}",
                where=record.name,
                remedy="name or map its columns",
            )
    recorded = {name for record in records for name in record.output_names}
    free = [
        name
        for name in parameters.free_names
        if not name.startswith("bias_") or name.removeprefix("bias_") in recorded
    ]
    shared = tuple(name for name in free if not name.startswith("bias_") and name not in local)
    own = tuple(name for name in free if name not in shared)
    starts = tuple(i for i, item in enumerate(initial) if item.free)
    if not free and not starts:
        raise ModelError(
            "no parameter is free",
            where=f"model with {', '.join(parameters.names)}",
            remedy="release at least one",
        )
    order = tuple(parameters.index(name) for name in (*shared, *own))
    problems = tuple(
        record_problem(
            record,
            system,
            settings.max_step,
            order,
            starts,
            valid=None if masks is None else masks[r],
            exact=settings.exact,
        )
        for r, record in enumerate(records)
    )
    record_items = [parameters[name] for name in own] + [initial.items[i] for i in starts]
    items = [parameters[name] for name in shared] + record_items * len(records)
    low = np.array([item.bounds[0] for item in items])
    high = np.array([item.bounds[1] for item in items])
    if start is None:
        start = np.array([item.value for item in items], dtype=float)
        if not settings.use_priors:
            _seed_initial_states(start, records, system, starts, len(shared), len(own))
    outputs = range(len(system.outputs))
    size = np.array(
        [max(np.max(np.abs(problem.z[i]), initial=0.0) for problem in problems) for i in outputs]
    )
    used = np.array([any(np.any(problem.valid[i]) for problem in problems) for i in outputs])
    return FitLayout(
        system,
        settings,
        problems,
        shared,
        own,
        starts,
        order,
        np.clip(start, low, high),
        low,
        high,
        _declared_prior(items) if settings.use_priors else None,
        used,
        np.maximum(ROUNDING_SHARE * size, 1e-30) ** 2,
    )


def _declared_prior(items: Sequence[Parameter]) -> Prior | None:
    """Return the declared priors of the unknowns ``items``; None where none has one."""
    positions = [i for i, item in enumerate(items) if math.isfinite(item.prior_std)]
    if not positions:
        return None
    information = np.diag([items[i].prior_std ** -2 for i in positions])
    return Prior(np.array(positions), np.array([items[i].value for i in positions]), information)


_ITERATIONS = 30  # Gauss-Newton steps for initial states
_LARGEST_STEP = 0.3  # largest change of a state in one of them, in the unit of the state


def _seed_initial_states(
    theta: np.ndarray,
    records: Sequence[Record],
    system: System,
    starts: Sequence[int],
    shared: int,
    local: int,
) -> None:
    """Set the initial states in ``theta`` that the first samples of the records show.

    ``shared`` and ``local`` are the numbers of shared parameters and of local ones of a record.
    """
    from_outputs = [i for i in starts if system.initial.items[i].source == FROM_OUTPUTS]
    for r, record in enumerate(records):
        measured = known_states(record, system)
        first = {i: float(values[0]) for i, (_, values) in measured.items()}
        if from_outputs:
            first |= _states_from_outputs(record, system, first, from_outputs)
        for c, i in enumerate(starts):
            if i in first:
                theta[shared + r * (local + len(starts)) + local + c] = first[i]


def _states_from_outputs(
    record: Record, system: System, known: Mapping[int, float], wanted: Sequence[int]
) -> dict[int, float]:
    """Return the states at the first sample whose outputs are nearest to the recorded ones, by
    Gauss-Newton; empty where the steps diverge. Differences of angles count within half a turn.

    Parameters
    ----------
    known : position of a measured state -> its value.
    wanted : positions of the states to estimate.
    """
    x0, p = system.initial.values(), system.parameters.values().tolist()
    for i, value in known.items():
        x0[i] = value
    names = [n for n in system.output_names if n in record.output_names and record[n].valid[0]]
    rows = [system.output_names.index(name) for name in names]
    measured = np.array([record[name].values[0] for name in names])
    angle = np.array([system.outputs[i].unit == "rad" for i in rows])
    u = [float(record[name].values[0]) for name in system.input_names]

    def simulated(values: Sequence[Any]) -> list[Any]:
        x: list[Any] = x0.tolist()
        for i, value in zip(wanted, values, strict=True):
            x[i] = value
        outputs = system.h(float(record.time[0]), x, u, p)
        return [outputs[i] for i in rows]

    states = x0[list(wanted)]
    for _ in range(_ITERATIONS):
        slopes = complex_step_jacobian(simulated, states.tolist())
        residual = measured - np.array(simulated(states.tolist()))
        residual = np.where(angle, (residual + np.pi) % (2.0 * np.pi) - np.pi, residual)
        step = np.linalg.lstsq(slopes, residual, rcond=1e-9)[0]
        states = states + step * min(1.0, _LARGEST_STEP / max(float(np.max(np.abs(step))), 1e-300))
    if not np.all(np.isfinite(states)):
        return {}
    return dict(zip(wanted, states.tolist(), strict=True))


# ---- Information of a record on the parameters, to first order

MAX_STEP = 0.01  # longest integration sub-step, s, as in whole-record fits


def weighted_sensitivities(
    record: Record, system: System, noise_std: np.ndarray
) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of the n free parameters and the sensitivities ``S (M, n)`` of all M valid
    samples to them, each over the noise standard deviation of its output.

    They hold at the parameters of ``system`` and come from complex steps. Biases and initial states
    are nuisance parameters: they are projected out, with their declared priors. The information
    matrix of the record is ``S' S``. A direction without influence is better seen in the singular
    values of ``S`` than in those of ``S' S``, which lose half the digits.

    Parameters
    ----------
    noise_std : ``(m,)`` standard deviation of the noise of each output.

    Raises
    ------
    ModelError : where the simulation diverges.
    """
    layout = lay_out([record], system, FitSettings(max_step=MAX_STEP, use_priors=True, exact=True))
    problem, n = layout.problems[0], len(layout.shared)
    p, x0 = layout.split(layout.start, 0)
    line = linearise(problem, p, x0, layout.guesses(layout.start)[0])
    line = linearise(problem, p, x0, line.states)  # about the corrected trajectory
    if not np.all(np.isfinite(line.jacobian)):
        raise ModelError(
            "the simulation leaves all measure",
            where=record.name,
            remedy="give starting values of a model that stays finite",
        )
    slopes = (line.jacobian / np.asarray(noise_std)[:, None, None])[problem.valid]
    items = [system.parameters[name] for name in layout.local] + [
        system.initial.items[i] for i in layout.starts
    ]
    prior_slopes = np.diag(
        [1.0 / item.prior_std if np.isfinite(item.prior_std) else 0.0 for item in items]
    )
    nuisance = np.vstack([slopes[:, n:], prior_slopes])
    shared = np.vstack([slopes[:, :n], np.zeros((len(items), n))])
    basis = np.linalg.qr(nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300))[0]
    return layout.shared, shared - basis @ (basis.T @ shared)


# ---- Noise models


class LaidOut(Protocol):
    """The attributes of a layout that a noise model reads; `FitLayout` has them."""

    @property
    def system(self) -> System: ...
    @property
    def problems(self) -> tuple[RecordProblem, ...]: ...
    @property
    def order(self) -> tuple[int, ...]: ...
    @property
    def low(self) -> np.ndarray: ...
    @property
    def high(self) -> np.ndarray: ...
    @property
    def used(self) -> np.ndarray: ...
    @property
    def smallest(self) -> np.ndarray: ...
    def columns(self, r: int) -> np.ndarray: ...
    def split(self, theta: np.ndarray, r: int) -> tuple[np.ndarray, np.ndarray]: ...


class ResidualFilter(Protocol):
    """Whitening filter of one record."""

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return ``columns (m, N, c)``, given in the units of the outputs, whitened to unit
        variance; zero where a sample is missing.
        """
        ...


@dataclass(frozen=True, eq=False)
class WeightedResiduals:
    """Whitened residuals and sensitivities of each record.

    Attributes
    ----------
    residuals : ``(m, N)`` of each record, zero where a sample is missing.
    jacobians : ``(m, N, c)`` of each record, derivatives of the fitted outputs.
    variance : ``(m,)`` variance of the residuals.
    cost : minus the log likelihood, without its constant 0.5 (1 + ln 2 pi) for each sample.
    filters : one for each record; they whiten further columns in the same way.
    """

    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    variance: np.ndarray
    cost: float
    filters: tuple[ResidualFilter, ...]


class NoiseModel(Protocol):
    """Model of the random part of the data.

    Attributes
    ----------
    names, start, low, high : names, starting values and bounds of its own unknowns.

    Methods
    -------
    weight_residuals : whitened residuals; None where the likelihood is not finite.
    covariance_terms : gradient ``(n,)`` and expected information ``(n, n)`` that the log likelihood
        has because the unknowns change the covariance of the residuals; None where they do not.
    step_bounds : lowest and highest values of all unknowns, ``(n,)`` each, that one step from
        ``theta`` may reach.
    """

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def start(self) -> np.ndarray: ...
    @property
    def low(self) -> np.ndarray: ...
    @property
    def high(self) -> np.ndarray: ...
    def weight_residuals(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None: ...
    def covariance_terms(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        weighted: WeightedResiduals,
    ) -> tuple[np.ndarray, np.ndarray] | None: ...
    def step_bounds(self, layout: LaidOut, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...


@dataclass(frozen=True, eq=False)
class Standardised:
    """Whitening of one record with white noise: division by the standard deviation of each output.

    Attributes
    ----------
    valid : ``(m, N)`` False where a sample is missing.
    variance : ``(m,)`` noise variance of each output.
    """

    valid: np.ndarray
    variance: np.ndarray

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return the columns over the standard deviation, zero where a sample is missing."""
        weight = np.where(self.valid, 1.0 / np.sqrt(self.variance)[:, None], 0.0)
        return weight[:, :, None] * columns


class WithoutUnknowns:
    """A noise model without unknowns: its variances are known or concentrated out."""

    names: tuple[str, ...] = ()

    @property
    def start(self) -> np.ndarray:
        return np.zeros(0)

    low = high = start

    def covariance_terms(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        weighted: WeightedResiduals,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return None: no unknown changes the covariance of the residuals."""
        return None

    def step_bounds(self, layout: LaidOut, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of the layout: a step may reach them at once."""
        return layout.low, layout.high


@dataclass(frozen=True)
class White(WithoutUnknowns):
    """White Gaussian noise on each output. Its variance is concentrated out: it is the mean square
    of the residual.
    """

    def weight_residuals(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None:
        """Return the residuals and sensitivities unchanged, with the variances and the cost."""
        squares = np.sum([(residual**2).sum(axis=1) for residual in residuals], axis=0)
        mean_square = squares / np.maximum(counts, 1)
        variance = np.where(layout.used, np.maximum(mean_square, layout.smallest), 1.0)
        # A variance at its lower bound does not follow the residuals: the cost needs their squares.
        at_bound = np.where(mean_square < layout.smallest, squares / variance - counts, 0.0)
        terms = np.where(layout.used, counts * np.log(variance) + at_bound, 0.0)
        cost = 0.5 * float(np.sum(terms))
        filters = tuple(Standardised(problem.valid, variance) for problem in layout.problems)
        return WeightedResiduals(
            tuple(residuals), tuple(line.jacobian for line in lines), variance, cost, filters
        )


WHITE = White()


# ---- Problem of a whole-record fit


@dataclass(frozen=True, eq=False)
class FitProblem:
    """A layout and a noise model. The unknowns of the noise model follow those of the layout in
    theta.
    """

    layout: FitLayout
    noise_model: NoiseModel = WHITE

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns."""
        return (*self.layout.names, *self.noise_model.names)

    @property
    def start(self) -> np.ndarray:
        """Starting values of all unknowns, ``(n,)``."""
        return np.concatenate([self.layout.start, self.noise_model.start])

    @property
    def low(self) -> np.ndarray:
        """Lower bounds of all unknowns, ``(n,)``."""
        return np.concatenate([self.layout.low, self.noise_model.low])

    @property
    def high(self) -> np.ndarray:
        """Upper bounds of all unknowns, ``(n,)``."""
        return np.concatenate([self.layout.high, self.noise_model.high])
