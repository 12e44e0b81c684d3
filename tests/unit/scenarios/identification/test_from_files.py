"""The other reading of the inputs is tried where no one declared how they are held."""

from __future__ import annotations

import tracemalloc
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import flightid
from ident.estimate import Outcome
from scenarios.files.measured.columns import RecordFile, read_record_file
from scenarios.files.writing import write_record
from scenarios.identification import identify
from scenarios.identification.assessment import DEFAULT_OPTIONS, Options, other_reading
from scenarios.identification.identify import identify_files
from scenarios.identification.methods import FILTERS, METHODS
from scenarios.preparation.plan import Plan, Request
from scenarios.studies.declaration import Row
from sim.record import Channel, Hold, Record
from tests.bases import Flight, rigid_model, three_two_one_one
from tests.own_models import ROLL, model_file
from tests.rigid_problem import FREE, TRUE, noisy, rigid_start


@dataclass(frozen=True)
class Found:
    """What an identification says of its record, and its notes."""

    record: Any
    notes: tuple[str, ...] = ()
    tests: tuple[Any, ...] = ()
    doubts: tuple[Any, ...] = ()


@dataclass
class Spy:
    """Replaces preparation and fit: records the hold and the options of each fit."""

    inputs: tuple[str, ...] = ("aileron",)
    outcome_ok: bool = True
    holds: list[Hold | None] = field(default_factory=list)
    asked: list[Options] = field(default_factory=list)

    def __call__(
        self,
        _vehicle: Any,
        _method: str,
        _files: Any,
        _choices: Any,
        plan: Plan,
        asked: Options,
        _opening: Any,
    ) -> Any:
        self.holds.append(plan.hold)
        self.asked.append(asked)
        found = Found(SimpleNamespace(inputs=self.inputs, hold=plan.hold or Hold.PREVIOUS))
        return SimpleNamespace(measured=()), found


@pytest.fixture
def spy(monkeypatch: pytest.MonkeyPatch) -> Spy:
    seen = Spy()
    monkeypatch.setattr(identify, "_identified", seen)

    def read_otherwise(ready: Any, found: Any, again: Any, options: Options) -> Any:
        return again(
            Hold.LINEAR if found.record.hold is Hold.PREVIOUS else Hold.PREVIOUS,
            replace(options, profile=None),
        )

    monkeypatch.setattr(identify, "_with_other_hold", read_otherwise)
    monkeypatch.setattr(identify, "filter_error_proposed", lambda *_: ())
    return seen


def record_files(
    folder: Path, count: int, *, states_hold: tuple[int, ...] = ()
) -> tuple[RecordFile, ...]:
    """Short records, of which some say how their inputs are held."""
    time = 0.1 * np.arange(20)
    opened = []
    for number in range(count):
        outputs = tuple(
            Channel.of(name, unit, np.sin(time)) for name, unit in (("p", "rad/s"), ("phi", "rad"))
        )
        record = Record(
            time,
            (Channel.of("aileron", "rad", np.cos(time)),),
            outputs,
            Hold.PREVIOUS,
            f"flight {number}",
        )
        file = read_record_file(write_record(folder, record, f"flight{number}")[0])
        opened.append(
            replace(file, sidecar=replace(file.sidecar, states_hold=number in states_hold))
        )
    return tuple(opened)


def request(folder: Path, count: int = 1, hold: Hold | None = None, **says: Any) -> Request:
    model = str(model_file(folder, ROLL))
    return Request(record_files(folder, count, **says), model, plan=Plan(hold=hold))


def test_inputs_that_nobody_said_how_to_read_are_read_the_other_way_as_well(
    spy: Spy, tmp_path: Path
) -> None:
    identify_files(request(tmp_path, 2), "output-error", replace(DEFAULT_OPTIONS, profile=("L_p",)))
    assert spy.holds == [None, Hold.LINEAR]
    # Profiles are of the result that is given, and not made again.
    assert [asked.profile for asked in spy.asked] == [("L_p",), None]


@pytest.mark.parametrize("method", METHODS)
def test_filters_are_not_run_twice(spy: Spy, tmp_path: Path, method: str) -> None:
    identify_files(request(tmp_path), method)
    assert len(spy.holds) == (1 if method in FILTERS else 2)


def test_without_an_input_there_is_no_other_reading(spy: Spy, tmp_path: Path) -> None:
    spy.inputs = ()
    identify_files(request(tmp_path), "output-error")
    assert spy.holds == [None]


