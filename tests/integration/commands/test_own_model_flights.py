"""Flights of a user's own model from the command line and from scenario files: what is flown, what
is written, what comes out.
"""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from scenarios.files.records import read_record
from scenarios.files.user_models import read_user_model
from scenarios.files.vehicles import read_vehicle
from scenarios.studies.campaign import fly_campaign
from scenarios.studies.catalogue import scenario_text, with_changes
from scenarios.studies.declaration import START_OF_REST, maneuvers_by_input, with_common_hold
from scenarios.studies.reading import maneuver_plans, scenario_of
from scenarios.studies.schema import ManeuverTable
from scenarios.studies.study import run_scenario
from scenarios.trials.own_flight import OwnFlight, study_document
from scenarios.trials.planted_flights import off
from sim.declaration.effect import Parameter
from sim.record import Hold, Record
from sim.vehicles.library import read_parameter_set
from tests.integration.command_line import CommandLine, contents
from tests.own_models import ROLL_AND_YAW, SHORT_PERIOD, SPRING, model_file

TANK = '''"""A tank that a pump fills and that empties through a hole; the pump keeps its level."""

from sim.declaration import own_model
from sim.maths import sqrt

MODEL = own_model(
    name="tank",
    states={"level": "m"},
    inputs={"pump": "m3/s"},
    outputs={"level": "m"},
    constants={"größe": (2.0, "m2")},
    parameters={"hole": (0.01, "m2")},
    rates=lambda s, p: {"level": (s.pump - p.hole * sqrt(19.62 * s.level)) / p.größe},
    readings=lambda s, p: {"level": s.level},
    initial={"level": 1.0, "pump": 0.0442944692},
)
'''


def record(path: Path, inputs: list[str], outputs: list[str], units: dict[str, str]) -> Record:
    return read_record(path, inputs, outputs, channel_units={"time": "s", **units})


def test_the_record_is_what_the_equations_give(flightid: CommandLine, tmp_path: Path) -> None:
    path = model_file(tmp_path, SPRING)
    (tmp_path / "true.toml").write_text('m = "2500 g"\n[derivatives]\nk = 30.0\n')
    asked = (
        "--input",
        "force=pulse,amplitude=0.01 kN,unit=0.5 s,start=0.2 s",
        "--noise",
        "x=1e-9 m",
        "--noise",
        "acceleration=1e-9",
    )
    said = flightid.done(
        "simulate",
        "--model",
        path,
        "--vehicle",
        tmp_path / "true.toml",
        "--out",
        tmp_path / "new.csv",
        *asked,
        "--duration",
        2,
        "--rate",
        50,
    )
    assert said == (
        "written: new.csv, new_validate.csv (a second flight, for --validate) and new_vehicle.toml "
        "(for --vehicle)\n"
    )
    units = {"force": "N", "x": "m", "acceleration": "m/s2"}
    flown = record(tmp_path / "new.csv", ["force"], ["x", "acceleration"], units)
    assert np.allclose(flown["force"].values, 10.0 * ((flown.time > 0.19) & (flown.time < 0.69)))
    m, k, c = 2.5, 30.0, 1.0
    # SciPy's own integrator from switch to switch
    parts = [(0.0, 0.2, 0.0), (0.2, 0.7, 10.0), (0.7, 2.0, 0.0)]
    at, expected = np.zeros(2), []
    for begin, end, force in parts:
        times = flown.time[
            (flown.time > begin - 1e-9)
            & (flown.time < end - 1e-9 if end < 2.0 else flown.time < 3.0)
        ]
        moved = solve_ivp(
            lambda t, x, force=force: [x[1], (force - c * x[1] - k * x[0]) / m],
            (begin, end),
            at,
            t_eval=[*times, *([end] if end < 2.0 else [])],
            rtol=1e-10,
            atol=1e-12,
        )
        expected += moved.y[0][: len(times)].tolist()
        at = moved.y[:, -1]
    assert np.max(np.abs(flown["x"].values - expected)) < 1e-7
    vehicle = read_vehicle(tmp_path / "new_vehicle.toml", str(path))
    assert vehicle.constants == {"m": 2.5} and vehicle.derivatives == {
        "k": pytest.approx(39.0),
        "c": pytest.approx(0.7),
    }
    assert sorted(contents(tmp_path)) == [
        "my_model.py",
        "new.csv",
        "new.json",
        "new_validate.csv",
        "new_validate.json",
        "new_vehicle.toml",
        "true.toml",
    ]


