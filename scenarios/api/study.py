"""Simulated studies in Python: `run`, `simulate` and `campaign`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.flying_qualities.modes import state_space, to_control
from scenarios.api import plot, tables
from scenarios.api.diagnosis import Diagnosis
from scenarios.api.record import Record, record_of
from scenarios.api.requests import KEPT, LOADERS, Flight, Runner, flown, no_progress
from scenarios.api.shown import (
    Parameter,
    Parameters,
    SavedResult,
    WithParameters,
    path_given,
    row_of,
    write_sheets,
)
from scenarios.api.tables import names_of, with_python_errors
from scenarios.files.declarations import named_after
from scenarios.files.user_models import is_own
from scenarios.identification.files import linearised
from scenarios.report.figure_formats import Formats
from scenarios.studies import campaign as campaigns
from scenarios.studies.campaign_causes import Judgement, judge
from scenarios.studies.campaign_report import findings_content
from scenarios.studies.catalogue import (
    IDENTIFICATION,
    scenario_file,
    scenario_kind,
)
from scenarios.studies.estimating import compiled, declared_for
from scenarios.tasks.study import Execution
from sim.errors import DeclarationError

if TYPE_CHECKING:
    import control
    import pandas


# ---- The model of a study of simulated flights as matrices


def matrices_of_study(study: Any, kind: str, pade: int) -> control.StateSpace:
    """Return the linearised model of the main method with its estimates.

    Of a closed loop it is the low-order equivalent.
    """
    if kind != IDENTIFICATION:
        result = study.result
        return to_control(state_space(result.setting.system, result.estimate.as_dict()), pade)
    estimation, result = study.main.estimation, study.main.result
    model = declared_for(study.scenario, estimation)
    own = model if is_own(model) else None
    matrices = linearised(
        compiled(estimation, model), result.estimate.as_dict(), result.record, own
    )
    return to_control(matrices, pade)


# ---- run and simulate in Python: scenarios of the catalogue, or of a file

Settings = Mapping[str, Any] | Sequence[str] | None


@dataclass(frozen=True, eq=False, repr=False)
class Study(SavedResult, WithParameters):
    """Result of a scenario: true values, estimates and sigmas.

    Attributes
    ----------
    name : the scenario's.
    kind : ``identification``, ``trace``, ``x29`` or ``sweep``.
    details : the complete internal result, of another type for each kind.
    """

    name: str
    kind: str
    details: Any
    _runner: Runner

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        return int(self.details.seed)

    @cached_property
    def parameters(self) -> Parameters:
        """Estimates of the main method; of a diagnosis those with the effects found."""
        if self.diagnosis is not None:
            return self.diagnosis.parameters
        if self.kind == "sweep":
            estimate = self.details.estimate
        elif self.kind == IDENTIFICATION:
            estimate = self.details.main.result.estimate
        else:
            estimate = self.details.result.estimate
        return Parameters(
            Parameter(name, float(value), float(std), unit)
            for name, value, std, unit in zip(
                estimate.names, estimate.values, estimate.std, estimate.units, strict=True
            )
        )

    @cached_property
    def true(self) -> dict[str, float]:
        """True values by name; for a simplified model, the values that it should find."""
        if self.kind == IDENTIFICATION:
            return {
                row.name: row.reference
                for row in self.details.main.rows
                if row.reference is not None
            }
        if self.kind == "sweep":
            return {row.name: row.true for row in self.details.rows if row.true is not None}
        if self.kind == "trace":
            return {row.name: row.comparable for row in self.details.derivatives}
        return {}

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """Diagnosis of the tracing loop, for tracing scenarios only."""
        return Diagnosis(self.details.tracing) if self.kind == "trace" else None

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """Records that the estimator or the loop used."""
        if self.kind == IDENTIFICATION:
            return (record_of(self.details.record),)
        if self.diagnosis is not None:
            return self.diagnosis.records
        if self.kind == "sweep":
            return tuple(record_of(record) for record in self.details.records)
        return (record_of(self.details.result.setting.record),)

    @property
    def record(self) -> Record:
        """The first record."""
        return self.records[0]

    def summary(self) -> str:
        """Return the text that the command prints."""
        return self._runner.text(self.details)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per parameter: ``unit``, ``value``, ``sigma``.

        If true values are known, also ``true`` and the error in ``sigmas``.
        """
        frame = self.parameters.to_dataframe()
        if self.true:
            frame["true"] = [self.true.get(name, float("nan")) for name in frame.index]
            frame["sigmas"] = (frame["value"] - frame["true"]) / frame["sigma"]
        return frame

    def to_excel(self, path: str | PathLike[str]) -> Path:
        """Write the parameters as an XLSX workbook with full precision; returns the path.

        Needs openpyxl.
        """
        return write_sheets(path, {"parameters": self.parameters})

    def to_state_space(self, pade: int = 4) -> control.StateSpace:
        """Return the model of the main method or of a diagnosis for python-control.

        It has ``parameters`` and named signals.
        """
        if self.diagnosis is not None:
            return self.diagnosis.to_state_space(pade)
        if self.kind == "sweep":
            what = "a sweep has transfer functions, no matrices"
            remedy = "use details.response.fits"
            raise DeclarationError(what, where=self.name, remedy=remedy)
        return matrices_of_study(self.details, self.kind, pade)

    def _write(self, folder: Path, figures: Formats) -> object:
        return self._runner.write(self.details, folder, figures=figures)

    @property
    def plot(self) -> plot.Figures:
        """Figures of this result: ``study.plot.fit()``, of a diagnosis its own."""
        if self.diagnosis is not None:
            return self.diagnosis.plot
        return plot.Figures(self, plot.fit) if self.kind == IDENTIFICATION else plot.Figures(self)

    def __repr__(self) -> str:
        verdict = f"{self.diagnosis.verdict}; " if self.diagnosis is not None else ""
        return f"<Study {self.name}, seed {self.seed}: {verdict}{self.parameters!r:.600}>"

    def _repr_html_(self) -> str:
        if self.diagnosis is not None:
            return self.diagnosis._repr_html_()
        headings = (
            "parameter",
            "unit",
            "value",
            "sigma",
            *(("true", "error, sigmas") if self.true else ()),
        )
        rows = [
            [*row_of(item), *(_true_cells(item, self.true) if self.true else ())]
            for item in self.parameters.values()
        ]
        return tables.page(f"{self.name}, seed {self.seed}", tables.table(headings, rows, left=2))


