"""Reading the aircraft's numbers: units, origins, and refusals that name the place."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim.closed_loop.airframe import DATA_FILE, load_x29
from sim.errors import DeclarationError
from tests.oracles.x29_origins import x29_origins

TEXT = DATA_FILE.read_text(encoding="utf-8")


def test_numbers_arrive_in_si_and_degrees() -> None:
    x29 = load_x29("P")
    a = x29.airframe
    assert a.airspeed == pytest.approx(221.224, abs=1e-3) and a.gravity == pytest.approx(
        9.7871, abs=1e-4
    )
    assert a.air_density == pytest.approx(0.65267, abs=1e-5)
    assert (a.L_alpha, a.L_q, a.M_alpha, a.M_q) == (-0.8167, 0.994, 12.14, -0.4136)
    assert a.M_surface == (0.1345, -0.08383, -0.04689)
    assert [(s.name, s.lower, s.upper, s.rate, s.trim) for s in x29.surfaces] == [
        ("canard", -60.0, 30.0, 100.0, -2.0),
        ("flaperon", -10.0, 24.75, 68.0, 5.0),
        ("strake", -30.0, 30.0, 30.0, 0.0),
    ]
    assert x29.surfaces[2].servo_frequency is None and x29.surfaces[0].servo_damping == 0.736
    assert x29.telemetry.vane_arm == pytest.approx(7.3152) and x29.frame == 0.0125
    assert (x29.stick.dead_band, x29.stick.delay_frames, x29.law.delay_frames) == (0.05, 2, 1)


def test_mixing_leaves_hardly_any_lift() -> None:
    for name in ("P", "S", "F"):
        x29 = load_x29(name)
        lifts = [
            derivative * surface.mixing
            for derivative, surface in zip(x29.airframe.L_surface, x29.surfaces, strict=True)
        ]
        assert abs(sum(lifts)) < 0.02 * max(abs(lift) for lift in lifts)
        moments = [
            derivative * surface.mixing
            for derivative, surface in zip(x29.airframe.M_surface, x29.surfaces, strict=True)
        ]
        assert min(moments) > 0.0


def test_flight_differs_from_simulation_where_it_should() -> None:
    simulation, flight = load_x29("S"), load_x29("F")
    assert (
        simulation.law == flight.law
        and simulation.surfaces == flight.surfaces
        and simulation.telemetry == flight.telemetry
    )
    assert (
        simulation.airframe.L_surface == flight.airframe.L_surface
        and simulation.airframe.airspeed == flight.airframe.airspeed
    )
    assert (flight.stick.delay_frames, flight.stick.recorded_skew) == (3, 0.005)


def test_every_number_tells_its_origin() -> None:
    origins = x29_origins()
    assert origins["airframes.P.M_alpha"] == (
        "1/s2",
        "read in the named publication or its reprint",
    )
    assert origins["airframes.S.M_alpha"] == ("1/s2", "chosen by this project, not flight data")
    assert origins["computer.frame_rate"] == ("1/s", "printed in NASA TM-101722")
    assert len(origins) == TEXT.count("origin = ")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'value = 725.8, unit = "ft/s"',
            'value = 725.8, unit = "m/s"',
            r"airframes\.P\.airspeed: unit 'm/s'; give the value in ft/s",
        ),
        (
            'value = 725.8, unit = "ft/s", origin = "pub"',
            'value = 725.8, unit = "ft/s"',
            r"airspeed: origin None; use one of pub",
        ),
        ("value = 725.8", 'value = "fast"', r"airspeed: value 'fast'; give one finite number"),
        ("value = 725.8", "value = nan", r"airspeed: value nan"),
        (
            "[-8.881e-4, -3.604e-3, -5.869e-4]",
            "[-8.881e-4, -3.604e-3]",
            r"L_surface: value .*give three numbers",
        ),
        ("M_q = {value = -0.4136", "M_r = {value = -0.4136", r"unknown key M_r; use airspeed"),
        (
            'M_q = {value = -0.4136, unit = "1/s", origin = "pub"}',
            "",
            r"airframes\.P\.M_q: is missing",
        ),
        ("[sensors.gyro]", "[sensors.rate_gyro]", r"the table gyro is missing"),
        (
            "trim = {value = -2.0",
            "trim = {value = 42.0",
            r"canard: trim 42 deg is not within its travel",
        ),
        ("rate = {value = 100.0", "rate = {value = 0.0", r"canard: rate or ram is not positive"),
        (
            "servo_damping = {value = 0.736",
            "servo_dumping = {value = 0.736",
            r"unknown key servo_dumping",
        ),
        (
            "delay_frames = {value = 1,",
            "delay_frames = {value = 0,",
            r"computer: delay_frames 0; give a whole number of frames, 1 or more",
        ),
        ("delay_frames = {value = 2,", "delay_frames = {value = 1.5,", r"delay_frames 1.5"),
        ('title = "published', 'titel = "published', r"title is missing"),
        ("[airframes.P]", "[airframes.P", r"is not TOML"),
    ],
)
def test_a_wrong_file_is_refused_by_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    path = tmp_path / "x29.toml"
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(DeclarationError, match=message):
        load_x29("P", path)


def test_an_unknown_airframe_or_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DeclarationError, match="no airframe 'Q'; use one of P, S, F"):
        load_x29("Q")
    with pytest.raises(DeclarationError, match="cannot be read"):
        load_x29("P", tmp_path / "absent.toml")
