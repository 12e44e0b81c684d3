"""Flights by JSBSim: trimmed and quiet, of Euler's equations, with true derivatives that the
aircraft's own file prints.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from pydantic_core import PydanticUndefined

from scenarios.files.vehicles import read_vehicle
from scenarios.studies.catalogue import load_document
from scenarios.trials import jsbsim_flight as flights
from scenarios.trials.jsbsim_declaration import (
    CONDITIONS,
    OUTPUTS,
    JsbsimFlight,
    package_folder,
    surfaces_of,
)
from scenarios.trials.jsbsim_flight import (
    JsbsimTruth,
    fly_jsbsim,
    jsbsim_of,
    vehicle_text,
    write_jsbsim,
)
from scenarios.trials.jsbsim_machine import Condition, JsbsimSignals, fly
from sim.errors import DeclarationError
from sim.record import Record

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("jsbsim") is None,
    reason="JSBSim is not installed (pip install 'flightid[jsbsim]')",
)
Made = tuple[JsbsimFlight, Record, JsbsimTruth]


def declared(*changes: str) -> JsbsimFlight:
    return jsbsim_of(*load_document("jsbsim", changes))


@pytest.fixture(scope="module")
def made() -> Made:
    """An A320 in the lateral axis: its file gives most lateral derivatives as plain numbers."""
    flight = declared("aircraft=A320", "axis=lateral", "duration=20", "rate=25")
    return flight, *fly_jsbsim(flight, 1)


@pytest.fixture(scope="module")
def turning() -> JsbsimSignals:
    """A light aircraft, all surfaces moved smoothly at once."""
    t = np.arange(2001) / 400.0
    waves = {
        name: 0.02 * np.sin(rate * t) ** 2
        for name, rate in (("elevator", 1.3), ("aileron", 2.0), ("rudder", 1.6))
    }
    return fly(Condition("t6texan2", *CONDITIONS["t6texan2"], 1.0 / 400.0), waves, 0.0)


def printed(name: str) -> float:
    """A coefficient of the A320 as its file prints it: the plain number of a product."""
    root = ElementTree.parse(package_folder() / "aircraft" / "A320" / "A320.xml").getroot()
    (found,) = [
        function
        for function in root.iter("function")
        if function.get("name") == f"aero/coefficient/{name}"
    ]
    (value,) = [float(str(value.text)) for value in found.iter("value")]
    return value


@pytest.mark.long
def test_a_record_is_quiet_at_first_and_has_all_channels(made: Made) -> None:
    _, record, _ = made
    assert record.output_names == tuple(OUTPUTS) and len(record) == 501
    for name, noise in (("beta", 0.1), ("p", 0.1), ("r", 0.1), ("phi", 0.1)):
        assert np.std(record[name].values[:45]) < np.radians(2.0 * noise), f"{name} is not at rest"
    assert np.mean(record["az"].values[:45]) == pytest.approx(-9.79, abs=0.06) and record[
        "psi"
    ].values[0] == pytest.approx(0.0, abs=0.02)
    assert np.ptp(record["beta"].values) > np.radians(2.0) and np.ptp(
        record["phi"].values
    ) < np.radians(40.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("Cl_p", "Clp"),
        ("Cl_r", "Clr"),
        ("Cl_da", "Clda"),
        ("Cl_dr", "Cldr"),
        ("Cn_r", "Cnr"),
        ("Cn_dr", "Cndr"),
    ],
)
def test_true_derivatives_are_those_of_the_aircrafts_file(
    made: Made, ours: str, theirs: str
) -> None:
    slopes = made[2].about_trim["lateral"]
    assert slopes.values[ours] == pytest.approx(printed(theirs), rel=5e-3, abs=2e-4)
    assert slopes.left < 1e-5


def test_rotation_obeys_eulers_equations_with_the_body_that_is_handed_over(
    turning: JsbsimSignals,
) -> None:
    """The sign of the product of inertia, the moments, and no frame between them."""
    f, body, step = turning, turning.body, 1.0 / 400.0
    p_dot, q_dot, r_dot = (np.gradient(f[name], step) for name in "pqr")
    roll = (
        body.roll_inertia * p_dot
        - body.cross_inertia * (r_dot + f["p"] * f["q"])
        + (body.yaw_inertia - body.pitch_inertia) * f["q"] * f["r"]
    )
    yaw = (
        body.yaw_inertia * r_dot
        - body.cross_inertia * (p_dot - f["q"] * f["r"])
        + (body.pitch_inertia - body.roll_inertia) * f["p"] * f["q"]
    )
    pitch = (
        body.pitch_inertia * q_dot
        + (body.roll_inertia - body.yaw_inertia) * f["p"] * f["r"]
        + body.cross_inertia * (f["p"] ** 2 - f["r"] ** 2)
    )
    assert abs(body.cross_inertia) > 0.1 * body.roll_inertia, "else its sign would not show"
    inner = slice(20, -20)
    for found, name in ((roll, "moment_l"), (pitch, "moment_m"), (yaw, "moment_n")):
        left = (found - f[name])[inner]
        assert np.std(left) < 5e-3 * np.std(f[name][inner]), name


def test_surfaces_are_those_that_the_loads_read_and_go_where_they_are_wanted(
    turning: JsbsimSignals,
) -> None:
    assert surfaces_of("c172x")["aileron"].property == "fcs/effective-aileron-pos"
    assert surfaces_of("T38")["elevator"].property == "fcs/elevator-pos-norm" and surfaces_of(
        "T38"
    )["elevator"].scale == pytest.approx(0.297)
    wanted = 0.02 * np.sin(1.3 * turning["time"]) ** 2
    assert np.max(np.abs(turning["elevator"] - turning["elevator"][0] - wanted)) < 2e-3


def test_vehicle_files_are_read_and_hold_no_true_derivative(made: Made, tmp_path: Path) -> None:
    flight, record, truth = made
    vehicles, kept = write_jsbsim(flight, 1, record, truth, tmp_path, "flight")
    starts = read_vehicle(vehicles["lateral"], "lateral").constants
    assert (
        set(vehicles) == {"lateral"}
        and kept.name == "flight_truth.json"
        and starts["airspeed"] == pytest.approx(flight.airspeed, rel=1e-6)
    )
    for name, value in truth.about_trim["lateral"].values.items():
        lines = [
            line
            for line in vehicles["lateral"].read_text().splitlines()
            if line.startswith(f"{name} = ")
        ]
        assert all(
            1e-4 < abs(float(line.split("=")[1]) / value - 1.0) <= 0.301 for line in lines
        ), name
    assert "CY_dr" not in vehicles["lateral"].read_text(), "what moves nothing is left out"
    other = vehicle_text(
        flight, truth.constants["lateral"], truth.about_trim["lateral"], np.random.default_rng(9)
    )
    assert other != vehicles["lateral"].read_text()


@pytest.mark.slow
def test_same_seed_same_record_and_rough_air_shakes(made: Made) -> None:
    flight, record, _ = made
    again, _ = fly_jsbsim(flight, 1)
    rough, _ = fly_jsbsim(
        declared("aircraft=A320", "axis=lateral", "duration=20", "rate=25", "rough_air=3"), 1
    )
    np.testing.assert_array_equal(record["beta"].values, again["beta"].values)
    assert np.std(rough["beta"].values[:45]) > 1.5 * np.std(record["beta"].values[:45])


@pytest.mark.slow
@pytest.mark.parametrize("aircraft", list(CONDITIONS))
@pytest.mark.parametrize("axis", ["longitudinal", "lateral"])
def test_every_aircraft_of_the_list_flies_both_axes(aircraft: str, axis: str) -> None:
    record, truth = fly_jsbsim(declared(f"aircraft={aircraft}", f"axis={axis}"), 2)
    values: dict[str, float] = dict(truth.about_trim[axis].values)
    if axis == "lateral":
        assert values["Cl_p"] < 0.0 < values["Cn_beta"] and np.ptp(
            record["beta"].values
        ) > np.radians(1.0)
    else:
        assert values["Cm_q"] < 0.0 < values["CL_alpha"] and np.ptp(
            record["alpha"].values
        ) > np.radians(1.0)


def shown(default: Any) -> str:
    if default is PydanticUndefined:
        return "required"
    if default is None:
        return "none"
    return "empty" if default in ("", {}) else f"`{default}`"


def test_keys_and_defaults_are_documented() -> None:
    text = (Path(__file__).parents[4] / "docs" / "scenarios.md").read_text(encoding="utf-8")
    section = text.split("\n## Flights by JSBSim\n")[1]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    documented = {key.strip().strip("`"): default.strip() for key, default, *_ in rows}
    assert documented == {
        field.alias or name: shown(field.default)
        for name, field in flights._Jsbsim.model_fields.items()
    }


def test_a_fault_of_a_surface_that_is_not_there_is_refused() -> None:
    """The airship's air loads read no aileron."""
    flight = declared(
        "aircraft=ZLT-NT", "axis=rigid", "altitude=500", "airspeed=20", "late={aileron = 0.1}"
    )
    with pytest.raises(
        DeclarationError, match=r"key late\.aileron: ZLT-NT has no aileron that its air loads read"
    ):
        fly_jsbsim(flight, 1)
