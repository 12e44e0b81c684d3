"""Declaring models: effects and biases come and go, wrong declarations are told by name."""

from __future__ import annotations

import math

import pytest

from sim.declaration.effect import ParameterSet
from sim.declaration.model import Model, Noise
from sim.effects.dynamics.structural_mode import StructuralMode
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.errors import ModelError
from sim.vehicles.uncoupled import ShortPeriod
from tests.bases import rigid_model


def test_an_effect_brings_its_parameters_under_full_names() -> None:
    model = rigid_model().with_effects(InputDelay(), SensorLag("q"), StructuralMode(2, (2,)))
    added = model.parameters.names[len(rigid_model().parameters) :]
    assert added[:4] == ("input-delay.delay", "sensor-lag:q.time_constant", "omega2", "zeta2")
    assert model.parameters["input-delay.delay"].bounds == (0.0, 2.0)
    assert [effect.name for effect in model.effects] == [
        "input-delay",
        "sensor-lag:q",
        "elastic-mode:2",
    ]


def test_with_and_without_is_the_model_itself() -> None:
    model = rigid_model()
    both = model.with_effects(InputDelay(), SensorLag("q"))
    assert both.without("input-delay").without("sensor-lag:q") == model
    assert both.without("input-delay") == model.with_effects(SensorLag("q"))
    assert model.effects == ()


def test_an_effect_acts_once() -> None:
    with pytest.raises(ModelError, match="model rigid: effect input-delay acts already"):
        rigid_model().with_effects(InputDelay(), InputDelay())
    assert len(rigid_model().with_effects(SensorLag("q"), SensorLag("nz")).effects) == 2


def test_taking_out_what_is_not_there_names_what_is() -> None:
    with pytest.raises(ModelError, match="there is no effect 'gust'; it has input-delay"):
        rigid_model().with_effects(InputDelay()).without("gust")
    with pytest.raises(ModelError, match="it has none"):
        rigid_model().without("gust")


def test_a_missing_parameter_is_named() -> None:
    model = rigid_model()
    fewer = ParameterSet(tuple(item for item in model.parameters if item.name != "Cm_q"))
    with pytest.raises(ModelError, match="model rigid, Cm_q: parameter is missing"):
        Model(ShortPeriod(), fewer, model.initial)


def test_biases_are_free_parameters_in_the_outputs_unit() -> None:
    model = rigid_model().with_biases(["q", "nz"], prior_std=0.2).with_biases(["nz"])
    assert model.biases == ("q", "nz") and model.parameters["bias_nz"].unit == "g"
    assert model.parameters["bias_q"].free and model.parameters["bias_q"].prior_std == 0.2
    with pytest.raises(
        ModelError, match="there is no output 'altitude'; its outputs are alpha, q, nz"
    ):
        model.with_biases(["altitude"])


def test_values_noise_and_initial_state_are_replaced_in_a_copy() -> None:
    model = rigid_model()
    other = (
        model.with_values({"Cm_q": -20.0})
        .with_noise(Noise({"q": 0.1}))
        .with_initial(model.initial.with_values({"alpha": 0.05}))
    )
    assert (
        other.parameters["Cm_q"].value,
        other.noise.measurement_std["q"],
        other.initial["alpha"].value,
    ) == (-20.0, 0.1, 0.05)
    assert (model.parameters["Cm_q"].value, model.initial["alpha"].value) == (-34.75, 0.0)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_noise_has_a_positive_standard_deviation(value: float) -> None:
    with pytest.raises(ModelError, match="output q: noise standard deviation"):
        Noise({"q": value})


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_process_noise_is_not_negative(value: float) -> None:
    with pytest.raises(ModelError, match="beta: process noise density"):
        Noise(process_density={"beta": value})
    assert Noise(process_density={"beta": 0.0}).process_density["beta"] == 0.0
