"""Malformed calls end as one line and exit code 2, or as a right result: a part of them by default,
all 600 with ``-m slow``.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.cases import COUNT, KINDS, case
from tests.fuzz.judging import Ended, fault_of, files_in, run
from tests.fuzz.material import Material, make_material

# of the cases one in so many belongs to the default suite; prime to the number of kinds, so that
# all of these come
SHARE = 20


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    return make_material(tmp_path_factory.mktemp("material"))


def faults(numbers: range, material: Material, tmp_path: Path) -> dict[int, str]:
    """What is wrong with the end of each of the cases of which something is."""
    found = {}
    for number in numbers:
        folder = tmp_path / f"case{number}"
        folder.mkdir()
        arguments = case(number, material, folder)
        before = files_in(folder)
        ended = run(arguments, folder)
        if fault := fault_of(ended, folder, before):
            found[number] = f"{fault}: {arguments} {ended.err}"[:600]
    return found


@pytest.mark.long
def test_some_malformed_calls_end_well(material: Material, tmp_path: Path) -> None:
    assert faults(range(0, COUNT, SHARE + 1), material, tmp_path) == {}


@pytest.mark.slow
@pytest.mark.parametrize("kind", range(len(KINDS)))
def test_all_malformed_calls_end_well(kind: int, material: Material, tmp_path: Path) -> None:
    assert faults(range(kind, COUNT, len(KINDS)), material, tmp_path) == {}


@pytest.mark.long
def test_a_number_is_one_case_however_often_it_is_asked_for(
    material: Material, tmp_path: Path
) -> None:
    for number in range(len(KINDS)):
        folders = [tmp_path / f"{number}-{time}" for time in range(2)]
        for folder in folders:
            folder.mkdir()
        calls = [case(number, material, folder) for folder in folders]
        assert calls[0] == calls[1]
        contents = [
            {
                name: (folder / name).read_bytes()
                for name in files_in(folder)
                if _is_plain(folder / name)
            }
            for folder in folders
        ]
        assert contents[0] == contents[1]


def _is_plain(path: Path) -> bool:
    return path.is_file() and path.stat().st_size < 1 << 24


@pytest.mark.parametrize(
    ("ended", "fault"),
    [
        (Ended(1, "", "flightid: internal error; report it\n", False), "exit code 1"),
        (Ended(2, "", "flightid: a; b\nflightid: c; d\n", False), "2 lines"),
        (Ended(2, "", "Traceback (most recent call last):\n", False), "not the program's own"),
        (Ended(2, "", "flightid: wrong\n", False), "no remedy"),
        (Ended(2, "", "flightid: \x1b[31mred; mend it\n", False), "control character"),
        (Ended(0, "L_p  nan  +- 0.1\n", "", False), "nan is printed"),
        (Ended(0, "", "RuntimeWarning: overflow\n", False), "not the program's own"),
        (Ended(0, "", "", True), "too long"),
    ],
)
def test_the_judge_sees_what_is_wrong(ended: Ended, fault: str, tmp_path: Path) -> None:
    assert fault in fault_of(ended, tmp_path, frozenset())


def test_the_judge_sees_what_is_left_behind_and_what_is_no_number(tmp_path: Path) -> None:
    (tmp_path / "half.csv").write_text("time\n")
    assert "left behind" in fault_of(
        Ended(2, "", "flightid: wrong; mend it\n", False), tmp_path, frozenset()
    )
    (tmp_path / "study.json").write_text('{"value": NaN}')
    assert "no strict JSON" in fault_of(Ended(0, "", "", False), tmp_path, frozenset())
    (tmp_path / "study.json").write_text('{"value": 1e999}')
    assert "no strict JSON" in fault_of(Ended(0, "", "", False), tmp_path, frozenset())
