"""Lab 5: a record with a hidden effect, drawn from a seed; its diagnosis, and the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flightid.labs.workings import Scratch

if TYPE_CHECKING:
    import flightid
    from sim.record import Record

# Scenario with and without a hidden effect.
BASE = {True: "trace-delay", False: "trace-nothing"}
# Low rate and short records, for a quick diagnosis. Each maneuver still switches at a sample.
SHORT = ("flight.rate=20 Hz", "flight.train.duration=18 s", "flight.validate.duration=14 s")
NOTHING = "nothing: noise alone"


@dataclass(frozen=True)
class Suspect:
    """An effect that may be hidden.

    Attributes
    ----------
    name : name in ``flightid effects``.
    shows : its signature in words.
    values : range of each value, SI, from which it is drawn.
    elsewhere : values that differ in the second record.
    """

    name: str
    shows: str
    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    elsewhere: Mapping[str, float] = field(default_factory=dict)


# By the words of the lab. Effects without values are never drawn; they are to be ruled out.
SUSPECTS: Mapping[str, Suspect] = {
    NOTHING: Suspect("", "white residuals of the size of the noise, in all channels"),
    "the elevator acts later than recorded": Suspect(
        "input-delay",
        "a spike in **all** channels after each step of the elevator, strongest in q",
        {"delay": (0.05, 0.09)},
    ),
    "the pitch-rate gyro is late": Suspect(
        "sensor-delay:q",
        "spikes in **q** after each step of the elevator, hardly any in α and nz",
        {"delay": (0.07, 0.12)},
    ),
    "the α vane sits ahead of the centre of gravity": Suspect(
        "vane-offset",
        "a residual of **α** that looks like q itself: the vane measures α − (arm/V) q",
        {"arm": (8.0, 14.0)},
    ),
    "a dead band in the elevator linkage": Suspect(
        "input-deadband",
        "errors that depend on the **size** of the deflection: large and small maneuvers cannot "
        "both be fitted",
        {"half_width": (0.01, 0.016)},
    ),
    "one vertical gust": Suspect(
        "gust-discrete",
        "a bump in α and nz **at one time**, with no elevator before it",
        {"peak": (3.0, 5.0), "start": (12.8, 13.6), "duration": (1.0, 1.4)},
        {"start": 11.0},
    ),
    "the α sensor drifts": Suspect(
        "sensor-drift:alpha",
        "a residual of **α** alone that grows slowly and steadily",
        {"slope": (0.0012, 0.002)},
    ),
    "the static stability changes during the flight": Suspect(
        "derivative-jump",
        "each of two parts of the record could be fitted alone; the oscillation has another "
        "frequency **from one time on**",
        {"time": (8.5, 9.5), "Cm_alpha": (0.25, 0.4)},
        {"time": 6.0},
    ),
    "an elastic mode rings": Suspect(
        "elastic-mode",
        "an oscillation after each step of the elevator at **one frequency** well above the short "
        "period",
    ),
    "the air is rough": Suspect(
        "gust-turbulence",
        "a coloured residual in α and nz **all the time**, also between the maneuvers",
    ),
}
# Hidden effect of the first seed: the same for a whole class, and possible to find.
FIRST = "the α vane sits ahead of the centre of gravity"
FIRST_SEED = 1


@dataclass(frozen=True, eq=False)
class Flown:
    """Both records, vehicle file and sensor noise, in a temporary folder without the truth."""

    folder: Scratch
    train: Record
    noise: Mapping[str, float]

    def path(self, name: str) -> Path:
        """Return ``train.csv``, ``validate.csv`` or ``vehicle.toml``."""
        return self.folder.path / name


def drawn(seed: int) -> tuple[str, dict[str, float]]:
    """Return the hidden effect of a seed in the words of the lab, and its values, SI."""
    rng = np.random.default_rng([seed, 5])
    hidden = [words for words, suspect in SUSPECTS.items() if suspect.values or words == NOTHING]
    words = FIRST if seed == FIRST_SEED else hidden[int(rng.integers(len(hidden)))]
    return words, {
        name: float(rng.uniform(*bounds)) for name, bounds in SUSPECTS[words].values.items()
    }


def changes(seed: int) -> tuple[str, tuple[str, ...]]:
    """Return the scenario and its changes for the effect that the seed selects."""
    words, values = drawn(seed)
    suspect = SUSPECTS[words]
    if not suspect.name:
        return BASE[False], SHORT
    inside = ", ".join(f"{name} = {value!r}" for name, value in values.items())
    elsewhere = ", ".join(f"{name} = {value!r}" for name, value in suspect.elsewhere.items())
    table = (
        f'{{name = "{suspect.name}", values = {{{inside}}}'
        + (f", elsewhere = {{{elsewhere}}}" if elsewhere else "")
        + "}"
    )
    return BASE[True], (*SHORT, f"hidden=[{table}]")


@lru_cache(16)
def flown(seed: int) -> Flown:
    """Return the two flights of a seed."""
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.planted_flights import fly_trace, trace_scenario_of, write_simulated

    found = fly_trace(trace_scenario_of(*load_document(*changes(seed))), seed)
    folder = Scratch()
    write_simulated(found, folder.path)
    return Flown(folder, found.train, found.noise_std)


@lru_cache(16)
def fitted(seed: int) -> flightid.Identification:
    """Return the fit of the rigid model to the first record."""
    import flightid

    given = flown(seed)
    return flightid.identify(
        given.path("train.csv"),
        "rigid",
        given.path("vehicle.toml"),
        validate=given.path("validate.csv"),
    )


def residuals(seed: int) -> dict[str, np.ndarray]:
    """Return the residuals of the rigid model by output, ``(N,)``, SI."""
    inner = fitted(seed).details.found
    names = inner.estimate.output_names
    z, valid = inner.record.output_array(names)
    return dict(zip(names, np.where(valid, z - inner.estimate.fitted[0], 0.0), strict=True))


@lru_cache(16)
def diagnosed(seed: int) -> flightid.Diagnosis:
    """Return the diagnosis of the same files."""
    import flightid

    given = flown(seed)
    return flightid.diagnose(
        given.path("train.csv"),
        "rigid",
        given.path("vehicle.toml"),
        validate=given.path("validate.csv"),
    )


def names_of_loop(seed: int) -> tuple[str, ...]:
    """Return the effects that the diagnosis claims."""
    return tuple(effect.name for effect in diagnosed(seed).effects)


def found_by_loop(seed: int) -> bool:
    """Return whether exactly the hidden effect is claimed, or nothing if there is none."""
    words, _ = drawn(seed)
    name = SUSPECTS[words].name
    return names_of_loop(seed) == ((name,) if name else ())
