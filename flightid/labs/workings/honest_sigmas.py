"""Lab 6: many runs of one flight, and whether the sigmas that an estimator reports are those with
which it scatters.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from flightid.labs.workings.trying import repeated, tried

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scenarios.studies.campaign import CampaignRuns
    from scenarios.studies.study import StudyResult
    from sim.declaration.model import Model
    from sim.record import Record

SCENARIO = "rigid"
VARIANCE = 0.016  # noise variance of alpha, deg^2, and of q, (deg/s)^2, in the scenario
METHODS = {"extended Kalman filter": "ekf", "output error": "output-error"}
DENSITIES = (0.0, 0.003, 0.01, 0.03, 0.1)  # (deg/s)^2/s on pitch rate


def changes(
    believed: float = 1.0,
    acting: float = 0.0,
    told: float = 0.0,
    method: str = "extended Kalman filter",
) -> tuple[str, ...]:
    """Return changes of the scenario.

    Assumed over true sensor noise, true and assumed process noise on pitch rate ((deg/s)^2/s), and
    the estimator.
    """
    variance = VARIANCE * believed**2
    of_filter = {"ekf": f'{{q = "{told:g} (deg/s)^2/s"}}' if told else "{}"}.get(
        METHODS[method], "{}"
    )
    return (
        "flight.rate=50 Hz",
        "flight.step=0.01 s",
        f'flight.process_noise={{q = "{acting:g} (deg/s)^2/s"}}'
        if acting
        else "flight.process_noise={}",
        f"estimate.method={METHODS[method]}",
        f'estimate.noise_variance={{alpha = "{variance:g} deg^2", q = "{variance:g} (deg/s)^2"}}',
        f"estimate.process_noise={of_filter}",
    )


def campaign(asked: tuple[str, ...], runs: int = 50) -> CampaignRuns:
    """The flight ``runs`` times, from seed 1."""
    return repeated(SCENARIO, asked, runs, 1)


def study(asked: tuple[str, ...], seed: int = 1) -> StudyResult:
    """One of these flights, for its residual."""
    return tried(SCENARIO, asked, seed)


def errors(found: CampaignRuns) -> dict[str, np.ndarray]:
    """Errors of each parameter in its reported sigmas, ``(N,)``."""
    return {
        name: (found.values[i] - spread.reference) / found.std[i]
        for i, (name, spread) in enumerate(zip(found.names, found.spreads, strict=True))
    }


@cache
def bound() -> Mapping[str, float]:
    """Cramer-Rao bound of each derivative from the sensors' noise alone, by differences of whole
    noise-free flights: no estimator takes part.
    """
    from scenarios.studies.campaign_statistics import cramer_rao
    from scenarios.studies.catalogue import load_scenario
    from scenarios.studies.declaration import maneuvers_by_input
    from scenarios.studies.estimating import true_model
    from sim.declaration.model import Noise
    from sim.truth.flight import fly, sample_times

    scenario = load_scenario(SCENARIO, changes())
    flight, time = scenario.flight, sample_times(scenario.flight.rate, scenario.flight.duration)
    by_input = maneuvers_by_input(flight.maneuvers, {"elevator"}, "key flight")

    def again(model: Model) -> Record:
        record, _ = fly(
            model.with_noise(Noise()),
            by_input,
            time,
            np.random.default_rng(0),
            step=flight.step,
            outputs=list(flight.noise_std),
        )
        return record

    return cramer_rao(
        true_model(flight), again, flight.noise_std, tuple(scenario.estimations[0].start), {}
    )


def numbers(
    believed: float = 1.0,
    acting: float = 0.0,
    told: float = 0.0,
    method: str = "extended Kalman filter",
    runs: int = 50,
) -> dict[str, float]:
    """What the key expects of a campaign: shares in per cent, scatter over reported sigma and sizes
    of single derivatives.
    """
    found = campaign(changes(believed, acting, told, method), runs)
    of = {spread.name: spread for spread in found.spreads}
    return {
        "within 2 sigma": 100.0 * found.pooled.within_two,
        "scatter over sigma": found.pooled.scatter,
        "scatter over sigma of Cm_de": of["Cm_de"].scatter / of["Cm_de"].reported,
        "scatter of CL_q": of["CL_q"].scatter,
        "sigma of CL_q": of["CL_q"].reported,
        "sigma of Cm_alpha": of["Cm_alpha"].reported,
        "sigma over bound of Cm_alpha": of["Cm_alpha"].reported / bound()["Cm_alpha"],
        "Cm_de within 2 sigma": 100.0 * of["Cm_de"].within_two,
    }
