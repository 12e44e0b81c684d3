"""Lab 8: a sweep of a small aircraft's roll loop: response, margins, and the direct estimate."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from flightid.labs.workings import KEPT

if TYPE_CHECKING:
    from scenarios.responses.analysis import ResponseEstimates
    from scenarios.trials.sweeps import SweepStudy

SCENARIO = "uav-sweep"
SEED = 1
GAINS = (0.11, 0.16, 0.22, 0.3, 0.44)  # command per rad/s
DELAYS = (12.0, 22.0, 32.0, 42.0, 52.0)  # ms
ENOUGH = 45.0  # deg, of MIL-F-9490D


def changes(
    gain: float = 0.22, delay: float = 32.0, amplitude: float = 0.15, gyro: float = 1.0
) -> tuple[str, ...]:
    """Return the changes of the scenario.

    They are gain of the law, delay (ms), amplitude of the sweep (of a full command), and gyro noise
    (deg/s).
    """
    return (
        f"loop.proportional={gain:g}",
        f"loop.delay={delay:g} ms",
        f"sweep.amplitude={amplitude:g}",
        f"noise.gyro={gyro:g} deg/s",
    )


@lru_cache(KEPT)
def study(changed: tuple[str, ...]) -> SweepStudy:
    """Return the flights and their estimates. Errors as ``run_sweep``."""
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.sweeps import run_sweep, sweep_scenario_of

    return run_sweep(sweep_scenario_of(*load_document(SCENARIO, changed)), SEED)


@lru_cache(KEPT)
def without_excitation(changed: tuple[str, ...]) -> ResponseEstimates:
    """Return the broken-loop response by the direct estimate, which does not use the sweep."""
    from scenarios.files.writing import write_record
    from scenarios.preparation.plan import Request
    from scenarios.responses.analysis import ResponseOptions, responses_of
    from scenarios.responses.reading import Names

    found = study(changed)
    with TemporaryDirectory(prefix="flightid-") as folder:
        paths = tuple(
            write_record(Path(folder), record, f"flight{n}", simulated=True)[0]
            for n, record in enumerate(found.records, 1)
        )
        return responses_of(
            Request(paths),
            Names(("command",), ("returned",)),
            ResponseOptions(found.scenario.band),
            margins="minus",
        )


def key_numbers(
    gain: float = 0.22, delay: float = 32.0, amplitude: float = 0.15, gyro: float = 1.0
) -> dict[str, float]:
    """Return the numbers of the key: true and estimated margins, model, and direct estimate.

    Numbers that the usable band does not show are zero.
    """
    changed = changes(gain, delay, amplitude, gyro)
    found = study(changed)
    rows = {row.name: row for row in found.rows}
    estimates = {name: row.estimate for name, row in rows.items()}
    loop = without_excitation(changed).loop
    direct = loop.margins.distance if loop is not None else None
    return {
        "phase margin": rows["phase_margin"].estimate,
        "true phase margin": rows["phase_margin"].true or 0.0,
        "sigma of it": rows["phase_margin"].std,
        "gain increase": estimates.get("gain_increase", 0.0),
        "1/T_roll": rows["inv_T_roll"].estimate,
        "delay, ms": 1000.0 * rows["delay"].estimate,
        "distance": estimates.get("distance", 0.0),
        "distance, direct": direct.size.value if direct is not None else 0.0,
    }


def longest_delay() -> float:
    """Return the longest delay of the slider (ms) with a sufficient true phase margin."""
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.sweeps import sweep_scenario_of, true_margins

    def margin(delay: float) -> float:
        scenario = sweep_scenario_of(*load_document(SCENARIO, changes(delay=delay)))
        return true_margins(scenario)["phase_margin"]

    return max(delay for delay in DELAYS if margin(delay) >= ENOUGH)
