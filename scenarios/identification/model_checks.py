"""Checks of a user's model without a record, and the effect of uncertain constants on sigmas.

Mass, inertias, density and airspeed are fixed in a fit, and errors in them shift the estimates. Let
s_i be the change of the estimates for one standard deviation of constant i. For independent
constants the covariance is P + sum_i s_i s_i' ("consider" parameters [1]_). The change is half the
difference of two estimates with the same method and records, one with the constant a standard
deviation above its value and one below. It is available for every method, and includes what is
nonlinear over that distance.

References
----------
.. [1] B. D. Tapley, B. E. Schutz and G. H. Born, Statistical Orbit Determination, Elsevier, 2004,
   chapter 6.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.estimate import Estimate, Outcome
from scenarios.files.units import is_unit
from scenarios.files.user_models import inputs_at_rest
from scenarios.preparation.declared_model import root_sizes
from scenarios.report.document import BY_ROW, Cell, Column, Table, formatted, table
from scenarios.report.quantities import shown_in
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, System
from sim.maths import COMPLEX_STEP, complex_step_jacobian
from sim.propagation import rk4_step

# ---- A motion with a doublet on each input

DOUBLET_ANGLE = 0.05  # rad, largest doublet of an angle; other inputs move by one unit at most
# Largest change of a state by a pulse, as a share of its initial value.
PULSE_STATE_SHARE = 0.02
PULSE_LENGTH_FACTOR = 1.5  # length of a pulse (half a doublet) times the mean root of the model
PULSES_BETWEEN_DOUBLETS = 8.0  # from the start of one doublet to that of the next
STEPS_PER_PULSE = 20.0  # integration steps in a pulse for the fastest root
MOST_STEPS = 4000
RUNAWAY_GROWTH = 1e6  # a motion that grows by a larger factor is cut off
LARGEST_SLOPE = 1e20  # a motion with larger sensitivities is cut off


@dataclass(frozen=True, eq=False)
class Motion:
    """Response of a model to a doublet on each input.

    Attributes
    ----------
    pulse : half the length of a doublet, s.
    amplitudes : size of the doublet by input.
    end : duration, s.
    names : the unknowns, which are free parameters, initial states and biases of outputs.
    slopes : sensitivities of each output, shape ``(N, unknowns)``.
    sizes : largest change of each output from its first value.
    ran_away : whether the motion was cut off because it grew too large.
    """

    pulse: float
    amplitudes: dict[str, float]
    end: float
    names: tuple[str, ...]
    slopes: tuple[np.ndarray, ...]
    sizes: tuple[float, ...]
    ran_away: bool


def doublet_motion(model: Model) -> Motion:
    """Return the motion from the initial state of a model, with pulses that suit its roots."""
    system = compile_model(model)
    rest = inputs_at_rest(model)
    sizes = root_sizes(system, rest)
    pulse = PULSE_LENGTH_FACTOR / float(np.exp(np.mean(np.log(sizes)))) if len(sizes) else 1.0
    step = (
        min(pulse, PULSE_LENGTH_FACTOR / float(np.max(sizes)) if len(sizes) else pulse)
        / STEPS_PER_PULSE
    )
    end = PULSES_BETWEEN_DOUBLETS * pulse * max(1, len(system.inputs)) + 2.0 * pulse
    count = min(int(np.ceil(end / step)), MOST_STEPS)
    amplitudes = _amplitudes(system, rest, pulse)

    def inputs(t: float) -> list[float]:
        # Time since the doublet of each input began, in pulses.
        since = [
            (t - (1.0 + PULSES_BETWEEN_DOUBLETS * i) * pulse) / pulse for i in range(len(rest))
        ]
        return [
            level + size * ((0.0 <= at < 1.0) - (1.0 <= at < 2.0))
            for level, size, at in zip(rest, amplitudes.values(), since, strict=True)
        ]

    free = [model.parameters.index(name) for name in model.parameters.free_names]
    unknown = len(free) + len(system.states)
    p: list[complex | np.ndarray] = [complex(value) for value in model.parameters.values()]
    for column, i in enumerate(free):
        p[i] = _stepped(model.parameters.items[i].value, column, unknown)
    x = np.array(
        [_stepped(value, len(free) + i, unknown) for i, value in enumerate(system.initial.values())]
    )
    outputs, largest = [], RUNAWAY_GROWTH * max(1.0, float(np.max(np.abs(x))))
    with np.errstate(all="ignore"):
        for k in range(count):
            t = k * step
            u = inputs(t + 0.5 * step)
            read = np.array(
                [np.broadcast_to(row, (unknown,)) for row in system.h(t, list(x), u, p)]
            )
            # The square root of a negative number has an imaginary part that is no sensitivity.
            if not (
                np.all(np.isfinite(read))
                and np.max(np.abs(x.real)) < largest
                and np.max(np.abs(x.imag)) < LARGEST_SLOPE * COMPLEX_STEP
            ):
                break
            outputs.append(read)
            x = np.array(rk4_step(system.f, t, list(x), (u, u, u), p, step))
    along = np.array(outputs).reshape(-1, len(system.outputs), unknown)
    slopes, values = along.imag / COMPLEX_STEP, along.real[:, :, 0]
    biased = [
        i
        for i, signal in enumerate(system.outputs)
        if signal.name in getattr(model.equations, "biased_outputs", ())
    ]
    constant = np.eye(len(system.outputs))[:, biased]
    names = (
        *model.parameters.free_names,
        *(f"{name} at the start" for name in system.state_names),
        *(f"bias of {system.output_names[i]}" for i in biased),
    )
    wide = tuple(
        np.hstack([slopes[:, i], np.tile(constant[i], (len(along), 1))])
        for i in range(len(system.outputs))
    )
    moves = tuple(
        float(np.max(np.abs(values[:, i] - values[0, i]), initial=0.0)) if len(values) else 0.0
        for i in range(len(system.outputs))
    )
    return Motion(pulse, amplitudes, step * len(along), names, wide, moves, len(along) < count)


def _amplitudes(system: System, rest: list[float], pulse: float) -> dict[str, float]:
    """Return the size of the doublet of each input, so small that no state moves far."""
    x, p = system.initial.values(), system.parameters.values().tolist()
    gains = (
        np.abs(complex_step_jacobian(lambda u: system.f(0.0, x.tolist(), u, p), rest))
        if rest
        else np.zeros((len(x), 0))
    )
    sizes = {}
    for i, signal in enumerate(system.inputs):
        limits = [
            PULSE_STATE_SHARE * abs(value) / (gain * pulse)
            for value, gain in zip(x, gains[:, i], strict=True)
            if value and gain > 0.0
        ]
        sizes[signal.name] = min([DOUBLET_ANGLE if signal.unit == "rad" else 1.0, *limits])
    return sizes


def _stepped(value: float, column: int, count: int) -> np.ndarray:
    """Return a value ``count`` times, with a complex step in one column."""
    row = np.full(count, complex(value))
    row[column] += 1j * COMPLEX_STEP
    return row


# ---- Checks of a model file without a record

SHAPE = (3, 5)  # shape of the arrays with which the equations are tried
# Distance of the points at which functions are compared, as a share of a value.
TRIAL_OFFSET = 0.01
DIFFERENCE_STEP_SHARE = 1e-6  # step of central differences over the value or ``TRIAL_OFFSET``
NOISE_SHARE = 0.01  # assumed noise over the largest change of an output
# A direction with a smaller eigenvalue of the scaled information, as a share of the largest one, is
# undetermined.
UNDETERMINED_EIGENVALUE_SHARE = 1e-10
# A parameter with a larger squared component in such a direction is undetermined.
LEAST_DIRECTION_SHARE = 1e-3


@dataclass(frozen=True)
class Excited:
    """What a motion determines of a parameter.

    Attributes
    ----------
    name, value : the parameter and its start.
    sigma : expected standard deviation; infinite if the motion does not determine the parameter.
    beside : unknowns that the motion cannot distinguish from it.
    """

    name: str
    value: float
    sigma: float
    beside: tuple[str, ...] = ()


def unknown_units(model: Model) -> list[str]:
    """Return ``"NAME (UNIT)"`` of signals and parameters with an unknown unit."""
    e = model.equations
    named = [
        (item.name, item.unit)
        for item in (*e.states, *e.inputs, *e.outputs, *e.ports, *model.parameters)
    ]
    return [f"{name} ({unit})" for name, unit in dict.fromkeys(named) if not is_unit(unit)]


def one_by_one(model: Model) -> float:
    """Return how much a call of the equations with arrays differs from calls with single numbers.

    It is the largest relative difference over all rates and outputs.
    """
    system = compile_model(model)
    points = _points(model, system, int(np.prod(SHAPE)))
    together = _answers(system, [row.reshape(SHAPE) for row in points])
    worst = 0.0
    for k in range(points.shape[1]):
        alone = np.array(_answers(system, points[:, k].tolist()), dtype=float)
        in_array = np.array([np.broadcast_to(row, SHAPE).reshape(-1)[k] for row in together])
        worst = max(worst, _relative_difference(alone, in_array))
    return worst


def steps_against_differences(model: Model) -> float:
    """Return how much derivatives by complex steps differ from central differences.

    It is the largest difference over all rates and outputs, relative to the largest derivative of
    each.
    """
    system = compile_model(model)
    point = _points(model, system, 2)[:, 1].tolist()
    exact = complex_step_jacobian(lambda at: _answers(system, at), point)
    differences = np.zeros_like(exact)
    for k, value in enumerate(point):
        step = DIFFERENCE_STEP_SHARE * (abs(value) or TRIAL_OFFSET)
        above, below = (
            np.array(
                _answers(system, [*point[:k], value + sign * step, *point[k + 1 :]]), dtype=float
            )
            for sign in (1.0, -1.0)
        )
        differences[:, k] = (above - below) / (2.0 * step)
    sizes = np.abs(np.array(point)) + TRIAL_OFFSET
    return _relative_difference((exact * sizes).T, (differences * sizes).T)


def excited(model: Model) -> tuple[Motion, list[Excited]]:
    """Return the response to a doublet on each input, and Cramer-Rao bounds of the parameters.

    Initial states and biases are unknown, too. Each output has white noise of ``NOISE_SHARE`` of
    its largest change. An output that does not move is not used.
    """
    motion = doublet_motion(model)
    rows = [
        slopes / (NOISE_SHARE * size)
        for slopes, size in zip(motion.slopes, motion.sizes, strict=True)
        if size > 0.0
    ]
    names = model.parameters.free_names
    if not rows:
        return motion, [Excited(name, model.parameters[name].value, np.inf) for name in names]
    jacobian = np.concatenate(rows)
    lengths = np.linalg.norm(jacobian, axis=0)
    seen = np.flatnonzero(lengths > 0.0)
    scaled = jacobian[:, seen] / lengths[seen]
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    open_directions = values < UNDETERMINED_EIGENVALUE_SHARE * values[-1]
    variance = np.sum(vectors[:, ~open_directions] ** 2 / values[~open_directions], axis=1)
    undetermined = vectors[:, open_directions] ** 2 > LEAST_DIRECTION_SHARE
    parameters = []
    for i, name in enumerate(names):
        value, place = model.parameters[name].value, np.flatnonzero(seen == i)
        if place.size == 0:
            parameters.append(Excited(name, value, np.inf))
            continue
        own_directions = undetermined[place[0]]
        beside = [
            motion.names[seen[j]]
            for j in np.flatnonzero(np.any(undetermined[:, own_directions], axis=1))
            if seen[j] != i
        ]
        sigma = np.inf
        if not np.any(own_directions):
            sigma = float(np.sqrt(variance[place[0]])) / float(lengths[i])
        parameters.append(Excited(name, value, sigma, tuple(beside)))
    return motion, parameters


def _points(model: Model, system: System, count: int) -> np.ndarray:
    """Return states, inputs and parameters at ``count`` points about the starts, ``(n, count)``."""
    start = np.concatenate(
        [system.initial.values(), inputs_at_rest(model), system.parameters.values()]
    )
    sides = np.sin(np.outer(1.0 + np.arange(len(start)), 1.0 + np.arange(count)))
    return np.asarray(
        start[:, None] + TRIAL_OFFSET * sides * np.where(start == 0.0, 1.0, np.abs(start))[:, None]
    )


def _answers(system: System, point: Sequence[Any]) -> list[Any]:
    """Return rates and outputs at a point of states, inputs and parameters."""
    n, m = len(system.states), len(system.inputs)
    x, u, p = point[:n], point[n : n + m], point[n + m :]
    return [*system.f(0.0, x, u, p), *system.h(0.0, x, u, p)]


def _relative_difference(first: np.ndarray, second: np.ndarray) -> float:
    """Return the largest difference relative to the largest number of each column."""
    first, second = np.atleast_2d(first), np.atleast_2d(second)
    sizes = np.maximum(np.max(np.abs(first), axis=0), np.max(np.abs(second), axis=0))
    difference = np.max(np.abs(first - second), axis=0)
    return float(np.max(difference / np.where(sizes > 0.0, sizes, 1.0), initial=0.0))


# ---- Effect of uncertain constants on sigmas

CAPTION = "Standard deviations with the uncertainty of constants"
DATA = "data"
_SETTLED = (Outcome.CONVERGED, Outcome.AT_BOUND)


@dataclass(frozen=True, eq=False)
class Considered:
    """Contributions to the standard deviations of estimates.

    Attributes
    ----------
    names, units : the n parameters and their units.
    constants : the k constants whose uncertainty counts.
    sigmas : standard deviation of each constant, in its unit.
    data : standard deviations from the data alone, with exact constants, shape ``(n,)``.
    moved : change of each estimate for one standard deviation of each constant, with its sign,
        shape ``(k, n)``.
    failed : constants for which a fit did not converge; they are not among ``constants``.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    constants: tuple[str, ...]
    sigmas: tuple[float, ...]
    data: np.ndarray
    moved: np.ndarray
    failed: tuple[str, ...] = ()

    @property
    def total(self) -> np.ndarray:
        """Standard deviations with the share of the constants, ``(n,)``."""
        return np.sqrt(self.data**2 + np.sum(self.moved**2, axis=0))

    @property
    def shares(self) -> np.ndarray:
        """Shares of the variance, ``(k + 1, n)``, that of the data first; a column sums to one."""
        variance = np.vstack([self.data**2, self.moved**2])
        whole = variance.sum(axis=0)
        return variance / np.where(whole > 0.0, whole, 1.0)

    def dominant(self, name: str) -> str:
        """Return the constant with the largest share of a parameter's variance, or ``"data"``."""
        place = int(np.argmax(self.shares[:, self.names.index(name)]))
        return (DATA, *self.constants)[place]


