"""Figures as files and as SVG elements of a page, the same bytes for the same figure."""

from __future__ import annotations

import io
import os
import re
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ident.background_task import can_fork, fork
from scenarios.plots.formats import (
    FRAGMENT,
    PDF,
    PNG,
    SVG,
    USUAL,
    Drawn,
    Formats,
    caption_of,
    gathered,
)
from scenarios.plots.svg_renderer import PageRenderer

# ---- Figures shared out between this process and a fork of it

_BYTES = 2  # of a number in the pipe, which a system reads as a whole
_MOST = 65536 // _BYTES  # numbers that a pipe holds


def shared_out(works: Sequence[Callable[[], None]]) -> None:
    """Do every work once, of which each leaves its result in files. With the longest first the two
    end at about the same time.

    Alone where there may be no fork, or where the system has no room for one. What a fork that
    failed had taken is done again here. A work that raises, and an interrupt, end this after the
    fork has ended its own: nobody writes from here on.
    """
    if not 2 <= len(works) <= _MOST or not _may_fork():
        for work in works:
            work()
        return
    waiting = _queue(len(works))
    own: set[int] = set()
    failed = 0
    try:
        helper = _helper(works, waiting)
        try:
            for number in _taken(waiting):
                own.add(number)
                works[number]()
        finally:
            failed = _ended(helper, waiting) if helper is not None else 0
    finally:
        os.close(waiting)
    if failed:
        for number in sorted(set(range(len(works))) - own):
            works[number]()


def _queue(count: int) -> int:
    """The end to read of a pipe that holds the numbers below ``count``."""
    waiting, filling = os.pipe()
    os.write(filling, b"".join(number.to_bytes(_BYTES, "little") for number in range(count)))
    os.close(filling)
    return waiting


def _taken(waiting: int) -> Iterator[int]:
    """Numbers as this process takes them, until none is left."""
    while number := os.read(waiting, _BYTES):
        yield int.from_bytes(number, "little")


def _helper(works: Sequence[Callable[[], None]], waiting: int) -> int | None:
    """The id of a fork that takes works too and then ends; None where the system has no room for
    another process.
    """
    # an interrupt in between would let the fork go on as if it were this process
    with _undisturbed():
        try:
            helper = fork()
        except OSError:
            return None
        if helper == 0:
            failed = 1
            try:
                for number in _taken(waiting):
                    works[number]()
                failed = 0
            finally:
                os._exit(failed)
        return helper


def _ended(helper: int, waiting: int) -> int:
    """Leave the fork nothing to take, wait until it has ended, and tell whether it failed."""
    with _undisturbed():
        for _ in _taken(waiting):
            pass
        return os.waitpid(helper, 0)[1]


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Ctrl-C waits until the body is left."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _may_fork() -> bool:
    """Whether a fork is safe: the system allows it, and this thread is the only one."""
    return can_fork() and threading.active_count() == 1


# ---- Figures as bytes

Named = tuple[str, Callable[[], Figure]]  # the stem of a figure's file, and what draws it

# Letters as outlines in SVG, so that it looks alike everywhere; as TrueType in PDF, so that its
# text can be searched.
_VECTOR: dict[Any, Any] = {"svg.hashsalt": "flightid", "svg.fonttype": "path", "pdf.fonttype": 42}
_REFERENCE = re.compile(r'(\bid="|url\(#|href="#)')
# What only a file needs: its description, and a rule of style that would hold for the whole page.
_OF_FILE = re.compile(
    r"<metadata>.*?</metadata>\s*|<defs>\s*<style.*?</style>\s*</defs>\s*", re.DOTALL
)


def save_figures(figures: Iterable[Named], folder: Path, formats: Formats = USUAL) -> list[Path]:
    """Draw each figure once and write ``folder/STEM.FORMAT`` in every format; the paths. The folder
    must exist.
    """
    if not formats:
        return []
    return [path for stem, make in figures for path in save_figure(make(), folder, stem, formats)]


def save_figure(figure: Figure, folder: Path, stem: str, formats: Formats = USUAL) -> list[Path]:
    """Write ``folder/stem.FORMAT`` in every format; the paths. The folder must exist."""
    paths = []
    for name in formats:
        path = Path(folder) / f"{stem}.{name}"
        path.write_bytes(_WRITERS[name](figure))
        paths.append(path)
    return paths


