"""What a watch prints holds the truth as often as its deviations say, wherever within its prior it
starts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from ident.flying_qualities.levels import qualities
from scenarios.files.vehicles import VehicleFile
from scenarios.watching.session import STARTED, Session, take
from scenarios.watching.study import SoFar, first_pass_so_far, likely_estimate, so_far
from tests import loes_problem as problem
from tests.bases import LOES_CONSTANTS, LOES_VALUES

STREAMS = 40
# Fewer two-sigma intervals than this hold the truth once in a thousand times where 95.4 % should,
# all quantities of a stream counted as one.
FEWEST = float(binom.ppf(1e-3, STREAMS, 0.9545)) / STREAMS


def flown(seed: int) -> tuple[Session, dict[str, float]]:
    """A stream of ten seconds that was started off by a quarter, as its prior says, and the
    truth.
    """
    rng = np.random.default_rng(1000 + seed)
    delay = float(rng.uniform(0.02, 0.18))
    truth = {**LOES_VALUES, **dict.fromkeys(("L_0", "M_0", "delta_0", "nz_0"), 0.0), "delay": delay}
    start = {
        name: value * (1.0 + 0.25 * np.clip(rng.standard_normal(), -3.0, 3.0))
        for name, value in LOES_VALUES.items()
    }
    vehicle = VehicleFile("drawn", "loes", LOES_CONSTANTS, start | {"L_q": 1.0, "delay": 0.05})
    record = problem.record(seed, duration=10.0, rate=40.0, delay=delay)
    session = Session(vehicle, "stream", "in", refine=True)
    table = np.vstack([record.time, *(channel.with_gaps() for channel in record.channels)])
    for first in range(0, table.shape[1], 40):
        take(session, table[:, first : first + 40])
    return session, truth


def sigmas(found: SoFar, truth: dict[str, float]) -> dict[str, float]:
    """Errors in deviations of what is printed as a number."""
    told = {
        name: (found.estimate.value(name), found.estimate.sigma(name))
        for name in found.estimate.names
    } | dict(found.derived)
    exact = replace(found.estimate, values=np.array([truth[name] for name in found.estimate.names]))
    derived = qualities(
        exact, LOES_CONSTANTS["airspeed"], LOES_CONSTANTS["gravity"], {"delay": truth["delay"]}
    )
    known = truth | {each.name: each.value for each in derived}
    return {
        name: (value - known[name]) / std
        for name, (value, std) in told.items()
        if name not in found.hanging
    }


@pytest.mark.slow
def test_two_sigmas_hold_the_truth_whatever_the_start() -> None:
    errors: dict[str, list[float]] = {"alone": [], "plain": [], "refined": []}
    refused = 0
    for seed in range(STREAMS):
        session, truth = flown(seed)
        assert session.bank is not None and session.state is not None
        alone, plain, refined = (
            likely_estimate(session.bank, session.state)[0],
            first_pass_so_far(session),
            so_far(session),
        )
        assert refined.refined and not refined.hanging
        errors["alone"] += [
            abs(alone.value(name) - truth[name]) / alone.sigma(name) for name in alone.names
        ]
        errors["plain"] += [abs(each) for each in sigmas(plain, truth).values()]
        errors["refined"] += [abs(each) for each in sigmas(refined, truth).values()]
        refused += len([name for name in plain.hanging if name in STARTED])
    share = {name: float(np.mean(np.array(each) < 2.0)) for name, each in errors.items()}
    print(
        share,
        {name: max(each) for name, each in errors.items()},
        refused / (STREAMS * len(STARTED)),
    )
    # The filter's own deviations do not hold: without what other starts led to they miss one time
    # in three.
    assert share["alone"] < 0.85
    assert min(share["plain"], share["refined"]) >= FEWEST
    assert max(errors["plain"]) < 5.0 and max(errors["refined"]) < 5.0
    assert refused < 0.1 * STREAMS * len(STARTED)
