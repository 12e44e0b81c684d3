"""Flights of a campaign of the tracing loop as tasks. Each is flown and diagnosed, and its result
is stored as text.
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

# Columns: the result as JSON, the time of its diagnosis; and the field that has the time.
FOUND, TAKEN, SECONDS = "found", "taken", "seconds"


@dataclass(frozen=True, eq=False)
class LoopFlights:
    """Flights of the campaign ``name``: the module-level function ``fly`` returns a dataclass of
    the ``kind`` for a flight's number and seed.

    ``told`` has everything else on which the result depends, as JSON.
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
        """Return the row of a flight. The time of its diagnosis has a cell of its own, since it is
        not reproducible.
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
        """Return the result of each flight that has a row, in order."""
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
    """Return values that JSON does not know in a form that is the same in every process."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, frozenset | set):
        return sorted(value)
    raise TypeError(f"a {type(value).__name__} in a result")


class Flights(Work, Protocol):
    """Work whose rows are read as results of flights."""

    def read(self, table: RowTable) -> list[Any]: ...


@dataclass(frozen=True)
class FlownCampaign:
    """Flights of a campaign that have ended: results ``found``, and ``failures`` by their reasons.

    ``root`` is the root seed, ``asked`` the number of requested flights, and ``ended`` the number
    of those that have ended.
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
        """``"seeds from 1"``, with the number of flights if the campaign was stopped."""
        words = (
            f"seeds from {self.root}"
            if self.whole
            else f"stopped after {self.ended} of {self.asked}, seeds from {self.root}"
        )
        return f"{words}; {self.failed}" if self.failures else words

    @property
    def failed(self) -> str:
        """Number of failed flights and the reasons; empty without any."""
        count = sum(self.failures.values())
        why = "; ".join(f"{times} {error}" for error, times in self.failures.items())
        return (
            f"{count} failed and {'is' if count == 1 else 'are'} left out ({why})" if count else ""
        )

    @property
    def content(self) -> dict[str, Any]:
        """Return the entries of ``campaign.json`` on the flights."""
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
    """Fly all flights of a campaign; after Ctrl-C, return those that had ended.

    Raises
    ------
    FlightidError : the folder of ``execution`` holds another campaign, or none to go on with.
    KeyboardInterrupt : where no flight had ended.
    """
    table = run_study(work, execution.request(runs, root, work.block, "flights"), tell)
    failures = Counter(error for error in table.columns["error"] if error)
    return FlownCampaign(root, runs, len(table), work.read(table), dict(failures.most_common()))
