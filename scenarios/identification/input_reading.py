"""The same identification with the inputs read the other way between samples: held instead of linear, or linear instead of held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from scenarios.preparation.interpreting import BETTER
from scenarios.studies.rows import Row
from scenarios.terminal.numbers import number
from scenarios.terminal.tables import Column, columns_of
from sim.record import Hold

WORDS = {Hold.PREVIOUS: "held", Hold.LINEAR: "linear"}
MOVED = 1.0  # sigmas of the estimate, from which the reading matters more than noise


@dataclass(frozen=True, eq=False)
class OtherReading:
    """What the other reading of the inputs gives.

    ``used`` and ``other`` are the two readings; ``moved`` pairs of rows (as used, as read otherwise) of derivatives that differ by more than a
    sigma of the first; ``gain`` twice the log likelihood by which the other fits better, negative where it fits worse, in samples that count
    as independent.
    """

    used: Hold
    other: Hold
    moved: tuple[tuple[Row, Row], ...]
    gain: float

    @property
    def decided(self) -> bool:
        """Whether the data say that the reading used is the right one."""
        return self.gain <= -BETTER

    @property
    def decision(self) -> str:
        """The reading that the data chose, and by how much."""
        worse = f"{WORDS[self.other]} ones fit worse (twice the log likelihood {self.gain:.1f})"
        return f"inputs {WORDS[self.used]} between samples: {worse}; --hold {self.other.value} reads them the other way"

    @property
    def sentence(self) -> str:
        """That derivatives hang on the reading, and how the choice is made."""
        names = ", ".join(row.name for row, _ in self.moved)
        how = "as well" if abs(self.gain) < 0.05 else "better" if self.gain > 0.0 else "worse"
        fits = f"fits {how} (twice the log likelihood {self.gain:+.1f})"
        return (
            f"{names}: by more than a sigma another value with inputs {WORDS[self.other]} between samples, which {fits}; "
            f"inputs were read as {WORDS[self.used]}; --hold {self.other.value} reads them the other way"
        )


def opposite(hold: Hold) -> Hold:
    """The other way to read inputs between samples."""
    return Hold.LINEAR if hold is Hold.PREVIOUS else Hold.PREVIOUS


def other_reading(used: Hold, rows: Sequence[Row], read_otherwise: Sequence[Row], gain: float) -> OtherReading | None:
    """What moves by more than a sigma between the two readings; None where nothing does."""
    again = {row.name: row for row in read_otherwise}
    pairs = [(row, again[row.name]) for row in rows if row.name in again]
    moved = tuple((row, new) for row, new in pairs if abs(new.estimate - row.estimate) > MOVED * row.std > 0.0)
    return OtherReading(used, opposite(used), moved, gain) if moved else None


def reading_rows(reading: OtherReading) -> list[Column]:
    """A table of the values under each reading, a row for each derivative that moves."""
    rows = [
        (row.name, row.unit if row.unit != "1" else "", *_values(row, new), f"{(new.estimate - row.estimate) / row.std:+.1f} sigma")
        for row, new in reading.moved
    ]
    headings = ("derivative", "unit", f"{WORDS[reading.used]} (used)", WORDS[reading.other], "moved by")
    return columns_of(headings, rows, left=2)


def reading_content(reading: OtherReading) -> dict[str, Any]:
    """The same for ``comparison.json``: the reading used, the other, values under each."""
    return {
        "used": reading.used.value,
        "other": reading.other.value,
        "log_likelihood_gain": 0.5 * reading.gain,
        "parameters": {
            row.name: {
                reading.used.value: {"estimate": row.estimate, "std": row.std},
                reading.other.value: {"estimate": new.estimate, "std": new.std},
                "unit": row.unit,
            }
            for row, new in reading.moved
        },
    }


def _values(row: Row, new: Row) -> tuple[str, str]:
    used, other = (f"{number(each.estimate, each.std)} +- {number(each.std, each.std)}" for each in (row, new))
    return used, other
