"""Condensing the upper modes only: limits, stages, and the responses it must keep."""

from __future__ import annotations

import numpy as np
import pytest

from sim.errors import ModelError
from sim.vehicles.factory import flexible_model, frequency_response, linearise
from sim.vehicles.flexibility import condense, condense_above
from sim.vehicles.library import read_parameter_set

vehicles = pytest.mark.parametrize("vehicle", ["bomber_ac1", "bomber_ac2"])


@vehicles
def test_with_no_mode_kept_it_is_static_condensation(vehicle: str) -> None:
    values = read_parameter_set(vehicle).values
    assert condense_above(values, 4, 0) == pytest.approx(condense(values, 4).derivatives, rel=1e-12)


@vehicles
def test_with_all_modes_kept_nothing_changes(vehicle: str) -> None:
    values = read_parameter_set(vehicle).values
    assert all(value == values[name] for name, value in condense_above(values, 4, 4).items())


@vehicles
@pytest.mark.parametrize("kept", [1, 2, 3])
def test_in_two_stages_as_in_one(vehicle: str, kept: int) -> None:
    values = read_parameter_set(vehicle).values
    between = {**values, **condense_above(values, 4, kept)}
    assert condense_above(between, kept, 0) == pytest.approx(
        condense_above(values, 4, 0), rel=1e-10
    )


@vehicles
def test_the_reduced_aircraft_answers_a_steady_elevator_alike_and_a_slow_one_nearly(
    vehicle: str,
) -> None:
    data = read_parameter_set(vehicle)
    whole = linearise(flexible_model(data, 4), ("alpha", "q"))
    reduced = linearise(
        flexible_model(data, 1).with_values(condense_above(data.values, 4, 1)), ("alpha", "q")
    )
    error = {
        omega: np.max(
            np.abs(frequency_response(reduced, omega) / frequency_response(whole, omega) - 1.0)
        )
        for omega in (1e-9, 0.1, 0.4)
    }
    assert error[1e-9] < 1e-6
    assert error[1e-9] < error[0.1] < error[0.4] < 0.1


def test_more_modes_kept_than_there_are() -> None:
    with pytest.raises(ModelError, match="5 modes kept of 4"):
        condense_above(read_parameter_set("bomber_ac1").values, 4, 5)