def _true_cells(item: Parameter, true: Mapping[str, float]) -> tuple[str, str]:
    """Return the true value and the error in sigmas; dashes if unknown."""
    if item.name not in true:
        return "-", "-"
    value = true[item.name]
    error = f"{(item.value - value) / item.sigma:+.2f}" if item.sigma > 0.0 else "-"
    return f"{value:.5g}", error


@with_python_errors
def run(
    name: str | PathLike[str],
    *,
    seed: int | None = None,
    set: Settings = None,
    progress: Callable[[str, float], None] | None = None,
) -> Study:
    """Simulate, identify and compare: ``flightid run`` in Python.

    Parameters
    ----------
    name : a scenario of the catalogue (``scenarios()`` lists them), or the path of a scenario file.
    seed : seed of the random numbers; None: that of the scenario.
    set : changed entries of the scenario, ``{"flight.rate": 50}`` or ``["flight.rate=50"]``.
    progress : called with the stage and the share done, 0 to 1.

    Raises
    ------
    InputError : there is no such scenario, or a key or value in it is wrong.

    Examples
    --------
    >>> import flightid as fid
    >>> study = fid.run("rigid", seed=1)
    >>> study["Cm_alpha"], study.true["Cm_alpha"]
    (Cm_alpha = -1.6570 +- 0.0018 1/rad, -1.66)
    """
    text, seed = str(name), seed_of(seed)
    kind = scenario_kind(text)
    runner = LOADERS[kind](text, changes_of(set))
    with named_after(scenario_file(text)):
        return Study(
            Path(text).stem if text.endswith(".toml") else text,
            kind,
            runner.run(seed, progress or no_progress),
            runner,
        )


