"""Parameters of a user's own model that change at one time: groups, sizes, and the flight against
SciPy's integrator.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from scenarios.diagnosis.opening import candidates_for
from scenarios.files.user_models import read_user_model
from sim.declaration.proposal import SearchContext
from sim.effects.dynamics.derivative_jump import (
    LARGEST_CHANGE_SHARE,
    USUAL_CHANGE_SHARE,
    ParameterJump,
)
from sim.effects.library import effects_for
from sim.vehicles.aircraft import aircraft_model
from sim.vehicles.uncoupled import ShortPeriod
from tests.airliner import AIRLINER, COEFFICIENTS
from tests.bases import RIGID_VALUES, Flight, fly_model
from tests.oracles.varying_parameters import spring
from tests.own_models import ROLL_AND_YAW, SPRING, model_file, own_rigid


def jumps(effects: Iterable[object]) -> dict[str, ParameterJump]:
    return {each.name: each for each in effects if isinstance(each, ParameterJump)}


def test_what_acts_through_one_port_is_one_group(tmp_path: Path) -> None:
    found = jumps(effects_for(read_user_model(model_file(tmp_path, ROLL_AND_YAW)).model.equations))
    assert {name: each.group for name, each in found.items()} == {
        "derivative-jump:p_rate": ("L_p", "L_beta", "L_da"),
        "derivative-jump:r_rate": ("N_r", "N_beta", "N_dr"),
        "derivative-jump:beta_rate": ("Y",),
    }
    assert {*jumps(effects_for(own_rigid(RIGID_VALUES).equations))} == {
        "derivative-jump:alpha_rate",
        "derivative-jump:q_rate",
    }
    assert not jumps(effects_for(ShortPeriod()))


def test_a_group_of_an_aircraft_is_the_derivatives_of_one_coefficient() -> None:
    """Each rate knows several coefficients; constants that jump are another effect's."""
    found = jumps(effects_for(aircraft_model(AIRLINER).equations))
    wanted = {
        axis: {f"{axis}_{term}" for term in terms if term != "1"}
        for axis, terms in COEFFICIENTS.items()
    }
    told = {name.partition(":")[2]: {*each.group} for name, each in found.items()}
    spelled = {
        axis: {name.replace("^", "").replace("*", "_") for name in names}
        for axis, names in wanted.items()
    }
    assert told == spelled


def test_a_group_is_offered_only_where_all_of_it_is_estimated(tmp_path: Path) -> None:
    model = read_user_model(model_file(tmp_path, SPRING)).model
    assert "derivative-jump" in jumps(candidates_for(model))
    assert not jumps(candidates_for(model.with_parameters(model.parameters.hold(["c"]))))


def test_sizes_follow_the_declared_values() -> None:
    jump = ParameterJump((("k", "N/m"), ("c", "N s/m")))
    assert not jump.traits.plausible, "of an unknown size any is believed"
    known = jump.fitted_to(SearchContext(0.0, 9.0, 0.05, values={"k": -40.0, "c": 1.0}))
    assert known.sizes == (
        USUAL_CHANGE_SHARE * 40.0,
        USUAL_CHANGE_SHARE,
    ) and known.traits.plausible["k"] == pytest.approx(
        (-LARGEST_CHANGE_SHARE * 40.0, LARGEST_CHANGE_SHARE * 40.0)
    )
    assert not jump.fitted_to(SearchContext(0.0, 9.0, 0.05, values={"k": -40.0, "c": 0.0})).sizes


def test_a_spring_that_slackens_flies_as_another_simulator_says(tmp_path: Path) -> None:
    """Before the time as declared, after it with the change, in rate and reading alike."""
    model = read_user_model(model_file(tmp_path, SPRING)).model
    record = spring(lambda x: 50.0, 1, extra=lambda t, x, f: 15.0 * x[0] * (t > 8.0))
    jump = jumps(effects_for(model.equations))["derivative-jump"].fitted_to(
        SearchContext(0.0, 20.0, 1e-4)
    )
    flight = Flight(record.time, np.array([channel.values for channel in record.inputs]))
    plain = np.array(fly_model(model, flight))
    flown = np.array(
        fly_model(
            model.with_effects(jump).with_values(
                {f"{jump.name}.time": 8.0, f"{jump.name}.k": -15.0, f"{jump.name}.c": 0.0}
            ),
            flight,
        )
    )
    measured = np.array([channel.values for channel in record.outputs])
    for row, std in zip(flown - measured, (0.003, 0.05), strict=True):
        assert np.sqrt(np.mean(row**2)) == pytest.approx(std, rel=0.15)
    np.testing.assert_array_equal(plain[:, record.time < 7.9], flown[:, record.time < 7.9])
    gone = model.with_effects(jump).with_values({f"{jump.name}.{name}": 0.0 for name in jump.group})
    np.testing.assert_array_equal(np.array(fly_model(gone, flight)), plain)
