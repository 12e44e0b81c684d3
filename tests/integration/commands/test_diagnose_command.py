"""`flightid diagnose` from the command line: exit codes, single lines, files, and what it must not
load.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scenarios.cli import main
from scenarios.cli.application import each_validated
from scenarios.files.writing import write_record
from scenarios.preparation.declared_model import model_of_file
from sim.declaration.model import Noise
from sim.maneuvers import three_two_one_one
from sim.truth.flight import fly, sample_times
from tests.diagnoses import NOISE, RIGID, written_inputs

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "docs" / "how-to" / "own-effect.md"
FORBIDDEN = (
    "control",
    "filterpy",
    "scipy.signal",
    "scipy.optimize",
    "pint",
    "pandas",
    "matplotlib.pyplot",
)
WATCHED = f"""
import sys
from scenarios.cli import main
from scenarios.report import terminal
terminal.EVERY = 1e6  # s; a busy machine would tell how far it is
try:
    main()
finally:
    print([name for name in {FORBIDDEN!r} if name in sys.modules], file=sys.stderr)
"""


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two records of an aircraft whose vane is turned as the documented effect says, and its
    vehicle file 10 % off.
    """
    folder = tmp_path_factory.mktemp("flights")
    _, _, vehicle = written_inputs(folder)
    own = folder / "my_effects.py"
    own.write_text(EXAMPLE.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0])
    from scenarios.diagnosis.opening import read_effects

    model = model_of_file(RIGID)
    turned = model.with_effects(*read_effects(own, model)).with_values({"vane-upwash.upwash": 0.2})
    turned = turned.with_noise(Noise({name: NOISE[name] for name in ("alpha", "q", "nz")}))
    for stem, size, unit, seed in (("train", -0.06, 0.8, 1), ("validate", 0.05, 0.6, 2)):
        record, _ = fly(
            turned,
            three_two_one_one(size, unit, 1.0),
            sample_times(25.0, 10.0),
            np.random.default_rng(seed),
            step=0.01,
        )
        write_record(folder, record, stem)
    lines = [f"{key} = {value}" for key, value in RIGID.constants.items()] + ["[derivatives]"]
    vehicle.write_text(
        "\n".join([*lines, *(f"{key} = {1.1 * value}" for key, value in RIGID.derivatives.items())])
    )
    return folder


def run(
    *arguments: object, code: str = "from scenarios.cli import main; main()"
) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", code, *(str(argument) for argument in arguments)]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=300, cwd=ROOT
    )


