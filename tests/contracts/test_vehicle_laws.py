"""Laws of every vehicle in the library; a new data file is covered by being there."""

from __future__ import annotations

import re
import tomllib
from importlib.resources import files

import numpy as np
import pint
import pytest

from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.maths import G0, complex_step_jacobian
from sim.vehicles.factory import WHOLE_AXES, linearise, model_of
from sim.vehicles.library import Origin, VehicleData, read_parameter_set, vehicle_names

NAMES = vehicle_names()
# Data files of another format, with readers and tests of their own.
OTHERS = {"x29"}
UNITS: pint.UnitRegistry = pint.UnitRegistry()


@pytest.fixture(params=NAMES)
def vehicle(request: pytest.FixtureRequest) -> VehicleData:
    return read_parameter_set(request.param)


def quantity(text: str) -> pint.Quantity:
    """``"6.4e6 slug ft2"`` with its unit."""
    number, _, unit = text.partition(" ")
    return float(number) * parsed(unit)


def parsed(unit: str) -> pint.Unit:
    return UNITS.parse_units(
        re.sub(r"(?<=[A-Za-z])(\d)", r"**\1", unit).replace(" ", "*") or "dimensionless"
    )


def level_flight(model: Model) -> dict[str, float]:
    """The start of a longitudinal model with the thrust that keeps its speed."""
    system = compile_model(model)
    p, x = system.parameters.values().tolist(), system.initial.values().tolist()
    slowing, with_one = (float(system.f(0.0, x, [0.0, thrust], p)[0]) for thrust in (0.0, 1.0))
    return {
        **dict(zip(system.initial.names, x, strict=True)),
        "thrust": slowing / (slowing - with_one),
    }


def test_every_data_file_is_a_vehicle_or_known_otherwise() -> None:
    found = {
        entry.name.removesuffix(".toml")
        for entry in (files("sim") / "data").iterdir()
        if entry.name.endswith(".toml")
    }
    assert found == {*NAMES} | OTHERS


def test_every_number_has_unit_origin_and_print(vehicle: VehicleData) -> None:
    for number in (*vehicle.numbers, *vehicle.initial):
        assert number.unit and number.printed, number.name
        assert number.origin is not Origin.USER, number.name
        assert number.source.startswith(number.origin.words)


def test_every_value_is_its_print_in_si(vehicle: VehicleData) -> None:
    for number in (*vehicle.numbers, *vehicle.initial):
        source = quantity(number.printed)
        value = source.magnitude if source.unitless else source.to(parsed(number.unit)).magnitude
        assert number.value == pytest.approx(value, rel=1e-9, abs=0.0), number.name


def test_units_are_si(vehicle: VehicleData) -> None:
    for number in (*vehicle.numbers, *vehicle.initial):
        assert (1.0 * parsed(number.unit)).to_base_units().magnitude == pytest.approx(
            1.0, rel=1e-15
        ), number.name


def test_every_number_of_a_model_has_a_source(vehicle: VehicleData) -> None:
    model = model_of(vehicle)
    for item in model.parameters:
        if item.name in vehicle:
            assert item.source == vehicle[item.name].source
            assert item.unit == vehicle[item.name].unit
        else:  # only a derivative may be left out, which is zero and stays so
            assert (item.value, item.free) == (0.0, False)
            assert item.name in WHOLE_AXES[vehicle.equations][2]
            assert item.source.endswith("left out")
    assert {number.name for number in vehicle.numbers} <= {*model.parameters.names}


def test_a_file_writes_no_number_of_its_base_twice(vehicle: VehicleData) -> None:
    if not vehicle.based_on:
        assert vehicle.numbers
        return
    base = read_parameter_set(vehicle.based_on)
    own = tomllib.loads(
        (files("sim") / "data" / f"{vehicle.name}.toml").read_text(encoding="utf-8")
    )["parameters"]
    assert not [
        name for name, entry in own.items() if name in base and base[name].value == entry["value"]
    ]


def test_model_compiles_and_rates_and_outputs_are_finite(vehicle: VehicleData) -> None:
    system = compile_model(model_of(vehicle))
    p, x = system.parameters.values().tolist(), system.initial.values().tolist()
    u = [0.1] * len(system.inputs)
    assert np.all(np.isfinite(system.f(0.0, x, u, p)))
    assert np.all(np.isfinite(system.h(0.0, x, u, p)))


def test_aircraft_are_stable(vehicle: VehicleData) -> None:
    model = model_of(vehicle)
    if vehicle.equations == "ballistic":
        return
    if vehicle.equations == "longitudinal":
        assert np.all(np.linalg.eigvals(linearise(model, about=level_flight(model)).A).real < 0)
        return
    assert vehicle.equations in ("rigid", "lateral")
    found = sorted(np.linalg.eigvals(linearise(model).A).tolist(), key=abs)
    if vehicle.equations == "lateral":
        # The spiral mode may grow, doubling in no less than 20 s (MIL-F-8785C, level 1, category
        # B).
        spiral = found.pop(0)
        assert spiral.imag == 0.0
        assert spiral.real < np.log(2.0) / 20.0
    assert all(root.real < 0 for root in found)


def test_longitudinal_sets_start_in_level_flight(vehicle: VehicleData) -> None:
    if vehicle.equations != "longitudinal":
        return
    model = model_of(vehicle)
    system, flight = compile_model(model), level_flight(model)
    assert flight["airspeed"] == vehicle["reference_airspeed"].value
    rates = system.f(
        0.0,
        system.initial.values().tolist(),
        [0.0, flight["thrust"]],
        system.parameters.values().tolist(),
    )
    # CL_0 is printed with six digits; speed and pitch rate are steady to rounding.
    assert rates == pytest.approx(
        [0.0] * 4, abs=1e-6 * G0 / flight["airspeed"] / vehicle["CL_0"].value
    )


def test_complex_step_equals_central_difference(vehicle: VehicleData) -> None:
    system = compile_model(model_of(vehicle))
    nx, nu = len(system.states), len(system.inputs)
    rng = np.random.default_rng(1)
    x = system.initial.values() + 0.1 * rng.standard_normal(nx)
    point = np.concatenate([x, 0.1 * rng.standard_normal(nu), system.parameters.values()])
    for function in (system.f, system.h):

        def at(v: list, function=function) -> list:
            return function(0.0, v[:nx], v[nx : nx + nu], v[nx + nu :])

        exact = complex_step_jacobian(at, point.tolist())
        for j, value in enumerate(point):
            size = 1e-6 * max(1.0, abs(value))
            ends = [
                np.array(at([*point[:j], value + sign * size, *point[j + 1 :]]))
                for sign in (1.0, -1.0)
            ]
            difference = (ends[0] - ends[1]) / (2 * size)
            scale = np.maximum(1e-6 * np.max(np.abs(ends), axis=0) / size, np.abs(exact[:, j]))
            assert np.all(np.abs(difference - exact[:, j]) <= 1e-6 * scale + 1e-9), j
