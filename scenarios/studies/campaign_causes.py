"""Causes of wrong sigmas in a campaign, and the right sigmas.

A cause either predicts the size of the errors (prior, coloured noise), or its removal corrects the
sigma (start, integration, noise levels, noise size). If no cause does, the model cannot represent
the truth. The causes are found from the runs alone, not from the scenario's declared errors.
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

# ---- Parameters with wrong sigmas


@dataclass(frozen=True, eq=False)
class Wrong:
    """A parameter whose reported sigma is wrong.

    Attributes
    ----------
    at : index of the parameter.
    factor : correction of the sigmas, with which two sigmas contain 95.4 % of the errors; above one
        if the reported sigmas are too small.
    rms, mean : root mean square and mean of the errors in reported sigmas.
    """

    at: int
    statistics: ParameterStatistics
    factor: float
    rms: float
    mean: float

    @property
    def too_small(self) -> bool:
        """Whether the reported sigma is too small."""
        return self.factor > 1.0


def wrong_sigmas(found: CampaignStatistics) -> tuple[Wrong, ...]:
    """Return the parameters whose two-sigma coverage differs from a normal distribution.

    Clopper-Pearson intervals at the level 1 - 0.05 / n for n parameters (Bonferroni), so that 5 %
    of the campaigns with correct sigmas report some parameter.
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


# ---- Cause and correction of each wrong sigma

# Largest difference between the logarithms of the predicted and the observed rms error.
PREDICTED_SIZE_TOLERANCE = 0.15
# Misfit in noise standard deviations: no misfit below the first; above the second, process noise
# estimated by likelihood would represent model error.
SMALL_MISFIT, LARGE = 0.05, 0.3
REMOVED_BIAS_SHARE = 0.3  # share of a bias left at a tenth of the noise: removed
SOME_BIAS = 0.15  # share of the mean square error above which the cause of a bias is sought
OF_BIAS = 0.5  # share of the mean square error above which a bias is the main error
PRIOR, COLOUR, NOISE, MODEL, OPEN = "prior", "colour", "noise", "model", "open"


@dataclass(frozen=True, eq=False)
class Finding:
    """Why the sigma of one parameter is wrong.

    Attributes
    ----------
    causes : their keys.
    corrected : correct sigma, in the parameter's unit.
    coverage : share of the errors within two corrected sigmas.
    again : the coverage is of runs repeated with the cause removed, not of the original runs.
    strength : size of the cause, such as the prior's share of the variance.
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
    """All wrong sigmas of a campaign and their evidence.

    ``levels``, ``residuals``: noise levels and residuals. ``again``: number of runs repeated.
    """

    found: tuple[Finding, ...]
    levels: Levels | None = None
    residuals: Residuals | None = None
    again: int = 0

    @property
    def misfits(self) -> bool:
        """Whether estimated process noise would represent model error."""
        return self.residuals is not None and self.residuals.misfit > LARGE


@dataclass(frozen=True, eq=False)
class Judgement:
    """Statistics of a campaign and the causes of its wrong sigmas."""

    statistics: CampaignStatistics
    findings: Findings


def judge(campaign: CampaignRuns, *, causes: bool = True, levels: bool = False) -> Judgement:
    """Return the statistics of a campaign, and with ``causes`` the causes of wrong sigmas.

    ``levels``: estimate the noise levels by likelihood even if no sigma is wrong.
    """
    statistics = campaign_statistics(campaign)
    return Judgement(
        statistics, findings_of(campaign, statistics, levels=levels) if causes else Findings(())
    )


def findings_of(
    campaign: CampaignRuns, statistics: CampaignStatistics, *, levels: bool = False
) -> Findings:
    """Return the causes of wrong sigmas; ``levels`` as in `judge`."""
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
    """Return whether the predicted rms error agrees with the observed one."""
    return foretold > 0.0 and abs(math.log(foretold / seen)) <= max(
        PREDICTED_SIZE_TOLERANCE, 3.0 / math.sqrt(2.0 * runs)
    )


def _by_prior(wrong: Wrong, bound: Bound | None, statistics: CampaignStatistics) -> Finding | None:
    """Return a finding if the prior has so large a part in the stated sigma that it predicts the
    errors.
    """
    # With other reported sigmas, as with process noise, the bound does not apply to the method.
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
    """Return the factors ``(n,)`` by which coloured noise makes sigmas too small; None if white."""
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
    """Return a finding if the correlation of the noise alone predicts the scatter."""
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
    # Linearisation does not reduce the scatter. The prior does; it loses its effect if the filter
    # starts from its own result.
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
    """Return the finding if no change helps: a bias from noise, or an inadequate model.

    The corrected sigma comes from half of the runs and is tested on the other half.
    """
    errors = statistics.sigmas[wrong.at]
    half, others = errors[::2], errors[1::2]
    factor = float(np.quantile(np.abs(half), NORMAL[2])) / 2.0
    misfit = residuals.misfit if residuals is not None else 0.0
    cause, strength = (MODEL, misfit) if misfit > SMALL_MISFIT else (OPEN, misfit)
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
