"""Lab 1: beta of a falling body from radar altitude, by a Kalman filter whose start is moved."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flightid.labs.workings.trying import ALONE, repeated, row_of, tried

if TYPE_CHECKING:
    from ident.estimate import FilterHistory
    from scenarios.studies.campaign import CampaignRuns
    from scenarios.studies.study import StudyResult

SCENARIO = "ballistic"
FOOT, POUND_PER_SQUARE_FOOT = 0.3048, 4.88242764  # m; kg/m2


def changes(
    start: float = 800.0, spread: float = 300.0, passes: int = 1, noise: float = 25.0
) -> tuple[str, ...]:
    """Changes of the scenario: start of beta and its standard deviation (lb/ft2), passes of the
    filter, noise of the radar (ft).
    """
    return (
        ALONE,
        f"flight.noise_std.altitude={noise:g} ft",
        f"estimate.start.beta.value={start:g} lb/ft2",
        f"estimate.start.beta.std={spread:g} lb/ft2",
        f"estimate.passes={passes:d}",
    )


def study(asked: tuple[str, ...], seed: int = 1) -> StudyResult:
    """One fall, estimated."""
    return tried(SCENARIO, asked, seed)


def campaign(asked: tuple[str, ...], runs: int = 200) -> CampaignRuns:
    """The same fall measured again and again, ``runs`` times from seed 1."""
    return repeated(SCENARIO, asked, runs, 1)


def history_of(found: StudyResult) -> FilterHistory:
    """The filter's course over time."""
    history = found.main.result.estimate.history
    assert history is not None
    return history


def awakening(found: StudyResult) -> tuple[float, float]:
    """Time (s) and true altitude (m) at which the filter has halved the sigma that it began
    with.
    """
    history = history_of(found)
    std = history.std[history.names.index("beta")]
    at = int(np.argmax(std < 0.5 * std[0]))
    time = float(history.time[at])
    return time, float(np.interp(time, found.record.time, found.record["altitude"].values))


def numbers(
    start: float = 800.0,
    spread: float = 300.0,
    passes: int = 1,
    noise: float = 25.0,
    seed: int = 1,
    runs: int = 200,
) -> dict[str, float]:
    """What the key expects: of one fall and of ``runs``; beta in lb/ft2, altitude in km, shares in
    per cent.
    """
    asked = changes(start, spread, passes, noise)
    one, many = study(asked, seed), campaign(asked, runs)
    row, (time, altitude) = row_of(one.main, "beta"), awakening(one)
    return {
        "estimate": row.estimate / POUND_PER_SQUARE_FOOT,
        "sigma": row.std / POUND_PER_SQUARE_FOOT,
        "awakes at": time,
        "altitude then": altitude / 1000.0,
        "bias": many.pooled.bias,
        "scatter": many.pooled.scatter,
        "within 2 sigma": 100.0 * many.pooled.within_two,
    }


def passes_needed(start: float, spread: float, share: float = 0.9, most: int = 5) -> int:
    """The fewest passes with which that share of the 2-sigma intervals of 200 falls hold the truth;
    ``most`` where none do.
    """
    shares = {
        passes: campaign(changes(start, spread, passes)).pooled.within_two
        for passes in range(1, most + 1)
    }
    return next((passes for passes, found in shares.items() if found >= share), most)


def worse_prior() -> str:
    """Which of two priors about 800 lb/ft2 biases one pass more, in reported sigmas; words as the
    question has them.
    """
    found = {
        f"{word} one: 800 ± {spread:g}": abs(campaign(changes(spread=spread)).pooled.bias)
        for word, spread in (("a wide", 300.0), ("a narrow", 30.0))
    }
    return max(found, key=lambda words: found[words])
