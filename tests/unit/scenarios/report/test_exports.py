"""Tables as Markdown, LaTeX and XLSX say what the table holds; a PDF needs a browser."""

from __future__ import annotations

import base64
import hashlib
import html
import math
import os
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from openpyxl import load_workbook

from scenarios.report import folder
from scenarios.report.document import Column, Number, Table
from scenarios.report.folder import (
    estimates,
    to_latex,
    to_markdown,
    write_pdf,
    write_workbook,
)
from sim.errors import FlightidError
from tests.pages import PAGE

ROWS = [("Cm_alpha", "1/rad", -1.657, 0.0018), ("L_p", "1/s", -2.5, 0.1), ("x_c", "m", 1.0, 1e30)]
VALUES = st.floats(-1e6, 1e6).filter(lambda value: abs(value) > 1e-6)


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


@given(VALUES, st.floats(1e-4, 0.3))
def test_markdown_rounds_to_the_sigma(value: float, share: float) -> None:
    sigma = share * abs(value)
    heading, rule, row = map(
        cells, to_markdown(estimates("", [("a", "s", value, sigma)])).split("\n")
    )
    assert heading == ["parameter", "unit", "estimate", "+- sigma"]
    assert rule == [":--", ":--", "--:", "--:"]
    assert row[:2] == ["a", "s"]
    assert abs(float(row[2]) - value) <= 0.51 * sigma
    assert abs(float(row[3]) - sigma) <= 0.06 * sigma + 1e-12


def test_latex_is_balanced_and_sets_symbols() -> None:
    text = to_latex(estimates("Fit of 100 %", ROWS))
    lines = text.splitlines()
    assert lines[0] == "% Fit of 100 %" and lines[1] == r"\begin{tabular}{llrr}"
    assert lines[-1] == r"\end{tabular}" and text.count("{") == text.count("}")
    assert r"$C_{m_\alpha}$ & 1/rad & $-1.6570$ & $0.0018$ \\" in lines
    assert r"x\_c & m & not determined & - \\" in lines
    for row in (line for line in lines if line.endswith(r"\\")):
        assert len(re.findall(r"(?<!\\)&", row)) == 3


@pytest.mark.parametrize("mark", [*"&%$#_{}~^\\"])
def test_latex_escapes_what_it_would_read(mark: str) -> None:
    shown = Table("", (Column("a"),), ((f"x{mark}y",),))
    body = to_latex(shown).splitlines()[4]
    assert body.startswith("x\\") and "y" in body


def test_a_workbook_has_full_precision(tmp_path: Path) -> None:
    value, sigma = -math.pi, math.e / 100.0
    first = estimates("a/b: c", [("Cm_q", "1/rad", value, sigma)])
    words = Table("a/b: c", (Column("x"), Column("n", "m")), (("=1+1", Number(2.0)),))
    book = load_workbook(write_workbook([first, words], tmp_path / "t.xlsx"))
    assert book.sheetnames == ["a b c", "a b c 2"]
    rows = [list(row) for row in book["a b c"].values]
    assert rows == [["parameter", "unit", "estimate", "sigma"], ["Cm_q", "1/rad", value, sigma]]
    assert [list(row) for row in book["a b c 2"].values] == [["x", "n, m"], ["'=1+1", 2]]


def test_a_workbook_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(FlightidError, match="cannot be written"):
        write_workbook([estimates("a", ROWS)], tmp_path / "none" / "t.xlsx")
    with pytest.raises(FlightidError, match="no table"):
        write_workbook([], tmp_path / "t.xlsx")


def test_no_browser_and_a_broken_one_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder, "browser", lambda: None)
    with pytest.raises(FlightidError, match="none was found; install"):
        write_pdf(tmp_path)
    monkeypatch.setattr(folder, "browser", lambda: str(tmp_path / "chromium"))
    folder.write_page(tmp_path, PAGE)
    before = {*tmp_path.iterdir()}
    with pytest.raises(FlightidError, match="chromium did not print the page"):
        write_pdf(tmp_path)
    assert {*tmp_path.iterdir()} == before


@pytest.mark.skipif(os.name == "nt", reason="the stand-in for a browser is a shell script")
@pytest.mark.parametrize(("paper", "size"), [("a4", "A4"), ("letter", "letter")])
def test_a_pdf_is_on_the_paper_that_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, paper: str, size: str
) -> None:
    program = tmp_path / "browser"
    program.write_text(
        "#!/bin/sh\n"
        "for word; do case $word in --print-to-pdf=*) out=${word#*=};; file:*) page=${word#file://};;"
        ' esac; done\ncat "$page" > "$out"\n'
    )
    program.chmod(0o755)
    monkeypatch.setattr(folder, "browser", lambda: str(program))
    study = tmp_path / "study"
    study.mkdir()
    folder.write_page(study, PAGE)
    printed = write_pdf(study, paper).read_text(encoding="utf-8")
    assert f"@page {{ size: {size}; margin: 16mm 14mm; }}" in printed
    style = printed.partition("<style>")[2].partition("</style>")[0]
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    # with another hash the browser ignores the style
    assert f"style-src 'sha256-{digest}'" in html.unescape(printed)
    assert "@page { margin:" in (study / "report.html").read_text(encoding="utf-8")
    assert {each.name for each in study.iterdir()} == {"report.html", "report.json", "report.pdf"}


def test_an_unknown_paper_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(FlightidError, match="'a5' is no size of paper; give a4 or letter"):
        write_pdf(tmp_path, "a5")
