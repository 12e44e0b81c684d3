"""An example of a motion: a doublet on one input after the other, simulated with the slopes by everything that a fit would estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenarios.files.own_models import inputs_at_rest
from scenarios.preparation.vehicle_model import root_sizes
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, System
from sim.maths import COMPLEX_STEP, complex_step_jacobian
from sim.propagation import rk4_step

ANGLE = 0.05  # rad, of a doublet on an angle; one unit at most on any other input
MODEST = 0.02  # of a state's value at the start, by which a pulse may move it: a tank must not run dry
PULSE = 1.5  # over a root's size: half the doublet's length
BETWEEN = 8.0  # pulses from one doublet to the next
FINE = 20.0  # steps in a pulse, and within the quickest root's time
MOST = 4000  # steps
FAR = 1e6  # growth beyond which a motion has run away
STEEPEST = 1e20  # of a slope by any unknown


@dataclass(frozen=True, eq=False)
class Motion:
    """``pulse`` s, half the length of each doublet; ``amplitudes`` of the inputs; ``end`` s.

    ``names`` of the unknowns: free parameters, states at the start, biases of outputs. ``slopes``: of each output ``(N, unknowns)``;
    ``sizes``: its largest value less its first. ``ran_away``: the motion was cut short where it left all measure.
    """

    pulse: float
    amplitudes: dict[str, float]
    end: float
    names: tuple[str, ...]
    slopes: tuple[np.ndarray, ...]
    sizes: tuple[float, ...]
    ran_away: bool


def doublet_motion(model: Model) -> Motion:
    """The motion from the model's initial state, doublets as long as its roots ask for."""
    system = compile_model(model)
    rest = inputs_at_rest(model)
    sizes = root_sizes(system, rest)
    pulse = PULSE / float(np.exp(np.mean(np.log(sizes)))) if len(sizes) else 1.0
    step = min(pulse, PULSE / float(np.max(sizes)) if len(sizes) else pulse) / FINE
    end = BETWEEN * pulse * max(1, len(system.inputs)) + 2.0 * pulse
    count = min(int(np.ceil(end / step)), MOST)
    amplitudes = _amplitudes(system, rest, pulse)

    def inputs(t: float) -> list[float]:
        along = [(t - (1.0 + BETWEEN * i) * pulse) / pulse for i in range(len(rest))]
        return [each + size * ((0.0 <= at < 1.0) - (1.0 <= at < 2.0)) for each, size, at in zip(rest, amplitudes.values(), along, strict=True)]

    free = [model.parameters.index(name) for name in model.parameters.free_names]
    unknown = len(free) + len(system.states)
    p: list[complex | np.ndarray] = [complex(value) for value in model.parameters.values()]
    for column, i in enumerate(free):
        p[i] = _stepped(model.parameters.items[i].value, column, unknown)
    x = np.array([_stepped(value, len(free) + i, unknown) for i, value in enumerate(system.initial.values())])
    outputs, largest = [], FAR * max(1.0, float(np.max(np.abs(x))))
    with np.errstate(all="ignore"):
        for k in range(count):
            t = k * step
            u = inputs(t + 0.5 * step)
            read = np.array([np.broadcast_to(row, (unknown,)) for row in system.h(t, list(x), u, p)])
            # The root of a negative number is imaginary as no slope is.
            if not (np.all(np.isfinite(read)) and np.max(np.abs(x.real)) < largest and np.max(np.abs(x.imag)) < STEEPEST * COMPLEX_STEP):
                break
            outputs.append(read)
            x = np.array(rk4_step(system.f, t, list(x), (u, u, u), p, step))
    along = np.array(outputs).reshape(-1, len(system.outputs), unknown)
    slopes, values = along.imag / COMPLEX_STEP, along.real[:, :, 0]
    biased = [i for i, signal in enumerate(system.outputs) if signal.name in getattr(model.equations, "biased_outputs", ())]
    constant = np.eye(len(system.outputs))[:, biased]
    names = (
        *model.parameters.free_names,
        *(f"{name} at the start" for name in system.state_names),
        *(f"bias of {system.output_names[i]}" for i in biased),
    )
    wide = tuple(np.hstack([slopes[:, i], np.tile(constant[i], (len(along), 1))]) for i in range(len(system.outputs)))
    moves = tuple(float(np.max(np.abs(values[:, i] - values[0, i]), initial=0.0)) if len(values) else 0.0 for i in range(len(system.outputs)))
    return Motion(pulse, amplitudes, step * len(along), names, wide, moves, len(along) < count)


def _amplitudes(system: System, rest: list[float], pulse: float) -> dict[str, float]:
    """Doublets that move no state far from where it starts, by input."""
    x, p = system.initial.values(), system.parameters.values().tolist()
    gains = np.abs(complex_step_jacobian(lambda u: system.f(0.0, x.tolist(), u, p), rest)) if rest else np.zeros((len(x), 0))
    out = {}
    for i, signal in enumerate(system.inputs):
        limits = [MODEST * abs(value) / (gain * pulse) for value, gain in zip(x, gains[:, i], strict=True) if value and gain > 0.0]
        out[signal.name] = min([ANGLE if signal.unit == "rad" else 1.0, *limits])
    return out


def _stepped(value: float, column: int, count: int) -> np.ndarray:
    row = np.full(count, complex(value))
    row[column] += 1j * COMPLEX_STEP
    return row
