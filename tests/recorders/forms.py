"""One record of a short-period motion in the forms in which people store records, and the channel
map that each of them needs.
"""

from __future__ import annotations

import bz2
import datetime
import gzip
import io
import lzma
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.declarations import ColumnChoice
from tests.recorders.logs import write_dataflash, write_dataflash_text, write_ulog

DEGREE = np.pi / 180.0
NAMES = ("time", "elevator", "alpha", "q")
Columns = dict[str, np.ndarray]
MAPPED = {name: ColumnChoice(n + 1) for n, name in enumerate(NAMES)}


def record(rows: int = 400) -> Columns:
    """Time at 50 Hz, a 3-2-1-1 of the elevator, and a motion; every number has six digits, so that
    all forms can hold it exactly.
    """
    time = np.round(0.02 * np.arange(rows), 6)
    elevator = 0.05 * np.select(
        [(time > 1) & (time <= 2.5), (time > 2.5) & (time <= 3.5), (time > 3.5) & (time <= 4)],
        [1.0, -1.0, 1.0],
        0.0,
    )
    rng = np.random.default_rng(5)
    alpha = np.round(
        0.06 * np.sin(1.9 * time) * np.exp(-0.3 * time) + 1e-3 * rng.standard_normal(rows), 6
    )
    q = np.round(
        0.1 * np.cos(1.9 * time) * np.exp(-0.3 * time) + 1e-3 * rng.standard_normal(rows), 6
    )
    return {"time": time, "elevator": elevator, "alpha": alpha, "q": q}


@dataclass(frozen=True)
class Form:
    """A way to store the record: how it is written, the channel map and rate that it needs, and how
    exact it is.
    """

    write: Callable[[Path, Columns], Path]
    choices: dict[str, ColumnChoice] | None = None
    rate: float | None = None
    tolerance: float = 1e-12
    names: tuple[str, ...] = field(default=())


def _rows(columns: Columns, mark: str, header: bool = True, names: tuple[str, ...] = NAMES) -> str:
    lines = [mark.join(names)] if header else []
    lines += [
        mark.join(repr(float(columns[name][row])) for name in NAMES if name in columns)
        for row in range(columns["alpha"].size)
    ]
    return "\n".join(lines) + "\n"


def _text(
    mark: str, suffix: str = ".csv", encoding: str = "utf-8", before: str = "", **options: Any
) -> Callable[[Path, Columns], Path]:
    def write(folder: Path, columns: Columns) -> Path:
        path = folder / f"record{suffix}"
        path.write_bytes((before + _rows(columns, mark, **options)).encode(encoding))
        return path

    return write


def _stamps(text: Callable[[float], str]) -> Callable[[Path, Columns], Path]:
    def write(folder: Path, columns: Columns) -> Path:
        path = folder / "record.csv"
        lines = [",".join(NAMES)]
        for row, time in enumerate(columns["time"]):
            lines.append(
                ",".join(
                    [text(float(time)), *(repr(float(columns[name][row])) for name in NAMES[1:])]
                )
            )
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


def _comma(folder: Path, columns: Columns) -> Path:
    path = folder / "record.csv"
    path.write_text(_rows(columns, ";").replace(".", ","))
    return path


def _unit_row(folder: Path, columns: Columns) -> Path:
    path = folder / "record.csv"
    degrees = {
        name: values / DEGREE if name in ("elevator", "alpha", "q") else values
        for name, values in columns.items()
    }
    head, rest = _rows(degrees, "\t").split("\n", 1)
    path.write_text(f"{head}\ns\tdeg\tdeg\tdeg/s\n{rest}")
    return path


def _lines(
    change: Callable[[list[str]], list[str]], mark: str = ","
) -> Callable[[Path, Columns], Path]:
    """The record as text whose lines, the header first, are changed."""

    def write(folder: Path, columns: Columns) -> Path:
        path = folder / "record.csv"
        path.write_text(
            "\n".join(change(_rows(columns, mark).splitlines())) + "\n", encoding="utf-8"
        )
        return path

    return write


def _rows_with(change: Callable[[str], str]) -> Callable[[list[str]], list[str]]:
    return lambda lines: [lines[0], *map(change, lines[1:])]


