"""Numbers printed in papers, one file a paper; only shown beside estimates, never used to form
them. One row of a study's comparison: a parameter's true, estimated and published value.

One TOML file a paper, table by table, each number with its unit and place; `__init__.py` reads one
column of one table, and the remark under `[remarks]` that every table which shows it repeats. It
may import `files` and `studies.declaration`. To add a paper, write a file with its tables and name
it in a scenario under `published`; a test compares the file with the scenario's parameters.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from ident.estimate import Estimate
from scenarios.studies.declaration import PublishedChoice, Start
from sim.errors import DeclarationError


def published_values(choice: PublishedChoice, units: Mapping[str, str]) -> dict[str, Start]:
    """Values and standard deviations of a published column, in the units given by parameter.

    Raises
    ------
    DeclarationError : no such file, table or column.
    """
    from scenarios.files.units import to_si

    place = f"published {choice.file}, table {choice.table}"
    table = _document(choice.file).get(choice.table)
    if not isinstance(table, dict) or not isinstance(table.get(choice.column), dict):
        columns = (
            ", ".join(key for key, value in table.items() if isinstance(value, dict))
            if isinstance(table, dict)
            else "no such table"
        )
        raise DeclarationError(
            f"there is no column {choice.column!r}", where=place, remedy=f"it has {columns}"
        )
    out = {}
    for name, row in table[choice.column].items():
        factor = (
            float(to_si(1.0, table["unit"], units.get(name, "1"), place, DeclarationError))
            if "unit" in table
            else 1.0
        )
        out[name] = Start(row["value"] * factor, row["std"] * factor)
    return out


def published_remark(choice: PublishedChoice | None) -> str:
    """Return a remark on a published column; empty if there is none, or no column.

    Raises DeclarationError if there is no such file.
    """
    return (
        ""
        if choice is None
        else str(
            _document(choice.file).get("remarks", {}).get(choice.table, {}).get(choice.column, "")
        )
    )


def _document(file: str) -> dict[str, Any]:
    entry = files("scenarios.studies.published").joinpath(f"{file}.toml")
    if not entry.is_file():
        raise DeclarationError(
            "there is no such file of published numbers",
            where=file,
            remedy="look into scenarios/studies/published",
        )
    return tomllib.loads(entry.read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Row:
    """One parameter of one method: what is true, what was estimated, what a paper found; all in
    ``unit``.

    ``condensed`` is the coefficient by static condensation of the elastic modes that the model
    lacks: what it should find.
    """

    name: str
    unit: str
    estimate: float
    std: float
    true: float | None = None
    condensed: float | None = None
    published: Start | None = None

    @property
    def reference(self) -> float | None:
        """Reference value of the estimate: the condensed value if there is one, else the true
        one.
        """
        return self.true if self.condensed is None else self.condensed

    @property
    def sigmas(self) -> float | None:
        """Error in the estimator's own standard deviations."""
        return None if self.reference is None else (self.estimate - self.reference) / self.std

    @property
    def percent(self) -> float | None:
        """Error in percent of the reference; None if that is zero."""
        return (
            None
            if not self.reference
            else 100.0 * (self.estimate - self.reference) / abs(self.reference)
        )

    @property
    def published_sigmas(self) -> float | None:
        """Error of the published value against the same reference, in the publication's own
        sigmas.
        """
        if self.published is None or self.reference is None:
            return None
        return (self.published.value - self.reference) / self.published.std


def rows_of(estimate: Estimate) -> tuple[Row, ...]:
    """Return the rows of an estimate of which nothing else is known, in its order."""
    found = zip(estimate.names, estimate.units, estimate.values, estimate.std, strict=True)
    return tuple(Row(name, unit, float(value), float(std)) for name, unit, value, std in found)
