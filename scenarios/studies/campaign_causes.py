"""Causes of wrong sigmas in a campaign, and the correct sigmas.

Some causes predict the size of the errors: prior, coloured noise. For others, runs repeated without
the cause have correct sigmas: start, integration, noise levels, noise size. If there is no such
cause, the model cannot represent the truth. Causes are found from the runs alone, not from the
errors that the scenario declares.

Residuals are computed with the parameters fixed at the reference and with fine integration steps,
so that they depend neither on start nor on step. S are the sensitivities in units of the noise, and
P is the stated covariance. A misfit d shifts the estimates by P S' d. Noise of autocovariance R
gives them the covariance P S' R S P.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import filter_batched, run_bank
from ident.filters.ekf import FilterSettings, run_ekf
from ident.statistics.intervals import SHARES_LEVEL, clopper_pearson
from ident.statistics.residual_spectrum import autocovariance, filtered_product
from scenarios.studies.campaign import CampaignRuns, EstimatorRuns
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
    Trial,
    Trials,
    closest,
    likely_levels,
    quiet_trial,
)
from scenarios.studies.declaration import FILTERS
from scenarios.studies.estimating import compiled, is_batched
from sim.errors import FlightidError

# ---- Parameters with wrong sigmas


@dataclass(frozen=True, eq=False)
class Wrong:
    """A parameter whose reported sigma is wrong.

    Attributes
    ----------
    at : index of the parameter.
    statistics : statistics of the parameter.
    factor : factor on the sigmas with which two sigmas contain 95.4 % of the errors; above 1 if the
        reported sigmas are too small.
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


def wrong_sigmas(statistics: CampaignStatistics) -> tuple[Wrong, ...]:
    """Return the parameters whose two-sigma coverage differs from that of a normal distribution.

    The coverage has a Clopper-Pearson interval at the level 1 - 0.05 / n for n parameters
    (Bonferroni). So 5 % of the campaigns with correct sigmas report any parameter.
    """
    wrong = []
    level = 1.0 - (1.0 - SHARES_LEVEL) / len(statistics.parameters)
    for i, parameter in enumerate(statistics.parameters):
        low, high = clopper_pearson(parameter.two.hits, parameter.two.runs, level)
        if not low <= NORMAL[2] <= high:
            errors = statistics.sigmas[i]
            rms = float(np.sqrt(np.mean(errors**2)))
            wrong.append(Wrong(i, parameter, _correction(errors), rms, float(np.mean(errors))))
    return tuple(wrong)


def _correction(errors: np.ndarray) -> float:
    """Return the factor on reported sigmas with which two sigmas contain 95.4 % of the errors."""
    return float(np.quantile(np.abs(errors), NORMAL[2])) / 2.0


# ---- Residuals at the reference values, and errors predicted from them and from the prior

RESIDUALS_RUNS, RESIDUALS_ALONE = 32, 6  # runs that are used: in a batch, one by one
HELD_PRIOR_SHARE = 1e-6  # prior sigma over value of a parameter, by which a filter holds it
STEPS_PER_SAMPLE = 4  # integration steps between samples
COLOURED_SIGMAS, LEAST_COLOUR = 5.0, 0.05  # a correlation above both shows coloured noise


@dataclass(frozen=True, eq=False)
class Residuals:
    """Normalized residuals of m outputs: their mean over runs (misfit), and the noise about it.

    Attributes
    ----------
    misfit : root mean square of the mean over runs, in standard deviations of the noise.
    colour : correlation of neighbouring noise samples, shape ``(m,)``.
    colour_std : standard deviation of ``colour`` for white noise.
    outputs : names of the outputs.
    lags : autocovariance of the noise, shape ``(m, L)``.
    valid : True for measured samples, shape ``(m, N)``.
    common : mean over runs, shape ``(m, N)``.
    """

    misfit: float
    colour: np.ndarray
    colour_std: float
    outputs: tuple[str, ...]
    lags: np.ndarray
    valid: np.ndarray
    common: np.ndarray

    @property
    def coloured(self) -> bool:
        """Whether the noise of an output is not white."""
        limit = max(COLOURED_SIGMAS * self.colour_std, LEAST_COLOUR)
        return bool(np.any(np.abs(self.colour) > limit))


