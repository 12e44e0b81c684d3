"""A diagnosis opens each of its files once, and says the hashes of what it read."""

from __future__ import annotations

import hashlib
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from ident.tracing.diagnosis import Diagnosis, Verdict
from scenarios.compatibility import check_files
from scenarios.diagnosis.diagnose import diagnose_files
from scenarios.preparation.plan import Plan, Request, Segment
from sim.record import Record
from tests.diagnoses import RIGID, diagnosis_of, written_inputs

MAP = 'alpha = "alpha"\n'
OWN = Path(__file__).parents[4] / "docs" / "how-to" / "own-effect.md"
_OPENED: list[str] = []
_WATCHED: list[str] = []


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _WATCHED and str(arguments[0]).startswith(_WATCHED[0]):
        _OPENED.append(Path(str(arguments[0])).name)


sys.addaudithook(_hook)  # it cannot be taken off: it does nothing while no folder is watched


@pytest.fixture
def opened(tmp_path: Path) -> Any:
    """Names of the files in the test's folder, as often as they were opened."""
    _OPENED.clear()
    _WATCHED.append(str(tmp_path))
    yield _OPENED
    _WATCHED.clear()


class Overwriting:
    """Stands in for the loop: overwrites every file meanwhile."""

    def __init__(self, files: Sequence[Path] = ()) -> None:
        self.files = files

    def __call__(
        self,
        records: Sequence[Record],
        model,
        candidates,
        guards,
        validation,
        settings,
        progress,
        kinematics=None,
        reread=None,
    ) -> Diagnosis:
        for file in self.files:
            file.write_text("nothing of use\n")
        return diagnosis_of(Verdict.PARTIAL, RIGID, tuple(records), tuple(validation))


def request(folder: Path, plan: Plan | None = None) -> Request:
    train, validate, vehicle = written_inputs(folder)
    channels, own = folder / "map.toml", folder / "own.py"
    channels.write_text(MAP)
    own.write_text(OWN.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0])
    return Request((train,), "rigid", vehicle, (validate,), own, channels, plan or Plan())


@pytest.mark.sampled
@pytest.mark.parametrize(
    "plan", [Plan(), Plan((Segment(0.5, 2.0), Segment(2.1, 3.9)))], ids=["whole", "segments"]
)
def test_each_file_is_opened_once_also_where_the_kinematics_are_checked(
    tmp_path: Path, plan: Plan, opened: list[str]
) -> None:
    asked = request(tmp_path, plan)
    opened.clear()
    tracing = diagnose_files(asked, trace=Overwriting())
    assert tracing.kinematics is not None and tracing.kinematics.result is not None
    counts = Counter(opened)
    assert {
        name: counts[name]
        for name in ("train.csv", "validate.csv", "vehicle.toml", "map.toml", "own.py")
    } == dict.fromkeys(("train.csv", "validate.csv", "vehicle.toml", "map.toml", "own.py"), 1)
    assert set(counts) <= {
        "train.csv",
        "validate.csv",
        "vehicle.toml",
        "map.toml",
        "own.py",
        "train.json",
        "validate.json",
    }
    assert max(counts.values()) == 1


def test_a_check_opens_each_file_once(tmp_path: Path, opened: list[str]) -> None:
    train, validate, _ = written_inputs(tmp_path)
    opened.clear()
    check_files(Request((train, validate)))
    assert Counter(opened) == Counter(
        {
            name: 1
            for name in ("train.csv", "train.json", "validate.csv", "validate.json", "vehicle.toml")
        }
    )


def test_files_overwritten_meanwhile_keep_hashes_and_numbers_of_what_was_read(
    tmp_path: Path,
) -> None:
    asked = request(tmp_path)
    files = [
        path
        for path in (*asked.records, *asked.validate, asked.vehicle, asked.effects)
        if isinstance(path, Path)
    ]
    assert len(files) == len(asked.records) + len(asked.validate) + 2
    expected = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    tracing = diagnose_files(asked, trace=Overwriting(files))
    inputs = tracing.inputs
    told = [*inputs.records, *inputs.validation, inputs.vehicle, *inputs.effects]
    assert [file.sha256 for file in told] == expected
    assert all(hashlib.sha256(file.read_bytes()).hexdigest() not in expected for file in files)
    # The kinematics are checked on what was read, too.
    assert tracing.kinematics is not None and tracing.kinematics.records == (
        "train.csv",
        "validate.csv",
    )
