"""Spreadsheets (XLSX, XLSM, XLSB, XLS, ODS) by python-calamine: each sheet with a header row is a
topic.
"""

from __future__ import annotations

import datetime
import io
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.formats.cells import (
    CellTable,
    Topic,
    damaged,
    header_cell,
    header_row,
    missing_library,
    no_table,
    unit_row,
    width_of,
)

FORMAT = "spreadsheet"
SUFFIXES = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
MAGIC = (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", b"PK\x03\x04")
EXTRA = "spreadsheets"


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return one topic for each sheet with a table. Its name is that of the sheet if there are
    several.
    """
    try:
        from python_calamine import CalamineWorkbook
    except ImportError as error:
        raise missing_library(error, path, "spreadsheets", EXTRA) from None
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(raw))
        sheets = [
            (name, book.get_sheet_by_name(name).to_python(skip_empty_area=False))
            for name in book.sheet_names
        ]
    except BaseException as error:  # errors of the compiled library are no Exception
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        raise damaged(error, path, FORMAT) from None
    tables = [
        (name, table) for name, rows in sheets if (table := _table(path, name, rows)) is not None
    ]
    if not tables:
        raise no_table(
            path,
            [name for name, _ in sheets],
            "give a sheet with a header row and one row a sample",
        )
    return tuple(Topic(name if len(tables) > 1 else "", table) for name, table in tables)


def _table(path: Path, sheet: str, rows: list[list[Any]]) -> CellTable | None:
    """Return the table of a sheet; None if the sheet has no header with a row of numbers below."""
    texts = [["" if cell is None else str(cell) for cell in row] for row in rows]
    head = header_row(texts)
    if head is None or head + 1 >= len(rows):
        return None
    width = width_of(texts[head])
    where = f"{path}, sheet {sheet!r}"
    header = tuple(header_cell(cell, where) for cell in texts[head][:width])
    units = unit_row(header, texts[head + 1][:width])
    begin = head + (2 if units else 1)
    filled_rows = [
        i for i in range(begin, len(rows)) if any(cell.strip() for cell in texts[i][:width])
    ]
    columns = tuple(_column([rows[i][column] for i in filled_rows]) for column in range(width))
    return CellTable(
        where,
        header,
        columns,
        np.array(filled_rows, dtype=int) + 1,
        units=units,
    )


def _column(cells: list[Any]) -> np.ndarray:
    """Return a column as floats if every cell is a number or empty; else as cells, with dates and
    times of day as ISO texts.
    """
    if all(isinstance(cell, int | float) or cell in ("", None) for cell in cells):
        return np.array(
            [np.nan if cell in ("", None) else float(cell) for cell in cells], dtype=float
        )
    column = np.empty(len(cells), dtype=object)
    column[:] = [_cell(cell) for cell in cells]
    return column


def _cell(cell: Any) -> Any:
    """Return a cell with a date or time of day as ISO text, a duration in s, and None if empty."""
    if isinstance(cell, datetime.datetime | datetime.date | datetime.time):
        return cell.isoformat()
    if isinstance(cell, datetime.timedelta):
        return cell.total_seconds()
    return None if cell == "" else cell
