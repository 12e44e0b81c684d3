"""A small table of texts and numbers: printed, shown in a notebook, or made a DataFrame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from scenarios.api.shown import html
from scenarios.terminal.paragraphs import wrapped
from scenarios.terminal.tables import columns_of, table_lines

if TYPE_CHECKING:
    import pandas

SHOWN = 60  # letters of a cell in a terminal


@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """Rows under headings; the first column names them.

    ``len``, iteration over rows as dictionaries, ``table[name]`` for the row of that name, ``names``.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The first column."""
        return tuple(str(row[0]) for row in self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (dict(zip(self.headings, row, strict=True)) for row in self.rows)

    def __getitem__(self, name: str) -> dict[str, Any]:
        if name not in self.names:
            raise KeyError(f"there is no {name!r}: {', '.join(self.names)}")
        return dict(zip(self.headings, self.rows[self.names.index(name)], strict=True))

    def __repr__(self) -> str:
        return f"<{self.title}: {len(self)} rows of {', '.join(self.headings)}>"

    def __str__(self) -> str:
        cells = [[_shortened(cell) for cell in row] for row in self.rows]
        return "\n".join([*wrapped(self.title), *table_lines(columns_of(self.headings, cells, left=len(self.headings)))])

    def _repr_html_(self) -> str:
        return html.page(self.title, html.table(self.headings, [[_text(cell) for cell in row] for row in self.rows], left=len(self.headings)))

    def to_dataframe(self) -> pandas.DataFrame:
        """A DataFrame, its index the first column."""
        import pandas

        return pandas.DataFrame(list(self.rows), columns=list(self.headings)).set_index(self.headings[0])


def _text(cell: Any) -> str:
    if isinstance(cell, float):
        return f"{cell:.6g}"
    return ", ".join(map(str, cell)) if isinstance(cell, tuple | list) else str(cell)


def _shortened(cell: Any) -> str:
    text = _text(cell)
    return text if len(text) <= SHOWN else text[: SHOWN - 4].rstrip() + " ..."
