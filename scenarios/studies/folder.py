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
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import write_page
from scenarios.report.quantities import as_text
from scenarios.report.summary import HERE
from scenarios.studies.campaign import CampaignRuns, Spread
from scenarios.studies.campaign_causes import Judgement
from scenarios.studies.campaign_report import findings_content
from scenarios.studies.campaign_statistics import (
    NORMAL,
    SIGMAS,
    CampaignStatistics,
    statistics_content,
    statistics_csv,
)
from scenarios.studies.comparison import comparison, determination_csv
from scenarios.studies.declaration import Start
from scenarios.studies.page import campaign_page, study_page
from scenarios.studies.study import MethodDetermination, MethodResult, StudyResult
from scenarios.studies.sweep import Sweep, criteria_of, sweep_csv
from scenarios.studies.text import print_study
from sim.truth.flight import INTEGRATION_TOLERANCE, Truth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenarios.plots.drawing import Named
    from scenarios.plots.residuals import EquivalentRow
    from scenarios.plots.signals import MethodOutputs
    from scenarios.plots.studies import Coverage, DeterminedBy


# ---- Data of the figure of a sweep

# Criterion -> axis label, legend, range drawn to scale.
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

    Methods: the main one and those with elastic modes.
    """
    from scenarios.plots.studies import (
        CriterionCourse,
        DerivativeCourse,
        Published,
        figure_flexibility,
    )

    points = sweep.points
    degrees = [point.figures.degree for point in points]
    courses = []
    for name, rigid in sweep.rigid.items():
        estimates = {}
        for number, method in enumerate(points[0].methods):
            if name in method.names and (
                number == 0 or method.estimation.modes != points[0].methods[0].estimation.modes
            ):
                at = method.names.index(name)
                found = [
                    (float(point.methods[number].values[at]), float(point.methods[number].std[at]))
                    for point in points
                ]
                estimates[method.estimation.label] = found
        printed = [
            Published(sweep.point(mark.frequency_factor).figures.degree, start.value, start.std)
            for mark, values in sweep.marks
            if (start := values.get(name)) is not None
        ]
        condensed = [point.figures.condensed[name] for point in points]
        best = [point.figures.fitted[name] for point in points]
        courses.append(
            DerivativeCourse(name, sweep.units[name], rigid, condensed, best, estimates, printed)
        )
    criteria = [
        CriterionCourse(
            *LABELS[each.name][:2], each.limit, each.values, each.degree, LABELS[each.name][2]
        )
        for each in criteria_of(points)
    ]
    marks = {
        mark.label: sweep.point(mark.frequency_factor).figures.degree for mark, _ in sweep.marks
    }
    return figure_flexibility(degrees, courses, criteria, marks, title)


# ---- Data of the figures of a campaign's statistics


def statistics_figures(found: CampaignStatistics, title: str) -> Iterator[Named]:
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
            p.name,
            tuple(
                (100.0 * w.share, 100.0 * w.interval[0], 100.0 * w.interval[1]) for w in p.coverage
            ),
        )
        for p in found.parameters
    ]
    yield (
        "coverage",
        partial(figure_coverage, rows, [100.0 * NORMAL[each] for each in SIGMAS], title),
    )
    yield "normality", partial(figure_errors, found.names, found.sigmas, title)
    panels = [
        SquaresPanel(s.name, s.values / s.degrees, float(s.degrees.mean()))
        for s in (found.nees, found.nis)
        if s is not None
    ]
    if panels:
        yield "consistency", partial(figure_squares, panels, title)


# ---- Figures of a study

TOLD_APART = 0.1  # share of the main method's residual rms; methods that differ less are not drawn
MOST_RESPONSES = 3
MOST_PANELS = 30  # parameters in one figure


def study_figures(study: StudyResult) -> Iterator[Named]:
    """Yield a scenario's figures: file stem and drawing function."""
    from scenarios.plots.residuals import (
        ComparisonRow,
        ErrorCloud,
        figure_comparison,
        figure_equivalents,
        figure_repeated,
    )
    from scenarios.plots.signals import context, figure_fit, figure_record
    from scenarios.plots.studies import figure_determination

    scenario, main = study.scenario, study.main
    title = scenario.title
    responses = [_response(method) for method in _told_apart(study)]
    known = {name for each in responses for name in each.outputs}
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
            context(study.record, tuple(known)),
        ),
    )
    yield "record", partial(figure_record, study.record, title, SIMULATED_DATA)
    for method in study.methods:
        if method.estimation.flight is not None:
            heading = f"{title}\n{method.estimation.label}"
            drawn = partial(figure_record, method.result.record, heading, SIMULATED_DATA)
            yield f"record_{method.estimation.name}", drawn
        # For a single parameter, the figures with all methods suffice.
        if method is main or len(method.rows) > 1:
            yield from _filter_figures(
                study, method, "" if method is main else f"_{method.estimation.name}"
            )
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
        yield (
            "errors",
            partial(figure_comparison, rows, f"{title}\n{label}error against the {against} value"),
        )
    if study.repeated:
        clouds = [
            ErrorCloud(each.estimation.label, each.flight, each.names, each.sigmas, each.outcomes)
            for each in study.repeated
        ]
        yield "repeated", partial(figure_repeated, clouds, title)
    determined = [
        _determined(method.determination)
        for method in study.methods
        if method.determination is not None
    ]
    if determined:
        yield "determination", partial(figure_determination, determined, title)
    if study.sweep is not None:
        yield "flexibility", partial(draw_sweep, study.sweep, title)
    if scenario.condensed:
        yield "equivalents", partial(figure_equivalents, _equivalents(study), title)


