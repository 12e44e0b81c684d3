"""Streams flown with multisines and identified on line second by second, by equations of their own.

Aircraft and integration are those of `independent_flights`. A user's models are a yaw oscillation
and Morelli's example of real-time estimation, whose exact transition over a sample is known. The
low-order equivalent system is that of `frequency_responses`, identified by its bank as well.
Multisines: Morelli, "Multiple Input Design for Real-Time Parameter Estimation in the Frequency
Domain", IFAC Symposium on System Identification, 2003; phases by Schroeder (IEEE Trans. Information
Theory 16(1), 1970).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd

from exam.coverage.independent_flights import CONSTANTS, RATE, SENSORS, TRUE, level, motion
from ident.frequency_domain.online import frequencies
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.low_order import identify_loes
from scenarios.watching.spectral import (
    SpectralSession,
    last_estimate,
    regress,
    signals_of,
    spectral_session,
)
from scenarios.watching.spectral import take as take_in_frequency
from sim.declaration import own_model
from sim.declaration.model import Model
from sim.record import Channel, Record

PERIOD, CYCLES = 15.0, 2  # s, of the multisines
F16_DURATION = 20.0  # s
LOWEST, HIGHEST = 2, 24  # harmonics, 0.13 to 1.6 Hz
START_ERROR = 0.3  # share by which starting values are wrong, at most
WITHIN = 1.959964  # deviations that hold 95 %
RMS: Mapping[str, Mapping[str, float]] = {
    "rigid": {"elevator": 0.02},
    "lateral": {"aileron": 0.03, "rudder": 0.03},
    "longitudinal": {"elevator": 0.02, "thrust": 500.0},
    "own": {"rudder": 0.03},
    "f16": {"elevator": math.radians(1.0)},
    "f16-unstable": {"elevator": math.radians(1.0)},
}


@dataclass(frozen=True)
class OwnMotion:
    """Two linear equations of a user: ``rates`` gives their matrix ``(2, 3)`` over both states and
    the input from a look-up of parameters, ``sensors`` the states' noise."""

    true: Mapping[str, float]
    units: Mapping[str, str]
    sensors: Mapping[str, float]
    rates: Callable[[Callable[[str], Any]], list[list[Any]]]


def _yaw(p: Callable[[str], Any]) -> list[list[Any]]:
    return [[p("Y_beta"), -1.0, 0.0], [p("N_beta"), p("N_r"), p("N_dr")]]


def _pitch(p: Callable[[str], Any]) -> list[list[Any]]:
    return [[p("Z_alpha"), p("Z_q"), p("Z_de")], [p("M_alpha"), p("M_q"), p("M_de")]]


# E. A. Morelli, program rtpid_demo, 1999, copyright 2002: linear longitudinal dynamics of the F-16,
# stable and unstable, noise of 0.1 deg and 0.1 deg/s, 20 s at 50 Hz.
_F16 = {"Z_alpha": -0.60, "Z_q": 0.95, "Z_de": -0.115, "M_alpha": -4.3, "M_q": -1.2, "M_de": -5.157}
_F16_UNITS = {
    **{"Z_alpha": "1/s", "Z_q": "1", "Z_de": "1/s"},
    **{"M_alpha": "1/s2", "M_q": "1/s", "M_de": "1/s2"},
}
_F16_SENSORS = {"alpha": math.radians(0.1), "q": math.radians(0.1)}
OWN: Mapping[str, OwnMotion] = {
    "own": OwnMotion(
        {"Y_beta": -0.25, "N_beta": 4.5, "N_r": -0.6, "N_dr": -3.2},
        {"Y_beta": "1/s", "N_beta": "1/s2", "N_r": "1/s", "N_dr": "1/s2"},
        {"beta": 0.002, "r": 0.002},
        _yaw,
    ),
    "f16": OwnMotion(_F16, _F16_UNITS, _F16_SENSORS, _pitch),
    "f16-unstable": OwnMotion({**_F16, "M_alpha": 1.0}, _F16_UNITS, _F16_SENSORS, _pitch),
}
STICK_RMS, REST = 0.35, 2.0  # of the stick, and s before it moves
LOW_ORDER = ("alpha", "q", "nz")
Counts = dict[str, list[int]]


def multisines(time: np.ndarray, rms: Sequence[float]) -> np.ndarray:
    """Inputs ``(r, N)`` of equal harmonics dealt out in turn, orthogonal over a period."""
    every = np.arange(LOWEST, HIGHEST + 1)
    rows = []
    for one, size in enumerate(rms):
        own = every[one :: len(rms)]
        k = np.arange(own.size)
        phases = -math.pi * k * (k + 1) / own.size
        turned = 2.0 * math.pi * np.outer(own / PERIOD, time) + phases[:, None]
        rows.append(size * math.sqrt(2.0 / own.size) * np.cos(turned).sum(axis=0))
    return np.array(rows)


