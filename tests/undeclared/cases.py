"""Records with something hidden in them, and what `flightid diagnose` says of them in a process of
its own.
"""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.oracles import undeclared_flights as flights
from tests.oracles.undeclared_flights import FIGHTER, LINER, SIGMA, TRAINER, Aircraft, Hidden

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Case:
    """One flight of an aircraft with something hidden, and the answers that are right.

    ``names`` are sets of effects that may be claimed, empty where none may; ``parameters`` true
    values by ``effect.local name``; ``validate`` is what is hidden in the second record where that
    differs.
    """

    name: str
    aircraft: Aircraft
    hidden: Callable[[np.random.Generator], Hidden]
    names: tuple[frozenset[str], ...]
    verdicts: tuple[str, ...] = ("traced", "ambiguous")
    parameters: Mapping[str, float] = field(default_factory=dict)
    validate: Callable[[np.random.Generator], Hidden] | None = None
    channels: tuple[str, ...] = ("alpha", "q", "nz")
    rate: float = 50.0
    peak: float = 0.06
    tails: float = 0.0
    seed: int = 1


@dataclass(frozen=True, eq=False)
class Answer:
    """What the command wrote: its JSON and the ratio of the held-out error to the noise, by
    channel, before and after.
    """

    content: Mapping[str, Any]
    before: Mapping[str, float]
    after: Mapping[str, float]

    @property
    def claimed(self) -> frozenset[str]:
        return frozenset(
            effect["name"] for effect in self.content["effects"] if effect.get("claimed", True)
        )

    def quantity(self, name: str) -> tuple[float, float]:
        """Value and standard deviation of ``effect.local name``."""
        effect, _, local = name.rpartition(".")
        found = next(item for item in self.content["effects"] if item["name"] == effect)[
            "parameters"
        ][local]
        return found["value"], found["std"]


def one(*names: str) -> tuple[frozenset[str], ...]:
    return (frozenset(names),)


def write_case(case: Case, folder: Path) -> None:
    """Both records and the vehicle file, derivatives up to 30 % wrong: a 3-2-1-1 and a smaller
    doublet to fit, other shapes to predict.
    """
    rng = np.random.default_rng(case.seed)
    first = flights.three_two_one_one(case.peak, 0.5, 1.0) + flights.doublet(
        -0.5 * case.peak, 1.0, 9.0
    )
    second = flights.doublet(0.9 * case.peak, 0.8, 1.0) + flights.three_two_one_one(
        -0.7 * case.peak, 0.4, 6.0
    )
    sigma = {name: SIGMA[name] for name in case.channels}
    for stem, pattern, duration, hidden in (
        ("train", first, 20.0, case.hidden),
        ("validate", second, 16.0, case.validate or case.hidden),
    ):
        what = hidden(rng)
        flown = flights.fly_aircraft(
            case.aircraft, flights.steps(pattern, case.rate, duration), case.rate, what
        )
        flights.write_record(
            folder / f"{stem}.csv", flights.measured(flown, rng, sigma, what, case.tails)
        )
    flights.write_vehicle(folder / "vehicle.toml", flights.wrong_start(case.aircraft, rng))


def diagnosed(
    folder: Path, model: str, sigma: Mapping[str, float], effort: str = "normal"
) -> Answer:
    """Run `python -m scenarios diagnose` on the files of a folder and read what it wrote."""
    out = folder / "out"
    command = [
        sys.executable,
        "-m",
        "scenarios",
        "diagnose",
        str(folder / "train.csv"),
        "--model",
        model,
        "--vehicle",
        str(folder / "vehicle.toml"),
    ]
    command += [
        "--validate",
        str(folder / "validate.csv"),
        "--out",
        str(out),
        "--no-figures",
        "--effort",
        effort,
    ]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        command, env=environment, cwd=folder, capture_output=True, text=True, timeout=400
    )
    assert run.returncode == 0, run.stderr
    content = json.loads((out / "diagnosis.json").read_text())
    measured, predicted = (
        _columns(folder / "validate.csv"),
        _columns(out / "validate_prediction.csv"),
    )
    ratios = {
        when: {
            name: float(
                np.sqrt(np.nanmean((measured[name] - predicted[f"{when}_{name}"]) ** 2)) / std
            )
            for name, std in sigma.items()
        }
        for when in ("before", "after")
    }
    return Answer(content, ratios["before"], ratios["after"])


def _columns(path: Path) -> dict[str, np.ndarray]:
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


