"""A designed maneuver decides between two effects in at least the share of flights that was
promised.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from ident.maneuver_design import (
    DECISIVE_LOG_LIKELIHOOD_RATIO,
    ODDS_COST,
    ActingEffect,
    parameter_cost,
)
from ident.tracing.fitted_model import FitData, FittedModel, Start, fit_set
from ident.whole_record.layout import FitSettings
from scenarios.maneuver_design.design import DesignResult, design
from scenarios.maneuver_design.setting import DesignRequest
from sim.declaration.model import Noise
from sim.record import Record
from sim.truth.flight import fly, remeasure
from tests.held_inputs import held_inputs

VEHICLE = """name = "fighter"
mass = 7500.0
wing_area = 30.0
chord = 2.4
pitch_inertia = 32000.0
airspeed = 130.0
air_density = 0.96
[derivatives]
CL_alpha = 5.2
CL_q = 7.0
CL_de = 0.4
Cm_alpha = -0.95
Cm_q = -17.0
Cm_de = -1.3
"""
FLIGHTS = 100
# Near-aliases by the library's own word, at sizes that a short maneuver finds and hardly tells.
ROUGH = ("alpha=0.0012", "q=0.0015")
# As the table in the guide was counted: by a flight computer, with actuators as fast as need be.
FAST = {"elevator_rate": 1e4}
PAIRS = {
    "vane ahead or slow": DesignRequest(
        "rigid",
        limits=FAST,
        computer=True,
        tell=("vane-offset", "sensor-lag:alpha"),
        size="arm=0.5",
    ),
    "vane ahead or late": DesignRequest(
        "rigid",
        limits=FAST,
        computer=True,
        tell=("vane-offset", "sensor-delay:alpha"),
        size="arm=0.4",
    ),
    "late or slow input": DesignRequest(
        "rigid",
        limits=FAST,
        computer=True,
        tell=("input-delay", "actuator-lag"),
        size="delay=0.01",
        noise=ROUGH,
    ),
    "stops or break-out": DesignRequest(
        "rigid",
        limits=FAST,
        computer=True,
        tell=("actuator-saturation", "input-deadband"),
        size="limit=0.0294",
        amplitude=("elevator=0.03",),
    ),
    "stops or curve": DesignRequest(
        "rigid",
        limits=FAST,
        computer=True,
        tell=("actuator-saturation", "control-nonlinearity"),
        size="limit=0.029",
        amplitude=("elevator=0.03",),
    ),
}
UNLIKELY = 1e-3  # of fewer decisions than were seen, if the promise holds


def flights(found: DesignResult, true: ActingEffect, count: int) -> list[Record]:
    """The best maneuver flown with an effect, by the truth generator, in finer steps, each with
    noise of its own.
    """
    setting = found.setting
    noise = Noise(dict(setting.noise))
    model = setting.model.with_effects(true.effect).with_values(true.full_values).with_noise(noise)
    record, truth = fly(
        model,
        held_inputs(found.best.flight.planned.record),
        setting.maneuver_limits.time,
        np.random.default_rng(0),
        step=0.002,
    )
    return [remeasure(record, truth, np.random.default_rng(seed)) for seed in range(count)]


def decides(record: Record, found: DesignResult, true: ActingEffect, rival: ActingEffect) -> bool:
    """Whether fits of both effects and of neither, as the loop makes them, find the true one and
    prefer it by enough.
    """
    outputs = tuple(found.setting.noise)
    data = FitData(
        (record,), (np.ones((len(outputs), len(record)), dtype=bool),), found.setting.model, outputs
    )

    def fitted(acting: ActingEffect | None) -> FittedModel:
        values = acting.full_values if acting is not None else {}
        effects = (acting.effect,) if acting is not None else ()
        fit = fit_set(data, effects, FitSettings(), Start(added=values))
        assert fit is not None
        return fit

    def weighed(acting: ActingEffect | None) -> float:
        fit = fitted(acting).fit
        return 2.0 * fit.cost + (
            parameter_cost(acting.effect, fit.counts) if acting is not None else 0.0
        )

    mine, other, none = (weighed(each) for each in (true, rival, None))
    return none - mine >= ODDS_COST and other - mine >= DECISIVE_LOG_LIKELIHOOD_RATIO


@pytest.mark.slow
@pytest.mark.parametrize("pair", PAIRS)
def test_the_designed_maneuver_decides_in_the_promised_share(pair: str, tmp_path: Path) -> None:
    """Both ways: either effect flown a hundred times."""
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    found = design(replace(PAIRS[pair], vehicle=tmp_path / "vehicle.toml"))
    for contest in found.best.contests:
        rival = contest.rival
        count = sum(
            decides(record, found, contest.true, rival)
            for record in flights(found, contest.true, FLIGHTS)
        )
        told = (
            f"{found.best.kind} | {contest.decision.log_likelihood:.1f} | "
            f"{100 * contest.chance:.0f} | {100 * count / FLIGHTS:.0f}"
        )
        print(f"| {contest.true.effect.name} | {rival.effect.name} | {told} |")
        assert (
            binomtest(count, FLIGHTS, min(contest.chance, 1.0 - 1e-9), alternative="less").pvalue
            > UNLIKELY
        )
