"""A study in the terminal and on its page: tables and sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from ident.estimate import Outcome
from scenarios.report.document import (
    PURE,
    SIGMAS,
    Block,
    Cell,
    Column,
    Number,
    Prose,
    formatted,
    known,
    table,
)
from scenarios.report.quantities import console, derived_line, is_frequency, shown_in, test_line
from scenarios.report.summary import (
    BELOW,
    TEXT,
    Summary,
    levels_line,
    print_paragraph,
    print_summary,
    residual_phrase,
    result_phrase,
)
from scenarios.report.terminal import (
    estimates_table,
    show_blocks,
    show_table,
)
from scenarios.studies.comparison import (
    HEADING,
    choice_lines,
    distance_text,
    engine_line,
    in_unit,
    other_flight_line,
    reference_lines,
    vehicle_line,
)
from scenarios.studies.declaration import Row
from scenarios.studies.study import (
    MethodDetermination,
    MethodResult,
    Scatter,
    StudyResult,
    flexibility_sentences,
)
from scenarios.studies.sweep import sweep_blocks, sweep_phrase

# ---- What records and priors determine, in the terminal

UNINFORMED_SHARE = 0.95  # posterior over prior sigma above which a record adds nothing
MOST_NAMED_DIRECTIONS = 3  # directions that are named as best known and as least known
MOST_NAMED_PARTS = 3  # parameters that are named of a direction
MOST_NAMED_PARAMETERS = 8  # parameters that are named as overclaimed


def determination_blocks(methods: Sequence[MethodDetermination]) -> list[Block]:
    """Return a table of posterior over prior sigma and of the prior's share by method, and
    sentences.
    """
    names = methods[0].found.names
    ratios, shares = [], []  # of each method, by parameter
    for method in methods:
        found = method.found
        ratio = (found.posterior_std / found.prior_std).tolist()
        ratios.append(dict(zip(found.names, ratio, strict=True)))
        shares.append(dict(zip(found.names, found.prior_share.tolist(), strict=True)))
    shown = [
        name for name in names if any(ratio.get(name, 1.0) < UNINFORMED_SHARE for ratio in ratios)
    ]
    shown.sort(key=lambda name: ratios[0][name])
    labels = [method.estimation.name for method in methods]
    ratio_columns = [
        (Column(f"{label}, sigma", PURE), [known(ratio.get(name), 3) for name in shown])
        for label, ratio in zip(labels, ratios, strict=True)
    ]
    share_columns = [
        (
            Column(f"{label}, prior", "%"),
            [known(100 * share[name] if name in share else None, 0) for name in shown],
        )
        for label, share in zip(labels, shares, strict=True)
    ]
    caption = "sigma over the prior's, and share of the variance that the prior gives"
    blocks: list[Block] = [
        table(caption, (Column("parameter"), shown), *ratio_columns, *share_columns)
    ]
    not_shown = len(names) - len(shown)
    if not_shown:
        blocks.append(
            Prose(
                f"the other {not_shown} of {len(names)} parameters keep more than "
                f"{UNINFORMED_SHARE:g} of their prior's sigma with every method"
            )
        )
    for method in methods:
        blocks += map(Prose, determination_sentences(method))
    return blocks


def determination_sentences(method: MethodDetermination) -> tuple[str, ...]:
    """Return sentences on the directions that the record determines best and least, and on
    parameters with too small sigmas. A direction is a linear combination of parameters.
    """
    found, label = method.found, method.estimation.name
    seen = len(found.names) - found.unseen
    directions = [_direction(method, number) for number in range(seen)]
    sentences = [
        f"{label}: of {len(found.names)} parameters the record shows {seen} directions and knows "
        f"{found.determined} of them better than the prior "
        f"does ({found.effective:.1f} numbers settled); along {found.unseen} directions the "
        "outputs do not change at all, whatever the noise",
        f"{label}: known best: {'; '.join(directions[:MOST_NAMED_DIRECTIONS])}",
        f"{label}: seen least: {'; '.join(directions[-MOST_NAMED_DIRECTIONS:])}",
    ]
    overclaimed = method.overclaimed
    if overclaimed:
        more = ", ..." if len(overclaimed) > MOST_NAMED_PARAMETERS else ""
        names = ", ".join(overclaimed[:MOST_NAMED_PARAMETERS]) + more
        sentences.append(
            f"{label}: claims {len(overclaimed)} parameters better than record and prior "
            f"allow: {names}"
        )
    return tuple(sentences)


def _direction(method: MethodDetermination, number: int) -> str:
    """Return strength and largest parts of a direction."""
    parts = method.found.composition(number, MOST_NAMED_PARTS)
    combination = " ".join(f"{part:+.2f} {name}" for name, part in parts).removeprefix("+")
    return f"{method.found.strengths[number]:.2g} times the prior ({combination})"


# ---- A study in the terminal


def print_study(study: StudyResult, out: Console | None = None, details: str = BELOW) -> None:
    """Print the summary, tables and notes of each method, and notes on the whole study."""
    out = out or console()
    scenario = study.scenario
    print_summary(out, study_summary(study, details))
    out.print(Text.assemble((scenario.name, "bold"), f": {scenario.title}"))
    out.print(
        f"flight and model: {distance_text(scenario.distance)}; seed {study.seed}; "
        f"{len(study.record)} samples in {study.record.time[-1]:g} s",
        highlight=False,
    )
    if line := engine_line([method.estimation for method in study.methods]):
        out.print(line, highlight=False)
    for method in study.methods:
        out.print()
        _print_method(study, method, out)
        main = method is study.main
        print_choices(
            out,
            choice_lines(scenario.choices if main else method.estimation.choices),
            vehicle_line(scenario.flight) if main else "",
        )
    if study.repeated:
        out.print()
        show_blocks(out, repeated_blocks(study.repeated))
    if study.determinations:
        out.print()
        show_blocks(out, determination_blocks(study.determinations))
    if study.sweep is not None:
        show_blocks(out, sweep_blocks(study.sweep), apart=True)
    if study.flexibility is not None:
        out.print()
        for sentence in flexibility_sentences(study.flexibility, study.scenario.flight.noise_std):
            print_paragraph(out, sentence, indent=0)
    if study.notes:
        out.print()
        for note in study.notes:
            print_paragraph(out, note, indent=0)


def print_brief(study: StudyResult, out: Console | None = None, details: str = BELOW) -> None:
    """Print the summary of a study, the main method's estimates, and where the other results are.

    ``details`` names this place, see ``details_in``.
    """
    out = out or console()
    main = study.main
    print_summary(out, study_summary(study, rest_of(details)))
    rows = [replace(row, published=None) for row in with_display(study, main.rows)]
    show_table(out, estimates_table("", rows))
    for line in (derived_line(main.derived), test_line(main.tests)):
        if line:
            print_paragraph(out, line)


def rest_of(details: str) -> str:
    """Return a sentence that says where all results of the study are."""
    if details == BELOW:
        return "--out FOLDER keeps the whole study, with a page to read"
    page = Path(details.removeprefix("below; in "))
    return f"{page} to read; {page.parent / TEXT} has every table"


def study_summary(study: StudyResult, details: str = BELOW) -> Summary:
    """Return the summary: main method, outcome, largest error, main cautions, residual."""
    main, scenario = study.main, study.scenario
    further = len(study.methods) - 1
    others = f"; {further} further method{'s' * (further > 1)} in the report" if further else ""
    errors = {row.name: row.sigmas for row in main.rows if row.sigmas is not None and row.std > 0.0}
    worst = max(errors, key=lambda name: abs(errors[name]), default="")
    outcome = main.result.estimate.outcome.value
    if worst:
        outcome += f"; largest error {errors[worst]:+.1f} sigma ({worst})"
    result = result_phrase(
        [(row.name, row.estimate, row.std, row.unit) for row in main.rows], main.derived
    )
    if study.sweep is not None:
        result = sweep_phrase(study.sweep)
    done = f"{scenario.name}: {scenario.title}; seed {study.seed}; {main.estimation.label}{others}"
    return Summary(done, outcome, result, residual_phrase(main.tests), details)


def print_choices(out: Console, lines: Sequence[str], vehicle: str = "") -> None:
    """Print the choices under a heading, and the line on the vehicle's numbers, if any."""
    if lines:
        print_paragraph(out, HEADING)
    for line in lines:
        print_paragraph(out, line, indent=4)
    if vehicle:
        print_paragraph(out, vehicle)


