"""Which of the effects that stand is chosen, which would do as well, and when a guard forbids any."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Quantity
from ident.tracing.replication.by_record import Flight, Replication
from ident.tracing.replication.comparison import DIFFERING, CrossValidation, choose, outdone
from ident.tracing.replication.error_reduction import reduction
from ident.tracing.screening.score_test import Finding
from ident.tracing.validation.held_out import held_out
from ident.tracing.witness import Silent
from ident.whole_record.gauss_newton import Fit
from sim.declaration.proposal import Traceable
from sim.effects.dynamics.curves.control_nonlinearity import ControlNonlinearity
from sim.effects.dynamics.curves.control_weakening import ControlWeakening
from sim.effects.dynamics.curves.moment_nonlinearity import MOMENT_NONLINEARITY
from sim.effects.guards.products import GUARDS
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.tracing_problem import fit_of, problem_of, root_of

LATE = SensorDelay("alpha")
SCALED = SensorScale("q")


def standing(effect: Traceable, fitted: FittedModel, predictions: list[Fit], share: float, *, stands: bool = True) -> CrossValidation:
    """A candidate that leaves this share of every error, with one parameter a name in ``absent``."""
    left = {
        r: replace(fit, weighted=replace(fit.weighted, residuals=(share * fit.residuals[0],))) for r, fit in enumerate(predictions)
    }  # the same errors, smaller: a difference without scatter
    lowered = reduction(predictions, [left[r] for r in sorted(left)])
    finding = Finding(effect, 10.0, len(effect.absent), ({},), (10.0,), np.ones(3))
    return CrossValidation(effect, finding, fitted, lowered, Replication((), stands), 100.0, stands, "", left)


def test_a_guard_stands_against_an_effect_by_being_better_or_by_doing_as_well_and_replicating(late: Flight) -> None:
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    guard = next(effect for effect in GUARDS if effect.name == "guard:alpha-q")
    squared = next(effect for effect in GUARDS if effect.name == "guard:control-squared")
    bend, curved = replace(MOMENT_NONLINEARITY, low=-0.1, high=0.1), ControlNonlinearity()
    effect = standing(bend, fitted, before, 0.6)
    assert choose([effect]) is not None
    assert choose([effect, standing(guard, fitted, before, 0.5)]) is None
    assert choose([effect, standing(guard, fitted, before, 0.5, stands=False)]) is None
    assert choose([effect, standing(guard, fitted, before, 0.7)]) is not None
    assert choose([effect, standing(guard, fitted, before, 0.6)]) is None
    assert choose([effect, standing(guard, fitted, before, 0.6, stands=False)]) is not None
    # What an effect contains speaks for it.
    assert choose([standing(curved, fitted, before, 0.6), standing(squared, fitted, before, 0.5)]) is not None
    assert choose([effect, standing(squared, fitted, before, 0.5)]) is None


def test_the_same_trace_under_another_name_is_told_though_its_values_differ_from_record_to_record(late: Flight) -> None:
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    best, differing = standing(SCALED, fitted, before, 0.6), standing(LATE, fitted, before, 0.59, stands=False)
    told = replace(differing, replication=Replication(({"delay": Quantity(0.1, 0.01, "s")},), False))
    apart = replace(told, finding=replace(told.finding, contribution=np.array([1.0, -1.0, 0.0])))
    assert [item.effect.name for item in choose([best, told]).others] == [LATE.name]  # type: ignore[union-attr]
    assert choose([best, differing]).others == choose([best, apart]).others == ()  # type: ignore[union-attr]


def test_the_same_trace_is_told_though_it_falls_just_short_of_what_is_worth_a_claim(late: Flight) -> None:
    """An error left of 0.9 is worth a claim, 0.91 is not, and 0.96 is not worth a word."""
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    best = standing(SCALED, fitted, before, 0.9)
    short, little = (standing(LATE, fitted, before, share, stands=False) for share in (0.91, 0.96))
    apart = replace(short, finding=replace(short.finding, contribution=np.array([1.0, -1.0, 0.0])))
    assert [item.effect.name for item in choose([best, short]).others] == [LATE.name]  # type: ignore[union-attr]
    assert choose([best, little]).others == choose([best, apart]).others == ()  # type: ignore[union-attr]


def test_of_equals_a_witness_decides_and_only_then_is_asked(late: Flight) -> None:
    fitted = fit_of(problem_of(list(late.records)), (LATE, SCALED), None, {"sensor-delay:alpha.delay": 0.07, "sensor-scale:q.scale": 1.01})
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    one, other = standing(LATE, fitted, before, 0.600), standing(SCALED, fitted, before, 0.605)
    asked: list[str] = []

    class ForTheScale(Silent):
        def __call__(self, effect: str, parameters: Mapping[str, Quantity], /) -> int:
            asked.append(effect)
            return int(effect == SCALED.name and parameters["scale"].value > 0)

    witness = ForTheScale()
    assert (first := choose([one, other])) is not None and first.best is one
    assert (second := choose([one, other], witness)) is not None and second.best is other and [item.effect for item in second.others] == [LATE]
    assert sorted(asked) == sorted([LATE.name, SCALED.name])
    asked.clear()
    assert (third := choose([one, standing(SCALED, fitted, before, 0.8)], witness)) is not None and third.best is one and asked == []


def test_what_does_as_well_as_the_one_that_is_named_is_told_though_a_dearer_one_predicts_better(late: Flight) -> None:
    """A curve leaves 57 %, an effect of one parameter, which is named, 58.5 %, and another one 60 %: equal to the second, not to the first."""
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    curve = standing(replace(MOMENT_NONLINEARITY, low=-0.1, high=0.1), fitted, before, 0.57)
    named, other = standing(LATE, fitted, before, 0.585), standing(SCALED, fitted, before, 0.60)
    for apart, item in enumerate((curve, named, other)):
        item.finding.contribution[:] = np.eye(3)[apart]
    chosen = choose([curve, named, other])
    assert chosen is not None and chosen.best is named and [item.effect.name for item in chosen.others] == [MOMENT_NONLINEARITY.name, SCALED.name]


def test_another_form_of_the_best_is_no_alternative_to_it(late: Flight) -> None:
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    best, other = standing(ControlNonlinearity(), fitted, before, 0.5), standing(ControlWeakening(), fitted, before, 0.505)
    chosen = choose([best, other, standing(SCALED, fitted, before, 0.502)])
    assert chosen is not None and len({chosen.best.effect.name, *(item.effect.name for item in chosen.others)}) == len(chosen.others) + 1
    alone = choose([best, other])
    assert alone is not None and alone.others == () and len(alone.sets) == 1


def test_what_an_effect_on_which_records_differ_predicts_better_is_an_imitation(late: Flight) -> None:
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    best = standing(LATE, fitted, before, 0.8)
    differing = replace(standing(SCALED, fitted, before, 0.6, stands=False), why=DIFFERING)
    assert outdone([best, differing], best)
    assert not outdone([best, standing(SCALED, fitted, before, 0.6, stands=False)], best)  # it fell for another reason
    guard = next(effect for effect in GUARDS if effect.name == "guard:alpha-q")
    assert not outdone([best, replace(standing(guard, fitted, before, 0.6, stands=False), why=DIFFERING)], best)
    assert not outdone([best, replace(differing, predictions=standing(SCALED, fitted, before, 0.79).predictions)], best)
