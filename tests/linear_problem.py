"""A linear problem for filters: an oscillator with two inputs, a free constant force and a free
bias, and its matrices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.declaration.effect import Parameter, ParameterSet, Signal
from sim.declaration.model import Model, Noise
from sim.record import Channel, Hold, Record
from tests.oracles.kalman import Linear

STIFFNESS, DAMPING = 3.0, 0.4
STD = {"place": 0.05, "mixed": 0.08, "speed": 0.1}


@dataclass(frozen=True)
class Oscillator:
    """place_dot = speed + 0.3 push, speed_dot = -k place - c speed + pull + force; three outputs,
    one with feed-through.
    """

    name: str = "oscillator"
    states: tuple[Signal, ...] = (Signal("position", "m"), Signal("speed", "m/s"))
    inputs: tuple[Signal, ...] = (Signal("pull", "m/s2"), Signal("push", "m/s"))
    outputs: tuple[Signal, ...] = (
        Signal("place", "m"),
        Signal("mixed", "m"),
        Signal("speed", "m/s"),
    )
    ports: tuple[Signal, ...] = ()
    parameter_names: tuple[str, ...] = ("stiffness", "damping", "force")

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        return {}

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        return (
            s.speed + 0.3 * s.push,
            -p.stiffness * s.position - p.damping * s.speed + s.pull + p.force,
        )

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return s.position, s.position + 0.5 * s.speed + 0.2 * s.pull, s.speed


def oscillator(density: Mapping[str, float] | None = None) -> Model:
    """Everything known but the force, the bias of ``mixed`` and the initial state."""
    parameters = ParameterSet(
        (
            Parameter("stiffness", STIFFNESS, "1/s2", free=False),
            Parameter("damping", DAMPING, "1/s", free=False),
            Parameter("force", 0.1, "m/s2", prior_std=0.7),
        )
    )
    initial = ParameterSet(
        (
            Parameter("position", 0.2, "m", prior_std=0.5),
            Parameter("speed", -0.1, "m/s", prior_std=0.4),
        )
    )
    model = Model(Oscillator(), parameters, initial, Noise(STD, density or {}))
    return model.with_biases(["mixed"], prior_std=0.3)


def matrices(density: Mapping[str, float] | None = None) -> Linear:
    """The same problem for the oracle; states position, speed, force, bias_mixed."""
    A = np.zeros((4, 4))
    A[0, 1], A[1, :3] = 1.0, [-STIFFNESS, -DAMPING, 1.0]
    B = np.zeros((4, 2))
    B[0, 1], B[1, 0] = 0.3, 1.0
    C = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, 0.5, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]])
    D = np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.0]])
    Q = np.diag(
        [(density or {}).get(name, 0.0) for name in ("position", "speed", "force", "bias_mixed")]
    )
    R = np.diag([value**2 for value in STD.values()])
    return Linear(
        A, B, C, D, Q, R, np.array([0.2, -0.1, 0.1, 0.0]), np.diag(np.square([0.5, 0.4, 0.7, 0.3]))
    )


def record_of(
    rng: np.random.Generator,
    samples: int = 60,
    *,
    uneven: bool = False,
    missing: bool = False,
    absent: tuple[str, ...] = (),
    hold: Hold = Hold.PREVIOUS,
) -> Record:
    """Any data will do for an oracle: smooth inputs, noisy outputs; a gap, single holes and
    channels left out if wanted.
    """
    steps = rng.uniform(0.02, 0.12, samples) if uneven else np.full(samples, 0.05)
    time = np.cumsum(steps)
    inputs = (
        Channel.of("pull", "m/s2", np.sin(1.7 * time)),
        Channel.of("push", "m/s", np.sign(np.cos(2.3 * time))),
    )
    outputs = []
    for name, std in STD.items():
        values = np.cos(1.5 * time) + 3.0 * std * rng.standard_normal(samples)
        if missing:
            values[rng.random(samples) < 0.3] = np.nan
            values[20:26] = np.nan
        if name not in absent:
            outputs.append(Channel.of(name, "m", values))
    return Record(time, inputs, tuple(outputs), hold)


def matched_record(
    rng: np.random.Generator, samples: int, density: Mapping[str, float] | None = None
) -> Record:
    """Data drawn from the problem's own distribution, start and noise included; 20 samples a
    second.
    """
    from tests.oracles.kalman import exponential, process_noise

    model, dt = matrices(density), 0.05
    blank = record_of(rng, samples)
    u = blank.input_array()
    x = model.x0 + np.sqrt(np.diag(model.P0)) * rng.standard_normal(4)
    noise = process_noise(model.A, model.Q, dt, None)
    root = np.linalg.cholesky(noise + 1e-18 * np.eye(4)) if density else np.zeros((4, 4))
    both = np.zeros((6, 6))
    both[:4, :4], both[:4, 4:] = model.A, model.B
    step = exponential(both * dt)
    z = np.zeros((3, samples))
    for k in range(samples):
        if k:
            x = step[:4, :4] @ x + step[:4, 4:] @ u[:, k - 1] + root @ rng.standard_normal(4)
        z[:, k] = (
            model.C @ x + model.D @ u[:, k] + np.sqrt(np.diag(model.R)) * rng.standard_normal(3)
        )
    return replace(
        blank, outputs=tuple(Channel.of(name, "m", row) for name, row in zip(STD, z, strict=True))
    )
