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
from scenarios.api.vehicle import toml_text
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
