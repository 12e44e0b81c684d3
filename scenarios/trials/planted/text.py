"""A tracing study in words and tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.diagnosis.report.text import diagnosis_text
from scenarios.terminal.paragraphs import WIDTH
from scenarios.terminal.quantities import value_text
from scenarios.terminal.tables import columns_of, table_lines
from scenarios.trials.planted.study import Grade, Scored, TraceStudy

DERIVATIVES = ("derivative", "unit", "true", "before", "after", "error, sigmas")
EFFECTS = ("effect", "unit", "true", "estimate", "error, sigmas")


def trace_text(study: TraceStudy, width: int = WIDTH) -> str:
    """Before and after as `flightid diagnose` shows them, then what the truth says of it."""
    scenario = study.scenario
    blocks = [
        [f"{scenario.name}: {scenario.title}", f"truth and model: {scenario.distance}; seed {study.seed}"],
        diagnosis_text(study.tracing, width).rstrip().split("\n"),
        table_lines(columns_of(DERIVATIVES, scored_rows(study.derivatives), left=2), title=table_title(study), width=width),
        table_lines(columns_of(EFFECTS, effect_rows(study), left=2), width=width),
        [scored_sentence(study)],
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def scored_sentence(study: TraceStudy) -> str:
    """What was hidden, what was expected, and what the diagnosis is worth."""
    return f"scored with the truth: {_hidden(study)}; expected {_expected(study)}; the diagnosis is {_verdict(study.grade)}"


def table_title(study: TraceStudy) -> str:
    """What the derivatives are held against."""
    if study.scenario.model == "loes":
        return "derivatives; true are those of the equivalent system that fits the linear loop's frequency response"
    return "derivatives against the truth"


def effect_rows(study: TraceStudy) -> list[tuple[str, ...]]:
    """Cells below ``EFFECTS``."""
    return [(*row[:3], *row[4:]) for row in scored_rows(study.effects)]


def scored_rows(scored: Sequence[Scored]) -> list[tuple[str, ...]]:
    """Cells below ``DERIVATIVES``."""
    return [
        (
            row.name,
            row.unit if row.unit != "1" else "",
            f"{row.true:.5g}",
            value_text(row.before.value, row.before.std) if row.before else "-",
            value_text(row.after.value, row.after.std),
            f"{row.sigmas:+.1f}",
        )
        for row in scored
    ]


def _hidden(study: TraceStudy) -> str:
    terms = [f"{name} ({', '.join(f'{key} {value:g}' for key, value in values.items())})" for name, values in study.flown.hidden.items()]
    if study.scenario.flight.modes and study.scenario.model == "rigid":
        terms.insert(0, f"{study.scenario.flight.modes} elastic mode{'s' if study.scenario.flight.modes > 1 else ''}")
    return f"hidden was {' and '.join(terms)}" if terms else "nothing was hidden"


def _expected(study: TraceStudy) -> str:
    expect = study.scenario.expect
    sets = " or ".join(" + ".join(names) for names in expect.effects)
    return " or ".join(expect.verdicts) + (f": {sets}" if sets else "")


def _verdict(grade: Grade) -> str:
    return grade.value
