"""Plain tables: within the width, no number cut, nothing lost but what is said to be left out."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.tracing.diagnosis import Verdict
from scenarios.diagnosis.report.text import diagnosis_text
from scenarios.terminal.plain_tables import WIDTH, table, wrapped
from tests.diagnoses import proven_tracing, tracing_of

HEADS = ("round", "candidate", "gain", "p", "held-out", "parameters", "remarks")
ROWS = [
    ("1", "sensor-lag:alpha", "420.0", "3e-90", "-74.0 %", "time_constant 0.061 +- 0.002 s", "like sensor-delay:alpha, vane-offset"),
    ("2", "actuator-saturation + unmeasured-input", "928.3", "<1e-300", "-", "start 17.976 +- 0.002 s, lift 0.0254 +- 0.0006", ""),
]


@given(st.integers(78, 160))
def test_candidates_fit_and_their_numbers_stay_whole(width: int) -> None:
    lines = table(HEADS, ROWS, left=2, width=width, spare=("p", "parameters"))
    assert max(len(line) for line in lines) <= width
    words = " ".join(lines).split()
    assert {"420.0", "928.3", "-74.0", "like", "unmeasured-input"} <= set(words)
    for name, cells in (("p", {"3e-90", "<1e-300"}), ("parameters", {"0.061", "17.976", "0.0254"})):
        assert cells <= set(words) or name in " ".join(lines).partition("for want of room: ")[2]


def test_a_table_that_fits_is_not_touched() -> None:
    wide = table(HEADS, ROWS, left=2, width=200, spare=("p", "parameters"))
    assert len(wide) == 3 and "want of room" not in wide[-1]
    assert wide[1].index("420.0") + 5 == wide[2].index("928.3") + 5, "numbers end in one column"
    assert table(HEADS, []) == [] and table(("a", "b"), [("1", "2")], title="t")[0] == "t"


def test_a_name_longer_than_its_column_is_parted_behind_a_colon_or_a_hyphen() -> None:
    rows = [("1", "guard:drifting-derivatives:side_force", "7.0", "x" * 40), ("2", "a", "8.0", "b c d " * 9)]
    lines = table(("round", "candidate", "gain", "remarks"), rows, left=2, width=76)
    assert [line.split()[:2] for line in lines[1:3]] == [["1", "guard:drifting-derivatives:"], ["side_force"]]
    assert lines[1].index("7.0") == next(line for line in lines if "8.0" in line).index("8.0")


def test_a_folded_cell_goes_on_in_its_own_column() -> None:
    lines = table(("effect", "parameters"), [("speed-variation", "one two three four five six seven eight nine ten")], width=46)
    at = lines[0].index("parameters")
    assert all(line[:at].strip() in ("effect", "speed-variation", "") for line in lines)
    assert " ".join(line[at:] for line in lines[1:]) == "one two three four five six seven eight nine ten"


@pytest.mark.parametrize("width", [80, 100, WIDTH])
def test_a_diagnosis_fits_its_terminal(width: int) -> None:
    for tracing in (proven_tracing(), *(tracing_of(verdict) for verdict in Verdict)):
        assert max(len(line) for line in diagnosis_text(tracing, width).splitlines()) <= width


def test_a_paragraph_moves_its_further_lines_in() -> None:
    assert wrapped("one two three", 10) == ["one two", "  three"]
