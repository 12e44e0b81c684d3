"""The contribution of each rule of the tracing loop: diagnoses with one rule left out at a time.

A case is diagnosed once with all rules, and every rule that changed something is noted. It is then
diagnosed again without each of these rules in turn. A rule that changed nothing cannot change the
answer, so that no second diagnosis is needed for it.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

from exam.independent.command import diagnosed
from exam.independent.grading import grade
from exam.options import Parser, ended_in_one_line
from exam.random_cases.examination import score_written, write_case
from ident.tracing import decision, loop, names
from ident.tracing.predictive import PredictiveGain
from ident.tracing.search import Search
from scenarios.cli import main as flightid
from scenarios.files.writing import write_text
from sim.errors import DeclarationError

LINES = "ablation.jsonl"
_SEARCHED = loop._searched  # the original function, which a rule may replace
ALL = "all rules"


@dataclass(frozen=True)
class Rule:
    """A rule of the tracing loop that can be left out.

    Attributes
    ----------
    what : the rule in one sentence.
    owner, attribute : object and name of its function.
    without : function that replaces it.
    acted : whether a call changed something, from the state before the call (``before``), the
        result and the arguments.
    """

    what: str
    owner: Any
    attribute: str
    without: Any
    acted: Callable[..., bool]
    before: Callable[..., Any] = lambda *arguments, **named: None


def _leader(search: Search, *_: object) -> frozenset[str]:
    return search.best().names


def _another_leads(before: object, result: object, search: Search, *_: object) -> bool:
    return search.best().names != before


def _nothing(*_: object, **__: object) -> None:
    return None


def _second(first: object, second: Any, *_: object, **__: object) -> Any:
    return second


def _not_second(before: object, result: object, first: object, second: object, *_: Any) -> bool:
    return result is not second


def _given(before: object, result: object, *_: object, **__: object) -> bool:
    return result is not None


def _search_step(what: str, attribute: str) -> Rule:
    """Return a step of the search that only adds fitted sets."""
    return Rule(what, Search, attribute, _nothing, _another_leads, _leader)


RULES: Mapping[str, Rule] = {
    "finer forms": Rule(
        "the leading set of each size is fitted with finer forms of its curves",
        Search,
        "_refined_set",
        _nothing,
        lambda before, result, search, one: result is not None and result.weight > one.weight,
    ),
    "look-alikes": _search_step(
        "effects with the signature of a member are tried in its place", "_try_confusable_effects"
    ),
    "equivalents": _search_step(
        "effects that no record tells from a member are tried in its place",
        "_try_equivalent_effects",
    ),
    "single effects": _search_step(
        "further effects are sought beside the likeliest single ones",
        "_scan_at_single_effects",
    ),
    "moved events": Rule(
        "events of the leading set are tried earlier and later",
        Search,
        "_with_moved_events",
        _second,
        _not_second,
    ),
    "failed fits": Rule(
        "a set that fits worse than a part of it is set aside",
        Search,
        "_exclude_failed",
        _nothing,
        lambda before, result, search, new: any(
            one.weight == float("-inf") for one in search.visited.values()
        ),
    ),
    "inputs read otherwise": Rule(
        "where a time is found, the likelier of two readings of inputs between samples is taken",
        loop,
        "_searched",
        lambda problem, discrepancy, reread: _SEARCHED(problem, discrepancy, None),
        lambda before, result, problem, *_: result[0] is not problem,
    ),
    "kinematics": Rule(
        "effects that the relations between the sensors name have larger prior odds",
        Search,
        "with_kinematics",
        lambda search, groups: search,
        lambda before, result, search, groups: result.best().names != before,
        _leader,
    ),
    "certain part": Rule(
        "what is not certain in the likeliest set is left out if the rest is credible",
        decision,
        "certain_subset",
        _second,
        _not_second,
    ),
    "weak members": Rule(
        "an effect that brings little, and not all along, is a hint",
        decision,
        "without_weak_members",
        lambda search, best, clear: (best, {}, set()),
        lambda before, result, search, best, *_: result[0] is not best,
    ),
    "other faults": Rule(
        "beside a discrepancy, other faults of a sensor that kinematics name are tried",
        decision,
        "_exchange_fault_forms",
        _second,
        _not_second,
    ),
    "general forms": Rule(
        "forms without a cause of their own are tried where nothing else leaves noise",
        decision,
        "_decide_with_general_forms",
        _nothing,
        _given,
    ),
    "rough air": Rule(
        "rough air is named only if its evidence is there while the aircraft hardly moves",
        decision,
        "_acts_when_quiet",
        lambda *_: True,
        lambda before, result, *_: not result,
    ),
    "small events": Rule(
        "a load or gust in passing is named only if its gain is large",
        names,
        "event_names",
        lambda *_: frozenset(),
        lambda before, result, *_: bool(result),
    ),
    "held-out noise": Rule(
        "a name under white noise needs held-out residuals that are noise",
        loop._HeldOutCheck,
        "leaves_noise",
        lambda *_: True,
        lambda before, result, *_: not result,
    ),
    "worse prediction": Rule(
        "effects that held-out data contradict are hints",
        loop,
        "predictive_gains",
        lambda *_: PredictiveGain(),
        lambda before, result, *_: result.contradicts,
    ),
}


@contextmanager
def noted(acted: set[str]) -> Iterator[None]:
    """Context in which the names of rules that change something are added to a set."""
    with ExitStack() as stack:
        for name, rule in RULES.items():
            original = getattr(rule.owner, rule.attribute)
            watch = _watched(original, name, rule, acted)
            stack.enter_context(patch.object(rule.owner, rule.attribute, watch))
        yield


def _watched(
    original: Callable[..., Any], name: str, rule: Rule, acted: set[str]
) -> Callable[..., Any]:
    @wraps(original)
    def watch(*arguments: Any, **named: Any) -> Any:
        before = rule.before(*arguments)
        result = original(*arguments, **named)
        if rule.acted(before, result, *arguments):
            acted.add(name)
        return result

    return watch


@contextmanager
def left_out(name: str) -> Iterator[None]:
    """Context in which the tracing loop lacks one rule."""
    rule = RULES[name]
    with patch.object(rule.owner, rule.attribute, rule.without):
        yield


def command_without(arguments: Sequence[str]) -> None:
    """Run a command of flightid without a rule, or with all; write the rules that acted into a
    file.

    ``arguments`` : the rule or ``all rules``, the file, and the command with its options.
    """
    name, file, *command = arguments
    acted: set[str] = set()
    with noted(acted) if name == ALL else left_out(name):
        try:
            flightid(command)
        finally:
            if name == ALL:
                Path(file).write_text(json.dumps(sorted(acted)), encoding="utf-8", newline="\n")


# ---- Cases

Answered = Mapping[str, Any]


def random_case(seed: int) -> dict[str, Answered]:
    """Diagnose a random case with all rules, and without each rule that acted."""
    acted: set[str] = set()
    with tempfile.TemporaryDirectory(prefix="flightid-") as place:
        folder = Path(place)
        written = write_case(seed, folder)
        with noted(acted):
            answers: dict[str, Answered] = {ALL: _answer(score_written(written, folder))}
        for name in RULES:
            if name in acted:
                with left_out(name):
                    answers[name] = _answer(score_written(written, folder))
    return answers


def _answer(score: Any) -> Answered:
    said = [score.verdict, *("/".join(each.name for each in claim) for claim in score.claims)]
    told = {"right": score.right, "wrong": score.wrong, "seconds": score.seconds}
    return {**told, "said": " ".join(said)}


def flight_case(folder: Path, answers: Path) -> dict[str, Answered]:
    """Diagnose an independent flight with all rules, and without each rule that acted."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))

    def answered(name: str, place: Path) -> Answered:
        place.mkdir(parents=True, exist_ok=True)
        acted = str(place / "acted.json")
        command = [sys.executable, "-m", "exam.ablation", name, acted]
        answer = diagnosed(folder, place / "study", command, truth["model"])
        found, said = grade(truth, answer)
        told = {"right": found.value == "right", "wrong": found.value == "wrong name"}
        return {**told, "seconds": answer.seconds, "said": said}

    home = answers / folder.name
    out = {ALL: answered(ALL, home / "all")}
    acted = json.loads((home / "all" / "acted.json").read_text(encoding="utf-8"))
    for name in acted:
        out[name] = answered(name, home / name.replace(" ", "-"))
    return out


