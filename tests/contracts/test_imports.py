"""What an import of the lower rooms may bring along: nothing heavy, and for ident nothing that
knows the answer.
"""

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
HEAVY = (
    "control",
    "filterpy",
    "matplotlib",
    "pandas",
    "pint",
    "pydantic",
    "scipy.optimize",
    "scipy.signal",
)
# Modules of sim that know a vehicle, an effect or the truth; ident must not see them.
CONCRETE = ("sim.closed_loop", "sim.data", "sim.effects", "sim.truth", "sim.vehicles")
# What a module may import at import time after all; with a package comes whatever that package
# itself brings.
ALLOWED = {"ident.filters.ekf": ("filterpy.kalman",), "ident.filters.ukf": ("filterpy.kalman",)}

# One process imports every target and notes which module asked for which; what a target brings
# along is all that can be reached from it. What a function imports counts for the module that runs
# it while it is imported itself.
PROBE = """
import builtins, importlib, json, sys
from importlib.util import resolve_name
targets, watched = json.load(sys.stdin)
asked = {}
plain, by_name = builtins.__import__, importlib.import_module
def importing():
    frame = sys._getframe(2)
    while frame is not None and (frame.f_code.co_name != "<module>" or "__name__" not in frame.f_globals):
        frame = frame.f_back
    return frame.f_globals["__name__"] if frame is not None else ""
def noted(name, globals=None, locals=None, fromlist=(), level=0):
    found = plain(name, globals, locals, fromlist, level)
    importer = importing()
    inside = globals or {}
    package = inside.get("__package__") or inside.get("__name__", "").rpartition(".")[0]
    full = resolve_name("." * level + name, package) if level else name
    for each in (full, *(f"{full}.{part}" for part in fromlist or ())):
        if each in sys.modules:
            asked.setdefault(importer, set()).add(each)
    return found
def noted_by_name(name, package=None):
    asked.setdefault(importing(), set()).add(resolve_name(name, package))
    return by_name(name, package)
builtins.__import__, importlib.import_module = noted, noted_by_name
for target in targets:
    by_name(target)
def brought(target):
    seen, left = set(), [target]
    while left:
        name = left.pop()
        while name and name not in seen:  # with a module come the packages that it lies in
            seen.add(name)
            left += asked.get(name, ())
            name = name.rpartition(".")[0]
    return seen
for target in targets:
    print(json.dumps([target, sorted(brought(target).intersection(watched))]))
"""  # noqa: E501
# The same of one target in a process that holds nothing else.
ALONE = (
    "import importlib, json, sys; importlib.import_module(sys.argv[1]); "
    "print(json.dumps(sorted({*sys.argv[2:]}.intersection(sys.modules))))"
)


def modules_of(room: str) -> list[str]:
    """Dotted names of all modules of a package, found as files so that nothing is imported here."""
    paths = [path.relative_to(ROOT).with_suffix("") for path in sorted((ROOT / room).rglob("*.py"))]
    return [".".join(path.parts[:-1] if path.name == "__init__" else path.parts) for path in paths]


def loaded_by(targets: Iterable[str], watched: Iterable[str]) -> dict[str, list[str]]:
    """Which of the watched modules the import of each target brings along."""
    request = json.dumps([sorted(targets), sorted(watched)])
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, "-c", PROBE],
        input=request,
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    return dict(json.loads(line) for line in run.stdout.splitlines())


MODULES = modules_of("sim") + modules_of("ident")


@pytest.fixture(scope="module")
def loaded() -> dict[str, list[str]]:
    extra = {package for packages in ALLOWED.values() for package in packages}
    return loaded_by({*MODULES, *extra, "scipy.stats"}, HEAVY + CONCRETE)


@pytest.mark.long
@pytest.mark.parametrize("module", MODULES)
def test_import_brings_nothing_heavy(module: str, loaded: dict[str, list[str]]) -> None:
    answer = loaded[module]
    permitted = {name for package in ALLOWED.get(module, ()) for name in loaded[package]}
    assert {*answer} & {*HEAVY} <= permitted


@pytest.mark.parametrize("module", modules_of("ident"))
def test_import_of_ident_brings_no_vehicle_effect_or_truth(
    module: str, loaded: dict[str, list[str]]
) -> None:
    answer = loaded[module]
    assert not {*answer} & {*CONCRETE}


@pytest.mark.long
def test_probe_sees_a_heavy_import() -> None:
    assert "filterpy" in loaded_by(["filterpy.kalman"], HEAVY)["filterpy.kalman"]


@pytest.mark.sampled
@pytest.mark.parametrize(
    "module",
    [
        "ident.filters.ekf",
        "ident.tracing.loop",
        "sim.closed_loop.nonlinear",
        "sim.vehicles.factory",
        "scipy.stats",
    ],
)
def test_the_probe_says_what_a_process_of_its_own_says(
    module: str, loaded: dict[str, list[str]]
) -> None:
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, "-c", ALONE, module, *HEAVY, *CONCRETE],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert loaded[module] == json.loads(run.stdout)


def test_contract_of_ident_names_every_concrete_module() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "importlinter"
    ]["contracts"]
    (blind,) = [contract for contract in declared if contract["name"].startswith("ident is blind")]
    expected = {*CONCRETE} & {*modules_of("sim")}
    assert {*blind["forbidden_modules"]} == expected, (
        f"set forbidden_modules in pyproject.toml to {sorted(expected)}"
    )


@pytest.mark.parametrize("room", ["sim", "ident", "scenarios", "flightid", "exam"])
def test_every_folder_with_modules_is_a_package(room: str) -> None:
    # The import contracts do not look into a folder without __init__.py.
    folders = {path.parent for path in (ROOT / room).rglob("*.py")}
    assert not [folder for folder in folders if not (folder / "__init__.py").exists()]
