"""Which coefficients each lateral control moves, that which it is for first."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LateralControl:
    """A control surface: its signal, the derivative of what it is for and of the side force, the ports of both, and the third pair."""

    control: str
    moment_by: str
    lift_by: str
    ports: tuple[str, str]
    further: tuple[tuple[str, str], ...]


LATERAL_CONTROLS = (
    LateralControl("aileron", "Cl_da", "CY_da", ("roll", "side_force"), (("yaw", "Cn_da"),)),
    LateralControl("rudder", "Cn_dr", "CY_dr", ("yaw", "side_force"), (("roll", "Cl_dr"),)),
)
