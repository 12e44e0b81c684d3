"""A survey of several flights: diagnoses, recurring effects, derivatives over flight conditions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ident.pooling import Trend
from scenarios.files.vehicles import ALSO_READ
from scenarios.report.figure_formats import Formats
from scenarios.survey.derivatives import Derivative, effects_over, estimates, over_flights
from scenarios.survey.flights import Flights, read_flights
from scenarios.survey.growing import PooledFits, SurveyFiles, Tell, run_flights, survey_files
from scenarios.survey.recurring import (
    Recurring,
    candidates,
    effects_of_one_flight,
    recurring_with_other_effects,
    starts_of,
)

DIAGNOSIS_SHARE = 0.75  # share of the work that is the diagnoses


@dataclass(frozen=True, eq=False, repr=False)
class SurveyResult:
    """The result of a survey.

    Attributes
    ----------
    flights : the flights as declared.
    survey_files : the diagnosis of each flight.
    recurs : effects that recur.
    tried : effects that were fitted to all flights.
    alone : effects that do not recur -> flights that claim them.
    needless : effects that do not recur and that the recurring ones replace -> flights that claim
        them.
    derivatives : derivatives over the flights.
    conditions : condition -> flight -> value; only conditions that differ between flights.
    condition_units : condition -> unit.
    effect_trends : effect and parameter -> condition with which the value changes, and its trend.
    refitted : number of flights that were fitted with the effects in this run.
    unfitted : flight that could not be fitted -> reason.
    """

    flights: Flights
    survey_files: SurveyFiles
    recurs: tuple[Recurring, ...] = ()
    tried: tuple[str, ...] = ()
    alone: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    needless: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    derivatives: tuple[Derivative, ...] = ()
    conditions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    condition_units: Mapping[str, str] = field(default_factory=dict)
    effect_trends: Mapping[tuple[str, str], tuple[str, Trend]] = field(default_factory=dict)
    refitted: int = 0
    unfitted: Mapping[str, str] = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Flights without information on the recurring effects, each with the reason."""
        failed = [f"{name} failed: {reason}" for name, reason in self.survey_files.failed.items()]
        unfitted = [
            f"{name} could not be fitted with what recurs: {reason}"
            for name, reason in self.unfitted.items()
        ]
        return (*failed, *unfitted)

    @property
    def notes(self) -> tuple[str, ...]:
        """The vehicle files that were read without being named, in one sentence; empty without
        one.
        """
        paths = dict.fromkeys(
            str(flight.vehicle_beside)
            for flight in self.flights.flights
            if flight.vehicle_beside is not None
        )
        return (f"{ALSO_READ}: {', '.join(paths)}",) * bool(paths)

    def __repr__(self) -> str:
        names = ", ".join(effect.name for effect in self.recurs) or "nothing recurs"
        return f"<Survey of {len(self.survey_files.diagnoses)} flights: {names}>"

    @property
    def verdicts(self) -> Mapping[str, int]:
        """Number of flights with each verdict of a single flight, the most frequent first."""
        verdicts = [str(content["verdict"]) for content in self.survey_files.diagnoses.values()]
        return dict(Counter(verdicts).most_common())


