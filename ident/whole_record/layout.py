"""Layout of the unknowns of a whole-record fit, and the problem of a fit.

The vector of all unknowns is theta: the unknowns of the layout, then those of the noise model.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.whole_record.linearise import (
    guess_states,
    known_states,
    linearise,
)
from ident.whole_record.noise_model import WHITE, NoiseModel
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
    enough : the fit also ends when a step lowers the cost by less than this. It is above zero for a
        comparison of models, which needs no lower cost.
    quick : neglect, in a fit with process noise, that parameters other than those of the noise
        change the gains of the filter. This hardly moves the optimum and serves comparisons of
        models.
    exact : differentiate by complex steps. They take a few times as long as forward differences,
        whose relative error is about a millionth.
    least_damping : smallest damping where noise levels are unknowns. With less damping, steps are
        too long and must be repeated. Only an unstable motion needs less: its best-determined
        direction is known e^15 times better than the others.
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
    mean : ``(k,)`` prior means.
    information : ``(k, k)`` inverse of the prior covariance.
    """

    positions: np.ndarray
    mean: np.ndarray
    information: np.ndarray


@dataclass(frozen=True, eq=False)
class FitLayout:
    """The unknowns of a fit: the shared parameters, then the local parameters and free initial
    states of each record in turn.

    Attributes
    ----------
    system : the model.
    settings : settings of the fit.
    problems : one for each record.
    shared : names of the parameters with one value for all records.
    local : names of the parameters with one value for each record.
    free_initial : positions of the free initial states among the states.
    order : positions of the shared, then of the local parameters among all parameters of the
        System.
    start : ``(n,)`` starting values of all unknowns.
    low, high : ``(n,)`` bounds of all unknowns.
    prior : prior of some unknowns; None where no unknown has one.
    used : ``(m,)`` True for an output with at least one valid sample.
    smallest : ``(m,)`` residual variance of each output at the rounding error of the computation;
        an output with a smaller one is fitted exactly.
    """

    system: System
    settings: FitSettings
    problems: tuple[RecordProblem, ...]
    shared: tuple[str, ...]
    local: tuple[str, ...]
    free_initial: tuple[int, ...]
    order: tuple[int, ...]
    start: np.ndarray
    low: np.ndarray
    high: np.ndarray
    prior: Prior | None
    used: np.ndarray
    smallest: np.ndarray

    @property
    def unknowns_per_record(self) -> int:
        """Number of unknowns that belong to one record: its local parameters and initial states."""
        return len(self.local) + len(self.free_initial)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns. With several records, the name of a local unknown ends with the
        number of its record, counted from 1.
        """
        local_names = [
            *self.local,
            *(f"{self.system.state_names[i]}(0)" for i in self.free_initial),
        ]
        if len(self.problems) == 1:
            return (*self.shared, *local_names)
        numbers = range(1, len(self.problems) + 1)
        return (*self.shared, *(f"{name}, record {k}" for k in numbers for name in local_names))

    def columns(self, r: int) -> np.ndarray:
        """Return the positions in theta of the shared unknowns and of those of record ``r``."""
        shared, local = len(self.shared), self.unknowns_per_record
        if not r:
            return np.arange(shared + local)
        return np.concatenate([np.arange(shared), shared + r * local + np.arange(local)])

    def split(self, theta: np.ndarray, r: int) -> tuple[np.ndarray, np.ndarray]:
        """Return all parameters ``(np,)`` and the initial state ``(nx,)`` of record ``r``; those
        that are not free have their declared values.
        """
        unknowns = theta[self.columns(r)]
        p, x0 = self.system.parameters.values(), self.system.initial.values()
        p[list(self.order)] = unknowns[: len(self.order)]
        x0[list(self.free_initial)] = unknowns[len(self.order) :]
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
    """Return the layout of a fit of one or several records.

    Parameters
    ----------
    local : names of further parameters, in addition to ``bias_*``, of which each record has its own
        value.
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
                f"the record has none of the outputs {', '.join(system.output_names)}",
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
    of_record = tuple(name for name in free if name not in shared)
    free_initial = tuple(i for i, item in enumerate(initial) if item.free)
    if not free and not free_initial:
        raise ModelError(
            "no parameter is free",
            where=f"model with {', '.join(parameters.names)}",
            remedy="release at least one",
        )
    order = tuple(parameters.index(name) for name in (*shared, *of_record))
    problems = tuple(
        record_problem(
            record,
            system,
            settings.max_step,
            order,
            free_initial,
            valid=None if masks is None else masks[r],
            exact=settings.exact,
        )
        for r, record in enumerate(records)
    )
    record_items = [parameters[name] for name in of_record] + [
        initial.items[i] for i in free_initial
    ]
    items = [parameters[name] for name in shared] + record_items * len(records)
    low = np.array([item.bounds[0] for item in items])
    high = np.array([item.bounds[1] for item in items])
    if start is None:
        start = np.array([item.value for item in items], dtype=float)
        if not settings.use_priors:
            _seed_initial_states(start, records, system, free_initial, len(shared), len(of_record))
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
        of_record,
        free_initial,
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
    free_initial: Sequence[int],
    shared: int,
    local: int,
) -> None:
    """Set those initial states in ``theta`` that follow from the first samples of the records.

    ``shared`` and ``local`` are the numbers of shared parameters and of local parameters of one
    record.
    """
    from_outputs = [i for i in free_initial if system.initial.items[i].source == FROM_OUTPUTS]
    for r, record in enumerate(records):
        measured = known_states(record, system)
        first = {i: float(values[0]) for i, (_, values) in measured.items()}
        if from_outputs:
            first |= _states_from_outputs(record, system, first, from_outputs)
        for c, i in enumerate(free_initial):
            if i in first:
                theta[shared + r * (local + len(free_initial)) + local + c] = first[i]


