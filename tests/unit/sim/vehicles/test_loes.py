"""The low-order equivalent system against a second writing in the paper's own signs, and its way
from numbers to models.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.errors import DeclarationError, ModelError
from sim.vehicles.factory import LOES_OFFSETS, loes_filter_model, model_from_constants
from tests.bases import LOES_CONSTANTS, LOES_VALUES, Flight, fly, loes_flight, loes_model
from tests.oracles.loes import exact_response, rates_and_readings

OFFSETS = {"L_0": 0.003, "M_0": -0.05, "delta_0": 0.2, "nz_0": 1.0}
number = st.floats(-2.0, 2.0)


def full_model() -> Model:
    return model_from_constants("loes", LOES_CONSTANTS, {**LOES_VALUES, **OFFSETS})


@given(number, number, number, number)
def test_equations_are_the_papers_with_the_pseudo_control_turned(
    alpha: float, q: float, delta: float, stick: float
) -> None:
    system = compile_model(full_model())
    p = list(system.parameters.values())
    rates, readings = rates_and_readings(
        {**LOES_CONSTANTS, **LOES_VALUES, **OFFSETS}, alpha, q, delta, stick
    )
    np.testing.assert_allclose(
        system.f(0.0, [alpha, q, delta], [stick], p), rates, rtol=1e-12, atol=1e-11
    )
    np.testing.assert_allclose(
        system.h(0.0, [alpha, q, delta], [stick], p), readings, rtol=1e-12, atol=1e-11
    )


def test_a_maneuver_is_the_exact_one() -> None:
    flight = loes_flight()
    outputs = fly(compile_model(full_model()), Flight(flight.time, flight.u, max_step=0.002))
    exact = exact_response({**LOES_CONSTANTS, **LOES_VALUES, **OFFSETS}, flight.u[0], 0.02, 6)
    for got, expected in zip(outputs, exact, strict=True):
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-8 * np.max(np.abs(expected)))


def test_nose_up_stick_gives_nose_up_motion_and_more_lift() -> None:
    alpha, q, nz = fly(compile_model(loes_model()), loes_flight())
    early = slice(70, 90)
    assert q[early].min() > 0 and alpha[early].max() > 0 and nz[early].max() > 0


def test_delay_has_its_plain_name_and_moves_the_response() -> None:
    model = loes_model()
    assert "delay" in model.parameters.names and model.parameters["delay"].bounds == (0.0, 2.0)
    assert not [name for name in model.parameters.names if "." in name]
    base = fly(compile_model(model), loes_flight())
    later = fly(
        compile_model(model.with_values({"delay": LOES_VALUES["delay"] + 0.04})), loes_flight()
    )
    for row, moved in zip(base, later, strict=True):
        np.testing.assert_allclose(moved[2:], row[:-2], atol=1e-12 * np.max(np.abs(row)))


def test_gauges_of_fit_and_filter() -> None:
    fit = model_from_constants("loes", LOES_CONSTANTS, LOES_VALUES)
    assert fit.parameters.free_names == (
        *(name for name in LOES_VALUES if name != "delay"),
        "delay",
    )
    assert [fit.parameters[name].value for name in LOES_OFFSETS] == [0.0] * 4
    filtered = loes_filter_model(fit)
    system = compile_model(filtered, online=True)
    assert len(system.states) + len(system.parameters.free_names) == 14
    assert set(system.parameters.free_names) == {
        name for name in LOES_VALUES if name != "delay"
    } | set(LOES_OFFSETS)


def test_vane_is_at_the_centre_of_gravity_unless_told() -> None:
    constants = {name: value for name, value in LOES_CONSTANTS.items() if name != "vane_arm"}
    system = compile_model(model_from_constants("loes", constants, LOES_VALUES))
    assert system.h(0.0, [0.1, 0.3, 0.0], [0.0], list(system.parameters.values()))[0] == 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inv_tau": -1.0}, "inv_tau: -1 1/s is negative"),
        ({"delay": -0.1}, "delay: -0.1 s is negative"),
        ({"Cm_q": 1.0}, "unknown number Cm_q"),
    ],
)
def test_wrong_numbers_are_refused_by_name(change: dict[str, float], message: str) -> None:
    with pytest.raises(DeclarationError, match=message):
        model_from_constants("loes", LOES_CONSTANTS, {**LOES_VALUES, **change})


def test_missing_numbers_are_named() -> None:
    for name in LOES_VALUES:
        with pytest.raises(DeclarationError, match=f"the number {name} is missing"):
            model_from_constants(
                "loes",
                LOES_CONSTANTS,
                {key: value for key, value in LOES_VALUES.items() if key != name},
            )


def test_an_elastic_mode_is_refused_for_want_of_a_chord() -> None:
    from sim.effects.dynamics.elastic_mode import ElasticMode

    model = loes_model()
    if "chord" in ElasticMode.needs_constants:
        with pytest.raises(ModelError, match="needs the constant 'chord'"):
            model.with_effects(ElasticMode())
