"""Every fault and effect as an undeclared case of the second simulator: three aircraft, two sizes,
alone and beside a late alpha.

python -m tests.independent.undeclared OUT --vehicle jet --fault curved-vane hum --size large
--alone
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from tests.independent import injected, recorder
from tests.independent.catalogue import FAULTS, LATE_ALPHA, NOTHING, Planted
from tests.independent.flight import Flight
from tests.independent.folders import Recording, write_flight
from tests.independent.maneuvers import tick_for, training, validation
from tests.independent.short_period import VEHICLES, Hidden, flown, second_order

PEAK_LOAD, PEAK_ALPHA = 0.6, np.radians(4.0)  # g and rad from trim, whichever comes first
BESIDE = 0.06  # s: the late alpha beside another fault
DAMPING = 0.6  # of the second-order actuator
# flown at constant speed, as the declared model has it; the others exchange speed and height
NO_PHUGOID = "fighter"


def _physics(
    name: str, unit: str, sizes: tuple[float, float], right: str, twins: str, words: str
) -> Planted:
    """An effect of the aircraft itself: nothing is done to its flight afterwards."""
    make = lambda size, rng: (injected.nothing, recorder.untouched)  # noqa: E731
    return Planted(
        name,
        unit,
        sizes,
        make,
        frozenset(right.split()),
        frozenset(twins.split()),
        tuple(words.split()),
    )


PHYSICS: dict[str, tuple[Planted, Callable[[float], Hidden]]] = {
    "phugoid": (
        _physics("phugoid", "rad of climb", (0.0, 0.05), "phugoid", "", ""),
        lambda size: Hidden(exchange=True, climb=size),
    ),
    "second-order-actuator": (
        _physics(
            "second-order-actuator",
            "rad/s",
            (20.0, 10.0),
            "actuator-second-order",
            "actuator-lag input-delay",
            "elevator",
        ),
        lambda size: Hidden(surface=second_order(size, DAMPING)),
    ),
    "unequal-control": (
        _physics("unequal-control", "part", (0.15, 0.40), "control-nonlinearity", "", "elevator"),
        lambda size: Hidden(unequal=size),
    ),
    # A steady deceleration and a climb at the start are the same to first order: either name is
    # right.
    "deceleration": (
        _physics("deceleration", "m/s2", (0.5, 1.5), "speed-variation phugoid", "", "speed"),
        lambda size: Hidden(deceleration=size),
    ),
}
NAMES = (*(name for name, fault in FAULTS.items() if not fault.rough_air), *PHYSICS)


@dataclass(frozen=True)
class Case:
    """One undeclared case: a vehicle of the second simulator, a fault by name, its size, and
    whether alpha is late as well.
    """

    vehicle: str
    fault: str
    size: str
    beside_late_alpha: bool = False

    @property
    def folder(self) -> str:
        return "-".join(
            filter(
                None,
                (self.vehicle, self.fault, self.size, "late" if self.beside_late_alpha else ""),
            )
        )

    @property
    def planted(self) -> tuple[Planted, float]:
        fault = PHYSICS[self.fault][0] if self.fault in PHYSICS else FAULTS[self.fault]
        much = fault.sizes[("small", "large").index(self.size)]
        # The sign goes with the name of the folder, so that the set holds both.
        return fault, -much if fault.either_sign and zlib.crc32(self.folder.encode()) % 2 else much


def cases(
    vehicles: Sequence[str], faults: Sequence[str], sizes: Sequence[str], beside: Sequence[bool]
) -> Iterator[Case]:
    """The cases asked for; a fault without a size comes once, and alpha is not made late twice."""
    for vehicle in vehicles:
        for fault in faults:
            for late in beside:
                if not (late and fault in ("late-alpha", "lagging-alpha", "nothing")):
                    found = [Case(vehicle, fault, size, late) for size in sizes]
                    yield from (
                        found if len({abs(case.planted[1]) for case in found}) > 1 else found[:1]
                    )


def flights_of(case: Case) -> tuple[Flight, ...]:
    """A record to fit and one to predict, in calm air."""
    fault, size = case.planted
    return (
        _flown(case.vehicle, fault.name, size)
        if fault.name in PHYSICS
        else _flown(case.vehicle, NOTHING.name, 0.0)
    )


@cache
def _flown(name: str, fault: str, much: float) -> tuple[Flight, ...]:
    """The elevator is scaled to `PEAK_LOAD` or `PEAK_ALPHA`, whichever a small motion says is
    reached first.
    """
    vehicle = VEHICLES[name]
    hidden = PHYSICS[fault][1](much) if fault in PHYSICS else Hidden()
    hidden = replace(
        hidden, exchange=hidden.exchange or (name != NO_PHUGOID and fault != "deceleration")
    )
    tick = tick_for(vehicle.short_period()[0])
    maneuvers = (training(tick)[0], validation(tick))
    small = flown(vehicle, maneuvers[0], 0.01)
    size = 0.01 * min(
        PEAK_LOAD / float(np.max(np.abs(small.nz - 1.0))),
        PEAK_ALPHA / float(np.max(np.abs(small.alpha))),
    )
    return tuple(flown(vehicle, maneuver, size, hidden) for maneuver in maneuvers)


def write_case(out: Path, case: Case, how: Recording, seed: int) -> Path:
    """The folder of a case."""
    late = [(LATE_ALPHA, BESIDE)] if case.beside_late_alpha else []
    folder = out / case.folder
    write_flight(
        folder, VEHICLES[case.vehicle], 0.0, flights_of(case), [*late, case.planted], how, seed
    )
    return folder


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path)
    parser.add_argument("--vehicle", nargs="+", choices=list(VEHICLES), default=list(VEHICLES))
    parser.add_argument("--fault", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--size", nargs="+", choices=["small", "large"], default=["small", "large"])
    parser.add_argument("--alone", action="store_true", help="none of them beside a late alpha")
    parser.add_argument("--beside", action="store_true", help="only beside a late alpha")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--channels", nargs="+", default=["alpha", "q", "nz"])
    given = parser.parse_args(arguments)
    beside = [
        late for late, unwanted in ((False, given.beside), (True, given.alone)) if not unwanted
    ]
    how = Recording(rate=given.rate, channels=tuple(given.channels))
    for case in cases(given.vehicle, given.fault, given.size, beside):
        print(write_case(given.out, case, how, given.seed).name, flush=True)


if __name__ == "__main__":
    main()
