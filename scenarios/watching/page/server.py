"""The page's server: bound to 127.0.0.1 alone, and deaf to requests under any other host name.

A page of another site could have its own name resolve to 127.0.0.1 and then read what is served there (DNS rebinding); its requests
bear that name in their Host header, and are refused.
"""

from __future__ import annotations

import socket
import socketserver
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs, urlsplit

from scenarios.watching.page.feed import Feed
from sim.errors import DeclarationError

ADDRESS = "127.0.0.1"
USUAL_PORT = 8040
READERS = 12  # at once; a browser has six connections to a host
BEAT = 1.0  # s: an event or a sign of life
RETRY = 500  # ms after which a browser comes back
STUCK = 10.0  # s after which a reader that takes nothing is let go
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"  # noqa: E501
_GUARDS = {
    "Content-Security-Policy": _POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class PageServer(ThreadingHTTPServer):
    """Serves a feed until ``stop``; ``address`` is where a browser finds it."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True
    request_queue_size = 32

    def __init__(self, feed: Feed, port: int | None = None) -> None:
        """Listen on ``port``, or on the usual one where it is free, else on any.

        Raises DeclarationError where ``port`` is taken.
        """
        self.feed, self.readers = feed, 0
        self.lock = threading.Lock()
        self._open: set[socket.socket] = set()
        try:
            super().__init__((ADDRESS, USUAL_PORT if port is None else port), Reader)
        except OSError as error:
            if port is not None:
                what = f"port {port} cannot be had ({error.strerror})"
                raise DeclarationError(what, where="--port", remedy="name another, or none") from None
            super().__init__((ADDRESS, 0), Reader)
        self.port = int(self.server_address[1])
        self.address = f"http://{ADDRESS}:{self.port}/"
        self.hosts = frozenset({f"{ADDRESS}:{self.port}", f"localhost:{self.port}"})
        self._thread = threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True, name="page")

    def server_bind(self) -> None:
        """Bind without asking a name server what this machine is called, as the library's would."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = ADDRESS, int(self.server_address[1])

    def start(self) -> None:
        """Serve from now on, in a thread of its own."""
        self._thread.start()

    def stop(self) -> None:
        """Tell the readers that it is over, and end."""
        self.feed.close()
        self.shutdown()
        self.server_close()
        self._thread.join(1.0)
        # A short while for the last words; a reader that takes none is dropped.
        for thread in [each for each in threading.enumerate() if each.name == "page-reader"]:
            thread.join(0.3)
        self.drop_readers()

    def drop_readers(self) -> None:
        """Cut all connections, as a network would; browsers come back."""
        with self.lock:
            held = list(self._open)
        for connection in held:
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """As the library's, with the connection known while it is open."""
        threading.current_thread().name = "page-reader"
        with self.lock:
            self._open.add(request)
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self.lock:
                self._open.discard(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A reader that went away is no error of the watch."""


class Reader(BaseHTTPRequestHandler):
    """One request."""

    server: PageServer
    server_version, sys_version = "flightid", ""
    timeout = STUCK

    def do_GET(self) -> None:
        """The page at ``/``, its events at ``/events``."""
        hosts = self.headers.get_all("Host") or []
        if len(hosts) != 1 or hosts[0].strip().lower() not in self.server.hosts:
            self._plain(HTTPStatus.MISDIRECTED_REQUEST, f"this page is served at {self.server.address} alone\n")
            return
        asked = urlsplit(self.path)
        if asked.path == "/":
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", page().encode())
        elif asked.path == "/events":
            self._events(self.headers.get("Last-Event-ID") or "".join(parse_qs(asked.query).get("last", [""])))
        else:
            self._plain(HTTPStatus.NOT_FOUND, "there is nothing here\n")

    def _events(self, last_id: str) -> None:
        with self.server.lock:
            self.server.readers += 1
            full = self.server.readers > READERS
        try:
            if full:
                self._plain(HTTPStatus.SERVICE_UNAVAILABLE, "too many pages are open\n")
            else:
                self._stream(_number_of(last_id, self.server.feed.token))
        except OSError:
            pass  # it went away, or takes nothing
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
        self.wfile.write(f"retry: {RETRY}\n\n".encode())
        while True:
            batch = feed.since(last, BEAT)
            lines = ["event: anew\ndata: {}\n\n"] if batch.complete else []
            lines += [f"event: {event.name}\ndata: {event.data}\n\n" for event in batch.events]
            # The number stands with the last event alone: who loses the line within a batch gets all of it again.
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
        """Say nothing: the terminal is the watch's."""


def page() -> str:
    """The page as one file."""
    here = files("scenarios.watching.page")
    text, style, script = (here.joinpath(name).read_text(encoding="utf-8") for name in ("page.html", "page.css", "page.js"))
    return text.replace("/* page.css */", style).replace("/* page.js */", script)


def _number_of(last_id: str, token: str) -> int | None:
    """The number of the event that a reader saw last; None where it saw none of this watch."""
    of, _, number = last_id.partition("-")
    return int(number) if of == token and number.isdecimal() and len(number) < 16 else None
