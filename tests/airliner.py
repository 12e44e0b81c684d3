"""A generic twin-jet airliner, trimmed in level flight: numbers of its size, of no aircraft."""

from __future__ import annotations

from sim.aerodynamics import FLOW, parse_term
from sim.vehicles.aircraft import DEFAULTS, Aircraft

SURFACES = {"elevator": "rad", "aileron": "rad", "rudder": "rad"}
COEFFICIENTS = {
    "CD": {"1": 0.025, "alpha": 0.1, "alpha^2": 1.2},
    "CY": {"beta": -0.9, "rudder": 0.2},
    "CL": {"1": 0.3, "alpha": 5.2, "q": 6.0, "elevator": 0.4},
    "Cl": {"beta": -0.1, "p": -0.5, "r": 0.15, "aileron": -0.13, "rudder": 0.02},
    "Cm": {"1": 0.05, "alpha": -1.0, "q": -20.0, "elevator": -1.3},
    "Cn": {"beta": 0.13, "p": -0.05, "r": -0.2, "aileron": 0.004, "rudder": -0.11},
}
ALPHA, ELEVATOR, THRUST = 0.024755289, 0.019419023, 11140.63  # of level flight at 130 m/s
CONSTANTS = {
    **DEFAULTS,
    "mass": 17600.0,
    "wing_area": 64.0,
    "chord": 3.159,
    "span": 21.5,
    "roll_inertia": 150e3,
    "pitch_inertia": 330e3,
    "yaw_inertia": 450e3,
    "cross_inertia": 20e3,
    "air_density": 0.73,
    "speed_of_sound": 320.0,
}
AIRLINER = Aircraft(
    "airliner",
    CONSTANTS,
    SURFACES,
    {
        axis: {parse_term(text, (*FLOW, *SURFACES)): value for text, value in terms.items()}
        for axis, terms in COEFFICIENTS.items()
    },
    sensors={"alpha": (6.0, 0.0, 0.0), "beta": (6.0, 0.0, 0.0), "accelerometer": (0.5, 0.0, 0.2)},
    start={"airspeed": 130.0, "alpha": ALPHA, "theta": ALPHA},
)
