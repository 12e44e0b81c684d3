"""The page of a campaign of a hidden-effect scenario."""

from __future__ import annotations

from collections.abc import Sequence

from exam.hidden_effects.campaign import TraceJudged, scores_of, trace_shares
from exam.hidden_effects.text import (
    SHARES,
    VERDICTS,
    expected_line,
    false_lines,
    share_rows,
    verdict_rows,
)
from exam.options import exam_reproduction
from exam.repeated import Flown
from exam.scores.page import scores_sections
from scenarios.report.document import Page, as_sentence, capital, now, section
from scenarios.report.figure_formats import Drawn
from scenarios.report.terminal import rows_table
from scenarios.trials.planted_declaration import TraceScenario


def campaign_page(scenario: TraceScenario, done: Flown, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a campaign with the figures ``drawn``: verdicts and shares with their intervals,
    names, probabilities, sigmas.
    """
    judged: Sequence[TraceJudged] = done.found
    shares, false = trace_shares(judged), false_lines(judged)
    right = shares["expected"]
    command = ("hidden-effects", scenario.name, "--runs", str(done.ended), "--seed", str(done.root))
    return Page(
        title=f"{capital(scenario.title)}: {len(judged)} flights",
        kind=f"Campaign of {scenario.name}",
        verdict="false claims" if false else "no false claim",
        tone="fair" if false else "good",
        sentence=f"{right.count} of {right.of} flights give the expected answer.",
        summary=(as_sentence(expected_line(scenario)),),
        warnings=tuple(map(as_sentence, [*false, *([done.failed] if done.failed else [])])),
        sections=(
            *section(
                "Verdicts",
                rows_table("Verdicts with their 95 % intervals", VERDICTS, verdict_rows(judged)),
            ),
            *section(
                "How often the loop is right",
                rows_table("Shares with their 95 % intervals", SHARES, share_rows(judged)),
            ),
            *scores_sections(scores_of(judged), drawn),
        ),
        reproduction=exam_reproduction(command, as_sentence(done.words)),
        created=now(),
    )
