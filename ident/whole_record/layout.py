"""Unknowns of a whole-record fit laid out over its records, and the noise model.

A NoiseModel whitens residuals and sensitivities. Its own unknowns, if any, follow those of the
layout in theta. `ident.process_noise.innovations_model` has the model with a Kalman filter.
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
    """How a whole-record fit runs.

    Attributes
    ----------
    max_step : longest integration sub-step, s.
    iterations : limit of accepted and rejected steps together.
    tolerance : the fit has converged when a step moves no parameter by more than this share of its
        sigma.
    use_priors : add the Gaussian priors of parameters and initial states to the cost.
    coloured : correct the covariance for residuals that are not white.
    enough : the fit also ends when a step lowers the cost by less than this: for comparing models
        it need not be lower.
    quick : leave out how derivatives move the gains of a filter with process noise: for comparing
        models, its optimum hardly moves.
    exact : derivatives by complex steps; ten times dearer than differences, which are good to a
        millionth.
    least_damping : of a step where noise levels are unknowns: less is of no use there and would
        have to be undone after a step too far. Only a motion that grows needs less: what its
        records know best they know by e^15 better than the rest.
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
    """Gaussian prior of some unknowns: ``mean (k,)`` and ``information (k, k)`` at ``positions`` of
    theta.
    """

    positions: np.ndarray
    mean: np.ndarray
    information: np.ndarray


