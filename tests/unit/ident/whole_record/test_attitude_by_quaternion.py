"""A loop through the vertical is fitted where the attitude is a quaternion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.estimate import Outcome
from ident.whole_record.layout import FitSettings, lay_out
from ident.whole_record.output_error import fit_output_error
from sim.declaration.compile import compile_model
from sim.record import Channel, Hold, Record
from sim.vehicles.aircraft import aircraft_model
from sim.vehicles.attitude import ATTITUDES, QUATERNION
from tests.airliner import AIRLINER, ELEVATOR
from tests.bases import Flight, fly

NOISE = {
    **{"airspeed": 0.2, "ax": 0.02, "ay": 0.02, "az": 0.05},
    **dict.fromkeys(("alpha", "beta", "p", "q", "r", "theta"), 0.002),
}
START = {"airspeed": 260.0, "alpha": 0.02, "theta": 0.1, "phi": 0.2}


def loop() -> tuple[Record, dict[str, np.ndarray]]:
    """Record of 18 s with theta but neither phi nor psi, which jump; outputs without noise."""
    system = compile_model(
        aircraft_model(replace(AIRLINER, attitude=QUATERNION, start=START, biases=()))
    )
    time = np.arange(0.0, 18.01, 0.04)
    elevator = ELEVATOR - 0.13 * np.clip(time - 1.0, 0.0, 1.0) * (time < 16.0)
    u = np.array(
        [
            elevator + 0.01 * np.sign(np.sin(2.0 * time)),
            0.02 * np.sign(np.sin(1.3 * time)),
            0.02 * np.sign(np.sin(0.9 * time + 1.0)),
            np.full(len(time), 80e3),
        ]
    )
    rows = dict(zip(system.output_names, fly(system, Flight(time, u, max_step=0.02)), strict=True))
    rng, units = np.random.default_rng(2), {each.name: each.unit for each in system.outputs}
    outputs = tuple(
        Channel.of(name, units[name], rows[name] + std * rng.standard_normal(len(time)))
        for name, std in NOISE.items()
    )
    inputs = tuple(Channel.of(n.name, n.unit, row) for n, row in zip(system.inputs, u, strict=True))
    return Record(time, inputs, outputs, Hold.PREVIOUS, "loop"), rows


def test_derivatives_of_a_loop_are_found() -> None:
    record, rows = loop()
    assert np.max(np.abs(rows["phi"])) > 3.0 and np.max(rows["theta"]) > 1.2
    # Another attitude at the start than the true one, wrong derivatives.
    model = aircraft_model(
        replace(AIRLINER, attitude=QUATERNION, start={**START, "phi": 0.0}, biases=())
    )
    true = {item.name: item.value for item in model.parameters}
    wrong = model.with_values({"Cm_alpha": -0.9, "Cm_q": -17.0, "Cl_p": -0.45, "CL_alpha": 4.9})
    found = fit_output_error(
        [record], compile_model(wrong, list(NOISE)), FitSettings(max_step=0.04)
    )
    assert found.outcome is Outcome.CONVERGED
    sigma = np.sqrt(np.diag(found.covariance))
    off = [abs(v - true[n]) / s for n, v, s in zip(found.names, found.values, sigma, strict=True)]
    assert max(off) < 3.5 and np.mean(np.array(off) < 2.0) > 0.85


@pytest.mark.parametrize("psi", [-3.0, 0.4, 2.8])
def test_a_fit_begins_at_the_recorded_attitude(psi: float) -> None:
    phi, theta = 0.7, -0.4
    turned = replace(
        AIRLINER, attitude=QUATERNION, further=("psi",), start={"airspeed": 130.0}, sensors={}
    )
    system = compile_model(aircraft_model(turned))
    values = {"airspeed": 130.0, "phi": phi, "theta": theta, "psi": psi}
    outputs = tuple(
        Channel.of(each.name, each.unit, np.full(50, values.get(each.name, 0.0)))
        for each in system.outputs
    )
    inputs = tuple(Channel.of(each.name, each.unit, np.zeros(50)) for each in system.inputs)
    record = Record(0.04 * np.arange(50), inputs, outputs, Hold.PREVIOUS, "still")
    layout = lay_out([record], system, FitSettings())
    begun = {
        name: layout.start[layout.names.index(f"{name}(0)")] for name in ("e1", "e2", "psi_start")
    }
    assert "e0(0)" not in layout.names and "e3(0)" not in layout.names
    expected = ATTITUDES[QUATERNION].at_start(phi, theta, psi)
    # The quaternion of the start is held at e0 = 1: any length says the same.
    assert begun["e1"] == pytest.approx(expected["e1"] / expected["e0"], abs=1e-9)
    assert begun["e2"] == pytest.approx(expected["e2"] / expected["e0"], abs=1e-9)
    assert np.sin(begun["psi_start"] - expected["psi_start"]) == pytest.approx(0.0, abs=1e-9)
