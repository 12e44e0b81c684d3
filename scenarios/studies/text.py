"""Tables for the terminal (rich): what was true, what was estimated, how sure, and what a paper found."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from rich.console import Console
from rich.text import Text

from scenarios.studies.departures import HEADING, choice_lines, other_flight_line, vehicle_line
from scenarios.studies.determination.text import print_determination
from scenarios.studies.engines import engine_line
from scenarios.studies.notes import flexibility_sentences
from scenarios.studies.published import published_remark
from scenarios.studies.repeated import Scatter
from scenarios.studies.rows import Row
from scenarios.studies.study import MethodResult, Study
from scenarios.studies.sweep.text import print_sweep, sweep_phrase
from scenarios.terminal.display_units import is_frequency, shown_in, unit_cell
from scenarios.terminal.flying_qualities import levels_line
from scenarios.terminal.numbers import console, derived_line, number, test_line
from scenarios.terminal.paragraphs import print_paragraph
from scenarios.terminal.quantities import determined
from scenarios.terminal.summary import BELOW, Summary, print_summary, residual_phrase, result_phrase
from scenarios.terminal.tables import Column, print_table


def print_study(study: Study, out: Console | None = None, details: str = BELOW) -> None:
    """A summary; the study's tables, the main method first, each with what there is to say of it; then what holds for the whole study."""
    out = out or console()
    scenario = study.scenario
    print_summary(out, study_summary(study, details))
    out.print(Text.assemble((scenario.name, "bold"), f": {scenario.title}"))
    out.print(f"truth and model: {scenario.distance}; seed {study.seed}; {len(study.record)} samples in {study.record.time[-1]:g} s", highlight=False)
    if line := engine_line([method.estimation for method in study.methods]):
        out.print(line, highlight=False)
    for method in study.methods:
        out.print()
        _print_method(study, method, out)
        main = method is study.main
        print_choices(out, choice_lines(scenario.choices if main else method.estimation.choices), vehicle_line(scenario.flight) if main else "")
    if study.repeated:
        out.print()
        _print_repeated(study.repeated, out)
    determined = [method.determination for method in study.methods if method.determination is not None]
    if determined:
        out.print()
        print_determination(determined, out)
    if study.sweep is not None:
        out.print()
        print_sweep(study.sweep, out)
    if study.flexibility is not None:
        out.print()
        for sentence in flexibility_sentences(study.flexibility, study.scenario.flight.noise_std):
            print_paragraph(out, sentence, indent=0)
    if study.notes:
        out.print()
        for note in study.notes:
            print_paragraph(out, note, indent=0)


def study_summary(study: Study, details: str = BELOW) -> Summary:
    """Scenario and main method; its outcome and largest error; what matters most; what the fit leaves."""
    main, scenario = study.main, study.scenario
    others = f" and {len(study.methods) - 1} more" if len(study.methods) > 1 else ""
    errors = {row.name: row.sigmas for row in main.rows if row.sigmas is not None and row.std > 0.0}
    worst = max(errors, key=lambda name: abs(errors[name]), default="")
    outcome = main.result.estimate.outcome.value + (f"; largest error {errors[worst]:+.1f} sigma ({worst})" if worst else "")
    result = result_phrase([(row.name, row.estimate, row.std, row.unit) for row in main.rows], main.derived)
    if study.sweep is not None:
        result = sweep_phrase(study.sweep)
    done = f"{scenario.name}: {scenario.title}; seed {study.seed}; {main.estimation.label}{others}"
    return Summary(done, outcome, result, residual_phrase(main.tests), details)


def print_choices(out: Console, lines: Sequence[str], vehicle: str = "") -> None:
    """Choices, one line each under a heading, and what is to be said of the vehicle's numbers; nothing where there is nothing."""
    if lines:
        print_paragraph(out, HEADING)
    for line in lines:
        print_paragraph(out, line, indent=4)
    if vehicle:
        print_paragraph(out, vehicle)


def _known(row: Row) -> bool:
    """Whether the record says anything of a parameter; what was held without a sigma is known."""
    return not row.std > 0.0 or determined(row.estimate, row.std)