def figure_png(figure: Figure) -> bytes:
    """The figure as a PNG at its own size and resolution."""
    buffer = io.BytesIO()
    # None takes the entry out that names matplotlib's version.
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def figure_svg(figure: Figure) -> bytes:
    """The figure as an SVG file at its own size."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.BytesIO()
    with rc_context(_VECTOR):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def figure_pdf(figure: Figure) -> bytes:
    """The figure as a PDF of one page at its own size."""
    # it loads a library of fonts, which takes as long as a figure
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    buffer = io.BytesIO()
    with rc_context(_VECTOR):
        FigureCanvasPdf(figure).print_pdf(
            buffer, metadata={"Creator": None, "Producer": None, "CreationDate": None}
        )
    return buffer.getvalue()


def svg_text(figure: Figure, name: str = "figure", description: str = "") -> str:
    """The figure as an ``<svg>`` element to stand within a page; ``description`` is what a screen
    reader says.

    All its identifiers begin with ``name``: several figures of one page must have different ones.
    """
    text = figure_svg(figure).decode("utf-8")
    head, rest = _OF_FILE.sub("", text[text.index("<svg") :]).strip().split(">", 1)
    look = 'style="stroke-linejoin: round; stroke-linecap: butt"'
    named = _REFERENCE.sub(rf"\g<1>{name}-", rest)
    return (
        f'{head} {look} role="img" aria-label="{escape(description or name, quote=True)}">{named}'
    )


_WRITERS: Mapping[str, Callable[[Figure], bytes]] = {
    PNG: figure_png,
    SVG: figure_svg,
    PDF: figure_pdf,
}


# ---- A figure as an <svg> element of a page, with what a reader who cannot see it is told

POINTS = 72.0
SCALE = 1.75  # pixels a point, where there is room
# points: a wider figure is moved sideways on a small screen rather than made too small to read
FULL = 400.0


def drawn_for_page(figures: Iterable[Named], folder: Path, formats: Formats) -> tuple[Drawn, ...]:
    """Draw each figure once: into ``folder`` in every format, and for the page; on two cores where
    that may be.
    """
    named = list(figures)
    leave_for_page(named, folder, formats)
    left = gathered(folder)
    return tuple(Drawn(stem, left[stem], caption_of(stem)) for stem, _ in named)


def leave_for_page(figures: Iterable[Named], folder: Path, formats: Formats) -> None:
    """The same, each element in a file of its own, for whoever makes the page to gather
    (``named.gathered``).
    """
    shared_out([partial(_leave, stem, make, folder, formats) for stem, make in figures])


def _leave(stem: str, make: Callable[[], Figure], folder: Path, formats: Formats) -> None:
    figure = make()
    save_figure(figure, folder, stem, formats)
    (folder / f"{stem}{FRAGMENT}").write_text(
        page_svg(figure, stem), encoding="utf-8", errors="backslashreplace", newline="\n"
    )


def page_svg(figure: Figure, stem: str) -> str:
    """The figure as an element that is as wide as its place and has no colours but those of the
    figure; the same for the same figure.

    ``stem`` begins its identifiers: figures of one page have different ones.
    """
    width, height = figure.get_size_inches() * POINTS
    dpi = figure.dpi
    renderer = PageRenderer(width, height, f"figure-{stem}")
    figure.patch.set_visible(False)
    try:
        figure.dpi = POINTS
        figure.draw(renderer)
    finally:
        figure.dpi = dpi
        figure.patch.set_visible(True)
    boxes = "".join(
        f'<clipPath id="{name}"><rect x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}"/></clipPath>'
        for (x, y, w, h), name in renderer.clips.items()
    )
    described = escape(description(figure), quote=True)
    size = (
        f'viewBox="0 0 {width:g} {height:g}" width="{SCALE * width:.0f}" '
        f'height="{SCALE * height:.0f}"'
    )
    kinds = [*(["full"] if width > FULL else []), *(["mapped"] if renderer.mapped else [])]
    wide = f' class="{" ".join(kinds)}"' if kinds else ""
    head = f'<svg {size}{wide} role="img" aria-label="{described}">'
    return f"{head}{f'<defs>{boxes}</defs>' if boxes else ''}{''.join(renderer.parts)}</svg>"


def description(figure: Figure) -> str:
    """What a figure shows in words: its title, what its panels have at their axes, and what is
    drawn in them.
    """
    title = " ".join(text.get_text() for text in figure.texts).strip()
    panels = [panel for panel in figure.axes if panel.get_visible()]
    across = dict.fromkeys(label for panel in panels if (label := _plain(panel.get_xlabel())))
    upward = dict.fromkeys(
        label
        for panel in panels
        for label in (_plain(panel.get_ylabel()), _plain(panel.get_title(loc="left")))
        if label
    )
    lines = dict.fromkeys(
        _plain(label)
        for panel in panels
        for label in panel.get_legend_handles_labels()[1]
        if label and not str(label).startswith("_")
    )
    told = [_plain(title) or "Figure"]
    against = f" against {', '.join(across)}" if across else ""
    told += [f"Panels: {', '.join(upward)}{against}"] if upward or across else []
    told += [f"Shown: {', '.join(lines)}"] if lines else []
    return ". ".join(told) + "."


def _plain(text: str) -> str:
    """A label without the marks of mathematics."""
    return " ".join(
        text.replace("\\mathrm", "")
        .replace("\\dot", "")
        .translate(str.maketrans("", "", "${}\\"))
        .split()
    )
