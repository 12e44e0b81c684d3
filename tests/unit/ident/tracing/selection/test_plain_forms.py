"""Freer forms are left again where the plain ones do as well."""

from __future__ import annotations

from ident.tracing.selection.event_times import in_freer_form
from ident.tracing.selection.ledger import Ledger
from ident.tracing.selection.plain_forms import child_in_plain_form, in_plain_form
from sim.effects.sensor_path.sensor_curve import SensorCurve
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.tracing_problem import fit_of, planted, problem_of

CURVE, SCALE = SensorCurve("nz", "g", 0.1, -3.0, 3.0), SensorScale("q")
BENT = {"sensor-curve:nz.curvature": 0.15}


def test_a_form_made_freer_in_vain_is_left_and_one_that_is_needed_stays() -> None:
    for values, needed in ((BENT, False), ({**BENT, "sensor-curve:nz.cubic": 0.12}, True)):
        problem = problem_of([planted([CURVE.finer() if needed else CURVE], values)], (CURVE,))
        root = fit_of(problem)
        ledger, freer = in_freer_form(Ledger(problem).kept(root, root.criterion), fit_of(problem, [CURVE], root), 0)
        assert freer is not None and freer.effects == (CURVE.finer(),)
        assert ledger.plain_form(freer.effects[0]) == CURVE and ledger.plain_form(SCALE) is SCALE
        _, left = in_plain_form(ledger, freer)
        assert left.effects == ((CURVE.finer(),) if needed else (CURVE,))
        assert left.criterion <= freer.criterion


def test_a_child_of_a_form_made_freer_too_soon_has_the_plain_one() -> None:
    problem = problem_of([planted([CURVE, SCALE], {**BENT, "sensor-scale:q.scale": 1.15})], (CURVE, SCALE))
    root = fit_of(problem)
    plain = fit_of(problem, [CURVE], root)
    freer = fit_of(problem, [CURVE.finer()], plain)
    ledger = Ledger(problem).kept(root, root.criterion)
    child = fit_of(problem, [CURVE.finer(), SCALE], freer)
    assert child_in_plain_form(ledger, freer, child)[1] is child, "nothing was made freer"
    _, left = child_in_plain_form(ledger.made_freer(plain), freer, child)
    assert left.effects == (CURVE, SCALE) and left.criterion < child.criterion