def consider(
    model: Model,
    sigmas: Mapping[str, float],
    estimate: Estimate,
    estimated: Callable[[Model], Estimate],
) -> tuple[Estimate, Considered | None]:
    """Return an estimate with the uncertainty of constants in its covariance, and contributions.

    Parameters
    ----------
    model : the fitted model with its constants.
    sigmas : standard deviation of each uncertain constant, in its unit.
    estimate : estimate from the data, with exact constants.
    estimated : returns the same estimate for a model with other constants. Its errors are passed
        on.

    Returns
    -------
    The estimate with the larger covariance, and the contributions. Without ``sigmas``, or if the
    estimate has not converged, the same estimate and None.
    """
    if not sigmas or estimate.outcome not in _SETTLED:
        return estimate, None
    held = {item.name: item.value for item in model.parameters if not item.free}
    moved, used, failed = [], [], []
    for name, sigma in sigmas.items():
        if name not in held:
            continue
        ends = [
            estimated(model.with_values({name: held[name] + side * sigma})) for side in (1.0, -1.0)
        ]
        change = None
        if _comparable(estimate, ends):
            change = 0.5 * (ends[0].values - ends[1].values)
        if change is None or not np.all(np.isfinite(change)):
            failed.append(name)
            continue
        used.append(name)
        moved.append(change)
    rows = np.array(moved).reshape(len(used), len(estimate.names))
    considered = Considered(
        estimate.names,
        estimate.units,
        tuple(used),
        tuple(sigmas[name] for name in used),
        estimate.std,
        rows,
        tuple(failed),
    )
    return replace(estimate, covariance=estimate.covariance + rows.T @ rows), considered


