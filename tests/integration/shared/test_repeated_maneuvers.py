"""Derivatives of a measured aircraft from aileron and rudder maneuvers, and from their repeat, by a
procedure that is laid down before the repeat is looked at.

1. The place of the accelerometer across the fuselage, with linear terms, from the first pair.
2. Terms by stepwise regression of the first pair alone, offered linear ones and ``x*abs(x)``.
3. Output error with these terms of each pair by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, chi2, norm

import flightid as fid

AIRCRAFT = Path(__file__).parents[4] / "shared" / "flightdata" / "aircraft"
pytestmark = pytest.mark.skipif(
    not AIRCRAFT.is_dir(), reason="the folder of measured flights is not here"
)
BOOM = 12.9  # m ahead of the centre of gravity, as `check` finds it
LINEAR = ("beta", "p", "r", "aileron", "rudder")
OFFERED = (*LINEAR, *(f"{name}*abs({name})" for name in LINEAR))
STARTS = {
    "CY": {"beta": -0.9, "r": 0.3, "rudder": 0.2},
    "Cl": {"beta": -0.1, "p": -0.5, "r": 0.15, "aileron": -0.13, "rudder": 0.02},
    "Cn": {"beta": 0.13, "p": -0.05, "r": -0.2, "aileron": 0.004, "rudder": -0.11},
}
LONGITUDINAL = {
    "CD": {"1": 0.05, "alpha": 0.3},
    "CL": {"1": 0.2, "alpha": 5.2, "q": 6.0, "elevator": 0.4},
    "Cm": {"1": 0.0, "alpha": -1.0, "q": -20.0, "elevator": -1.3},
}
Terms = Mapping[str, Sequence[str]]


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
                        "ax": part[:, 1],
                        "ay": part[:, 2],
                        "az": part[:, 3],
                    }
                )
            )
    return found


def vehicle(folder: Path, terms: Terms, across: float = 0.0) -> Path:
    """A vehicle file of ATTAS' size; longitudinal terms are held.

    ``across`` : place of the accelerometer to the right, m, where its estimate begins.
    """
    fixed = [
        f"{axis}_{'0' if text == '1' else text}"
        for axis, own in LONGITUDINAL.items()
        for text in own
    ]
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
thrust = {{input = "thrust"}}
[sensors]
alpha = {{x = {BOOM}}}
beta = {{x = {BOOM}}}
accelerometer = {{y = {across}, estimated = ["y"]}}
"""
    sides = {
        axis: {**({} if axis == "CY" else {"1": 0.0}), **{t: STARTS[axis].get(t, 0.0) for t in own}}
        for axis, own in terms.items()
    }
    for axis, own in {**LONGITUDINAL, **sides}.items():
        text += f"[aerodynamics.{axis}]\n"
        text += "".join(f'"{term}" = {value}\n' for term, value in own.items())
    path = folder / "attas.toml"
    path.write_text(text)
    return path


def chosen(records: list[pd.DataFrame], path: Path) -> dict[str, list[str]]:
    """Terms of the lateral coefficients that stepwise regression of some maneuvers finds."""
    offered = path.parent / "offered.toml"
    lines = [f"{axis} = {list(OFFERED)}\n" for axis in STARTS]
    lines += [f'{axis} = ["alpha", "q", "elevator"]\n' for axis in LONGITUDINAL]
    offered.write_text("".join(lines))
    found = fid.structure(records, path, terms=offered, hierarchical=True, hold="linear")
    return {axis: sorted({*found.terms[axis]} - {"1"}) for axis in STARTS}


def fitted(records: list[pd.DataFrame], path: Path) -> pd.DataFrame:
    """Estimates; accelerations along the plane of symmetry belong to motion that is recorded."""
    lateral = [frame.drop(columns=["ax", "az"]) for frame in records]
    return fid.identify(lateral, "aircraft", str(path), hold="linear").to_dataframe()


def differences(a: pd.DataFrame, b: pd.DataFrame) -> dict[str, float]:
    """Of each derivative in sigmas; constants trade with biases of the sensors."""
    return {
        name: float(
            (a["value"][name] - b["value"][name]) / np.hypot(a["sigma"][name], b["sigma"][name])
        )
        for name in a.index
        if not name.endswith("_0") and not name.startswith("accelerometer")
    }


@pytest.mark.long
def test_derivatives_of_two_pairs_of_maneuvers_agree(tmp_path: Path) -> None:
    first, repeat = frames(("fAttasAil1", "fAttasRud1")), frames(("fAttasAilRud2",))
    begun = fitted(first, vehicle(tmp_path, dict.fromkeys(STARTS, LINEAR)))
    across = float(begun["value"]["accelerometer_y"])
    terms = chosen(first, vehicle(tmp_path, dict.fromkeys(STARTS, LINEAR), across))
    curved = sorted((*LINEAR, "aileron*abs(aileron)"))
    assert terms == {"CY": sorted(LINEAR), "Cl": curved, "Cn": sorted(LINEAR)}
    # Nothing hangs on which pair chooses.
    assert chosen(repeat, tmp_path / "attas.toml") == terms
    path = vehicle(tmp_path, terms, across)
    both = fitted(first, path), fitted(repeat, path)
    z = np.array(list(differences(*both).values()))
    n = len(z)
    assert n == 16
    # Each bound is passed by chance once in a hundred times where the sigmas are right.
    assert np.sum(np.abs(z) < 2.0) >= binom.ppf(0.01, n, 0.9545)
    assert np.max(np.abs(z)) < norm.isf(0.5 * (1.0 - 0.99 ** (1.0 / n)))
    assert np.sum(z**2) < chi2.ppf(0.99, n)
    # The vertical accelerometer, which these fits do not use, is lifted by y p_dot.
    for estimates, sides in zip(both, (first, repeat), strict=True):
        place, sigma = (estimates[key]["accelerometer_y"] for key in ("value", "sigma"))
        assert abs(place - lifted(sides[0])) < 3.0 * sigma


def lifted(frame: pd.DataFrame) -> float:
    """The accelerometer's place to the right, m, from its vertical axis in a rolling maneuver."""
    step = float(frame["time"][1])
    rates = {name: np.gradient(frame[name], step) for name in "pq"}
    p, q, r = (frame[name] for name in "pqr")
    columns = [
        np.ones(len(frame)),
        *(frame[name] * frame["airspeed"] ** 2 for name in ("alpha", "elevator")),
        q * frame["airspeed"],
        *(abs(frame[name]) for name in ("beta", "aileron")),
        p * r - rates["q"],
        q * r + rates["p"],
    ]
    return float(np.linalg.lstsq(np.array(columns).T, frame["az"].to_numpy(), rcond=None)[0][-1])
