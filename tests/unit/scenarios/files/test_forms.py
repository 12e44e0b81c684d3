"""One record in every form that recorders and people store it in reads back equal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scenarios.files.formats.registry import readers
from scenarios.files.measured.record_file import read_record_file, with_names
from scenarios.files.records import read_record
from tests.recorders.forms import FORMS, record

LIBRARIES = {"hdf5": "h5py", "mat 7.3": "h5py", "mdf": "asammdf", "tdms": "nptdms", "ulog": "pyulog", "dataflash": "pymavlink"}
LIBRARIES |= {"excel": "python_calamine", "ods": "odf"}


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize("name", FORMS)
def test_the_same_record_in_every_form(tmp_path: Path, name: str) -> None:
    if name in LIBRARIES:
        pytest.importorskip(LIBRARIES[name])
    form, columns = FORMS[name], record()
    file = with_names(read_record_file(form.write(tmp_path, columns)), form.names)
    found = read_record(file, ["elevator"], ["alpha", "q"], form.choices, rate=form.rate)
    np.testing.assert_allclose(found.time - found.time[0], columns["time"], rtol=0, atol=max(form.tolerance, 1e-9))
    for channel in found.channels:
        np.testing.assert_allclose(channel.with_gaps(), columns[channel.name], rtol=1e-12, atol=form.tolerance, err_msg=channel.name)


def test_every_format_has_a_form() -> None:
    suffixes = {suffix for reader in readers().values() for suffix in reader.SUFFIXES}
    assert {".csv", ".ulg", ".bin", ".mf4", ".tdms", ".h5", ".mat", ".xlsx", ".ods", ".feather", ".parquet"} <= suffixes
    for name, reader in readers().items():
        assert reader.FORMAT and reader.SUFFIXES and reader.__doc__, name
