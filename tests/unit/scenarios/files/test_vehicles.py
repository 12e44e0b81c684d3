"""Vehicle files: read in SI, and every fault told by file and key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from scenarios.files.vehicles import VehicleFile, read_vehicle
from sim.errors import DeclarationError

RIGID = """
name = "demonstrator"
mass = 7500.0
wing_area = 30.1
chord = 2.43
pitch_inertia = 32000
airspeed = 130.0
air_density = 0.96
{extra}
[derivatives]
CL_alpha = 5.1
CL_q = 6.0
CL_de = 0.42
Cm_alpha = -0.92
Cm_q = -17.0
Cm_de = -1.35
"""
MODE = """
[[modes]]
frequency = {frequency}
damping = 0.02
generalized_mass = "183.6 slug ft2"
CL_eta{i} = 0.0288
CL_etadot{i} = 0.0848
Cm_eta{i} = -0.032
Cm_etadot{i} = -0.159
Ceta{i}_alpha = -0.0149
Ceta{i}_q = -0.0949
Ceta{i}_de = -0.0128
Ceta{i}_eta{i} = 5.85e-5
Ceta{i}_etadot{i} = -4.2e-4
"""
LOES = """
name = "simulation"
airspeed = "969.6 ft/s"
gravity = 9.796
{extra}
[derivatives]
L_alpha = -1.9
M_alpha = -12.4
L_delta = -2.5e-5
M_delta = 0.317
L_q = 1.0
M_q = -3.0
inv_tau = 10
delay = "120 ms"
"""
BALLISTIC = """
name = "body"
air_density_reference = "0.0034 slug/ft3"
density_scale_height = "22000 ft"
gravity = "32.2 ft/s2"
[derivatives]
beta = "500 lb/ft2"
"""


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


def test_rigid(tmp_path: Path) -> None:
    vehicle = read_vehicle(written(tmp_path, RIGID.format(extra="")), "rigid")
    assert vehicle == VehicleFile(
        "demonstrator",
        "rigid",
        {
            "mass": 7500.0,
            "wing_area": 30.1,
            "chord": 2.43,
            "pitch_inertia": 32000.0,
            "airspeed": 130.0,
            "air_density": 0.96,
        },
        {
            "CL_alpha": 5.1,
            "CL_q": 6.0,
            "CL_de": 0.42,
            "Cm_alpha": -0.92,
            "Cm_q": -17.0,
            "Cm_de": -1.35,
        },
    )


def test_values_with_units(tmp_path: Path) -> None:
    text = (
        RIGID.format(extra="")
        .replace("7500.0", '"24200 lb"')
        .replace("5.1", '"0.1 1/deg"')
        .replace("130.0", '"100kt"')
    )
    vehicle = read_vehicle(written(tmp_path, text), "rigid")
    assert vehicle.constants["mass"] == pytest.approx(24200 * 0.45359237, rel=1e-12)
    assert vehicle.constants["airspeed"] == pytest.approx(100 * 1852 / 3600, rel=1e-12)
    assert vehicle.derivatives["CL_alpha"] == pytest.approx(0.1 * 57.29577951308232, rel=1e-12)


def test_flexible(tmp_path: Path) -> None:
    text = (
        RIGID.format(extra="")
        + MODE.format(i=1, frequency=12.57)
        + "Ceta1_eta2 = -1e-4\n"
        + MODE.format(i=2, frequency='"2 Hz"')
    )
    vehicle = read_vehicle(written(tmp_path, text), "flexible")
    (first, one), (second, two) = vehicle.modes
    assert (first, second) == (1, 2)
    assert one["frequency"] == 12.57 and one["Ceta1_eta2"] == -1e-4 and len(one) == 13
    assert (
        two["frequency"] == pytest.approx(12.566370614359172)
        and two["Cm_eta2"] == -0.032
        and len(two) == 12
    )
    assert one["generalized_mass"] == pytest.approx(183.6 * 1.3558179483314004, rel=1e-12)
    assert "modes" not in vehicle.constants and vehicle.derivatives["CL_q"] == 6.0


def test_modal_starts_may_stand_under_derivatives(tmp_path: Path) -> None:
    mode = MODE.format(i=1, frequency=12.57)
    moved = RIGID.format(extra="") + "CL_eta1 = 0.0288\n" + mode.replace("CL_eta1 = 0.0288\n", "")
    assert read_vehicle(written(tmp_path, moved), "flexible") == read_vehicle(
        written(tmp_path, RIGID.format(extra="") + mode), "flexible"
    )
    refused(
        tmp_path,
        RIGID.format(extra="") + "CL_eta1 = 0.0288\n" + mode,
        "flexible",
        "key derivatives.CL_eta1",
        "given twice",
    )


@pytest.mark.parametrize("extra", ["", 'vane_arm = "24 ft"'])
def test_loes(tmp_path: Path, extra: str) -> None:
    vehicle = read_vehicle(written(tmp_path, LOES.format(extra=extra)), "loes")
    expected = {"airspeed": 969.6 * 0.3048, "gravity": 9.796} | (
        {"vane_arm": 24 * 0.3048} if extra else {}
    )
    assert vehicle.constants == pytest.approx(expected, rel=1e-12)
    assert (
        vehicle.derivatives["delay"] == pytest.approx(0.12, rel=1e-12)
        and len(vehicle.derivatives) == 8
    )


def test_ballistic(tmp_path: Path) -> None:
    vehicle = read_vehicle(written(tmp_path, BALLISTIC.replace('name = "body"', "")), "ballistic")
    assert vehicle.name == "plane"
    assert vehicle.derivatives["beta"] == pytest.approx(500 * 4.882427636383051, rel=1e-12)
    assert vehicle.constants == pytest.approx(
        {
            "air_density_reference": 0.0034 * 515.3788183931961,
            "density_scale_height": 6705.6,
            "gravity": 9.81456,
        },
        rel=1e-12,
    )


VALUES: list[tuple[str, tuple[str, ...]]] = [
    ("-7500.0", ("key mass", "value -7500 is not above 0", "above 0")),
    ("0", ("key mass", "is not above 0")),
    ('"-3 lb"', ("key mass", "'-3 lb' is not above 0")),
    ("nan", ("key mass", "not a finite number")),
    ("inf", ("key mass", "not a finite number")),
    ('"1e999 kg"', ("key mass", "not a finite number")),
    ("1" + "0" * 400, ("key mass", "not a number")),
    ("true", ("key mass", "True is not a number", "1.5 kg")),
    ("[1]", ("key mass", "[1] is not a number")),
    ('"heavy"', ("key mass", "'heavy' is not a number with a unit", "1.5 kg")),
    ('"7500"', ("key mass", "'7500' has no unit", "1.5 kg")),
    ('"7500 m"', ("key mass", "'m' does not measure a mass", "kg, lb or slug")),
    ('"7500 stones_of_old"', ("key mass", "unknown unit 'stones_of_old'")),
    ('"7500 lbf"', ("key mass", "'lbf' does not measure a mass", "lb")),
]


@pytest.mark.parametrize(("value", "parts"), VALUES)
def test_wrong_values(tmp_path: Path, value: str, parts: tuple[str, ...]) -> None:
    refused(tmp_path, RIGID.format(extra="").replace("7500.0", value), "rigid", *parts)


def test_wrong_keys(tmp_path: Path) -> None:
    rigid = RIGID.format(extra="")
    refused(
        tmp_path,
        rigid.replace("mass", "mas"),
        "rigid",
        "key mas",
        "no such key",
        "did you mean 'mass'?",
    )
    refused(
        tmp_path,
        rigid.replace("CL_q", "CL_Q"),
        "rigid",
        "key derivatives.CL_Q",
        "did you mean 'CL_q'?",
    )
    refused(
        tmp_path,
        RIGID.format(extra="gravity = 9.8"),
        "rigid",
        "key gravity",
        "use one of name, mass, wing_area",
    )
    refused(
        tmp_path,
        rigid.replace("mass = 7500.0", "").replace("Cm_q = -17.0", ""),
        "rigid",
        "keys missing: mass, derivatives.Cm_q",
        "add them",
    )
    refused(tmp_path, rigid.replace("mass = 7500.0", ""), "rigid", "key missing: mass", "add it")
    refused(tmp_path, rigid[: rigid.index("[deriv")], "rigid", "key missing: derivatives")
    refused(
        tmp_path,
        rigid[: rigid.index("[deriv")] + "derivatives = 3\n",
        "rigid",
        "key derivatives",
        "value 3",
    )
    refused(tmp_path, rigid.replace('"demonstrator"', "3"), "rigid", "key name", "value 3")
    refused(
        tmp_path,
        LOES.format(extra="").replace("inv_tau = 10", "inv_tau = 0"),
        "loes",
        "key derivatives.inv_tau",
        "not above 0",
    )
    refused(
        tmp_path,
        LOES.format(extra="").replace('"120 ms"', "-0.1"),
        "loes",
        "key derivatives.delay",
        "is below 0",
    )
    refused(
        tmp_path,
        LOES.format(extra='vane_arm = "24 kg"'),
        "loes",
        "key vane_arm",
        "does not measure a length",
    )
    refused(
        tmp_path,
        BALLISTIC.replace("500 lb/ft2", "500 Pa"),
        "ballistic",
        "key derivatives.beta",
        "mass per area",
    )


def test_wrong_modes(tmp_path: Path) -> None:
    rigid, mode = RIGID.format(extra=""), MODE.format(i=1, frequency=12.57)
    refused(tmp_path, rigid, "flexible", "key modes", "[[modes]]")
    refused(tmp_path, RIGID.format(extra="modes = 3"), "flexible", "key modes", "[[modes]]")
    refused(
        tmp_path,
        rigid + mode.replace("damping", "dampin"),
        "flexible",
        "key modes[1].dampin",
        "did you mean 'damping'?",
    )
    refused(
        tmp_path,
        rigid + mode.replace("damping = 0.02\n", ""),
        "flexible",
        "key missing: modes[1].damping",
    )
    refused(
        tmp_path,
        rigid + mode + MODE.format(i=2, frequency=-1),
        "flexible",
        "key modes[2].frequency",
        "not above 0",
    )
    refused(
        tmp_path,
        rigid + mode + "Ceta1_eta2 = 0.1\n",
        "flexible",
        "key modes[1].Ceta1_eta2",
        "no such key",
    )
    refused(
        tmp_path,
        rigid + "CL_eta2 = 0.1\n" + mode,
        "flexible",
        "key derivatives.CL_eta2",
        "no such key",
    )
    refused(tmp_path, rigid + mode, "rigid", "key modes", "no such key")


def test_files_that_are_no_vehicle(tmp_path: Path) -> None:
    refused(tmp_path, "mass = \n", "rigid", "not valid TOML", "line 1")
    refused(tmp_path, "mass = 1\nmass = 2\n", "rigid", "not valid TOML", "line 2")
    refused(
        tmp_path,
        RIGID.format(extra=""),
        "rocket",
        "no model 'rocket'",
        "ballistic, rigid, flexible, loes",
    )
    (tmp_path / "plane.toml").write_bytes(b'name = "\xff"\n')
    with pytest.raises(DeclarationError, match=r"plane\.toml: not UTF-8 text; save"):
        read_vehicle(tmp_path / "plane.toml", "rigid")
    with pytest.raises(DeclarationError, match=r"none\.toml: there is no such file; check"):
        read_vehicle(tmp_path / "none.toml", "rigid")
    with pytest.raises(DeclarationError, match="this is a folder; name"):
        read_vehicle(tmp_path, "rigid")


SHARED = Path(__file__).parents[5] / "shared"


@pytest.mark.skipif(not SHARED.is_dir(), reason="the practice records are not at hand")
@pytest.mark.parametrize("model", ["rigid", "loes", "ballistic"])
def test_practice_vehicles(model: str) -> None:
    counts: dict[str, Any] = {"rigid": (6, 6), "loes": (2, 8), "ballistic": (3, 1)}
    paths = sorted((SHARED / "exam" / "records" / model).glob("*/vehicle.toml"))
    assert paths
    for path in paths:
        vehicle = read_vehicle(path, model)
        assert (
            len(vehicle.constants) >= counts[model][0]
            and len(vehicle.derivatives) == counts[model][1]
        )
