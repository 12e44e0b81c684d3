"""The page of an estimate: figures, tables, how it was made and how its numbers are read."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from scenarios.pages.folder import figures
from scenarios.pages.model import Block, Bullets, Page, Prose, as_sentence, now, reproduction, section
from scenarios.pages.tables import printed_blocks
from scenarios.plots.formats import Drawn
from scenarios.responses.analysis import Responses, pairs
from scenarios.responses.loops import margin_lines
from scenarios.responses.text import (
    band_sentence,
    fit_columns,
    fit_lines,
    loop_tables,
    name_pair,
    quality_lines,
    responses_summary,
    table_columns,
)
from scenarios.terminal.tables import print_table

READING = (
    "The bands hold the response with a probability of 95 % at each frequency by itself. They cover "
    "random errors; an error of a sensor's scale or delay is not among them.",
    "The coherence is the share of the output's power that follows the inputs linearly. The partial "
    "coherence of an input leaves the other inputs out.",
    "The random error is the standard deviation of the magnitude over the magnitude.",
    "If the output acts back on the input through a controller or a pilot, name an excitation with "
    "--reference: without one the estimate is biased towards the negative inverse of the feedback.",
)


def responses_page(found: Responses, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of an estimate with the figures ``drawn``."""
    names, summary = found.names, responses_summary(found)
    files = [each.name for each in found.identities]
    tables = []
    for row, column, name in pairs(found):
        output, one = name_pair(found, row, column)
        unit = found.unit(output, one)
        title = f"{name}{f', {unit}' if unit else ''}"
        tables += printed_blocks(partial(print_table, title=title, columns=table_columns(found, row, column)))
        tables.append(Prose(f"{name}: {band_sentence(found, row, column)}.", "note"))
    functions: list[Block] = []
    for row, column, name in pairs(found):
        functions += [Prose(f"{as_sentence(line)}") for line in fit_lines(found, row, column)]
        columns = fit_columns(found, row, column)
        if columns:
            functions += printed_blocks(partial(print_table, title=f"Parameters of {name}", columns=columns))
    margins: list[Block] = []
    if found.loop is not None:
        for title, columns in loop_tables(found.loop):
            margins += printed_blocks(partial(print_table, title=title, columns=columns))
        margins.append(Bullets(tuple(map(as_sentence, margin_lines(found.loop)))))
    words = ["flightid", "response", *files]
    words += [word for name in names.inputs for word in ("--input", name)]
    words += [word for name in names.outputs for word in ("--output", name)]
    words += [word for name in names.references for word in ("--reference", name)]
    words += ["--margins", found.loop.sign] if found.loop is not None else []
    usable = sum(band is not None for row in found.found.bands() for band in row)
    number = len(pairs(found))
    return Page(
        title=f"{', '.join(files[:3])}{', ...' if len(files) > 3 else ''}: frequency responses",
        kind="Frequency responses",
        verdict=f"{usable} of {number} usable" if number > 1 else ("usable" if usable else "not usable"),
        tone="plain",
        sentence=as_sentence(summary.outcome),
        summary=(as_sentence(summary.result),),
        warnings=tuple(map(as_sentence, found.cautions)),
        sections=(
            *section("Bode diagrams", *figures(drawn)),
            *section("Transfer functions", *functions),
            *section("Flying qualities", Bullets(tuple(map(as_sentence, quality_lines(found))))),
            *section("Stability margins", *margins),
            *section("Numbers", *tables),
            *section("How they were estimated", Bullets(tuple(map(as_sentence, found.notes)))),
            *section("How the numbers are read", Bullets(READING)),
        ),
        reproduction=reproduction(words, "", [("used", each.name, each.sha256) for each in found.identities]),
        created=now(),
    )