def campaign_figures(campaign: CampaignRuns, statistics: CampaignStatistics) -> Iterator[Named]:
    """Yield the figures of a campaign: errors and coverage of all runs, and its statistics."""
    from scenarios.plots.studies import figure_campaign

    reference = np.array([[spread.reference] for spread in campaign.spreads])
    sigmas = (campaign.values - reference) / campaign.std
    rows = [_coverage(spread, each) for spread, each in zip(campaign.spreads, sigmas, strict=True)]
    title = f"{campaign.scenario.title}\n{campaign.estimation.label}: {sigmas.shape[1]} runs"
    yield (
        "campaign",
        partial(
            figure_campaign,
            [*rows, _coverage(campaign.pooled, sigmas.ravel())] if len(rows) > 1 else rows,
            title,
        ),
    )
    yield from statistics_figures(statistics, title)


def _coverage(spread: Spread, sigmas: np.ndarray) -> Coverage:
    from scenarios.plots.studies import Coverage

    low, high = spread.interval
    return Coverage(spread.name, sigmas, 100.0 * spread.within_two, (100.0 * low, 100.0 * high))


def _filter_figures(study: StudyResult, method: MethodResult, suffix: str) -> Iterator[Named]:
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
            row.name: _pair(row.published) for row in method.rows if row.published is not None
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


def _told_apart(study: StudyResult) -> list[MethodResult]:
    """Return the main method and those whose residuals differ visibly from its residuals."""
    z, valid = study.record.output_array(study.main.result.estimate.output_names)

    def size(method: MethodResult) -> np.ndarray:
        return np.sqrt(
            np.mean(np.where(valid, z - method.result.estimate.fitted[0], 0.0) ** 2, axis=1)
        )

    expected = size(study.main)
    same_record = [
        m
        for m in study.methods[1:]
        if m.result.record is study.record and len(m.result.estimate.output_names) == len(z)
    ]
    return [
        study.main,
        *(m for m in same_record if np.any(np.abs(size(m) / expected - 1.0) > TOLD_APART)),
    ][:MOST_RESPONSES]


def _ballistic_figures(study: StudyResult) -> Iterator[Named]:
    from scenarios.plots.signals import figure_ballistic_coefficient, figure_trajectory

    kept, same_fall = {}, {}
    for method in study.methods:
        if method.result.estimate.history is not None:
            kept[method.estimation.label] = method.result.estimate.history
            if method.estimation.flight is None:
                same_fall[method.estimation.label] = method.result.estimate.history
    if same_fall:
        yield (
            "trajectory",
            partial(figure_trajectory, study.record, same_fall, study.truth, study.scenario.title),
        )
    if kept:
        true = study.truth.parameters["beta"].value
        yield (
            "ballistic_coefficient",
            partial(figure_ballistic_coefficient, kept, true, title=study.scenario.title),
        )


