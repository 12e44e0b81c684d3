"""Why sigmas are wrong, on the page of a campaign and in its document."""

from __future__ import annotations

from typing import Any

from scenarios.pages.model import BY_ROW, PURE, Block, Bullets, Column, Prose, Table
from scenarios.pages.numbers import Cell, Number
from scenarios.pages.wording import sentence
from scenarios.studies.campaign_causes.findings import Finding, Findings
from scenarios.studies.campaign_causes.levels import PARAMETERS, STATES, Level, Levels
from scenarios.studies.campaign_causes.text import LEVELS_TITLE, TITLE, cause_sentences, cause_word, level_text, levels_sentence
from scenarios.terminal.numbers import number

NONE = "No reported sigma is told from a right one by these runs: the two-sigma coverage of every parameter is that of a normal distribution."


def findings_blocks(found: Findings) -> list[Block]:
    """The table of wrong sigmas with the right ones and a sentence for each cause, or that there is none; noise levels."""
    blocks: list[Block] = []
    if found.found:
        headings = Column("parameter"), Column("multiply σ by", PURE), Column("reported σ", BY_ROW), Column("right σ", BY_ROW)
        shares = Column("its coverage", "%"), Column("from", "%"), Column("to", "%"), Column("because of")
        rows = tuple(_row(each) for each in found.found)
        blocks.append(Table(TITLE.capitalize(), (*headings, *shares), rows, tuple(each.wrong.statistics.unit for each in found.found)))
        blocks.append(Bullets(tuple(sentence(each) for each in cause_sentences(found))))
    else:
        blocks.append(Prose(NONE))
    return blocks + (_levels_blocks(found, found.levels) if found.levels is not None else [])


def _levels_blocks(found: Findings, levels: Levels) -> list[Block]:
    """Noise levels by likelihood beside those assumed."""
    outputs = [item for item in levels.items if item.name not in (STATES, PARAMETERS)]
    columns = Column("noise of"), Column("assumed σ", BY_ROW), Column("σ by likelihood", BY_ROW), Column("agree")
    rows = tuple((item.name, _level(item.assumed), _level(item.found, item), "yes" if item.agrees else "no") for item in outputs)
    table = Table(LEVELS_TITLE.capitalize(), columns, rows, tuple(item.unit for item in outputs))
    forced = [
        f"{item.name}: assumed {level_text(item, item.assumed)}, by likelihood {level_text(item, item.found)}"
        for item in levels.items[len(outputs) :]
    ]
    return [table, *(Prose(sentence(each)) for each in forced), Prose(sentence(levels_sentence(found)))]


def findings_content(found: Findings) -> dict[str, Any]:
    """For ``campaign.json``: wrong sigmas by parameter, in SI, and noise levels where they were looked for."""
    content: dict[str, Any] = {"wrong_sigmas": {each.name: _content(each) for each in found.found}, "because": cause_sentences(found)}
    if found.levels is not None:
        items = {
            item.name: {"unit": item.unit, "assumed": item.assumed, "by_likelihood": item.found, "agrees": item.agrees} for item in found.levels.items
        }
        content["noise_levels"] = {"runs": found.levels.runs, "levels": items}
    return content


def _content(each: Finding) -> dict[str, Any]:
    within = each.coverage
    numbers = {"factor": each.wrong.factor, "reported_std": each.wrong.statistics.reported, "right_std": each.corrected}
    shares = {"right_within_2": within.share, "right_within_2_low": within.interval[0], "right_within_2_high": within.interval[1]}
    return {"causes": list(each.causes), **numbers, **shares, "runs": within.runs, "computed_again": each.again}


def _row(each: Finding) -> tuple[Cell, ...]:
    within, sizes = each.coverage, (each.wrong.statistics.reported, each.corrected)
    shares = (Number(100.0 * value, digits=1) for value in (within.share, *within.interval))
    factor = Number(each.wrong.factor, shown=number(each.wrong.factor, each.wrong.factor))
    return each.name, factor, *(Number(size, shown=number(size, size)) for size in sizes), *shares, cause_word(each)


def _level(value: float, item: Level | None = None) -> Cell:
    if value == 0.0:
        return "none"
    spread = value * item.spread if item is not None and 0.0 < item.spread < 1.0 else None
    return Number(value, spread)