def survey_flights(
    path: str | Path,
    folder: Path,
    jobs: int = 1,
    figures: Formats = (),
    tell: Tell = lambda stage, share: None,
    cluster: str | None = None,
) -> SurveyResult:
    """Survey the flights of a file into a folder, in which the result of each flight is kept.

    Parameters
    ----------
    path : the file that declares the flights.
    folder : folder of the survey.
    jobs : processes of this machine.
    figures : formats of the figures of each flight.
    tell : called with the stage and the share of the work that is done.
    cluster : address of a Dask scheduler, whose workers are used in place of processes.

    Raises
    ------
    FlightidError : anything in the file that keeps it from being used.
    KeyboardInterrupt : Ctrl-C, with what is kept.
    """
    survey = read_flights(path)
    tell("reading", 0.0)
    files = survey_files(
        survey,
        folder,
        jobs,
        figures,
        lambda stage, share: tell(stage, DIAGNOSIS_SHARE * share),
        cluster,
    )
    names = candidates(files.diagnoses)
    # Without new diagnoses the fits are all of the work, and the remaining time follows from them.
    share_done = DIAGNOSIS_SHARE if files.computed else 0.0
    fits, refitted, unfitted = _fits(
        files,
        names,
        folder,
        jobs,
        lambda stage, share: tell(stage, share_done + (0.95 - share_done) * share),
        cluster,
    )
    flights = tuple(fits)
    recurring, sets, used_fits = recurring_with_other_effects(
        names, flights, list(fits.values()), files.diagnoses
    )
    conditions, condition_units = conditions_of(files)
    units = {name: unit for fitted in fits.values() for name, unit in fitted["units"].items()}
    derivatives = over_flights(flights, estimates(used_fits, recurring, sets), conditions, units)
    effect_trends = effects_over(recurring, conditions)
    # Flights that fit as well without their single effects.
    without_single_effects = {
        flight
        for flight, fitted in zip(flights, used_fits, strict=True)
        if fitted["sets"] is fitted.get("sets_without")
    }
    explained = {name for effect in recurring for name in (effect.name, *effect.rivals)}
    alone: dict[str, list[str]] = {}
    needless: dict[str, list[str]] = {}
    for flight, content in files.diagnoses.items():
        for effect in content["effects"]:
            name = effect["name"]
            if effect["claimed"] and name not in explained:
                dropped = flight in without_single_effects and name in fits[flight]["own"]
                (needless if dropped else alone).setdefault(name, []).append(flight)
    tell("pooled", 0.96)
    return SurveyResult(
        survey,
        files,
        tuple(recurring),
        names,
        {name: tuple(flights_of) for name, flights_of in sorted(alone.items())},
        {name: tuple(flights_of) for name, flights_of in sorted(needless.items())},
        tuple(derivatives),
        conditions,
        condition_units,
        effect_trends,
        refitted,
        unfitted,
    )


def _fits(
    files: SurveyFiles,
    names: tuple[str, ...],
    folder: Path,
    jobs: int,
    tell: Tell,
    cluster: str | None,
) -> tuple[dict[str, Mapping[str, Any]], int, dict[str, str]]:
    """Return the fits of each flight with every set of the effects ``names``; the number of flights
    that were fitted in this run; and the flights that could not be fitted, with the reasons.
    """
    flights = tuple(files.flights[name] for name in files.diagnoses)
    fits = PooledFits(
        flights,
        names,
        starts_of(files.diagnoses, names),
        tuple(effects_of_one_flight(content, names) for content in files.diagnoses.values()),
        folder,
    )
    missing = [number for number in range(len(flights)) if fits.kept(number) is None]
    failed: dict[str, str] = {}
    if missing:
        work = replace(
            fits,
            flights=tuple(flights[n] for n in missing),
            own=tuple(fits.own[n] for n in missing),
        )
        try:
            table = run_flights(work, len(missing), jobs, folder, tell, cluster)
        except KeyboardInterrupt:
            table = None
        if table is None or not table.whole:
            raise KeyboardInterrupt(f"all {len(flights)} flights are kept in {folder}")
        errors = zip(table.columns["number"], table.columns["error"], strict=True)
        failed = {
            flights[missing[int(number)]].name: str(error) for number, error in errors if error
        }
    kept = {flight.name: fits.kept(number) for number, flight in enumerate(flights)}
    fitted = {name: content for name, content in kept.items() if content is not None}
    return fitted, len(missing), failed


def conditions_of(files: SurveyFiles) -> tuple[dict[str, dict[str, float]], dict[str, str]]:
    """Return condition -> flight -> value for the conditions that differ between flights, and
    condition -> unit.
    """
    values: dict[str, dict[str, float]] = {}
    units: dict[str, str] = {}
    for flight in files.diagnoses:
        for name, (value, unit) in files.flights[flight].condition.items():
            values.setdefault(name, {})[flight] = value
            units[name] = unit
    varied = {
        name: by_flight for name, by_flight in values.items() if len({*by_flight.values()}) > 1
    }
    return varied, {name: units[name] for name in varied}
