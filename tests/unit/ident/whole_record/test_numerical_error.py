"""Records without noise: sigmas hold the errors of integration and sampling, and noise is left as
it was.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ident.estimate import Estimate, Outcome
from ident.regression.equation_error import run_equation_error
from ident.whole_record.layout import FitSettings
from ident.whole_record.numerical_errors import with_sampling_error
from ident.whole_record.output_error import fit_output_error
from sim.declaration import own_model
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, System
from sim.record import Channel, Record
from tests.bases import (
    Flight,
    base_for,
    lateral_flight,
    longitudinal_flight,
    rigid_flight,
    three_two_one_one,
)

TRUE = {"k": 4.0, "c": 0.5, "b": 0.3}
FLIGHTS = {
    "rigid": rigid_flight(8.0),
    "lateral": lateral_flight(8.0),
    "longitudinal": longitudinal_flight(8.0),
}


def spring() -> tuple[Model, Flight]:
    """A mass on a hardening spring."""
    model = own_model(
        name="spring",
        states={"x": "m", "v": "m/s"},
        inputs={"force": "N"},
        outputs={"x": "m", "v": "m/s"},
        parameters={"k": (4.0, "1/s2"), "c": (0.5, "1/s"), "b": (0.3, "1/(m2 s2)")},
        rates=lambda s, p: {"x": s.v, "v": s.force - p.c * s.v - p.k * s.x - p.b * s.x * s.x * s.x},
        readings=lambda s, p: {"x": s.x, "v": s.v},
    )
    time = np.arange(601) / 50.0
    return model, Flight(time, three_two_one_one(time, size=1.5)[None])


def flown(kind: str, noise: float = 0.0) -> tuple[Record, System, np.ndarray]:
    """A record by SciPy's DOP853 at 1e-12, the system started 20 % off, and the true values of its
    free parameters.
    """
    model, flight = spring() if kind == "own" else (base_for(kind)[0], FLIGHTS[kind])
    system = compile_model(model.with_biases([signal.name for signal in model.equations.outputs]))
    p = system.parameters.values().tolist()
    rows = [np.array(system.initial.values(), dtype=float)]
    for at in range(len(flight.time) - 1):
        span, u = (flight.time[at], flight.time[at + 1]), flight.u[:, at].tolist()
        rows.append(
            solve_ivp(
                lambda t, x, u=u: system.f(t, x, u, p),
                span,
                rows[-1],
                method="DOP853",
                rtol=1e-12,
                atol=1e-14,
            ).y[:, -1]
        )
    x = np.array(rows).T
    y = system.h(flight.time, list(x), list(flight.u), p)
    rng = np.random.default_rng(3)
    outputs = []
    for signal, row in zip(system.outputs, y, strict=True):
        values = np.broadcast_to(row, flight.time.shape)
        outputs.append(
            Channel.of(
                signal.name,
                signal.unit,
                values + noise * np.std(values) * rng.standard_normal(len(values)),
            )
        )
    inputs = tuple(
        Channel.of(signal.name, signal.unit, row)
        for signal, row in zip(system.inputs, flight.u, strict=True)
    )
    record = Record(flight.time, inputs, tuple(outputs), flight.hold, kind)
    free = [name for name in system.parameters.free_names if not name.startswith("bias_")]
    true = np.array([system.parameters[name].value for name in free])
    started = replace(
        system,
        parameters=system.parameters.with_values(
            {name: 0.8 * value for name, value in zip(free, true, strict=True)}
        ),
    )
    return record, started, true


def away(estimate: Estimate, true: np.ndarray) -> np.ndarray:
    return np.abs(estimate.values - true) / estimate.std


@pytest.mark.long
@pytest.mark.parametrize("kind", ["rigid", "lateral", "longitudinal", "own"])
def test_without_noise_an_output_error_estimate_has_the_sigma_of_its_integration(kind: str) -> None:
    record, system, true = flown(kind)
    found = fit_output_error([record], system)
    # The equations of totals do not settle to a thousandth of sigmas that are rounding; what is
    # left is below the sigmas reported.
    assert found.outcome is (
        Outcome.MAX_ITERATIONS if kind == "longitudinal" else Outcome.CONVERGED
    )
    assert np.max(away(found, true)) < 3.0 and np.max(away(found, true)) > 0.1
    assert np.all(found.std < 1e-4 * np.maximum(np.abs(true), 1e-2))
    assert "the integration leaves larger errors than the noise of the record" in found.message


@pytest.mark.long
@pytest.mark.parametrize("kind", ["rigid", "lateral", "longitudinal", "own"])
def test_without_noise_an_equation_error_estimate_has_the_sigma_of_its_sampling(kind: str) -> None:
    record, system, true = flown(kind)
    plain = run_equation_error([record], system)
    found = with_sampling_error(plain, [record], system, FitSettings())
    assert found.outcome is Outcome.CONVERGED and np.array_equal(found.values, plain.values)
    assert np.max(away(plain, true)) > 3.0  # otherwise there is nothing to correct
    assert np.max(away(found, true)) < 3.0
    assert "slopes of samples leave larger errors than the noise of the record" in found.message


@pytest.mark.long
@pytest.mark.parametrize("kind", ["rigid", "own"])
def test_noise_leaves_estimates_as_they_are(kind: str) -> None:
    record, system, _ = flown(kind, noise=0.02)
    found = fit_output_error([record], system)
    assert found.outcome is Outcome.CONVERGED and not found.message
    plain = run_equation_error([record], system)
    assert with_sampling_error(plain, [record], system, FitSettings()) is plain


@pytest.mark.long
def test_noise_just_below_the_bound_changes_no_sigma() -> None:
    record, system, true = flown("rigid", noise=5e-4)
    found = fit_output_error([record], system)
    bare = fit_output_error([record], system, FitSettings(max_step=0.0025))
    assert np.allclose(found.std, bare.std, rtol=1e-3) and not found.message
    assert np.max(away(found, true)) < 4.0
