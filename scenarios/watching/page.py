"""The web page of `watch`: a buffer of events, a local HTTP server, and the functions that make
events from rows and estimates.

The server refuses requests with another Host header than its own. Without this check, the page of
another site could read the data if its name resolved to 127.0.0.1 (DNS rebinding).
"""

from __future__ import annotations

import json
import math
import secrets
import socket
import socketserver
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

import numpy as np

from scenarios.report.quantities import CHANNELS, DEGREES, number_text
from scenarios.watching.reference import HANGING, WORDS, CrossValidation, comparisons
from scenarios.watching.rows import OUTPUTS
from scenarios.watching.session import UNITS, Session, Watch, WatchStep
from scenarios.watching.study import WatchOutcome, so_far
from sim.errors import DeclarationError

# ---- Events of a watch

KEPT_ROWS = 6000  # rows in the buffer: 2.5 minutes at 40 Hz
KEPT_ESTIMATES = 2000  # estimates in the buffer: half an hour at one a second
KEPT_EVENTS = 1200  # events in the buffer: two minutes at ten a second


class Event(NamedTuple):
    """An event: its name, and its data as one line of JSON."""

    name: str
    data: str


class Batch(NamedTuple):
    """Events for one reader."""

    events: list[Event]
    last: int  # number of the last event
    complete: bool  # these are all events in the buffer, not only the new ones
    over: bool  # no more events will follow


class Feed:
    """Buffer of the events of a watch, for any number of readers in their own threads.

    Memory is bounded for any length of the stream. The buffer has the last ``KEPT_EVENTS`` events,
    the last ``KEPT_ROWS`` rows, up to ``KEPT_ESTIMATES`` estimates, and the last event of every
    other name. If there are too many estimates, every second one is removed.
    """

    def __init__(
        self, rows: int = KEPT_ROWS, estimates: int = KEPT_ESTIMATES, events: int = KEPT_EVENTS
    ) -> None:
        # Event numbers begin at 1 in every watch; the token tells watches on one port apart.
        self.token = secrets.token_hex(4)
        self._changed = threading.Condition()
        self._ring: deque[tuple[int, Event]] = deque(maxlen=events)
        self._rows: deque[tuple[int, Event]] = deque()
        self._estimates: list[Event] = []
        self._latest: dict[str, Event] = {}
        self._count = self._kept_rows = self._skipped = 0
        self._stride, self._most_rows, self._most_estimates = 1, rows, estimates
        self.closed = False

    def put(self, name: str, data: str, rows: int = 0) -> None:
        """Add an event and wake the readers; ``rows`` is the number of rows in an event of rows."""
        with self._changed:
            event = Event(name, data)
            self._count += 1
            self._ring.append((self._count, event))
            if name == "rows":
                self._rows.append((rows, event))
                self._kept_rows += rows
                while len(self._rows) > 1 and self._kept_rows > self._most_rows:
                    self._kept_rows -= self._rows.popleft()[0]
            elif name == "estimates":
                self._keep_estimate(event)
            else:
                self._latest[name] = event
            self._changed.notify_all()

    def _keep_estimate(self, event: Event) -> None:
        """Keep every ``_stride``-th estimate, and the last one in any case."""
        self._latest["estimates"] = event
        self._skipped += 1
        if self._skipped >= self._stride:
            self._skipped = 0
            self._estimates.append(event)
        if len(self._estimates) > self._most_estimates:
            self._estimates = self._estimates[::2]
            self._stride *= 2

    def close(self) -> None:
        """Tell all readers that no more events follow, and wake them."""
        self.put("bye", "{}")
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    def since(self, last: int | None, timeout: float) -> Batch:
        """Return the events after number ``last``; wait up to ``timeout`` (s) for one.

        If ``last`` is None or no longer in the buffer, return all events in the buffer.
        """
        with self._changed:
            if last is None or last > self._count or self._is_lost(last):
                return Batch(self._all_events(), self._count, True, self.closed)
            if last == self._count and not self.closed:
                self._changed.wait(timeout)
            if self._is_lost(last):
                return Batch(self._all_events(), self._count, True, self.closed)
            first_new = len(self._ring) - (self._count - last)
            events = [self._ring[i][1] for i in range(first_new, len(self._ring))]
            return Batch(events, self._count, False, self.closed)

    def _is_lost(self, last: int) -> bool:
        """Return whether the event after number ``last`` has left the buffer."""
        return bool(self._ring) and last < self._ring[0][0] - 1

    def _all_events(self) -> list[Event]:
        """Return all events in the buffer in the order that a page needs: constants, rows,
        estimates, status.
        """
        constants = [self._latest["about"]] if "about" in self._latest else []
        estimates = list(self._estimates)
        if "estimates" in self._latest and self._latest["estimates"] not in estimates[-1:]:
            estimates.append(self._latest["estimates"])
        others = [
            event for name, event in self._latest.items() if name not in ("about", "estimates")
        ]
        return [*constants, *(event for _, event in self._rows), *estimates, *others]

    @property
    def kept(self) -> tuple[int, int, int]:
        """Numbers of events, rows and estimates in the buffer."""
        with self._changed:
            return len(self._ring), self._kept_rows, len(self._estimates)


