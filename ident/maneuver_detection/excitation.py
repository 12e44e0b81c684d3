"""How well a maneuver determines each derivative of its axis.

The acceleration of an axis is regressed on a constant and the regressors of its moment (Klein and
Morelli, Aircraft System Identification, 2nd ed., chapter 5),

    q_dot = c + M_alpha alpha + M_q q + M_de elevator,

and each derivative gets the absolute value of its estimate over its standard deviation. The t value
does not depend on the units of the regressors, and equals that of the non-dimensional derivative.
Residuals that are correlated in time carry less information: with rho the correlation of
neighbours, the variance is multiplied by (1 + rho) / (1 - rho).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.maneuver_detection.signals import EvenSegment

# axis -> signal whose rate is the left-hand side, and derivative -> its regressor
EQUATIONS: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "pitch": ("q", {"Cm_alpha": "alpha", "Cm_q": "q", "Cm_de": "elevator"}),
    "roll": (
        "p",
        {"Cl_beta": "beta", "Cl_p": "p", "Cl_r": "r", "Cl_da": "aileron", "Cl_dr": "rudder"},
    ),
    "yaw": (
        "r",
        {"Cn_beta": "beta", "Cn_p": "p", "Cn_r": "r", "Cn_da": "aileron", "Cn_dr": "rudder"},
    ),
    "throttle": ("airspeed", {"X_V": "airspeed", "X_thrust": "thrust"}),
}
# axis -> control -> derivative -> regressor, for models with dimensional derivatives: low-order
# equivalent system and multirotor
DIMENSIONAL: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "pitch": {
        "stick": {"M_alpha": "alpha", "M_q": "q", "M_delta": "stick"},
        "pitch_command": {"M_q": "q", "M_lon": "pitch_command"},
    },
    "roll": {"roll_command": {"L_p": "p", "L_lat": "roll_command"}},
    "yaw": {"yaw_command": {"N_r": "r", "N_ped": "yaw_command"}},
}
TIME_BEFORE_INPUT = 1.0  # s, time before the input that is used
TIME_AFTER_INPUT = 4.0  # s, time after the input that is used, since the response continues
AVERAGING_TIME = 0.1  # s, longest block over which samples are averaged
FEWEST_AVERAGES_PER_PARAMETER = 3.0  # fewest averages for each unknown, constant included
LARGEST_CORRECTED_CORRELATION = 0.95  # largest correlation of neighbours in the correction
LARGEST_T_VALUE = 1000.0  # limit for records without noise


def excitation_of(stretch: EvenSegment, start: float, end: float, axis: str) -> dict[str, float]:
    """Return derivative -> absolute t value from a maneuver of an axis of ``EQUATIONS`` between the
    times ``start`` and ``end``, s; empty if the necessary signals are not recorded.
    """
    output, regressors = EQUATIONS[axis]
    rows = stretch.rows(start - TIME_BEFORE_INPUT, end + TIME_AFTER_INPUT)
    signals = {**stretch.inputs, **stretch.outputs}
    if output not in signals:
        return {}
    for control, dimensional in DIMENSIONAL.get(axis, {}).items():
        if control in signals:
            regressors = dimensional
    length = end - start + TIME_BEFORE_INPUT + TIME_AFTER_INPUT
    block = max(1, round(min(AVERAGING_TIME, length / 60.0) / stretch.step))
    averaged = {
        name: values
        for name, channel in regressors.items()
        if channel in signals
        and (values := _averaged(signals[channel][rows], block)).size
        and np.ptp(values) > 0.0
    }
    measured = _averaged(signals[output][rows], block)
    if measured.size < FEWEST_AVERAGES_PER_PARAMETER * (len(averaged) + 1) or not averaged:
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
    rho = (
        float(np.clip(residual[1:] @ residual[:-1] / power, 0.0, LARGEST_CORRECTED_CORRELATION))
        if power > 0.0
        else 0.0
    )
    variance = power / (measured.size - len(averaged) - 1) * (1.0 + rho) / (1.0 - rho)
    sigma = np.sqrt(np.maximum(variance * np.diag(np.linalg.inv(scaled.T @ scaled)), 0.0))
    t = np.minimum(np.abs(estimate), LARGEST_T_VALUE * sigma) / np.where(sigma > 0.0, sigma, 1.0)
    return {
        name: float(value) if s > 0.0 else LARGEST_T_VALUE
        for name, value, s in zip(averaged, t, sigma, strict=True)
    }


def _averaged(values: np.ndarray, block: int) -> np.ndarray:
    """Return the means of successive blocks of ``block`` samples."""
    count = values.size // block
    return values[: count * block].reshape(count, block).mean(axis=1)
