"""The low-order equivalent system of the linear loop, fitted to its frequency response; independent of any record.

The low-order system with stick s (in): delta_dot = inv_tau (s(t - delay) - delta), alpha_dot = L_alpha alpha + L_q q + L_delta delta,
q_dot = M_alpha alpha + M_q q + M_delta delta, nz = -(V/g) [L_alpha alpha + (L_q - 1) q + L_delta delta].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from sim.closed_loop.airframe import X29
from sim.closed_loop.linear import frequency_response
from sim.errors import ModelError

FITTED_NAMES = ("L_alpha", "M_alpha", "M_q", "M_delta", "L_delta", "inv_tau", "delay")
# The usual weights of equivalent-system matching: errors in dB, and sqrt(0.01745) per degree of phase.
_DECIBEL, _PHASE = 20.0 / math.log(10.0), math.sqrt(0.01745) * 180.0 / math.pi
# Start of the search, and sizes of the parameters.
_START = np.array([-2.0, -10.0, -4.0, 0.3, 0.0, 12.0, 0.1])
_SCALE = np.array([1.0, 10.0, 3.0, 0.3, 0.01, 10.0, 0.1])
_STEPS, _SETTLED = 12, 1e-6  # Gauss-Newton steps from nearby, and the last of them, in sizes of the parameters


class FitOutcome(Enum):
    """Whether the search for the equivalent system ended at a minimum."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not converged"


@dataclass(frozen=True)
class EquivalentSystem:
    """A fitted low-order equivalent system.

    Attributes
    ----------
    L_alpha, M_alpha, L_q, M_q : 1/s, 1/s2, 1, 1/s.
    M_delta, L_delta : per inch of stick, 1/s2/in and 1/s/in; M_delta > 0 for a nose-up stick.
    inv_tau, delay : 1/s, s.
    natural_frequency, damping_ratio : undamped short-period frequency w (rad/s) and damping, from
        w^2 = L_alpha M_q - L_q M_alpha and 2 damping w = -(L_alpha + M_q); both 0 where w^2 is not positive.
    mismatch : mean over channels and frequencies of (error in dB)^2 + 0.01745 (error in deg)^2.
    outcome : how the search ended.
    """

    L_alpha: float
    M_alpha: float
    L_q: float
    M_q: float
    M_delta: float
    L_delta: float
    inv_tau: float
    delay: float
    natural_frequency: float
    damping_ratio: float
    mismatch: float
    outcome: FitOutcome


def equivalent_system(x29: X29, L_q: float = 1.01, low: float = 0.35, high: float = 14.0, points: int = 40) -> EquivalentSystem:
    """Equivalent of the recorded linear loop: stick as recorded (its skew counts as delay), ``points`` from ``low`` to ``high`` rad/s.

    The response is taken from frame to frame, without the hold of the sampled stick; the delay of a record whose stick is held
    between 40 Hz samples comes out about half a frame (6 ms) shorter. L_delta is poorly determined:
    mostly what an ``L_q`` leaves that is not the airframe's.
    """
    omega = np.geomspace(low, high, points)
    response = frequency_response(x29, omega, recorded=True)
    return fit_equivalent(omega, response, x29.airframe.airspeed, x29.airframe.gravity, L_q)


