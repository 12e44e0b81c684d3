"""The page of a campaign of the tracing loop itself: one table."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.pages.model import Page, section
from scenarios.pages.printed import rows_table
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.wording import capital, sentence


def trials_page(name: str, first: int, words: str, runs: int, title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Page:
    """The page of ``runs`` flights from seed ``first`` on (``words`` say which seeds), and the table of what was found."""
    return Page(
        title=f"{capital(name.replace('-', ' '))}: {runs} flights",
        kind="Campaign of the tracing loop",
        verdict="",
        tone="plain",
        sentence=sentence(title),
        summary=(),
        warnings=(),
        sections=section("What was found", rows_table(capital(title), headings, rows)),
        reproduction=reproduction(("flightid", "campaign", name, "--runs", str(runs), "--seed", str(first)), sentence(words)),
        created=now(),
    )
