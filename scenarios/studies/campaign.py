"""Monte-Carlo campaigns: the same flight measured many times, each run with its own seed."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ident.statistics.intervals import clopper_pearson, clustered_share
from scenarios.files.declarations import refuse_unknown
from scenarios.studies.declaration import Estimation, Scenario, seen_by
from scenarios.studies.estimating import (
    Estimates,
    batched,
    declared_for,
    fly_scenario,
    is_batched,
    measured_again,
    one_by_one,
)
from scenarios.studies.study import RESAMPLING_SEED, references
from scenarios.tasks.study import Execution, run_study
from scenarios.tasks.work import Row, RowTable, Task
from sim.declaration.model import Model
from sim.errors import DeclarationError, ModelError
from sim.record import Record
from sim.truth.flight import Truth, remeasure

# ---- Identity of a campaign: all that its rows depend on, as JSON

# Fields of an estimation that do not affect its numbers.
WORDS = ("label", "explanation", "published", "choices", "own", "flight", "distance", "engine")


def identity_of(scenario: Scenario, estimation: Estimation) -> dict[str, Any]:
    """Return everything that affects the rows: flight, estimation, hashes of the user's files.

    Texts such as labels are left out.
    """
    estimation_fields = {
        field.name: getattr(estimation, field.name)
        for field in dataclasses.fields(estimation)
        if field.name not in WORDS
    }
    flown = {
        field.name: getattr(scenario.flight, field.name)
        for field in dataclasses.fields(scenario.flight)
        if field.name != "own"
    }
    return {
        "scenario": scenario.name,
        "flight": plain(flown),
        "estimation": plain(estimation_fields),
        "files": {file.name: file.sha256 for file in scenario.files},
    }


def plain(value: Any) -> Any:
    """Return a declared value for JSON; infinite numbers and None become text."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    if isinstance(value, Mapping):
        return {str(name): plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if isinstance(value, Enum):
        return value.name
    if value is None:
        return "none"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, str | bool | int | float):
        return value
    raise DeclarationError(f"a {type(value).__name__} has no place in a manifest", where="campaign")


# ---- The runs of a campaign as tasks

ESTIMATE, SIGMA = "estimate:", "sigma:"  # prefixes of column names
SOUND = "converged"
# Runs in a block. A batch of this size fills the vector units and fits into the cache.
BATCHED_BLOCK, BLOCK_ONE_BY_ONE = 500, 4


