"""Page of a study folder and its JSON; its tables as Markdown, LaTeX and XLSX; its page as PDF."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scenarios.files.sources import MOST_DOCUMENT, json_or_none, json_value, read_content
from scenarios.files.writing import unwritable, write_json, write_text
from scenarios.report.document import (
    BY_ROW,
    PURE,
    Column,
    Figure,
    Link,
    Number,
    Page,
    Section,
    Table,
    estimate,
    table,
)
from scenarios.report.figure_formats import Drawn
from scenarios.report.html import page_content, page_html, page_of
from scenarios.report.summary import PAGE, TableColumn
from scenarios.report.terminal import printed_columns
from sim.errors import FlightidError

# ---- Markdown and LaTeX, with the digits of the terminal

_LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{mark: f"\\{mark}" for mark in "&%$#_{}"},
}
_SIGNS = {  # Non-ASCII characters of tables in LaTeX.
    "σ": r"$\sigma$",
    "±": r"$\pm$",
    "−": "$-$",
    "–": "--",
    "→": r"$\to$",
    "<": r"$<$",
    ">": r"$>$",
    "\N{NO-BREAK SPACE}": "~",
}
_SYMBOL = re.compile(r"(C[LDmYln]|L|M)_(alpha|beta|delta|de|da|dr|q|p|r|V|0)")
_SUBSCRIPTS = {
    "alpha": r"\alpha",
    "beta": r"\beta",
    "delta": r"\delta",
    "de": r"{\delta_e}",
    "da": r"{\delta_a}",
    "dr": r"{\delta_r}",
}


def estimates(caption: str, rows: Sequence[tuple[str, str, float, float]]) -> Table:
    """Return a table of estimates.

    Parameters
    ----------
    caption : title of the table.
    rows : name, unit, value and standard deviation of each parameter; an infinite standard
        deviation says that the data do not determine the parameter.

    Returns
    -------
    Table
        Parameter, unit, estimate and sigma.

    Examples
    --------
    >>> print(to_markdown(estimates("", [("Cm_q", "1/rad", -34.712, 0.09)])))
    | parameter | unit | estimate | +- sigma |
    | :-- | :-- | --: | --: |
    | Cm_q | 1/rad | -34.712 | 0.090 |
    """
    return table(
        caption,
        (Column("parameter"), [name for name, *_ in rows]),
        (Column("estimate", BY_ROW), [estimate(value, sigma) for _, _, value, sigma in rows]),
        units=[unit or PURE for _, unit, *_ in rows],
    )


def to_markdown(shown: Table) -> str:
    """Return a table as Markdown (pipe table of GitHub and Pandoc) below its caption in bold."""
    columns = printed_columns(shown)
    lines = [
        _markdown_row([_heading(column) for column in columns]),
        _markdown_row([":--" if column.left else "--:" for column in columns]),
        *(_markdown_row(row) for row in _rows(columns)),
    ]
    title = f"**{_one_line(shown.caption)}**\n\n" if shown.caption else ""
    return title + "\n".join(lines)


def to_latex(shown: Table) -> str:
    r"""Return a table as LaTeX: a ``tabular`` with the rules of the package ``booktabs``.

    Derivatives become symbols (``Cm_alpha`` is :math:`C_{m_\alpha}`). The caption is a comment
    above the table, because its place depends on the document.
    """
    columns = printed_columns(shown)
    sides = "".join("l" if column.left else "r" for column in columns)
    body = [_latex_row(row) for row in _rows(columns)]
    heading = _latex_row([_heading(column).replace("+-", "±") for column in columns])
    title = [f"% {' '.join(shown.caption.split())}"] if shown.caption else []
    return "\n".join(
        [
            *title,
            f"\\begin{{tabular}}{{{sides}}}",
            "\\toprule",
            heading,
            "\\midrule",
            *body,
            "\\bottomrule",
            "\\end{tabular}",
        ]
    )


def _heading(column: TableColumn) -> str:
    """Return the heading of a column without ``± σ``: sigmas have another column."""
    return column.heading.strip().removesuffix(" ± σ")


def _rows(columns: Sequence[TableColumn]) -> list[tuple[str, ...]]:
    return list(zip(*(column.cells for column in columns), strict=True))


def _one_line(text: str) -> str:
    """Return a text in one line that Markdown does not read as several cells."""
    return " ".join(text.split()).replace("|", r"\|")


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(_one_line(cell) for cell in cells)} |"


def _latex_row(cells: Sequence[str]) -> str:
    return f"{' & '.join(map(_latex_cell, cells))} \\\\"


def _latex_cell(text: str) -> str:
    """Return a cell in LaTeX: derivatives, numbers and powers of units in mathematics."""
    if found := _SYMBOL.fullmatch(text):
        name, subscript = found[1], _SUBSCRIPTS.get(found[2], found[2])
        if len(name) == 2:
            return f"${name[0]}_{{{name[1]}_{subscript}}}$"
        return f"${name}_{subscript}$"
    if re.fullmatch(r"[+-]?[\d.]+(e[+-]?\d+)?", text):
        return f"${text}$"
    if "^" not in text and (power := re.fullmatch(r"(.*[A-Za-z])([234])", text)):
        return f"{_escaped(power[1])}$^{power[2]}$"
    return _escaped(text)


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(mark) or _SIGNS.get(mark, mark) for mark in text)


# ---- XLSX: full precision

_NOT_IN_SHEET = re.compile(r"[\[\]:*?/\\']")
_LONGEST_SHEET_NAME = 31  # letters of a sheet's name in XLSX


def write_workbook(tables: Sequence[Table], path: Path) -> Path:
    """Write tables as a workbook, a sheet each; numbers have their full precision.

    Parameters
    ----------
    tables : the tables; captions become names of sheets.
    path : path of the ``.xlsx`` file.

    Raises
    ------
    FlightidError
        The package ``openpyxl`` is not installed, there is no table, or the file cannot be written.
    """
    try:
        from openpyxl import Workbook
        from openpyxl.styles import Font
    except ImportError:
        raise FlightidError(
            "writing XLSX needs the package openpyxl",
            where=str(path),
            remedy='in the folder of the project: python -m pip install -e ".[spreadsheets]"',
        ) from None
    if not tables:
        raise FlightidError("there is no table", where=str(path), remedy="name another study")
    book = Workbook()
    book.remove(book.active)
    for shown in tables:
        sheet = book.create_sheet(_sheet_name(shown.caption, book.sheetnames))
        for row in _sheet_rows(shown):
            sheet.append(row)
        for cell in sheet[1]:
            cell.font = Font(bold=True)
        sheet.freeze_panes = "A2"
    try:
        book.save(path)
    except OSError as error:
        raise unwritable(path, error, "name a file that you may write") from None
    return path


def _sheet_name(caption: str, used: Sequence[str]) -> str:
    """Return a permitted name for a sheet, other than those ``used``."""
    plain = " ".join(_NOT_IN_SHEET.sub(" ", caption).split())
    plain = plain[:_LONGEST_SHEET_NAME].strip() or "table"
    name, number = plain, 2
    while name.lower() in map(str.lower, used):
        suffix = f" {number}"
        name, number = plain[: _LONGEST_SHEET_NAME - len(suffix)] + suffix, number + 1
    return name


def _sheet_rows(shown: Table) -> list[list[str | float | None]]:
    """Return the headings and then the rows; a sigma is in the column after its value."""
    has_sigma = [
        any(isinstance(cell, Number) and cell.sigma for cell in cells)
        for cells in (zip(*shown.rows, strict=True) if shown.rows else [()] * len(shown.columns))
    ]
    headings: list[str | float | None] = []
    for number, column in enumerate(shown.columns):
        unit = f", {column.unit}" if column.unit not in (None, PURE, BY_ROW) else ""
        headings.append(f"{column.heading.replace(' ± σ', '')}{unit}")
        headings += ["sigma"] if has_sigma[number] else []
        headings += ["unit"] if number == 0 and shown.units else []
    sheet_rows = [headings]
    for row, unit in zip(shown.rows, shown.units or [""] * len(shown.rows), strict=True):
        sheet_row: list[str | float | None] = []
        for number, cell in enumerate(row):
            text = cell.text if isinstance(cell, Link) else cell
            # A spreadsheet would read such a text as a formula.
            if isinstance(text, str) and text[:1] in ("=", "+", "@"):
                text = f"'{text}"
            sheet_row.append(text.value if isinstance(text, Number) else text)
            if has_sigma[number]:
                sheet_row.append(text.sigma if isinstance(text, Number) else None)
            sheet_row += [unit] if number == 0 and shown.units else []
        sheet_rows.append(sheet_row)
    return sheet_rows


# ---- All tables of a page

TABLES = "tables.md", "tables.tex", "tables.xlsx"


def tables_of(page: Page) -> tuple[Table, ...]:
    """Return the tables of a page in their order; a table without a caption gets that of its
    section.
    """

    def tables_in(sections: Sequence[Section]) -> Iterator[Table]:
        for each in sections:
            for block in each.blocks:
                if isinstance(block, Table):
                    yield replace(block, caption=block.caption or each.title)
            yield from tables_in(each.parts)

    return tuple(tables_in(page.sections))


def write_tables(page: Page, folder: Path) -> tuple[Path, ...]:
    """Write all tables of a page as Markdown, LaTeX and XLSX next to it; return the files."""
    tables = tables_of(page)
    markdown, latex, book = (folder / name for name in TABLES)
    write_workbook(tables, book)
    for path, show in ((markdown, to_markdown), (latex, to_latex)):
        text = "\n\n".join(map(show, tables)) + "\n"
        path.write_text(text, encoding="utf-8", newline="\n")
    return markdown, latex, book


# ---- PDF by a browser without a window

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PDF = "report.pdf"
PAPERS = {"a4": "A4", "letter": "letter"}  # word of ``--paper`` -> size of a page in CSS
BROWSER_TIMEOUT = 60.0  # s


def browser() -> str | None:
    """Return the path of Chromium or Chrome: on the search path, else installed by Playwright."""
    for name in BROWSERS:
        if found := shutil.which(name):
            return found
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return None
    with sync_playwright() as driver:
        path = driver.chromium.executable_path
    return path if Path(path).is_file() else None


def write_pdf(folder: Path, paper: str = "a4") -> Path:
    """Print the page of a study folder as ``report.pdf`` in that folder, by Chromium or Chrome.

    ``paper`` is a key of ``PAPERS``.

    Raises
    ------
    FlightidError
        There is no such paper or no such browser, the folder has no content of a page, or the
        browser did not print.
    """
    if paper not in PAPERS:
        raise FlightidError(
            f"{paper!r} is no size of paper",
            where="--paper",
            remedy=f"give {' or '.join(PAPERS)}",
        )
    program = browser()
    if program is None:
        raise FlightidError(
            "a PDF needs Chromium or Chrome, and none was found",
            where=str(folder / PAGE),
            remedy="install one of them, or print the page from your own browser",
        )
    target = folder / PDF
    with TemporaryDirectory(prefix="flightid-") as scratch, _sized(folder, paper) as page:
        printed = Path(scratch) / PDF
        command = [
            program,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-pdf-header-footer",
            f"--user-data-dir={scratch}/profile",
            f"--print-to-pdf={printed}",
            page.resolve().as_uri(),
        ]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=BROWSER_TIMEOUT)
            content = printed.read_bytes()
        except (OSError, subprocess.SubprocessError):
            raise FlightidError(
                f"{Path(program).name} did not print the page",
                where=str(folder / PAGE),
                remedy="print the page from your own browser",
            ) from None
    target.write_bytes(content)
    return target


@contextmanager
def _sized(folder: Path, paper: str) -> Iterator[Path]:
    """Yield a copy of a folder's page that prints on a paper; it is deleted afterwards.

    Chromium has no option for the paper and takes US letter. The copy is beside the page, so that
    relative links lead to the same files.
    """
    copy = folder / f".printed-{PAGE}"
    text = page_html(stored_page(folder), PAPERS[paper])
    try:
        write_text(copy, text)
        yield copy
    finally:
        copy.unlink(missing_ok=True)


# ---- Page of a study folder

CONTENT = "report.json"
_DOCUMENTS = (
    "comparison.json",
    "diagnosis.json",
    "compatibility.json",
    "campaign.json",
    "compared.json",
    "design.json",
    "survey.json",
    "maneuvers.json",
    "responses.json",
)


def write_page(folder: Path, page: Page) -> None:
    """Write ``report.json`` and ``report.html`` into an existing folder."""
    write_json(folder / CONTENT, page_content(page))
    write_text(folder / PAGE, page_html(page))


def rebuilt(folder: str | Path) -> Path:
    """Make ``report.html`` from ``report.json`` and return its path.

    Raises
    ------
    FlightidError : there is no such folder, no content of a page in it, or one that cannot be read.
    """
    folder = Path(folder)
    text = page_html(stored_page(folder))
    target = folder / PAGE
    try:
        write_text(target, text)
    except OSError as error:
        raise unwritable(target, error) from None
    return target


def stored_page(folder: Path) -> Page:
    """Return the page that ``report.json`` of a folder describes.

    Raises
    ------
    FlightidError : there is no such folder, no content of a page in it, or one that cannot be read.
    """
    source = folder / CONTENT
    if not folder.is_dir():
        raise FlightidError(
            "there is no such folder",
            where=str(folder),
            remedy="name the folder of a study, what --out was given",
        )
    if not source.is_file():
        reason = (
            "the study is of an older version" if _document(folder) else "it is no study folder"
        )
        raise FlightidError(
            f"has no {CONTENT}: {reason}", where=str(folder), remedy=_command_again(folder)
        )
    content = read_content(source, FlightidError, "the folder of a study", MOST_DOCUMENT)
    try:
        return page_of(json_value(content))
    except (KeyError, TypeError, ValueError, AttributeError, FlightidError):
        raise FlightidError(
            "is no content of a page that this version can show",
            where=str(source),
            remedy=_command_again(folder),
        ) from None


def figures(drawn: Sequence[Drawn]) -> tuple[Figure, ...]:
    """Return drawn figures as blocks of a page."""
    return tuple(Figure(f"figure-{each.stem}", each.svg, each.caption, each.plot) for each in drawn)


def first_figure(drawn: Sequence[Drawn]) -> tuple[tuple[Figure, ...], tuple[Figure, ...]]:
    """Return the figure of the fit, with which a page begins, and the other figures.

    The figure of the record is left out if there is a figure of the fit, which shows the same data.
    """
    fit = [figure for figure in drawn if figure.stem == "fit"]
    shown_before = ("fit", "record") if fit else ()
    return figures(fit), figures([figure for figure in drawn if figure.stem not in shown_before])


def _command_again(folder: Path) -> str:
    """Return advice on how to repeat a study, with the command if the folder contains it."""
    document = _document(folder)
    name = document.get("scenario")
    if not document:
        return "name the folder that --out was given"
    if (
        document.get("schema") == "flightid/comparison/1"
        and isinstance(name, str)
        and "seed" in document
    ):
        return f"run it again: flightid run {name} --seed {document['seed']} --out {folder}"
    if isinstance(name, str) and "runs" in document:
        seed = document.get("seed", document.get("first_seed", 1))
        return (
            f"run it again: flightid campaign {name} --runs {document['runs']} --seed {seed} --out "
            f"{folder}"
        )
    return f"run its command again with --out {folder}"


def _document(folder: Path) -> dict[str, Any]:
    """Return the content of the study's main JSON file; empty if there is none."""
    for name in _DOCUMENTS:
        content = json_or_none(folder / name)
        if isinstance(content, dict) and str(content.get("schema", "")).startswith("flightid/"):
            return content
    return {}
