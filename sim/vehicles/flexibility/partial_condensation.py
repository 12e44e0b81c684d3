"""Static condensation of the upper elastic modes only: what a model with the first few modes should find.

The modes above those kept follow at once, etadot_b = eta_ddot_b = 0, forced by the motion and by the kept modes a,

    (K_b - C_bb) eta_b = C_b_motion motion + C_ba eta_a + C_ba_dot etadot_a c/2V,

and eta_b put into CL, Cm and the forces on the kept modes changes the coefficients that the reduced model has.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim.errors import ModelError

_MOTIONS = ("alpha", "q", "de")


def condense_above(values: Mapping[str, float], modes: int, kept: int) -> dict[str, float]:
    """Coefficients of an aircraft with ``kept`` modes that stands for one with ``modes``; with none kept those of ``condense``.

    Parameters
    ----------
    values : numbers by full name in SI, as ``VehicleData.values`` has them; a coupling that is missing is zero.
    modes : modes that the aircraft has. kept : how many of them the reduced model has, ``0 <= kept <= modes``.

    Returns
    -------
    The six rigid derivatives and, of the kept modes, their ``CL_eta CL_etadot Cm_eta Cm_etadot`` and all ``Ceta``, SI.

    Raises
    ------
    ModelError : more modes kept than there are.
    """
    if not 0 <= kept <= modes:
        raise ModelError(f"{kept} modes kept of {modes}", where="condensation", remedy=f"keep 0 to {modes}")
    first, rest = range(1, kept + 1), range(kept + 1, modes + 1)
    pressure = 0.5 * values["air_density"] * values["airspeed"] ** 2 * values["wing_area"] * values["chord"]
    rows = ["CL", "Cm", *(f"Ceta{i}" for i in first)]
    columns = [*_MOTIONS, *(f"eta{j}" for j in first), *(f"etadot{j}" for j in first)]

    def table(of: list[str], by: list[str]) -> np.ndarray:
        return np.array([[values.get(f"{row}_{column}", 0.0) for column in by] for row in of]).reshape(len(of), len(by))

    forces, hidden = [f"Ceta{i}" for i in rest], [f"eta{i}" for i in rest]
    stiffness = np.diag([values[f"omega{i}"] ** 2 * values[f"generalized_mass{i}"] / pressure for i in rest])
    deflection = np.linalg.solve(stiffness.reshape(len(rest), len(rest)) - table(forces, hidden), table(forces, columns))
    reduced = table(rows, columns) + table(rows, hidden) @ deflection
    return {f"{row}_{column}": float(value) for row, line in zip(rows, reduced, strict=True) for column, value in zip(columns, line, strict=True)}
