"""What was true of a stand-in, on the page of its diagnosis; and the page of a campaign of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scenarios.pages.model import Bullets, Page, section
from scenarios.pages.printed import columns_table, rows_table
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.wording import capital, sentence
from scenarios.plots.page.named import Drawn
from scenarios.trials.marks.page import marks_sections
from scenarios.trials.repeated import Flown
from scenarios.trials.standin.campaign import Judged, marks_of, shares
from scenarios.trials.standin.campaign_text import DERIVATIVES as BY_DERIVATIVE
from scenarios.trials.standin.campaign_text import EFFECTS, SHARES, TITLE, derivative_rows, effect_rows, false_lines, share_rows, verdict_counts
from scenarios.trials.standin.declaration import StandIn
from scenarios.trials.standin.study import StandInStudy
from scenarios.trials.standin.text import against_nominal, flown_lines, hidden_text, score_text


def scored_page(study: StandInStudy, page: Page) -> Page:
    """The page of the diagnosis with the scenario's title, and the truth before what the loop says of itself."""
    standin = study.standin
    told = sentence(f"truth: {hidden_text(study.flight.drawn)}; {score_text(study)}")
    units = {row.name: row.after.unit for row in study.derivatives}
    table = columns_table("Derivatives against the nominal ones", against_nominal(study), units)
    truth = section("Against the truth", table, Bullets(tuple(map(sentence, flown_lines(study.flight)))))
    again = reproduction(("flightid", "run", standin.name, "--seed", str(study.seed)), f"Seed {study.seed}.", page.reproduction.inputs)
    kind = f"Study {standin.name}: {page.kind}"
    return replace(
        page, title=capital(standin.title), kind=kind, summary=(*page.summary, told), sections=(*truth, *page.sections), reproduction=again
    )


def campaign_page(standin: StandIn, done: Flown, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a campaign with the figures ``drawn``: shares with intervals, by effect and by derivative; names, probabilities, sigmas."""
    judged: Sequence[Judged] = done.found
    found, false = shares(judged), false_lines(judged)
    named = found["named"]
    told = f"{named.count} of {named.of} hidden effects are named" if named.of else "nothing is hidden"
    command = ("flightid", "campaign", standin.name, "--runs", str(done.ended), "--seed", str(done.root))
    return Page(
        title=f"{capital(standin.title)}: {len(judged)} flights",
        kind=f"Campaign of {standin.name}",
        verdict="false claims" if false else "no false claim",
        tone="fair" if false else "good",
        sentence=sentence(told),
        summary=(sentence(verdict_counts(judged)),),
        warnings=tuple(map(sentence, [*false, *([done.failed] if done.failed else [])])),
        sections=(
            *section("How often the loop is right", rows_table("Shares with their 95 % intervals", SHARES, share_rows(judged))),
            *section("Effect by effect", rows_table("Hidden effects", EFFECTS, effect_rows(judged))),
            *section("Derivative by derivative", rows_table(capital(TITLE), BY_DERIVATIVE, derivative_rows(judged))),
            *marks_sections(marks_of(judged), drawn),
        ),
        reproduction=reproduction(command, sentence(done.words)),
        created=now(),
    )