def residuals_of(work: EstimatorRuns, seeds: Sequence[int]) -> Residuals | None:
    """Return the residuals of the first runs; None if the model at the reference diverges."""
    estimation, reference = work.estimation, work.common.reference
    model = work.common.model.with_values({name: reference[name] for name in work.parameters})
    held = {name: HELD_PRIOR_SHARE * max(abs(reference[name]), 1e-3) for name in work.parameters}
    model = replace(model, parameters=model.parameters.with_prior(held)).with_noise(
        replace(model.noise, process_density={})
    )
    filtered = replace(estimation, method="ekf", process_noise={}, passes=1)
    system = compiled(filtered, model)
    settings = FilterSettings(max_step=1.0 / (STEPS_PER_SAMPLE * work.seen.flight.rate))
    batched = is_batched(filtered, bool(work.seen.flight.feedback))
    records = [
        work.record_of(seed) for seed in seeds[: RESIDUALS_RUNS if batched else RESIDUALS_ALONE]
    ]
    try:
        if batched:
            z = np.stack(
                [record.output_array(system.output_names)[0] for record in records], axis=2
            )
            bank = run_bank(records[0], system, settings, z=z, keep=True)
            assert bank.innovation is not None and bank.innovation_std is not None
            normalized = bank.innovation / bank.innovation_std
            is_sound = bool(np.all(bank.sound))
        else:
            histories = [
                run_ekf(record, system, settings, by=filter_batched).history for record in records
            ]
            normalized = np.stack(
                [h.innovation / h.innovation_std for h in histories if h is not None], axis=2
            )
            is_sound = normalized.shape[2] == len(records)
    except FlightidError:
        return None
    valid = records[0].output_array(system.output_names)[1]
    return (
        split(normalized, valid, system.output_names)
        if is_sound and np.all(np.isfinite(normalized))
        else None
    )


def split(normalized: np.ndarray, valid: np.ndarray, outputs: Sequence[str]) -> Residuals:
    """Split normalized residuals of K runs, ``(m, N, K)``, into misfit and noise."""
    runs = normalized.shape[2]
    common = normalized.mean(axis=2, keepdims=True)
    noise = np.where(valid[:, :, None], normalized - common, 0.0) * (runs / (runs - 1.0)) ** 0.5
    variance = np.sum(noise**2, axis=(1, 2)) / np.maximum(runs * valid.sum(axis=1), 1)
    excess = np.where(valid, common[:, :, 0] ** 2 - variance[:, None] / runs, 0.0).sum() / max(
        valid.sum(), 1
    )
    # Subtract the mean square that noise alone leaves in K runs.
    excess *= excess > 4.0 * float(variance.mean()) * np.sqrt(2.0 / max(valid.sum(), 1)) / runs
    count = max(10, normalized.shape[1] // 5)
    lags = np.array(
        [
            np.mean([autocovariance(noise[i, :, run], count) for run in range(runs)], axis=0)
            for i in range(len(noise))
        ]
    )
    lags *= normalized.shape[1] / np.maximum(valid.sum(axis=1), 1)[:, None]
    colour = lags[:, 1] / np.maximum(lags[:, 0], 1e-300)
    return Residuals(
        float(np.sqrt(max(excess, 0.0))),
        colour,
        1.0 / float(np.sqrt(runs * valid.sum(axis=1).min())),
        tuple(outputs),
        lags,
        valid,
        common[:, :, 0],
    )


def predicted_by_prior(bound: Bound, at: int) -> tuple[float, float]:
    """Return the rms error that the priors predict, in stated sigmas, and ``Bound.prior_share``.

    ``at``: index of the parameter.
    """
    stated = float(bound.stated[at])
    return float(np.hypot(bound.scatter[at], bound.pull[at])) / stated, float(bound.prior_share[at])


def predicted_by_colour(bound: Bound, residuals: Residuals) -> np.ndarray | None:
    """Return the factors on the stated sigmas for coloured noise, ``(n,)``; None if unknown.

    They follow from the covariance of Morelli and Klein for coloured residuals (J. Guidance 20(1),
    1997), with sensitivities at the reference and the mean autocovariance over runs.
    """
    if bound.slopes is None:
        return None
    n, (m, count) = len(bound.names), residuals.valid.shape
    slopes = np.zeros((m * count, n))
    slopes[residuals.valid.ravel()] = bound.slopes[: int(residuals.valid.sum())]
    lags = residuals.lags.shape[1]
    taper = 1.0 - np.arange(lags) / lags
    coloured = np.zeros((n, n))
    for part, autocovariances in zip(slopes.reshape(m, count, n), residuals.lags, strict=True):
        coloured += filtered_product(part, autocovariances / autocovariances[0] * taper)
    white = bound.slopes.T @ bound.slopes
    variance = bound.stated**2 + np.diag(bound.gain @ (coloured - white) @ bound.gain.T)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)) / bound.stated)


