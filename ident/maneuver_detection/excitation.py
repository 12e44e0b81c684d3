"""How well a maneuver determines each derivative: t values of an equation-error regression on the maneuver alone.

The acceleration of an axis is regressed on a constant and the regressors of its moment (Klein and Morelli, Aircraft System
Identification, 2nd ed., chapter 5),

    q_dot = c + M_alpha alpha + M_q q + M_de elevator,

and each derivative gets the absolute value of its estimate over its standard deviation. The t value does not depend on the units
of the regressors, and equals that of the non-dimensional derivative. Residuals that are correlated in time carry less information:
with rho the correlation of neighbours, the variance is multiplied by (1 + rho) / (1 - rho).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.maneuver_detection.signals import Stretch

# Axis -> what is differentiated, and derivative -> its regressor; a regressor that is not recorded is left out.
EQUATIONS: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "pitch": ("q", {"Cm_alpha": "alpha", "Cm_q": "q", "Cm_de": "elevator", "M_delta": "stick", "M_lon": "pitch_command"}),
    "roll": (
        "p",
        {"Cl_beta": "beta", "Cl_p": "p", "Cl_r": "r", "Cl_da": "aileron", "Cl_dr": "rudder", "L_lat": "roll_command"},
    ),
    "yaw": (
        "r",
        {"Cn_beta": "beta", "Cn_p": "p", "Cn_r": "r", "Cn_da": "aileron", "Cn_dr": "rudder", "N_ped": "yaw_command"},
    ),
    "throttle": ("airspeed", {"X_V": "airspeed", "X_thrust": "thrust"}),
}
BEFORE, AFTER = (
    1.0,
    4.0,
)  # s of motion around the input that are used: the response goes on when the input is over
AVERAGED = 0.1  # s, over which samples are averaged; a twentieth of a shorter maneuver
FEWEST = 3.0  # averages a parameter
CORRELATED = 0.95  # largest correlation of neighbours that is corrected for
LARGEST = 1000.0  # of a t value: noise-free records have no other limit


def excitation_of(stretch: Stretch, start: float, end: float, axis: str) -> dict[str, float]:
    """Derivative -> absolute t value from the rows about a maneuver; empty where what is needed is not recorded.

    Parameters
    ----------
    start, end : s, of the maneuver. axis : one of the keys of ``EQUATIONS``.
    """
    output, regressors = EQUATIONS[axis]
    rows = stretch.rows(start - BEFORE, end + AFTER)
    signals = {**stretch.inputs, **stretch.outputs}
    if output not in signals:
        return {}
    block = max(1, round(min(AVERAGED, (end - start + BEFORE + AFTER) / 60.0) / stretch.step))
    averaged = {name: _averaged(signals[channel][rows], block) for name, channel in regressors.items() if channel in signals}
    averaged = {name: values for name, values in averaged.items() if values.size and np.ptp(values) > 0.0}
    measured = _averaged(signals[output][rows], block)
    if measured.size < FEWEST * (len(averaged) + 1) or not averaged:
        return {}
    acceleration = np.gradient(measured, block * stretch.step)
    centred = np.column_stack([values - values.mean() for values in averaged.values()])
    scaled = centred / np.sqrt(np.sum(centred**2, axis=0))
    wanted = acceleration - acceleration.mean()
    estimate, _, rank, _ = np.linalg.lstsq(scaled, wanted, rcond=1e-10)
    if rank < scaled.shape[1]:
        return {}
    residual = wanted - scaled @ estimate
    power = float(residual @ residual)
    rho = float(np.clip(residual[1:] @ residual[:-1] / power, 0.0, CORRELATED)) if power > 0.0 else 0.0
    variance = power / (measured.size - len(averaged) - 1) * (1.0 + rho) / (1.0 - rho)
    sigma = np.sqrt(np.maximum(variance * np.diag(np.linalg.inv(scaled.T @ scaled)), 0.0))
    t = np.minimum(np.abs(estimate), LARGEST * sigma) / np.where(sigma > 0.0, sigma, 1.0)
    return {name: float(value) if s > 0.0 else LARGEST for name, value, s in zip(averaged, t, sigma, strict=True)}


def _averaged(values: np.ndarray, block: int) -> np.ndarray:
    """Means of successive blocks of samples."""
    count = values.size // block
    return values[: count * block].reshape(count, block).mean(axis=1)
