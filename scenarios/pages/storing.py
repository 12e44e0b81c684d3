"""A page as JSON and back, so that it can be made again from its folder without computing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenarios.pages.model import Block, Bullets, Column, Figure, Fold, Page, Prose, Reproduction, Section, Table
from scenarios.pages.numbers import Cell, Link, Number

SCHEMA = "flightid/report/1"


def page_content(page: Page) -> dict[str, Any]:
    """Content of ``report.json``; what has its usual value is left out."""
    return {
        "schema": SCHEMA,
        "title": page.title,
        "kind": page.kind,
        "verdict": page.verdict,
        "tone": page.tone,
        "sentence": page.sentence,
        "summary": list(page.summary),
        "warnings": list(page.warnings),
        "created": page.created,
        "sections": [_section(each) for each in page.sections],
        "reproduction": {
            "commands": list(page.reproduction.commands),
            "versions": [list(pair) for pair in page.reproduction.versions.items()],  # in their order, which keys would lose
            "seed": page.reproduction.seed,
            "inputs": [list(each) for each in page.reproduction.inputs],
        },
    }


def page_of(content: Mapping[str, Any]) -> Page:
    """The page that ``page_content`` describes.

    Raises KeyError, TypeError or ValueError for a content that describes none.
    """
    if content["schema"] != SCHEMA:
        raise ValueError(content["schema"])
    again = content["reproduction"]
    inputs = tuple((use, name, digest) for use, name, digest in again["inputs"])
    return Page(
        content["title"],
        content["kind"],
        content["verdict"],
        content["tone"],
        content["sentence"],
        tuple(content["summary"]),
        tuple(content["warnings"]),
        tuple(map(_section_of, content["sections"])),
        Reproduction(tuple(again["commands"]), dict(again["versions"]), again["seed"], inputs),
        content["created"],
    )


def _section(each: Section) -> dict[str, Any]:
    out: dict[str, Any] = {"title": each.title, "blocks": [_block(block) for block in each.blocks]}
    return out | ({"parts": [_section(part) for part in each.parts]} if each.parts else {}) | ({"card": each.card} if each.card else {})


def _section_of(content: Mapping[str, Any]) -> Section:
    parts = tuple(map(_section_of, content.get("parts", ())))
    return Section(content["title"], tuple(map(_block_of, content["blocks"])), parts, content.get("card", ""))


def _block(block: Block) -> dict[str, Any]:
    match block:
        case Prose():
            return {"prose": block.text, "kind": block.kind, "term": block.term}
        case Bullets():
            return {"bullets": list(block.items), "numbered": block.numbered}
        case Fold():
            return {"fold": list(block.items), "summary": block.summary}
        case Figure():
            return {"figure": block.name, "svg": block.svg, "caption": block.caption}
        case Table():
            columns = [_column(column) for column in block.columns]
            out: dict[str, Any] = {"table": block.caption, "columns": columns, "rows": [list(map(_cell, row)) for row in block.rows]}
            out |= {"units": list(block.units)} if block.units else {}
            return out | ({} if block.printed is None else {"printed": block.printed})


def _column(column: Column) -> dict[str, Any]:
    return {"heading": column.heading, **({} if column.unit is None else {"unit": column.unit}), **({"code": True} if column.code else {})}


def _block_of(content: Mapping[str, Any]) -> Block:
    if "prose" in content:
        return Prose(content["prose"], content["kind"], content["term"])
    if "bullets" in content:
        return Bullets(tuple(content["bullets"]), content["numbered"])
    if "fold" in content:
        return Fold(content["summary"], tuple(content["fold"]))
    if "figure" in content:
        return Figure(content["figure"], content["svg"], content["caption"])
    columns = tuple(Column(each["heading"], each.get("unit"), each.get("code", False)) for each in content["columns"])
    rows = tuple(tuple(map(_cell_of, row)) for row in content["rows"])
    return Table(content["table"], columns, rows, tuple(content.get("units", ())), content.get("printed"))


def _cell(cell: Cell) -> Any:
    if isinstance(cell, str):
        return cell
    if isinstance(cell, Link):
        return {"text": cell.text, "to": cell.to}
    out: dict[str, Any] = {"value": cell.value}
    further = {"sigma": cell.sigma, "unit": cell.unit or None, "digits": cell.digits, "signed": cell.signed or None, "shown": cell.shown or None}
    return out | {key: value for key, value in further.items() if value is not None}


def _cell_of(content: Any) -> Cell:
    if isinstance(content, str):
        return content
    if "to" in content:
        return Link(content["text"], content["to"])
    known = {key: content[key] for key in ("unit", "signed", "shown") if key in content}
    return Number(content["value"], content.get("sigma"), digits=content.get("digits"), **known)
