"""Lab 1: beta of a falling body from radar altitude, by a Kalman filter whose start is moved."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flightid.labs.workings import MAIN_METHOD_ONLY, row_of, scenario_campaign, scenario_study

if TYPE_CHECKING:
    from ident.estimate import FilterHistory
    from scenarios.studies.campaign import CampaignRuns
    from scenarios.studies.study import StudyResult

SCENARIO = "ballistic"
FOOT, POUND_PER_SQUARE_FOOT = 0.3048, 4.88242764  # m; kg/m2


def changes(
    start: float = 800.0, spread: float = 300.0, passes: int = 1, noise: float = 25.0
) -> tuple[str, ...]:
    """Return the changes of the scenario.

    They are start of beta and its standard deviation (lb/ft2), number of passes of the filter, and
    noise of the radar (ft).
    """
    return (
        MAIN_METHOD_ONLY,
        f"flight.noise_std.altitude={noise:g} ft",
        f"estimate.start.beta.value={start:g} lb/ft2",
        f"estimate.start.beta.std={spread:g} lb/ft2",
        f"estimate.passes={passes:d}",
    )


def study(changed: tuple[str, ...], seed: int = 1) -> StudyResult:
    """Return the study of one fall."""
    return scenario_study(SCENARIO, changed, seed)


def campaign(changed: tuple[str, ...], runs: int = 200) -> CampaignRuns:
    """Return a campaign of the fall: ``runs`` runs from seed 1."""
    return scenario_campaign(SCENARIO, changed, runs, 1)


def history_of(found: StudyResult) -> FilterHistory:
    """Return the history of the filter."""
    history = found.main.result.estimate.history
    assert history is not None
    return history


def awakening(found: StudyResult) -> tuple[float, float]:
    """Return time (s) and true altitude (m) at which the filter has halved its initial sigma."""
    history = history_of(found)
    std = history.std[history.names.index("beta")]
    at = int(np.argmax(std < 0.5 * std[0]))
    time = float(history.time[at])
    return time, float(np.interp(time, found.record.time, found.record["altitude"].values))


def key_numbers(
    start: float = 800.0,
    spread: float = 300.0,
    passes: int = 1,
    noise: float = 25.0,
    seed: int = 1,
    runs: int = 200,
) -> dict[str, float]:
    """Return the numbers of the key, from one fall and from a campaign.

    Beta is in lb/ft2, altitude in km, coverage in percent.
    """
    changed = changes(start, spread, passes, noise)
    fall, pooled = study(changed, seed), campaign(changed, runs).pooled
    row, (time, altitude) = row_of(fall.main, "beta"), awakening(fall)
    return {
        "estimate": row.estimate / POUND_PER_SQUARE_FOOT,
        "sigma": row.std / POUND_PER_SQUARE_FOOT,
        "awakes at": time,
        "altitude then": altitude / 1000.0,
        "bias": pooled.bias,
        "scatter": pooled.scatter,
        "within 2 sigma": 100.0 * pooled.within_two,
    }


def passes_needed(start: float, spread: float) -> int:
    """Return the fewest passes, at most 5, with which the 2-sigma coverage of 200 falls reaches
    90 percent; 5 if no number of passes does.
    """
    shares = {n: campaign(changes(start, spread, n)).pooled.within_two for n in range(1, 6)}
    return next((passes for passes, found in shares.items() if found >= 0.9), 5)


def worse_prior() -> str:
    """Return which of two priors about 800 lb/ft2 causes the larger bias of one pass, in sigmas.

    The words are those of the question.
    """
    biases = {
        f"{word} one: 800 ± {spread:g}": abs(campaign(changes(spread=spread)).pooled.bias)
        for word, spread in (("a wide", 300.0), ("a narrow", 30.0))
    }
    return max(biases, key=lambda words: biases[words])