@dataclass(frozen=True, eq=False)
class FitLayout:
    """The unknowns of a fit: shared parameters, then for each record its local parameters and
    initial states.

    Attributes
    ----------
    problems : the records laid out.
    shared, local : names of parameters.
    starts : positions of free initial states.
    start, low, high : of all unknowns, ``(n,)``.
    order : positions of shared and local among the System's parameters.
    prior : None where no unknown has one.
    used : ``(m,)`` outputs with at least one sample.
    smallest : ``(m,)`` variance below which an output is exact to rounding.
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
        """Unknowns of each record alone."""
        return len(self.local) + len(self.starts)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns; with several records, local ones end with the record's number from
        1.
        """
        mine = [*self.local, *(f"{self.system.state_names[i]}(0)" for i in self.starts)]
        many = len(self.problems) > 1
        each = (
            f"{name}, record {r + 1}" if many else name
            for r in range(len(self.problems))
            for name in mine
        )
        return (*self.shared, *each)

    def columns(self, r: int) -> np.ndarray:
        """Return the positions in theta of the unknowns of record ``r``."""
        shared, own = len(self.shared), self.own
        if not r:
            return np.arange(shared + own)
        return np.concatenate([np.arange(shared), shared + r * own + np.arange(own)])

    def split(self, theta: np.ndarray, r: int) -> tuple[np.ndarray, np.ndarray]:
        """Return all parameters and the initial state of record ``r``."""
        mine = theta[self.columns(r)]
        p, x0 = self.system.parameters.values(), self.system.initial.values()
        p[list(self.order)] = mine[: len(self.order)]
        x0[list(self.starts)] = mine[len(self.order) :]
        return p, x0

    def guesses(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return starting trajectories from the measured channels, one a record."""
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
    masks : ``(m, N)`` a record, False where a sample is set aside; None uses all that are valid.
    start : ``(n,)`` all unknowns; from the System and the first samples when None.

    Raises
    ------
    ModelError : a record without any of the outputs, or nothing to estimate.
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
        n
        for n in parameters.free_names
        if not (n.startswith("bias_") and n.removeprefix("bias_") not in recorded)
    ]
    apart = {name for name in free if name.startswith("bias_") or name in local}
    shared, own = tuple(n for n in free if n not in apart), tuple(n for n in free if n in apart)
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
    mine = [parameters[name] for name in own] + [initial.items[i] for i in starts]
    items = [parameters[name] for name in shared] + mine * len(records)
    low = np.array([item.bounds[0] for item in items])
    high = np.array([item.bounds[1] for item in items])
    first = np.array([item.value for item in items], dtype=float)
    if start is None and not settings.use_priors:
        _seed_initial_states(first, records, system, starts, len(shared), len(own))
    first = np.clip(first if start is None else start, low, high)
    size = np.array(
        [
            max(np.max(np.abs(problem.z[i]), initial=0.0) for problem in problems)
            for i in range(len(system.outputs))
        ]
    )
    return FitLayout(
        system,
        settings,
        problems,
        shared,
        own,
        starts,
        order,
        first,
        low,
        high,
        _declared_prior(items) if settings.use_priors else None,
        np.array(
            [
                any(np.any(problem.valid[i]) for problem in problems)
                for i in range(len(system.outputs))
            ]
        ),
        np.maximum(ROUNDING_SHARE * size, 1e-30) ** 2,
    )


def _declared_prior(items: Sequence[Parameter]) -> Prior | None:
    known = [i for i, item in enumerate(items) if math.isfinite(item.prior_std)]
    if not known:
        return None
    information = np.diag([items[i].prior_std ** -2 for i in known])
    return Prior(np.array(known), np.array([items[i].value for i in known]), information)


# Gauss-Newton iterations, and the largest step in units of states
_ITERATIONS, _LARGEST_STEP = 30, 0.3


def _seed_initial_states(
    theta: np.ndarray,
    records: Sequence[Record],
    system: System,
    starts: Sequence[int],
    shared: int,
    local: int,
) -> None:
    asked = [i for i in starts if system.initial.items[i].source == FROM_OUTPUTS]
    for r, record in enumerate(records):
        known = known_states(record, system)
        found = {i: float(values[0]) for i, (_, values) in known.items()}
        if asked:
            found |= _states_from_outputs(record, system, found, asked)
        for c, i in enumerate(starts):
            if i in found:
                theta[shared + r * (local + len(starts)) + local + c] = found[i]


def _states_from_outputs(
    record: Record, system: System, known: Mapping[int, float], asked: Sequence[int]
) -> dict[int, float]:
    """Return the states at the first sample whose outputs are nearest to the recorded ones
    (Gauss-Newton); angles within half a turn.

    Parameters
    ----------
    known : by position, states that are measured.
    asked : positions of those to find.
    """
    x0, p = system.initial.values(), system.parameters.values().tolist()
    for i, value in known.items():
        x0[i] = value
    names = [n for n in system.output_names if n in record.output_names and record[n].valid[0]]
    rows = [system.output_names.index(name) for name in names]
    measured = np.array([record[name].values[0] for name in names])
    angle = np.array([system.outputs[i].unit == "rad" for i in rows])
    u = [float(record[name].values[0]) for name in system.input_names]

    def read(part: Sequence[Any]) -> list[Any]:
        x: list[Any] = x0.tolist()
        for i, value in zip(asked, part, strict=True):
            x[i] = value
        outputs = system.h(float(record.time[0]), x, u, p)
        return [outputs[i] for i in rows]

    best = x0[list(asked)]
    for _ in range(_ITERATIONS):
        slopes = complex_step_jacobian(read, best.tolist())
        left = measured - np.array(read(best.tolist()))
        left = np.where(angle, (left + np.pi) % (2.0 * np.pi) - np.pi, left)
        move = np.linalg.lstsq(slopes, left, rcond=1e-9)[0]
        best = best + move * min(1.0, _LARGEST_STEP / max(float(np.max(np.abs(move))), 1e-300))
    if not np.all(np.isfinite(best)):
        return {}
    return dict(zip(asked, best.tolist(), strict=True))


# ---- Information of a record on the parameters, to first order

MAX_STEP = 0.01  # longest sub-step, s: that of the whole-record fits


def weighted_sensitivities(
    record: Record, system: System, noise_std: np.ndarray
) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of the free parameters and the slopes ``(M, n)`` of all measured samples by
    them, over the noise standard deviation ``(m,)``.

    At the parameters of ``system``, by complex steps. Biases and initial states are nuisance
    parameters and projected out, with the priors that the system declares of them. The information
    of the record is ``S' S``; singular values of ``S`` show directions without influence to
    rounding; those of ``S' S`` lose half the digits.

    Raises
    ------
    ModelError : the simulation leaves all measure.
    """
    layout = lay_out([record], system, FitSettings(max_step=MAX_STEP, use_priors=True, exact=True))
    problem, n = layout.problems[0], len(layout.shared)
    p, x0 = layout.split(layout.start, 0)
    line = linearise(problem, p, x0, layout.guesses(layout.start)[0])
    line = linearise(problem, p, x0, line.states)
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
    known = np.array(
        [1.0 / item.prior_std if np.isfinite(item.prior_std) else 0.0 for item in items]
    )
    nuisance = np.vstack([slopes[:, n:], np.diag(known)])
    shared = np.vstack([slopes[:, :n], np.zeros((len(items), n))])
    basis = np.linalg.qr(nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300))[0]
    return layout.shared, shared - basis @ (basis.T @ shared)


