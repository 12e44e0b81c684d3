"""The whole-record Gauss-Newton fit: what its outcome promises, and that units do not enter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ident.estimate import Outcome
from ident.whole_record.fit_problem import FitProblem
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitSettings, lay_out
from sim.declaration.compile import compile_model
from sim.record import Channel, Record
from tests.bases import rigid_model
from tests.rigid_problem import FREE, UNSTABLE, rigid_record

FACTORS = (0.5, 0.5, 1.1, 0.7, 1.9, 0.5)  # a start from which trial steps are refused until damping has made them tiny
ROUGH = FitSettings(max_step=0.04, tolerance=0.03, enough=0.2)


def unstable_fit(settings: FitSettings, unit: float = 1.0) -> Fit:
    """Of an unstable aircraft; the load factor, which is no state, in units of ``1 / unit`` g."""
    record = rigid_record(np.random.default_rng(1), 6.0, 25.0, UNSTABLE)
    model = rigid_model(UNSTABLE).with_values({name: UNSTABLE[name] * x for name, x in zip(FREE, FACTORS, strict=True)})
    system = compile_model(model)
    h = system.h
    assert system.output_names == ("alpha", "q", "nz")

    def outputs(t: Any, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        alpha, q, nz = h(t, x, u, p)
        return [alpha, q, unit * nz]

    channels = tuple(Channel.of(name, "1", (unit if name == "nz" else 1.0) * record[name].values) for name in system.output_names)
    fit = fit_whole_records(FitProblem(lay_out([Record(record.time, record.inputs, channels, record.hold)], replace(system, h=outputs), settings)))
    assert fit is not None
    return fit


def undamped_step_in_sigmas(fit: Fit) -> float:
    """Length of the Gauss-Newton step in its own sigmas, from the residuals and sensitivities, by QR."""
    record, line = fit.layout.problems[0], fit.lines[0]
    sigma = np.sqrt(np.mean((record.z - line.y) ** 2, axis=1))[:, None]
    J, e = (line.jacobian / sigma[:, :, None]).reshape(-1, len(fit.theta)), ((record.z - line.y) / sigma).ravel()
    return float(np.linalg.norm(np.linalg.qr(J)[0].T @ e))


def test_a_rough_fit_that_has_converged_is_not_sigmas_short_of_the_optimum() -> None:
    rough, exact = unstable_fit(ROUGH), unstable_fit(replace(ROUGH, tolerance=1e-4, enough=0.0))
    assert exact.outcome is Outcome.CONVERGED and undamped_step_in_sigmas(exact) < 1e-3
    assert rough.outcome is Outcome.CONVERGED and undamped_step_in_sigmas(rough) < np.sqrt(2.0 * ROUGH.enough)
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
