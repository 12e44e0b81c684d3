"""Vehicle files of lateral and longitudinal models: what must be given, what may be left out, and
every fault in one line.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from scenarios.files.vehicles import read_any_vehicle, read_vehicle
from scenarios.preparation.declared_model import model_of_file
from sim.errors import DeclarationError
from tests.whole_axes import CONSTANTS, TRUE, vehicle_text

POSITIVE = {
    "lateral": (
        "mass",
        "wing_area",
        "span",
        "roll_inertia",
        "yaw_inertia",
        "airspeed",
        "air_density",
    ),
    "longitudinal": (
        "mass",
        "wing_area",
        "chord",
        "pitch_inertia",
        "air_density",
        "reference_airspeed",
    ),
}
SHARED = Path(__file__).parents[5] / "shared"


def written(folder: Path, text: str) -> Path:
    path = folder / "plane.toml"
    path.write_text(text, encoding="utf-8")
    return path


def refused(folder: Path, text: str, model: str, *parts: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        read_vehicle(written(folder, text), model)
    message = str(caught.value)
    assert (
        "\n" not in message
        and message.startswith(str(folder / "plane.toml"))
        and len(caught.value.remedy) > 4
    )
    for part in parts:
        assert part in message, message


def with_value(text: str, key: str, value: object) -> str:
    """The text with another value of one key."""
    return (
        "\n".join(
            f"{key} = {value}" if line.startswith(f"{key} =") else line
            for line in text.splitlines()
        )
        + "\n"
    )


@pytest.mark.parametrize("model", list(TRUE))
def test_what_is_given_is_read_and_what_is_left_out_is_held_at_zero(
    tmp_path: Path, model: str
) -> None:
    vehicle = read_vehicle(written(tmp_path, vehicle_text(model, 1.0)), model)
    assert (vehicle.name, vehicle.model) == ("twin", model)
    assert vehicle.constants == CONSTANTS[model] and vehicle.derivatives == TRUE[model]
    parameters = model_of_file(vehicle).parameters
    assert set(parameters.free_names) == set(TRUE[model])
    left_out = (
        {"CY_p", "CY_r", "CY_da", "Cn_da"}
        if model == "lateral"
        else {"CD_V", "CL_V", "CL_q", "Cm_V"}
    )
    assert {parameters[name].value for name in left_out} == {0.0}
    assert read_any_vehicle(tmp_path / "plane.toml") == vehicle


def test_a_fit_of_totals_starts_at_the_reference_airspeed(tmp_path: Path) -> None:
    vehicle = read_vehicle(written(tmp_path, vehicle_text("longitudinal")), "longitudinal")
    assert (
        model_of_file(vehicle).initial["airspeed"].value
        == CONSTANTS["longitudinal"]["reference_airspeed"]
    )


def test_units_and_signs(tmp_path: Path) -> None:
    text = with_value(
        with_value(vehicle_text("lateral"), "trim_alpha", '"-2 deg"'),
        "cross_inertia",
        '"-100 slug ft2"',
    )
    constants = read_vehicle(written(tmp_path, text), "lateral").constants
    assert constants["trim_alpha"] == pytest.approx(-math.radians(2.0)) and constants[
        "cross_inertia"
    ] == pytest.approx(-135.58179)
    text = with_value(vehicle_text("longitudinal"), "reference_airspeed", '"120 kt"')
    assert read_vehicle(written(tmp_path, text), "longitudinal").constants[
        "reference_airspeed"
    ] == pytest.approx(120 * 1852 / 3600)
    for model, names in POSITIVE.items():
        for name in names:
            refused(
                tmp_path,
                with_value(vehicle_text(model), name, 0),
                model,
                f"key {name}",
                "value 0 is not above 0",
            )


def test_faults_in_one_line(tmp_path: Path) -> None:
    lateral, longitudinal = vehicle_text("lateral"), vehicle_text("longitudinal")
    bare = lateral[: lateral.index("[derivatives]")]
    refused(tmp_path, bare, "lateral", "key missing: derivatives")
    refused(
        tmp_path,
        bare + "[derivatives]\n",
        "lateral",
        "key derivatives: no derivative is given",
        "CY_beta",
        "held at zero",
    )
    refused(
        tmp_path,
        lateral.replace("Cl_p", "Cl_P"),
        "lateral",
        "key derivatives.Cl_P",
        "did you mean 'Cl_p'?",
    )
    refused(
        tmp_path, lateral + "CL_alpha = 5\n", "lateral", "key derivatives.CL_alpha", "no such key"
    )
    refused(
        tmp_path, lateral + "CY_p = nan\n", "lateral", "key derivatives.CY_p", "not a finite number"
    )
    refused(
        tmp_path,
        lateral.replace("span", "wingspan"),
        "lateral",
        "key wingspan",
        "did you mean 'span'?",
    )
    refused(
        tmp_path,
        "\n".join(line for line in lateral.splitlines() if "span" not in line),
        "lateral",
        "key missing: span",
    )
    refused(
        tmp_path,
        with_value(lateral, "cross_inertia", 6000),
        "lateral",
        "key cross_inertia: value 6000 kg m2 is too large",
    )
    refused(
        tmp_path,
        with_value(lateral, "trim_theta", '"3 m"'),
        "lateral",
        "key trim_theta",
        "does not measure an angle",
    )
    refused(tmp_path, longitudinal, "lateral", "for the longitudinal model", "not for lateral")
    refused(
        tmp_path,
        longitudinal.replace("thrust_arm = -0.1\n", ""),
        "longitudinal",
        "key missing: thrust_arm",
    )
    refused(
        tmp_path,
        with_value(longitudinal, "CD_0", '"0.03 kg"'),
        "longitudinal",
        "key derivatives.CD_0",
        "does not measure a pure number",
    )


@pytest.mark.skipif(not SHARED.is_dir(), reason="the practice records are not at hand")
@pytest.mark.parametrize("model", list(TRUE))
def test_practice_vehicles(model: str) -> None:
    paths = sorted((SHARED / "exam" / "records" / model).glob("*/vehicle.toml"))
    assert paths
    for path in paths:
        vehicle = read_any_vehicle(path)
        assert (
            vehicle.model == model
            and set(vehicle.constants) == set(CONSTANTS[model])
            and len(vehicle.derivatives) > 8
        )


def test_a_check_takes_a_file_with_the_airspeed_alone(tmp_path: Path) -> None:
    path = tmp_path / "short.toml"
    path.write_text('name = "bomber"\nairspeed = "200 m/s"\nvane_arm = 3.0\n')
    vehicle = read_any_vehicle(path)
    assert (vehicle.name, vehicle.model) == ("bomber", "")
    assert vehicle.constants == {"airspeed": 200.0, "vane_arm": 3.0}
    path.write_text("airspeed = -1.0\n")
    with pytest.raises(DeclarationError, match="airspeed: value -1"):
        read_any_vehicle(path)