def spikes(channel: str, *placed: tuple[int, float]) -> Callable[[np.random.Generator], Hidden]:
    return lambda rng: Hidden(
        spikes={channel: [(at, size * SIGMA[channel]) for at, size in placed]}
    )


def half_sine(
    peak: float, start: float, duration: float
) -> Callable[[np.random.Generator], Hidden]:
    """A gust with a kink at both ends, which the library's does not have."""

    def inside(t: float) -> float:
        within = start < t < start + duration
        return peak * math.sin(math.pi * (t - start) / duration) if within else 0.0

    return lambda rng: Hidden(gust=inside)


def always(hidden: Hidden) -> Callable[[np.random.Generator], Hidden]:
    return lambda rng: hidden


def jump(
    time: float, aircraft: Aircraft, name: str, factor: float
) -> Callable[[np.random.Generator], Hidden]:
    return always(Hidden(changed=(time, {name: factor * aircraft.derivatives[name]})))


def rough_air(
    sigma: float, length: float, aircraft: Aircraft
) -> Callable[[np.random.Generator], Hidden]:
    return lambda rng: Hidden(gust=flights.dryden(rng, sigma, length, aircraft.airspeed, 25.0))


def named(name: str, aircraft: Aircraft, hidden: Hidden, parameter: str, value: float) -> Case:
    """A case with one effect whose one parameter is asked for."""
    return Case(
        name,
        aircraft,
        always(hidden),
        one(parameter.rpartition(".")[0]),
        parameters={parameter: value},
    )


def flattening(t: float, alpha: float, q: float, elevator: float) -> float:
    return 0.5 * (0.03 * math.tanh(alpha / 0.03) - alpha)


def swinging(t: float, alpha: float, q: float, elevator: float) -> float:
    return 0.004 * math.sin(5.0 * t)


def rubbing(t: float, alpha: float, q: float, elevator: float) -> float:
    return -0.004 * math.tanh(q / 0.01)


BENDING = {"frequency": 28.0, "damping": 0.03, "lift": 0.15, "moment": -0.2, "gyro": 0.01}
CHEAP: Sequence[Case] = (
    Case("clean", LINER, always(Hidden()), (frozenset(),), ("consistent",), seed=11),
    Case(
        "dead band",
        FIGHTER,
        always(Hidden(command=(flights.dead(0.009),))),
        one("input-deadband"),  # a curve of the control comes near it: the verdict may be ambiguous
        parameters={"input-deadband.half_width": 0.009},
    ),
    Case(
        "delay",
        TRAINER,
        always(Hidden(command=(flights.delayed(0.047),))),
        one("input-delay"),
        parameters={"input-delay.delay": 0.047},
    ),
    Case(
        "vane ahead",
        LINER,
        always(Hidden(vane_arm=8.5)),
        one("vane-offset"),
        parameters={"vane-offset.arm": 8.5},
    ),
)

INSTRUMENTS: Sequence[tuple[str, Aircraft, Hidden, str, float]] = (
    (
        "accelerometer ahead",
        FIGHTER,
        Hidden(accelerometer_arm=9.0),
        "accelerometer-offset:nz.arm",
        9.0,
    ),
    (
        "accelerometer a little ahead",
        LINER,
        Hidden(accelerometer_arm=4.0),
        "accelerometer-offset:nz.arm",
        4.0,
    ),
    (
        "accelerometer behind",
        FIGHTER,
        Hidden(accelerometer_arm=-9.0),
        "accelerometer-offset:nz.arm",
        -9.0,
    ),
    ("gyro that feels load", LINER, Hidden(gyro_by_load=0.012), "sensor-coupling:q.gain", 0.012),
    (
        "gyro that feels a little load",
        FIGHTER,
        Hidden(gyro_by_load=0.005),
        "sensor-coupling:q.gain",
        0.005,
    ),
    (
        "bent vane",
        FIGHTER,
        Hidden(sensors={"alpha": flights.curved(2.0)}),
        "sensor-curve:alpha.curvature",
        2.0,
    ),
    (
        "vane bent a little",
        TRAINER,
        Hidden(sensors={"alpha": flights.curved(-0.7)}),
        "sensor-curve:alpha.curvature",
        -0.7,
    ),
    (
        "gyro whose zero jumps",
        FIGHTER,
        Hidden(sensors={"q": flights.stepped(0.006, 8.013)}),
        "sensor-step:q.size",
        0.006,
    ),
    (
        "vane that is knocked",
        LINER,
        Hidden(sensors={"alpha": flights.stepped(-0.003, 5.513)}),
        "sensor-step:alpha.size",
        -0.003,
    ),
    (
        "gyro on a slow bus",
        LINER,
        Hidden(sensors={"q": flights.held(0.1, 0.04)}),
        "sensor-hold:q.period",
        0.1,
    ),
    (
        "vane on a slow bus",
        TRAINER,
        Hidden(sensors={"alpha": flights.held(0.08, 0.02)}),
        "sensor-hold:alpha.period",
        0.08,
    ),
)
BESIDE_LATE_ALPHA = ("gyro that feels load", "gyro whose zero jumps", "gyro on a slow bus")
LATE_ALPHA = flights.shown_late(0.06)


