"""Lab 6: many runs of one flight: scatter of the estimates against their reported sigmas."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from flightid.labs.workings import scenario_campaign, scenario_study

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
    """Return the changes of the scenario.

    Parameters
    ----------
    believed : assumed over true standard deviation of the sensor noise.
    acting, told : true and assumed process noise of pitch rate, (deg/s)^2/s.
    method : a key of ``METHODS``.
    """
    variance = VARIANCE * believed**2
    is_filter = METHODS[method] == "ekf"
    assumed = f'{{q = "{told:g} (deg/s)^2/s"}}' if told and is_filter else "{}"
    return (
        "flight.rate=50 Hz",
        "flight.step=0.01 s",
        f'flight.process_noise={{q = "{acting:g} (deg/s)^2/s"}}'
        if acting
        else "flight.process_noise={}",
        f"estimate.method={METHODS[method]}",
        f'estimate.noise_variance={{alpha = "{variance:g} deg^2", q = "{variance:g} (deg/s)^2"}}',
        f"estimate.process_noise={assumed}",
    )


def campaign(changed: tuple[str, ...], runs: int = 50) -> CampaignRuns:
    """Return a campaign of ``runs`` runs from seed 1."""
    return scenario_campaign(SCENARIO, changed, runs, 1)


def study(changed: tuple[str, ...], seed: int = 1) -> StudyResult:
    """Return the study of one flight, for its residual."""
    return scenario_study(SCENARIO, changed, seed)


def errors(found: CampaignRuns) -> dict[str, np.ndarray]:
    """Return the errors of each parameter in reported sigmas, ``(N,)``."""
    return {
        name: (found.values[i] - spread.reference) / found.std[i]
        for i, (name, spread) in enumerate(zip(found.names, found.spreads, strict=True))
    }


@cache
def bound() -> Mapping[str, float]:
    """Return the Cramer-Rao bound of each derivative for the sensor noise.

    It is computed by differences of noise-free flights, without an estimator.
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

    def simulated(model: Model) -> Record:
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
        true_model(flight), simulated, flight.noise_std, tuple(scenario.estimations[0].start), {}
    )


def key_numbers(
    believed: float = 1.0,
    acting: float = 0.0,
    told: float = 0.0,
    method: str = "extended Kalman filter",
    runs: int = 50,
) -> dict[str, float]:
    """Return the numbers of the key from a campaign; coverage in percent."""
    found = campaign(changes(believed, acting, told, method), runs)
    spreads = {spread.name: spread for spread in found.spreads}
    return {
        "within 2 sigma": 100.0 * found.pooled.within_two,
        "scatter over sigma": found.pooled.scatter,
        "scatter over sigma of Cm_de": spreads["Cm_de"].scatter / spreads["Cm_de"].reported,
        "scatter of CL_q": spreads["CL_q"].scatter,
        "sigma of CL_q": spreads["CL_q"].reported,
        "sigma of Cm_alpha": spreads["Cm_alpha"].reported,
        "sigma over bound of Cm_alpha": spreads["Cm_alpha"].reported / bound()["Cm_alpha"],
        "Cm_de within 2 sigma": 100.0 * spreads["Cm_de"].within_two,
    }
