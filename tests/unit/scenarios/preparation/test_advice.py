"""What is said to one whose log lacks a channel, a unit or a motion."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import flightid as fid
from ident.recording.misread_columns import large_angle_finding
from scenarios.files.measured.columns import read_record_file
from scenarios.preparation.declared_model import NO_LIFT
from scenarios.preparation.draft_text import map_text
from scenarios.preparation.drafting import drafted
from sim.errors import FlightidError
from sim.record import Channel
from tests.recorders import flights, quadrotor

SERVO = "0.5*(pwm(RCOU.C2, 1510, 572.958) - pwm(RCOU.C1, 1500, 572.958))"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pymavlink")
    return flights.without_vane(tmp_path_factory.mktemp("log") / "novane.bin", flights.flight())


def test_the_draft_names_servo_outputs_of_the_log_and_no_unused_columns(log: Path) -> None:
    text = map_text(drafted(read_record_file(log)))
    assert '# elevator = "pwm(RCOU.C2, 1500, 573)"' in text
    assert "Pulses that move: RCOU.C1, RCOU.C2" in text
    assert "elevon_left" not in text and "without a channel" not in text


def test_pitch_rate_alone_leads_to_an_accelerometer(log: Path) -> None:
    vehicle = tomllib.loads(flights.VEHICLE)
    channels = {"elevator": SERVO, "q": "IMU.GyrY"}
    alone = fid.identify(log, "rigid", vehicle, channels=channels)
    assert any(NO_LIFT in each for each in alone.warnings)
    assert not any("fly a maneuver" in each for each in alone.warnings)
    found = fid.identify(log, "rigid", vehicle, channels=channels | {"az": "IMU.AccZ"})
    for name, true in flights.TRUTH.items():
        assert abs(found[name].value - true) < 3.0 * found[name].sigma, name


@pytest.mark.parametrize(
    ("channels", "said"),
    [
        ({"q": "vehicle_angular_velocity.xyz[1]"}, "for logs of PX4, and this is one of ArduPilot"),
        ({"q": "IMU.GyrY", "elevator": "pwm(RCOU.C1, 1510)"}, "pwm needs three values, not 2"),
        ({"elevtor": "RCOU.C1"}, "did you mean 'elevator'?"),
    ],
)
def test_a_wrong_map_is_refused_with_what_was_meant(
    log: Path, channels: dict[str, str], said: str
) -> None:
    with pytest.raises(FlightidError) as refused:
        fid.identify(
            fid.read_record(log, channels={"q": "IMU.GyrY", **channels}),
            "rigid",
            tomllib.loads(flights.VEHICLE),
        )
    assert said in str(refused.value)


def test_pulses_are_told_from_degrees() -> None:
    angle = 5.0 * np.sin(np.arange(200) / 9.0)
    pulses = large_angle_finding(Channel.of("elevator", "rad", 1500.0 + 10.0 * angle))
    degrees = large_angle_finding(Channel.of("elevator", "rad", angle))
    assert pulses is not None and "servo pulses in us" in pulses.sentence
    assert degrees is not None and "name it elevator_deg" in degrees.remedy


@pytest.mark.parametrize(
    ("model", "method", "said"),
    [("rgid", "output-error", "did you mean 'rigid'?"), ("rigid", "ekv", "did you mean 'ekf'?")],
)
def test_misspelt_models_and_methods(log: Path, model: str, method: str, said: str) -> None:
    with pytest.raises(FlightidError) as refused:
        fid.identify(log, model, tomllib.loads(flights.VEHICLE), method=method)
    assert said in str(refused.value)


def test_motors_at_rest_are_said_in_the_place_of_a_next_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyulog")
    from scenarios.preparation.draft_text import draft_map

    columns = quadrotor.flight()
    still = {name: values * ("command" not in name) for name, values in columns.items()}
    path = quadrotor.px4(tmp_path / "still.ulg", still)
    draft_map(path, tmp_path / "out", None, None, False)
    told = " ".join(capsys.readouterr().out.split())
    assert "the motors moved nothing" in told and "flightid identify" not in told
