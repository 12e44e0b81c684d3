"""A flight by JSBSim from its declaration to its record, vehicle files and truth.

The schema of flights by JSBSim (pydantic), and the way from a checked file to a JsbsimFlight.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field

from scenarios.files.declarations import checked, closest
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT
from scenarios.files.sources import versions
from scenarios.files.writing import write_json, write_record, write_text
from scenarios.studies.schema import Quantity, positive, si
from scenarios.trials.jsbsim.declaration import (
    CONDITIONS,
    CONTROLS,
    DURATIONS,
    INPUTS,
    MANEUVERS,
    MODELS,
    OUTPUTS,
    SURFACES,
    JsbsimFlight,
    commands,
    named,
    refuse_unknown_aircraft,
    rehearsal,
    spoiled,
    surfaces_of,
)
from scenarios.trials.jsbsim.machine import (
    LEAST_FRAME_RATE,
    Condition,
    JsbsimSignals,
    Slopes,
    constants_of,
    fly,
    slopes_of,
)
from sim.errors import DeclarationError
from sim.record import Channel, Hold, Record

# ---- A flight by JSBSim from its declaration

REHEARSAL_TIME = 12.0  # s
MOST_REHEARSALS = 4
AMPLITUDE_TOLERANCE = 0.15  # share within which an amplitude is accepted
FIRST_DEFLECTION = math.radians(1.0)  # rad, first deflection that is tried
LARGEST_DEFLECTION = math.radians(20.0)  # rad, largest deflection
THROTTLE_STEP = 0.12  # of the throttle's travel
SMALL_MANEUVER_SHARE = 0.1  # share of the maneuver that is flown for slopes about trim
LEAST_TRAVEL_SHARE = 0.7  # share of the commanded deflection that a surface must reach
UNITS = (0.25, 1.5)  # s, of a 3-2-1-1
# factor of the pilot's gains: the wings are kept level while the elevator moves
PITCH_PILOT_FACTOR = 1.0
ROLL_PILOT_FACTOR = 0.3  # the same in rolling: the wings return slowly
# How far a control takes the aircraft from trim: twenty times what sensors tell, and little enough
# for models about trim (twice as far, the speed that is lost in banks of 20 degrees and the square
# of the drag stand out of the noise).
PEAKS: Mapping[str, Mapping[str, float]] = {
    "elevator": {"alpha": math.radians(2.0), "q": math.radians(8.0)},
    "rudder": {"beta": math.radians(2.5), "p": math.radians(8.0)},
    "aileron": {"p": math.radians(10.0), "phi": math.radians(10.0), "beta": math.radians(2.5)},
}


@dataclass(frozen=True, eq=False)
class JsbsimTruth:
    """What is true of a flight: by model constants, slopes about trim, and the nearest straight
    lines over the maneuver as it was flown.

    ``sizes`` : peak of each surface, rad, and of the throttle, parts of its travel.
    """

    constants: Mapping[str, Mapping[str, float]]
    about_trim: Mapping[str, Slopes]
    in_maneuver: Mapping[str, Slopes]
    sizes: Mapping[str, float]


def fly_jsbsim(flight: JsbsimFlight, seed: int) -> tuple[Record, JsbsimTruth]:
    """Return the record and its truth; the same seed gives the same numbers.

    Raises
    ------
    DeclarationError : JSBSim is not installed, has no such aircraft, does not trim it here, or
        loses it in the maneuver.
    """
    _refuse_missing_surface(flight)
    frames = math.ceil(LEAST_FRAME_RATE / flight.rate)  # of one sample
    calm = Condition(
        flight.aircraft, flight.altitude, flight.airspeed, 1.0 / (frames * flight.rate), 0, 1 + seed
    )
    units = units_of(calm)
    sizes = {
        control: _sized(calm, control, units[control]) if control in PEAKS else THROTTLE_STEP
        for control in CONTROLS[flight.axis]
    }
    time = calm.step * np.arange(int(flight.duration * flight.rate) * frames + 1)
    wanted = {control: flight.size * size for control, size in sizes.items()}
    leveller = ROLL_PILOT_FACTOR if "aileron" in wanted else PITCH_PILOT_FACTOR
    simulated = fly(
        replace(calm, rough_air=flight.rough_air), commands(flight, wanted, units, time), leveller
    )
    small = _small_motion(calm, flight, sizes, units, time)
    models = MODELS[flight.axis]
    truth = JsbsimTruth(
        {model: constants_of(model, small) for model in models},
        {model: slopes_of(model, small) for model in models},
        {model: slopes_of(model, small, simulated) for model in models},
        wanted,
    )
    return _recorded(flight, simulated, frames, np.random.default_rng(seed)), truth


def _refuse_missing_surface(flight: JsbsimFlight) -> None:
    there = surfaces_of(flight.aircraft)
    for key, faults in (("late", flight.late), ("backlash", flight.backlash)):
        for name in faults:
            if name in SURFACES and name not in there:
                what = f"{flight.aircraft} has no {name} that its air loads read"
                raise DeclarationError(
                    what, where=f"key {key}.{name}", remedy="leave it out, or give another aircraft"
                )


def units_of(calm: Condition) -> dict[str, float]:
    """Step of a 3-2-1-1 (s) by control: 1.6 over the frequency of the excited mode, from a small
    motion.
    """
    time = calm.step * np.arange(round(REHEARSAL_TIME / calm.step))
    pitching = fly(calm, rehearsal("elevator", FIRST_DEFLECTION, 0.5, time), PITCH_PILOT_FACTOR)
    yawing = fly(calm, rehearsal("rudder", FIRST_DEFLECTION, 0.5, time), ROLL_PILOT_FACTOR)
    pitch = _frequency(
        pitching, "moment_m", ("alpha", "q", "elevator"), pitching.body.pitch_inertia
    )
    yaw = _frequency(yawing, "moment_n", ("beta", "r", "p", "rudder"), yawing.body.yaw_inertia)
    step = {"elevator": 1.6 / pitch, "rudder": 1.6 / yaw, "aileron": 1.0 / yaw}
    return {control: float(np.clip(unit, *UNITS)) for control, unit in step.items()} | {
        "throttle": 1.0
    }


def _frequency(signals: JsbsimSignals, moment: str, by: tuple[str, ...], inertia: float) -> float:
    """Square root of stiffness over inertia, rad/s: slope of a moment by the first of the
    signals.
    """
    matrix = np.stack(
        [
            np.ones(len(signals["time"])),
            *(signals[name] - signals[name][0] for name in by if name in signals.signals),
        ],
        axis=1,
    )
    stiffness = float(np.linalg.lstsq(matrix, signals[moment], rcond=None)[0][1]) / inertia
    return math.sqrt(max(abs(stiffness), 0.25))


def _sized(calm: Condition, control: str, unit: float) -> float:
    """Return the deflection (rad) at which the first of ``PEAKS`` is reached in a 3-2-1-1."""
    time, size = calm.step * np.arange(round(REHEARSAL_TIME / calm.step)), FIRST_DEFLECTION
    for _ in range(MOST_REHEARSALS):
        simulated = fly(
            calm,
            rehearsal(control, size, unit, time),
            PITCH_PILOT_FACTOR if control == "elevator" else ROLL_PILOT_FACTOR,
        )
        reached = max(
            float(np.max(np.abs(simulated[name] - simulated[name][0]))) / peak
            for name, peak in PEAKS[control].items()
        )
        if abs(reached - 1.0) < AMPLITUDE_TOLERANCE:
            break
        size = min(LARGEST_DEFLECTION, size * float(np.clip(1.0 / reached, 0.25, 4.0)))
    return size


def _small_motion(
    calm: Condition,
    flight: JsbsimFlight,
    sizes: Mapping[str, float],
    units: Mapping[str, float],
    time: np.ndarray,
) -> JsbsimSignals:
    """Return the 3-2-1-1 of the flight a tenth as large, in calm air; larger where the play of a
    linkage swallows it.
    """
    share = SMALL_MANEUVER_SHARE
    while True:
        wanted = commands(
            replace(flight, maneuver="3-2-1-1"),
            {control: share * size for control, size in sizes.items()},
            units,
            time,
        )
        # a propeller's torque would be as large as the motion
        wanted.setdefault("throttle", np.zeros(len(time)))
        simulated = fly(
            calm, wanted, ROLL_PILOT_FACTOR if "aileron" in wanted else PITCH_PILOT_FACTOR
        )
        done = [
            np.ptp(simulated[name]) / np.ptp(values)
            for name, values in wanted.items()
            if name in simulated.signals
        ]
        if min(done) > LEAST_TRAVEL_SHARE or share >= 1.0:
            return simulated
        share = min(1.0, 2.0 * share)


def _recorded(
    flight: JsbsimFlight, simulated: JsbsimSignals, frames: int, rng: np.random.Generator
) -> Record:
    """Every so many frames, white Gaussian noise on each output, none on surfaces and thrust."""
    signals = dict(simulated.signals)
    signals |= {f"a{axis}": signals[f"force_{axis}"] / signals["mass"] for axis in "xyz"}
    shown = spoiled(signals, flight)
    rows = slice(None, None, frames)
    outputs = []
    for name, unit in OUTPUTS.items():
        sigma = flight.noise * flight.noise_std.get(name, 0.0)
        outputs.append(
            Channel.of(
                name, unit, shown[name][rows] + sigma * rng.standard_normal(len(shown[name][rows]))
            )
        )
    inputs = tuple(
        Channel.of(name, unit, shown[name][rows]) for name, unit in INPUTS.items() if name in shown
    )
    time = np.arange(len(shown["time"][rows])) / flight.rate
    return Record(time, inputs, tuple(outputs), Hold.LINEAR, f"{flight.aircraft}_{flight.axis}")


# ---- The files of a flight by JSBSim

STARTS_APART = 1_000_003  # between the seeds of sensors and those of starting values
LEAST_LOAD_SHARE = 1e-3  # share of a load's spread: a derivative that moves less is zero for a fit


def write_jsbsim(
    flight: JsbsimFlight, seed: int, record: Record, truth: JsbsimTruth, folder: Path, stem: str
) -> tuple[dict[str, Path], Path]:
    """``stem.csv`` with its sidecar, ``stem_MODEL.toml`` for each model, ``stem_truth.json``;
    vehicle files by model, and the truth's path.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_record(folder, record, stem, simulated=True)
    rng = np.random.default_rng((STARTS_APART, seed))
    vehicles = {}
    for model, constants in truth.constants.items():
        vehicles[model] = folder / f"{stem}_{model}.toml"
        text = vehicle_text(flight, constants, truth.about_trim[model], rng)
        write_text(vehicles[model], text)
    path = folder / f"{stem}_truth.json"
    write_json(path, truth_content(flight, seed, truth))
    return vehicles, path