def own_motion(model: str, time: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """States ``(2, N)`` from rest by their exact transition, the input held between samples."""
    from scipy.linalg import expm

    known = OWN[model]
    whole = np.zeros((3, 3))
    whole[:2] = known.rates(known.true.__getitem__)
    step = expm(whole * (time[1] - time[0]))
    out = np.zeros((2, time.size))
    for k in range(time.size - 1):
        out[:, k + 1] = step[:2, :2] @ out[:, k] + step[:2, 2] * moved[k]
    return out


def own_declared(model: str, start: Mapping[str, float]) -> Model:
    """The model as a user declares it, with starting values."""
    known = OWN[model]
    (x, y), u = known.sensors, next(iter(RMS[model]))

    def rates(s: Any, p: Any) -> Mapping[str, Any]:
        rows = known.rates(partial(getattr, p))
        signals = [getattr(s, name) for name in (x, y, u)]
        return {
            name: sum(factor * each for factor, each in zip(row, signals, strict=True))
            for name, row in zip((x, y), rows, strict=True)
        }

    units = dict(zip((x, y), ("rad", "rad/s"), strict=True))
    return own_model(
        name=model,
        states=units,
        inputs={u: "rad"},
        outputs=units,
        parameters={name: (value, known.units[name]) for name, value in start.items()},
        rates=rates,
        readings=lambda s, p: {x: getattr(s, x), y: getattr(s, y)},
    )


@cache
def clean_stream(model: str) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Times, inputs ``(r, N)`` and outputs by name, without noise."""
    duration = F16_DURATION if model.startswith("f16") else PERIOD * CYCLES
    time = np.arange(round(duration * RATE)) / RATE
    moved = multisines(time, list(RMS[model].values()))
    if model in OWN:
        states = own_motion(model, time, moved[0])
        return time, moved, dict(zip(OWN[model].sensors, states, strict=True))
    if model == "longitudinal":
        _, elevator, thrust = level()
        moved = moved + np.array([[elevator], [thrust]])
    inputs = dict(zip(RMS[model], moved, strict=True))
    return time, moved, motion(model, time, inputs)


def _wrong(true: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    shares = rng.uniform(1.0 - START_ERROR, 1.0 + START_ERROR, len(true))
    return {name: float(value * by) for (name, value), by in zip(true.items(), shares, strict=True)}


def stream(model: str, seed: int) -> tuple[VehicleFile, np.ndarray, Mapping[str, float]]:
    """A vehicle file with wrong derivatives, rows ``(1 + r + m, N)`` of time, inputs and outputs in
    the order of the model, and the true derivatives."""
    rng = np.random.default_rng([44, list(RMS).index(model), seed])
    time, inputs, outputs = clean_stream(model)
    own = OWN.get(model)
    true, sensors = (own.true, own.sensors) if own else (TRUE[model], SENSORS[model])
    start = _wrong(true, rng)
    vehicle = VehicleFile(
        "a stream",
        model,
        {} if own else dict(CONSTANTS[model]),
        start,
        own=own_declared(model, start) if own else None,
    )
    signals = signals_of(vehicle)
    noisy = {
        name: outputs[name] + std * rng.standard_normal(time.size) for name, std in sensors.items()
    }
    named = dict(zip(RMS[model], inputs, strict=True))
    rows = [time, *(named[name] for name in signals.inputs)]
    rows += [noisy.get(name, np.full(time.size, np.nan)) for name in signals.outputs]
    return vehicle, np.array(rows), true


def watched(model: str, seed: int) -> Counts:
    """Intervals of the parameter histories that hold the truth: after every second that shows one,
    and at the end."""
    vehicle, rows, true = stream(model, seed)
    measured = [
        name
        for name, row in zip(signals_of(vehicle).outputs, rows[1 + len(RMS[model]) :], strict=True)
        if np.isfinite(row).any()
    ]
    session = spectral_session(vehicle, "stream", measured, frequencies())
    take_in_frequency(session, rows)
    regress(session)
    return histories(session, true)


def histories(session: SpectralSession, true: Mapping[str, float]) -> Counts:
    """Counts of a session's points: all seconds, the last."""
    exact = np.array([true[name] for name in session.names])
    out: Counts = {"every second": [0, 0], "at the end": [0, 0]}
    for point in session.points:
        known = np.isfinite(point.std) & (point.std > 0.0)
        inside = np.abs(point.values - exact)[known] <= WITHIN * point.std[known]
        last = ["at the end"] if point is session.points[-1] else []
        for name in ("every second", *last):
            held, count = out[name]
            out[name] = [held + int(inside.sum()), count + int(known.sum())]
    return out


def stick_multisine(time: np.ndarray) -> np.ndarray:
    """The stick of a low-order stream ``(N,)``: rest for ``REST`` s, then multisines."""
    moved = multisines(time - REST, [STICK_RMS])[0]
    return np.where(time >= REST - 1e-9, moved, 0.0)


def beside_the_bank(vehicle: VehicleFile, frame: pd.DataFrame, true: Mapping[str, float]) -> Counts:
    """A low-order stream by the regression and by the bank as the end of `watch` shows it, against
    the truth and, within two deviations, against each other.

    ``frame`` : columns time, stick, alpha, q, nz in SI and g.
    """
    rows = frame.to_numpy().T
    session = spectral_session(vehicle, "stream", LOW_ORDER, frequencies())
    take_in_frequency(session, rows)
    regress(session)
    outputs = zip(LOW_ORDER, ("rad", "rad/s", "g"), rows[2:], strict=True)
    record = Record(
        rows[0],
        (Channel.of("stick", "1", rows[1]),),
        tuple(Channel.of(name, unit, row) for name, unit, row in outputs),
        name="stream",
    )
    bank = identify_loes(record, vehicle).estimate
    last = last_estimate(session)
    assert last is not None
    out = {f"regression, {name}": held for name, held in histories(session, true).items()}
    out |= {"bank, at the end": [0, 0], "one another, two deviations": [0, 0]}
    for name in bank.names:
        if name not in true:
            continue
        errors = {"bank, at the end": (bank.value(name) - true[name]) / bank.sigma(name) / WITHIN}
        if name in last.names:
            apart = last.value(name) - bank.value(name)
            both = math.hypot(last.sigma(name), bank.sigma(name))
            errors["one another, two deviations"] = 0.5 * apart / both
        for key, error in errors.items():
            out[key] = [out[key][0] + int(abs(error) <= 1.0), out[key][1] + 1]
    return out