def _packed(suffix: str, pack: Callable[[bytes], bytes]) -> Callable[[Path, Columns], Path]:
    def write(folder: Path, columns: Columns) -> Path:
        path = folder / f"record.csv{suffix}"
        path.write_bytes(pack(_rows(columns, ",").encode()))
        return path

    return write


def _zip(content: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("flight/record.csv", content)
    return packed.getvalue()


def _day(time: float) -> datetime.datetime:
    """Of a flight that begins four seconds before midnight."""
    return datetime.datetime(2025, 2, 28, 23, 59, 56) + datetime.timedelta(
        microseconds=round(1e6 * time)
    )


def _date_index(method: str, suffix: str) -> Callable[[Path, Columns], Path]:
    """A DataFrame whose index of dates has no name."""

    def write(folder: Path, columns: Columns) -> Path:
        import pandas

        path = folder / f"record{suffix}"
        frame = pandas.DataFrame(columns).drop(columns="time")
        frame.index = pandas.DatetimeIndex([_day(float(time)) for time in columns["time"]])
        getattr(frame, method)(path)
        return path

    return write


def _no_time(folder: Path, columns: Columns) -> Path:
    return _text(",", names=NAMES[1:])(folder, {name: columns[name] for name in NAMES[1:]})


def _frame(method: str, suffix: str, **options: Any) -> Callable[[Path, Columns], Path]:
    def write(folder: Path, columns: Columns) -> Path:
        import pandas

        path = folder / f"record{suffix}"
        getattr(pandas.DataFrame(columns), method)(path, **options)
        return path

    return write


def _hdf5(folder: Path, columns: Columns) -> Path:
    import h5py

    path = folder / "record.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("flight")
        for name, values in columns.items():
            data = group.create_dataset(name, data=values / DEGREE if name == "alpha" else values)
            data.attrs["units"] = {"time": "s", "alpha": "deg", "elevator": "rad", "q": "rad/s"}[
                name
            ]
    return path


def _mat(content: Callable[[Columns], dict[str, Any]]) -> Callable[[Path, Columns], Path]:
    def write(folder: Path, columns: Columns) -> Path:
        from scipy.io import savemat

        path = folder / "record.mat"
        savemat(path, content(columns))
        return path

    return write


def _saved(name: str, save: Callable[[Path, Columns], None]) -> Callable[[Path, Columns], Path]:
    def write(folder: Path, columns: Columns) -> Path:
        save(folder / name, columns)
        return folder / name

    return write


def _cells(*items: Any) -> np.ndarray:
    """A MATLAB cell array: NumPy makes one matrix of vectors of one length unless each is put
    in.
    """
    cells = np.empty(len(items), dtype=object)
    for at, item in enumerate(items):
        cells[at] = item
    return cells


def _simulink(columns: Columns) -> dict[str, Any]:
    """A structure with time, as a To Workspace block saves it."""
    signals = [(columns[name].reshape(-1, 1), name) for name in NAMES[1:]]
    return {
        "out": {
            "time": columns["time"],
            "signals": np.array(signals, dtype=[("values", object), ("label", object)]),
        }
    }


def _group_a_signal(path: Path, columns: Columns) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name in NAMES[1:]:
            file[f"{name}/time"], file[f"{name}/data"] = columns["time"], columns[name]


def _clock_above(path: Path, columns: Columns) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file["time"] = columns["time"]
        for name in NAMES[1:]:
            file[f"signals/{name}"] = columns[name]


def _named_by_attribute(path: Path, columns: Columns) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("data", data=_matrix(columns)).attrs["columns"] = list(NAMES)


def _mat73_cells(folder: Path, columns: Columns) -> Path:
    import h5py

    path = folder / "record.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        store = file.create_group("#refs#")
        vectors = [
            store.create_dataset(f"v{name}", data=columns[name].reshape(1, -1)).ref
            for name in NAMES
        ]
        texts = []
        for name in NAMES:
            text = store.create_dataset(
                f"n{name}", data=np.array([[ord(letter)] for letter in name], dtype="u2")
            )
            text.attrs["MATLAB_class"] = np.bytes_(b"char")
            texts.append(text.ref)
        for key, references in (("data", vectors), ("names", texts)):
            cells = file.create_dataset(
                key, data=np.array(references, dtype=h5py.ref_dtype).reshape(-1, 1)
            )
            cells.attrs["MATLAB_class"] = np.bytes_(b"cell")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")
    return path


def _mat73(folder: Path, columns: Columns) -> Path:
    import h5py

    path = folder / "record.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            data = file.create_dataset(name, data=values.reshape(1, -1))
            data.attrs["MATLAB_class"] = np.bytes_(b"double")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")
    return path


def _mdf(folder: Path, columns: Columns) -> Path:
    from asammdf import MDF, Signal

    path = folder / "record.mf4"
    units = {"elevator": "deg", "alpha": "rad", "q": "rad/s"}
    with MDF() as log:
        signals = [
            Signal(
                columns[n] / (DEGREE if units[n] == "deg" else 1.0),
                columns["time"],
                name=n,
                unit=units[n],
            )
            for n in NAMES[1:]
        ]
        log.append(signals)
        log.save(path, overwrite=True)
    return path


def _tdms(folder: Path, columns: Columns) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    path = folder / "record.tdms"
    with TdmsWriter(str(path)) as writer:
        told = {"wf_increment": 0.02, "wf_start_offset": 0.0}
        writer.write_segment(
            [
                ChannelObject("flight", name, columns[name], {**told, "unit_string": ""})
                for name in NAMES[1:]
            ]
        )
    return path


def _ulog(folder: Path, columns: Columns) -> Path:
    stamps = np.round(1e6 * columns["time"]) + 5_000_000
    topics = {
        "vehicle_angular_velocity": {
            "timestamp": stamps,
            "xyz[0]": 0 * stamps,
            "xyz[1]": columns["q"],
            "xyz[2]": 0 * stamps,
        },
        "vane": {"timestamp": stamps, "alpha": columns["alpha"]},
        "actuator_servos": {
            "timestamp": stamps,
            "control[0]": 0 * stamps,
            "control[1]": columns["elevator"] / 0.5,
        },
    }
    return write_ulog(folder / "record.ulg", topics)


def dataflash_messages(columns: Columns) -> dict[str, Columns]:
    """The record as messages of an ArduPilot log; the second gyro rests."""
    stamps = np.round(1e6 * columns["time"])
    two = np.repeat(stamps, 2)
    return {
        "IMU": {
            "TimeUS": two,
            "I": np.tile([0.0, 1.0], stamps.size),
            "GyrY": np.column_stack([columns["q"], 0 * stamps]).ravel(),
        },
        "AOA": {"TimeUS": stamps, "AOA": columns["alpha"] / DEGREE},
        "RCOU": {"TimeUS": stamps, "C2": 1500.0 + 500.0 * columns["elevator"]},
    }


DATAFLASH_UNITS = {"IMU": "s#E", "AOA": "sd"}


def _dataflash(folder: Path, columns: Columns) -> Path:
    return write_dataflash(folder / "record.bin", dataflash_messages(columns), DATAFLASH_UNITS)


def _dataflash_text(folder: Path, columns: Columns) -> Path:
    return write_dataflash_text(folder / "record.log", dataflash_messages(columns), DATAFLASH_UNITS)


def _shuffled(order: Callable[[int], list[int]]) -> Callable[[Path, Columns], Path]:
    def write(folder: Path, columns: Columns) -> Path:
        rows = order(columns["time"].size)
        return _text(",")(folder, {name: values[rows] for name, values in columns.items()})

    return write


def _exchanged(count: int) -> list[int]:
    rows = list(range(count))
    rows[100], rows[101] = rows[101], rows[100]
    return rows


def _matrix(columns: Columns) -> np.ndarray:
    return np.column_stack([columns[name] for name in NAMES])


TOPICS = {name: ColumnChoice(f"{name}.{name}") for name in NAMES[1:]}
PWM = {"elevator": ColumnChoice("pwm(C2, 1500, 500)")}
FORMS: dict[str, Form] = {
    "comma": Form(_text(",")),
    "tab": Form(_text("\t", ".tsv")),
    "semicolon": Form(_text(";")),
    "blanks": Form(_text("   ", ".asc")),
    "bar": Form(_text(" | ", ".txt")),
    "decimal comma": Form(_comma),
    "row of units": Form(_unit_row),
    "latin-1": Form(_text(",", encoding="latin-1", before="# Flugversuch für Böen\n")),
    "utf-16": Form(_text("\t", encoding="utf-16")),
    "preamble": Form(_text(",", before="Flight test data\nAircraft: X1, second flight\n\n")),
    "capitals": Form(_text(",", names=("Time", "ELEVATOR", "Alpha", "Q"))),
    "no header": Form(_text(" ", ".asc", header=False), MAPPED),
    "no header, named": Form(_text(",", header=False), names=NAMES),
    "no time": Form(_no_time, rate=50.0),
    "microseconds": Form(_stamps(lambda time: str(round(1e6 * time)))),
    "milliseconds": Form(_stamps(lambda time: str(round(1e3 * time)))),
    "iso": Form(_stamps(lambda time: f"2025-03-01T12:00:{time:09.6f}Z"), tolerance=1e-9),
    "hh:mm:ss": Form(_stamps(lambda time: f"12:00:{time:06.3f}"), tolerance=1e-9),
    "irig": Form(_stamps(lambda time: f"060:23:59:{52 + time:06.3f}" if time < 8 else ""), tolerance=1e-9),  # noqa: E501
    "month first": Form(_stamps(lambda time: (
        f"{_day(time):%m/%d/%Y %I:%M:%S.%f %p}"
    )), tolerance=1e-9),
    "day first": Form(_stamps(lambda time: f"{_day(time):%d.%m.%Y %H:%M:%S.%f}"), tolerance=1e-9),
    "minutes and seconds": Form(_stamps(lambda time: f"{_day(time):%M:%S.%f}"), tolerance=1e-9),
    "durations": Form(_stamps(lambda time: f"0 days 00:00:{time:09.6f}"), tolerance=1e-9),
    "days of a calendar": Form(_stamps(lambda time: f"{45717.9 + time / 86400:.12f}"), tolerance=1e-5),  # noqa: E501
    "milliseconds since 1970": Form(_stamps(lambda time: str(1_740_873_590_000 + round(1e3 * time)))),  # noqa: E501
    "whole seconds": Form(_stamps(lambda time: str(int(time + 1e-9)))),
    "seconds of the day": Form(_stamps(lambda time: f"{(86396 + time) % 86400:.3f}"), tolerance=1e-9),  # noqa: E501
    "index of dates": Form(_date_index("to_csv", ".csv"), tolerance=1e-9),
    "parquet, index of dates": Form(_date_index("to_parquet", ".parquet"), tolerance=1e-9),
    "header in a comment": Form(_lines(lambda lines: ["# two flights", "# " + lines[0], *lines[1:]])),  # noqa: E501
    "header in a comment, blanks": Form(_lines(lambda lines: ["% " + lines[0], *lines[1:]], " ")),
    "row of groups": Form(_lines(lambda lines: [(
        "Clock,Controls,Air data,Inertial"
    ), lines[0], "s,rad,rad,rad/s", *lines[1:]])),
    "row of long names": Form(_lines(lambda lines: [lines[0], "Time of day,Stick,Vane,Gyro", "[s],[rad],[rad],[rad/s]", *lines[1:]])),  # noqa: E501
    "units above names": Form(_lines(lambda lines: ["s,rad,rad,rad/s", *lines])),
    "header again": Form(_lines(lambda lines: [*lines[:200], lines[0], *lines[200:]])),
    "elements of an array": Form(
        _lines(lambda lines: ["timestamp,control[0],control[1],xyz[1],xyz[2]", *(f"{line},0" for line in lines[1:])]),  # noqa: E501
        {"elevator": ColumnChoice("control[0]"), "alpha": ColumnChoice("control[1]"), "q": ColumnChoice("xyz[1]")},  # noqa: E501
    ),
    "titles of two cells": Form(_lines(lambda lines: ["Flight,12", "Pilot,Meyer", "", *lines])),
    "comments between rows": Form(_lines(lambda lines: [*lines[:100], "# second maneuver", *lines[100:]])),  # noqa: E501
    "separator at the end of rows": Form(_lines(_rows_with(lambda line: f"{line},"))),
    "numbers of the rows": Form(_lines(lambda lines: [lines[0], *(f'"{n + 1}",{line}' for n, line in enumerate(lines[1:]))])),  # noqa: E501
    "sums below": Form(_lines(lambda lines: [*lines, "", "Mean,0.1,0.2,0.3", "Max,1,2,3"])),
    "remark below": Form(_lines(lambda lines: [*lines, "End of data"])),
    "minus signs of a word processor": Form(_lines(_rows_with(lambda line: line.replace("-", "\N{MINUS SIGN}")))),  # noqa: E501
    "exponents of Fortran": Form(_lines(_rows_with(lambda line: " ".join(f"{float(cell):.12E}".replace("E", "D") for cell in line.split())), " ")),  # noqa: E501
    "gzip": Form(_packed(".gz", gzip.compress)),
    "bzip2": Form(_packed(".bz2", bz2.compress)),
    "xz": Form(_packed(".xz", lzma.compress)),
    "zip": Form(_packed(".zip", _zip)),
    "repeats": Form(_shuffled(lambda count: [*range(200), 199, *range(200, count)])),
    "unsorted": Form(_shuffled(_exchanged)),
    "parquet": Form(_frame("to_parquet", ".parquet")),
    "feather": Form(_frame("to_feather", ".feather")),
    "excel": Form(_frame("to_excel", ".xlsx", index=False)),
    "ods": Form(_frame("to_excel", ".ods", index=False, engine="odf")),
    "hdf5": Form(_hdf5),
    "mat vectors": Form(_mat(dict)),
    "mat struct": Form(_mat(lambda columns: {"flight": columns})),
    "mat nested": Form(_mat(lambda columns: {"log": {"flight": {name: {"data": each, "units": ""} for name, each in columns.items()}}})),  # noqa: E501
    "mat matrix": Form(_mat(lambda columns: {"Z": _matrix(columns)}), MAPPED),
    "mat named matrix": Form(_mat(lambda columns: {"Z": _matrix(columns), "names": np.array(NAMES, dtype=object)})),  # noqa: E501
    "mat iddata": Form(
        _mat(lambda columns: {"u": columns["elevator"], "y": np.column_stack([columns["alpha"], columns["q"]]), "Ts": 0.02}),  # noqa: E501
        {"elevator": ColumnChoice("u"), "alpha": ColumnChoice("y1"), "q": ColumnChoice("y2")},
    ),
    "mat 7.3": Form(_mat73),
    "mat cells of vectors": Form(_mat(lambda columns: {"data": _cells(*(columns[name] for name in NAMES)), "names": _cells(*NAMES)})),  # noqa: E501
    "mat cells of rows": Form(_mat(lambda columns: {"C": np.array([list(NAMES), *_matrix(columns).tolist()], dtype=object)})),  # noqa: E501
    "mat struct a sample": Form(
        _mat(lambda columns: {"s": np.array([tuple(row) for row in _matrix(columns)], dtype=[(name, object) for name in NAMES])})  # noqa: E501
    ),
    "mat struct a signal": Form(_mat(lambda columns: {name: {"Time": columns["time"], "Data": columns[name]} for name in NAMES[1:]}), TOPICS),  # noqa: E501
    "simulink": Form(_mat(_simulink)),
    "mat 7.3 cells": Form(_mat73_cells),
    "hdf5 group a signal": Form(_saved("record.h5", _group_a_signal), TOPICS),
    "hdf5 clock above": Form(_saved("record.h5", _clock_above), {name: ColumnChoice(f"signals.{name}") for name in NAMES[1:]}),  # noqa: E501
    "hdf5 named by attribute": Form(_saved("record.h5", _named_by_attribute)),
    "npz": Form(_saved("record.npz", lambda path, columns: np.savez(path, allow_pickle=False, **columns))),  # noqa: E501
    "npy": Form(_saved("record.npy", lambda path, columns: np.save(path, _matrix(columns))), MAPPED),  # noqa: E501
    "mdf": Form(_mdf),
    "tdms": Form(_tdms),
    "ulog": Form(
        _ulog, {"elevator": ColumnChoice("0.5*actuator_servos.control[1]"), "alpha": ColumnChoice("vane.alpha"),  # noqa: E501
                "q": ColumnChoice("vehicle_angular_velocity.xyz[1]")},
    ),
    "dataflash": Form(_dataflash, {**PWM, "alpha": ColumnChoice("AOA.AOA"), "q": ColumnChoice("IMU[0].GyrY")}),  # noqa: E501
    "dataflash text": Form(_dataflash_text, {**PWM, "alpha": ColumnChoice("AOA.AOA"), "q": ColumnChoice("IMU[0].GyrY")}),  # noqa: E501
}  # fmt: skip
