"""A random examination of the tracing loop: model, vehicle, rate, channels, maneuvers, and what is
hidden, all drawn from a seed.

Each record is written, diagnosed by what the loop is told (two files and a vehicle file), and
marked: right name, held-out error, and how many standard deviations the derivatives are off.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np

from exam.random_cases.case import Case, CaseScore
from exam.random_cases.case_scoring import case_score_of, refusal_score_of
from exam.random_cases.flying import Values, drawn_values, flown, values_again
from exam.random_cases.kinds import KINDS, drawable, families
from exam.random_cases.vehicles import RATES, Flight, drawn_flights, drawn_vehicle, vehicle_file
from exam.random_cases.visible import all_visible
from exam.scoring import same_fault
from scenarios.diagnosis.diagnose import diagnose_files
from scenarios.files.writing import write_record
from scenarios.preparation.plan import Request
from sim.declaration.model import Model
from sim.errors import FlightidError, ModelError
from sim.record import Record

MODELS = {"rigid": 0.6, "loes": 0.25, "ballistic": 0.15}
GROUPS = {
    "nothing": 0.15,
    "one effect": 0.3,
    "two effects": 0.25,
    "foreign": 0.15,
    "recorder": 0.15,
}
TRIES = 20  # of sizes, for one case
# Both change the airspeed; a truth with two laws for it is none.
NEVER_TOGETHER = frozenset({"phugoid", "speed-variation"})


@dataclass(frozen=True, eq=False)
class Written:
    """A case in a folder: the true model, what is hidden in the first record, and what the loop is
    told.
    """

    case: Case
    model: Model
    values: Values
    request: Request


def examine(seed: int, group: str = "") -> CaseScore:
    """Draw a case, fly it, have it diagnosed, and score it; all but the time depends on these
    alone.

    ``group`` : one of ``GROUPS``; empty, it is drawn as well.
    """
    with tempfile.TemporaryDirectory(prefix="flightid-") as name:
        return score_written(write_case(seed, Path(name), group), Path(name))


def score_written(written: Written, folder: Path) -> CaseScore:
    """Have a case diagnosed from its files, and score it."""
    started = process_time()
    try:
        tracing = diagnose_files(written.request)
    except FlightidError as fault:
        score = refusal_score_of(written.case, fault, process_time() - started)
        # The folder's name is chance, and no part of a score.
        return replace(score, values=written.values, said=score.said.replace(f"{folder}/", ""))
    score = case_score_of(written.case, written.model, tracing, process_time() - started)
    return replace(score, values=written.values)


def write_case(seed: int, folder: Path, group: str = "") -> Written:
    """Write a seed's case into a folder that exists: ``train.csv`` and ``validate.csv`` with their
    sidecars, ``vehicle.toml``.
    """
    rng = np.random.default_rng((seed, 3))
    name = _chosen(MODELS, rng)
    label, model = drawn_vehicle(name, rng)
    rate = float(rng.choice(RATES[name]))
    channels = _channels(name, rng)
    drawn = _chosen(GROUPS, rng)
    for _ in range(TRIES):
        written = _written(seed, name, label, model, rate, channels, group or drawn, folder, rng)
        if written is not None:
            return written
    raise ModelError(
        f"{TRIES} cases hide what no one could see",
        where=f"case {seed}",
        remedy="draw larger sizes of what is hidden",
    )


def write_clean(name: str, seed: int, folder: Path) -> tuple[Written, Flight]:
    """A case of one model in which nothing is hidden, drawn as others are, and the flight of its
    first record.

    Raises
    ------
    ModelError : no such case that can be flown.
    """
    rng = np.random.default_rng((seed, 3))
    for _ in range(TRIES):
        label, model = drawn_vehicle(name, rng)
        rate = float(rng.choice(RATES[name]))
        channels = _channels(name, rng)
        flights = drawn_flights(model, rate, rng)
        written = _flown_and_written(
            Case(seed, label, (), frozenset(), False, channels, rate, name, "nothing"),
            model,
            flights,
            folder,
            rng,
        )
        if written is not None:
            return written, flights[0]
    raise ModelError(
        f"{TRIES} cases of {name} cannot be flown",
        where=f"case {seed}",
        remedy="draw smaller maneuvers",
    )


def _channels(model: str, rng: np.random.Generator) -> tuple[str, ...]:
    return (
        ("altitude",)
        if model == "ballistic"
        else ("alpha", "q", "nz")
        if rng.random() < 0.75
        else ("alpha", "q")
    )


def _written(
    seed: int,
    name: str,
    label: str,
    model: Model,
    rate: float,
    channels: tuple[str, ...],
    group: str,
    folder: Path,
    rng: np.random.Generator,
) -> Written | None:
    """A case of a group; None where what was drawn could not be flown, or seen."""
    hidden = drawn_hidden(group, name, channels, rng)
    answers = frozenset(KINDS[kind].answer for kind in hidden if KINDS[kind].answer)
    outside = any(not KINDS[kind].answer for kind in hidden)
    told = {0: "nothing", 1: "one effect", 2: "two effects"}[len(answers)] if not outside else group
    case = Case(seed, label, hidden, answers, outside, channels, rate, name, told)
    return _flown_and_written(case, model, drawn_flights(model, rate, rng), folder, rng)


def _flown_and_written(
    case: Case, model: Model, flights: tuple[Flight, Flight], folder: Path, rng: np.random.Generator
) -> Written | None:
    """A case's files in a folder; None where what is hidden could not be flown, or seen."""
    sane = _flown_sanely(case, *flights, rng)
    if sane is None:
        return None
    first, records = sane
    for stem, record in zip(("train", "validate"), records, strict=True):
        write_record(folder, record, stem)
    vehicle = folder / "vehicle.toml"
    vehicle.write_text(vehicle_file(model, rng), encoding="utf-8", newline="\n")
    return Written(
        case,
        model,
        first,
        Request((folder / "train.csv",), case.model, vehicle, (folder / "validate.csv",)),
    )