def fit_equivalent(
    omega: np.ndarray, response: np.ndarray, airspeed: float, gravity: float, L_q: float = 1.01, near: EquivalentSystem | None = None
) -> EquivalentSystem:
    """Fits a low-order equivalent system to responses of alpha, q and nz per inch of stick.

    Parameters
    ----------
    omega : ``(n,)``, rad/s, positive.
    response : complex ``(3, n)``: alpha (rad/in), q (rad/s/in), incremental nz (g/in), nowhere zero.
    airspeed, gravity : m/s, m/s2.
    L_q : held at this value.
    near : the equivalent of a loop nearby: a few Gauss-Newton steps from it, and the whole search only where they do not settle.

    Returns the least-squares fit of gain in dB and weighted phase over all three channels with equal weight.
    Raises ModelError when shapes do not agree, a frequency is not positive, or a response is zero or not finite.
    """
    from scipy.optimize import least_squares

    omega, response = np.asarray(omega, dtype=float), np.asarray(response, dtype=complex)
    if response.shape != (3, omega.size) or omega.size < 3 or not np.all(omega > 0):
        raise ModelError(
            f"responses of shape {response.shape} at {omega.size} frequencies",
            where="fit_equivalent",
            remedy="give (3, n) at n >= 3 positive frequencies",
        )
    if not (np.all(np.isfinite(response)) and np.all(response != 0)):
        raise ModelError("a response is zero or not finite", where="fit_equivalent", remedy="leave that frequency out")

    def errors(p: np.ndarray) -> np.ndarray:
        ratio = np.log(equivalent_response(dict(zip(FITTED_NAMES, p, strict=True)), omega, airspeed, gravity, L_q) / response)
        return np.concatenate([_DECIBEL * ratio.real.ravel(), _PHASE * ratio.imag.ravel()])

    if near is not None and (settled := _from_near(near, omega, response, airspeed, gravity, L_q)) is not None:
        return settled
    found = least_squares(errors, _START, x_scale=_SCALE, xtol=1e-12, ftol=1e-14, gtol=1e-12, max_nfev=2000)
    outcome = FitOutcome.CONVERGED if found.status > 0 else FitOutcome.NOT_CONVERGED
    return _system(found.x, L_q, float(2.0 * found.cost / response.size), outcome)


def _from_near(
    near: EquivalentSystem, omega: np.ndarray, response: np.ndarray, airspeed: float, gravity: float, L_q: float
) -> EquivalentSystem | None:
    """The same fit by Gauss-Newton steps from an equivalent nearby, all slopes in one call; None where it does not settle."""
    p, nudge = np.array([getattr(near, name) for name in FITTED_NAMES]), 1e-7 * _SCALE

    def errors(columns: np.ndarray) -> np.ndarray:
        values = dict(zip(FITTED_NAMES, columns[:, :, None], strict=True))
        ratio = np.log(equivalent_response(values, omega, airspeed, gravity, L_q) / response[:, None, :])
        return np.concatenate([_DECIBEL * ratio.real, _PHASE * ratio.imag]).transpose(0, 2, 1).reshape(-1, columns.shape[1])

    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            found = errors(p[:, None] + np.column_stack([np.zeros(len(p)), np.diag(nudge)]))
            if not np.all(np.isfinite(found)):
                return None
            step = np.linalg.lstsq((found[:, 1:] - found[:, :1]) / 1e-7, -found[:, 0], rcond=None)[0]
            p = p + _SCALE * step
            if np.abs(step).max() < _SETTLED:
                return _system(p, L_q, float(found[:, 0] @ found[:, 0] / response.size), FitOutcome.CONVERGED)
    return None


def _system(fitted: np.ndarray, L_q: float, mismatch: float, outcome: FitOutcome) -> EquivalentSystem:
    """The system of fitted values in the order of ``FITTED_NAMES``, with its frequency and damping."""
    values = {name: float(value) for name, value in zip(FITTED_NAMES, fitted, strict=True)}
    stiffness = values["L_alpha"] * values["M_q"] - L_q * values["M_alpha"]
    frequency = math.sqrt(stiffness) if stiffness > 0 else 0.0
    damping = -(values["L_alpha"] + values["M_q"]) / (2.0 * frequency) if frequency else 0.0
    return EquivalentSystem(
        **values,
        L_q=L_q,
        natural_frequency=frequency,
        damping_ratio=damping,
        mismatch=mismatch,
        outcome=outcome,
    )


def equivalent_response(values: Mapping[str, Any], omega: np.ndarray, airspeed: float, gravity: float, L_q: float) -> np.ndarray:
    """Response of alpha, q and incremental nz to the stick for values of ``FITTED_NAMES``, complex ``(3, n)``; of values ``(k, 1)`` ``(3, k, n)``."""
    L_alpha, M_alpha, M_q, M_delta, L_delta, inv_tau, delay = (values[name] for name in FITTED_NAMES)
    s = 1j * omega
    delta = inv_tau / (s + inv_tau) * np.exp(-s * delay)
    determinant = (s - L_alpha) * (s - M_q) - L_q * M_alpha
    alpha = ((s - M_q) * L_delta + L_q * M_delta) / determinant * delta
    q = ((s - L_alpha) * M_delta + M_alpha * L_delta) / determinant * delta
    nz = -(airspeed / gravity) * (L_alpha * alpha + (L_q - 1.0) * q + L_delta * delta)
    return np.stack([alpha, q, nz])
