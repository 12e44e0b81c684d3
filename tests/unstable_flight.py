"""An aircraft that is unstable without its flight control system, flown through the project's own
simulator, loop closed sample by sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.propagation import rk4_step
from sim.record import Channel, Record
from tests.bases import rigid_model, three_two_one_one

FIGHTER = {
    "mass": 9295.0,
    "wing_area": 27.87,
    "chord": 3.45,
    "pitch_inertia": 75670.0,
    "airspeed": 153.0,
    "air_density": 1.05,
    "CL_alpha": 3.9,
    "CL_q": 4.0,
    "CL_de": 0.55,
    "Cm_alpha": 0.30,
    "Cm_q": -5.0,
    "Cm_de": -0.62,
}
DERIVATIVES = tuple(name for name in FIGHTER if name.startswith("C") and "_" in name)
STEP = 0.0025  # s, of the integration


@dataclass(frozen=True)
class Loop:
    """Elevator = command + ``alpha_gain`` alpha + ``rate_gain`` q, worked out at each sample from
    what the sensors say and held till the next.
    """

    alpha_gain: float = 0.9
    rate_gain: float = 0.6


def fighter(values: Mapping[str, float] = FIGHTER) -> Model:
    """The bare airframe with its sensors' noise."""
    return rigid_model(values).with_noise(Noise({"alpha": 0.001, "q": 0.001, "nz": 0.01}))


def fighter_start(factors: Mapping[str, float] | float) -> Model:
    """The fighter at starting values off by factors, every output with a bias, as ``identify``
    begins.
    """
    by_name = dict.fromkeys(DERIVATIVES, factors) if isinstance(factors, float) else dict(factors)
    wrong = {name: FIGHTER[name] * by_name.get(name, 1.0) for name in DERIVATIVES}
    return fighter().with_values(wrong).with_biases(["alpha", "q", "nz"])


def flown_in_a_loop(
    rng: np.random.Generator,
    *,
    duration: float = 12.0,
    rate: float = 50.0,
    size: float = 0.03,
    scale: float = 1.0,
    gust: float = 0.0,
    loop: Loop = Loop(),
) -> Record:
    """A record of the fighter in its loop: a pilot's 3-2-1-1 of ``size`` rad twice, sensor noise
    times ``scale``.

    ``gust``: white noise on alpha_dot, rad per root s. The recorded elevator is the one that flew,
    held between samples.
    """
    model = fighter()
    system = compile_model(model)
    p = system.parameters.values().tolist()
    time = np.arange(round(duration * rate) + 1) / rate
    command = three_two_one_one(time, size=size) + three_two_one_one(
        time, start=0.5 * duration, unit=0.3, size=-size
    )
    std = np.array([model.noise.measurement_std[name] for name in system.output_names])
    x, seen, flown = [0.0, 0.0], np.empty((len(std), len(time))), np.empty(len(time))
    substeps = round(1.0 / (rate * STEP))
    for k, t in enumerate(time.tolist()):
        noise = scale * std * rng.standard_normal(len(std))
        # alpha and q are states: the loop closes before the load factor, which the elevator moves
        # at once, is read.
        felt = np.array(x) + noise[:2]
        flown[k] = command[k] + loop.alpha_gain * felt[0] + loop.rate_gain * felt[1]
        u = [float(flown[k])]
        seen[:, k] = np.array(system.h(t, x, u, p), dtype=float) + noise
        for _ in range(substeps):
            x = rk4_step(system.f, t, x, (u, u, u), p, STEP)
            x = [float(value) for value in x]
            x[0] += gust * float(np.sqrt(STEP) * rng.standard_normal())
    outputs = tuple(
        Channel.of(name, "1", row) for name, row in zip(system.output_names, seen, strict=True)
    )
    return Record(time, (Channel.of("elevator", "rad", flown),), outputs)