@with_python_errors
def simulate(name: str | PathLike[str], *, seed: int | None = None, set: Settings = None) -> Flight:
    """Simulate the records of a scenario: ``flightid simulate`` in Python.

    The result has the records and their vehicle, without the truth. Parameters as in ``run``.

    Examples
    --------
    >>> import flightid as fid
    >>> fid.simulate("rigid", seed=3).record.names
    ('elevator', 'alpha', 'q')
    """
    return flown(str(name), seed_of(seed), changes_of(set))


def seed_of(given: Any) -> int | None:
    """Return the seed. Raises DeclarationError for a value that is none."""
    if given is not None and (
        isinstance(given, bool) or not isinstance(given, Integral) or given < 0
    ):
        raise DeclarationError(
            f"{given!r:.60} is no seed", where="seed", remedy="give a whole number, zero or more"
        )
    return None if given is None else int(given)


def changes_of(settings: Settings) -> list[str]:
    """Return settings as texts ``KEY=VALUE``."""
    if settings is None:
        return []
    if isinstance(settings, Mapping):
        from scenarios.files.aircraft_files import toml_value

        return [f"{key}={toml_value(value, key)}" for key, value in settings.items()]
    return list(names_of(settings, "setting", "set"))


# ---- campaign in Python: the same study with many seeds

