"""The search adds what is needed, drops what is not, and stops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.quantities import quantities
from ident.tracing.selection.backward import backward_elimination
from ident.tracing.selection.criterion import gain
from ident.tracing.selection.expansion import expand
from ident.tracing.selection.forward import _freer_forms, first_round, forward_selection, hopeless
from ident.tracing.selection.ledger import Ledger, fit
from sim.effects.disturbance.gust_turbulence import GustTurbulence
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.record import Record
from sim.truth.noise import coloured_noise
from tests.searches import FEW, LAG, found_by, searched
from tests.tracing_problem import SETTINGS, fit_of, planted, problem_of, with_output


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


def test_what_is_far_behind_a_set_that_leaves_noise_is_not_tried_in_its_freer_form(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of([planted([SensorLag("q")], LAG, 1)], (SensorLag("q"), SensorScale("nz")))
    root = fit_of(problem)
    right, wrong = fit_of(problem, (SensorLag("q"),), root), fit_of(problem, (SensorScale("nz"),), root)
    ledger = Ledger(problem).kept(root, root.criterion).kept(right, right.criterion).kept(wrong, wrong.criterion)
    tried: list[tuple[str, ...]] = []

    def spy(ledger: Ledger, fitted: FittedModel) -> tuple[Ledger, FittedModel]:
        tried.append(fitted.names)
        return ledger, fitted

    monkeypatch.setattr("ident.tracing.selection.forward.freer_form", spy)
    assert _freer_forms(ledger, [right, wrong])[1] == [right, wrong] and tried == [right.names]
    tried.clear()
    # Where the best leaves more than noise, or is hardly ahead, each of them is.
    _freer_forms(ledger, [wrong, root])
    near = ledger.replaced(wrong, ledger.score(right) + 10.0)
    _freer_forms(near, [right, wrong])
    assert tried == [wrong.names, root.names, right.names, wrong.names]
