"""What one search knows and gathers on its way: fitted nodes, their scores, steps, evidence, and how much it may still spend."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel, fit_set, levels_of
from ident.tracing.diagnosis import Candidate, Step, Witness, silent
from ident.tracing.selection.criterion import few_samples, unevenness
from ident.tracing.settings import TraceSettings
from ident.whole_record.layout import FitSettings
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.record import Record

FORCED = 4.0  # a fit with process noise costs as much as so many without
UNIT = 100.0  # iterations times unknowns of a small fit
USUAL = 1500.0  # samples of a record whose fits count once


@dataclass(eq=False)
class Search:
    """What one search knows and gathers on its way: fitted nodes, their scores, steps and evidence.

    A fitted model's score is that of its parent less the gain, see ``gain``; the root's is its criterion. ``beside`` are records that will be
    predicted: only the ranges they fly through are used. ``totals`` and ``misfits`` are of sets weighed on held-out data too: score, and
    twice the cost alone.
    """

    records: Sequence[Record]
    model: Model
    candidates: Sequence[Traceable]
    outputs: Sequence[str]
    settings: TraceSettings
    masks: Sequence[np.ndarray]
    progress: Callable[[str, float], None]
    fitted_models: dict[frozenset[str], FittedModel] = field(default_factory=dict)
    scores: dict[frozenset[str], float] = field(default_factory=dict)
    expanded: set[frozenset[str]] = field(default_factory=set)
    steps: list[Step] = field(default_factory=list)
    evidence: list[Candidate] = field(default_factory=list)
    totals: dict[frozenset[str], float] = field(default_factory=dict)
    misfits: dict[frozenset[str], float] = field(default_factory=dict)
    beside: Sequence[Record] = ()
    witness: Witness = silent
    spent: float = 0.0

    def fit(
        self, effects: Sequence[Traceable], start: FittedModel | None, added: Mapping[str, float] | None = None, *, rough: bool = False
    ) -> FittedModel | None:
        """Fit a set from another fitted model's values; roughly while searching, to the end for what is kept."""
        settings = self.roughly if rough else FitSettings(max_step=self.settings.max_step)
        values, levels = (None, None) if start is None else (start.values, levels_of(start))
        fitted = fit_set(self.records, self.model, effects, self.outputs, settings, self.masks, self.settings.event, values, added, levels)
        if fitted is not None:
            work = (fitted.fit.iterations + 2) * len(fitted.fit.theta) / UNIT * self._length
            self.spent += work * FORCED if has_process_noise(fitted.system) else work
        return fitted

    @property
    def guards(self) -> frozenset[str]:
        """Names of the candidates that compete and can never be claimed."""
        return frozenset(candidate.name for candidate in self.candidates if candidate.traits.guard)

    @property
    def roughly(self) -> FitSettings:
        """How a set is fitted that is only compared: twice the step moves no output of an aircraft by a hundredth of its noise."""
        return FitSettings(max_step=2.0 * self.settings.max_step, iterations=14, tolerance=0.03, enough=0.2)

    @property
    def _length(self) -> float:
        """How much more than a usual record there is to fit."""
        return max(1.0, sum(len(record) for record in self.records) / USUAL)

    def gain(self, parent: FittedModel, child: FittedModel) -> float:
        """By how much an addition lowers the score: twice the log-likelihood gain over the unevenness, less its price."""
        price = (child.criterion - 2.0 * child.fit.cost) - (parent.criterion - 2.0 * parent.fit.cost)
        brought = 2.0 * (parent.fit.cost - child.fit.cost)
        if has_process_noise(child.system):
            # Innovations are of variance one whatever the likelihood: there is no saying which samples brought the gain.
            return brought / (unevenness(parent, child) if has_process_noise(parent.system) else 1.0) - price
        spread = brought * (1.0 - few_samples(parent, child)) + 0.5 * self.settings.accept
        return min(brought / unevenness(parent, child), spread) - price

    @property
    def exhausted(self) -> bool:
        """Whether the search has fitted as much as it may: a residual that defies the library must not take for ever."""
        return self.spent >= self.settings.budget

    def keep(self, fitted: FittedModel, score: float) -> None:
        """Remember a fitted model, the better one where a set was fitted twice."""
        key = frozenset(fitted.names)
        if key not in self.fitted_models or score < self.scores[key]:
            self.fitted_models[key], self.scores[key] = fitted, score

    def score(self, fitted: FittedModel) -> float:
        return self.scores[frozenset(fitted.names)]
