"""The pre-whitener against a Kalman filter written a second time, and its slopes against
differences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from ident.process_noise.innovations_model import process_noise
from ident.process_noise.linear_noise import Variation, discretise, discretised_noise
from ident.process_noise.whitener import Whitener, filtered, whitener
from ident.whole_record.gauss_newton import evaluate
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.record_problem import RecordProblem, record_problem
from sim.declaration.compile import compile_model
from sim.record import Channel, Record
from tests.linear_problem import matrices, oscillator, record_of
from tests.oracles.kalman import exponential
from tests.oracles.kalman import process_noise as noise_integral
from tests.turbulence import NOISE, rough_model, rough_record

DENSITY = {"speed": 0.4, "position": 0.01}
VARIANCE = np.square([0.05, 0.08, 0.1])
RECORDS = {
    "even": lambda rng: record_of(rng, 80),
    "long": lambda rng: record_of(rng, 500),
    "uneven": lambda rng: record_of(rng, 80, uneven=True),
    "holes": lambda rng: record_of(rng, 80, missing=True),
    "all": lambda rng: record_of(rng, 80, uneven=True, missing=True, absent=("mixed",)),
    "gap": lambda rng: without_rows(record_of(rng, 80), slice(30, 42)),
}


def without_rows(record: Record, rows: slice) -> Record:
    keep = np.ones(len(record), dtype=bool)
    keep[rows] = False

    def cut(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
        return tuple(Channel.of(c.name, c.unit, c.with_gaps()[keep]) for c in channels)

    return Record(record.time[keep], cut(record.inputs), cut(record.outputs), record.hold)


def at_nodes(problem: RecordProblem, values: np.ndarray) -> np.ndarray:
    """``(m, N, c)`` of samples to nodes, where a gap has further ones."""
    out = np.zeros((len(problem.grid.nodes), len(values), values.shape[2]), dtype=values.dtype)
    out[problem.grid.sample // problem.grid.substeps] = values.transpose(1, 0, 2)
    return out


def at_samples(problem: RecordProblem, values: np.ndarray) -> np.ndarray:
    return values[problem.grid.sample // problem.grid.substeps]


def prepared(record: Record, density: dict[str, float] = DENSITY) -> tuple[RecordProblem, Whitener]:
    system = compile_model(oscillator(density))
    problem = record_problem(record, system, 0.05, (), ())
    motion = discretised_noise(
        problem, np.zeros((2, len(problem.grid.nodes))), Variation(system.parameters.values(), 1.0)
    )
    return problem, whitener(
        motion, VARIANCE, at_nodes(problem, problem.valid[:, :, None])[:, :, 0]
    )


@dataclass(frozen=True, eq=False)
class Plain:
    """Rows are samples."""

    innovation: np.ndarray
    nis: np.ndarray
    log_likelihood: np.ndarray
    P: np.ndarray


def oracle(record: Record, e: np.ndarray, valid: np.ndarray) -> Plain:
    """Covariance form, sample by sample: position and speed from a start known exactly, driven by
    noise.
    """
    whole = matrices(DENSITY)
    A, Q, C, R = whole.A[:2, :2], whole.Q[:2, :2], whole.C[:, :2], whole.R
    N = len(record)
    out = Plain(np.zeros((N, 3)), np.zeros(N), np.zeros(N), np.zeros((N, 2, 2)))
    x, P = np.zeros(2), np.zeros((2, 2))
    for k in range(N):
        if k:
            dt = record.time[k] - record.time[k - 1]
            Phi = exponential(A * dt)
            x, P = Phi @ x, Phi @ P @ Phi.T + noise_integral(A, Q, dt, None)
        rows = np.flatnonzero(valid[:, k])
        if rows.size:
            y = e[rows, k] - C[rows] @ x
            S = C[rows] @ P @ C[rows].T + R[np.ix_(rows, rows)]
            K = P @ C[rows].T @ np.linalg.inv(S)
            x, P = x + K @ y, P - K @ S @ K.T
            out.innovation[k, rows] = y
            out.nis[k] = y @ np.linalg.solve(S, y)
            out.log_likelihood[k] = -0.5 * (out.nis[k] + np.log(np.linalg.det(2.0 * np.pi * S)))
        out.P[k] = P
    return out


@pytest.mark.sampled
@pytest.mark.parametrize("kind", RECORDS)
def test_innovations_and_likelihood_equal_a_covariance_filters(kind: str) -> None:
    rng = np.random.default_rng(3)
    record = RECORDS[kind](rng)
    problem, filter = prepared(record)
    e = rng.standard_normal(problem.z.shape)
    through = filtered(filter, at_nodes(problem, e[:, :, None]))
    second = oracle(record, e, problem.valid)
    assert at_samples(problem, through.innovation)[:, :, 0] == pytest.approx(
        second.innovation, abs=1e-10
    )
    standard = at_samples(problem, through.normalised)[:, :, 0]
    assert (standard**2).sum(axis=1) == pytest.approx(second.nis, rel=1e-10)
    total = -0.5 * (
        np.sum(standard**2) + filter.log_determinant + problem.valid.sum() * math.log(2.0 * math.pi)
    )
    assert total == pytest.approx(second.log_likelihood.sum(), rel=1e-10)
    covariance = filter.covariance[filter.entry][problem.grid.sample // problem.grid.substeps]
    assert covariance == pytest.approx(second.P, abs=1e-12)


def test_a_filter_that_settles_keeps_few_gains() -> None:
    _, filter = prepared(RECORDS["long"](np.random.default_rng(0)))
    assert len(filter.covariance) < 250 and filter.entry[-1] == len(filter.covariance) - 1


@pytest.mark.parametrize("kind", ["even", "all"])
def test_columns_pass_like_differences_of_residuals(kind: str) -> None:
    rng = np.random.default_rng(4)
    problem, filter = prepared(RECORDS[kind](rng))
    e, columns = (
        rng.standard_normal((*problem.z.shape, 1)),
        rng.standard_normal((*problem.z.shape, 5)),
    )
    base = filtered(filter, at_nodes(problem, e)).normalised
    moved = filtered(filter, at_nodes(problem, e + columns)).normalised
    assert filtered(filter, at_nodes(problem, columns)).normalised == pytest.approx(
        moved - base, abs=1e-10
    )


def test_without_forcing_residuals_are_only_divided_by_their_sigma() -> None:
    rng = np.random.default_rng(5)
    problem, filter = prepared(RECORDS["holes"](rng), {})
    e = rng.standard_normal(problem.z.shape)
    expected = np.where(problem.valid, e / np.sqrt(VARIANCE)[:, None], 0.0)
    through = filtered(filter, at_nodes(problem, e[:, :, None]))
    assert through.normalised[:, :, 0].transpose() == pytest.approx(expected, rel=1e-14)
    assert filter.log_determinant == pytest.approx(
        float(problem.valid.sum(axis=1) @ np.log(VARIANCE)), rel=1e-13
    )


@pytest.mark.parametrize("step", [0.004, 0.05, 1.3])
def test_transition_and_noise_of_a_step(step: float) -> None:
    A, Q = matrices(DENSITY).A[:2, :2], matrices(DENSITY).Q[:2, :2]
    Phi, noise = (M[0] for M in discretise(A[None], np.diag(Q), np.array([step])))
    assert Phi == pytest.approx(exponential(A * step), rel=1e-12, abs=1e-15)
    assert noise == pytest.approx(noise_integral(A, Q, step, None), rel=1e-10, abs=1e-18)


def test_gust_starts_from_its_stationary_spread() -> None:
    system = compile_model(rough_model())
    record = rough_record(np.random.default_rng(1), 60)
    problem = record_problem(record, system, 0.01, (), ())
    p = system.parameters.values()
    p[system.parameters.index("gust-turbulence.sigma")] = 1.7
    motion = discretised_noise(problem, np.zeros((4, 60)), Variation(p, 1.0))
    gust = [
        system.state_names.index(name) for name in system.state_names if name.startswith("gust")
    ]
    assert len(gust) == 2 and set(system.stationary) == {system.state_names[i] for i in gust}
    assert not np.any(motion.start[:2]) and not np.any(motion.start[:, :2])
    # As seen at the vane: a gust of the declared intensity, whatever its length.
    assert motion.H[0, 0] @ motion.start @ motion.H[0, 0] == pytest.approx(
        (1.7 / p[system.parameters.index("airspeed")]) ** 2, rel=1e-12
    )


def test_stationary_spread_stays_what_it_is() -> None:
    system = compile_model(rough_model())
    problem = record_problem(rough_record(np.random.default_rng(1), 60), system, 0.01, (), ())
    motion = discretised_noise(
        problem, np.zeros((4, 60)), Variation(system.parameters.values(), 1.0)
    )
    after = motion.Phi[0] @ motion.start @ motion.Phi[0].T + motion.Q[0]
    assert after[2:, 2:] == pytest.approx(motion.start[2:, 2:], rel=1e-12)


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ["even", "missing", "uneven"])
def test_gradient_of_the_likelihood_is_its_slope(kind: str) -> None:
    """All unknowns: derivatives through outputs, gains and covariances; intensity, length, noise
    levels.
    """
    record = rough_record(np.random.default_rng(2), 121, missing=0.1 if kind == "missing" else 0.0)
    if kind == "uneven":
        record = without_rows(record, slice(1, -1, 3))
    system = compile_model(rough_model())
    levels = dict(zip(system.output_names, 1.3 * NOISE, strict=True))
    layout = lay_out([record], system, FitSettings(0.01))
    problem = FitProblem(layout, process_noise(system, levels, system.output_names))
    first = evaluate(problem, problem.start, layout.guesses(layout.start))
    assert first is not None
    fit = evaluate(problem, problem.start, [first.linearisations[0].states])
    assert fit is not None
    information, gradient = fit.normal_equations()
    for i, scale in enumerate(1.0 / np.sqrt(np.diag(information))):
        costs = []
        for step in (-1e-3, 1e-3):
            theta = problem.start.copy()
            theta[i] += step * scale
            moved = evaluate(problem, theta, [fit.linearisations[0].states])
            assert moved is not None
            costs.append(moved.cost)
        assert gradient[i] * scale == pytest.approx(
            (costs[0] - costs[1]) / 2e-3, rel=1e-4, abs=1e-4
        ), problem.names[i]
