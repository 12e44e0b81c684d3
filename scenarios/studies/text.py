"""A study in the terminal: tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from rich.console import Console
from rich.text import Text

from scenarios.studies.comparison import (
    HEADING,
    choice_lines,
    engine_line,
    other_flight_line,
    vehicle_line,
)
from scenarios.studies.published import published_remark
from scenarios.studies.rows import Row
from scenarios.studies.study import (
    MethodDetermination,
    MethodResult,
    Scatter,
    StudyResult,
    flexibility_sentences,
)
from scenarios.studies.sweep import Criterion, Sweep, SweepPoint, criteria_of
from scenarios.terminal.quantities import (
    console,
    derived_line,
    determined,
    is_frequency,
    number_text,
    shown_in,
    test_line,
    unit_cell,
)
from scenarios.terminal.summary import (
    BELOW,
    Summary,
    levels_line,
    print_summary,
    residual_phrase,
    result_phrase,
)
from scenarios.terminal.tables import TableColumn, print_paragraph, print_table

# ---- What records and priors determine, in the terminal

KEPT = 0.95  # of the prior's deviation: above it a record has said nothing to speak of
SHOWN = 3  # directions of each kind that are named


def print_determination(methods: Sequence[MethodDetermination], out: Console) -> None:
    """Of each parameter the deviation left of the prior's and the share of its variance that the
    prior gives, all methods beside each other.
    """
    first = methods[0].found
    ratio = [
        dict(zip(m.found.names, (m.found.posterior_std / m.found.prior_std).tolist(), strict=True))
        for m in methods
    ]
    share = [dict(zip(m.found.names, m.found.prior_share.tolist(), strict=True)) for m in methods]
    shown = [name for name in first.names if any(each.get(name, 1.0) < KEPT for each in ratio)]
    shown.sort(key=lambda name: ratio[0][name])
    labels = [method.estimation.name for method in methods]
    left = [
        TableColumn(f"{a}, sigma", [f"{each[name]:.3f}" if name in each else "-" for name in shown])
        for a, each in zip(labels, ratio, strict=True)
    ]
    right = [
        TableColumn(
            f"{a}, prior", [f"{100 * each[name]:.0f} %" if name in each else "-" for name in shown]
        )
        for a, each in zip(labels, share, strict=True)
    ]
    print_table(
        out,
        "sigma over the prior's, and share of the variance that the prior gives",
        [TableColumn("parameter", shown, left=True), *left, *right],
    )
    rest = len(first.names) - len(shown)
    if rest:
        print_paragraph(
            out,
            f"the other {rest} of {len(first.names)} parameters keep more than {KEPT:g} of their "
            "prior's sigma with every method",
            0,
        )
    for method in methods:
        out.print()
        for sentence in determination_sentences(method):
            print_paragraph(out, sentence, 0)


def determination_sentences(method: MethodDetermination) -> tuple[str, ...]:
    """How many numbers the record settles, the directions it knows best and least, and what the
    method claims beyond it.
    """
    found, label = method.found, method.estimation.name
    seen = len(found.names) - found.unseen
    said = [
        f"{label}: of {len(found.names)} parameters the record shows {seen} directions and knows "
        f"{found.determined} of them better than the prior "
        f"does ({found.effective:.1f} numbers settled); along {found.unseen} directions the "
        "outputs do not change at all, whatever the noise"
    ]
    best, least = range(min(SHOWN, seen)), range(max(seen - SHOWN, 0), seen)
    said.append(f"{label}: known best: {'; '.join(_direction(method, at) for at in best)}")
    said.append(f"{label}: seen least: {'; '.join(_direction(method, at) for at in least)}")
    if method.overclaimed:
        few = ", ".join(method.overclaimed[:8]) + (", ..." if len(method.overclaimed) > 8 else "")
        said.append(
            f"{label}: claims {len(method.overclaimed)} parameters better than record and prior "
            f"allow: {few}"
        )
    return tuple(said)


def _direction(method: MethodDetermination, at: int) -> str:
    parts = method.found.composition(at, 3)
    named = " ".join(f"{part:+.2f} {name}" for name, part in parts)
    return f"{method.found.strengths[at]:.2g} times the prior ({named.removeprefix('+')})"


# ---- A sweep in the terminal

LEAST = -20  # logarithm of a probability below which its size says no more
HEADINGS = {"likelihood": "BIC gain of a mode", "whiteness": "p(white)", "misfit": ""}


def print_sweep(sweep: Sweep, out: Console) -> None:
    """The structures with the criteria's figures, errors of the six rigid derivatives by each
    method, and the criteria in words.
    """
    criteria = criteria_of(sweep.points)
    names = {mark.frequency_factor: mark.label for mark, _ in sweep.marks}
    factors = TableColumn(
        "frequencies",
        [
            f"{p.frequency_factor:g} {names.get(p.frequency_factor, '')}".strip()
            for p in sweep.points
        ],
        left=True,
    )
    degree = TableColumn("degree", [f"{p.figures.degree:.4f}" for p in sweep.points])
    columns = [
        factors,
        degree,
        TableColumn(
            "stiffness lost", [f"{100 * p.figures.stiffness_loss:.1f} %" for p in sweep.points]
        ),
    ]
    columns.append(TableColumn("misfit/noise", [f"{p.figures.misfit:.2f}" for p in sweep.points]))
    columns += [
        TableColumn(HEADINGS[each.name], [_shown(each.name, value) for value in each.values])
        for each in criteria
        if HEADINGS[each.name]
    ]
    print_table(out, "structures from stiff to soft", columns)
    for number, found in enumerate(sweep.points[0].methods):
        out.print()
        title = (
            f"{found.estimation.label}: error against the condensed derivatives in % (in standard "
            "deviations)"
        )
        rows = [
            TableColumn(name, [_error(point, number, name) for point in sweep.points])
            for name in sweep.rigid
            if name in found.names
        ]
        print_table(out, title, [factors, *rows])
    out.print()
    for each in criteria:
        print_paragraph(out, criterion_sentence(each, sweep), indent=0)


def sweep_phrase(sweep: Sweep) -> str:
    """From which degree of flexibility on a rigid model fails each criterion, in one line."""
    told = [
        f"{each.name} from {each.degree:.3g} on"
        if each.degree is not None
        else f"{each.name} {_everywhere(each)}"
        for each in criteria_of(sweep.points)
    ]
    return f"degree of flexibility from which a rigid model fails: {', '.join(told)}"


def _everywhere(criterion: Criterion) -> str:
    fails = (
        criterion.values[0] < criterion.limit
        if criterion.below
        else criterion.values[0] > criterion.limit
    )
    return "on every structure" if fails else "on none"


def criterion_sentence(criterion: Criterion, sweep: Sweep) -> str:
    """From where on a rigid model fails the criterion."""
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


def _shown(name: str, value: float) -> str:
    if name != "whiteness":
        return f"{value:.0f}"
    return f"{10.0**value:.2g}" if value > LEAST else f"< 1e{LEAST}"


def _error(point: SweepPoint, method: int, name: str) -> str:
    percent, sigmas = point.methods[method].errors(name)
    return f"{percent:+.1f} ({sigmas:+.1f})"


# ---- Tables for the terminal (rich)


def print_study(study: StudyResult, out: Console | None = None, details: str = BELOW) -> None:
    """A summary; the study's tables, the main method first, each with what there is to say of it;
    then what holds for the whole study.
    """
    out = out or console()
    scenario = study.scenario
    print_summary(out, study_summary(study, details))
    out.print(Text.assemble((scenario.name, "bold"), f": {scenario.title}"))
    out.print(
        f"truth and model: {scenario.distance}; seed {study.seed}; {len(study.record)} samples in "
        f"{study.record.time[-1]:g} s",
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
        _print_repeated(study.repeated, out)
    determined = [
        method.determination for method in study.methods if method.determination is not None
    ]
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


def study_summary(study: StudyResult, details: str = BELOW) -> Summary:
    """Scenario and main method; its outcome and largest error; what matters most; what the fit
    leaves.
    """
    main, scenario = study.main, study.scenario
    others = f" and {len(study.methods) - 1} more" if len(study.methods) > 1 else ""
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
    """Choices, one line each under a heading, and what is to be said of the vehicle's numbers;
    nothing where there is nothing.
    """
    if lines:
        print_paragraph(out, HEADING)
    for line in lines:
        print_paragraph(out, line, indent=4)
    if vehicle:
        print_paragraph(out, vehicle)


def _known(row: Row) -> bool:
    """Whether the record says anything of a parameter; what was held without a sigma is known."""
    return not row.std > 0.0 or determined(row.estimate, row.std)


def _print_method(study: StudyResult, method: MethodResult, out: Console) -> None:
    estimate = method.result.estimate
    title = f"{method.estimation.label}: {estimate.outcome.value}"
    title += f"; {estimate.message}" if estimate.message else ""
    rows = with_display(study, method.rows)
    columns = [
        TableColumn("parameter", [row.name for row in rows], left=True),
        TableColumn("unit", [unit_cell(row.unit) for row in rows], left=True),
        TableColumn("true", [_or_dash(row.true) for row in rows]),
    ]
    if any(row.condensed is not None for row in rows):
        columns.append(TableColumn("condensed", [_or_dash(row.condensed) for row in rows]))
    columns += [
        TableColumn(
            "estimate",
            [
                number_text(row.estimate, row.std) if _known(row) else "not determined"
                for row in rows
            ],
        ),
        TableColumn(
            "+- sigma",
            [number_text(row.std, row.std) if _known(row) else "-" for row in rows],
            beside=True,
        ),
        TableColumn("error %", [_or_dash(row.percent, ".2f") for row in rows]),
        TableColumn("error, sigmas", [_or_dash(row.sigmas, "+.2f") for row in rows]),
    ]
    published = []
    if any(row.published is not None for row in rows):
        published = [
            TableColumn(
                "published", [f"{row.published.value:.5g}" if row.published else "" for row in rows]
            ),
            TableColumn(
                "+- sigma",
                [f"{row.published.std:.4g}" if row.published else "" for row in rows],
                beside=True,
            ),
            TableColumn(
                "off, own sigmas",
                [_or_dash(row.published_sigmas, "+.1f") if row.published else "" for row in rows],
                beside=True,
            ),
        ]
    print_table(out, title, [*columns, *published])
    flown = study.scenario.flown
    levels = levels_line(method.levels, flown, method.tests) if flown is not None else ""
    seen, remark = (
        other_flight_line(study.scenario, method.estimation),
        published_remark(method.estimation.published),
    )
    printed = f"published: {remark}" if remark else ""
    for line in (
        seen,
        derived_line(method.derived),
        levels,
        test_line(method.tests),
        method.estimation.explanation,
        printed,
    ):
        if line:
            print_paragraph(out, line)


def _print_repeated(found: Sequence[Scatter], out: Console) -> None:
    """Errors over all runs of the repeated flights: in reported sigmas, then in the derivatives'
    units.
    """
    names, runs = (
        dict.fromkeys(name for each in found for name in each.names),
        sum(found[0].outcomes.values()),
    )
    common = [
        TableColumn(
            "flight: method",
            [f"{each.flight}: {each.estimation.label}" for each in found],
            left=True,
        )
    ]
    shares = [each.within_two for each in found]
    judged = [
        TableColumn("settled", [str(each.outcomes.get("converged", 0)) for each in found]),
        TableColumn("within 2 sigma", [f"{100 * share:.0f} %" for share, _ in shares]),
        TableColumn(
            "95 % interval", [f"{100 * low:.0f} to {100 * high:.0f} %" for _, (low, high) in shares]
        ),
    ]
    in_sigmas = [
        TableColumn(name, [_of(each, name, each.rms_sigmas, ".2f") for each in found])
        for name in names
    ]
    print_table(
        out,
        f"{runs} runs of each flight: root mean square error in reported sigmas",
        [*common, *judged, *in_sigmas],
    )
    in_units = [
        TableColumn(name, [_of(each, name, each.rms, ".3g") for each in found]) for name in names
    ]
    print_table(out, "the same in the derivatives' units", [*common, *in_units])
    for each in found:
        others = ", ".join(
            f"{count} {code}"
            for code, count in sorted(each.outcomes.items())
            if code != "converged"
        )
        if others:
            print_paragraph(
                out, f"{each.flight}, {each.estimation.label}: {others} of {runs} left out"
            )


def _of(each: Scatter, name: str, values: np.ndarray, digits: str) -> str:
    """One derivative's number of ``values (n,)``; a dash where a method does not estimate it or no
    run settled.
    """
    value = values[each.names.index(name)] if name in each.names else math.nan
    return format(value, digits) if math.isfinite(value) else "-"


def with_display(study: StudyResult, rows: Iterable[Row]) -> list[Row]:
    """Rows in the units in which they are shown, frequencies in Hz as well, and again in another
    unit those that the scenario wants shown so.
    """
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
