"""Flights of a campaign of the tracing loop as tasks: each flown and diagnosed, what was found kept
as text, and all of them together.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any, Protocol

from scenarios.tasks.study import Execution, ShowProgress, run_study
from scenarios.tasks.work import Row, RowTable, Task, Work

# columns: what was found as JSON, the time of its diagnosis; the field that has it
FOUND, TAKEN, SECONDS = "found", "taken", "seconds"


@dataclass(frozen=True, eq=False)
class LoopFlights:
    """Flights of a campaign by the ``name`` of it: ``fly``, a function of a module, gives of a
    flight's number and seed a ``kind`` of dataclass.

    ``told`` : everything on which that depends but these, as JSON.
    """

    name: str
    fly: Callable[[int, int], Any]
    kind: Any
    told: Mapping[str, Any]

    @property
    def columns(self) -> Mapping[str, str]:
        return {FOUND: "text", TAKEN: "time"}

    @property
    def block(self) -> int:
        return 1

    def identity(self) -> Mapping[str, Any]:
        return {"campaign": self.name, **self.told}

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """One row a flight; the time that its diagnosis took stands apart, for it is never the
        same.
        """
        rows: list[Row | str] = []
        for task in tasks:
            found = self.fly(task.number, task.seed)
            taken = getattr(found, SECONDS, None)
            timeless = found if taken is None else replace(found, **{SECONDS: 0.0})
            rows.append(
                {
                    FOUND: json.dumps(
                        self._types.dump_python(timeless), default=_plain, ensure_ascii=False
                    ),
                    TAKEN: taken,
                }
            )
        return rows

    def read(self, table: RowTable) -> list[Any]:
        """What was found of each flight that has a row, in order."""
        found = []
        for text, taken in zip(table.columns[FOUND], table.times[TAKEN].tolist(), strict=True):
            if text is not None:
                each = self._types.validate_python(json.loads(text))
                found.append(replace(each, **{SECONDS: taken}) if hasattr(each, SECONDS) else each)
        return found

    @cached_property
    def _types(self) -> Any:
        from pydantic import TypeAdapter

        return TypeAdapter(self.kind)

    def __reduce__(self) -> tuple[type[LoopFlights], tuple[Any, ...]]:
        return LoopFlights, (self.name, self.fly, self.kind, self.told)


def _plain(value: object) -> object:
    """What JSON does not know, the same in every process."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, frozenset | set):
        return sorted(value)
    raise TypeError(f"a {type(value).__name__} in a result")


class Flights(Work, Protocol):
    """Work whose rows are read as what was found of each flight."""

    def read(self, table: RowTable) -> list[Any]: ...


@dataclass(frozen=True)
class FlownCampaign:
    """Flights of a campaign that have ended: what was ``found`` of those that could be judged,
    ``failures`` by what the others ended.

    ``root`` : from which the seeds of all flights spring. ``asked`` : how many there were to be,
    ``ended`` : how many have.
    """

    root: int
    asked: int
    ended: int
    found: Sequence[Any]
    failures: Mapping[str, int]

    @property
    def whole(self) -> bool:
        return self.ended == self.asked

    @property
    def words(self) -> str:
        """``"seeds from 1"``, and how many where it was stopped."""
        words = (
            f"seeds from {self.root}"
            if self.whole
            else f"stopped after {self.ended} of {self.asked}, seeds from {self.root}"
        )
        return f"{words}; {self.failed}" if self.failures else words

    @property
    def failed(self) -> str:
        """How many could not be judged, and why; empty where all could."""
        count = sum(self.failures.values())
        why = "; ".join(f"{times} {error}" for error, times in self.failures.items())
        return (
            f"{count} failed and {'is' if count == 1 else 'are'} left out ({why})" if count else ""
        )

    @property
    def content(self) -> dict[str, Any]:
        """What ``campaign.json`` says of it."""
        stopped = {} if self.whole else {"asked": self.asked}
        return {
            "seed": self.root,
            "runs": self.ended,
            **stopped,
            **({"failures": dict(self.failures)} if self.failures else {}),
        }


def fly_all(
    work: Flights,
    runs: int,
    root: int,
    execution: Execution,
    tell: ShowProgress = lambda stage, share: None,
) -> FlownCampaign:
    """All flights of a campaign, or after Ctrl-C those that had ended.

    Raises
    ------
    FlightidError : the folder of ``execution`` holds another campaign, or none to go on with.
    KeyboardInterrupt : where no flight had ended.
    """
    table = run_study(work, execution.request(runs, root, work.block, "flights"), tell)
    failures = Counter(error for error in table.columns["error"] if error)
    return FlownCampaign(root, runs, len(table), work.read(table), dict(failures.most_common()))