def _print_method(study: Study, method: MethodResult, out: Console) -> None:
    estimate = method.result.estimate
    title = f"{method.estimation.label}: {estimate.outcome.value}"
    title += f"; {estimate.message}" if estimate.message else ""
    rows = with_display(study, method.rows)
    columns = [
        Column("parameter", [row.name for row in rows], left=True),
        Column("unit", [unit_cell(row.unit) for row in rows], left=True),
        Column("true", [_or_dash(row.true) for row in rows]),
    ]
    if any(row.condensed is not None for row in rows):
        columns.append(Column("condensed", [_or_dash(row.condensed) for row in rows]))
    columns += [
        Column("estimate", [number(row.estimate, row.std) if _known(row) else "not determined" for row in rows]),
        Column("+- sigma", [number(row.std, row.std) if _known(row) else "-" for row in rows], beside=True),
        Column("error %", [_or_dash(row.percent, ".2f") for row in rows]),
        Column("error, sigmas", [_or_dash(row.sigmas, "+.2f") for row in rows]),
    ]
    published = []
    if any(row.published is not None for row in rows):
        published = [
            Column("published", [f"{row.published.value:.5g}" if row.published else "" for row in rows]),
            Column("+- sigma", [f"{row.published.std:.4g}" if row.published else "" for row in rows], beside=True),
            Column("off, own sigmas", [_or_dash(row.published_sigmas, "+.1f") if row.published else "" for row in rows], beside=True),
        ]
    print_table(out, title, [*columns, *published])
    flown = study.scenario.flown
    levels = levels_line(method.levels, flown, method.tests) if flown is not None else ""
    seen, remark = other_flight_line(study.scenario, method.estimation), published_remark(method.estimation.published)
    printed = f"published: {remark}" if remark else ""
    for line in (seen, derived_line(method.derived), levels, test_line(method.tests), method.estimation.explanation, printed):
        if line:
            print_paragraph(out, line)


def _print_repeated(found: Sequence[Scatter], out: Console) -> None:
    """Errors over all runs of the repeated flights: in reported sigmas, then in the derivatives' units."""
    names, runs = dict.fromkeys(name for each in found for name in each.names), sum(found[0].outcomes.values())
    common = [Column("flight: method", [f"{each.flight}: {each.estimation.label}" for each in found], left=True)]
    shares = [each.within_two for each in found]
    judged = [
        Column("settled", [str(each.outcomes.get("converged", 0)) for each in found]),
        Column("within 2 sigma", [f"{100 * share:.0f} %" for share, _ in shares]),
        Column("95 % interval", [f"{100 * low:.0f} to {100 * high:.0f} %" for _, (low, high) in shares]),
    ]
    in_sigmas = [Column(name, [_of(each, name, each.rms_sigmas, ".2f") for each in found]) for name in names]
    print_table(out, f"{runs} runs of each flight: root mean square error in reported sigmas", [*common, *judged, *in_sigmas])
    in_units = [Column(name, [_of(each, name, each.rms, ".3g") for each in found]) for name in names]
    print_table(out, "the same in the derivatives' units", [*common, *in_units])
    for each in found:
        others = ", ".join(f"{count} {code}" for code, count in sorted(each.outcomes.items()) if code != "converged")
        if others:
            print_paragraph(out, f"{each.flight}, {each.estimation.label}: {others} of {runs} left out")


def _of(each: Scatter, name: str, values: np.ndarray, digits: str) -> str:
    """One derivative's number of ``values (n,)``; a dash where a method does not estimate it or no run settled."""
    value = values[each.names.index(name)] if name in each.names else math.nan
    return format(value, digits) if math.isfinite(value) else "-"


def with_display(study: Study, rows: Iterable[Row]) -> list[Row]:
    """Rows in the units in which they are shown, frequencies in Hz as well, and again in another unit those that the scenario wants shown so."""
    from scenarios.studies.comparison import in_unit

    out = []
    for row in rows:
        shown = shown_in(row.unit, row.name).unit
        out.append(row if shown == row.unit else in_unit(row, shown))
        if is_frequency(row.name, row.unit):
            out.append(in_unit(row, "Hz"))
        if row.name in study.scenario.display:
            out.append(in_unit(row, study.scenario.display[row.name]))
    return out


def _or_dash(value: float | None, form: str = ".5g") -> str:
    return "-" if value is None else format(value, form)