def _print_method(study: StudyResult, method: MethodResult, out: Console) -> None:
    estimate = method.result.estimate
    title = f"{method.estimation.label}: {estimate.outcome.value}"
    title += f"; {estimate.message}" if estimate.message else ""
    rows = with_display(study, method.rows)
    show_table(out, estimates_table(title, rows))
    flown = study.scenario.flown
    levels = levels_line(method.levels, flown, method.tests) if flown is not None else ""
    for line in (
        other_flight_line(study.scenario, method.estimation),
        derived_line(method.derived),
        levels,
        test_line(method.tests),
        method.estimation.explanation,
        *reference_lines(method.rows, method.estimation),
    ):
        if line:
            print_paragraph(out, line)


def repeated_blocks(scatters: Sequence[Scatter]) -> list[Block]:
    """Return tables of the results of repeated flights, and notes on runs that failed.

    The tables have the coverage, and the errors in sigmas and in the units of the derivatives.
    """
    runs = sum(scatters[0].outcomes.values())
    labels = [f"{scatter.flight}: {scatter.estimation.label}" for scatter in scatters]
    units: dict[str, str] = {}
    for scatter in scatters:
        units |= dict(zip(scatter.names, scatter.units, strict=True))
    converged = [scatter.outcomes.get("converged", 0) for scatter in scatters]
    coverage = [(share, *interval) for share, interval in (item.within_two for item in scatters)]

    def percent(entry: int) -> list[Cell]:
        return [Number(100.0 * row[entry], digits=0) for row in coverage]

    def errors(name: str, form: str, rms: Callable[[Scatter], np.ndarray]) -> list[Cell]:
        values = [
            rms(scatter)[scatter.names.index(name)] if name in scatter.names else None
            for scatter in scatters
        ]
        return [formatted(value, form) for value in values]

    flights = (Column("flight: method"), labels)
    blocks: list[Block] = [
        table(
            f"{runs} runs of each flight: intervals that hold the truth, and root mean square "
            "error in reported sigmas",
            flights,
            (Column("settled", PURE), [Number(count, digits=0) for count in converged]),
            (Column("within two sigmas", "%"), percent(0)),
            (Column("95 % from", "%"), percent(1)),
            (Column("to", "%", beside=True), percent(2)),
            *(
                (Column(name, SIGMAS, printed=name), errors(name, ".2f", lambda s: s.rms_sigmas))
                for name in units
            ),
        ),
        table(
            "root mean square error in the derivatives' units",
            flights,
            *(
                (Column(name, unit or PURE, printed=name), errors(name, ".3g", lambda s: s.rms))
                for name, unit in units.items()
            ),
        ),
    ]
    for scatter in scatters:
        failures = [
            f"{count} {code}"
            for code, count in sorted(scatter.outcomes.items())
            if code != "converged"
        ]
        if failures:
            line = (
                f"{scatter.flight}, {scatter.estimation.label}: {', '.join(failures)} of {runs} "
                "left out"
            )
            blocks.append(Prose(line, "note"))
    return blocks


def with_display(study: StudyResult, rows: Iterable[Row]) -> list[Row]:
    """Return the rows in display units; further rows have frequencies in Hz, and parameters in the
    units of the scenario's ``display``.
    """
    displayed = []
    for row in rows:
        unit = shown_in(row.unit, row.name).unit
        displayed.append(row if unit == row.unit else in_unit(row, unit))
        if is_frequency(row.name, row.unit):
            displayed.append(in_unit(row, "Hz"))
        if row.name in study.scenario.display:
            displayed.append(in_unit(row, study.scenario.display[row.name]))
    return displayed


# ---- The page of a study

SETTLED = (Outcome.CONVERGED, Outcome.AT_BOUND)
