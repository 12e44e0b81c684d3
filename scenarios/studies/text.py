"""Tables for the terminal (rich): what was true, what was estimated, how sure, and what a paper found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from rich.console import Console
from rich.text import Text

from ident.statistics.residuals import ResidualTest
from scenarios.studies.notes import flexibility_sentences
from scenarios.studies.study import MethodResult, Row, Study
from scenarios.terminal.rich_tables import Column, print_paragraph, print_table


def console(width: int | None = None) -> Console:
    """A console that never folds numbers, 120 columns where the output is not a terminal; brackets in texts stay as they are."""
    plain = Console(markup=False)
    return plain if plain.is_terminal else Console(width=width or 120, no_color=True, highlight=False, markup=False)


def number(value: float, std: float | None = None) -> str:
    """A number with the digits that its standard deviation makes sensible: two of the deviation, else five."""
    if std is None or not std > 0:
        return f"{value:.5g}"
    from math import floor, log10

    last = floor(log10(std)) - 1  # the decimal place of the deviation's second digit
    if last >= -5:
        return f"{value:.{max(0, -last)}f}"
    return f"{value:.{max(1, floor(log10(max(abs(value), std))) - last)}e}"


def print_study(study: Study, out: Console | None = None) -> None:
    """The study's tables, the main method first, each with what there is to say of it; then what holds for the whole study."""
    out = out or console()
    scenario = study.scenario
    out.print(Text.assemble((scenario.name, "bold"), f": {scenario.title}"))
    out.print(f"truth and model: {scenario.distance}; seed {study.seed}; {len(study.record)} samples in {study.record.time[-1]:g} s", highlight=False)
    for method in study.methods:
        out.print()
        _print_method(study, method, out)
    if study.flexibility is not None:
        out.print()
        for sentence in flexibility_sentences(study.flexibility, study.scenario.flight.noise_std):
            print_paragraph(out, sentence, indent=0)
    if study.notes:
        out.print()
        for note in study.notes:
            print_paragraph(out, note, indent=0)


def _print_method(study: Study, method: MethodResult, out: Console) -> None:
    estimate = method.result.estimate
    title = f"{method.estimation.label}: {estimate.outcome.value}"
    title += f" {estimate.message}" if estimate.message else ""
    rows = _with_display(study, method.rows)
    columns = [
        Column("parameter", [row.name for row in rows], left=True),
        Column("unit", [row.unit for row in rows], left=True),
        Column("true", [_or_dash(row.true) for row in rows]),
    ]
    if any(row.condensed is not None for row in rows):
        columns.append(Column("condensed", [_or_dash(row.condensed) for row in rows]))
    columns += [
        Column("estimate", [number(row.estimate, row.std) for row in rows]),
        Column("+- sigma", [number(row.std, row.std) for row in rows]),
        Column("error %", [_or_dash(row.percent, ".2f") for row in rows]),
        Column("error, sigmas", [_or_dash(row.sigmas, "+.2f") for row in rows]),
    ]
    published = []
    if any(row.published is not None for row in rows):
        published = [
            Column("published", [f"{row.published.value:.5g}" if row.published else "" for row in rows]),
            Column("+- sigma", [f"{row.published.std:.4g}" if row.published else "" for row in rows]),
            Column("off, own sigmas", [_or_dash(row.published_sigmas, "+.1f") if row.published else "" for row in rows]),
        ]
    print_table(out, title, columns, published)
    for line in (derived_line(method.derived), test_line(method.tests), method.estimation.explanation):
        if line:
            print_paragraph(out, line)


def _with_display(study: Study, rows: Iterable[Row]) -> list[Row]:
    """Rows, and again in another unit those that the scenario wants shown so."""
    from scenarios.studies.comparison import in_unit

    out = []
    for row in rows:
        out.append(row)
        if row.name in study.scenario.display:
            out.append(in_unit(row, study.scenario.display[row.name]))
    return out


def derived_line(derived: Mapping[str, tuple[float, float]]) -> str:
    """Natural frequency, damping and the like with their sigmas, in one line."""
    words = {"natural_frequency": "natural frequency {} rad/s", "damping_ratio": "damping ratio {}", "delay": "delay {} s"}
    return "; ".join(words[key].format(f"{number(v, s)} +- {number(s, s)}") for key, (v, s) in derived.items())


def test_line(tests: Sequence[ResidualTest]) -> str:
    """What the residual tests say, in one line."""
    failed = [test for test in tests if not test.passed]
    if failed:
        return "residual is not the noise alone: " + "; ".join(f"{test.channel}: {test.sentence}" for test in failed)
    return "residual: what the noise alone would give (" + "; ".join(f"{t.channel} p = {t.p_value:.2g}" for t in tests) + ")" if tests else ""


def _or_dash(value: float | None, form: str = ".5g") -> str:
    return "-" if value is None else format(value, form)
