"""Data with something that the identification side cannot know: it sees CSV files alone, in a
process of its own.
"""

from __future__ import annotations

import concurrent.futures
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.oracles import undeclared_flights as flights
from tests.oracles.undeclared_flights import SIGMA
from tests.undeclared.cases import CHEAP, DEAR, Answer, Case, diagnosed, write_case

NOISY = {"spikes and free play"}  # the held-out record holds spikes itself
FREE_SIMULATION_FAILS = {"rough air", "clean with heavy tails"}


def answer_of(case: Case, folder: Path) -> Answer:
    write_case(case, folder)
    return diagnosed(folder, "rigid", {name: SIGMA[name] for name in case.channels})


@pytest.fixture(scope="module")
def answers(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[dict[str, concurrent.futures.Future[Answer]]]:
    """The cheap cases, two at a time."""
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        yield {
            case.name: pool.submit(answer_of, case, tmp_path_factory.mktemp("case"))
            for case in CHEAP
        }


def judged(case: Case, answer: Answer) -> None:
    """Verdict, names, parameters, derivatives and held-out error against the truth."""
    assert answer.content["verdict"] in case.verdicts
    assert answer.claimed in case.names
    for name, true in case.parameters.items():
        value, std = answer.quantity(name)
        assert abs(value - true) < max(4.0 * std, 1e-3 * abs(true)), name
        assert abs(value - true) < 0.08 * abs(true), name
    if "unexplained" in case.verdicts:
        return
    after = answer.content["parameters"]["after"]
    z = np.array(
        [
            (after[name]["value"] - true) / after[name]["std"]
            for name, true in case.aircraft.derivatives.items()
        ]
    )
    assert np.max(np.abs(z)) < 4.5
    for name in ("CL_alpha", "Cm_alpha", "Cm_de"):
        assert abs(after[name]["value"] / case.aircraft.derivatives[name] - 1.0) < 0.05, name
    if case.name not in NOISY | FREE_SIMULATION_FAILS:
        assert max(answer.after.values()) < 1.15
    if case.names != (frozenset(),) and case.name not in FREE_SIMULATION_FAILS:
        assert max(answer.before[name] / answer.after[name] for name in answer.after) > 1.02


@pytest.mark.sampled
@pytest.mark.parametrize("case", CHEAP, ids=lambda case: case.name)
def test_hidden_effect_is_found_and_named(
    case: Case, answers: dict[str, concurrent.futures.Future[Answer]]
) -> None:
    judged(case, answers[case.name].result())


@pytest.mark.slow
@pytest.mark.parametrize("case", DEAR, ids=lambda case: case.name)
def test_hidden_effect_is_found_and_named_in_dearer_cases(case: Case, tmp_path: Path) -> None:
    judged(case, answer_of(case, tmp_path))


@pytest.mark.long
def test_body_that_loses_its_heat_shield(tmp_path: Path) -> None:
    rng, sigma = np.random.default_rng(3), {"altitude": 8.0}
    for stem, time, drop in (("train", 14.0, 0.0), ("validate", 11.0, -4000.0)):
        hidden = {"jump_time": time, "jump_factor": 1.3}
        flown = flights.fly_body(620.0, 30.0, 10.0, hidden, altitude=56000.0 + drop)
        flights.write_record(tmp_path / f"{stem}.csv", flights.measured(flown, rng, sigma))
    lines = [
        "air_density_reference = 1.225",
        "density_scale_height = 7160.0",
        "gravity = 9.79",
        "[derivatives]",
        "beta = 450.0",
    ]
    (tmp_path / "vehicle.toml").write_text("\n".join(lines))
    answer = diagnosed(tmp_path, "ballistic", sigma)
    assert answer.content["verdict"] in ("traced", "ambiguous")
    assert answer.claimed == {"drag-jump"}
    factor, std = answer.quantity("drag-jump.factor")
    assert abs(factor - 1.3) < 4.0 * std
    beta = answer.content["parameters"]["after"]["beta"]
    assert abs(beta["value"] - 620.0) < 4.0 * beta["std"]
    assert answer.after["altitude"] < 1.15 < answer.before["altitude"]
