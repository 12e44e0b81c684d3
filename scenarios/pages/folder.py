"""The page in a study folder: HTML in one file, its JSON, and pages made again from it."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from scenarios.files.sources import MOST_DOCUMENT, escaped, found_json, json_value, read_content
from scenarios.files.writing import write_json, write_text
from scenarios.pages.model import (
    BY_ROW,
    PURE,
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
    as_sentence,
    capital,
    signs,
)
from scenarios.plots.formats import Drawn
from scenarios.terminal.summary import PAGE
from sim.errors import FlightidError

if TYPE_CHECKING:
    from jinja2 import Template


# ---- A page as HTML

_DARK = {
    **{
        "paper": "#14171b",
        "ink": "#e8eaed",
        "soft": "#a9b0b8",
        "line": "#363c44",
        "fill": "#1d2127",
        "accent": "#7cc0f0",
    },
    **{"good": "#5fd0ae", "fair": "#f0b45c", "open": "#ff9a70"},
    **{
        "f-black": "#e8eaed",
        "f-white": "#14171b",
        "f-light": "#363c44",
        "f-grey": "#9aa1a9",
        "f-blue": "#4fb0ea",
    },
    **{
        "f-vermilion": "#ff8f45",
        "f-green": "#2fc99b",
        "f-purple": "#e29ac3",
        "f-sky": "#3d82ad",
        "f-orange": "#f0b23a",
    },
}
# Colours of the figures (`scenarios/plots/style.py`) by the name of the variable that stands for
# them on a page.
_FIGURES = {
    **{
        "#000000": "f-black",
        "#ffffff": "f-white",
        "#d9d9d9": "f-light",
        "#7f7f7f": "f-grey",
        "#0072b2": "f-blue",
        "#d55e00": "f-vermilion",
    },
    **{"#009e73": "f-green", "#cc79a7": "f-purple", "#56b4e9": "f-sky", "#e69f00": "f-orange"},
}


def page_html(page: Page) -> str:
    """The page; the same for the same content.

    Its policy allows the one style and the one script that are in it, by their hashes, and nothing
    from anywhere.
    """
    from markupsafe import Markup

    style, script = _style(), _resource("page.js")
    inputs = Table(
        "Input files",
        (Column("use"), Column("file", code=True), Column("SHA-256", code=True)),
        page.reproduction.inputs,
    )
    text = _template().render(
        page=page,
        policy=(
            f"default-src 'none'; style-src '{_digest(style)}'; script-src '{_digest(script)}'; "
            "base-uri 'none'; form-action 'none'"
        ),
        style=Markup(style),
        script=Markup(script),
        version=page.reproduction.versions.get("flightid", ""),
        versions=", ".join(
            f"{name} {version}" for name, version in page.reproduction.versions.items()
        ),
        sections=list(_named(page.sections)),
        inputs=inputs,
    )
    return escaped(text)


def _named(sections: tuple[Section, ...]) -> Iterator[tuple[Section, str]]:
    """Sections with names that differ."""
    used: set[str] = {"content", "reproduce", "told", "theme"}
    for each in sections:
        name, number = each.name, 2
        while name in used:
            name, number = f"{each.name}-{number}", number + 1
        used.add(name)
        yield each, name


@cache
def _template() -> Template:
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {
        "signs": signs,
        "capital": capital,
        "sentence": as_sentence,
        "kind": _kind,
        "rows": _rows,
        "numeric": _numeric,
        "unit": _unit,
        "day": _day,
        "drawing": Markup,
    }
    return environment.from_string(_resource("page.html"))


def _kind(block: Block) -> str:
    return type(block).__name__


def _rows(table: Table) -> list[tuple[tuple[Cell, ...], str]]:
    return list(zip(table.rows, table.units or ("",) * len(table.rows), strict=True))


def _numeric(table: Table, at: int) -> bool:
    """Whether a column holds numbers, so that its heading stands at the right."""
    return any(isinstance(row[at], Number) for row in table.rows)


def _unit(column: Column) -> str:
    return column.unit if column.unit not in (None, PURE, BY_ROW) else ""


def _day(created: str) -> str:
    """``2026-11-23 08:10 UTC`` of a time stamp."""
    return (
        f"{created[:10]} {created[11:16]} UTC"
        if len(created) >= len("2026-11-23T08:10")
        else created
    )


@cache
def _style() -> str:
    rules = "".join(
        f'svg [{use}="{colour}"] {{ {use}: var(--{name}); }}\n'
        for colour, name in _FIGURES.items()
        for use in ("fill", "stroke")
    )
    style = _resource("page.css")
    light = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6});", style[: style.index("}")]))
    dark = "color-scheme: dark; " + " ".join(
        f"--{name}: {colour};" for name, colour in _DARK.items()
    )
    bright = " ".join(f"--{name}: {colour};" for name, colour in light.items())
    style = style.replace("--dark: 1; /*DARK*/", dark).replace("/*LIGHT*/", bright)
    return style.replace("@media print", rules + "@media print", 1)


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}"


def _resource(name: str) -> str:
    return files("scenarios.pages").joinpath(name).read_text(encoding="utf-8")


# ---- A page as JSON and back, so that it can be made again from its folder without computing

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
            return {"figure": block.name, "svg": block.svg, "caption": block.caption}
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
        return Figure(_text(content["figure"]), _drawing(content["svg"]), _text(content["caption"]))
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


# ---- The page in a study folder: written beside its content, and made again from it

CONTENT = "report.json"
_FURTHER = ("maneuvers.json",)
_DOCUMENTS = (
    "comparison.json",
    "diagnosis.json",
    "compatibility.json",
    "campaign.json",
    "compared.json",
    "design.json",
    "survey.json",
    "maneuvers.json",
    "responses.json",
)


def write_page(folder: Path, page: Page) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists."""
    write_json(folder / CONTENT, page_content(page))
    write_text(folder / PAGE, page_html(page))