# ---- Noise models


class LaidOut(Protocol):
    """The part of a layout that a noise model reads; implemented by
    `ident.whole_record.layout.FitLayout`.
    """

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
        """Return the columns ``(m, N, c)`` in the outputs' units whitened to unit variance, zero
        where a sample is missing.
        """
        ...


@dataclass(frozen=True, eq=False)
class WeightedResiduals:
    """Whitened residuals and sensitivities of each record.

    Attributes
    ----------
    residuals, jacobians : ``(m, N)`` and ``(m, N, c)`` a record; residuals are zero where a sample
        is missing.
    variance : ``(m,)`` of the residuals.
    cost : minus the log likelihood, without 0.5 (1 + ln 2 pi) a sample.
    filters : one a record, for further columns.
    """

    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    variance: np.ndarray
    cost: float
    filters: tuple[ResidualFilter, ...]


class NoiseModel(Protocol):
    """Model of the random part of the data.

    ``names``, ``start``, ``low``, ``high`` describe its own unknowns. ``weight_residuals`` returns
    None where its likelihood is not finite. ``covariance_terms`` are gradient ``(n,)`` and expected
    information ``(n, n)`` of the log likelihood through the dependence of the residuals' covariance
    on the unknowns; None where there is none. ``step_bounds`` are the lowest and highest values of
    all unknowns, ``(n,)`` each, after one step from ``theta``.
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
    """Division by each output's standard deviation: ``valid (m, N)``, ``variance (m,)``."""

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
        """None: no unknown changes the covariance of the residuals."""
        return None

    def step_bounds(self, layout: LaidOut, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The bounds of the layout."""
        return layout.low, layout.high


@dataclass(frozen=True)
class White(WithoutUnknowns):
    """Independent Gaussian noise on each output, its variance concentrated out: the mean square of
    the residual.
    """

    def weight_residuals(
        self,
        layout: LaidOut,
        theta: np.ndarray,
        lines: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None:
        """Return the residuals and sensitivities unchanged."""
        squares = np.sum([(residual**2).sum(axis=1) for residual in residuals], axis=0)
        found = squares / np.maximum(counts, 1)
        variance = np.where(layout.used, np.maximum(found, layout.smallest), 1.0)
        # A variance at its lower bound is constant: the cost then needs the squared residuals.
        held = np.where(found < layout.smallest, squares / variance - counts, 0.0)
        cost = 0.5 * float(np.sum(np.where(layout.used, counts * np.log(variance) + held, 0.0)))
        filters = tuple(Standardised(problem.valid, variance) for problem in layout.problems)
        return WeightedResiduals(
            tuple(residuals), tuple(line.jacobian for line in lines), variance, cost, filters
        )


WHITE = White()


# ---- Problem of a whole-record fit


@dataclass(frozen=True, eq=False)
class FitProblem:
    """A layout and a noise model; the noise model's unknowns follow those of the layout in
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
        """Starting values of the fit, ``(n,)``."""
        return np.concatenate([self.layout.start, self.noise_model.start])

    @property
    def low(self) -> np.ndarray:
        """Lowest values, ``(n,)``."""
        return np.concatenate([self.layout.low, self.noise_model.low])

    @property
    def high(self) -> np.ndarray:
        """Highest values, ``(n,)``."""
        return np.concatenate([self.layout.high, self.noise_model.high])