class _Common(NamedTuple):
    """Objects that all runs share.

    Attributes
    ----------
    model : the declared model.
    record, truth : the simulated flight.
    reference : value of each parameter from which errors count.
    """

    model: Model
    record: Record
    truth: Truth
    reference: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class EstimatorRuns:
    """Task: runs of a scenario by one of its methods.

    Attributes
    ----------
    scenario : the scenario.
    estimation : the method.
    rebuilt_scenario : content from which another process rebuilds the scenario; needed if the
        scenario holds functions of a user's file, which cannot be sent to a process.
    """

    scenario: Scenario
    estimation: Estimation
    rebuilt_scenario: Rebuilt | None = None

    quick = True

    @property
    def name(self) -> str:
        return f"campaign of {self.scenario.name} by {self.estimation.name}"

    @cached_property
    def seen(self) -> Scenario:
        """Scenario with the flight that this method uses."""
        return seen_by(self.scenario, self.estimation)

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return tuple(item.name for item in self.common.model.parameters if item.free)

    @property
    def columns(self) -> Mapping[str, str]:
        """Type by column of a row."""
        cells = {f"{kind}{name}": "float" for name in self.parameters for kind in (ESTIMATE, SIGMA)}
        return {"outcome": "text", **cells, "nees": "float", "nis": "float", "degrees": "int"}

    @property
    def block(self) -> int:
        """Number of runs that are computed together."""
        batched = is_batched(self.estimation, bool(self.seen.flight.feedback))
        return BATCHED_BLOCK if batched else BLOCK_ONE_BY_ONE

    def identity(self) -> Mapping[str, Any]:
        """Return all that the rows depend on."""
        return identity_of(self.seen, self.estimation)

    @cached_property
    def common(self) -> _Common:
        """Simulated flight, declared model, and reference of each parameter.

        Raises FlightidError if the declared flight or estimation is impossible.
        """
        record, truth = fly_scenario(self.seen, self.scenario.seed)
        model = declared_for(self.seen, self.estimation)
        reference = {
            **{item.name: item.value for item in truth.parameters},
            **references(self.seen, self.estimation),
        }
        return _Common(model, record, truth, reference)

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """Return one row per run.

        With process noise or feedback of measured outputs, each run is a new simulation. Otherwise
        one simulated flight gets new measurement noise in each run.
        """
        estimates = self.estimated(self.estimation, [self.record_of(task.seed) for task in tasks])
        std = estimates.std
        error = estimates.values - np.array(
            [[self.common.reference[name]] for name in estimates.names]
        )
        rows: list[Row | str] = []
        for at in range(len(tasks)):
            cells = {
                f"{ESTIMATE}{name}": float(estimates.values[i, at])
                for i, name in enumerate(estimates.names)
            }
            cells |= {f"{SIGMA}{name}": float(std[i, at]) for i, name in enumerate(estimates.names)}
            finite = all(np.isfinite(list(cells.values())))
            outcome = estimates.outcomes[at] if finite else "diverged"
            converged = outcome == SOUND
            rows.append(
                {
                    "outcome": outcome,
                    **(cells if finite else dict.fromkeys(cells)),
                    "nees": _nees(error[:, at], estimates.covariance[at]) if converged else None,
                    "nis": float(estimates.nis[at]) if converged else None,
                    "degrees": int(estimates.degrees[at]) if converged else 0,
                }
            )
        return rows

    def estimated(self, estimation: Estimation, records: Sequence[Record]) -> Estimates:
        """Return the estimates from records by ``estimation``."""
        unchanged = estimation is self.estimation
        model = self.common.model if unchanged else declared_for(self.seen, estimation)
        if self.block == BATCHED_BLOCK:
            return batched(estimation, records, model)
        return one_by_one(estimation, records, model)

    def record_of(self, seed: int) -> Record:
        """Return the record of a run, by its seed."""
        record, truth = self.common.record, self.common.truth
        noise = self.estimation.flown_noise_std
        if self.seen.flight.process_noise or self.seen.flight.feedback:
            record, truth = fly_scenario(self.seen, seed)
            return measured_again(record, truth, noise, seed) if noise else record
        if noise:
            return measured_again(record, truth, noise, seed)
        return remeasure(record, truth, np.random.default_rng(seed))

    def __reduce__(self) -> tuple[Callable[..., EstimatorRuns], tuple[Any, ...]]:
        if self.rebuilt_scenario is None:
            return EstimatorRuns, (self.scenario, self.estimation)
        return _rebuilt, (self.rebuilt_scenario, self.estimation.name)


@dataclass(frozen=True)
class Rebuilt:
    """Content of a scenario file, from which another process rebuilds the scenario."""

    document: Mapping[str, Any]
    name: str
    where: str

    def scenario(self) -> Scenario:
        """Return the rebuilt scenario. Raises DeclarationError."""
        from scenarios.studies.reading import scenario_of

        return scenario_of(self.document, self.name, self.where)


def campaign_scenario(name: str, changes: Sequence[str], where: str = "") -> Rebuilt:
    """Return a scenario of identification with changes, for a campaign.

    Parameters
    ----------
    name : a name or a path as in ``load_document``.
    changes : changes of the scenario file, as ``"KEY=VALUE"``.
    where : place of the name in messages.

    Raises
    ------
    DeclarationError : there is no such scenario, or it is of another kind.
    """
    from scenarios.studies.catalogue import IDENTIFICATION, load_document, moved, scenario_kind

    kind = scenario_kind(name)
    if kind == "trace":
        raise moved(f"a campaign of {name}", f"hidden-effects {name}", where or "flightid")
    if kind != IDENTIFICATION:
        what = f"there is no campaign of a scenario of kind {kind}"
        raise DeclarationError(what, where=where or name, remedy="name a scenario of estimators")
    document, short, file = load_document(name, changes)
    return Rebuilt({key: value for key, value in document.items() if key != "kind"}, short, file)