def _comparable(estimate: Estimate, ends: list[Estimate]) -> bool:
    return all(end.names == estimate.names and end.outcome in _SETTLED for end in ends)


def considered_sentences(considered: Considered | None) -> list[str]:
    """Return the cautions about constants whose uncertainty could not be counted."""
    if considered is None or not considered.failed:
        return []
    names = ", ".join(considered.failed)
    return [
        f"the uncertainty of {names} is not in the sigmas: the fit does not settle one standard "
        "deviation away; state a smaller one, or begin nearer"
    ]


def considered_table(considered: Considered, parameters: tuple[str, ...]) -> Table:
    """Return a table of sigmas from the data and in all, and of shares of the variance."""
    places = [considered.names.index(name) for name in parameters if name in considered.names]
    names = [considered.names[i] for i in places]
    shown = [shown_in(considered.units[i], considered.names[i]) for i in places]
    data, total, shares = considered.data, considered.total, considered.shares
    pairs = list(zip(places, (unit.factor for unit in shown), strict=True))
    return table(
        CAPTION,
        (Column("parameter"), names),
        (Column("sigma, data", BY_ROW), [_sigma(data[i] * factor) for i, factor in pairs]),
        (Column("sigma, all", BY_ROW), [_sigma(total[i] * factor) for i, factor in pairs]),
        *(
            (Column(source, "%"), [formatted(100.0 * shares[k, i], ".0f") for i in places])
            for k, source in enumerate((DATA, *considered.constants))
        ),
        (Column("dominant"), [considered.dominant(name) for name in names]),
        units=[unit.unit for unit in shown],
    )


def _sigma(value: float) -> Cell:
    return formatted(float(value), ".2g")


def considered_content(considered: Considered | None) -> dict[str, Any]:
    """Return the contributions for comparison.json; empty if no constant is uncertain."""
    if considered is None:
        return {}
    return {
        "uncertain_constants": {
            "sigmas": dict(zip(considered.constants, considered.sigmas, strict=True)),
            "parameters": {
                name: {
                    "std_data": float(considered.data[i]),
                    "std": float(considered.total[i]),
                    "moved": {
                        constant: float(considered.moved[k, i])
                        for k, constant in enumerate(considered.constants)
                    },
                    "dominant": considered.dominant(name),
                }
                for i, name in enumerate(considered.names)
            },
            **({"not_counted": list(considered.failed)} if considered.failed else {}),
        }
    }
