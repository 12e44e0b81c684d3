"""What a diagnosis rests on: residual tests with a caution for each that fails, and held-out data
that forbid a claim.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Concern, Diagnosis, Verdict
from ident.tracing.held_out import HeldOut, fit_held_out
from ident.tracing.loop import diagnose
from ident.tracing.names import CLAIM_LEVEL
from ident.tracing.result import not_noise, residual_tests
from sim.declaration.proposal import Traceable
from sim.effects.sensor_path.sensor_calibration import SensorScale
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.record import Record
from tests.tracing_problem import SETTINGS, declared, fit_of, planted, problem_of

LAG = {"sensor-lag:q.time_constant": 0.06}
FINE = ResidualTest("ljung-box", "q, fitted", 20.0, 0.5, "white")
BAD = ResidualTest("ljung-box", "q, fitted", 200.0, 1e-9, "not white")


def lagged(seed: int) -> Record:
    return planted([SensorLag("q")], LAG, seed)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    """A late pitch rate, found in one record and shown by another."""
    return diagnose(
        [lagged(1)], declared(), (SensorLag("q"), SensorScale("nz")), (), [lagged(2)], SETTINGS
    )


def test_a_caution_of_a_failed_test_carries_the_test_and_its_number() -> None:
    (caution,) = not_noise([FINE, BAD], 1e-4)
    assert caution.concern is Concern.NOT_NOISE and caution.test is BAD
    assert caution.requirement is not None and (
        caution.requirement.value,
        caution.requirement.bar,
    ) == (1e-9, 1e-4)
    assert not_noise([FINE, BAD], 1e-10) == []


def test_residual_tests_are_of_the_fitted_records_and_of_those_held_out() -> None:
    root, other = fit_of(problem_of([planted(seed=1)])), planted(seed=2)
    tests = residual_tests(root, fit_held_out(root, [other], None))
    assert len(tests.fitted) == len(tests.others) == 3 and tests.all == (
        *tests.fitted,
        *tests.others,
    )
    assert {test.channel.partition(", ")[2] for test in tests.others} == {"held out"}
    assert residual_tests(root, HeldOut(None, None)).others == ()
    wrong = residual_tests(root, fit_held_out(root, [lagged(2)], None))
    assert not not_noise(wrong.fitted, 1e-4) and not_noise(wrong.others, 1e-4)


def test_a_claim_says_how_probable_it_is_and_nothing_that_only_a_coloured_residual_asks_for(
    found: Diagnosis,
) -> None:
    (claim,) = found.effects
    assert found.verdict is Verdict.TRACED and claim.probability["sensor-lag:q"] > CLAIM_LEVEL
    assert claim.spread is None and claim.by_record == () and claim.reasons == ()


def test_steps_and_candidates_say_how_the_search_went(found: Diagnosis) -> None:
    """To its gain come the odds that a candidate has beforehand, .03 shared by five at least;
    linearised, also those of its place.
    """
    assert found.steps and found.steps[-1].effects == ("sensor-lag:q",) and not found.stopped
    assert found.steps[-1].log_evidence >= found.steps[0].log_evidence
    assert "candidates scanned" in found.steps[0].sentence
    assert {each.name for each in found.candidates} == {"sensor-lag:q", "sensor-scale:nz"}
    before = math.log(0.03 / 5)
    fitted = [each for each in found.candidates if each.fitted]
    assert all(each.weight - each.gain == pytest.approx(before, abs=1e-6) for each in fitted)
    assert all(each.weight - each.gain < before + 1e-6 for each in found.candidates)
    assert max(fitted, key=lambda each: each.weight).name == "sensor-lag:q"
    assert all(bool(each.parameters) == each.fitted for each in found.candidates)


def test_effects_that_worsen_held_out_data_are_not_claimed() -> None:
    """A record without the lag: the set that has it predicts that worse, and may not claim it."""
    d = diagnose([lagged(1)], declared(), (SensorLag("q"),), (), [planted(seed=7)], SETTINGS)
    assert d.verdict is Verdict.UNEXPLAINED
    (hint,) = d.effects
    assert not hint.claimed and hint.probability == {} and "not fitted" in hint.reasons[0]
    assert Concern.NOT_NOISE in [caution.concern for caution in d.warnings]


@pytest.mark.long
def test_a_search_that_ends_at_its_means_says_so_and_a_set_is_no_larger_than_was_asked_for() -> (
    None
):
    both: list[Traceable] = [SensorLag("q"), SensorScale("nz")]
    record = planted(both, {**LAG, "sensor-scale:nz.scale": 1.15}, 1)
    found = {
        depth: diagnose(
            [record], declared(), both, (), (), replace(SETTINGS, depth=depth, budget=budget)
        )
        for depth, budget in ((2, 40), (1, 40), (3, 0))
    }
    assert [each.stopped for each in found.values()] == [False, False, True]
    assert {claim.name for claim in found[2].effects} == {"sensor-lag:q", "sensor-scale:nz"}
    assert found[2].verdict is Verdict.TRACED
    assert all(len(step.effects) <= 1 for step in found[1].steps)
    assert found[1].verdict is Verdict.UNEXPLAINED, "one of two leaves no noise"
