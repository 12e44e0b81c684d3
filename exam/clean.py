"""Records of every model with nothing hidden: false claims of a diagnosis with all candidates, and
coverage of its sigmas.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from time import process_time

import numpy as np

from exam.random_cases.examination import write_clean
from exam.random_cases.flying import simulated
from exam.random_cases.vehicles import NOISE
from exam.scoring import share_of_flights, share_within_flights
from scenarios.diagnosis.diagnose import diagnose_files
from scenarios.preparation.plan import Request
from scenarios.report.document import Cell, Number, counted, formatted
from scenarios.studies.campaign_statistics import cramer_rao
from scenarios.trials.planted_declaration import TraceFlight, true_vehicle
from scenarios.trials.planted_flights import (
    fly_trace,
    simulated_record,
    trace_scenario_of,
    write_simulated,
)
from sim.declaration.model import Model, Noise
from sim.record import Record

# Model -> the tracing scenario whose flight is flown without what it hides; the others are cases,
# whose vehicles and maneuvers are drawn.
FLOWN: Mapping[str, str] = {
    "flexible": "trace-flexible",
    "own": "trace-own-model",
    "lateral": "trace-lateral-rudder",
    "longitudinal": "trace-longitudinal-thrust",
}
MODELS = ("rigid", "loes", "ballistic", "flexible", "own", "lateral", "longitudinal")
WRONG = 0.3  # largest relative error of starting values
SIGMAS = 2.0
_SPREAD = 7_000_003  # offset between the seeds of flights and of starting values


@dataclass(frozen=True)
class CleanRun:
    """One clean flight: verdict, claims, errors of the derivatives in their sigmas, and ratios of
    these sigmas to the Cramer-Rao bound.

    Derivatives are left out if the record does not determine them, that is, if the bound is above
    the value. ``hints`` are effects that are named but not claimed. ``seconds`` is the processor
    time of the diagnosis.
    """

    seed: int
    model: str
    verdict: str
    claimed: tuple[str, ...]
    hints: tuple[str, ...]
    errors: Mapping[str, float]
    over_bound: Mapping[str, float]
    seconds: float


@dataclass(frozen=True, eq=False)
class _Flight:
    """Files to diagnose, true model, and Cramer-Rao bounds of some parameters with biases of some
    outputs.
    """

    request: Request
    model: Model
    bound: Callable[[tuple[str, ...], Mapping[str, float]], Mapping[str, float]]


def clean_flight(seed: int, model: str) -> CleanRun:
    """Fly and diagnose one record of a ``model`` with nothing hidden, and a held-out record. All
    but the time depends on the arguments alone.
    """
    with tempfile.TemporaryDirectory(prefix="flightid-") as name:
        flight = (
            _case(model, seed, Path(name))
            if model not in FLOWN
            else _scenario(model, seed, Path(name))
        )
        started = process_time()
        tracing = diagnose_files(flight.request)
        seconds = process_time() - started
    d, true = tracing.diagnosis, flight.model.parameters
    bound = flight.bound(tuple(d.after), _biased(tracing.model))
    # What no record tells, as the scale of a mode that is not measured, has a sigma that is the
    # width of its start.
    found = {
        name: quantity for name, quantity in d.after.items() if bound[name] < abs(true[name].value)
    }
    errors = {
        name: (quantity.value - true[name].value) / quantity.std for name, quantity in found.items()
    }
    over = {name: float(quantity.std / bound[name]) for name, quantity in found.items()}
    claimed, hints = (
        [claim.name for claim in d.effects if claim.claimed is wanted] for wanted in (True, False)
    )
    return CleanRun(
        seed, model, d.verdict.value, tuple(claimed), tuple(hints), errors, over, seconds
    )


def _case(model: str, seed: int, folder: Path) -> _Flight:
    """Return a case with nothing hidden."""
    written, train = write_clean(model, seed, folder)

    def again(true: Model) -> Record:
        setting = replace(train.setting, model=true)
        return simulated(
            written.case, {}, replace(train, setting=setting), np.random.default_rng(0), {}
        )

    true, noise = train.setting.model, {name: NOISE[name] for name in written.case.channels}
    return _Flight(
        written.request, true, lambda names, biased: cramer_rao(true, again, noise, names, biased)
    )


def _scenario(model: str, seed: int, folder: Path) -> _Flight:
    """Return the flight of a tracing scenario without its hidden effect, with starting values drawn
    at random.
    """
    from scenarios.studies.catalogue import load_document

    scenario = trace_scenario_of(*load_document(FLOWN[model]))
    scenario = replace(scenario, flight=replace(scenario.flight, hidden=()))
    rng = np.random.default_rng((_SPREAD, seed))
    true = true_vehicle(scenario.flight)
    free = [item for item in true.parameters if item.free and item.value != 0.0]
    start = {item.name: item.value * (1.0 + float(rng.uniform(-WRONG, WRONG))) for item in free}
    scenario = replace(scenario, start=start)
    train, validate, vehicle = write_simulated(fly_trace(scenario, seed), folder)
    request = Request((train,), scenario.model, vehicle, (validate,))
    # Noise and starting values apart, every flight of a scenario is the same, and so is its bound.
    return _Flight(
        request, true, lambda names, biased: _bound_of(model, names, tuple(biased.items()))
    )


def clean_rows(runs: Sequence[CleanRun]) -> list[tuple[Cell, ...]]:
    """Return the rows of the table by model and for all models.

    Columns are: runs, false claims with their 95 % interval in per cent, verdicts that are not
    consistent, derivatives within two sigmas with their interval, the median of sigma over the
    bound with its 5 and 95 % quantiles, and median processor time in s.
    """
    groups = {model: [run for run in runs if run.model == model] for model in MODELS}
    return [
        _row(label, group)
        for label, group in (
            {label: group for label, group in groups.items() if group} | {"all": list(runs)}
        ).items()
    ]


def _row(label: str, runs: Sequence[CleanRun]) -> tuple[Cell, ...]:
    claims = share_of_flights(bool(run.claimed) for run in runs)
    within = share_within_flights(
        [abs(error) <= SIGMAS for error in run.errors.values()] for run in runs
    )
    over = np.array([ratio for run in runs for ratio in run.over_bound.values()])
    other = sum(run.verdict != "consistent" for run in runs)
    low, high = (100.0 * limit for limit in claims.interval)
    share, (least, most) = 100.0 * within.count / within.of, within.interval
    ends = f"{100.0 * least:.1f} to {100.0 * most:.1f}"
    inside = Number(share, shown=f"{share:.1f} of {within.of} ({ends})")
    middle = float(np.median(over))
    ends = f"{np.quantile(over, 0.05):.2f} to {np.quantile(over, 0.95):.2f}"
    ratio = Number(middle, shown=f"{middle:.2f} ({ends})")
    seconds = float(np.median([run.seconds for run in runs]))
    return (
        label,
        counted(len(runs)),
        counted(claims.count),
        f"{low:.1f} to {high:.1f}",
        counted(other),
        inside,
        ratio,
        formatted(seconds, ".1f"),
    )


def _biased(model: Model) -> Mapping[str, float]:
    """Return the outputs with a free bias, and the standard deviations of its priors."""
    return {name: model.parameters[f"bias_{name}"].prior_std for name in model.biases}


@cache
def _bound_of(
    model: str, names: tuple[str, ...], biased: tuple[tuple[str, float], ...]
) -> Mapping[str, float]:
    from scenarios.studies.catalogue import load_document

    flight = trace_scenario_of(*load_document(FLOWN[model])).flight
    return cramer_rao(
        true_vehicle(flight),
        lambda changed: _noiseless(flight, changed),
        flight.noise_std,
        names,
        dict(biased),
    )


def _noiseless(flight: TraceFlight, model: Model) -> Record:
    """Return the fitted record of a tracing scenario's flight without noise."""
    return simulated_record(
        flight, flight.train, model.with_noise(Noise()), np.random.default_rng(0), "train"
    )
