"""Flights by JSBSim with one fault each, as folders that `tests.independent.examine` reads.

python -m tests.independent.fly OUT --aircraft A320 T38 --fault nothing late-alpha --seed 1
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.independent.catalogue import FAULTS, FIRST, Planted
from tests.independent.flight import Flight, Vehicle
from tests.independent.folders import Recording, write_flight
from tests.independent.jsbsim_aircraft import AIRCRAFT, Aircraft, Condition
from tests.independent.jsbsim_flight import RoughAir, bend_of, fly, vehicle_of
from tests.independent.maneuvers import Maneuver, tick_for, training, validation
from tests.independent.recording import EVERY, USUAL

# of full command, in the small motion that tells derivatives and how much elevator the maneuver
# needs
REHEARSED = 0.02
MOST_LOST = 1e-3  # of the variance of a load in the small motion
# sigmas: over two records of 1200 samples a bend of this size gains 4 in log likelihood, which
# nobody should see
STRAIGHT = 0.06
SMALLEST = 0.4  # of the full size, below which a maneuver excites too little
PEAK_LOAD, PEAK_ALPHA = 0.5, np.radians(4.0)  # g and rad from trim, whichever comes first
# ft, from which on JSBSim's table needs a higher class for the same metre per second
HIGH = 25000.0


def severity_at(altitude: float) -> int:
    """JSBSim's class of exceedance that gives about 1 m/s of rough air: the same class is three
    times calmer at 30 000 ft than at 15 000.
    """
    return 5 if altitude > HIGH else 3


@dataclass(frozen=True, eq=False)
class Rehearsed:
    """An aircraft in a condition: what its vehicle file holds, the maneuvers that suit its short
    period, and their size.

    ``bend`` is what straight lines leave of the largest maneuver, in standard deviations of nz and
    q.
    """

    vehicle: Vehicle
    maneuvers: tuple[Maneuver, Maneuver, Maneuver]
    size: float
    bend: float


def rehearsed(aircraft: Aircraft, condition: Condition) -> Rehearsed:
    """Fly small twice, for the derivatives and for the size; then as asked, and smaller where the
    tables bend within the maneuver.
    """
    vehicle, lost = vehicle_of(fly(aircraft, condition, training(0.5)[0], REHEARSED), aircraft.name)
    if lost > MOST_LOST:
        raise RuntimeError(
            f"{aircraft.name} at {condition}: no straight lines even in a small motion, {lost:.1e} "
            "of the variance is left"
        )
    tick = tick_for(vehicle.short_period()[0])
    maneuvers = (*training(tick), validation(tick))
    small = fly(aircraft, condition, maneuvers[0], REHEARSED).flight
    load, alpha = (float(np.max(np.abs(values - values[0]))) for values in (small.nz, small.alpha))
    size = REHEARSED * min(PEAK_LOAD / load, PEAK_ALPHA / alpha)
    bend = bend_at(aircraft, condition, maneuvers[0], size, vehicle)
    if bend > STRAIGHT:
        # A bend grows with the square of the size.
        size *= max(SMALLEST, float(np.sqrt(STRAIGHT / bend)))
        bend = bend_at(aircraft, condition, maneuvers[0], size, vehicle)
    return Rehearsed(vehicle, maneuvers, size, bend)


def bend_at(
    aircraft: Aircraft, condition: Condition, maneuver: Maneuver, size: float, vehicle: Vehicle
) -> float:
    load, rate = bend_of(fly(aircraft, condition, maneuver, size), vehicle)
    return max(load / USUAL["nz"], rate / USUAL["q"])


def flown(
    aircraft: Aircraft, condition: Condition, ready: Rehearsed, seed: int | None
) -> list[Flight]:
    """The three records of a flight; ``seed`` of the turbulence, None in calm air."""
    severity = severity_at(condition.altitude)
    airs = [
        None if seed is None else RoughAir(severity, seed + part)
        for part in range(len(ready.maneuvers))
    ]
    return [
        fly(aircraft, condition, maneuver, ready.size, air).flight
        for maneuver, air in zip(ready.maneuvers, airs, strict=True)
    ]


def fly_aircraft(
    out: Path, aircraft: Aircraft, faults: Sequence[Planted], seed: int, how: Recording
) -> None:
    """Every fault in both conditions; calm flights are flown once."""
    for number, condition in enumerate(aircraft.conditions):
        ready = rehearsed(aircraft, condition)
        calm: list[Flight] | None = None
        for fault in faults:
            folder = out / f"{aircraft.name}-{number + 1}-{fault.name}"
            size = fault.drawn(np.random.default_rng([seed, zlib.crc32(folder.name.encode()), 1]))
            if fault.rough_air:
                flights = flown(
                    aircraft,
                    condition,
                    ready,
                    seed=100_000 * seed + zlib.crc32(folder.name.encode()) % 99_991,
                )
            else:
                flights = calm = calm or flown(aircraft, condition, ready, None)
            write_flight(folder, ready.vehicle, ready.bend, flights, [(fault, size)], how, seed)
            print(f"{folder.name}: {size:.4g} {fault.unit}", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path)
    parser.add_argument("--aircraft", nargs="+", choices=sorted(AIRCRAFT), default=list(AIRCRAFT))
    parser.add_argument("--fault", nargs="+", choices=sorted(FAULTS), default=list(FIRST))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=50.0, help="samples a second, a part of 400")
    parser.add_argument("--channels", nargs="+", choices=EVERY, default=["alpha", "q", "nz"])
    parser.add_argument("--fine", action="store_true", help="a third of the usual sensor noise")
    given = parser.parse_args(arguments)
    how = replace(Recording(), rate=given.rate, channels=tuple(given.channels), fine=given.fine)
    for name in given.aircraft:
        fly_aircraft(
            given.out, AIRCRAFT[name], [FAULTS[fault] for fault in given.fault], given.seed, how
        )


if __name__ == "__main__":
    main()
