"""The folders of a study (record, truth, comparison, histories, figures) and of a campaign."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.files.sources import versions
from scenarios.files.writing import (
    RESPONSE,
    csv_text,
    study_folder,
    write_json,
    write_record,
    write_responses,
    write_text,
)
from scenarios.plots import draw_into
from scenarios.plots.display import SIMULATED_DATA
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.report.folder import write_page
from scenarios.report.quantities import as_text
from scenarios.report.summary import HERE
from scenarios.studies.campaign import CampaignRuns, Spread
from scenarios.studies.campaign_causes import Judgement
from scenarios.studies.campaign_report import campaign_page, findings_content
from scenarios.studies.campaign_statistics import (
    NORMAL,
    SIGMAS,
    CampaignStatistics,
    statistics_content,
    statistics_csv,
)
from scenarios.studies.comparison import comparison, determination_csv, history_csv
from scenarios.studies.page import study_page
from scenarios.studies.study import (
    MethodDetermination,
    MethodResult,
    StudyResult,
    distinct_labels,
)
from scenarios.studies.sweep import Sweep, criteria_of, sweep_csv
from scenarios.studies.text import print_study
from sim.truth.flight import INTEGRATION_TOLERANCE, Truth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenarios.plots.comparisons import EquivalentRow
    from scenarios.plots.drawing import Named
    from scenarios.plots.studies import Coverage, DeterminedBy


# ---- Data of the figure of a sweep

# Criterion -> axis label, legend, range of values drawn to scale.
LABELS = {
    "likelihood": (
        "BIC gain of an elastic mode (–)",
        "from here on a mode is likelier (BIC)",
        (-100.0, 300.0),
    ),
    "whiteness": (r"$\log_{10}$ p(residual white)", "the residual is not white", (-20.0, 0.0)),
    "misfit": (
        r"$\log_{10}$ (misfit / noise)",
        "no rigid model fits to the noise",
        (-math.inf, math.inf),
    ),
}


def draw_sweep(sweep: Sweep, title: str) -> Figure:
    """Return the figure of equivalent derivatives and criteria over the degree of flexibility.

    It has the main method, and the methods with another number of elastic modes.
    """
    from scenarios.plots.studies import (
        CriterionCourse,
        DerivativeCourse,
        Published,
        figure_flexibility,
    )

    points = sweep.points
    degrees = [point.figures.degree for point in points]
    main_modes = points[0].methods[0].estimation.modes
    courses = []
    for name, rigid in sweep.rigid.items():
        estimates = {}
        labels = distinct_labels([method.estimation for method in points[0].methods])
        for number, (label, method) in enumerate(zip(labels, points[0].methods, strict=True)):
            if name in method.names and (number == 0 or method.estimation.modes != main_modes):
                at = method.names.index(name)
                estimates[label] = [
                    (float(point.methods[number].values[at]), float(point.methods[number].std[at]))
                    for point in points
                ]
        published = [
            Published(sweep.point(mark.frequency_factor).figures.degree, start.value, start.std)
            for mark, values in sweep.marks
            if (start := values.get(name)) is not None
        ]
        condensed = [point.figures.condensed[name] for point in points]
        best = [point.figures.fitted[name] for point in points]
        courses.append(
            DerivativeCourse(name, sweep.units[name], rigid, condensed, best, estimates, published)
        )
    criteria = []
    for item in criteria_of(points):
        axis_label, legend, drawn_range = LABELS[item.name]
        criteria.append(
            CriterionCourse(axis_label, legend, item.limit, item.values, item.degree, drawn_range)
        )
    marks = {
        mark.label: sweep.point(mark.frequency_factor).figures.degree for mark, _ in sweep.marks
    }
    return figure_flexibility(degrees, courses, criteria, marks, title)


# ---- Data of the figures of a campaign's statistics


def statistics_figures(statistics: CampaignStatistics, title: str) -> Iterator[Named]:
    """Yield the figures of coverage, of the error distribution, and of NEES and NIS."""
    from scenarios.plots.studies import (
        CoverageRow,
        SquaresPanel,
        figure_coverage,
        figure_errors,
        figure_squares,
    )

    rows = [
        CoverageRow(
            parameter.name,
            tuple(
                (100.0 * within.share, 100.0 * within.interval[0], 100.0 * within.interval[1])
                for within in parameter.coverage
            ),
        )
        for parameter in statistics.parameters
    ]
    expected = [100.0 * NORMAL[sigmas] for sigmas in SIGMAS]
    yield "coverage", partial(figure_coverage, rows, expected, title)
    yield "normality", partial(figure_errors, statistics.names, statistics.sigmas, title)
    panels = [
        SquaresPanel(squares.name, squares.values / squares.degrees, float(squares.degrees.mean()))
        for squares in (statistics.nees, statistics.nis)
        if squares is not None
    ]
    if panels:
        yield "consistency", partial(figure_squares, panels, title)


# ---- Figures of a study

# Relative difference from the main method's residual rms; methods that differ less are not drawn.
VISIBLE_DIFFERENCE = 0.1
MOST_RESPONSES = 3  # methods whose outputs are drawn
MOST_PANELS = 30  # parameters in one figure


def study_figures(study: StudyResult) -> Iterator[Named]:
    """Yield a scenario's figures: file stem and drawing function."""
    from scenarios.plots.comparisons import ErrorCloud, figure_equivalents, figure_repeated
    from scenarios.plots.signals import context, figure_fit, figure_record, response_of
    from scenarios.plots.studies import figure_determination

    scenario, main = study.scenario, study.main
    title = scenario.title
    responses = [
        response_of(method.result.estimate, method.estimation.label)
        for method in _distinguishable(study)
    ]
    fitted_outputs = {name for response in responses for name in response.outputs}
    yield (
        "fit",
        partial(
            figure_fit,
            study.record,
            responses,
            study.truth,
            title,
            study.truth.noise_std,
            SIMULATED_DATA,
            context(study.record, tuple(fitted_outputs)),
        ),
    )
    yield "record", partial(figure_record, study.record, title, SIMULATED_DATA)
    for method in study.methods:
        if method.estimation.flight is not None:
            heading = f"{title}\n{method.estimation.label}"
            yield (
                f"record_{method.estimation.name}",
                partial(figure_record, method.result.record, heading, SIMULATED_DATA),
            )
        # For a single parameter, the figures with all methods suffice.
        if method is main or len(method.rows) > 1:
            yield from _filter_figures(
                study, method, "" if method is main else f"_{method.estimation.name}"
            )
    if scenario.estimations[0].model == "ballistic":
        yield from _ballistic_figures(study)
    yield from _error_figure(study)
    if study.repeated:
        clouds = [
            ErrorCloud(
                scatter.estimation.label,
                scatter.flight,
                scatter.names,
                scatter.sigmas,
                scatter.outcomes,
            )
            for scatter in study.repeated
        ]
        yield "repeated", partial(figure_repeated, clouds, title)
    if study.determinations:
        determined = [_determined(method) for method in study.determinations]
        yield "determination", partial(figure_determination, determined, title)
    if study.sweep is not None:
        yield "flexibility", partial(draw_sweep, study.sweep, title)
    if scenario.condensed:
        yield "equivalents", partial(figure_equivalents, _equivalents(study), title)


