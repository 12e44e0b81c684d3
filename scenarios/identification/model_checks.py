"""Checks of a user's model without a record, and the effect of uncertain constants on sigmas.

Mass, inertias, density and airspeed are held in a fit, and errors in them move the estimates. With
s_i the change of the estimates for one standard deviation of constant i, and independent
constants, the covariance is P + sum_i s_i s_i' ("consider" parameters [1]_). The change is half the
difference of two estimates with the same method and records, one sigma of the constant apart on
either side; it holds what is not linear in that distance, and every method has it.

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

# ---- An example of a motion

DOUBLET_ANGLE = 0.05  # rad, doublet of an angle; at most one unit for other inputs
# largest change of a state by a pulse, share of its initial value
PULSE_STATE_SHARE = 0.02
PULSE_LENGTH_FACTOR = 1.5  # over a root's size: half the doublet's length
PULSES_BETWEEN_DOUBLETS = 8.0  # pulses from one doublet to the next
STEPS_PER_PULSE = 20.0  # steps in a pulse, and within the quickest root's time
MOST_STEPS = 4000
RUNAWAY_GROWTH = 1e6  # growth beyond which a motion has run away
LARGEST_SLOPE = 1e20  # limit of sensitivities


@dataclass(frozen=True, eq=False)
class Motion:
    """``pulse`` s, half the length of each doublet; ``amplitudes`` of the inputs; ``end`` s.

    ``names`` of the unknowns: free parameters, states at the start, biases of outputs. ``slopes``:
    of each output ``(N, unknowns)``; ``sizes``: its largest value less its first. ``ran_away``: the
    motion was cut short where it left all measure.
    """

    pulse: float
    amplitudes: dict[str, float]
    end: float
    names: tuple[str, ...]
    slopes: tuple[np.ndarray, ...]
    sizes: tuple[float, ...]
    ran_away: bool


def doublet_motion(model: Model) -> Motion:
    """Return the motion from the model's initial state, doublets as long as its roots ask for."""
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
        along = [
            (t - (1.0 + PULSES_BETWEEN_DOUBLETS * i) * pulse) / pulse for i in range(len(rest))
        ]
        return [
            each + size * ((0.0 <= at < 1.0) - (1.0 <= at < 2.0))
            for each, size, at in zip(rest, amplitudes.values(), along, strict=True)
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
            # The root of a negative number is imaginary as no slope is.
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
    """Doublets that move no state far from where it starts, by input."""
    x, p = system.initial.values(), system.parameters.values().tolist()
    gains = (
        np.abs(complex_step_jacobian(lambda u: system.f(0.0, x.tolist(), u, p), rest))
        if rest
        else np.zeros((len(x), 0))
    )
    out = {}
    for i, signal in enumerate(system.inputs):
        limits = [
            PULSE_STATE_SHARE * abs(value) / (gain * pulse)
            for value, gain in zip(x, gains[:, i], strict=True)
            if value and gain > 0.0
        ]
        out[signal.name] = min([DOUBLET_ANGLE if signal.unit == "rad" else 1.0, *limits])
    return out


def _stepped(value: float, column: int, count: int) -> np.ndarray:
    row = np.full(count, complex(value))
    row[column] += 1j * COMPLEX_STEP
    return row


# ---- Checks of a model file without a record

SHAPE = (3, 5)
# distance of points at which functions are compared, share of a value
TRIAL_OFFSET = 0.01
DIFFERENCE_STEP_SHARE = 1e-6  # step of central differences over the value or ``TRIAL_OFFSET``
NOISE_SHARE = 0.01  # assumed noise over an output's largest value
# Eigenvalue of the scaled information over the largest one, below which a direction is unknown.
UNDETERMINED_EIGENVALUE_SHARE = 1e-10
LEAST_DIRECTION_SHARE = 1e-3  # component of a parameter in such a direction


@dataclass(frozen=True)
class Excited:
    """Expected sigma of a parameter, infinite without effect on outputs.

    ``beside``: parameters that cannot be distinguished from it.
    """

    name: str
    value: float
    sigma: float
    beside: tuple[str, ...] = ()


def unknown_units(model: Model) -> list[str]:
    """Return ``"NAME (UNIT)"`` of signals and parameters with an unknown unit."""
    e = model.equations
    named = [
        (each.name, each.unit)
        for each in (*e.states, *e.inputs, *e.outputs, *e.ports, *model.parameters)
    ]
    return [f"{name} ({unit})" for name, unit in dict.fromkeys(named) if not is_unit(unit)]


def one_by_one(model: Model) -> float:
    """Return the largest relative difference between a call with arrays of ``SHAPE`` and calls with
    single numbers, over all rates and readings.
    """
    system = compile_model(model)
    points = _points(model, system, int(np.prod(SHAPE)))
    together = _answers(system, [row.reshape(SHAPE) for row in points])
    worst = 0.0
    for k in range(points.shape[1]):
        alone = np.array(_answers(system, points[:, k].tolist()), dtype=float)
        there = np.array([np.broadcast_to(row, SHAPE).reshape(-1)[k] for row in together])
        worst = max(worst, _apart(alone, there))
    return worst


def steps_against_differences(model: Model) -> float:
    """Return the largest difference between complex steps and central differences over all rates
    and readings, relative to the largest slope of each.
    """
    system = compile_model(model)
    point = _points(model, system, 2)[:, 1].tolist()
    exact = complex_step_jacobian(lambda at: _answers(system, at), point)
    found = np.zeros_like(exact)
    for k, value in enumerate(point):
        step = DIFFERENCE_STEP_SHARE * (abs(value) or TRIAL_OFFSET)
        above, below = (
            np.array(
                _answers(system, [*point[:k], value + sign * step, *point[k + 1 :]]), dtype=float
            )
            for sign in (1.0, -1.0)
        )
        found[:, k] = (above - below) / (2.0 * step)
    sizes = np.abs(np.array(point)) + TRIAL_OFFSET
    return _apart((exact * sizes).T, (found * sizes).T)


def excited(model: Model) -> tuple[Motion, list[Excited]]:
    """Return the response to a doublet on each input, and Cramer-Rao bounds of the parameters.

    Initial states and biases are unknown, too. White noise of ``NOISE_SHARE`` of each output; an
    output that does not move is not used.
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
    dark = values < UNDETERMINED_EIGENVALUE_SHARE * values[-1]
    variance = np.sum(vectors[:, ~dark] ** 2 / values[~dark], axis=1)
    untold = vectors[:, dark] ** 2 > LEAST_DIRECTION_SHARE
    out = []
    for i, name in enumerate(names):
        value, place = model.parameters[name].value, np.flatnonzero(seen == i)
        if place.size == 0:
            out.append(Excited(name, value, np.inf))
            continue
        mine = untold[place[0]]
        beside = [
            motion.names[seen[j]]
            for j in np.flatnonzero(np.any(untold[:, mine], axis=1))
            if seen[j] != i
        ]
        sigma = np.inf if np.any(mine) else float(np.sqrt(variance[place[0]])) / float(lengths[i])
        out.append(Excited(name, value, sigma, tuple(beside)))
    return motion, out


def _points(model: Model, system: System, count: int) -> np.ndarray:
    """States, inputs and parameters at ``count`` points about the starts, ``(n, count)``."""
    start = np.concatenate(
        [system.initial.values(), inputs_at_rest(model), system.parameters.values()]
    )
    sides = np.sin(np.outer(1.0 + np.arange(len(start)), 1.0 + np.arange(count)))
    return np.asarray(
        start[:, None] + TRIAL_OFFSET * sides * np.where(start == 0.0, 1.0, np.abs(start))[:, None]
    )


def _answers(system: System, point: Sequence[Any]) -> list[Any]:
    n, m = len(system.states), len(system.inputs)
    x, u, p = point[:n], point[n : n + m], point[n + m :]
    return [*system.f(0.0, x, u, p), *system.h(0.0, x, u, p)]


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest difference relative to the largest number of each column."""
    sizes = np.maximum(
        np.max(np.abs(np.atleast_2d(one)), axis=0), np.max(np.abs(np.atleast_2d(other)), axis=0)
    )
    return float(
        np.max(
            np.max(np.abs(np.atleast_2d(one - other)), axis=0) / np.where(sizes > 0.0, sizes, 1.0),
            initial=0.0,
        )
    )


CAPTION = "Standard deviations with the uncertainty of constants"
DATA = "data"
_SETTLED = (Outcome.CONVERGED, Outcome.AT_BOUND)


@dataclass(frozen=True, eq=False)
class Considered:
    """Contributions to the standard deviations of estimates.

    Attributes
    ----------
    names, units : of the ``n`` parameters.
    constants : the ``k`` constants whose uncertainty counts, with ``sigmas`` in their units.
    data : ``(n,)`` standard deviations from the data alone, constants taken as exact.
    moved : ``(k, n)`` change of each estimate for one standard deviation of each constant, signed.
    failed : constants for which a fit did not converge; not included.
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
        """Standard deviations with the constants' share, ``(n,)``."""
        return np.sqrt(self.data**2 + np.sum(self.moved**2, axis=0))

    @property
    def shares(self) -> np.ndarray:
        """Shares of the variance, ``(k + 1, n)``, the data's first; each column sums to one."""
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
    """Return an estimate with the uncertainty of constants in its covariance, and what contributes.

    Parameters
    ----------
    model : as it was fitted, with its constants.
    sigmas : standard deviation of each uncertain constant, in the constant's unit.
    estimate : the model's, from the data alone.
    estimated : the same estimation of another model.

    Returns
    -------
    The estimate with the larger covariance, and the contributions; without ``sigmas``, or where the
    estimate has not settled, the same estimate and None.

    Raises
    ------
    What ``estimated`` raises.
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
        change = 0.5 * (ends[0].values - ends[1].values) if _alike(estimate, ends) else None
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


def _alike(estimate: Estimate, ends: list[Estimate]) -> bool:
    return all(each.names == estimate.names and each.outcome in _SETTLED for each in ends)


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
    """Sigmas from the data and in all, and shares of the variance, for some parameters."""
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
