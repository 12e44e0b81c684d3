"""The whole input path before a vehicle, against a march of command, actuator and aircraft in steps
of 50 microseconds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.effects.input_path.actuator import ActuatorLag, ActuatorRateLimit, ActuatorSaturation
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.input_path.input_play import InputBacklash, InputDeadband
from sim.maths import COMPLEX_STEP
from tests.bases import RIGID_VALUES as V
from tests.bases import Flight, fly, fly_model, rigid_model, three_two_one_one

STEP = 5e-5
TIME = np.arange(101) * 0.02
COMMAND = three_two_one_one(TIME, start=0.1, unit=0.2) + 0.012 * np.sin(9.0 * TIME)
FLIGHT = Flight(TIME, COMMAND[None], max_step=0.005)
SIZES = {
    "input-delay.delay": 0.0537,
    "input-deadband.half_width": 0.004,
    "input-backlash.half_width": 0.003,
    "actuator-lag.time_constant": 0.037,
    "actuator-rate-limit.rate": 0.96,
    "actuator-saturation.limit": 0.083,
}


def full_path() -> Model:
    effects = (
        ActuatorSaturation(),
        ActuatorRateLimit(),
        ActuatorLag(),
        InputBacklash(),
        InputDeadband(),
        InputDelay(),
    )
    return rigid_model().with_effects(*effects).with_values(SIZES)


def marched(command_at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """alpha and q at the samples: delay, dead band, backlash, lag, rate limit, saturation in this
    order, then the aircraft.
    """
    late, dead, play, tau, rate, limit = SIZES.values()
    pressure = 0.5 * V["air_density"] * V["airspeed"] ** 2 * V["wing_area"]
    hat = V["chord"] / (2.0 * V["airspeed"])
    lift, turn = pressure / (V["mass"] * V["airspeed"]), pressure * V["chord"] / V["pitch_inertia"]
    free = lagged = limited = command_at[0] - np.clip(command_at[0], -dead, dead)
    alpha = q = 0.0
    out = [(alpha, q)]
    for i in range(round(TIME[-1] / STEP)):
        u = command_at[
            max(0, int(np.searchsorted(TIME, (i + 0.5) * STEP - late, side="right")) - 1)
        ]
        u = u - min(max(u, -dead), dead)
        free = max(min(free, u + play), u - play)
        before = limited
        middle = lagged + (free - lagged) * 0.5 * STEP / tau
        lagged += (free - middle) * STEP / tau
        limited += min(max(lagged - limited, -rate * STEP), rate * STEP)
        elevator = min(max(0.5 * (before + limited), -limit), limit)

        def rates(a: float, b: float, e: float = elevator) -> tuple[float, float]:
            CL = V["CL_alpha"] * a + V["CL_q"] * b * hat + V["CL_de"] * e
            return b - lift * CL, turn * (V["Cm_alpha"] * a + V["Cm_q"] * b * hat + V["Cm_de"] * e)

        a_rate, q_rate = rates(alpha, q)
        a_rate, q_rate = rates(alpha + 0.5 * STEP * a_rate, q + 0.5 * STEP * q_rate)
        alpha, q = alpha + STEP * a_rate, q + STEP * q_rate
        if (i + 1) % round(0.02 / STEP) == 0:
            out.append((alpha, q))
    history = np.array(out)
    return history[:, 0], history[:, 1]


def test_all_six_in_a_row_are_the_march() -> None:
    got, plain = fly_model(full_path(), FLIGHT), fly_model(rigid_model(), FLIGHT)
    for row, without, expected in zip(got[:2], plain[:2], marched(COMMAND), strict=True):
        assert np.max(np.abs(without - expected)) > 0.05 * np.max(np.abs(expected))
        np.testing.assert_allclose(row, expected, rtol=0.0, atol=5e-4 * np.max(np.abs(expected)))


@pytest.mark.sampled
@pytest.mark.parametrize("name", list(SIZES))
def test_outputs_are_smooth_in_every_size(name: str) -> None:
    # Over a change as small as a fit's last steps the derivative tells the difference: no stairs
    # from cells. (At a rate of 0.9 a pulse only just arrives, a true kink.)
    system = compile_model(full_path())
    index = system.parameters.index(name)
    p = list(system.parameters.values())
    for share in (0.93, 1.0, 1.07):
        p[index] = complex(share * SIZES[name], COMPLEX_STEP)
        slope = fly(system, FLIGHT, p)[1].imag / COMPLEX_STEP
        step = 3e-4 * SIZES[name]
        sides = []
        for sign in (1.0, -1.0):
            p[index] = share * SIZES[name] + sign * step
            sides.append(fly(system, FLIGHT, p)[1])
        np.testing.assert_allclose(
            (sides[0] - sides[1]) / (2.0 * step), slope, rtol=0.0, atol=0.03 * np.max(np.abs(slope))
        )


def test_a_finer_grid_gives_the_same() -> None:
    finer = fly_model(full_path(), replace(FLIGHT, max_step=0.001))
    for row, fine in zip(fly_model(full_path(), FLIGHT)[:2], finer[:2], strict=True):
        np.testing.assert_allclose(row, fine, rtol=0.0, atol=1e-4 * np.max(np.abs(fine)))


def test_the_derivative_by_the_delay_tells_the_difference_over_several_cells() -> None:
    # With the delay ahead of the rate limit, cells that hold part of a jump would make stairs of
    # it: a slope of zero between them.
    system = compile_model(
        rigid_model()
        .with_effects(InputDelay(), ActuatorRateLimit())
        .with_values({"actuator-rate-limit.rate": 0.96})
    )
    index, p = system.parameters.index("input-delay.delay"), list(system.parameters.values())
    for delay in (0.0483, 0.051, 0.0537):
        p[index] = complex(delay, COMPLEX_STEP)
        slope = fly(system, FLIGHT, p)[1].imag / COMPLEX_STEP
        sides = []
        for shift in (0.003, -0.003):
            p[index] = delay + shift
            sides.append(fly(system, FLIGHT, p)[1])
        np.testing.assert_allclose(
            (sides[0] - sides[1]) / 0.006, slope, rtol=0.0, atol=0.01 * np.max(np.abs(slope))
        )
