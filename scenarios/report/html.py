"""Conversion of a document to an HTML page (one file, no network access) and to and from JSON."""

from __future__ import annotations

import base64
import hashlib
import math
import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

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
    unit_signs,
)
from scenarios.report.plot_data import (
    checked_count,
    checked_list,
    checked_number,
    checked_text,
    plot_content,
    plot_of,
    plot_text,
)
from scenarios.report.summary import NEXT

if TYPE_CHECKING:
    from jinja2 import Template
    from markupsafe import Markup

SCHEMA = "flightid/report/1"
_LARGEST_COUNT = 1_000_000  # largest number of digits or rows in a document
_TAG = "svg|g|defs|clipPath|rect|path|text|tspan|use"
_ATTRIBUTE = (
    r'\s(?:href="#[\w-]+"|'
    r'(?!on|href|style|src)[a-zA-Z][a-zA-Z-]*="(?:url\(#[\w-]+\)|(?!url)[^"<>]*)")'
)
_ELEMENT = re.compile(
    rf"/(?:{_TAG})>[^>]*$|(?:{_TAG})(?:{_ATTRIBUTE})*\s*/?>[^>]*$", re.DOTALL | re.ASCII
)


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

    The content may come from anyone: types are checked, and figures may only contain drawings.
    Raises KeyError, TypeError or ValueError for invalid content.
    """
    if content["schema"] != SCHEMA:
        raise ValueError(content["schema"])
    reproduction = content["reproduction"]
    inputs = tuple(
        (checked_text(use), checked_text(name), checked_text(digest))
        for use, name, digest in checked_list(reproduction["inputs"])
    )
    versions = {
        checked_text(name): checked_text(version)
        for name, version in checked_list(reproduction["versions"])
    }
    return Page(
        checked_text(content["title"]),
        checked_text(content["kind"]),
        checked_text(content["verdict"]),
        checked_text(content["tone"]),
        checked_text(content["sentence"]),
        _texts(content["summary"]),
        _texts(content["warnings"]),
        tuple(map(_section_of, checked_list(content["sections"]))),
        Reproduction(
            _texts(reproduction["commands"]), versions, checked_text(reproduction["seed"]), inputs
        ),
        checked_text(content["created"]),
    )


def _section(section: Section) -> dict[str, Any]:
    return {
        "title": section.title,
        "blocks": [_block(block) for block in section.blocks],
        **({"parts": [_section(part) for part in section.parts]} if section.parts else {}),
        **({"card": section.card} if section.card else {}),
    }


def _section_of(content: Mapping[str, Any]) -> Section:
    parts = tuple(map(_section_of, checked_list(content.get("parts", []))))
    return Section(
        checked_text(content["title"]),
        tuple(map(_block_of, checked_list(content["blocks"]))),
        parts,
        checked_text(content.get("card", "")),
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
        return Prose(
            checked_text(content["prose"]),
            checked_text(content["kind"]),
            checked_text(content["term"]),
        )
    if "bullets" in content:
        return Bullets(_texts(content["bullets"]), _flag(content["numbered"]))
    if "fold" in content:
        return Fold(checked_text(content["summary"]), _texts(content["fold"]))
    if "figure" in content:
        plot = plot_of(content["plot"]) if "plot" in content else None
        drawing = _drawing(content["svg"])
        return Figure(
            checked_text(content["figure"]), drawing, checked_text(content["caption"]), plot
        )
    columns = tuple(map(_column_of, checked_list(content["columns"])))
    rows = tuple(tuple(map(_cell_of, checked_list(row))) for row in checked_list(content["rows"]))
    printed = (
        None
        if content.get("printed") is None
        else checked_count(content["printed"], _LARGEST_COUNT)
    )
    return Table(
        checked_text(content["table"]), columns, rows, _texts(content.get("units", [])), printed
    )


def _column_of(content: Mapping[str, Any]) -> Column:
    unit = None if content.get("unit") is None else checked_text(content["unit"])
    return Column(checked_text(content["heading"]), unit, _flag(content.get("code", False)))


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
        return Link(checked_text(content["text"]), checked_text(content["to"]))
    return Number(
        checked_number(content["value"]),
        None if content.get("sigma") is None else checked_number(content["sigma"]),
        checked_text(content.get("unit", "")),
        None if content.get("digits") is None else checked_count(content["digits"], _LARGEST_COUNT),
        _flag(content.get("signed", False)),
        checked_text(content.get("shown", "")),
        checked_text(content.get("shown_sigma", "")),
    )


def _texts(value: Any) -> tuple[str, ...]:
    return tuple(map(checked_text, checked_list(value)))


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"a {type(value).__name__} instead of a bool")
    return value


def _drawing(value: Any) -> str:
    """Return the ``<svg>`` of a figure if it has only drawing elements, no scripts or links."""
    text = checked_text(value)
    parts = text.split("<")
    if (
        parts[0]
        or not (text.startswith("<svg ") and text.endswith("</svg>"))
        or not all(_ELEMENT.match(part) for part in parts[1:])
    ):
        raise ValueError("a figure holds more than a drawing")
    return text


# Most characters of the drawings and their data on one page.
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


def page_html(page: Page, paper: str = "") -> str:
    """Return the page; the same for the same content.

    ``paper`` is the size of the printed page in CSS (``"A4"``); empty leaves it to the browser.
    The page's security policy allows only its own style and script, by their hashes.
    """
    from markupsafe import Markup

    plots = _plots(page)
    style, script = _style(), _resource("page.js")
    if paper:
        style = style.replace("@page {", f"@page {{ size: {paper};", 1)
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
        room=_room(page, paper),
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
    """Return the data of figures by name, of as many as the size of a page permits."""
    figures, plots = list(_figures(page.sections)), {}
    available = MOST_DRAWING_CHARACTERS - sum(len(figure.svg) for figure in figures)
    for figure in figures:
        if figure.plot is None or figure.name in plots:
            continue
        text = plot_text(plot_content(figure.plot))
        available -= len(text)
        if available >= 0:
            plots[figure.name] = text
    return plots


def _figures(sections: tuple[Section, ...]) -> Iterator[Figure]:
    for each in sections:
        yield from (block for block in each.blocks if isinstance(block, Figure))
        yield from _figures(each.parts)


@cache
def _with_plots(script: str) -> str:
    """Return the page's script, with the plotting library and the script that calls it."""
    colours = ", ".join(f'"{colour}": "{name}"' for colour, name in _FIGURES.items())
    drawing = _resource("plots.js").replace("/*COLOURS*/", colours)
    return "\n".join((script.rstrip(), _resource("uplot.min.js").rstrip(), drawing))


