"""A study in the terminal: tables and sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

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
from scenarios.report.quantities import (
    console,
    derived_line,
    is_frequency,
    shown_in,
    test_line,
)
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
from scenarios.report.terminal import estimates_table, show_blocks, show_table
from scenarios.studies.comparison import (
    HEADING,
    choice_lines,
    distance_text,
    engine_line,
    other_flight_line,
    reference_lines,
    vehicle_line,
)
from scenarios.studies.published import Row
from scenarios.studies.study import (
    MethodDetermination,
    MethodResult,
    Scatter,
    StudyResult,
    flexibility_sentences,
)
from scenarios.studies.sweep import Criterion, Sweep, SweepPoint, criteria_of

# ---- What records and priors determine, in the terminal

UNINFORMED_SHARE = 0.95  # posterior over prior sigma above which a record adds nothing
MOST_NAMED_DIRECTIONS = 3  # directions of each kind that are named


def determination_blocks(methods: Sequence[MethodDetermination]) -> list[Block]:
    """Return tables of posterior over prior sigma and of the prior's share, by method."""
    first = methods[0].found
    ratio = [
        dict(zip(m.found.names, (m.found.posterior_std / m.found.prior_std).tolist(), strict=True))
        for m in methods
    ]
    share = [dict(zip(m.found.names, m.found.prior_share.tolist(), strict=True)) for m in methods]
    shown = [
        name
        for name in first.names
        if any(each.get(name, 1.0) < UNINFORMED_SHARE for each in ratio)
    ]
    shown.sort(key=lambda name: ratio[0][name])
    labels = [method.estimation.name for method in methods]
    blocks: list[Block] = [
        table(
            "sigma over the prior's, and share of the variance that the prior gives",
            (Column("parameter"), shown),
            *(
                (Column(f"{label}, sigma", PURE), [known(each.get(n), 3) for n in shown])
                for label, each in zip(labels, ratio, strict=True)
            ),
            *(
                (
                    Column(f"{label}, prior", "%"),
                    [known(100 * each[n] if n in each else None, 0) for n in shown],
                )
                for label, each in zip(labels, share, strict=True)
            ),
        )
    ]
    rest = len(first.names) - len(shown)
    if rest:
        blocks.append(
            Prose(
                f"the other {rest} of {len(first.names)} parameters keep more than "
                f"{UNINFORMED_SHARE:g} of their prior's sigma with every method"
            )
        )
    for method in methods:
        blocks += map(Prose, determination_sentences(method))
    return blocks


def determination_sentences(method: MethodDetermination) -> tuple[str, ...]:
    """Return sentences on what the record determines best and least, and on overclaims."""
    found, label = method.found, method.estimation.name
    seen = len(found.names) - found.unseen
    sentences = [
        f"{label}: of {len(found.names)} parameters the record shows {seen} directions and knows "
        f"{found.determined} of them better than the prior "
        f"does ({found.effective:.1f} numbers settled); along {found.unseen} directions the "
        "outputs do not change at all, whatever the noise"
    ]
    best, least = (
        range(min(MOST_NAMED_DIRECTIONS, seen)),
        range(max(seen - MOST_NAMED_DIRECTIONS, 0), seen),
    )
    sentences.append(f"{label}: known best: {'; '.join(_direction(method, at) for at in best)}")
    sentences.append(f"{label}: seen least: {'; '.join(_direction(method, at) for at in least)}")
    if method.overclaimed:
        names = ", ".join(method.overclaimed[:8]) + (", ..." if len(method.overclaimed) > 8 else "")
        sentences.append(
            f"{label}: claims {len(method.overclaimed)} parameters better than record and prior "
            f"allow: {names}"
        )
    return tuple(sentences)


def _direction(method: MethodDetermination, at: int) -> str:
    parts = method.found.composition(at, 3)
    named = " ".join(f"{part:+.2f} {name}" for name, part in parts)
    return f"{method.found.strengths[at]:.2g} times the prior ({named.removeprefix('+')})"


# ---- A sweep in the terminal

LEAST_LOG_PROBABILITY = -20  # decimal logarithm of the smallest probability that is printed
HEADINGS = {"likelihood": "BIC gain of a mode", "whiteness": "p(white)", "misfit": ""}


def sweep_blocks(sweep: Sweep) -> list[Block]:
    """Return the tables of criteria and of errors by structure, and sentences on the criteria."""
    criteria, points = criteria_of(sweep.points), sweep.points
    names = {mark.frequency_factor: mark.label for mark, _ in sweep.marks}
    factors = (
        Column("frequencies", PURE, left=True),
        [
            Number(
                p.frequency_factor,
                shown=f"{p.frequency_factor:g} {names.get(p.frequency_factor, '')}".strip(),
            )
            for p in points
        ],
    )
    blocks: list[Block] = [
        table(
            "structures from stiff to soft",
            factors,
            (Column("degree", PURE), [Number(p.figures.degree, digits=4) for p in points]),
            (
                Column("stiffness lost", "%"),
                [Number(100 * p.figures.stiffness_loss, digits=1) for p in points],
            ),
            (Column("misfit/noise", PURE), [Number(p.figures.misfit, digits=2) for p in points]),
            *(
                (
                    Column(HEADINGS[each.name], PURE),
                    [_criterion_cell(each.name, value) for value in each.values],
                )
                for each in criteria
                if HEADINGS[each.name]
            ),
        )
    ]
    for number, found in enumerate(points[0].methods):
        title = (
            f"{found.estimation.label}: error against the condensed derivatives in % (in standard "
            "deviations)"
        )
        columns = [
            (
                Column(name, "%", printed=name),
                [_error(point, number, name) for point in points],
            )
            for name in sweep.rigid
            if name in found.names
        ]
        blocks.append(table(title, factors, *columns))
    return [*blocks, *(Prose(criterion_sentence(each, sweep)) for each in criteria)]