@pytest.mark.long
def test_each_input_has_its_maneuver_and_a_seed_its_noise(
    flightid: CommandLine, tmp_path: Path
) -> None:
    path = model_file(tmp_path, ROLL_AND_YAW)
    words = (
        "--input",
        "aileron=3-2-1-1,amplitude=4 deg,unit=0.5 s,start=1 s",
        "--input",
        "rudder=doublet,start=6 s,unit=0.4 s",
        "--noise",
        "p=0.2 deg/s",
    )
    for name, seed in (("a", 1), ("again", 1), ("b", 2)):
        flightid.done(
            "simulate",
            "--model",
            path,
            "--out",
            tmp_path / f"{name}.csv",
            *words,
            "--rate",
            20,
            "--seed",
            seed,
        )
    assert (
        (tmp_path / "a.csv").read_bytes()
        == (tmp_path / "again.csv").read_bytes()
        != (tmp_path / "b.csv").read_bytes()
    )
    names = {
        "aileron": "rad",
        "rudder": "rad",
        "p": "rad/s",
        "r": "rad/s",
        "beta": "rad",
        "phi": "rad",
    }
    one, other = (
        record(tmp_path / f"{name}.csv", ["aileron", "rudder"], ["p", "r", "beta", "phi"], names)
        for name in ("a", "b")
    )
    moving = {name: one.time[np.flatnonzero(one[name].values)] for name in ("aileron", "rudder")}
    assert (moving["aileron"][0], moving["aileron"][-1]) == pytest.approx((1.0, 4.45)) and moving[
        "rudder"
    ][0] == pytest.approx(6.0)
    assert np.max(one["aileron"].values) == pytest.approx(math.radians(4.0))
    # Two flights differ by their noise alone, of which the standard deviation was named; that of a
    # chi-square within four sigmas.
    difference = (one["p"].values - other["p"].values) / math.sqrt(2.0)
    assert np.std(difference) == pytest.approx(
        math.radians(0.2), rel=4.0 / math.sqrt(2.0 * len(difference))
    )
    assert np.std(one["phi"].values - other["phi"].values) < 0.05 * np.ptp(one["phi"].values)


@pytest.mark.long
def test_a_model_rests_where_its_file_says(flightid: CommandLine, tmp_path: Path) -> None:
    path = model_file(tmp_path, TANK)
    flightid.done(
        "simulate",
        "--model",
        path,
        "--out",
        tmp_path / "tank.csv",
        "--hide",
        "input-delay.delay=2 s",
        "--input",
        "pump=pulse,start=300 s,unit=100 s",
    )
    flown = record(tmp_path / "tank.csv", ["pump"], ["level"], {"pump": "m3/s", "level": "m"})
    early = flown.time < 299.0
    assert (
        np.allclose(flown["pump"].values[early], 0.0442944692)
        and np.max(flown["pump"].values) > 0.0443
    )
    assert abs(np.mean(flown["level"].values[early]) - 1.0) < 4.0 * np.std(
        flown["level"].values[early]
    ) / math.sqrt(early.sum())
    assert read_vehicle(tmp_path / "tank_vehicle.toml", str(path)).constants == {"größe": 2.0}
    printed = flightid.done("campaign", "--model", path, "--runs", 4)
    assert "hole" in printed and "0.01" in printed


