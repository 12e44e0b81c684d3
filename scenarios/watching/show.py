"""Display of a watch, as a live table or a line a second, its final print, and the study folder of
a watch in the frequency domain.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.estimate import Estimate
from scenarios.files.sources import InputFile, versions
from scenarios.files.writing import study_folder, write_json, write_record, write_text
from scenarios.report.document import (
    Block,
    Page,
    Section,
    as_sentence,
    capital,
    now,
    reproduction,
    section,
)
from scenarios.report.folder import write_page
from scenarios.report.quantities import console, number_text
from scenarios.report.shared_tables import derived_table, estimates_table, fixed_table
from scenarios.report.summary import TableColumn, print_table
from scenarios.studies.comparison import SCHEMA
from scenarios.studies.published import Row
from scenarios.watching.history_figure import history_section
from scenarios.watching.reference import (
    WORDS,
    CrossValidation,
    Reference,
    View,
    against,
    against_items,
    comparisons,
    live_table,
    rows_and_vehicle,
    usual_command,
    vehicle_sentence,
)
from scenarios.watching.reference import line as view_line
from scenarios.watching.session import Session, Watch, WatchStep
from scenarios.watching.spectral import (
    UNKNOWN,
    Point,
    SpectralSession,
    derived_quantities,
    estimate_of,
    history_csv,
    last_estimate,
    record_of,
    spectral_content,
    undetermined,
)
from scenarios.watching.study import (
    NAME,
    WatchOutcome,
    differences_table,
    reference_content,
    so_far,
)

SHOWN = 4  # parameters in a line, the best known ones


def line(session: SpectralSession, point: Point, left_out: int) -> str:
    """A second of the stream in one line."""
    rows = estimate_of(point, session)[:SHOWN]
    texts = [
        f"{each['name']} {number_text(each['value'], each['std'])} +- "
        f"{number_text(each['std'], each['std'])}"
        for each in rows
    ]
    lost = f", {left_out} line{'s' * (left_out != 1)} left out" if left_out else ""
    return f"{session.name}, {point.time:.2f} s{lost}: {', '.join(texts) or UNKNOWN}"


def items_of(
    session: SpectralSession, estimate: Estimate | None, reference: Reference | None
) -> tuple[CrossValidation, ...]:
    """The last estimate against the reference where there is one."""
    return (
        ()
        if estimate is None
        else comparisons(estimate, derived_quantities(session, estimate), reference)
    )


def print_spectral_end(watch: Watch, session: SpectralSession) -> None:
    """Print the last estimate in a table, undetermined parameters, and the reference."""
    out, found = console(), last_estimate(session)
    items = items_of(session, found, watch.reference)
    out.print(
        f"{watch.reason}; equation error in the frequency domain over {session.rows} rows:",
        highlight=False,
    )
    out.print(vehicle_sentence(session.vehicle), highlight=False)
    columns = [
        TableColumn(
            "quantity",
            [
                item.name.replace("_", " ") if item.name == item.name.lower() else item.name
                for item in items
            ],
            left=True,
        ),
        TableColumn("unit", [item.unit for item in items], left=True),
        TableColumn("estimate", [number_text(item.value, item.std) for item in items]),
        TableColumn("+- sigma", [number_text(item.std, item.std) for item in items]),
    ]
    if any(item.reference is not None for item in items):
        columns += [
            TableColumn(
                "reference",
                [number_text(*item.reference) if item.reference else "" for item in items],
            ),
            TableColumn(
                "off, sigmas", ["-" if item.z is None else f"{item.z:+.1f}" for item in items]
            ),
        ]
    print_table(out, "", columns)
    if unknown := undetermined(session):
        out.print(f"{UNKNOWN} by this stream: {', '.join(unknown)}", highlight=False)
    if watch.reference is not None:
        out.print(against_items(items, watch.reference.name), highlight=False)


def beside_lines(session: SpectralSession | None, bank: Estimate) -> list[str]:
    """The estimate in the frequency domain against that of the bank, whose data it shares."""
    estimate = None if session is None else last_estimate(session)
    if estimate is None:
        return []
    parts = []
    for name, value, std in zip(
        estimate.names, estimate.values.tolist(), estimate.std.tolist(), strict=True
    ):
        if name in bank.names:
            # Of two estimates from the same data the larger deviation is the measure.
            off = (value - bank.value(name)) / max(std, bank.sigma(name), 1e-300)
            parts.append(
                f"{name} {number_text(value, std)} +- {number_text(std, std)} ({off:+.1f})"
            )
    return [
        f"in the frequency domain (difference from these, in the larger sigma): {', '.join(parts)}"
    ]


def write_spectral(out: Path, watch: Watch, session: SpectralSession, name: str) -> None:
    """Write the study of a stream in the frequency domain, completely or not at all."""
    estimate = last_estimate(session)
    items = items_of(session, estimate, watch.reference)
    with study_folder(out, "comparison.json") as scratch:
        record_file, _ = write_record(scratch, record_of(session))
        history = history_csv(session)
        write_text(scratch / NAME, history)
        digest = hashlib.sha256(record_file.read_bytes()).hexdigest()
        content = {
            "schema": SCHEMA,
            "scenario": "watch",
            "model": session.vehicle.model,
            "vehicle": session.vehicle.name,
            **spectral_content(session),
            **(
                {}
                if watch.reference is None
                else {"reference": reference_content(watch.reference, items)}
            ),
            "stream": {
                "rows": session.rows,
                "left_out": watch.left_out,
                "mended": watch.mended,
                "ended": watch.reason,
            },
            "versions": versions(),
        }
        first = history_section(scratch, history, content, f"{content['vehicle']}: {name}")
        write_page(scratch, spectral_page(content, name, digest, first, session.vehicle.identity))
        write_json(
            scratch / "comparison.json",
            {**content, "inputs": {"records": [name], "sha256": [digest]}},
        )


def spectral_page(
    content: Mapping[str, Any],
    name: str,
    digest: str,
    first: tuple[Section, ...] = (),
    vehicle: InputFile | None = None,
) -> Page:
    """The page of a stream that was identified in the frequency domain; ``first``: the sections
    with which it begins, ``vehicle`` the vehicle file that was read.
    """
    stream = content["stream"]
    counts = (
        f"{stream['rows']} rows of {name}, {stream['left_out']} left out, {stream['mended']} mended"
    )
    outside: Sequence[str] = content.get("reference", {}).get("outside", ())
    words = (
        against(outside, len(content["reference"]["differences"]), content["reference"]["study"])
        if "reference" in content
        else ""
    )
    verdict = (
        "outside the reference" if outside else "identified" if content["parameters"] else UNKNOWN
    )
    fixed = {key: (each["value"], each["unit"]) for key, each in content.get("fixed", {}).items()}
    return Page(
        title=f"{capital(content['vehicle'])}: identified from a stream",
        kind=f"Watch of {name}, {content['model']}, equation error in the frequency domain",
        verdict=verdict,
        tone="fair" if outside else "good" if content["parameters"] else "open",
        sentence=as_sentence(words or counts),
        summary=(as_sentence(counts),) if "reference" in content else (),
        warnings=tuple(map(as_sentence, content.get("warnings", ()))),
        sections=(
            *first,
            *section("Estimates", *estimate_blocks(content)),
            *section(
                "Against the reference",
                differences_table(content["reference"]) if "reference" in content else None,
            ),
            *section("How it was made", fixed_table("Constants", fixed)),
        ),
        reproduction=reproduction(
            usual_command(name, content["model"], vehicle),
            as_sentence(f"the watch ended: {stream['ended']}"),
            rows_and_vehicle(name, digest, vehicle),
        ),
        created=now(),
    )


def estimate_blocks(content: Mapping[str, Any]) -> list[Block]:
    """Tables of the parameters and of derived quantities."""
    if not content["parameters"]:
        return []
    rows = [
        Row(name, each["unit"], each["estimate"], each["std"])
        for name, each in content["parameters"].items()
    ]
    derived = {
        name: (each["estimate"], each["std"]) for name, each in content.get("derived", {}).items()
    }
    return [
        estimates_table("Parameters", rows),
        *([derived_table("Derived quantities", derived)] if derived else []),
    ]


REFRESH = 0.25  # s between two drawings of the live table


def view_of(watch: Watch, session: Session, step: WatchStep | None = None) -> View:
    """The stream after a step, the last when None."""
    # A step that is named is news, however long its row waited to be filtered.
    silent = time.monotonic() - watch.heard if step is None else 0.0
    bank, step = session.bank, session.last if step is None else step
    assert bank is not None and step is not None
    result, state = so_far(session, step), step.state
    items = comparisons(result.estimate, result.derived, watch.reference, result.hanging)
    sound = bool(state.sound.any())
    return View(
        watch.name,
        state.time,
        state.rows_seen,
        watch.left_out,
        step.spikes,
        items,
        bank.delays,
        result.weights,
        silent,
        sound,
        result.refined,
    )


class Show:
    """Draws a live table on a terminal, else prints a line for every second of data."""

    def __init__(self, watch: Watch) -> None:
        from rich.live import Live

        from scenarios.report.quantities import console

        self._watch, self._said, self._drawn = watch, -np.inf, 0.0
        terminal = console()
        self.live = Live(console=terminal, auto_refresh=False) if terminal.is_terminal else None

    def __call__(self, steps: Sequence[WatchStep]) -> None:
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
        shown_steps = list(steps)[-1:] if self._said == -np.inf else steps
        seconds = [int(np.floor(step.row[0])) for step in shown_steps]
        for step, second, after in zip(shown_steps, seconds, [*seconds[1:], None], strict=False):
            if second > self._said and second != after:
                self._said = second
                print(view_line(view_of(self._watch, session, step)), flush=True)


@contextmanager
def display(watch: Watch) -> Iterator[Show]:
    """Context manager that gives the display; on a terminal a live table."""
    show = Show(watch)
    with show.live if show.live is not None else nullcontext():
        yield show


def print_end(watch: Watch, session: Session, end: WatchOutcome) -> None:
    """Print the last table, the reason of the end, and quantities outside the reference's
    bounds.
    """
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
        if end.refinement is not None
        else "refined on line"
        if end.refined
        else "on line, the most likely filter"
    )
    terminal.print(f"{watch.reason}; {kind}:", highlight=False)
    terminal.print(vehicle_sentence(session.vehicle), highlight=False)
    terminal.print(live_table(view))
    for words in beside_lines(session.spectral, (end.refinement or end.online).estimate):
        terminal.print(words, highlight=False)
    hanging = [WORDS.get(item.name, item.name) for item in end.standings if item.hanging]
    if hanging:
        what = (
            f"with another start within its prior the result would differ: {', '.join(hanging)}; "
            "name a nearer start with --vehicle"
        )
        terminal.print(
            f"{what}, or leave out --no-refine" if not watch.refine else what, highlight=False
        )
    if watch.reference is not None:
        terminal.print(against_items(end.standings, watch.reference.name), highlight=False)
    if watch.beside:
        terminal.print(
            f"note: {watch.beside} was found beside the record and read for its units",
            highlight=False,
        )