def _error_figure(study: StudyResult) -> Iterator[Named]:
    from scenarios.plots.comparisons import ComparisonRow, figure_comparison

    scenario, main = study.scenario, study.main
    is_single = len(main.rows) == 1  # all methods in one figure
    rows = [
        ComparisonRow(
            row.name,
            row.reference,
            row.estimate,
            row.std,
            row.published.value if row.published else None,
            row.published.std if row.published else None,
            method.estimation.label if is_single else "",
        )
        for method in (study.methods if is_single else (main,))
        for row in method.rows
        if row.reference is not None
    ]
    if rows:
        against = "condensed" if scenario.condensed else "true"
        label = "" if is_single else f"{main.estimation.label}: "
        title = f"{scenario.title}\n{label}error against the {against} value"
        yield "errors", partial(figure_comparison, rows, title)


def campaign_figures(campaign: CampaignRuns, statistics: CampaignStatistics) -> Iterator[Named]:
    """Yield the figures of a campaign: errors and coverage of all runs, and its statistics."""
    from scenarios.plots.studies import figure_campaign

    reference = np.array([[spread.reference] for spread in campaign.spreads])
    sigmas = (campaign.values - reference) / campaign.std
    rows = [_coverage(spread, row) for spread, row in zip(campaign.spreads, sigmas, strict=True)]
    if len(rows) > 1:
        rows.append(_coverage(campaign.pooled, sigmas.ravel()))
    title = f"{campaign.scenario.title}\n{campaign.estimation.label}: {sigmas.shape[1]} runs"
    yield "campaign", partial(figure_campaign, rows, title)
    yield from statistics_figures(statistics, title)


