"""What differences between records make of sigmas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.statistics.intervals import scatter_factors
from ident.tracing.between_records import scatter_between_records
from ident.tracing.loop import fit_declared, held_out_data
from sim.effects.disturbance.gusts import GustTurbulence
from sim.maneuvers import doublet, sequence, three_two_one_one
from sim.record import Record
from sim.truth.flight import fly, sample_times
from tests.bases import rigid_model
from tests.tracing_problem import problem_of

ROUGH = GustTurbulence()


def test_two_grown_sigmas_hold_the_mean_whatever_the_number_of_records() -> None:
    """Values that scatter twice as much as their sigmas say, with six derivatives and two to six
    records.
    """
    rng = np.random.default_rng(1)
    for count in (2, 3, 5):
        held, flights = 0, 600
        for _ in range(flights):
            sigma = rng.uniform(0.5, 2.0, (6, count))
            values = 2.0 * sigma * rng.standard_normal((6, count))
            weight = sigma**-2
            mean, std = (
                np.sum(weight * values, axis=1) / weight.sum(axis=1),
                weight.sum(axis=1) ** -0.5,
            )
            held += int(np.count_nonzero(np.abs(mean) < 2.0 * scatter_factors(values, sigma) * std))
        assert 0.93 < held / (6 * flights) < 0.985, (count, held / (6 * flights))


@pytest.mark.long
def test_one_derivative_borrows_from_none() -> None:
    """Ten times its sigma: two records hold as much as Student's t does for one degree of freedom,
    no less.
    """
    rng = np.random.default_rng(2)
    for count in (2, 3, 5):
        sigma = rng.uniform(0.5, 2.0, (4000, 1, count))
        values = 10.0 * sigma * rng.standard_normal(sigma.shape)
        weight = sigma**-2
        mean, std = np.sum(weight * values, axis=2) / weight.sum(axis=2), weight.sum(axis=2) ** -0.5
        held = np.mean(
            [
                abs(m[0]) < 2.0 * scatter_factors(v, s)[0] * d[0]
                for m, v, s, d in zip(mean, values, sigma, std, strict=True)
            ]
        )
        assert 0.94 < held < 0.97, (count, held)


def test_one_derivative_that_differs_does_not_take_the_others_with_it() -> None:
    sigma = np.ones((6, 5))
    values = np.tile([1.0, -1.0, 1.0, -1.0, 0.0], (6, 1))
    wild = values.copy()
    wild[0] *= 20.0
    calm, one = scatter_factors(values, sigma), scatter_factors(wild, sigma)
    assert one[0] > 8.0 and np.allclose(one[1:], calm[1:])


@given(st.integers(2, 6), st.integers(1, 8), st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6))
def test_growth_knows_no_unit_and_never_shrinks(
    count: int, rows: int, seed: int, unit: float
) -> None:
    rng = np.random.default_rng(seed)
    values, sigma = rng.standard_normal((rows, count)), rng.uniform(0.1, 1.0, (rows, count))
    factors = scatter_factors(values, sigma)
    assert np.all(factors >= 1.0) and np.all(np.isfinite(factors))
    assert np.allclose(scatter_factors(unit * values + 3.0 * unit, unit * sigma), factors)


def in_rough_air(seed: int, Cm_q: float) -> Record:
    """A flight in turbulence as the filter knows it, of an aircraft with this pitch damping."""
    model = (
        rigid_model()
        .with_effects(ROUGH)
        .with_values({"gust-turbulence.sigma": 0.5, "gust-turbulence.length": 250.0, "Cm_q": Cm_q})
    )
    maneuver = sequence(
        [three_two_one_one(0.06, 0.5), doublet(0.03, 1.0), doublet(0.06, 0.5)], 2.0, start=1.0
    )
    record, _ = fly(
        model, maneuver, sample_times(20.0, 50.0), np.random.default_rng((seed, 7)), step=0.02
    )
    return replace(record, name=f"flight {seed}")


@pytest.mark.long
@pytest.mark.parametrize(("apart", "low", "high"), [(0.0, 1.0, 1.8), (0.5, 3.0, 30.0)])
def test_records_differ_in_rough_air_as_their_derivatives_do(
    apart: float, low: float, high: float
) -> None:
    """Innovations of one record, white or not, do not tell that the pitch damping of the next one
    is another.
    """
    damping = float(rigid_model().parameters["Cm_q"].value)
    records = [
        in_rough_air(seed, damping * (1.0 + apart * side))
        for seed, side in ((1, -1.0), (2, 0.0), (3, 1.0))
    ]
    done = fit_declared(problem_of(records[:2], [ROUGH]))
    held = held_out_data(done, records[2:])
    fitted = done.problem.fit((ROUGH,), done.fitted)
    assert fitted is not None
    found = scatter_between_records(done.problem, fitted, held)
    assert set(found.inflation) == {"CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"}
    assert low <= found.inflation["Cm_q"] <= high
    assert (
        found.scatter["Cm_q"] > 0.15 * abs(damping)
        if apart
        else found.scatter["Cm_q"] < 0.15 * abs(damping)
    )
