"""Records from CSV, Parquet and MAT: headers, units, channel maps, windows, sidecars."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from scenarios.files.declarations import ColumnChoice, read_channel_map
from scenarios.files.records import read_record, rows_between
from sim.errors import RecordError
from sim.record import Hold

SHARED = Path(__file__).parents[5] / "shared"


def csv_file(folder: Path, text: str, name: str = "run.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode())
    return path


def test_header_cells_carry_units(tmp_path: Path) -> None:
    path = csv_file(
        tmp_path,
        "time_ms, elevator_deg ,alpha [deg],q_deg_s,nz "
        "(m/s2),remark\n0,90,180,360,9.80665,x\n100,0,,-180,0,y\n",
    )
    record = read_record(path, ["elevator"], ["alpha", "q", "nz"])
    np.testing.assert_allclose(record.time, [0.0, 0.1], rtol=1e-15)
    np.testing.assert_allclose(record["elevator"].values, [math.pi / 2, 0.0], rtol=1e-15)
    np.testing.assert_allclose(record["alpha"].values, [math.pi, 0.0], rtol=1e-15)
    np.testing.assert_allclose(record["q"].values, [2 * math.pi, -math.pi], rtol=1e-15)
    np.testing.assert_allclose(record["nz"].values, [1.0, 0.0], rtol=1e-15)
    assert record["alpha"].valid.tolist() == [True, False]
    assert [channel.unit for channel in record.channels] == ["rad", "rad", "rad/s", "g"]
    assert record.hold is Hold.PREVIOUS and record.name == "run.csv"


def test_missing_samples_have_several_spellings(tmp_path: Path) -> None:
    record = read_record(
        csv_file(tmp_path, "time,q,alpha\n0,1,1\n1,,NaN\n2,nan,NA\n3, n/a ,-nan\n"),
        (),
        ["q", "alpha"],
    )
    assert (
        record["q"].valid.tolist() == record["alpha"].valid.tolist() == [True, False, False, False]
    )


def test_absent_outputs_are_left_out_and_optional_ones_come_last(tmp_path: Path) -> None:
    path = csv_file(tmp_path, "az,time,q,theta_deg\n-9.8,0,1,180\n-9.8,1,1,0\n")
    assert read_record(path, (), ["alpha", "q", "nz"]).output_names == ("q",)
    record = read_record(path, (), ["alpha", "q", "nz"], optional=["theta", "airspeed", "az", "q"])
    assert record.output_names == ("q", "theta", "az")
    assert record["theta"].values[0] == pytest.approx(math.pi, rel=1e-15)


def test_the_stick_keeps_numbers_and_label(tmp_path: Path) -> None:
    for header, label in (
        ("stick", "1"),
        ("stick [in]", "in"),
        ("stick_deg", "deg"),
        ("stick [nonsense]", "nonsense"),
    ):
        stick = read_record(
            csv_file(tmp_path, f"time,{header},q\n0,2.5,0\n1,3,0\n"), ["stick"], ["q"]
        )["stick"]
        assert stick.unit == label and stick.values.tolist() == [2.5, 3.0]


@pytest.mark.parametrize("other", ["alpha_true", "alpha_m", "alpha_std"])
def test_a_word_that_is_no_unit_of_the_channel_is_another_signal(
    tmp_path: Path, other: str
) -> None:
    path = csv_file(tmp_path, f"time,{other},alpha\n0,5,1\n1,5,1\n")
    assert read_record(path, (), ["alpha"])["alpha"].values.tolist() == [1.0, 1.0]


def test_channel_map_finds_other_headers(tmp_path: Path) -> None:
    path = csv_file(tmp_path, "T,AoA1,gyro [deg/s],alpha\n0,180,180,7\n1,0,0,7\n")
    table = tmp_path / "map.toml"
    table.write_text('time = "T"\nalpha = {column = "AoA1", unit = "deg"}\nq = "gyro"\n')
    record = read_record(path, (), ["alpha", "q"], read_channel_map(table))
    stick = read_record(
        path,
        ["stick"],
        ["alpha"],
        {"time": ColumnChoice("T"), "stick": ColumnChoice("alpha", "in")},
    )["stick"]
    assert stick.unit == "in" and stick.values.tolist() == [7.0, 7.0]
    assert record["alpha"].values[0] == record["q"].values[0] == pytest.approx(math.pi, rel=1e-15)


def test_sidecar_gives_hold_name_and_units(tmp_path: Path) -> None:
    path = csv_file(tmp_path, "time,stick,alpha,q [rad/s]\n0,1,180,1\n1,1,0,1\n")
    sidecar = {
        "schema": "flightid/record/1",
        "name": "doublet",
        "hold": "linear",
        "units": {"stick": "in", "alpha": "deg", "q": "deg/s"},
    }
    (tmp_path / "run.json").write_text(json.dumps(sidecar))
    record = read_record(path, ["stick"], ["alpha", "q"])
    assert record.hold is Hold.LINEAR and record.name == "doublet" and record["stick"].unit == "in"
    assert record["alpha"].values[0] == pytest.approx(math.pi, rel=1e-15)
    assert record["q"].values[0] == 1.0  # the header has the last word
    assert read_record(path, ["stick"], ["alpha"], hold=Hold.PREVIOUS).hold is Hold.PREVIOUS


@pytest.mark.parametrize(
    "other", ["[1]", "{}", '{"schema": "other/1", "hold": "cubic"}', '{"altitude": 3}']
)
def test_a_json_of_another_program_is_ignored(tmp_path: Path, other: str) -> None:
    path = csv_file(tmp_path, "time,q\n0,1\n1,1\n")
    (tmp_path / "run.json").write_text(other)
    assert read_record(path, (), ["q"]).hold is Hold.PREVIOUS


@pytest.mark.parametrize(
    ("key", "value"),
    [("hold", '"cubic"'), ("name", "3"), ("units", '{"q": 3}'), ("schema", '"flightid/record/2"')],
    ids=["hold", "name", "units", "schema"],
)
def test_a_wrong_sidecar_is_refused(tmp_path: Path, key: str, value: str) -> None:
    path = csv_file(tmp_path, "time,q\n0,1\n1,1\n")
    schema = "" if key == "schema" else '"schema": "flightid/record/1", '
    (tmp_path / "run.json").write_text(f'{{{schema}"{key}": {value}}}')
    with pytest.raises(RecordError) as caught:
        read_record(path, (), ["q"])
    assert (
        f"run.json, key {key}" in str(caught.value)
        and caught.value.remedy
        and "\n" not in str(caught.value)
    )


DAMAGED = {
    "truncated": (b'{"schema": "flightid/record/1", "hold": "lin', "run.json: not JSON: "),
    "empty": (b"", "run.json: not JSON: "),
    "no JSON": (b"hold: linear", "run.json: not JSON: "),
    "Latin-1": (
        b'{"schema": "flightid/record/1", "name": "M\xfcller"}',
        "run.json: not UTF-8 text",
    ),
    "nested too deep": (b"[" * 100_000, "run.json: nested deeper than"),
    "a number beyond Python": (
        b'{"schema": "flightid/record/1", "name": ' + b"1" * 5000 + b"}",
        "digits",
    ),
    "another schema of ours": (
        b'{"schema": "flightid/comparison/1"}',
        "key schema: schema 'flightid/comparison/1' is not known",
    ),
    "a schema that is a number": (
        b'{"schema": 1, "hold": "linear"}',
        "key schema: it has the key hold and no schema",
    ),
    "no schema": (b'{"units": {"q": "deg/s"}}', "key schema: it has the key units and no schema"),
    "a hold that is a list": (
        b'{"schema": "flightid/record/1", "hold": ["linear"]}',
        "key hold: hold ['linear'] is not known",
    ),
    "units that are a list": (
        b'{"schema": "flightid/record/1", "units": ["deg/s"]}',
        "key units: a unit is not a text",
    ),
    "an origin that is a number": (
        b'{"schema": "flightid/record/1", "origin": 1}',
        "key origin: the origin is not a text",
    ),
    "a key that is not there": (
        b'{"schema": "flightid/record/1", "hld": "linear"}',
        "key 'hld': there is no such key; did you mean 'hold'?",
    ),
    "an unknown channel": (
        b'{"schema": "flightid/record/1", "units": {"qq": "deg/s"}}',
        "key units: there is no channel 'qq'",
    ),
    "an unknown unit": (
        b'{"schema": "flightid/record/1", "units": {"q": "foo"}}',
        "column 'q': unknown unit 'foo'",
    ),
}


@pytest.mark.parametrize(("content", "said"), DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_sidecar_is_refused(tmp_path: Path, content: bytes, said: str) -> None:
    path = csv_file(tmp_path, "time,q\n0,1\n1,1\n")
    (tmp_path / "run.json").write_bytes(content)
    with pytest.raises(RecordError) as caught:
        read_record(path, (), ["q"])
    assert said in str(caught.value) and caught.value.remedy and "\n" not in str(caught.value)


def test_a_sidecar_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    path = csv_file(tmp_path, "time,q\n0,1\n1,1\n")
    (tmp_path / "run.json").mkdir()
    with pytest.raises(RecordError, match=r"run.json: cannot be read \(Is a directory\); "):
        read_record(path, (), ["q"])


def test_units_of_a_sidecar_may_be_those_of_other_columns(tmp_path: Path) -> None:
    path = csv_file(tmp_path, "time,q,fuel,AoA\n0,1,2,3\n1,1,2,3\n")
    units = {"q": "deg/s", "fuel": "kg", "altitude": "ft", "alpha": "deg"}
    (tmp_path / "run.json").write_text(json.dumps({"schema": "flightid/record/1", "units": units}))
    record = read_record(path, (), ["alpha", "q"], {"alpha": ColumnChoice("AoA")})
    assert record["alpha"].values[0] == pytest.approx(math.radians(3.0)) and record["q"].values[
        0
    ] == pytest.approx(math.radians(1.0))


HEADERS = [
    "al\x07pha",
    "\x1b[31malpha",
    "alpha\x00",
    "al\u200bpha",
    "alpha [deg\x7f]",
    "al\x1fpha",
    "alpha\u202e",
]


@pytest.mark.parametrize("name", HEADERS, ids=ascii)
def test_a_header_with_control_characters_is_refused_and_named_escaped(
    tmp_path: Path, name: str
) -> None:
    path = csv_file(tmp_path, f"time,q,{name}\n0,1,2\n1,1,2\n")
    with pytest.raises(RecordError) as caught:
        read_record(path, (), ["alpha", "q"])
    said = str(caught.value)
    assert (
        "run.csv, header: the name" in said
        and repr(name) in said
        and "control characters; rename that column" in said
    )
    assert said.isprintable()


def test_a_header_that_a_spreadsheet_broke_into_lines_is_read(tmp_path: Path) -> None:
    path = csv_file(tmp_path, 'time,q,"alpha\r\n[deg]"\n0,1,2\n1,1,2\n')
    assert read_record(path, (), ["alpha", "q"])["alpha"].values[0] == pytest.approx(
        math.radians(2.0)
    )


def mat_file(folder: Path, **variables: object) -> Path:
    from scipy.io import savemat

    path = folder / "run.mat"
    savemat(path, {"time": np.arange(4.0), "elevator": np.zeros(4), "q": np.ones(4), **variables})
    return path


UNREADABLE = {
    "two columns": (np.ones((4, 2)), "it is an array of 4x2"),
    "three axes": (np.ones((4, 2, 3)), "it is an array of 4x2x3"),
    "sparse": (sparse.csc_matrix(np.eye(4)), "it is a sparse array of 4x4"),
    "empty": (np.zeros((0, 0)), "it is empty"),
}


@pytest.mark.parametrize(("value", "said"), UNREADABLE.values(), ids=UNREADABLE)
def test_a_mat_variable_that_is_no_vector_is_refused_where_it_is_a_channel(
    tmp_path: Path, value: object, said: str
) -> None:
    path = mat_file(tmp_path, alpha=value)
    with pytest.raises(
        RecordError, match=f"run.mat, column 'alpha': {said}; store one vector for each channel"
    ):
        read_record(path, ("elevator",), ["alpha", "q"])
    with pytest.raises(RecordError, match=said):
        read_record(path, (), ["q"], optional=["alpha"])
    assert read_record(path, ("elevator",), ["q"]).output_names == ("q",)
    assert read_record(
        mat_file(tmp_path, notes=value), ("elevator",), ["alpha", "q"]
    ).output_names == ("q",)


def test_a_sparse_mat_column_is_a_vector(tmp_path: Path) -> None:
    path = mat_file(tmp_path, alpha=sparse.csc_matrix(np.array([[0.0], [2.0], [0.0], [1.0]])))
    assert read_record(path, ("elevator",), ["alpha"])["alpha"].values.tolist() == [
        0.0,
        2.0,
        0.0,
        1.0,
    ]


def test_a_matrix_alone_is_named_with_its_size(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "run.mat", {"data": np.ones((801, 4))})
    with pytest.raises(RecordError, match=r"the columns are data1, data2, data3, data4"):
        read_record(tmp_path / "run.mat", (), ["q"])


def test_vectors_beside_a_struct_are_read_and_none_twice(tmp_path: Path) -> None:
    from scipy.io import savemat

    inside = {"time": np.arange(3.0), "q": np.ones(3)}
    savemat(tmp_path / "run.mat", {"log": inside, "alpha": np.full(3, 0.5)})
    assert read_record(tmp_path / "run.mat", (), ["alpha", "q"]).output_names == ("alpha", "q")
    savemat(tmp_path / "run.mat", {"log": inside, "q": np.zeros(3)})
    with pytest.raises(
        RecordError, match="column 'q': it is there twice, in the struct log and outside it"
    ):
        read_record(tmp_path / "run.mat", (), ["q"])


def test_gzip_and_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress("\ufefftime,q\r\n0,1\r\n\r\n1,2\r\n".encode()))
    assert read_record(path, (), ["q"])["q"].values.tolist() == [1.0, 2.0]


def test_parquet(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    frame = pandas.DataFrame(
        {
            "time": [0.0, 0.1, 0.3],
            "stick [in]": [1, 2, 3],
            "alpha_deg": [180.0, None, 0.0],
            "q": pandas.array([1, None, 3], "Int64"),
        }
    )
    path = tmp_path / "run.parquet"
    frame.set_index("time").to_parquet(path)
    record = read_record(path, ["stick"], ["alpha", "q"])
    assert record.time.tolist() == [0.0, 0.1, 0.3] and record["stick"].unit == "in"
    assert record["alpha"].valid.tolist() == record["q"].valid.tolist() == [True, False, True]
    assert record["alpha"].values[0] == pytest.approx(math.pi, rel=1e-15)


@pytest.mark.parametrize("nested", [False, True], ids=["vectors", "struct"])
def test_mat(tmp_path: Path, nested: bool) -> None:
    savemat = pytest.importorskip("scipy.io").savemat
    vectors = {
        "time": np.array([[0.0], [0.1], [0.3]]),
        "q_deg_s": np.array([180.0, np.nan, 0.0]),
        "elevator": np.array([1, 2, 3]),
        "note": "text",
        "g": 9.8,
    }
    path = tmp_path / "run.mat"
    savemat(path, {"flight": vectors, "version": 3.0} if nested else vectors)
    record = read_record(path, ["elevator"], ["q"])
    assert record.time.tolist() == [0.0, 0.1, 0.3] and record["elevator"].values.tolist() == [
        1.0,
        2.0,
        3.0,
    ]
    assert record["q"].values[0] == pytest.approx(math.pi, rel=1e-15) and record[
        "q"
    ].valid.tolist() == [True, False, True]


def test_only_the_window_is_checked(tmp_path: Path) -> None:
    rows = [
        "0,1",
        "999,1",
        "x,1",
        "1,text",
        "0.5,inf",
        ",",
        "2,1,1",
        "888,1",
        "4,1",
        "5,2",
        "6,3",
        "",
        "7,4",
        "3,5",
        "nan,5",
        "8",
    ]
    path = csv_file(tmp_path, "time,q\n" + "\n".join(rows) + "\n")
    record = read_record(path, (), ["q"], start=4.0, stop=7.0)
    assert record.time.tolist() == [4.0, 5.0, 6.0, 7.0] and record["q"].values.tolist() == [
        1.0,
        2.0,
        3.0,
        4.0,
    ]


def test_a_broken_stamp_inside_the_window_is_told_by_its_row(tmp_path: Path) -> None:
    path = csv_file(tmp_path, "time,q\n0,1\n1,1\n2,1\n0,1\n4,1\n5,1\n")
    with pytest.raises(
        RecordError, match=r"run\.csv, row 5, column 'time': time goes back \(2 s, then 0 s\)"
    ):
        read_record(path, (), ["q"], start=1.0)


@given(
    st.lists(st.floats(-100, 100), min_size=1, max_size=30, unique=True),
    st.one_of(st.none(), st.floats(-120, 120)),
    st.one_of(st.none(), st.floats(-120, 120)),
)
def test_window_of_sound_stamps_is_the_rows_between(
    stamps: list[float], start: float | None, stop: float | None
) -> None:
    time = np.sort(np.array(stamps))
    low, high = -np.inf if start is None else start, np.inf if stop is None else stop
    assert (
        time[rows_between(time, start, stop)].tolist()
        == time[(time >= low) & (time <= high)].tolist()
    )


@pytest.mark.skipif(not SHARED.is_dir(), reason="the measured records are not at hand")
def test_measured_fall() -> None:
    record = read_record(
        SHARED / "flightdata" / "cavour_ballistic.csv",
        (),
        ["altitude"],
        {"altitude": ColumnChoice("h")},
        start=44.0,
    )
    assert len(record) == 153 and record.time[0] == 44.0 and record["altitude"].unit == "m"
    assert np.all(np.diff(record["altitude"].values) < 0.0)
