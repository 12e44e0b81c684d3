"""Causes of wrong sigmas in a campaign, and the right sigmas.

A cause is what foretells the errors (the prior, coloured noise) or what, changed, makes the sigma
right (start, integration, noise levels, the size of the noise); where nothing does, the model
cannot follow the truth. Nothing is read off the scenario's declaration of what is wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ident.statistics.intervals import SHARES_LEVEL, clopper_pearson
from scenarios.studies.campaign import CampaignRuns
from scenarios.studies.campaign_statistics import (
    NORMAL,
    Bound,
    CampaignStatistics,
    ParameterStatistics,
    Within,
    bound_of,
    campaign_statistics,
    coverage_of,
)
from scenarios.studies.campaign_trials import (
    START,
    Levels,
    Residuals,
    Trial,
    Trials,
    closest,
    likely_levels,
    predicted_by_colour,
    predicted_by_prior,
    quiet_trial,
    residuals_of,
)
from scenarios.studies.declaration import FILTERS

# ---- Which sigmas are judged wrong


@dataclass(frozen=True, eq=False)
class Wrong:
    """A parameter whose reported sigma is wrong.

    ``at`` : its place. ``factor`` : by which its sigmas have to be multiplied so that twice them
    holds 95.4 % of the runs' errors; above one they are too small. ``rms`` : root mean square of
    the errors in reported sigmas, of which ``mean`` is their mean.
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


def wrong_sigmas(found: CampaignStatistics) -> tuple[Wrong, ...]:
    """Return the parameters whose two-sigma coverage excludes that of a normal distribution; of all
    together one in twenty right campaigns has some.

    The interval of each is that of Clopper and Pearson at a level of one minus 0.05 over the number
    of parameters (Bonferroni).
    """
    out = []
    level = 1.0 - (1.0 - SHARES_LEVEL) / len(found.parameters)
    for at, each in enumerate(found.parameters):
        low, high = clopper_pearson(each.two.hits, each.two.runs, level)
        if not low <= NORMAL[2] <= high:
            errors = found.sigmas[at]
            factor = float(np.quantile(np.abs(errors), NORMAL[2])) / 2.0
            out.append(
                Wrong(at, each, factor, float(np.sqrt(np.mean(errors**2))), float(np.mean(errors)))
            )
    return tuple(out)


# ---- Why each wrong sigma is wrong, and the right one beside it with its own coverage

# of a logarithm: as near as a foretold size of the errors has to come to theirs
PREDICTED_SIZE_TOLERANCE = 0.15
# misfits in units of the noise: below the first none, above the second what process noise by
# likelihood would stand for
LITTLE, LARGE = 0.05, 0.3
REMOVED_BIAS_SHARE = 0.3  # share of a bias at or below which a tenth of the noise has taken it away
SOME_BIAS = 0.15  # of the mean square error, from which on it is asked where a bias comes from
OF_BIAS = 0.5  # of the mean square error from which on a bias is more than half of it
PRIOR, COLOUR, NOISE, MODEL, OPEN = "prior", "colour", "noise", "model", "open"


@dataclass(frozen=True, eq=False)
class Finding:
    """Why the sigma of one parameter is wrong.

    ``causes`` : by their keys. ``corrected`` : the right sigma in the parameter's unit,
    ``coverage`` its share within two; ``again`` : it is that of runs computed again with the cause
    removed, not of the estimates as they were. ``strength`` : what the cause says of itself, such
    as the prior's share.
    """

    wrong: Wrong
    causes: tuple[str, ...]
    corrected: float
    coverage: Within
    again: bool
    strength: float = math.nan

    @property
    def name(self) -> str:
        """The parameter."""
        return self.wrong.statistics.name


@dataclass(frozen=True, eq=False)
class Findings:
    """All wrong sigmas of a campaign, and from what that was told: noise levels, residuals, how
    many runs were computed ``again``.
    """

    found: tuple[Finding, ...]
    levels: Levels | None = None
    residuals: Residuals | None = None
    again: int = 0

    @property
    def misfits(self) -> bool:
        """Whether the model leaves so much of the flight that process noise by likelihood would
        stand for it.
        """
        return self.residuals is not None and self.residuals.misfit > LARGE


@dataclass(frozen=True, eq=False)
class Judgement:
    """What is said of a campaign: its statistics, and why sigmas are wrong."""

    statistics: CampaignStatistics
    findings: Findings


def judge(campaign: CampaignRuns, *, causes: bool = True, levels: bool = False) -> Judgement:
    """Return the statistics of a campaign, and where ``causes`` why sigmas are wrong; ``levels``:
    noise levels by likelihood in any case.
    """
    statistics = campaign_statistics(campaign)
    return Judgement(
        statistics, findings_of(campaign, statistics, levels=levels) if causes else Findings(())
    )


