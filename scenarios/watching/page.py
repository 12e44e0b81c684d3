"""The web page of `watch`: a ring buffer of events, a local HTTP server, and the functions that
turn rows and estimates into events.

The server refuses requests whose Host header is not its own. Otherwise a page of another site,
whose name resolves to 127.0.0.1 (DNS rebinding), could read the data.
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

KEPT_ROWS = 6000  # rows kept, two and a half minutes at 40 Hz
KEPT_ESTIMATES = 2000  # estimates kept, half an hour at one a second
KEPT_EVENTS = 1200  # two minutes of ten events a second


class Event(NamedTuple):
    """An event: its name, and its data as one line of JSON."""

    name: str
    data: str


class Batch(NamedTuple):
    """Events for one reader.

    ``complete``: they are all events in the buffer, not only the new ones; ``last``: number of the
    last event; ``over``: no more events will follow.
    """

    events: list[Event]
    last: int
    complete: bool
    over: bool


class Feed:
    """Buffer of the events of a watch, for any number of readers in their own threads.

    Memory is bounded for any length of the stream: the buffer keeps the last ``KEPT_EVENTS``
    events, the last ``KEPT_ROWS`` rows, estimates thinned to every second one when there are too
    many, and the last event of every other name.
    """

    def __init__(
        self, rows: int = KEPT_ROWS, estimates: int = KEPT_ESTIMATES, events: int = KEPT_EVENTS
    ) -> None:
        self.token = secrets.token_hex(4)  # another watch on the same port numbers its events anew
        self._changed = threading.Condition()
        self._ring: deque[tuple[int, Event]] = deque(maxlen=events)
        self._rows: deque[tuple[int, Event]] = deque()
        self._estimates: list[Event] = []
        self._latest: dict[str, Event] = {}
        self._count = self._kept_rows = self._skipped = 0
        self._stride, self._most_rows, self._most_estimates = 1, rows, estimates
        self.closed = False

    def put(self, name: str, data: str, rows: int = 0) -> None:
        """Add an event and wake the readers; ``rows``: rows of the stream in an event of rows."""
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
        """Tell all readers that no more events follow, and release them."""
        self.put("bye", "{}")
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    def since(self, last: int | None, timeout: float) -> Batch:
        """Return the events after number ``last``, after waiting up to ``timeout`` (s) for one; all
        events in the buffer if ``last`` is None or no longer there.
        """
        with self._changed:
            if last is None or last > self._count or (self._ring and last < self._ring[0][0] - 1):
                return Batch(self._whole(), self._count, True, self.closed)
            if last == self._count and not self.closed:
                self._changed.wait(timeout)
            if self._ring and last < self._ring[0][0] - 1:
                return Batch(self._whole(), self._count, True, self.closed)
            missed = self._count - last
            events = [self._ring[at][1] for at in range(len(self._ring) - missed, len(self._ring))]
            return Batch(events, self._count, False, self.closed)

    def _whole(self) -> list[Event]:
        """Return all events in the buffer in the order that a page needs: constants, rows,
        estimates, status.
        """
        first = [self._latest[name] for name in ("about",) if name in self._latest]
        estimates = list(self._estimates)
        if "estimates" in self._latest and self._latest["estimates"] not in estimates[-1:]:
            estimates.append(self._latest["estimates"])
        last = [event for name, event in self._latest.items() if name not in ("about", "estimates")]
        return [*first, *(event for _, event in self._rows), *estimates, *last]

    @property
    def kept(self) -> tuple[int, int, int]:
        """Numbers of events, rows and estimates in the buffer."""
        with self._changed:
            return len(self._ring), self._kept_rows, len(self._estimates)


# ---- The page's server

ADDRESS = "127.0.0.1"
USUAL_PORT = 8040
MOST_READERS = 12  # simultaneous readers; a browser opens up to six connections
HEARTBEAT_INTERVAL = 1.0  # s between keep-alive messages
RECONNECT_DELAY = 500  # ms after which a browser reconnects
READER_TIMEOUT = 10.0  # s after which an inactive reader is dropped
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_GUARDS = {
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
        """Listen on ``port``; by default on the usual port if it is free, else on any.

        Raises DeclarationError if ``port`` is taken.
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
        # A short while for the last words; a reader that takes none is dropped.
        for thread in [each for each in threading.enumerate() if each.name == "page-reader"]:
            thread.join(0.3)
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
        """Process a request as the base class does; the connection is registered while it is
        open.
        """
        threading.current_thread().name = "page-reader"
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
            self._events(
                self.headers.get("Last-Event-ID") or "".join(parse_qs(url.query).get("last", [""]))
            )
        else:
            self._plain(HTTPStatus.NOT_FOUND, "there is nothing here\n")

    def _events(self, last_id: str) -> None:
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
        feed = self.server.feed
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/event-stream")
        for name, value in _GUARDS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(f"retry: {RECONNECT_DELAY}\n\n".encode())
        while True:
            batch = feed.since(last, HEARTBEAT_INTERVAL)
            lines = ["event: anew\ndata: {}\n\n"] if batch.complete else []
            lines += [f"event: {event.name}\ndata: {event.data}\n\n" for event in batch.events]
            # Only the last event has a number, so that an interrupted batch is sent again in full.
            end = f"id: {feed.token}-{batch.last}\nevent: beat\ndata: {{}}\n\n"
            self.wfile.write(("".join(lines) + end).encode())
            last = batch.last
            if batch.over:
                return

    def _plain(self, status: HTTPStatus, text: str) -> None:
        self._send(status, "text/plain; charset=utf-8", text.encode())

    def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        for name, value in _GUARDS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing; the terminal is in use."""


def page() -> str:
    """Return the page as one HTML text."""
    here = files("scenarios.watching")
    text, style, script = (
        here.joinpath(name).read_text(encoding="utf-8")
        for name in ("page.html", "page.css", "page.js")
    )
    return text.replace("/* page.css */", style).replace("/* page.js */", script)


def _number_of(last_id: str, token: str) -> int | None:
    """Return the number of the last event that a reader has received from this watch, else None."""
    of, _, number = last_id.partition("-")
    return int(number) if of == token and number.isdecimal() and len(number) < 16 else None


# ---- What the events hold: rows, estimates and status

FACTOR = {name: math.degrees(1.0) if UNITS[name] in DEGREES else 1.0 for name in OUTPUTS}


def about(name: str, stick_unit: str, delays: np.ndarray, reference: str | None, start: str) -> str:
    """Constants of the page: names and units of the signals, the delays (ms), the reference
    study.
    """
    strips = [{"name": "stick", "word": "stick", "unit": "" if stick_unit == "1" else stick_unit}]
    strips += [
        {"name": each, "word": CHANNELS[each], "unit": DEGREES.get(UNITS[each], UNITS[each])}
        for each in OUTPUTS
    ]
    return _line(
        {
            "name": name,
            "strips": strips,
            "delays": (1000.0 * delays).tolist(),
            "reference": reference,
            "start": start,
        }
    )


def rows(steps: Sequence[WatchStep], offsets: Mapping[str, float]) -> str:
    """Return the times, inputs, and for each channel the measured and the predicted values."""
    table = np.array([step.row for step in steps]).T
    expected = np.array([_expected(step) for step in steps]).T
    out: dict[str, Any] = {"t": _rounded(table[0], 9), "stick": _rounded(table[1])}
    for at, name in enumerate(OUTPUTS):
        out[name] = _rounded(FACTOR[name] * table[2 + at])
        out[f"{name}_expected"] = _rounded(FACTOR[name] * (expected[at] + offsets.get(name, 0.0)))
    return _line(out)


def estimates(time: float, items: Iterable[CrossValidation], weights: np.ndarray, kind: str) -> str:
    """Estimates as in the terminal's table, and the probability of each delay; ``kind`` names the
    estimator.
    """
    return _line(
        {
            "t": round(time, 6),
            "kind": kind,
            "items": [_item(each) for each in items],
            "weights": _rounded(weights, 6),
        }
    )


def status(state: str, sentence: str, numbers: Mapping[str, float]) -> str:
    """Status of the stream; ``state`` is waiting, collecting, running or ended."""
    return _line(
        {
            "state": state,
            "sentence": sentence,
            **{name: _number(value) for name, value in numbers.items()},
        }
    )


def _item(each: CrossValidation) -> dict[str, Any]:
    text = (
        HANGING
        if each.hanging
        else f"{number_text(each.value, each.std)} ± {number_text(each.std, each.std)}"
    )
    out: dict[str, Any] = {
        "name": each.name,
        "word": WORDS.get(each.name, each.name),
        "unit": "" if each.unit == "1" else each.unit,
        "told": text,
    }
    out |= {} if each.hanging else {"value": _number(each.value), "std": _number(each.std)}
    if each.reference is not None:
        value, std = each.reference
        out |= {
            "reference": _number(value),
            "reference_std": _number(std),
            "reference_told": f"{number_text(value, std)} ± {number_text(std, std)}",
        }
        out |= {} if each.z is None else {"off": round(each.z, 2), "outside": each.beyond}
    return out


def _expected(step: WatchStep) -> np.ndarray:
    """Predicted outputs, of the relinearised bank if there is one."""
    state = step.state if step.refined is None else step.refined.state
    return state.expected


def _rounded(values: np.ndarray, digits: int = 6) -> list[float | None]:
    """Return the numbers with enough significant digits for a page; None for missing ones."""
    return [
        float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()
    ]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _line(content: Mapping[str, Any]) -> str:
    return json.dumps(content, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


# ---- Feeds the page while a stream is watched

ROW_EVENT_INTERVAL = 0.1  # s between two events of rows
STATE_EVENT_INTERVAL = 1.0  # s between two of how the stream stands
RATE_AVERAGING_TIME = 5.0  # s over which the rate is taken
KINDS = {
    True: "refined on line, delay between the grid points",
    False: "the most likely filter, deviations with what other starts led to",
}


class Follow:
    """Callable that puts the steps of a watch into a feed; called without steps when no row
    came.
    """

    def __init__(self, watch: Watch, feed: Feed) -> None:
        self._watch, self._feed = watch, feed
        self._waiting: list[WatchStep] = []
        self._second, self._sent, self._stood = -np.inf, 0.0, 0.0
        self._counted: deque[tuple[float, int]] = deque()
        self._introduced = False

    def __call__(self, steps: Sequence[WatchStep]) -> None:
        """Put steps into the feed."""
        session, now = self._watch.session, time.monotonic()
        if session is not None and session.bank is not None and not self._introduced:
            self._introduced = True
            reference = self._watch.reference
            named = (
                self._watch.name,
                session.stick_unit,
                session.bank.delays,
                None if reference is None else reference.name,
                session.vehicle.name,
            )
            self._feed.put("about", about(*named))
        self._waiting += steps
        if session is not None and (
            now - self._sent >= ROW_EVENT_INTERVAL or len(self._waiting) >= 1000
        ):
            self._rows(session)
            self._sent = now
        if now - self._stood >= STATE_EVENT_INTERVAL or (steps and not self._counted):
            self._stood = now
            self._stand(session, now)

    def end(self, session: Session, end: WatchOutcome) -> None:
        """Put the last estimate and the reason of the end into the feed."""
        self._rows(session)
        kind = "refined over all rows" if end.refinement is not None else KINDS[end.refined]
        assert session.state is not None
        self._feed.put("final", estimates(session.state.time, end.standings, end.weights, kind))
        self._stand(session, time.monotonic(), f"{self._watch.reason}; {kind}")

    def _rows(self, session: Session) -> None:
        steps, self._waiting = self._waiting, []
        if not steps:
            return
        self._feed.put("rows", rows(steps, session.offsets), rows=len(steps))
        seconds = [int(np.floor(step.row[0])) for step in steps]
        for step, second, after in zip(steps, seconds, [*seconds[1:], None], strict=True):
            if second > self._second and second != after:
                self._second = second
                result = so_far(session, step)
                items = comparisons(
                    result.estimate, result.derived, self._watch.reference, result.hanging
                )
                self._feed.put(
                    "estimates",
                    estimates(step.state.time, items, result.weights, KINDS[result.refined]),
                )

    def _stand(self, session: Session | None, now: float, ended: str = "") -> None:
        rows = 0 if session is None or session.state is None else session.state.rows_seen
        self._counted.append((now, rows))
        while len(self._counted) > 2 and now - self._counted[0][0] > RATE_AVERAGING_TIME:
            self._counted.popleft()
        first_time, before = self._counted[0]
        passed = now - first_time
        rate = (rows - before) / passed if passed > 0 else 0.0
        numbers = {
            "rows": rows,
            "left_out": self._watch.left_out,
            "spikes": 0 if session is None else session.spikes,
            "rate": rate,
        }
        numbers |= {
            "silent": now - self._watch.heard,
            "t": np.nan if session is None or session.state is None else session.state.time,
        }
        state = (
            "ended"
            if ended
            else "waiting"
            if session is None
            else "running"
            if session.bank is not None
            else "collecting"
        )
        self._feed.put("status", status(state, ended, numbers))


@contextmanager
def served(watch: Watch, port: int | None) -> Iterator[Follow]:
    """Context manager that serves the page and gives a function that feeds it.

    Raises DeclarationError if the port is taken.
    """
    with served_feed(port) as feed:
        yield Follow(watch, feed)


@contextmanager
def served_feed(port: int | None) -> Iterator[Feed]:
    """Context manager that gives a feed whose page is served."""
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
