"""``maneuvers.toml``: parts of one record by number and name, and the plan that uses some of
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.preparation.plan import WHOLE, Plan, plan_of, refuse_turned
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.files.measured.columns import RecordFile

FILE = "maneuvers.toml"
FIND = "flightid maneuvers RECORD --out DIR writes one"


@dataclass(frozen=True)
class Part:
    """A part of a record, s, by its number and name."""

    number: int
    name: str
    start: float
    stop: float

    @property
    def sentence(self) -> str:
        """What messages call it, ``"maneuver 3 (pitch-doublet-1), 119.2 to 127.5 s"``."""
        return f"maneuver {self.number} ({self.name}), {self.start:g} to {self.stop:g} s"


@dataclass(frozen=True)
class Parts:
    """The parts that a file declares, and the record that they are of: its name and hash, each
    empty where the file does not say it.
    """

    where: str
    record: str
    sha256: str
    parts: tuple[Part, ...]


def read_parts(path: str | Path) -> Parts:
    """Read ``maneuvers.toml``; a table without a number counts on from the one before it.

    Raises
    ------
    DeclarationError : no such file, an unknown or missing key, a wrong value, times the wrong way
    round, a number or name twice.
    """
    from scenarios.files.declarations import checked, read_toml
    from scenarios.files.schemas import FileEntry

    where = str(path)
    entry = checked(FileEntry, read_toml(path), path)
    parts: list[Part] = []
    for each in entry.maneuvers:
        number = each.number if each.number is not None else (parts[-1].number + 1 if parts else 1)
        part = Part(number, each.name or str(number), each.from_, each.to)
        refuse_turned(part.start, part.stop, f"{where}, maneuver {part.number}")
        for other in parts:
            if number == other.number or part.name == other.name:
                what = (
                    f"two maneuvers have the {'number' if number == other.number else 'name'} "
                    f"{number if number == other.number else part.name}"
                )
                raise DeclarationError(
                    what, where=where, remedy="give each a number and a name of its own"
                )
        parts.append(part)
    return Parts(where, entry.record or "", entry.sha256 or "", tuple(parts))


def chosen_parts(parts: Parts, asked: Sequence[str | int]) -> tuple[Part, ...]:
    """The parts that are asked for by number or name, in the order of their times.

    Raises
    ------
    DeclarationError : there is no such part, it is asked for twice, or two overlap.
    """
    by_name = {each.name: each for each in parts.parts} | {
        str(each.number): each for each in parts.parts
    }
    found: list[Part] = []
    for wanted in asked:
        part = by_name.get(str(wanted).strip())
        if part is None:
            known = ", ".join(f"{each.number} {each.name}" for each in parts.parts[:12]) + (
                ", ..." if len(parts.parts) > 12 else ""
            )
            raise DeclarationError(
                f"there is no maneuver {str(wanted)!r}",
                where=parts.where,
                remedy=f"it has {known}" if known else "it has none",
            )
        if part in found:
            raise DeclarationError(
                f"maneuver {part.number} is asked for twice",
                where="--maneuver",
                remedy="name each once",
            )
        found.append(part)
    found.sort(key=lambda each: each.start)
    for one, other in pairwise(found):
        if other.start < one.stop:
            what = (
                f"maneuvers {one.number} and {other.number} overlap ({one.start:g} to {one.stop:g} "
                f"s, {other.start:g} to {other.stop:g} s)"
            )
            raise DeclarationError(
                what,
                where=parts.where,
                remedy="take one of them, or change their times in the file",
            )
    return tuple(found)


def with_maneuvers(
    plan: Plan,
    records: Sequence[Path | RecordFile],
    asked: Sequence[str | int] | None,
    file: Path | Parts | None = None,
) -> Plan:
    """The plan with the parts of maneuvers as its segments, as ``--from`` and ``--to`` of each
    would give it, and a sentence on each.

    ``asked`` : numbers or names; None or empty leaves the plan alone. ``file`` : None takes
    ``maneuvers.toml`` beside the record.

    Raises
    ------
    DeclarationError : together with ``--from`` or ``--to`` or with several records, no file, one of
    another record, or no such maneuver.
    """
    if not asked:
        if file is not None:
            raise DeclarationError(
                "no maneuver is named",
                where="--maneuvers",
                remedy="add --maneuver NUMBER, or leave it out",
            )
        return plan
    if plan.segments != WHOLE:
        raise DeclarationError(
            "goes without --from and --to", where="--maneuver", remedy="leave one or the other out"
        )
    if len(records) != 1:
        what = f"maneuvers are of one record, and {len(records)} are named"
        raise DeclarationError(
            what, where="--maneuver", remedy="name one record, or cut each with --from and --to"
        )
    parts = file if isinstance(file, Parts) else read_parts(file or _beside(records[0]))
    _refuse_other(parts, records[0])
    found = chosen_parts(parts, asked)
    segments = plan_of([each.start for each in found], [each.stop for each in found]).segments
    return replace(
        plan,
        segments=segments,
        chosen=tuple(f"{each.sentence}, of {parts.where}" for each in found),
    )


def _beside(record: Path | RecordFile) -> Path:
    from scenarios.files.measured.columns import path_of

    path = path_of(record)
    if path is None:
        raise DeclarationError(
            "the record is in memory, where no file lies beside it",
            where="--maneuver",
            remedy="name the file (maneuvers)",
        )
    beside = path.with_name(FILE)
    if not beside.is_file():
        raise DeclarationError(
            f"there is no {FILE} beside {path.name}",
            where="--maneuver",
            remedy=f"name one with --maneuvers; {FIND}",
        )
    return beside


def _refuse_other(parts: Parts, record: Path | RecordFile) -> None:
    """Raise DeclarationError where the file was made for a record of another content."""
    from scenarios.files.sources import read_source
    from sim.errors import RecordError

    if not parts.sha256:
        return
    identity = (
        read_source(record, RecordError, "the record file").identity
        if isinstance(record, Path)
        else record.identity
    )
    if identity.sha256 != parts.sha256:
        of = (
            f"{parts.record}, not of {identity.name}"
            if parts.record != identity.name
            else f"an earlier {parts.record}: its content has changed"
        )
        raise DeclarationError(
            f"is of {of}",
            where=parts.where,
            remedy="run flightid maneuvers on this record, or take sha256 out of the file",
        )
