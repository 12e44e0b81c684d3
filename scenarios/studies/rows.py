"""One row of a study's comparison: a parameter's true, estimated and published value."""

from __future__ import annotations

from dataclasses import dataclass

from ident.estimate import Estimate
from scenarios.studies.declaration import Start


@dataclass(frozen=True)
class Row:
    """One parameter of one method: what is true, what was estimated, what a paper found; all in
    ``unit``.

    ``condensed`` is the coefficient by static condensation of the elastic modes that the model
    lacks: what it should find.
    """

    name: str
    unit: str
    estimate: float
    std: float
    true: float | None = None
    condensed: float | None = None
    published: Start | None = None

    @property
    def reference(self) -> float | None:
        """What the estimate is held against: the condensed value where there is one, else the true
        one.
        """
        return self.true if self.condensed is None else self.condensed

    @property
    def sigmas(self) -> float | None:
        """Error in the estimator's own standard deviations."""
        return None if self.reference is None else (self.estimate - self.reference) / self.std

    @property
    def percent(self) -> float | None:
        """Error in percent of the reference; None where that is zero."""
        return (
            None
            if not self.reference
            else 100.0 * (self.estimate - self.reference) / abs(self.reference)
        )

    @property
    def published_sigmas(self) -> float | None:
        """Error of the published value against the same reference, in the publication's own
        sigmas.
        """
        if self.published is None or self.reference is None:
            return None
        return (self.published.value - self.reference) / self.published.std


def rows_of(estimate: Estimate) -> tuple[Row, ...]:
    """The rows of an estimate of which nothing else is known, in its order."""
    found = zip(estimate.names, estimate.units, estimate.values, estimate.std, strict=True)
    return tuple(Row(name, unit, float(value), float(std)) for name, unit, value, std in found)
