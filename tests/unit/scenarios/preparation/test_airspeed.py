"""Measured speed and pressure in the equations: against an independent simulation, and what is done
to the signals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.whole_record.output_error import fit_output_error
from scenarios.diagnosis.opening import candidates_for
from scenarios.preparation.measured_inputs import (
    flow_doubts,
    flow_sentence,
    measured_flow,
    usable_flow_channels,
    with_flow,
)
from scenarios.preparation.plausibility import hold_out
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.errors import RecordError
from sim.record import Channel, Hold, Record
from sim.vehicles.factory import model_from_constants
from tests.oracles.falling_speed import CONSTANTS, TRUE, fly_falling
from tests.preparing import OUTPUTS, declared, record_of

LOES = dict(
    L_alpha=-0.9,
    M_alpha=-4.0,
    L_delta=-0.05,
    M_delta=2.0,
    L_q=1.0,
    M_q=-1.5,
    inv_tau=10.0,
    delay=0.05,
)


def errors(model: Model, record: Record) -> dict[str, float]:
    """Relative errors of the derivatives."""
    estimate = fit_output_error([record], compile_model(model.with_biases(OUTPUTS), OUTPUTS))
    return {name: estimate.value(name) / value - 1.0 for name, value in TRUE.items()}


@pytest.mark.sampled
@pytest.mark.parametrize("weight", [True, False])
@pytest.mark.parametrize(
    "measured", [("airspeed",), ("dynamic_pressure",), ("airspeed", "dynamic_pressure")]
)
def test_derivatives_of_a_flight_that_loses_a_tenth_of_its_speed(
    weight: bool, measured: tuple[str, ...]
) -> None:
    # the air grows thinner where both are there to tell
    climb = 0.05 if len(measured) == 2 else 0.0
    record = record_of(fly_falling(weight=weight, climb=climb), outputs=(*OUTPUTS, *measured))
    model, (ready,) = with_flow(declared(), [record], trim_lift=weight)
    found = errors(model, ready)
    # Without noise what is left is the path's angle and the smoothing at the ends.
    assert all(abs(found[name]) < 2e-3 for name in ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de")), found
    assert all(abs(found[name]) < 3e-2 for name in ("CL_q", "CL_de")), found
    constant = errors(declared(), record.only(OUTPUTS))
    assert abs(constant["Cm_alpha"]) > 0.03 and abs(constant["CL_alpha"]) > 0.05


def test_a_speed_that_stays_is_the_plain_model_to_rounding() -> None:
    record = record_of(
        fly_falling(weight=False, fall=0.0, duration=6.0),
        outputs=(*OUTPUTS, "airspeed", "dynamic_pressure"),
    )
    model, (ready,) = with_flow(declared(), [record])
    assert [signal.name for signal in model.equations.inputs] == [
        "elevator",
        "airspeed_change",
        "density_change",
        "lift",
    ]
    for name in model.equations.inputs[1:]:
        assert np.max(np.abs(ready[name.name].values)) < 1e-12 * CONSTANTS["airspeed"]
    with_it, without = errors(model, ready), errors(declared(), record.only(OUTPUTS))
    assert all(with_it[name] == pytest.approx(without[name], abs=1e-9) for name in TRUE)


def test_a_record_without_a_speed_leaves_model_and_record_alone() -> None:
    model, record = declared(), record_of(fly_falling(weight=False, duration=2.0))
    assert with_flow(model, [record]) == (model, [record]) and flow_sentence(record, model) == ""


def test_a_record_without_beside_one_with_flies_at_the_declared_speed() -> None:
    flown = fly_falling(weight=True, duration=4.0)
    _, (first, second) = with_flow(
        declared(), [record_of(flown, outputs=(*OUTPUTS, "airspeed")), record_of(flown)]
    )
    assert first.input_names == second.input_names == ("elevator", "airspeed_change", "lift")
    assert np.all(second["airspeed_change"].values == 0.0) and np.all(second["lift"].values == 0.0)
    assert first.output_names == second.output_names == OUTPUTS


def test_the_trim_lift_balances_the_weight() -> None:
    """In nz it is the pressure over the one at the beginning, less one: m g0 over S and the
    pressure, in coefficients.
    """
    flown = fly_falling(weight=True)
    model, (ready,) = with_flow(declared(), [record_of(flown, outputs=(*OUTPUTS, "airspeed"))])
    pressure = 0.5 * CONSTANTS["air_density"] * flown.airspeed**2
    nz = ready["lift"].values * pressure * CONSTANTS["wing_area"] / (CONSTANTS["mass"] * 9.80665)
    beginning = np.mean(pressure[flown.time < 0.5])
    np.testing.assert_allclose(nz[60:-60], (pressure / beginning - 1.0)[60:-60], atol=1e-4)
    assert model.parameters.free_names == declared().parameters.free_names


def test_the_low_order_system_takes_the_speed_and_leaves_the_pressure() -> None:
    model = model_from_constants("loes", {"airspeed": 130.0, "gravity": 9.81}, LOES)
    time = np.arange(200) / 20.0
    speed = 130.0 - time
    stick, q = Channel.of("stick", "1", np.zeros(200)), Channel.of("q", "rad/s", np.zeros(200))
    record = Record(
        time,
        (stick,),
        (
            q,
            Channel.of("airspeed", "m/s", speed),
            Channel.of("dynamic_pressure", "Pa", 0.5 * speed**2),
        ),
        Hold.LINEAR,
    )
    assert usable_flow_channels(model) == ("airspeed",)
    _, (ready,) = with_flow(model, [record])
    assert ready.input_names == ("stick", "airspeed_change", "lift") and ready.output_names == (
        "q",
    )
    # lift is a rate of alpha there: less of it, -g/V times the lost share of the weight.
    np.testing.assert_allclose(
        ready["lift"].values[40:-40],
        (-9.81 / speed * ((speed / speed[:10].mean()) ** 2 - 1.0))[40:-40],
        rtol=1e-3,
    )
    assert (
        usable_flow_channels(
            model_from_constants(
                "ballistic",
                dict(air_density_reference=1.2, density_scale_height=7000.0, gravity=9.8),
                dict(beta=2000.0),
            )
        )
        == ()
    )


def test_spikes_gaps_and_noise_of_the_speed_are_taken_out_and_its_ends_stay() -> None:
    flown = fly_falling(weight=True, duration=10.0)
    rng = np.random.default_rng(3)
    speed = flown.airspeed + 0.5 * rng.standard_normal(len(flown.time))
    speed[[100, 250, 251]] += 40.0
    speed[300:330] = np.nan
    record = replace(
        record_of(flown), outputs=(*record_of(flown).outputs, Channel.of("airspeed", "m/s", speed))
    )
    flow = measured_flow(record, declared())
    assert flow is not None and flow.density is None
    assert (
        np.max(np.abs(flow.speed - flown.airspeed)) < 0.6
        and np.std(flow.speed - flown.airspeed) < 0.2
    )
    clean = measured_flow(record_of(flown, outputs=("airspeed",)), declared())
    # a straight line stays one
    assert clean is not None and np.max(np.abs(clean.speed - flown.airspeed)) < 1e-9


def test_held_inputs_carry_the_mean_of_each_interval() -> None:
    flown = fly_falling(weight=True, duration=4.0)
    _, (linear,) = with_flow(declared(), [record_of(flown, Hold.LINEAR, (*OUTPUTS, "airspeed"))])
    _, (held,) = with_flow(declared(), [record_of(flown, Hold.PREVIOUS, (*OUTPUTS, "airspeed"))])
    lines = linear["airspeed_change"].values
    np.testing.assert_allclose(
        held["airspeed_change"].values[:-1], 0.5 * (lines[:-1] + lines[1:]), rtol=1e-12
    )


def test_a_speed_that_is_none_is_refused_and_one_far_off_is_told() -> None:
    flown = fly_falling(weight=True, duration=4.0)
    record = record_of(flown, outputs=("airspeed", "dynamic_pressure"))
    slow = replace(
        record,
        outputs=(Channel.of("airspeed", "m/s", flown.airspeed - 200.0), record.outputs[1]),
        name="slow.csv",
    )
    with pytest.raises(
        RecordError,
        match=(
            r"slow\.csv, channel airspeed: airspeed is not above zero at 0 s; leave the column out"
        ),
    ):
        with_flow(declared(), [slow])
    indicated = replace(
        record, outputs=(Channel.of("airspeed", "m/s", 0.8 * flown.airspeed), record.outputs[1])
    )
    slower, denser = flow_doubts([record, replace(indicated, name="indicated.csv")], declared())
    assert (
        slower.startswith("indicated.csv: the measured airspeed, ")
        and "at that speed; mend airspeed there, or" in slower
    )
    assert "1.5 kg/m3, is far from 0.96 kg/m3" in denser and "mend air_density there" in denser
    assert not flow_doubts([record], declared()) and not flow_doubts([record.only(())], declared())
    heavy = replace(
        record, outputs=(Channel.of("dynamic_pressure", "Pa", 1.5 * flown.dynamic_pressure),)
    )
    assert (
        "mend airspeed or air_density there, or check the unit of the dynamic pressure"
        in flow_doubts([heavy], declared())[0]
    )


def test_a_measured_speed_is_no_candidate_and_no_excitation() -> None:
    flown = fly_falling(weight=True)
    model, (ready,) = with_flow(declared(), [record_of(flown, outputs=(*OUTPUTS, "airspeed"))])
    names = {effect.name for effect in candidates_for(model)}
    assert {effect.name for effect in candidates_for(declared())} - names == {"speed-variation"}
    plain = record_of(flown)
    assert [len(part) for part in hold_out(ready)] == [len(part) for part in hold_out(plain)]
