"""Runs one job: all who are installed, whether they agree, warm in turn, then as whole processes in
turn.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np

from benchmarks.comparison.job import Agreement, Answer, Contender, Job
from benchmarks.comparison.timing import Quartiles, interleaved, quartiles, ratios
from benchmarks.comparison.whole_process import measured

Say = Callable[[str], None]


@dataclass(frozen=True)
class Pace:
    """How long a comparison takes: rounds of warm calls and after how many seconds one drops out,
    rounds of whole processes, small problems.
    """

    rounds: int = 15
    patience: float = 6.0
    cold_rounds: int = 5
    small: bool = False


UNASKED = Agreement("", True)
QUICK = Pace(rounds=3, patience=1.0, cold_rounds=1, small=True)


@dataclass(frozen=True)
class Result:
    """One contender in one job; times in s, ratios to flightid, None where it is ``absent`` (which
    says why).
    """

    contender: Contender
    absent: str = ""
    agreement: Agreement = UNASKED
    warm: Quartiles | None = None
    cold: Quartiles | None = None
    warm_ratio: Quartiles | None = None
    cold_ratio: Quartiles | None = None
    memory: float | None = None


def compare(job: Job, pace: Pace, folder: Path, say: Say) -> tuple[Result, ...]:
    """Results of a job, flightid's first. Raises ProcessFailed where a contender cannot do it as a
    process of its own.
    """
    problem = job.problem(pace.small)
    path = folder / f"{job.name}.npz"
    np.savez(path, **cast(dict[str, Any], problem))
    present = [each for each in job.contenders if not each.absent]
    say(f"{job.name}: {len(present)} of {len(job.contenders)} installed, preparing")
    works: dict[str, Callable[[], Answer]] = {
        each.module: import_module(f"benchmarks.peers.{each.module}").prepare(problem)
        for each in present
    }
    answers = {name: work() for name, work in works.items()}
    say(f"{job.name}: warm, {pace.rounds} rounds")
    warm = interleaved(works, pace.rounds, pace.patience)
    say(f"{job.name}: whole processes, {pace.cold_rounds} rounds")
    cold: dict[str, list[float]] = {each.module: [] for each in present}
    memory: dict[str, float] = {}
    for _ in range(pace.cold_rounds):
        for each in present:
            found = measured(
                [sys.executable, "-m", "benchmarks.peers", each.module, str(path)], folder
            )
            # Of a contender that does a share of the work the rest is added at its warm rate.
            cold[each.module].append(
                found.seconds + (1.0 / each.share - 1.0) * quartiles(warm[each.module]).median
            )
            memory[each.module] = max(found.memory, memory.get(each.module, 0.0))
    warm = {
        each.module: [seconds / each.share for seconds in warm[each.module]] for each in present
    }
    return tuple(
        _result(job, each, problem, answers, warm, cold, memory) for each in job.contenders
    )


def _result(
    job: Job,
    each: Contender,
    problem: Mapping[str, np.ndarray],
    answers: Mapping[str, Answer],
    warm: Mapping[str, list[float]],
    cold: Mapping[str, list[float]],
    memory: Mapping[str, float],
) -> Result:
    if each.absent:
        return Result(each, each.absent)
    name, ours = each.module, job.ours.module
    agreement = job.check(problem, answers[ours], answers[name], each.tolerance)
    times = quartiles(warm[name]), quartiles(cold[name])
    return Result(
        each,
        "",
        agreement,
        *times,
        ratios(warm[name], warm[ours]),
        ratios(cold[name], cold[ours]),
        memory[name],
    )


def result_json(result: Result) -> dict[str, Any]:
    """A result for performance.json."""

    def spread(values: Quartiles | None) -> dict[str, float] | None:
        return None if values is None else values._asdict()

    return {
        "contender": result.contender.label,
        "version": result.contender.version,
        "absent": result.absent,
        "check": result.agreement.said,
        "same_answer": result.agreement.near,
        "share_of_work": result.contender.share,
        "warm_s": spread(result.warm),
        "cold_s": spread(result.cold),
        "warm_ratio": spread(result.warm_ratio),
        "cold_ratio": spread(result.cold_ratio),
        "peak_memory_mib": result.memory,
    }
