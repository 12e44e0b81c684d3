"""`flightid campaign` of tracing scenarios, stand-ins and every effect: flown, printed, written; one flight of every effect by its number."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.plots.formats import USUAL, Formats
from scenarios.tasks.manner import Manner, stopped
from scenarios.terminal.paragraphs import terminal_width
from scenarios.terminal.progress import progress_bar
from scenarios.terminal.summary import details_in, written_to
from scenarios.trials.campaigns import ROOT, loop_campaign
from sim.errors import DeclarationError


def run_loop_campaign(
    name: str,
    runs: int,
    seed: int | None,
    manner: Manner,
    changes: Sequence[str],
    figures: Formats = USUAL,
    *,
    progress: bool = True,
    effects: Sequence[str] | None = None,
) -> None:
    """Fly and diagnose, print the tables, and write ``campaign.json``, ``flights.csv``, figures and the page into ``manner.out``."""
    campaign, out = loop_campaign(name, runs, changes, effects), manner.out
    with progress_bar(progress) as tell:
        done = campaign.fly(runs, seed, manner, tell)
    print(campaign.text(done, terminal_width(), details_in(out)), end="")
    if out is not None:
        campaign.write(done, out, figures)
        print(written_to(out))
    if not done.whole:
        raise stopped(done.ended, done.asked, "flights", out)


def one_of_every_effect(
    number: int,
    seed: int | None,
    effects: Sequence[str] | None,
    manner: Manner,
    changes: Sequence[str],
    figures: Formats = USUAL,
    progress: bool = True,
) -> None:
    """Fly and diagnose flight ``number`` of the campaign again, print what the loop says of it and the truth, and write both into ``manner.out``."""
    from scenarios.trials.every_effect.one import fly_one, one_text, write_one
    from scenarios.trials.every_effect.work import EveryEffect

    if manner.resume:
        raise DeclarationError("one flight is not gone on with", where="--resume", remedy="leave it out, or leave out --only")
    if changes:
        raise DeclarationError("nothing of every-effect can be changed", where="--set", remedy="leave it out")
    with progress_bar(progress) as tell:
        one = fly_one(EveryEffect(None if effects is None else tuple(effects)), number, ROOT if seed is None else seed, tell)
    print(one_text(one, terminal_width()), end="")
    if manner.out is not None:
        write_one(one, manner.out, figures=figures)
        print(written_to(manner.out))
