"""A random examination of the tracing loop: cases drawn from seeds, examined as tasks, and the
command lines.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from exam.options import STOPPED, Parser, ended_in_one_line, manner_of
from exam.random_cases.case import Case, CaseScore, Named
from exam.random_cases.case_scoring import (
    case_score_of,
    refusal_score_of,
    reliability_table,
    summary_table,
)
from exam.random_cases.flying import Values, all_visible, drawn_values, flown, values_again
from exam.random_cases.kinds import KINDS, drawable, families
from exam.random_cases.vehicles import RATES, Flight, drawn_flights, drawn_vehicle, vehicle_file
from exam.repeated import FlownCampaign, LoopFlights, fly_all
from exam.scoring import Statement, same_fault
from scenarios.diagnosis.diagnose import diagnose_files
from scenarios.files.writing import write_record, write_text
from scenarios.preparation.plan import Request
from scenarios.report.terminal import progress_bar
from scenarios.tasks.study import Execution
from sim.declaration.model import Model
from sim.errors import DeclarationError, FlightidError, ModelError
from sim.record import Record

# ---- A random examination of the tracing loop

MODELS = {"rigid": 0.6, "loes": 0.25, "ballistic": 0.15}
GROUPS = {
    "nothing": 0.15,
    "one effect": 0.3,
    "two effects": 0.25,
    "foreign": 0.15,
    "recorder": 0.15,
}
TRIES = 20  # draws of sizes for one case
# Both change the airspeed, which has one true law only.
NEVER_TOGETHER = frozenset({"phugoid", "speed-variation"})


@dataclass(frozen=True, eq=False)
class Written:
    """A case in a folder: the true model, the hidden causes of the first record, and the request
    for the loop.
    """

    case: Case
    model: Model
    values: Values
    request: Request


def examine(seed: int, group: str = "") -> CaseScore:
    """Draw a case, fly it, have it diagnosed, and score it.

    Everything but the time depends on the arguments alone. ``group`` is one of ``GROUPS``; an empty
    one is drawn as well.
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
        # The name of the folder is random and must not be part of a score.
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
    """Write a case of one model with nothing hidden, drawn like other cases; return it with the
    flight of its first record.

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
    """Write a case of a group; return None if the draw cannot be flown or observed."""
    hidden = drawn_hidden(group, name, channels, rng)
    answers = frozenset(KINDS[kind].answer for kind in hidden if KINDS[kind].answer)
    outside = any(not KINDS[kind].answer for kind in hidden)
    told = {0: "nothing", 1: "one effect", 2: "two effects"}[len(answers)] if not outside else group
    case = Case(seed, label, hidden, answers, outside, channels, rate, name, told)
    return _flown_and_written(case, model, drawn_flights(model, rate, rng), folder, rng)


def _flown_and_written(
    case: Case, model: Model, flights: tuple[Flight, Flight], folder: Path, rng: np.random.Generator
) -> Written | None:
    """Write the files of a case into a folder; return None if the hidden cause cannot be flown or
    observed.
    """
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
    """Return the hidden causes of the first record, and both records.

    The draw is repeated if the causes would not be observable, or the motion would leave the range
    of any model.
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
    """Draw the names of the hidden causes of a case.

    A falling body has one channel, which cannot separate two effects. It has one hidden cause.
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
    """Return whether two effects can be hidden together.

    They can unless they are one fault with two names, or two laws of one quantity.
    """
    a, b = KINDS[one].answer, KINDS[other].answer
    return not same_fault(a) & same_fault(b) and {a, b} != NEVER_TOGETHER


def _chosen(shares: dict[str, float], rng: np.random.Generator) -> str:
    return str(rng.choice(list(shares), p=list(shares.values())))


# ---- A series of cases, from a first seed on


def examined(first: int, count: int, execution: Execution, group: str = "") -> FlownCampaign:
    """Return scores of the cases ``first`` to ``first + count - 1``; if stopped, of those that had
    ended.

    ``group`` : the group of all cases; empty if each case draws its own.
    """
    told = {"first": first, **({"group": group} if group else {})}
    work = LoopFlights("random-cases", partial(_case, first, group), CaseScore, told)
    with progress_bar(True) as tell:
        return fly_all(work, count, first, execution, tell)


def _case(first: int, group: str, number: int, seed: int) -> CaseScore:
    """Return a case with the small seed of its number, by which documents name it."""
    return examine(first + number, group)


def line_of(score: CaseScore) -> Mapping[str, Any]:
    """Return the line of the file for a score; numbers that are not finite are left out."""
    case = score.case
    return {
        **{
            "seed": case.seed,
            "model": case.model,
            "aircraft": case.aircraft,
            "rate": case.rate,
            "channels": case.channels,
        },
        **{
            "group": case.group,
            "hidden": case.hidden,
            "values": score.values,
            "verdict": score.verdict,
        },
        "claims": [
            [{"name": named.name, "hidden": named.hidden} for named in claim]
            for claim in score.claims
        ],
        "statements": [asdict(statement) for statement in score.statements],
        **{"right": score.right, "wrong": score.wrong, "said": score.said},
        "held_out_error": score.held_out if math.isfinite(score.held_out) else -1.0,
        "errors_in_sigmas": {
            name: error for name, error in score.errors.items() if math.isfinite(error)
        },
        "seconds": score.seconds,
    }


def score_of_line(line: Mapping[str, Any]) -> CaseScore:
    """Return the score of a line.

    Raises
    ------
    DeclarationError : a key is missing, or a hidden cause has another name than those of today.
    """
    try:
        hidden = tuple(line["hidden"])
        kinds = [KINDS[name] for name in hidden]
        case = Case(
            line["seed"],
            line["aircraft"],
            hidden,
            frozenset(kind.answer for kind in kinds if kind.answer),
            any(not kind.answer for kind in kinds),
            tuple(line["channels"]),
            line["rate"],
            line["model"],
            line["group"],
        )
        claims = tuple(
            tuple(Named(each["name"], each["hidden"]) for each in claim) for claim in line["claims"]
        )
        return CaseScore(
            case,
            line["verdict"],
            tuple(claim[0].name for claim in claims),
            line["right"],
            line["wrong"],
            line["errors_in_sigmas"],
            line["held_out_error"],
            line["seconds"],
            claims,
            tuple(Statement(**each) for each in line["statements"]),
            line["values"],
            line["said"],
        )
    except (KeyError, TypeError, IndexError) as fault:
        what = f"{fault} is not what a line of random cases has"
        remedy = "name a file that python -m exam random wrote"
        raise DeclarationError(what, where="exam", remedy=remedy) from None


# ---- Random cases by their seeds, and the tables of what was found in them

LINES = "cases.jsonl"


def random_cases(arguments: Sequence[str] | None = None) -> int:
    """Cases whose model, vehicle, record and hidden cause are drawn from a seed."""
    return _examine("random", arguments)


def foreign_causes(arguments: Sequence[str] | None = None) -> int:
    """Random cases that hide a cause that no effect of the library names."""
    return _examine("foreign", arguments)


def recorder_faults(arguments: Sequence[str] | None = None) -> int:
    """Random cases that hide a fault of the recorder."""
    return _examine("recorder", arguments)


def _examine(name: str, arguments: Sequence[str] | None) -> int:
    """Examine COUNT cases from seed FIRST on.

    Each score is stored as soon as it is known; ``cases.jsonl`` has them in the order of the seeds.
    """
    parser = Parser(name, "random cases, one JSON line each")
    parser.add_argument("first", type=int, metavar="FIRST", help="the first seed")
    parser.add_argument("count", type=int, metavar="COUNT", help="how many seeds")
    parser.add_manner(out_required=True)
    asked = parser.parse_args(arguments)
    if asked.first < 0 or asked.count < 1:
        parser.error("FIRST is 0 or more, COUNT is 1 or more")
    group = name if name in GROUPS else ""

    def work() -> int:
        done = examined(asked.first, asked.count, manner_of(asked), group)
        lines = [json.dumps(line_of(score), allow_nan=False) + "\n" for score in done.found]
        write_text(asked.out / LINES, "".join(lines))
        _print_tables(done.found)
        print(f"{done.ended} of {done.asked} cases, {done.words}")
        return 0 if done.whole else STOPPED

    return ended_in_one_line(name, work)


def score(arguments: Sequence[str] | None = None) -> int:
    """Print the tables of examined random cases, from the files of one or several series."""
    parser = Parser("score", "tables of random cases from their files")
    parser.add_argument("files", type=Path, nargs="+", metavar="CASES.jsonl")
    asked = parser.parse_args(arguments)

    def work() -> int:
        found = [each for file in asked.files for each in _read(file)]
        _print_tables(found)
        print(f"{len(found)} cases")
        return 0

    return ended_in_one_line("score", work)


def _read(file: Path) -> list[CaseScore]:
    try:
        lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    except ValueError as fault:
        what = f"this is not one JSON object a line: {fault}"
        remedy = "name a file that python -m exam random wrote"
        raise DeclarationError(what, where=str(file), remedy=remedy) from None
    return [score_of_line(line) for line in lines]


def _print_tables(found: Sequence[CaseScore]) -> None:
    if found:
        print("\n".join(summary_table(found)))
        statements = [statement for each in found for statement in each.statements]
        print("\n".join(reliability_table(statements)))
