"""The vehicle library: sets that build on others, faults named by file and key, factories for
built-in and user's numbers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.declaration.compile import compile_model
from sim.errors import DeclarationError, FlightidError
from sim.maths import complex_step_jacobian
from sim.vehicles.factory import (
    RIGID_CONSTANTS,
    RIGID_DERIVATIVES,
    ballistic_model,
    flexible_model,
    linearise,
    model_from_constants,
    model_of,
    rigid_model,
    vehicle_from_values,
)
from sim.vehicles.library import (
    Origin,
    SourcedNumber,
    difference,
    read_parameter_file,
    read_parameter_set,
    vehicle_names,
)


def roots(name: str, modes: int) -> list[complex]:
    found = np.linalg.eigvals(linearise(flexible_model(read_parameter_set(name), modes)).A)
    return sorted((root for root in found.tolist() if root.imag > 0), key=abs)


def test_rigid_roots_are_those_of_the_reference() -> None:
    (root,) = roots("bomber_rigid", 0)
    assert root == pytest.approx(-0.631 + 1.863j, abs=7e-4)


@pytest.mark.parametrize(
    ("name", "modes", "which", "expected"),
    [
        ("bomber_ac1", 1, 1, -0.473 + 12.39j),
        ("bomber_ac1", 2, 2, -1.272 + 16.71j),
        ("bomber_ac1", 3, 3, -0.558 + 21.24j),
        ("bomber_ac1", 4, 4, -0.529 + 22.11j),
        ("bomber_ac1", 4, 0, -0.562 + 1.654j),
        ("bomber_ac2", 1, 0, -0.420 + 1.192j),
        ("bomber_ac2", 2, 0, -0.400 + 1.037j),
        ("bomber_ac2", 3, 0, -0.384 + 0.944j),
        ("bomber_ac2", 4, 0, -0.384 + 0.944j),
    ],
)
def test_flexible_roots_are_those_of_the_reference(
    name: str, modes: int, which: int, expected: complex
) -> None:
    root = roots(name, modes)[which]
    assert root.real == pytest.approx(expected.real, abs=6e-4)
    assert root.imag == pytest.approx(expected.imag, abs=6e-3 if abs(expected) > 2 else 6e-4)


def test_a_set_takes_over_what_it_does_not_change() -> None:
    first, second = read_parameter_set("bomber_ac1"), read_parameter_set("bomber_ac2")
    changed = difference(first, second)
    assert [item.name for item in changed] == ["omega1", "omega2", "omega3", "omega4"]
    assert all(
        item.first and item.second and item.second.value == pytest.approx(item.first.value / 2)
        for item in changed
    )
    assert second.modes == first.modes == 4
    assert second["mass"] == read_parameter_set("bomber_rigid")["mass"]
    extra = difference(read_parameter_set("bomber_rigid"), first)
    assert len(extra) == 4 * (3 + 7 + 8)
    assert all(item.first is None for item in extra)


def test_misprint_is_shown_and_not_used() -> None:
    number = read_parameter_set("bomber_ac2")["Cm_eta1"]
    assert (number.value, number.printed_by_paper) == (-0.032, "0.0025")


def test_constants_are_held_and_derivatives_free() -> None:
    rigid = rigid_model(read_parameter_set("bomber_rigid"))
    assert rigid.parameters.free_names == tuple(RIGID_DERIVATIVES)
    flexible = flexible_model(read_parameter_set("bomber_ac1"), 1)
    assert len(flexible.parameters.free_names) == 15
    assert not flexible.parameters["omega1"].free
    body = ballistic_model(read_parameter_set("ballistic_target"))
    assert body.parameters.free_names == ("beta",)
    assert body.initial["velocity"].value == -1828.8


def test_sources_come_along_to_the_model() -> None:
    flexible = flexible_model(read_parameter_set("bomber_ac1"), 2)
    assert flexible.parameters["CL_eta2"].source == Origin.OWN.words
    assert flexible.parameters["mass"].source.startswith(Origin.REMEMBERED.words)
    assert flexible.parameters["Ceta1_eta1"].value == 5.85e-5


def test_elastic_modes_without_coupling_leave_the_rigid_motion_bit_for_bit() -> None:
    data = read_parameter_set("bomber_ac1")
    silent = {
        f"{name}{i}": 0.0 for i in (1, 2) for name in ("CL_eta", "CL_etadot", "Cm_eta", "Cm_etadot")
    }
    flexible = compile_model(flexible_model(data, 2).with_values(silent))
    rigid = compile_model(rigid_model(data))
    x, u = [0.02, -0.1, 0.3, 0.1, -0.2, 0.5], [0.05]
    assert flexible.f(0.0, x, u, flexible.parameters.values().tolist())[:2] == rigid.f(
        0.0, x[:2], u, rigid.parameters.values().tolist()
    )


def test_matrices_about_a_point_are_the_slopes_there() -> None:
    model = model_of(read_parameter_set("navion_longitudinal"))
    about = {
        "airspeed": 60.0,
        "alpha": 0.05,
        "theta": 0.1,
        "q": -0.02,
        "elevator": 0.03,
        "thrust": 2000.0,
    }
    system, found = compile_model(model), linearise(model, about=about)
    point, p = np.array(list(about.values())), system.parameters.values().tolist()
    for function, matrix in (
        (system.f, np.hstack([found.A, found.B])),
        (system.h, np.hstack([found.C, found.D])),
    ):
        for j in range(6):
            step = 1e-5 * max(1.0, point[j]) * np.eye(6)[j]
            ends = [
                np.array(function(0.0, at[:4].tolist(), at[4:].tolist(), p))
                for at in (point + step, point - step)
            ]
            # The differences' truncation goes with the square of the step, their rounding is 1e-16
            # of the values over it.
            assert matrix[:, j] == pytest.approx(
                (ends[0] - ends[1]) / (2.0 * step[j]), rel=1e-7, abs=1e-8
            )


def test_linearising_about_what_is_not_there_is_refused() -> None:
    with pytest.raises(DeclarationError, match="there is no state or input flaps"):
        linearise(
            model_of(read_parameter_set("navion_longitudinal")),
            about={"airspeed": 50.0, "flaps": 0.1},
        )


def test_users_numbers_go_through_the_same_factory() -> None:
    data = read_parameter_set("bomber_ac1")
    constants = {
        name: data[name].value
        for name in (*RIGID_CONSTANTS, "omega1", "zeta1", "generalized_mass1")
    }
    derivatives = {
        n.name: n.value
        for n in data.numbers
        if n.name.startswith(("CL_", "Cm_")) and n.name[-1] not in "234"
    }
    derivatives |= {
        n.name: n.value
        for n in data.numbers
        if n.name in ("Ceta1_alpha", "Ceta1_q", "Ceta1_de", "Ceta1_eta1", "Ceta1_etadot1")
    }
    users, ours = (
        model_from_constants("rigid", constants, derivatives, modes=1),
        flexible_model(data, 1),
    )
    assert users.parameters.names == ours.parameters.names
    assert np.array_equal(users.parameters.values(), ours.parameters.values())
    assert users.parameters.free_names == ours.parameters.free_names
    assert users.parameters["mass"].source == Origin.USER.words


def test_coupling_that_a_user_leaves_out_is_zero() -> None:
    data = read_parameter_set("bomber_ac1")
    values = {
        n.name: n.value
        for n in data.numbers
        if "_eta1" not in n.name or not n.name.startswith("Ceta")
    }
    model = model_of(vehicle_from_values("mine", "rigid", values, modes=4))
    assert model.parameters["Ceta3_eta1"].value == 0.0
    assert model.parameters["Ceta3_eta2"].value == 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": -5.0}, "mass: -5 kg is not positive"),
        ({"chord": 0.0}, "chord: 0 m is not positive"),
        ({"CL_alpha": float("nan")}, "CL_alpha: nan is not a finite number"),
        ({"wingspan": 3.0}, "unknown number wingspan"),
        ({"omega1": 3.0}, "unknown number omega1"),
    ],
)
def test_users_faults_are_named(change: dict[str, float], message: str) -> None:
    values = {**read_parameter_set("bomber_rigid").values, **change}
    with pytest.raises(FlightidError, match=message):
        model_of(vehicle_from_values("mine", "rigid", values))


def test_other_faults_of_a_user_are_named() -> None:
    values = dict(read_parameter_set("bomber_rigid").values)
    with pytest.raises(DeclarationError, match="unknown equations 'glider'"):
        vehicle_from_values("mine", "glider", values)
    with pytest.raises(DeclarationError, match="its equations are rigid"):
        ballistic_model(vehicle_from_values("mine", "rigid", values))
    with pytest.raises(DeclarationError, match="unknown number height"):
        vehicle_from_values("mine", "rigid", values, initial={"height": 1.0})
    del values["Cm_q"]
    with pytest.raises(DeclarationError, match="the number Cm_q is missing"):
        rigid_model(vehicle_from_values("mine", "rigid", values))
    with pytest.raises(DeclarationError, match="5 elastic modes asked for"):
        flexible_model(read_parameter_set("bomber_ac1"), 5)


GOOD = """title = "a"
source = "b"
equations = "rigid"
based_on = "bomber_rigid"
[parameters]
mass = {value = 2.0, unit = "kg", printed = "2", origin = "own"}
"""


def test_a_new_vehicle_is_one_new_file(tmp_path: Path) -> None:
    path = tmp_path / "glider.toml"
    path.write_text(GOOD, encoding="utf-8")
    data = read_parameter_file(path)
    assert (data.name, data["mass"].value, data["chord"].value) == ("glider", 2.0, 4.66344)
    assert data["mass"] == SourcedNumber("mass", 2.0, "kg", "2", Origin.OWN)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('title = "a"\n', "", "title is missing"),
        ('title = "a"', "title = ", "is not TOML"),
        ("title", "colour", "unknown key colour"),
        ("bomber_rigid", "nothing", "based_on nothing: there is no such vehicle"),
        ("bomber_rigid", "glider", "leads back to itself"),
        ("[parameters]", "modes = -1\n[parameters]", "modes is -1"),
        ("[parameters]", 'aircraft_class = "V"\n[parameters]', "aircraft_class is 'V'"),
        ("value = 2.0", "value = true", "value True"),
        ("value = 2.0", "value = inf", "value inf"),
        ("value = 2.0, ", "", "value is missing"),
        ('origin = "own"', 'origin = "hearsay"', "origin 'hearsay'"),
        ('origin = "own"', 'origin = "own", colour = "red"', "unknown key colour"),
        ('unit = "kg"', "unit = 1", "unit is no text"),
        ("mass = {", "mass = 3\nother = {", "is no table"),
    ],
)
def test_faults_of_a_file_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "glider.toml"
    path.write_text(GOOD.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(DeclarationError, match=message) as caught:
        read_parameter_file(path)
    assert str(caught.value).startswith("glider.toml")


def test_each_aircraft_names_its_class() -> None:
    """Class III from 45 t, class I below 5 t; a set has the class of the one it is based on."""
    found = {name: read_parameter_set(name) for name in vehicle_names()}
    assert {data.aircraft_class for data in found.values()} == {"", "I", "III", "IV"}
    for name, data in found.items():
        mass = data.values.get("mass", 0.0)
        assert (data.aircraft_class == "") is (data.equations == "ballistic"), name
        assert (data.aircraft_class == "III") is (mass > 45e3), name
        assert (data.aircraft_class == "I") is (0.0 < mass < 5e3), name
    assert found["bomber_ac2"].aircraft_class == "III"


def test_unknown_vehicle_lists_the_known() -> None:
    with pytest.raises(DeclarationError, match="bomber_ac1, bomber_ac2, bomber_rigid"):
        read_parameter_set("concorde")


def test_ballistic_acceleration_is_that_of_the_paper_with_the_velocity_squared() -> None:
    system = compile_model(ballistic_model(read_parameter_set("ballistic_target")))
    x = system.initial.values().tolist()
    rates = system.f(0.0, x, [], system.parameters.values().tolist())
    # In feet: 0.5 rho v^2 / beta - g with beta = 500 lb/ft2 = 500 / 32.17405 slug/ft2.
    feet = 0.5 * 0.0034 * np.exp(-200000 / 22000) * 6000**2 / (500 / 32.17404855643) - 32.2
    assert rates[1] / 0.3048 == pytest.approx(feet, rel=1e-8)
    assert np.all(
        np.isfinite(
            complex_step_jacobian(
                lambda v: system.f(0.0, v, [], system.parameters.values().tolist()), x
            )
        )
    )
