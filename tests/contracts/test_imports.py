"""What an import of the lower rooms may bring along: nothing heavy, and for ident nothing that knows the answer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEAVY = ("control", "filterpy", "matplotlib", "pandas", "pint", "pydantic", "scipy.optimize", "scipy.signal")
# Modules of sim that know a vehicle, an effect or the truth; ident must not see them.
CONCRETE = ("sim.closed_loop", "sim.data", "sim.effects", "sim.truth", "sim.vehicles")
# What a module may import at import time after all; with a package comes whatever that package itself brings.
ALLOWED = {"ident.filters.ekf": ("filterpy.kalman",), "ident.filters.ukf": ("filterpy.kalman",)}

# Each target is imported in a fork of a process that holds numpy alone: as clean as a fresh process, and much faster.
PROBE = """
import importlib, json, os, sys, traceback
import numpy
targets, watched = json.load(sys.stdin)
for target in targets:
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        try:
            importlib.import_module(target)
            answer = [name for name in watched if name in sys.modules]
        except BaseException:
            answer = traceback.format_exc()
        print(json.dumps([target, answer]), flush=True)
        os._exit(0)
    os.waitpid(child, 0)
"""


def modules_of(room: str) -> list[str]:
    """Dotted names of all modules of a package, found as files so that nothing is imported here."""
    paths = [path.relative_to(ROOT).with_suffix("") for path in sorted((ROOT / room).rglob("*.py"))]
    return [".".join(path.parts[:-1] if path.name == "__init__" else path.parts) for path in paths]


def loaded_by(targets: Iterable[str], watched: Iterable[str]) -> dict[str, list[str]]:
    """Which of the watched modules the import of each target leaves in ``sys.modules``."""
    request = json.dumps([sorted(targets), sorted(watched)])
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    run = subprocess.run([sys.executable, "-c", PROBE], input=request, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    return dict(json.loads(line) for line in run.stdout.splitlines())


MODULES = modules_of("sim") + modules_of("ident")


@pytest.fixture(scope="module")
def loaded() -> dict[str, list[str]]:
    extra = {package for packages in ALLOWED.values() for package in packages}
    return loaded_by({*MODULES, *extra}, HEAVY + CONCRETE)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the probe forks")
@pytest.mark.parametrize("module", MODULES)
def test_import_brings_nothing_heavy(module: str, loaded: dict[str, list[str]]) -> None:
    answer = loaded[module]
    assert isinstance(answer, list), answer
    permitted = {name for package in ALLOWED.get(module, ()) for name in loaded[package]}
    assert {*answer} & {*HEAVY} <= permitted


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the probe forks")
@pytest.mark.parametrize("module", modules_of("ident"))
def test_import_of_ident_brings_no_vehicle_effect_or_truth(module: str, loaded: dict[str, list[str]]) -> None:
    answer = loaded[module]
    assert isinstance(answer, list), answer
    assert not {*answer} & {*CONCRETE}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the probe forks")
def test_probe_sees_a_heavy_import() -> None:
    assert "filterpy" in loaded_by(["filterpy.kalman"], HEAVY)["filterpy.kalman"]


def test_contract_of_ident_names_every_concrete_module() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    (blind,) = [contract for contract in declared if contract["name"].startswith("ident is blind")]
    expected = {*CONCRETE} & {*modules_of("sim")}
    assert {*blind["forbidden_modules"]} == expected, f"set forbidden_modules in pyproject.toml to {sorted(expected)}"


@pytest.mark.parametrize("room", ["sim", "ident", "scenarios", "flightid"])
def test_every_folder_with_modules_is_a_package(room: str) -> None:
    # The import contracts do not look into a folder without __init__.py.
    folders = {path.parent for path in (ROOT / room).rglob("*.py")}
    assert not [folder for folder in folders if not (folder / "__init__.py").exists()]
