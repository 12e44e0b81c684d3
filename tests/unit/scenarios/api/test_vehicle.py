"""A vehicle in Python: the keys, the messages and the numbers of vehicle files, whichever way it
came.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flightid as fid
from scenarios.files.aircraft_files import toml_text
from scenarios.files.vehicles import read_vehicle
from scenarios.preparation.declared_model import model_of_file
from sim.vehicles.factory import model_of
from sim.vehicles.library import read_parameter_set, vehicle_names
from tests.integration.command_line import VEHICLE

NUMBERS: dict[str, Any] = tomllib.loads(VEHICLE)
NOTHING: Any = 3
TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=8)
VALUES = st.one_of(st.booleans(), st.integers(-(2**60), 2**60), st.floats(allow_nan=False), TEXTS)
TABLES = st.dictionaries(
    TEXTS,
    st.one_of(VALUES, st.lists(VALUES, max_size=3), st.dictionaries(TEXTS, VALUES, max_size=2)),
    max_size=3,
)
CONTENTS = st.dictionaries(
    TEXTS, st.one_of(VALUES, TABLES, st.lists(TABLES, min_size=1, max_size=2)), max_size=4
)


def test_a_file_keywords_and_a_mapping_are_one_vehicle(tmp_path: Path) -> None:
    path = tmp_path / "bomber.toml"
    path.write_text(VEHICLE)
    saved = fid.vehicle(NUMBERS).save(tmp_path / "v.toml")
    read = [
        fid.vehicle(path),
        fid.vehicle(str(path)),
        fid.vehicle(**NUMBERS),
        fid.vehicle(NUMBERS),
        fid.vehicle(saved),
    ]
    files = [read_vehicle(each.source_for("rigid"), "rigid") for each in read]
    assert all(file == files[0] for file in files) and files[0].constants["mass"] == pytest.approx(
        130642.3, rel=1e-6
    )
    assert (
        {each.name for each in read} == {"bomber"}
        and read[2]["chord"] == 4.66344
        and read[2]["CL_q"] == -11.0
    )
    assert read[0].source_for("rigid").identity.name == "bomber.toml"


def test_numbers_beside_a_source_replace_its_own_key_by_key() -> None:
    changed = fid.vehicle(NUMBERS, airspeed=180.0, derivatives={"CL_q": -9.0}, fixed=["CL_q"])
    assert changed["airspeed"] == 180.0 and changed.derivatives == {
        **NUMBERS["derivatives"],
        "CL_q": -9.0,
    }
    assert read_vehicle(changed.source_for("rigid"), "rigid").constraints.fixed == ("CL_q",)
    assert fid.vehicle(NUMBERS)["airspeed"] == NUMBERS["airspeed"]


@pytest.mark.parametrize("name", vehicle_names())
def test_every_vehicle_of_the_library_has_the_library_s_numbers(name: str) -> None:
    data = read_parameter_set(name)
    model = "flexible" if data.modes else data.equations
    model = "rigid" if model == "short-period" else model
    read = model_of_file(read_vehicle(fid.vehicle(name).source_for(model), model))
    known = model_of(data).parameters
    assert {item.name: item.value for item in read.parameters} == pytest.approx(
        {item.name: item.value for item in known}
    )


def test_a_rigid_model_of_an_elastic_vehicle_leaves_its_modes_out() -> None:
    elastic = next(name for name in vehicle_names() if read_parameter_set(name).modes)
    assert read_vehicle(fid.vehicle(elastic).source_for("rigid"), "rigid").modes == ()


@pytest.mark.long
@given(CONTENTS)
@settings(max_examples=25, deadline=None)
def test_what_is_written_reads_back(content: dict[str, Any]) -> None:
    assert tomllib.loads(toml_text(content)) == content


@pytest.mark.parametrize(
    ("given_vehicle", "line"),
    [
        (
            lambda: fid.vehicle("nowhere.toml"),
            "nowhere.toml: there is no such file; check the path",
        ),
        (
            lambda: fid.vehicle("navyon"),
            "vehicle: there is no vehicle 'navyon'; name a file that ends in .toml, or one of",
        ),
        (
            lambda: fid.vehicle(mass=object()),
            "key mass: a object is no value; give a number or a text",
        ),
        (
            lambda: fid.vehicle(NOTHING),
            "vehicle: a int is no vehicle; give a file's path, a name of the library, or its "
            "numbers",
        ),
        (lambda: fid.vehicle({**NUMBERS, "mas": 1.0}), "bomber, key mas: there is no such key"),
        (lambda: fid.vehicle(NUMBERS, mass="5 ft"), "bomber, key mass: unit 'ft'"),
        (
            lambda: fid.vehicle(NUMBERS, airspeed=-1.0),
            "bomber, key airspeed: value -1 is not above 0",
        ),
    ],
)
def test_a_fault_is_told_as_a_file_would_be(given_vehicle: Any, line: str) -> None:
    with pytest.raises(fid.InputError) as raised:
        read_vehicle(given_vehicle().source_for("rigid"), "rigid")
    assert str(raised.value).startswith(line)


def test_parameters_are_fixed_bounded_tied_and_freed_as_in_a_file() -> None:
    """The oracle is the same vehicle with the tables of a file written by hand."""
    made = fid.vehicle(NUMBERS)
    made.parameters["Cm_q"].fix(-28.0)
    made.parameters["CL_q"].bound(-30.0, -1.0)
    made.parameters["CL_de"].tie("Cm_de", factor=-0.2, constant=0.1)
    tables = {
        "fixed": {"Cm_q": -28.0},
        "bounds": {"CL_q": [-30.0, -1.0]},
        "tied": {"CL_de": [{"parameter": "Cm_de", "factor": -0.2}, {"constant": 0.1}]},
    }
    starts = {k: v for k, v in NUMBERS["derivatives"].items() if k not in ("Cm_q", "CL_de")}
    written = fid.vehicle({**NUMBERS, "derivatives": starts, **tables})
    assert read_vehicle(made.source_for("rigid"), "rigid").constraints == (
        read_vehicle(written.source_for("rigid"), "rigid").constraints
    )
    states = {name: each.state for name, each in made.parameters.items() if each.state != "free"}
    assert states == {"Cm_q": "fixed", "CL_q": "bounded", "CL_de": "tied"}
    for name in states:
        made.parameters[name].free()
    assert all(each.state == "free" for each in made.parameters.values())
    assert made["CL_de"] == pytest.approx(0.1 - 0.2 * made["Cm_de"])
    assert made["Cm_q"] == -28.0 and not {"fixed", "bounds", "tied"} & set(made.content)


def test_a_list_of_fixed_names_stays_fixed() -> None:
    made = fid.vehicle(NUMBERS, fixed=["Cm_q", "CL_q"])
    made.parameters["CL_q"].free()
    assert made.parameters["Cm_q"].state == "fixed" and made["CL_q"] == -11.0
    assert made.content["fixed"] == {"Cm_q": NUMBERS["derivatives"]["Cm_q"]}
    assert read_vehicle(made.source_for("rigid"), "rigid").constraints.fixed


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda p: p["Cm_q"].bound(1.0, -1.0), "wrong order"),
        (lambda p: p["Cm_q"].fix(float("nan")), "finite number"),
        (lambda p: p["Cm_q"].fix("abc"), "'abc' is no value of Cm_q; give a number, or a text"),
        (lambda p: p["Cm_q"].fix("3"), "'3' is no value of Cm_q"),
        (lambda p: p["Cm_q"].fix(True), "True is no value of Cm_q"),
        (lambda p: p["Cm_q"].bound("a", 1.0), "'a' is no value of Cm_q"),
        (lambda p: p["Cm_q"].tie("CL_q", factor="x"), "'x' is no number for the tie of Cm_q"),
        (lambda p: p["Cm_q"].tie("CL_q", constant="1 deg"), "'1 deg' is no number for the tie"),
        (lambda p: p["Cm_q"].tie("Cm_q"), "cannot be tied"),
        (lambda p: p["Cm_q"].tie("nothing"), "cannot be tied"),
    ],
)
def test_what_cannot_hold_is_refused_and_changes_nothing(change: Any, told: str) -> None:
    made = fid.vehicle(NUMBERS)
    with pytest.raises(fid.InputError, match=told):
        change(made.parameters)
    assert made.content == NUMBERS
    with pytest.raises(KeyError, match="there is no parameter 'Cm_x': CL_alpha"):
        made.parameters["Cm_x"]


def test_a_parameter_of_an_elastic_mode_is_fixed() -> None:
    made = fid.vehicle("bomber_ac1")
    start = made.parameters["Cm_eta1"].start
    made.parameters["Cm_eta1"].fix()
    assert read_vehicle(made.source_for("flexible"), "flexible").constraints.fixed
    made.parameters["Cm_eta1"].free()
    file = read_vehicle(made.source_for("flexible"), "flexible")
    assert dict(file.modes[0][1])["Cm_eta1"] == start and not file.constraints.fixed


def test_a_name_of_the_library_serves_as_a_vehicle_file() -> None:
    for name, model in (("bomber_rigid", "rigid"), ("navion_lateral", "lateral")):
        file = read_vehicle(name, model)
        assert file.constants == read_vehicle(fid.vehicle(name).source_for(model), model).constants
        assert file.identity is not None and file.identity.name == name
    with pytest.raises(fid.InputError, match=r"no vehicle 'bomber_rigit'; .*bomber_rigid"):
        read_vehicle("bomber_rigit", "rigid")


@pytest.mark.parametrize("name", vehicle_names())
def test_a_file_for_another_model_says_so(name: str) -> None:
    equations = read_parameter_set(name).equations
    own = "rigid" if equations == "flexible" else equations
    for model in {"rigid", "lateral", "longitudinal", "ballistic"} - {own}:
        with pytest.raises(fid.InputError, match=f"is for the {own} model .*, not for {model};"):
            read_vehicle(name, model)
    assert read_vehicle(name, own).name == name


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: fid.vehicle(mas=3.0), "vehicle, key mas: there is no such key; did you mean"),
        (lambda: fid.vehicle("bomber_rigid", wings=2), "bomber_rigid, key wings: there is no such"),
        (lambda: fid.vehicle("bomber_rigid", mass="abc"), "bomber_rigid, key mass: 'abc' is not a"),
        (lambda: fid.vehicle(mass=True), "vehicle, key mass: True is not a number"),
        (lambda: fid.vehicle(derivatives=3), "vehicle, key derivatives: this is no table"),
        (
            lambda: fid.vehicle(NUMBERS, derivatives={"CL_q": "abc"}),
            "bomber, key derivatives.CL_q: 'abc' is not a number",
        ),
    ],
)
def test_a_wrong_keyword_is_refused_where_it_is_written(call: Any, line: str) -> None:
    with pytest.raises(fid.InputError) as raised:
        call()
    assert str(raised.value).startswith(line) and "\n" not in str(raised.value)


def test_constants_of_a_model_of_ones_own_may_have_any_name() -> None:
    assert fid.vehicle(mass_1=2.0, stiffness="3 N/m")["mass_1"] == 2.0
