"""Which data choose: records that are held out take no part where two or more are fitted, and none that was fitted to other samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Candidate, Diagnosis, Verdict
from ident.tracing.found import Declared, Found
from ident.tracing.loop import diagnose, fit_declared, held_out_data, search, with_final_masks
from ident.tracing.replication.partial import Partial, cross_validated
from ident.tracing.result import Before, Outcome, reported
from ident.tracing.selection.ledger import Ledger
from ident.tracing.spikes.detection import input_edges
from ident.tracing.validation.held_out import HeldOutData, held_out
from sim.declaration.proposal import Traceable
from sim.effects.dynamics.curves.moment_nonlinearity import MOMENT_NONLINEARITY
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.sensor_spikes import InputSpikes, SensorSpikes
from sim.effects.sensor_path.vane_offset import VaneOffset
from sim.record import Channel, Record
from tests.bases import Flight
from tests.tracing_problem import SETTINGS, coloured, declared, doublets, planted, problem_of, with_output

LAG, LATE, AHEAD, SCALE = SensorLag("q"), SensorDelay("alpha"), VaneOffset(), SensorScale("nz")
LIBRARY: tuple[Traceable, ...] = (LAG, LATE, AHEAD, SCALE, MOMENT_NONLINEARITY)
LAGGED = {"sensor-lag:q.time_constant": 0.06}
DELAYED = {"sensor-delay:alpha.delay": 0.08}
SCALED = {"sensor-scale:nz.scale": 0.7}


def gentle() -> Flight:
    """Smaller than what is fitted: the ranges over which curves are drawn are those of all records that the model must serve."""
    flight = doublets()
    return Flight(flight.time, 0.7 * flight.u, max_step=0.02)


def unlike(effects: Sequence[Traceable], values: dict[str, float]) -> Record:
    """A held-out record of another truth."""
    return planted(effects, values, 9, flight=gentle())


def traced(records: Sequence[Record], validation: Record) -> Diagnosis:
    return diagnose(records, declared(), LIBRARY, (), [validation], SETTINGS)


def looked_at(diagnosis: Diagnosis) -> list[Candidate]:
    """The evidence without what is told of held-out data."""
    return [replace(candidate, held_out_change=None, held_out_scatter=None) for candidate in diagnosis.candidates]


def values(diagnosis: Diagnosis) -> dict[str, float]:
    return {name: quantity.value for name, quantity in diagnosis.after.items()}


def test_a_search_over_two_records_goes_its_way_whatever_is_held_out() -> None:
    """The verdict may ask, after the search, for what replicates; the search itself is the same to the last bit."""
    records = [planted([LAG], LAGGED, seed) for seed in (1, 2)]
    alike = traced(records, planted([LAG], LAGGED, 7, flight=gentle()))
    assert alike.verdict is Verdict.TRACED and [claim.name for claim in alike.effects] == [LAG.name] and not alike.used_to_choose
    for other in (unlike([LAG, SCALE], {**LAGGED, **SCALED}), unlike([AHEAD], {"vane-offset.arm": 8.0})):
        diagnosis = traced(records, other)
        assert diagnosis.verdict is not Verdict.TRACED
        assert diagnosis.steps[: len(alike.steps)] == alike.steps
        assert looked_at(diagnosis)[: len(alike.candidates)] == looked_at(alike)
        assert {name for step in diagnosis.steps for name in step.effects} == {LAG.name}
        # What held-out data refuse is taken back as a whole; what they bear is what the fitted records say.
        refused = diagnosis.verdict is Verdict.UNEXPLAINED
        expected = {name: quantity.value for name, quantity in diagnosis.before.items()} if refused else values(alike)
        assert values(diagnosis) == pytest.approx(expected, rel=1e-6)
        assert refused is (diagnosis.effects == ())


@pytest.mark.slow
def test_what_replicates_is_found_in_the_fitted_records_alone() -> None:
    """Coloured records, which no set of effects explains. Held-out data that refuse the effect must not send the search on to others."""
    records = [coloured(planted([LATE], DELAYED, seed), seed, 0.3) for seed in (1, 2)]
    alike = traced(records, coloured(planted([LATE], DELAYED, 7, flight=gentle()), 7, 0.3))
    assert alike.verdict is Verdict.PARTIAL and [claim.name for claim in alike.effects] == [LATE.name]
    also_scaled = traced(records, coloured(unlike([LATE, SCALE], {**DELAYED, **SCALED}), 9, 0.3))
    refusing = traced(records, coloured(unlike([SCALE], SCALED), 9, 0.3))
    for diagnosis in (also_scaled, refusing):
        assert diagnosis.steps == alike.steps
        assert looked_at(diagnosis) == looked_at(alike)
    assert also_scaled.verdict is Verdict.PARTIAL and values(also_scaled) == values(alike)
    assert refusing.verdict is Verdict.UNEXPLAINED and refusing.effects == ()


def test_beside_one_fitted_record_the_others_choose_and_are_not_called_held_out() -> None:
    """A vane that is hardly late in the fitted record, and clearly ahead of the centre of gravity in the other."""
    small, other = {"sensor-delay:alpha.delay": 0.01}, planted([AHEAD], {"vane-offset.arm": 4.0}, 9)
    one = planted([LATE], small, 2)

    def first(diagnosis: Diagnosis) -> str:
        return next(claim.name for claim in diagnosis.effects)

    alone, beside = traced([one], planted([LATE], small, 5)), traced([one], other)
    assert alone.used_to_choose and beside.used_to_choose
    assert (first(alone), first(beside)) == (LATE.name, AHEAD.name) and values(alone) != values(beside)
    assert {test.channel.split(", ")[1].split(" record")[0] for test in beside.tests_after} == {"fitted", "not fitted"}
    two = [one, planted([LATE], small, 3)]
    both, held = traced(two, planted([LATE], small, 5)), traced(two, other)
    assert not (both.used_to_choose or held.used_to_choose)
    assert both.steps == held.steps[: len(both.steps)] and first(both) == LATE.name
    assert {test.channel.split(", ")[1].split(" record")[0] for test in both.tests_after} == {"fitted", "held out"}


# Late spikes: they stand where the input switches, so that only the final model tells them from its motion.


def spiked(record: Record) -> tuple[Record, list[int]]:
    """Two wrong samples of q at switches of the elevator, a second apart at least."""
    switches = np.flatnonzero(input_edges(record, 0))
    at = [int(switches[1]), int(switches[switches > switches[1] + 60][0])]
    wrong = record["q"].values.copy()
    wrong[at] += [0.06, -0.05]
    return with_output(record, "q", wrong), at


def searched(records: Sequence[Record], candidates: Sequence[Traceable], validation: Sequence[Record] = ()) -> tuple[Declared, Found]:
    begun = fit_declared(replace(problem_of(records, candidates), predicted=validation))
    return begun, search(begun, held_out_data(begun, validation))


def test_late_spikes_leave_no_model_of_other_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    record, at = spiked(planted([LAG], LAGGED))
    candidates = (LAG, SCALE, SensorSpikes("q", "rad/s", 0.05))
    begun, found = searched([record], candidates)
    assert np.all(begun.ledger.problem.masks[0]), "found too early to test anything"
    final = with_final_masks(found)
    masks = final.ledger.problem.masks
    assert np.flatnonzero(~masks[0][1]).tolist() == at and np.all(masks[0][[0, 2]])
    assert final.ledger.models.keys() == found.ledger.models.keys() and len(final.ledger.models) > 1
    # From here to the report.
    kept: list[Ledger] = []

    def spy(
        ledger: Ledger, before: Before, after: Outcome, held: HeldOutData, validation: Sequence[Record], seconds: Mapping[str, float]
    ) -> Diagnosis:
        kept.append(ledger)
        return reported(ledger, before, after, held, validation, seconds)

    monkeypatch.setattr("ident.tracing.loop.reported", spy)
    diagnosis = diagnose([record], declared(), candidates, (), [planted([LAG], LAGGED, 7)], SETTINGS)
    (ledger,) = kept
    assert all(ledger.problem.holds(model) for model in ledger.models.values())
    for model in ledger.models.values():
        np.testing.assert_array_equal(model.fit.layout.problems[0].valid, masks[0])
    assert diagnosis.verdict is Verdict.TRACED
    assert {claim.name for claim in diagnosis.effects} == {LAG.name, "sensor-spikes:q"}
    assert np.flatnonzero(~diagnosis.fitted[0].used[1]).tolist() == at


@pytest.mark.parametrize("few", [True, False])
def test_after_late_spikes_what_replicates_is_fitted_anew_and_asked_anew_where_they_are_many(monkeypatch: pytest.MonkeyPatch, few: bool) -> None:
    monkeypatch.setattr(thresholds, "FEW_OTHER_SAMPLES", thresholds.FEW_OTHER_SAMPLES if few else 0.0)
    plain = [coloured(planted([LATE], DELAYED, seed), seed) for seed in (1, 2, 3, 4)]
    record, at = spiked(plain[0])
    records, validation = [record, *plain[1:3]], [plain[3]]
    asked: list[tuple[Ledger, Partial | None]] = []

    def spy(ledger: Ledger, root: FittedModel, held: HeldOutData) -> tuple[Ledger, Partial | None]:
        after, partial = cross_validated(ledger, root, held)
        asked.append((ledger, partial))
        return after, partial

    monkeypatch.setattr("ident.tracing.claims_beside_noise.cross_validated", spy)
    _, found = searched(records, (LATE, SCALE), validation)
    assert found.partial is not None and found.asked and len(asked) == 1
    final = with_final_masks(found)
    assert np.flatnonzero(~final.ledger.problem.masks[0][1]).tolist() == at
    assert len(asked) == (1 if few else 2) and (few or asked[1][1] is final.partial)
    assert few or all(np.array_equal(a, b) for a, b in zip(asked[1][0].problem.masks, final.ledger.problem.masks, strict=True))
    assert final.partial is not None and [claim.name for claim in final.partial.claims] == [claim.name for claim in found.partial.claims]
    # Nothing that was found on the other samples is told of these.
    before = {(item.within, item.name, item.gain) for item in found.ledger.evidence if item.held_out_change is not None}
    after = {(item.within, item.name, item.gain) for item in final.ledger.evidence if item.held_out_change is not None}
    assert after and not before & after
    assert len({step.sentence for step in final.ledger.steps}) == len(final.ledger.steps)
    assert final.best is final.partial.fitted and final.best is not found.best
    assert all(final.ledger.problem.holds(model) for model in (final.best, final.root, *final.ledger.models.values()))


def test_the_declared_model_is_simulated_on_mended_inputs_as_every_other_set_is() -> None:
    """Else every set would come out better on held-out data by what two spikes of the recorded elevator cost."""

    def spoilt(record: Record) -> Record:
        elevator = record["elevator"].values.copy()
        elevator[[160, 333]] += np.array([0.2, -0.3])
        return replace(record, inputs=(Channel.of("elevator", "rad", elevator),))

    validation = [spoilt(planted(seed=4))]
    declared_model = fit_declared(problem_of([spoilt(planted(seed=3))], (InputSpikes("elevator"), SCALE)))
    assert [claim.name for claim in declared_model.spikes] == ["sensor-spikes:elevator"]
    held = held_out_data(declared_model, validation)
    raw = held_out(declared_model.root, validation, held.masks, informed=False).frozen
    mended = held_out(declared_model.root, held.records, held.masks, informed=False).frozen
    assert held.declared.frozen is not None and raw is not None and mended is not None
    assert held.declared.frozen.cost == mended.cost < raw.cost - 100.0
