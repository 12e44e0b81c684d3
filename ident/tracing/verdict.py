"""From evidence to a verdict; an honest `unexplained` beats a wrong name."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from ident.process_noise.filter_error import noise_levels, predictive_log_likelihood
from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.residuals import ResidualTest
from ident.tracing import thresholds
from ident.tracing.belief.standing import cautions_of
from ident.tracing.candidate_model.fitted_model import FittedModel, local_names
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.candidate_model.quantities import quantities, records_of
from ident.tracing.diagnosis import Caution, Claim, Concern, Requirement, Verdict
from ident.tracing.equivalents import same_by_value
from ident.tracing.ranking.choice import Choice, alternatives_of, is_ambiguous
from ident.tracing.validation.held_out import HeldOut, HeldOutData
from ident.tracing.validation.whiteness import whiteness
from ident.tracing.weighed import Ground, Weighed
from ident.whole_record.gauss_newton import Fit

WIND = frozenset({"gust", "headwind"})  # ports by which the air moves
OF_EVENTS = "an event has a free place, and one that small among three causes or more stands for what they do not get quite right"
OF_MANY = ", or nearly so: of three causes or more each has to show there, or one that is not in the library is put together from them"


@dataclass(frozen=True, eq=False)
class ResidualTests:
    """Residual tests of the fitted records, and of those that were not fitted, under what the fitted ones taught."""

    fitted: tuple[ResidualTest, ...]
    others: tuple[ResidualTest, ...] = ()

    @property
    def all(self) -> tuple[ResidualTest, ...]:
        return (*self.fitted, *self.others)


@dataclass(frozen=True, eq=False)
class Judgement:
    """A verdict on a set of effects: what is claimed, what was tested, and what speaks against more.

    ``not_met`` : requirements that kept an effect from being even a hint; the others are those of the cautions.
    """

    verdict: Verdict
    best: FittedModel
    out: HeldOut
    claims: tuple[Claim, ...]
    tests: ResidualTests
    cautions: tuple[Caution, ...]
    not_met: tuple[Requirement, ...] = ()


def judge(problem: TraceProblem, root: FittedModel, choice: Choice, spikes: Sequence[Claim], held: HeldOutData) -> Judgement:
    """Judge a set of effects against the declared model ``root``; ``spikes`` are claimed with it."""
    best, tests = choice.best, residual_tests(choice.best, choice.out, held)
    claims = (*spikes, *claims_of(problem, choice))
    verdict, cautions = verdict_on(problem, root, choice, claims, tests, held)
    return Judgement(verdict, best, choice.out, claims, tests, tuple(cautions))


def residual_tests(best: FittedModel, out: HeldOut, held: HeldOutData) -> ResidualTests:
    """Is what remains noise, on the fitted records and on the others?"""
    others = whiteness(out.informed, held.label) if out.informed is not None else ()
    return ResidualTests(tuple(whiteness(best.fit, "fitted")), tuple(others))


def not_noise(tests: Sequence[ResidualTest], least: float) -> list[Caution]:
    """What is left: a caution for each test whose p-value is below ``least``."""
    return [
        Caution(
            Concern.NOT_NOISE,
            f"{test.channel}: {test.sentence} (p = {test.p_value:.1e})",
            test,
            Requirement(f"the p-value of the residual test of {test.channel}", test.p_value, least, at_least=True),
        )
        for test in tests
        if test.p_value < least
    ]


def claims_of(problem: TraceProblem, choice: Choice) -> list[Claim]:
    """The effects of a set, with what could take the place of each; hints where a guard is among them."""
    best, others = choice.best, alternatives_of(choice, problem.guards)
    guarded, out = bool(best.guards), []
    for effect in (each for each in best.effects if not each.traits.guard):
        found = quantities(best, effect)
        same = same_by_value(effect, found)
        alternatives = tuple(dict.fromkeys([*same, *others.get(effect.name, ())]))[: thresholds.ALTERNATIVES_NAMED]
        ground = Ground.ONE_STEP if has_process_noise(best.system) else Ground.NOISE_LEFT
        acts_on = records_of(best, effect)
        out.append(Claim(effect.name, found, alternatives, not guarded, acts_on, effect.explanation, weighed=Weighed(ground, choice.sets, same)))
    return out


def verdict_on(
    problem: TraceProblem, root: FittedModel, choice: Choice, claims: Sequence[Claim], tests: ResidualTests, held: HeldOutData
) -> tuple[Verdict, list[Caution]]:
    """The verdict that tests and held-out data allow, and what speaks against more."""
    best, least = choice.best, problem.settings.white
    left = not_noise(tests.all, least)
    if not claims and not best.effects:
        if left and not not_noise(tests.fitted, least):
            told = "the declared model explains the fitted records but not the others: fit them together, they show what the first do not"
            left.append(Caution(Concern.DIFFERS_HELD_OUT, told))
        return (Verdict.UNEXPLAINED if left else Verdict.CONSISTENT), left
    guards = best.guards
    if guards:
        told = f"what is missing behaves like {', '.join(guards)}, which is no effect of the library{_look_the_same(problem, best)}"
        return Verdict.UNEXPLAINED, [Caution(Concern.GUARD, told, requirement=_outside_the_library(choice)), *left]
    if left:
        return Verdict.UNEXPLAINED, left
    if choice.idle:
        idle, many = " and ".join(choice.idle), len(best.foreground) >= thresholds.MANY_CAUSES
        told = f"data that were not fitted are predicted {'as well' if many else 'better'} without {idle}{OF_MANY if many else ''}"
        return Verdict.UNEXPLAINED, [Caution(Concern.NO_IMPROVEMENT, told, requirement=_least(choice.idle, IDLE, choice.least))]
    if choice.slight:
        told = f"{' and '.join(choice.slight)} brings hardly anything beside the others: {OF_EVENTS}"
        share = _least(choice.slight, SLIGHT, thresholds.LITTLE)
        return Verdict.UNEXPLAINED, [Caution(Concern.ONE_CAUSE, told, requirement=share)]
    if choice.uneven:
        told = "what fits best is turbulence, but what it would explain comes and goes with the motion: the cause is another"
        return Verdict.UNEXPLAINED, [Caution(Concern.GOES_WITH_MOTION, told, requirement=choice.unevenness)]
    if choice.behind_gaps:
        told = "what fits best is turbulence, but most of what it explains lies right behind missing rows: an unrecorded input does as much"
        return Verdict.UNEXPLAINED, [Caution(Concern.ROWS_MISSING, told, requirement=choice.gap_share)]
    doubts = cautions_of(root, best, [(effect, quantities(best, effect)) for effect in best.effects])
    if doubts:
        return Verdict.UNEXPLAINED, doubts
    denied = _denied(problem, best)
    if denied:
        told = f"what fits best is {' and '.join(denied)}, but kinematics alone, which need no aerodynamics, speak against {_it(denied)}"
        asked = Requirement(
            "the log likelihood by which kinematics speak against it",
            max(denied.values()),
            thresholds.STRONG_WITNESS,
            at_least=False,
            effects=tuple(denied),
        )
        return Verdict.UNEXPLAINED, [Caution(Concern.CONTRADICTED, told, requirement=asked)]
    raised = _raised(root, choice, held) if best.effects else math.inf
    if not raised > 0.0:
        told = "the effects found do not lower the error on data that were not fitted"
        asked = Requirement("the rise of the log likelihood of data that were not fitted", raised, 0.0, at_least=True)
        return Verdict.UNEXPLAINED, [Caution(Concern.NO_IMPROVEMENT, told, requirement=asked if math.isfinite(raised) else None)]
    return (Verdict.AMBIGUOUS if is_ambiguous(choice, problem.guards) else Verdict.TRACED), []


IDLE = "the rise of the log likelihood of data that were not fitted, by it beside the others,"
SLIGHT = "its share of the rise of the log likelihood by all effects together"


def _least(found: Mapping[str, float], asked: str, bar: float) -> Requirement:
    """The requirement that the smallest of these numbers, by effect, does not meet."""
    return Requirement(asked, min(found.values()), bar, at_least=True, effects=tuple(found))


def _outside_the_library(choice: Choice) -> Requirement | None:
    """How far behind the best set of the library's effects alone is, in the criterion; None where no such set was compared."""
    mine = frozenset(choice.best.names)
    others = [item for item in choice.sets if not item.guard and frozenset(item.names) != mine]
    if not others:
        return None
    nearest = min(others, key=lambda item: item.misfit + item.price + item.declared)
    behind = nearest.misfit + nearest.price + nearest.declared
    words = f"with {' and '.join(nearest.names)}" if nearest.names else "of the declared model alone"
    asked = f"the criterion {words}, above that with {' and '.join(choice.best.guards)}, which is outside the library,"
    return Requirement(asked, behind, thresholds.GUARD_TIE, at_least=False)


