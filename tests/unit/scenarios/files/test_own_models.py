"""A user's model file and its vehicle file: what they give, and one line on each fault."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from scenarios.files.declarations import ColumnChoice, read_channel_map
from scenarios.files.records import read_record
from scenarios.files.units import is_unit, to_si
from scenarios.files.user_models import channel_units, is_model_file, read_user_model
from scenarios.files.vehicles import MODELS, VehicleFile, read_vehicle
from scenarios.preparation.declared_model import model_of_file
from sim.errors import DeclarationError, RecordError
from tests.own_models import ROLL, SPRING, model_file


def read(folder: Path, vehicle: str | None = None, text: str = ROLL) -> VehicleFile:
    path = model_file(folder, text)
    if vehicle is None:
        return read_vehicle(None, str(path))
    (folder / "vehicle.toml").write_text(vehicle)
    return read_vehicle(folder / "vehicle.toml", str(path))


def test_what_is_a_model_file() -> None:
    assert [is_model_file(name) for name in ("rigid", "roll.py", "models/roll", "roll")] == [
        False,
        True,
        True,
        False,
    ]


def test_the_file_of_an_aircraft_does_not_take_the_place_of_a_model_in_python(
    tmp_path: Path,
) -> None:
    with pytest.raises(DeclarationError) as refused:
        read(tmp_path, "[aerodynamics.Cm]\nalpha = -1.0\n")
    said = str(refused.value)
    assert "vehicle.toml" in said and "[aerodynamics]" in said and "--model aircraft" in said


def test_without_a_vehicle_file_the_model_has_its_own_numbers(tmp_path: Path) -> None:
    vehicle = read(tmp_path)
    assert (vehicle.name, vehicle.model) == ("roll", "roll")
    assert vehicle.constants == {"airspeed": 60.0} and vehicle.derivatives == {
        "L_p": -2.0,
        "L_da": 8.0,
    }
    assert (
        vehicle.identity is not None
        and vehicle.identity.name == "my_model.py"
        and vehicle.own_file == vehicle.identity
    )
    assert vehicle.own is not None and vehicle.own.equations.explanation.startswith(  # type: ignore[attr-defined]
        "Roll of an aircraft"
    )


def test_a_vehicle_file_gives_some_of_them_in_any_unit(tmp_path: Path) -> None:
    vehicle = read(tmp_path, 'name = "glider"\nairspeed = "108 km/h"\n[derivatives]\nL_da = 12\n')
    assert vehicle.name == "glider" and vehicle.constants["airspeed"] == pytest.approx(
        30.0, rel=1e-12
    )
    assert vehicle.derivatives == {"L_p": -2.0, "L_da": 12.0}
    model = model_of_file(vehicle)
    assert (
        model.parameters["L_da"].value == 12.0
        and model.parameters["L_da"].prior_std == 6.0
        and model.parameters.free_names == ("L_p", "L_da")
    )
    assert vehicle.identity is not None and vehicle.identity.name == "vehicle.toml"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("x = 1\n", "it declares no MODEL; "),
        ("MODEL = 3\n", "its MODEL is of type int; "),
        (
            "import nothing_there\n",
            "line 1: ModuleNotFoundError: No module named 'nothing_there'; ",
        ),
        ("def f(:\n", "line 1: SyntaxError: invalid syntax; "),
        ("x = 1\ny = x / 0\n", "line 2: ZeroDivisionError: division by zero; "),
        ("raise SystemExit(3)\n", "line 1: SystemExit: 3; "),
        (
            ROLL.replace("p.L_p", "p.Lp"),
            "rates ({file}, line 12): there is no parameter p.Lp; did you mean 'L_p'?",
        ),
        (
            ROLL.replace('"phi": "rad"}', '"phi": ""}', 1),
            "line 5: model roll, states, phi: the unit is empty; ",
        ),
        (ROLL.replace('name="roll"', 'name="rigid"'), "the model 'rigid' is built in; "),
        (
            ROLL.replace('"airspeed"', '"derivatives"'),
            "a constant 'derivatives' has no place in a vehicle file; ",
        ),
    ],
)
def test_one_line_on_a_wrong_model_file(tmp_path: Path, text: str, line: str) -> None:
    path = model_file(tmp_path, text)
    with pytest.raises(DeclarationError) as caught:
        read_user_model(path, MODELS)
    message = str(caught.value)
    assert (
        message.startswith(str(path))
        and line.format(file=path) in message
        and "\n" not in message
        and len(caught.value.remedy) > 4
    )


@pytest.mark.parametrize(
    ("name", "line"),
    [("gone.py", "there is no such file; "), ("folder/roll", "there is no such file; ")],
)
def test_a_model_file_that_is_not_there(tmp_path: Path, name: str, line: str) -> None:
    with pytest.raises(DeclarationError, match=line):
        read_vehicle(None, str(tmp_path / name))
    with pytest.raises(DeclarationError, match="this is no Python file; name a file that ends in"):
        read_vehicle(None, str(model_file(tmp_path, ROLL, "roll.txt")))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("mass = 3\n", "key mass: there is no such key; use one of airspeed"),
        ("airsped = 3\n", "key airsped: there is no such key; did you mean 'airspeed'?"),
        (
            "L_p = 3\n",
            "key L_p: there is no such key; it is a parameter: put it under [derivatives]",
        ),
        (
            "[derivatives]\nairspeed = 3\n",
            "key derivatives.airspeed: there is no such key; it is a constant: put it above "
            "[derivatives]",
        ),
        ("[derivatives]\nL_q = 3\n", "key derivatives.L_q: there is no such key; did you mean"),
        (
            '[derivatives]\nL_p = "3 kg"\n',
            "key derivatives.L_p: unit 'kg' does not measure a rate; write 1/s",
        ),
        ("[derivatives]\nL_p = true\n", "key derivatives.L_p: True is not a number with a unit; "),
        ("[derivatives]\nL_p = nan\n", "key derivatives.L_p: value nan is not a finite number; "),
        ("derivatives = 3\n", "key derivatives: this is no table; "),
        ("name = 3\n", "key name: 3 is no name; "),
        ("airspeed = \n", "not valid TOML"),
    ],
)
def test_one_line_on_a_wrong_vehicle_file(tmp_path: Path, text: str, line: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        read(tmp_path, text)
    assert (
        str(caught.value).startswith(str(tmp_path / "vehicle.toml"))
        and line in str(caught.value)
        and "\n" not in str(caught.value)
    )


def test_bounds_hold_for_the_vehicle_file(tmp_path: Path) -> None:
    text = ROLL.replace("    rates=", '    bounds={"L_p": (-5.0, 0.0)},\n    rates=')
    with pytest.raises(
        DeclarationError,
        match=r"vehicle\.toml: parameter L_p: value 1 1/s lies outside \[-5, 0\]; ",
    ):
        read(tmp_path, "[derivatives]\nL_p = 1\n", text)


def test_built_in_models_need_their_file() -> None:
    with pytest.raises(
        DeclarationError, match="--vehicle: the rigid model needs constants and starting values; "
    ):
        read_vehicle(None, "rigid")


def test_class_and_phase_for_flying_qualities_are_read_as_for_built_in_models(
    tmp_path: Path,
) -> None:
    found = read(tmp_path, 'aircraft_class = "II"\nflight_phase = "B"\n')
    assert (found.aircraft_class, found.flight_phase) == ("II", "B")
    with pytest.raises(DeclarationError, match="aircraft_class"):
        read(tmp_path, 'aircraft_class = "heavy"\n')


def test_channels_are_the_declared_names_in_the_declared_units(tmp_path: Path) -> None:
    model = read_user_model(model_file(tmp_path, SPRING)).model
    units = channel_units(model)
    assert units == {"time": "s", "force": "N", "x": "m", "acceleration": "m/s2"}
    path = tmp_path / "record.csv"
    path.write_text("time,force [kN],x_cm,acceleration (g)\n0,0.5,12,1\n0.1,0.25,3,2\n")
    record = read_record(path, ["force"], ["x", "acceleration"], channel_units=units)
    assert record["force"].values.tolist() == [500.0, 250.0] and record[
        "acceleration"
    ].values.tolist() == pytest.approx([9.80665, 19.6133])
    assert record["x"].values.tolist() == pytest.approx([0.12, 0.03], rel=1e-12) and [
        c.unit for c in record.channels
    ] == ["N", "m", "m/s2"]
    path.write_text("time,force,x [N]\n0,0.5,12\n0.1,0.25,3\n")
    with pytest.raises(
        RecordError, match=r"column 'x \[N\]': unit 'N' does not measure a length; "
    ):
        read_record(path, ["force"], ["x", "acceleration"], channel_units=units)


def test_a_channel_whose_name_begins_with_anothers_is_its_own(tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text("time,x_dot,u\n0,1,0\n1,2,0\n")
    units = {"time": "s", "u": "1", "x": "m", "x_dot": "m/s"}
    assert read_record(path, ["u"], ["x", "x_dot"], channel_units=units).output_names == ("x_dot",)


def test_a_channel_map_knows_the_declared_names(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text('copy = "other"\nx = {column = "POS", unit = "mm"}\n')
    assert read_channel_map(path, ["time", "x", "copy"]) == {
        "x": ColumnChoice("POS", "mm"),
        "copy": ColumnChoice("other"),
    }
    # Words that the schema itself might take for something: each is a channel like any other.
    names = ["copy", "channel_0", "channel_1", "model_config", "schema"]
    path.write_text("".join(f'{name} = "{name} of mine"\n' for name in names))
    assert read_channel_map(path, names) == {
        name: ColumnChoice(f"{name} of mine") for name in names
    }
    path.write_text('y = "POS"\n')
    with pytest.raises(
        DeclarationError, match="key y: there is no such key; use one of time, x, copy"
    ):
        read_channel_map(path, ["time", "x", "copy"])


@pytest.mark.parametrize(
    ("value", "unit", "target", "found"),
    [
        (3.0, "lbf/ft", "N/m", 3.0 * 4.4482216152605 / 0.3048),
        (2.0, "rad", "deg", math.degrees(2.0)),
        (90.0, "deg/s", "deg/s", 90.0),
        (math.pi, "rad/s", "deg/s", 180.0),
        (5.0, "kN s/m", "N s/m", 5000.0),
        (20.0, "", "furlong", 20.0),
        (1.0, "ft", "in", 12.0),
    ],
)
def test_units_that_a_model_declares(value: float, unit: str, target: str, found: float) -> None:
    assert to_si(value, unit, target, "here") == pytest.approx(found, rel=1e-12)


def test_a_label_has_no_conversion() -> None:
    assert is_unit("N s/m") and is_unit("g") and is_unit("1/rad") and not is_unit("parsnips")
    assert to_si(3.0, "parsnips", "parsnips", "here") == 3.0
    with pytest.raises(
        RecordError, match="here: unit 'm' is not the declared 'parsnips'; leave the unit out"
    ):
        to_si(3.0, "m", "parsnips", "here")
    with pytest.raises(
        RecordError, match="here: unit '1/s' does not measure what is declared in 'deg/s'; "
    ):
        to_si(3.0, "1/s", "deg/s", "here")
