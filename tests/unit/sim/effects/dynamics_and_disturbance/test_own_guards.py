"""Guards made for a user's own model: which they are, what they add, and that absent they add
nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from scenarios.files.units import to_si
from sim.declaration import own_model
from sim.declaration.effect import Effect, full_name
from sim.declaration.model import Model
from sim.declaration.proposal import SearchContext
from sim.effects.guards.further_loads import LaggedLoads
from sim.effects.library import catch_all_terms_for
from sim.errors import DeclarationError
from tests.bases import RIGID_VALUES, Flight, fly_model
from tests.offered import ALL_VEHICLES
from tests.own_models import own_rigid
from tests.own_models import spring_mass as spring

TIME = np.arange(0.0, 4.0, 0.02)
FORCE = 20.0 * ((TIME > 0.5) & (TIME < 1.5)) - 15.0 * ((TIME > 2.0) & (TIME < 2.6))


def outputs(model: Model, *effects: Effect, **values: float) -> np.ndarray:
    flown = model.with_effects(*effects)
    absent = {
        full_name(effect, name): value
        for effect in effects[1:]
        for name, value in effect.absent.items()
    }
    named = absent | {full_name(effects[0], name): value for name, value in values.items()}
    return np.array(fly_model(flown.with_values(named), Flight(TIME, FORCE[None], max_step=0.004)))


def expected(
    extra: Callable[[float, np.ndarray, float], float], felt: bool, further: int = 0
) -> np.ndarray:
    """The same spring by SciPy: ``extra`` N beside the recorded force, which the accelerometer
    feels or does not; a lag of .4 s of x.
    """
    x, out = np.zeros(2 + further), []
    for k, f in enumerate(FORCE):
        push = extra(TIME[k], x, f)
        out.append([x[0], (f + (push if felt else 0.0) - 1.3 * x[1] - 40.0 * x[0]) / 2.0])
        if k < len(TIME) - 1:

            def rates(t: float, y: np.ndarray, f: float = f) -> list[float]:
                late = [(y[0] - y[2]) / 0.4] if further else []
                return [y[1], (f + extra(t, y, f) - 1.3 * y[1] - 40.0 * y[0]) / 2.0, *late]

            x = solve_ivp(rates, (TIME[k], TIME[k + 1]), x, rtol=1e-10, atol=1e-12).y[:, -1]
    return np.array(out).T


def guard(model: Model, name: str) -> Any:
    (found,) = [each for each in catch_all_terms_for(model.equations) if each.name == name]
    return found


def names(model: Model) -> set[str]:
    return {each.name.removeprefix("guard:") for each in catch_all_terms_for(model.equations)}


def test_products_that_no_parameter_stands_for_are_guarded() -> None:
    """Stiffness and damping multiply displacement and speed, so that only the force's own square is
    left to the guard of the load.
    """
    model = spring(ports={"load": "N"})
    assert names(model) == {"lagged-loads:x", "lagged-loads:v", "periodic-loads", "force-force"}
    rates = spring()
    assert names(rates) == names(model) | {"x-x", "x-v", "x-force", "v-v", "v-force"}
    assert guard(rates, "guard:x-v").ports == ("x_rate",) and guard(
        rates, "guard:force-force"
    ).ports == ("x_rate", "v_rate")


def test_several_rates_swing_each_by_itself() -> None:
    rigid = own_rigid(RIGID_VALUES)
    assert guard(rigid, "guard:periodic-loads").ports == ("alpha_rate", "q_rate")
    three = own_model(
        name="three tanks",
        states={"a": "m", "b": "m", "c": "m"},
        inputs={"inflow": "m/s"},
        outputs={"c": "m"},
        parameters={"k1": (0.1, "1/s"), "k2": (0.2, "1/s"), "k3": (0.3, "1/s")},
        rates=lambda s, p: {
            "a": s.inflow - p.k1 * s.a,
            "b": p.k1 * s.a - p.k2 * s.b,
            "c": p.k2 * s.b - p.k3 * s.c,
        },
        readings=lambda s, p: {"c": s.c},
    )
    assert {name for name in names(three) if name.startswith("periodic")} == {
        f"periodic-loads:{name}_rate" for name in "abc"
    }
    assert guard(three, "guard:lagged-loads:a").ports == ("a_rate", "b_rate")


@pytest.mark.sampled
@pytest.mark.parametrize("felt", [True, False])
def test_they_are_the_terms_that_they_name(felt: bool) -> None:
    """A declared port adds to the force that the accelerometer feels; the port of a rate adds to
    the rate alone.
    """
    model, port, share = (
        (spring(ports={"load": "N"}), "load", 1.0) if felt else (spring(), "v_rate", 0.5)
    )
    square = outputs(
        model,
        replace(guard(model, "guard:force-force"), ports=(port,), units=("1",), sizes=(1.0,)),
        **{port: 0.03 * share},
    )
    np.testing.assert_allclose(square, expected(lambda t, x, f: 0.03 * f * f, felt), atol=2e-6)
    swinging = outputs(
        model,
        guard(model, "guard:periodic-loads"),
        frequency=7.0,
        **{f"{port}_cos": 3.0 * share, f"{port}_sin": -2.0 * share},
    )
    np.testing.assert_allclose(
        swinging,
        expected(lambda t, x, f: 3.0 * np.cos(7.0 * t) - 2.0 * np.sin(7.0 * t), felt),
        atol=2e-6,
    )
    late = outputs(model, guard(model, "guard:lagged-loads:x"), lag=0.4, **{port: -25.0 * share})
    np.testing.assert_allclose(
        late, expected(lambda t, x, f: -25.0 * (x[0] - x[2]), felt, 1), atol=2e-6
    )


def test_absent_they_add_nothing_and_their_units_are_known() -> None:
    for model in (spring(), spring(ports={"load": "N"}), own_rigid(RIGID_VALUES)):
        for each in catch_all_terms_for(model.equations):
            for item in each.parameters:
                assert np.isfinite(to_si(1.0, item.unit, item.unit, each.name, DeclarationError)), (
                    item.unit
                )
    plain = outputs(spring())
    for each in catch_all_terms_for(spring().equations):
        assert np.array_equal(outputs(spring(), each, **each.absent), plain), each.name


def test_a_lag_of_a_state_called_late_angle_and_two_lags_at_once() -> None:
    """What is late has a name that no signal of the user can have, and each guard its own."""
    model = own_model(
        name="vane",
        states={"late_angle": "rad", "w": "rad"},
        inputs={"push": "1/s"},
        outputs={"late_angle": "rad", "w": "rad"},
        parameters={"a": (1.3, "1/s"), "b": (0.7, "1/s")},
        flow=lambda s, p: {"late": -p.b * s.w},
        rates=lambda s, p: {"late_angle": s.push - p.a * s.late_angle, "w": s.late_angle + s.late},
        readings=lambda s, p: {"late_angle": s.late_angle, "w": s.w},
    )
    first, second = (
        guard(model, "guard:lagged-loads:late_angle"),
        guard(model, "guard:lagged-loads:w"),
    )
    flown = outputs(model, first, second, lag=0.4, late_angle_rate=0.5)

    def rates(t: float, y: np.ndarray, f: float) -> list[float]:
        return [f - 1.3 * y[0] + 0.5 * (y[0] - y[2]), y[0] - 0.7 * y[1], (y[0] - y[2]) / 0.4]

    x, rows = np.zeros(3), []
    for k, f in enumerate(FORCE):
        rows.append(x[:2])
        if k < len(TIME) - 1:
            x = solve_ivp(rates, (TIME[k], TIME[k + 1]), x, args=(f,), rtol=1e-10, atol=1e-12).y[
                :, -1
            ]
    np.testing.assert_allclose(flown, np.array(rows).T, atol=2e-6)


def test_a_lag_counts_from_the_middle_of_what_was_flown() -> None:
    """Else a state that stays far from zero would begin with a jump."""
    late = guard(spring(), "guard:lagged-loads:x").fitted_to(
        SearchContext(0.0, 4.0, 0.02, flown={"x": (9.0, 13.0)})
    )
    assert isinstance(late, LaggedLoads) and late.middle == 11.0


def test_the_built_in_models_have_theirs_from_the_files_alone() -> None:
    for vehicle in ALL_VEHICLES:
        listed = {each.name for each in catch_all_terms_for(vehicle)}
        assert not any(
            name.startswith(("guard:lagged-loads:", "guard:periodic-loads:")) for name in listed
        )