def _coverage(spread: Spread, sigmas: np.ndarray) -> Coverage:
    from scenarios.plots.studies import Coverage

    low, high = spread.interval
    return Coverage(spread.name, sigmas, 100.0 * spread.within_two, (100.0 * low, 100.0 * high))


def _filter_figures(study: StudyResult, method: MethodResult, suffix: str) -> Iterator[Named]:
    """Yield the figures of a filter's histories, and the correlation of the main method."""
    from scenarios.plots.estimates import (
        figure_correlation,
        figure_innovations,
        figure_parameter_histories,
    )
    from scenarios.plots.signals import units_of

    estimate, estimation = method.result.estimate, method.estimation
    title = f"{study.scenario.title}\n{estimation.label}"
    if estimate.history is not None:
        prior = {name: (start.value, start.std) for name, start in estimation.start.items()}
        true = {row.name: row.reference for row in method.rows if row.reference is not None}
        published = {
            row.name: (row.published.value, row.published.std)
            for row in method.rows
            if row.published is not None
        }
        units = [row.unit for row in method.rows]
        against = "condensed" if study.scenario.condensed else "true"
        if len(estimate.names) <= MOST_PANELS:
            shown = estimate.history, estimate.names, units, true, published, prior, title, against
            yield f"parameters{suffix}", partial(figure_parameter_histories, *shown)
        units = units_of(method.result.record, estimate.output_names)
        yield (
            f"innovations{suffix}",
            partial(figure_innovations, estimate.history, estimate.output_names, units, title),
        )
    if (
        method is study.main
        and 1 < len(estimate.names) <= MOST_PANELS
        and np.all(np.isfinite(estimate.correlation))
    ):
        yield (
            "correlation",
            partial(figure_correlation, estimate.names, estimate.correlation, title),
        )


def _distinguishable(study: StudyResult) -> list[MethodResult]:
    """Return the main method and those whose residuals differ visibly from its residuals."""
    z, valid = study.record.output_array(study.main.result.estimate.output_names)

    def residual_rms(method: MethodResult) -> np.ndarray:
        return np.sqrt(
            np.mean(np.where(valid, z - method.result.estimate.fitted[0], 0.0) ** 2, axis=1)
        )

    of_main = residual_rms(study.main)
    drawn = [study.main]
    for method in study.methods[1:]:
        estimate = method.result.estimate
        if method.result.record is not study.record or len(estimate.output_names) != len(z):
            continue
        if np.any(np.abs(residual_rms(method) / of_main - 1.0) > VISIBLE_DIFFERENCE):
            drawn.append(method)
    return drawn[:MOST_RESPONSES]


def _ballistic_figures(study: StudyResult) -> Iterator[Named]:
    from scenarios.plots.signals import figure_ballistic_coefficient, figure_trajectory

    title = study.scenario.title
    histories, of_common_flight = {}, {}  # by label of the method
    for method in study.methods:
        history, label = method.result.estimate.history, method.estimation.label
        if history is not None:
            histories[label] = history
            if method.estimation.flight is None:
                of_common_flight[label] = history
    if of_common_flight:
        drawn = partial(figure_trajectory, study.record, of_common_flight, study.truth, title)
        yield "trajectory", drawn
    if histories:
        true = study.truth.parameters["beta"].value
        drawn = partial(figure_ballistic_coefficient, histories, true, title=title)
        yield "ballistic_coefficient", drawn


def _equivalents(study: StudyResult) -> list[EquivalentRow]:
    from scenarios.plots.comparisons import EquivalentRow

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
    from scenarios.plots.studies import DeterminedBy

    found = method.found
    ratio = (found.posterior_std / found.prior_std).tolist()
    return DeterminedBy(
        method.estimation.label,
        dict(zip(found.names, ratio, strict=True)),
        dict(zip(found.names, found.prior_share.tolist(), strict=True)),
        found.strengths[: len(found.names) - found.unseen],
        found.unseen,
    )


# ---- The study folder of a scenario: record, truth, comparison, histories, figures

MAIN = "comparison.json"


