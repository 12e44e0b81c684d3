"""`flightid watch`: identification of a stream while it arrives, compared with a reference and
written continuously; and the stability margins of a loop in it.
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

PIPE = "-"
LOW_ORDER = "loes"  # the model that banks of filters follow
FILE_IDLE = 5.0  # s; a pipe says by itself when it ends
# two and a half minutes at 40 Hz; the refinement goes over all rows some fifty times
REFINED_ROWS = 6000


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
    page: bool = False,
    port: int | None = None,
    plan: Plan | None = None,
    band: tuple[float, float] | None = None,
) -> None:
    """Follow the stream to its end, then print, and write where a folder is named; with a ``page``
    serve it until Ctrl-C.

    ``band`` : Hz, of the regression in the frequency domain; None for the usual one.
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
    watch = _prepared(record, vehicle, reference, channels, refine, plan, needed)
    if model == LOW_ORDER and watch.hold is Hold.LINEAR:
        raise RecordError(
            "its inputs are linear between samples",
            where=record,
            remedy="the filters of loes hold them; use flightid identify",
        )
    watch.omega = _frequencies(band)
    if out is not None and record != PIPE:
        refuse_overwriting(Path(record), out)
    limit = idle if idle is not None else None if record == PIPE else FILE_IDLE
    if model != LOW_ORDER:
        _watch_in_frequency(watch, model, record, out, limit, until_end)
        return
    with ExitStack() as open_until_done:
        read = open_until_done.enter_context(_source(record, until_end))
        follow = open_until_done.enter_context(_page(watch, port)) if page else None
        history = open_until_done.enter_context(History(out)) if out is not None else None
        _follow(watch, lines_of(read, limit, watch.name), history, follow)
        session = session_of(watch)
        if session.bank is None:
            _written(history, session, start(session))
        end = _finished(watch, session, refine and not (page and watch.stopped))
        if out is not None and history is not None:
            write_watch(
                out,
                session,
                watch.reference,
                end,
                history,
                Path(record).name if record != PIPE else watch.name,
            )
        print_end(watch, session, end)
        if out is not None:
            from scenarios.report.summary import written_to

            print(written_to(out), flush=True)
        if follow is not None:
            _stay(watch, session, end, follow)


def _frequencies(band: tuple[float, float] | None) -> np.ndarray:
    """Frequencies of the regression, rad/s, as many in a given band as in the usual one."""
    if band is None:
        return frequencies()
    low, high = band
    if not (0.0 < low < high and math.isfinite(high)):
        raise DeclarationError(
            f"{low:g} to {high:g} Hz is no band",
            where="--band",
            remedy="give LOW HIGH in Hz, above 0",
        )
    return frequencies(
        low, high, (high - low) * FREQUENCY_SPACING / (HIGHEST_FREQUENCY - LOWEST_FREQUENCY)
    )


def _watch_in_frequency(
    watch: Watch, model: str, record: str, out: Path | None, limit: float | None, until_end: bool
) -> None:
    """Follow a stream whose model is regressed in the frequency domain."""
    from scenarios.watching.show import line, print_spectral_end, write_spectral

    vehicle = read_vehicle(watch.vehicle_path, model)
    watch.signals = signals_of(vehicle)
    session: SpectralSession | None = None

    def show(points: list[Point]) -> None:
        for point in points:
            assert session is not None
            print(line(session, point, watch.left_out), flush=True)

    with _source(record, until_end) as read:
        try:
            for came in lines_of(read, limit, watch.name):
                rows = rows_in(watch, came)
                session = session or _begun(watch, vehicle)
                if session is not None and rows.size:
                    show(take_rows(session, rows))
                if came.unfinished and watch.header is not None:
                    watch.line += 1
                    report(watch, [Fault(watch.line, "the stream ended in the middle of it")])
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

        write_spectral(out, watch, session, Path(record).name if record != PIPE else watch.name)
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
    plan: Plan | None,
    band: tuple[float, float] | None,
) -> None:
    """Follow a loop's signals to the end of the stream, margins every second; with a ``page`` serve
    it until Ctrl-C. ``band`` : Hz, of the broken-loop response; None for the usual one."""
    from scenarios.watching.show import print_loop_end, served_loop, write_loop

    refuse_page(port, page)
    if plan is not None and plan.hold is not None:
        raise DeclarationError(
            "margins use no input between samples", where="--hold", remedy="leave it out"
        )
    watch = _prepared(record, None, None, channels, False, plan, ())
    watch.signals = names.signals
    if out is not None and record != PIPE:
        refuse_overwriting(Path(record), out)
    limit = idle if idle is not None else None if record == PIPE else FILE_IDLE
    session = MarginSession(names, watch.name, band)
    with ExitStack() as open_until_done:
        read = open_until_done.enter_context(_source(record, until_end))
        live = open_until_done.enter_context(served_loop(watch, session, port)) if page else None

        def show(points: list[MarginPoint], rows: np.ndarray) -> None:
            for point in points:
                print(loop_line(session, point, watch.left_out), flush=True)
                if live is not None:
                    live.point(point)
            if live is not None:
                live.rows(rows)

        try:
            for came in lines_of(read, limit, watch.name):
                rows = rows_in(watch, came)
                if rows.size:
                    show(take_loop(session, rows), rows)
                if came.unfinished and watch.header is not None:
                    watch.line += 1
                    report(watch, [Fault(watch.line, "the stream ended in the middle of it")])
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
            write_loop(out, watch, session, source.name if source else watch.name, source)
            print(written_to(out), flush=True)
        if live is not None:
            from scenarios.watching.page import until_interrupted

            live.end()
            if not watch.stopped:
                until_interrupted()


