"""What the truth says of a diagnosis, on its page."""

from __future__ import annotations

from dataclasses import replace

from scenarios.pages.model import Page, Prose, as_sentence, capital, reproduction, section
from scenarios.pages.tables import columns_table, rows_table
from scenarios.trials.planted.study import TraceStudy
from scenarios.trials.planted.text import (
    EFFECTS,
    MODES,
    THIRD_TITLE,
    against_truth,
    comparable_sentences,
    effect_rows,
    mode_rows,
    scored_sentence,
    table_title,
    third_headings,
    third_rows,
)


def scored_page(study: TraceStudy, page: Page) -> Page:
    """The page of the diagnosis with the scenario's title, and the truth before what the loop says of itself."""
    scenario = study.scenario
    scored = as_sentence(scored_sentence(study))
    truth = section(
        "Against the truth",
        columns_table(capital(table_title(study)), against_truth(study)),
        rows_table("Parameters of the effects", EFFECTS, effect_rows(study)),
        rows_table("Frequencies and damping ratios of the whole aircraft", MODES, mode_rows(study)),
        *(Prose(as_sentence(capital(told))) for told in comparable_sentences(study)),
        rows_table(capital(THIRD_TITLE), third_headings(study), third_rows(study)),
        Prose(f"Truth and model: {scenario.distance}.", "note"),
    )
    again = reproduction(("flightid", "run", scenario.name, "--seed", str(study.seed)), f"Seed {study.seed}.", page.reproduction.inputs)
    kind = f"Study {scenario.name}: {page.kind}"
    return replace(
        page, title=capital(scenario.title), kind=kind, summary=(*page.summary, scored), sections=(*truth, *page.sections), reproduction=again
    )
