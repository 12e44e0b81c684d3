"""What the truth says of a diagnosis, on its page; and the page of a campaign of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scenarios.pages.model import Page, Prose, section
from scenarios.pages.printed import columns_table, rows_table
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.wording import capital, sentence
from scenarios.plots.page.named import Drawn
from scenarios.trials.marks.page import marks_sections
from scenarios.trials.planted.campaign import TraceJudged, marks_of, trace_shares
from scenarios.trials.planted.campaign_text import SHARES, VERDICTS, expected_line, false_lines, share_rows, verdict_rows
from scenarios.trials.planted.declaration import TraceScenario
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
from scenarios.trials.repeated import Flown


def scored_page(study: TraceStudy, page: Page) -> Page:
    """The page of the diagnosis with the scenario's title, and the truth before what the loop says of itself."""
    scenario = study.scenario
    scored = sentence(scored_sentence(study))
    truth = section(
        "Against the truth",
        columns_table(capital(table_title(study)), against_truth(study)),
        rows_table("Parameters of the effects", EFFECTS, effect_rows(study)),
        rows_table("Frequencies and damping ratios of the whole aircraft", MODES, mode_rows(study)),
        *(Prose(sentence(capital(told))) for told in comparable_sentences(study)),
        rows_table(capital(THIRD_TITLE), third_headings(study), third_rows(study)),
        Prose(f"Truth and model: {scenario.distance}.", "note"),
    )
    again = reproduction(("flightid", "run", scenario.name, "--seed", str(study.seed)), f"Seed {study.seed}.", page.reproduction.inputs)
    kind = f"Study {scenario.name}: {page.kind}"
    return replace(
        page, title=capital(scenario.title), kind=kind, summary=(*page.summary, scored), sections=(*truth, *page.sections), reproduction=again
    )


def campaign_page(scenario: TraceScenario, done: Flown, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a campaign with the figures ``drawn``: verdicts and shares with their intervals, names, probabilities, sigmas."""
    judged: Sequence[TraceJudged] = done.found
    shares, false = trace_shares(judged), false_lines(judged)
    right = shares["expected"]
    command = ("flightid", "campaign", scenario.name, "--runs", str(done.ended), "--seed", str(done.root))
    return Page(
        title=f"{capital(scenario.title)}: {len(judged)} flights",
        kind=f"Campaign of {scenario.name}",
        verdict="false claims" if false else "no false claim",
        tone="fair" if false else "good",
        sentence=f"{right.count} of {right.of} flights give the expected answer.",
        summary=(sentence(expected_line(scenario)),),
        warnings=tuple(map(sentence, [*false, *([done.failed] if done.failed else [])])),
        sections=(
            *section("Verdicts", rows_table("Verdicts with their 95 % intervals", VERDICTS, verdict_rows(judged))),
            *section("How often the loop is right", rows_table("Shares with their 95 % intervals", SHARES, share_rows(judged))),
            *marks_sections(marks_of(judged), drawn),
        ),
        reproduction=reproduction(command, sentence(done.words)),
        created=now(),
    )