def _states_from_outputs(
    record: Record, system: System, known: Mapping[int, float], wanted: Sequence[int]
) -> dict[int, float]:
    """Return position -> value of the ``wanted`` states at the first sample, with which the outputs
    are nearest to the recorded ones; empty where the steps diverge.

    The states are found by Gauss-Newton. Differences of angles are taken within half a turn.

    Parameters
    ----------
    known : position of a measured state -> its value.
    wanted : positions of the states to estimate.
    """
    x0, p = system.initial.values(), system.parameters.values().tolist()
    for i, value in known.items():
        x0[i] = value
    names = [
        name
        for name in system.output_names
        if name in record.output_names and record[name].valid[0]
    ]
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
    """Return the names of the n free parameters, and the sensitivities ``S (M, n)`` of all M valid
    samples to them, each over the noise standard deviation of its output.

    The sensitivities are taken at the parameters of ``system``, by complex steps. Biases and
    initial states are nuisance parameters: they are projected out, with their declared priors. The
    information matrix of the record is ``S' S``. A direction without influence is better seen in
    the singular values of ``S`` than in those of ``S' S``, which lose half the digits.

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
    linearisation = linearise(problem, p, x0, layout.guesses(layout.start)[0])
    linearisation = linearise(
        problem, p, x0, linearisation.states
    )  # about the corrected trajectory
    if not np.all(np.isfinite(linearisation.jacobian)):
        raise ModelError(
            "the simulation diverges",
            where=record.name,
            remedy="give starting values with which the simulation stays finite",
        )
    slopes = (linearisation.jacobian / np.asarray(noise_std)[:, None, None])[problem.valid]
    items = [system.parameters[name] for name in layout.local] + [
        system.initial.items[i] for i in layout.free_initial
    ]
    prior_slopes = np.diag(
        [1.0 / item.prior_std if np.isfinite(item.prior_std) else 0.0 for item in items]
    )
    nuisance = np.vstack([slopes[:, n:], prior_slopes])
    shared = np.vstack([slopes[:, :n], np.zeros((len(items), n))])
    basis = np.linalg.qr(nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300))[0]
    return layout.shared, shared - basis @ (basis.T @ shared)


# ---- Problem of a whole-record fit


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Problem of a fit: a layout and a noise model. The unknowns of the noise model follow those of
    the layout in theta.
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
