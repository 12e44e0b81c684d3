"""A survey of several flights: diagnoses, recurring effects, derivatives over flight conditions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.pooling import (
    PooledValue,
    Trend,
    adjusted_p_values,
    condition_on_shared_value,
    fit_trend,
    outlying_flights,
    pool_values,
    pooled_without_flight,
)
from scenarios.files.vehicles import ALSO_READ
from scenarios.report.figure_formats import Formats
from scenarios.survey.flights import Flights, read_flights
from scenarios.survey.growing import PooledFits, SurveyFiles, run_flights, survey_files
from scenarios.survey.recurring import (
    Recurring,
    candidates,
    effects_of_one_flight,
    fit_with,
    recurring_with_other_effects,
    starts_of,
)
from scenarios.tasks.study import ShowProgress

# ---- Derivatives and values of effects over the flights, and their trends

# Rate of false discoveries among the trends, and among the derivatives said to differ.
FALSE_DISCOVERY_RATE = 0.05
# Sigma over value above which a flight does not determine a derivative.
UNDETERMINED_SIGMA_RATIO = 1e6


@dataclass(frozen=True, eq=False)
class Derivative:
    """One derivative over the flights.

    Attributes
    ----------
    name, unit : name of the derivative, and its unit.
    flights : names of the N flights that determine it.
    values, sigmas : estimate of each flight and its standard deviation, ``(N,)``.
    common : the common value.
    differs : false discovery rate at which the value is not constant.
    trends : condition -> trend, and its false discovery rate.
    off : distance of each flight from the trend, else from the common value, in sigmas, ``(N,)``.
    out : whether each flight is an outlier, ``(N,)``.
    """

    name: str
    unit: str
    flights: tuple[str, ...]
    values: np.ndarray
    sigmas: np.ndarray
    common: PooledValue
    differs: float
    trends: Mapping[str, tuple[Trend, float]]
    off: np.ndarray
    out: np.ndarray

    @property
    def drifts(self) -> tuple[str, Trend] | None:
        """Return the condition with the most significant trend, and the trend; None without one."""
        significant = {
            name: (line, q) for name, (line, q) in self.trends.items() if q < FALSE_DISCOVERY_RATE
        }
        if not significant:
            return None
        best = min(significant, key=lambda name: (significant[name][0].p_value, name))
        return best, significant[best][0]


def estimates(
    fits: Sequence[Mapping[str, Any]],
    recurring_effects: Sequence[Recurring],
    sets: Sequence[frozenset[str]],
) -> list[dict[str, tuple[float, float]]]:
    """Return derivative -> value and standard deviation for each flight.

    Where an effect has one value in all flights, this value is known from the other flights.
    """
    estimates_of_flights: list[dict[str, tuple[float, float]]] = []
    shared = {effect.name: effect for effect in recurring_effects if effect.recurrence.agrees}
    for number, (fitted, effects) in enumerate(zip(fits, sets, strict=True)):
        fit = fit_with(fitted, effects)
        if fit is None:
            estimates_of_flights.append({})
            continue
        value, fit_covariance = np.array(fit["estimate"]), np.array(fit["covariance"])
        covariance = fit_covariance
        for name in sorted(effects & set(shared)):
            effect = shared[name]
            at = np.array([fit["names"].index(full) for full in fitted["effects"][name]["full"]])
            # In the common value a flight has the weight of its probability.
            weighted = fit_covariance[np.ix_(at, at)] / effect.recurrence.probability[number]
            of_others = pooled_without_flight(
                effect.recurrence.value,
                effect.recurrence.covariance,
                effect.values[number],
                weighted,
            )
            if of_others is not None:
                value, covariance = condition_on_shared_value(value, covariance, at, *of_others)
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        estimates_of_flights.append(
            {
                n: (float(v), float(s))
                for n, v, s in zip(fitted["declared"], value, sigma, strict=False)
                if 0 < s < UNDETERMINED_SIGMA_RATIO * max(abs(v), 1e-12)
            }
        )
    return estimates_of_flights


def effects_over(
    recurring_effects: Sequence[Recurring], conditions: Mapping[str, Mapping[str, float]]
) -> dict[tuple[str, str], tuple[str, Trend]]:
    """Return effect and parameter -> condition and trend, for parameters that differ between
    flights and change with a condition. The most significant trend is taken.
    """
    trends: list[tuple[tuple[str, str], str, Trend]] = []
    for effect in recurring_effects:
        if effect.recurrence.agrees:
            continue
        for condition, by_flight in conditions.items():
            at = [
                number
                for number, name in enumerate(effect.flights)
                if name in effect.has and name in by_flight
            ]
            where = np.array([by_flight[effect.flights[number]] for number in at])
            for place, local in enumerate(effect.parameters):
                line = fit_trend(effect.values[at, place], effect.sigmas[at, place], where)
                if line is not None:
                    trends.append(((effect.name, local), condition, line))
    rates = adjusted_p_values(np.array([line.p_value for *_, line in trends]))
    best: dict[tuple[str, str], tuple[str, Trend]] = {}
    for (key, condition, line), rate in zip(trends, rates, strict=True):
        if rate < FALSE_DISCOVERY_RATE and (key not in best or line.p_value < best[key][1].p_value):
            best[key] = condition, line
    return best


def over_flights(
    flights: Sequence[str],
    estimates_of_flights: Sequence[Mapping[str, tuple[float, float]]],
    conditions: Mapping[str, Mapping[str, float]],
    units: Mapping[str, str],
) -> list[Derivative]:
    """Return each derivative over all flights.

    Parameters
    ----------
    flights : names of the flights.
    estimates_of_flights : derivative -> value and standard deviation, as ``estimates`` returns.
    conditions : condition -> flight -> value.
    units : derivative -> unit.
    """
    names = list(dict.fromkeys(name for found in estimates_of_flights for name in found))
    derivatives = []
    for name in names:
        by_flight = {
            flight: found[name]
            for flight, found in zip(flights, estimates_of_flights, strict=True)
            if name in found
        }
        values, sigmas = np.array(list(by_flight.values())).T
        trends: dict[str, tuple[Trend, float]] = {}
        for condition, at_flight in conditions.items():
            at = [n for n, flight in enumerate(by_flight) if flight in at_flight]
            where = np.array([at_flight[flight] for flight in by_flight if flight in at_flight])
            line = fit_trend(values[at], sigmas[at], where)
            if line is not None:
                trends[condition] = line, np.nan  # the rate follows from all derivatives
        derivatives.append(
            Derivative(
                name,
                units.get(name, ""),
                tuple(by_flight),
                values,
                sigmas,
                pool_values(values, sigmas),
                np.nan,
                trends,
                np.zeros(len(values)),
                np.zeros(len(values), dtype=bool),
            )
        )
    differ = adjusted_p_values(np.array([item.common.p_same for item in derivatives]))
    rates = iter(
        adjusted_p_values(
            np.array([line.p_value for item in derivatives for line, _ in item.trends.values()])
        )
    )
    completed = []
    for item, rate in zip(derivatives, differ, strict=True):
        trends = {key: (line, float(next(rates))) for key, (line, _) in item.trends.items()}
        completed.append(
            _with_outliers(replace(item, differs=float(rate), trends=trends), conditions)
        )
    return completed


def _with_outliers(
    derivative: Derivative, conditions: Mapping[str, Mapping[str, float]]
) -> Derivative:
    """Return a derivative with the distance of each flight from its trend, else from the common
    value, and with its outliers.
    """
    expected = np.full(len(derivative.values), derivative.common.value)
    if derivative.drifts is not None:
        condition, line = derivative.drifts
        where = [conditions[condition].get(name, line.middle) for name in derivative.flights]
        expected, _ = line.band(np.array(where))
    off, out = outlying_flights(derivative.values - expected, derivative.sigmas)
    return replace(derivative, off=off, out=out)


# ---- A survey of all flights

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
    show_progress: ShowProgress = lambda stage, share: None,
    cluster: str | None = None,
) -> SurveyResult:
    """Survey the flights of a file into a folder, in which the result of each flight is kept.

    Parameters
    ----------
    path : the file that declares the flights.
    folder : folder of the survey.
    jobs : processes of this machine.
    figures : formats of the figures of each flight.
    show_progress : called with the stage and the share of the work that is done.
    cluster : address of a Dask scheduler, whose workers are used in place of processes.

    Raises
    ------
    FlightidError : anything in the file that keeps it from being used.
    KeyboardInterrupt : Ctrl-C, with what is kept.
    """
    survey = read_flights(path)
    show_progress("reading", 0.0)
    files = survey_files(
        survey,
        folder,
        jobs,
        figures,
        lambda stage, share: show_progress(stage, DIAGNOSIS_SHARE * share),
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
        lambda stage, share: show_progress(stage, share_done + (0.95 - share_done) * share),
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
    show_progress("pooled", 0.96)
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
    show_progress: ShowProgress,
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
            table = run_flights(work, len(missing), jobs, folder, show_progress, cluster)
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
