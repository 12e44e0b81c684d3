"""Sixty cases: twenty causes in three sizes, flown by the three aircraft of the second simulator in
turn.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from tests.independent import injected, recorder
from tests.independent.catalogue import Planted
from tests.independent.flight import Flight
from tests.independent.folders import Recording, write_flight
from tests.independent.foreign import controls, loads, masses, sensors, surroundings
from tests.independent.foreign.simulator import Cause, flown_with
from tests.independent.maneuvers import Maneuver, tick_for, training, validation
from tests.independent.short_period import VEHICLES, Hidden, flown
from tests.independent.undeclared import NO_PHUGOID, PEAK_ALPHA, PEAK_LOAD

FAMILIES = (controls, loads, masses, sensors, surroundings)
CAUSES: dict[str, Cause] = {
    cause.name: cause
    for cause in sorted(
        (one for family in FAMILIES for one in family.CAUSES), key=lambda one: one.name
    )
}
SIZES = ("small", "medium", "large")
# samples a second of the cases with these numbers modulo ten; the others are recorded at 50 Hz
RATES = {3: 25.0, 7: 100.0}


@dataclass(frozen=True)
class Case:
    """A cause by name, its size, and the aircraft."""

    cause: str
    size: str
    vehicle: str

    @property
    def folder(self) -> str:
        return f"{self.cause}-{self.size}-{self.vehicle}"

    @property
    def much(self) -> float:
        return CAUSES[self.cause].sizes[SIZES.index(self.size)]

    @property
    def rate(self) -> float:
        """Samples a second, by the place of the case among all."""
        return RATES.get((3 * list(CAUSES).index(self.cause) + SIZES.index(self.size)) % 10, 50.0)

    @property
    def planted(self) -> Planted:
        """The cause as the examiner's truth file has it; nothing is done to its flights
        afterwards.
        """
        cause = CAUSES[self.cause]
        make = lambda size, rng: (injected.nothing, recorder.untouched)  # noqa: E731
        small, _, large = cause.sizes
        return Planted(
            cause.name,
            cause.unit,
            (small, large),
            make,
            frozenset(cause.right.split()),
            frozenset(),
            tuple(cause.channels.split()),
        )


def cases(
    causes: Sequence[str], sizes: Sequence[str], vehicles: Sequence[str] = ()
) -> Iterator[Case]:
    """Those asked for; without ``vehicles`` every case has one, which goes on with cause and size,
    so that a cause meets all three.
    """
    names = list(VEHICLES)
    for cause in causes:
        for size in sizes:
            turn = names[(list(CAUSES).index(cause) + SIZES.index(size)) % len(names)]
            yield from (Case(cause, size, vehicle) for vehicle in (vehicles or [turn]))


@cache
def maneuvers_of(vehicle: str) -> tuple[tuple[Maneuver, Maneuver, Maneuver], float]:
    """Two maneuvers to fit and one to predict, and the elevator's size (rad): half a g or so, or
    four degrees, whichever comes first.
    """
    tick = tick_for(VEHICLES[vehicle].short_period()[0])
    first, second = training(tick)
    small = flown(VEHICLES[vehicle], first, 0.01)
    size = 0.01 * min(
        PEAK_LOAD / float(np.max(np.abs(small.nz - 1.0))),
        PEAK_ALPHA / float(np.max(np.abs(small.alpha))),
    )
    return (first, second, validation(tick)), size


def flights_of(
    case: Case, seed: int, phugoid: bool = True, much: float | None = None
) -> tuple[Flight, ...]:
    """The three flights of a case, without noise; ``phugoid`` False holds the speed, ``much``
    replaces the size.
    """
    vehicle, (maneuvers, size) = VEHICLES[case.vehicle], maneuvers_of(case.vehicle)
    rng = np.random.default_rng([seed, zlib.crc32(case.folder.encode()), 1])
    hidden = Hidden(exchange=phugoid and case.vehicle != NO_PHUGOID)
    found = []
    for maneuver in maneuvers:
        term = CAUSES[case.cause].make(
            case.much if much is None else much, vehicle, maneuver.duration, rng
        )
        found.append(flown_with(vehicle, maneuver, size, term, hidden))
    return tuple(found)


def write_case(out: Path, case: Case, how: Recording, seed: int) -> Path:
    """The folder of a case, as the examiner expects it."""
    folder = out / case.folder
    write_flight(
        folder,
        VEHICLES[case.vehicle],
        0.0,
        flights_of(case, seed),
        [(case.planted, case.much)],
        how,
        seed,
    )
    return folder