def ablate(arguments: Sequence[str] | None = None) -> int:
    """Run cases by their seeds, or flights of a folder, with one rule left out at a time."""
    parser = Parser("ablate", "diagnoses with one rule of the tracing loop left out at a time")
    parser.add_argument("--random", type=int, nargs=2, metavar=("FIRST", "COUNT"))
    parser.add_argument("--flights", type=Path, metavar="DIR", help="of python -m exam independent")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    asked = parser.parse_args(arguments)
    if (asked.random is None) is (asked.flights is None):
        parser.error("give one of --random and --flights")

    def work() -> int:
        asked.out.mkdir(parents=True, exist_ok=True)
        if asked.random is not None:
            first, count = asked.random
            cases: Sequence[Any] = range(first, first + count)
            examined: Callable[[Any], dict[str, Answered]] = random_case
        else:
            cases = sorted(path.parent.resolve() for path in asked.flights.glob("*/truth.json"))
            examined = partial(flight_case, answers=asked.out.resolve())
        if not cases:
            what, remedy = "no flights", "name a folder that exam independent wrote"
            raise DeclarationError(what, where=str(asked.flights), remedy=remedy)
        rows: list[dict[str, Answered]] = []
        with ProcessPoolExecutor(asked.jobs) as pool:
            for case, row in zip(cases, pool.map(examined, cases), strict=True):
                rows.append(row)
                line = json.dumps({"case": getattr(case, "name", case), "answers": row})
                with (asked.out / LINES).open("a", encoding="utf-8", newline="\n") as file:
                    file.write(line + "\n")
        print(table(rows))
        write_text(asked.out / "table.md", table(rows) + "\n")
        return 0

    return ended_in_one_line("ablate", work)


def table(rows: Sequence[Mapping[str, Answered]]) -> str:
    """Return, for each rule, the cases that it changed, and the answers in these with and without
    it.
    """
    lines = [
        "| rule | acted | right with it | right without | false with it | false without |",
        "|---|---|---|---|---|---|",
    ]
    for name, rule in RULES.items():
        pairs = [(row[ALL], row[name]) for row in rows if name in row]
        counts = [
            sum(bool(pair[side][what]) for pair in pairs)
            for what in ("right", "wrong")
            for side in (0, 1)
        ]
        lines.append(f"| {rule.what} | {len(pairs)} | " + " | ".join(map(str, counts)) + " |")
    right, wrong = (sum(bool(row[ALL][what]) for row in rows) for what in ("right", "wrong"))
    lines.append(f"| all rules | {len(rows)} | {right} | | {wrong} | |")
    return "\n".join(lines)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    command_without(sys.argv[1:])
