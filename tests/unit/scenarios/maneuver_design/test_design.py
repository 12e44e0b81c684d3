"""The design of maneuvers: limits kept by a finer flight, the CSV flown again, multisines, faults
in one line, the command that does it again.
"""

from __future__ import annotations

import csv
import json
import shlex
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flightid as fid
from ident.tracing.diagnosis import Claim, Quantity, Verdict
from scenarios.diagnosis.diagnose import deciding_maneuver
from scenarios.files.records import read_record
from scenarios.maneuver_design.design import DesignResult, design
from scenarios.maneuver_design.limits import ACTUATOR_RATE, PILOT, no_faster, offset_of
from scenarios.maneuver_design.report import MAIN, design_text, maneuvers_table, write_design
from scenarios.maneuver_design.setting import DesignRequest, setting_of
from scenarios.preparation.plan import Request
from scenarios.report.figure_formats import caption_of
from sim.errors import DeclarationError
from sim.maneuvers import Multisine, least_peak_multisine, schroeder_multisine
from sim.record import Record
from sim.truth.flight import fly
from tests.held_inputs import held_inputs

VEHICLE = """name = "fighter"
mass = 7500.0
wing_area = 30.0
chord = 2.4
pitch_inertia = 32000.0
airspeed = 130.0
air_density = 0.96
[derivatives]
CL_alpha = 5.2
CL_q = 7.0
CL_de = 0.4
Cm_alpha = -0.95
Cm_q = -17.0
Cm_de = -1.3
"""
LIMITS = {
    "nz_max": 1.6,
    "nz_min": 0.5,
    "alpha_max": "3 deg",
    "q_max": "9 deg/s",
    "elevator_amplitude": "4 deg",
    "elevator_rate": "20 deg/s",
}


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("design") / "vehicle.toml"
    path.write_text(VEHICLE)
    return path


@pytest.fixture(scope="module")
def told(vehicle: Path) -> DesignResult:
    return design(
        DesignRequest(
            "rigid",
            vehicle,
            LIMITS,
            tell=("vane-offset", "sensor-lag:alpha"),
            size="arm=1 m",
            duration=12.0,
            computer=True,
        )
    )


def extremes(found: DesignResult, record: Record) -> dict[str, tuple[float, float]]:
    """Of a flight in steps that are five times finer, load factors as totals."""
    flight, _ = fly(
        found.setting.model, held_inputs(record), record.time, np.random.default_rng(0), step=0.002
    )
    offset = {name: offset_of(found.setting.model, name) for name in flight.output_names}
    return {
        name: (
            float(flight[name].values.min()) + offset[name],
            float(flight[name].values.max()) + offset[name],
        )
        for name in flight.output_names
    }


@pytest.mark.long
def test_a_flight_keeps_the_limits_and_comes_near_one(told: DesignResult) -> None:
    limits = told.setting.limits
    for each in told.maneuvers:
        record = each.flight.planned.record
        found = extremes(told, record)
        shares = [
            max((v - r) / (m - r) for v, m, r in ((lo, least, rest), (hi, most, rest)))
            for name, (lo, hi) in found.items()
            for least, most in [limits.outputs[name]]
            for rest in [1.0 if name == "nz" else 0.0]
        ]
        u = record["elevator"].values
        assert max(shares) <= 1.001
        assert np.max(np.abs(u)) <= np.radians(4.0) + 1e-12
        assert np.max(np.abs(np.diff(u))) <= np.radians(20.0) * 0.02 + 1e-12
        assert (
            max(shares) > 0.95
            or np.max(np.abs(u)) > 0.9 * np.radians(4.0)
            or each.kind in ("3-2-1-1", "doublet")
        )