def findings_of(
    campaign: CampaignRuns, statistics: CampaignStatistics, *, levels: bool = False
) -> Findings:
    """Why sigmas are wrong; ``levels``: noise levels by likelihood also where none is."""
    wrong = wrong_sigmas(statistics)
    seeds = tuple(int(seed) for seed in campaign.seeds[campaign.kept])
    if not wrong:
        return Findings((), likely_levels(campaign.work, seeds) if levels else None)
    work, bound = campaign.work, bound_of(campaign.work)
    found = {
        each.at: told for each in wrong if (told := _by_prior(each, bound, statistics)) is not None
    }
    residuals = residuals_of(work, seeds)
    scale = _scale(bound, residuals, campaign)
    if scale is not None and residuals is not None:
        left = [each for each in wrong if each.at not in found]
        found |= {
            each.at: told
            for each in left
            if (told := _by_colour(each, scale, residuals, statistics)) is not None
        }
    rest = [each for each in wrong if each.at not in found]
    likely = likely_levels(work, seeds) if rest or levels else None
    trials = Trials.of(campaign, likely, scale)
    # What makes up for a large misfit, as process noise by likelihood does, is no cure.
    misfits = residuals is not None and residuals.misfit > LARGE
    cured = {} if misfits else closest(trials, [each.at for each in rest])
    colour = _strongest(residuals) if scale is not None and residuals is not None else None
    for each in rest:
        found[each.at] = (
            _of_trial(each, cured[each.at], colour)
            if each.at in cured
            else _left(each, trials, residuals, statistics)
        )
    return Findings(tuple(found[each.at] for each in wrong), likely, residuals, len(trials.seeds))


def _near(foretold: float, seen: float, runs: int) -> bool:
    """Return whether a foretold size of the errors is that which was seen."""
    return foretold > 0.0 and abs(math.log(foretold / seen)) <= max(
        PREDICTED_SIZE_TOLERANCE, 3.0 / math.sqrt(2.0 * runs)
    )


def _by_prior(wrong: Wrong, bound: Bound | None, statistics: CampaignStatistics) -> Finding | None:
    """Return a finding if the prior has so large a part in the stated sigma that it predicts the
    errors.
    """
    # Where other things are stated, as with process noise, what is right of the bound is not right
    # of the method.
    if (
        bound is None
        or abs(math.log(wrong.statistics.reported / float(bound.stated[wrong.at])))
        > 2.0 * PREDICTED_SIZE_TOLERANCE
    ):
        return None
    foretold, share = predicted_by_prior(bound, wrong.at)
    errors = statistics.sigmas[wrong.at]
    if (share < 0.2 and foretold < 1.0 + PREDICTED_SIZE_TOLERANCE) or not _near(
        foretold, wrong.rms, len(errors)
    ):
        return None
    return Finding(
        wrong,
        (PRIOR,),
        foretold * wrong.statistics.reported,
        coverage_of(errors / foretold)[1],
        False,
        share,
    )


def _scale(
    bound: Bound | None, residuals: Residuals | None, campaign: CampaignRuns
) -> np.ndarray | None:
    """Return the factors ``(n,)`` by which sigmas of filters that take coloured noise for white are
    too small; None if it is white.
    """
    estimation = campaign.estimation
    if (
        bound is None
        or residuals is None
        or not residuals.coloured
        or estimation.method not in FILTERS
        or estimation.process_noise
    ):
        return None
    return predicted_by_colour(bound, residuals)


def _by_colour(
    wrong: Wrong, scale: np.ndarray, residuals: Residuals, statistics: CampaignStatistics
) -> Finding | None:
    """Return a finding if the colour of the noise alone predicts the scatter."""
    errors, factor = statistics.sigmas[wrong.at], float(scale[wrong.at])
    if wrong.mean**2 > OF_BIAS * wrong.rms**2 or not _near(factor, wrong.rms, len(errors)):
        return None
    return Finding(
        wrong,
        (COLOUR,),
        factor * wrong.statistics.reported,
        coverage_of(errors / factor)[1],
        False,
        _strongest(residuals),
    )


def _strongest(residuals: Residuals) -> float:
    return float(residuals.colour[np.argmax(np.abs(residuals.colour))])


def _of_trial(wrong: Wrong, trial: Trial, strength: float | None) -> Finding:
    errors, std = trial.errors[wrong.at], trial.std[wrong.at]
    # Linearisation does not keep estimates from scattering; the prior does, and counts no more
    # where a filter starts at its own result.
    keys = (PRIOR,) if trial.keys == (START,) and not wrong.too_small else trial.keys
    causes = keys if strength is None else (COLOUR, *keys)
    return Finding(
        wrong,
        causes,
        float(np.sqrt(np.mean(std**2))),
        coverage_of(errors / std)[1],
        True,
        math.nan if strength is None else strength,
    )


def _left(
    wrong: Wrong, trials: Trials, residuals: Residuals | None, statistics: CampaignStatistics
) -> Finding:
    """Return the finding if no change helps: noise acts as a bias, or the model cannot follow the
    truth; the sigma of half the runs is tried on the others.
    """
    errors = statistics.sigmas[wrong.at]
    half, others = errors[::2], errors[1::2]
    factor = float(np.quantile(np.abs(half), NORMAL[2])) / 2.0
    misfit = residuals.misfit if residuals is not None else 0.0
    cause, strength = (MODEL, misfit) if misfit > LITTLE else (OPEN, misfit)
    if cause == OPEN and wrong.mean**2 > SOME_BIAS * wrong.rms**2:
        first, quiet = trials.trial(()), quiet_trial(trials)
        if (
            first is not None
            and quiet is not None
            and abs(quiet.errors[wrong.at].mean())
            < REMOVED_BIAS_SHARE * abs(first.errors[wrong.at].mean())
        ):
            cause = NOISE
    return Finding(
        wrong,
        (cause,),
        factor * wrong.statistics.reported,
        coverage_of(others / factor)[1],
        False,
        strength,
    )
