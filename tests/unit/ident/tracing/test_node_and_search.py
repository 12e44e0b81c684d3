"""Nodes carry values from one model to the next; the search adds what is needed, drops what is not, and stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ident.statistics.residuals import ResidualTest
from ident.tracing.candidate_model.fitted_model import FittedModel, carried, compiled_with, free_names
from ident.tracing.candidate_model.quantities import quantities
from ident.tracing.diagnosis import Claim, Verdict
from ident.tracing.selection.backward import backward_elimination, refined
from ident.tracing.selection.expansion import expand
from ident.tracing.selection.forward import first_round, forward_selection, hopeless
from ident.tracing.selection.search import Search
from ident.tracing.validation.held_out import HeldOut, held_out
from ident.tracing.verdict import judge
from ident.whole_record.layout import FitSettings, lay_out
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.gust_turbulence import GustTurbulence
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.dynamics.elastic_mode import ElasticMode
from sim.effects.library import guards_for
from sim.effects.sensor_path.sensor_drift import SensorDrift
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.record import Record
from sim.truth.noise import coloured_noise
from sim.vehicles.short_period import ShortPeriod
from tests.tracing_problem import OUTPUTS, SETTINGS, declared, fit_of, planted, search_of, with_output

LAG = {"sensor-lag:q.time_constant": 0.06}
FEW: tuple[Traceable, ...] = (SensorScale("q"), SensorScale("nz"), SensorLag("alpha"), SensorLag("q"), UnmeasuredInput())


def found_by(records: Sequence[Record], candidates: Sequence[Traceable] = FEW) -> tuple[Search, FittedModel, FittedModel]:
    """A search, its root and the set it ends with."""
    search = search_of(records, candidates)
    root = fit_of(search)
    return search, root, refined(search, backward_elimination(search, forward_selection(search, root, first_round(search, root))))


# Nodes.


def test_values_are_carried_by_name_from_one_model_to_the_next() -> None:
    """A smaller model's values begin a larger one's fit, and the other way round; what is new begins as told, or as declared."""
    records = [planted([SensorLag("q")], LAG, seed) for seed in (1, 2)]
    search = search_of(records)
    small = fit_of(search, [SensorScale("nz")])
    effects = (SensorDrift("q", "rad/s", 5e-4), SensorLag("q"), SensorScale("nz"))
    _, system = compiled_with(declared(), effects, OUTPUTS)
    layout = lay_out(records, system, FitSettings(max_step=0.02), local=["sensor-drift:q.slope"])
    start, guesses = carried(layout, small.values, {"sensor-lag:q.time_constant": 0.123})
    by_name = dict(zip(layout.names, start, strict=True))
    known = {**small.values.shared}
    for r, own in enumerate(small.values.own):
        known |= {f"{name}, record {r + 1}": value for name, value in own.items()}
    assert len(known) == len(small.fit.theta)
    assert {name: by_name[name] for name in known} == known
    assert {name: value for name, value in by_name.items() if name not in known} == {
        "sensor-lag:q.time_constant": 0.123,
        "sensor-drift:q.slope, record 1": 5e-4,
        "sensor-drift:q.slope, record 2": 5e-4,
    }
    assert guesses is not None
    for guess, line in zip(guesses, small.fit.lines, strict=True):
        np.testing.assert_array_equal(guess, line.states)
    # Back: what the smaller model lacks is left behind.
    large = fit_of(search, effects, small, {"sensor-lag:q.time_constant": 0.05})
    back, _ = carried(small.fit.layout, large.values, {})
    shared = {**large.values.shared}
    assert {name: value for name, value in zip(small.fit.layout.shared, back, strict=False)} == {
        name: shared[name] for name in small.fit.layout.shared
    }


def test_added_states_begin_at_rest() -> None:
    search = search_of([planted()])
    root = fit_of(search)
    _, system = compiled_with(declared(), [ElasticMode()], OUTPUTS)
    layout = lay_out(search.records, system, FitSettings(max_step=0.02))
    _, guesses = carried(layout, root.values, {})
    assert guesses is not None
    np.testing.assert_array_equal(guesses[0][:2], root.fit.lines[0].states)
    assert not np.any(guesses[0][2:])


def test_a_fit_begun_at_its_own_end_stays_there() -> None:
    search = search_of([planted([SensorLag("q")], LAG)])
    fitted = fit_of(search, [SensorLag("q")])
    again = fit_of(search, [SensorLag("q")], fitted)
    assert again.fit.cost == pytest.approx(fitted.fit.cost, abs=1e-6)
    assert again.fit.iterations <= 3


def test_parameters_of_an_effect_of_one_record_are_local() -> None:
    """Each record has its own drift; a scale is common to both. Both come out as planted."""
    drift = SensorDrift("q", "rad/s", 5e-4)
    effects = (drift, SensorScale("nz"))
    records = [planted(effects, {"sensor-drift:q.slope": slope, "sensor-scale:nz.scale": 1.2}, seed) for seed, slope in ((1, 0.002), (2, -0.003))]
    fitted = fit_of(search_of(records), effects)
    assert "sensor-scale:nz.scale" in fitted.fit.layout.shared
    assert fitted.fit.layout.local[-1] == "sensor-drift:q.slope"
    assert [own["sensor-drift:q.slope"] for own in fitted.values.own] == [pytest.approx(0.002, abs=2e-4), pytest.approx(-0.003, abs=2e-4)]
    assert fitted.values.shared["sensor-scale:nz.scale"] == pytest.approx(1.2, abs=0.02)
    # Three parameters are paid for: one a record, one for both.
    assert fitted.added == 3
    assert fitted.criterion == pytest.approx(2.0 * fitted.fit.cost + 3.0 * np.log(2 * 3 * len(records[0])))
    shown = quantities(fitted, drift)["slope"]
    # Of the record in which it stands out most.
    assert shown.value == fitted.values.own[1]["sensor-drift:q.slope"] and shown.std > 0 and shown.unit == "rad/s/s"


def test_an_event_pays_for_its_place() -> None:
    search = search_of([planted()])
    fitted = fit_of(search, [UnmeasuredInput()])
    assert len(free_names(UnmeasuredInput())) == 4
    assert fitted.criterion == pytest.approx(2.0 * fitted.fit.cost + 4.0 * np.log(fitted.fit.counts.sum()) + SETTINGS.event)


def test_bad_starts_leave_no_node() -> None:
    search = search_of([planted()])
    assert search.fit([SensorScale("q")], None, {"sensor-scale:q.scale": np.nan}) is None


# The search.


def test_clean_data_return_the_root() -> None:
    search, root, best = found_by([planted(seed=3)])
    assert best.names == ()
    assert best.fit.cost == pytest.approx(root.fit.cost, abs=1e-3)
    assert {candidate.name for candidate in search.evidence} <= {effect.name for effect in FEW}
    assert all(candidate.within == () for candidate in search.evidence)


@pytest.mark.parametrize("count", [1, 2], ids=["one record", "two records"])
def test_one_planted_effect_is_found_from_end_to_end(count: int) -> None:
    search, root, best = found_by([planted([SensorLag("q")], LAG, seed) for seed in range(1, 1 + count)])
    assert best.names == ("sensor-lag:q",)
    shown = quantities(best, SensorLag("q"))["time_constant"]
    assert abs(shown.value - 0.06) < 4.0 * shown.std < 0.02
    assert search.score(best) < search.score(root) - 100.0
    winner = next(candidate for candidate in search.evidence if candidate.name == "sensor-lag:q")
    assert winner.fitted and winner.round == 1 and winner.p_value < 1e-12
    assert winner.gain == max(candidate.gain for candidate in search.evidence if candidate.within == ())
    assert any(step.effects == ("sensor-lag:q",) for step in search.steps)


def test_an_event_of_one_of_two_records_is_found() -> None:
    values = {"unmeasured-input.start": 6.3, "unmeasured-input.duration": 0.8, "unmeasured-input.moment": 0.01, "unmeasured-input.lift": 0.0}
    _, _, best = found_by([planted(seed=1), planted([UnmeasuredInput()], values, 2)], (SensorScale("nz"), UnmeasuredInput()))
    assert best.names == ("unmeasured-input",)
    second = best.values.own[1]
    # What is shown is what the record has on which it acts.
    assert quantities(best, UnmeasuredInput())["start"].value == second["unmeasured-input.start"]
    assert second["unmeasured-input.start"] == pytest.approx(6.3, abs=0.1)
    assert second["unmeasured-input.moment"] == pytest.approx(0.01, rel=0.3)
    assert abs(best.values.own[0]["unmeasured-input.moment"] * best.values.own[0]["unmeasured-input.duration"]) < 0.002


def test_a_useless_effect_is_dropped_again() -> None:
    search = search_of([planted([SensorLag("q")], LAG)], FEW)
    root = fit_of(search)
    search.keep(root, root.criterion)
    lag = fit_of(search, [SensorLag("q")], root)
    both = fit_of(search, [SensorScale("nz"), SensorLag("q")], lag)
    search.keep(both, search.score(root) - search.gain(root, lag) - search.gain(lag, both))
    best = backward_elimination(search, both)
    assert best.names == ("sensor-lag:q",)
    assert any("sensor-scale:nz is no longer needed" in step.sentence for step in search.steps)
    assert search.score(best) < search.score(both)


def test_what_is_needed_is_kept() -> None:
    effects = (SensorScale("nz"), SensorLag("q"))
    search = search_of([planted(effects, {**LAG, "sensor-scale:nz.scale": 1.3})], FEW)
    root = fit_of(search)
    both = fit_of(search, effects, root)
    search.keep(both, both.criterion)
    assert backward_elimination(search, both) is both


def test_an_exhausted_search_adds_nothing() -> None:
    search = search_of([planted([SensorLag("q")], LAG)], FEW, replace(SETTINGS, budget=0.0))
    root = fit_of(search)
    assert search.exhausted
    assert expand(search, root, 1) == []
    assert search.evidence == [] and forward_selection(search, root, first_round(search, root)).names == ()


def test_work_is_counted_and_ends_the_search() -> None:
    """A budget that the root leaves a little of: the search ends after the fit that spends it, not a round later."""
    record = planted(
        [SensorLag("q"), SensorScale("nz"), SensorLag("alpha")], {**LAG, "sensor-scale:nz.scale": 1.3, "sensor-lag:alpha.time_constant": 0.1}
    )
    free = search_of([record], FEW)
    root = fit_of(free)
    forward_selection(free, root, first_round(free, root))
    before = search_of([record], FEW)
    fit_of(before)
    assert 0.0 < before.spent < 0.3 * free.spent
    tight = search_of([record], FEW, replace(SETTINGS, budget=before.spent + 0.5))
    root = fit_of(tight)
    assert tight.spent < tight.settings.budget
    forward_selection(tight, root, first_round(tight, root))
    assert tight.exhausted
    assert tight.spent < 0.6 * free.spent
    assert sum(candidate.fitted for candidate in tight.evidence) < sum(candidate.fitted for candidate in free.evidence)


def test_a_set_is_expanded_only_once() -> None:
    search = search_of([planted([SensorLag("q")], LAG)], (SensorLag("q"), SensorScale("nz")))
    root = fit_of(search)
    search.keep(root, root.criterion)
    assert [child.names for child in expand(search, root, 1)] == [("sensor-lag:q",)]
    told = len(search.evidence)
    assert expand(search, root, 1) == [] and len(search.evidence) == told


def test_the_better_of_two_fits_of_a_set_is_kept() -> None:
    search = search_of([planted()])
    root = fit_of(search)
    search.keep(root, 10.0)
    search.keep(root, 20.0)
    assert search.score(root) == 10.0
    search.keep(root, 5.0)
    assert search.score(root) == 5.0


# The verdict.

FINE = ResidualTest("ljung-box", "q, fitted", 20.0, 0.5, "white")
BAD = ResidualTest("ljung-box", "q, fitted", 200.0, 1e-9, "not white")
NOTHING = HeldOut(None, None)


def judged(
    names: Sequence[Traceable],
    claims: Sequence[Claim] = (),
    tests: Sequence[ResidualTest] = (FINE,),
) -> tuple[Verdict, list[str]]:
    search = search_of([planted([SensorLag("q")], LAG)])
    root = fit_of(search)
    best = fit_of(search, names, root) if names else root
    return judge(search, root, best, claims, tests, NOTHING, NOTHING, SETTINGS)


def test_guards_lead_to_unexplained() -> None:
    guard = next(guard for guard in guards_for(ShortPeriod()) if guard.name == "guard:alpha-q")
    verdict, warnings = judged([guard], [])
    assert verdict is Verdict.UNEXPLAINED and "guard:alpha-q" in warnings[0]
    # Also beside an effect that is right.
    verdict, warnings = judged([SensorLag("q"), guard], [Claim("sensor-lag:q", {})])
    assert verdict is Verdict.UNEXPLAINED and "guard:alpha-q" in warnings[0]


def test_verdicts_without_effects_follow_the_tests() -> None:
    assert judged([]) == (Verdict.CONSISTENT, [])
    verdict, warnings = judged([], tests=(FINE, BAD))
    assert verdict is Verdict.UNEXPLAINED and len(warnings) == 1 and "not white" in warnings[0]


def test_what_remains_not_noise_is_unexplained_or_partial_but_never_traced() -> None:
    claims = [Claim("sensor-lag:q", {})]
    assert judged([SensorLag("q")], claims) == (Verdict.TRACED, [])
    verdict, warnings = judged([SensorLag("q")], claims, (FINE, BAD))
    assert verdict in (Verdict.UNEXPLAINED, Verdict.PARTIAL) and warnings


def test_effects_that_worsen_held_out_data_are_not_traced() -> None:
    """Two nodes on a record without the lag: the one that has it predicts worse, and may not claim it."""
    search = search_of([planted([SensorLag("q")], LAG)])
    root = fit_of(search)
    best = fit_of(search, [SensorLag("q")], root)
    for values, verdict in (({}, Verdict.UNEXPLAINED), (LAG, Verdict.TRACED)):
        validation = [planted([SensorLag("q")] if values else [], values, 7)]
        out = [held_out(fitted, validation, None, informed=False) for fitted in (root, best)]
        found, _ = judge(search, root, best, [Claim("sensor-lag:q", {})], (FINE,), out[0], out[1], SETTINGS)
        assert found is verdict


def test_a_held_out_fit_that_failed_is_not_traced() -> None:
    validation = [planted([SensorLag("q")], LAG, 7)]
    search = replace(search_of([planted([SensorLag("q")], LAG)]), beside=validation)
    root = fit_of(search)
    best = fit_of(search, [SensorLag("q")], root)
    good = held_out(root, validation, None, informed=False)
    for before in (good, NOTHING):
        found, warnings = judge(search, root, best, [Claim("sensor-lag:q", {})], (FINE,), before, NOTHING, SETTINGS)
        assert found is Verdict.UNEXPLAINED and "not fitted" in warnings[0]


def test_a_set_is_hopeless_where_colour_stays_that_random_motion_does_not_take_in() -> None:
    """Coloured noise in every channel of two records is; a gust is not, nor one record alone, nor what is white."""
    rng = np.random.default_rng(5)

    def coloured(record: Record) -> Record:
        for name, size in (("alpha", 0.004), ("q", 0.006), ("nz", 0.06)):
            record = with_output(record, name, record[name].values + coloured_noise(rng, record.time, size, 0.3))
        return record

    candidates = (*FEW, GustTurbulence())
    plain = [planted([], None, 1), planted([], None, 2)]
    noisy = search_of([coloured(record) for record in plain], candidates)
    assert hopeless(noisy, fit_of(noisy))
    white, one = search_of(plain, candidates), search_of([coloured(plain[0])], candidates)
    assert not hopeless(white, fit_of(white))
    assert not hopeless(one, fit_of(one))
