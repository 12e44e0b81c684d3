"""A flight by JSBSim: its record, vehicle files and truth.

Also the schema of its declaration (pydantic), and conversion of a checked file to a JsbsimFlight.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field

from scenarios.files.declarations import checked, closest, refuse_unknown
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT
from scenarios.files.sources import versions
from scenarios.files.writing import write_json, write_record, write_text
from scenarios.studies.schema import Quantity, positive, positive_si, si
from scenarios.trials.jsbsim_declaration import (
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
    surfaces_of,
    with_faults,
)
from scenarios.trials.jsbsim_machine import (
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
LARGEST_DEFLECTION = math.radians(20.0)  # rad
THROTTLE_STEP = 0.12  # share of the throttle's travel
SMALL_MANEUVER_SHARE = 0.1  # size of the maneuver that gives the derivatives about trim
LEAST_TRAVEL_SHARE = 0.7  # share of the commanded deflection that a surface must reach
UNITS = (0.25, 1.5)  # s, shortest and longest unit of a 3-2-1-1
# Factors on the pilot's gains: the wings are held level while the elevator moves, and return slowly
# while rudder or aileron move.
PITCH_PILOT_FACTOR = 1.0
ROLL_PILOT_FACTOR = 0.3
# Largest excursions from trim by control: twenty times the sensor noise. With twice as much, loss
# of speed in banks and the square of the drag are visible in models about trim.
PEAKS: Mapping[str, Mapping[str, float]] = {
    "elevator": {"alpha": math.radians(2.0), "q": math.radians(8.0)},
    "rudder": {"beta": math.radians(2.5), "p": math.radians(8.0)},
    "aileron": {"p": math.radians(10.0), "phi": math.radians(10.0), "beta": math.radians(2.5)},
}


@dataclass(frozen=True, eq=False)
class JsbsimTruth:
    """True values of a flight, by model.

    Attributes
    ----------
    constants : constants of the vehicle file, SI.
    about_trim, in_maneuver : derivatives about trim, and best linear fits over the maneuver.
    sizes : peak of each surface, rad, and of the throttle, parts of its travel.
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
    simulated = fly(
        replace(calm, rough_air=flight.rough_air),
        commands(flight, wanted, units, time),
        _levelling(wanted),
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


def _levelling(controls: Collection[str]) -> float:
    """Return the factor on the pilot's gains while these controls move."""
    return ROLL_PILOT_FACTOR if "aileron" in controls else PITCH_PILOT_FACTOR


def _refuse_missing_surface(flight: JsbsimFlight) -> None:
    available = surfaces_of(flight.aircraft)
    for key, faults in (("late", flight.late), ("backlash", flight.backlash)):
        for name in faults:
            if name in SURFACES and name not in available:
                what = f"{flight.aircraft} has no {name} that its air loads read"
                raise DeclarationError(
                    what, where=f"key {key}.{name}", remedy="leave it out, or give another aircraft"
                )


def units_of(calm: Condition) -> dict[str, float]:
    """Return the unit of a 3-2-1-1 by control, s: 1.6 over the frequency of the excited mode.

    The frequencies are measured in small motions.
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
    """Return the square root of stiffness over inertia, rad/s.

    The stiffness is the slope of ``moment`` over the first of the signals ``by``.
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
    """Return a 3-2-1-1 of a tenth of the size, in calm air; larger if play absorbs it."""
    share = SMALL_MANEUVER_SHARE
    while True:
        wanted = commands(
            replace(flight, maneuver="3-2-1-1"),
            {control: share * size for control, size in sizes.items()},
            units,
            time,
        )
        # With moving throttle, the torque of a propeller would be as large as the motion.
        wanted.setdefault("throttle", np.zeros(len(time)))
        simulated = fly(calm, wanted, _levelling(wanted))
        travel_shares = [
            np.ptp(simulated[name]) / np.ptp(values)
            for name, values in wanted.items()
            if name in simulated.signals
        ]
        if min(travel_shares) > LEAST_TRAVEL_SHARE or share >= 1.0:
            return simulated
        share = min(1.0, 2.0 * share)


def _recorded(
    flight: JsbsimFlight, simulated: JsbsimSignals, frames: int, rng: np.random.Generator
) -> Record:
    """Return the record: one sample per ``frames``, white noise on outputs, none on inputs."""
    signals = dict(simulated.signals)
    signals |= {f"a{axis}": signals[f"force_{axis}"] / signals["mass"] for axis in "xyz"}
    shown = with_faults(signals, flight)
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

STARTS_APART = 1_000_003  # makes the seeds of starting values differ from those of sensors
LEAST_LOAD_SHARE = 1e-3  # share of a load's spread; derivatives with a smaller effect are left out


def write_jsbsim(
    flight: JsbsimFlight, seed: int, record: Record, truth: JsbsimTruth, folder: Path, stem: str
) -> tuple[dict[str, Path], Path]:
    """Write the files of a flight into a folder.

    They are ``stem.csv`` with its sidecar, ``stem_MODEL.toml`` for each model, ``stem_truth.json``.

    Returns
    -------
    The vehicle files by model, and the path of the truth.
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
    """Return a vehicle file: constants of JSBSim, and derivatives wrong by up to ``wrong``.

    Derivatives without a notable effect are left out.
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
    """Return the content of the truth file: derivatives by model, added faults, settings."""
    settings = {
        key: value
        for key, value in asdict(flight).items()
        if key not in ("name", "title", "about", "seed")
    }
    return {
        "schema": "flightid/truth/1",
        "parameters": {model: dict(slopes.values) for model, slopes in truth.about_trim.items()},
        "in_maneuver": {model: dict(slopes.values) for model, slopes in truth.in_maneuver.items()},
        "variance_left": {model: slopes.left for model, slopes in truth.in_maneuver.items()},
        "hidden": named(flight),
        "flight": settings,
        "controls": dict(truth.sizes),
        "seed": seed,
        "versions": versions(),
    }


# ---- Schema of a flight by JSBSim

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
    refuse_unknown("axis", content.axis, CONTROLS, f"{where}, key axis")
    refuse_unknown("maneuver", content.maneuver, MANEUVERS, f"{where}, key maneuver")
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
    rate = positive_si(content.rate, "1/s", f"{where}, key rate", {"hz": "1/s"})
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
        _by_channel(content.noise_std, OUTPUTS, where, "noise_std"),
        content.rough_air,
        content.wrong,
        _by_channel(content.late, dict.fromkeys((*SURFACES, *OUTPUTS), "s"), where, "late"),
        _by_channel(content.backlash, dict.fromkeys(SURFACES, "rad"), where, "backlash"),
        si(content.vane_ahead, "m", f"{where}, key vane_ahead"),
        content.seed,
    )


