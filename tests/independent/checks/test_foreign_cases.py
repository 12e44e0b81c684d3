"""The sixty cases of causes outside the library: what they are made of, that they can be seen, and
how an answer to one is graded.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.independent.examine import chosen
from tests.independent.folders import Recording
from tests.independent.foreign.__main__ import main
from tests.independent.foreign.catalogue import CAUSES, SIZES, Case, cases, flights_of, write_case
from tests.independent.foreign.rigid_fit import (
    SHOWN,
    best_rigid,
    centred,
    predicted,
    seen_beside_rigid,
)
from tests.independent.foreign.simulator import Term, flown_with
from tests.independent.grading import Answer, Fault, Grade, graded
from tests.independent.maneuvers import training
from tests.independent.recording import USUAL
from tests.independent.short_period import TRAINER, VEHICLES

SEED = 1
QUICK = ("cable-creep", "quadratic-damping", "vane-feels-elevator")
# of the two records at 50 Hz; standard deviations of chi squared
SAMPLES, CHANNELS, FAR = 2450.0, 3.0, 5.0


def fault_of(folder: Path) -> Fault:
    one = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["faults"][0]
    return Fault(
        one["name"], frozenset(one["right"]), frozenset(one["twins"]), tuple(one["channels"])
    )


def answer(verdict: str, *names: str) -> Answer:
    effects: list[dict[str, Any]] = [
        {"name": name, "alternatives": [], "parameters": {}} for name in names
    ]
    return Answer(0, {"verdict": verdict, "effects": effects, "warnings": []})


def test_twenty_causes_in_three_sizes_meet_three_aircraft() -> None:
    every = list(cases(list(CAUSES), SIZES))
    assert len(CAUSES) == 20 and len(every) == 60 and len({case.folder for case in every}) == 60
    assert all(
        {case.vehicle for case in every if case.cause == name} == set(VEHICLES) for name in CAUSES
    )
    assert Counter(case.rate for case in every)[50.0] == 48
    for cause in CAUSES.values():
        small, medium, large = cause.sizes
        assert small < medium < large or small > medium > large, cause.name
    assert sum(bool(cause.right) for cause in CAUSES.values()) <= 3, (
        "names that are accepted stay rare"
    )
    assert [case.vehicle for case in cases(["buffet"], ["small"], list(VEHICLES))] == list(VEHICLES)


@pytest.mark.slow
def test_a_folder_is_what_the_examiner_grades(tmp_path: Path) -> None:
    main(
        [
            str(tmp_path),
            "--cause",
            "quadratic-damping",
            "gyro-warms",
            "--size",
            "medium",
            "--vehicle",
            "trainer",
            "--rate",
            "25",
        ]
    )
    hidden, known = (
        tmp_path / "quadratic-damping-medium-trainer",
        tmp_path / "gyro-warms-medium-trainer",
    )
    assert chosen(tmp_path, None, None) == [known, hidden]
    files = {"train.csv", "train_2.csv", "validate.csv", "vehicle.toml", "truth.json"}
    assert {path.name for path in hidden.iterdir()} == files
    rows = np.loadtxt(hidden / "train.csv", delimiter=",", skiprows=1)
    assert rows.shape == (626, 5) and rows[1, 0] == pytest.approx(0.04)
    assert graded([fault_of(hidden)], answer("traced", "phugoid")).grade is Grade.MISSED
    assert graded([fault_of(hidden)], answer("unexplained", "phugoid")).grade is Grade.NOTICED
    assert graded([fault_of(hidden)], answer("partial", "moment-nonlinearity")).grade is Grade.FALSE
    assert graded([fault_of(known)], answer("traced", "sensor-drift:q")).grade is Grade.RIGHT
    assert graded([fault_of(known)], answer("traced", "sensor-step:q")).grade is Grade.FALSE


@pytest.mark.slow
def test_the_same_seed_writes_the_same_records(tmp_path: Path) -> None:
    case = Case("vortex-wake", "small", "trainer")
    for name in ("one", "two"):
        write_case(tmp_path / name, case, Recording(25.0), SEED)
    for file in ("train.csv", "vehicle.toml"):
        assert (tmp_path / "one" / case.folder / file).read_bytes() == (
            tmp_path / "two" / case.folder / file
        ).read_bytes()
    first, second, _ = flights_of(case, SEED)
    assert abs(int(np.argmin(first.alpha)) - int(np.argmin(second.alpha))) > 100, (
        "each record meets the wake at its own time"
    )


def test_the_rigid_fit_finds_a_rigid_aircraft() -> None:
    flight = flown_with(TRAINER, training(0.3)[0], 0.02, Term())
    found, left = best_rigid(TRAINER, [flight])
    np.testing.assert_allclose(found, list(TRAINER.derivatives.values()), rtol=0.02)
    # Ramps bend between grid points, where the fit has straight lines: less than a twentieth of a
    # sensor's noise.
    assert np.all(
        np.max(np.abs(left[0]), axis=1) < 0.05 * np.array([USUAL[name] for name in SHOWN])
    )
    shown = predicted(
        TRAINER, np.array(list(TRAINER.derivatives.values())), flight.elevator, flight.step
    )
    # Straight lines between the samples of the fine grid, and bends of the ramps between them.
    np.testing.assert_allclose(
        centred(shown), centred(np.stack([flight.alpha, flight.q, flight.nz - 1.0])), atol=1e-4
    )


def visible(name: str, size: str) -> bool:
    """Whether what the best rigid model leaves over adds more to chi squared than noise makes it
    scatter, `FAR` times.
    """
    (case,) = cases([name], [size])
    shown = sum(sigmas**2 for sigmas, _ in seen_beside_rigid(case, SEED).values())
    return SAMPLES * shown > FAR * np.sqrt(2.0 * CHANNELS * SAMPLES)


@pytest.mark.long
@pytest.mark.parametrize("name", QUICK)
def test_a_medium_cause_shows_beside_the_best_rigid_model(name: str) -> None:
    assert visible(name, "medium")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CAUSES if name not in QUICK])
def test_every_medium_and_large_cause_shows(name: str) -> None:
    assert visible(name, "medium") and visible(name, "large")
