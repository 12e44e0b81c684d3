"""Which sigmas are judged wrong: those whose coverage does not fit the normal distribution, all parameters of a campaign considered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.statistics.intervals import SHARES_LEVEL, clopper_pearson
from scenarios.studies.campaign_statistics.statistics import NORMAL, CampaignStatistics, ParameterStatistics


@dataclass(frozen=True, eq=False)
class Wrong:
    """A parameter whose reported sigma is wrong.

    ``at`` : its place. ``factor`` : by which its sigmas have to be multiplied so that twice them holds 95.4 % of the runs' errors; above one they are
    too small. ``rms`` : root mean square of the errors in reported sigmas, of which ``mean`` is their mean.
    """

    at: int
    statistics: ParameterStatistics
    factor: float
    rms: float
    mean: float

    @property
    def too_small(self) -> bool:
        """Whether the sigma promises too much."""
        return self.factor > 1.0


def judged_wrong(found: CampaignStatistics) -> tuple[Wrong, ...]:
    """Parameters whose two-sigma coverage excludes that of a normal distribution; of all together one in twenty right campaigns has some.

    The interval of each is that of Clopper and Pearson at a level of one minus 0.05 over the number of parameters (Bonferroni).
    """
    out = []
    level = 1.0 - (1.0 - SHARES_LEVEL) / len(found.parameters)
    for at, each in enumerate(found.parameters):
        low, high = clopper_pearson(each.two.hits, each.two.runs, level)
        if not low <= NORMAL[2] <= high:
            errors = found.sigmas[at]
            factor = float(np.quantile(np.abs(errors), NORMAL[2])) / 2.0
            out.append(Wrong(at, each, factor, float(np.sqrt(np.mean(errors**2))), float(np.mean(errors))))
    return tuple(out)
