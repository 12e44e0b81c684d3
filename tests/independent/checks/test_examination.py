"""What the loop must show on flights of simulators that it does not share: a few cases always, the
whole examination as a slow statistic.
"""

from __future__ import annotations

import concurrent.futures
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.independent.catalogue import FAULTS, FIRST
from tests.independent.examine import FEW_SIGMAS, Outcome, examined, summary
from tests.independent.fly import fly_aircraft
from tests.independent.folders import Recording
from tests.independent.grading import Grade
from tests.independent.jsbsim_aircraft import AIRCRAFT
from tests.independent.jsbsim_flight import AVAILABLE
from tests.independent.short_period import VEHICLES
from tests.independent.undeclared import NAMES, Case, cases, write_case

SEED = 1
# share of explained flights with one of six derivatives beyond three sigmas: by chance 0.016, and
# 0.05 once in a thousand of 200
FAR = 0.05
RECORDED = (
    Recording(10.0),
    Recording(25.0, ("alpha", "q")),
    Recording(100.0, ("alpha", "q", "nz", "theta")),
    Recording(200.0, ("alpha", "q", "nz", "theta", "airspeed")),
)


def outcomes_of(folders: Sequence[Path], studies: Path) -> list[Outcome]:
    """Two diagnoses at a time; the tables go to the captured output."""
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        outcomes = list(pool.map(lambda folder: examined(folder, studies), folders))
    print(summary(outcomes))
    return outcomes


def bad(outcomes: Sequence[Outcome], *grades: Grade) -> list[str]:
    return [
        f"{outcome.flight}: {outcome.graded.grade.value}, {outcome.graded.why}"
        for outcome in outcomes
        if outcome.graded.grade in grades
    ]


@pytest.mark.long
def test_a_late_vane_is_told_and_degrees_are_refused(tmp_path: Path) -> None:
    asked = [Case("fighter", "late-alpha", "large"), Case("jet", "alpha-degrees", "small")]
    late, degrees = outcomes_of(
        [write_case(tmp_path, case, Recording(), SEED) for case in asked], tmp_path / "studies"
    )
    assert late.graded.grade is Grade.RIGHT, late
    assert late.worst < FEW_SIGMAS
    assert degrees.graded.grade is Grade.NOTICED, degrees


@pytest.mark.slow
def test_a_light_aircraft_at_ten_samples_a_second_is_not_refused(tmp_path: Path) -> None:
    """Its motion changes within three samples: a control that works the other way half a period
    later explains them as well.
    """
    (sound,) = outcomes_of(
        [write_case(tmp_path, Case("trainer", "nothing", "small"), Recording(10.0), SEED)],
        tmp_path / "studies",
    )
    assert sound.graded.grade is Grade.RIGHT, sound


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("fault", ["nothing", "phugoid"])
def test_nothing_but_a_phugoid_is_found_where_nothing_was_put_in(
    vehicle: str, fault: str, tmp_path: Path
) -> None:
    asked = cases([vehicle], [fault], ["small", "large"], [False])
    outcomes = outcomes_of(
        [write_case(tmp_path, case, Recording(), SEED) for case in asked], tmp_path / "studies"
    )
    assert all(
        outcome.graded.grade is Grade.RIGHT and outcome.worst < FEW_SIGMAS for outcome in outcomes
    ), outcomes


def _far(outcomes: Sequence[Outcome]) -> float:
    """Share of flights that were told right and explained, with a derivative beyond three
    sigmas.
    """
    explained = [
        outcome for outcome in outcomes if outcome.traced and outcome.graded.grade is Grade.RIGHT
    ]
    return sum(outcome.worst > FEW_SIGMAS for outcome in explained) / max(len(explained), 1)


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside a late alpha"])
def test_every_fault_is_named_noticed_or_refused(
    vehicle: str, beside: bool, tmp_path: Path
) -> None:
    asked = cases([vehicle], NAMES, ["small", "large"], [beside])
    outcomes = outcomes_of(
        [write_case(tmp_path, case, Recording(), SEED) for case in asked], tmp_path / "studies"
    )
    assert bad(outcomes, Grade.FALSE, Grade.MISSED, Grade.ALARM, Grade.BROKEN) == []
    assert _far(outcomes) <= FAR


@pytest.mark.slow
@pytest.mark.parametrize(
    "how", RECORDED, ids=lambda how: f"{how.rate:.0f} Hz, {' '.join(how.channels)}"
)
def test_rates_and_channels(how: Recording, tmp_path: Path) -> None:
    asked = cases(
        list(VEHICLES), ["nothing", "phugoid", "late-alpha", "q-scale"], ["large"], [False]
    )
    outcomes = outcomes_of(
        [write_case(tmp_path, case, how, SEED) for case in asked], tmp_path / "studies"
    )
    assert bad(outcomes, Grade.FALSE, Grade.MISSED, Grade.ALARM, Grade.BROKEN) == []


@pytest.mark.slow
@pytest.mark.skipif(
    not AVAILABLE, reason="JSBSim is not installed (pip install 'flightid[jsbsim]')"
)
def test_six_degrees_of_freedom(tmp_path: Path) -> None:
    """At least 85 % of the faults claimed (rough air aside), at most 1 % false claims, nothing but
    a phugoid where nothing was put in.
    """
    for aircraft in AIRCRAFT.values():
        fly_aircraft(
            tmp_path / "flights", aircraft, [FAULTS[name] for name in FIRST], SEED, Recording()
        )
    outcomes = outcomes_of(sorted((tmp_path / "flights").iterdir()), tmp_path / "studies")
    assert len(bad(outcomes, Grade.FALSE)) <= 0.01 * len(outcomes), bad(outcomes, Grade.FALSE)
    assert (
        bad(
            [outcome for outcome in outcomes if outcome.fault == "nothing"],
            Grade.ALARM,
            Grade.FALSE,
            Grade.BROKEN,
        )
        == []
    )
    faulty = [outcome for outcome in outcomes if outcome.fault not in ("nothing", "rough-air")]
    assert sum(outcome.graded.grade is Grade.RIGHT for outcome in faulty) >= 0.85 * len(faulty)
