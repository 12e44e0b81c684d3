"""Effects that stand although what remains is not noise, as they are told: claims, sigmas, sentences, evidence, and when nothing is asked."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ident.tracing import claims_beside_noise, thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.claims_beside_noise import predicts_no_better, shown_strongly
from ident.tracing.diagnosis import Quantity
from ident.tracing.found import Found
from ident.tracing.loop import fit_declared, held_out_data
from ident.tracing.replication import known_motion
from ident.tracing.replication import partial as told
from ident.tracing.replication.by_record import Flight, most_telling
from ident.tracing.replication.comparison import CrossValidation
from ident.tracing.replication.partial import Partial, Validated, cross_validated
from ident.tracing.replication.weighing import weigh
from ident.tracing.screening.score_test import Finding
from ident.tracing.selection.ledger import Ledger
from ident.tracing.validation.held_out import HeldOut, HeldOutData, held_out
from ident.tracing.validation.improvement import hardly_better
from ident.tracing.weighed import ComparedSet, Ground
from ident.whole_record.gauss_newton import Fit
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.disturbance.gust_turbulence import GustTurbulence
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.disturbance.speed_variation import SpeedVariation
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.vane_offset import VaneOffset
from sim.record import Record
from tests.tracing_problem import coloured, declared, doublets, fit_of, planted, problem_of

LATE, AHEAD, SCALE = SensorDelay("alpha"), VaneOffset(), SensorScale("q")
GUST, PHUGOID = GustDiscrete(), Phugoid()
LIBRARY: tuple[Traceable, ...] = (LATE, AHEAD, SCALE)
DELAYED = {"sensor-delay:alpha.delay": 0.08}


def begun(records: Sequence[Record], validation: Sequence[Record]) -> tuple[Ledger, FittedModel, HeldOutData]:
    start = fit_declared(replace(problem_of(records, LIBRARY), predicted=validation))
    return start.ledger, start.root, held_out_data(start, validation)


@pytest.fixture(scope="module")
def found(late: Flight) -> tuple[Ledger, Partial, Ledger]:
    """Three fitted records and one held out: the ledger after, what stands, and the ledger before."""
    ledger, root, held = begun(late.records, [coloured(planted([LATE], DELAYED, 9), 9)])
    after, partial = cross_validated(ledger, root, held)
    assert partial is not None
    return after, partial, ledger


def test_a_claim_tells_what_stands_and_what_would_do_as_well(found: tuple[Ledger, Partial, Ledger]) -> None:
    ledger, partial, _ = found
    (claim,) = partial.claims
    assert claim.claimed and claim.name == LATE.name and claim.explanation == LATE.explanation and claim.records == ()
    assert set(claim.alternatives) <= {AHEAD.name} and len(claim.alternatives) <= thresholds.ALTERNATIVES_NAMED
    evidence = claim.evidence
    assert evidence is not None and evidence.already_in_model == ()
    assert 0.0 < evidence.error_left < 1.0 - thresholds.WORTH / 2.0 and 0.0 < evidence.error_left_std < 0.2
    assert len(evidence.by_record) == 3 and all(set(own) == {"delay"} for own in evidence.by_record)
    # Its probability rests on what was cross-validated beside it.
    assert claim.weighed is not None and claim.weighed.ground is Ground.CROSS_VALIDATED
    assert {LATE.name, *claim.alternatives} <= {name for item in claim.weighed.sets for name in item.names}
    # The derivatives under each name that would do, and nothing but those of the declared model.
    assert set(evidence.derivatives) == {LATE.name, *claim.alternatives}
    free = {item.name for item in declared().parameters if item.free and not item.name.startswith("bias_")}
    assert all(set(quantities) == free for quantities in evidence.derivatives.values())
    assert all(quantity.std > 0.0 for quantities in evidence.derivatives.values() for quantity in quantities.values())
    # What is claimed is fitted to the samples of the ledger, and judged on the record held out.
    assert partial.fitted.names == (LATE.name,) and ledger.problem.holds(partial.fitted) and ledger.known(partial.fitted) is partial.fitted
    assert ledger.score(partial.fitted) == partial.fitted.criterion
    assert partial.out.frozen is not None and len(partial.out.frozen.layout.problems) == 1


def test_the_value_is_that_of_the_common_fit_with_a_sigma_that_the_records_bear_out(found: tuple[Ledger, Partial, Ledger]) -> None:
    _, partial, _ = found
    (claim,) = partial.claims
    assert claim.evidence is not None
    shown, common = claim.parameters["delay"], most_telling(partial.fitted, LATE)["delay"]
    each = [own["delay"].value for own in claim.evidence.by_record]
    assert shown.value == common.value and shown.unit == "s"
    assert shown.std == pytest.approx(max(common.std, np.std(each, ddof=1) / np.sqrt(3.0)))
    assert abs(shown.value - 0.08) < 4.0 * shown.std


def test_sigmas_do_not_fall_below_the_scatter_between_three_records_and_two_do_not_tell() -> None:
    quantity = Quantity(1.0, 0.01, "s")
    scattered = told._scattered(quantity, [0.9, 1.0, 1.1])
    assert (scattered.value, scattered.unit) == (1.0, "s") and scattered.std == pytest.approx(0.1 / np.sqrt(3.0))
    assert told._scattered(quantity, [0.999, 1.0, 1.001]) == quantity
    assert told._scattered(quantity, [0.5, 1.5]) == quantity


def test_the_sentence_gives_the_change_on_each_record(found: tuple[Ledger, Partial, Ledger]) -> None:
    ledger, partial, before = found
    (step,) = ledger.steps[len(before.steps) :]
    assert step.effects == (LATE.name,)
    form = r"sensor-delay:alpha replicates and changes the error on records not fitted by (.*?)(; (.*) would do as well)?"
    match = re.fullmatch(form, step.sentence)
    assert match is not None
    changes = [float(part.removesuffix(" %")) for part in match[1].split(", ")]
    evidence = partial.claims[0].evidence
    assert evidence is not None and len(changes) == 3 and all(change < 0.0 for change in changes)
    # Their middle is what is left of the error, within the rounding to a per cent.
    assert np.mean(changes) == pytest.approx(100.0 * (evidence.error_left - 1.0), abs=3.0)
    assert (match[3] or "") == ", ".join(partial.claims[0].alternatives)


def test_all_that_was_weighed_is_evidence_with_its_reason(found: tuple[Ledger, Partial, Ledger]) -> None:
    ledger, partial, before = found
    weighed = {candidate.name: candidate for candidate in ledger.evidence[len(before.evidence) :] if candidate.within == ()}
    members = {LATE.name, *partial.claims[0].alternatives}
    assert members <= set(weighed)
    for name, candidate in weighed.items():
        assert candidate.fitted and candidate.held_out_change is not None and 0.0 <= candidate.p_value <= 1.0 and candidate.round == 1
        if name in members:
            assert candidate.remark in ("cross-validated", "the records give different values")
            assert candidate.held_out_change < -thresholds.WORTH / 2.0
        else:
            assert candidate.remark not in ("", "cross-validated")
    assert weighed[LATE.name].remark == "cross-validated"


def test_a_second_effect_is_told_beside_the_first() -> None:
    values = {**DELAYED, "sensor-scale:q.scale": 1.3}
    records = [coloured(planted([LATE, SCALE], values, seed), seed) for seed in (1, 2, 3)]
    ledger, root, held = begun(records, [coloured(planted([LATE, SCALE], values, 9), 9)])
    ledger, partial = cross_validated(ledger, root, held)
    assert partial is not None and {claim.name for claim in partial.claims} == {LATE.name, SCALE.name} == set(partial.fitted.names)
    first, second = partial.claims
    assert second.evidence is not None and second.evidence.already_in_model == (first.name,)
    assert (
        ledger.steps[-1].sentence.startswith(f"{second.name}, with {first.name} already in the model, replicates")
        and "already" not in ledger.steps[-2].sentence
    )


def test_what_is_claimed_beside_it_does_not_speak_against_an_effect(found: tuple[Ledger, Partial, Ledger]) -> None:
    """Before both were in the model they were weighed against each other."""
    _, partial, _ = found
    (item,) = partial.validated.chosen
    rival = replace(item.best, effect=SCALE)
    rivals = replace(item, others=(rival,), sets=(ComparedSet((LATE.name,), 0.0), ComparedSet((SCALE.name,), 0.0)))
    alone, beside = (told._claim(partial.fitted, rivals, other) for other in ((), (SCALE.name,)))
    assert alone.alternatives == (SCALE.name,) and beside.alternatives == ()
    assert alone.weighed is not None and beside.weighed is not None
    assert [each.names for each in beside.weighed.sets] == [(LATE.name,)] and len(alone.weighed.sets) == 2


def test_an_event_is_claimed_of_its_record_and_needs_no_other() -> None:
    """A gust in the second of three coloured records, which the record held out need not have."""
    crossed = {"gust-discrete.peak": 6.0, "gust-discrete.start": 6.0, "gust-discrete.duration": 1.0}
    flight = doublets(10.0, 25.0)
    records = [
        coloured(planted([GUST], {**crossed, "gust-discrete.peak": peak}, seed, flight=flight), seed) for seed, peak in enumerate((0.0, 6.0, 0.0))
    ]
    validation = [coloured(planted(seed=9, flight=flight), 9)]
    start = fit_declared(replace(problem_of(records, (GUST,)), predicted=validation))
    _, partial = cross_validated(start.ledger, start.root, held_out_data(start, validation))
    assert partial is not None and partial.events_alone and partial.fitted.names == (GUST.name,)
    (claim,) = partial.claims
    assert claim.records == (1,) and claim.parameters["peak"].value == pytest.approx(6.0, abs=1.0)
    assert claim.parameters["start"].value == pytest.approx(6.0, abs=0.2) and claim.evidence is not None and claim.evidence.by_record == ()
    assert claim.weighed is not None and claim.weighed.ground is Ground.CROSS_VALIDATED


@pytest.mark.parametrize(("alone", "rise", "no_better"), [(True, -1.0, False), (True, 1.0, True), (False, -1.0, True), (False, 1.0, True)])
def test_events_alone_need_not_lower_the_error_of_data_held_out_only_not_raise_it(
    found: tuple[Ledger, Partial, Ledger], alone: bool, rise: float, no_better: bool
) -> None:
    """Two predictions that are alike but for a little of their cost."""
    _, partial, _ = found
    plain = partial.out.frozen
    assert plain is not None
    said = replace(partial, out=HeldOut(replace(plain, cost=plain.cost + rise), None), validated=Validated((), ()), events_alone=alone)
    assert predicts_no_better(HeldOutData(declared=HeldOut(plain, None)), said) is no_better


def test_what_is_fitted_to_the_data_held_out_has_to_lower_their_error_by_a_twentieth(monkeypatch: pytest.MonkeyPatch) -> None:
    """A change of speed that is not there takes some noise along, and by all that it could bring: half of that would be no bar, however much."""
    monkeypatch.setattr(thresholds, "SHOWS", 0.0)
    problem, speed = problem_of([planted([], {}, seed) for seed in (1, 2)]), SpeedVariation()
    root = fit_of(problem)
    fitted = fit_of(problem, [speed], root)
    passed = []
    for seed in range(11, 15):
        record = planted([], {}, seed)
        before, after = (held_out(each, [record], None, informed=False) for each in (root, fitted))
        passed.append(not hardly_better(before, after, weak=True))
        for learnt in (True, False):
            said = Partial((), fitted, after, Validated((), ()), learnt_there=learnt)
            assert predicts_no_better(HeldOutData(declared=before), said) is (learnt or not passed[-1])
    assert sum(passed) > 2


def test_a_phugoid_that_the_base_has_is_claimed_with_what_it_is_as_well(phugoids: tuple[Ledger, FittedModel, HeldOutData]) -> None:
    """Cross-validated where it stands; without evidence, and yet by name, where only another effect does."""
    ledger, base, held = phugoids
    _, partial = cross_validated(ledger, base, held)
    assert partial is not None and not partial.events_alone and partial.learnt_there
    (claim,) = partial.claims
    assert claim.name == PHUGOID.name and claim.alternatives[0] == "speed-variation" and claim.evidence is not None
    assert abs(claim.parameters["attitude"].value) > thresholds.CLEARLY_OFF_ABSENCE * claim.parameters["attitude"].std
    said = told._of_background(base, PHUGOID)
    assert said.alternatives == ("speed-variation",) and said.evidence is None and said.weighed is not None
    assert said.claimed
    # One whose numbers no one believes has taken in what is missing: it stays in the model, and is no claim.
    beyond = base.fit.layout.names.index("phugoid.trim_moment")
    theta = base.fit.theta.copy()
    theta[beyond] = 0.3
    assert not told._of_background(replace(base, fit=replace(base.fit, theta=theta)), PHUGOID).claimed


@pytest.fixture(scope="module")
def phugoids() -> tuple[Ledger, FittedModel, HeldOutData]:
    """Coloured records of 14 s along paths up and down, the declared model with a phugoid fitted to three of them."""
    flight, attitudes = doublets(14.0, 25.0), (0.06, -0.05, 0.05, 0.04)
    flown = [{"phugoid.attitude": each, "phugoid.induced_drag": 4.0} for each in attitudes]
    records = [coloured(planted([PHUGOID], values, seed, flight=flight), seed) for seed, values in enumerate(flown, start=1)]
    start = fit_declared(replace(problem_of(records[:3], (PHUGOID, SpeedVariation())), predicted=records[3:]))
    return start.ledger, fit_of(start.ledger.problem, (PHUGOID,), start.root), held_out_data(start, records[3:])


def test_an_even_change_of_speed_is_claimed_in_the_place_of_a_phugoid_that_no_one_believes(
    phugoids: tuple[Ledger, FittedModel, HeldOutData], monkeypatch: pytest.MonkeyPatch
) -> None:
    ledger, base, held = phugoids

    def disbelieving(flight: Flight, fitted: FittedModel, finding: Finding, before: Mapping[int, Fit]) -> CrossValidation | None:
        item = weigh(flight, fitted, finding, before)
        return item if item is None or finding.effect.name != PHUGOID.name else replace(item, stands=False)

    monkeypatch.setattr(known_motion, "weigh", disbelieving)
    after, partial = cross_validated(ledger, base, held)
    assert partial is not None and PHUGOID.name in base.names
    assert [claim.name for claim in partial.claims] == ["speed-variation"] and partial.fitted.names == ("speed-variation",)
    assert after.models.keys() > ledger.models.keys()


def test_where_nothing_stands_only_the_evidence_is_told() -> None:
    ledger, root, held = begun([coloured(planted([], None, seed), seed) for seed in (4, 5, 6)], [coloured(planted([], None, 9), 9)])
    after, partial = cross_validated(ledger, root, held)
    assert partial is None and after.steps == ledger.steps and after.models == ledger.models
    assert all(candidate.remark not in ("", "cross-validated") for candidate in after.evidence[len(ledger.evidence) :])


def test_what_cannot_be_asked_is_not_said(late: Flight) -> None:
    """Without data that can be predicted, with one record in all, and with process noise the ledger comes back as it was."""
    validation = [coloured(planted([LATE], DELAYED, 9), 9)]
    ledger, root, held = begun(late.records[:2], validation)
    assert cross_validated(ledger, root, HeldOutData()) == (ledger, None)
    assert cross_validated(ledger, root, replace(held, masks=None)) == (ledger, None)
    moved = fit_of(ledger.problem, (GustTurbulence(),), root)
    assert cross_validated(ledger, moved, held) == (ledger, None)
    # One record and one that is held out from all but the verdict: nothing to leave out. Where that may choose, there is.
    quiet = [coloured(planted([LATE], DELAYED, seed), seed, 0.3) for seed in (1, 9)]  # two records have to lose most of what each leaves
    alone, lonely, other = begun(quiet[:1], quiet[1:])
    assert other.choosing
    assert cross_validated(alone, lonely, replace(other, choosing=False)) == (alone, None)
    assert cross_validated(alone, lonely, other)[1] is not None


def test_only_what_three_records_show_by_twice_its_worth_is_shown_strongly(found: tuple[Ledger, Partial, Ledger]) -> None:
    _, partial, _ = found
    (item,) = partial.validated.chosen

    def said(total: float, records: int) -> Partial:
        reduction = replace(item.best.reduction, total=total, by_record=(total,) * records)
        chosen = [replace(item, best=replace(item.best, reduction=reduction))]
        return replace(partial, validated=replace(partial.validated, chosen=chosen))

    assert [shown_strongly(said(*each)) for each in ((-0.21, 3), (-0.19, 3), (-0.5, 2))] == [True, False, False]
    assert not shown_strongly(replace(partial, validated=Validated((), ())))
    # One more record then has to speak against it; it is enough that it says nothing.
    plain = partial.out.frozen
    silent = replace(said(-0.3, 3), out=HeldOut(plain, None))
    assert not predicts_no_better(HeldOutData(declared=HeldOut(plain, None)), silent)
    assert predicts_no_better(HeldOutData(declared=HeldOut(plain, None)), replace(silent, validated=said(-0.15, 3).validated))
    assert predicts_no_better(HeldOutData(declared=HeldOut(plain, None), choosing=True), silent)


@pytest.mark.parametrize(("doubted", "left"), [((), None), (("second",), 1), (("first",), None), (("third",), 2), (("second", "third"), 1)])
def test_what_is_less_likely_than_not_takes_along_only_what_was_found_beside_it(
    found: tuple[Ledger, Partial, Ledger], monkeypatch: pytest.MonkeyPatch, doubted: tuple[str, ...], left: int | None
) -> None:
    """Three effects, one found beside the other; where the first is doubted nothing came before it, and the verdict withdraws all."""
    ledger, partial, _ = found
    (item,) = partial.validated.chosen
    chosen = [replace(item, best=replace(item.best, effect=SimpleNamespace(name=name))) for name in ("first", "second", "third")]
    partial = replace(partial, validated=replace(partial.validated, chosen=chosen))
    kept: list[int] = []

    def judged(ledger: Ledger, base: object, held: object, validated: Validated) -> tuple[Ledger, None]:
        kept.append(len(validated.chosen))
        return ledger, None

    monkeypatch.setattr(claims_beside_noise, "unlikely", lambda *_: list(doubted))
    monkeypatch.setattr(claims_beside_noise, "as_partial", judged)
    root = partial.fitted  # stands for any
    found_before = Found(ledger, root, root, root, HeldOutData(), partial, True, ())
    after = claims_beside_noise.likely_part(ledger, found_before, partial)
    assert after == (ledger, partial if left is None else None) and kept == ([] if left is None else [left])
    assert claims_beside_noise.likely_part(ledger, found_before, None) == (ledger, None)