COLUMNS = ("unit", "reference", "bias", "scatter", "reported", "within_one", "within_two")


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(SavedResult):
    """Estimates of many runs, compared with the truth.

    ``details``: the complete internal result. ``noise_levels``: noise levels are estimated even if
    no sigma is wrong.
    """

    details: campaigns.CampaignRuns
    noise_levels: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The estimated parameters."""
        return self.details.names

    @property
    def values(self) -> np.ndarray:
        """Estimates, shape ``(runs, parameters)``; runs that broke down are left out."""
        return self.details.values.T

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations as reported, shape ``(runs, parameters)``."""
        return self.details.std.T

    @property
    def coverage(self) -> float:
        """Share of two-sigma intervals, over all parameters, that contain the reference."""
        return self.details.pooled.within_two

    @property
    def coverage_interval(self) -> tuple[float, float]:
        """95 % confidence interval of ``coverage``."""
        return self.details.pooled.interval

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per parameter: bias, scatter, reported sigma, and coverage.

        Coverage is that of one- and two-sigma intervals.
        """
        import pandas

        spreads = self.details.spreads
        rows = [[getattr(spread, name) for name in COLUMNS] for spread in spreads]
        index = pandas.Index([spread.name for spread in spreads], name="parameter")
        return pandas.DataFrame(rows, columns=list(COLUMNS), index=index)

    def statistics(self) -> pandas.DataFrame:
        """Return one row per parameter with the columns of ``statistics.csv``, SI.

        They are bias, scatter over the reported sigma, coverage of one, two and three sigmas, each
        with its interval; the Cramer-Rao bound and the efficiency.
        """
        import io

        import pandas

        from scenarios.studies.campaign_statistics import statistics_csv

        return pandas.read_csv(
            io.StringIO(statistics_csv(self._judgement.statistics)), index_col="parameter"
        )

    def wrong_sigmas(self) -> pandas.DataFrame:
        """Return one row per parameter with a wrong sigma, SI.

        Columns: correcting factor, causes, reported and correct sigma, share of the runs within two
        correct sigmas.
        """
        import pandas

        rows = findings_content(self._judgement.findings)["wrong_sigmas"]
        columns = [
            "factor",
            "causes",
            "reported_std",
            "right_std",
            "right_within_2",
            "right_within_2_low",
            "right_within_2_high",
            "runs",
        ]
        return pandas.DataFrame(
            list(rows.values()), columns=columns, index=pandas.Index(list(rows), name="parameter")
        )

    @cached_property
    def _judgement(self) -> Judgement:
        return judge(self.details, levels=self.noise_levels)

    def estimates(self) -> pandas.DataFrame:
        """Return one row per run: its seed, each estimate and its ``std_NAME``."""
        import pandas

        return pandas.DataFrame(
            {
                "seed": self.details.seeds[self.details.kept],
                **dict(zip(self.names, self.details.values, strict=True)),
                **{f"std_{n}": s for n, s in zip(self.names, self.details.std, strict=True)},
            }
        )

    def summary(self) -> str:
        """Return the text that the command prints."""
        from scenarios.report.quantities import as_text
        from scenarios.studies.campaign_report import print_campaign

        return as_text(lambda out: print_campaign(self.details, out, KEPT, self._judgement))

    def _write(self, folder: Path, figures: Formats) -> Path:
        from scenarios.studies.folder import write_campaign

        return write_campaign(self.details, self._judgement, folder, figures=figures)

    @property
    def _title(self) -> str:
        return (
            f"{self.details.scenario.name}, {len(self.details.seeds)} runs by "
            f"{self.details.estimation.label}"
        )

    def __repr__(self) -> str:
        low, high = self.coverage_interval
        return (
            f"<Campaign: {self._title}; {100 * self.coverage:.1f} % within two sigmas "
            f"({100 * low:.1f} to {100 * high:.1f} %)>"
        )

    def _repr_html_(self) -> str:
        rows = [
            [spread.name, *(_cell(getattr(spread, name)) for name in COLUMNS)]
            for spread in self.details.spreads
        ]
        return tables.page(self._title, tables.table(("parameter", *COLUMNS), rows, left=2))


@with_python_errors
def campaign(
    name: str | PathLike[str],
    runs: int,
    *,
    seed: int | None = None,
    set: Settings = None,
    method: str | None = None,
    noise_levels: bool = False,
    jobs: int | None = None,
    out: str | PathLike[str] | None = None,
    resume: bool = False,
    cluster: str | None = None,
    time_limit: float | None = None,
) -> Campaign:
    """Repeat a scenario with many seeds, for bias, scatter and coverage: ``flightid campaign`` in
    Python.

    Parameters
    ----------
    name, set : as in ``run``.
    runs : number of runs, each with its own seed.
    seed : seed of the campaign, from which the others follow; None: that of the scenario.
    method : name of an estimation; None: the main one.
    noise_levels : estimate noise levels by likelihood even if no sigma is wrong.
    jobs : number of processes; None: one per core.
    out : folder in which finished runs are kept.
    resume : continue the campaign in ``out``; ``runs`` may be larger than before.
    cluster : address of a Dask scheduler.
    time_limit : longest time of a run, s.

    Raises
    ------
    InputError : there is no such scenario or method, or ``out`` holds another campaign.
    KeyboardInterrupt : by Ctrl-C; finished runs are kept in ``out``.

    Examples
    --------
    >>> import flightid as fid
    >>> fid.campaign("rigid", runs=4, seed=1, jobs=1)
    <Campaign: rigid, 4 runs by extended Kalman filter; 100.0 % within two sigmas (39.8 to 100.0 %)>
    """
    text = str(name)
    count = _count_of(runs)
    rebuilt = campaigns.campaign_scenario(text, changes_of(set), "campaign")
    execution = Execution(
        jobs, None if out is None else path_given(out), resume, cluster, time_limit
    )
    with named_after(rebuilt.where):
        found = campaigns.fly_campaign(
            rebuilt.scenario(),
            count,
            seed_of(seed),
            method or "main",
            no_progress,
            execution,
            rebuilt,
        )
    if len(found.seeds) < found.asked:
        # A program must not continue as if all runs had finished.
        raise KeyboardInterrupt(f"{len(found.seeds)} of {count} runs had ended")
    return Campaign(found, noise_levels)


def _count_of(given: Any) -> int:
    if isinstance(given, bool) or not isinstance(given, Integral) or given < 2:
        raise DeclarationError(
            f"{given!r:.60} runs", where="runs", remedy="give a whole number, two or more"
        )
    return int(given)


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
