"""The whole-record Gauss-Newton fit: what its outcome promises, and that units do not enter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ident.estimate import Outcome
from ident.statistics.minimise import LocalModel, local_model
from ident.whole_record import gauss_newton
from ident.whole_record.gauss_newton import (
    Fit,
    evaluate,
    fit_whole_records,
    has_converged,
    predicted_trajectories,
    without_sensitivities,
)
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.noise_model import White
from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from sim.propagation import drive_from_record, make_grid, simulate
from sim.record import Channel, Record
from tests.bases import ballistic_model, rigid_model
from tests.linear_problem import oscillator, record_of
from tests.rigid_problem import FREE, UNSTABLE, ballistic_record, rigid_record

# a start from which trial steps are refused until damping has made them tiny
FACTORS = (0.5, 0.5, 1.1, 0.7, 1.9, 0.5)
ROUGH = FitSettings(max_step=0.04, tolerance=0.03, enough=0.2)


def unstable_fit(settings: FitSettings, unit: float = 1.0) -> Fit:
    """Of an unstable aircraft; the load factor, which is no state, in units of ``1 / unit`` g."""
    record = rigid_record(np.random.default_rng(1), 6.0, 25.0, UNSTABLE)
    model = rigid_model(UNSTABLE).with_values(
        {name: UNSTABLE[name] * x for name, x in zip(FREE, FACTORS, strict=True)}
    )
    system = compile_model(model)
    h = system.h
    assert system.output_names == ("alpha", "q", "nz")

    def outputs(t: Any, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        alpha, q, nz = h(t, x, u, p)
        return [alpha, q, unit * nz]

    channels = tuple(
        Channel.of(name, "1", (unit if name == "nz" else 1.0) * record[name].values)
        for name in system.output_names
    )
    fit = fit_whole_records(
        FitProblem(
            lay_out(
                [Record(record.time, record.inputs, channels, record.hold)],
                replace(system, h=outputs),
                settings,
            )
        )
    )
    assert fit is not None
    return fit


@pytest.mark.parametrize("exact", [False, True])
def test_the_cost_alone_is_that_of_a_whole_evaluation(*, exact: bool) -> None:
    record = rigid_record(np.random.default_rng(1), 6.0, 25.0)
    layout = lay_out([record, record.window(1.0, 4.0)], compile_model(rigid_model()), FitSettings())
    problem = FitProblem(
        replace(layout, problems=tuple(replace(each, exact=exact) for each in layout.problems))
    )
    begun = evaluate(problem, problem.start, layout.guesses(problem.start))
    assert begun is not None
    theta = problem.start * 1.02
    whole, bare = (
        evaluate(each, theta, predicted_trajectories(begun, theta))
        for each in (problem, without_sensitivities(problem))
    )
    assert whole is not None and bare is not None
    assert bare.cost == pytest.approx(whole.cost, rel=1e-14)
    assert all(jacobian.shape[2] == 0 for jacobian in bare.jacobians)


def undamped_step_in_sigmas(fit: Fit) -> float:
    """Length of the Gauss-Newton step in its own sigmas, from the residuals and sensitivities, by
    QR.
    """
    record, line = fit.layout.problems[0], fit.linearisations[0]
    sigma = np.sqrt(np.mean((record.z - line.y) ** 2, axis=1))[:, None]
    J, e = (
        (line.jacobian / sigma[:, :, None]).reshape(-1, len(fit.theta)),
        ((record.z - line.y) / sigma).ravel(),
    )
    return float(np.linalg.norm(np.linalg.qr(J)[0].T @ e))


def test_a_rough_fit_that_has_converged_is_not_sigmas_short_of_the_optimum() -> None:
    rough, exact = unstable_fit(ROUGH), unstable_fit(replace(ROUGH, tolerance=1e-4, enough=0.0))
    assert exact.outcome is Outcome.CONVERGED and undamped_step_in_sigmas(exact) < 1e-3
    assert rough.outcome is Outcome.CONVERGED and undamped_step_in_sigmas(rough) < np.sqrt(
        2.0 * ROUGH.enough
    )
    assert rough.cost - exact.cost < ROUGH.enough


def test_a_fit_that_ran_out_of_iterations_says_so() -> None:
    fit = unstable_fit(replace(ROUGH, iterations=4))
    assert fit.outcome is Outcome.MAX_ITERATIONS and undamped_step_in_sigmas(fit) > 3.0


@pytest.mark.parametrize("unit", [1e-8, 3.3516e7, 1e12])
def test_the_unit_of_an_output_does_not_enter(unit: float) -> None:
    """The cost is shifted by N ln(unit), to nearly zero and to either side."""
    one, other = unstable_fit(ROUGH), unstable_fit(ROUGH, unit)
    assert other.outcome is one.outcome and other.iterations == one.iterations
    np.testing.assert_allclose(other.theta, one.theta, rtol=1e-6)  # a sigma is a hundredth or so
    assert other.cost - one.cost == pytest.approx(float(one.counts[2]) * np.log(unit), rel=1e-9)


def one_unknown(step: float) -> LocalModel:
    """A quadratic whose optimum lies ``step`` sigmas away."""
    return LocalModel(np.ones(1), np.ones((1, 1)), np.array([step]), np.array([True]))


@pytest.mark.parametrize(
    ("tolerance", "enough", "limit"),
    [(1e-3, 0.0, np.sqrt(0.002)), (0.1, 0.0, 0.1), (0.1, 0.2, np.sqrt(0.4)), (1.0, 0.2, 1.0)],
)
def test_it_has_arrived_where_the_undamped_step_is_shorter_than_the_tolerance_or_promises_less_than_is_enough(  # noqa: E501
    tolerance: float, enough: float, limit: float
) -> None:
    settings = FitSettings(tolerance=tolerance, enough=enough)
    assert has_converged(one_unknown(0.99 * limit), np.zeros(1), settings)
    assert not has_converged(one_unknown(1.01 * limit), np.zeros(1), settings)


def test_a_step_within_the_rounding_of_an_unknown_is_none() -> None:
    settings = FitSettings()
    assert not has_converged(one_unknown(0.5), np.array([1e9]), settings)
    assert has_converged(one_unknown(0.5), np.array([1e11]), settings)


def test_a_promise_does_not_depend_on_how_unknowns_are_combined() -> None:
    """Half of g' I^-1 g, also where two unknowns act nearly alike and each step alone is long in
    conditional sigmas.
    """
    information, gradient = np.array([[1e4, 99.9], [99.9, 1.0]]), np.array([30.0, -0.4])
    model = local_model(information, gradient, np.zeros(2), np.full(2, -np.inf), np.full(2, np.inf))
    assert model.predicted_gain == pytest.approx(
        0.5 * gradient @ np.linalg.inv(information) @ gradient, rel=1e-6
    )
    pressed = local_model(
        information, gradient, np.zeros(2), np.array([-np.inf, 0.0]), np.full(2, np.inf)
    )
    assert pressed.movable.tolist() == [True, False] and pressed.predicted_gain == pytest.approx(
        0.5 * 30.0**2 / 1e4, rel=1e-6
    )
    released = local_model(
        information,
        np.array([30.0, 0.4]),
        np.zeros(2),
        np.array([-np.inf, 0.0]),
        np.full(2, np.inf),
    )
    assert released.movable.all()


def test_damping_goes_as_far_as_a_step_needs_it() -> None:
    """Outputs p^9 from p = 0.2: the undamped step is a million times too long."""
    rng, time = np.random.default_rng(5), np.arange(60) * 0.05
    initial = ParameterSet(
        (Parameter("position", 0.0, "m", free=False), Parameter("speed", 0.0, "m/s", free=False))
    )
    model = oscillator().with_initial(initial).with_values({"force": 0.2})
    system = compile_model(model)
    at = system.parameters.index("force")
    system = replace(system, h=lambda t, x, u, p: [p[at] ** 9 + 0.0 * x[0], 0.0 * x[0], 0.0 * x[0]])
    blank = record_of(rng, 60)
    record = Record(
        time, blank.inputs, (Channel.of("place", "m", 1.0 + 0.01 * rng.standard_normal(60)),)
    )
    fit = fit_whole_records(FitProblem(lay_out([record], system, FitSettings(max_step=0.05))))
    assert fit is not None and fit.outcome is Outcome.CONVERGED
    assert fit.theta[0] ** 9 == pytest.approx(np.mean(record["place"].values), rel=1e-6)


def test_steps_follow_the_floor_of_a_curved_valley(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rosenbrock's valley: outputs a and 300 (b - a^2) from a = -1.5; straight steps creep."""
    rng, time = np.random.default_rng(6), np.arange(60) * 0.05
    initial = ParameterSet(
        (Parameter("position", 0.0, "m", free=False), Parameter("speed", 0.0, "m/s", free=False))
    )
    parameters = ParameterSet(
        (
            Parameter("stiffness", 3.0, "1/s2", free=False),
            Parameter("damping", -1.5, "1/s"),
            Parameter("force", 2.25, "m/s2"),
        )
    )
    model = replace(oscillator(), parameters=parameters, biases=()).with_initial(initial)
    system = compile_model(model)
    a, b = (system.parameters.index(name) for name in ("damping", "force"))
    system = replace(
        system,
        h=lambda t, x, u, p: [p[a] + 0.0 * x[0], 300.0 * (p[b] - p[a] ** 2), 0.0 * x[0]],
    )
    outputs = (
        Channel.of("place", "m", 1.0 + 0.3 * rng.standard_normal(60)),
        Channel.of("mixed", "m", 0.3 * rng.standard_normal(60)),
    )
    record = Record(time, record_of(rng, 60).inputs, outputs)
    problem = FitProblem(lay_out([record], system, FitSettings(max_step=0.05, iterations=300)))
    curved = fit_whole_records(problem)
    monkeypatch.setattr(gauss_newton, "_CURVED_STEP_SHARES", (0.0,))
    straight = fit_whole_records(problem)
    assert curved is not None and straight is not None
    least = np.mean(record["place"].values)
    assert curved.outcome is Outcome.CONVERGED
    assert curved.theta[0] == pytest.approx(least, rel=1e-4)
    assert curved.iterations < 0.5 * straight.iterations


