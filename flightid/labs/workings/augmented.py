"""Lab 4: an unstable airframe with its control law, and the low-order equivalent system."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flightid.labs.workings import KEPT

if TYPE_CHECKING:
    from ident.flying_qualities.levels import Quality, QualityLevel
    from scenarios.identification.assessment import IdentificationResult
    from scenarios.x29.declaration import SimulatedLoop
    from sim.closed_loop.linear import EquivalentSystem

SCENARIO = "x29-flight"
AIRFRAMES = {"F, flight-like": "F", "S, simulation-like": "S"}
CATEGORY = "A"  # rapid maneuvering
DELAYS = (0.10, 0.20, 0.25)  # s, largest of levels 1 to 3: MIL-F-8785C 3.5.3


@dataclass(frozen=True, eq=False)
class Augmented:
    """A flight of the closed loop and its low-order equivalents.

    Attributes
    ----------
    flown : the flight.
    found : low-order system identified from the record.
    of_loop : low-order system that fits the frequency response of the loop.
    qualities, levels : flying qualities of ``found``, and their levels.
    """

    flown: SimulatedLoop
    found: IdentificationResult
    of_loop: EquivalentSystem
    qualities: tuple[Quality, ...]
    levels: tuple[QualityLevel, ...]


def changes(
    airframe: str = "F, flight-like",
    amplitude: float = 1.0,
    unit: float = 0.5,
    dead_band: float = 0.05,
    noise: bool = True,
) -> tuple[str, ...]:
    """Return the changes of the scenario.

    Parameters
    ----------
    airframe : a name of ``AIRFRAMES``.
    amplitude, unit : amplitude (inches) and time unit (s) of the 3-2-1-1 of the stick.
    dead_band : dead band of the stick, inches.
    noise : whether there is telemetry noise.
    """
    return (
        f"flight.airframe={AIRFRAMES[airframe]}",
        f"flight.stick.amplitude={amplitude:g}",
        f"flight.stick.unit={unit:g} s",
        f"flight.dead_band={dead_band:g}",
        f"flight.noise={'true' if noise else 'false'}",
    )


def vehicle_text(flown: SimulatedLoop) -> str:
    """Return the vehicle file for the identification.

    It has the flight condition, and rounded starting values from Table 1 of NASA
    TM-101722 (``docs/papers.md``).
    """
    from scenarios.x29.declaration import loop_constants

    constants = loop_constants(flown.x29)
    starts = {
        "L_alpha": -1.9,
        "M_alpha": -14.0,
        "L_delta": 0.0,
        "M_delta": 0.38,
        "L_q": 1.0,
        "M_q": -3.7,
        "inv_tau": 8.0,
        "delay": 0.08,
    }
    lines = [
        'name = "augmented"',
        'aircraft_class = "IV"',
        f'flight_phase = "{CATEGORY}"',
        *(f"{name} = {value:.6g}" for name, value in constants.items()),
        "[derivatives]",
    ]
    return "\n".join([*lines, *(f"{name} = {value!r}" for name, value in starts.items())]) + "\n"


@lru_cache(KEPT)
def study(changed: tuple[str, ...], seed: int = 1) -> Augmented:
    """Simulate the loop, and identify its record as ``flightid identify --model loes`` does.

    Raises FlightidError.
    """
    from ident.flying_qualities.levels import levels, qualities
    from scenarios.x29.declaration import fly_loop
    from scenarios.x29.study import loop_scenario
    from sim.closed_loop.linear import equivalent_system

    flown = fly_loop(loop_scenario(SCENARIO, changed).flight, seed)
    found = _identified(flown)
    airframe = flown.x29.airframe
    found_qualities = qualities(found.estimate, airframe.airspeed, airframe.gravity)
    of_category = tuple(
        level for level in levels(found_qualities) if level.criterion.category in (CATEGORY, "")
    )
    return Augmented(flown, found, equivalent_system(flown.x29), found_qualities, of_category)


def _identified(flown: SimulatedLoop) -> IdentificationResult:
    from scenarios.files.measured.columns import read_record_files
    from scenarios.files.vehicles import read_vehicle
    from scenarios.files.writing import write_record
    from scenarios.identification.identify import identify
    from scenarios.preparation.declared_model import model_of_file
    from scenarios.preparation.plan import Request, column_choices
    from scenarios.preparation.reading import prepare

    with tempfile.TemporaryDirectory(prefix="flightid-") as scratch:
        folder = Path(scratch)
        write_record(folder, flown.record, "flight")
        (folder / "augmented.toml").write_text(vehicle_text(flown), encoding="utf-8", newline="\n")
        request = Request((folder / "flight.csv",), "loes", folder / "augmented.toml")
        vehicle = read_vehicle(request.vehicle, request.model)
        ready = prepare(
            read_record_files(request.records),
            model_of_file(vehicle),
            request.plan,
            column_choices(request),
            use_measured_airspeed=True,
        )
        return identify(ready.fitted[0], vehicle, "output-error", (), ready.model)


def bare_airframe(flown: SimulatedLoop) -> np.ndarray:
    """Return the eigenvalues (1/s) of the airframe without control law, the unstable one last."""
    a = flown.x29.airframe
    return np.sort(np.linalg.eigvals(np.array([[a.L_alpha, a.L_q], [a.M_alpha, a.M_q]])).real)


def doubling_time(flown: SimulatedLoop) -> float:
    """Return the doubling time of the airframe without its control law, s."""
    return math.log(2.0) / float(bare_airframe(flown)[-1])


def responses(flight: Augmented, omega: np.ndarray) -> dict[str, np.ndarray]:
    """Return complex responses of pitch rate to stick (rad/s per inch), ``(n,)``.

    They are those of the whole loop, and of the equivalent system from the record. ``omega``:
    frequencies ``(n,)``, rad/s.
    """
    from sim.closed_loop.linear import equivalent_response, frequency_response

    values, airframe = flight.found.estimate.as_dict(), flight.flown.x29.airframe
    low = equivalent_response(values, omega, airframe.airspeed, airframe.gravity, values["L_q"])
    return {
        "the whole loop": frequency_response(flight.flown.x29, omega, recorded=True)[1],
        "equivalent system, from the record": low[1],
    }


def quality(flight: Augmented, name: str) -> float:
    """Return a flying-qualities parameter by its name."""
    return next(item.value for item in flight.qualities if item.name == name)


def key_numbers(
    airframe: str = "F, flight-like",
    amplitude: float = 1.0,
    unit: float = 0.5,
    dead_band: float = 0.05,
    noise: bool = True,
    seed: int = 1,
) -> dict[str, float]:
    """Return the numbers that the answer key of the lab gives for one flight; delays in ms,
    ``M_delta`` per inch of stick.
    """
    flight = study(changes(airframe, amplitude, unit, dead_band, noise), seed)
    rows = {row.name: row.estimate for row in flight.found.rows}
    return {
        "M_alpha of the airframe": flight.flown.x29.airframe.M_alpha,
        "doubles in": doubling_time(flight.flown),
        **{name: rows[name] for name in ("M_alpha", "M_q", "M_delta", "inv_tau")},
        "frequency": quality(flight, "natural_frequency"),
        "damping": quality(flight, "damping_ratio"),
        "delay": 1000.0 * rows["delay"],
        "total delay": 1000.0 * quality(flight, "total_delay"),
        "tests failed": float(sum(not test.passed for test in flight.found.tests)),
    }


def level_of_delay() -> str:
    """Return the level that the delay of the flight-like airframe allows."""
    delay = key_numbers()["delay"] / 1000.0
    return next(
        (f"Level {level}" for level, bound in enumerate(DELAYS, start=1) if delay <= bound), "none"
    )


def most_constant() -> str:
    """Return which of four quantities changes least, relative to its size, with the maneuver.

    The maneuvers have units of 0.2, 0.5 and 1 s.
    """
    found = [key_numbers(unit=unit) for unit in (0.2, 0.5, 1.0)]
    words = {
        "inv_tau": "inv_tau",
        "M_q": "M_q",
        "delay and lag together": "total delay",
        "M_alpha": "M_alpha",
    }
    spread = {
        word: np.ptp([flight[name] for flight in found]) / abs(found[1][name])
        for word, name in words.items()
    }
    return min(spread, key=lambda word: spread[word])
