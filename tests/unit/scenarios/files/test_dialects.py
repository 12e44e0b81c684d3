"""Records in the dialects of loggers and spreadsheets: whatever separator, decimal mark, quotes,
comments and units, they read back equal.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.files.declarations import ColumnChoice
from scenarios.files.records import read_record

DEGREE = math.pi / 180.0
UNITS = {
    "elevator": {"rad": 1.0, "deg": DEGREE},
    "alpha": {"deg": DEGREE, "rad": 1.0},
    "q": {"deg/s": DEGREE, "rad/s": 1.0},
    "nz": {"g": 1.0},
}
MEASURED = st.floats(-1e6, 1e6) | st.floats(-1e-3, 1e-3) | st.integers(-9999, 9999).map(float)
COMMENTS = st.lists(
    st.text(
        st.characters(codec="utf-8", exclude_characters="\r\n\v\f\x1c\x1d\x1e\x85\u2028\u2029"),
        max_size=20,
    ),
    max_size=3,
)


class Dialect(NamedTuple):
    separator: str
    comma: bool
    mark: bool
    quoted: bool
    end: str
    comments: list[str]
    declared: bool
    units_at: str
    missing: str


DIALECTS = st.builds(
    Dialect,
    st.sampled_from(",;\t"),
    st.booleans(),
    st.booleans(),
    st.booleans(),
    st.sampled_from(["\n", "\r\n"]),
    COMMENTS,
    st.booleans(),
    st.sampled_from(["header", "row", "both"]),
    st.sampled_from(["", "nan", "NA"]),
)


def written(dialect: Dialect, table: dict[str, tuple[str, list[float]]]) -> bytes:
    """A table, name -> unit and numbers, as a logger with this dialect writes it."""
    comma = dialect.comma and dialect.separator != ","

    def number(value: float) -> str:
        return (
            dialect.missing
            if math.isnan(value)
            else repr(value).replace(".", "," if comma else ".")
        )

    def line(cells: list[str]) -> str:
        return dialect.separator.join(f'"{cell}"' if dialect.quoted else cell for cell in cells)

    in_header = dialect.units_at != "row"
    lines = [f"sep={dialect.separator}"] * dialect.declared + [
        f"#{text}" for text in dialect.comments
    ]
    lines.append(
        line([f"{name} [{unit}]" if in_header else name for name, (unit, _) in table.items()])
    )
    lines += (
        [line([f"[{unit}]" for unit, _ in table.values()])] if dialect.units_at != "header" else []
    )
    lines += [
        line([number(value) for value in row])
        for row in zip(*(values for _, values in table.values()), strict=True)
    ]
    text = dialect.end.join(lines) + dialect.end
    return text.encode("utf-8-sig" if dialect.mark else "utf-8")


@st.composite
def records(draw: st.DrawFn) -> dict[str, tuple[str, list[float]]]:
    size = draw(st.integers(2, 6))
    steps = draw(st.lists(st.floats(1e-3, 10.0), min_size=size, max_size=size))
    out: dict[str, tuple[str, list[float]]] = {"time": ("s", [0.0, *np.cumsum(steps).tolist()])}
    for name, units in UNITS.items():
        values = draw(st.lists(MEASURED, min_size=size + 1, max_size=size + 1))
        if name == "q":
            values[draw(st.integers(0, size))] = math.nan
        out[name] = (draw(st.sampled_from(sorted(units))), values)
    return out


@pytest.mark.long
@given(DIALECTS, records(), st.booleans())
@settings(max_examples=60)
def test_a_record_in_any_dialect_reads_back_equal(
    tmp_path_factory: pytest.TempPathFactory,
    dialect: Dialect,
    table: dict[str, tuple[str, list[float]]],
    mapped: bool,
) -> None:
    path = tmp_path_factory.getbasetemp() / "dialect.csv"
    choices = (
        {"alpha": ColumnChoice("AoA, left")}
        if mapped and (dialect.quoted or dialect.separator != ",")
        else None
    )
    path.write_bytes(
        written(
            dialect,
            {
                "AoA, left" if choices and name == "alpha" else name: each
                for name, each in table.items()
            },
        )
    )
    record = read_record(path, ["elevator"], ["alpha", "q", "nz"], choices)
    assert record.time.tolist() == table["time"][1]
    for name, units in UNITS.items():
        unit, values = table[name]
        np.testing.assert_allclose(
            record[name].with_gaps(), units[unit] * np.array(values), rtol=4e-16, equal_nan=True
        )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "time;q;stick;remark\ns;deg/s;in;-\n0,0;180;1;x\n0,5;90;2;y\n",
            {"q": [math.pi, math.pi / 2], "stick": [1.0, 2.0]},
        ),
        ("Zeit;AoA\n[s];[deg]\n0,0;180\n0,5;90\n", {"alpha": [math.pi, math.pi / 2]}),
        ("time;q, rad/s;alpha\n0;1;2\n1;3;4\n", {"alpha": [2.0, 4.0]}),
        ("time;alpha\n0,000;1,500\n1,000;2,500\n", {"alpha": [1.5, 2.5]}),
        ("time;alpha\n0;1500\n1;-2e-3\n", {"alpha": [1500.0, -2e-3]}),
    ],
    ids=["a remark and a label", "a map", "a comma in a name", "three decimals", "whole numbers"],
)
def test_what_loggers_write(tmp_path: Path, text: str, said: dict[str, list[float]]) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    choices = (
        {"time": ColumnChoice("Zeit"), "alpha": ColumnChoice("AoA")}
        if text.startswith("Zeit")
        else None
    )
    record = read_record(
        path,
        ["stick"] if "stick" in said else [],
        [name for name in said if name != "stick"],
        choices,
    )
    for name, values in said.items():
        np.testing.assert_allclose(record[name].values, values, rtol=1e-15)
    assert "stick" not in said or record["stick"].unit == "in"


def test_a_spreadsheets_unicode_text_is_read(tmp_path: Path) -> None:
    path = tmp_path / "sheet.txt"
    path.write_bytes("time\talpha [°]\r\n0,0\t180\r\n0,5\t90\r\n".encode("utf-16"))
    np.testing.assert_allclose(
        read_record(path, (), ["alpha"])["alpha"].values, [math.pi, math.pi / 2], rtol=1e-15
    )
