"""The study folder of a closed-loop scenario: record, truth, comparison, figures, page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.estimate import FilterHistory, Outcome
from scenarios.files.writing import study_folder, write_json, write_record, write_text
from scenarios.plots import draw_into
from scenarios.plots.display import SIMULATED_DATA
from scenarios.report.document import (
    Bullets,
    Page,
    Prose,
    Section,
    as_sentence,
    capital,
    now,
    reproduction,
    section,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import first_figure, write_page
from scenarios.report.quantities import as_text, number_text
from scenarios.report.summary import HERE, residual_phrase
from scenarios.report.terminal import tests_table
from scenarios.studies.comparison import (
    HEADING,
    SEE_PAPERS,
    bank_line,
    choice_lines,
    columns_csv,
    history_csv,
)
from scenarios.x29.content import loop_comparison
from scenarios.x29.declaration import OUTPUTS, printed_column, telemetry_noise
from scenarios.x29.estimating import start_of
from scenarios.x29.findings import sentences
from scenarios.x29.open_margins import OPEN, OpenMargins
from scenarios.x29.printing import BLOCKS, WORDS, print_loop
from scenarios.x29.study import LoopResult, LoopStudy
from sim.closed_loop.airframe import X29
from sim.declaration.effect import Parameter

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenarios.plots.drawing import Named
    from scenarios.plots.low_order import Bar
    from scenarios.plots.signals import MethodOutputs


# ---- The page of a closed-loop scenario


def loop_page(study: LoopStudy, figure_files: Sequence[Drawn] = ()) -> Page:
    """Return the page of a study with the figures ``figure_files``."""
    scenario, estimate, record = study.scenario, study.result.estimate, study.result.setting.record
    tables = {title: section(title, *blocks(study)) for title, blocks in BLOCKS.items()}
    qualities = "; ".join(
        f"{WORDS[q.name]} {number_text(q.value, q.std)} +- {number_text(q.std, q.std)}"
        f"{'' if q.unit == '1' else f' {q.unit}'}"
        for q in study.result.qualities
    )
    white = all(test.passed for test in study.tests)
    window = f"{record.time[0]:g} to {record.time[-1]:g} s"
    choices = choice_lines(scenario.choices)
    first, others = first_figure(figure_files)
    return Page(
        title=capital(scenario.title),
        kind=f"Closed-loop study {scenario.name}, delay refined over a bank of filters",
        verdict=estimate.outcome.value.partition(":")[0].partition(",")[0],
        tone="open"
        if estimate.outcome not in (Outcome.CONVERGED, Outcome.AT_BOUND)
        else "good"
        if white
        else "fair",
        sentence=as_sentence(f"residual: {residual_phrase(study.tests)}") if study.tests else "",
        summary=tuple(as_sentence(line) for line in (qualities, scenario.findings) if line),
        warnings=(),
        sections=(
            *section("Recorded and estimated", *first),
            *tables["Estimate"],
            *section(
                "Findings",
                *(Prose(as_sentence(line)) for line in sentences(study) if line),
                Prose(as_sentence(SEE_PAPERS)) if scenario.published else None,
            ),
            *section("Further figures", *others),
            *(part for title, parts in tables.items() if title != "Estimate" for part in parts),
            *section("Residuals", tests_table("Residual tests", study.tests)),
            *_provenance(study, window, choices),
        ),
        reproduction=reproduction(
            ("flightid", "run", scenario.name, "--seed", str(study.seed)), f"Seed {study.seed}."
        ),
        created=now(),
    )


def _provenance(study: LoopStudy, window: str, choices: Sequence[str]) -> tuple[Section, ...]:
    scenario = study.scenario
    origin = Prose(
        f"Flight and model: {scenario.distance}. {len(study.result.setting.record)} samples, "
        f"{window}."
    )
    engine = Prose(as_sentence(bank_line(scenario.estimation.engine, study.second)))
    heading = Prose(as_sentence(HEADING.replace(" [own]", ""))) if choices else None
    return section(
        "How it was made",
        Prose(as_sentence(scenario.about)) if scenario.about else None,
        origin,
        engine,
        heading,
        Bullets(tuple(choices)),
    )


# ---- Figures of a closed-loop study, as figs. 3 to 10 of the paper

SHOWN = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau", "delay")


def loop_figures(study: LoopStudy) -> Iterator[Named]:
    """Yield the figures of a study: stem of the file and function that draws it."""
    from scenarios.plots.estimates import figure_correlation, figure_innovations
    from scenarios.plots.low_order import figure_side_by_side, figure_states
    from scenarios.plots.signals import figure_fit, figure_record, units_of

    result, title = study.result, study.scenario.title
    estimate, record = result.estimate, result.setting.record
    history = estimate.history
    assert history is not None
    yield (
        "record",
        partial(figure_record, result.simulated.record, f"{title}\nrecord", SIMULATED_DATA),
    )
    noise = None
    if study.scenario.flight.noise:
        noise = dict(zip(OUTPUTS, estimate.noise_std.tolist(), strict=True))
    simulated = [_response("low-order equivalent, free simulation", study.simulated)]
    yield (
        "fit",
        partial(
            figure_fit,
            record,
            simulated,
            None,
            f"{title}\nfree simulation",
            noise,
            SIMULATED_DATA,
            above=record.inputs,
        ),
    )
    if (
        study.other is not None
        and study.other_simulated is not None
        and study.scenario.against is not None
    ):
        label = study.scenario.against.label
        shown = [_response("low-order equivalent, free simulation", study.other_simulated)]
        yield (
            "fit_other",
            partial(
                figure_fit,
                study.other.setting.record,
                shown,
                None,
                f"{title}\ncompared with: {label}",
                None,
                SIMULATED_DATA,
            ),
        )
        yield (
            "compared",
            partial(
                figure_side_by_side,
                _bars(study.other),
                _bars(result),
                label,
                "this study",
                title,
                _printed(study),
            ),
        )
    names = estimate.output_names
    units = units_of(record, names)
    yield "innovations", partial(figure_innovations, history, names, units, title)
    system = result.setting.system
    items = [start_of(system, name) for name in history.names]
    moving, constant = items[: len(system.state_names)], items[len(system.state_names) :]
    states, state_units = [item.name for item in moving], [item.unit for item in moving]
    heading = f"{title}\nstates of the filter"
    yield "states", partial(figure_states, history, states, state_units, heading)
    yield (
        "parameters",
        partial(_parameter_histories, history, constant, f"{title}\nparameters as states"),
    )
    yield "correlation", partial(figure_correlation, estimate.names, estimate.correlation, title)
    yield from _further_figures(study)


def _further_figures(study: LoopStudy) -> Iterator[Named]:
    from scenarios.plots.low_order import (
        LikelihoodCurve,
        figure_delays,
        figure_linear,
        figure_peaks,
    )

    title, bank = study.scenario.title, study.result.bank
    curve = LikelihoodCurve(
        bank.delays,
        bank.log_likelihood,
        bank.most_likely,
        bank.weighted_mean,
        bank.refined,
        bank.refined_std,
    )
    yield "delays", partial(figure_delays, curve, title)
    if (check := study.linear) is not None:
        units, words = ("rad", "rad/s", "g"), f"{title}\nflown and linear"
        yield (
            "linear",
            partial(
                figure_linear,
                check.time,
                check.simulated,
                check.linear,
                OUTPUTS,
                units,
                check.sticks,
                check.curves,
                words,
            ),
        )
    if study.open_margins is not None:
        yield "margins", partial(_margins, study, study.open_margins)
    if study.variants and study.scenario.peak is not None:
        rows = [
            ("as declared", study.misfit.peak_percent),
            *((v.label, v.misfit.peak_percent) for v in study.variants),
        ]
        yield (
            "variants",
            partial(
                figure_peaks, rows, "final peak of q, free simulation against the record (%)", title
            ),
        )
    elif study.variants:
        misfits = [("as declared", study.misfit), *((v.label, v.misfit) for v in study.variants)]
        if study.scenario.stretch is not None:
            axis_label = "rms of q in the stretch over σ (–)"
            rows = [(label, misfit.stretch) for label, misfit in misfits]
        else:
            axis_label = "lag-1 correlation of pitch-rate innovations (–)"
            rows = [(label, misfit.lag_one) for label, misfit in misfits]
        yield "variants", partial(figure_peaks, rows, axis_label, title)


def _parameter_histories(
    history: FilterHistory, constant: Sequence[Parameter], title: str
) -> Figure:
    """Return the figure of parameter histories with fewer tick labels."""
    from matplotlib.ticker import MaxNLocator

    from scenarios.plots.estimates import figure_parameter_histories

    prior = {item.name: (item.value, item.prior_std) for item in constant}
    names, units = [item.name for item in constant], [item.unit for item in constant]
    figure = figure_parameter_histories(history, names, units, prior=prior, title=title)
    for panel in figure.axes:
        panel.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    return figure


def _printed(study: LoopStudy) -> list[dict[str, float]]:
    """Return published values of the other and of this scenario; empty if there are none."""
    columns = (
        study.other.scenario.column if study.other is not None else "",
        study.scenario.column,
    )
    return [
        {name: cell.value for name, cell in printed_column(column).items()} for column in columns
    ]


def _margins(study: LoopStudy, found: OpenMargins) -> Figure:
    """Return the figure of margins over unpublished values, with those of declared airframes."""
    from scenarios.plots.low_order import figure_open_margins

    clouds = [
        (design.name, design.simulation[design.plausible], design.flight[design.plausible])
        for design in found.designs
    ]
    first, (other_name, other), *further = study.margins.items()
    declared = [
        (f"{name} and {other_name}, declared", other.phase, margins.phase)
        for name, margins in (first, *further)
    ]
    effects = [
        (item.label, found.effects[item.name]) for item in OPEN if item.name in found.effects
    ]
    title = f"{study.scenario.title}\nphase margins that the published numbers leave open"
    return figure_open_margins(clouds, declared, effects, title)


def _response(label: str, outputs: np.ndarray) -> MethodOutputs:
    from scenarios.plots.signals import MethodOutputs

    return MethodOutputs(label, dict(zip(OUTPUTS, outputs, strict=True)))


def _bars(result: LoopResult) -> dict[str, Bar]:
    from scenarios.plots.low_order import Bar

    estimate = result.estimate
    out = {
        n: Bar(estimate.value(n), estimate.sigma(n), estimate.units[estimate.names.index(n)])
        for n in SHOWN
        if n in estimate.names
    }
    for name in ("natural_frequency", "damping_ratio"):
        quality = result.quality(name)
        if quality is not None:
            out[name] = Bar(quality.value, quality.std, quality.unit)
    return out


# ---- The study folder of a closed-loop scenario: record, truth, comparison, history, figures

MAIN = "comparison.json"


def write_loop(study: LoopStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a study into ``folder``, all files or none; return the folder.

    Files: ``record.csv`` and ``record.json`` (the flight), ``truth.json``, ``study.txt`` (the text
    of the terminal), ``history.csv`` of the filter at the refined delay, ``simulation.csv``
    (measured and simulated outputs in the window), figures, the page, ``comparison.json`` last.
    Other scenarios that the study used are named in it, not nested.
    """
    with study_folder(folder, MAIN) as scratch:
        write_record(scratch, study.result.simulated.record, simulated=True)
        write_json(scratch / "truth.json", truth_content(study))
        write_text(scratch / "study.txt", as_text(lambda out: print_loop(study, out, HERE)))
        estimate = study.result.estimate
        assert estimate.history is not None
        text = history_csv(estimate.history, estimate.output_names)
        write_text(scratch / "history.csv", text)
        write_text(scratch / "simulation.csv", _simulation_csv(study))
        figure_files = draw_into(scratch, loop_figures(study), figures)
        write_page(scratch, loop_page(study, figure_files))
        write_json(scratch / MAIN, loop_comparison(study))
    return Path(folder)


