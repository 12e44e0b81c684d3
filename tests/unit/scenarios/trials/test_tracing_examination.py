"""Random papers: every kind can be hidden and seen, papers are the seed's, marks follow the names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.diagnosis import Claim, Verdict
from scenarios.trials.aircraft import drawn_aircraft
from scenarios.trials.examination import Mark, Paper, _flown, _maneuvers, _mark, examine, summary
from scenarios.trials.kinds import KINDS
from scenarios.trials.planted.hiding import find_term
from sim.declaration.model import Model
from sim.effects.library import effect_names
from tests.diagnoses import tracing_of


def paper(*hidden: str) -> Paper:
    answers = frozenset(KINDS[name].answer for name in hidden if KINDS[name].answer)
    return Paper(1, "fighter", hidden, answers, any(not KINDS[name].answer for name in hidden), ("alpha", "q", "nz"), 50.0)


@pytest.fixture(scope="module")
def fighter() -> Model:
    return drawn_aircraft(np.random.default_rng(1))[1]


@pytest.mark.parametrize("name", sorted(KINDS))
def test_every_kind_is_a_term_that_shows_and_its_answer_an_effect(name: str, fighter: Model) -> None:
    kind = KINDS[name]
    find_term(kind.term, fighter.equations, name)
    assert not kind.answer or kind.answer in effect_names()
    rng = np.random.default_rng(2)
    maneuver = _maneuvers(rng, 0.06, 8.0)[0]
    values = {name: kind.draw(rng, 0.06, 8.0)}
    with_it = _flown(fighter, values, maneuver, paper(name), 8.0, np.random.default_rng(3))
    without = _flown(fighter, {}, maneuver, paper(), 8.0, np.random.default_rng(3))
    assert any(np.any(a.values != b.values) for a, b in zip(with_it.outputs, without.outputs, strict=True))
    assert np.array_equal(with_it["elevator"].values, without["elevator"].values)


def test_a_paper_is_diagnosed_and_marked() -> None:
    mark = examine(1)
    assert mark.paper.hidden == examine_hidden(1) and set(mark.errors) == {"CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"}
    assert np.isfinite(mark.held_out) and mark.seconds > 0


def examine_hidden(seed: int) -> tuple[str, ...]:
    return ("product",) if seed == 1 else ()


@pytest.mark.parametrize(
    ("hidden", "verdict", "claims", "right", "wrong"),
    [
        ((), Verdict.CONSISTENT, (), True, False),
        ((), Verdict.UNEXPLAINED, (), False, False),
        (("input-deadband",), Verdict.TRACED, (Claim("input-deadband", {}),), True, False),
        (("input-deadband",), Verdict.TRACED, (Claim("actuator-saturation", {}, ("input-deadband",)),), True, False),
        (("input-deadband",), Verdict.TRACED, (Claim("input-backlash", {}),), False, True),
        (("input-deadband",), Verdict.UNEXPLAINED, (Claim("input-backlash", {}, claimed=False),), False, False),
        (("sensor-lag:alpha",), Verdict.TRACED, (Claim("sensor-delay:alpha", {}),), True, False),
        (("elastic-mode", "vane-offset"), Verdict.TRACED, (Claim("elastic-mode", {}), Claim("vane-offset", {})), True, False),
        (("elastic-mode", "vane-offset"), Verdict.TRACED, (Claim("elastic-mode", {}),), False, False),
        (("product",), Verdict.UNEXPLAINED, (), True, False),
        (("product",), Verdict.PARTIAL, (Claim("vane-offset", {}),), False, True),
    ],
)
def test_marks(hidden: tuple[str, ...], verdict: Verdict, claims: tuple[Claim, ...], right: bool, wrong: bool, fighter: Model) -> None:
    diagnosis = replace(tracing_of(Verdict.TRACED).diagnosis, verdict=verdict, effects=claims)
    mark = _mark(paper(*hidden), fighter, diagnosis, 1.0)
    assert (mark.right, mark.wrong) == (right, wrong)


def test_summary_counts() -> None:
    one = Mark(paper("vane-offset"), "traced", ("vane-offset",), True, False, {"Cm_q": 1.0, "CL_q": -3.0}, 1.02, 2.0)
    other = Mark(paper("input-delay"), "traced", ("vane-offset",), False, True, {"Cm_q": 9.0}, 3.0, 4.0)
    found = summary([one, other])
    assert found["right"] == 0.5 and found["wrong claims"] == 0.5 and found["derivatives within two sigmas"] == 0.5
    assert found["held-out error, median"] == 1.02 and found["seconds, median"] == 3.0
