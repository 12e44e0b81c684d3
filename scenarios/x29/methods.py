"""The same record estimated in other ways than the scenario's own: the paper's procedure, and ours taken apart into its steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.banks.bank import run_bank, run_iterated_bank
from ident.banks.delays import DelayBank, vertex
from scenarios.x29.declaration import METHODS, LoopEstimation
from scenarios.x29.estimating import Plain, SetUp, plain, refined
from scenarios.x29.published import printed_density

PASSES = 5  # of plain filters that start again from their own result


@dataclass(frozen=True, eq=False)
class MethodResult:
    """What one method found: delay (s), values and sigmas by name of the parameters, its log-likelihood."""

    name: str
    label: str
    delay: float
    values: Mapping[str, float]
    std: Mapping[str, float]
    log_likelihood: float

    @property
    def frequency(self) -> float:
        """Undamped natural frequency of its short period, rad/s; NaN where that does not oscillate."""
        v = self.values
        stiffness = v["L_alpha"] * v["M_q"] - v["L_q"] * v["M_alpha"]
        return float(np.sqrt(stiffness)) if stiffness > 0 else float("nan")

    @property
    def damping(self) -> float:
        """Its damping ratio."""
        return -(self.values["L_alpha"] + self.values["M_q"]) / (2.0 * self.frequency)


@dataclass(frozen=True, eq=False)
class Restarts:
    """Plain filters with the printed P0 held at some delays (s), each started again from its own result.

    ``values`` : by parameter, ``(passes, delays)``.
    """

    delays: tuple[float, ...]
    values: Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Ways:
    """What the methods work on: the paper's set-up and its plain bank, ours and its refined bank, and the same record set up anew."""

    paper: SetUp
    plain: Plain
    estimation: LoopEstimation
    refined: DelayBank
    again: Callable[[LoopEstimation], SetUp]


def run_methods(names: Sequence[str], ways: Ways) -> tuple[MethodResult, ...]:
    """Each named method on the record; ``names`` are keys of ``METHODS``."""
    return tuple(_RUN[name](name, ways) for name in names)


def other_side(found: Plain, refined_delay: float) -> int:
    """Which filter of the plain bank has the grid's delay on the other side of the refined one than its most likely filter."""
    best = int(np.argmax(found.bank.log_likelihood))
    step = 1 if found.delays[best] < refined_delay else -1
    return min(max(best + step, 0), len(found.delays) - 1)


def all_restarts(ways: Ways, delays: Sequence[float]) -> dict[str, Restarts]:
    """Plain restarts at some delays (s), with P0 and R as printed and with each of them another."""
    louder = _set_up(ways, prior="printed", noise_share=2.0 * ways.estimation.noise_share)
    settings = {"R and P0 as printed": ways.paper, "P0 a quarter of the start": _set_up(ways, prior="quarter"), "R four times as large": louder}
    return {label: plain_restarts(setting, delays) for label, setting in settings.items()}


def plain_restarts(setting: SetUp, delays: Sequence[float], passes: int = PASSES) -> Restarts:
    """Plain filters at held delays, ``passes`` times each from its last parameters with the same P0."""
    system, start = setting.system, None
    n_x, rows, names = len(system.states), [], system.parameters.free_names
    for _ in range(passes):
        bank = run_bank(setting.record, system, held={"delay": np.array(delays)}, start=start)
        rows.append(bank.mean[n_x:])
        first = np.array([system.initial[name].value for name in system.state_names])
        start = np.concatenate([np.repeat(first[:, None], len(delays), axis=1), bank.mean[n_x:]])
    stacked = np.array(rows)
    return Restarts(tuple(delays), {name: stacked[:, i] for i, name in enumerate(names)})


def between_grid_points(found: Plain) -> float:
    """Vertex of the parabola through the plain bank's largest log-likelihood and its neighbours, s."""
    L, best = found.bank.log_likelihood, int(np.argmax(found.bank.log_likelihood))
    near = slice(min(max(best - 1, 0), len(L) - 3), min(max(best + 2, 3), len(L)))
    return vertex(found.delays[near], L[near])[0]


def _of_bank(name: str, found: Plain, at: int) -> MethodResult:
    bank = found.bank
    rows = range(len(bank.names) - len(found.estimate.names), len(bank.names))
    values = {bank.names[i]: float(bank.mean[i, at]) for i in rows}
    std = {bank.names[i]: float(np.sqrt(bank.covariance[at, i, i])) for i in rows}
    return MethodResult(name, METHODS[name], float(found.delays[at]), values, std, float(bank.log_likelihood[at]))


def _best(name: str, found: Plain) -> MethodResult:
    return _of_bank(name, found, int(np.argmax(found.bank.log_likelihood)))


def _held(name: str, ways: Ways) -> MethodResult:
    delay = ways.refined.refined
    bank = run_bank(ways.paper.record, ways.paper.system, held={"delay": np.array([delay])})
    return _of_bank(name, replace(ways.plain, bank=bank, delays=np.array([delay])), 0)


def _relinearised(name: str, ways: Ways) -> MethodResult:
    bank, _ = run_iterated_bank(ways.paper.record, ways.paper.system, held={"delay": np.array([ways.plain.delay])})
    return _of_bank(name, replace(ways.plain, bank=bank, delays=np.array([ways.plain.delay])), 0)


def _set_up(ways: Ways, **changes: Any) -> SetUp:
    return ways.again(replace(ways.estimation, **changes))


def _refined(name: str, setting: SetUp) -> MethodResult:
    return of_refined(name, METHODS[name], refined(setting))


def of_refined(name: str, label: str, bank: DelayBank) -> MethodResult:
    """A refined bank's result in the same form."""
    estimate = bank.estimate
    std = dict(zip(estimate.names, estimate.std.tolist(), strict=True))
    return MethodResult(name, label, bank.refined, estimate.as_dict(), std, estimate.log_likelihood)


_RUN: Mapping[str, Callable[[str, Ways], MethodResult]] = {
    "paper": lambda name, ways: _best(name, ways.plain),
    "paper-other": lambda name, ways: _of_bank(name, ways.plain, other_side(ways.plain, ways.refined.refined)),
    "paper-density": lambda name, ways: _best(name, plain(_set_up(ways, prior="printed", process_noise=printed_density("flight")))),
    "plain-quarter": lambda name, ways: _best(name, plain(_set_up(ways, prior="quarter"))),
    "held": _held,
    "relinearised": _relinearised,
    "refined-printed": lambda name, ways: _refined(name, _set_up(ways, prior="printed")),
    "refined-quarter": lambda name, ways: _refined(name, _set_up(ways, prior="quarter")),
}
