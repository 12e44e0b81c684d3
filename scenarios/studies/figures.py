"""Which figures a study gets: input, response, parameters over time, innovations, errors beside the paper's."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from scenarios.plots.ballistic import figure_ballistic_coefficient, figure_trajectory
from scenarios.plots.comparison import ComparisonRow, EquivalentRow, ErrorCloud, figure_comparison, figure_equivalents, figure_repeated
from scenarios.plots.correlation import figure_correlation
from scenarios.plots.display import SIMULATED_DATA
from scenarios.plots.files import Named
from scenarios.plots.innovations import figure_innovations
from scenarios.plots.parameters import figure_parameter_histories
from scenarios.plots.signals import Response, figure_fit, figure_record, response_of, units_of
from scenarios.plots.studies.campaign import Coverage, figure_campaign
from scenarios.plots.studies.determination import DeterminedBy, figure_determination
from scenarios.studies.campaign import Campaign, Spread
from scenarios.studies.campaign_statistics.figures import statistics_figures
from scenarios.studies.campaign_statistics.statistics import CampaignStatistics
from scenarios.studies.declaration import Start
from scenarios.studies.determination.determine import MethodDetermination
from scenarios.studies.study import MethodResult, Study
from scenarios.studies.sweep.figure import draw_sweep

TOLD_APART = 0.1  # of the main residual's rms: what differs less is drawn by the main method alone
MOST_RESPONSES = 3
MOST_PANELS = 30  # parameters: more histories, or a larger matrix, on one page are no longer read


def study_figures(study: Study) -> Iterator[Named]:
    """A scenario's figures: the stem of each file, and what draws it."""
    scenario, main = study.scenario, study.main
    title = scenario.title
    yield "record", partial(figure_record, study.record, title, SIMULATED_DATA)
    responses = [_response(method) for method in _told_apart(study)]
    yield "fit", partial(figure_fit, study.record, responses, study.truth, title, study.truth.noise_std, SIMULATED_DATA)
    for method in study.methods:
        if method.estimation.flight is not None:
            yield (
                f"record_{method.estimation.name}",
                partial(figure_record, method.result.record, f"{title}\n{method.estimation.label}", SIMULATED_DATA),
            )
        # Of a single parameter the figures of all methods together say what one for each would.
        if method is main or len(method.rows) > 1:
            yield from _filter_figures(study, method, "" if method is main else f"_{method.estimation.name}")
    if scenario.estimations[0].model == "ballistic":
        yield from _ballistic_figures(study)
    rows = [
        ComparisonRow(
            row.name,
            row.reference,
            row.estimate,
            row.std,
            row.published.value if row.published else None,
            row.published.std if row.published else None,
            method.estimation.label if len(main.rows) == 1 else "",
        )
        for method in (study.methods if len(main.rows) == 1 else (main,))
        for row in method.rows
        if row.reference is not None
    ]
    if rows:
        against = "condensed" if scenario.condensed else "true"
        label = "" if len(main.rows) == 1 else f"{main.estimation.label}: "
        yield "errors", partial(figure_comparison, rows, f"{title}\n{label}error against the {against} value")
    if study.repeated:
        clouds = [ErrorCloud(each.estimation.label, each.flight, each.names, each.sigmas, each.outcomes) for each in study.repeated]
        yield "repeated", partial(figure_repeated, clouds, title)
    determined = [_determined(method.determination) for method in study.methods if method.determination is not None]
    if determined:
        yield "determination", partial(figure_determination, determined, title)
    if study.sweep is not None:
        yield "flexibility", partial(draw_sweep, study.sweep, title)
    if scenario.condensed:
        yield "equivalents", partial(figure_equivalents, _equivalents(study), title)


def campaign_figures(campaign: Campaign, statistics: CampaignStatistics) -> Iterator[Named]:
    """The figures of a campaign: errors of all runs and how often their intervals hold the reference, and those of its statistics."""
    reference = np.array([[spread.reference] for spread in campaign.spreads])
    sigmas = (campaign.values - reference) / campaign.std
    rows = [_coverage(spread, each) for spread, each in zip(campaign.spreads, sigmas, strict=True)]
    title = f"{campaign.scenario.title}\n{campaign.estimation.label}: {sigmas.shape[1]} runs"
    yield "campaign", partial(figure_campaign, [*rows, _coverage(campaign.pooled, sigmas.ravel())] if len(rows) > 1 else rows, title)
    yield from statistics_figures(statistics, title)


