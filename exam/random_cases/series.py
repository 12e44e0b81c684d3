"""A series of cases, from a first seed on: examined as tasks, and the line that is written of
each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

from exam.calibration import Statement
from exam.random_cases.case import Case, CaseScore, Named
from exam.random_cases.examination import examine
from exam.random_cases.kinds import KINDS
from exam.repeated import Flown, LoopFlights, fly_all
from scenarios.report.terminal import progress_bar
from scenarios.tasks.study import Execution
from sim.errors import DeclarationError


def examined(first: int, count: int, execution: Execution, group: str = "") -> Flown:
    """Scores of the cases ``first`` to ``first + count - 1``, of those that had ended where it was
    stopped.

    ``group`` : all of them are of this one; empty, each draws its own.
    """
    told = {"first": first, **({"group": group} if group else {})}
    work = LoopFlights("random-cases", partial(_case, first, group), CaseScore, told)
    with progress_bar(True) as tell:
        return fly_all(work, count, first, execution, tell)


def _case(first: int, group: str, number: int, seed: int) -> CaseScore:
    """A case has its own small seed, by which documents name it, and takes none that is spawned."""
    return examine(first + number, group)


def line_of(score: CaseScore) -> Mapping[str, Any]:
    """What one line of the file holds; a number that is not finite is left out."""
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
    """The score that ``line_of`` wrote.

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
