"""Which biases of sensors a record can tell from where its states begin: an angle that nothing but its own gyro feels is known to a constant."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from sim.declaration.own_equations import OwnEquations
from sim.declaration.own_trial import Starts, beside
from sim.maths.elementary import complex_step_jacobian

RANK = 1e-9  # of the largest singular value, below which a direction is not seen: slopes are exact to rounding


def biases_told(equations: OwnEquations, starts: Starts) -> tuple[str, ...]:
    """Outputs that can have a free bias beside free initial states, taken in order.

    A bias is no unknown of its own where some constant change of the states makes it: with the rates' slopes A and the readings' C a state x0
    for which A x0 = 0 and C x0 is that bias. Slopes are those beside the starts; a bias that is told on one side counts as told.
    """
    told = [_told(*_slopes(equations, beside(starts, side))) for side in (1.0, -1.0)]
    return tuple(signal.name for i, signal in enumerate(equations.outputs) if any(i in some for some in told))


def _slopes(equations: OwnEquations, at: Starts) -> tuple[np.ndarray, np.ndarray]:
    """A ``(n, n)`` and C ``(m, n)`` at a point."""
    names, p = [signal.name for signal in equations.states], SimpleNamespace(**at.parameters)

    def answers(x: Sequence[Any]) -> list[Any]:
        s = SimpleNamespace(**{**at.signals, **dict(zip(names, x, strict=True))})
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
