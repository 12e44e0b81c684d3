"""Linearised models against matrices printed in text books, differences, roots of equations written
again, and our own simulation.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from ident.flying_qualities.modes import StateSpace, level_flight, state_space, to_control
from ident.frequency_response.model_fit import model_response
from scenarios.preparation.declared_model import model_of_file
from sim.declaration.compile import compile_model
from sim.effects.library import find_effect
from sim.errors import ModelError
from sim.maneuvers import doublet, three_two_one_one
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import model_of
from sim.vehicles.library import read_parameter_set
from tests.diagnoses import LOES
from tests.oracles.whole_axis_modes import lateral_roots
from tests.whole_axes import CONSTANTS, TRUE, true_model

FOOT = 0.3048
SPEED = 773.98  # ft/s, of the Boeing 747 in Etkin and Reid

# Etkin and Reid, Dynamics of Flight, 3rd ed., sections 6.2 and 6.7: states u, w, q, theta in ft and
# s, and v, p, r, phi; Nelson, Flight Stability and Automatic Control, 2nd ed., section 5.4: the
# Navion's beta, p, r, phi. Here speeds across are angles, and lengths metres.
PRINTED = {
    "boeing747_longitudinal": {
        ("airspeed", "airspeed"): -0.006868,
        ("airspeed", "alpha"): 0.01395 * SPEED * FOOT,
        ("airspeed", "theta"): -32.174 * FOOT,
        ("alpha", "airspeed"): -0.09055 / SPEED / FOOT,
        ("alpha", "alpha"): -0.3151,
        ("q", "airspeed"): 0.0001187 / FOOT,
        ("q", "alpha"): -0.001026 * SPEED,
        ("q", "q"): -0.4285,
    },
    "boeing747_lateral": {
        ("beta", "beta"): -0.0558,
        ("p", "beta"): -0.003865 * SPEED,
        ("p", "p"): -0.4342,
        ("p", "r"): 0.4136,
        ("r", "beta"): 0.001086 * SPEED,
        ("r", "p"): -0.006112,
        ("r", "r"): -0.1458,
    },
    "navion_lateral": {
        ("beta", "beta"): -0.254,
        ("beta", "phi"): 0.182,
        ("p", "beta"): -16.02,
        ("p", "p"): -8.40,
        ("p", "r"): 2.19,
        ("r", "beta"): 4.488,
        ("r", "p"): -0.350,
        ("r", "r"): -0.760,
    },
}


def built_in(name: str) -> StateSpace:
    system = compile_model(model_of(read_parameter_set(name)))
    return state_space(
        system,
        {},
        *(level_flight(system, system.parameters.values()) or ()) if "longitudinal" in name else (),
    )


@pytest.mark.parametrize("name", list(PRINTED))
def test_matrices_are_those_of_the_text_books(name: str) -> None:
    space = built_in(name)
    at = [signal.name for signal in space.states]
    for (row, column), value in PRINTED[name].items():
        # Derivatives are printed with three digits, and the constants that make them dimensional
        # too.
        assert space.A[at.index(row), at.index(column)] == pytest.approx(value, rel=0.015), (
            row,
            column,
        )
    assert np.max(np.abs(space.rates)) < 1e-9, "an equilibrium"


def test_a_matrix_is_what_differences_give() -> None:
    system = compile_model(true_model("longitudinal"))
    p = system.parameters.values()
    level = level_flight(system, p)
    assert level is not None
    space = state_space(system, {"CL_alpha": 4.4}, *level)
    p[system.parameters.index("CL_alpha")] = 4.4
    x0, u0 = np.array(level[0]), np.array(level[1])

    def both(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        x_, u_ = x.tolist(), u.tolist()
        return np.array([*system.f(0.0, x_, u_, p.tolist()), *system.h(0.0, x_, u_, p.tolist())])

    for matrix, steps, moved in (
        (np.vstack([space.A, space.C]), [1e-3, 1e-5, 1e-5, 1e-5], lambda d: both(x0 + d, u0)),
        (np.vstack([space.B, space.D]), [1e-5, 1.0], lambda d: both(x0, u0 + d)),
    ):
        for i, h in enumerate(steps):
            d = np.zeros(len(steps))
            d[i] = h
            np.testing.assert_allclose(
                matrix[:, i], (moved(d) - moved(-d)) / (2.0 * h), rtol=1e-6, atol=1e-7
            )
    np.testing.assert_allclose(space.y0, both(x0, u0)[4:])
    assert np.max(np.abs(space.rates)) > 1e-3, (
        "with another lift the trim is none, and that is told"
    )


def test_eigenvalues_are_the_roots_of_the_equations_written_again() -> None:
    found = state_space(compile_model(true_model("lateral")), {}).eigenvalues
    expected = lateral_roots(CONSTANTS["lateral"], TRUE["lateral"])
    np.testing.assert_allclose(
        found, sorted(expected, key=lambda root: (abs(root), root.imag)), rtol=1e-6, atol=1e-9
    )


def test_python_control_simulates_what_we_simulate() -> None:
    import control

    model = true_model("lateral")
    maneuvers = {"aileron": doublet(0.001, 0.8, 0.4), "rudder": three_two_one_one(0.001, 0.4, 2.0)}
    record, _ = fly(model, maneuvers, sample_times(25.0, 8.0), np.random.default_rng(0), step=0.004)
    plant = to_control(state_space(compile_model(model), {}))
    assert plant.state_labels == ["beta", "p", "r", "phi"] and plant.input_labels == [
        "aileron",
        "rudder",
    ]
    assert plant.output_labels == [signal.name for signal in model.equations.outputs]
    held = control.c2d(plant, 0.04, "zoh")
    inputs = np.array([record[name].values for name in ("aileron", "rudder")])
    found = control.forced_response(held, record.time, inputs).outputs
    expected = np.array([record[name].values for name in plant.output_labels])
    # The equations are linear but for products in 1e-3 rad; what is left is that of a step of 4 ms
    # of RK4.
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-6 * np.max(np.abs(expected)))


def test_a_delay_is_told_and_approximated() -> None:
    import control

    system = compile_model(model_of_file(LOES))
    space = state_space(system, {"delay": 0.12})
    assert space.delays == {"stick": 0.12} and space.left_out == ()
    omega, names = np.array([0.5, 2.0, 5.0, 10.0]), ["alpha", "q", "nz"]
    exact = model_response(system, {**LOES.derivatives, "delay": 0.12}, omega, names)
    late = to_control(space)
    assert late.nstates == 3 + 4 and late.state_labels[3:] == [
        f"stick_delay_{k}" for k in range(1, 5)
    ]
    found = np.squeeze(control.frequency_response(late, omega).complex)
    np.testing.assert_allclose(found, exact, rtol=1e-4)
    without = np.squeeze(control.frequency_response(to_control(space, pade=0), omega).complex)
    np.testing.assert_allclose(without * np.exp(-0.12j * omega), exact, rtol=1e-9)


def test_a_sensor_that_is_late_is_left_out_and_told() -> None:
    """The stick's own delay is told as one; a delay of a sensor is in no matrix."""
    model = model_of_file(LOES)
    late = compile_model(model.with_effects(find_effect("sensor-delay:q", model.equations)))
    space = state_space(late, {})
    assert set(space.delays) == {"stick"} and space.left_out == ("sensor-delay:q",)


def test_an_input_that_passes_through_is_delayed_as_well() -> None:
    import control

    space = built_in("navion_lateral")
    late = StateSpace(**{**space.__dict__, "delays": {"rudder": 0.1}})
    omega = np.array([1.0, 6.0])
    exact, found = (
        control.frequency_response(plant, omega).complex
        for plant in (to_control(space), to_control(late))
    )
    np.testing.assert_allclose(found[:, 0], exact[:, 0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        found[:, 1], exact[:, 1] * np.exp(-0.1j * omega), rtol=1e-5, atol=1e-8
    )
    assert np.max(np.abs(space.D[:, 1])) > 0.1


def test_a_point_without_slopes_is_refused() -> None:
    with pytest.raises(
        ModelError, match=r"no finite derivatives at airspeed 0, .*; choose another point"
    ):
        state_space(compile_model(true_model("longitudinal")), {})
    assert math.isfinite(state_space(compile_model(true_model("lateral")), {}).eigenvalues[0].real)
