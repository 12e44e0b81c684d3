"""A random examination of the tracing loop: aircraft, rate, channels, maneuvers, and what is hidden, all drawn from a seed.

Each record is written, diagnosed by what the loop is told (two files and a vehicle file), and marked: right name, held-out error, and
how many standard deviations the derivatives are off.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from ident.statistics.shares import clopper_pearson, clustered_share
from ident.tracing.diagnosis import Diagnosis
from scenarios.diagnosis.diagnose import diagnose_files
from scenarios.files.writing import write_record
from scenarios.preparation.request import Request
from scenarios.trials.aircraft import NOISE, USUAL, drawn_aircraft
from scenarios.trials.kinds import KINDS
from scenarios.trials.planted.hiding import OWN, find_term
from scenarios.trials.scoring import same_fault
from sim.declaration.effect import full_name
from sim.declaration.model import Model, Noise
from sim.maneuvers.multisine import schroeder_multisine
from sim.maneuvers.steps import Maneuver, MultiStep, Sum, alternating, doublet, three_two_one_one
from sim.record import Channel, Record
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import RIGID_CONSTANTS


@dataclass(frozen=True)
class Paper:
    """One record pair with what is hidden in it; ``interval`` is the sampling interval, s."""

    seed: int
    aircraft: str
    hidden: tuple[str, ...]
    answers: frozenset[str]
    outside: bool
    channels: tuple[str, ...]
    rate: float


@dataclass(frozen=True)
class Mark:
    """A paper marked.

    ``right`` the names are those hidden (or none, where nothing is or nothing in the library fits); ``wrong`` a claim names what is not there.
    ``errors`` derivative errors in reported standard deviations; ``held_out`` the worst channel's error over the noise.
    """

    paper: Paper
    verdict: str
    claimed: tuple[str, ...]
    right: bool
    wrong: bool
    errors: Mapping[str, float]
    held_out: float
    seconds: float


RATES = (20.0, 25.0, 50.0, 50.0, 100.0)


def examine(seed: int) -> Mark:
    """Draw a paper, fly it, have it diagnosed, and mark it; a third hides one thing, a third two, the rest nothing or something foreign."""
    rng = np.random.default_rng((seed, 3))
    aircraft, model = drawn_aircraft(rng)
    rate, duration = float(rng.choice(RATES)), float(rng.uniform(12.0, 25.0))
    channels = ("alpha", "q", "nz") if rng.random() < 0.75 else ("alpha", "q")
    named = [name for name, kind in KINDS.items() if kind.answer and set(kind.channels) <= set(channels)]
    share = rng.random()
    if share < 0.15:
        hidden: tuple[str, ...] = ()
    elif share < 0.25:
        hidden = (str(rng.choice([name for name, kind in KINDS.items() if not kind.answer])),)
    else:
        hidden = tuple(str(name) for name in rng.choice(named, 1 if share < 0.65 else 2, replace=False))
        hidden = hidden[: len({KINDS[name].answer for name in hidden})]
    paper = Paper(
        seed,
        aircraft,
        hidden,
        frozenset(KINDS[name].answer for name in hidden if KINDS[name].answer),
        any(not KINDS[name].answer for name in hidden),
        channels,
        rate,
    )
    return marked(paper, model, rng, duration)


def marked(paper: Paper, model: Model, rng: np.random.Generator, duration: float) -> Mark:
    """Fly a paper's two records, have them diagnosed, and compare."""
    peak = float(rng.uniform(0.03, 0.08))
    with tempfile.TemporaryDirectory(prefix="flightid-") as name:
        folder = Path(name)
        first = _values(paper, rng, peak, duration)
        for stem, maneuver in zip(("train", "validate"), _maneuvers(rng, peak, duration), strict=True):
            values = first if stem == "train" else _again(paper, first, rng, peak, duration)
            write_record(folder, _flown(model, values, maneuver, paper, duration, rng), stem)
        lines = [f"{key} = {model.parameters[key].value!r}" for key in RIGID_CONSTANTS]
        lines += ["[derivatives]", *(f"{key} = {model.parameters[key].value * rng.uniform(0.7, 1.3)!r}" for key in USUAL)]
        vehicle = folder / "vehicle.toml"
        vehicle.write_text("\n".join(lines) + "\n", encoding="utf-8")
        started = process_time()
        diagnosis = diagnose_files(Request((folder / "train.csv",), "rigid", vehicle, (folder / "validate.csv",))).diagnosis
        seconds = process_time() - started
    return _mark(paper, model, diagnosis, seconds)


