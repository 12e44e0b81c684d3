"""Show a watch as a live table or as a line for each second, and print its end.

Also write study folder and page of a watch in the frequency domain, and of the stability margins of
a watched loop.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ident.estimate import Estimate
from ident.flying_qualities.stability_margins import (
    NORMAL_HALF_WIDTH,
    REQUIRED_GAIN,
    REQUIRED_PHASE,
)
from scenarios.files.sources import InputFile, versions
from scenarios.files.writing import study_folder, write_json, write_record, write_text
from scenarios.report.document import (
    Block,
    Bullets,
    Page,
    Section,
    as_sentence,
    capital,
    now,
    reproduction,
    section,
)
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.report.folder import figures as page_figures
from scenarios.report.folder import write_page
from scenarios.report.quantities import console, number_text
from scenarios.report.summary import TableColumn, print_paragraph, print_table
from scenarios.report.terminal import fixed_table, show_table
from scenarios.responses.loops import UNITS, LoopMargins, interval_text, loop_tables, margin_lines
from scenarios.responses.loops import WORDS as LOOP_WORDS
from scenarios.studies.comparison import SCHEMA
from scenarios.watching.loop_margins import (
    HISTORY,
    MAIN,
    MarginPoint,
    MarginSession,
    margin_content,
    margins_of,
    shown,
)
from scenarios.watching.loop_margins import history_csv as margin_history
from scenarios.watching.page import Feed, json_line, rounded, served_feed, status
from scenarios.watching.reference import (
    WORDS,
    CrossValidation,
    Reference,
    View,
    against,
    against_items,
    comparisons,
    differences_table,
    live_table,
    reference_content,
    rows_and_vehicle,
    usual_command,
    vehicle_sentence,
)
from scenarios.watching.reference import line as view_line
from scenarios.watching.session import Session, Watch, WatchStep, history_section
from scenarios.watching.spectral import (
    UNKNOWN,
    Point,
    SpectralSession,
    derived_quantities,
    estimate_of,
    history_csv,
    last_estimate,
    record_of,
    spectral_content,
    stream_notes,
    stream_warnings,
)
from scenarios.watching.study import NAME, WatchOutcome, estimate_tables, so_far

# ---- A stream in the frequency domain: what is printed, study folder and page

SHOWN_PARAMETERS = 4  # parameters in a line: those with the smallest relative sigmas


def line(session: SpectralSession, point: Point, left_out: int) -> str:
    """Return the estimates after a second of the stream in one line."""
    rows = estimate_of(point, session)[:SHOWN_PARAMETERS]
    texts = [
        f"{row['name']} {number_text(row['value'], row['std'])} +- "
        f"{number_text(row['std'], row['std'])}"
        for row in rows
    ]
    lost = f", {left_out} line{'s' * (left_out != 1)} left out" if left_out else ""
    return f"{session.name}, {point.time:.2f} s{lost}: {', '.join(texts) or UNKNOWN}"


def items_of(
    session: SpectralSession, estimate: Estimate | None, reference: Reference | None
) -> tuple[CrossValidation, ...]:
    """Return the quantities of an estimate with their references; empty without an estimate."""
    if estimate is None:
        return ()
    return comparisons(estimate, derived_quantities(session, estimate), reference)


def print_spectral_end(watch: Watch, session: SpectralSession) -> None:
    """Print the last estimate in a table, undetermined parameters, and the reference."""
    out, estimate = console(), last_estimate(session)
    items = items_of(session, estimate, watch.reference)
    out.print(
        f"{watch.reason}; equation error in the frequency domain over {session.rows} rows:",
        highlight=False,
    )
    out.print(vehicle_sentence(session.vehicle), highlight=False)
    columns = [
        TableColumn(
            "quantity",
            # Symbols of parameters, such as M_alpha, keep their underscores.
            [item.name.replace("_", " ") if item.name.islower() else item.name for item in items],
            left=True,
        ),
        TableColumn("unit", [item.unit for item in items], left=True),
        TableColumn("estimate", [number_text(item.value, item.std) for item in items]),
        TableColumn("+- sigma", [number_text(item.std, item.std) for item in items]),
    ]
    if any(item.reference is not None for item in items):
        columns += [
            TableColumn(
                "reference",
                [number_text(*item.reference) if item.reference else "" for item in items],
            ),
            TableColumn(
                "off, sigmas", ["-" if item.z is None else f"{item.z:+.1f}" for item in items]
            ),
        ]
    print_table(out, "", columns)
    for warning in stream_warnings(session):
        out.print(f"warning: {warning}", highlight=False)
    for note in stream_notes(session):
        out.print(f"note: {note}", highlight=False)
    if watch.reference is not None:
        out.print(against_items(items, watch.reference.name), highlight=False)


def beside_lines(session: SpectralSession | None, bank: Estimate) -> list[str]:
    """Return lines that compare the frequency-domain estimate with that of the bank."""
    estimate = None if session is None else last_estimate(session)
    if estimate is None:
        return []
    parts = []
    for name, value, std in zip(
        estimate.names, estimate.values.tolist(), estimate.std.tolist(), strict=True
    ):
        if name in bank.names:
            # Both estimates are from the same data, so that their variances must not be added.
            difference = (value - bank.value(name)) / max(std, bank.sigma(name), 1e-300)
            parts.append(
                f"{name} {number_text(value, std)} +- {number_text(std, std)} ({difference:+.1f})"
            )
    return [
        f"in the frequency domain (difference from these, in the larger sigma): {', '.join(parts)}"
    ]


def write_spectral(
    out: Path, watch: Watch, session: SpectralSession, name: str, formats: Formats = USUAL
) -> None:
    """Write the study folder of a stream in the frequency domain, completely or not at all."""
    estimate = last_estimate(session)
    items = items_of(session, estimate, watch.reference)
    with study_folder(out, "comparison.json") as scratch:
        record_file, _ = write_record(scratch, record_of(session))
        history = history_csv(session)
        write_text(scratch / NAME, history)
        digest = hashlib.sha256(record_file.read_bytes()).hexdigest()
        content = {
            "schema": SCHEMA,
            "scenario": "watch",
            "model": session.vehicle.model,
            "vehicle": session.vehicle.name,
            **spectral_content(session),
            **(
                {}
                if watch.reference is None
                else {"reference": reference_content(watch.reference, items)}
            ),
            "stream": {
                "rows": session.rows,
                "left_out": watch.left_out,
                "mended": watch.mended,
                "ended": watch.reason,
            },
            "versions": versions(),
        }
        title = f"{content['vehicle']}: {name}"
        first = history_section(scratch, history, content, title, formats)
        write_page(scratch, spectral_page(content, name, digest, first, session.vehicle.identity))
        write_json(
            scratch / "comparison.json",
            {**content, "inputs": {"records": [name], "sha256": [digest]}},
        )


def spectral_page(
    content: Mapping[str, Any],
    name: str,
    digest: str,
    first: tuple[Section, ...] = (),
    vehicle: InputFile | None = None,
) -> Page:
    """Return the page of a stream that was identified in the frequency domain.

    Parameters
    ----------
    content : content of ``comparison.json``.
    name : name of the stream.
    digest : SHA-256 of the record.
    first : sections above all others.
    vehicle : the vehicle file, if there is one.
    """
    stream = content["stream"]
    counts = (
        f"{stream['rows']} rows of {name}, {stream['left_out']} left out, "
        f"{stream['mended']} filled in"
    )
    reference = content.get("reference")
    outside: Sequence[str] = () if reference is None else reference["outside"]
    agreement = (
        ""
        if reference is None
        else against(outside, len(reference["differences"]), reference["study"])
    )
    verdict = (
        "outside the reference" if outside else "identified" if content["parameters"] else UNKNOWN
    )
    fixed = {
        constant: (entry["value"], entry["unit"])
        for constant, entry in content.get("fixed", {}).items()
    }
    return Page(
        title=f"{capital(content['vehicle'])}: identified from a stream",
        kind=f"Watch of {name}, {content['model']}, equation error in the frequency domain",
        verdict=verdict,
        tone=(
            "open"
            if not content["parameters"]
            else "fair"
            if outside or content.get("warnings")
            else "good"
        ),
        sentence=as_sentence(agreement or counts),
        summary=() if reference is None else (as_sentence(counts),),
        warnings=tuple(map(as_sentence, content.get("warnings", ()))),
        sections=(
            *first,
            *section("Estimates", *estimate_tables(content)),
            *section("Against the reference", differences_table(content)),
            *section(
                "How it was made",
                fixed_table("Constants", fixed),
                Bullets(tuple(map(as_sentence, content.get("notes", ())))),
            ),
        ),
        reproduction=reproduction(
            usual_command(name, content["model"], vehicle),
            as_sentence(f"the watch ended: {stream['ended']}"),
            rows_and_vehicle(name, digest, vehicle),
        ),
        created=now(),
    )


# ---- A stream with a bank of filters: live table or lines, and the end

REFRESH_INTERVAL = 0.25  # s between two drawings of the live table


def view_of(watch: Watch, session: Session, step: WatchStep | None = None) -> View:
    """Return the view of a stream after a step; None: the last step."""
    # A given step is new, even if its row had to wait for the filter.
    silent = time.monotonic() - watch.heard if step is None else 0.0
    bank, step = session.bank, session.last if step is None else step
    assert bank is not None and step is not None
    result, state = so_far(session, step), step.state
    items = comparisons(result.estimate, result.derived, watch.reference, result.hanging)
    sound = bool(state.sound.any())
    return View(
        watch.name,
        state.time,
        state.rows_seen,
        watch.left_out,
        step.spikes,
        items,
        bank.delays,
        result.weights,
        silent,
        sound,
        result.refined,
    )


class Show:
    """Shows a watch: a live table on a terminal, else a line for each second of data."""

    def __init__(self, watch: Watch) -> None:
        from rich.live import Live

        # Last second of the stream with a line; time of the last drawing, s.
        self._watch, self._last_second, self._drawn = watch, -np.inf, 0.0
        terminal = console()
        self.live = Live(console=terminal, auto_refresh=False) if terminal.is_terminal else None

    def __call__(self, steps: Sequence[WatchStep]) -> None:
        """Show the last state, or a line for the last of ``steps`` in each second."""
        session = self._watch.session
        if session is None or session.state is None:
            return
        if self.live is not None:
            now = time.monotonic()
            if now - self._drawn >= REFRESH_INTERVAL:
                self._drawn = now
                self.live.update(live_table(view_of(self._watch, session)), refresh=True)
            return
        # The rows collected before the filters started have one line, that of the last row.
        shown_steps = list(steps)[-1:] if self._last_second == -np.inf else steps
        seconds = [int(np.floor(step.row[0])) for step in shown_steps]
        for step, second, after in zip(shown_steps, seconds, [*seconds[1:], None], strict=False):
            if second > self._last_second and second != after:
                self._last_second = second
                print(view_line(view_of(self._watch, session, step)), flush=True)


@contextmanager
def display(watch: Watch) -> Iterator[Show]:
    """Give the body the display: a live table on a terminal, else lines."""
    show = Show(watch)
    with show.live if show.live is not None else nullcontext():
        yield show


def print_end(watch: Watch, session: Session, end: WatchOutcome) -> None:
    """Print the reason of the end, the last table, and quantities outside the reference."""
    terminal = console()
    view = replace(
        view_of(watch, session),
        standings=end.standings,
        weights=end.weights,
        silent=0.0,
        refined=end.refined,
    )
    kind = (
        "refined over all rows"
        if end.refinement is not None
        else "refined on line"
        if end.refined
        else "on line, the most likely filter"
    )
    terminal.print(f"{watch.reason}; {kind}:", highlight=False)
    terminal.print(vehicle_sentence(session.vehicle), highlight=False)
    terminal.print(live_table(view))
    for words in beside_lines(session.spectral, (end.refinement or end.online).estimate):
        terminal.print(words, highlight=False)
    hanging = [WORDS.get(item.name, item.name) for item in end.standings if item.hanging]
    if hanging:
        what = (
            f"with another start within its prior the result would differ: {', '.join(hanging)}; "
            "name a nearer start with --vehicle"
        )
        terminal.print(
            f"{what}, or leave out --no-refine" if not watch.refine else what, highlight=False
        )
    if watch.reference is not None:
        terminal.print(against_items(end.standings, watch.reference.name), highlight=False)
    if watch.beside:
        terminal.print(
            f"note: {watch.beside} was found beside the record and read for its units",
            highlight=False,
        )


# ---- Stability margins of a loop: what is printed, study folder, page and live page


def print_loop_end(watch: Watch, session: MarginSession) -> None:
    """Print the margins over the whole stream in a table, compared with the required ones."""
    out, loop = console(), margins_of(session)
    gaps = f", {session.gaps} gap{'s' * (session.gaps != 1)}" if session.gaps else ""
    out.print(f"{watch.reason}; {session.rows} rows{gaps}:", highlight=False)
    if loop is None:
        out.print("no frequency is usable: no margin is determined", highlight=False)
        return
    for margin_table in loop_tables(loop):
        show_table(out, margin_table)
    for words in (*margin_lines(loop), *loop.cautions):
        print_paragraph(out, words, indent=0)


# Margins that MIL-F-9490D requires below the first structural mode, dB and deg.
REQUIRED = {
    "gain_increase": REQUIRED_GAIN,
    "gain_decrease": -REQUIRED_GAIN,
    "phase_margin": REQUIRED_PHASE,
}


@dataclass(frozen=True, eq=False)
class PlottedLoop:
    """Argument of ``figure_margins``: a loop, and whether its data are simulated."""

    loop: LoopMargins
    simulated: bool = False


def write_loop(
    out: Path,
    watch: Watch,
    session: MarginSession,
    name: str,
    source: Path | None = None,
    formats: Formats = USUAL,
) -> None:
    """Write the study folder of a loop, completely or not at all.

    ``source``: file of the rows; None for a pipe. ``formats``: of the figures; empty draws none.
    """
    from scenarios.plots.drawing import draw_for_page
    from scenarios.plots.flying_qualities import figure_margin_history, figure_margins

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
        makers = []
        if formats and loop is not None:
            makers.append(("loop", partial(figure_margins, PlottedLoop(loop))))
        if formats and any(shown(point) for point in session.points):
            makers.append(("history", partial(figure_margin_history, session.points, name)))
        figure_files = draw_for_page(makers, scratch, formats)
        write_text(scratch / HISTORY, margin_history(session))
        write_page(scratch, loop_page(content, loop, name, digest, page_figures(figure_files)))
        write_json(scratch / MAIN, content)


def loop_page(
    content: Mapping[str, Any],
    loop: LoopMargins | None,
    name: str,
    digest: str,
    figure_blocks: tuple[Block, ...],
) -> Page:
    """Return the page of a watched loop; ``digest``: SHA-256 of the rows, empty for a pipe."""
    stream = content["stream"]
    sentence = (
        f"{stream['rows']} rows of {name}, {stream['left_out']} left out, {stream['gaps']} gaps"
    )
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
        sentence=as_sentence(sentence),
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
    """Sends rows, margins and status of a watched loop to its live page."""

    def __init__(self, watch: Watch, session: MarginSession, feed: Feed) -> None:
        self._watch, self._session, self._feed = watch, session, feed
        names = session.names
        strips = [names.command, *([names.excitation] if names.excitation else []), names.returned]
        about = {
            "name": watch.name,
            "strips": [{"name": signal, "word": signal, "unit": ""} for signal in strips],
            "delays": [],
            "reference": None,
            "start": "",
            "loop": {"standard": "required by MIL-F-9490D"},
        }
        self._strips, self._begun, self._rows = strips, time.monotonic(), 0
        feed.put("about", json_line(about))

    def rows(self, table: np.ndarray) -> None:
        """Send new rows, ``(1 + S, N)``: time and S signals."""
        if table.shape[1]:
            values = {"t": rounded(table[0], 9)}
            for name, row in zip(self._strips, table[1:], strict=True):
                values[name] = rounded(row)
            self._rows += table.shape[1]
            self._feed.put("rows", json_line(values), rows=table.shape[1])
        self._send_status("running")

    def point(self, point: MarginPoint, name: str = "estimates") -> None:
        """Send the margins after a second in an event ``name``, which is "final" at the end."""
        items = [
            {
                "name": key,
                "word": LOOP_WORDS[key],
                "unit": UNITS[margin.kind] if margin.kind != "distance" else "",
                "told": f"{margin.size.value:.3g} ({interval_text(margin)})",
                "value": margin.size.value,
                "std": 0.5 * (margin.high - margin.low) / NORMAL_HALF_WIDTH,
                "low": margin.low,
                "high": margin.high,
                **({"required": REQUIRED[key]} if key in REQUIRED else {}),
            }
            for key, margin in shown(point)
        ]
        kind = "broken-loop response by recursive Fourier transforms, 95 % intervals in brackets"
        event = {"t": round(point.time, 6), "kind": kind, "items": items, "weights": []}
        self._feed.put(name, json_line(event))

    def end(self) -> None:
        """Send the last margins, and why the stream ended."""
        if self._session.points:
            self.point(self._session.points[-1], "final")
        self._send_status("ended", self._watch.reason)

    def _send_status(self, state: str, sentence: str = "") -> None:
        """Send the status; ``state`` is "running" or "ended"."""
        now, points = time.monotonic(), self._session.points
        numbers = {
            "rows": self._rows,
            "left_out": self._watch.left_out,
            "spikes": 0,
            "rate": self._rows / max(now - self._begun, 1e-3),
            "silent": now - self._watch.heard,
            "t": points[-1].time if points else np.nan,
        }
        self._feed.put("status", status(state, sentence, numbers))


@contextmanager
def served_loop(watch: Watch, session: MarginSession, port: int | None) -> Iterator[FollowLoop]:
    """Serve the live page of a loop while the body runs, and give the body its feed."""
    with served_feed(port) as feed:
        yield FollowLoop(watch, session, feed)
