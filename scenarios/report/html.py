"""Conversion of a document to an HTML page (one file, no network access) and to and from JSON."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, TypeVar

from scenarios.files.sources import escaped
from scenarios.report.document import (
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
from scenarios.report.plot_data import plot_content, plot_of, plot_text
from scenarios.report.summary import NEXT

if TYPE_CHECKING:
    from jinja2 import Template
    from markupsafe import Markup

SCHEMA = "flightid/report/1"
_LARGEST_REQUEST = 1_000_000  # upper limit of digits and rows in a page's document
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
    """Return the content of ``report.json``, without default values."""
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
            # a list keeps the order
            "versions": [list(pair) for pair in page.reproduction.versions.items()],
            "seed": page.reproduction.seed,
            "inputs": [list(each) for each in page.reproduction.inputs],
        },
    }


def page_of(content: Mapping[str, Any]) -> Page:
    """Return the page from the content of ``report.json``.

    Content may be untrusted: types are checked, and figures may only contain drawings. Raises
    KeyError, TypeError or ValueError for invalid content.
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
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _LARGEST_REQUEST:
        raise TypeError(f"{value!r:.40} is no count")
    return value


def _drawing(value: Any) -> str:
    """Return the ``<svg>`` of a figure if it has only drawing elements, no scripts or links."""
    text = _text(value)
    parts = text.split("<")
    if (
        parts[0]
        or not (text.startswith("<svg ") and text.endswith("</svg>"))
        or not all(_ELEMENT.match(part) for part in parts[1:])
    ):
        raise ValueError("a figure holds more than a drawing")
    return text


# limit of drawings and their data on one page, in characters
MOST_DRAWING_CHARACTERS = 2_500_000
_DARK = {
    "paper": "#14171b",
    "ink": "#e8eaed",
    "soft": "#a9b0b8",
    "line": "#363c44",
    "fill": "#1d2127",
    "accent": "#7cc0f0",
    **{"good": "#5fd0ae", "fair": "#f0b45c", "open": "#ff9a70"},
    "f-black": "#e8eaed",
    "f-white": "#14171b",
    "f-light": "#363c44",
    "f-grey": "#9aa1a9",
    "f-blue": "#4fb0ea",
    "f-vermilion": "#ff8f45",
    "f-green": "#2fc99b",
    "f-purple": "#e29ac3",
    "f-sky": "#3d82ad",
    "f-orange": "#f0b23a",
}
# Colour of the figures (`scenarios/plots/style.py`) -> CSS variable.
_FIGURES = {
    "#000000": "f-black",
    "#ffffff": "f-white",
    "#d9d9d9": "f-light",
    "#7f7f7f": "f-grey",
    "#0072b2": "f-blue",
    "#d55e00": "f-vermilion",
    **{"#009e73": "f-green", "#cc79a7": "f-purple", "#56b4e9": "f-sky", "#e69f00": "f-orange"},
}


