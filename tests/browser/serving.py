"""Servers that a test starts on 127.0.0.1 and that end with it."""

from __future__ import annotations

import contextlib
import functools
import http.server
import os
import signal
import socket
import subprocess
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType

Served = Callable[[Path], str]
ROOT = Path(__file__).parents[2]
# s that a server may take to answer; far more than it needs, so that a busy machine does not fail
# it
PATIENCE = 60.0


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing: the browser's complaints tell what was not found."""


def free_port() -> int:
    """A port of 127.0.0.1 that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Servers:
    """Servers started within a `with` block and ended behind it."""

    def __init__(self) -> None:
        self._ends = contextlib.ExitStack()
        self._sessions: dict[str, int] = {}

    def __enter__(self) -> Servers:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ends.close()

    def folder(self, folder: Path) -> str:
        """Serve a folder's files; the address ends with a slash."""
        handler = functools.partial(_Quiet, directory=str(folder))
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        self._ends.callback(thread.join)
        self._ends.callback(server.server_close)
        self._ends.callback(server.shutdown)
        return f"http://127.0.0.1:{server.server_port}/"

    def process(self, command: Sequence[str | Path], port: int, folder: Path) -> str:
        """Start a command that serves on a port of 127.0.0.1, working in a folder; its address,
        once it answers.

        What it prints goes to `server.txt` in the folder and is shown if it ends early or never
        answers.
        """
        printed = folder / "server.txt"
        environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
        with printed.open("wb") as out:
            # A session of its own: what it starts in turn ends with it.
            running = subprocess.Popen(
                [*map(str, command)],
                cwd=folder,
                stdout=out,
                stderr=out,
                env=environment,
                start_new_session=True,
            )
        self._ends.callback(_end, running)
        address = f"http://127.0.0.1:{port}/"
        self._sessions[address] = running.pid
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline and running.poll() is None:
            if _answers(address):
                return address
            time.sleep(0.1)
        raise AssertionError(
            f"{command} does not serve {address}:\n{printed.read_text(errors='replace')}"
        )

    def busy(self, address: str) -> float:
        """Processor time that the command which serves an address has taken so far, s."""
        return _processor_time(self._sessions[address])


def _processor_time(session: int) -> float:
    """Of all processes of a session, with the children that have ended, s."""
    ticks = 0
    for each in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = each.read_text().rpartition(")")[2].split()
        except OSError:  # it ended meanwhile
            continue
        if int(fields[3]) == session:
            ticks += sum(map(int, fields[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


def _answers(address: str) -> bool:
    try:
        with urllib.request.urlopen(address, timeout=5):
            return True
    except (urllib.error.URLError, TimeoutError, ConnectionError):
        return False


def _end(running: subprocess.Popen[bytes]) -> None:
    if running.poll() is None:
        os.killpg(running.pid, signal.SIGTERM)
        try:
            running.wait(10)
        except subprocess.TimeoutExpired:
            os.killpg(running.pid, signal.SIGKILL)
            running.wait()