def test_steps_beside_a_smooth_maneuver_are_all_held() -> None:
    steps = ManeuverTable(input="aileron", kind="doublet", amplitude=0.1, unit=0.5, start=1.0)
    smooth = ManeuverTable(
        input="rudder", kind="multisine", amplitude=0.1, duration=4.0, harmonics=[1, 3]
    )
    time = np.arange(0.0, 5.0, 0.1)
    plans = maneuver_plans([steps, smooth], "here", "lateral")
    flown = maneuvers_by_input(plans, ["aileron", "rudder"], "here", {"rudder": 0.02})
    held = with_common_hold(flown, plans, time)
    assert {flown["rudder"].hold, held["rudder"].hold} == {Hold.LINEAR, Hold.PREVIOUS} and held[
        "aileron"
    ] is flown["aileron"]
    assert np.allclose(held["rudder"](time + 0.05), flown["rudder"](time)) and float(
        held["rudder"](0.5 * START_OF_REST)
    ) == pytest.approx(0.02)
    assert (
        with_common_hold({"rudder": flown["rudder"]}, plans[1:], time)["rudder"] is flown["rudder"]
    ), "alone it is read as the line that it is"


@pytest.mark.parametrize(
    ("value", "bounds", "share", "expected"),
    [
        (2.0, (0.0, 9.0), 0.3, 2.6),
        (2.0, (0.0, 2.1), 0.3, 1.4),
        (2.0, (1.9, 2.1), 0.3, 2.05),
        (2.0, (1.9, 2.1), -0.3, 1.95),
        (-2.0, (-9.0, 0.0), 0.3, -2.6),
    ],
)
def test_a_start_is_off_within_its_bounds(
    value: float, bounds: tuple[float, float], share: float, expected: float
) -> None:
    assert off(Parameter("k", value, "1", bounds=bounds), share) == pytest.approx(expected)


@pytest.mark.long
def test_a_campaign_says_what_its_estimates_say(flightid: CommandLine, tmp_path: Path) -> None:
    path, out = model_file(tmp_path, SPRING), tmp_path / "out"
    printed = flightid.done(
        "campaign",
        "--model",
        path,
        "--runs",
        30,
        "--seed",
        3,
        "--set",
        "estimate.method=ekf",
        "--out",
        out,
    )
    assert "30 runs from seed 3" in printed and "in 1 sigma" in printed
    content = json.loads((out / "campaign.json").read_text())
    rows = [*csv.DictReader((out / "estimates.csv").read_text().splitlines())]
    for name, true in (("k", 50.0), ("c", 1.0)):
        found = content["parameters"][name]
        error = np.array([float(row[name]) - true for row in rows])
        std = np.array([float(row[f"std_{name}"]) for row in rows])
        assert found["reference"] == true and found["bias"] == pytest.approx(
            error.mean(), abs=1e-12
        )
        assert found["within_one_sigma"] == np.mean(np.abs(error) <= std) and found[
            "within_two_sigma"
        ] == np.mean(np.abs(error) <= 2.0 * std)
        assert found["scatter"] == pytest.approx(error.std(ddof=1))
        # The filter is unbiased and its sigma that of its estimates, within four standard errors of
        # 30 runs.
        assert abs(found["bias"]) < 4.0 * found["scatter"] / math.sqrt(30.0)
        assert found["scatter"] / found["reported_std"] == pytest.approx(
            1.0, abs=4.0 / math.sqrt(60.0)
        )


def test_a_bank_of_filters_is_one_filter_after_the_other(tmp_path: Path) -> None:
    """Where a force is measured in an acceleration, the input acts on an output with no parameter
    before it.
    """
    asked = ["estimate.method=ekf", "estimate.passes=1"]
    path = str(model_file(tmp_path, SPRING))
    scenario = scenario_of(with_changes(study_document(OwnFlight(path)), asked), "spring", path)
    campaign = fly_campaign(scenario, 2, 5)
    for run, seed in enumerate(campaign.seeds):
        alone = run_scenario(scenario, int(seed)).main.result.estimate
        np.testing.assert_allclose(campaign.values[:, run], alone.values, rtol=1e-9)
        np.testing.assert_allclose(campaign.std[:, run], alone.std, rtol=1e-7)


