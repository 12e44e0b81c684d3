"""The equations of a multirotor against a second writing, and the one lag and one delay of all its
commands.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.declaration.compile import compile_model
from sim.errors import DeclarationError
from sim.vehicles.factory import model_from_constants
from sim.vehicles.other_vehicles import COMMANDS
from tests.bases import Flight, fly, fly_model
from tests.recorders.quadrotor import TRUTH, flight


@pytest.mark.long
def test_the_flight_of_the_second_writing_comes_out_of_its_recorded_commands() -> None:
    columns = flight(noise=0.0, duration=19.0)
    system = compile_model(model_from_constants("multirotor", {}, TRUTH))
    u = np.array([columns[name] for name in COMMANDS])
    coarse, fine = (
        fly(system, Flight(columns["time"], u, max_step=step)) for step in (0.002, 0.001)
    )
    for name, two, one in zip(system.output_names, coarse, fine, strict=True):
        size = np.max(np.abs(columns[name]))
        # A lagged command enters as its mean over a step: an error of second order.
        errors = [np.max(np.abs(row - columns[name])) for row in (two, one)]
        if name == "az":
            # It reads the lagged thrust command as its mean over the millisecond behind a sample.
            quickest = (
                abs(TRUTH["Z_col"])
                * np.ptp(columns["thrust_command"])
                / TRUTH["motor_time_constant"]
            )
            assert max(errors) < 0.5e-3 * quickest
        else:
            assert errors[0] < 2e-5 * size and errors[1] < 0.3 * errors[0], (name, errors)


def test_inertial_coupling_is_that_of_eulers_equations() -> None:
    inertia = np.array([0.012, 0.015, 0.021])
    x, y, z = inertia
    coupling = {"L_qr": (y - z) / x, "M_pr": (z - x) / y, "N_pq": (x - y) / z}
    torque = np.array([0.02, -0.015, 0.01])
    steady = dict(zip(("L_0", "M_0", "N_0"), torque / inertia, strict=True))
    time = np.linspace(0.0, 1.5, 151)
    model = model_from_constants(
        "multirotor", {}, {**coupling, **steady}, initial={"p": 0.7, "q": -1.1, "r": 1.6}
    )
    rows = fly_model(model, Flight(time, np.zeros((4, time.size)), max_step=0.01))

    def euler(_: float, rates: np.ndarray) -> np.ndarray:
        return np.asarray((torque - np.cross(rates, inertia * rates)) / inertia)

    expected = solve_ivp(euler, (0.0, 1.5), [0.7, -1.1, 1.6], t_eval=time, rtol=1e-11, atol=1e-12).y
    assert np.max(np.abs(np.array(rows[:3]) - expected)) < 1e-7
    assert np.max(np.abs(expected[:, -1] - [0.7, -1.1, 1.6])) > 0.5  # the coupling shows


def test_all_commands_share_one_lag_and_one_delay() -> None:
    model = model_from_constants("multirotor", {}, TRUTH)
    assert len(model.effects) == 8 and model.parameters["delay"].bounds[0] == 0.0
    assert (
        model.parameters.free_names.count("motor_time_constant")
        == model.parameters.free_names.count("delay")
        == 1
    )
    fewer = model.without("input-delay:yaw_command")
    assert "delay" in fewer.parameters and len(fewer.effects) == 7
    for name in COMMANDS[:2] + COMMANDS[3:]:
        fewer = fewer.without(f"input-delay:{name}")
    assert "delay" not in fewer.parameters and "motor_time_constant" in fewer.parameters


def test_what_is_left_out_is_held_at_zero_and_a_negative_time_is_refused() -> None:
    model = model_from_constants("multirotor", {}, {"L_p": -1.0, "L_lat": 50.0})
    assert model.parameters.free_names == ("L_p", "L_lat") and not model.effects
    with pytest.raises(DeclarationError, match="negative"):
        model_from_constants("multirotor", {}, {"L_lat": 50.0, "delay": -0.01})
