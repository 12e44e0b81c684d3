"""Files opened once: the hash is that of the bytes that were used, whatever happens to the file
meanwhile.
"""

from __future__ import annotations

import hashlib
import os
import threading
from pathlib import Path

import pytest

from scenarios.cli.options import MODEL_NAMES
from scenarios.files.measured.columns import (
    read_record_file,
    read_with_validation,
    refuse_duplicates,
)
from scenarios.files.records import read_record
from scenarios.files.schemas import SCHEMAS
from scenarios.files.sources import read_source
from scenarios.files.vehicles import AIRCRAFT, MODELS, read_any_vehicle, read_vehicle
from sim.errors import DeclarationError, RecordError

FIRST = b"time,q\n0,1\n1,2\n"
LATER = b"time,q\n0,7\n1,8\n2,9\n"


def test_a_file_that_changes_after_reading_keeps_the_hash_and_the_numbers_of_what_was_read(
    tmp_path: Path,
) -> None:
    path = tmp_path / "record.csv"
    path.write_bytes(FIRST)
    file = read_record_file(path)
    path.write_bytes(LATER)
    assert (file.identity.name, file.identity.sha256) == (
        "record.csv",
        hashlib.sha256(FIRST).hexdigest(),
    )
    assert read_record(file, (), ["q"])["q"].values.tolist() == [1.0, 2.0]
    assert read_record(path, (), ["q"])["q"].values.tolist() == [7.0, 8.0, 9.0]


def test_a_pipe_is_read_and_hashed_though_it_can_be_read_once_only(tmp_path: Path) -> None:
    pipe = tmp_path / "record.csv"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_bytes, args=(FIRST,))
    writer.start()
    file = read_record_file(pipe)
    writer.join()
    assert (
        file.identity.sha256 == hashlib.sha256(FIRST).hexdigest()
        and len(read_record(file, (), ["q"])) == 2
    )


def test_records_with_equal_names_are_told_apart_by_as_many_folders_as_it_takes(
    tmp_path: Path,
) -> None:
    paths = [
        tmp_path / place
        for place in (
            "a/flight1/record.csv",
            "a/flight2/record.csv",
            "b/flight1/other.csv",
            "b/flight2/record.csv",
            "lone.csv",
        )
    ]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(FIRST)

    def names(fitted: list[Path], predicted: list[Path]) -> list[str]:
        return [
            file.identity.name
            for files in read_with_validation(fitted, predicted)
            for file in files
        ]

    assert names(paths[:1], paths[1:3]) == ["flight1/record.csv", "flight2/record.csv", "other.csv"]
    assert names([paths[0], paths[1]], [paths[3]]) == [
        "a/flight1/record.csv",
        "a/flight2/record.csv",
        "b/flight2/record.csv",
    ]
    assert names(paths[:1], paths[4:]) == ["record.csv", "lone.csv"]


def test_a_vehicle_file_carries_the_hash_of_what_was_read_and_equals_another_that_says_the_same(
    tmp_path: Path,
) -> None:
    text = "airspeed = 208.0\ngravity = 9.8\n[derivatives]\n" + "\n".join(
        f"{name} = 1.0"
        for name in ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau", "delay")
    )
    path = tmp_path / "plane.toml"
    path.write_text(text)
    one = read_vehicle(path, "loes")
    path.write_text(text + "\n# a remark\n")
    two = read_any_vehicle(path)
    assert one == two and one.identity is not None and two.identity is not None
    assert one.identity.sha256 == hashlib.sha256(text.encode()).hexdigest() != two.identity.sha256


@pytest.mark.parametrize(
    ("error", "wanted"), [(RecordError, "the record file"), (DeclarationError, "a TOML file")]
)
def test_what_cannot_be_opened_is_told_in_one_line(
    error: type[RecordError] | type[DeclarationError], wanted: str, tmp_path: Path
) -> None:
    (tmp_path / "file").write_bytes(b"x")
    for path, said in (
        (tmp_path / "none", "there is no such file; check the path"),
        (tmp_path, f"this is a folder; name {wanted} in it"),
    ):
        with pytest.raises(error) as caught:
            read_source(path, error, wanted)
        assert str(caught.value) == f"{path}: {said}"
    with pytest.raises(error, match="there is no such file"):
        read_source(tmp_path / "file" / "inside", error, wanted)


def test_the_same_record_by_another_path_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="named twice; name each record once"):
        refuse_duplicates([tmp_path / "a.csv", tmp_path / "b" / ".." / "a.csv"])


def test_every_model_of_a_vehicle_file_has_a_schema_and_is_named_in_the_help() -> None:
    assert set(MODELS) == {*SCHEMAS, AIRCRAFT}  # whose file has tables of terms
    assert MODEL_NAMES == MODELS