def sweep_phrase(sweep: Sweep) -> str:
    """Return the degree of flexibility at which a rigid model fails each criterion, in one line."""
    texts = [
        f"{each.name} from {each.degree:.3g} on"
        if each.degree is not None
        else f"{each.name} {_everywhere(each)}"
        for each in criteria_of(sweep.points)
    ]
    return f"degree of flexibility from which a rigid model fails: {', '.join(texts)}"


def _everywhere(criterion: Criterion) -> str:
    fails = (
        criterion.values[0] < criterion.limit
        if criterion.below
        else criterion.values[0] > criterion.limit
    )
    return "on every structure" if fails else "on none"


def criterion_sentence(criterion: Criterion, sweep: Sweep) -> str:
    """Return a sentence on the structure from which on a rigid model fails the criterion."""
    if criterion.degree is None or criterion.frequency_factor is None:
        fails = (
            criterion.values[0] < criterion.limit
            if criterion.below
            else criterion.values[0] > criterion.limit
        )
        return (
            f"{criterion.sentence}: "
            f"{'on every structure of the sweep' if fails else 'on none of the sweep, or not from one on'}"  # noqa: E501
        )
    first, last = sweep.points[0].figures.degree, sweep.points[-1].figures.degree
    where = (
        f"from a degree of flexibility of {criterion.degree:.3g} on (frequencies by "
        f"{criterion.frequency_factor:.3g})"
    )
    return f"{criterion.sentence} {where}; the sweep goes from {first:.2g} to {last:.2g}"


def _criterion_cell(name: str, value: float) -> Cell:
    if name != "whiteness":
        return Number(value, digits=0)
    share = 10.0**value
    return Number(
        share,
        shown=f"{share:.2g}" if value > LEAST_LOG_PROBABILITY else f"< 1e{LEAST_LOG_PROBABILITY}",
    )


def _error(point: SweepPoint, method: int, name: str) -> Cell:
    percent, sigmas = point.methods[method].errors(name)
    return Number(percent, shown=f"{percent:+.1f} ({sigmas:+.1f})")


# ---- Tables for the terminal (rich)


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
    determined = [
        method.determination for method in study.methods if method.determination is not None
    ]
    if determined:
        out.print()
        show_blocks(out, determination_blocks(determined))
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
    """Print the summary of a study, the main method's estimates, and where to find the rest.

    ``details``: place of the rest, see ``details_in``.
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
    """Return the line that says where to read the rest of the study."""
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
    outcome = main.result.estimate.outcome.value + (
        f"; largest error {errors[worst]:+.1f} sigma ({worst})" if worst else ""
    )
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
    seen = other_flight_line(study.scenario, method.estimation)
    for line in (
        seen,
        derived_line(method.derived),
        levels,
        test_line(method.tests),
        method.estimation.explanation,
        *reference_lines(method.rows, method.estimation),
    ):
        if line:
            print_paragraph(out, line)


def repeated_blocks(found: Sequence[Scatter]) -> list[Block]:
    """Return tables of repeated flights: coverage, errors (sigmas and units), failed runs."""
    runs = sum(found[0].outcomes.values())
    labels = [f"{each.flight}: {each.estimation.label}" for each in found]
    units = {
        name: unit for each in found for name, unit in zip(each.names, each.units, strict=True)
    }
    shares = [(share, low, high) for each in found for share, (low, high) in [each.within_two]]

    def percent(at: int) -> list[Cell]:
        return [Number(100.0 * each[at], digits=0) for each in shares]

    def errors(name: str, form: str, values: Callable[[Scatter], np.ndarray]) -> list[Cell]:
        return [
            formatted(values(each)[each.names.index(name)] if name in each.names else None, form)
            for each in found
        ]

    flights = (Column("flight: method"), labels)
    blocks: list[Block] = [
        table(
            f"{runs} runs of each flight: intervals that hold the truth, and root mean square "
            "error in reported sigmas",
            flights,
            (
                Column("settled", PURE),
                [Number(each.outcomes.get("converged", 0), digits=0) for each in found],
            ),
            (Column("within two sigmas", "%"), percent(0)),
            (Column("from (95 %)", "%"), percent(1)),
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
    for each in found:
        others = ", ".join(
            f"{count} {code}"
            for code, count in sorted(each.outcomes.items())
            if code != "converged"
        )
        if others:
            line = f"{each.flight}, {each.estimation.label}: {others} of {runs} left out"
            blocks.append(Prose(line, "note"))
    return blocks


def with_display(study: StudyResult, rows: Iterable[Row]) -> list[Row]:
    """Return the rows in display units, with frequencies in Hz and the scenario's ``display``."""
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