def test_a_scenario_finds_the_truth(flightid: CommandLine, tmp_path: Path) -> None:
    flightid.done(
        "run", "own-model", "--out", tmp_path, "--no-figures", "--set", "flight.duration=5 s"
    )
    found = json.loads((tmp_path / "comparison.json").read_text())
    assert found["inputs"]["models"] == ["own_model.py"] and set(found["methods"]) == {"filter"}
    for method in (found, found["methods"]["filter"]):
        assert {name: row["true"] for name, row in method["parameters"].items()} == {
            "stiffness": 400.0,
            "damping": 12.0,
        }
        assert all(
            abs(row["error_sigmas"]) < 3.0 and abs(row["error_percent"]) < 1.0
            for row in method["parameters"].values()
        )


@pytest.mark.slow  # as test_own_model_commands.py, which traces one in each run
def test_a_scenario_finds_a_late_sensor(flightid: CommandLine, tmp_path: Path) -> None:
    assert "the diagnosis is right" in flightid.done(
        "run", "trace-own-model", "--out", tmp_path, "--no-figures"
    )
    traced = json.loads((tmp_path / "comparison.json").read_text())
    assert (
        abs(traced["parameters"]["sensor-delay:deflection.delay"]["error_sigmas"]) < 3.0
        and traced["grade"] == "right"
    )


def test_the_example_is_short_and_a_model(flightid: CommandLine, tmp_path: Path) -> None:
    text = flightid.done("models", "--example")
    assert len(text.splitlines()) <= 25
    model = read_user_model(model_file(tmp_path, text)).model
    assert len(model.initial) == 2 and model.parameters.free_names == ("stiffness", "damping")


def test_an_own_model_is_fitted_to_a_built_in_vehicle(
    flightid: CommandLine, tmp_path: Path
) -> None:
    """Truth and model may be of different files; constants are those of the model's own."""
    values, text = read_parameter_set("bomber_rigid").values, SHORT_PERIOD
    for name in ("mass", "wing_area", "chord", "pitch_inertia", "airspeed", "air_density"):
        text = re.sub(rf'"{name}": \([0-9.]+', f'"{name}": ({values[name]!r}', text)
    model_file(tmp_path, text)
    mine = scenario_text("rigid").replace('model = "rigid"', 'model = "my_model.py"')
    (tmp_path / "mine.toml").write_text(mine)
    shorter = (
        "--no-figures",
        "--set",
        "flight.duration=3 s",
        "--set",
        "flight.rate=50",
        "--set",
        "flight.step=5 ms",
    )
    flightid.done("run", tmp_path / "mine.toml", "--out", tmp_path / "own", *shorter)
    flightid.done("run", "rigid", "--out", tmp_path / "rigid", *shorter)
    own, rigid = (
        json.loads((tmp_path / name / "comparison.json").read_text())["parameters"]
        for name in ("own", "rigid")
    )
    assert own.keys() == rigid.keys()
    assert all(
        own[name]["estimate"] == pytest.approx(rigid[name]["estimate"], rel=1e-9) for name in rigid
    )


def test_identify_takes_the_vehicle_file_beside_the_record(
    flightid: CommandLine, tmp_path: Path
) -> None:
    path = model_file(tmp_path, SPRING)
    flightid.done("simulate", "--model", path, "--out", tmp_path / "record.csv")
    (tmp_path / "vehicle.toml").write_text("m = 4.0\n")
    asked = (
        "identify",
        tmp_path / "record.csv",
        "--model",
        path,
        "--no-figures",
        "--out",
        tmp_path / "out",
    )
    flightid.done(*asked)
    content = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert content["fixed"]["m"]["value"] == 4.0
