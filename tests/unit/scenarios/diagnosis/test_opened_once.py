"""A diagnosis opens each of its files once, and says the hashes of what it read."""

from __future__ import annotations

import hashlib
import math
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ident.tracing.diagnosis import Claim, Diagnosis, Quantity, Trained, Verdict
from ident.whole_record.layout import FitSettings
from scenarios.compatibility import check_files
from scenarios.diagnosis.diagnose import diagnose_files
from scenarios.diagnosis.opening import (
    Refit,
    has_fitted_times,
    notes_of_reread,
    with_sigmas_of_both,
)
from scenarios.preparation.plan import BY_HAND, Plan, Request, Segment
from sim.effects.sensor_path.sensor_mounting import VaneOffset
from sim.record import Hold, Record
from tests.diagnoses import RIGID, diagnosis_of, measured_record, tracing_of, written_inputs

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


def test_the_second_reading_was_chosen_by_no_hand() -> None:
    notes = (f"inputs linear between samples: {BY_HAND}", "a trim was taken off")
    first, second = notes_of_reread(notes)
    assert BY_HAND not in first and "--hold previous" in first and second == notes[1]


def test_times_found_with_held_inputs_ask_for_a_second_reading() -> None:
    record = measured_record()
    late = Claim("sensor-delay:alpha", {"delay": Quantity(0.05, 0.001, "s")})
    found = replace(tracing_of(Verdict.TRACED).diagnosis, effects=(late,))
    assert has_fitted_times(found, [record])
    assert not has_fitted_times(found, [replace(record, hold=Hold.LINEAR)])
    vane = Claim("vane-offset", {"arm": Quantity(3.0, 0.1, "m")})
    assert not has_fitted_times(replace(found, effects=(vane,)), [record])
    hint = replace(late, claimed=False)
    boom = Trained((VaneOffset(),), ("alpha",), {}, ({},), FitSettings())
    other = replace(found, effects=(vane, hint), trained_after=boom)
    assert not has_fitted_times(other, [record]), "the hint belongs to another set"


def test_where_both_readings_serve_what_differs_is_told_and_sigmas_hold_both() -> None:
    """Half an interval of 0.02 s is ten sigmas of a delay; nothing is told where one of the two
    readings fits clearly better, or where nothing moves.
    """
    late = Claim("sensor-delay:q", {"delay": Quantity(0.09, 0.001, "s")})
    first = replace(
        tracing_of(Verdict.TRACED).diagnosis,
        effects=(late,),
        after={"Cm_q": Quantity(-12.0, 0.3, "1/rad")},
    )
    moved = {"sensor-delay:q.delay": 0.10, "Cm_q": -12.4}
    both, (told,) = with_sigmas_of_both(Refit(0.0, moved), first)
    assert "sensor-delay:q.delay 0.1 for 0.09" in told and "--hold linear" in told
    (found,) = both.effects
    # Two values, equally probable, and the scatter of each: the mean square about the first.
    assert found.parameters["delay"].value == 0.09
    assert found.parameters["delay"].std ** 2 == pytest.approx(0.001**2 + 0.5 * 0.01**2)
    assert both.after["Cm_q"].std ** 2 == pytest.approx(0.3**2 + 0.5 * 0.4**2)
    likelier, _ = with_sigmas_of_both(Refit(6.0, moved), first)
    share = 1.0 / (1.0 + math.exp(-3.0))
    assert likelier.effects[0].parameters["delay"].std ** 2 == pytest.approx(
        0.001**2 + share * 0.01**2
    )
    still = {"sensor-delay:q.delay": 0.0905, "Cm_q": -12.1}
    for again in (
        Refit(0.0, still),
        Refit(-11.0, moved),
        Refit(11.0, moved),
        Refit(-math.inf, {}),
    ):
        assert with_sigmas_of_both(again, first) == (first, ())
