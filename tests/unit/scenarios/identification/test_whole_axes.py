"""Lateral and longitudinal records identified from starts that are 20 to 30 % wrong, by every
method.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.estimate import Outcome
from scenarios.identification.assessment import IdentificationResult
from scenarios.identification.identify import identify
from scenarios.identification.methods import METHODS
from sim.record import Record
from tests.whole_axes import CONSTANTS, NOISE, TRUE, flown, true_model, vehicle_file

SERVES = [
    (model, method)
    for model in TRUE
    for method in METHODS
    if (model, method) != ("longitudinal", "frequency-domain")
]
OFFSETS = {
    "lateral": {"beta": 0.02, "p": -0.01, "phi": 0.03, "ny": 0.02},
    "longitudinal": {"q": 0.01, "nz": -0.03, "nx": 0.02},
}


DEAR = (
    ("longitudinal", "filter-error"),
    ("longitudinal", "ukf"),
    ("longitudinal", "equation-error"),
    ("lateral", "ukf"),
    ("lateral", "filter-error"),
)  # seconds each


def sigmas_off(found: IdentificationResult) -> dict[str, float]:
    """How far the derivatives are from the truth, in their own sigmas."""
    true = TRUE[found.vehicle.model]
    return {
        row.name: (row.estimate - true[row.name]) / row.std
        for row in found.rows
        if row.name in true
    }


def without(record: Record, *names: str) -> Record:
    return Record(
        record.time,
        record.inputs,
        tuple(c for c in record.outputs if c.name not in names),
        record.hold,
        record.name,
    )


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("model", "method"),
    [pytest.param(*each, marks=pytest.mark.slow if each in DEAR else ()) for each in SERVES],
)
def test_every_method_finds_the_derivatives(model: str, method: str) -> None:
    rng = np.random.default_rng(7)
    wrong = {name: 1.0 + float(rng.choice([-0.3, -0.2, 0.2, 0.3])) for name in TRUE[model]}
    found = identify(flown(model), vehicle_file(model, wrong), method)
    assert found.estimate.outcome is Outcome.CONVERGED and not found.cautions
    off = sigmas_off(found)
    assert set(off) == set(TRUE[model]) and max(map(abs, off.values())) < 3.5, off
    noise = dict(zip(found.estimate.output_names, found.estimate.noise_std, strict=True))
    # which leaves what smoothing leaves
    for name, std in NOISE[model].items() if method != "equation-error" else ():
        assert noise[name] == pytest.approx(std, rel=0.15)


@pytest.mark.parametrize("model", list(TRUE))
def test_a_constant_error_of_a_sensor_is_no_derivative(model: str) -> None:
    found = identify(flown(model, 1, OFFSETS[model]), vehicle_file(model, 0.75), "output-error")
    assert (
        found.estimate.outcome is Outcome.CONVERGED
        and max(map(abs, sigmas_off(found).values())) < 3.5
    )


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("model", "absent"),
    [
        ("lateral", ("beta", "ny")),
        ("longitudinal", ("airspeed", "theta")),
        ("longitudinal", ("alpha",)),
    ],
)
def test_outputs_may_be_absent(model: str, absent: tuple[str, ...]) -> None:
    """An airspeed that is not measured starts at the reference one."""
    found = identify(without(flown(model, 2), *absent), vehicle_file(model, 1.2), "output-error")
    assert (
        found.estimate.outcome is Outcome.CONVERGED
        and max(map(abs, sigmas_off(found).values())) < 3.5
    )


def test_a_derivative_that_is_left_out_is_held_at_zero() -> None:
    found = identify(flown("lateral"), vehicle_file("lateral", 1.2), "output-error")
    assert found.fixed["CY_p"] == (0.0, "1/rad") and found.fixed["span"] == (
        CONSTANTS["lateral"]["span"],
        "m",
    )
    assert "CY_p" not in found.estimate.names


@pytest.mark.parametrize("model", list(TRUE))
def test_the_modes_are_those_of_the_true_aircraft(model: str) -> None:
    from ident.flying_qualities.modes import MODAL_UNITS, lateral_modes, longitudinal_modes
    from sim.declaration.compile import compile_model

    system = compile_model(true_model(model))
    true = (lateral_modes if model == "lateral" else longitudinal_modes)(
        system, system.parameters.values()
    )
    found = identify(flown(model, 3), vehicle_file(model, 0.8), "output-error").derived
    assert set(found) == set(true) <= set(MODAL_UNITS) and len(true) == 4
    for name, (value, std) in found.items():
        assert abs(value - true[name]) < 3.5 * std
