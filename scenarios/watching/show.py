"""What a stream shows while it arrives, a live table or a line a second, and what it ends with."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace

import numpy as np

from scenarios.watching.reference import (
    WORDS,
    View,
    comparisons,
    live_table,
    outside_of,
    vehicle_sentence,
)
from scenarios.watching.reference import line as view_line
from scenarios.watching.session import Session, Step, Watch
from scenarios.watching.spectral_study import beside_lines
from scenarios.watching.study import Outcome, so_far

REFRESH = 0.25  # s between two drawings of the live table


def view_of(watch: Watch, session: Session, step: Step | None = None) -> View:
    """The stream after a step, the last when None."""
    # A step that is named is news, however long its row waited to be filtered.
    silent = time.monotonic() - watch.heard if step is None else 0.0
    bank, step = session.bank, session.last if step is None else step
    assert bank is not None and step is not None
    found, state = so_far(session, step), step.state
    items = comparisons(found.estimate, found.derived, watch.reference, found.hanging)
    sound = bool(state.sound.any())
    return View(
        watch.name,
        state.time,
        state.rows_seen,
        watch.left_out,
        step.spikes,
        items,
        bank.delays,
        found.weights,
        silent,
        sound,
        found.refined,
    )


class Show:
    """Draws a live table on a terminal, else prints a line for every second of data."""

    def __init__(self, watch: Watch) -> None:
        from rich.live import Live

        from scenarios.report.quantities import console

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
                self.live.update(live_table(view_of(self._watch, session)), refresh=True)
            return
        # Of those that were collected before the filter started only the last counts.
        told = list(steps)[-1:] if self._said == -np.inf else steps
        seconds = [int(np.floor(step.row[0])) for step in told]
        for step, second, after in zip(told, seconds, [*seconds[1:], None], strict=False):
            if second > self._said and second != after:
                self._said = second
                print(view_line(view_of(self._watch, session, step)), flush=True)


@contextmanager
def display(watch: Watch) -> Iterator[Show]:
    """Gives what shows the stream's states; on a terminal its live table stands while the body
    runs.
    """
    show = Show(watch)
    with show.live if show.live is not None else nullcontext():
        yield show


def print_end(watch: Watch, session: Session, end: Outcome) -> None:
    """The last table, why the stream ended, and what lies outside the reference's bounds."""
    from scenarios.report.quantities import console

    terminal = console()
    view = replace(
        view_of(watch, session),
        standings=end.standings,
        weights=end.weights,
        silent=0.0,
        refined=end.refined,
    )
    kind = (
        "refined over all rows"
        if end.found is not None
        else "refined on line"
        if end.refined
        else "on line, the most likely filter"
    )
    terminal.print(f"{watch.reason}; {kind}:", highlight=False)
    terminal.print(vehicle_sentence(session.vehicle), highlight=False)
    terminal.print(live_table(view))
    for words in beside_lines(session.spectral, (end.found or end.online).estimate):
        terminal.print(words, highlight=False)
    hanging = [WORDS.get(item.name, item.name) for item in end.standings if item.hanging]
    if hanging:
        what = (
            f"another start within its prior would have led elsewhere: {', '.join(hanging)}; name "
            "a nearer start with --vehicle"
        )
        terminal.print(
            f"{what}, or leave out --no-refine" if not watch.refine else what, highlight=False
        )
    outside = outside_of(end.standings)
    if watch.reference is not None:
        inside = (
            "inside the bounds of"
            if any(item.z is not None for item in end.standings)
            else "nothing to hold against"
        )
        said = (
            f"outside the bounds of {watch.reference.name}: {', '.join(outside)}"
            if outside
            else f"{inside} {watch.reference.name}"
        )
        terminal.print(said, highlight=False)
    if watch.beside:
        terminal.print(
            f"note: {watch.beside} was found beside the record and read for its units",
            highlight=False,
        )