# ---- Cause and correction of each wrong sigma

# Largest difference between the logarithms of the predicted and the observed rms error.
PREDICTED_SIZE_TOLERANCE = 0.15
SMALL_MISFIT = 0.05  # misfit over the noise sigma, below which there is none
# Misfit above which process noise estimated by likelihood would represent model error.
LARGE_MISFIT = 0.3
# A bias is due to noise if at most this share of it remains with a tenth of the noise.
REMOVED_BIAS_SHARE = 0.3
NOTABLE_BIAS_SHARE = 0.15  # of the mean square error; above it the cause of a bias is sought
MAIN_BIAS_SHARE = 0.5  # of the mean square error; above it a bias is the main error
SMALL_PRIOR_SHARE = 0.2  # of the variance; below it a prior hardly changes a sigma
PRIOR, COLOUR, NOISE, MODEL, OPEN = "prior", "colour", "noise", "model", "open"


@dataclass(frozen=True, eq=False)
class Finding:
    """The cause of the wrong sigma of one parameter.

    Attributes
    ----------
    wrong : the parameter.
    causes : keys of the causes.
    corrected : correct sigma, in the parameter's unit.
    coverage : share of the errors within two corrected sigmas.
    again : whether the coverage is of runs repeated without the cause, not of the original runs.
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

    Attributes
    ----------
    found : the finding for each wrong sigma.
    levels : noise levels by likelihood, or None.
    residuals : residuals of the runs, or None.
    again : number of repeated runs.
    """

    found: tuple[Finding, ...]
    levels: Levels | None = None
    residuals: Residuals | None = None
    again: int = 0

    @property
    def misfits(self) -> bool:
        """Whether estimated process noise would represent model error."""
        return self.residuals is not None and self.residuals.misfit > LARGE_MISFIT


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
    findings = findings_of(campaign, statistics, levels=levels) if causes else Findings(())
    return Judgement(statistics, findings)


def findings_of(
    campaign: CampaignRuns, statistics: CampaignStatistics, *, levels: bool = False
) -> Findings:
    """Return the causes of wrong sigmas; ``levels`` as in `judge`."""
    wrong = wrong_sigmas(statistics)
    seeds = tuple(int(seed) for seed in campaign.seeds[campaign.kept])
    if not wrong:
        return Findings((), likely_levels(campaign.work, seeds) if levels else None)
    work, bound = campaign.work, bound_of(campaign.work)
    findings: dict[int, Finding] = {}  # by index of the parameter
    for item in wrong:
        if (finding := _by_prior(item, bound, statistics)) is not None:
            findings[item.at] = finding
    residuals = residuals_of(work, seeds)
    scale, colour = _scale(bound, residuals, campaign), None
    if scale is not None and residuals is not None:
        colour = _strongest(residuals)
        for item in wrong:
            if item.at in findings:
                continue
            if (finding := _by_colour(item, scale, residuals, statistics)) is not None:
                findings[item.at] = finding
    unexplained = [item for item in wrong if item.at not in findings]
    likely = likely_levels(work, seeds) if unexplained or levels else None
    trials = Trials.of(campaign, likely, scale)
    # With a large misfit, a change as process noise by likelihood hides the cause: model error.
    large_misfit = residuals is not None and residuals.misfit > LARGE_MISFIT
    successful = {} if large_misfit else closest(trials, [item.at for item in unexplained])
    for item in unexplained:
        if item.at in successful:
            findings[item.at] = _of_trial(item, successful[item.at], colour)
        else:
            findings[item.at] = _without_trial(item, trials, residuals, statistics)
    ordered = tuple(findings[item.at] for item in wrong)
    return Findings(ordered, likely, residuals, len(trials.seeds))


