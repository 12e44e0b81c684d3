"""A vane at an arm and an accelerometer at minus that arm: one record, two readings, and the declared derivatives between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.diagnosis import Diagnosis, Quantity, Verdict
from ident.tracing.equivalents import misfit_to_declared, same_by_value, told_by_declared
from ident.tracing.loop import diagnose
from ident.tracing.ranking.choice import Choice
from ident.tracing.validation.held_out import HeldOut
from ident.tracing.verdict import claims_of
from sim.declaration.model import Model
from sim.effects.disturbance.phugoid import EVEN_CHANGE, Phugoid
from sim.effects.guards.vane_behind import VaneBehind
from sim.effects.sensor_path.accelerometer_offset import AccelerometerOffset
from sim.effects.sensor_path.vane_offset import VaneOffset
from sim.record import Record
from tests.bases import RIGID_VALUES, rigid_model
from tests.rigid_problem import noisy
from tests.tracing_problem import OUTPUTS, SETTINGS, declared, doublets, fit_of, planted, problem_of

VANE, ACCELEROMETER = "vane-offset", "accelerometer-offset:nz"
BOTH = (VaneOffset(), AccelerometerOffset())
ARM = 9.0
CL_DE = RIGID_VALUES["CL_de"]


def diagnosed(record: Record, model: Model | None = None) -> Diagnosis:
    return diagnose([record], model or declared(), BOTH, (VaneBehind(),), (), SETTINGS)


def with_vane(arm: float, seed: int = 1) -> Record:
    return planted([VaneOffset()], {"vane-offset.arm": arm}, seed)


def with_accelerometer(arm: float, seed: int = 1) -> Record:
    return planted([AccelerometerOffset()], {f"{ACCELEROMETER}.arm": arm}, seed)


@pytest.mark.parametrize(
    ("record", "name", "other"),
    [(with_vane(ARM), VANE, ACCELEROMETER), (with_accelerometer(-ARM), ACCELEROMETER, VANE)],
    ids=["vane", "accelerometer"],
)
def test_each_is_named_with_the_other_beside_it_and_both_sets_of_derivatives(record: Record, name: str, other: str) -> None:
    d = diagnosed(record)
    (claim,) = d.effects
    assert (d.verdict, claim.name, claim.alternatives) == (Verdict.TRACED, name, (other,))
    under = claim.derivatives_under
    assert list(under) == [name, other] and under[name] == d.after
    right, wrong = under[name]["CL_de"], under[other]["CL_de"]
    assert abs(right.value - CL_DE) < 3.0 * right.std < 0.5
    assert abs(wrong.value - CL_DE) > 20.0 * wrong.std


def test_an_accelerometer_ahead_has_no_other_reading_in_the_library() -> None:
    d = diagnosed(with_accelerometer(ARM))
    (claim,) = d.effects
    assert (d.verdict, claim.name, claim.alternatives) == (Verdict.TRACED, ACCELEROMETER, ())
    assert abs(claim.parameters["arm"].value - ARM) < 4.0 * claim.parameters["arm"].std


def test_a_vane_behind_is_not_claimed_as_an_accelerometer_ahead() -> None:
    model = rigid_model().with_effects(VaneBehind()).with_values({"guard:vane-behind.arm": ARM})
    d = diagnosed(noisy(model, doublets(), np.random.default_rng(1)))
    assert d.verdict is Verdict.UNEXPLAINED and not any(claim.claimed for claim in d.effects)


def test_where_the_declared_derivatives_know_nothing_the_two_are_equal() -> None:
    """Declared half-way between the two readings."""
    record = with_vane(2.0)
    readings = [fit_of(problem_of([record]), (effect,)) for effect in BOTH]
    between = {name: 0.5 * sum(r.values.shared[name] for r in readings) for name in ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")}
    d = diagnosed(record, declared().with_values(between))
    assert d.verdict is Verdict.AMBIGUOUS
    assert {d.effects[0].name, *d.effects[0].alternatives} == {VANE, ACCELEROMETER}


def test_only_equivalents_are_weighed_by_what_was_declared() -> None:
    problem = problem_of([with_vane(ARM)])
    vane, accelerometer = (fit_of(problem, (effect,)) for effect in BOTH)
    assert misfit_to_declared(vane) < 20.0 < misfit_to_declared(accelerometer)
    root = fit_of(problem)
    models = {frozenset([VANE]): vane, frozenset([ACCELEROMETER]): accelerometer, frozenset(["else"]): root}
    totals = {frozenset([VANE]): 5.0, frozenset([ACCELEROMETER]): 4.0, frozenset(["else"]): 7.0}
    told = told_by_declared(totals, models)
    assert told[frozenset([VANE])] == pytest.approx(4.0, rel=1e-12) and told[frozenset(["else"])] == 7.0
    apart = 5.0 - 4.0 + misfit_to_declared(vane) - misfit_to_declared(accelerometer)
    assert told[frozenset([ACCELEROMETER])] == pytest.approx(4.0 - apart)
    alone = {key: totals[key] for key in (frozenset(["else"]), frozenset([VANE]))}
    assert told_by_declared(alone, models) == alone


def test_a_declared_value_of_zero_says_nothing() -> None:
    fitted = fit_of(problem_of([with_vane(ARM)]), (VaneOffset(),))
    silent = replace(fitted, declared=fitted.declared.with_values({"CL_de": 0.0}))
    assert misfit_to_declared(silent) <= misfit_to_declared(replace(fitted, declared=fitted.declared.with_values({"CL_de": 1.0})))
    assert set(OUTPUTS) <= set(fitted.system.output_names)


@pytest.mark.parametrize(("value", "std", "same"), [(0.05, 0.005, True), (-0.05, 0.005, True), (0.05, 0.02, False), (0.9 * EVEN_CHANGE, 1e-4, False)])
def test_a_phugoid_along_a_path_that_is_not_level_is_an_even_change_of_speed(value: float, std: float, same: bool) -> None:
    """Where the attitude is known and large enough; a recorded airspeed leaves no attitude to be taken for one."""
    found = {"attitude": Quantity(value, std, "rad"), "trim_moment": Quantity(0.5, 1e-6, "1")}
    assert same_by_value(Phugoid(), found) == (("speed-variation",) if same else ())
    assert same_by_value(Phugoid(speed_recorded=True), found) == () == same_by_value(Phugoid(), {"trim_moment": found["trim_moment"]})


def test_a_claimed_phugoid_names_the_change_of_speed_that_it_is_and_a_level_one_does_not() -> None:
    for attitude, expected in ((0.1, ("speed-variation",)), (0.0, ())):
        values = {"phugoid.attitude": attitude, "phugoid.speed_damping": 0.01, "phugoid.induced_drag": 5.0, "phugoid.trim_moment": 0.0}
        problem = problem_of([planted([Phugoid()], values, 3)], (Phugoid(),))
        (claim,) = claims_of(problem, Choice(fit_of(problem, (Phugoid(),)), HeldOut(None, None)))
        assert claim.alternatives == expected
