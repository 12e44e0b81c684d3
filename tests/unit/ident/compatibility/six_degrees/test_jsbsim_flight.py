"""The check of the kinematics on a flight that JSBSim flew with elevator, aileron and rudder: round
turning earth, its own equations.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest

from ident.compatibility.check import compatibility
from ident.compatibility.trials import CompatibilitySettings
from sim.record import Channel, Record
from tests.independent.jsbsim_aircraft import AIRCRAFT
from tests.independent.jsbsim_axes import fly_axes
from tests.independent.jsbsim_flight import AVAILABLE, FINE
from tests.oracles.six_degrees import NOISE, UNITS, WHOLE

pytestmark = pytest.mark.skipif(
    not AVAILABLE, reason="JSBSim is not installed (pip install 'flightid[jsbsim]')"
)


@cache
def flown() -> Mapping[str, np.ndarray]:
    fighter = AIRCRAFT["F4N"]
    return fly_axes(
        fighter, fighter.conditions[0], {"elevator": 0.1, "aileron": 0.1, "rudder": 0.2}
    )


def recorded(
    seed: int, late: Mapping[str, float], scaled: Mapping[str, float], biased: Mapping[str, float]
) -> Record:
    """20 s at 25 samples a second with white noise."""
    rng, time, outputs = np.random.default_rng(seed), np.arange(501) / 25.0, []
    fine = np.arange(len(flown()["q"])) / FINE
    for name in WHOLE:
        y = np.unwrap(flown()[name]) if name in ("phi", "psi") else flown()[name]
        y = scaled.get(name, 1.0) * np.interp(time - late.get(name, 0.0), fine, y) + biased.get(
            name, 0.0
        )
        outputs.append(
            Channel.of(name, UNITS[name], y + NOISE[name] * rng.standard_normal(len(time)))
        )
    return Record(time, (), tuple(outputs), name=f"flight {seed}")


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("late", "scaled", "biased", "named"),
    [
        ({}, {}, {}, {}),
        (
            {"r": 0.06},
            {"beta": 1.15},
            {"p": 0.01},
            {"sensor-delay:r": 0.06, "sensor-scale:beta": 1.15, "bias:p": 0.01},
        ),
    ],
)
def test_sound_sensors_raise_nothing_and_faults_are_named(
    late: Mapping[str, float],
    scaled: Mapping[str, float],
    biased: Mapping[str, float],
    named: Mapping[str, float],
) -> None:
    found = compatibility([recorded(2, late, scaled, biased)], CompatibilitySettings())
    standing = [finding for finding in found.findings if finding.supported]
    assert {name for finding in standing for name in (finding.name, *finding.group)} >= set(named)
    for finding in standing:
        assert {finding.name, *finding.group} & set(named), f"{finding.name} is not there"
    sizes = {item.name: item.smoother for item in (*found.joint.estimates, *found.joint.biases)}
    for name, true in named.items():
        assert abs(sizes[name].value - true) < 3.0 * sizes[name].std
