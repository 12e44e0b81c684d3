"""`flightid watch`: identification of a stream while it arrives, and stability margins of a loop.

A stream is a growing file or standard input. Estimates are compared with a reference and written
continuously.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.frequency_domain.online import (
    FREQUENCY_SPACING,
    HIGHEST_FREQUENCY,
    LOWEST_FREQUENCY,
    frequencies,
)
from scenarios.files.vehicles import VehicleFile, read_vehicle, refuse_unknown_model
from scenarios.identification.low_order import PAPER_START
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.watching.loop_margins import (
    LoopNames,
    MarginPoint,
    MarginSession,
    finish_second,
    refuse_short,
)
from scenarios.watching.loop_margins import line as loop_line
from scenarios.watching.loop_margins import take as take_loop
from scenarios.watching.reference import comparisons, read_reference
from scenarios.watching.rows import (
    Fault,
    Lines,
    Read,
    at_end,
    growing_file,
    lines_of,
    standard_input,
)
from scenarios.watching.session import (
    STOPPED,
    Session,
    Watch,
    WatchStep,
    pieces,
    record_of,
    report,
    rows_in,
    session_of,
    start,
    take,
)
from scenarios.watching.show import display, print_end
from scenarios.watching.spectral import (
    Point,
    SpectralSession,
    regress,
    signals_of,
    spectral_session,
)
from scenarios.watching.spectral import record_of as record_of_stream
from scenarios.watching.spectral import take as take_rows
from scenarios.watching.study import History, WatchOutcome, refuse_overwriting, so_far, write_watch
from sim.errors import DeclarationError, FlightidError, RecordError
from sim.record import Hold

if TYPE_CHECKING:
    from scenarios.preparation.plan import Plan
    from scenarios.watching.page import Follow

PIPE = "-"  # argument for standard input
LOW_ORDER = "loes"  # the model that a bank of filters identifies
FILE_IDLE = 5.0  # s without new rows after which a file has ended; a pipe reports its end
# Most rows of a refinement: 2.5 minutes at 40 Hz. The refinement computes about fifty passes.
REFINED_ROWS = 6000
UNFINISHED = "the stream ended in the middle of this line"


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
    page: bool,
    port: int | None,
    plan: Plan,
    band: tuple[float, float] | None,
    figures: Formats = USUAL,
) -> None:
    """Identify a stream until it ends, print the result and write it.

    Parameters
    ----------
    record : file that grows, or ``"-"`` for standard input.
    model : the model.
    vehicle : vehicle file.
    reference : study or file whose values are compared with the estimates.
    channels : channel map.
    out : folder of the study.
    idle : time (s) without new rows after which the stream has ended.
    until_end : stop at the end of the file instead of waiting for new rows.
    refine : fit all rows again at the end.
    page : serve a page of the estimates until Ctrl-C.
    port : port of the page.
    plan : preparation of the record.
    band : band (Hz) of the regression in the frequency domain; None for the usual one.
    figures : formats of the figures.
    """
    refuse_page(port, page)
    refuse_unknown_model(model, "--model")
    if model != LOW_ORDER and page:
        raise DeclarationError(
            f"there is no page of the model {model}",
            where="--page",
            remedy="leave it out, or watch loes",
        )
    needed = tuple(PAPER_START) if model == LOW_ORDER else ()
    watch = _watch_of(record, vehicle, reference, channels, refine, plan, needed)
    if model == LOW_ORDER and watch.hold is Hold.LINEAR:
        raise RecordError(
            "its inputs are linear between samples",
            where=record,
            remedy="the filters of loes hold them; use flightid identify",
        )
    watch.omega = _frequencies(band)
    if out is not None and record != PIPE:
        refuse_overwriting(Path(record), out)
    limit = _idle_limit(record, idle)
    if model != LOW_ORDER:
        _watch_in_frequency(watch, model, record, out, limit, until_end, figures)
        return
    with ExitStack() as stack:
        read = stack.enter_context(_open_stream(record, until_end))
        follow = stack.enter_context(_served_page(watch, port)) if page else None
        history = stack.enter_context(History(out)) if out is not None else None
        _follow(watch, lines_of(read, limit, watch.name), history, follow)
        session = session_of(watch)
        if session.bank is None:
            _write_steps(history, session, start(session))
        # Ctrl-C on a page asks for the end, not for a refinement of minutes.
        outcome = _outcome(watch, session, refine and not (page and watch.stopped))
        if out is not None and history is not None:
            source = Path(record).name if record != PIPE else watch.name
            write_watch(out, session, watch.reference, outcome, history, source, figures)
        print_end(watch, session, outcome)
        if out is not None:
            from scenarios.report.summary import written_to

            print(written_to(out), flush=True)
        if follow is not None:
            _show_end(watch, session, outcome, follow)


def _idle_limit(record: str, idle: float | None) -> float | None:
    """Return the time (s) without new rows after which a stream has ended; None for no limit."""
    if idle is not None:
        return idle
    return None if record == PIPE else FILE_IDLE


def _frequencies(band: tuple[float, float] | None) -> np.ndarray:
    """Return the frequencies of the regression in a band (Hz), rad/s.

    Every band has the same number of frequencies. None takes the usual band.
    """
    if band is None:
        return frequencies()
    low, high = band
    if not (0.0 < low < high and math.isfinite(high)):
        raise DeclarationError(
            f"{low:g} to {high:g} Hz is no band",
            where="--band",
            remedy="give LOW HIGH in Hz, above 0",
        )
    spacing = (high - low) * FREQUENCY_SPACING / (HIGHEST_FREQUENCY - LOWEST_FREQUENCY)
    return frequencies(low, high, spacing)


def _watch_in_frequency(
    watch: Watch,
    model: str,
    record: str,
    out: Path | None,
    limit: float | None,
    until_end: bool,
    figures: Formats,
) -> None:
    """Identify a stream by regression in the frequency domain until it ends, print and write it.

    The parameters are those of ``watch_stream``; ``limit`` is the time (s) without new rows after
    which the stream has ended, None for no limit.
    """
    from scenarios.watching.show import line, print_spectral_end, write_spectral

    vehicle = read_vehicle(watch.vehicle_path, model)
    watch.signals = signals_of(vehicle)
    session: SpectralSession | None = None

    def show(points: list[Point]) -> None:
        for point in points:
            assert session is not None
            print(line(session, point, watch.left_out), flush=True)

    with _open_stream(record, until_end) as read:
        try:
            for lines in lines_of(read, limit, watch.name):
                rows = rows_in(watch, lines)
                session = session or _spectral_session(watch, vehicle)
                if session is not None and rows.size:
                    show(take_rows(session, rows))
                _report_unfinished(watch, lines)
        except KeyboardInterrupt:
            watch.reason = STOPPED
    if session is None:
        raise RecordError(
            "the stream is empty", where=watch.name, remedy="give a header row and one row a sample"
        )
    rows, faults, watch.order = at_end(watch.order, len(watch.signals.names))
    report(watch, faults)
    show([*take_rows(session, rows), *regress(session)])
    record_of_stream(session)
    print_spectral_end(watch, session)
    if out is not None:
        from scenarios.report.summary import written_to

        source = Path(record).name if record != PIPE else watch.name
        write_spectral(out, watch, session, source, figures)
        print(written_to(out), flush=True)


def watch_loop(
    record: str,
    names: LoopNames,
    channels: Path | None,
    out: Path | None,
    idle: float | None,
    until_end: bool,
    page: bool,
    port: int | None,
    plan: Plan,
    band: tuple[float, float] | None,
    figures: Formats = USUAL,
) -> None:
    """Estimate the stability margins of a loop every second until the stream ends; print and write.

    ``names`` are the signals of the loop. ``band`` (Hz) is the band of the broken-loop response;
    None takes the usual one. The other parameters are those of ``watch_stream``.
    """
    from scenarios.watching.show import print_loop_end, served_loop, write_loop

    refuse_page(port, page)
    if plan.hold is not None:
        raise DeclarationError(
            "margins use no input between samples", where="--hold", remedy="leave it out"
        )
    watch = _watch_of(record, None, None, channels, False, plan, ())
    watch.signals = names.signals
    if out is not None and record != PIPE:
        refuse_overwriting(Path(record), out)
    limit = _idle_limit(record, idle)
    session = MarginSession(names, watch.name, band)
    with ExitStack() as stack:
        read = stack.enter_context(_open_stream(record, until_end))
        live_page = stack.enter_context(served_loop(watch, session, port)) if page else None

        def show(points: list[MarginPoint], rows: np.ndarray) -> None:
            for point in points:
                print(loop_line(session, point, watch.left_out), flush=True)
                if live_page is not None:
                    live_page.point(point)
            if live_page is not None:
                live_page.rows(rows)

        try:
            for lines in lines_of(read, limit, watch.name):
                rows = rows_in(watch, lines)
                if rows.size:
                    show(take_loop(session, rows), rows)
                _report_unfinished(watch, lines)
        except KeyboardInterrupt:
            watch.reason = STOPPED
        rows, faults, watch.order = at_end(watch.order, len(watch.signals.names))
        report(watch, faults)
        show([*take_loop(session, rows), *finish_second(session)], rows)
        refuse_short(session)
        print_loop_end(watch, session)
        if out is not None:
            from scenarios.report.summary import written_to

            source = Path(record) if record != PIPE else None
            name = source.name if source else watch.name
            write_loop(out, watch, session, name, source, figures)
            print(written_to(out), flush=True)
        if live_page is not None:
            from scenarios.watching.page import until_interrupted

            live_page.end()
            if not watch.stopped:
                until_interrupted()


def refuse_page(port: int | None, page: bool) -> None:
    """Raise DeclarationError for a port without a page."""
    if port is not None and not page:
        raise DeclarationError("there is no page to serve", where="--port", remedy="add --page")


def _report_unfinished(watch: Watch, lines: Lines) -> None:
    if lines.unfinished and watch.header is not None:
        watch.line += 1
        report(watch, [Fault(watch.line, UNFINISHED)])


def _spectral_session(watch: Watch, vehicle: VehicleFile) -> SpectralSession | None:
    """Return a session for the outputs in the header; None before the header has arrived."""
    if watch.header is None or watch.omega is None:
        return None
    columns = watch.header.columns[1 + len(watch.signals.inputs) :]
    outputs = [
        name
        for name, column in zip(watch.signals.outputs, columns, strict=True)
        if column is not None
    ]
    return spectral_session(vehicle, watch.name, outputs, watch.omega, watch.hold, watch.hold_from)


def _served_page(watch: Watch, port: int | None) -> AbstractContextManager[Follow]:
    """Return the context that serves the page of a watch, and yields the function that feeds it."""
    from scenarios.watching.page import served

    return served(watch, port)


def _show_end(watch: Watch, session: Session, outcome: WatchOutcome, follow: Follow) -> None:
    """Show the outcome on the page until Ctrl-C, which may already have stopped the stream."""
    from scenarios.watching.page import until_interrupted

    follow.end(session, outcome)
    if not watch.stopped:
        until_interrupted()


def _watch_of(
    record: str,
    vehicle: Path | None,
    reference: Path | None,
    channels: Path | None,
    refine: bool,
    plan: Plan,
    needed: Sequence[str],
) -> Watch:
    """Return the state of a watch before its first row; the parameters are those of
    ``watch_stream``.

    ``needed`` are the parameters that the reference must have.
    """
    from scenarios.files.declarations import read_channel_map
    from scenarios.files.measured.columns import Sidecar, read_sidecar
    from scenarios.preparation.plan import BY_HAND

    reference_values = read_reference(reference, needed) if reference is not None else None
    choices = read_channel_map(channels) if channels is not None else None
    sidecar = Sidecar() if record == PIPE else read_sidecar(Path(record))
    hold, hold_from = plan.hold, BY_HAND
    if hold is None and sidecar.states_hold:
        hold, hold_from = sidecar.hold, f"as {sidecar.file} says"
    return Watch(
        "standard input" if record == PIPE else record,
        vehicle,
        reference_values,
        choices,
        sidecar.units,
        refine,
        sidecar.file,
        plan.columns,
        plan.rate,
        hold,
        hold_from,
    )


@contextmanager
def _open_stream(record: str, until_end: bool) -> Iterator[Read]:
    if record == PIPE:
        yield standard_input()
        return
    with growing_file(Path(record), until_end) as read:
        yield read


def _follow(
    watch: Watch, lines: Iterator[Lines], history: History | None, follow: Follow | None = None
) -> None:
    """Process lines until the stream ends or Ctrl-C; show the steps and write them.

    Parameters
    ----------
    watch : state of the watch, which changes.
    lines : pieces of the stream.
    history : file that receives the steps; None writes none.
    follow : function that shows the steps on the page; None without a page.
    """
    with display(watch) as show_in_terminal:

        def show(steps: list[WatchStep]) -> None:
            show_in_terminal(steps)
            if follow is not None:
                follow(steps)

        try:
            for new_lines in lines:
                rows = rows_in(watch, new_lines)
                for piece in pieces(watch.session, rows):
                    steps = take(session_of(watch), piece)
                    _write_steps(history, session_of(watch), steps)
                    show(steps)
                show([])
                _report_unfinished(watch, new_lines)
        except KeyboardInterrupt:
            watch.reason = STOPPED
        if watch.header is not None:
            rows, faults, watch.order = at_end(watch.order)
            report(watch, faults)
            session = session_of(watch)
            _write_steps(history, session, take(session, rows))


def _write_steps(history: History | None, session: Session, steps: list[WatchStep]) -> None:
    if history is not None and session.bank is not None:
        history.write(session.bank, steps, session.refine)


def _outcome(watch: Watch, session: Session, refine: bool) -> WatchOutcome:
    """Return the last estimates, their refinement, and the comparison with the reference.

    ``refine`` : fit all rows again, if these are at most ``REFINED_ROWS``.
    """
    from scenarios.identification.low_order import identify_loes

    if session.spectral is not None:
        regress(session.spectral)
    state, record = session.state, record_of(session)
    assert session.bank is not None and state is not None
    refined, online = None, so_far(session)
    if refine and len(record) <= REFINED_ROWS and bool(state.sound.any()):
        try:
            refined = identify_loes(record, session.vehicle)
        except KeyboardInterrupt:
            watch.reason = STOPPED
        except FlightidError as error:
            print(f"flightid: not refined: {error}", file=sys.stderr)
    if refined is None:
        items = comparisons(online.estimate, online.derived, watch.reference, online.hanging)
    else:
        items = comparisons(refined.estimate, refined.derived, watch.reference)
    return WatchOutcome(
        record,
        refined,
        online,
        session.bank.delays,
        items,
        watch.left_out,
        watch.mended,
        session.spikes,
        watch.reason,
    )
