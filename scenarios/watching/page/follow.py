"""Feeds the page while a stream is watched: rows ten times a second, estimates for every second of data, and how the stream stands."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from scenarios.watching.estimates import so_far
from scenarios.watching.page import messages
from scenarios.watching.page.feed import Feed
from scenarios.watching.page.server import PageServer
from scenarios.watching.session import Session, Step
from scenarios.watching.stream import Watch
from scenarios.watching.study import Outcome
from scenarios.watching.table import standings

FRAME = 0.1  # s between two events of rows
STANDING = 1.0  # s between two of how the stream stands
RECENT = 5.0  # s over which the rate is taken
KINDS = {True: "refined on line, delay between the grid points", False: "the most likely filter, deviations with what other starts led to"}


class Follow:
    """Tells a feed what a watch does; called with the steps as they are made, and with none when nothing came."""

    def __init__(self, watch: Watch, feed: Feed) -> None:
        self._watch, self._feed = watch, feed
        self._waiting: list[Step] = []
        self._second, self._sent, self._stood = -np.inf, 0.0, 0.0
        self._counted: deque[tuple[float, int]] = deque()
        self._introduced = False

    def __call__(self, steps: Sequence[Step]) -> None:
        """Take steps along."""
        session, now = self._watch.session, time.monotonic()
        if session is not None and session.bank is not None and not self._introduced:
            self._introduced = True
            known = self._watch.reference
            named = (self._watch.name, session.stick_unit, session.bank.delays, None if known is None else known.name, session.vehicle.name)
            self._feed.put("about", messages.about(*named))
        self._waiting += steps
        if session is not None and (now - self._sent >= FRAME or len(self._waiting) >= 1000):
            self._rows(session)
            self._sent = now
        if now - self._stood >= STANDING or (steps and not self._counted):
            self._stood = now
            self._stand(session, now)

    def end(self, session: Session, end: Outcome) -> None:
        """Tell the last numbers and why the stream ended."""
        self._rows(session)
        kind = "refined over all rows" if end.found is not None else KINDS[end.refined]
        assert session.state is not None
        self._feed.put("final", messages.estimates(session.state.time, end.standings, end.weights, kind))
        self._stand(session, time.monotonic(), f"{self._watch.reason}; {kind}")

    def _rows(self, session: Session) -> None:
        steps, self._waiting = self._waiting, []
        if not steps:
            return
        self._feed.put("rows", messages.rows(steps, session.offsets), rows=len(steps))
        seconds = [int(np.floor(step.row[0])) for step in steps]
        for step, second, after in zip(steps, seconds, [*seconds[1:], None], strict=True):
            if second > self._second and second != after:
                self._second = second
                found = so_far(session, step)
                items = standings(found.estimate, found.derived, self._watch.reference, found.hanging)
                self._feed.put("estimates", messages.estimates(step.state.time, items, found.weights, KINDS[found.refined]))

    def _stand(self, session: Session | None, now: float, ended: str = "") -> None:
        rows = 0 if session is None or session.state is None else session.state.rows_seen
        self._counted.append((now, rows))
        while len(self._counted) > 2 and now - self._counted[0][0] > RECENT:
            self._counted.popleft()
        begun, before = self._counted[0]
        passed = now - begun
        rate = (rows - before) / passed if passed > 0 else 0.0
        numbers = {"rows": rows, "left_out": self._watch.left_out, "spikes": 0 if session is None else session.spikes, "rate": rate}
        numbers |= {"silent": now - self._watch.heard, "t": np.nan if session is None or session.state is None else session.state.time}
        state = "ended" if ended else "waiting" if session is None else "running" if session.bank is not None else "collecting"
        self._feed.put("status", messages.status(state, ended, numbers))


@contextmanager
def served(watch: Watch, port: int | None) -> Iterator[Follow]:
    """Gives what feeds the page, which is served while the body runs.

    Raises DeclarationError where the port is taken.
    """
    feed = Feed()
    server = PageServer(feed, port)
    server.start()
    print(f"flightid: page at {server.address}", file=sys.stderr, flush=True)
    try:
        yield Follow(watch, feed)
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
