"""Monte-Carlo campaigns: the same flight measured many times, one seed a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ident.statistics.intervals import clopper_pearson, clustered_share
from scenarios.files.declarations import closest
from scenarios.studies.declaration import Estimation, Scenario
from scenarios.studies.runs.work import ESTIMATE, SIGMA, SOUND, EstimatorRuns, Rebuilt
from scenarios.tasks.manner import Manner
from scenarios.tasks.rows import Table
from scenarios.tasks.study import run_study
from sim.errors import DeclarationError, ModelError

RESAMPLING_SEED = 1  # of the interval over all parameters: the same runs give the same interval
ALONE = Manner()
FEWEST = 2  # runs, of which alone a scatter can be told


@dataclass(frozen=True, eq=False)
class Spread:
    """One parameter over all runs.

    ``bias`` is mean error, ``scatter`` the standard deviation of the estimates, ``reported`` the root mean square of the
    estimator's own sigma, ``within_one`` and ``within_two`` the shares of its intervals that hold the reference, ``interval`` the latter's
    95 % confidence interval: of one parameter that of Clopper and Pearson over runs, of all together by resampling whole runs.
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
class Campaign:
    """Results of N runs: estimates and sigmas ``(n, M)`` of the M sound ones, and their summary.

    ``root`` : from which the seeds of all runs spring; ``seeds`` ``(N,)`` : of the runs that ended, by which ``flightid run`` flies one again;
    ``kept`` ``(N,)`` : which of them are sound. ``broken`` runs are left out, ``failures`` tells by what; ``asked`` is how many runs it was to be.
    ``nees`` ``(M,)`` : normalised estimation error squared of all parameters together, NaN where there is none. ``nis``, ``degrees``
    ``(M,)`` : sum of the normalised innovations squared and of how many measured numbers that is, zero where the method has none.
    ``work`` made the runs; ``columns`` ``(M,)`` are all that their rows hold.
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
        """Runs that are left out."""
        return len(self.seeds) - int(np.sum(self.kept))

    def __repr__(self) -> str:
        return f"<Campaign of {self.scenario.name}: {len(self.seeds)} runs by {self.estimation.name}>"


Progress = Callable[[str, float], None]


def fly_campaign(
    scenario: Scenario,
    runs: int,
    seed: int | None = None,
    method: str = "main",
    progress: Progress = lambda stage, share: None,
    manner: Manner = ALONE,
    again: Rebuilt | None = None,
) -> Campaign:
    """Run one of a scenario's estimations ``runs`` times; run k has the seed of task k of ``seed`` and equals ``flightid run --seed`` with that.

    Where process noise really acts or measured outputs are fed back every run is flown anew, else the same flight is measured again.
    ``manner`` : how many processes, where rows are kept, ...; no number depends on it but where the time limit ends a run. ``again`` : from
    what other processes make the scenario, where it holds a user's own functions. Ctrl-C ends it with the runs that had been
    estimated, if these are enough: ``asked`` then is more than there are seeds.

    Raises
    ------
    FlightidError : there is no method of that name, what it declares cannot be flown or estimated, or the folder holds another campaign.
    """
    known = {estimation.name: estimation for estimation in scenario.estimations}
    if method not in known:
        raise DeclarationError(f"there is no method {method!r}", where="--method", remedy=closest(method, known))
    root = scenario.seed if seed is None else seed
    work = EstimatorRuns(scenario, known[method], again)
    table = run_study(work, manner.asked(runs, root, work.block, "runs"), progress)
    if not table.whole and len(table) < FEWEST:
        raise KeyboardInterrupt(f"{len(table)} of {runs} runs had ended")
    return campaign_of(work, table, root)


def campaign_of(work: EstimatorRuns, table: Table, root: int) -> Campaign:
    """The summary of a campaign's rows. Raises ModelError where fewer than two runs are sound."""
    columns, names, estimation = table.columns, work.parameters, work.estimation
    ways = [error or outcome for error, outcome in zip(columns["error"], columns["outcome"], strict=True)]
    kept = np.array([way == SOUND for way in ways], dtype=bool)
    failures = dict(Counter(way for way in ways if way != SOUND).most_common())
    if np.sum(kept) < FEWEST:
        what = f"{np.sum(~kept)} of {len(kept)} runs broke down ({next(iter(failures), '')})"
        raise ModelError(what, where=f"estimation {estimation.name}", remedy="give it other starting values, or a flight that tells more")
    values, std = (np.array([columns[f"{kind}{name}"][kept] for name in names]) for kind in (ESTIMATE, SIGMA))
    reference = {name: work.common.reference[name] for name in names}
    units = {item.name: item.unit for item in work.common.model.parameters}
    spreads = tuple(_spread(name, units[name], reference[name], values[i], std[i]) for i, name in enumerate(names))
    pooled = _pooled((values - np.array([[reference[name]] for name in names])) / std)
    nees, nis, degrees = (columns[name][kept].astype(float) for name in ("nees", "nis", "degrees"))
    seeds = columns["seed"]
    sound = {name: column[kept] for name, column in columns.items()}
    weighed = nees, nis, degrees.astype(int)
    return Campaign(work.seen, estimation, root, seeds, names, values, std, kept, spreads, pooled, table.asked, *weighed, work, sound, failures)


def _spread(name: str, unit: str, reference: float, values: np.ndarray, std: np.ndarray) -> Spread:
    """One parameter over runs ``(N,)``, which are independent of each other."""
    error = values - reference
    hits = int(np.sum(np.abs(error) <= 2.0 * std))
    scatter, reported = float(values.std(ddof=1)), float(np.sqrt(np.mean(std**2)))
    one = float(np.mean(np.abs(error) <= std))
    return Spread(name, unit, reference, float(error.mean()), scatter, reported, one, hits / len(values), clopper_pearson(hits, len(values)))


def _pooled(errors: np.ndarray) -> Spread:
    """All parameters together, from errors ``(n, N)`` in reported sigmas; those of one run are correlated."""
    hits = np.sum(np.abs(errors) <= 2.0, axis=0)
    interval = clustered_share(hits, np.full(len(hits), len(errors)), np.random.default_rng(RESAMPLING_SEED))
    one, two = float(np.mean(np.abs(errors) <= 1.0)), float(hits.sum()) / errors.size
    return Spread("all", "sigma", 0.0, float(errors.mean()), float(errors.std(ddof=1)), 1.0, one, two, interval)