def beside_late_alpha(
    name: str, aircraft: Aircraft, hidden: Hidden, parameter: str, value: float
) -> Case:
    """The same fault with an angle of attack that is read late."""
    both = always(replace(hidden, sensors={**hidden.sensors, "alpha": LATE_ALPHA}))
    names = tuple(
        frozenset({parameter.rpartition(".")[0], late})
        for late in ("sensor-delay:alpha", "sensor-lag:alpha")
    )
    return Case(f"{name}, late alpha", aircraft, both, names, parameters={parameter: value})


LATE_NZ = (frozenset({"sensor-lag:nz"}), frozenset({"sensor-delay:nz"}))
NONE = (frozenset[str](),)
DEAR: Sequence[Case] = (
    Case(
        "product of angle and elevator",
        LINER,
        always(Hidden(moment=lambda t, a, q, e: 9.0 * a * e)),
        (frozenset(),),
        ("unexplained",),
    ),
    Case(
        "spikes and free play",
        FIGHTER,
        always(
            Hidden(
                command=(flights.slack(0.004),),
                spikes={"q": [(150, 0.05), (433, -0.04), (701, 0.06)]},
            )
        ),
        one("input-backlash", "sensor-spikes:q"),
        parameters={"input-backlash.half_width": 0.004},
    ),
    Case(
        "gust of another form",
        FIGHTER,
        half_sine(0.9, 12.3, 1.3),
        one("gust-discrete"),
        validate=half_sine(-0.8, 10.1, 0.9),
    ),
    Case(
        "clean without load factor",
        TRAINER,
        always(Hidden()),
        NONE,
        ("consistent",),
        channels=("alpha", "q"),
        seed=21,
    ),
    Case(
        "clean with heavy tails",
        FIGHTER,
        always(Hidden()),
        NONE,
        ("consistent",),
        tails=3.5,
        seed=22,
    ),
    Case(
        "late load factor",
        TRAINER,
        always(Hidden(sensors={"nz": flights.shown_lagged(0.062)})),
        LATE_NZ,
    ),
    named(
        "scale of the gyro",
        LINER,
        Hidden(sensors={"q": flights.scaled(0.93)}),
        "sensor-scale:q.scale",
        0.93,
    ),
    named(
        "saturation",
        FIGHTER,
        Hidden(command=(flights.limited(0.049),)),
        "actuator-saturation.limit",
        0.049,
    ),
    named(
        "rate limit", LINER, Hidden(command=(flights.rated(0.2),)), "actuator-rate-limit.rate", 0.2
    ),
    Case(
        "moment of another form",
        FIGHTER,
        always(Hidden(moment=flattening)),
        one("moment-nonlinearity"),
    ),
    Case(
        "tail loses power",
        LINER,
        jump(8.0, LINER, "Cm_de", 0.8),
        one("derivative-jump"),
        validate=jump(5.0, LINER, "Cm_de", 0.8),
    ),
    named("elastic mode", FIGHTER, Hidden(mode=BENDING), "elastic-mode.frequency", 28.0),
    Case("rough air", LINER, rough_air(0.8, 180.0, LINER), one("gust-turbulence")),
    Case(
        "dead band and vane",
        TRAINER,
        always(Hidden(command=(flights.dead(0.008),), vane_arm=2.5)),
        one("input-deadband", "vane-offset"),
        parameters={"input-deadband.half_width": 0.008, "vane-offset.arm": 2.5},
    ),
    Case(
        "a moment that swings by itself",
        FIGHTER,
        always(Hidden(moment=swinging)),
        NONE,
        ("unexplained",),
    ),
    Case(
        "damping by the sign of the rate",
        LINER,
        always(Hidden(moment=rubbing)),
        NONE,
        ("unexplained",),
    ),
    Case("vane behind", FIGHTER, always(Hidden(vane_arm=-9.0)), NONE, ("unexplained",)),
    *(named(*case) for case in INSTRUMENTS),
    *(beside_late_alpha(*case) for case in INSTRUMENTS if case[0] in BESIDE_LATE_ALPHA),
)
