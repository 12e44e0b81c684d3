"""What was true of a surrogate flight, on the page of its diagnosis; and the page of a campaign of
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from exam.options import exam_reproduction
from exam.repeated import Flown
from exam.scores.page import scores_sections
from exam.surrogates.campaign import Judged, scores_of, shares
from exam.surrogates.campaign_text import DERIVATIVES as BY_DERIVATIVE
from exam.surrogates.campaign_text import (
    EFFECTS,
    SHARES,
    TITLE,
    derivative_rows,
    effect_rows,
    false_lines,
    share_rows,
    verdict_counts,
)
from exam.surrogates.declaration import Surrogate
from exam.surrogates.study import SurrogateStudy
from exam.surrogates.text import against_nominal, flown_lines, hidden_text, score_text
from scenarios.report.document import Bullets, Page, as_sentence, capital, now, section
from scenarios.report.figure_formats import Drawn
from scenarios.report.terminal import rows_table


def scored_page(study: SurrogateStudy, page: Page) -> Page:
    """The page of the diagnosis with the scenario's title, and the truth before what the loop says
    of itself.
    """
    surrogate = study.surrogate
    told = as_sentence(f"truth: {hidden_text(study.flight.drawn)}; {score_text(study)}")
    truth = section(
        "Against the truth",
        against_nominal(study),
        Bullets(tuple(map(as_sentence, flown_lines(study.flight)))),
    )
    again = exam_reproduction(
        ("surrogate", surrogate.name, "--seed", str(study.seed)), f"Seed {study.seed}."
    )
    again = replace(again, inputs=page.reproduction.inputs)
    kind = f"Study {surrogate.name}: {page.kind}"
    return replace(
        page,
        title=capital(surrogate.title),
        kind=kind,
        summary=(*page.summary, told),
        sections=(*truth, *page.sections),
        reproduction=again,
    )


def campaign_page(surrogate: Surrogate, done: Flown, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a campaign with the figures ``drawn``: shares with intervals, by effect and by
    derivative; names, probabilities, sigmas.
    """
    judged: Sequence[Judged] = done.found
    found, false = shares(judged), false_lines(judged)
    named = found["named"]
    told = (
        f"{named.count} of {named.of} hidden effects are named" if named.of else "nothing is hidden"
    )
    command = ("surrogates", surrogate.name, "--runs", str(done.ended), "--seed", str(done.root))
    return Page(
        title=f"{capital(surrogate.title)}: {len(judged)} flights",
        kind=f"Campaign of {surrogate.name}",
        verdict="false claims" if false else "no false claim",
        tone="fair" if false else "good",
        sentence=as_sentence(told),
        summary=(as_sentence(verdict_counts(judged)),),
        warnings=tuple(map(as_sentence, [*false, *([done.failed] if done.failed else [])])),
        sections=(
            *section(
                "How often the loop is right",
                rows_table("Shares with their 95 % intervals", SHARES, share_rows(judged)),
            ),
            *section(
                "Effect by effect", rows_table("Hidden effects", EFFECTS, effect_rows(judged))
            ),
            *section(
                "Derivative by derivative",
                rows_table(capital(TITLE), BY_DERIVATIVE, derivative_rows(judged)),
            ),
            *scores_sections(scores_of(judged), drawn),
        ),
        reproduction=exam_reproduction(command, as_sentence(done.words)),
        created=now(),
    )
