"""The page of the campaign of every effect."""

from __future__ import annotations

from collections.abc import Sequence

from exam.options import exam_reproduction
from exam.repeated import Flown
from exam.scores.page import scores_sections
from exam.scores.rates import NOTHING, Scores, false_share, right_share
from scenarios.report.document import Page, Prose, as_sentence, now, section
from scenarios.report.figure_formats import Drawn

EXPLAINED = (
    "In each flight one effect of the library, or nothing, is hidden with values drawn from the "
    "flight's seed; the loop is given two records and a "
    "vehicle file with starting values up to 30 % off, and no truth. The size is the change of the "
    "fitted outputs in noise sigmas that no other "
    "values of the declared parameters explain; it is drawn between 8 and 80, even in the "
    "logarithm."
)


def every_effect_page(
    done: Flown,
    scores: Scores,
    runs: int,
    effects: Sequence[str] | None,
    drawn: Sequence[Drawn] = (),
) -> Page:
    """The page of all flights, ``runs`` of each of the ``effects``, with the figures ``drawn``."""
    right = right_share([each for each in scores.flights if each.hidden])
    clean = false_share([each for each in scores.flights if not each.hidden])
    told = (
        f"{right.count} of {right.of} hidden effects are named"
        if right.of
        else "nothing was hidden"
    )
    false = (
        f"{clean.count} of {clean.of} flights with nothing in them get a name"
        if clean.of
        else f"no flight has {NOTHING} in it"
    )
    options = ("--effects", ",".join(effects)) if effects else ()
    command = ("every-effect", "--runs", str(runs), "--seed", str(done.root), *options)
    one = "python -m exam every-effect " + " ".join(
        (*options, "--seed", str(done.root), "--only", "NUMBER", "--out", "DIR")
    )
    return Page(
        title=f"Every effect: {done.ended} flights",
        kind="Campaign of the tracing loop",
        verdict="false names" if clean.count else "no false name" if clean.of else "",
        tone="fair" if clean.count else "good" if clean.of else "plain",
        sentence=as_sentence(told),
        summary=(as_sentence(false),),
        warnings=(as_sentence(done.failed),) if done.failed else (),
        sections=(
            *scores_sections(scores, drawn),
            *section(
                "How it was made",
                Prose(EXPLAINED),
                Prose("One flight again, by its number in flights.csv:"),
                Prose(one, "code"),
            ),
        ),
        reproduction=exam_reproduction(command, as_sentence(done.words)),
        created=now(),
    )
