"""Natural frequency and damping of an estimated model's slowest oscillation, with bounds by linearisation."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ident.estimate import Estimate
from sim.declaration.system import System
from sim.maths.elementary import complex_step_jacobian


def slowest_oscillation(system: System, p: np.ndarray, held: Collection[str] = ()) -> tuple[float, float] | None:
    """Undamped natural frequency (rad/s) and damping ratio of the slowest complex pair at rest; None if all roots are real.

    For a short-period model this is the short period, also when elastic modes are present. ``held``: names of states that do not move,
    those of motion slower than what is asked for (a phugoid: its speed and attitude).
    """
    n, u = len(system.states), [0.0] * len(system.inputs)
    F = complex_step_jacobian(lambda x: system.f(0.0, x, u, p.tolist()), [0.0] * n)
    moving = [i for i, state in enumerate(system.states) if state.name not in held]
    roots = [root for root in np.linalg.eigvals(F[np.ix_(moving, moving)]) if root.imag > 1e-9]
    if not roots:
        return None
    slowest = min(roots, key=abs)
    return float(abs(slowest)), float(-slowest.real / abs(slowest))


def modal_estimate(system: System, estimate: Estimate, held: Collection[str] = ()) -> dict[str, tuple[float, float]]:
    """``natural_frequency`` and ``damping_ratio`` with standard deviations; empty where the model does not oscillate.

    Standard deviations by linearisation in the estimated parameters, as TM-101722 does for its figure 8. ``held`` as there.
    """
    p = system.parameters.values()
    index = [system.parameters.index(name) for name in estimate.names]
    p[index] = estimate.values
    centre = slowest_oscillation(system, p, held)
    if centre is None:
        return {}
    gradient = np.zeros((2, len(index)))
    for column, (i, sigma) in enumerate(zip(index, estimate.std, strict=True)):
        step = max(1e-4 * sigma, 1e-9 * abs(p[i]), 1e-300)
        pair = []
        for sign in (1.0, -1.0):
            moved = p.copy()
            moved[i] += sign * step
            pair.append(slowest_oscillation(system, moved, held))
        if pair[0] is None or pair[1] is None:
            return {}
        gradient[:, column] = (np.array(pair[0]) - np.array(pair[1])) / (2.0 * step)
    std = np.sqrt(np.maximum(np.diag(gradient @ estimate.covariance @ gradient.T), 0.0))
    return {"natural_frequency": (centre[0], float(std[0])), "damping_ratio": (centre[1], float(std[1]))}