def test_the_trajectory_obeys_the_equations_however_loose_the_tolerance() -> None:
    """The last step leaves a gap of second order between the intervals, which is squared away."""
    system = compile_model(ballistic_model().with_values({"beta": 1600.0}))
    record = ballistic_record(np.random.default_rng(2))
    fit = fit_whole_records(
        FitProblem(lay_out([record], system, FitSettings(max_step=0.1, tolerance=30.0)))
    )
    assert fit is not None and fit.outcome is Outcome.CONVERGED
    p, x0 = fit.layout.split(fit.theta, 0)
    grid = make_grid(record.time, 0.1)
    drive = drive_from_record(
        system, p.tolist(), record.input_array(system.input_names), record.time, record.hold, grid
    )
    expected = np.array(simulate(system, p.tolist(), x0.tolist(), drive, grid))
    np.testing.assert_allclose(fit.linearisations[0].y, expected, rtol=1e-11)


class Endless(White):
    """White noise whose likelihood has a gradient that is no number."""

    def covariance_terms(
        self, layout: Any, theta: np.ndarray, lines: Any, weighted: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        return np.full(len(theta), np.nan), np.zeros((len(theta), len(theta)))


def test_a_start_without_a_finite_gradient_is_no_start() -> None:
    record = rigid_record(np.random.default_rng(1), 6.0, 25.0)
    layout = lay_out([record], compile_model(rigid_model()), FitSettings())
    assert fit_whole_records(FitProblem(layout)) is not None
    assert fit_whole_records(FitProblem(layout, Endless())) is None
