"""Layout of a whole-record fit: which unknowns there are, and which record sees which."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ident.whole_record.first_guess import known_states
from ident.whole_record.record_problem import RecordProblem, record_problem
from ident.whole_record.trajectory_guess import guess_states
from sim.declaration.effect import Parameter
from sim.declaration.model import System
from sim.errors import ModelError
from sim.record import Record

ROUNDING = 1e-11  # relative size of what a whole-record computation does not resolve


@dataclass(frozen=True)
class FitSettings:
    """How a whole-record fit runs.

    Attributes
    ----------
    max_step : longest integration sub-step, s.
    iterations : limit of accepted and rejected steps together.
    tolerance : the fit has settled when a step moves no parameter by more than this share of its sigma.
    use_priors : add the Gaussian priors of parameters and initial states to the cost.
    coloured : correct the covariance for residuals that are not white.
    enough : the fit also ends when a step lowers the cost by less than this: for comparing models it need not be lower.
    quick : leave out how derivatives move the gains of a filter with process noise: for comparing models, its optimum hardly moves.
    exact : derivatives by complex steps; ten times dearer than differences, which are good to a millionth.
    least_damping : of a step where noise levels are unknowns: less is of no use there and would have to be undone after a step too far. Only
        a motion that grows needs less: what its records know best they know by e^15 better than the rest.
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
    """Gaussian knowledge of some unknowns: ``mean (k,)`` and ``information (k, k)`` at ``positions`` of theta."""

    positions: np.ndarray
    mean: np.ndarray
    information: np.ndarray


@dataclass(frozen=True, eq=False)
class FitLayout:
    """The unknowns of a fit: shared parameters, then for each record its local parameters and initial states.

    Attributes
    ----------
    problems : the records laid out. shared, local : names of parameters. starts : positions of free initial states.
    start, low, high : of all unknowns, ``(n,)``. order : positions of shared and local among the System's parameters.
    prior : None where no unknown has one. used : ``(m,)`` outputs with at least one sample.
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
        """Unknowns that each record has for itself."""
        return len(self.local) + len(self.starts)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns; those of one record carry its number from 1 where there are several records."""
        mine = [*self.local, *(f"{self.system.state_names[i]}(0)" for i in self.starts)]
        many = len(self.problems) > 1
        each = (f"{name}, record {r + 1}" if many else name for r in range(len(self.problems)) for name in mine)
        return (*self.shared, *each)

    def columns(self, r: int) -> np.ndarray:
        """Positions in theta of the unknowns that record ``r`` sees."""
        shared, own = len(self.shared), self.own
        if not r:
            return np.arange(shared + own)
        return np.concatenate([np.arange(shared), shared + r * own + np.arange(own)])

    def split(self, theta: np.ndarray, r: int) -> tuple[np.ndarray, np.ndarray]:
        """All parameters and the initial state of record ``r``."""
        mine = theta[self.columns(r)]
        p, x0 = self.system.parameters.values(), self.system.initial.values()
        p[list(self.order)] = mine[: len(self.order)]
        x0[list(self.starts)] = mine[len(self.order) :]
        return p, x0

    def guesses(self, theta: np.ndarray) -> list[np.ndarray]:
        """Trajectory guesses from the measured channels, one a record."""
        return [guess_states(problem, *self.split(theta, r)) for r, problem in enumerate(self.problems)]


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
            raise ModelError(f"it has none of the outputs {', '.join(system.output_names)}", where=record.name, remedy="name or map its columns")
    recorded = {name for record in records for name in record.output_names}
    free = [n for n in parameters.free_names if not (n.startswith("bias_") and n.removeprefix("bias_") not in recorded)]
    apart = {name for name in free if name.startswith("bias_") or name in local}
    shared, own = tuple(n for n in free if n not in apart), tuple(n for n in free if n in apart)
    starts = tuple(i for i, item in enumerate(initial) if item.free)
    if not free and not starts:
        raise ModelError("no parameter is free", where=f"model with {', '.join(parameters.names)}", remedy="release at least one")
    order = tuple(parameters.index(name) for name in (*shared, *own))
    problems = tuple(
        record_problem(record, system, settings.max_step, order, starts, valid=None if masks is None else masks[r], exact=settings.exact)
        for r, record in enumerate(records)
    )
    mine = [parameters[name] for name in own] + [initial.items[i] for i in starts]
    items = [parameters[name] for name in shared] + mine * len(records)
    low, high = np.array([item.bounds[0] for item in items]), np.array([item.bounds[1] for item in items])
    first = np.array([item.value for item in items], dtype=float)
    if start is None and not settings.use_priors:
        _seed_initial_states(first, records, system, starts, len(shared), len(own))
    first = np.clip(first if start is None else start, low, high)
    size = np.array([max(np.max(np.abs(problem.z[i]), initial=0.0) for problem in problems) for i in range(len(system.outputs))])
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
        np.array([any(np.any(problem.valid[i]) for problem in problems) for i in range(len(system.outputs))]),
        np.maximum(ROUNDING * size, 1e-30) ** 2,
    )


def _declared_prior(items: Sequence[Parameter]) -> Prior | None:
    known = [i for i, item in enumerate(items) if math.isfinite(item.prior_std)]
    if not known:
        return None
    information = np.diag([items[i].prior_std ** -2 for i in known])
    return Prior(np.array(known), np.array([items[i].value for i in known]), information)


def _seed_initial_states(theta: np.ndarray, records: Sequence[Record], system: System, starts: Sequence[int], shared: int, local: int) -> None:
    for r, record in enumerate(records):
        known = known_states(record, system)
        for c, i in enumerate(starts):
            if i in known:
                theta[shared + r * (local + len(starts)) + local + c] = known[i][1][0]
