"""Derivatives over the condition, on flights that were made up: against one fit of all samples, and
a regression written a second way.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from ident.pooling import Recurrence
from scenarios.survey.recurring import Recurring, recurring
from scenarios.survey.survey import (
    FALSE_DISCOVERY_RATE,
    effects_over,
    estimates,
    over_flights,
)
from tests.unit.scenarios.survey.made_up import DECLARED, TRUE, UNITS, flown, kept

COUNT = 14
NAMES = tuple(kept([{}] * COUNT))


@pytest.mark.parametrize("parameters", [1, 2])
def test_derivatives_are_those_of_one_fit_of_all_samples(parameters: int) -> None:
    rng = np.random.default_rng(1)
    value = [1.0, -0.8][:parameters]
    # The effect looks like a derivative's own: alone each flight tells them apart poorly.
    flights = [
        flown(rng, {"arm": rng.standard_normal((60, parameters))}, {"arm": value}, alike=2.0)
        for _ in range(COUNT)
    ]
    fits = [each.fits() for each in flights]
    found, sets = recurring(("arm",), NAMES, fits, kept([{"arm": []}] * COUNT))
    assert sets == [frozenset({"arm"})] * COUNT
    told = estimates(fits, found, sets)
    whole = np.zeros((60 * COUNT, 2 * COUNT + parameters))
    for number, each in enumerate(flights):
        rows = slice(60 * number, 60 * number + 60)
        whole[rows, 2 * number : 2 * number + 2], whole[rows, 2 * COUNT :] = (
            each.design,
            each.effects["arm"],
        )
    inverse = np.linalg.inv(whole.T @ whole)
    joint = inverse @ whole.T @ np.concatenate([each.y for each in flights])
    for number, mine in enumerate(told):
        for place, name in enumerate(DECLARED):
            at = 2 * number + place
            assert mine[name][0] == pytest.approx(joint[at], abs=1e-4)
            assert mine[name][1] == pytest.approx(np.sqrt(inverse[at, at]), rel=1e-3)
    assert found[0].recurrence.value == pytest.approx(joint[2 * COUNT :], abs=1e-4)


def test_a_flight_that_may_have_an_effect_counts_by_that_probability_and_not_twice() -> None:
    """Informations add up: a flight's own, whole, and of each other flight on the effect the share
    that its probability is.
    """
    rng, probability = np.random.default_rng(4), np.array([0.97, 0.6, 0.8, 0.99])
    roots = rng.standard_normal((4, 3, 3)) + 2.0 * np.eye(3)
    covariances, values = (
        roots @ roots.transpose(0, 2, 1),
        rng.standard_normal((4, 3)) + [5.0, -0.6, 2.0],
    )
    told = probability / covariances[:, 2, 2]
    common = np.array([told @ values[:, 2] / told.sum()])
    found = Recurrence(
        common, np.array([[1.0 / told.sum()]]), 0.0, True, 0.9, probability, 50.0, np.zeros(4), 1e-9
    )
    arm = Recurring("arm", {"size": "m"}, NAMES[:4], found, values[:, 2:], np.zeros((4, 1)), {}, ())
    effects = {"arm": {"parameters": ["size"], "units": {"size": "m"}, "full": ["arm.size"]}}
    fits = [
        {
            "declared": [*DECLARED],
            "effects": effects,
            "sets": {
                "arm": {
                    "names": [*DECLARED, "arm.size"],
                    "estimate": value.tolist(),
                    "covariance": covariance.tolist(),
                }
            },
        }
        for value, covariance in zip(values, covariances, strict=True)
    ]
    mine = estimates(fits, [arm], [frozenset({"arm"})] * 4)
    for number in range(4):
        others = [i for i in range(4) if i != number]
        information, at = np.linalg.inv(covariances[number]), np.zeros((3, 3))
        at[2, 2] = told[others].sum()
        pull = information @ values[number] + [0.0, 0.0, told[others] @ values[others, 2]]
        expected, sigma = (
            np.linalg.solve(information + at, pull),
            np.sqrt(np.diag(np.linalg.inv(information + at))),
        )
        assert list(mine[number].values()) == [
            pytest.approx((expected[k], sigma[k])) for k in range(2)
        ]


def test_a_flight_without_a_fit_says_nothing() -> None:
    rng = np.random.default_rng(2)
    fits = [flown(rng, {}, {}).fits() for _ in range(3)]
    fits[1]["sets"] = {}
    told = estimates(fits, [], [frozenset()] * 3)
    assert told[1] == {}
    assert over_flights(NAMES[:3], told, {}, UNITS)[0].flights == (NAMES[0], NAMES[2])


def regression(
    values: np.ndarray, sigmas: np.ndarray, condition: np.ndarray
) -> tuple[float, float, float, float]:
    """Slope, its sigma, the scatter and p: restricted likelihood of error contrasts, generalised
    least squares by whitening, Knapp and Hartung.
    """
    n = len(values)
    design = np.column_stack([np.ones(n), condition])
    contrasts = null_space(design.T).T

    def cost(log_scatter: float) -> float:
        covariance = contrasts @ np.diag(sigmas**2 + np.exp(2.0 * log_scatter)) @ contrasts.T
        left = contrasts @ values
        return float(np.linalg.slogdet(covariance)[1] + left @ np.linalg.solve(covariance, left))

    scatter = float(
        np.exp(
            minimize_scalar(cost, bounds=(-12.0, 3.0), method="bounded", options={"xatol": 1e-10}).x
        )
    )
    white = 1.0 / np.sqrt(sigmas**2 + scatter**2)
    triangle = np.linalg.qr(design * white[:, None])[1]
    found = np.linalg.lstsq(design * white[:, None], values * white, rcond=None)[0]
    spread = np.sum(((values - design @ found) * white) ** 2) / (n - 2)
    sigma = np.linalg.norm(np.linalg.inv(triangle)[1]) * np.sqrt(max(1.0, spread))
    return (
        float(found[1]),
        float(sigma),
        scatter,
        float(2.0 * student.sf(abs(found[1]) / sigma, n - 2)),
    )


def test_trends_are_those_of_a_regression_written_a_second_way() -> None:
    rng = np.random.default_rng(3)
    mass, mach = rng.uniform(4000.0, 6000.0, COUNT), rng.uniform(0.2, 0.7, COUNT)
    told = []
    for number in range(COUNT):
        sigmas = rng.uniform(0.01, 0.05, 2)
        values = (
            TRUE
            + [0.0, 3e-4 * (mass[number] - 5000.0)]
            + [0.04, 0.02] * rng.standard_normal(2)
            + sigmas * rng.standard_normal(2)
        )
        told.append(
            {
                name: (float(v), float(s))
                for name, v, s in zip(DECLARED, values, sigmas, strict=True)
            }
        )
    conditions = {
        "mass": dict(zip(NAMES, mass, strict=True)),
        "mach": dict(zip(NAMES, mach, strict=True)),
    }
    plain, moved = over_flights(NAMES, told, conditions, UNITS)
    for each in (plain, moved):
        for name, at in (("mass", mass), ("mach", mach)):
            line = each.trends[name][0]
            slope, sigma, scatter, p = regression(each.values, each.sigmas, at)
            assert line.slope == pytest.approx(slope, rel=1e-4)
            assert line.slope_sigma == pytest.approx(sigma, rel=1e-4)
            assert line.scatter == pytest.approx(scatter, rel=1e-3)
            assert line.p_value == pytest.approx(p, rel=1e-3)
    assert moved.drifts is not None
    assert moved.drifts[0] == "mass"
    assert plain.drifts is None
    assert moved.differs < FALSE_DISCOVERY_RATE
    # Of the four questions asked: Benjamini and Hochberg's rule, walked down by hand.
    asked = sorted(line.p_value for each in (plain, moved) for line, _ in each.trends.values())
    least = min(asked[place] * 4 / (place + 1) for place in range(4))
    assert moved.trends["mass"][1] == pytest.approx(least)


def test_a_flight_that_stands_out_is_told_and_no_other() -> None:
    rng = np.random.default_rng(4)
    told = [
        {"Cm_alpha": (-0.6 + 0.02 * rng.standard_normal() + (0.4 if number == 5 else 0.0), 0.02)}
        for number in range(COUNT)
    ]
    (each,) = over_flights(NAMES, told, {}, UNITS)
    assert [NAMES[number] for number in np.flatnonzero(each.out)] == ["F005"]


def test_conditions_that_only_some_flights_have() -> None:
    told = [{"Cm_alpha": (-0.6 + 0.01 * number, 0.001)} for number in range(6)]
    (each,) = over_flights(
        NAMES[:6],
        told,
        {"flaps": {name: float(number) for number, name in enumerate(NAMES[:5])}},
        UNITS,
    )
    assert each.drifts is not None
    assert each.drifts[1].slope == pytest.approx(0.01)
    (few,) = over_flights(NAMES[:6], told, {"flaps": dict.fromkeys(NAMES[:3], 1.0)}, UNITS)
    assert few.trends == {}


def test_an_effect_that_changes_with_a_condition_is_told_so() -> None:
    """A lag that is an arm over the airspeed; where one value is enough, nothing is asked."""
    rng = np.random.default_rng(5)
    speed = rng.uniform(0.7, 1.6, COUNT)
    conditions = {
        "airspeed": dict(zip(NAMES, speed, strict=True)),
        "mass": dict(zip(NAMES, rng.uniform(4.0, 6.0, COUNT), strict=True)),
    }
    for power, told in ((1.0, {("lag", "value0"): "airspeed"}), (0.0, {})):
        fits = [
            flown(rng, {"lag": rng.standard_normal((60, 1))}, {"lag": [3.0 / one**power]}).fits()
            for one in speed
        ]
        found, _ = recurring(("lag",), NAMES, fits, kept([{"lag": []}] * COUNT))
        changes = effects_over(found, conditions)
        assert {key: condition for key, (condition, _) in changes.items()} == told
        for _, line in changes.values():
            slope, sigma, _, _ = regression(found[0].values[:, 0], found[0].sigmas[:, 0], speed)
            assert (line.slope, line.slope_sigma) == pytest.approx((slope, sigma), rel=1e-4)
            assert slope < -8.0 * sigma
