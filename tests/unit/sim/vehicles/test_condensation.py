"""Static condensation against reference values and against the aircraft's own static solution; the
degree of flexibility.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.errors import ModelError
from sim.maneuvers import three_two_one_one
from sim.vehicles.factory import (
    RIGID_DERIVATIVES,
    flexible_model,
    frequency_response,
    linearise,
    rigid_model,
    zero_order_hold_response,
)
from sim.vehicles.flexibility import Flexibility, condense, flexibility
from sim.vehicles.library import VehicleData, read_parameter_set
from tests.oracles.quasi_static import quasi_static_error

ELEVATOR = three_two_one_one(0.10471, 0.5, 1.0)(np.arange(801) * 0.01)
NOISE = math.radians(math.sqrt(0.016))

TABLE = {
    ("bomber_ac1", 0): ("2.922", "-1.660", "-34.75", "-2.578"),
    ("bomber_ac1", 1): ("2.721", "-1.437", "-33.3", "-2.386"),
    ("bomber_ac1", 2): ("2.490", "-1.330", "-33.3", "-2.397"),
    ("bomber_ac1", 3): ("2.479", "-1.303", "-33.1", "-2.376"),
    ("bomber_ac1", 4): ("2.478", "-1.303", "-33.1", "-2.376"),
    ("bomber_ac2", 0): ("2.922", "-1.660", "-34.75", "-2.578"),
    ("bomber_ac2", 1): ("2.047", "-0.688", "-28.6", "-1.743"),
    ("bomber_ac2", 2): ("1.700", "-0.524", "-28.9", "-1.827"),
    ("bomber_ac2", 3): ("1.654", "-0.431", "-28.1", "-1.760"),
    ("bomber_ac2", 4): ("1.654", "-0.431", "-28.1", "-1.760"),
}


@pytest.mark.parametrize(("name", "modes"), TABLE)
def test_equivalents_are_those_of_the_reference_to_its_digits(name: str, modes: int) -> None:
    # The reference was computed with Ceta1_de rounded to -0.0128; only Cm_de shows it, in the third
    # digit after the point.
    found = condense({**read_parameter_set(name).values, "Ceta1_de": -0.0128}, modes).derivatives
    for key, text in zip(
        ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de"), TABLE[name, modes], strict=True
    ):
        digits = len(text.partition(".")[2])
        assert found[key] == pytest.approx(float(text), abs=0.5001 * 10**-digits), key
    unrounded = condense(read_parameter_set(name).values, modes).derivatives
    assert unrounded["Cm_de"] == pytest.approx(found["Cm_de"], abs=0.0035)


@pytest.mark.parametrize("modes", [0, 1, 2, 3, 4])
def test_condensed_and_flexible_aircraft_agree_at_rest_of_the_structure(modes: int) -> None:
    data = read_parameter_set("bomber_ac2")
    condensed = rigid_model(data).with_values(condense(data.values, modes).derivatives)
    over, under = (
        frequency_response(linearise(model), 0.0)
        for model in (flexible_model(data, modes), condensed)
    )
    # At zero frequency the modal rates vanish, so both are the same equilibrium.
    assert over == pytest.approx(under, rel=1e-9)


@given(factor=st.floats(1.0, 30.0))
def test_stiffer_structures_come_nearer_to_the_rigid_aircraft(factor: float) -> None:
    values = dict(read_parameter_set("bomber_ac1").values)
    soft = condense(values, 4)
    stiff = condense(
        {**values, **{f"omega{i}": values[f"omega{i}"] * factor for i in range(1, 5)}}, 4
    )
    for name in RIGID_DERIVATIVES:
        assert abs(stiff.change[name]) <= abs(soft.change[name]) + 1e-12
    assert soft.divergence_margin - 1e-12 <= stiff.divergence_margin <= 1.0


def test_no_modes_change_nothing() -> None:
    values = read_parameter_set("bomber_ac1").values
    none = condense(values, 0)
    assert none.derivatives == {name: values[name] for name in RIGID_DERIVATIVES}
    assert none.deflection.shape == (0, 3)
    assert none.divergence_margin == 1.0


def test_divergence_is_refused() -> None:
    values = {**read_parameter_set("bomber_ac1").values, "Ceta2_eta2": 30.0}
    with pytest.raises(ModelError, match="static divergence"):
        condense(values, 4)


def scaled(factor: float) -> VehicleData:
    data = read_parameter_set("bomber_ac1")
    return replace(
        data,
        numbers=tuple(
            replace(n, value=n.value * factor) if n.name.startswith("omega") else n
            for n in data.numbers
        ),
    )


def figures(data: VehicleData) -> Flexibility:
    return flexibility(data, ELEVATOR, 0.01, {"alpha": NOISE, "q": NOISE})


@pytest.fixture(scope="module")
def ac1() -> Flexibility:
    return figures(read_parameter_set("bomber_ac1"))


@pytest.fixture(scope="module")
def ac2() -> Flexibility:
    return figures(read_parameter_set("bomber_ac2"))


def test_rigid_model_serves_for_the_first_aircraft_and_not_for_the_second(
    ac1: Flexibility, ac2: Flexibility
) -> None:
    assert ac1.rigid_serves
    assert ac1.misfit > ac1.detectable
    assert not ac2.rigid_serves
    assert [ac1.degree, ac2.degree] == pytest.approx([0.0296, 0.1603], abs=5e-5)
    assert [ac1.misfit, ac2.misfit] == pytest.approx([0.69, 9.62], abs=0.006)


def test_best_rigid_model_explains_more_than_the_condensed_one(
    ac1: Flexibility, ac2: Flexibility
) -> None:
    for one, data in (
        (ac1, read_parameter_set("bomber_ac1")),
        (ac2, read_parameter_set("bomber_ac2")),
    ):
        flexible = zero_order_hold_response(
            linearise(flexible_model(data), ("alpha", "q")), ELEVATOR, 0.01
        )
        best = zero_order_hold_response(
            linearise(rigid_model(data).with_values(one.fitted), ("alpha", "q")), ELEVATOR, 0.01
        )
        assert math.sqrt(np.mean((flexible - best) ** 2)) / NOISE == pytest.approx(
            one.misfit, rel=1e-9
        )
        assert one.misfit * math.sqrt(flexible.size) < one.distance


def test_quasi_static_error_grows_with_frequency_and_falls_with_the_square_of_stiffness() -> None:
    soft, stiff = scaled(3.0), scaled(6.0)
    for omega in (0.1, 2.0, 5.0):
        assert quasi_static_error(soft, omega) / quasi_static_error(stiff, omega) == pytest.approx(
            4.0, rel=0.05
        )
    assert quasi_static_error(stiff, 0.2) / quasi_static_error(stiff, 0.1) == pytest.approx(
        2.0, rel=0.03
    )
    assert quasi_static_error(read_parameter_set("bomber_ac1"), 1e-6) < 1e-6


def test_every_figure_falls_as_the_structure_stiffens() -> None:
    series = [figures(scaled(factor)) for factor in (0.5, 0.7, 1.0, 2.0, 4.0)]
    for name in ("stiffness_loss", "degree", "distance", "misfit"):
        values = [getattr(one, name) for one in series]
        assert values == sorted(values, reverse=True)
    assert series[-1].distance < 4.0


def test_without_modes_there_is_no_flexibility() -> None:
    none = flexibility(read_parameter_set("bomber_rigid"), ELEVATOR, 0.01, {"alpha": NOISE})
    assert none.stiffness_loss == pytest.approx(0.0, abs=1e-12)
    assert none.separation == math.inf
    assert none.degree < 1e-12
    assert none.misfit < 1e-9
    assert none.rigid_serves


def test_bad_questions_are_refused() -> None:
    with pytest.raises(ModelError, match="no output is named"):
        flexibility(read_parameter_set("bomber_ac1"), ELEVATOR, 0.01, {})
    with pytest.raises(ModelError, match="no oscillatory short period"):
        figures(scaled(0.42))