def _named(sections: tuple[Section, ...]) -> Iterator[tuple[Section, str]]:
    """Yield each section with a name that no other element of the page has."""
    used: set[str] = {"content", "reproduce", "told", "theme"}
    for section in sections:
        name, number = section.name, 2
        while name in used:
            name, number = f"{section.name}-{number}", number + 1
        used.add(name)
        yield section, name


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
        "kind": lambda block: type(block).__name__,
        "rows": _rows,
        "numeric": _numeric,
        "unit": _unit,
        "unit_signs": unit_signs,
        "day": _day,
        "drawing": Markup,
        "quoted": lambda text: Markup(_QUOTED.sub(r"<code>\1</code>", str(escape(text)))),
    }
    return environment.from_string(_resource("page.html"))


_QUOTED = re.compile(r"`([^`\n]+)`")  # code in a text
# Words that must not be broken: options of a command, a maneuver, and an interval.
_NUMBER = r"[-\N{MINUS SIGN}]?\d[\d.]*"
_WHOLE = re.compile(rf"(?<![\w-])(--[a-z][a-z-]*|3-2-1-1|{_NUMBER} to {_NUMBER})")


def _signs(text: str) -> Markup:
    """Return a text with typographic signs; options, 3-2-1-1 and intervals are not broken into two
    lines.
    """
    from markupsafe import Markup, escape

    return Markup(_WHOLE.sub(r'<span class="word">\1</span>', str(escape(signs(text)))))


def _rows(table: Table) -> list[tuple[tuple[Cell, ...], str]]:
    return list(zip(table.rows, table.units or ("",) * len(table.rows), strict=True))


def _numeric(table: Table, at: int) -> bool:
    """Return whether a column has numbers, so that its heading is right-aligned."""
    return any(isinstance(row[at], Number) for row in table.rows)


def _unit(column: Column) -> str:
    return column.unit if column.unit not in (None, PURE, BY_ROW) else ""


def _day(created: str) -> str:
    """Return a time stamp as ``2026-11-23 08:10 UTC``."""
    return (
        f"{created[:10]} {created[11:16]} UTC"
        if len(created) >= len("2026-11-23T08:10")
        else created
    )


@cache
def _style() -> str:
    """Return the page's style, with dark colours and the colours of figures as variables."""
    rules = "".join(
        f'svg [{use}="{colour}"] {{ {use}: var(--{name}); }}\n'
        for colour, name in _FIGURES.items()
        for use in ("fill", "stroke")
    )
    style = _resource("page.css")
    light = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6});", style[: style.index("}")]))
    dark_rules, light_rules = (
        " ".join(f"--{name}: {colour};" for name, colour in colours.items())
        for colours in (_DARK, light)
    )
    style = style.replace("--dark: 1; /*DARK*/", f"color-scheme: dark; {dark_rules}")
    style = style.replace("/*LIGHT*/", light_rules)
    rooms = "".join(
        f"  header.room{room} + section figure:first-of-type .drawing svg "
        f"{{ max-height: {room}mm; }}\n"
        for room in _ROOMS
    )
    style = style.replace("/*ROOMS*/", rooms)
    return style.replace("@media print", rules + "@media print", 1)


_ROOMS = range(130, 205, 5)  # mm; lower figures would have letters too small to read
# Points between the margins of a sheet: of A4, and of US letter, the shorter of the usual ones.
_SHEETS = {"A4": 747.0, "": 697.0}
_POINT = 25.4 / 72.0  # mm


def _room(page: Page, paper: str = "") -> int:
    """Return the height in mm that title, verdict, summary and warnings leave for the first figure
    on the first sheet, one of ``_ROOMS``. Return 0 if it is less; then the next sheet has it.

    Lines are counted by characters: the style of paper has 10 points, headings 16.
    """

    def lines(text: str, characters: int) -> int:
        return max(1, math.ceil(len(text) / characters))

    used = 20.0 * lines(page.title, 45) + 14.0 * lines(page.kind, 62) + 95.0  # heading, caption
    used += 15.5 * lines(f"{page.verdict} {page.sentence}", 80) + 20.0
    for at, text in enumerate(page.summary):
        used += (17.4 * lines(text, 70) if at == 0 else 15.5 * lines(text, 80)) + 4.5
    used += sum(15.5 * lines(text, 72) + 11.0 for text in page.warnings)
    room = int((_SHEETS.get(paper, _SHEETS[""]) - used) * _POINT)
    return max((each for each in _ROOMS if each <= room), default=0)


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}"


def _resource(name: str) -> str:
    return files("scenarios.report").joinpath(name).read_text(encoding="utf-8")
