"""Laws of what the library offers to each kind of equations: names that are one effect's alone, and
nothing left out.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import fields, replace
from itertools import combinations

import pytest

from sim.declaration import own_model
from sim.declaration.effect import Effect, Signal, Station
from sim.declaration.model import Containing, Equations
from sim.declaration.proposal import FittedToRecord, SearchContext, Traceable
from sim.effects.dynamics.control_nonlinearity import (
    ControlNonlinearity,
    ControlUnevenness,
    ControlWeakening,
)
from sim.effects.library import catch_all_terms_for, effects_for
from sim.vehicles.other_vehicles import Ballistic
from sim.vehicles.uncoupled import ShortPeriod
from tests.offered import ALL_VEHICLES, WHOLE_AXES, stem

ON_INPUTS = {
    *("actuator-lag", "actuator-rate-limit", "actuator-saturation", "actuator-second-order"),
    *("input-backlash", "input-deadband", "input-delay", "input-recorded-late"),
}
BESIDE_A_LAG = {"actuator-rate-limit", "actuator-saturation", "input-backlash", "input-deadband"}
ON_OUTPUTS = {
    f"sensor-{what}"
    for what in ("curve", "delay", "drift", "hold", "lag", "scale", "spikes", "step")
}
# what the forms of one effect may differ in; a freer form comes from ``finer``
FORMS = ("lasting", "weight", "bends")
CONTROLS = {ControlNonlinearity, ControlUnevenness, ControlWeakening}
every_vehicle = pytest.mark.parametrize("vehicle", ALL_VEHICLES, ids=lambda vehicle: vehicle.name)


def are_forms_of_one(one: Effect, other: Effect) -> bool:
    """Whether two effects of one name are the same cause: lasting or not, a square or a cube, a
    control that is uneven, weakens or is curved.
    """
    if type(one) is not type(other) and {type(one), type(other)} <= CONTROLS:
        return all(
            getattr(one, name) == getattr(other, name)
            for name in ("control", "ports", "moment_by", "lift_by")
        )
    differing = [
        field.name
        for field in fields(one)  # type: ignore[arg-type]
        if getattr(one, field.name) != getattr(other, field.name)
    ]
    return type(one) is type(other) and len(differing) == 1 and differing[0] in FORMS


@every_vehicle
def test_a_name_is_one_effect_alone(vehicle: Equations) -> None:
    by_name: dict[str, list[Effect]] = defaultdict(list)
    for effect in (*effects_for(vehicle), *catch_all_terms_for(vehicle)):
        by_name[effect.name].append(effect)
    assert [
        name
        for name, same in by_name.items()
        if not all(are_forms_of_one(*pair) for pair in combinations(same, 2))
    ] == []


@every_vehicle
def test_every_input_has_its_instances(vehicle: Equations) -> None:
    offered, several = effects_for(vehicle), len(vehicle.inputs) > 1
    for signal in vehicle.inputs:
        on_path = [
            effect
            for effect in offered
            if effect.station is Station.INPUT_PATH and getattr(effect, "signal", "") == signal.name
        ]
        # A lag and a delay are parts of the low-order equivalent, and what is like them would be
        # one of its parameters.
        stems = BESIDE_A_LAG if isinstance(vehicle, Containing) else ON_INPUTS
        assert sorted(effect.name for effect in on_path) == sorted(
            f"{name}:{signal.name}" if several else name for name in stems
        )
        assert f"sensor-spikes:{signal.name}" in {effect.name for effect in offered}
        for effect in on_path:
            units = {item.unit for item in effect.parameters} - {"s", "1", "rad/s", "1/s"}
            assert signal.unit in ("rad", "1") or units <= {signal.unit, f"{signal.unit}/s"}


@every_vehicle
def test_every_output_has_its_instances(vehicle: Equations) -> None:
    names = [effect.name for effect in effects_for(vehicle)]
    # A body that is only tracked falls on a curve that a bent reading cannot be told from.
    stems = ON_OUTPUTS - ({"sensor-curve"} if isinstance(vehicle, Ballistic) else set())
    for signal in vehicle.outputs:
        # a square and a cube
        assert all(
            names.count(f"{each}:{signal.name}") == (2 if each == "sensor-curve" else 1)
            for each in stems
        )
    assert ("vane-offset" in names) == any(
        signal.name in ("alpha", "beta") for signal in vehicle.outputs
    )
    for channel in ("nz", "ny", "nx"):
        assert (f"accelerometer-offset:{channel}" in names) == any(
            signal.name == channel for signal in vehicle.outputs
        )


@every_vehicle
def test_every_port_has_its_effects(vehicle: Equations) -> None:
    offered = [
        effect
        for effect in effects_for(vehicle)
        if effect.station in (Station.DYNAMICS, Station.DISTURBANCE)
    ]
    # of the others some ports are recorded inputs
    for port in vehicle.ports if vehicle in WHOLE_AXES else ():
        assert any(port.name in getattr(effect, "needs", ()) for effect in offered), (
            f"nothing acts on {port.name}"
        )
    loads = {port.name for port in vehicle.ports} & {
        "lift",
        "moment",
        "drag",
        "side_force",
        "roll",
        "pitch",
        "yaw",
        "heave",
    }
    told = {
        port
        for effect in offered
        if stem(effect) == "unmeasured-input"
        for port in getattr(effect, "needs", ())
    }
    assert told == loads
    curves = {
        port
        for effect in offered
        if stem(effect).endswith("-nonlinearity")
        for port in getattr(effect, "needs", ())
    }
    # What acts on a multirotor are accelerations, which are no curve of an angle of the flow.
    assert curves == (loads if vehicle.name != "multirotor" else set())


@every_vehicle
def test_effects_speak_of_each_other_by_the_names_that_are_offered(vehicle: Equations) -> None:
    offered = [
        effect
        for effect in (*effects_for(vehicle), *catch_all_terms_for(vehicle))
        if isinstance(effect, Traceable)
    ]
    names, labelled = (
        {effect.name for effect in offered},
        {stem(effect) for effect in offered if ":" in effect.name},
    )
    for effect in offered:
        t = effect.traits
        for other in (*effect.aliases, *t.twins, *t.equivalents, *t.never_beside):
            # One that is not offered at all is of other equations; one whose label is missing would
            # never be found.
            assert other in names or other not in labelled, f"{effect.name} speaks of {other}"
            if ":" in effect.name and ":" in other and stem(effect) in ON_INPUTS and other in names:
                assert other.partition(":")[2] == effect.name.partition(":")[2]


def test_measured_motion_among_the_inputs_changes_no_name() -> None:
    """An airspeed or an attitude that is measured takes the place of a port or a state; it is no
    second control.
    """
    rigid = ShortPeriod()
    measured = (
        *(port for port in rigid.ports if port.name in ("airspeed_change", "density_change")),
        Signal("theta", "rad", "recorded"),
    )
    assert len(measured) == 3
    recorded, plain = (
        effects_for(replace(rigid, inputs=(*rigid.inputs, *measured))),
        effects_for(rigid),
    )
    further = [effect.name for effect in recorded if effect not in plain]
    assert [effect for effect in recorded if effect in plain] == list(plain)
    # All that may depend on a signal may depend on the recorded airspeed, too.
    assert further == [f"varies:{name}(airspeed)" for name in rigid.factors]


def test_a_vane_is_offered_only_where_there_is_the_rate_that_it_feels() -> None:
    def offered(states: Mapping[str, str]) -> set[str]:
        equations = own_model(
            name="turning",
            states=states,
            inputs={"d": "rad"},
            outputs={"alpha": "rad"},
            constants={"airspeed": (50.0, "m/s")},
            parameters={"a": (-1.0, "1/s"), "b": (1.0, "1/s")},
            rates=lambda s, p: {name: p.a * getattr(s, name) + p.b * s.d for name in states},
            readings=lambda s, p: {"alpha": s.alpha},
        ).equations
        return {
            effect.name for effect in (*effects_for(equations), *catch_all_terms_for(equations))
        }

    both = {"vane-offset", "guard:vane-behind"}
    assert not both & offered({"alpha": "rad"})
    assert both <= offered({"alpha": "rad", "q": "rad/s"})


def test_what_is_counted_in_another_unit_has_an_instance_in_that_unit() -> None:
    """An elevator in degrees is no elevator in radians: limits and starts of the library's own
    instances would be 57 times too small.
    """
    equations = own_model(
        name="in degrees",
        states={"alpha": "deg", "q": "deg/s"},
        inputs={"elevator": "deg"},
        outputs={"alpha": "deg", "q": "deg/s", "nz": "m/s2"},
        ports={"gust": "m/s", "pressure": "Pa"},
        parameters={"a": (-1.0, "1/s"), "b": (1.0, "1/s")},
        rates=lambda s, p: {
            "alpha": p.a * (s.alpha + s.gust) + s.q,
            "q": p.b * s.elevator + s.pressure,
        },
        readings=lambda s, p: {"alpha": s.alpha, "q": s.q, "nz": p.a * s.alpha},
    ).equations
    offered = [effect for effect in effects_for(equations) if isinstance(effect, Traceable)]
    units = {signal.name: signal.unit for signal in (*equations.inputs, *equations.outputs)}
    for effect in offered:
        acts_on = getattr(effect, "signal", getattr(effect, "channel", ""))
        assert getattr(effect, "unit", units.get(acts_on)) == units.get(acts_on), effect.name
    found = {effect.name: effect for effect in offered}
    assert "gust-discrete" not in found and "accelerometer-offset:nz" not in found
    context = SearchContext(0.0, 10.0, 0.02, input_peak={"elevator": 8.0})
    stop = found["actuator-saturation"]
    assert isinstance(stop, FittedToRecord) and stop.fitted_to(context).traits.plausible[
        "limit"
    ] == pytest.approx((0.4, 40.0))
    assert (
        found["unmeasured-input"].traits.plausible == {}
        and found["sensor-step:nz"].traits.plausible != {}
    )
    assert found["sensor-step:alpha"].traits.plausible == {}, (
        "nobody knows what is large in a unit that the library has not met"
    )