def _coverage(spread: Spread, sigmas: np.ndarray) -> Coverage:
    low, high = spread.interval
    return Coverage(spread.name, sigmas, 100.0 * spread.within_two, (100.0 * low, 100.0 * high))


def _filter_figures(study: Study, method: MethodResult, suffix: str) -> Iterator[Named]:
    estimate, estimation = method.result.estimate, method.estimation
    title = f"{study.scenario.title}\n{estimation.label}"
    if estimate.history is not None:
        prior = {name: (start.value, start.std) for name, start in estimation.start.items()}
        true = {row.name: row.reference for row in method.rows if row.reference is not None}
        published = {row.name: _pair(row.published) for row in method.rows if row.published is not None}
        units = [row.unit for row in method.rows]
        against = "condensed" if study.scenario.condensed else "true"
        if len(estimate.names) <= MOST_PANELS:
            shown = estimate.history, estimate.names, units, true, published, prior, title, against
            yield f"parameters{suffix}", partial(figure_parameter_histories, *shown)
        units = units_of(method.result.record, estimate.output_names)
        yield f"innovations{suffix}", partial(figure_innovations, estimate.history, estimate.output_names, units, title)
    if method is study.main and 1 < len(estimate.names) <= MOST_PANELS and np.all(np.isfinite(estimate.correlation)):
        yield "correlation", partial(figure_correlation, estimate.names, estimate.correlation, title)


def _told_apart(study: Study) -> list[MethodResult]:
    """The main method and those whose residual of the same record differs so much that a figure shows it."""
    z, valid = study.record.output_array(study.main.result.estimate.output_names)

    def size(method: MethodResult) -> np.ndarray:
        return np.sqrt(np.mean(np.where(valid, z - method.result.estimate.fitted[0], 0.0) ** 2, axis=1))

    expected = size(study.main)
    same_record = [m for m in study.methods[1:] if m.result.record is study.record and len(m.result.estimate.output_names) == len(z)]
    return [study.main, *(m for m in same_record if np.any(np.abs(size(m) / expected - 1.0) > TOLD_APART))][:MOST_RESPONSES]


def _ballistic_figures(study: Study) -> Iterator[Named]:
    kept, same_fall = {}, {}
    for method in study.methods:
        if method.result.estimate.history is not None:
            kept[method.estimation.label] = method.result.estimate.history
            if method.estimation.flight is None:
                same_fall[method.estimation.label] = method.result.estimate.history
    if same_fall:
        yield "trajectory", partial(figure_trajectory, study.record, same_fall, study.truth, study.scenario.title)
    if kept:
        true = study.truth.parameters["beta"].value
        yield "ballistic_coefficient", partial(figure_ballistic_coefficient, kept, true, title=study.scenario.title)


def _response(method: MethodResult) -> Response:
    return response_of(method.result.estimate, method.estimation.label)


def _equivalents(study: Study) -> list[EquivalentRow]:
    return [
        EquivalentRow(
            method.estimation.label,
            row.name,
            row.unit,
            row.true,
            row.condensed,
            row.estimate,
            row.std,
            row.published.value if row.published else None,
            row.published.std if row.published else None,
        )
        for method in study.methods
        for row in method.rows
        if row.true is not None and row.condensed is not None
    ]


def _determined(method: MethodDetermination) -> DeterminedBy:
    found, seen = method.found, len(method.found.names) - method.found.unseen
    ratio = dict(zip(found.names, (found.posterior_std / found.prior_std).tolist(), strict=True))
    return DeterminedBy(
        method.estimation.label, ratio, dict(zip(found.names, found.prior_share.tolist(), strict=True)), found.strengths[:seen], found.unseen
    )


def _pair(start: Start) -> tuple[float, float]:
    return start.value, start.std
