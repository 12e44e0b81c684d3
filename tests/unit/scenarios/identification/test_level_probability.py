"""The probability of a level is one: of an aircraft exactly at a limit it is anything between
nothing and certainty, evenly.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import kstest

from ident.flying_qualities.levels import FlightPhase, mode_levels
from ident.flying_qualities.modes import lateral_modes
from scenarios.identification.identify import identify
from sim.declaration.compile import compile_model
from sim.declaration.model import Noise
from sim.truth.flight import fly, sample_times
from tests.whole_axes import DURATION, NOISE, RATE, TRUE, maneuvers, true_model, vehicle_file

LIMIT = 0.19  # damping ratio of level 1, class I, category A


@pytest.mark.slow
def test_at_a_limit_every_probability_is_as_likely() -> None:
    """Forty records of a Dutch roll with the damping that level 1 asks, identified from starts 10 %
    off.
    """
    declared = true_model("lateral")
    system = compile_model(declared)
    at = system.parameters.index("Cn_r")

    def above(yaw_damping: float) -> float:
        p = system.parameters.values()
        p[at] = yaw_damping
        return lateral_modes(system, p)["dutch_roll_damping"] - LIMIT

    true = declared.with_values(
        {"Cn_r": brentq(above, 2.0 * TRUE["lateral"]["Cn_r"], 0.0, xtol=1e-12)}
    )
    true = replace(true, noise=Noise(dict(NOISE["lateral"])))
    shares = []
    for seed in range(40):
        record, _ = fly(
            true,
            maneuvers("lateral"),
            sample_times(RATE, DURATION["lateral"]),
            np.random.default_rng(seed),
            step=0.01,
            name="lateral.csv",
        )
        found = identify(record, vehicle_file("lateral", 1.1), "output-error")
        assert found.modes is not None
        dutch_roll = next(
            level
            for level in mode_levels(found.modes, FlightPhase("I", "A", ()))
            if level.mode == "Dutch roll"
        )
        shares.append(dutch_roll.probabilities[0])
    # A true null falls below once in a thousand times.
    assert kstest(shares, "uniform").pvalue > 1e-3, np.sort(shares)