def vehicle_text(
    flight: JsbsimFlight, constants: Mapping[str, float], slopes: Slopes, rng: np.random.Generator
) -> str:
    """Return a vehicle file: constants as JSBSim has them, derivatives wrong by up to ``wrong``;
    those that move nothing left out.
    """
    lines = [
        f'name = "{flight.aircraft}"',
        *(f"{name} = {value!r}" for name, value in constants.items()),
        "[derivatives]",
    ]
    for name, value in slopes.values.items():
        start = value * (1.0 + flight.wrong * rng.uniform(-1.0, 1.0))
        if slopes.weight.get(name, 1.0) > LEAST_LOAD_SHARE:
            lines.append(f"{name} = {start:.4g}")
    return "\n".join(lines) + "\n"


def truth_content(flight: JsbsimFlight, seed: int, truth: JsbsimTruth) -> dict[str, Any]:
    """JSON content: derivatives about trim and over the maneuver by model, inserted errors, and
    settings of the flight.
    """
    made = {
        key: value
        for key, value in asdict(flight).items()
        if key not in ("name", "title", "about", "seed")
    }
    return {
        "schema": "flightid/truth/1",
        "parameters": {model: dict(result.values) for model, result in truth.about_trim.items()},
        "in_maneuver": {model: dict(result.values) for model, result in truth.in_maneuver.items()},
        "variance_left": {model: result.left for model, result in truth.in_maneuver.items()},
        "hidden": named(flight),
        "flight": made,
        "controls": dict(truth.sizes),
        "seed": seed,
        "versions": versions(),
    }


