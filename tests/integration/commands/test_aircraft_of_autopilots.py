"""From the log of an autopilot to the terms of a small aircraft, their values and a model for
another program, by the commands of docs/six-degrees.md.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from scenarios.files.aircraft_files import read_aircraft
from scenarios.files.declarations import read_toml_source
from scenarios.studies.catalogue import load_scenario
from scenarios.studies.estimating import fly_scenario
from tests.integration.command_line import CommandLine
from tests.recorders.forms import DEGREE
from tests.recorders.logs import write_dataflash, write_ulog

pytest.importorskip("pyulog")
pytest.importorskip("pymavlink")
FULL_THRUST = 12.0  # N
SURFACES = {
    ".ulg": """left_elevon = {column = "30 * actuator_servos.control[0]", unit = "deg"}
right_elevon = {column = "30 * actuator_servos.control[1]", unit = "deg"}
throttle = "actuator_motors.control[0]"
""",
    ".bin": """left_elevon = "pwm(RCOU.C1, 1500, 572.9577951308232)"
right_elevon = "pwm(RCOU.C2, 1500, 572.9577951308232)"
throttle = "pwm(RCOU.C3, 1000, 1000)"
""",
}


def ulog(path: Path, stamps: np.ndarray, rows: dict[str, np.ndarray]) -> Path:
    """The flight as PX4 logs it: the attitude as a quaternion, elevons and motor as commands."""
    half_roll, half_pitch = 0.5 * rows["phi"], 0.5 * rows["theta"]
    q = [
        np.cos(half_roll) * np.cos(half_pitch),
        np.sin(half_roll) * np.cos(half_pitch),
        np.cos(half_roll) * np.sin(half_pitch),
        -np.sin(half_roll) * np.sin(half_pitch),
    ]
    topics = {
        "vehicle_angular_velocity": {f"xyz[{i}]": rows[name] for i, name in enumerate("pqr")},
        "vehicle_acceleration": {f"xyz[{i}]": rows[f"a{name}"] for i, name in enumerate("xyz")},
        "vehicle_attitude": {f"q[{i}]": each for i, each in enumerate(q)},
        "airspeed_validated": {"true_airspeed_m_s": rows["airspeed"]},
        "vane": {"angle_of_attack": rows["alpha"], "sideslip": rows["beta"]},
        "actuator_servos": {
            "control[0]": rows["left_elevon"] / (30.0 * DEGREE),
            "control[1]": rows["right_elevon"] / (30.0 * DEGREE),
        },
        "actuator_motors": {"control[0]": rows["thrust"] / FULL_THRUST},
    }
    return write_ulog(path, {name: {"timestamp": stamps, **row} for name, row in topics.items()})


def dataflash(path: Path, stamps: np.ndarray, rows: dict[str, np.ndarray]) -> Path:
    """The flight as ArduPilot logs it: two IMUs, angles in degrees, servo pulses."""
    motion = {f"Gyr{name}": rows[rate] for name, rate in zip("XYZ", "pqr", strict=True)}
    motion |= {f"Acc{name}": rows[f"a{name.lower()}"] for name in "XYZ"}
    twice = {name: np.repeat(row, 2) for name, row in motion.items()}
    messages = {
        "IMU": {"TimeUS": np.repeat(stamps, 2), "I": np.tile([0.0, 1.0], len(stamps)), **twice},
        "ATT": {
            "TimeUS": stamps,
            "Roll": rows["phi"] / DEGREE,
            "Pitch": rows["theta"] / DEGREE,
            "Yaw": 0.0 * stamps,
        },
        "AOA": {"TimeUS": stamps, "AOA": rows["alpha"] / DEGREE, "SSA": rows["beta"] / DEGREE},
        "ARSP": {"TimeUS": stamps, "Airspeed": rows["airspeed"]},
        "RCOU": {
            "TimeUS": stamps,
            "C1": 1500.0 + 10.0 * rows["left_elevon"] / DEGREE,
            "C2": 1500.0 + 10.0 * rows["right_elevon"] / DEGREE,
            "C3": 1000.0 + 1000.0 * rows["thrust"] / FULL_THRUST,
        },
    }
    units = {"IMU": "s#EEEooo", "ATT": "sddh", "AOA": "sdd", "ARSP": "sn"}
    return write_dataflash(path, messages, units)


@pytest.mark.parametrize("suffix", [".ulg", pytest.param(".bin", marks=pytest.mark.long)])
def test_from_a_log_to_terms_values_and_a_model(
    flightid: CommandLine, tmp_path: Path, suffix: str
) -> None:
    scenario = load_scenario("aircraft-uav")
    record, _ = fly_scenario(scenario, 5)
    rows = {each.name: each.values for each in (*record.inputs, *record.outputs)}
    stamps = np.round(1e6 * (12.0 + record.time))
    log = tmp_path / f"uav{suffix}"
    (ulog if suffix == ".ulg" else dataflash)(log, stamps, rows)
    text = Path(scenario.flight.vehicle).read_text()
    text = text[: text.index("[aerodynamics.CD]")]
    text = text[: text.index("[trim]")] + text[text.index("[surfaces]") :]
    thrust = f'input = "throttle"\nmaximum = {FULL_THRUST}'
    (tmp_path / "uav.toml").write_text(text.replace('input = "thrust"', thrust))
    flightid.done("map", log, "--out", tmp_path / "draft")
    draft = (tmp_path / "draft" / "channels.toml").read_text().splitlines()
    kept = [line for line in draft if not line.startswith(("elevator", "aileron"))]
    channels = tmp_path / "channels.toml"
    channels.write_text("\n".join(kept) + "\n" + SURFACES[suffix])
    told = flightid.done(
        *("structure", log, "--vehicle", tmp_path / "uav.toml", "--channels", channels),
        *("--hierarchical", "--no-figures", "--out", tmp_path / "terms"),
    )
    assert f"--channels {channels} --out FIT" in told
    flightid.done(
        *("identify", log, "--model", "aircraft", "--vehicle", tmp_path / "terms" / "vehicle.toml"),
        *("--channels", channels, "--no-figures", "--out", tmp_path / "fit"),
    )
    found = json.loads((tmp_path / "fit" / "comparison.json").read_text())["parameters"]
    aircraft, _ = read_aircraft(read_toml_source(Path(scenario.flight.vehicle)))
    true = {
        f"{axis}_{term.label}": value
        for axis, table in aircraft.coefficients.items()
        for term, value in table.items()
    }
    for name in ("CY_beta", "Cl_beta", "Cl_p", "Cl_aileron", "Cm_alpha", "Cm_q", "Cm_elevator"):
        each = found[name]
        assert abs(each["estimate"] - true[name]) < 4.0 * each["std"], name
    for target, ending in (("python", "py"), ("jsbsim", "xml")):
        flightid.done("export", tmp_path / "fit", "--to", target, "--out", tmp_path / f"m.{ending}")
        assert (tmp_path / f"m.{ending}").stat().st_size > 2000