def _denied(problem: TraceProblem, best: FittedModel) -> dict[str, float]:
    """Effects that a witness speaks strongly against, with the log likelihood.

    None where air moves that is not still, which kinematics do not know.
    """
    if has_process_noise(best.system) or any(WIND.intersection(getattr(effect, "needs", ())) for effect in best.effects):
        return {}
    found = {effect.name: problem.witness.against(effect.name, quantities(best, effect)) for effect in best.foreground}
    return {name: value for name, value in found.items() if value > thresholds.STRONG_WITNESS}


def _it(names: Collection[str]) -> str:
    return "it" if len(names) == 1 else "them"


def _look_the_same(problem: TraceProblem, best: FittedModel) -> str:
    """Instances of general forms that a guard of a set cannot be told from, in words; empty where there are none."""
    offered = {candidate.name for candidate in problem.general}
    names = [name for effect in best.effects if effect.traits.guard for name in effect.traits.also if name in offered]
    return f"; a derivative that varies looks much the same, and this does not tell which: {', '.join(names)}" if names else ""


def _raised(root: FittedModel, choice: Choice, held: HeldOutData) -> float:
    """By how much the effects raise the log likelihood of held-out data.

    Infinite where there are no such data, minus infinite where they cannot be simulated.

    For deterministic effects the cost of a free simulation, over all channels, has to fall. With process noise a free simulation cannot
    improve: then one-step predictions have to, by their likelihood. What belongs to one record is looked for anew in each, so that the cost
    of an event that is not there falls by what its parameters take from noise: this asks only that it does not rise.
    """
    best, before, after = choice.best, held.declared, choice.out
    if before.frozen is None or after.frozen is None:
        return math.inf if not held.records and before.frozen is None and after.frozen is None else -math.inf
    if not has_process_noise(best.system):
        return before.frozen.cost - after.frozen.cost
    records = [problem.record for problem in before.frozen.layout.problems]
    settings = best.fit.layout.settings
    masks = [problem.valid for problem in (after.informed or before.frozen).layout.problems]
    plain = predictive_log_likelihood(records, root.system, root.values.shared, noise_levels(root.fit), settings, masks=masks)
    local = [name for effect in best.effects for name in local_names(effect)]
    begin = _own_values(after.informed or after.frozen, local)
    levels, values = noise_levels(best.fit), best.values.shared
    return predictive_log_likelihood(records, best.system, values, levels, settings, local=local, masks=masks, begin=begin) - plain


def _own_values(fit: Fit, names: Collection[str]) -> list[dict[str, float]]:
    """Of each record of a fit the values of these parameters of its own: an event begins there where the fit has found it."""
    layout = fit.layout
    columns = [layout.columns(r)[len(layout.shared) :] for r in range(len(layout.problems))]
    return [{name: float(fit.theta[at]) for name, at in zip(layout.local, mine, strict=False) if name in names} for mine in columns]