def _rebuilt(rebuilt_scenario: Rebuilt, method: str) -> EstimatorRuns:
    scenario = rebuilt_scenario.scenario()
    by_name = {estimation.name: estimation for estimation in scenario.estimations}
    return EstimatorRuns(scenario, by_name[method], rebuilt_scenario)


def _nees(error: np.ndarray, covariance: np.ndarray) -> float | None:
    """Return the normalized estimation error squared; None if the covariance has no inverse."""
    std = np.sqrt(np.diagonal(covariance))
    if not np.all(std > 0.0):
        return None
    in_sigmas, correlation = error / std, covariance / np.outer(std, std)
    try:
        return float(in_sigmas @ np.linalg.solve(correlation, in_sigmas))
    except np.linalg.LinAlgError:
        return None


# ---- Campaigns and their summaries

ALONE = Execution()
FEWEST_RUNS = 2  # runs that a standard deviation needs


@dataclass(frozen=True, eq=False)
class Spread:
    """One parameter over all runs.

    Attributes
    ----------
    name, unit : the parameter and its unit.
    reference : value from which errors count.
    bias : mean error.
    scatter : standard deviation of the estimates.
    reported : root mean square of the reported sigmas.
    within_one : share of the one-sigma intervals that contain the reference.
    within_two : share of the two-sigma intervals that contain the reference.
    interval : 95 % confidence interval of ``within_two``; by Clopper and Pearson for a parameter,
        by bootstrap over runs for all parameters together.
    """

    name: str
    unit: str
    reference: float
    bias: float
    scatter: float
    reported: float
    within_one: float
    within_two: float
    interval: tuple[float, float]


@dataclass(frozen=True, eq=False, repr=False)
class CampaignRuns:
    """Results of N finished runs, of which M converged, and their summary.

    Attributes
    ----------
    scenario, estimation : the scenario and the method.
    root : seed of the campaign, from which the seeds of its runs are derived.
    seeds : seeds of the runs, ``(N,)``; ``flightid run --seed`` repeats a run.
    names : names of the parameters.
    values : estimates, ``(n, M)``.
    std : reported sigmas, ``(n, M)``.
    kept : True for the runs that converged, ``(N,)``.
    spreads : summary of each parameter.
    pooled : summary of all parameters together.
    asked : number of runs that were requested.
    nees : normalized estimation error squared of all parameters, ``(M,)``; NaN if undefined.
    nis : sum of the normalized innovations squared, ``(M,)``; zero without innovations.
    degrees : degrees of freedom of ``nis``, ``(M,)``; zero without innovations.
    work : the task that made the runs.
    columns : all columns of the rows, ``(M,)`` each.
    failures : number of runs by reason of failure.
    """

    scenario: Scenario
    estimation: Estimation
    root: int
    seeds: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    kept: np.ndarray
    spreads: tuple[Spread, ...]
    pooled: Spread
    asked: int
    nees: np.ndarray
    nis: np.ndarray
    degrees: np.ndarray
    work: EstimatorRuns
    columns: Mapping[str, np.ndarray]
    failures: Mapping[str, int] = field(default_factory=dict)

    @property
    def broken(self) -> int:
        """Number of runs that did not converge."""
        return len(self.seeds) - int(np.sum(self.kept))

    def __repr__(self) -> str:
        return (
            f"<Campaign of {self.scenario.name}: {len(self.seeds)} runs by {self.estimation.name}>"
        )


Progress = Callable[[str, float], None]


