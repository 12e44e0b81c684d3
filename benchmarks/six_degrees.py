"""How long six degrees of freedom take: an output-error fit, structure determination.

    python benchmarks/six_degrees.py [--runs N]

The fit has 25 coefficients and 11 outputs of 4001 samples (scenario `aircraft-uav` at 200 Hz); its
ratio is that of SciPy's least_squares on the Python module that `flightid export` writes of the
same aircraft. That loop fits the first 101 samples and is scaled to all. The structure is of fifty
maneuvers of 1001 samples (scenario `aircraft-airliner`), both methods, with the pages left out.
"""

from __future__ import annotations

import argparse
import importlib.util
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
if TYPE_CHECKING:
    from scenarios.studies.declaration import Scenario
    from sim.record import Record

FAST = ('flight.rate="200 Hz"', 'flight.step="0.005 s"')
FIT_LIMIT, STRUCTURE_LIMIT = 5.0, 10.0  # s of processor time asked for
SHORT = 101  # samples that the loop fits
MANEUVERS = 50


def seconds(work: Callable[[], object], runs: int) -> float:
    """Median processor seconds of ``runs`` calls of ``work``, one before them not counted."""
    work()
    spent = []
    for _ in range(runs):
        begin = time.process_time()
        work()
        spent.append(time.process_time() - begin)
    return statistics.median(spent)


def flown(name: str, changes: tuple[str, ...], seed: int = 1) -> tuple[Scenario, Record]:
    """A scenario with ``changes`` as of --set, and the record of its flight."""
    from scenarios.studies.catalogue import load_scenario
    from scenarios.studies.estimating import fly_scenario

    scenario = load_scenario(name, changes)
    return scenario, fly_scenario(scenario, seed)[0]


def exported(scenario: Scenario, folder: Path) -> ModuleType:
    """The Python module that `flightid export` writes of the scenario's vehicle."""
    from scenarios.export.targets import written_model

    file, _, _ = written_model(
        Path(scenario.flight.vehicle), "python", folder / "exported_vehicle.py", None
    )
    spec = importlib.util.spec_from_file_location("exported_vehicle", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def loop_fit(module: ModuleType, scenario: Scenario, record: Record) -> Callable[[], object]:
    """SciPy's least_squares on the simulation loop of an exported module: coefficients from the
    scenario's starts, the motion from the true state, the noise known.
    """
    from scipy.optimize import least_squares

    start = {name: each.value for name, each in scenario.estimations[0].start.items()}
    names, first = list(start), np.array(list(start.values()))
    z = np.array([record[name].values for name in module.OUTPUTS])
    u = np.array([record[name].values for name in module.INPUTS])
    noise = np.array([scenario.flight.noise_std[name] for name in module.OUTPUTS])[:, None]

    def misfit(p: np.ndarray) -> np.ndarray:
        values = dict(zip(names, p.tolist(), strict=True))
        found, _ = module.simulate(record.time, u, parameters=values)
        return np.asarray((z - found) / noise).ravel()

    return lambda: least_squares(misfit, first, x_scale=np.abs(first), xtol=1e-6, ftol=1e-6)


def fit_seconds(folder: Path, runs: int) -> None:
    """Print the time of the fit, the share of its sigmas, and the ratio of the loop to it."""
    from ident.whole_record.layout import FitSettings
    from ident.whole_record.output_error import fit_output_error
    from scenarios.studies.estimating import (
        assumed_noise,
        biased_system,
        declared_model,
        flight_constants,
    )

    scenario, record = flown("aircraft-uav", FAST)
    estimation = scenario.estimations[0]
    constants = flight_constants(scenario.flight, estimation)
    system = biased_system(
        estimation,
        declared_model(estimation, constants, assumed_noise(scenario, estimation)),
    )

    def fitted(coloured: bool) -> object:
        return fit_output_error([record], system, FitSettings(coloured=coloured))

    whole, white = (seconds(partial(fitted, each), runs) for each in (True, False))
    print(
        f"output error, {len(estimation.start)} coefficients, {len(record.outputs)} outputs, "
        f"{len(record)} samples: {whole:.2f} s of processor time (asked {FIT_LIMIT:g}), of which "
        f"{whole - white:.2f} s for sigmas of coloured residuals",
        flush=True,
    )
    short = record.window(record.time[0], record.time[SHORT - 1])
    loop = loop_fit(exported(scenario, folder), scenario, short)
    begin = time.process_time()
    loop()
    scaled = (time.process_time() - begin) * len(record) / SHORT
    print(
        f"SciPy, least_squares on a plain loop, scaled from {SHORT} samples: {scaled:.0f} s, "
        f"{scaled / whole:.0f} x",
        flush=True,
    )


def structure_seconds(runs: int) -> None:
    """Print the time in which the terms of fifty maneuvers are found."""
    from scenarios.files.aircraft_files import read_aircraft
    from scenarios.files.declarations import read_toml_source
    from scenarios.structure import StructureOptions, structure_of

    changes = ('flight.duration="40 s"',)
    scenario, first = flown("aircraft-airliner", changes)
    records = [first, *(flown("aircraft-airliner", changes, n)[1] for n in range(2, MANEUVERS + 1))]
    aircraft = read_aircraft(read_toml_source(Path(scenario.flight.vehicle)))[0]
    named = [replace(record, name=f"m{n}") for n, record in enumerate(records)]
    spent = seconds(lambda: structure_of(named, aircraft, StructureOptions(degree=2)), runs)
    print(
        f"structure, {MANEUVERS} maneuvers of {len(first)} samples: {spent:.2f} s of processor "
        f"time (asked {STRUCTURE_LIMIT:g})",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3)
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as temporary:
        fit_seconds(Path(temporary), runs)
    structure_seconds(runs)


if __name__ == "__main__":
    main()
