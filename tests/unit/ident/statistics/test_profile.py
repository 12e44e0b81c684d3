"""Profile-likelihood intervals: a parabola, a regression in closed form, a sigma that is wrong,
sides that are open or end at a bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ident.frequency_domain import output_error as in_frequency
from ident.frequency_domain.output_error import FrequencySettings, covariance_of, frequency_fit
from ident.statistics.profile_likelihood import (
    LEVEL,
    TWICE_LOG_LIKELIHOOD_DROP,
    ProfileInterval,
    profile_interval,
)
from ident.whole_record.gauss_newton import fit_whole_records, profile_intervals
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.output_error import fit_from_best_start, shared_covariance
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.record import Channel, Record
from tests.linear_problem import oscillator, record_of
from tests.own_models import roll

FREE = (-math.inf, math.inf)


def of_function(
    cost: Callable[[float], float],
    value: float,
    sigma: float,
    bounds: tuple[float, float] = FREE,
    inflation: float = 1.0,
) -> ProfileInterval:
    return profile_interval(
        "x", value, sigma, cost(value), lambda at, state: (cost(at), None), bounds, inflation
    )


def test_of_a_parabola_it_is_two_sigmas() -> None:
    found = of_function(lambda x: 0.5 * ((x - 3.0) / 0.2) ** 2, 3.0, 0.2)
    assert (
        found.low == pytest.approx(2.6, abs=0.01)
        and found.high == pytest.approx(3.4, abs=0.01)
        and found.agrees
    )
    assert abs(LEVEL - 0.9545) < 1e-4


def test_colour_widens_the_threshold() -> None:
    found = of_function(lambda x: 0.5 * x**2, 0.0, 1.5, inflation=1.5**2)
    assert (
        found.low == pytest.approx(-3.0, abs=0.06)
        and found.high == pytest.approx(3.0, abs=0.06)
        and found.agrees
    )


def test_what_is_normal_in_its_logarithm_is_skewed() -> None:
    """ln x is known to 0.5: the interval is a factor of e either way, and sigma at the maximum
    tells neither end.
    """
    found = of_function(
        lambda x: math.inf if x <= 0.0 else 0.5 * (math.log(x) / 0.5) ** 2, 1.0, 0.5
    )
    assert (
        found.low == pytest.approx(math.exp(-1.0), rel=0.02)
        and found.high == pytest.approx(math.e, rel=0.02)
        and not found.agrees
    )


@pytest.mark.parametrize("most", [1.9, 1.0])
def test_a_likelihood_that_levels_off_is_open_on_that_side(most: float) -> None:
    """Its root goes to ``most``, below the two that make an end."""
    found = of_function(lambda x: 0.5 * (x if x < 0.0 else most * x / (most + x)) ** 2, 0.0, 1.0)
    assert found.high is None and found.low == pytest.approx(-2.0, abs=0.05) and not found.agrees


def test_a_bound_ends_a_side_and_is_said() -> None:
    found = of_function(lambda x: 0.5 * (x - 1.0) ** 2, 1.0, 1.0, (0.0, math.inf))
    assert (
        found.low == 0.0
        and found.low_bound
        and not found.high_bound
        and found.high == pytest.approx(3.0, abs=0.05)
    )


def test_a_refit_that_fails_lies_outside() -> None:
    found = profile_interval(
        "x",
        0.0,
        1.0,
        0.0,
        lambda at, state: None if at > 2.5 else (0.5 * (at * 0.9) ** 2, None),
        FREE,
    )
    assert found.high == pytest.approx(2.0 / 0.9, rel=0.02)


def test_a_likelier_value_is_told() -> None:
    assert of_function(
        lambda x: 0.5 * x**2 - 3.0 * math.exp(-((x - 2.0) ** 2) / 0.1), 0.0, 1.0
    ).better == pytest.approx(1.0)


def static_record(rng: np.random.Generator) -> Record:
    record = record_of(rng, 80)
    return replace(
        record, outputs=tuple(channel for channel in record.outputs if channel.name == "place")
    )


def test_of_a_linear_regression_it_is_in_closed_form() -> None:
    """One output, unknowns force and initial state: N ln(RSS / RSS_min) = 4, with RSS a parabola
    along the force.
    """
    record = static_record(np.random.default_rng(3))
    model = oscillator()
    system = compile_model(model.with_parameters(model.parameters.hold(["bias_mixed"])), ["place"])
    settings = FitSettings(coloured=False, exact=True)
    fit = fit_whole_records(FitProblem(lay_out([record], system, settings)))
    assert fit is not None
    (found,) = profile_intervals(fit, ["force"], shared_covariance(fit)[0])
    slopes, z = fit.jacobians[0][0], record["place"].values
    projector = np.linalg.inv(slopes.T @ slopes)
    least = float(np.sum((z - fit.linearisations[0].y[0]) ** 2))
    assert found.low is not None and found.high is not None
    half = math.sqrt((math.exp(TWICE_LOG_LIKELIHOOD_DROP / len(z)) - 1.0) * least * projector[0, 0])
    assert found.value - found.low == pytest.approx(
        half, rel=0.01
    ) and found.high - found.value == pytest.approx(half, rel=0.01)
    assert half == pytest.approx(2.0 * found.sigma, rel=0.03) and found.agrees


def lagged() -> Model:
    """A servo that answers in next to no time: its rate is known from below alone."""
    return roll(
        name="servo",
        states={"p": "rad/s"},
        outputs={"p": "rad/s"},
        constants={},
        parameters={"quickness": (30.0, "1/s"), "gain": (1.0, "1/s")},
        rates=lambda s, p: {"p": p.quickness * (p.gain * s.aileron - s.p)},
        readings=lambda s, p: {"p": s.p},
        bounds={"quickness": (0.1, 1e6)},
    )


def servo_record(rng: np.random.Generator, quickness: float) -> Record:
    time = np.arange(120) / 20.0
    u = np.sign(np.sin(2.1 * time + 0.2)) * (time > 0.5)
    decay, x, rows = math.exp(-quickness / 20.0), 0.0, []
    for value in u:
        rows.append(x)
        x = decay * x + (1.0 - decay) * value
    noisy = np.array(rows) + 0.08 * rng.standard_normal(len(rows))
    return Record(time, (Channel.of("aileron", "rad", u),), (Channel.of("p", "rad/s", noisy),))


@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_a_lag_too_quick_for_the_record_is_open_above(domain: str) -> None:
    """At 20 Hz a servo of 80 rad/s has done 98 % of its way after a sample: no sigma says that any
    quicker one does as well.
    """
    record, system = servo_record(np.random.default_rng(2), 80.0), compile_model(lagged())
    if domain == "time":
        fit = fit_from_best_start(lay_out([record], system, FitSettings(max_step=0.002)))
        assert fit is not None
        quick, gain = profile_intervals(fit, ["quickness", "gain"], shared_covariance(fit)[0])
    else:
        found, _ = frequency_fit([record], system, FrequencySettings((0.0, 10.0)))
        assert found is not None
        quick, gain = in_frequency.profile_intervals(
            found, ["quickness", "gain"], covariance_of(found, colour=True)[0]
        )
    assert (
        (quick.high is None or quick.high_bound)
        and quick.low is not None
        and 20.0 < quick.low < 80.0
        and not quick.agrees
    )
    assert gain.agrees


@pytest.mark.slow
def test_an_interval_by_likelihood_holds_the_truth_where_two_sigmas_do_not() -> None:
    """A servo of 120 rad/s at 20 Hz: of 100 records intervals by likelihood hold it in 95 at least
    less two deviations, by sigma in fewer than 88.
    """
    system, held, by_sigma = compile_model(lagged()), 0, 0
    for seed in range(100):
        fit, _ = frequency_fit(
            [servo_record(np.random.default_rng(seed), 120.0)],
            system,
            FrequencySettings((0.0, 10.0)),
        )
        assert fit is not None
        (found,) = in_frequency.profile_intervals(
            fit, ["quickness"], covariance_of(fit, colour=False)[0]
        )
        held += (found.low or -math.inf) <= 120.0 <= (found.high or math.inf)
        by_sigma += abs(found.value - 120.0) <= 2.0 * found.sigma
    assert held >= 91 and by_sigma < 88, (held, by_sigma)