def _agree(predicted: float, observed: float, runs: int) -> bool:
    """Return whether a predicted rms error agrees with the observed one of so many runs."""
    if predicted <= 0.0:
        return False
    tolerance = max(PREDICTED_SIZE_TOLERANCE, 3.0 / math.sqrt(2.0 * runs))
    return abs(math.log(predicted / observed)) <= tolerance


def _by_prior(wrong: Wrong, bound: Bound | None, statistics: CampaignStatistics) -> Finding | None:
    """Return a finding if the share of the prior in the sigma predicts the errors; else None."""
    if bound is None:
        return None
    # With other reported sigmas, as with process noise, the bound does not apply to the method.
    deviation = abs(math.log(wrong.statistics.reported / float(bound.stated[wrong.at])))
    if deviation > 2.0 * PREDICTED_SIZE_TOLERANCE:
        return None
    predicted, share = predicted_by_prior(bound, wrong.at)
    errors = statistics.sigmas[wrong.at]
    small = share < SMALL_PRIOR_SHARE and predicted < 1.0 + PREDICTED_SIZE_TOLERANCE
    if small or not _agree(predicted, wrong.rms, len(errors)):
        return None
    return Finding(
        wrong,
        (PRIOR,),
        predicted * wrong.statistics.reported,
        coverage_of(errors / predicted)[1],
        False,
        share,
    )


def _scale(
    bound: Bound | None, residuals: Residuals | None, campaign: CampaignRuns
) -> np.ndarray | None:
    """Return the factors ``(n,)`` by which coloured noise makes sigmas too small.

    None if the noise is white, or the method is not a filter without process noise.
    """
    estimation = campaign.estimation
    if bound is None or residuals is None or not residuals.coloured:
        return None
    if estimation.method not in FILTERS or estimation.process_noise:
        return None
    return predicted_by_colour(bound, residuals)


def _by_colour(
    wrong: Wrong, scale: np.ndarray, residuals: Residuals, statistics: CampaignStatistics
) -> Finding | None:
    """Return a finding if the autocorrelation of the noise predicts the scatter; else None."""
    errors, factor = statistics.sigmas[wrong.at], float(scale[wrong.at])
    biased = wrong.mean**2 > MAIN_BIAS_SHARE * wrong.rms**2
    if biased or not _agree(factor, wrong.rms, len(errors)):
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
    """Return the finding from repeated runs that have correct sigmas."""
    errors, std = trial.errors[wrong.at], trial.std[wrong.at]
    # A filter that starts from its own result has neither the errors of its linearisation nor the
    # effect of its prior. Of the two, only the prior makes reported sigmas too large.
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


def _without_trial(
    wrong: Wrong, trials: Trials, residuals: Residuals | None, statistics: CampaignStatistics
) -> Finding:
    """Return the finding if no repeated runs have correct sigmas: the model is inadequate, a bias
    is due to noise, or the cause is unknown.

    The corrected sigma comes from half of the runs and is tested on the other half.
    """
    errors = statistics.sigmas[wrong.at]
    factor = _correction(errors[::2])
    misfit = residuals.misfit if residuals is not None else 0.0
    cause = MODEL if misfit > SMALL_MISFIT else OPEN
    if cause == OPEN and wrong.mean**2 > NOTABLE_BIAS_SHARE * wrong.rms**2:
        original, quiet = trials.trial(()), quiet_trial(trials)
        if original is not None and quiet is not None:
            bias = abs(original.errors[wrong.at].mean())
            if abs(quiet.errors[wrong.at].mean()) < REMOVED_BIAS_SHARE * bias:
                cause = NOISE
    return Finding(
        wrong,
        (cause,),
        factor * wrong.statistics.reported,
        coverage_of(errors[1::2] / factor)[1],
        False,
        misfit,
    )
