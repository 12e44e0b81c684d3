"""Estimated numbers by name, each with its sigma and unit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scenarios.api.shown import html
from scenarios.terminal.numbers import number
from scenarios.terminal.quantities import determined, value_text

if TYPE_CHECKING:
    import pandas

HEADINGS = ("parameter", "unit", "value", "sigma")
IN_A_LINE = 4  # parameters that a repr names


@dataclass(frozen=True)
class Parameter:
    """An estimated number in ``unit``: ``sigma`` is its standard deviation, ``start`` where the search began (None: it is not known)."""

    name: str
    value: float
    sigma: float
    unit: str
    start: float | None = None

    @property
    def interval(self) -> tuple[float, float]:
        """Value minus and plus two sigmas."""
        return self.value - 2.0 * self.sigma, self.value + 2.0 * self.sigma

    @property
    def determined(self) -> bool:
        """Whether the record says anything of it."""
        return determined(self.value, self.sigma)

    def __float__(self) -> float:
        return self.value

    def __repr__(self) -> str:
        return f"{self.name} = {value_text(self.value, self.sigma, self.unit)}"


class Parameters(Mapping[str, Parameter]):
    """Parameters by name, in the order of the estimate."""

    def __init__(self, items: Iterable[Parameter]) -> None:
        self._items = {item.name: item for item in items}

    def __getitem__(self, name: str) -> Parameter:
        if name not in self._items:
            raise KeyError(f"there is no parameter {name!r}: {', '.join(self._items)}")
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def to_dict(self) -> dict[str, float]:
        """Values by name."""
        return {name: item.value for name, item in self._items.items()}

    def to_dataframe(self) -> pandas.DataFrame:
        """One row a parameter: ``unit``, ``value``, ``sigma``, and ``start`` where it is known."""
        import pandas

        index = pandas.Index(list(self._items), name="parameter")
        items = list(self._items.values())
        columns = {"unit": [i.unit for i in items], "value": [i.value for i in items], "sigma": [i.sigma for i in items]}
        if any(item.start is not None for item in items):
            columns["start"] = [math.nan if item.start is None else item.start for item in items]
        return pandas.DataFrame(columns, index=index)

    def __repr__(self) -> str:
        items = list(self._items.values())
        more = f", and {len(items) - IN_A_LINE} more" if len(items) > IN_A_LINE else ""
        return f"<{', '.join(map(repr, items[:IN_A_LINE])) or 'no parameters'}{more}>"

    def html_table(self) -> str:
        """The HTML table alone."""
        return html.table(HEADINGS, [row_of(item) for item in self._items.values()], left=2)

    def _repr_html_(self) -> str:
        return html.page("parameters", self.html_table())


def row_of(item: Parameter) -> tuple[str, str, str, str]:
    """Name, unit, value and sigma with the digits that the sigma makes sensible."""
    unit = item.unit if item.unit != "1" else ""
    if not item.determined:
        return item.name, unit, "not determined", "-"
    return item.name, unit, number(item.value, item.sigma), number(item.sigma, item.sigma)