def fly_campaign(
    scenario: Scenario,
    runs: int,
    seed: int | None = None,
    method: str = "main",
    progress: Progress = lambda stage, share: None,
    execution: Execution = ALONE,
    rebuilt_scenario: Rebuilt | None = None,
) -> CampaignRuns:
    """Run one of a scenario's estimations ``runs`` times.

    The seed of each run is derived from ``seed``. ``EstimatorRuns.run`` says when a run is a new
    simulation. After Ctrl-C the finished runs are summarized if there are enough.

    Parameters
    ----------
    scenario : the scenario.
    runs : number of runs.
    seed : seed of the campaign; None: that of the scenario.
    method : name of the estimation.
    progress : called with the stage and the share of the work that is done, 0 to 1.
    execution : number of processes, folder of the rows, time limit; without effect on the numbers.
    rebuilt_scenario : content from which other processes rebuild a scenario with a user's
        functions.

    Raises
    ------
    FlightidError : the method is unknown, the declared flight or estimation is impossible, or the
        folder holds another campaign.
    """
    known = {estimation.name: estimation for estimation in scenario.estimations}
    refuse_unknown("method", method, known, "--method")
    root = scenario.seed if seed is None else seed
    work = EstimatorRuns(scenario, known[method], rebuilt_scenario)
    table = run_study(work, execution.request(runs, root, work.block, "runs"), progress)
    if not table.whole and len(table) < FEWEST_RUNS:
        raise KeyboardInterrupt(f"{len(table)} of {runs} runs had ended")
    return campaign_of(work, table, root)


def campaign_of(work: EstimatorRuns, table: RowTable, root: int) -> CampaignRuns:
    """Return the summary of a campaign's rows. Raises ModelError if fewer than two converged."""
    columns, names, estimation = table.columns, work.parameters, work.estimation
    endings = [
        error or outcome
        for error, outcome in zip(columns["error"], columns["outcome"], strict=True)
    ]
    kept = np.array([ending == SOUND for ending in endings], dtype=bool)
    failures = dict(Counter(ending for ending in endings if ending != SOUND).most_common())
    if np.sum(kept) < FEWEST_RUNS:
        what = f"{np.sum(~kept)} of {len(kept)} runs broke down ({next(iter(failures), '')})"
        raise ModelError(
            what,
            where=f"estimation {estimation.name}",
            remedy="give it other starting values, or a flight that determines more",
        )
    values, std = (
        np.array([columns[f"{kind}{name}"][kept] for name in names]) for kind in (ESTIMATE, SIGMA)
    )
    reference = {name: work.common.reference[name] for name in names}
    units = {item.name: item.unit for item in work.common.model.parameters}
    spreads = tuple(
        _spread(name, units[name], reference[name], values[i], std[i])
        for i, name in enumerate(names)
    )
    pooled = _pooled((values - np.array([[reference[name]] for name in names])) / std)
    nees, nis, degrees = (columns[name][kept].astype(float) for name in ("nees", "nis", "degrees"))
    seeds = columns["seed"]
    kept_columns = {name: column[kept] for name, column in columns.items()}
    return CampaignRuns(
        work.seen,
        estimation,
        root,
        seeds,
        names,
        values,
        std,
        kept,
        spreads,
        pooled,
        table.asked,
        nees,
        nis,
        degrees.astype(int),
        work,
        kept_columns,
        failures,
    )


def _spread(name: str, unit: str, reference: float, values: np.ndarray, std: np.ndarray) -> Spread:
    """Return the summary of a parameter from its estimates and sigmas, ``(M,)`` each."""
    error = values - reference
    hits = int(np.sum(np.abs(error) <= 2.0 * std))
    scatter, reported = float(values.std(ddof=1)), float(np.sqrt(np.mean(std**2)))
    one = float(np.mean(np.abs(error) <= std))
    return Spread(
        name,
        unit,
        reference,
        float(error.mean()),
        scatter,
        reported,
        one,
        hits / len(values),
        clopper_pearson(hits, len(values)),
    )


def _pooled(errors: np.ndarray) -> Spread:
    """Return the summary of all parameters together, from errors in reported sigmas, ``(n, M)``.

    The errors of a run are correlated, so the bootstrap resamples whole runs.
    """
    hits = np.sum(np.abs(errors) <= 2.0, axis=0)
    interval = clustered_share(
        hits, np.full(len(hits), len(errors)), np.random.default_rng(RESAMPLING_SEED)
    )
    one, two = float(np.mean(np.abs(errors) <= 1.0)), float(hits.sum()) / errors.size
    return Spread(
        "all",
        "sigma",
        0.0,
        float(errors.mean()),
        float(errors.std(ddof=1)),
        1.0,
        one,
        two,
        interval,
    )
