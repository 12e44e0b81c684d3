"""Rates of false alarms of the tracing loop, and of detection and right naming of effects of a
given strength.

Strength is the expected gain of the log likelihood. It is half the squared change of the outputs by
the effect, in noise sigmas, without the part that changes of the declared model's parameters,
initial state or biases can explain.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from time import process_time

import numpy as np

from exam.aircraft import NOISE, USUAL, drawn_aircraft
from exam.scoring import same_fault
from ident.statistics.intervals import clopper_pearson
from ident.tracing.diagnosis import Diagnosis
from scenarios.diagnosis.diagnose import diagnose_files
from scenarios.files.writing import write_record
from scenarios.preparation.plan import Request
from scenarios.report.document import Cell, counted, formatted
from sim.declaration.effect import full_name
from sim.declaration.model import Model, Noise
from sim.effects.library import find_effect
from sim.maneuvers import Maneuver, Sum, doublet, three_two_one_one
from sim.record import Channel, Record
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import RIGID_CONSTANTS

DURATION = 20.0  # s
PEAK = 0.06  # rad
WEAK = {
    "input-delay": ("delay", 0.2),
    "actuator-lag": ("time_constant", 0.2),
    "input-deadband": ("half_width", 0.03),
    "input-backlash": ("half_width", 0.03),
    "vane-offset": ("arm", 20.0),
    "sensor-lag:q": ("time_constant", 0.2),
    "sensor-scale:nz": ("scale", 1.5),
    "sensor-drift:alpha": ("slope", 0.01),
    "speed-variation": ("rate", 5.0),
}


class Finding(Enum):
    """Outcome for a record with one weak effect."""

    RIGHT = "named right"
    AMBIGUOUS = "ambiguous, the right name among the alternatives"
    UNEXPLAINED = "detected, not named"
    WRONG = "named wrong"
    MISSED = "not detected"


@dataclass(frozen=True)
class Setting:
    """Common settings of the records of a campaign: channels, degrees of freedom of the noise (0
    for normal noise), rate in 1/s.
    """

    label: str
    channels: tuple[str, ...] = ("alpha", "q", "nz")
    tails: float = 0.0
    rate: float = 50.0


@dataclass(frozen=True)
class Alarm:
    """One clean record: its seed, the verdict, the claimed effects, and the label of its
    setting.
    """

    seed: int
    aircraft: str
    verdict: str
    claimed: tuple[str, ...]
    seconds: float
    setting: str = ""


@dataclass(frozen=True)
class Detection:
    """One record with a weak effect: its size, and the outcome."""

    seed: int
    effect: str
    gain: float
    size: float
    finding: Finding
    claimed: tuple[str, ...]
    seconds: float


# If nz is recorded, even the smallest delay of the surface changes the sample at each switch by the
# whole jump, so that the strength of these effects cannot be set.
WITHOUT_NZ = ("input-delay", "actuator-lag")
SETTINGS = (
    Setting("three channels"),
    Setting("alpha and q only", ("alpha", "q")),
    Setting("three channels, heavy tails (Student's t, 3.5 degrees of freedom)", tails=3.5),
)


def weak_setting(effect: str) -> Setting:
    """Return a setting in which the strength of an effect can be set: three channels, or two."""
    return SETTINGS[1] if effect in WITHOUT_NZ else SETTINGS[0]


def clean_run(setting: Setting, seed: int) -> Alarm:
    """Fly and diagnose one record with nothing hidden. Aircraft, derivatives, noise and starting
    values are drawn from the seed.
    """
    rng = np.random.default_rng((seed, 1))
    name, model = drawn_aircraft(rng)
    diagnosis, seconds = traced(model, model, setting, rng)
    return Alarm(seed, name, diagnosis.verdict.value, _claimed(diagnosis), seconds, setting.label)


def weak_run(setting: Setting, effect: str, gain: float, seed: int) -> Detection:
    """Fly and diagnose one record with an effect of the size that gives the wanted expected
    gain.
    """
    rng = np.random.default_rng((seed, 2))
    _, model = drawn_aircraft(rng)
    size = size_of(model, effect, gain, setting)
    diagnosis, seconds = traced(model, with_effect(model, effect, size), setting, rng)
    return Detection(
        seed, effect, gain, size, found(effect, diagnosis), _claimed(diagnosis), seconds
    )


def found(effect: str, diagnosis: Diagnosis) -> Finding:
    """Return the outcome of a diagnosis for one hidden effect; a lag and a delay of the same sensor
    count as one.
    """
    right = same_fault(effect)
    claims = [claim for claim in diagnosis.effects if claim.claimed]
    if diagnosis.verdict.value == "consistent":
        return Finding.MISSED
    if diagnosis.verdict.value == "unexplained" or not claims:
        return Finding.UNEXPLAINED
    if len(claims) == 1 and claims[0].name in right:
        return Finding.RIGHT
    if len(claims) == 1 and right & set(claims[0].alternatives):
        return Finding.AMBIGUOUS
    return Finding.WRONG


def with_effect(model: Model, name: str, size: float) -> Model:
    """Return the aircraft with a library effect at a value of its one parameter."""
    effect = find_effect(name, model.equations)
    return model.with_effects(effect).with_values({full_name(effect, WEAK[name][0]): size})


def traced(
    declared: Model, true: Model, setting: Setting, rng: np.random.Generator
) -> tuple[Diagnosis, float]:
    """Fly two records, write them, and have the files diagnosed; return the diagnosis and its
    processor time in s.
    """
    with tempfile.TemporaryDirectory(prefix="flightid-") as name:
        folder = Path(name)
        for stem, maneuver in (("train", _first()), ("validate", _second())):
            write_record(folder, _measured(flown(true, maneuver, setting), setting, rng), stem)
        lines = [f"{key} = {declared.parameters[key].value!r}" for key in RIGID_CONSTANTS]
        lines += [
            "[derivatives]",
            *(
                f"{key} = {declared.parameters[key].value * rng.uniform(0.7, 1.3)!r}"
                for key in USUAL
            ),
        ]
        vehicle = folder / "vehicle.toml"
        vehicle.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
        started = process_time()
        tracing = diagnose_files(
            Request((folder / "train.csv",), "rigid", vehicle, (folder / "validate.csv",))
        )
        return tracing.diagnosis, process_time() - started


def flown(model: Model, maneuver: Maneuver, setting: Setting) -> Record:
    """Fly one record without noise, in steps of 5 ms; input paths use finer cells."""
    time = sample_times(setting.rate, DURATION)
    record, _ = fly(
        model.with_noise(Noise()),
        maneuver,
        time,
        np.random.default_rng(0),
        step=0.005,
        outputs=setting.channels,
    )
    return record


def size_of(model: Model, name: str, gain: float, setting: Setting) -> float:
    """Return the value of an effect's parameter whose expected log-likelihood gain on the training
    record is ``gain``; at most the largest of ``WEAK``.
    """
    effect = find_effect(name, model.equations)
    local, most = WEAK[name]
    absent = effect.absent[local]
    base = _whitened(flown(model, _first(), setting), setting)
    columns = _columns(model, base, setting)

    def reached(share: float) -> float:
        changed = (
            _whitened(
                flown(
                    with_effect(model, name, absent + share * (most - absent)), _first(), setting
                ),
                setting,
            )
            - base
        )
        rest = changed - columns @ np.linalg.lstsq(columns, changed, rcond=None)[0]
        return 0.5 * float(rest @ rest)

    # The gain is nearly proportional to the square of the size, so a few corrections suffice.
    share = 0.05
    for _ in range(5):
        share = min(1.0, share * float(np.sqrt(gain / max(reached(share), 1e-12))))
    return absent + share * (most - absent)


def alarm_rows(alarms: Mapping[str, Sequence[Alarm]]) -> list[tuple[Cell, ...]]:
    """Return the rows: setting, runs, false claims, not consistent, 95 % interval of false claims
    in per cent, median processor time in s.
    """
    rows: list[tuple[Cell, ...]] = []
    for label, group in alarms.items():
        claims, other = (
            sum(bool(alarm.claimed) for alarm in group),
            sum(alarm.verdict != "consistent" for alarm in group),
        )
        low, high = clopper_pearson(claims, len(group))
        seconds = float(np.median([alarm.seconds for alarm in group]))
        rows.append(
            (
                label,
                counted(len(group)),
                counted(claims),
                counted(other),
                f"{100 * low:.1f} to {100 * high:.1f}",
                formatted(seconds, ".1f"),
            )
        )
    return rows


def detection_rows(
    detections: Sequence[Detection], by: Callable[[Detection], str]
) -> list[tuple[Cell, ...]]:
    """Return the rows: group, runs, detected, named right, ambiguous, unexplained, wrong, and the
    95 % interval of detection in per cent.
    """
    rows: list[tuple[Cell, ...]] = []
    for label in dict.fromkeys(by(detection) for detection in detections):
        group = [detection for detection in detections if by(detection) == label]
        count = {
            finding: sum(detection.finding is finding for detection in group) for finding in Finding
        }
        seen = len(group) - count[Finding.MISSED]
        low, high = clopper_pearson(seen, len(group))
        named = (
            count[Finding.RIGHT],
            count[Finding.AMBIGUOUS],
            count[Finding.UNEXPLAINED],
            count[Finding.WRONG],
        )
        rows.append(
            (
                label,
                counted(len(group)),
                counted(seen),
                *map(counted, named),
                f"{100 * low:.0f} to {100 * high:.0f}",
            )
        )
    return rows


def _claimed(diagnosis: Diagnosis) -> tuple[str, ...]:
    return tuple(claim.name for claim in diagnosis.effects if claim.claimed)


def _first() -> Maneuver:
    return Sum((three_two_one_one(PEAK, 0.5, 1.0), doublet(-0.5 * PEAK, 1.0, 9.0)))


def _second() -> Maneuver:
    return Sum((doublet(0.9 * PEAK, 0.8, 1.0), three_two_one_one(-0.7 * PEAK, 0.4, 6.0)))


def _measured(record: Record, setting: Setting, rng: np.random.Generator) -> Record:
    outputs = []
    for channel in record.outputs:
        n = len(record.time)
        unit = (
            rng.standard_t(setting.tails, n) * np.sqrt(1.0 - 2.0 / setting.tails)
            if setting.tails
            else rng.standard_normal(n)
        )
        outputs.append(
            Channel.of(channel.name, channel.unit, channel.values + NOISE[channel.name] * unit)
        )
    return Record(record.time, record.inputs, tuple(outputs), record.hold, record.name)


def _whitened(record: Record, setting: Setting) -> np.ndarray:
    return np.concatenate([record[name].values / NOISE[name] for name in setting.channels])


def _columns(model: Model, base: np.ndarray, setting: Setting) -> np.ndarray:
    """Return the changes of the outputs by the declared unknowns: derivatives, initial state, one
    bias for each channel.
    """
    columns = []
    for name in USUAL:
        value = model.parameters[name].value
        moved = flown(model.with_values({name: value * (1.0 + 1e-4)}), _first(), setting)
        columns.append(_whitened(moved, setting) - base)
    for state in model.initial.names:
        started = model.with_initial(model.initial.with_values({state: 1e-4}))
        columns.append(_whitened(flown(started, _first(), setting), setting) - base)
    count = len(base) // len(setting.channels)
    columns += [
        np.repeat(np.arange(len(setting.channels)) == i, count).astype(float)
        for i in range(len(setting.channels))
    ]
    return np.array([column / np.linalg.norm(column) for column in columns]).T
