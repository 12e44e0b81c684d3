"""Structural modes against the aircraft written a second time, and against the roots that its table
gives.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from sim.declaration.compile import compile_model
from sim.declaration.effect import full_name
from sim.declaration.model import Model, System
from sim.effects.disturbance.gusts import GustDiscrete
from sim.effects.dynamics.structural_mode import StructuralMode
from sim.errors import ModelError
from sim.maths import complex_step_jacobian
from tests.bases import fly_model, rigid_flight, rigid_model
from tests.oracles.flexible_aircraft import (
    FOOT,
    SPEED,
    flexible_aircraft,
    parameters_in_si,
    respond,
)

# Modes kept: pair of roots added and short period, rad/s, of AC1; short period of AC2 (half the
# frequencies).
ADDED = {
    0: -0.631 + 1.863j,
    1: -0.473 + 12.39j,
    2: -1.272 + 16.71j,
    3: -0.558 + 21.24j,
    4: -0.529 + 22.11j,
}
AC1_SHORT_PERIOD = -0.562 + 1.654j
AC2_SHORT_PERIOD = {1: -0.420 + 1.192j, 2: -0.400 + 1.037j, 3: -0.384 + 0.944j, 4: -0.384 + 0.944j}


def flexible_model(modes: int, frequency_factor: float = 1.0) -> Model:
    numbers = tuple(range(1, modes + 1))
    model = rigid_model().with_effects(*(StructuralMode(number, numbers) for number in numbers))
    return model.with_values(parameters_in_si(modes, frequency_factor))


def roots(system: System) -> np.ndarray:
    """Roots with positive imaginary part, slowest first."""
    p = [float(value) for value in system.parameters.values()]
    jacobian = complex_step_jacobian(
        lambda x: system.f(0.0, x, [0.0], p), [0.0] * len(system.states)
    )
    values = np.linalg.eigvals(jacobian)
    return np.array(sorted(values[values.imag > 0], key=abs))


def nearest(values: np.ndarray, wanted: complex) -> complex:
    return complex(values[np.argmin(np.abs(values - wanted))])


@pytest.mark.parametrize("modes", sorted(ADDED))
def test_roots_of_the_stiffer_aircraft_are_those_of_its_table(modes: int) -> None:
    found = roots(compile_model(flexible_model(modes)))
    root = nearest(found, ADDED[modes])
    assert (
        abs(root.real - ADDED[modes].real) <= 0.0006 and abs(root.imag - ADDED[modes].imag) <= 0.006
    )
    if modes == 4:
        assert abs(found[0] - AC1_SHORT_PERIOD) <= 0.0009


@pytest.mark.parametrize("modes", sorted(AC2_SHORT_PERIOD))
def test_roots_of_the_softer_aircraft_are_those_of_its_table(modes: int) -> None:
    assert (
        abs(roots(compile_model(flexible_model(modes, 0.5)))[0] - AC2_SHORT_PERIOD[modes]) <= 0.0009
    )


@pytest.mark.sampled
@pytest.mark.parametrize(("modes", "factor"), [(0, 1.0), (1, 1.0), (4, 1.0), (4, 0.5)])
def test_response_is_that_of_the_second_writing(modes: int, factor: float) -> None:
    flight = dataclasses.replace(rigid_flight(), max_step=0.0025)
    expected = respond(flexible_aircraft(modes, factor), flight.time, flight.u[0])
    for got, wanted in zip(fly_model(flexible_model(modes, factor), flight), expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=2e-7 * np.max(np.abs(wanted)))


def test_roots_are_those_of_the_second_writing_to_rounding() -> None:
    values = np.linalg.eigvals(flexible_aircraft(4).A)
    for root in roots(compile_model(flexible_model(4))):
        assert abs(root - nearest(values, root)) < 1e-8


def test_a_gust_bends_the_structure_as_in_the_second_writing() -> None:
    flight = dataclasses.replace(rigid_flight(), max_step=0.0025)
    peak, start, duration = 4.0, 1.23, 0.77
    model = flexible_model(2).with_effects(GustDiscrete())
    model = model.with_values(
        {
            "gust-discrete.peak": peak,
            "gust-discrete.start": start,
            "gust-discrete.duration": duration,
        }
    )

    def angle(t: float) -> float:
        inside = start < t < start + duration
        return (
            peak * np.sin(np.pi * (t - start) / duration) ** 2 / (SPEED * FOOT) if inside else 0.0
        )

    expected = respond(flexible_aircraft(2), flight.time, flight.u[0], angle)
    for got, wanted in zip(fly_model(model, flight), expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-6 * np.max(np.abs(wanted)))


def test_full_names_carry_the_number_of_the_mode() -> None:
    mode = StructuralMode(2, (1, 2))
    names = [full_name(mode, item.name) for item in mode.parameters]
    assert names == [
        *(
            "omega2",
            "zeta2",
            "generalized_mass2",
            "CL_eta2",
            "CL_etadot2",
            "Cm_eta2",
            "Cm_etadot2",
            "Ceta2_alpha",
            "Ceta2_q",
            "Ceta2_de",
        ),
        *("Ceta2_eta1", "Ceta2_etadot1", "Ceta2_eta2", "Ceta2_etadot2"),
    ]
    assert not mode.parameters[2].free and mode.parameters[2].unit == "kg m2"


def test_a_mode_that_was_taken_out_couples_no_longer() -> None:
    flight = rigid_flight(3.0)
    truncated = flexible_model(2).without("elastic-mode:2")
    for got, wanted in zip(
        fly_model(truncated, flight), fly_model(flexible_model(1), flight), strict=True
    ):
        np.testing.assert_array_equal(got, wanted)


@pytest.mark.parametrize(("number", "modes"), [(0, (0,)), (2, (1,)), (1, (1, 1))])
def test_wrong_numbers_are_refused(number: int, modes: tuple[int, ...]) -> None:
    with pytest.raises(ModelError, match="number modes from 1"):
        StructuralMode(number, modes)
