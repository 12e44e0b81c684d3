"""Lines to rows: the same numbers as a record's reader, and every line that cannot be used told
apart and counted.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.files.declarations import ColumnChoice
from scenarios.files.records import read_record
from scenarios.watching.line_cells import is_row, numbers_of, plain_numbers
from scenarios.watching.rows import (
    LONGEST_BRIDGED_GAP,
    Header,
    Lines,
    Order,
    at_end,
    in_order,
    lines_of,
    read_header,
    read_lines,
)
from sim.errors import RecordError

PLAIN = read_header(b"time,stick,alpha,q,nz", "stream")


def rows(
    text: str, header: Header = PLAIN, order: Order | None = None
) -> tuple[np.ndarray, list[tuple[int, str]], Order]:
    """Rows of lines from row 2 on, and what is wrong with those that are not among them."""
    table, numbers, faults = read_lines(header, text.encode().split(b"\n"), 2)
    kept, disorder, order = in_order(table, numbers, order or Order())
    return kept, [(fault.row, fault.what) for fault in sorted([*faults, *disorder])], order


def test_units_and_header_rules_are_those_of_records(tmp_path: Path) -> None:
    text = (
        "time_ms,stick [in],alpha_deg,q (deg/s),nz "
        "[m/s2],other\n0,0.1,1.5,-3,9.7,x\n25,0.2,,2.25,9.9,y\n50,0.3,1.0,1.0,,z\n"
    )
    (tmp_path / "record.csv").write_text(text)
    record = read_record(tmp_path / "record.csv", ["stick"], ["alpha", "q", "nz"])
    first, *lines = text.encode().splitlines()
    table, numbers, faults = read_lines(read_header(first, "stream"), lines, 2)
    assert (numbers, faults) == ([2, 3, 4], [])
    np.testing.assert_array_equal(
        table, [record.time, *(channel.with_gaps() for channel in record.channels)]
    )
    assert read_header(first, "stream").stick_unit == record["stick"].unit == "in"


def test_a_channel_map_and_the_sidecars_units_serve() -> None:
    header = read_header(
        b"t,stick,AoA1,q",
        "stream",
        {"time": ColumnChoice("t"), "alpha": ColumnChoice("AoA1", "deg")},
        {"q": "deg/s"},
    )
    table, _, _ = read_lines(header, [b"1,0,180,180"], 2)
    np.testing.assert_allclose(table[:, 0], [1.0, 0.0, math.pi, math.pi, math.nan])


@pytest.mark.parametrize(
    ("line", "word"),
    [
        (b"time,alpha,q", "no column 'stick'"),
        (b"stick,alpha,q", "no column 'time'"),
        (b"time,stick,theta", "no column 'alpha'"),
        (b"time;stick;theta", "no column 'alpha'"),
        (b"time,stick,alpha [kg]", "does not measure an angle"),
        (b"time,stick,\xff\xfe", "not UTF-8"),
        (b"time,stick,alpha,alpha", "are all alpha"),
    ],
)
def test_headers_that_are_refused(line: bytes, word: str) -> None:
    with pytest.raises(RecordError, match=word):
        read_header(line, "stream")


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("0.1,0,0,0", "4 cells under a header of 5"),
        ("0.1,0,0,0,0,0", "6 cells under a header of 5"),
        ("0.1,0,up,0,0", "'up' is not a number"),
        ("0.1,0,1_0,0,0", "'1_0' is not a number"),
        ("0.1,0,inf,0,0", "'inf' is no measurement"),
        ("0.1,0,1e60,0,0", "'1e60' is no measurement"),
        ("0.1,0,\u00b5,0,0", "not plain text"),
        (",0,0,0,0", "time is missing"),
        ("0.0,0,0,0,0", "time is repeated (0 s, then 0 s)"),
        ("-1,0,0,0,0", "time goes back (0 s, then -1 s)"),
        ("time,stick,alpha,q,nz", "'time' is not a number"),
    ],
)
def test_a_bad_line_is_left_out_and_told(line: str, word: str) -> None:
    kept, faults, _ = rows(f"-0.05,0,0,0,0\n0,0,0,0,0\n{line}\n0.2,0,0,0,0")
    np.testing.assert_array_equal(kept[0], [-0.05, 0.0, 0.2])
    assert faults == [(4, word)]


@given(
    st.lists(
        st.one_of(st.floats().map(repr), st.text('0123456789.+-eEinfa_ \t"x\u0663', max_size=6)),
        min_size=4,
        max_size=6,
    )
)
def test_plain_lines_are_read_as_all_others_are(cells: list[str]) -> None:
    line = ",".join(cells).encode()
    found = plain_numbers(line, (0, 2, 3), 5)
    if found is not None:
        np.testing.assert_array_equal(found, numbers_of(line, (0, 2, 3), 5))


def test_numbers_of_fortran_are_read_as_in_records() -> None:
    assert numbers_of(b"1.5D+01,2,-3.d-1", (0, 2), 3) == [15.0, -0.3]


def test_missing_samples_and_sticks() -> None:
    kept, faults, _ = rows("0,,0,0,0\n0.1,0.5,,,\n0.2,,1,nan,NA\n\n0.3,0.7,1,1,1\n0.4,0.8,1,1,1")
    np.testing.assert_array_equal(kept[:2], [[0.1, 0.2, 0.3, 0.4], [0.5, 0.5, 0.7, 0.8]])
    assert np.isnan(kept[2:, 0]).all() and kept[2, 1] == 1.0 and np.isnan(kept[3:, 1]).all()
    assert faults == [
        (2, "the stick is missing, and there is none before"),
        (4, "the stick is missing, the last one holds"),
    ]


def test_a_stamp_far_ahead_waits_for_the_next() -> None:
    kept, faults, order = rows("0,0,0,0,0\n0.1,0,0,0,0\n500,0,0,0,0\n0.2,0,0,0,0\n0.3,0,0,0,0")
    np.testing.assert_array_equal(kept[0], [0.0, 0.1, 0.2, 0.3])
    assert faults == [(4, "time jumps ahead (0.1 s, then 500 s) and comes back")]
    kept, faults, order = rows("30,0,0,0,0\n30.1,0,0,0,0\n30.2,0,0,0,0", order=order)
    np.testing.assert_array_equal(kept[0], [30.0, 30.1, 30.2])
    assert not faults


def test_a_first_stamp_that_is_wrong_does_not_lock_out_the_stream() -> None:
    kept, faults, _ = rows("1e9,0,0,0,0\n0.1,0,0,0,0\n0.2,0,0,0,0")
    np.testing.assert_array_equal(kept[0], [0.1, 0.2])
    assert [row for row, _ in faults] == [2]


def test_a_row_that_waits_at_the_end_is_taken() -> None:
    _, _, order = rows("0,0,0,0,0\n0.1,0,0,0,0\n9,0.5,1,2,3")
    kept, faults, _ = at_end(order)
    np.testing.assert_array_equal(kept[:, 0], [9.0, 0.5, 1.0, 2.0, 3.0])
    assert not faults and at_end(Order())[0].shape == (5, 0)


def test_nothing_is_taken_once_the_motion_is_lost() -> None:
    late = LONGEST_BRIDGED_GAP + 10.0
    kept, faults, order = rows(
        f"0,0,0,0,0\n0.1,0,0,0,0\n{late},0,0,0,0\n{late + 0.1},0,0,0,0\n{late + 0.2},0,0,0,0"
    )
    np.testing.assert_array_equal(kept[0], [0.0, 0.1])
    assert [row for row, _ in faults] == [4, 5, 6] and order.lost == 0.1


@given(st.lists(st.floats(-10.0, 10.0), max_size=30), st.integers(0, 30))
def test_times_increase_whatever_comes_and_however_it_is_cut(times: list[float], cut: int) -> None:
    table = np.vstack([times, np.zeros((4, len(times)))]) if times else np.zeros((5, 0))
    numbers = list(range(len(times)))
    whole, faults, order = in_order(table, numbers, Order())
    first, some, middle = in_order(table[:, :cut], numbers[:cut], Order())
    second, more, last = in_order(table[:, cut:], numbers[cut:], middle)
    assert (np.diff(np.append(whole[0], at_end(order)[0][0])) > 0).all()
    np.testing.assert_array_equal(np.hstack([first, second]), whole)
    assert some + more == faults and last.time == order.time
    waiting = int(order.waiting is not None)
    assert whole.shape[1] + len(faults) + waiting == len(times)


@given(st.lists(st.binary(min_size=1, max_size=9), max_size=12))
def test_lines_do_not_depend_on_how_the_bytes_came(pieces: list[bytes]) -> None:
    given_pieces = iter([*pieces, None])
    found = list(lines_of(lambda: next(given_pieces), None, "stream"))
    *whole, rest = b"".join(pieces).split(b"\n")
    assert [line for each in found for line in each.whole] == [
        line.removesuffix(b"\r") for line in whole
    ]
    assert found[-1] == Lines([], rest)


def test_a_silent_source_ends_and_a_line_without_end_is_refused() -> None:
    assert list(lines_of(lambda: b"", 0.0, "stream")) == [Lines([], b"")]
    endless = iter([b"x" * (1 << 21), None])
    with pytest.raises(RecordError, match="a line without end"):
        list(lines_of(lambda: next(endless), None, "stream"))


@pytest.mark.parametrize("mark", [";", "\t"])
@pytest.mark.parametrize("decimal", [",", "."])
def test_semicolons_tabs_and_decimal_commas_are_read_as_in_records(
    mark: str, decimal: str, tmp_path: Path
) -> None:
    text = "time,stick [in],alpha_deg,q,nz\n0,0.5,1.25,,1\n0.02,-0.125,1,0.5,0.75\n"
    text = text.replace(",", mark).replace(".", decimal)
    (tmp_path / "record.csv").write_text(text)
    record = read_record(tmp_path / "record.csv", ["stick"], ["alpha", "q", "nz"])
    first, *lines = text.encode().splitlines()
    table, _, faults = read_lines(read_header(first, "stream"), lines, 2)
    assert faults == []
    np.testing.assert_array_equal(
        table, [record.time, *(channel.with_gaps() for channel in record.channels)]
    )


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("1,500;0;0;0;0", "'1,500' may be a decimal number or one with its thousands parted"),
        ("0,5;0.5;0;0;0", "'0.5' has a point among decimal commas"),
    ],
)
def test_decimal_marks_that_cannot_be_told_are_left_out(line: str, word: str) -> None:
    header = read_header(b"time;stick;alpha;q;nz", "stream")
    _, _, faults = read_lines(header, [line.encode()], 2)
    assert [fault.what for fault in faults] == [word]


def test_a_first_row_of_decimal_commas_has_semicolons_between_its_cells() -> None:
    names = ["time", "stick", "alpha", "q", "nz"]
    line = b"0,5;0,25;0,125;0;1"
    assert is_row(line, "stream")
    table, _, faults = read_lines(read_header(line, "stream", names=names), [line], 1)
    assert not faults and table[:, 0].tolist() == [0.5, 0.25, 0.125, 0.0, 1.0]
