"""Filter error of a user's own model: white noise on the states whose rates have parameters, of a
size that the record tells.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.estimate import Outcome
from scenarios.identification.assessment import IdentificationResult
from scenarios.identification.identify import identify
from scenarios.identification.methods import forced
from sim.record import Channel, Record
from tests.bases import three_two_one_one
from tests.every_model import case_of

FORCING = 0.05  # rad/s/sqrt(s): of the roll acceleration that nobody recorded
SUB_STEPS = 20


def rolled_in_rough_air(seed: int) -> Record:
    """The roll of `case_of("own")` with white noise on its acceleration, by Euler and Maruyama in
    steps of 2 ms.
    """
    case, rng = case_of("own"), np.random.default_rng(seed)
    time = np.arange(501) / 25.0
    aileron = three_two_one_one(time, size=0.08)
    dt, state, rows = 1.0 / 25.0 / SUB_STEPS, np.zeros(2), []
    for held in aileron:
        rows.append(state + np.array([0.004, 0.003]) * rng.standard_normal(2))
        for _ in range(SUB_STEPS):
            kick = FORCING * np.sqrt(dt) * rng.standard_normal()
            state = (
                state
                + dt * np.array([case.true["L_p"] * state[0] + case.true["L_da"] * held, state[0]])
                + np.array([kick, 0.0])
            )
    p, phi = np.array(rows).T
    moved = tuple(
        type(channel).of(channel.name, channel.unit, aileron) for channel in case.record.inputs
    )
    return Record(
        time,
        moved,
        (Channel.of("p", "rad/s", p), Channel.of("phi", "rad", phi)),
        case.record.hold,
        "rough.csv",
    )


def identified(seed: int, method: str) -> IdentificationResult:
    case = case_of("own")
    return identify(rolled_in_rough_air(seed), case.vehicle, method)


def off(found: IdentificationResult) -> list[float]:
    return [
        (found.estimate.value(name) - true) / found.estimate.sigma(name)
        for name, true in case_of("own").true.items()
    ]


def test_the_states_with_parameters_in_their_rates_are_forced() -> None:
    case = case_of("own")
    assert case.vehicle.own is not None
    density = forced(case.vehicle.own, [case.record]).noise.process_density
    assert set(density) == {"p"}, (
        "the bank angle's rate is the roll rate, whatever the parameters are"
    )
    time, p = case.record.time, case.record["p"].values
    ahead = np.searchsorted(time, time + 1.0 - 1e-9)
    change = p[ahead[ahead < len(time)]] - p[: np.count_nonzero(ahead < len(time))]
    assert density["p"] == pytest.approx((0.1 * np.std(change)) ** 2, rel=1e-6)


def test_parameters_and_the_size_of_the_forcing_are_found() -> None:
    found = identified(3, "filter-error")
    assert found.estimate.outcome is Outcome.CONVERGED and np.max(np.abs(off(found))) < 4.0
    begun = forced(case_of("own").vehicle.own, [found.record]).noise.process_density["p"]  # type: ignore[arg-type]
    assert found.estimate.value("process_noise_scale") * np.sqrt(begun) == pytest.approx(
        FORCING, rel=0.3
    )


@pytest.mark.slow
def test_sigmas_hold_where_those_of_output_error_do_not() -> None:
    by_filter, by_simulation = (
        [off(identified(seed, method)) for seed in range(30)]
        for method in ("filter-error", "output-error")
    )
    # 60 errors: standard deviation of a sample's within .18 of one at two sigmas.
    assert np.std(by_filter) < 1.2 < np.std(by_simulation)