def rebuilt(folder: str | Path) -> Path:
    """Make ``report.html`` again from ``report.json``, computing nothing; the page's path.

    Raises
    ------
    FlightidError : there is no such folder, no content of a page in it, or one that cannot be read.
    """
    folder = Path(folder)
    source = folder / CONTENT
    if not folder.is_dir():
        raise FlightidError(
            "there is no such folder",
            where=str(folder),
            remedy="name the folder of a study, what --out was given",
        )
    if not source.is_file():
        raise FlightidError(
            f"has no {CONTENT}: {_older(folder)}", where=str(folder), remedy=_again(folder)
        )
    content = read_content(source, FlightidError, "the folder of a study", MOST_DOCUMENT)
    try:
        text = page_html(page_of(json_value(content)))
    except (KeyError, TypeError, ValueError, AttributeError, FlightidError):
        raise FlightidError(
            "is no content of a page that this version can show",
            where=str(source),
            remedy=_again(folder),
        ) from None
    target = folder / PAGE
    try:
        write_text(target, text)
    except OSError as error:
        raise FlightidError(
            f"cannot be written ({error.strerror})",
            where=str(target),
            remedy="name a folder that you may write in",
        ) from None
    return target


def figures(drawn: Sequence[Drawn]) -> tuple[Figure, ...]:
    """Figures that were drawn, as blocks of a page."""
    return tuple(Figure(f"figure-{each.stem}", each.svg, each.caption) for each in drawn)


def _older(folder: Path) -> str:
    return "the study is of an older version" if _document(folder) else "it is no study folder"


def _again(folder: Path) -> str:
    """What to run, as far as the folder's own document tells."""
    document = _document(folder)
    name = document.get("scenario")
    if not document:
        return "name the folder that --out was given"
    if (
        document.get("schema") == "flightid/comparison/1"
        and isinstance(name, str)
        and "seed" in document
    ):
        return f"run it again: flightid run {name} --seed {document['seed']} --out {folder}"
    if isinstance(name, str) and "runs" in document:
        seed = document.get("seed", document.get("first_seed", 1))
        return (
            f"run it again: flightid campaign {name} --runs {document['runs']} --seed {seed} --out "
            f"{folder}"
        )
    return f"run its command again with --out {folder}"


def _document(folder: Path) -> dict[str, Any]:
    for name in _DOCUMENTS:
        content = found_json(folder / name)
        if isinstance(content, dict) and str(content.get("schema", "")).startswith("flightid/"):
            return content
    return {}
