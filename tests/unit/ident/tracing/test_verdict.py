"""From evidence to a verdict: what leads to which, and which bars decide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ident.statistics.residuals import ResidualTest
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.diagnosis import Claim, Concern, Quantity, Verdict
from ident.tracing.ranking.choice import Choice
from ident.tracing.validation.held_out import HeldOut, HeldOutData, held_out
from ident.tracing.validation.improvement import contradicted, hardly_better, no_better, room_for
from ident.tracing.verdict import ResidualTests, judge, not_noise, verdict_on
from ident.tracing.witness import Silent
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.disturbance.gust_turbulence import GustTurbulence
from sim.effects.library import guards_for
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.record import Record
from sim.vehicles.short_period import ShortPeriod
from tests.tracing_problem import doublets, fit_of, planted, problem_of
from tests.turbulence import rough_record

LAG = {"sensor-lag:q.time_constant": 0.06}
FINE = ResidualTest("ljung-box", "q, fitted", 20.0, 0.5, "white")
BAD = ResidualTest("ljung-box", "q, fitted", 200.0, 1e-9, "not white")
NOTHING = HeldOut(None, None)


@pytest.fixture(scope="module")
def problem() -> TraceProblem:
    return problem_of([planted([SensorLag("q")], LAG)])


@pytest.fixture(scope="module")
def root(problem: TraceProblem) -> FittedModel:
    return fit_of(problem)


def found(
    problem: TraceProblem, root: FittedModel, effects: Sequence[Traceable], spikes: Sequence[Claim] = (), bad: bool = False
) -> tuple[Verdict, list[Concern]]:
    """Verdict on a set of effects, where all residual tests pass or one fails."""
    best = fit_of(problem, effects, root) if effects else root
    tests = ResidualTests((FINE, BAD) if bad else (FINE,))
    verdict, cautions = verdict_on(problem, root, Choice(best, NOTHING), spikes, tests, HeldOutData())
    return verdict, [caution.concern for caution in cautions]


@dataclass
class Denying(Silent):
    """A witness that speaks against one effect."""

    name: str
    by: float

    def against(self, effect: str, parameters: Mapping[str, Quantity], /) -> float:
        return self.by if effect == self.name and parameters else 0.0


@pytest.mark.parametrize(("share", "verdict"), [(0.9, Verdict.TRACED), (1.1, Verdict.UNEXPLAINED)])
def test_what_kinematics_speak_strongly_against_is_not_claimed(problem: TraceProblem, root: FittedModel, share: float, verdict: Verdict) -> None:
    heard = replace(problem, witness=Denying("sensor-lag:q", share * thresholds.STRONG_WITNESS))
    said, concerns = found(heard, root, [SensorLag("q")])
    assert said is verdict and concerns == ([Concern.CONTRADICTED] if verdict is Verdict.UNEXPLAINED else [])
    # In air that moves the kinematics of still air are no witness.
    assert Concern.CONTRADICTED not in found(heard, root, [SensorLag("q"), GustDiscrete()])[1]


def test_guards_lead_to_unexplained(problem: TraceProblem, root: FittedModel) -> None:
    guard = next(guard for guard in guards_for(ShortPeriod()) if guard.name == "guard:alpha-q")
    assert found(problem, root, [guard]) == (Verdict.UNEXPLAINED, [Concern.GUARD])
    # Also beside an effect that is right; the sentence names the guard.
    best = fit_of(problem, [SensorLag("q"), guard], root)
    verdict, cautions = verdict_on(problem, root, Choice(best, NOTHING), [], ResidualTests((FINE, BAD)), HeldOutData())
    assert verdict is Verdict.UNEXPLAINED and [c.concern for c in cautions] == [Concern.GUARD, Concern.NOT_NOISE]
    assert "guard:alpha-q" in cautions[0].sentence


def test_verdicts_without_effects_follow_the_tests(problem: TraceProblem, root: FittedModel) -> None:
    assert found(problem, root, []) == (Verdict.CONSISTENT, [])
    assert found(problem, root, [], bad=True) == (Verdict.UNEXPLAINED, [Concern.NOT_NOISE])
    verdict, cautions = verdict_on(problem, root, Choice(root, NOTHING), [], ResidualTests((FINE,), (BAD,)), HeldOutData())
    assert verdict is Verdict.UNEXPLAINED and [c.concern for c in cautions] == [Concern.NOT_NOISE, Concern.DIFFERS_HELD_OUT]


def test_what_remains_not_noise_is_never_traced(problem: TraceProblem, root: FittedModel) -> None:
    claims = [Claim("sensor-lag:q", {})]
    assert found(problem, root, [SensorLag("q")], claims) == (Verdict.TRACED, [])
    assert found(problem, root, [SensorLag("q")], claims, bad=True) == (Verdict.UNEXPLAINED, [Concern.NOT_NOISE])


def test_a_caution_of_a_failed_test_carries_the_test() -> None:
    assert [caution.test for caution in not_noise([FINE, BAD], 1e-4)] == [BAD]
    assert not_noise([FINE, BAD], 1e-10) == []


def held(records: Sequence[Record], root: FittedModel) -> HeldOutData:
    """Records that took no part in choosing."""
    return HeldOutData(records, [record.output_array(("alpha", "q", "nz"))[1] for record in records], held_out(root, records, None, informed=False))


def test_effects_that_worsen_held_out_data_are_not_traced(problem: TraceProblem, root: FittedModel) -> None:
    """Two sets on a record without the lag: the one that has it predicts worse, and may not claim it."""
    best = fit_of(problem, [SensorLag("q")], root)
    for values, expected in (({}, Verdict.UNEXPLAINED), (LAG, Verdict.TRACED)):
        data = held([planted([SensorLag("q")] if values else [], values, 7)], root)
        out = held_out(best, data.records, None, informed=False)
        assert judge(problem, root, Choice(best, out), [], data).verdict is expected


def test_held_out_cost_has_to_fall_not_merely_to_stay(problem: TraceProblem, root: FittedModel) -> None:
    """A rise by less than its scatter, sqrt(2 k), was once enough."""
    best = fit_of(problem, [SensorLag("q")], root)
    data = held([planted([SensorLag("q")], LAG, 7)], root)
    out = held_out(best, data.records, None, informed=False)
    before = data.declared.frozen
    assert before is not None and out.frozen is not None
    for rise, expected in ((-0.1, Verdict.TRACED), (0.0, Verdict.UNEXPLAINED), (0.5, Verdict.UNEXPLAINED)):
        fit = replace(out.frozen, cost=before.cost + rise)
        verdict, cautions = verdict_on(problem, root, Choice(best, HeldOut(fit, None)), [], ResidualTests((FINE,)), data)
        assert verdict is expected
        assert [c.concern for c in cautions] == ([] if verdict is Verdict.TRACED else [Concern.NO_IMPROVEMENT])


def test_a_held_out_fit_that_failed_is_not_traced(problem: TraceProblem, root: FittedModel) -> None:
    best = fit_of(problem, [SensorLag("q")], root)
    good = held([planted([SensorLag("q")], LAG, 7)], root)
    for data in (good, replace(good, declared=NOTHING)):
        verdict, cautions = verdict_on(problem, root, Choice(best, NOTHING), [], ResidualTests((FINE,)), data)
        assert verdict is Verdict.UNEXPLAINED and "not fitted" in cautions[0].sentence


def test_data_that_hardly_move_ask_for_half_of_what_an_effect_would_bring_there(problem: TraceProblem, root: FittedModel) -> None:
    """A twentieth of the usual motion: the true cause lowers the error there by less than a twentieth, and a wrong one raises it."""
    best = fit_of(problem, [SensorLag("q")], root)
    true, without = (planted([SensorLag("q")], {"sensor-lag:q.time_constant": size}, 5, flight=doublets(size=0.006)) for size in (0.06, 1e-6))
    for record, worse in ((true, False), (without, True)):
        before, after = (held_out(each, [record], None, informed=False) for each in (root, best))
        one, two = before.frozen, after.frozen
        assert one is not None and two is not None
        assert hardly_better(before, after) and hardly_better(before, after, weak=True) is worse and no_better(before, after) is worse
        apart = one.residuals[0] - two.residuals[0]
        expected = float(np.mean(0.5 * np.log(1.0 + np.mean(apart**2, axis=1) / two.variance)))
        assert 0.0 < expected < 0.1 and room_for(one, two) == pytest.approx(expected)


def test_data_in_which_the_cause_does_not_show_ask_for_a_twentieth(problem: TraceProblem, root: FittedModel) -> None:
    """A two-hundredth of the usual motion: that the error falls there is chance, for a wrong cause as for the true one."""
    best, passed = fit_of(problem, [SensorLag("q")], root), 0
    for seed in range(6):
        still = planted([SensorLag("q")], {"sensor-lag:q.time_constant": 1e-6}, seed, flight=doublets(size=0.0003))
        before, after = (held_out(each, [still], None, informed=False) for each in (root, best))
        passed += not no_better(before, after)
        assert hardly_better(before, after, weak=True)
    assert passed, "by likelihood alone some would pass"


def test_data_that_hardly_show_a_cause_do_not_contradict_it_and_those_that_would_show_it_do(problem: TraceProblem, root: FittedModel) -> None:
    """The record of ``best`` moves as usual, or a two-hundredth of it; with the cause or without."""
    best = fit_of(problem, [SensorLag("q")], root)
    for size, there, against in ((0.1, True, False), (0.1, False, True), (0.0003, True, False), (0.0003, False, False)):
        value = {"sensor-lag:q.time_constant": 0.06 if there else 1e-6}
        record = planted([SensorLag("q")], value, 5, flight=doublets(size=size))
        before, after = (held_out(each, [record], None, informed=False) for each in (root, best))
        assert contradicted(before, after) is against
    assert contradicted(NOTHING, NOTHING)


def test_data_are_called_held_out_only_where_they_took_no_part() -> None:
    assert HeldOutData(choosing=True).label == "not fitted"
    assert HeldOutData(choosing=False).label == "held out"


def test_process_noise_is_judged_by_one_step_predictions(problem: TraceProblem) -> None:
    """Turbulence improves no free simulation: it has to predict held-out data a step ahead, and what flies in still air it does not."""
    rough = problem_of([rough_record(np.random.default_rng(1))])
    root, gust = fit_of(rough), GustTurbulence()
    best = fit_of(rough, [gust], root)
    still = fit_of(problem_of([planted(seed=3)]))
    for record, expected in ((rough_record(np.random.default_rng(2)), Verdict.TRACED), (planted(seed=4), Verdict.UNEXPLAINED)):
        # The declared model as it is known where the air was as it is here.
        base = root if expected is Verdict.TRACED else still
        data = held([record], base)
        out = held_out(best, data.records, None, informed=False)
        verdict, cautions = verdict_on(rough, base, Choice(best, out), [], ResidualTests((FINE,)), data)
        assert verdict is expected
        assert [c.concern for c in cautions] == ([] if verdict is Verdict.TRACED else [Concern.NO_IMPROVEMENT])
