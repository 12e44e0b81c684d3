"""A vane at an arm and an accelerometer at minus that arm: one record, two readings, and the
declared derivatives between them.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.diagnosis import Diagnosis, Verdict
from ident.tracing.loop import diagnose
from ident.tracing.names import CLAIM_LEVEL
from sim.declaration.model import Model
from sim.effects.guards.further_loads import VaneBehind
from sim.effects.sensor_path.sensor_mounting import AccelerometerOffset, VaneOffset
from sim.record import Record
from tests.bases import RIGID_VALUES, rigid_model
from tests.rigid_problem import noisy
from tests.tracing_problem import SETTINGS, declared, doublets, fit_of, planted, problem_of

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
def test_each_is_named_with_the_other_beside_it_and_both_sets_of_derivatives(
    record: Record, name: str, other: str
) -> None:
    """The records alone say nothing: under the other name CL_de is far from what the file declares,
    which makes the first certain.
    """
    d = diagnosed(record)
    (claim,) = d.effects
    assert (d.verdict, claim.name, claim.alternatives) == (Verdict.TRACED, name, (other,))
    assert claim.probability[name] > CLAIM_LEVEL
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
    between = {
        name: 0.5 * sum(r.values.shared[name] for r in readings)
        for name in ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
    }
    d = diagnosed(record, declared().with_values(between))
    assert d.verdict is Verdict.AMBIGUOUS
    (claim,) = d.effects
    assert {claim.name, *claim.alternatives} == {VANE, ACCELEROMETER} == set(claim.probability)
    assert sum(claim.probability.values()) == pytest.approx(1.0, abs=0.01)
    under = claim.derivatives_under
    assert list(under) == [claim.name, *claim.alternatives] and under[claim.name] == d.after
    first, second = (each["CL_de"] for each in under.values())
    assert abs(first.value - second.value) > 3.0 * max(first.std, second.std)
