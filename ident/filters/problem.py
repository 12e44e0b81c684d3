"""What every filter needs before its first sample: data, grid, drive, start and its covariance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.declaration.effect import ParameterSet
from sim.declaration.model import System
from sim.errors import ModelError
from sim.propagation import Drive, Grid, drive_from_record, make_grid
from sim.record import Record

QUARTER = 0.25


@dataclass(frozen=True, eq=False)
class FilterProblem:
    """A record and a System brought together; states first, then free parameters (``n`` in all).

    ``z`` and ``valid`` are ``(m, N)``; ``start`` is ``(n,)``, ``covariance`` ``(n, n)``; ``density`` ``(n,)`` the spectral
    density of each entry; ``variance`` ``(m,)`` of the measurement noise; ``p`` all parameters; ``free`` their
    positions among ``p``.
    """

    system: System
    grid: Grid
    drive: Drive
    time: np.ndarray
    z: np.ndarray
    valid: np.ndarray
    p: list[float]
    free: list[int]
    names: tuple[str, ...]
    start: np.ndarray
    covariance: np.ndarray
    density: np.ndarray
    variance: np.ndarray

    @property
    def walking(self) -> bool:
        """Whether a free parameter is a random walk."""
        return bool(np.any(self.density[len(self.system.states) :]))


def filter_problem(record: Record, system: System, max_step: float) -> FilterProblem:
    """Check that a filter can run and lay out what it needs.

    Raises
    ------
    ModelError : no free parameter has data (no output in common), an unknown noise level, a free parameter or
        state without a prior standard deviation, an effect that cannot run on line.
    """
    present = [name for name in system.output_names if name in record.output_names]
    if not present:
        raise ModelError(
            f"it has none of the outputs {', '.join(system.output_names)}", where=record.name, remedy="name the columns, or map them with --channels"
        )
    if system.sensor_stages:
        raise ModelError(
            f"effect {system.sensor_stages[0]} keeps a memory on the sensor path",
            where="filter",
            remedy="compile the model with online=True, or use a whole-record fit (output-error)",
        )
    z, valid = record.output_array(system.output_names)
    p = system.parameters.values().tolist()
    density_of_states, variance = system.noise(p)
    variance = [v if name in present else 1.0 for v, name in zip(variance, system.output_names, strict=True)]
    for name, value in zip(system.output_names, variance, strict=True):
        if not (math.isfinite(value) and value > 0):
            raise ModelError("its measurement noise is not declared", where=f"output {name}", remedy="give its standard deviation")
    free_names = system.parameters.free_names
    std: list[float] = [prior_std(system, name, state=True) for name in system.state_names] + [
        prior_std(system, name, state=False) for name in free_names
    ]
    random_walk = [system.declared_noise.process_density.get(name, 0.0) for name in free_names]
    grid = make_grid(record.time, max_step if math.isfinite(max_step) else float(np.diff(record.time).max()))
    return FilterProblem(
        system,
        grid,
        drive_from_record(system, p, record.input_array(system.input_names), record.time, record.hold, grid),
        record.time,
        z,
        valid,
        p,
        [system.parameters.index(name) for name in free_names],
        (*system.state_names, *free_names),
        np.concatenate([system.initial.values(), system.parameters.values(free_names)]),
        np.diag(np.square(std)),
        np.array([*density_of_states, *random_walk], dtype=float),
        np.array(variance, dtype=float),
    )


def with_free(p: Sequence[float], free: Sequence[int], values: Sequence[object]) -> list:
    """All parameters with the free ones replaced, for calling a System."""
    out: list = list(p)
    for index, value in zip(free, values, strict=True):
        out[index] = value
    return out


def prior_std(system: System, name: str, *, state: bool) -> float:
    """Prior standard deviation of a state or a free parameter, zero for a state that is held; ModelError where none is declared."""
    item = system.initial[name] if state else system.parameters[name]
    if state and not item.free:
        return 0.0
    if not math.isfinite(item.prior_std):
        kind = "initial state" if state else "parameter"
        raise ModelError(f"{kind} without a prior standard deviation", where=name, remedy="a filter needs one; give it, or use output-error")
    return item.prior_std


def proportional_priors(parameters: ParameterSet, engineering: Mapping[str, float], share: float = QUARTER) -> ParameterSet:
    """Free parameters with a prior standard deviation of ``share`` times the starting value, or the engineering value given.

    The rule of NASA TM-101722: P0 = (x0/4)^2, and for states that start at or near zero a bound by engineering judgement.

    Parameters
    ----------
    engineering : standard deviations by name; it overrides the share, and may name what is not free.

    Raises
    ------
    ModelError : a free parameter that starts at zero without an engineering value.
    """
    priors = {}
    for item in parameters:
        if not item.free:
            continue
        priors[item.name] = engineering.get(item.name, share * abs(item.value))
        if not priors[item.name] > 0:
            raise ModelError("it starts at zero, and has no share", where=f"parameter {item.name}", remedy="give its standard deviation")
    return parameters.with_prior(priors)