def _flown_sanely(
    case: Case, train: Flight, validate: Flight, rng: np.random.Generator
) -> tuple[Values, tuple[Record, Record]] | None:
    """What is hidden in the first record, and both; drawn anew where it would not be seen, or leave
    the range of any model.
    """
    for _ in range(TRIES):
        first = drawn_values(case.hidden, train.setting, rng)
        if not all_visible(case, first, train):
            continue
        again = values_again(case.hidden, first, validate.setting, rng)
        try:
            return first, (flown(case, first, train, rng), flown(case, again, validate, rng))
        except ModelError:
            continue
    return None


def drawn_hidden(
    group: str, model: str, channels: tuple[str, ...], rng: np.random.Generator
) -> tuple[str, ...]:
    """Names of what a case of a group hides. A falling body has one channel, which does not
    separate two effects: it hides one.
    """
    if group == "nothing":
        return ()
    if group == "recorder":
        among = families(drawable(group, model, channels))
        family = str(rng.choice(sorted(among)))
        return (str(rng.choice(among[family])),)
    if group == "foreign":
        return (str(rng.choice(drawable(group, model, channels))),)
    names = drawable("effect", model, channels)
    first = str(rng.choice(names))
    if group == "one effect" or model == "ballistic":
        return (first,)
    return first, str(rng.choice([name for name in names if _go_together(first, name)]))


def _go_together(one: str, other: str) -> bool:
    """Whether two effects are two: not one fault by two names, nor two laws of one quantity."""
    a, b = KINDS[one].answer, KINDS[other].answer
    return not same_fault(a) & same_fault(b) and {a, b} != NEVER_TOGETHER


def _chosen(shares: dict[str, float], rng: np.random.Generator) -> str:
    return str(rng.choice(list(shares), p=list(shares.values())))
