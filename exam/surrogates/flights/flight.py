"""From a surrogate flight and a seed to a flight: drawn, with its dominant effects, and flown."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from exam.surrogates.declaration import LATERAL, Surrogate
from exam.surrogates.flights.dominant import draw_dominant
from exam.surrogates.flights.drawing import Drawn, draw
from exam.surrogates.flights.flying import FlownRecord, fly_drawn
from exam.surrogates.flights.lateral.drawing import draw_lateral
from sim.errors import DeclarationError
from sim.record import Record

AIRCRAFT_TRIED = 5  # on one of thirty aircraft no declared size makes a difference


@dataclass(frozen=True, eq=False)
class Flight:
    """A flown surrogate flight: ``drawn`` is the truth of the whole flight, and ``flown`` has each
    record with its own truth.
    """

    drawn: Drawn
    flown: tuple[FlownRecord, ...]

    @property
    def records(self) -> tuple[Record, ...]:
        return tuple(flown.record for flown in self.flown)


def fly_surrogate(surrogate: Surrogate, seed: int) -> Flight:
    """Draw and fly; the same seed gives the same bytes.

    Raises
    ------
    DeclarationError : a maneuver, a vehicle or a hidden effect that is not there.
    """
    plan, dominant, air = np.random.default_rng(seed).spawn(3)
    drawn = _with_dominant(surrogate, plan, dominant)
    return Flight(drawn, fly_drawn(drawn, air))


def _with_dominant(
    surrogate: Surrogate, plan: np.random.Generator, dominant: np.random.Generator
) -> Drawn:
    """Return a flight with its dominant effects. An aircraft on which no declared size makes a
    difference is drawn again.
    """
    drawn = draw_lateral if surrogate.flight.axis == LATERAL else draw
    for _ in range(AIRCRAFT_TRIED - 1 if surrogate.hidden.sizes else 0):
        try:
            return draw_dominant(drawn(surrogate, plan), dominant)
        except DeclarationError:
            continue
    return draw_dominant(drawn(surrogate, plan), dominant)


def vehicle_text(drawn: Drawn) -> str:
    """Return the vehicle file for the loop: true nominal constants, and wrong derivatives."""
    lines = [
        f'name = "{drawn.vehicle}"',
        *(f"{name} = {drawn.declared.parameters[name].value!r}" for name in drawn.axis.constants),
    ]
    return (
        "\n".join(
            [
                *lines,
                "[derivatives]",
                *(f"{name} = {float(value)!r}" for name, value in drawn.starts.items()),
            ]
        )
        + "\n"
    )


def write_flight(flight: Flight, folder: Path) -> tuple[list[Path], Path]:
    """Write ``record_1.csv`` and so on with their sidecars, and ``vehicle.toml``, for the loop;
    return the paths of records and vehicle file.
    """
    from scenarios.files.writing import write_record

    paths = [
        write_record(folder, record, record.name, simulated=True)[0] for record in flight.records
    ]
    vehicle = folder / "vehicle.toml"
    vehicle.write_text(vehicle_text(flight.drawn), encoding="utf-8", newline="\n")
    return paths, vehicle
