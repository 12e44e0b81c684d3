"""Tables for the terminal (rich): what was true, what was estimated, how sure, and what a paper found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ident.residuals import ResidualTest
from scenarios.run import MethodResult, Row, Study


def console(width: int | None = None) -> Console:
    """A console that never folds numbers, 120 columns where the output is not a terminal; brackets in texts stay as they are."""
    plain = Console(markup=False)
    return plain if plain.is_terminal else Console(width=width or 120, no_color=True, highlight=False, markup=False)


def number(value: float, std: float | None = None) -> str:
    """A number with the digits that its standard deviation makes sensible: two of the deviation, else five."""
    if std is None or not std > 0:
        return f"{value:.5g}"
    from math import floor, log10

    digits = min(12, max(0, 1 - floor(log10(std))))
    return f"{value:.{digits}f}"


def print_study(study: Study, out: Console | None = None) -> None:
    """The study's tables: the main method, then the others beside it."""
    out = out or console()
    scenario = study.scenario
    out.print(Text.assemble((scenario.name, "bold"), f": {scenario.title}"))
    out.print(f"truth and model: {scenario.distance}; seed {study.seed}; {len(study.record)} samples in {study.record.time[-1]:g} s", highlight=False)
    for method in study.methods:
        out.print(_method_table(study, method))
        for line in _method_lines(study, method):
            out.print(line, highlight=False)


def _method_table(study: Study, method: MethodResult) -> Table:
    estimate = method.result.estimate
    title = f"{method.estimation.label}: {estimate.outcome.value}"
    title += f" {estimate.message}" if estimate.message else ""
    table = Table(title=title, title_justify="left", title_style="bold")
    condensed = any(row.condensed is not None for row in method.rows)
    published = any(row.published is not None for row in method.rows)
    headings = ["parameter", "unit", "true"] + (["condensed"] if condensed else []) + ["estimate", "+- sigma", "error %", "error, sigmas"]
    headings += ["published", "+- sigma", "off, own sigmas"] if published else []
    for heading in headings:
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right", no_wrap=True)
    for row in _with_display(study, method.rows):
        cells = [row.name, row.unit, _or_dash(row.true)]
        cells += [_or_dash(row.condensed)] if condensed else []
        cells += [number(row.estimate, row.std), number(row.std, row.std), _or_dash(row.percent, ".2f"), _or_dash(row.sigmas, "+.2f")]
        if published:
            there = row.published
            cells += [f"{there.value:.5g}", f"{there.std:.4g}"] if there else ["", ""]
            cells += [_or_dash(row.published_sigmas, "+.1f") if there else ""]
        table.add_row(*cells)
    return table


def _with_display(study: Study, rows: Iterable[Row]) -> list[Row]:
    """Rows, and again in another unit those that the scenario wants shown so."""
    from scenarios.comparing import in_unit

    out = []
    for row in rows:
        out.append(row)
        if row.name in study.scenario.display:
            out.append(in_unit(row, study.scenario.display[row.name]))
    return out


def _method_lines(study: Study, method: MethodResult) -> list[str]:
    return [line for line in (derived_line(method.derived), test_line(method.tests), method.estimation.explanation) if line] + [""]


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
