"""The page of a campaign of the tracing loop itself: one table."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.pages.model import Page, section
from scenarios.pages.printed import rows_table
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.wording import capital, sentence
from scenarios.trials.repeated import Flown


def trials_page(name: str, done: Flown, title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Page:
    """The page of all flights, and the table of what was found."""
    return Page(
        title=f"{capital(name.replace('-', ' '))}: {done.ended} flights",
        kind="Campaign of the tracing loop",
        verdict="",
        tone="plain",
        sentence=sentence(title),
        summary=(),
        warnings=(sentence(done.failed),) if done.failed else (),
        sections=section("What was found", rows_table(capital(title), headings, rows)),
        reproduction=reproduction(("flightid", "campaign", name, "--runs", str(done.ended), "--seed", str(done.root)), sentence(done.words)),
        created=now(),
    )
