"""The page of a closed-loop scenario: the findings, the paper's tables beside ours, figures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from ident.estimate import Outcome
from ident.flying_qualities.modes import MODAL_UNITS
from scenarios.pages.folder import figures
from scenarios.pages.model import Bullets, Page, Prose, Section, section
from scenarios.pages.printed import printed_blocks
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.tables import tests_table
from scenarios.pages.wording import capital, sentence
from scenarios.plots.page.named import Drawn
from scenarios.studies.departures import HEADING, choice_lines
from scenarios.studies.engines import bank_line
from scenarios.terminal.numbers import number, test_line
from scenarios.x29.findings import sentences
from scenarios.x29.printing import TABLES, WORDS
from scenarios.x29.study import LoopStudy

# Units of columns whose rows have units of their own.
SQUARED = "unit²"
_COLUMNS = {
    **{"initial variance": SQUARED, "final variance": SQUARED, "R": SQUARED, "Q": f"{SQUARED}/s", "damping": "1", "pass": "1", "rad/s": "rad/s"},
    **{"P0, here": SQUARED, "variance, here": SQUARED, "R, here": SQUARED, "Q, here": f"{SQUARED}/s"},
}


def loop_page(study: LoopStudy, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a study with the figures ``drawn``."""
    scenario, estimate, record = study.scenario, study.result.estimate, study.result.setting.record
    units = _units(study)
    tables = {title: section(title, *printed_blocks(partial(table, study), units)) for title, table in TABLES.items()}
    qualities = "; ".join(f"{WORDS[q.name]} {number(q.value, q.std)} +- {number(q.std, q.std)} {q.unit}".rstrip(" 1") for q in study.result.qualities)
    white = all(test.passed for test in study.tests)
    window = f"{record.time[0]:g} to {record.time[-1]:g} s"
    choices = choice_lines(scenario.choices)
    return Page(
        title=capital(scenario.title),
        kind=f"Closed-loop study {scenario.name}, delay refined over a bank of filters",
        verdict=estimate.outcome.value.partition(":")[0].partition(",")[0],
        tone="open" if estimate.outcome not in (Outcome.CONVERGED, Outcome.AT_BOUND) else "good" if white else "fair",
        sentence=sentence(test_line(study.tests)) if study.tests else "",
        summary=tuple(sentence(line) for line in (qualities, scenario.findings) if line),
        warnings=(),
        sections=(
            *tables["Estimate"],
            *section("What it says", *(Prose(sentence(line)) for line in sentences(study) if line)),
            *(each for title, parts in tables.items() if title != "Estimate" for each in parts),
            *section("Figures", *figures(drawn)),
            *section("Residuals", tests_table("Residual tests", study.tests)),
            *_made(study, window, choices),
        ),
        reproduction=reproduction(("flightid", "run", scenario.name, "--seed", str(study.seed)), f"Seed {study.seed}."),
        created=now(),
    )


def _made(study: LoopStudy, window: str, choices: Sequence[str]) -> tuple[Section, ...]:
    scenario = study.scenario
    told = Prose(f"Truth and model: {scenario.distance}. {len(study.result.setting.record)} samples, {window}.")
    engine = Prose(sentence(bank_line(scenario.estimation.engine, study.second)))
    heading = Prose(sentence(HEADING)) if choices else None
    return section("How it was made", Prose(sentence(scenario.about)) if scenario.about else None, told, engine, heading, Bullets(tuple(choices)))


def _units(study: LoopStudy) -> dict[str, str]:
    """Units of everything that a row or a column of the tables is named after."""
    estimate, system = study.result.estimate, study.result.setting.system
    units = {item.name: item.unit for item in (*system.initial, *system.parameters)}
    units |= dict(zip(estimate.names, estimate.units, strict=True)) | {"delay": "s", **MODAL_UNITS}
    words = {WORDS[q.name]: q.unit for q in study.result.qualities} | {WORDS[name]: unit for name, unit in MODAL_UNITS.items() if name in WORDS}
    return {**units, **words, WORDS["delay"]: "s", **_COLUMNS}