def _mark(paper: Paper, model: Model, diagnosis: Diagnosis, seconds: float) -> Mark:
    claims = [claim for claim in diagnosis.effects if claim.claimed]
    left, wrong = set(paper.answers), False
    for claim in claims:
        hit = next((answer for answer in left if _same(answer, claim.name, claim.alternatives)), None)
        if hit is None:
            wrong = True
        left.discard(hit or "")
    right = not wrong and not left and (diagnosis.verdict.value == "unexplained" if paper.outside else True)
    if not paper.hidden:
        right = diagnosis.verdict.value == "consistent"
    errors = {
        name: (diagnosis.after[name].value - model.parameters[name].value) / diagnosis.after[name].std for name in USUAL if name in diagnosis.after
    }
    held_out = max(rmse / NOISE[name] for name, rmse in diagnosis.error_after.rmse.items())
    return Mark(paper, diagnosis.verdict.value, tuple(claim.name for claim in claims), right, wrong, errors, held_out, seconds)


def _same(answer: str, name: str, alternatives: Sequence[str]) -> bool:
    accepted = same_fault(answer)
    return name.partition("#")[0] in {*accepted, *(a.partition(":")[0] for a in accepted if a.startswith("elastic"))} or bool(
        accepted & set(alternatives)
    )


def _values(paper: Paper, rng: np.random.Generator, peak: float, duration: float) -> dict[str, Mapping[str, float]]:
    return {name: KINDS[name].draw(rng, peak, duration) for name in paper.hidden}


def _again(
    paper: Paper, first: Mapping[str, Mapping[str, float]], rng: np.random.Generator, peak: float, duration: float
) -> dict[str, Mapping[str, float]]:
    return {name: KINDS[name].draw(rng, peak, duration) if KINDS[name].apart else first[name] for name in paper.hidden}


def _maneuvers(rng: np.random.Generator, peak: float, duration: float) -> tuple[Maneuver, Maneuver]:
    """Two maneuvers of different shape that leave some quiet at the end."""
    unit = float(rng.uniform(0.3, 0.7))
    period = round(duration - 3.0)
    sine = schroeder_multisine(0.45 * peak, float(period), range(1, max(4, round(1.6 * period)), 2), 1.0)
    choices: list[Maneuver] = [
        Sum((three_two_one_one(peak, unit, 1.0), doublet(-0.6 * peak, 1.6 * unit, 1.0 + 9.0 * unit))),
        Sum((doublet(0.9 * peak, 0.8, 1.0), three_two_one_one(-0.7 * peak, 0.8 * unit, 4.0))),
        Sum((alternating(peak, (0.7, 0.5, 0.3, 0.3), 1.0), alternating(0.55 * peak, (1.0, 0.6, 0.4), 4.5))),
        sine,
    ]
    one, two = rng.choice(len(choices), 2, replace=False)
    return choices[int(one)], choices[int(two)]


def _flown(
    model: Model, hidden: Mapping[str, Mapping[str, float]], maneuver: Maneuver, paper: Paper, duration: float, rng: np.random.Generator
) -> Record:
    true = model.with_noise(Noise())
    for name, values in hidden.items():
        effect = find_term(KINDS[name].term, model.equations, name)
        local = {item.name for item in effect.parameters}
        extra = {"duration": duration, "width": 1.0 / paper.rate} if "spikes" in name else {}
        true = true.with_effects(effect).with_values({full_name(effect, key): value for key, value in {**values, **extra}.items() if key in local})
    time = sample_times(paper.rate, duration)
    # As a record has it: what is sampled is held until the next sample, switches between samples are none.
    held = MultiStep(tuple(maneuver(time).tolist()), (*time.tolist(), float(time[-1] + 1.0 / paper.rate)))
    record, _ = fly(true, held, time, rng, step=0.002, outputs=paper.channels)
    outputs = (Channel.of(c.name, c.unit, c.values + NOISE[c.name] * rng.standard_normal(len(record))) for c in record.outputs)
    return Record(record.time, record.inputs, tuple(outputs), record.hold, record.name)


def summary(marks: Sequence[Mark]) -> dict[str, float]:
    """Shares over many papers: right, wrong claims, derivatives within two standard deviations where right, and the held-out error's median."""
    count, right = len(marks), [mark for mark in marks if mark.right]
    free = [mark for mark in right if not any(OWN in name or "turbulence" in name or "spikes" in name for name in mark.paper.hidden)]
    told = [np.abs([*mark.errors.values()]) for mark in right if not mark.paper.outside and mark.errors]
    within, of = np.array([np.sum(errors < 2.0) for errors in told]), np.array([len(errors) for errors in told])
    # Derivatives of one paper are correlated: the interval counts papers.
    low, high = clustered_share(within, of, np.random.default_rng(0)) if told else (0.0, 1.0)
    wrong = sum(mark.wrong for mark in marks)
    return {
        "papers": float(count),
        "right": len(right) / count,
        "wrong claims": wrong / count,
        "wrong claims, upper 95 %": clopper_pearson(wrong, count)[1],
        "derivatives within two sigmas": float(within.sum() / of.sum()) if told else 0.0,
        "derivatives within two sigmas, lower 95 %": low,
        "derivatives within two sigmas, upper 95 %": high,
        "held-out error, median": float(np.median([mark.held_out for mark in free])) if free else 0.0,
        "seconds, median": float(np.median([mark.seconds for mark in marks])),
    }
