"""A document as JSON and back, so that its page can be made again without computing."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, TypeVar

from scenarios.report.document import (
    Block,
    Bullets,
    Cell,
    Column,
    Figure,
    Fold,
    Link,
    Number,
    Page,
    Prose,
    Reproduction,
    Section,
    Table,
)
from scenarios.report.plot_data import plot_content, plot_of

SCHEMA = "flightid/report/1"
_MOST = 1_000_000  # of digits and rows that a page may ask for
_TAG = "svg|g|defs|clipPath|rect|path|text|tspan|use"
_ATTRIBUTE = (
    r'\s(?:href="#[\w-]+"|'
    r'(?!on|href|style|src)[a-zA-Z][a-zA-Z-]*="(?:url\(#[\w-]+\)|(?!url)[^"<>]*)")'
)
_ELEMENT = re.compile(
    rf"/(?:{_TAG})>[^>]*$|(?:{_TAG})(?:{_ATTRIBUTE})*\s*/?>[^>]*$", re.DOTALL | re.ASCII
)
Kind = TypeVar("Kind")


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
            # in their order, which keys would lose
            "versions": [list(pair) for pair in page.reproduction.versions.items()],
            "seed": page.reproduction.seed,
            "inputs": [list(each) for each in page.reproduction.inputs],
        },
    }


def page_of(content: Mapping[str, Any]) -> Page:
    """The page that ``page_content`` describes; a study may be somebody else's, so that every value
    is of its kind and figures only draw.

    Raises KeyError, TypeError or ValueError for a content that describes none.
    """
    if content["schema"] != SCHEMA:
        raise ValueError(content["schema"])
    again = content["reproduction"]
    inputs = tuple(
        (_text(use), _text(name), _text(digest)) for use, name, digest in _list(again["inputs"])
    )
    versions = {_text(name): _text(version) for name, version in _list(again["versions"])}
    return Page(
        _text(content["title"]),
        _text(content["kind"]),
        _text(content["verdict"]),
        _text(content["tone"]),
        _text(content["sentence"]),
        _texts(content["summary"]),
        _texts(content["warnings"]),
        tuple(map(_section_of, _list(content["sections"]))),
        Reproduction(_texts(again["commands"]), versions, _text(again["seed"]), inputs),
        _text(content["created"]),
    )


def _section(each: Section) -> dict[str, Any]:
    out: dict[str, Any] = {"title": each.title, "blocks": [_block(block) for block in each.blocks]}
    return (
        out
        | ({"parts": [_section(part) for part in each.parts]} if each.parts else {})
        | ({"card": each.card} if each.card else {})
    )


def _section_of(content: Mapping[str, Any]) -> Section:
    parts = tuple(map(_section_of, _list(content.get("parts", []))))
    return Section(
        _text(content["title"]),
        tuple(map(_block_of, _list(content["blocks"]))),
        parts,
        _text(content.get("card", "")),
    )


def _block(block: Block) -> dict[str, Any]:
    match block:
        case Prose():
            return {"prose": block.text, "kind": block.kind, "term": block.term}
        case Bullets():
            return {"bullets": list(block.items), "numbered": block.numbered}
        case Fold():
            return {"fold": list(block.items), "summary": block.summary}
        case Figure():
            drawing = {"figure": block.name, "svg": block.svg, "caption": block.caption}
            return drawing | ({} if block.plot is None else {"plot": plot_content(block.plot)})
        case Table():
            columns = [_column(column) for column in block.columns]
            out: dict[str, Any] = {
                "table": block.caption,
                "columns": columns,
                "rows": [list(map(_cell, row)) for row in block.rows],
            }
            out |= {"units": list(block.units)} if block.units else {}
            return out | ({} if block.printed is None else {"printed": block.printed})


def _column(column: Column) -> dict[str, Any]:
    return {
        "heading": column.heading,
        **({} if column.unit is None else {"unit": column.unit}),
        **({"code": True} if column.code else {}),
    }


def _block_of(content: Mapping[str, Any]) -> Block:
    if "prose" in content:
        return Prose(_text(content["prose"]), _text(content["kind"]), _text(content["term"]))
    if "bullets" in content:
        return Bullets(_texts(content["bullets"]), _flag(content["numbered"]))
    if "fold" in content:
        return Fold(_text(content["summary"]), _texts(content["fold"]))
    if "figure" in content:
        plot = plot_of(content["plot"]) if "plot" in content else None
        drawing = _drawing(content["svg"])
        return Figure(_text(content["figure"]), drawing, _text(content["caption"]), plot)
    columns = tuple(map(_column_of, _list(content["columns"])))
    rows = tuple(tuple(map(_cell_of, _list(row))) for row in _list(content["rows"]))
    printed = None if content.get("printed") is None else _count(content["printed"])
    return Table(_text(content["table"]), columns, rows, _texts(content.get("units", [])), printed)


def _column_of(content: Mapping[str, Any]) -> Column:
    unit = None if content.get("unit") is None else _text(content["unit"])
    return Column(_text(content["heading"]), unit, _flag(content.get("code", False)))


def _cell(cell: Cell) -> Any:
    if isinstance(cell, str):
        return cell
    if isinstance(cell, Link):
        return {"text": cell.text, "to": cell.to}
    out: dict[str, Any] = {"value": cell.value}
    further = {
        "sigma": cell.sigma,
        "unit": cell.unit or None,
        "digits": cell.digits,
        "signed": cell.signed or None,
        "shown": cell.shown or None,
        "shown_sigma": cell.shown_sigma or None,
    }
    return out | {key: value for key, value in further.items() if value is not None}


def _cell_of(content: Any) -> Cell:
    if isinstance(content, str):
        return content
    if "to" in content:
        return Link(_text(content["text"]), _text(content["to"]))
    return Number(
        _number(content["value"]),
        None if content.get("sigma") is None else _number(content["sigma"]),
        _text(content.get("unit", "")),
        None if content.get("digits") is None else _count(content["digits"]),
        _flag(content.get("signed", False)),
        _text(content.get("shown", "")),
        _text(content.get("shown_sigma", "")),
    )


def _text(value: Any) -> str:
    return _of_kind(value, str)


def _flag(value: Any) -> bool:
    return _of_kind(value, bool)


def _list(value: Any) -> list[Any]:
    return _of_kind(value, list)


def _texts(value: Any) -> tuple[str, ...]:
    return tuple(map(_text, _list(value)))


def _of_kind(value: Any, kind: type[Kind]) -> Kind:
    if not isinstance(value, kind):
        raise TypeError(f"a {type(value).__name__} where a {kind.__name__} is due")
    return value


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"a {type(value).__name__} where a number is due")
    return value


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MOST:
        raise TypeError(f"{value!r:.40} is no count")
    return value


def _drawing(value: Any) -> str:
    """The ``<svg>`` of a figure as our renderer writes it: elements that draw, and no attribute
    that runs or loads anything.
    """
    text = _text(value)
    parts = text.split("<")
    if (
        parts[0]
        or not (text.startswith("<svg ") and text.endswith("</svg>"))
        or not all(_ELEMENT.match(part) for part in parts[1:])
    ):
        raise ValueError("a figure holds more than a drawing")
    return text
