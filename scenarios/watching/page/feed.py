"""Events of a watch, numbered and kept in a ring: who was away gets what was missed, who was away too long gets all that is kept."""

from __future__ import annotations

import secrets
import threading
from collections import deque
from typing import NamedTuple

ROWS, ESTIMATES = 6000, 2000  # kept: two and a half minutes at 40 Hz, half an hour at one estimate a second
EVENTS = 1200  # two minutes of ten events a second


class Event(NamedTuple):
    """An event on its way: its name, its data as one line of JSON."""

    name: str
    data: str


class Batch(NamedTuple):
    """Events for one reader: ``complete`` when they are all that is kept instead of what came since; ``last`` the number of the last of them.

    ``over`` where nothing comes after them.
    """

    events: list[Event]
    last: int
    complete: bool
    over: bool


class Feed:
    """What a watch has told so far, for any number of readers in their own threads.

    Memory is bounded whatever the length of the stream: the last ``EVENTS`` events; rows by their number, estimates thinned to every
    second one whenever there are too many; of everything else the last of each name.
    """

    def __init__(self, rows: int = ROWS, estimates: int = ESTIMATES, events: int = EVENTS) -> None:
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
        """Tell all readers; ``rows`` how many rows of the stream an event of rows holds."""
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
        """Every ``_stride``-th estimate is kept, and the last of all in any case."""
        self._latest["estimates"] = event
        self._skipped += 1
        if self._skipped >= self._stride:
            self._skipped = 0
            self._estimates.append(event)
        if len(self._estimates) > self._most_estimates:
            self._estimates = self._estimates[::2]
            self._stride *= 2

    def close(self) -> None:
        """Tell all readers that nothing more comes, and let them go."""
        self.put("bye", "{}")
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    def since(self, last: int | None, timeout: float) -> Batch:
        """What came after event ``last``, waiting up to ``timeout`` (s) for it; all that is kept where ``last`` is None or forgotten."""
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
        """All that is kept, in an order that a page can follow: what does not change, rows, estimates, and how it stands."""
        first = [self._latest[name] for name in ("about",) if name in self._latest]
        estimates = list(self._estimates)
        if "estimates" in self._latest and self._latest["estimates"] not in estimates[-1:]:
            estimates.append(self._latest["estimates"])
        last = [event for name, event in self._latest.items() if name not in ("about", "estimates")]
        return [*first, *(event for _, event in self._rows), *estimates, *last]

    @property
    def kept(self) -> tuple[int, int, int]:
        """How many events, rows and estimates are kept."""
        with self._changed:
            return len(self._ring), self._kept_rows, len(self._estimates)
