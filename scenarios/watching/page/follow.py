"""The page of a watch fed with rows and estimates as events."""

from __future__ import annotations

import json
import math
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from scenarios.report.quantities import CHANNELS, DEGREES, number_text
from scenarios.watching.page.server import Feed, PageServer
from scenarios.watching.reference import HANGING, WORDS, CrossValidation, comparisons
from scenarios.watching.rows import OUTPUTS
from scenarios.watching.session import UNITS, Session, Step, Watch
from scenarios.watching.study import Outcome, so_far

# ---- What rows

FACTOR = {name: math.degrees(1.0) if UNITS[name] in DEGREES else 1.0 for name in OUTPUTS}


def about(name: str, stick_unit: str, delays: np.ndarray, reference: str | None, start: str) -> str:
    """What does not change: names and units of the strips, the delays (ms), the study that is
    compared with.
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


def rows(steps: Sequence[Step], offsets: Mapping[str, float]) -> str:
    """Times, the stick, and of each channel what was measured and what the filter expected before
    it saw the sample.
    """
    table = np.array([step.row for step in steps]).T
    expected = np.array([_expected(step) for step in steps]).T
    out: dict[str, Any] = {"t": _rounded(table[0], 9), "stick": _rounded(table[1])}
    for at, name in enumerate(OUTPUTS):
        out[name] = _rounded(FACTOR[name] * table[2 + at])
        out[f"{name}_expected"] = _rounded(FACTOR[name] * (expected[at] + offsets.get(name, 0.0)))
    return _line(out)


def estimates(time: float, items: Iterable[CrossValidation], weights: np.ndarray, kind: str) -> str:
    """The quantities as the terminal's table has them, and the likelihood of each delay; ``kind``
    says whose estimate it is.
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
    """How the stream stands: ``state`` is waiting, collecting, running or ended."""
    return _line(
        {
            "state": state,
            "sentence": sentence,
            **{name: _number(value) for name, value in numbers.items()},
        }
    )


def _item(each: CrossValidation) -> dict[str, Any]:
    told = (
        HANGING
        if each.hanging
        else f"{number_text(each.value, each.std)} ± {number_text(each.std, each.std)}"
    )
    out: dict[str, Any] = {
        "name": each.name,
        "word": WORDS.get(each.name, each.name),
        "unit": "" if each.unit == "1" else each.unit,
        "told": told,
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


def _expected(step: Step) -> np.ndarray:
    """By the bank that was linearised anew, where there is one."""
    state = step.state if step.refined is None else step.refined.state
    return state.expected


def _rounded(values: np.ndarray, digits: int = 6) -> list[float | None]:
    """Significant digits enough for a page; None for what is missing."""
    return [
        float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()
    ]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _line(content: Mapping[str, Any]) -> str:
    return json.dumps(content, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


# ---- Feeds the page while a stream is watched

FRAME = 0.1  # s between two events of rows
STANDING = 1.0  # s between two of how the stream stands
RECENT = 5.0  # s over which the rate is taken
KINDS = {
    True: "refined on line, delay between the grid points",
    False: "the most likely filter, deviations with what other starts led to",
}


class Follow:
    """Tells a feed what a watch does; called with the steps as they are made, and with none when
    nothing came.
    """

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
            named = (
                self._watch.name,
                session.stick_unit,
                session.bank.delays,
                None if known is None else known.name,
                session.vehicle.name,
            )
            self._feed.put("about", about(*named))
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
                found = so_far(session, step)
                items = comparisons(
                    found.estimate, found.derived, self._watch.reference, found.hanging
                )
                self._feed.put(
                    "estimates",
                    estimates(step.state.time, items, found.weights, KINDS[found.refined]),
                )

    def _stand(self, session: Session | None, now: float, ended: str = "") -> None:
        rows = 0 if session is None or session.state is None else session.state.rows_seen
        self._counted.append((now, rows))
        while len(self._counted) > 2 and now - self._counted[0][0] > RECENT:
            self._counted.popleft()
        begun, before = self._counted[0]
        passed = now - begun
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
    """Gives what feeds the page, which is served while the body runs.

    Raises DeclarationError where the port is taken.
    """
    with served_feed(port) as feed:
        yield Follow(watch, feed)


@contextmanager
def served_feed(port: int | None) -> Iterator[Feed]:
    """Gives a feed whose page is served while the body runs."""
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