def page_html(page: Page) -> str:
    """Return the page; the same for the same content.

    Its security policy allows only its own style and script, by their hashes.
    """
    from markupsafe import Markup

    plots = _plots(page)
    style, script = _style(), _resource("page.js")
    if plots:
        style, script = f"{_resource('uplot.min.css')}\n{style}", _with_plots(script)
    inputs = Table(
        "Input files",
        (Column("use"), Column("file", code=True), Column("SHA-256", code=True)),
        page.reproduction.inputs,
    )
    text = _template().render(
        next_command=NEXT,
        page=page,
        plots=plots,
        policy=_policy(style, script),
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


# Adapts the frame's height to the figure, if the surrounding page allows it.
_FRAME = """(() => {
  const fit = () => { try { if (frameElement) frameElement.style.height = `${document.body.scrollHeight}px`; } catch { /* another origin */ } };
  new ResizeObserver(fit).observe(document.body);
})();"""  # noqa: E501
_FRAMED = "body { display: flow-root; } figure { margin: 0; } figcaption:empty { display: none; }"


def figure_html(figure: Figure) -> str:
    """Return one figure as an HTML document for a frame in a notebook.

    Interactive if the figure has data. Loads nothing from the network; light background.
    """
    from html import escape

    plot = "" if figure.plot is None else plot_text(plot_content(figure.plot))
    data = f' data-plot="{escape(plot, quote=True)}"' if plot else ""
    style = f"{_resource('uplot.min.css')}\n{_style()}\n{_FRAMED}"
    script = f"{_with_plots('')}\n{_FRAME}"
    caption = escape(figure.caption, quote=True)
    return escaped(
        "<!DOCTYPE html>\n"
        '<html lang="en" data-theme="light"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(style, script)}">'
        f"<title>{caption}</title><style>{style}</style></head><body>"
        f'<figure id="{figure.name}"{data}>'
        f'<div class="drawing" tabindex="0" role="group" aria-label="{caption}">'
        f"{figure.svg}</div><figcaption></figcaption></figure>"
        '<button id="theme" hidden></button><div id="told" role="status" class="unseen"></div>'
        f"<script>{script}</script></body></html>\n"
    )


def _policy(style: str, script: str) -> str:
    """Return the content policy of a page: its one style and its one script, by their hashes."""
    return (
        f"default-src 'none'; style-src '{_digest(style)}'; script-src '{_digest(script)}'; "
        "base-uri 'none'; form-action 'none'"
    )


def _plots(page: Page) -> dict[str, str]:
    """Return the data of the first figures by name, up to a total size, without duplicate names."""
    found, room = (
        {},
        MOST_DRAWING_CHARACTERS - sum(len(each.svg) for each in _figures(page.sections)),
    )
    for each in _figures(page.sections):
        if each.plot is None or each.name in found:
            continue
        text = plot_text(plot_content(each.plot))
        room -= len(text)
        if room >= 0:
            found[each.name] = text
    return found


def _figures(sections: tuple[Section, ...]) -> Iterator[Figure]:
    for each in sections:
        yield from (block for block in each.blocks if isinstance(block, Figure))
        yield from _figures(each.parts)


@cache
def _with_plots(script: str) -> str:
    """Return the page's script with the library that draws figures, and what uses it."""
    colours = ", ".join(f'"{colour}": "{name}"' for colour, name in _FIGURES.items())
    drawing = _resource("plots.js").replace("/*COLOURS*/", colours)
    return "\n".join((script.rstrip(), _resource("uplot.min.js").rstrip(), drawing))


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
    from markupsafe import Markup, escape

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {
        "signs": _signs,
        "capital": capital,
        "sentence": as_sentence,
        "kind": _kind,
        "rows": _rows,
        "numeric": _numeric,
        "unit": _unit,
        "day": _day,
        "drawing": Markup,
        "quoted": lambda text: Markup(_QUOTED.sub(r"<code>\1</code>", str(escape(text)))),
    }
    return environment.from_string(_resource("page.html"))


_QUOTED = re.compile(r"`([^`\n]+)`")  # words of code in a text


# an option of a command, and a maneuver of that name, in a text
_WHOLE = re.compile(r"(?<![\w-])(--[a-z][a-z-]*|3-2-1-1)")


def _signs(text: str) -> Markup:
    """Return a text with the signs of books, with options and 3-2-1-1 on one line each."""
    from markupsafe import Markup, escape

    return Markup(_WHOLE.sub(r'<span class="word">\1</span>', str(escape(signs(text)))))


def _kind(block: Block) -> str:
    return type(block).__name__


def _rows(table: Table) -> list[tuple[tuple[Cell, ...], str]]:
    return list(zip(table.rows, table.units or ("",) * len(table.rows), strict=True))


def _numeric(table: Table, at: int) -> bool:
    """Return whether a column has numbers, so that its heading is right-aligned."""
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
    return files("scenarios.report").joinpath(name).read_text(encoding="utf-8")