def test_documented_effect_is_traced_and_written(flights: Path, tmp_path: Path) -> None:
    arguments = [
        "diagnose",
        flights / "train.csv",
        "--model",
        "rigid",
        "--vehicle",
        flights / "vehicle.toml",
    ]
    arguments += [
        "--validate",
        flights / "validate.csv",
        "--effects",
        flights / "my_effects.py",
        "--out",
        tmp_path / "out",
    ]
    done = run(*arguments, code=WATCHED)
    assert done.returncode == 0, done.stderr
    # Where no terminal is nothing but progress belongs on stderr.
    *progress, modules = done.stderr.splitlines()
    assert modules == "[]", "modules that a diagnosis must do without"
    assert all(line.startswith("flightid: ") for line in progress)
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_bytes())
    assert content["verdict"] == "traced"
    (effect,) = content["effects"]
    assert effect["name"] == "vane-upwash"
    found = effect["parameters"]["upwash"]
    assert abs(found["value"] - 0.2) < 4.0 * found["std"]
    assert "the control surface turns the vane" in done.stdout
    assert (
        content["error"]["after"]["rmse"]["alpha"]
        < 0.5 * content["error"]["before"]["rmse"]["alpha"]
    )
    measured = (flights / "validate.csv").read_text().splitlines()
    predicted = (tmp_path / "out" / "validate_prediction.csv").read_text().splitlines()
    assert len(predicted) == len(measured)
    assert predicted[0] == "time,before_alpha,before_q,before_nz,after_alpha,after_q,after_nz"
    assert all(math.isfinite(float(cell)) for line in predicted[1:] for cell in line.split(","))
    # The printed error is that of the written prediction.
    alpha = np.array([float(line.split(",")[2]) for line in measured[1:]])
    after = np.array([float(line.split(",")[4]) for line in predicted[1:]])
    assert math.sqrt(np.mean((alpha - after) ** 2)) == pytest.approx(
        content["error"]["after"]["rmse"]["alpha"], rel=1e-6
    )
    assert (tmp_path / "out" / "held_out.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["diagnose"], "missing argument 'RECORD...'"),
        (["diagnose", "TRAIN"], "missing option '--model'"),
        (
            ["diagnose", "TRAIN", "--model", "glider"],
            "--model: there is no model 'glider'; use one of ballistic, rigid, flexible, loes",
        ),
        (
            ["diagnose", "no.csv", "--model", "rigid", "--vehicle", "VEHICLE"],
            "no.csv: there is no such file",
        ),
        (
            ["diagnose", "TRAIN", "--model", "rigid", "--vehicle", "no.toml"],
            "no.toml: there is no such file",
        ),
        (
            ["diagnose", "TRAIN", "--model", "loes", "--vehicle", "VEHICLE"],
            "vehicle.toml: this vehicle file is for the rigid model",
        ),
        (
            ["diagnose", "TRAIN", "--model", "rigid", "--validate", "TRAIN"],
            "the record is named twice",
        ),
        (
            ["diagnose", "TRAIN", "--model", "rigid", "--class", "V"],
            "--class: there is no class 'V'",
        ),
        (
            ["diagnose", "TRAIN", "--model", "rigid", "--effects", "no.py"],
            "no.py: there is no such file",
        ),
        (
            ["diagnose", "TRAIN", "--model", "rigid", "--vehicle", "VEHICLE", "--effects", "RANK"],
            "rank.py: effect vane-upwash: unknown attribute 'rank'; its present name is "
            "'path_order'",
        ),
        (
            ["diagnose", "TRAIN", "--model", "rigid", "--from", "9"],
            "rows are too few to hold a part out",
        ),
        (
            ["diagnose", "TRAIN", "--model", "rigid", "--from", "99"],
            "there is no row between --from and --to",
        ),
        (["diagnose", "TRAIN", "--model", "rigid", "--frm", "1"], "no such option"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str], line: str, flights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {
        "TRAIN": str(flights / "train.csv"),
        "VEHICLE": str(flights / "vehicle.toml"),
        "RANK": str(flights / "rank.py"),
    }
    own = (flights / "my_effects.py").read_text()
    (flights / "rank.py").write_text(own.replace("    channel", "    rank = 30\n    channel"))
    with pytest.raises(SystemExit) as stopped:
        main([places.get(argument, argument) for argument in arguments])
    told = capsys.readouterr()
    assert stopped.value.code == 2
    assert told.out == "" and told.err.count("\n") == 1
    assert line in told.err


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (
            "diagnose a.csv --model rigid --validate b.csv c.csv --out o",
            "diagnose a.csv --model rigid --validate b.csv --validate c.csv --out o",
        ),
        (
            "diagnose a.csv --validate b.csv --validate c.csv --model rigid",
            "diagnose a.csv --validate b.csv --validate c.csv --model rigid",
        ),
        ("diagnose a.csv x.csv --validate b.csv", "diagnose a.csv x.csv --validate b.csv"),
        (
            "diagnose --model rigid --validate b.csv a.csv",
            "diagnose --model rigid --validate b.csv a.csv",
        ),
        (
            "diagnose a.csv --validate b.csv c.csv --no-figures",
            "diagnose a.csv --validate b.csv --validate c.csv --no-figures",
        ),
        (
            "diagnose --no-figures a.csv --validate b.csv c.csv",
            "diagnose --no-figures a.csv --validate b.csv --validate c.csv",
        ),
        (
            "identify a.csv --validate b.csv c.csv",
            "identify a.csv --validate b.csv --validate c.csv",
        ),
        (
            "identify a.csv --profile p q --model m",
            "identify a.csv --profile p --profile q --model m",
        ),
        ("identify a.csv --profile --model m", "identify a.csv --profile all --model m"),
        ("identify --profile a.csv --model m", "identify --profile all a.csv --model m"),
        (
            "identify --band 0.1 2 --model m a.csv --profile",
            "identify --band 0.1 2 --model m a.csv --profile all",
        ),
        (
            "identify --band 0.1 2 --validate b.csv a.csv",
            "identify --band 0.1 2 --validate b.csv a.csv",
        ),
        (
            "identify --validate b.csv a.csv --profile",
            "identify --validate b.csv a.csv --profile all",
        ),
        (
            "identify --profile --validate b.csv a.csv",
            "identify --profile all --validate b.csv a.csv",
        ),
        ("check a.csv --validate b.csv c.csv", "check a.csv --validate b.csv c.csv"),
    ],
)
def test_validate_takes_every_record_up_to_the_next_option(given: str, meant: str) -> None:
    assert each_validated(given.split()) == meant.split()


def test_failed_run_leaves_no_process_and_no_folder(flights: Path, tmp_path: Path) -> None:
    done = run(
        "diagnose",
        flights / "nothing.csv",
        "--model",
        "rigid",
        "--vehicle",
        flights / "vehicle.toml",
        "--out",
        tmp_path / "out",
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