@pytest.mark.parametrize("hold", list(Hold))
def test_a_reading_that_is_asked_for_is_the_only_one(spy: Spy, tmp_path: Path, hold: Hold) -> None:
    identify_files(request(tmp_path, hold=hold), "output-error")
    assert spy.holds == [hold]


@pytest.mark.parametrize("says", [(0,), (1,), (0, 1)])
def test_one_file_that_says_how_its_inputs_are_held_is_enough(
    spy: Spy, tmp_path: Path, says: tuple[int, ...]
) -> None:
    identify_files(request(tmp_path, 2, states_hold=says), "output-error")
    assert spy.holds == [None]


@pytest.mark.parametrize("used", list(Hold))
@pytest.mark.parametrize(("by", "told"), [(0.9, False), (1.1, True), (-0.9, False), (-1.1, True)])
def test_the_other_reading_is_told_where_it_moves_a_value_by_more_than_its_sigma(
    used: Hold, by: float, told: bool
) -> None:
    rows = [
        Row("L_p", "1/s", -2.0, 0.1),
        Row("L_da", "1/s2", 8.0, 0.4),
        Row("held", "1/s", 1.0, 0.0),
    ]
    again = [
        Row("L_p", "1/s", -2.0 + 0.1 * by, 0.9),
        Row("L_da", "1/s2", 8.0, 0.01),
        Row("held", "1/s", 5.0, 0.0),
    ]
    found = other_reading(used, rows, again, -3.0)
    assert (found is not None) is told
    if found is not None:
        assert (
            [row.name for row, _ in found.moved] == ["L_p"]
            and {found.used, found.other} == set(Hold)
            and found.used is used
        )
        assert "fits worse" in found.sentence and f"--hold {found.other.value}" in found.sentence


def test_no_profile_is_made_of_the_other_reading() -> None:
    asked: list[Options] = []
    ended = SimpleNamespace(
        record=SimpleNamespace(hold=Hold.PREVIOUS),
        estimate=SimpleNamespace(outcome=Outcome.DIVERGED),
    )

    def again(hold: Hold, options: Options) -> Any:
        asked.append(options)
        assert hold is Hold.LINEAR
        return None, ended

    ready: Any = "ready"
    found: Any = identify._with_other_hold(
        ready, cast(Any, ended), again, replace(DEFAULT_OPTIONS, profile=("L_p",))
    )
    assert found == (ready, ended)
    assert [options.profile for options in asked] == [None]


PAUSE = 40.0  # s, from one maneuver to the next


def several_maneuvers(samples: int) -> Record:
    """The rigid aircraft at 100 Hz in one 3-2-1-1 after the other, of four lengths and both
    signs.
    """
    time = np.arange(samples) / 100.0
    starts = np.arange(5.0, time[-1] - 12.0, PAUSE)
    steps = [
        three_two_one_one(time, start=at, unit=0.4 + 0.1 * (i % 4), size=0.03 * (-1) ** i)
        for i, at in enumerate(starts.tolist())
    ]
    return noisy(rigid_model(), Flight(time, np.sum(steps, axis=0)[None]), np.random.default_rng(1))


def fitted_within(samples: int, most: float) -> None:
    """A fit of the record settles at the truth; ``most``: GB at its peak."""
    record, start = several_maneuvers(samples), rigid_start()
    values = {item.name: item.value for item in start.parameters}
    derivatives = {name: values[name] for name in FREE}
    vehicle = {
        "name": "bomber",
        "derivatives": derivatives,
        **{name: value for name, value in values.items() if name not in FREE},
    }
    columns = {"time": record.time, **{channel.name: channel.values for channel in record.channels}}
    tracemalloc.start()
    try:
        found = flightid.identify(columns, "rigid", vehicle, hold="previous")
        peak = tracemalloc.get_traced_memory()[1] / 1e9
    finally:
        tracemalloc.stop()
    assert found.details.found.estimate.outcome.name == "CONVERGED"
    assert found.details.found.estimate.iterations < 20
    assert np.max(np.abs((found.values - TRUE) / found.sigmas)) < 4.0
    assert peak < most


@pytest.mark.long
def test_two_minutes_with_three_maneuvers() -> None:
    fitted_within(12_000, 0.2)


@pytest.mark.slow
def test_ten_minutes_with_fifteen_maneuvers() -> None:
    fitted_within(60_000, 1.0)
