"""One record in every form that recorders and people store it in reads back equal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from scenarios.files.formats import tabular
from scenarios.files.formats.cells import numbers
from scenarios.files.formats.registry import readers
from scenarios.files.measured.columns import read_record_file, with_names
from scenarios.files.records import read_record
from sim.errors import RecordError
from tests.recorders.forms import DATAFLASH_UNITS, FORMS, dataflash_messages, record
from tests.recorders.logs import write_dataflash, write_dataflash_text

LIBRARIES = {
    "hdf5": "h5py",
    "mat 7.3": "h5py",
    "mdf": "asammdf",
    "tdms": "nptdms",
    "ulog": "pyulog",
    "dataflash": "pymavlink",
}
LIBRARIES |= {name: "h5py" for name in FORMS if name.startswith(("hdf5", "mat 7.3"))}
LIBRARIES |= {"dataflash text": "pymavlink"}
LIBRARIES |= {"excel": "python_calamine", "ods": "odf"}


@pytest.mark.sampled
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize("name", FORMS)
def test_the_same_record_in_every_form(tmp_path: Path, name: str) -> None:
    if name in LIBRARIES:
        pytest.importorskip(LIBRARIES[name])
    form, columns = FORMS[name], record()
    file = with_names(read_record_file(form.write(tmp_path, columns)), form.names)
    found = read_record(file, ["elevator"], ["alpha", "q"], form.choices, rate=form.rate)
    np.testing.assert_allclose(
        found.time - found.time[0], columns["time"], rtol=0, atol=max(form.tolerance, 1e-9)
    )
    for channel in found.channels:
        np.testing.assert_allclose(
            channel.with_gaps(),
            columns[channel.name],
            rtol=1e-12,
            atol=form.tolerance,
            err_msg=channel.name,
        )


@pytest.mark.parametrize(
    ("mark", "before", "suffix"),
    [(", ", "", ".log"), (",", "", ".csv"), (", ", "Log 5, read by a ground station\n\n", ".bin")],
)
def test_a_text_log_is_the_binary_log(tmp_path: Path, mark: str, before: str, suffix: str) -> None:
    pytest.importorskip("pymavlink")
    messages = dataflash_messages(record(50))
    binary = read_record_file(
        write_dataflash(tmp_path / "twin.bin", messages, DATAFLASH_UNITS)
    ).topics
    path = write_dataflash_text(
        tmp_path / f"record{suffix}", messages, DATAFLASH_UNITS, before=before, mark=mark
    )
    text = read_record_file(path).topics
    assert (
        [topic.name for topic in text]
        == [topic.name for topic in binary]
        == ["AOA", "IMU[0]", "IMU[1]", "RCOU"]
    )
    for one, other in zip(text, binary, strict=True):
        assert (one.table.header, one.table.units) == (other.table.header, other.table.units)
        for index in range(len(one.table.header)):
            assert (
                numbers(one.table, index).values.tobytes()
                == numbers(other.table, index).values.tobytes()
            )


def test_units_with_multipliers_are_alike_in_both_logs(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    messages = {
        "BARO": {
            "TimeUS": 1e4 * np.arange(5),
            "Alt": 100.0 * np.arange(5),
            "Up": 1.0 * np.arange(5),
        }
    }
    units, factors = {"BARO": "smm"}, {"BARO": "FB-"}
    for write, name in ((write_dataflash, "log.bin"), (write_dataflash_text, "log.log")):
        file = read_record_file(write(tmp_path / name, messages, units, factors))
        assert dict(zip(file.table.header, file.table.units, strict=True)) == {
            "TimeUS": "us",
            "Alt": "cm",
            "Up": "m",
        }


def test_a_text_log_with_lines_cut_is_read_less_these(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    path = write_dataflash_text(
        tmp_path / "record.log", dataflash_messages(record(50)), DATAFLASH_UNITS
    )
    text = path.read_text().splitlines()
    # the flight's last line, RCOU, without its last cell
    text[-1] = text[-1][: text[-1].rindex(",")]
    path.write_text("\n".join([*text, "garbage", "IMU", "FMT, 7"]))
    file = read_record_file(path)
    assert {topic.name: topic.table.rows.size for topic in file.topics} == {
        "AOA": 50,
        "IMU[0]": 50,
        "IMU[1]": 50,
        "RCOU": 49,
    }
    assert (
        "RCOU: 1 line of RCOU with another number of cells than its format left out" in file.notes
    )


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("FMT, 1, 12, IMU, QdX, TimeUS,GyrX,GyrY", "not a readable ArduPilot DataFlash file"),
        ("FMT, one, 12, IMU, Qd, TimeUS,GyrX", "not a readable ArduPilot DataFlash file"),
        ("IMU, 1, 2", "no column of numbers is in the file"),
        ("FMT, 1, 12, IMU, Qd, TimeUS,GyrX\nIMU, yes, no", "no column of numbers is in the file"),
    ],
)
def test_a_text_log_that_cannot_be_read_is_refused(tmp_path: Path, wrong: str, said: str) -> None:
    pytest.importorskip("pymavlink")
    path = tmp_path / "record.log"
    path.write_text(f"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n{wrong}\n")
    with pytest.raises(RecordError, match=said) as refused:
        read_record_file(path)
    assert "\n" not in str(refused.value)


def test_every_format_has_a_form() -> None:
    suffixes = {suffix for reader in readers() for suffix in reader.suffixes}
    assert {
        ".csv",
        ".ulg",
        ".bin",
        ".mf4",
        ".tdms",
        ".h5",
        ".mat",
        ".xlsx",
        ".ods",
        ".feather",
        ".parquet",
    } <= suffixes
    for reader in readers():
        assert reader.name and reader.suffixes and reader.read.__doc__, reader


@pytest.mark.sampled
@pytest.mark.parametrize("mark", [",", ";", "\t", "|", " "])
def test_a_large_file_reads_as_a_small_one(
    tmp_path: Path, mark: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from scenarios.files.formats import text

    rng = np.random.default_rng(1)
    rows = [mark.join(["time", "elevator", "alpha", "q", "mode"])]
    for row in range(3000):
        cells = [
            f"{0.01 * row:.2f}",
            f"{rng.standard_normal():.3e}",
            f"{rng.standard_normal():.17g}",
            str(rng.integers(-9, 9)),
        ]
        cells[2] = "nan" if row % 7 == 3 else cells[2]
        rows.append(mark.join([*cells, "auto" if mark != " " else "7"]))
    path = tmp_path / "record.csv"
    path.write_bytes(("# a log\n" + "\n".join(rows) + "\n").encode())
    monkeypatch.setattr(text, "LARGE_FILE_BYTES", 10**9)
    careful = read_record_file(path).table
    monkeypatch.setattr(text, "LARGE_FILE_BYTES", 1000)
    monkeypatch.setattr(text, "BLOCK_BYTES", 20_000)
    fast = read_record_file(path).table
    assert isinstance(fast.columns[0], np.ndarray) and not isinstance(
        careful.columns[0], np.ndarray
    )
    assert (fast.header, fast.rows.tolist()) == (careful.header, careful.rows.tolist())
    for index in range(4):
        assert numbers(fast, index).values.tobytes() == numbers(careful, index).values.tobytes()
    path.write_bytes(path.read_bytes() + mark.join(["30.0", "x", "0", "0", "7"]).encode())
    assert numbers(read_record_file(path).table, 1).texts == {3000: "x"}


def _as_a_data_frame(frame: pd.DataFrame) -> dict[str, list]:
    """What pandas shows of a table: named index levels first, a cell without a value as None."""
    if any(name is not None for name in frame.index.names):
        frame = frame.reset_index()
    return {str(name): [None if pd.isna(cell) else cell for cell in frame[name]] for name in frame}


@pytest.mark.parametrize("suffix", [".parquet", ".feather"])
def test_a_table_is_read_in_batches_as_pandas_reads_it_whole(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(tabular, "ROWS_PER_BATCH", 7)
    n = 30
    frame = pd.DataFrame(
        {"time": np.arange(n) / 50, "count": np.arange(n), "single": np.arange(n, dtype="f4")}
    )
    # empty cells in a late batch
    frame["whole"] = pd.array([*range(n - 3), None, None, 7], dtype="Int64")
    frame["text"] = [None if i == 9 else f"row {i}" for i in range(n)]
    frame["flag"] = frame["count"] % 2 == 0
    frame["clock"] = pd.date_range("2020-01-01", periods=n, freq="20ms")
    indexed, by_number = frame.set_index("time"), frame.rename_axis("row")
    for index, each in enumerate(
        [frame, indexed, by_number, frame.set_index(["time", "count"]), frame.iloc[:0]]
    ):
        path = tmp_path / f"table{index}{suffix}"
        each.to_parquet(path) if suffix == ".parquet" else each.reset_index(
            drop=each is frame
        ).to_feather(path)
        wanted = _as_a_data_frame(each if suffix == ".parquet" else pd.read_feather(path))
        (topic,) = tabular.read_parquet(path, path.read_bytes())
        assert list(topic.table.header) == list(wanted)
        assert len(topic.table.rows) == len(each)
        for name, column in zip(topic.table.header, topic.table.columns, strict=True):
            assert [
                None if pd.isna(cell) else pd.Timestamp(cell) if name == "clock" else cell
                for cell in column
            ] == wanted[name]
