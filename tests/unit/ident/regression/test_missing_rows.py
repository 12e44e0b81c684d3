"""Equation error where rows of a record are missing, or its samples uneven: the estimates are those
of the whole record.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ident.estimate import Outcome
from ident.regression.equation_error import run_equation_error
from sim.declaration import own_model
from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.record import Channel, Hold, Record

CASE = Path(__file__).parents[5] / "shared" / "cases" / "equation-error-missing-rows"
TRUE = {"L_u": 50.0, "L_p": -4.0}
STEP = 0.012  # s


@pytest.fixture(scope="module")
def system() -> System:
    model = own_model(
        name="roll",
        states={"p": "rad/s"},
        inputs={"u": "1"},
        outputs={"p": "rad/s"},
        parameters={"L_u": (60.0, "rad/s2"), "L_p": (-3.0, "1/s"), "L_0": (0.0, "rad/s2")},
        rates=lambda s, p: {"p": p.L_u * s.u + p.L_p * s.p + p.L_0},
        readings=lambda s, p: {"p": s.p},
        biases=(),
    )
    return compile_model(model)


def flown(seed: int, uneven: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, a held input and the exact answer with white noise, ``(600,)`` each."""
    rng = np.random.default_rng(seed)
    time = np.arange(600) * STEP
    if uneven:
        time = time + STEP * rng.uniform(-0.4, 0.4, 600) * (np.arange(600) > 0)
        # a step of four times the usual one, across which the input is held
        time[300:] += 3.0 * STEP
    u = 0.02 * np.repeat(rng.choice([-1.0, 0.0, 1.0], 20), 30)
    u[285:315] = u[285]
    p = np.zeros(600)
    for k, length in enumerate(np.diff(time)):
        carried = np.exp(TRUE["L_p"] * length)
        p[k + 1] = carried * p[k] - TRUE["L_u"] / TRUE["L_p"] * (1.0 - carried) * u[k]
    return time, u, p + 0.005 * rng.standard_normal(600)


def record(time: np.ndarray, u: np.ndarray, p: np.ndarray, kept: np.ndarray) -> Record:
    inputs = (Channel.of("u", "1", u[kept]),)
    return Record(time[kept], inputs, (Channel.of("p", "rad/s", p[kept]),), Hold.PREVIOUS, "roll")


def gap(first: int, last: int) -> np.ndarray:
    kept = np.ones(600, dtype=bool)
    kept[first:last] = False
    return kept


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("missing", [(299, 307), (310, 311), (100, 120)])
def test_missing_rows_change_nothing_beyond_the_noise(
    system: System, missing: tuple[int, int], seed: int
) -> None:
    flight = flown(seed)
    found = run_equation_error([record(*flight, gap(*missing))], system)
    whole = run_equation_error([record(*flight, gap(0, 0))], system)
    assert found.outcome is Outcome.CONVERGED
    sigma = np.sqrt(np.diag(found.covariance))[:2]
    assert np.all(np.abs(found.values[:2] - list(TRUE.values())) < 3.5 * sigma)
    assert np.all(np.abs(found.values[:2] - whole.values[:2]) < 2.0 * sigma)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_uneven_samples_serve(system: System, seed: int) -> None:
    found = run_equation_error([record(*flown(seed, uneven=True), gap(0, 0))], system)
    sigma = np.sqrt(np.diag(found.covariance))[:2]
    assert found.outcome is Outcome.CONVERGED
    assert np.all(np.abs(found.values[:2] - list(TRUE.values())) < 3.5 * sigma)


def test_a_record_without_gaps_is_read_from_sample_to_sample_as_before(system: System) -> None:
    """The nodes of the grid are then the samples themselves."""
    from sim.propagation import make_grid

    time = flown(1)[0]
    grid = make_grid(time, float(np.diff(time).max()))
    assert np.array_equal(grid.sample, np.arange(600))


def test_the_measured_case(system: System) -> None:
    if not CASE.is_dir():
        pytest.skip(f"the case is not here: {CASE}")
    table = np.genfromtxt(CASE / "roll.csv", delimiter=",", names=True)
    flight = (table["time"], table["u"], table["p"])
    found = run_equation_error([record(*flight, np.ones(len(table), dtype=bool))], system)
    sigma = np.sqrt(np.diag(found.covariance))[:2]
    assert np.all(np.abs(found.values[:2] - list(TRUE.values())) < 3.0 * sigma)
