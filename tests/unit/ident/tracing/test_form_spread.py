"""What the form of a curve leaves open of the derivatives."""

from __future__ import annotations

from dataclasses import replace

from ident.tracing.between_records import form_spread
from sim.effects.dynamics.load_nonlinearity import MOMENT_NONLINEARITY
from sim.effects.sensor_path.sensor_timing import SensorDelay
from tests.tracing_problem import declared, fit_of, planted, problem_of

LATE = SensorDelay("alpha")


def test_the_form_of_a_curve_widens_what_hangs_on_it_and_nothing_else() -> None:
    """A moment that bends more sharply than four shapes follow: the slope at trim moves with the
    form; a delay has one form only.
    """
    bend = replace(MOMENT_NONLINEARITY, low=-0.12, high=0.12)
    values = {f"moment-nonlinearity.{name}": 0.0 for name in bend.absent}
    sharp = {f"moment-nonlinearity.{name}": 0.0 for name in bend.finer().absent} | {
        "moment-nonlinearity.shape6": 0.01
    }
    record = planted([bend.finer()], sharp, 1)
    problem = problem_of([record])
    fitted = fit_of(problem, (bend,), None, values)
    spread = form_spread(problem, fitted)
    assert set(spread) <= set(declared().parameters.names) and spread["Cm_alpha"] > 0.0
    plain = problem_of([planted([], None, 1)])
    assert form_spread(plain, fit_of(plain, (LATE,))) == {}


def test_a_fit_to_the_end_is_made_once_for_one_question() -> None:
    problem = problem_of([planted([], None, 1)])
    root = fit_of(problem, ())
    late = fit_of(problem, (LATE,), root)
    assert fit_of(problem, (SensorDelay("alpha"),), root) is late
    assert fit_of(problem, (LATE,), late) is not late
    assert fit_of(problem, (LATE,), root, {"sensor-delay:alpha.delay": 0.02}) is not late
    assert fit_of(problem.with_masks(problem.masks), (LATE,), root) is not late
