"""What differs between surrogate flights of the two axes: the model that the loop is told,
channels, inputs, and the names in its vehicle file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from exam.surrogates.declaration import LATERAL, LONGITUDINAL, MEASURED, OPTIONAL
from sim.vehicles.factory import RIGID_CONSTANTS
from sim.vehicles.uncoupled import LATERAL_CONSTANTS, Lateral


@dataclass(frozen=True)
class Axis:
    """One axis.

    Attributes
    ----------
    model : that the loop is told. inputs : that move and are recorded. measured : outputs of every
    record; optional : further ones. constants : of the vehicle file. scattered : constants that
    differ from record to record, with the level of `Causes` that says how far.
    """

    model: str
    inputs: tuple[str, ...]
    measured: tuple[str, ...]
    optional: tuple[str, ...]
    constants: tuple[str, ...]
    scattered: Mapping[str, str]


_AIR = {"airspeed": "airspeed_scatter", "air_density": "density_scatter"}
AXES: Mapping[str, Axis] = {
    LONGITUDINAL: Axis(
        "rigid",
        ("elevator",),
        MEASURED,
        OPTIONAL,
        tuple(RIGID_CONSTANTS),
        {"mass": "mass_scatter", "pitch_inertia": "inertia_scatter", **_AIR},
    ),
    LATERAL: Axis(
        "lateral",
        ("rudder", "aileron"),
        tuple(signal.name for signal in Lateral().outputs),
        (),
        tuple(LATERAL_CONSTANTS),
        {
            "mass": "mass_scatter",
            "roll_inertia": "inertia_scatter",
            "yaw_inertia": "inertia_scatter",
            **_AIR,
        },
    ),
}
