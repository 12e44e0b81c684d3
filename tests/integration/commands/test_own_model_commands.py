"""A user's own model on the command line: identified, diagnosed, looked at; nothing of an aircraft
is in it.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from scenarios.cli.libraries import LIST_WIDTH
from scenarios.diagnosis.opening import can_act
from scenarios.files.user_models import read_user_model
from scenarios.files.vehicles import MODELS
from scenarios.files.writing import write_record
from sim.declaration.effect import Effect
from sim.declaration.model import Model
from sim.effects.library import catch_all_terms_for, effects_for
from sim.maneuvers import alternating
from sim.truth.flight import fly, sample_times
from sim.truth.measurement import Measurement
from tests.bases import RIGID_VALUES
from tests.integration.command_line import CommandLine
from tests.own_models import ROLL, ROLL_AND_YAW, SPRING, model_file, own_rigid

TRUE = {"k": 40.0, "c": 1.5}
NOISE = {"x": 0.002, "acceleration": 0.05}
LATE = 0.06  # s


def declared(folder: Path) -> tuple[Path, Model]:
    """The model file, and its model at values other than those of the file."""
    path = model_file(folder, SPRING, "spring.py")
    return path, read_user_model(path).model.with_values(TRUE)


def pushed(folder: Path, model: Model, seed: int, stem: str = "record") -> Path:
    """A record of the mass pushed about from rest."""
    push = alternating(20.0, [0.5, 0.7, 0.4, 1.1, 0.3], start=1.0)
    record, _ = fly(
        model,
        push,
        sample_times(50.0, 10.0),
        np.random.default_rng(seed),
        measurement=Measurement(NOISE),
        step=0.005,
    )
    return write_record(folder, record, stem)[0]


def late_sensor(model: Model) -> Effect:
    """A late position sensor, where the library makes one for the channels of a declaration."""
    found = [effect for effect in effects_for(model.equations) if effect.name == "sensor-delay:x"]
    return found[0]


CONSTANTS_ONLY = '''"""A tank that drains as it is known to do."""

from sim.declaration import own_model

MODEL = own_model(
    name="tank",
    states={"level": "m"},
    inputs={"inflow": "m/s"},
    outputs={"level": "m"},
    constants={"drain": (1.0, "1/s")},
    parameters={},
    rates=lambda s, p: {"level": s.inflow - p.drain * s.level},
    readings=lambda s, p: {"level": s.level},
)
'''


def test_a_model_of_which_nothing_is_estimated_is_diagnosed(
    flightid: CommandLine, tmp_path: Path
) -> None:
    """Only the bias of its sensor is fitted; whether it stands can be asked all the same."""
    path = model_file(tmp_path, CONSTANTS_ONLY, "tank.py")
    model = read_user_model(path).model
    moved = alternating(0.5, [0.5, 0.7, 0.4, 1.1, 0.3], start=1.0)
    for seed, stem in ((1, "one"), (2, "two")):
        record, _ = fly(
            model,
            moved,
            sample_times(20.0, 10.0),
            np.random.default_rng(seed),
            measurement=Measurement({"level": 0.01}),
            step=0.01,
        )
        write_record(tmp_path, record, stem)
    printed = flightid.done(
        "diagnose",
        tmp_path / "one.csv",
        "--validate",
        tmp_path / "two.csv",
        "--model",
        path,
        "--no-figures",
    )
    assert "CONSISTENT" in printed


def test_a_mass_on_a_spring_is_identified(flightid: CommandLine, tmp_path: Path) -> None:
    path, model = declared(tmp_path)
    record = pushed(tmp_path, model, 1)
    printed = flightid.done(
        "identify", record, "--model", path, "--out", tmp_path / "out", "--no-figures"
    )
    assert (
        "spring-mass model, output-error: converged" in printed
        and "natural frequency 4.4" in printed
    )
    content = json.loads((tmp_path / "out" / "comparison.json").read_text())
    for name, true in TRUE.items():
        found = content["parameters"][name]
        assert abs(found["estimate"] - true) < 4.0 * found["std"] and found["std"] < 0.01 * true
    assert (
        content["model"] == "spring-mass"
        and content["inputs"]["model"] == "spring.py"
        and len(content["inputs"]["model_sha256"]) == 64
    )


@pytest.mark.sampled
@pytest.mark.parametrize("method", ["ekf", "equation-error"])
def test_other_methods_find_the_same(flightid: CommandLine, tmp_path: Path, method: str) -> None:
    path, model = declared(tmp_path)
    record = pushed(tmp_path, model, 2)
    flightid.done(
        "identify",
        record,
        "--model",
        path,
        "--method",
        method,
        "--out",
        tmp_path / "out",
        "--no-figures",
    )
    content = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert all(
        abs(content["parameters"][name]["estimate"] - true) < 0.02 * true
        for name, true in TRUE.items()
    )


@pytest.mark.long
def test_a_late_sensor_is_traced(flightid: CommandLine, tmp_path: Path) -> None:
    path, model = declared(tmp_path)
    late = late_sensor(model)
    flown = model.with_effects(late)
    flown = flown.with_values({f"{late.name}.delay": LATE})
    record, other = pushed(tmp_path, flown, 3), pushed(tmp_path, flown, 5, "other")
    flightid.done(
        "diagnose",
        record,
        "--validate",
        other,
        "--model",
        path,
        "--out",
        tmp_path / "out",
        "--no-figures",
    )
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    (claim,) = content["effects"]
    assert claim["name"] == late.name and content["verdict"] == "traced"
    assert claim["parameters"]["delay"]["value"] == pytest.approx(LATE, abs=0.002)
    assert (
        content["error"]["unit"] == {"x": "m", "acceleration": "m/s2"}
        and content["inputs"]["model"] == "spring.py"
    )


@pytest.mark.long
def test_of_two_inputs_the_late_one_is_named(flightid: CommandLine, tmp_path: Path) -> None:
    path = model_file(tmp_path, ROLL_AND_YAW)
    model = read_user_model(path).model
    late = [
        effect for effect in effects_for(model.equations) if effect.name == "input-delay:rudder"
    ]
    shares = {
        name: 1.1 if place % 2 else 0.9 for place, name in enumerate(model.parameters.free_names)
    }
    flown = model.with_values(
        {name: share * model.parameters[name].value for name, share in shares.items()}
    ).with_effects(*late)
    flown, noise = (
        flown.with_values({"input-delay:rudder.delay": 0.12}),
        {"p": 0.003, "r": 0.002, "beta": 0.002, "phi": 0.003},
    )
    for stem, seed in (("record", 1), ("other", 2)):
        maneuvers = {
            "aileron": alternating(0.05, [0.5, 1.0, 0.5], start=1.0 + 0.2 * seed),
            "rudder": alternating(0.08, [0.7, 0.7, 0.4, 0.4], start=5.0),
        }
        rng, measured = np.random.default_rng(seed), Measurement(noise)
        write_record(
            tmp_path,
            fly(flown, maneuvers, sample_times(50.0, 12.0), rng, measurement=measured, step=0.005)[
                0
            ],
            stem,
        )
    record, other, out = tmp_path / "record.csv", tmp_path / "other.csv", tmp_path / "out"
    flightid.done(
        "diagnose", record, "--validate", other, "--model", path, "--out", out, "--no-figures"
    )
    content = json.loads((out / "diagnosis.json").read_text())
    (claim,) = content["effects"]
    assert (
        claim["name"] == "input-delay:rudder"
        and abs(claim["parameters"]["delay"]["value"] - 0.12)
        < 3.0 * claim["parameters"]["delay"]["std"]
    )
    after = content["parameters"]["after"]
    assert all(
        abs(after[name]["value"] - flown.parameters[name].value) < 4.0 * after[name]["std"]
        for name in shares
    )


def test_only_what_finds_its_signals_is_offered(tmp_path: Path) -> None:
    model = read_user_model(model_file(tmp_path, ROLL_AND_YAW)).model
    offered = catch_all_terms_for(model.equations)
    able = can_act(offered, model)
    assert {guard.name for guard in able} <= {guard.name for guard in offered}
    # A vane behind the centre of gravity divides by the airspeed, which this model has not.
    assert not [guard.name for guard in able if guard.name == "guard:vane-behind"]
    rigid = own_rigid(RIGID_VALUES)
    assert {"sensor-delay:q", "input-delay"} <= {
        effect.name for effect in can_act(effects_for(rigid.equations), rigid)
    }


@pytest.mark.long
def test_nothing_is_found_where_nothing_is_missing(flightid: CommandLine, tmp_path: Path) -> None:
    path, model = declared(tmp_path)
    record = pushed(tmp_path, model, 4)
    printed = flightid.done("diagnose", record, "--model", path)
    assert "CONSISTENT" in printed and " m/s2 " in printed


@pytest.mark.long
def test_models_are_listed_and_shown(flightid: CommandLine) -> None:
    lines = flightid.done("models").splitlines()
    assert [line.split()[0] for line in lines] == list(MODELS)
    assert all(len(line) <= LIST_WIDTH and len(line.split()) > 3 for line in lines)
    for name in MODELS:
        printed = flightid.done("models", name)
        assert printed.startswith(f"{name}: ") and "effects that may act on it:" in printed
    assert "beta_dot = " in flightid.done("models", "lateral") and "Cn_dr (1/rad)" in flightid.done(
        "models", "lateral"
    )


def test_a_file_is_shown_and_checked(flightid: CommandLine, tmp_path: Path) -> None:
    printed = flightid.done("models", model_file(tmp_path, ROLL))
    for part in (
        "phi_dot = p",
        "states         p (rad/s), phi (rad)",
        "biases         p\n",
        "L_da (8 1/s2)",
        "p_rate (rad/s2, ",
        "units: all known",
    ):
        assert part in printed
    assert (
        "doublets of 0.75 s to each side on aileron 0.05 rad" in printed
        and "L_p            known to" in printed
    )


def test_what_a_doublet_does_not_show_is_told(flightid: CommandLine, tmp_path: Path) -> None:
    text = ROLL.replace(
        '"L_da": (8.0, "1/s2")}',
        '"L_da": (8.0, "1/s2"), "gain": (1.0, "parsnips"), "idle": (1.0, "1")}',
    )
    printed = flightid.done(
        "models",
        model_file(
            tmp_path,
            text.replace("p.L_da * s.aileron", "p.gain * p.L_da * s.aileron + 0.0 * p.idle"),
        ),
    )
    assert "no conversion for gain (parsnips)" in printed
    for part in (
        "L_da           not distinguishable from gain\n",
        "gain           not distinguishable from L_da\n",
        "idle           moves no output\n",
    ):
        assert part in printed


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["models", "rolll"], "there is no model 'rolll'; use one of ballistic, "),
        (["models", "gone.py"], "gone.py: there is no such file; "),
        (["identify", "record.csv", "--model", "three.py"], "three.py: its MODEL is of type int; "),
        (["diagnose", "record.csv", "--model", "three.py"], "three.py: its MODEL is of type int; "),
        (
            ["identify", "record.csv", "--model", "rigid"],
            "--vehicle: the rigid model needs constants and starting values; ",
        ),
        (
            ["identify", "record.csv", "--model", "roll.py"],
            "record.csv, header: there is no column 'aileron'",
        ),
        (
            ["identify", "record.csv", "--model", "roll.py", "--method", "filter-error"],
            "there is no column 'aileron'",
        ),
    ],
)
def test_one_line_and_exit_code_2(
    flightid: CommandLine,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    line: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    model_file(tmp_path, "MODEL = 3\n", "three.py")
    model_file(tmp_path, ROLL, "roll.py")
    (tmp_path / "record.csv").write_text("time,p,phi\n0,0,0\n1,0,0\n")
    assert line in flightid.refused(*arguments)
