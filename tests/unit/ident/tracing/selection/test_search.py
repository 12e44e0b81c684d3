"""Fitted models carry values from one to the next; the search adds what is needed, drops what is not, and stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel, carried, compiled_with, free_names
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.candidate_model.quantities import quantities
from ident.tracing.selection.backward import backward_elimination, refined
from ident.tracing.selection.criterion import gain
from ident.tracing.selection.expansion import expand
from ident.tracing.selection.forward import first_round, forward_selection, hopeless
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.selection.refitting import refitted
from ident.whole_record.layout import FitSettings, lay_out
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.gust_turbulence import GustTurbulence
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.dynamics.elastic_mode import ElasticMode
from sim.effects.sensor_path.sensor_drift import SensorDrift
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.record import Record
from sim.truth.noise import coloured_noise
from tests.tracing_problem import OUTPUTS, SETTINGS, declared, fit_of, planted, problem_of, with_output

LAG = {"sensor-lag:q.time_constant": 0.06}
FEW: tuple[Traceable, ...] = (SensorScale("q"), SensorScale("nz"), SensorLag("alpha"), SensorLag("q"), UnmeasuredInput())


def searched(problem: TraceProblem, root: FittedModel) -> tuple[Ledger, FittedModel]:
    """Forward selection from the declared model."""
    ledger, first = first_round(Ledger(problem), root)
    return forward_selection(ledger, root, first)


def found_by(records: Sequence[Record], candidates: Sequence[Traceable] = FEW) -> tuple[Ledger, FittedModel, FittedModel]:
    """A ledger, the declared model and the set that a search ends with."""
    problem = problem_of(records, candidates)
    root = fit_of(problem)
    ledger, best = refined(*backward_elimination(*searched(problem, root)))
    return ledger, root, best


# Fitted models.


def test_values_are_carried_by_name_from_one_model_to_the_next() -> None:
    """A smaller model's values begin a larger one's fit, and the other way round; what is new begins as told, or as declared."""
    records = [planted([SensorLag("q")], LAG, seed) for seed in (1, 2)]
    problem = problem_of(records)
    small = fit_of(problem, [SensorScale("nz")])
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
    large = fit_of(problem, effects, small, {"sensor-lag:q.time_constant": 0.05})
    back, _ = carried(small.fit.layout, large.values, {})
    shared = {**large.values.shared}
    assert {name: value for name, value in zip(small.fit.layout.shared, back, strict=False)} == {
        name: shared[name] for name in small.fit.layout.shared
    }


def test_added_states_begin_at_rest() -> None:
    problem = problem_of([planted()])
    root = fit_of(problem)
    _, system = compiled_with(declared(), [ElasticMode()], OUTPUTS)
    layout = lay_out(problem.records, system, FitSettings(max_step=0.02))
    _, guesses = carried(layout, root.values, {})
    assert guesses is not None
    np.testing.assert_array_equal(guesses[0][:2], root.fit.lines[0].states)
    assert not np.any(guesses[0][2:])


def test_a_fit_begun_at_its_own_end_stays_there() -> None:
    problem = problem_of([planted([SensorLag("q")], LAG)])
    fitted = fit_of(problem, [SensorLag("q")])
    again = fit_of(problem, [SensorLag("q")], fitted)
    assert again.fit.cost == pytest.approx(fitted.fit.cost, abs=1e-6)
    assert again.fit.iterations <= 3


def test_parameters_of_an_effect_of_one_record_are_local() -> None:
    """Each record has its own drift; a scale is common to both. Both come out as planted."""
    drift = SensorDrift("q", "rad/s", 5e-4)
    effects = (drift, SensorScale("nz"))
    records = [planted(effects, {"sensor-drift:q.slope": slope, "sensor-scale:nz.scale": 1.2}, seed) for seed, slope in ((1, 0.002), (2, -0.003))]
    fitted = fit_of(problem_of(records), effects)
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
    problem = problem_of([planted()])
    fitted = fit_of(problem, [UnmeasuredInput()])
    assert len(free_names(UnmeasuredInput())) == 4
    assert fitted.criterion == pytest.approx(2.0 * fitted.fit.cost + 4.0 * np.log(fitted.fit.counts.sum()) + SETTINGS.event)


def test_bad_starts_leave_nothing_fitted() -> None:
    problem = problem_of([planted()])
    assert problem.fit([SensorScale("q")], None, {"sensor-scale:q.scale": np.nan}) is None


# The search.


def test_clean_data_return_the_root() -> None:
    ledger, root, best = found_by([planted(seed=3)])
    assert best.names == ()
    assert best.fit.cost == pytest.approx(root.fit.cost, abs=1e-3)
    assert {candidate.name for candidate in ledger.evidence} <= {effect.name for effect in FEW}
    assert all(candidate.within == () for candidate in ledger.evidence)


@pytest.mark.parametrize("count", [1, 2], ids=["one record", "two records"])
def test_one_planted_effect_is_found_from_end_to_end(count: int) -> None:
    ledger, root, best = found_by([planted([SensorLag("q")], LAG, seed) for seed in range(1, 1 + count)])
    assert best.names == ("sensor-lag:q",)
    shown = quantities(best, SensorLag("q"))["time_constant"]
    assert abs(shown.value - 0.06) < 4.0 * shown.std < 0.02
    assert ledger.score(best) < ledger.score(root) - 100.0
    winner = next(candidate for candidate in ledger.evidence if candidate.name == "sensor-lag:q")
    assert winner.fitted and winner.round == 1 and winner.p_value < 1e-12
    assert winner.gain == max(candidate.gain for candidate in ledger.evidence if candidate.within == ())
    assert any(step.effects == ("sensor-lag:q",) for step in ledger.steps)


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
    problem = problem_of([planted([SensorLag("q")], LAG)], FEW)
    accept = problem.settings.accept
    root = fit_of(problem)
    ledger = Ledger(problem).kept(root, root.criterion)
    lag = fit_of(problem, [SensorLag("q")], root)
    both = fit_of(problem, [SensorScale("nz"), SensorLag("q")], lag)
    ledger = ledger.kept(both, ledger.score(root) - gain(root, lag, accept) - gain(lag, both, accept))
    ledger, best = backward_elimination(ledger, both)
    assert best.names == ("sensor-lag:q",)
    assert any("sensor-scale:nz is no longer needed" in step.sentence for step in ledger.steps)
    assert ledger.score(best) < ledger.score(both)


def test_what_is_needed_is_kept() -> None:
    effects = (SensorScale("nz"), SensorLag("q"))
    problem = problem_of([planted(effects, {**LAG, "sensor-scale:nz.scale": 1.3})], FEW)
    both = fit_of(problem, effects, fit_of(problem))
    assert backward_elimination(Ledger(problem).kept(both, both.criterion), both)[1] is both


def test_an_exhausted_search_adds_nothing() -> None:
    problem = problem_of([planted([SensorLag("q")], LAG)], FEW, replace(SETTINGS, budget=0.0))
    root = fit_of(problem)
    ledger = Ledger(problem)
    assert ledger.exhausted
    assert expand(ledger, root, 1) == (ledger, [])
    ledger, best = searched(problem, root)
    assert ledger.evidence == () and best.names == ()


def test_work_is_counted_and_ends_the_search() -> None:
    """A budget that the declared model leaves a little of: the search ends after the fit that spends it, not a round later."""
    record = planted(
        [SensorLag("q"), SensorScale("nz"), SensorLag("alpha")], {**LAG, "sensor-scale:nz.scale": 1.3, "sensor-lag:alpha.time_constant": 0.1}
    )
    free, root = fit(Ledger(problem_of([record], FEW)), (), None)
    assert root is not None
    begun = free.spent
    free, first = first_round(free, root)
    free, _ = forward_selection(free, root, first)
    assert 0.0 < begun < 0.3 * free.spent
    tight = replace(Ledger(problem_of([record], FEW, replace(SETTINGS, budget=begun + 0.5))), spent=begun)
    # The same record, but another problem: its own fit of the declared model.
    root = fit_of(tight.problem)
    assert not tight.exhausted
    tight, first = first_round(tight, root)
    tight, _ = forward_selection(tight, root, first)
    assert tight.exhausted
    assert tight.spent < 0.6 * free.spent
    assert sum(candidate.fitted for candidate in tight.evidence) < sum(candidate.fitted for candidate in free.evidence)


def test_a_set_is_expanded_only_once() -> None:
    problem = problem_of([planted([SensorLag("q")], LAG)], (SensorLag("q"), SensorScale("nz")))
    root = fit_of(problem)
    ledger, children = expand(Ledger(problem).kept(root, root.criterion), root, 1)
    assert [child.names for child in children] == [("sensor-lag:q",)]
    again, children = expand(ledger, root, 1)
    assert again is ledger and children == []


def test_the_better_of_two_fits_of_a_set_is_kept() -> None:
    problem = problem_of([planted()])
    root = fit_of(problem)
    ledger = Ledger(problem).kept(root, 10.0).kept(root, 20.0)
    assert ledger.score(root) == 10.0
    assert ledger.kept(root, 5.0).score(root) == 5.0
    # A stage returns a ledger; the one it was given is as it was.
    assert ledger.score(root) == 10.0


# Other masks are another problem.


def holed(problem: TraceProblem) -> list[np.ndarray]:
    """Masks without twenty samples of q."""
    masks = [mask.copy() for mask in problem.masks]
    masks[0][1, 100:120] = False
    return masks


def test_no_model_that_was_fitted_to_other_samples_enters_a_ledger() -> None:
    problem = problem_of([planted([SensorLag("q")], LAG)], FEW)
    root, other = fit_of(problem), problem.with_masks(holed(problem))
    with pytest.raises(ValueError, match="the declared model was fitted to other samples"):
        Ledger(other).kept(root, root.criterion)
    again = fit_of(other)
    assert Ledger(other).kept(again, again.criterion).known(again) is again
    with pytest.raises(ValueError, match="other samples"):
        Ledger(problem).kept(again, again.criterion)
    # Other records of the same masks are other samples, too.
    with pytest.raises(ValueError, match="other samples"):
        Ledger(replace(problem, records=[planted([SensorLag("q")], LAG, 2)])).kept(root, root.criterion)


def test_other_masks_leave_no_stale_candidate() -> None:
    """All sets of a search are there again, each fitted to the new samples, with scores that a search on them would have given."""
    ledger, _, best = found_by([planted([SensorLag("q")], LAG)])
    masks = holed(ledger.problem)
    fresh = refitted(ledger, masks, best)
    assert fresh is not None
    assert fresh.models.keys() == ledger.models.keys() and fresh.scores.keys() == fresh.models.keys()
    for fitted in fresh.models.values():
        np.testing.assert_array_equal(fitted.fit.layout.problems[0].valid, masks[0])
        assert int(fitted.fit.counts.sum()) == int(masks[0].sum())
    declared = fresh.models[frozenset()]
    assert fresh.score(declared) == declared.criterion
    one = fresh.known(best)
    assert fresh.score(one) == pytest.approx(declared.criterion - gain(declared, one, ledger.problem.settings.accept))
    # Against a search that never saw the other masks.
    alone = problem_of(ledger.problem.records, FEW).with_masks(masks)
    assert declared.fit.cost == pytest.approx(fit_of(alone).fit.cost, abs=0.05)
    assert one.fit.cost == pytest.approx(fit_of(alone, best.effects, fit_of(alone)).fit.cost, abs=0.05)
    # Nothing counts as extended yet.
    assert fresh.expanded == frozenset() and fresh.steps == ledger.steps


def test_a_set_is_hopeless_where_colour_stays_that_process_noise_does_not_take_in() -> None:
    """Coloured noise in every channel of two records is; a gust is not, nor one record alone, nor what is white."""
    rng = np.random.default_rng(5)

    def coloured(record: Record) -> Record:
        for name, size in (("alpha", 0.004), ("q", 0.006), ("nz", 0.06)):
            record = with_output(record, name, record[name].values + coloured_noise(rng, record.time, size, 0.3))
        return record

    candidates = (*FEW, GustTurbulence())
    plain = [planted([], None, 1), planted([], None, 2)]
    noisy = problem_of([coloured(record) for record in plain], candidates)
    assert hopeless(Ledger(noisy), fit_of(noisy))
    white, one = problem_of(plain, candidates), problem_of([coloured(plain[0])], candidates)
    assert not hopeless(Ledger(white), fit_of(white))
    assert not hopeless(Ledger(one), fit_of(one))
