"""One parameter of one study, and a study as a column of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from scenarios.side_by_side.responses import Responses


@dataclass(frozen=True)
class Value:
    """What one study says of one parameter, all in ``unit``.

    ``std`` is zero where the study states none. ``condensed`` is what the study's model should find where the aircraft has modes that it
    lacks. ``published`` has a deviation of zero where none is printed.
    """

    estimate: float
    std: float
    unit: str
    true: float | None = None
    condensed: float | None = None
    published: tuple[float, float] | None = None

    @property
    def reference(self) -> float | None:
        """What the estimate is held against: the condensed value where there is one, else the true one."""
        return self.true if self.condensed is None else self.condensed

    @property
    def percent(self) -> float | None:
        """Error in percent of the reference; None where there is none or it is zero."""
        return None if not self.reference else 100.0 * (self.estimate - self.reference) / abs(self.reference)

    @property
    def sigmas(self) -> float | None:
        """Error in the study's own standard deviations; None without a reference or a deviation."""
        return None if self.reference is None or not self.std > 0.0 else (self.estimate - self.reference) / self.std

    def in_unit(self, factor: float, unit: str) -> Value:
        """The same, all numbers times ``factor``, in another ``unit``."""
        true, condensed = (factor * each if each is not None else None for each in (self.true, self.condensed))
        published = (factor * self.published[0], factor * self.published[1]) if self.published is not None else None
        return Value(factor * self.estimate, factor * self.std, unit, true, condensed, published)

    @property
    def published_value(self) -> Value | None:
        """The published number as a value of its own, held against the same."""
        return None if self.published is None else replace(self, estimate=self.published[0], std=self.published[1], published=None)


@dataclass(frozen=True, eq=False)
class Column:
    """One method of one study.

    Attributes
    ----------
    label : what tells it from the others, unique in a comparison. folder, method : where it comes from; ``method`` is empty for the main one.
    title : the study's own. estimator : the word of the study for how it was estimated. outcome : code of the estimate, or the verdict.
    seed : None of a measured record. values, derived : parameters and derived quantities by name.
    responses : outputs over time; None where the folder has none.
    """

    label: str
    folder: Path
    method: str
    title: str
    estimator: str
    outcome: str
    seed: int | None
    values: Mapping[str, Value]
    derived: Mapping[str, Value]
    responses: Responses | None = None
