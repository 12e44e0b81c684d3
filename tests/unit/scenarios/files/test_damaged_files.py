"""Two hundred damaged files of every format, from fixed seeds: each is read with finite numbers or refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scenarios.files.measured.record_file import read_record_file, with_names
from scenarios.files.records import read_record
from sim.errors import FlightidError
from tests.recorders.forms import FORMS, record

COUNT = 200
BINARY = ("parquet", "feather", "excel", "ods", "hdf5", "mat vectors", "mat nested", "mat matrix", "mat 7.3", "mdf", "tdms", "ulog", "dataflash")
TEXT = ("dataflash text", "blanks", "bar", "no header", "utf-16", "preamble", "iso", "hh:mm:ss", "irig", "microseconds", "row of units")
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
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path: Path, part: int, capfd: pytest.CaptureFixture[str]) -> None:
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
        suffix = str(rng.choice([".csv", ".mat", ".bin", ".log", ".h5", ".xlsx"])) if kind == "other suffix" else whole[name].suffix
        path = tmp_path / f"case{seed}{suffix}"
        path.write_bytes(damaged(whole[name].read_bytes(), kind, rng))
        form = FORMS[name]
        try:
            file = with_names(read_record_file(path), form.names)
            found = read_record(file, ["elevator"], ["alpha", "q"], form.choices, rate=form.rate)
        except FlightidError as error:
            assert "\n" not in str(error) and len(error.remedy) > 5 and str(error).isprintable(), (seed, name, kind, str(error))
            continue
        except BaseException as error:
            raise AssertionError(f"seed {seed}, {name}, {kind}: {error!r}") from error
        for channel in found.channels:
            assert np.all(np.isfinite(channel.values)), (seed, name, kind)
    printed = capfd.readouterr()
    assert (printed.out, printed.err) == ("", "")