def write_study(study: StudyResult, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a study into ``folder``, all files or none; return the folder.

    Files: ``record.csv`` and ``record.json``, ``truth.json``, ``study.txt`` (terminal output),
    ``response.csv`` (measured, predicted and noise-free outputs), ``history.csv`` of a filter,
    figures in the formats ``figures``, ``report.html`` and its source ``report.json``,
    ``comparison.json`` last. Further methods: ``response_METHOD.csv``, ``history_METHOD.csv``, and
    ``record_METHOD.csv`` for another flight or other sensors. Optional: ``sweep.csv``,
    ``determination.csv``.
    """
    with study_folder(folder, MAIN) as scratch:
        write_record(scratch, study.record, simulated=True)
        for method in study.methods:
            name = method.estimation.name
            if method.result.record is not study.record:
                write_record(scratch, method.result.record, f"record_{name}", simulated=True)
            suffix = "" if method is study.main else f"_{name}"
            estimate = method.result.estimate
            predicted = dict(zip(estimate.output_names, estimate.fitted[0], strict=True))
            write_responses(
                scratch / f"{RESPONSE}{suffix}.csv",
                method.result.record,
                predicted,
                method.truth.outputs if method.truth else None,
            )
            if estimate.history is not None:
                text = history_csv(estimate.history, estimate.output_names)
                write_text(scratch / f"history{suffix}.csv", text)
        write_json(scratch / "truth.json", truth_content(study.truth))
        if study.determinations:
            text = determination_csv(study.determinations)
            write_text(scratch / "determination.csv", text)
        if study.sweep is not None:
            write_text(scratch / "sweep.csv", sweep_csv(study.sweep))
        write_text(scratch / "study.txt", as_text(lambda out: print_study(study, out, HERE)))
        labels = {method.estimation.name: method.estimation.label for method in study.methods}
        drawn = draw_into(scratch, study_figures(study), figures, labels)
        write_page(scratch, study_page(study, drawn))
        write_json(scratch / MAIN, comparison(study))
    return Path(folder)


def truth_content(truth: Truth) -> dict[str, Any]:
    """Return true parameters, effects, noise and distance from the model, without histories."""
    return {
        "schema": "flightid/truth/1",
        "parameters": {
            item.name: {"value": item.value, "unit": item.unit, "source": item.source}
            for item in truth.parameters
        },
        "effects": list(truth.effects),
        "noise_std": dict(truth.noise_std),
        "process_density": dict(truth.process_density),
        "distance": truth.distance.value,
        **({"tolerance": INTEGRATION_TOLERANCE} if truth.step is None else {"step": truth.step}),
        "method": truth.method,
    }


# ---- The folder of a campaign


def write_campaign(
    campaign: CampaignRuns, judgement: Judgement, out: Path, *, figures: Formats = USUAL
) -> Path:
    """Write data files, figures and the page into ``out``, all files or none; return ``out``."""
    with study_folder(out, "campaign.json") as scratch:
        header = ["seed", *(part for name in campaign.names for part in (name, f"std_{name}"))]
        seeds = campaign.seeds[campaign.kept].tolist()
        cells = np.stack([campaign.values, campaign.std], axis=1).reshape(-1, len(seeds)).T
        rows = ([seed, *map(repr, row)] for seed, row in zip(seeds, cells.tolist(), strict=True))
        write_text(scratch / "statistics.csv", statistics_csv(judgement.statistics))
        write_text(scratch / "estimates.csv", csv_text(header, rows))
        drawn = draw_into(scratch, campaign_figures(campaign, judgement.statistics), figures)
        write_page(scratch, campaign_page(campaign, judgement, drawn))
        content = {
            "schema": "flightid/campaign/1",
            "scenario": campaign.scenario.name,
            "method": campaign.estimation.name,
            "seed": campaign.root,
            "runs": len(campaign.seeds),
            **({"asked": campaign.asked} if campaign.asked > len(campaign.seeds) else {}),
            "broken": campaign.broken,
            **({"failures": dict(campaign.failures)} if campaign.failures else {}),
            "parameters": {spread.name: _spread_content(spread) for spread in campaign.spreads},
            "pooled": {
                "within_one_sigma": campaign.pooled.within_one,
                "within_two_sigma": campaign.pooled.within_two,
                "interval": list(campaign.pooled.interval),
            },
            "statistics": statistics_content(judgement.statistics),
            **findings_content(judgement.findings),
            "versions": versions(),
        }
        write_json(scratch / "campaign.json", content)
    return out


def _spread_content(spread: Spread) -> dict[str, Any]:
    return {
        "unit": spread.unit,
        "reference": spread.reference,
        "bias": spread.bias,
        "scatter": spread.scatter,
        "reported_std": spread.reported,
        "within_one_sigma": spread.within_one,
        "within_two_sigma": spread.within_two,
        "interval": list(spread.interval),
    }
