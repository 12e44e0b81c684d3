"""Simulation of a model in closed loop: a pilot or a flight control system moves the inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.model import Model, System
from sim.errors import ModelError
from sim.maneuvers import Maneuver, Sum
from sim.propagation import Step, rk4_step
from sim.record import Channel, Hold, Record
from sim.truth.flight import Distance, Truth
from sim.truth.measurement import white_noise

Gains = Mapping[str, Mapping[str, float]]
FEED_THROUGH_TOLERANCE = 1e-12  # relative change of an output that is rounding, no feed-through


def fly_with_feedback(
    model: Model,
    maneuvers: Mapping[str, Maneuver],
    gains: Gains,
    time: np.ndarray,
    rng: np.random.Generator,
    *,
    step: float = 0.005,
    method: Step | None = None,
    outputs: Sequence[str] | None = None,
    distance: Distance = Distance.OTHER_STEP,
    name: str = "record",
) -> tuple[Record, Truth]:
    """Simulate a model under feedback and measure it; inputs are recorded as they act.

    At each sample an input is the value of its maneuver plus feedback: the sum over
    ``gains[input]`` of gain times (measured output minus its value at the start without noise). It
    is held to the next sample.

    Parameters
    ----------
    gains : by input, then by output, in the unit of the input over that of the output. Outputs with
        feed-through, such as a load factor, are refused.
    time : ``(N,)``, s.
    step : largest integration step, s.
    method : integrator; None for Runge-Kutta's method of order 4.

    The other parameters are those of ``fly``; process noise may act on states only.

    Raises
    ------
    ModelError : an input or output is unknown; effects on the input or sensor path; an algebraic
        loop; parameters that walk randomly; or a flight that diverges.
    """
    system, method = compile_model(model, outputs), method or rk4_step
    loop = _Loop(system, model, maneuvers, gains)
    time = np.asarray(time, dtype=float)
    std = {key: float(model.noise.measurement_std.get(key, 0.0)) for key in system.output_names}
    noise = np.array(
        [
            white_noise(rng, len(time), each) if each > 0 else np.zeros(len(time))
            for each in std.values()
        ]
    )
    forcing, N = loop.densities(), len(time)
    start = loop.outputs(
        float(time[0]), system.initial.values().tolist(), loop.command(float(time[0]))
    )
    x: list[Any] = system.initial.values().tolist()
    states, u = np.empty((len(x), N)), np.empty((len(system.inputs), N))
    clean = np.empty((len(std), N))
    for k, t in enumerate(time.tolist()):
        u[:, k], clean[:, k] = loop.closed(t, x, noise[:, k], start)
        states[:, k] = x
        if k < N - 1:
            x = _states_at_next_sample(
                loop, method, x, u[:, k].tolist(), t, float(time[k + 1]) - t, step, forcing, rng
            )
        if not np.all(np.isfinite(x)):
            remedy = "shorten the flight or check the gains"
            raise ModelError(
                f"the simulation diverges at {t:.4g} s", where=f"model {model.name}", remedy=remedy
            )
    truth = Truth(
        parameters=model.parameters,
        effects=tuple(effect.name for effect in model.effects),
        time=time.copy(),
        states=dict(zip(system.state_names, states, strict=True)),
        outputs=dict(zip(system.output_names, clean, strict=True)),
        walks={},
        noise_std=std,
        process_density={
            key: value for key, value in zip(system.state_names, forcing, strict=True) if value > 0
        },
        distance=distance,
        step=step,
        method=getattr(method, "__name__", type(method).__name__),
    )
    inputs = tuple(
        Channel.of(signal.name, signal.unit, row)
        for signal, row in zip(system.inputs, u, strict=True)
    )
    measured = tuple(
        Channel.of(signal.name, signal.unit, row)
        for signal, row in zip(system.outputs, clean + noise, strict=True)
    )
    return Record(time, inputs, measured, Hold.PREVIOUS, name), truth


@dataclass(frozen=True, eq=False)
class _Loop:
    """A compiled model with its controller, which acts sample by sample.

    Raises
    ------
    ModelError : effects on the input or sensor path, unknown signals, or parameters that walk.
    """

    system: System
    model: Model
    maneuvers: Mapping[str, Maneuver]
    gains: Gains

    def __post_init__(self) -> None:
        system = self.system
        if system.input_stages or system.sensor_stages:
            what = f"{', '.join((*system.input_stages, *system.sensor_stages))} under feedback"
            raise ModelError(
                what,
                where=f"model {self.model.name}",
                remedy="leave out effects on the input and sensor path",
            )
        for key in (*self.maneuvers, *self.gains):
            if key not in system.input_names:
                raise ModelError(
                    f"there is no input {key!r}",
                    where="feedback",
                    remedy=f"the inputs are {', '.join(system.input_names) or 'none'}",
                )
        for key in {name for table in self.gains.values() for name in table}:
            if key not in system.output_names:
                raise ModelError(
                    f"{key!r} is not measured",
                    where="feedback",
                    remedy=f"the outputs are {', '.join(system.output_names)}",
                )
        for key in self.model.noise.process_density:
            if key not in system.state_names:
                raise ModelError(
                    f"{key!r} drifts under feedback",
                    where="feedback",
                    remedy="declare process noise on states only",
                )

    def densities(self) -> list[float]:
        """Return the spectral density of the forcing of each state."""
        return [
            float(value) for value in self.system.noise(self.system.parameters.values().tolist())[0]
        ]

    def command(self, t: float) -> list[float]:
        """Return the values of the maneuvers for every input."""
        return [float(self.maneuvers.get(key, Sum())(t)) for key in self.system.input_names]

    def closed(
        self, t: float, x: list[Any], noise: np.ndarray, start: list[float]
    ) -> tuple[list[float], list[float]]:
        """Return the inputs at a sample, and the outputs without noise.

        ``noise`` is that of the outputs, and ``start`` are the outputs at the start without noise.
        """
        system, command = self.system, self.command(t)
        open_loop = self.outputs(t, x, command)
        readings = {
            key: open_loop[i] + float(noise[i]) - start[i]
            for i, key in enumerate(system.output_names)
        }
        added = [
            sum(gain * readings[key] for key, gain in self.gains.get(name, {}).items())
            for name in system.input_names
        ]
        u = [value + more for value, more in zip(command, added, strict=True)]
        y = self.outputs(t, x, u)
        for key in {name for table in self.gains.values() for name in table}:
            i = system.output_names.index(key)
            if abs(y[i] - open_loop[i]) > FEED_THROUGH_TOLERANCE * max(1.0, abs(y[i])):
                raise ModelError(
                    f"an input moves {key!r} at once",
                    where="feedback",
                    remedy="feed back outputs that are states",
                )
        return u, y

    def outputs(self, t: float, x: list[Any], u: list[float]) -> list[float]:
        """Return the outputs without noise."""
        return [
            float(value)
            for value in self.system.h(t, x, u, self.system.parameters.values().tolist())
        ]


def _states_at_next_sample(
    loop: _Loop,
    method: Step,
    x: list[Any],
    u: list[float],
    begin: float,
    span: float,
    step: float,
    densities: Sequence[float],
    rng: np.random.Generator,
) -> list[Any]:
    """Return the states after a sampling interval, infinite if a rate is not defined.

    Parameters
    ----------
    x, u : states at the begin, and inputs, which are held.
    begin, span : begin and length of the interval, s.
    step : largest integration step, s.
    densities : spectral density of each state's forcing, which is added after each step.
    """
    p, count = loop.system.parameters.values().tolist(), max(1, int(np.ceil(span / step - 1e-9)))
    size = span / count
    for k in range(count):
        try:
            x = [
                float(value)
                for value in method(loop.system.f, begin + k * size, x, (u, u, u), p, size)
            ]
        except (OverflowError, ZeroDivisionError):
            return [np.inf] * len(x)
        for i, density in enumerate(densities):
            if density > 0:
                x[i] += float(np.sqrt(density * size) * rng.standard_normal())
    return x