def refuse_page(port: int | None, page: bool) -> None:
    """Raise DeclarationError for a port without a page."""
    if port is not None and not page:
        raise DeclarationError("there is no page to serve", where="--port", remedy="add --page")


def _begun(watch: Watch, vehicle: VehicleFile) -> SpectralSession | None:
    """Return the session, once the header has come."""
    if watch.header is None or watch.omega is None:
        return None
    columns = watch.header.columns[1 + len(watch.signals.inputs) :]
    outputs = [
        name
        for name, column in zip(watch.signals.outputs, columns, strict=True)
        if column is not None
    ]
    return spectral_session(vehicle, watch.name, outputs, watch.omega, watch.hold, watch.hold_from)


def _page(watch: Watch, port: int | None) -> AbstractContextManager[Follow]:
    from scenarios.watching.page import served

    return served(watch, port)


def _stay(watch: Watch, session: Session, end: WatchOutcome, follow: Follow) -> None:
    """The page shows the end until Ctrl-C; a stream that was stopped by Ctrl-C has had it."""
    from scenarios.watching.page import until_interrupted

    follow.end(session, end)
    if not watch.stopped:
        until_interrupted()


def _prepared(
    record: str,
    vehicle: Path | None,
    reference: Path | None,
    channels: Path | None,
    refine: bool,
    plan: Plan | None,
    needed: Sequence[str],
) -> Watch:
    from scenarios.files.declarations import read_channel_map
    from scenarios.files.measured.columns import read_sidecar
    from scenarios.preparation.plan import BY_HAND

    known = read_reference(reference, needed) if reference is not None else None
    choices = read_channel_map(channels) if channels is not None else None
    names, rate, hold = (
        (plan.columns, plan.rate, plan.hold) if plan is not None else ((), None, None)
    )
    if record == PIPE:
        return Watch(
            "standard input",
            vehicle,
            known,
            choices,
            {},
            refine,
            columns=names,
            rate=rate,
            hold=hold,
        )
    sidecar = read_sidecar(Path(record))
    hold_from = BY_HAND
    if hold is None and sidecar.says_hold:
        hold, hold_from = sidecar.hold, f"as {sidecar.file} says"
    return Watch(
        record,
        vehicle,
        known,
        choices,
        sidecar.units,
        refine,
        sidecar.file,
        names,
        rate,
        hold,
        hold_from,
    )


@contextmanager
def _source(record: str, until_end: bool) -> Iterator[Read]:
    if record == PIPE:
        yield standard_input()
        return
    with growing_file(Path(record), until_end) as read:
        yield read


def _follow(
    watch: Watch, lines: Iterator[Lines], history: History | None, follow: Follow | None = None
) -> None:
    """Take lines until the stream ends or Ctrl-C."""
    with display(watch) as table:

        def show(steps: list[WatchStep]) -> None:
            table(steps)
            if follow is not None:
                follow(steps)

        try:
            for came in lines:
                rows = rows_in(watch, came)
                for piece in pieces(watch.session, rows):
                    steps = take(session_of(watch), piece)
                    _written(history, session_of(watch), steps)
                    show(steps)
                show([])
                if came.unfinished and watch.header is not None:
                    watch.line += 1
                    report(watch, [Fault(watch.line, "the stream ended in the middle of it")])
        except KeyboardInterrupt:
            watch.reason = STOPPED
        if watch.header is not None:
            rows, faults, watch.order = at_end(watch.order)
            report(watch, faults)
            session = session_of(watch)
            _written(history, session, take(session, rows))


def _written(history: History | None, session: Session, steps: list[WatchStep]) -> None:
    if history is not None and session.bank is not None:
        history.write(session.bank, steps, session.refine)


def _finished(watch: Watch, session: Session, refine: bool) -> WatchOutcome:
    """Return the refinement over all rows where it is wanted and affordable, and the last estimates
    against the reference.
    """
    from scenarios.identification.low_order import identify_loes

    if session.spectral is not None:
        regress(session.spectral)
    state, record = session.state, record_of(session)
    assert session.bank is not None and state is not None
    found, online = None, so_far(session)
    if refine and len(record) <= REFINED_ROWS and bool(state.sound.any()):
        try:
            found = identify_loes(record, session.vehicle)
        except KeyboardInterrupt:
            watch.reason = STOPPED
        except FlightidError as error:
            print(f"flightid: not refined: {error}", file=sys.stderr)
    if found is None:
        items = comparisons(online.estimate, online.derived, watch.reference, online.hanging)
    else:
        items = comparisons(found.estimate, found.derived, watch.reference)
    return WatchOutcome(
        record,
        found,
        online,
        session.bank.delays,
        items,
        watch.left_out,
        watch.mended,
        session.spikes,
        watch.reason,
    )
