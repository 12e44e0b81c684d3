"""What one search works on. It never changes: other records or other masks make another problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.tracing.candidate_model.fitted_model import FitData, FittedModel, fit_set, start_from
from ident.tracing.settings import TraceSettings
from ident.tracing.witness import Witness, silent
from ident.whole_record.layout import FitSettings
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.record import Record

SETTLED = 1e-6  # of log likelihood: a step that gains less moves nothing by more than 0.0015 sigmas


def untold(text: str, share: float) -> None:
    """A progress that nobody follows."""


@dataclass(frozen=True, eq=False)
class _Ended:
    """A fit to the end, and what was asked for: the form of a claimed curve is asked for twice, when sets are compared and when sigmas are told."""

    start: FittedModel | None
    effects: tuple[Traceable, ...]
    added: Mapping[str, float]
    fitted: FittedModel | None


@dataclass(frozen=True, eq=False)
class TraceProblem:
    """Records, the samples that count, the declared model, and what may be added to it.

    ``masks`` ``(m, N)`` a record, True where a sample counts. ``candidates`` : effects and guards. ``predicted`` : records that will be
    predicted; only the ranges they fly through are used. ``progress`` is told what is done, and which share of the work that is.
    ``general`` : instances of general forms (``Traits.general``), which stand behind the candidates.
    """

    records: Sequence[Record]
    masks: Sequence[np.ndarray]
    model: Model
    candidates: Sequence[Traceable]
    outputs: Sequence[str]
    settings: TraceSettings
    predicted: Sequence[Record] = ()
    witness: Witness = silent
    progress: Callable[[str, float], None] = untold
    general: Sequence[Traceable] = ()
    _ended: list[_Ended] = field(default_factory=list, init=False, repr=False)

    @property
    def guards(self) -> frozenset[str]:
        """Names of the candidates that compete and can never be claimed."""
        return frozenset(candidate.name for candidate in self.candidates if candidate.traits.guard)

    @property
    def twins(self) -> Mapping[str, tuple[str, ...]]:
        """By name of a candidate, other descriptions of the same fault, and the guards that are narrower forms of it and speak for it."""
        narrower = {each.name: each.traits.within for each in self.candidates if each.traits.guard}
        every = (*self.candidates, *self.general)
        return {c.name: (*c.traits.twins, *(guard for guard, wider in narrower.items() if c.name in wider)) for c in every}

    @property
    def data(self) -> FitData:
        """What sets are fitted to."""
        return FitData(self.records, self.masks, self.model, self.outputs)

    @property
    def roughly(self) -> FitSettings:
        """How a set is fitted that is only compared: twice the step moves no output of an aircraft by a hundredth of its noise."""
        return FitSettings(max_step=2.0 * self.settings.max_step, iterations=14, tolerance=0.03, enough=0.2)

    def fit(
        self, effects: Sequence[Traceable], start: FittedModel | None, added: Mapping[str, float] | None = None, *, rough: bool = False
    ) -> FittedModel | None:
        """Fit a set from another one's values; roughly while searching, to the end for what is kept. None where no cost is finite."""
        if rough:
            return self._fit(effects, self.roughly, start, added)
        asked = (start, tuple(effects), dict(added or {}))
        for one in self._ended:
            if one.start is start and (one.effects, one.added) == asked[1:]:
                return one.fitted
        settings = FitSettings(max_step=self.settings.max_step, enough=SETTLED)
        self._ended.append(_Ended(*asked, self._fit(effects, settings, start, added)))
        return self._ended[-1].fitted

    def _fit(
        self, effects: Sequence[Traceable], settings: FitSettings, start: FittedModel | None, added: Mapping[str, float] | None
    ) -> FittedModel | None:
        return fit_set(self.data, effects, settings, start_from(start, added), event_cost=self.settings.event)

    def at_values(self, effects: Sequence[Traceable], fitted: FittedModel) -> FittedModel | None:
        """A set of effects at the values that another fitted model has, not fitted; None where its cost is not finite."""
        return fit_set(self.data, effects, replace(self.roughly, iterations=0), start_from(fitted), event_cost=self.settings.event)

    def with_masks(self, masks: Sequence[np.ndarray]) -> TraceProblem:
        """The same question with other samples set aside: another problem, to which no earlier fit belongs."""
        return replace(self, masks=tuple(masks))

    def holds(self, fitted: FittedModel) -> bool:
        """Whether a model was fitted to the samples of this problem, and to no others."""
        problems = fitted.fit.layout.problems
        return len(problems) == len(self.records) and all(
            problem.record is record and np.array_equal(problem.valid, mask)
            for problem, record, mask in zip(problems, self.records, self.masks, strict=True)
        )
