"""Derivatives and values of effects over the flights of a survey, and their trends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
from scenarios.survey.recurring import Recurring, fit_with

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
