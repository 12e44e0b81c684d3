"""A survey of several flights: diagnoses, recurring effects, derivatives over flight conditions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ident.pooling import Trend
from scenarios.report.figure_formats import Formats
from scenarios.survey.flights import Flights, read_flights
from scenarios.survey.growing import PooledFits, SurveyFiles, Tell, run_flights, survey_files
from scenarios.survey.recurring import (
    Derivative,
    Recurring,
    candidates,
    effects_of_one_flight,
    effects_over,
    estimates,
    over_flights,
    recurring_with_other_effects,
    starts_of,
)

DIAGNOSIS_SHARE = 0.75  # share of the work that is the diagnoses


@dataclass(frozen=True, eq=False, repr=False)
class SurveyResult:
    """The result of a survey.

    ``flights``: as declared. ``survey_files``: the diagnosis of each flight. ``recurs``: effects
    that recur. ``tried``: effects fitted to all flights. ``alone``: effects of single flights that
    do not recur, with these flights; ``needless``: those that what recurs explains as
    well. ``derivatives`` over the flights. ``effect_trends``: values of effects that change with a
    condition. ``refitted``: flights that were fitted with what recurs in this run. ``unfitted``:
    those that could not be, with the reason.
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
        return (
            *failed,
            *(
                f"{name} could not be fitted with what recurs: {reason}"
                for name, reason in self.unfitted.items()
            ),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """The vehicle files that were read without being named, in one sentence; empty without
        one.
        """
        result = dict.fromkeys(
            str(flight.vehicle_beside)
            for flight in self.flights.flights
            if flight.vehicle_beside is not None
        )
        return (
            (f"also read, because found beside the records: {', '.join(result)}",) if result else ()
        )

    def __repr__(self) -> str:
        named = ", ".join(each.name for each in self.recurs) or "nothing recurs"
        return f"<Survey of {len(self.survey_files.diagnoses)} flights: {named}>"

    @property
    def verdicts(self) -> Mapping[str, int]:
        """Number of single flights with each verdict."""
        return dict(
            Counter(
                str(each["verdict"]) for each in self.survey_files.diagnoses.values()
            ).most_common()
        )


def survey_flights(
    path: str | Path,
    folder: Path,
    jobs: int = 1,
    figures: Formats = (),
    tell: Tell = lambda stage, share: None,
    cluster: str | None = None,
) -> SurveyResult:
    """Survey the flights of a file into a folder, in which the result of each flight is kept.

    ``jobs`` : processes of this machine. ``cluster`` : the address of a Dask scheduler, whose
    workers take their place.

    Raises
    ------
    FlightidError : anything in the file that keeps it from being used.
    KeyboardInterrupt : Ctrl-C, with what is kept.
    """
    survey = read_flights(path)
    tell("reading", 0.0)
    had = survey_files(
        survey,
        folder,
        jobs,
        figures,
        lambda stage, share: tell(stage, DIAGNOSIS_SHARE * share),
        cluster,
    )
    names = candidates(had.diagnoses)
    share_done = (
        DIAGNOSIS_SHARE if had.computed else 0.0
    )  # so that the time that is left follows from the share
    fits, refitted, unfitted = _fits(
        had,
        names,
        folder,
        jobs,
        lambda stage, share: tell(stage, share_done + (0.95 - share_done) * share),
        cluster,
    )
    fitted = tuple(fits)
    result, sets, taken_of = recurring_with_other_effects(
        names, fitted, list(fits.values()), had.diagnoses
    )
    conditions, condition_units = conditions_of(had)
    estimated = estimates(fitted, taken_of, result, sets)
    units = {name: unit for each in fits.values() for name, unit in each["units"].items()}
    taken = {each.name for each in result} | {rival for each in result for rival in each.rivals}
    left = {
        name
        for name, each in zip(fitted, taken_of, strict=True)
        if each["sets"] is each.get("sets_without")
    }
    alone: dict[str, list[str]] = {}
    needless: dict[str, list[str]] = {}
    for name, flight in had.diagnoses.items():
        for each in flight["effects"]:
            if each["claimed"] and each["name"] not in taken:
                gone = name in left and each["name"] in fits[name]["own"]
                (needless if gone else alone).setdefault(each["name"], []).append(name)
    derivatives = over_flights(fitted, estimated, conditions, units)
    changes = effects_over(result, conditions)
    tell("pooled", 0.96)
    single, gone_of = (
        {name: tuple(here) for name, here in sorted(each.items())} for each in (alone, needless)
    )
    return SurveyResult(
        survey,
        had,
        tuple(result),
        names,
        single,
        gone_of,
        tuple(derivatives),
        conditions,
        condition_units,
        changes,
        refitted,
        unfitted,
    )


def _fits(
    had: SurveyFiles,
    names: tuple[str, ...],
    folder: Path,
    jobs: int,
    tell: Tell,
    cluster: str | None,
) -> tuple[dict[str, Mapping[str, Any]], int, dict[str, str]]:
    """Return the fits of each flight with every set of what may recur, how many flights were fitted
    for that now, and which could not be.
    """
    flights = [had.flights[name] for name in had.diagnoses]
    whole = PooledFits(
        tuple(flights),
        names,
        starts_of(had.diagnoses, names),
        tuple(effects_of_one_flight(each, names) for each in had.diagnoses.values()),
        folder,
    )
    missing = [number for number in range(len(flights)) if whole.kept(number) is None]
    failed: dict[str, str] = {}
    if missing:
        work = PooledFits(
            tuple(flights[n] for n in missing),
            names,
            whole.starts,
            tuple(whole.own[n] for n in missing),
            folder,
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
    result = {flight.name: whole.kept(number) for number, flight in enumerate(flights)}
    return {name: each for name, each in result.items() if each is not None}, len(missing), failed


def conditions_of(had: SurveyFiles) -> tuple[dict[str, dict[str, float]], dict[str, str]]:
    """Conditions that differ between flights, by name and flight, and their units."""
    values: dict[str, dict[str, float]] = {}
    units: dict[str, str] = {}
    for name in had.diagnoses:
        for key, (value, unit) in had.flights[name].condition.items():
            values.setdefault(key, {})[name] = value
            units[key] = unit
    varied = {key: each for key, each in values.items() if len(set(each.values())) > 1}
    return varied, {key: units[key] for key in varied}
