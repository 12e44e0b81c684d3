"""Stability margins of a watched loop: final print, study folder, its page and the live page."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ident.flying_qualities.stability_margins import NORMAL, REQUIRED_GAIN, REQUIRED_PHASE
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.report.document import Block, Bullets, Page, as_sentence, now, reproduction, section
from scenarios.report.folder import figures as page_figures
from scenarios.report.folder import write_page
from scenarios.report.quantities import console
from scenarios.report.summary import print_paragraph
from scenarios.report.terminal import show_table
from scenarios.responses.loops import (
    UNITS,
    WORDS,
    LoopMargins,
    interval_text,
    loop_tables,
    margin_lines,
)
from scenarios.watching.loop_margins import (
    HISTORY,
    MAIN,
    MarginPoint,
    MarginSession,
    history_csv,
    margin_content,
    margins_of,
    shown,
)
from scenarios.watching.page import Feed, served_feed
from scenarios.watching.session import Watch


def print_loop_end(watch: Watch, session: MarginSession) -> None:
    """Print the margins over the whole stream in a table, compared with the required ones."""
    out, loop = console(), margins_of(session)
    gaps = f", {session.gaps} gap{'s' * (session.gaps != 1)}" if session.gaps else ""
    out.print(f"{watch.reason}; {session.rows} rows{gaps}:", highlight=False)
    if loop is None:
        out.print("no frequency is usable: no margin is determined", highlight=False)
        return
    for each in loop_tables(loop):
        show_table(out, each)
    for words in (*margin_lines(loop), *loop.cautions):
        print_paragraph(out, words, indent=0)


# What MIL-F-9490D demands below the first structural mode, dB and deg.
REQUIRED = {
    "gain_increase": REQUIRED_GAIN,
    "gain_decrease": -REQUIRED_GAIN,
    "phase_margin": REQUIRED_PHASE,
}


@dataclass(frozen=True, eq=False)
class PlottedLoop:
    """A loop as the figure of margins takes it."""

    loop: LoopMargins
    simulated: bool = False


def write_loop(
    out: Path, watch: Watch, session: MarginSession, name: str, source: Path | None = None
) -> None:
    """Write the study of a loop, completely or not at all; ``source`` is the file of its rows, None
    for a pipe.
    """
    from scenarios.plots.drawing import draw_for_page
    from scenarios.plots.flying_qualities import figure_margin_history, figure_margins
    from scenarios.report.figure_formats import USUAL

    loop = margins_of(session)
    digest = hashlib.sha256(source.read_bytes()).hexdigest() if source is not None else ""
    content = margin_content(session)
    content["stream"] = {
        "rows": session.rows,
        "left_out": watch.left_out,
        "mended": watch.mended,
        "gaps": session.gaps,
        "ended": watch.reason,
    }
    with study_folder(out, MAIN) as scratch:
        named = []
        if loop is not None:
            named.append(("loop", partial(figure_margins, PlottedLoop(loop))))
        if any(shown(point) for point in session.points):
            named.append(("history", partial(figure_margin_history, session.points, name)))
        figure_files = draw_for_page(named, scratch, USUAL)
        write_text(scratch / HISTORY, history_csv(session))
        write_page(scratch, loop_page(content, loop, name, digest, page_figures(figure_files)))
        write_json(scratch / MAIN, content)


def loop_page(
    content: Mapping[str, Any],
    loop: LoopMargins | None,
    name: str,
    digest: str,
    figure_blocks: tuple[Block, ...],
) -> Page:
    """The page of a loop that was watched."""
    stream = content["stream"]
    said = f"{stream['rows']} rows of {name}, {stream['left_out']} left out, {stream['gaps']} gaps"
    margins: list[Block] = []
    if loop is not None:
        margins += loop_tables(loop)
        margins.append(Bullets(tuple(map(as_sentence, margin_lines(loop)))))
    command, _, returned = content["response"].partition("/")[::-1]
    words = ["flightid", "watch", name, "--margins", content["sign"]]
    words += ["--input", command, "--output", returned]
    return Page(
        title=f"{content['response']}: stability margins of a stream",
        kind=f"Watch of {name}, broken-loop response by recursive Fourier transforms",
        verdict="margins" if loop is not None else "not determined",
        tone="plain" if loop is not None else "open",
        sentence=as_sentence(said),
        summary=(),
        warnings=tuple(map(as_sentence, content["warnings"])),
        sections=(
            *section("Margins while the stream arrived", *figure_blocks),
            *section("Margins at the end", *margins),
        ),
        reproduction=reproduction(
            words,
            as_sentence(f"the watch ended: {stream['ended']}"),
            [("rows", name, digest)] if digest else [],
        ),
        created=now(),
    )


class FollowLoop:
    """Callable that puts rows, margins and status of a watched loop into a feed."""

    def __init__(self, watch: Watch, session: MarginSession, feed: Feed) -> None:
        self._watch, self._session, self._feed = watch, session, feed
        names = session.names
        strips = [names.command, *([names.excitation] if names.excitation else []), names.returned]
        about = {
            "name": watch.name,
            "strips": [{"name": each, "word": each, "unit": ""} for each in strips],
            "delays": [],
            "reference": None,
            "start": "",
            "loop": {"standard": "required by MIL-F-9490D"},
        }
        self._strips, self._begun, self._rows = strips, time.monotonic(), 0
        feed.put("about", _line(about))

    def rows(self, table: np.ndarray) -> None:
        """Rows ``(1 + S, N)`` as they came."""
        if table.shape[1]:
            values = {"t": _numbers(table[0], 9)}
            for name, row in zip(self._strips, table[1:], strict=True):
                values[name] = _numbers(row)
            self._rows += table.shape[1]
            self._feed.put("rows", _line(values), rows=table.shape[1])
        self._stand("running")

    def point(self, point: MarginPoint, name: str = "estimates") -> None:
        """Margins after a second; ``name`` : of the event, ``"final"`` at the end."""
        items = []
        for key, margin in shown(point):
            text = f"{margin.size.value:.3g} ({interval_text(margin)})"
            half = 0.5 * (margin.high - margin.low) / NORMAL
            items.append(
                {
                    "name": key,
                    "word": WORDS[key],
                    "unit": UNITS[margin.kind] if margin.kind != "distance" else "",
                    "told": text,
                    "value": margin.size.value,
                    "std": half,
                    "low": margin.low,
                    "high": margin.high,
                    **({"required": REQUIRED[key]} if key in REQUIRED else {}),
                }
            )
        kind = "broken-loop response by recursive Fourier transforms, 95 % intervals in brackets"
        event = {"t": round(point.time, 6), "kind": kind, "items": items, "weights": []}
        self._feed.put(name, _line(event))

    def end(self) -> None:
        """The last margins, and why the stream ended."""
        if self._session.points:
            self.point(self._session.points[-1], "final")
        self._stand("ended", self._watch.reason)

    def _stand(self, state: str, sentence: str = "") -> None:
        passed = max(time.monotonic() - self._begun, 1e-3)
        points = self._session.points
        event = {
            "state": state,
            "sentence": sentence,
            "rows": self._rows,
            "left_out": self._watch.left_out,
            "spikes": 0,
            "rate": self._rows / passed,
            "silent": time.monotonic() - self._watch.heard,
            "t": points[-1].time if points else None,
        }
        self._feed.put("status", _line(event))


@contextmanager
def served_loop(watch: Watch, session: MarginSession, port: int | None) -> Iterator[FollowLoop]:
    """Context manager that serves the live page of a loop and gives the callable that feeds it."""
    with served_feed(port) as feed:
        yield FollowLoop(watch, session, feed)


def _numbers(values: np.ndarray, digits: int = 6) -> list[float | None]:
    return [
        float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in values.tolist()
    ]


def _line(content: Mapping[str, Any]) -> str:
    return json.dumps(content, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
