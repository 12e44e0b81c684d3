"""Statistics of a campaign's runs: of each parameter, and of all together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.statistics.intervals import clopper_pearson, deviation_factors, inside, mean_square_interval
from scenarios.studies.campaign import Campaign, Spread
from scenarios.studies.campaign_statistics.bound import Bound, bound_of

SIGMAS = (1, 2, 3)
NORMAL = {1: 0.682689492137086, 2: 0.954499736103642, 3: 0.997300203936740}  # of a normal distribution within so many standard deviations


@dataclass(frozen=True)
class Within:
    """Share of the runs whose interval of ``sigmas`` reported standard deviations holds the reference, with its exact 95 % interval."""

    sigmas: int
    hits: int
    runs: int
    share: float
    interval: tuple[float, float]

    @property
    def right(self) -> bool:
        """Whether the normal distribution's share lies in the interval."""
        return self.interval[0] <= NORMAL[self.sigmas] <= self.interval[1]


@dataclass(frozen=True, eq=False)
class ParameterStatistics:
    """One parameter over the sound runs, SI.

    Attributes
    ----------
    bias, bias_std : mean error and the standard deviation of that mean.
    scatter, reported : standard deviation of the estimates; root mean square of the reported sigmas.
    ratio, ratio_interval : of these two, with the 95 % interval by chi-square.
    coverage : within one, two and three reported sigmas.
    bound, pull : least scatter that the method could have and what its priors do to the mean, at the reference; None where there is no bound.
    efficiency, efficiency_interval : variance of that bound over that of the estimates, and its interval; one where nothing is lost.
    prior_share : of the stated variance that the prior gives, at the bound.
    """

    name: str
    unit: str
    reference: float
    bias: float
    bias_std: float
    scatter: float
    reported: float
    ratio: float
    ratio_interval: tuple[float, float]
    coverage: tuple[Within, ...]
    bound: float | None = None
    pull: float | None = None
    efficiency: float | None = None
    efficiency_interval: tuple[float, float] | None = None
    prior_share: float | None = None

    @property
    def two(self) -> Within:
        """Within two sigmas."""
        return self.coverage[1]


@dataclass(frozen=True, eq=False)
class Squares:
    """A sum of normalised squares in each run ``(M,)`` that should be chi-square with ``degrees (M,)`` of freedom.

    ``mean`` over runs of the sum over its degrees; ``interval`` in which this mean lies with 95 % where sigmas are right; ``inside`` the share
    of the runs within their own 95 % interval, ``inside_interval`` its exact interval.
    """

    name: str
    values: np.ndarray
    degrees: np.ndarray
    mean: float
    interval: tuple[float, float]
    inside: float
    inside_interval: tuple[float, float]

    @property
    def right(self) -> bool:
        """Whether the mean is what right sigmas give."""
        return self.interval[0] <= self.mean <= self.interval[1]


@dataclass(frozen=True, eq=False)
class CampaignStatistics:
    """Of all parameters; ``sigmas (n, M)`` are the errors in the sigma that each run reports. NIS is None of methods that predict nothing."""

    parameters: tuple[ParameterStatistics, ...]
    sigmas: np.ndarray
    nees: Squares | None
    nis: Squares | None

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        return tuple(each.name for each in self.parameters)


def campaign_statistics(campaign: Campaign) -> CampaignStatistics:
    """Statistics of the sound runs, and the bound at the reference values."""
    bound = bound_of(campaign.work)
    reference = np.array([[spread.reference] for spread in campaign.spreads])
    parameters = tuple(_parameter(spread, campaign.values[i], campaign.std[i], bound, i) for i, spread in enumerate(campaign.spreads))
    nees = squares("NEES", campaign.nees, np.full(len(campaign.nees), len(parameters)))
    return CampaignStatistics(parameters, (campaign.values - reference) / campaign.std, nees, squares("NIS", campaign.nis, campaign.degrees))


def coverage_of(sigmas: np.ndarray) -> tuple[Within, ...]:
    """Shares of errors ``(M,)`` in sigmas within one, two and three."""
    runs = len(sigmas)
    hits = [int(np.sum(np.abs(sigmas) <= each)) for each in SIGMAS]
    return tuple(Within(each, hit, runs, hit / runs, clopper_pearson(hit, runs)) for each, hit in zip(SIGMAS, hits, strict=True))


def squares(name: str, values: np.ndarray, degrees: np.ndarray) -> Squares | None:
    """Of the runs that have such a sum; None where none has."""
    there = np.isfinite(values) & (degrees > 0)
    if not np.any(there):
        return None
    values, degrees = values[there], degrees[there]
    held = int(np.sum(inside(values, degrees)))
    interval = mean_square_interval(float(degrees.sum()))
    return Squares(name, values, degrees, float(values.sum() / degrees.sum()), interval, held / len(values), clopper_pearson(held, len(values)))


def _parameter(spread: Spread, values: np.ndarray, std: np.ndarray, bound: Bound | None, at: int) -> ParameterStatistics:
    runs = len(values)
    low, high = deviation_factors(runs)
    ratio = spread.scatter / spread.reported if spread.reported > 0.0 else float("inf")
    coverage = coverage_of((values - spread.reference) / std)
    ours = (spread.name, spread.unit, spread.reference, spread.bias, spread.scatter / runs**0.5, spread.scatter, spread.reported)
    found = ParameterStatistics(*ours, ratio, (low * ratio, high * ratio), coverage)
    # Without a prior nothing bounds what a record leaves open.
    if bound is None or spread.scatter == 0.0 or (np.isinf(bound.data[at]) and not bound.prior_share[at] > 0.0):
        return found
    best = float(bound.scatter[at])
    efficiency = (best / spread.scatter) ** 2
    ends = efficiency / high**2, efficiency / low**2
    return ParameterStatistics(
        *ours, ratio, (low * ratio, high * ratio), coverage, best, float(bound.pull[at]), efficiency, ends, float(bound.prior_share[at])
    )
