"""`flightid campaign every-effect`: each effect of the library planted and asked for, printed and written; one of its flights by its number."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.plots.formats import USUAL, Formats
from scenarios.tasks.manner import Manner, stopped
from scenarios.terminal.paragraphs import terminal_width
from scenarios.terminal.progress import progress_bar
from scenarios.terminal.summary import written_to
from scenarios.trials.every_effect.campaign import every_effect_text, write_every_effect
from scenarios.trials.every_effect.one import fly_one, one_text, write_one
from scenarios.trials.every_effect.work import EveryEffect
from scenarios.trials.repeated import fly_all
from sim.errors import DeclarationError

ROOT = 1  # of the seeds, where none is asked for


def every_effect_campaign(
    runs: int,
    seed: int | None,
    effects: Sequence[str] | None,
    manner: Manner,
    changes: Sequence[str],
    figures: Formats = USUAL,
    progress: bool = True,
) -> None:
    """Fly and diagnose ``runs`` flights of each of some ``effects`` (None: all of the library), print the tables, and write into ``manner.out``."""
    work, out = _work(effects, changes), manner.out
    with progress_bar(progress) as tell:
        done = fly_all(work, runs * len(work.kinds), ROOT if seed is None else seed, manner, tell)
    print(every_effect_text(done, terminal_width()), end="")
    if out is not None:
        write_every_effect(done, runs, work.effects, out, figures)
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
    work = _work(effects, changes)
    if manner.resume:
        raise DeclarationError("one flight is not gone on with", where="--resume", remedy="leave it out, or leave out --only")
    with progress_bar(progress) as tell:
        one = fly_one(work, number, ROOT if seed is None else seed, tell)
    print(one_text(one, terminal_width()), end="")
    if manner.out is not None:
        write_one(one, manner.out, figures=figures)
        print(written_to(manner.out))


def _work(effects: Sequence[str] | None, changes: Sequence[str]) -> EveryEffect:
    if changes:
        raise DeclarationError("nothing of every-effect can be changed", where="--set", remedy="leave it out")
    work = EveryEffect(None if effects is None else tuple(effects))
    assert work.kinds  # refuses an effect that the library lacks, before anything is flown
    return work
