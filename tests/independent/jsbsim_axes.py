"""A flight of JSBSim with elevator, aileron and rudder, all six degrees of freedom read as
instruments at the centre of gravity would show them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tests.independent.jsbsim_aircraft import Aircraft, Condition
from tests.independent.jsbsim_flight import FINE, FOOT, POUND, SLUG, trimmed

READ = {
    **{
        "aero/alpha-rad": "alpha",
        "aero/beta-rad": "beta",
        "velocities/vt-fps": "airspeed",
        "position/h-sl-ft": "height",
    },
    **{"velocities/p-rad_sec": "p", "velocities/q-rad_sec": "q", "velocities/r-rad_sec": "r"},
    **{"attitude/phi-rad": "phi", "attitude/theta-rad": "theta", "attitude/psi-rad": "psi"},
    **{
        "forces/fbx-total-lbs": "ax",
        "forces/fby-total-lbs": "ay",
        "forces/fbz-total-lbs": "az",
        "inertia/mass-slugs": "mass",
    },
}
FACTORS = {"airspeed": FOOT, "height": FOOT, "mass": SLUG} | dict.fromkeys(
    ("ax", "ay", "az"), POUND
)
# s, and parts of full command: pulses one after the other on each control.
PULSES: Mapping[str, tuple[tuple[float, float, float], ...]] = {
    "elevator": ((1.0, 2.0, 1.0), (2.0, 3.0, -1.0), (11.0, 12.0, -0.7), (12.0, 13.0, 0.7)),
    "aileron": (
        (4.0, 5.0, 1.0),
        (5.0, 7.0, -1.0),
        (7.0, 8.0, 1.0),
        (15.0, 16.0, 0.8),
        (17.5, 18.5, -0.8),
    ),
    "rudder": ((8.5, 9.5, 1.0), (9.5, 10.5, -1.0), (13.5, 14.5, -0.8), (14.5, 15.5, 0.8)),
}


def fly_axes(
    aircraft: Aircraft, condition: Condition, sizes: Mapping[str, float], duration: float = 20.0
) -> dict[str, np.ndarray]:
    """The true motion every 1/``FINE`` s: angles rad, rates rad/s, specific forces m/s2 along body
    axes, airspeed m/s, height m.
    """
    machine = trimmed(aircraft, condition)
    neutral = {name: machine[f"fcs/{name}-cmd-norm"] for name in PULSES}
    seen = np.empty((len(READ), round(duration * FINE) + 1))
    for k in range(seen.shape[1]):
        t = k / FINE
        for name, pulses in PULSES.items():
            asked = sum(size for start, stop, size in pulses if start <= t < stop)
            machine[f"fcs/{name}-cmd-norm"] = neutral[name] + sizes[name] * asked
        machine.run()
        seen[:, k] = [machine[name] for name in READ]
    out = {
        name: FACTORS.get(name, 1.0) * row for name, row in zip(READ.values(), seen, strict=True)
    }
    mass = out.pop("mass")
    return out | {name: out[name] / mass for name in ("ax", "ay", "az")}
