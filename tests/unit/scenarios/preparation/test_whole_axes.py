"""Channels of lateral and longitudinal records: accelerometers for load factors, trims, what stays
an output, what the raw look says.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from scenarios.files.measured.columns import read_record_files
from scenarios.files.vehicles import read_vehicle
from scenarios.preparation.declared_model import model_of_file
from scenarios.preparation.measured_inputs import accelerometers_for
from scenarios.preparation.plan import Plan
from scenarios.preparation.reading import PreparedData, prepare
from scenarios.preparation.recording import expectations_of
from sim.errors import RecordError
from sim.maths import G0
from sim.record import Hold, Record
from tests.whole_axes import TRUE, flown, moved, trim, write_flown

DEGREES = math.degrees(1.0)
HELD = Plan(hold=Hold.PREVIOUS)


@pytest.fixture(scope="module")
def records() -> dict[str, Record]:
    return {model: flown(model) for model in TRUE}


def read(
    folder: Path, model: str, record: Record, units: dict[str, tuple[str, float]] | None = None
) -> PreparedData:
    path = write_flown(folder, model, record, units)
    return prepare(
        read_record_files([path]), model_of_file(read_vehicle(folder / "vehicle.toml", model)), HELD
    )


def same(a: Record, b: Record) -> None:
    assert (a.input_names, a.output_names) == (b.input_names, b.output_names)
    for one, other in zip(a.channels, b.channels, strict=True):
        assert one.unit == other.unit
        np.testing.assert_allclose(one.values, other.values, rtol=1e-9, atol=1e-12)


@pytest.mark.long
def test_accelerometers_serve_as_load_factors(tmp_path: Path, records: dict[str, Record]) -> None:
    lateral = read(tmp_path, "lateral", records["lateral"], {"ny": ("ay", G0)})
    same(lateral.fitted[0], records["lateral"])
    assert "lateral.csv: ny is ay/9.80665" in lateral.notes
    units = {
        "nz": ("az [ft/s2]", -G0 / 0.3048),
        "nx": ("ax", G0),
        "thrust": ("thrust_kN", 1e-3),
        "airspeed": ("airspeed [kt]", 3600 / 1852),
    }
    longitudinal = read(tmp_path, "longitudinal", records["longitudinal"], units)
    same(longitudinal.fitted[0], records["longitudinal"])
    assert {"longitudinal.csv: nz is -az/9.80665", "longitudinal.csv: nx is ax/9.80665"} <= set(
        longitudinal.notes
    )
    assert accelerometers_for(("alpha", "q", "nz")) == {"nz": "az"}


def test_degrees_by_name(tmp_path: Path, records: dict[str, Record]) -> None:
    units = {name: (f"{name}_deg", DEGREES) for name in ("beta", "phi", "aileron", "rudder")}
    units |= {"p": ("p_deg_s", DEGREES), "r": ("r [deg/s]", DEGREES)}
    same(read(tmp_path, "lateral", records["lateral"], units).fitted[0], records["lateral"])


def test_each_control_of_perturbations_is_taken_about_its_trim(
    tmp_path: Path, records: dict[str, Record]
) -> None:
    ready = read(tmp_path, "lateral", moved(records["lateral"], {"aileron": 0.02, "rudder": -0.01}))
    same(ready.fitted[0], records["lateral"])
    assert (
        "lateral.csv: trim of aileron taken off, 1.146 deg" in ready.notes
        and "lateral.csv: trim of rudder taken off, -0.573 deg" in ready.notes
    )


def test_no_trim_is_taken_off_totals(tmp_path: Path, records: dict[str, Record]) -> None:
    ready = read(tmp_path, "longitudinal", records["longitudinal"])
    same(ready.fitted[0], records["longitudinal"])
    assert not any("trim" in note for note in ready.notes)
    assert ready.fitted[0]["elevator"].values[0] == pytest.approx(trim()[1])


def test_airspeed_and_attitude_are_outputs_of_one_and_unused_by_the_other(
    tmp_path: Path, records: dict[str, Record]
) -> None:
    """With an attitude asked for, as a diagnosis does, too."""
    path = write_flown(tmp_path, "longitudinal", records["longitudinal"])
    ready = prepare(
        read_record_files([path]),
        model_of_file(read_vehicle(tmp_path / "vehicle.toml", "longitudinal")),
        HELD,
        attitude=True,
    )
    assert {"airspeed", "theta"} <= set(ready.fitted[0].output_names) and ready.fitted[
        0
    ].input_names == ("elevator", "thrust")
    path = write_flown(tmp_path, "lateral", records["lateral"])
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header + ",airspeed,theta", *(row + ",61.0,0.03" for row in rows)]))
    ready = prepare(
        read_record_files([path]),
        model_of_file(read_vehicle(tmp_path / "vehicle.toml", "lateral")),
        HELD,
        attitude=True,
    )
    same(ready.fitted[0], records["lateral"])


@pytest.mark.parametrize(
    ("cells", "noted", "doubted"),
    [
        ("62.1", True, False),
        ("45.0", True, True),
        ("x", False, False),  # a fault in a column that no equation uses does no harm
    ],
)
def test_a_recorded_airspeed_that_a_model_holds_constant_is_told(
    tmp_path: Path, records: dict[str, Record], cells: str, noted: bool, doubted: bool
) -> None:
    path = write_flown(tmp_path, "lateral", records["lateral"])
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header + ",airspeed", *(f"{row},{cells}" for row in rows)]))
    ready = prepare(
        read_record_files([path]),
        model_of_file(read_vehicle(tmp_path / "vehicle.toml", "lateral")),
        HELD,
    )
    same(ready.fitted[0], records["lateral"])
    said = (
        f"lateral.csv: the recorded airspeed, {float(cells):.4g} to {float(cells):.4g} m/s, is not "
        "used: the lateral model holds the airspeed of the vehicle file"
        if noted
        else "recorded airspeed"
    )
    assert any(note.startswith(said) for note in ready.notes) is noted
    far = "lateral.csv: the recorded airspeed, 45 m/s, is far from"
    assert any(doubt.startswith(far) for doubt in ready.doubts) is doubted


def test_a_column_in_degrees_that_says_radians_is_refused(
    tmp_path: Path, records: dict[str, Record]
) -> None:
    with pytest.raises(
        RecordError,
        match=r"rudder: moves by .* rad .*; if the column is in degrees, name it rudder_deg",
    ):
        read(tmp_path, "lateral", records["lateral"], {"rudder": ("rudder", DEGREES)})
    with pytest.raises(RecordError, match="channel elevator: has the sign turned"):
        read(tmp_path, "longitudinal", records["longitudinal"], {"elevator": ("elevator", -1.0)})
    vehicle = model_of_file(read_vehicle(tmp_path / "vehicle.toml", "longitudinal"))
    assert (
        expectations_of(vehicle).airspeed == 62.0
        and (expectations_of(vehicle).control_power or 0.0) < 0.0
    )
