"""A rigid aircraft in Dryden turbulence, written for the tests alone: its equations and its gust
share nothing with the effect's.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim.declaration.model import Model
from sim.effects.disturbance.gusts import GustTurbulence
from sim.record import Channel, Record
from sim.truth.measurement import dryden_gust
from tests.bases import RIGID_VALUES, rigid_model, three_two_one_one

DERIVATIVES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
TRUE = np.array([RIGID_VALUES[name] for name in DERIVATIVES])
NOISE = np.array([0.002, 0.002, 0.01])
_FINE = 10  # simulation steps a sample


def rough_record(
    rng: np.random.Generator,
    samples: int = 501,
    *,
    intensity: float = 1.0,
    length: float = 300.0,
    missing: float = 0.0,
    size: float = 0.05,
    unit: float = 0.5,
    values: Mapping[str, float] = RIGID_VALUES,
) -> Record:
    """A 3-2-1-1 in rough air, 50 samples a second; ``missing`` is the share of samples left out."""
    v, V = values, values["airspeed"]
    force = 0.5 * v["air_density"] * V * V * v["wing_area"]
    time = np.arange(samples) * 0.02
    h = 0.02 / _FINE
    gust = dryden_gust(rng, np.arange((samples - 1) * _FINE + 1) * h, intensity, length, V) / V
    elevator = three_two_one_one(time, size=size, unit=unit)
    half_chord = v["chord"] / (2.0 * V)
    # of alpha, q, gust, elevator
    lift = np.array([v["CL_alpha"], v["CL_q"] * half_chord, v["CL_alpha"], v["CL_de"]])
    moment = np.array([v["Cm_alpha"], v["Cm_q"] * half_chord, v["Cm_alpha"], v["Cm_de"]])
    M = np.zeros((2, 4))
    M[0, 1] = 1.0
    M[0] -= force / (v["mass"] * V) * lift
    M[1] += force * v["chord"] / v["pitch_inertia"] * moment
    x, states = np.zeros(2), np.zeros((2, samples))
    for k in range(samples - 1):
        for s in range(k * _FINE, (k + 1) * _FINE):
            # Midpoint rule: of second order, on steps of 2 ms.
            at = np.array([0.5 * (gust[s] + gust[s + 1]), elevator[k]])
            middle = x + 0.5 * h * (M[:, :2] @ x + M[:, 2:] @ at)
            x = x + h * (M[:, :2] @ middle + M[:, 2:] @ at)
        states[:, k + 1] = x
    seen = gust[::_FINE]
    nz = force / (v["mass"] * 9.80665) * (lift @ np.array([*states, seen, elevator]))
    z = np.array([states[0] + seen, states[1], nz]) + NOISE[:, None] * rng.standard_normal(
        (3, samples)
    )
    z[rng.random(z.shape) < missing] = np.nan
    outputs = tuple(
        Channel.of(name, unit_, row)
        for name, unit_, row in zip(("alpha", "q", "nz"), ("rad", "rad/s", "g"), z, strict=True)
    )
    return Record(time, (Channel.of("elevator", "rad", elevator),), outputs)


def calm_model(factor: float = 1.2) -> Model:
    """The rigid aircraft with output biases, derivatives off by a factor."""
    wrong = {name: factor * RIGID_VALUES[name] for name in DERIVATIVES}
    return rigid_model().with_values(wrong).with_biases(["alpha", "q", "nz"])


def rough_model(factor: float = 1.2) -> Model:
    """The same in turbulence of unknown intensity and length."""
    return calm_model(factor).with_effects(GustTurbulence())
