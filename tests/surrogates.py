"""Short surrogate flights for tests: two records of 8 s, one aircraft, whatever levels are
wanted.
"""

from __future__ import annotations

import math
from typing import Any

from exam.surrogates.declaration import OPTIONAL, Causes, FlightLine, Hidden, Surrogate

DEGREE = math.pi / 180.0
NOISE = {
    "alpha": 0.001,
    "q": 0.001,
    "nz": 0.006,
    "theta": 0.001,
    "airspeed": 0.3,
    "dynamic_pressure": 40.0,
    "ax": 0.02,
}
EVERY = Causes(
    anti_alias=7.0,
    anti_alias_spread=0.04,
    anti_alias_odd=1.0,
    input_noise=0.0005,
    turbulence=0.2,
    speed_drift=0.02,
    gravity=1.0,
    trim_lift=1.0,
    downwash=0.3,
    elastic=0.02,
    moment_curvature=0.04,
    lift_curvature=0.03,
    mass_scatter=0.01,
    inertia_scatter=0.01,
    airspeed_scatter=0.005,
    density_scatter=0.003,
    trim_scatter=0.003,
    noise_std=NOISE,
)
CALM = Causes()
NOTHING = Hidden()


def short(causes: Causes = CALM, hidden: Hidden = NOTHING, **changes: Any) -> Surrogate:
    """A surrogate flight that flies in a few hundredths of a second; ``changes`` are those of its
    FlightLine.
    """
    line = {
        "vehicles": ("fighter",),
        "variation": 0.2,
        "records": (2, 2),
        "duration": 8.0,
        "rates": (25.0,),
        "maneuvers": ("3-2-1-1", "hand-flown"),
        "amplitude": (2.0 * DEGREE, 3.0 * DEGREE),
        "step": 0.01,
        "trim_alpha": (0.05, 0.05),
        "optional": 1.0,
    }
    return Surrogate("short", "short", "", FlightLine(**{**line, **changes}), causes, hidden)


ALL_CHANNELS = ("alpha", "q", "nz", *OPTIONAL)
