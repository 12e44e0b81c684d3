"""`flightid watch`: a stream identified while it arrives, shown against a reference, written as it goes."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ident.banks.online import BankState
from scenarios.files.channels import ColumnChoice
from scenarios.watching.history import History
from scenarios.watching.lines import Lines, Read, growing_file, lines_of, standard_input
from scenarios.watching.reference import Reference, read_reference, vehicle_to_watch
from scenarios.watching.rows import Fault, Header, Order, at_end, in_order, read_header, read_lines
from scenarios.watching.session import Session, Step, likely_estimate, record_of, start, take
from scenarios.watching.session import derived_so_far as derived_of_session
from scenarios.watching.study import Outcome, refuse_overwriting, write_watch
from scenarios.watching.table import View, live_table, outside_of, standings
from scenarios.watching.table import line as view_line
from sim.errors import DeclarationError, FlightidError, RecordError
from sim.record import Hold

PIPE = "-"
WATCHED = ("loes",)  # models of which a stream can be identified
FILE_IDLE = 5.0  # s; a pipe says by itself when it ends
REFINED_ROWS = 6000  # two and a half minutes at 40 Hz; the refinement goes over all rows some fifty times
TOGETHER = 200  # rows that are filtered before they are written and shown: a few hundredths of a second
REFRESH = 0.25  # s between two drawings of the live table


@dataclass
class _Watch:
    """What the loop changes: the header once it came, how far the stream is, and what was left out."""

    name: str
    vehicle_path: Path | None
    reference: Reference | None
    choices: Mapping[str, ColumnChoice] | None
    units: Mapping[str, str]
    header: Header | None = None
    session: Session | None = None
    order: Order = field(default_factory=Order)
    line: int = 0
    left_out: int = 0
    mended: int = 0
    reason: str = "the stream ended"
    heard: float = field(default_factory=time.monotonic)


def watch_stream(
    record: str,
    model: str,
    vehicle: Path | None,
    reference: Path | None,
    channels: Path | None,
    out: Path | None,
    idle: float | None,
    until_end: bool,
    refine: bool,
) -> None:
    """Follow the stream to its end, then print, and write where a folder is named."""
    if model not in WATCHED:
        raise DeclarationError(f"there is no model {model!r} for a stream", where="--model", remedy=f"use {', '.join(WATCHED)}")
    watch = _prepared(record, vehicle, reference, channels)
    if out is not None and record != PIPE:
        refuse_overwriting(Path(record), out)
    limit = idle if idle is not None else None if record == PIPE else FILE_IDLE
    with _source(record, until_end) as read, History(out) if out is not None else nullcontext() as history:
        _follow(watch, lines_of(read, limit, watch.name), history)
        session = _session(watch)
        if session.bank is None:
            _written(history, session, start(session))
        end = _finished(watch, session, refine)
        if out is not None and history is not None:
            write_watch(out, session, watch.reference, end, history, Path(record).name if record != PIPE else watch.name)
    _print(watch, session, end)
    if out is not None:
        print(f"written to {out}")


def _prepared(record: str, vehicle: Path | None, reference: Path | None, channels: Path | None) -> _Watch:
    from scenarios.files.channels import read_channel_map
    from scenarios.files.sidecar import read_sidecar

    known = read_reference(reference) if reference is not None else None
    choices = read_channel_map(channels) if channels is not None else None
    if record == PIPE:
        return _Watch("standard input", vehicle, known, choices, {})
    sidecar = read_sidecar(Path(record))
    if sidecar.hold is not Hold.PREVIOUS:
        raise RecordError("its inputs are linear between samples", where=record, remedy="a stream holds them; use flightid identify")
    return _Watch(record, vehicle, known, choices, sidecar.units)


@contextmanager
def _source(record: str, until_end: bool) -> Iterator[Read]:
    if record == PIPE:
        yield standard_input()
        return
    with growing_file(Path(record), until_end) as read:
        yield read


def _follow(watch: _Watch, lines: Iterator[Lines], history: History | None) -> None:
    """Take lines until the stream ends or Ctrl-C."""
    with _display(watch) as show:
        try:
            for came in lines:
                rows = _rows_in(watch, came)
                for piece in _pieces(watch.session, rows):
                    steps = take(_session(watch), piece)
                    _written(history, _session(watch), steps)
                    show(steps)
                show([])
                if came.unfinished and watch.header is not None:
                    watch.line += 1
                    _report(watch, [Fault(watch.line, "the stream ended in the middle of it")])
        except KeyboardInterrupt:
            watch.reason = "stopped by the user"
        if watch.header is not None:
            rows, faults, watch.order = at_end(watch.order)
            _report(watch, faults)
            session = _session(watch)
            _written(history, session, take(session, rows))


def _rows_in(watch: _Watch, came: Lines) -> np.ndarray:
    """The rows that lines hold."""
    lines = came.whole
    if lines:
        watch.heard = time.monotonic()
    while watch.header is None and lines:
        first, lines = lines[0], lines[1:]
        watch.line += 1
        if first.strip():
            watch.header = read_header(first, watch.name, watch.choices, watch.units)
            watch.session = Session(vehicle_to_watch(watch.vehicle_path, watch.reference), watch.name, watch.header.stick_unit)
    if watch.header is None or not lines:
        return np.zeros((0, 0))
    table, numbers, faults = read_lines(watch.header, lines, watch.line + 1)
    watch.line += len(lines)
    rows, disorder, watch.order = in_order(table, numbers, watch.order)
    _report(watch, sorted([*faults, *disorder]))
    return rows


def _pieces(session: Session | None, rows: np.ndarray) -> Iterator[np.ndarray]:
    """Rows cut where a second of the stream begins, so that what is shown does not hang on how they came: one second at a time until
    the filter has started, later as many as ``TOGETHER`` holds."""
    if session is None or not rows.size:
        return
    cuts = [*(np.flatnonzero(np.diff(np.floor(rows[0]))) + 1).tolist(), rows.shape[1]]
    first = 0
    while first < rows.shape[1]:
        ahead = [cut for cut in cuts if cut > first]
        fitting = [cut for cut in ahead if cut <= first + TOGETHER] if session.bank is not None else []
        last = max(fitting, default=ahead[0])
        yield rows[:, first:last]
        first = last


def _session(watch: _Watch) -> Session:
    if watch.session is None:
        raise RecordError("the stream is empty", where=watch.name, remedy="give a header row and one row a sample")
    return watch.session


def _written(history: History | None, session: Session, steps: list[Step]) -> None:
    if history is not None and session.bank is not None:
        history.write(session.bank, steps)


def _report(watch: _Watch, faults: list[Fault]) -> None:
    """Count faults, and say the first of each sort in one line."""
    for fault in faults:
        if fault.left_out:
            if not watch.left_out:
                print(f"flightid: {watch.name}, row {fault.row}: {fault.what}; left out, others like it are counted", file=sys.stderr)
            watch.left_out += 1
        else:
            if not watch.mended:
                print(f"flightid: {watch.name}, row {fault.row}: {fault.what}; others like it are counted", file=sys.stderr)
            watch.mended += 1


def _view(watch: _Watch, session: Session, state: BankState | None = None, spikes: int | None = None) -> View:
    """The stream at a state of the bank, the last when None."""
    bank, state = session.bank, session.state if state is None else state
    assert bank is not None and state is not None
    estimate, weights, delay = likely_estimate(bank, state)
    items = standings(estimate, derived_of_session(session, estimate, delay), watch.reference)
    silent = time.monotonic() - watch.heard
    spikes = session.spikes if spikes is None else spikes
    return View(watch.name, state.time, state.rows_seen, watch.left_out, spikes, items, bank.delays, weights, silent, bool(state.sound.any()))


class _Show:
    """Draws a live table on a terminal, else prints a line for every second of data."""

    def __init__(self, watch: _Watch) -> None:
        from rich.live import Live

        from scenarios.terminal.numbers import console

        self._watch, self._said, self._drawn = watch, -np.inf, 0.0
        terminal = console()
        self.live = Live(console=terminal, auto_refresh=False) if terminal.is_terminal else None

    def __call__(self, steps: Sequence[Step]) -> None:
        """Show the last state, or a line for the last of ``steps`` in each second."""
        session = self._watch.session
        if session is None or session.state is None:
            return
        if self.live is not None:
            now = time.monotonic()
            if now - self._drawn >= REFRESH:
                self._drawn = now
                self.live.update(live_table(_view(self._watch, session)), refresh=True)
            return
        # Of those that were collected before the filter started only the last counts.
        told = list(steps)[-1:] if self._said == -np.inf else steps
        seconds = [int(np.floor(step.row[0])) for step in told]
        for step, second, after in zip(told, seconds, [*seconds[1:], None], strict=False):
            if second > self._said and second != after:
                self._said = second
                print(view_line(_view(self._watch, session, step.state, step.spikes)), flush=True)


@contextmanager
def _display(watch: _Watch) -> Iterator[_Show]:
    show = _Show(watch)
    with show.live if show.live is not None else nullcontext():
        yield show


def _finished(watch: _Watch, session: Session, refine: bool) -> Outcome:
    """The refinement over all rows where it is wanted and affordable, and the last estimates against the reference."""
    from scenarios.identification.low_order import identify_loes

    bank, state, record = session.bank, session.state, record_of(session)
    assert bank is not None and state is not None
    online, weights, delay = likely_estimate(bank, state)
    found = None
    if refine and len(record) <= REFINED_ROWS and bool(state.sound.any()):
        try:
            found = identify_loes(record, session.vehicle)
        except KeyboardInterrupt:
            watch.reason = "stopped by the user"
        except FlightidError as error:
            print(f"flightid: not refined: {error}", file=sys.stderr)
    derived = derived_of_session(session, online, delay) if found is None else found.derived
    last = online if found is None else found.estimate
    items = standings(last, derived, watch.reference)
    return Outcome(record, found, online, weights, derived, items, watch.left_out, watch.mended, session.spikes, watch.reason)


def _print(watch: _Watch, session: Session, end: Outcome) -> None:
    from scenarios.terminal.numbers import console

    terminal = console()
    view = replace(_view(watch, session), standings=end.standings, silent=0.0)
    kind = "on line, the most likely filter" if end.found is None else "refined over all rows"
    terminal.print(f"{watch.reason}; {kind}:", highlight=False)
    terminal.print(live_table(view))
    outside = outside_of(end.standings)
    if watch.reference is not None:
        said = f"outside the bounds of {watch.reference.name}: {', '.join(outside)}" if outside else f"inside the bounds of {watch.reference.name}"
        terminal.print(said, highlight=False)
