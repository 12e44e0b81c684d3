"""`run` and `simulate` in Python: scenarios of the catalogue, or of a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.api import plot
from scenarios.api.diagnosis import Diagnosis
from scenarios.api.flights import Flight, flown
from scenarios.api.records.record import Record, record_of
from scenarios.api.running import LOADERS, Runner, untold
from scenarios.api.shown import html
from scenarios.api.shown.parameters import Parameter, Parameters, row_of
from scenarios.api.shown.report import write_report
from scenarios.files.declarations import named_after
from scenarios.plots.formats import formats_wanted
from scenarios.studies.catalogue import IDENTIFICATION, scenario_file, scenario_kind
from sim.errors import DeclarationError

if TYPE_CHECKING:
    import control
    import pandas

Settings = Mapping[str, Any] | Sequence[str] | None


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """A scenario that has been run: what is true, what was estimated, how sure.

    Attributes
    ----------
    name : the scenario's. kind : ``identification``, ``trace``, ``x29`` or ``sweep``.
    details : everything that the library knows of it, of another type for each kind.
    """

    name: str
    kind: str
    details: Any
    _runner: Runner

    @property
    def seed(self) -> int:
        """The seed of its random numbers."""
        return int(self.details.seed)

    @cached_property
    def parameters(self) -> Parameters:
        """What the main method estimated; of a diagnosis the parameters with what was found."""
        if self.diagnosis is not None:
            return self.diagnosis.parameters
        if self.kind == "sweep":
            estimate = self.details.estimate
        else:
            estimate = self.details.main.result.estimate if self.kind == IDENTIFICATION else self.details.result.estimate
        return Parameters(
            Parameter(name, float(value), float(std), unit)
            for name, value, std, unit in zip(estimate.names, estimate.values, estimate.std, estimate.units, strict=True)
        )

    @cached_property
    def true(self) -> dict[str, float]:
        """True values by name, of those parameters that have one; what the fitted model should find where that is another."""
        if self.kind == IDENTIFICATION:
            return {row.name: row.reference for row in self.details.main.rows if row.reference is not None}
        if self.kind == "sweep":
            return {row.name: row.true for row in self.details.rows if row.true is not None}
        if self.kind == "trace":
            return {row.name: row.comparable for row in self.details.derivatives}
        return {}

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """What the tracing loop said, of scenarios of its own."""
        return Diagnosis(self.details.tracing) if self.kind == "trace" else None

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """What the estimator or the loop saw."""
        if self.kind == IDENTIFICATION:
            return (record_of(self.details.record),)
        if self.diagnosis is not None:
            return self.diagnosis.records
        if self.kind == "sweep":
            return tuple(record_of(record) for record in self.details.records)
        return (record_of(self.details.result.setting.record),)

    @property
    def record(self) -> Record:
        """The first of them."""
        return self.records[0]

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[name]

    def summary(self) -> str:
        """What the command prints."""
        return self._runner.text(self.details)

    def to_dataframe(self) -> pandas.DataFrame:
        """One row a parameter: ``unit``, ``value``, ``sigma``, and where it is known ``true`` with the error in ``sigmas``."""
        frame = self.parameters.to_dataframe()
        if self.true:
            frame["true"] = [self.true.get(name, float("nan")) for name in frame.index]
            frame["sigmas"] = (frame["value"] - frame["true"]) / frame["sigma"]
        return frame

    def to_state_space(self, pade: int = 4) -> control.StateSpace:
        """The model with ``parameters``, as python-control's with named signals; of the main method, or of a diagnosis."""
        if self.diagnosis is not None:
            return self.diagnosis.to_state_space(pade)
        if self.kind == "sweep":
            what, remedy = "a sweep has transfer functions, no matrices", "use details.response.fits"
            raise DeclarationError(what, where=self.name, remedy=remedy)
        from scenarios.api.matrices import matrices_of_study

        return matrices_of_study(self.details, self.kind, pade)

    def save(self, folder: str | PathLike[str], *, figures: bool | str | Sequence[str] = True) -> Path:
        """Write the study as the command does with ``--out``; returns the folder."""
        self._runner.write(self.details, Path(folder), figures=formats_wanted(figures))
        return Path(folder)

    def report(self, path: str | PathLike[str]) -> Path:
        """Write its page alone, one HTML file that holds its figures; returns the path."""
        return write_report(self.save, path)

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
        headings = ("parameter", "unit", "value", "sigma", *(("true", "error, sigmas") if self.true else ()))
        rows = [[*row_of(item), *(_against(item, self.true) if self.true else ())] for item in self.parameters.values()]
        return html.page(f"{self.name}, seed {self.seed}", html.table(headings, rows, left=2))


def _against(item: Parameter, true: Mapping[str, float]) -> tuple[str, str]:
    """The true value, and how far the estimate is from it; dashes where there is none."""
    if item.name not in true:
        return "-", "-"
    return f"{true[item.name]:.5g}", f"{(item.value - true[item.name]) / item.sigma:+.2f}" if item.sigma > 0.0 else "-"


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
    seed : of the random numbers; the scenario's own when left out.
    set : entries of the scenario that are changed, ``{"flight.rate": 50}`` or ``["flight.rate=50"]``.
    progress : told the stage and the share done, 0 to 1.

    Raises
    ------
    InputError : there is no such scenario, or a key or value in it is wrong.
    """
    text, seed = str(name), seed_of(seed)
    kind = scenario_kind(text)
    runner = LOADERS[kind](text, changes_of(set))
    with named_after(scenario_file(text)):
        return Study(Path(text).stem if text.endswith(".toml") else text, kind, runner.run(seed, progress or untold), runner)


def simulate(name: str | PathLike[str], *, seed: int | None = None, set: Settings = None) -> Flight:
    """The records of a scenario without its truth, and the vehicle that goes with them: ``flightid simulate`` in Python; parameters as in ``run``."""
    return flown(str(name), seed_of(seed), changes_of(set))


def seed_of(given: Any) -> int | None:
    """The seed. Raises DeclarationError for what is none."""
    if given is not None and (isinstance(given, bool) or not isinstance(given, Integral) or given < 0):
        raise DeclarationError(f"{given!r:.60} is no seed", where="seed", remedy="give a whole number, zero or more")
    return None if given is None else int(given)


def changes_of(settings: Settings) -> list[str]:
    """Settings as the command line takes them."""
    if settings is None:
        return []
    if isinstance(settings, Mapping):
        from scenarios.api.vehicle import toml_value

        return [f"{key}={toml_value(value, key)}" for key, value in settings.items()]
    return [settings] if isinstance(settings, str) else list(settings)