def _condition(content: _Jsbsim, where: str) -> tuple[float, float]:
    """Return altitude (m) and airspeed (m/s) as given, else the usual ones of the aircraft."""
    usual = CONDITIONS.get(str(content.aircraft), (None, None))

    def given(key: str, unit: str, value: Quantity | None, usual_value: float | None) -> float:
        if value is not None:
            return si(value, unit, f"{where}, key {key}")
        if usual_value is None:
            raise DeclarationError(
                f"no usual {key} is known of {content.aircraft}",
                where=f"{where}, key {key}",
                remedy=f"give it, or an aircraft of {', '.join(CONDITIONS)}",
            )
        return usual_value

    altitude = given("altitude", "m", content.altitude, usual[0])
    airspeed = given("airspeed", "m/s", content.airspeed, usual[1])
    return altitude, positive(airspeed, f"{where}, key airspeed")


def _by_channel(
    given: Mapping[str, Quantity], units: Mapping[str, str], where: str, key: str
) -> dict[str, float]:
    """Return positive quantities by channel in the ``units`` of the allowed channels."""
    for name in given:
        if name not in units:
            raise DeclarationError(
                f"there is no channel {name!r} here",
                where=f"{where}, key {key}",
                remedy=closest(name, tuple(units)),
            )
    return {
        name: positive_si(value, units[name], f"{where}, key {key}.{name}")
        for name, value in given.items()
    }