# ---- Server of the page

ADDRESS = "127.0.0.1"
USUAL_PORT = 8040
MOST_READERS = 12  # simultaneous readers; a browser opens up to six connections
READER_THREAD = "page-reader"  # name of the threads that serve readers
HEARTBEAT_INTERVAL = 1.0  # s between keep-alive messages
RECONNECT_DELAY = 500  # ms after which a browser reconnects
READER_TIMEOUT = 10.0  # s after which an inactive reader is dropped
LAST_EVENTS_TIMEOUT = 0.3  # s for which the end waits for a reader to receive the last events
LONGEST_NUMBER = 15  # digits of an event number that a reader may send
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_SECURITY_HEADERS = {
    "Content-Security-Policy": _POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class PageServer(ThreadingHTTPServer):
    """HTTP server of a feed; ``address`` is the URL for a browser."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True
    request_queue_size = 32

    def __init__(self, feed: Feed, port: int | None = None) -> None:
        """Listen on ``port``; None takes the usual port or, if that is taken, any free one.

        Raise DeclarationError if ``port`` is taken.
        """
        self.feed, self.readers = feed, 0
        self.lock = threading.Lock()
        self._open: set[socket.socket] = set()
        try:
            super().__init__((ADDRESS, USUAL_PORT if port is None else port), RequestHandler)
        except OSError as error:
            if port is not None:
                what = f"port {port} cannot be had ({error.strerror})"
                raise DeclarationError(
                    what, where="--port", remedy="name another, or none"
                ) from None
            super().__init__((ADDRESS, 0), RequestHandler)
        self.port = int(self.server_address[1])
        self.address = f"http://{ADDRESS}:{self.port}/"
        self.hosts = frozenset({f"{ADDRESS}:{self.port}", f"localhost:{self.port}"})
        self._thread = threading.Thread(
            target=self.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True, name="page"
        )

    def server_bind(self) -> None:
        """Bind without a name lookup of this machine, which the base class would do."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = ADDRESS, int(self.server_address[1])

    def start(self) -> None:
        """Serve in a thread."""
        self._thread.start()

    def stop(self) -> None:
        """Tell the readers that the watch has ended, and stop."""
        self.feed.close()
        self.shutdown()
        self.server_close()
        self._thread.join(1.0)
        for thread in threading.enumerate():
            if thread.name == READER_THREAD:
                thread.join(LAST_EVENTS_TIMEOUT)
        self.drop_readers()

    def drop_readers(self) -> None:
        """Close all connections, as a network failure would; browsers reconnect."""
        with self.lock:
            readers = list(self._open)
        for connection in readers:
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Process a request as the base class does; its connection is registered meanwhile."""
        threading.current_thread().name = READER_THREAD
        with self.lock:
            self._open.add(request)
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self.lock:
                self._open.discard(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors of readers that have disconnected."""


class RequestHandler(BaseHTTPRequestHandler):
    """Handler of one request."""

    server: PageServer
    server_version, sys_version = "flightid", ""
    timeout = READER_TIMEOUT

    def do_GET(self) -> None:
        """Send the page at ``/`` or its events at ``/events``."""
        hosts = self.headers.get_all("Host") or []
        if len(hosts) != 1 or hosts[0].strip().lower() not in self.server.hosts:
            self._plain(
                HTTPStatus.MISDIRECTED_REQUEST,
                f"this page is served at {self.server.address} alone\n",
            )
            return
        url = urlsplit(self.path)
        if url.path == "/":
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", page().encode())
        elif url.path == "/events":
            query_id = "".join(parse_qs(url.query).get("last", [""]))
            self._send_events(self.headers.get("Last-Event-ID") or query_id)
        else:
            self._plain(HTTPStatus.NOT_FOUND, "there is nothing here\n")

    def _send_events(self, last_id: str) -> None:
        """Send events until the watch ends; ``last_id`` identifies the last received event."""
        with self.server.lock:
            self.server.readers += 1
            full = self.server.readers > MOST_READERS
        try:
            if full:
                self._plain(HTTPStatus.SERVICE_UNAVAILABLE, "too many pages are open\n")
            else:
                self._stream(_number_of(last_id, self.server.feed.token))
        except OSError:
            pass  # disconnected or inactive
        finally:
            with self.server.lock:
                self.server.readers -= 1

    def _stream(self, last: int | None) -> None:
        """Send the events after number ``last`` as server-sent events; None: all events."""
        feed = self.server.feed
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/event-stream")
        for name, value in _SECURITY_HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(f"retry: {RECONNECT_DELAY}\n\n".encode())
        while True:
            batch = feed.since(last, HEARTBEAT_INTERVAL)
            lines = ["event: anew\ndata: {}\n\n"] if batch.complete else []
            lines += [f"event: {event.name}\ndata: {event.data}\n\n" for event in batch.events]
            # Only the last event has a number, so that an interrupted batch is sent again in full.
            heartbeat = f"id: {feed.token}-{batch.last}\nevent: beat\ndata: {{}}\n\n"
            self.wfile.write(("".join(lines) + heartbeat).encode())
            last = batch.last
            if batch.over:
                return

    def _plain(self, status: HTTPStatus, text: str) -> None:
        self._send(status, "text/plain; charset=utf-8", text.encode())

    def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        for name, value in _SECURITY_HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing; the terminal is in use."""


def page() -> str:
    """Return the page as one HTML text."""
    package = files("scenarios.watching")
    text, style, script = (
        package.joinpath(name).read_text(encoding="utf-8")
        for name in ("page.html", "page.css", "page.js")
    )
    return text.replace("/* page.css */", style).replace("/* page.js */", script)


def _number_of(last_id: str, token: str) -> int | None:
    """Return the number of the last event that a reader has received; None if the identifier is of
    another watch or wrong.
    """
    watch, _, number = last_id.partition("-")
    valid = watch == token and number.isdecimal() and len(number) <= LONGEST_NUMBER
    return int(number) if valid else None


# ---- Content of the events: rows, estimates and status

# Output -> factor from its unit to that of the page.
FACTOR = {name: math.degrees(1.0) if UNITS[name] in DEGREES else 1.0 for name in OUTPUTS}


def about(name: str, stick_unit: str, delays: np.ndarray, reference: str | None, start: str) -> str:
    """Return the constants of the page: names of stream, reference and vehicle (``start``), units
    of the signals, and delays of the bank of filters (s).
    """
    strips = [{"name": "stick", "word": "stick", "unit": "" if stick_unit == "1" else stick_unit}]
    for output in OUTPUTS:
        unit = DEGREES.get(UNITS[output], UNITS[output])
        strips.append({"name": output, "word": CHANNELS[output], "unit": unit})
    return json_line(
        {
            "name": name,
            "strips": strips,
            "delays": (1000.0 * delays).tolist(),
            "reference": reference,
            "start": start,
        }
    )


def rows(steps: Sequence[WatchStep], offsets: Mapping[str, float]) -> str:
    """Return the times, the stick, and measured and predicted values of each output.

    Predictions are from the relinearised bank if there is one. ``offsets``: outputs at trim.
    """
    table = np.array([step.row for step in steps]).T
    states = (step.state if step.refined is None else step.refined.state for step in steps)
    predicted = np.array([state.expected for state in states]).T
    content: dict[str, Any] = {"t": rounded(table[0], 9), "stick": rounded(table[1])}
    for i, name in enumerate(OUTPUTS):
        values = predicted[i] + offsets.get(name, 0.0)
        content[name] = rounded(FACTOR[name] * table[2 + i])
        content[f"{name}_expected"] = rounded(FACTOR[name] * values)
    return json_line(content)


def estimates(time: float, items: Iterable[CrossValidation], weights: np.ndarray, kind: str) -> str:
    """Return the estimates at a time (s), and the probability of each delay (``weights``).

    ``kind`` is the estimator in words.
    """
    contents = [_item_content(item) for item in items]
    weight_numbers = rounded(weights, 6)
    return json_line(
        {"t": round(time, 6), "kind": kind, "items": contents, "weights": weight_numbers}
    )


def status(state: str, sentence: str, numbers: Mapping[str, float]) -> str:
    """Return the status of the stream; ``state`` is waiting, collecting, running or ended."""
    return json_line(
        {
            "state": state,
            "sentence": sentence,
            **{name: _number(value) for name, value in numbers.items()},
        }
    )


def _item_content(item: CrossValidation) -> dict[str, Any]:
    """Return a parameter with its estimate, its reference value, and their difference."""
    content: dict[str, Any] = {
        "name": item.name,
        "word": WORDS.get(item.name, item.name),
        "unit": "" if item.unit == "1" else item.unit,
        "told": HANGING if item.hanging else _estimate_text(item.value, item.std),
    }
    if not item.hanging:
        content |= {"value": _number(item.value), "std": _number(item.std)}
    if item.reference is not None:
        value, std = item.reference
        content |= {
            "reference": _number(value),
            "reference_std": _number(std),
            "reference_told": _estimate_text(value, std),
        }
        if item.z is not None:
            content |= {"off": round(item.z, 2), "outside": item.beyond}
    return content


def _estimate_text(value: float, std: float) -> str:
    """Return an estimate with its standard deviation."""
    return f"{number_text(value, std)} ± {number_text(std, std)}"


def rounded(values: np.ndarray, digits: int = 6) -> list[float | None]:
    """Return numbers with ``digits`` significant digits; None for those that are not finite."""
    return [
        float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()
    ]


def _number(value: float) -> float | None:
    """Return the value, or None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def json_line(content: Mapping[str, Any]) -> str:
    """Return the content as JSON in one line."""
    return json.dumps(content, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


# ---- Events of a stream while it is watched

ROW_EVENT_INTERVAL = 0.1  # s between two events of rows
MOST_EVENT_ROWS = 1000  # rows after which an event is made at once
STATE_EVENT_INTERVAL = 1.0  # s between two events of the status
RATE_AVERAGING_TIME = 5.0  # s, averaging time of the rate of rows
KINDS = {  # whether an estimate is of the relinearised bank -> the estimator in words
    True: "refined on line, delay between the grid points",
    False: "the most likely filter, deviations with what other starts led to",
}


class Follow:
    """Puts the steps of a watch into a feed; also called without steps while no row arrives."""

    def __init__(self, watch: Watch, feed: Feed) -> None:
        self._watch, self._feed = watch, feed
        self._waiting: list[WatchStep] = []  # steps that were not sent yet
        self._second = -np.inf  # second of the last estimate
        self._rows_time = self._status_time = 0.0  # of the last event of rows and of the status
        self._row_counts: deque[tuple[float, int]] = deque()  # time, number of rows until then
        self._introduced = False

    def __call__(self, steps: Sequence[WatchStep]) -> None:
        """Put steps into the feed."""
        session, now = self._watch.session, time.monotonic()
        if session is not None and session.bank is not None and not self._introduced:
            self._introduced = True
            reference = self._watch.reference
            constants = about(
                self._watch.name,
                session.stick_unit,
                session.bank.delays,
                None if reference is None else reference.name,
                session.vehicle.name,
            )
            self._feed.put("about", constants)
        self._waiting += steps
        due = now - self._rows_time >= ROW_EVENT_INTERVAL or len(self._waiting) >= MOST_EVENT_ROWS
        if session is not None and due:
            self._put_rows(session)
            self._rows_time = now
        first_rows = steps and not self._row_counts
        if now - self._status_time >= STATE_EVENT_INTERVAL or first_rows:
            self._status_time = now
            self._put_status(session, now)

    def end(self, session: Session, outcome: WatchOutcome) -> None:
        """Put the last estimate and the reason of the end into the feed."""
        self._put_rows(session)
        kind = KINDS[outcome.refined]
        if outcome.refinement is not None:
            kind = "refined over all rows"
        assert session.state is not None
        last = estimates(session.state.time, outcome.standings, outcome.weights, kind)
        self._feed.put("final", last)
        self._put_status(session, time.monotonic(), f"{self._watch.reason}; {kind}")

    def _put_rows(self, session: Session) -> None:
        """Put the waiting rows and the estimate at the end of each second into the feed."""
        steps, self._waiting = self._waiting, []
        if not steps:
            return
        self._feed.put("rows", rows(steps, session.offsets), rows=len(steps))
        seconds = [int(np.floor(step.row[0])) for step in steps]
        for step, second, next_second in zip(steps, seconds, [*seconds[1:], None], strict=True):
            if second > self._second and second != next_second:
                self._second = second
                result = so_far(session, step)
                items = comparisons(
                    result.estimate, result.derived, self._watch.reference, result.hanging
                )
                self._feed.put(
                    "estimates",
                    estimates(step.state.time, items, result.weights, KINDS[result.refined]),
                )

    def _put_status(self, session: Session | None, now: float, ended: str = "") -> None:
        """Put the status into the feed; ``ended`` is a sentence on the end of the stream."""
        bank_state = None if session is None else session.state
        count = 0 if bank_state is None else bank_state.rows_seen
        self._row_counts.append((now, count))
        while len(self._row_counts) > 2 and now - self._row_counts[0][0] > RATE_AVERAGING_TIME:
            self._row_counts.popleft()
        first_time, first_count = self._row_counts[0]
        duration = now - first_time
        numbers = {
            "rows": count,
            "left_out": self._watch.left_out,
            "spikes": 0 if session is None else session.spikes,
            "rate": (count - first_count) / duration if duration > 0 else 0.0,
            "silent": now - self._watch.heard,
            "t": np.nan if bank_state is None else bank_state.time,
        }
        self._feed.put("status", status(_state_of(session, ended), ended, numbers))


def _state_of(session: Session | None, ended: str) -> str:
    """Return the state of a stream for the page."""
    if ended:
        return "ended"
    if session is None:
        return "waiting"
    return "running" if session.bank is not None else "collecting"


@contextmanager
def served(watch: Watch, port: int | None) -> Iterator[Follow]:
    """Serve the page of a watch and yield the function that feeds it; raise DeclarationError if the
    port is taken.
    """
    with served_feed(port) as feed:
        yield Follow(watch, feed)


@contextmanager
def served_feed(port: int | None) -> Iterator[Feed]:
    """Serve a page; yield its feed."""
    feed = Feed()
    server = PageServer(feed, port)
    server.start()
    print(f"flightid: page at {server.address}", file=sys.stderr, flush=True)
    try:
        yield feed
    finally:
        server.stop()


def until_interrupted() -> None:
    """Wait for Ctrl-C, so that the page stays."""
    print("flightid: the page stays until Ctrl-C", file=sys.stderr, flush=True)
    try:
        while True:
            time.sleep(60.0)
    except KeyboardInterrupt:
        return