def truth_content(study: LoopStudy) -> dict[str, Any]:
    """Return the true flight: airframe, stick, noise.

    It has no true parameters, since the loop is of higher order than the model.
    """
    simulated, flight = study.result.simulated, study.scenario.flight
    x29: X29 = simulated.x29
    a, stick = x29.airframe, x29.stick
    content: dict[str, Any] = {
        "schema": "flightid/truth/1",
        "parameters": {},
        "airframe": {
            "name": x29.name,
            "title": a.title,
            "L_alpha": a.L_alpha,
            "L_q": a.L_q,
            "M_alpha": a.M_alpha,
            "M_q": a.M_q,
        },
        "stick": {
            "kind": flight.stick.kind,
            "dead_band": stick.dead_band,
            "gain": stick.gain,
            "curvature": stick.curvature,
        },
        "noise_std": telemetry_noise(x29) if flight.noise else dict.fromkeys(OUTPUTS, 0.0),
        "effects": [],
        "distance": study.scenario.distance,
    }
    if flight.spike is not None:
        content["effects"] = ["sensor-spikes:stick"]
        content["spike"] = {"time": flight.spike.time, "size": flight.spike.size}
    if simulated.truth is not None:
        content["limits_met"] = {
            "command": float(np.mean(simulated.truth.command_limited)),
            "rate": float(np.mean(simulated.truth.rate_limited)),
            "stops": float(np.mean(simulated.truth.stopped)),
        }
    return content


def _simulation_csv(study: LoopStudy) -> str:
    """Return measured and simulated outputs in the window as CSV."""
    record = study.result.setting.record
    columns: dict[str, np.ndarray] = {"time": record.time}
    for name, simulated in zip(OUTPUTS, study.simulated, strict=True):
        columns |= {name: record[name].values, f"simulated_{name}": simulated}
    return columns_csv(columns)
