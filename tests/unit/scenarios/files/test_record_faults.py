"""Bad records: one line that names file and place, and says what to do."""

from __future__ import annotations

import builtins
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.files.declarations import ColumnChoice
from scenarios.files.records import read_record
from sim.errors import RecordError


def refused(
    path: Path,
    *parts: str,
    inputs: tuple[str, ...] = (),
    outputs: tuple[str, ...] = ("alpha",),
    **options: Any,
) -> None:
    """Reading fails in one line that has the file, the parts and a remedy."""
    with pytest.raises(RecordError) as caught:
        read_record(path, inputs, outputs, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    assert len(caught.value.remedy) > 5
    for part in parts:
        assert part in message, message


CASES: dict[str, tuple[str, tuple[str, ...]]] = {
    "no rows": ("time,alpha\n", ("header but no rows",)),
    "blank": ("\n \n", ("the file is empty",)),
    "json": ('[{"time": 0.0, "alpha": 1}]\n', ("JSON is not read", "save it as CSV")),
    "json lines": ('{"time": 0.0, "alpha": 1}\n{"time": 1.0, "alpha": 2}\n', ("JSON is not read",)),
    "no time": (
        "z,alpha\n0,0\n1,0\n",
        ("header", "no column 'time'", "z, alpha", "--channels", "--rate"),
    ),
    "no time under a broken header": (
        '"z\n(s)",alpha\n0,0\n1,0\n',
        ("the columns are z (s), alpha",),
    ),
    "no output": ("time,beta\n0,0\n1,0\n", ("no column 'alpha'", "time, beta", "--channels")),
    "either separator": (
        "# a log\ntime;alpha, left\n0\n",
        ("row 2", "commas and semicolons stand in the header", "save it with one separator"),
    ),
    "header commented out": (
        "# a log,of yesterday\n0,0\n1,0\n",
        ("row 2", "there is no header", "take the # from the header, row 1"),
    ),
    "comment of another width": ("# time,alpha,q\n0,0\n1,0\n", ("row 2", "there is no header")),
    "row after comments": ("# a\n\n# b\ntime,alpha\n0,0\n1,bad\n", ("row 6, column 'alpha'",)),
    "units apart": (
        "time,alpha [deg]\ns,rad\n0,0\n1,0\n",
        ("column 'alpha [deg]'", "the header says deg", "under it rad", "correct one"),
    ),
    "units apart in a suffix": (
        "time,alpha_deg\ns,rad\n0,0\n1,0\n",
        ("column 'alpha_deg'", "the header says deg, the row of units under it rad"),
    ),
    "unknown unit under the header": (
        "time,alpha\ns,foo\n0,0\n1,0\n",
        ("column 'alpha'", "unknown unit 'foo'"),
    ),
    "text under the header": (
        "time,alpha\nZeit,Winkel\n0,0\n1,0\n",
        ("row 2, column 'time'", "'Zeit' is not a number"),
    ),
    "units and no rows": ("time;alpha\ns;deg\n", ("header but no rows",)),
    "commas in columns by commas": (
        "time,alpha\n0,0,1,5\n0,1,1,6\n",
        ("row 2", "4 cells under a header of 2", "not decimal commas"),
    ),
    "thousands or decimals": (
        "time;alpha\n0;1,500\n1;2,500\n",
        ("row 2, column 'alpha'", "'1,500' may be a decimal number", "nothing between thousands"),
    ),
    "points among commas": (
        "time;alpha\n0,5;1,500\n1;2.500\n",
        ("row 3, column 'alpha'", "'2.500' has a point in a file with decimal commas"),
    ),
    "both marks": (
        "time;alpha\n0,5;1,500\n1;2.500,5\n",
        ("row 3, column 'alpha'", "one decimal mark, and none between thousands"),
    ),
    "unknown unit": (
        "time,alpha [foo]\n0,0\n1,0\n",
        ("column 'alpha [foo]'", "unknown unit 'foo'", "deg"),
    ),
    "unknown unit in brackets beside a plain column": (
        "time,alpha [foo],alpha\n0,0,0\n1,0,0\n",
        ("are all alpha",),
    ),
    "unknown unit as suffix": (
        "time,alpha_foo\n0,0\n1,0\n",
        ("column 'alpha_foo'", "unknown unit 'foo'", "deg"),
    ),
    "unit of another dimension": (
        "time,alpha [kg]\n0,0\n1,0\n",
        ("column 'alpha [kg]'", "'kg' does not measure an angle", "deg"),
    ),
    "unit of time": (
        "time [m],alpha\n0,0\n1,0\n",
        ("column 'time [m]'", "'m' does not measure a time"),
    ),
    "not a number in a channel": (
        "time,alpha\n0,\n1,nan\n",
        ("column 'alpha'", "not a single number", "row 2 to row 3", "leave the column out"),
    ),
    "text": ("time,alpha\n0,0\n1,bad\n", ("row 3, column 'alpha'", "'bad' is not a number")),
    "text after a blank line": ("time,alpha\n0,0\n\n\n1,bad\n", ("row 5, column 'alpha'",)),
    "decimal comma": (
        'time,alpha\n0,0\n1,"0,5"\n',
        (
            "row 3, column 'alpha'",
            "'0,5' has a comma in a file whose columns are separated by commas",
            "semicolons",
        ),
    ),
    "underscore": ("time,alpha\n0,1_000\n1,0\n", ("row 2, column 'alpha'", "'1_000'")),
    "text over two lines": (
        'time,alpha\n0,0\n1,"a\nb"\n',
        ("row 4, column 'alpha'", r"'a\nb' is not a number"),
    ),
    "text in time": (
        "time,alpha\n0,0\n12:00,0\n",
        ("row 3, column 'time'", "'12:00' is not a number"),
    ),
    "missing time": ("time,alpha\n0,0\n,0\n2,0\n", ("row 3, column 'time'", "time is missing")),
    "infinite time": ("time,alpha\n0,0\ninf,0\n", ("row 3, column 'time'", "time is infinite")),
    "time goes back": (
        "time,alpha\n0,0\n2,0\n1,0\n",
        ("row 4, column 'time'", "goes back (2 s, then 1 s)", "sort"),
    ),
    "repeated row": (
        "time,alpha\n0,0\n1,0\n1,2\n",
        ("row 4, column 'time'", "repeated", "remove duplicates"),
    ),
    "one sample": ("time,alpha\n0,0\n", ("row 2", "one sample", "two rows")),
    "infinite value": ("time,alpha\n0,0\n1,1e999\n", ("row 3, column 'alpha'", "infinite")),
    "two columns by unit": (
        "time,alpha,alpha_deg\n0,0,0\n1,0,0\n",
        ("'alpha' and 'alpha_deg'", "--channels"),
    ),
    "two columns alike": ("time,alpha,alpha\n0,0,0\n1,0,0\n", ("'alpha' and 'alpha'",)),
    "short row": ("time,alpha,q\n0,0,0\n1,0\n", ("row 3", "2 cells under a header of 3")),
    "long row": ("time,alpha\n0,0\n1,0,0\n", ("row 3", "3 cells under a header of 2")),
}


@pytest.mark.parametrize("case", CASES)
def test_csv_fault(tmp_path: Path, case: str) -> None:
    text, parts = CASES[case]
    path = tmp_path / "run.csv"
    path.write_text(text)
    refused(path, *parts)


def test_the_first_fault_in_the_file_is_told(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,alpha\n0,0\n1,inf\n2,text\n")
    refused(path, "row 3", "infinite")


def test_missing_input(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,alpha\n0,0\n1,0\n")
    refused(path, "no column 'elevator'", "time, alpha", "--channels", inputs=("elevator",))


def test_missing_input_sample(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,elevator,alpha\n0,0,0\n1,,0\n2,0,0\n")
    refused(path, "row 3, column 'elevator'", "input sample is missing", inputs=("elevator",))


def test_rows_are_the_files_after_a_cut(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,elevator,alpha\n0,0,0\n1,0,0\n2,0,0\n3,0,x\n4,,0\n5,0,0\n")
    refused(path, "row 5, column 'alpha'", inputs=("elevator",), start=2.0, stop=3.0)
    refused(path, "row 6, column 'elevator'", inputs=("elevator",), start=4.0)
    path.write_text("time,alpha\n0,0\n1,\n2,\n3,0\n")
    refused(path, "not a single number", "row 3 to row 4", start=1.0, stop=2.0)


@pytest.mark.parametrize(
    ("start", "stop", "part"),
    [
        (5.0, None, "covers 0 to 2 s"),
        (None, -1.0, "covers 0 to 2 s"),
        (2.0, 1.0, "--from 2 is not before --to 1"),
        (1.5, None, "one sample"),
        (float("nan"), None, "--from is not a number"),
    ],
)
def test_windows_without_a_record(
    tmp_path: Path, start: float | None, stop: float | None, part: str
) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,alpha\n0,0\n1,0\n2,0\n")
    refused(path, part, start=start, stop=stop)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    refused(tmp_path / "none.csv", "there is no such file")
    refused(tmp_path, "this is a folder")
    for name in ("empty.csv", "empty.parquet", "empty.mat"):
        (tmp_path / name).write_bytes(b"")
        refused(tmp_path / name, "the file is empty")
    latin = tmp_path / "latin.csv"
    latin.write_bytes("time,alpha\n0,0\n1,0°\n".encode("latin-1"))
    refused(latin, "row 3", "'0°' is not a number")
    (tmp_path / "binary.csv").write_bytes(b"time,alpha\n0,0\n1,\xff\x00\x01\n")
    refused(tmp_path / "binary.csv", "row 3", "neither text nor a format that is known")
    for name, kind in (
        ("bad.parquet", "not a readable Parquet file"),
        ("bad.mat", "not a readable MAT file"),
        ("bad.csv.gz", "not a gzip file"),
    ):
        (tmp_path / name).write_bytes(b"time,alpha\n0,0\n1,0\n" * 20)
        refused(tmp_path / name, kind)
    damaged = tmp_path / "damaged.csv.gz"
    whole = gzip.compress(b"time,alpha\n0,0\n1,0\n")
    for content in (whole[:-9], whole[:12] + b"\xff" * 8 + whole[20:]):
        damaged.write_bytes(content)
        refused(damaged, "not a gzip file")
    wide = tmp_path / "wide.csv"
    wide.write_text('time,alpha\n0,"' + "x" * 200_000 + '"\n1,0\n')
    refused(wide, "row 2", "'alpha'", "is not a number")


def test_channel_map_faults(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,AoA1,x,x\n0,0,0,0\n1,0,0,0\n")
    refused(
        path,
        "no column 'AoA2'",
        "for alpha",
        "did you mean 'AoA1'?",
        channel_map={"alpha": ColumnChoice("AoA2")},
    )
    refused(path, "2 columns are headed 'x'", channel_map={"alpha": ColumnChoice("x")})
    refused(
        path,
        "column 'AoA1'",
        "unknown unit 'foo'",
        channel_map={"alpha": ColumnChoice("AoA1", "foo")},
    )
    refused(
        path,
        "column 'AoA1'",
        "'m' does not measure an angle",
        channel_map={"alpha": ColumnChoice("AoA1", "m")},
    )


def test_an_unknown_channel_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,alpha\n0,0\n1,0\n")
    refused(path, "no channel 'alhpa'", "did you mean 'alpha'?", outputs=("alhpa",))


def test_parquet_faults(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    path = tmp_path / "run.parquet"
    pandas.DataFrame({"time": [0.0, 1.0], "alpha": ["0", "bad"]}).to_parquet(path)
    refused(path, "row 2, column 'alpha'", "'bad' is not a number")
    pandas.DataFrame({"time": [0.0, 1.0], "alpha": [0.0, np.inf]}).to_parquet(path)
    refused(path, "row 2, column 'alpha'", "infinite")
    pandas.DataFrame(
        {"time": pandas.to_datetime(["2020-01-01", "2020-01-02"]), "alpha": [0.0, 1.0]}
    ).to_parquet(path)
    assert read_record(path, (), ["alpha"]).time.tolist() == [0.0, 86400.0]
    pandas.DataFrame({"time": [], "alpha": []}).to_parquet(path)
    refused(path, "header but no rows")


def test_parquet_without_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.parquet"
    path.write_bytes(b"PAR1")
    plain_import = builtins.__import__

    def without(name: str, *rest: Any, **options: Any) -> Any:
        if name.split(".")[0] == "pyarrow":
            raise ImportError("no pyarrow", name="pyarrow")
        return plain_import(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    refused(path, "needs pyarrow, which is not installed", "pip install pyarrow")


def test_mat_faults(tmp_path: Path) -> None:
    savemat = pytest.importorskip("scipy.io").savemat
    path = tmp_path / "run.mat"
    savemat(path, {"time": np.arange(3.0), "alpha": np.arange(4.0)})
    refused(path, "column 'alpha'", "4 values for 3 times")
    savemat(path, {"time": np.arange(3.0), "alpha": np.array([0.0, 1.0, 1j])})
    refused(path, "column 'alpha'")
    savemat(path, {"alpha": np.arange(3.0)})
    refused(path, "no column 'time'")
    savemat(path, {"picture": np.zeros((2, 2))})
    refused(path, "no column of numbers", "picture (2 x 2)")
    savemat(path, {"time": np.array([0.0, 1.0, 1.0]), "alpha": np.arange(3.0) * 2.0})
    refused(path, "row 3, column 'time'", "repeated")
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x00" * 400)
    refused(path, "not a readable MAT file")
