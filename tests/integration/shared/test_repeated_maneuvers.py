"""Derivatives of a measured aircraft from aileron and rudder maneuvers, and from their repeat."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import flightid as fid

AIRCRAFT = Path(__file__).parents[4] / "shared" / "flightdata" / "aircraft"
pytestmark = pytest.mark.skipif(
    not AIRCRAFT.is_dir(), reason="the folder of measured flights is not here"
)
BOOM = 12.9  # m ahead of the centre of gravity, as `check` finds it
LATERAL = {
    "CY": {"beta": -0.9, "p": 0.0, "r": 0.3, "rudder": 0.2},
    "Cl": {"1": 0.0, "beta": -0.1, "p": -0.5, "r": 0.15, "aileron": -0.13, "rudder": 0.02},
    "Cn": {"1": 0.0, "beta": 0.13, "p": -0.05, "r": -0.2, "aileron": 0.004, "rudder": -0.11},
}
# The force of the fin and its moment share their terms.
CURVED = {
    "CY_rudder_abs_rudder": ("CY", "rudder*abs(rudder)"),
    "CY_beta_abs_beta": ("CY", "beta*abs(beta)"),
    "Cl_aileron_abs_aileron": ("Cl", "aileron*abs(aileron)"),
    "Cn_rudder_abs_rudder": ("Cn", "rudder*abs(rudder)"),
    "Cn_beta_abs_beta": ("Cn", "beta*abs(beta)"),
}


def frames(names: Sequence[str]) -> list[pd.DataFrame]:
    """A frame of each part of the records, SI and radians."""
    from scipy.io import loadmat

    found = []
    for name in names:
        (rows,) = [v for k, v in loadmat(AIRCRAFT / f"{name}.mat").items() if not k.startswith("_")]
        cuts = np.flatnonzero(np.diff(rows[:, 0]) > 1.0) + 1
        for part in np.split(rows, cuts):
            degrees = {"elevator": 21, "rudder": 29, "alpha": 12, "beta": 13}
            degrees |= {"p": 6, "q": 7, "r": 8, "phi": 9, "theta": 10}
            columns = {key: np.radians(part[:, at]) for key, at in degrees.items()}
            found.append(
                pd.DataFrame(
                    {
                        "time": part[:, 0] - part[0, 0],
                        **columns,
                        "aileron": np.radians(part[:, 28] - part[:, 27]) / 2.0,
                        "thrust": part[:, 36] + part[:, 37],
                        "air_density": part[:, 33],
                        "airspeed": part[:, 14],
                        "ay": part[:, 2],
                    }
                )
            )
    return found


def vehicle(folder: Path, curved: Mapping[str, float] | None, held: bool) -> Path:
    """A vehicle file of ATTAS' size; ``curved`` values of the quadratic terms, None without."""
    terms = {axis: dict(own) for axis, own in LATERAL.items()}
    if curved is not None:
        terms["CY"]["aileron"] = 0.01
        for name, (axis, text) in CURVED.items():
            terms[axis][text] = curved.get(name, 0.0)
    longitudinal = {
        "CD": {"1": 0.05, "alpha": 0.3},
        "CL": {"1": 0.2, "alpha": 5.2, "q": 6.0, "elevator": 0.4},
        "Cm": {"1": 0.0, "alpha": -1.0, "q": -20.0, "elevator": -1.3},
    }
    fixed = [
        f"{axis}_{'0' if text == '1' else text}"
        for axis, own in longitudinal.items()
        for text in own
    ]
    fixed += list(CURVED) if held else []
    text = f"""model = "aircraft"
mass = 17600.0
wing_area = 64.0
chord = 3.159
span = 21.5
roll_inertia = 150e3
pitch_inertia = 330e3
yaw_inertia = 450e3
cross_inertia = 20e3
air_density = 0.73
airspeed = 131.0
trim_alpha = 0.035
trim_theta = 0.035
columns = ["air_density"]
recorded = ["airspeed", "alpha", "q", "theta"]
biases = ["p", "r", "ay", "phi", "beta"]
fixed = {fixed}
surfaces = {{elevator = "rad", aileron = "rad", rudder = "rad"}}
sensors = {{alpha = {{x = {BOOM}}}, beta = {{x = {BOOM}}}}}
thrust = {{input = "thrust"}}
"""
    for axis, own in {**longitudinal, **terms}.items():
        text += f"[aerodynamics.{axis}]\n"
        text += "".join(f'"{term}" = {value}\n' for term, value in own.items())
    path = folder / "attas.toml"
    path.write_text(text)
    return path


def differences(one: fid.Identification, other: fid.Identification) -> dict[str, float]:
    """Of each derivative in sigmas; constants trade with biases of the sensors."""
    a, b = one.to_dataframe(), other.to_dataframe()
    return {
        name: float(
            (a["value"][name] - b["value"][name]) / np.hypot(a["sigma"][name], b["sigma"][name])
        )
        for name in a.index
        if not name.endswith("_0") and name not in CURVED
    }


@pytest.mark.long
def test_derivatives_of_two_pairs_of_maneuvers_agree(tmp_path: Path) -> None:
    pairs = [frames(("fAttasAil1", "fAttasRud1")), frames(("fAttasAilRud2",))]

    def fitted(records: list[pd.DataFrame], path: Path) -> fid.Identification:
        return fid.identify(records, "aircraft", str(path), hold="linear")

    linear = [fitted(pair, vehicle(tmp_path, None, False)) for pair in pairs]
    whole = fitted([*pairs[0], *pairs[1]], vehicle(tmp_path, {}, False))
    # The quadratic terms are no chance: with them the likelihood is that of another model.
    assert whole.log_likelihood > linear[0].log_likelihood + linear[1].log_likelihood + 1000.0
    found = whole.to_dataframe()
    curved = {name: float(found["value"][name]) for name in CURVED}
    for name, value in curved.items():
        assert abs(value) > 2.0 * found["sigma"][name] or name == "CY_beta_abs_beta", name
    both = [fitted(pair, vehicle(tmp_path, curved, True)) for pair in pairs]
    apart = differences(*both)
    assert len(apart) == 15
    assert sum(abs(z) < 1.95 for z in apart.values()) >= 13
    assert max(abs(z) for z in apart.values()) < 2.1
    assert abs(apart["Cn_rudder"]) < abs(differences(*linear)["Cn_rudder"])
