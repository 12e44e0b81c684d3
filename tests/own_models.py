"""Models of users, declared by functions and as files: a roll, a mass on a spring, and the rigid
short period written a second time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sim.declaration import own_model
from sim.declaration.model import Model
from sim.maths import G0
from tests.bases import RIGID_VALUES

ROLL = '''"""Roll of an aircraft: p_dot = L_p p + L_da aileron, phi_dot = p."""

from sim.declaration import own_model

MODEL = own_model(
    name="roll",
    states={"p": "rad/s", "phi": "rad"},
    inputs={"aileron": "rad"},
    outputs={"p": "rad/s", "phi": "rad"},
    constants={"airspeed": (60.0, "m/s")},
    parameters={"L_p": (-2.0, "1/s"), "L_da": (8.0, "1/s2")},
    rates=lambda s, p: {"p": p.L_p * s.p + p.L_da * s.aileron, "phi": s.p},
    readings=lambda s, p: {"p": s.p, "phi": s.phi},
)
'''
SPRING = '''"""A mass on a spring with a damper, pushed by a force."""

from sim.declaration import own_model

MODEL = own_model(
    name="spring-mass",
    states={"x": "m", "v": "m/s"},
    inputs={"force": "N"},
    outputs={"x": "m", "acceleration": "m/s2"},
    constants={"m": (2.0, "kg")},
    parameters={"k": (50.0, "N/m"), "c": (1.0, "N s/m")},
    flow=lambda s, p: {"a": (s.force - p.c * s.v - p.k * s.x) / p.m},
    rates=lambda s, p: {"x": s.v, "v": s.a},
    readings=lambda s, p: {"x": s.x, "acceleration": s.a},
)
'''
ROLL_AND_YAW = '''"""Roll, yaw and sideslip in dimensional derivatives."""

from sim.declaration import own_model

MODEL = own_model(
    name="roll and yaw",
    states={"p": "rad/s", "r": "rad/s", "beta": "rad", "phi": "rad"},
    inputs={"aileron": "rad", "rudder": "rad"},
    outputs={"p": "rad/s", "r": "rad/s", "beta": "rad", "phi": "rad"},
    constants={"g_V": (0.1, "1/s")},
    parameters={
        "L_p": (-2.0, "1/s"),
        "L_beta": (-8.0, "1/s2"),
        "L_da": (10.0, "1/s2"),
        "N_r": (-0.4, "1/s"),
        "N_beta": (3.0, "1/s2"),
        "N_dr": (-2.0, "1/s2"),
        "Y": (-0.15, "1/s"),
    },
    rates=lambda s, p: {
        "p": p.L_p * s.p + p.L_beta * s.beta + p.L_da * s.aileron,
        "r": p.N_r * s.r + p.N_beta * s.beta + p.N_dr * s.rudder,
        "beta": p.Y * s.beta - s.r + p.g_V * s.phi,
        "phi": s.p,
    },
    readings=lambda s, p: {"p": s.p, "r": s.r, "beta": s.beta, "phi": s.phi},
)
'''
SHORT_PERIOD = '''"""The rigid short period as a user would write it, with the ports of the built-in one."""

from sim.declaration import own_model
from sim.maths import G0


def flow(s, p):
    V = p.airspeed + s.airspeed_change
    pressure_area = 0.5 * (p.air_density + s.density_change) * V * V * p.wing_area
    alpha_air, q_hat = s.alpha + s.gust, s.q * p.chord / (2.0 * V)
    return {"V": V, "alpha_air": alpha_air, "q_hat": q_hat, "pressure_area": pressure_area}


def CL(s, p):
    return p.CL_alpha * s.alpha_air + p.CL_q * s.q_hat + p.CL_de * s.elevator + s.lift


def rates(s, p):
    Cm = p.Cm_alpha * s.alpha_air + p.Cm_q * s.q_hat + p.Cm_de * s.elevator + s.moment
    return {
        "alpha": s.q - s.pressure_area * CL(s, p) / (p.mass * s.V),
        "q": s.pressure_area * p.chord * Cm / p.pitch_inertia,
    }


def readings(s, p):
    return {"alpha": s.alpha_air, "q": s.q, "nz": s.pressure_area * CL(s, p) / (p.mass * G0)}


MODEL = own_model(
    name="short period",
    states={"alpha": "rad", "q": "rad/s"},
    inputs={"elevator": "rad"},
    outputs={"alpha": "rad", "q": "rad/s", "nz": "g"},
    ports={"gust": "rad", "airspeed_change": "m/s", "density_change": "kg/m3", "lift": "1", "moment": "1"},
    constants={
        "mass": (1.0, "kg"),
        "wing_area": (1.0, "m2"),
        "chord": (1.0, "m"),
        "pitch_inertia": (1.0, "kg m2"),
        "airspeed": (100.0, "m/s"),
        "air_density": (1.0, "kg/m3"),
    },
    parameters={
        "CL_alpha": (5.0, "1/rad"),
        "CL_q": (5.0, "1/rad"),
        "CL_de": (0.4, "1/rad"),
        "Cm_alpha": (-1.0, "1/rad"),
        "Cm_q": (-10.0, "1/rad"),
        "Cm_de": (-1.0, "1/rad"),
    },
    flow=flow,
    rates=rates,
    readings=readings,
)
'''  # noqa: E501
ROLL_DECLARED: dict[str, Any] = {
    "name": "roll",
    "states": {"p": "rad/s", "phi": "rad"},
    "inputs": {"aileron": "rad"},
    "outputs": {"p": "rad/s", "phi": "rad"},
    "constants": {"airspeed": (60.0, "m/s")},
    "parameters": {"L_p": (-2.0, "1/s"), "L_da": (8.0, "1/s2")},
    "rates": lambda s, p: {"p": p.L_p * s.p + p.L_da * s.aileron, "phi": s.p},
    "readings": lambda s, p: {"p": s.p, "phi": s.phi},
}


def spring_mass(**ports: Any) -> Model:
    """2 kg on a spring of 40 N/m with a damper; the force of a port ``load`` acts before the
    acceleration is formed, as a user would write it.
    """
    load = (lambda s: s.load) if ports else (lambda s: 0.0)
    return own_model(
        name="spring-mass",
        states={"x": "m", "v": "m/s"},
        inputs={"force": "N"},
        outputs={"x": "m", "acceleration": "m/s2"},
        constants={"m": (2.0, "kg")},
        parameters={"k": (40.0, "N/m"), "c": (1.3, "N s/m")},
        flow=lambda s, p: {"a": (s.force + load(s) - p.c * s.v - p.k * s.x) / p.m},
        rates=lambda s, p: {"x": s.v, "v": s.a},
        readings=lambda s, p: {"x": s.x, "acceleration": s.a},
        **ports,
    )


def roll(**changes: Any) -> Model:
    """The roll of an aircraft with some arguments of its declaration changed."""
    return own_model(**{**ROLL_DECLARED, **changes})


def own_rigid(values: dict[str, float]) -> Model:
    """The rigid short period as a user would write it, at these values; the airframe's numbers are
    those of ``RIGID_VALUES``.
    """
    derivatives = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")

    def flow(s: Any, p: Any) -> dict[str, Any]:
        q_hat, force = (
            s.q * p.chord / (2.0 * p.airspeed),
            0.5 * p.air_density * p.airspeed * p.airspeed * p.wing_area,
        )
        return {
            "L": force * (p.CL_alpha * s.alpha + p.CL_q * q_hat + p.CL_de * s.elevator),
            "M": force * p.chord * (p.Cm_alpha * s.alpha + p.Cm_q * q_hat + p.Cm_de * s.elevator),
        }

    return own_model(
        name="short period",
        states={"alpha": "rad", "q": "rad/s"},
        inputs={"elevator": "rad"},
        outputs={"alpha": "rad", "q": "rad/s", "nz": "g"},
        constants={
            name: (value, "1") for name, value in RIGID_VALUES.items() if name not in derivatives
        },
        parameters={name: (values[name], "1/rad") for name in derivatives},
        flow=flow,
        rates=lambda s, p: {"alpha": s.q - s.L / (p.mass * p.airspeed), "q": s.M / p.pitch_inertia},
        readings=lambda s, p: {"alpha": s.alpha, "q": s.q, "nz": s.L / (p.mass * G0)},
    )


def model_file(folder: Path, text: str, name: str = "my_model.py") -> Path:
    """A model file with this text."""
    path = folder / name
    path.write_text(text)
    return path