@pytest.mark.long
def test_the_maneuver_reads_back_and_flies_the_same(told: DesignResult, tmp_path: Path) -> None:
    write_design(told, tmp_path / "plan", figures=())
    record = read_record(tmp_path / "plan" / "maneuver.csv", ("elevator",))
    assert np.array_equal(
        record["elevator"].values, told.best.flight.planned.record["elevator"].values
    )
    assert record.hold is told.best.flight.planned.record.hold
    again, _ = fly(
        told.setting.model, held_inputs(record), record.time, np.random.default_rng(0), step=0.002
    )
    with (tmp_path / "plan" / "expected.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for name, std in told.setting.noise.items():
        assert (
            np.max(np.abs(again[name].values - np.array([float(row[name]) for row in rows])))
            < 0.02 * std
        )


@pytest.mark.long
def test_the_folder_has_a_page_and_strict_json(told: DesignResult, tmp_path: Path) -> None:
    folder = write_design(told, tmp_path / "plan", figures=("svg",))
    content = json.loads((folder / MAIN).read_text())
    assert content["schema"] == "flightid/design/1" and content["best"] == told.best.kind
    assert {each["kind"] for each in content["maneuvers"]} == {
        "3-2-1-1",
        "doublet",
        "sweep",
        "multisine",
    }
    assert all(
        0.0 <= contest["chance"] <= 1.0
        for each in content["maneuvers"]
        for contest in each["contests"]
    )
    best = content["maneuvers"][0]
    assert content["flown_by"] == "a flight computer" and set(best["margins"]) == set(
        best["extremes"]
    )
    page = (folder / "report.html").read_text()
    assert "Margins to the limits" in page
    assert "vane-offset" in page and "<svg" in page and (folder / "maneuvers.svg").is_file()
    assert all(each.kind in design_text(told) for each in told.maneuvers)
    file = told.setting.vehicle.identity
    assert file is not None and f"({file.name}), rigid model" in " ".join(design_text(told).split())


def test_no_text_says_that_maneuvers_with_different_peaks_are_of_equal_amplitude(
    told: DesignResult,
) -> None:
    """Each is as large as requested or as the limits allow: peaks of 4.65 and 2.74 deg stood under
    "equal amplitude".
    """
    text = design_text(told)
    assert "equal amplitude" not in text and "as large as requested or as the limits allow" in text
    assert "qual amplitude" not in maneuvers_table(told).caption
    assert "is not drawn" in caption_of("maneuvers")


def test_the_best_maneuver_is_the_first(told: DesignResult) -> None:
    chances = [round(each.chance, 3) for each in told.maneuvers]
    assert chances == sorted(chances, reverse=True)


def peak_factor(multisine: Multisine) -> float:
    """Largest magnitude over root mean square, of a sine the root of two."""
    count = 64 * max(multisine.harmonics)
    u = multisine._inside(np.arange(count) * multisine.period / count)
    return float(np.max(np.abs(u)) / np.sqrt(np.mean(u**2)))


def test_multisines_are_orthogonal_and_of_low_peak() -> None:
    period, t = 20.0, np.arange(2000) * 0.01
    one, other = (least_peak_multisine(1.0, period, range(first, 31, 2)) for first in (1, 2))
    product = np.array([m(t) for m in (one, other)])
    gram = product @ product.T / len(t)
    assert gram == pytest.approx(np.eye(2), abs=1e-9)
    for m in (one, other):
        assert peak_factor(m) < 0.9 * peak_factor(schroeder_multisine(1.0, period, m.harmonics))
        assert abs(float(m(np.array(0.0)))) < 1e-6


def test_a_rate_limit_follows_as_fast_as_it_may() -> None:
    rows = np.array([[0.0, 1.0, 1.0, 1.0, 0.0, 0.0]])
    assert no_faster(rows, np.array([4.0]), 0.1).tolist() == [
        pytest.approx([0.0, 0.4, 0.8, 1.0, 0.6, 0.2])
    ]
    assert np.array_equal(no_faster(rows, np.array([np.inf]), 0.1), rows)


def holds(row: np.ndarray, interval: float) -> list[float]:
    """Lengths (s) for which a row stays on one side beyond half its peak."""
    level = np.sign(np.where(np.abs(row) > 0.5 * np.max(np.abs(row)), row, 0.0))
    ends = np.flatnonzero(np.diff(level)) + 1
    return [(end - begin) * interval for begin, end in pairwise(ends) if level[begin] != 0.0]


def test_what_is_said_to_fly_can_be_flown_by_hand(vehicle: Path) -> None:
    """By default: no multisine, a hand's rate, no step shorter than a pilot makes; what the finer
    flight reaches leaves the margins that are said.
    """
    found = design(DesignRequest("rigid", vehicle, duration=12.0))
    assert {each.kind for each in found.maneuvers} == {"3-2-1-1", "doublet", "sweep"}
    limits = found.setting.limits
    assert limits.rate["elevator"] == min(ACTUATOR_RATE, limits.amplitude["elevator"] / PILOT.rise)
    for each in found.maneuvers:
        record = each.flight.planned.record
        u = record["elevator"].values
        fastest = np.max(np.abs(np.diff(u))) / found.setting.maneuver_limits.interval
        assert fastest <= limits.rate["elevator"] * (1.0 + 1e-9)
        assert each.pulse_width >= PILOT.shortest_step - 1e-9
        if each.kind != "sweep":
            steps = holds(u - u[0], found.setting.maneuver_limits.interval)
            assert steps and min(steps) >= 0.5 * PILOT.shortest_step
        for name, (low, high) in extremes(found, record).items():
            least, most = limits.outputs[name]
            rest = 1.0 if name == "nz" else 0.0
            left = min((most - rest) / (high - rest), (rest - least) / (rest - low)) - 1.0
            assert each.flight.margins[name] == pytest.approx(left, rel=0.02, abs=2e-3)
    assert "flown by a pilot" in " ".join(design_text(found).split())
    assert "margin %" in design_text(found)


def test_two_inputs_fly_one_after_the_other_or_at_once() -> None:
    found = fid.design("lateral", fid.vehicle("navion_lateral"), computer=True).details
    for each in found.maneuvers:
        both = np.min(np.abs(each.flight.deflections), axis=0)
        assert bool(np.max(both) > 0.0) is (each.kind == "multisine")


def test_level_flight_is_level() -> None:
    setting = setting_of(
        DesignRequest("longitudinal", fid.vehicle("navion_longitudinal").source_for("longitudinal"))
    )
    flown, _ = fly(
        setting.model,
        held_inputs(setting.planned(np.zeros((2, len(setting.maneuver_limits.time)))).record),
        setting.maneuver_limits.time,
        np.random.default_rng(0),
    )
    assert np.ptp(flown["airspeed"].values) < 1e-3 and flown["nz"].values == pytest.approx(
        np.cos(setting.model.initial["alpha"].value), abs=1e-4
    )


FAULTS: list[tuple[dict[str, Any], str]] = [
    ({"tell": ("vane-offset",)}, "1 effects"),
    ({"tell": ("vane-offset", "vane-ofset")}, "did you mean 'vane-offset'"),
    ({"tell": ("vane-offset", "gust-turbulence")}, "is random"),
    ({"tell": ("vane-offset", "sensor-lag:alpha"), "size": "arms=2"}, "did you mean 'arm'"),
    ({"limits": {"nz_maximum": 2.0}}, "did you mean 'nz_max'"),
    ({"limits": {"alpha_max": "3 kg"}}, "does not measure an angle"),
    ({"limits": {"nz_max": 0.9}}, "before any maneuver"),
    ({"limits": {"elevator_rate": -1.0}}, "is not above 0"),
    ({"noise": ("alpha=0",)}, "is not above 0"),
    ({"value": ("CL_alpha",)}, "this is not NAME=VALUE"),
    ({"duration": 1.0}, "leave no room"),
    ({"rate": 1e6}, "samples"),
]


@pytest.mark.parametrize(("change", "line"), FAULTS)
def test_a_fault_is_told_in_one_line(vehicle: Path, change: dict[str, Any], line: str) -> None:
    change = {"values" if key == "value" else key: value for key, value in change.items()}
    with pytest.raises(DeclarationError, match=line) as caught:
        design(replace(DesignRequest("rigid", vehicle), **change))
    assert "\n" not in str(caught.value)


def test_a_falling_body_has_no_input() -> None:
    source = fid.vehicle("ballistic_target").source_for("ballistic")
    with pytest.raises(DeclarationError, match="no input to design"):
        design(DesignRequest("ballistic", source))


@pytest.mark.long
def test_the_command_of_an_ambiguous_diagnosis_does_it_again(vehicle: Path) -> None:
    """What is printed, typed again, designs the same maneuver with the same chance, to the last
    bit.
    """
    first = design(
        DesignRequest("rigid", vehicle, {"elevator_rate": 100.0}, duration=12.0, computer=True)
    )
    after = {
        name: Quantity(1.07 * first.setting.model.parameters[name].value, 0.01, "1/rad")
        for name in first.best.sigmas
    }
    claim = Claim(
        "vane-offset",
        {"arm": Quantity(1.23456, 0.1, "m")},
        ("accelerometer-offset:nz", "sensor-lag:alpha"),
    )
    d: Any = type(
        "D",
        (),
        {
            "verdict": Verdict.AMBIGUOUS,
            "effects": (claim,),
            "after": after,
            "residual_std": {"alpha": 0.00123, "q": 0.0015},
            "trained_after": None,
        },
    )()
    d.trained_after = type("T", (), {"effects": (found_effect(),)})()
    records = (first.best.flight.planned.record,)
    found = deciding_maneuver(
        d,
        Request((Path("flight.csv"),), "rigid", vehicle),
        first.setting.vehicle,
        first.setting.model,
        records,
    )
    assert found is not None and [each.effect.name for each in found.acting] == [
        "vane-offset",
        "sensor-lag:alpha",
    ]
    again = design(asked_by(found.request.command()))
    assert (
        np.array_equal(again.best.flight.deflections, found.best.flight.deflections)
        and again.best.chance == found.best.chance
    )
    d.verdict = Verdict.TRACED
    assert (
        deciding_maneuver(
            d,
            Request((Path("flight.csv"),), "rigid", vehicle),
            first.setting.vehicle,
            first.setting.model,
            records,
        )
        is None
    )


def found_effect() -> Any:
    from sim.effects.library import find_effect

    return find_effect("vane-offset", fid_equations())


def fid_equations() -> Any:
    from sim.vehicles.uncoupled import ShortPeriod

    return ShortPeriod()


def asked_by(command: str) -> DesignRequest:
    """What the command line makes of a command."""
    words = shlex.split(command)[2:]
    assert words.pop() == "--computer", "the records have steps from sample to sample"
    options = dict(zip(words[::2], words[1::2], strict=True))
    return DesignRequest(
        options["--model"],
        Path(options["--vehicle"]),
        tell=tuple(options["--tell"].split(",")),
        size=options["--size"],
        values=(options["--value"],),
        noise=(options["--noise"],),
        amplitude=(options["--amplitude"],),
        duration=float(options["--duration"]),
        rate=float(options["--rate"]),
        computer=True,
    )