def _response(method: MethodResult) -> MethodOutputs:
    from scenarios.plots.signals import response_of

    return response_of(method.result.estimate, method.estimation.label)


def _equivalents(study: StudyResult) -> list[EquivalentRow]:
    from scenarios.plots.residuals import EquivalentRow

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

    found, seen = method.found, len(method.found.names) - method.found.unseen
    ratio = dict(zip(found.names, (found.posterior_std / found.prior_std).tolist(), strict=True))
    return DeterminedBy(
        method.estimation.label,
        ratio,
        dict(zip(found.names, found.prior_share.tolist(), strict=True)),
        found.strengths[:seen],
        found.unseen,
    )


def _pair(start: Start) -> tuple[float, float]:
    return start.value, start.std


# ---- The study folder of a scenario: record, truth, comparison, histories, figures

MAIN = "comparison.json"


def write_study(study: StudyResult, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a study into ``folder``, whole or not at all; returns the folder.

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
                write_history(scratch / f"history{suffix}.csv", method)
        write_json(scratch / "truth.json", truth_content(study.truth))
        determined = [
            method.determination for method in study.methods if method.determination is not None
        ]
        if determined:
            write_text(scratch / "determination.csv", determination_csv(determined))
        if study.sweep is not None:
            write_text(scratch / "sweep.csv", sweep_csv(study.sweep))
        write_text(scratch / "study.txt", as_text(lambda out: print_study(study, out, HERE)))
        labels = {each.estimation.name: each.estimation.label for each in study.methods}
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


def write_history(path: Path, method: MethodResult) -> None:
    """Write states and parameters with sigmas, and innovations, of each sample as CSV."""
    history = method.result.estimate.history
    assert history is not None
    outputs = method.result.estimate.output_names
    header = ["time"]
    for name in history.names:
        header += [name, f"std_{name}"]
    for name in outputs:
        header += [f"innovation_{name}", f"std_innovation_{name}"]
    columns = [history.time]
    for mean, std in zip(history.mean, history.std, strict=True):
        columns += [mean, std]
    for value, std in zip(history.innovation, history.innovation_std, strict=True):
        columns += [value, std]
    rows = np.array(columns).T.tolist()
    write_text(path, csv_text(header, ([f"{value:.9g}" for value in row] for row in rows)))


# ---- The folder of a campaign


def write_campaign(
    campaign: CampaignRuns, judgement: Judgement, out: Path, *, figures: Formats = USUAL
) -> Path:
    """Write data files, figures and the page into ``out``, all or nothing; return ``out``."""
    with study_folder(out, "campaign.json") as scratch:
        header = ["seed", *(part for name in campaign.names for part in (name, f"std_{name}"))]
        sound = campaign.seeds[campaign.kept].tolist()
        cells = np.stack([campaign.values, campaign.std], axis=1).reshape(-1, len(sound)).T
        rows = ([seed, *map(repr, row)] for seed, row in zip(sound, cells.tolist(), strict=True))
        write_text(scratch / "statistics.csv", statistics_csv(judgement.statistics))
        write_text(scratch / "estimates.csv", csv_text(header, rows))
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.drawing import draw_for_page

            drawn = draw_for_page(
                campaign_figures(campaign, judgement.statistics), scratch, figures
            )
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
            "parameters": {s.name: _spread(s) for s in campaign.spreads},
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


def _spread(s: Spread) -> dict[str, Any]:
    return {
        "unit": s.unit,
        "reference": s.reference,
        "bias": s.bias,
        "scatter": s.scatter,
        "reported_std": s.reported,
        "within_one_sigma": s.within_one,
        "within_two_sigma": s.within_two,
        "interval": list(s.interval),
    }
