"""A document as a page: HTML in one file that asks no other machine for anything."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

from scenarios.files.sources import escaped
from scenarios.report.document import (
    BY_ROW,
    PURE,
    Block,
    Cell,
    Column,
    Figure,
    Number,
    Page,
    Section,
    Table,
    as_sentence,
    capital,
    signs,
)
from scenarios.report.plot_data import plot_content, plot_text
from scenarios.report.text_tables import NEXT

if TYPE_CHECKING:
    from jinja2 import Template

PLOTS = 2_500_000  # characters of drawings and their data on one page, which stays below 3 MB
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


# A frame is as high as its figure where the page around it lets that be seen.
_FRAME = """(() => {
  const fit = () => { try { if (frameElement) frameElement.style.height = `${document.body.scrollHeight}px`; } catch { /* another origin */ } };
  new ResizeObserver(fit).observe(document.body);
})();"""  # noqa: E501
_FRAMED = "body { display: flow-root; } figure { margin: 0; } figcaption:empty { display: none; }"


def figure_html(figure: Figure) -> str:
    """One figure as a document of its own, for a frame in a notebook: it zooms where the figure
    has its data, and asks no other machine for anything. Its ground is light, as that of notebooks.
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
    """What a page may load: its one style and its one script, by their hashes."""
    return (
        f"default-src 'none'; style-src '{_digest(style)}'; script-src '{_digest(script)}'; "
        "base-uri 'none'; form-action 'none'"
    )


def _plots(page: Page) -> dict[str, str]:
    """The data of figures by name, as many of them from the first as keep the page short; none of
    figures whose name is there twice.
    """
    found, room = {}, PLOTS - sum(len(each.svg) for each in _figures(page.sections))
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
    """The page's script with the library that draws figures, and what uses it."""
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
    return files("scenarios.report").joinpath(name).read_text(encoding="utf-8")
