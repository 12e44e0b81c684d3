"""What a search has found so far: fitted models, their scores, steps, evidence, and how much of its means is spent.

A ledger belongs to one problem. Each stage takes one and returns another; a model that was fitted to other samples cannot enter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel, free_names
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.diagnosis import Candidate, Step
from sim.declaration.proposal import Traceable

# Units of the budget, which bounds time, not what is found.
DEARER_WITH_PROCESS_NOISE = 4.0  # a fit with process noise costs as much as so many without
SMALL_FIT = 100.0  # iterations times unknowns
USUAL_LENGTH = 1500.0  # samples of a record whose fits count once

Key = frozenset[str]
Form = tuple[str, frozenset[str]]


@dataclass(frozen=True, eq=False)
class Ledger:
    """Fitted models by the names of their effects, each with its score, and how the search came to them.

    The score of the declared model is its criterion; that of any other is its parent's less what the addition brought (``criterion.gain``).
    ``plain`` : of sets that stand in a freer form and still leave more than noise, the plain one. ``freed`` : freer effects and their plain
    forms, by name and free parameters. ``expanded`` : sets that were extended already. ``evidence`` : all candidates that were looked at, in
    order. ``ran_out`` : the means of an earlier stage were spent.
    """

    problem: TraceProblem
    models: Mapping[Key, FittedModel] = field(default_factory=dict)
    scores: Mapping[Key, float] = field(default_factory=dict)
    plain: Mapping[Key, FittedModel] = field(default_factory=dict)
    freed: Mapping[Form, Traceable] = field(default_factory=dict)
    expanded: frozenset[Key] = frozenset()
    steps: tuple[Step, ...] = ()
    evidence: tuple[Candidate, ...] = ()
    spent: float = 0.0
    ran_out: bool = False

    @property
    def exhausted(self) -> bool:
        """Whether the search has fitted as much as it may: a residual that defies the library must not take for ever."""
        return self.spent >= self.problem.settings.budget

    @property
    def stopped(self) -> bool:
        """Whether this or an earlier stage of the search stopped for want of means."""
        return self.ran_out or self.exhausted

    def renewed(self, share: float) -> Ledger:
        """With this share of the means to be spent anew."""
        return replace(self, spent=min(self.spent, (1.0 - share) * self.problem.settings.budget), ran_out=self.stopped)

    def respent(self, spent: float) -> Ledger:
        """With so much counted as spent."""
        return replace(self, spent=spent)

    def score(self, fitted: FittedModel) -> float:
        """Score of the set of a fitted model."""
        return self.scores[frozenset(fitted.names)]

    def known(self, fitted: FittedModel) -> FittedModel:
        """The model that is kept of the set of a fitted model."""
        return self.models[frozenset(fitted.names)]

    def kept(self, fitted: FittedModel, score: float) -> Ledger:
        """With a fitted model, unless one of its set with a lower criterion is there; a set keeps the lowest score that any of its models had.

        Scores charge unevenness by what each model leaves: they say whether to add, and not which of two forms of one set fits better.
        """
        key = frozenset(fitted.names)
        if key not in self.models:
            return self.replaced(fitted, score)
        return self if fitted.criterion >= self.models[key].criterion else self.replaced(fitted, min(score, self.scores[key]))

    def replaced(self, fitted: FittedModel, score: float) -> Ledger:
        """With a fitted model in the place of any other of its set.

        Raises
        ------
        ValueError : a model that was fitted to other samples; its criterion does not compare with those here.
        """
        if not self.problem.holds(fitted):
            raise ValueError(f"{' + '.join(fitted.names) or 'the declared model'} was fitted to other samples than this ledger's")
        key = frozenset(fitted.names)
        return replace(self, models={**self.models, key: fitted}, scores={**self.scores, key: score})

    def made_freer(self, plain: FittedModel) -> Ledger:
        """With the plain form of a set kept beside the freer one that takes its place."""
        return replace(self, plain={**self.plain, frozenset(plain.names): plain})

    def knows_plain(self, plain: Traceable, finer: Traceable) -> Ledger:
        """With the plain form of an effect known."""
        return replace(self, freed={**self.freed, form_of(finer): plain})

    def plain_form(self, effect: Traceable) -> Traceable:
        """The form from which an effect was made freer; itself where it was not."""
        return self.freed.get(form_of(effect), effect)

    def marked(self, key: Key) -> Ledger:
        """With a set marked as extended."""
        return replace(self, expanded=self.expanded | {key})

    def told(self, *steps: Step, evidence: Sequence[Candidate] = ()) -> Ledger:
        """With further steps and evidence."""
        return replace(self, steps=(*self.steps, *steps), evidence=(*self.evidence, *evidence))


def form_of(effect: Traceable) -> Form:
    """What tells the forms of one effect apart: its name and its free parameters."""
    return effect.name, frozenset(free_names(effect))


def fit(
    ledger: Ledger, effects: Sequence[Traceable], start: FittedModel | None, added: Mapping[str, float] | None = None, *, rough: bool = False
) -> tuple[Ledger, FittedModel | None]:
    """Fit a set to the ledger's problem, and count the work."""
    fitted = ledger.problem.fit(effects, start, added, rough=rough)
    if fitted is None:
        return ledger, None
    samples = sum(len(record) for record in ledger.problem.records)
    work = (fitted.fit.iterations + 2) * len(fitted.fit.theta) / SMALL_FIT * max(1.0, samples / USUAL_LENGTH)
    work *= DEARER_WITH_PROCESS_NOISE if has_process_noise(fitted.system) else 1.0
    return replace(ledger, spent=ledger.spent + work), fitted