SHORTEST = 8.0  # s
FASTEST = 400.0  # Hz


class _Jsbsim(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT

    schema_: Literal["flightid/scenario/1"] = Field(alias="schema")
    kind: Literal["jsbsim"]
    title: Annotated[str, Field(min_length=1)]
    about: str = ""
    seed: int = Field(default=1, ge=0)
    aircraft: Annotated[str, Field(min_length=1)] | int  # there is a 737
    altitude: Quantity | None = None
    airspeed: Quantity | None = None
    axis: str
    maneuver: str = "3-2-1-1"
    size: Annotated[float, Field(gt=0, le=5)] = 1.0
    duration: Quantity | None = None
    rate: Quantity = 50.0
    noise: Annotated[float, Field(ge=0)] = 1.0
    noise_std: dict[str, Quantity] = {}
    rough_air: Annotated[int, Field(ge=0, le=7)] = 0
    wrong: Annotated[float, Field(ge=0, lt=1)] = 0.3
    late: dict[str, Quantity] = {}
    backlash: dict[str, Quantity] = {}
    vane_ahead: Quantity = 0.0


def jsbsim_of(document: Mapping[str, Any], name: str, where: str) -> JsbsimFlight:
    """Return a JsbsimFlight from the content of its file; ``where`` names the file in messages.

    Raises
    ------
    DeclarationError : an unknown or missing key, name, unit or value, JSBSim not installed: one
        line with file and key.
    """
    content = checked(_Jsbsim, document, where)
    aircraft = str(content.aircraft)
    refuse_unknown_aircraft(aircraft, f"{where}, key aircraft")
    _one_of(content.axis, tuple(CONTROLS), "axis", where)
    _one_of(content.maneuver, MANEUVERS, "maneuver", where)
    duration = (
        DURATIONS[content.axis]
        if content.duration is None
        else si(content.duration, "s", f"{where}, key duration")
    )
    if not duration >= SHORTEST:
        raise DeclarationError(
            f"{duration:g} s hold no maneuver",
            where=f"{where}, key duration",
            remedy=f"give {SHORTEST:g} s or more",
        )
    rate = positive(
        si(content.rate, "1/s", f"{where}, key rate", {"hz": "1/s"}), f"{where}, key rate"
    )
    if rate > FASTEST:
        raise DeclarationError(
            f"{rate:g} samples a second",
            where=f"{where}, key rate",
            remedy=f"give {FASTEST:g} Hz or less",
        )
    altitude, airspeed = _condition(content, where)
    return JsbsimFlight(
        name,
        content.title,
        " ".join(content.about.split()),
        aircraft,
        altitude,
        airspeed,
        content.axis,
        content.maneuver,
        content.size,
        duration,
        rate,
        content.noise,
        _by_channel(content.noise_std, tuple(OUTPUTS), OUTPUTS, where, "noise_std"),
        content.rough_air,
        content.wrong,
        _by_channel(
            content.late,
            (*SURFACES, *OUTPUTS),
            dict.fromkeys((*SURFACES, *OUTPUTS), "s"),
            where,
            "late",
        ),
        _by_channel(content.backlash, SURFACES, dict.fromkeys(SURFACES, "rad"), where, "backlash"),
        si(content.vane_ahead, "m", f"{where}, key vane_ahead"),
        content.seed,
    )


def _condition(content: _Jsbsim, where: str) -> tuple[float, float]:
    """Altitude and airspeed as given, else those of the aircraft."""
    own = CONDITIONS.get(str(content.aircraft))
    result = []
    for place, (key, unit, value) in enumerate(
        (("altitude", "m", content.altitude), ("airspeed", "m/s", content.airspeed))
    ):
        if value is None and own is None:
            what = f"no usual {key} is known of {content.aircraft}"
            raise DeclarationError(
                what,
                where=f"{where}, key {key}",
                remedy=f"give it, or an aircraft of {', '.join(CONDITIONS)}",
            )
        result.append(
            si(value, unit, f"{where}, key {key}")
            if value is not None
            else own[place]
            if own
            else 0.0
        )
    return result[0], positive(result[1], f"{where}, key airspeed")


def _one_of(name: str, allowed: tuple[str, ...], what: str, where: str) -> None:
    if name not in allowed:
        raise DeclarationError(
            f"there is no {what} {name!r}",
            where=f"{where}, key {what}",
            remedy=closest(name, allowed),
        )


def _by_channel(
    given: Mapping[str, Quantity],
    allowed: tuple[str, ...],
    units: Mapping[str, str],
    where: str,
    key: str,
) -> dict[str, float]:
    for name in given:
        if name not in allowed:
            raise DeclarationError(
                f"there is no channel {name!r} here",
                where=f"{where}, key {key}",
                remedy=closest(name, allowed),
            )
    return {
        name: positive(
            si(value, units[name], f"{where}, key {key}.{name}"), f"{where}, key {key}.{name}"
        )
        for name, value in given.items()
    }
