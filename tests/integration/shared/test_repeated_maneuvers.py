"""Derivatives of a measured aircraft from aileron and rudder maneuvers, and from their repeat, by a
procedure that is laid down before the repeat is looked at.

1. Mass, inertias and places of the sensors as ``umr_reg_attas`` of Jategaonkar's programs has them.
2. Terms by stepwise regression of the first pair alone, offered linear ones and ``x*abs(x)``.
3. Output error with these terms of each pair by itself.

References
----------
R. V. Jategaonkar, Flight Vehicle System Identification, 2nd ed., AIAA 2015, chapter 6 and programs.
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
BOOM = "{x = 13.08, y = -0.01, z = -0.027}"  # m from the centre of gravity
ACCELEROMETER = (-1.01, 0.886, 0.103)
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


def vehicle(folder: Path, terms: Terms, *, estimated: bool = False) -> Path:
    """A vehicle file of ATTAS; longitudinal terms are held.

    ``estimated`` : the accelerometer's place to the right is estimated, from zero.
    """
    x, y, z = ACCELEROMETER
    place = '{y = 0.0, estimated = ["y"]}' if estimated else f"{{x = {x}, y = {y}, z = {z}}}"
    fixed = [
        f"{axis}_{'0' if text == '1' else text}"
        for axis, own in LONGITUDINAL.items()
        for text in own
    ]
    text = f"""model = "aircraft"
mass = 17631.0
wing_area = 64.0
chord = 3.159
span = 21.5
roll_inertia = 133367.0
pitch_inertia = 252687.0
yaw_inertia = 359593.0
cross_inertia = 11442.0
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
alpha = {BOOM}
beta = {BOOM}
accelerometer = {place}
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


def fitted(records: list[pd.DataFrame], path: Path) -> fid.Identification:
    """Estimates; accelerations along the plane of symmetry belong to motion that is recorded."""
    lateral = [frame.drop(columns=["ax", "az"]) for frame in records]
    return fid.identify(lateral, "aircraft", str(path), hold="linear")


def compared(a: fid.Identification, b: fid.Identification) -> tuple[pd.Series, pd.DataFrame]:
    """Differences of the derivatives and their covariance; constants trade with biases."""
    found = [each.to_dataframe()["value"] for each in (a, b)]
    at = [i for i, name in enumerate(found[0].index) if not name.endswith("_0")]
    names = found[0].index[at]
    covariance = (a.covariance + b.covariance)[np.ix_(at, at)]
    return (found[0] - found[1])[names], pd.DataFrame(covariance, names, names)


@pytest.mark.long
def test_derivatives_of_two_pairs_of_maneuvers_agree(tmp_path: Path) -> None:
    first, repeat = frames(("fAttasAil1", "fAttasRud1")), frames(("fAttasAilRud2",))
    path = vehicle(tmp_path, dict.fromkeys(STARTS, LINEAR))
    terms = chosen(first, path)
    curved = sorted((*LINEAR, "aileron*abs(aileron)"))
    side = sorted({*LINEAR} - {"aileron"})  # the ailerons make no side force
    assert terms == {"CY": side, "Cl": curved, "Cn": sorted(LINEAR)}
    assert chosen(repeat, path) == terms
    path = vehicle(tmp_path, terms)
    apart, covariance = compared(fitted(first, path), fitted(repeat, path))
    z = apart / np.sqrt(np.diag(covariance))
    n = len(z)
    assert n == 15
    # Each bound is passed by chance once in a hundred times where the sigmas are right.
    assert np.sum(np.abs(z) < 2.0) >= binom.ppf(0.01, n, 0.9545)
    assert np.max(np.abs(z)) < norm.isf(0.5 * (1.0 - 0.99 ** (1.0 / n)))
    assert apart @ np.linalg.solve(covariance, apart) < chi2.ppf(0.99, n)


@pytest.mark.long
def test_the_place_of_the_accelerometer_is_the_published_one(tmp_path: Path) -> None:
    """By lateral fits that do not use the vertical axis, and by that axis: y p_dot lifts it."""
    path = vehicle(tmp_path, dict.fromkeys(STARTS, LINEAR), estimated=True)
    for sides in (frames(("fAttasAil1", "fAttasRud1")), frames(("fAttasAilRud2",))):
        place, sigma = fitted(sides, path).to_dataframe().loc["accelerometer_y", ["value", "sigma"]]
        assert abs(place - ACCELEROMETER[1]) < 2.5 * sigma and sigma < 0.15
        assert lifted(sides[0]) == pytest.approx(ACCELEROMETER[1], abs=0.08)


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
