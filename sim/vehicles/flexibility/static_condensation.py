"""Static condensation: the rigid derivatives that a flexible aircraft shows when its structure follows at once.

With etadot = eta_ddot = 0 the modal equations (eq. 28 of the paper on simulated flight data) are linear in eta,

    omega_i^2 M_i / (qbar S c) eta_i - sum_j Ceta_i_eta_j eta_j = Ceta_i_alpha alpha + Ceta_i_q q_hat + Ceta_i_de elevator,

and eta put into CL and Cm changes the six rigid derivatives. For any number of modes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim.errors import ModelError

_MOTIONS = ("alpha", "q", "de")


@dataclass(frozen=True)
class Condensation:
    """Result of a static condensation.

    Attributes
    ----------
    derivatives : equivalent ``CL_alpha CL_q CL_de Cm_alpha Cm_q Cm_de``, 1/rad.
    change : equivalent minus rigid value, by the same names.
    deflection : ``(n, 3)`` static eta of each mode per alpha (rad), q_hat (q c/2V, rad) and elevator (rad).
    divergence_margin : smallest eigenvalue of I - K^-1 C_eta_eta: 1 without aerodynamic stiffness, 0 at
        static divergence of the restrained structure.
    """

    derivatives: Mapping[str, float]
    change: Mapping[str, float]
    deflection: np.ndarray
    divergence_margin: float


def condense(values: Mapping[str, float], modes: int) -> Condensation:
    """Condense the first ``modes`` elastic modes of an aircraft.

    Parameters
    ----------
    values : numbers by full name in SI, as ``VehicleData.values`` has them; a coupling that is missing is zero.
    modes : how many modes to keep; 0 returns the rigid derivatives.

    Raises
    ------
    ModelError : the restrained structure is beyond static divergence, so that it has no static deflection.
    """
    names = [f"{coefficient}_{motion}" for coefficient in ("CL", "Cm") for motion in _MOTIONS]
    rigid = np.array([values[name] for name in names]).reshape(2, 3)
    numbers = range(1, modes + 1)
    pressure = 0.5 * values["air_density"] * values["airspeed"] ** 2 * values["wing_area"] * values["chord"]
    stiffness = np.array([values[f"omega{i}"] ** 2 * values[f"generalized_mass{i}"] / pressure for i in numbers])
    aerodynamic = np.array([[values.get(f"Ceta{i}_eta{j}", 0.0) for j in numbers] for i in numbers]).reshape(modes, modes)
    forces = np.array([[values[f"Ceta{i}_{motion}"] for motion in _MOTIONS] for i in numbers]).reshape(modes, 3)
    loads = np.array([[values[f"{coefficient}_eta{i}"] for i in numbers] for coefficient in ("CL", "Cm")]).reshape(2, modes)
    margin = float(np.min(np.linalg.eigvals(np.eye(modes) - aerodynamic / stiffness[:, None]).real)) if modes else 1.0
    if margin <= 0:
        raise ModelError(
            f"static divergence: the margin is {margin:.3g}", where=f"{modes} elastic mode(s)", remedy="raise the frequencies or lower the airspeed"
        )
    deflection = np.linalg.solve(np.diag(stiffness) - aerodynamic, forces)
    change = loads @ deflection
    return Condensation(
        dict(zip(names, (rigid + change).ravel().tolist(), strict=True)),
        dict(zip(names, change.ravel().tolist(), strict=True)),
        deflection,
        margin,
    )
