"""Published values of parameters, and the rows of a study's comparison.

Each paper has one TOML file with its tables; each number has its unit and its place in the paper. A
remark under `[remarks]` is repeated wherever its column is shown. Published values are compared
with estimates and never used to form them. To add a paper, write its file and name it in a scenario
under `published`; a test compares the file with the scenario's parameters.
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
    """Return values and standard deviations of a published column.

    ``units``: unit of the result by parameter; 1 for others.

    Raises
    ------
    DeclarationError : no such file, table or column.
    """
    from scenarios.files.units import to_si

    place = f"published {choice.file}, table {choice.table}"
    found = _document(choice.file).get(choice.table)
    table: dict[str, Any] = found if isinstance(found, dict) else {}
    columns = {key: value for key, value in table.items() if isinstance(value, dict)}
    if choice.column not in columns:
        known = ", ".join(columns) if table else "no such table"
        raise DeclarationError(
            f"there is no column {choice.column!r}", where=place, remedy=f"it has {known}"
        )
    published = {}
    for name, row in columns[choice.column].items():
        factor = 1.0
        if "unit" in table:
            unit = units.get(name, "1")
            factor = float(to_si(1.0, table["unit"], unit, place, DeclarationError))
        published[name] = Start(row["value"] * factor, row["std"] * factor)
    return published


def published_remark(choice: PublishedChoice | None) -> str:
    """Return the remark on a published column; empty if there is none, or no column.

    Raises DeclarationError if there is no such file.
    """
    if choice is None:
        return ""
    remarks = _document(choice.file).get("remarks", {})
    return str(remarks.get(choice.table, {}).get(choice.column, ""))


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
    """Estimated, true and published value of one parameter, all in ``unit``.

    Attributes
    ----------
    condensed : value that the model should find: the coefficient with the elastic modes that the
        model lacks statically condensed.
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
        """Value that the estimate should have: the condensed value if known, else the true one."""
        return self.true if self.condensed is None else self.condensed

    @property
    def sigmas(self) -> float | None:
        """Error in reported standard deviations."""
        return None if self.reference is None else (self.estimate - self.reference) / self.std

    @property
    def percent(self) -> float | None:
        """Error in percent of the reference; None if that is zero."""
        if not self.reference:
            return None
        return 100.0 * (self.estimate - self.reference) / abs(self.reference)

    @property
    def published_sigmas(self) -> float | None:
        """Error of the published value against the reference, in published sigmas."""
        if self.published is None or self.reference is None:
            return None
        return (self.published.value - self.reference) / self.published.std


def rows_of(estimate: Estimate) -> tuple[Row, ...]:
    """Return the rows of an estimate, without true and published values."""
    numbers = zip(estimate.names, estimate.units, estimate.values, estimate.std, strict=True)
    return tuple(Row(name, unit, float(value), float(std)) for name, unit, value, std in numbers)
