"""What a watch leaves behind: the rows it took, the history, and a comparison of the last estimate with the reference."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.sources import resolved, versions
from scenarios.files.writing import study_folder, write_json, write_record
from scenarios.identification.assessment import IdentificationResult
from scenarios.pages.folder import CONTENT, write_page
from scenarios.studies.comparison import DERIVED_UNITS, SCHEMA, estimate_content
from scenarios.studies.rows import Row
from scenarios.terminal.summary import PAGE
from scenarios.watching.estimates import SoFar, nearest, plain_so_far
from scenarios.watching.history import NAME, History
from scenarios.watching.reference import Reference
from scenarios.watching.report import watch_page
from scenarios.watching.session import Session
from scenarios.watching.spectral import METHOD, history_csv, last_estimate, spectral_content
from scenarios.watching.table import CrossValidation
from sim.errors import DeclarationError
from sim.record import Record

FREQUENCY = "frequency.csv"  # beside the history of the bank
FILES = ("comparison.json", NAME, FREQUENCY, "record.csv", "record.json", CONTENT, PAGE)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of a watch: ``record`` the rows taken, ``found`` the whole-record refinement, None where it was not made; ``online`` the last
    estimate on line, ``delays`` those of its bank (s); ``standings`` of what counts."""

    record: Record
    found: IdentificationResult | None
    online: SoFar
    delays: np.ndarray
    standings: tuple[CrossValidation, ...]
    left_out: int
    mended: int
    spikes: int
    reason: str

    @property
    def weights(self) -> np.ndarray:
        """Of the declared delays, as in ``SoFar``, by what counts."""
        if self.found is None or "delay" not in self.found.estimate.names:
            return self.online.weights
        return nearest(self.delays, self.found.estimate.value("delay"), self.found.estimate.sigma("delay"))

    @property
    def refined(self) -> bool:
        """Whether what counts was linearised anew."""
        return self.found is not None or self.online.refined


def refuse_overwriting(stream: Path, out: Path) -> None:
    """Refuse a folder in which our files would take the place of the one that is watched.

    Raises DeclarationError.
    """
    if resolved(stream).parent == resolved(out) and stream.name in FILES:
        what = "the study's files would take the place of what is watched"
        raise DeclarationError(what, where=str(stream), remedy="name another folder with --out")


def write_watch(out: Path, session: Session, reference: Reference | None, end: Outcome, history: History, name: str) -> None:
    """Write the study; the history that grew until now becomes one of its files."""
    with study_folder(out, "comparison.json") as scratch:
        record_file, _ = write_record(scratch, end.record)
        (scratch / NAME).write_text(history.finish(), encoding="ascii", newline="\n")
        if session.spectral is not None and session.spectral.points:
            (scratch / FREQUENCY).write_text(history_csv(session.spectral), encoding="ascii", newline="\n")
        digest = hashlib.sha256(record_file.read_bytes()).hexdigest()
        content = watch_content(session, reference, end)
        write_page(scratch, watch_page(content, name, digest))
        write_json(scratch / "comparison.json", {**content, "inputs": {"records": [name], "sha256": [digest]}})


def watch_content(session: Session, reference: Reference | None, end: Outcome) -> dict[str, Any]:
    """Content of ``comparison.json``: the refined estimate as the main one where it was made, the on-line bank's under ``methods``."""
    bank, state = session.bank, session.state
    assert bank is not None and state is not None
    alone = plain_so_far(session)
    plain: dict[str, Any] = {**_content(session, alone), "method": "online"}
    if end.found is not None:
        found = end.found
        main: dict[str, Any] = {**estimate_content(found.estimate, found.rows, found.derived, found.fixed, found.tests), "method": "ekf"}
    else:
        main = {**_content(session, end.online), "method": "online-refined"} if end.refined else plain
    methods: dict[str, Any] = {"online": plain} if end.refined else {}
    if session.spectral is not None and last_estimate(session.spectral) is not None:
        methods[METHOD] = spectral_content(session.spectral)
    return {
        "schema": SCHEMA,
        "scenario": "watch",
        "model": "loes",
        "vehicle": session.vehicle.name,
        **main,
        **({"methods": methods} if methods else {}),
        "bank": {"delays": bank.delays, "weights": alone.weights, "most_likely": float(bank.delays[state.best])},
        **({} if reference is None else {"reference": reference_content(reference, end.standings)}),
        "stream": {
            "rows": len(end.record),
            "left_out": end.left_out,
            "mended": end.mended,
            "spikes": end.spikes,
            "trim": dict(session.offsets),
            "ended": end.reason,
        },
        "versions": versions(),
    }


def _content(session: Session, online: SoFar) -> dict[str, Any]:
    """An estimate on line; quantities that hang on the start are named, without a number."""
    assert session.bank is not None and session.state is not None and session.system is not None
    estimate = online.estimate
    rows = rows_of(estimate.names, estimate.units, estimate.values.tolist(), estimate.std.tolist())
    fixed = {item.name: (item.value, item.unit) for item in session.system.parameters if not item.free and item.name not in estimate.names}
    if "delay" not in estimate.names:
        fixed["delay"] = (float(session.bank.delays[session.state.best]), DERIVED_UNITS["delay"])
    derived = {name: pair for name, pair in online.derived.items() if name not in online.hanging}
    content = estimate_content(estimate, tuple(row for row in rows if row.name not in online.hanging), derived, fixed, ())
    if not online.hanging:
        return content
    names = sorted(online.hanging)
    warning = f"another start within its prior would have led elsewhere: {', '.join(names)} hang on the start, and no number is told"
    return {**content, "start_dependent": names, "warnings": [warning]}


def rows_of(names: Sequence[str], units: Sequence[str], values: Sequence[float], std: Sequence[float]) -> tuple[Row, ...]:
    """Rows of the estimated quantities; one without a deviation is not estimated."""
    return tuple(Row(*each) for each in zip(names, units, values, std, strict=True) if each[3] > 0)


def reference_content(reference: Reference, items: Sequence[CrossValidation]) -> dict[str, Any]:
    """The reference and what differs from it, for ``comparison.json``."""
    compared = [item for item in items if item.reference is not None and item.z is not None]
    return {
        "study": resolved(Path(reference.name)).name,
        "differences": [
            {
                "name": item.name,
                "unit": item.unit,
                "reference": item.reference[0],
                "reference_std": item.reference[1],
                "sigmas": item.z,
                "outside": item.beyond,
            }
            for item in compared
            if item.reference is not None
        ],
        "outside": [item.name for item in compared if item.beyond],
    }
