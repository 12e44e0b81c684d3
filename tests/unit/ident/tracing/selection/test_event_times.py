"""Events that a fit places wrongly: wide edges lead to the right time, and a freer course begins where the plain one does not end."""

from __future__ import annotations

import pytest

from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.event_times import in_freer_form, placed_better
from ident.tracing.selection.ledger import Ledger
from scenarios.trials.hidden.half_sine_gust import HalfSineGust
from sim.declaration.proposal import Edged
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.dynamics.derivative_jump import DerivativeJump
from sim.effects.dynamics.drag_jump import DragJump
from tests.tracing_problem import fit_of, planted, problem_of

PULSE = UnmeasuredInput()
# Its lift jumps in single samples of nz, each of which holds the fit of an edge where it is.
TRUE = {"unmeasured-input.start": 6.0, "unmeasured-input.duration": 1.73, "unmeasured-input.moment": 0.004, "unmeasured-input.lift": 0.08}


def test_wide_edges_lead_out_of_the_local_optima_of_single_samples() -> None:
    problem = problem_of([planted([PULSE], TRUE)], (PULSE,))
    root = fit_of(problem)
    stuck = fit_of(problem, [PULSE], root, {**TRUE, "unmeasured-input.duration": 1.5})
    assert abs(stuck.values.own[0]["unmeasured-input.duration"] - 1.73) > 0.1
    _, placed = placed_better(Ledger(problem).kept(root, root.criterion), stuck, PULSE)
    assert placed.values.own[0]["unmeasured-input.duration"] == pytest.approx(1.73, abs=0.03)
    assert placed.values.own[0]["unmeasured-input.start"] == pytest.approx(6.0, abs=0.03)
    assert placed.effects == (PULSE,), "the edges are as narrow as before"
    assert placed.fit.cost < stuck.fit.cost - 20.0


def test_a_place_that_cannot_be_bettered_stays() -> None:
    problem = problem_of([planted([PULSE], TRUE)], (PULSE,))
    root = fit_of(problem)
    right = fit_of(problem, [PULSE], root, TRUE)
    _, placed = placed_better(Ledger(problem).kept(root, root.criterion), right, PULSE)
    assert placed.fit.cost > right.fit.cost - 3.0 and placed.values.own[0]["unmeasured-input.duration"] == pytest.approx(1.73, abs=0.03)


@pytest.mark.parametrize("effect", [PULSE, DerivativeJump(), DragJump()], ids=lambda effect: effect.name)
def test_wider_edges_change_nothing_else(effect: Edged) -> None:
    wide = effect.blunted(16)
    assert wide.width == pytest.approx(16 * effect.width) and wide.parameters == effect.parameters  # type: ignore[attr-defined]


def test_a_freer_course_of_a_gust_is_sought_inside_and_outside_the_plain_one() -> None:
    """Half a sine: 1 - cos fitted to it begins too early and ends too late."""
    hidden = HalfSineGust()
    values = {"own:half-sine-gust.peak": 4.2, "own:half-sine-gust.start": 5.3, "own:half-sine-gust.duration": 1.94}
    problem = problem_of([planted([hidden], values, scale=0.2)], (GustDiscrete(),))  # type: ignore[list-item]
    root = fit_of(problem)
    plain = fit_of(problem, [GustDiscrete()], root, {"gust-discrete.peak": 4.0, "gust-discrete.start": 5.1, "gust-discrete.duration": 2.3})
    assert plain.values.own[0]["gust-discrete.duration"] > 2.2
    at_once = fit_of(problem, [GustDiscrete().finer()], plain)
    assert not is_white(at_once), "from the plain one's ends the fit does not come there"
    _, freer = in_freer_form(Ledger(problem).kept(root, root.criterion), plain, 0)
    assert freer is not None and is_white(freer)
    assert freer.values.own[0]["gust-discrete.start"] == pytest.approx(5.3, abs=0.05)
    assert freer.values.own[0]["gust-discrete.duration"] == pytest.approx(1.94, abs=0.1)
