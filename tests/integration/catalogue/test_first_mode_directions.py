"""The fifteen parameters of the first-mode model: alpha and q show twelve numbers of them, whatever
the maneuver.
"""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.studies.catalogue import load_scenario
from scenarios.studies.study import references
from sim.vehicles.factory import flexible_model, linearise, zero_order_hold_response
from sim.vehicles.library import read_parameter_set


def sensitivities(outputs: tuple[str, ...]) -> np.ndarray:
    """Response per prior standard deviation of each parameter, one column each."""
    scenario = load_scenario("flexible-ac2-first-mode")
    estimation = scenario.estimations[0]
    model = flexible_model(read_parameter_set("bomber_ac2"), 1).with_values(
        references(scenario, estimation)
    )
    elevator = 0.1 * np.sign(np.random.default_rng(3).standard_normal(40)).repeat(20)

    def response(name: str, change: float) -> np.ndarray:
        value = model.parameters[name].value + change
        return zero_order_hold_response(
            linearise(model.with_values({name: value}), outputs), elevator, 0.01
        ).ravel()

    sizes = {name: 1e-4 * start.std for name, start in estimation.start.items()}
    return np.array(
        [(response(name, size) - response(name, -size)) / 2e-4 for name, size in sizes.items()]
    ).T


@pytest.mark.parametrize("outputs", [("alpha", "q"), ("alpha", "q", "nz")])
def test_three_directions_leave_the_outputs_as_they_are(outputs: tuple[str, ...]) -> None:
    values = np.linalg.svd(sensitivities(outputs), compute_uv=False)
    assert len(values) == 15
    assert values[11] > 1e-5 * values[0]
    assert values[12] < 1e-8 * values[0]
    assert values[12] < 1e-3 * values[11]
