"""Sixty flights by JSBSim, with its own aircraft, equations and trim; the hidden causes are added
to its true signals.

Even numbers are for tuning the loop, odd ones are kept from it. Each cause is flown twice, once in
either half, by different aircraft.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from exam.independent import causes as c
from exam.independent.causes import Cause, Scales
from exam.independent.folders import (
    Planted,
    Recorder,
    Signals,
    recorded,
    truth_of,
    write_folder,
    wrong_starts,
)
from tests.independent.flight import Flight
from tests.independent.fly import Rehearsed, rehearsed, severity_at
from tests.independent.jsbsim_aircraft import AIRCRAFT, Aircraft, Condition, at
from tests.independent.jsbsim_flight import RoughAir, fly

SEED = 37
# Largest gain of log likelihood by the nonlinearity of tables in the records to fit, which should
# not be detectable.
MOST_GAIN = 4.0
MORE = (
    Aircraft("787-8", at((25000, 290), (22000, 285))),
    Aircraft("pa28", at((7000, 95), (6000, 98)), propeller=True),
    Aircraft("f15", at((20000, 320), (18000, 325))),
)
FLEET = (*AIRCRAFT.values(), *MORE)
ROUGH_AIR = Cause(
    Planted("turbulence", ("gust-turbulence",), (), ("alpha", "nz", "turbulence"), {}),
    lambda signals, step: signals,
)
Draw = Callable[[Scales, np.random.Generator], Cause]


def _of(make: Callable[[str, Scales, np.random.Generator], Cause], channel: str) -> Draw:
    return lambda scales, rng: make(channel, scales, rng)


def _rough(scales: Scales, rng: np.random.Generator) -> Cause:
    return ROUGH_AIR


CLEAN: tuple[Draw, ...] = ()
PLANTED: tuple[tuple[Draw, ...], ...] = (
    (_of(c.late_sensor, "alpha"),),
    (_of(c.lagging_sensor, "alpha"),),
    (_of(c.late_sensor, "q"),),
    (_of(c.late_sensor, "nz"),),
    (_of(c.boom, "alpha"),),
    (_of(c.accelerometer_ahead, "nz"),),
    (_of(c.wrong_scale, "q"),),
    (_of(c.wrong_scale, "nz"),),
    (_of(c.follows_late, "elevator"),),
    (_of(c.recorded_late, "elevator"),),
    (_rough,),
    (_of(c.feels_load, "q"),),
    (_of(c.curved, "alpha"),),
    (_of(c.zero_step, "alpha"),),
    (_of(c.drifting, "nz"),),
    (_of(c.held, "alpha"),),
    (_of(c.boom, "alpha"), _of(c.wrong_scale, "q")),
    (_of(c.late_sensor, "q"), _rough),
    (_of(c.vane_with_play, "alpha"),),
    (_of(c.gyro_threshold, "q"),),
)
SPECS: tuple[tuple[Draw, ...], ...] = tuple(
    spec for k in range(10) for spec in (CLEAN, PLANTED[2 * k], PLANTED[2 * k + 1])
)
COUNT = 2 * len(SPECS)


@cache
def _ready(number: int, second: bool) -> Rehearsed:
    aircraft = FLEET[number]
    return rehearsed(aircraft, aircraft.conditions[second])


def fly_flight(number: int, folder: Path, draw: int = 0) -> None:
    """Fly number 1 to `COUNT` and write its folder; the same number and draw give the same bytes.

    Another draw has the same causes in the same order, with other aircraft and sizes.
    """
    rng = np.random.default_rng([SEED, 1, number, *([draw] if draw else [])])
    # Three aircraft apart in the two halves, so that each cause meets two aircraft.
    which = (5 * ((number - 1) // 2) + 3 * (number % 2) + 7 * draw) % len(FLEET)
    aircraft, second = FLEET[which], bool(rng.random() < 0.5)
    condition, ready = aircraft.conditions[second], _ready(which, second)
    vehicle = ready.vehicle
    scales = Scales(vehicle.chord, 1.0 / max(vehicle.short_period()[0], 0.5))
    planted = [draw(scales, rng) for draw in SPECS[(number - 1) // 2]]
    rough = ROUGH_AIR in planted
    how = Recorder(
        float(rng.choice([25.0, 50.0, 50.0, 100.0])),
        float(rng.choice([8.0, 12.0, 20.0])),
        float(rng.choice([0.7, 1.0])),
    )
    size, bend = _size(ready, how)
    flights = [
        fly(
            aircraft,
            condition,
            maneuver,
            size,
            _air(condition, number + 1000 * draw, part) if rough else None,
        ).flight
        for part, maneuver in enumerate(ready.maneuvers)
    ]
    channels = (
        ("alpha", "q", "nz") if rng.random() < 0.7 else ("alpha", "q", "nz", "theta", "airspeed")
    )
    records = []
    for flight in flights:
        signals = signals_of(flight)
        for cause in planted:
            signals = cause.plant(signals, flight.step)
        seen = {name: signals[name] for name in ("elevator", *channels)}
        records.append(recorded(seen, flight.step, ("elevator",), how, rng))
    names = ("mass", "wing_area", "chord", "pitch_inertia", "airspeed", "air_density")
    constants = {"name": f"aircraft {number}", **{name: getattr(vehicle, name) for name in names}}
    notes = {
        "simulator": "jsbsim",
        "condition": [condition.altitude, condition.speed],
        "bend": bend,
        "rate": how.rate,
        "cutoff": how.cutoff,
    }
    truth = truth_of(
        "rigid",
        aircraft.name,
        [cause.planted for cause in planted],
        ("phugoid",),
        vehicle.derivatives,
        notes,
    )
    write_folder(folder, records, constants, wrong_starts(_usable(vehicle.derivatives), rng), truth)


def _size(ready: Rehearsed, how: Recorder) -> tuple[float, float]:
    """Return the elevator size at which the nonlinearity of the aircraft's tables gains at most
    `MOST_GAIN`, and this nonlinearity in noise sigmas.
    """
    samples = how.rate * sum(maneuver.duration for maneuver in ready.maneuvers[:-1])
    allowed, bend = float(np.sqrt(2.0 * MOST_GAIN / samples)), ready.bend / how.noise
    # The nonlinearity is proportional to the square of the size.
    share = min(1.0, float(np.sqrt(allowed / bend)))
    return share * ready.size, share**2 * bend


def _air(condition: Condition, number: int, part: int) -> RoughAir:
    return RoughAir(severity_at(condition.altitude), 1000 * number + part)


def _usable(derivatives: dict[str, float]) -> dict[str, float]:
    """Return starting values; a derivative near zero starts at a third of a usual one."""
    usual = {
        "CL_alpha": 4.0,
        "CL_q": 5.0,
        "CL_de": 0.3,
        "Cm_alpha": -0.3,
        "Cm_q": -15.0,
        "Cm_de": -1.0,
    }
    return {
        name: value if abs(value) > 0.1 * abs(usual[name]) else 0.3 * usual[name]
        for name, value in derivatives.items()
    }


def signals_of(flight: Flight) -> Signals:
    """Return the true signals of a flight by channel name."""
    return {
        name: flight.signal(name) for name in ("elevator", "alpha", "q", "nz", "theta", "airspeed")
    }


def numbers(half: str) -> Sequence[int]:
    """Return the flight numbers of a half: ``tuning`` has the even ones, ``kept`` the odd ones."""
    return range(2 if half == "tuning" else 1, COUNT + 1, 2)
