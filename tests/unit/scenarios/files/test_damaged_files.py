"""Two hundred damaged files of every format, from fixed seeds: each is read with finite numbers or
refused in one line.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scenarios.files.measured.columns import read_record_file, with_names
from scenarios.files.records import read_record
from sim.errors import FlightidError
from tests.recorders.forms import FORMS, record

COUNT = 200
BINARY = (
    *(
        "parquet",
        "feather",
        "excel",
        "ods",
        "hdf5",
        "mat vectors",
        "mat nested",
        "mat matrix",
        "mat 7.3",
    ),
    *(
        "mdf",
        "tdms",
        "ulog",
        "dataflash",
        "mat struct a signal",
        "mat cells of vectors",
        "simulink",
    ),
    *("hdf5 group a signal", "npz", "npy", "zip", "gzip"),
)
TEXT = (
    *(
        "dataflash text",
        "blanks",
        "bar",
        "no header",
        "utf-16",
        "preamble",
        "iso",
        "hh:mm:ss",
        "irig",
    ),
    *(
        "microseconds",
        "row of units",
        "row of groups",
        "header in a comment",
        "sums below",
        "month first",
    ),
)
KINDS = ("cut", "flip", "zero", "doubled", "random tail", "other suffix", "head only", "exchanged")


def damaged(raw: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """The bytes of a file with one kind of damage."""
    size = len(raw)
    at = int(rng.integers(0, size))
    if kind == "cut":
        return raw[:at]
    if kind == "zero":
        return raw[:at] + bytes(min(64, size - at)) + raw[at + 64 :]
    if kind == "doubled":
        return raw + raw
    if kind == "random tail":
        return raw[:at] + rng.bytes(size - at)
    if kind == "head only":
        return raw[:8] + rng.bytes(200)
    if kind == "exchanged":
        half = size // 2
        return raw[half:] + raw[:half]
    out = bytearray(raw)
    if kind == "flip":
        for place in rng.integers(0, size, 12):
            out[place] ^= int(rng.integers(1, 256))
    return bytes(out)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("part", range(4))
def test_damaged_files_are_read_or_refused_in_one_line(
    tmp_path: Path, part: int, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ("h5py", "asammdf", "nptdms", "pyulog", "pymavlink", "python_calamine", "odf"):
        pytest.importorskip(name)
    columns = record(80)
    whole = {}
    for name in (*BINARY, *TEXT):
        folder = tmp_path / name.replace(" ", "-").replace(":", "")
        folder.mkdir()
        whole[name] = FORMS[name].write(folder, columns)
    for seed in range(part, COUNT, 4):
        rng = np.random.default_rng(seed)
        name = (*BINARY, *TEXT)[seed % (len(BINARY) + len(TEXT))]
        kind = KINDS[int(rng.integers(len(KINDS)))]
        suffix = (
            str(rng.choice([".csv", ".mat", ".bin", ".log", ".h5", ".xlsx"]))
            if kind == "other suffix"
            else whole[name].suffix
        )
        path = tmp_path / f"case{seed}{suffix}"
        path.write_bytes(damaged(whole[name].read_bytes(), kind, rng))
        form = FORMS[name]
        try:
            file = with_names(read_record_file(path), form.names)
            found = read_record(file, ["elevator"], ["alpha", "q"], form.choices, rate=form.rate)
        except FlightidError as error:
            assert "\n" not in str(error) and len(error.remedy) > 5 and str(error).isprintable(), (
                seed,
                name,
                kind,
                str(error),
            )
            continue
        except BaseException as error:
            raise AssertionError(f"seed {seed}, {name}, {kind}: {error!r}") from error
        for channel in found.channels:
            assert np.all(np.isfinite(channel.values)), (seed, name, kind)
    printed = capfd.readouterr()
    assert (printed.out, printed.err) == ("", "")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "name", ["mat vectors", "mat struct a signal", "mat struct a sample", "mat cells of vectors"]
)
def test_a_mat_file_with_a_wrong_type_or_flag_does_not_end_the_program(
    tmp_path: Path, name: str
) -> None:
    """SciPy reads beyond its own tables where the type of an element is none, or an imaginary part
    is missing.
    """
    path = FORMS[name].write(tmp_path, record(220))
    whole, rng = path.read_bytes(), np.random.default_rng(4)
    refused = 0
    for _ in range(60):
        content = bytearray(whole)
        for place in 128 + 8 * rng.integers(0, min(len(content) - 128, 600) // 8, 2):
            content[place : place + 2] = rng.bytes(2)
        path.write_bytes(content)
        try:
            read_record_file(path)
        except FlightidError:
            refused += 1
    assert refused


def test_arrays_of_every_class_in_a_mat_file_are_of_known_types(tmp_path: Path) -> None:
    from scipy.io import savemat
    from scipy.sparse import eye

    cells = np.empty(3, dtype=object)
    cells[:] = ["text", np.zeros((0, 0)), {"inner": 1 + 2j}]
    others = {
        "empty": np.zeros((0, 0)),
        "none": "",
        "text": "abc",
        "yes": True,
        "wave": np.exp(1j * np.arange(5.0)),
        "few": np.array([1, 2], dtype=np.int8),
    }
    savemat(
        tmp_path / "run.mat",
        {**record(30), **others, "cells": cells, "sparse": eye(4), "words": np.array(["ab", "cd"])},
    )
    assert {"time", "alpha"} <= set(read_record_file(tmp_path / "run.mat").table.header)
