"""What the sensors of an own model tell: which biases a record knows from where its states begin, and which output reads a state.

An angle that nothing but its own gyro feels is known to a constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.declaration.arguments import Signals
from sim.declaration.own_equations import OwnEquations
from sim.declaration.own_trial import Starts, beside
from sim.errors import ModelError
from sim.maths.elementary import complex_step_jacobian

ALIKE = 2.0  # times: a sensor that reads a state moves with it, by a scale factor at most
RANK = 1e-9  # of the largest singular value, below which a direction is not seen: slopes are exact to rounding


def biases_told(equations: OwnEquations, starts: Starts) -> tuple[str, ...]:
    """Outputs that can have a free bias beside free initial states, taken in order.

    A bias is no unknown of its own where some constant change of the states makes it: with the rates' slopes A and the readings' C a state x0
    for which A x0 = 0 and C x0 is that bias. Slopes are those beside the starts; a bias that is told on one side counts as told.
    """
    told = [_told(*_slopes(equations, beside(starts, side))) for side in (1.0, -1.0)]
    return tuple(signal.name for i, signal in enumerate(equations.outputs) if any(i in some for some in told))


def refuse_misnamed(equations: OwnEquations, starts: Starts) -> None:
    """Raise ModelError for an output that has the name of a state, with which a fit begins, and reads something else."""
    states = [signal.name for signal in equations.states]
    both = [(i, states.index(signal.name)) for i, signal in enumerate(equations.outputs) if signal.name in states]
    slopes = [_slopes(equations, beside(starts, side))[1] for side in (1.0, -1.0)] if both else []
    for i, j in both:
        output, state = equations.outputs[i], equations.states[j]
        where = f"model {equations.name}, outputs, {output.name}"
        if output.unit != state.unit:
            remedy = "give it the state's unit (a record's columns are converted), or another name"
            raise ModelError(f"the unit is {output.unit}, that of the state of this name {state.unit}", where=where, remedy=remedy)
        if not any(1.0 / ALIKE < C[i, j] < ALIKE or not np.isfinite(C[i, j]) for C in slopes):
            told = f"it has the name of a state and reads something else (it moves {slopes[0][i, j]:.3g} times as far)"
            raise ModelError(told, where=where, remedy="give it another name, or read the state as it is")


def _slopes(equations: OwnEquations, at: Starts) -> tuple[np.ndarray, np.ndarray]:
    """A ``(n, n)`` and C ``(m, n)`` at a point."""
    names, p = [signal.name for signal in equations.states], Signals(**at.parameters)

    def answers(x: Sequence[Any]) -> list[Any]:
        s = Signals(**{**at.signals, **dict(zip(names, x, strict=True))})
        s.__dict__.update(equations.flow(s, p))
        return [*equations.derivatives(s, p), *equations.measurements(s, p)]

    both = complex_step_jacobian(answers, [at.signals[name] for name in names])
    return both[: len(names)], both[len(names) :]


def _told(A: np.ndarray, C: np.ndarray) -> list[int]:
    """Positions of the outputs whose bias adds to what is seen; all where the slopes are not finite."""
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(C))):
        return list(range(len(C)))
    sizes = np.max(np.abs(C), axis=1, keepdims=True)
    C = C / np.where(sizes > 0.0, sizes, 1.0)
    kept: list[int] = []
    for i in range(len(C)):
        if _seen(A, C, [*kept, i]) > _seen(A, C, kept):
            kept.append(i)
    return kept


def _seen(A: np.ndarray, C: np.ndarray, biases: Sequence[int]) -> int:
    """Rank of the observability matrix with the states and these biases as unknowns; time is scaled, which changes no rank."""
    n, k = len(A), len(biases)
    rate = np.linalg.norm(A, 2)
    step = np.zeros((n + k, n + k))
    step[:n, :n] = A / rate if rate > 0.0 else A
    row = np.hstack([C, np.eye(len(C))[:, biases]])
    rows = [row]
    for _ in range(n + k - 1):
        rows.append(rows[-1] @ step)
    return int(np.linalg.matrix_rank(np.vstack(rows), rtol=RANK))
