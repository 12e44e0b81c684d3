"""A parameter that is a curve of a signal: which instances there are, what they are called, and
what they do to the equations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenarios.diagnosis.opening import candidates_for
from sim.declaration import own_model
from sim.declaration.compile import compile_model
from sim.declaration.model import Equations, Multiplying
from sim.declaration.proposal import SearchContext
from sim.effects.dynamics.varies import Varies, curve_made_for, other_names
from sim.effects.library import effects_for, find_effect
from sim.vehicles.other_vehicles import Ballistic
from sim.vehicles.uncoupled import Lateral, Loes, Longitudinal, ShortPeriod
from tests.bases import lateral_model, longitudinal_model, rigid_model
from tests.offered import ALL_VEHICLES
from tests.whole_axes import CONSTANTS, TRUE, true_model

NAMED = {
    "rigid": {
        **{
            "varies:Cm_alpha(alpha)": "moment-nonlinearity",
            "varies:CL_alpha(alpha)": "lift-nonlinearity",
        },
        **{
            "varies:Cm_de(elevator)": "control-nonlinearity",
            "varies:CL_de(elevator)": "control-nonlinearity",
        },
    },
    "loes": {
        **{
            "varies:M_alpha(alpha)": "moment-nonlinearity",
            "varies:L_alpha(alpha)": "lift-nonlinearity",
        },
        **{
            "varies:M_delta(delta)": "control-nonlinearity",
            "varies:L_delta(delta)": "control-nonlinearity",
        },
    },
    "ballistic": {
        "varies:beta(velocity)": "drag-mach",
        "varies:beta(altitude)": "density-scale-height",
    },
    "lateral": {
        **{
            "varies:CY_beta(beta)": "side-force-nonlinearity",
            "varies:Cl_beta(beta)": "roll-nonlinearity",
            "varies:Cn_beta(beta)": "yaw-nonlinearity",
        },
        **{
            f"varies:{axis}_da(aileron)": "control-nonlinearity:aileron"
            for axis in ("CY", "Cl", "Cn")
        },
        **{
            f"varies:{axis}_dr(rudder)": "control-nonlinearity:rudder"
            for axis in ("CY", "Cl", "Cn")
        },
    },
    "longitudinal": {
        **{
            "varies:CD_alpha(alpha)": "drag-nonlinearity",
            "varies:CL_alpha(alpha)": "lift-nonlinearity",
        },
        **{"varies:Cm_alpha(alpha)": "moment-nonlinearity"},
        **{
            "varies:CL_de(elevator)": "control-nonlinearity:elevator",
            "varies:Cm_de(elevator)": "control-nonlinearity:elevator",
        },
    },
    "multirotor": {},
}


@pytest.mark.parametrize("vehicle", ALL_VEHICLES, ids=lambda vehicle: vehicle.name)
def test_every_derivative_over_every_signal_once_and_under_the_name_of_a_named_curve_where_it_is_one(  # noqa: E501
    vehicle: Equations,
) -> None:
    assert isinstance(vehicle, Multiplying)
    offered = [effect.name for effect in effects_for(vehicle) if isinstance(effect, Varies)]
    signals = [signal.name for signal in (*vehicle.states, *vehicle.inputs)]
    every = {f"varies:{parameter}({signal})" for parameter in vehicle.factors for signal in signals}
    assert other_names(vehicle) == NAMED[vehicle.name]
    assert len(set(offered)) == len(offered) and {*offered} == every - {*NAMED[vehicle.name]}
    for name, curve in NAMED[vehicle.name].items():
        assert find_effect(name, vehicle).name == curve
    constants = {
        "mass",
        "airspeed",
        "reference_airspeed",
        "vane_arm",
        "inv_tau",
        "nz_0",
        "M_0",
        "CD_0",
        "CL_0",
        "Cm_0",
        "gravity",
    }
    assert not constants & {*vehicle.factors}


def test_the_numbers_of_instances() -> None:
    assert [
        len(curve_made_for(vehicle))
        for vehicle in (ShortPeriod(), Loes(), Ballistic(), Lateral(), Longitudinal())
    ] == [14, 20, 0, 81, 55]


def test_a_derivative_that_a_vehicle_file_leaves_out_does_not_vary() -> None:
    names = {
        effect.name
        for effect in candidates_for(true_model("lateral"))
        if isinstance(effect, Varies)
    }
    assert "CY_p" not in TRUE["lateral"] and not any("CY_p(" in name for name in names)
    assert names and {name.partition(":")[2].partition("(")[0] for name in names} == {
        *TRUE["lateral"]
    }
    assert CONSTANTS["lateral"]["airspeed"] > 0


def test_rolling_damping_over_sideslip_is_another_derivative_at_every_sideslip() -> None:
    """The rates at any state are those of the plain equations with the derivative that the curve
    gives there, written by numpy's own spline.
    """
    from scipy.interpolate import CubicSpline

    low, high = -0.2, 0.1
    curve = replace(find_effect("varies:Cl_p(beta)", Lateral()), low=low, high=high, count=5)  # type: ignore[type-var]
    assert isinstance(curve, Varies)
    sizes = np.array([0.1, -0.05, 0.02, 0.01, -0.03])
    plain = lateral_model()
    values = {f"{curve.name}.shape{i + 1}": size for i, size in enumerate(sizes)}
    system = compile_model(plain.with_effects(curve).with_values(values))
    knots = np.linspace(low, high, 6)
    at_knots = np.array([curve.change(_Bus(beta), sizes) for beta in knots])
    spline = CubicSpline(knots, at_knots, bc_type="natural")
    assert spline(0.0) == pytest.approx(0.0, abs=1e-12)
    for beta in (-0.17, -0.06, 0.013, 0.099):
        x, u = [beta, 0.3, -0.2, 0.1], [0.05, -0.04]
        other = plain.with_values({"Cl_p": plain.parameters["Cl_p"].value + float(spline(beta))})
        wanted = compile_model(other)
        p = system.parameters.values().tolist()
        np.testing.assert_allclose(
            system.f(0.0, x, u, p),
            wanted.f(0.0, x, u, wanted.parameters.values().tolist()),
            rtol=1e-12,
        )
        np.testing.assert_allclose(
            system.h(0.0, x, u, p),
            wanted.h(0.0, x, u, wanted.parameters.values().tolist()),
            rtol=1e-12,
        )
    # Beyond the range it goes on straight.
    steps = [curve.change(_Bus(high + step), sizes) - at_knots[-1] for step in (0.02, 0.04)]
    assert steps[1] == pytest.approx(2.0 * steps[0], rel=1e-12) and steps[0] == pytest.approx(
        0.02 * float(spline(high, 1)), rel=1e-9
    )


class _Bus:
    """A bus with an angle of sideslip and no gust."""

    def __init__(self, beta: float) -> None:
        self.beta, self.gust = beta, 0.0


def test_the_plain_form_is_a_slope_and_a_bend_and_counts_from_zero_or_the_middle() -> None:
    context = SearchContext(
        0.0,
        10.0,
        0.04,
        flown={"alpha": (0.02, 0.1), "q": (-0.2, 0.3)},
        values={"Cm_alpha": -2.0, "Cm_q": -14.0},
    )
    over_alpha, over_q = (
        find_effect(name, Longitudinal()) for name in ("varies:Cm_q(alpha)", "varies:Cm_alpha(q)")
    )
    assert isinstance(over_alpha, Varies) and isinstance(over_q, Varies)
    fitted = over_alpha.fitted_to(context)
    assert (fitted.low, fitted.high) == (0.02, 0.1) and [
        item.name for item in fitted.parameters
    ] == ["shape1", "shape2"]
    assert fitted.change(_At(alpha=0.06), (1.0, 1.0)) == pytest.approx(0.0, abs=1e-12)
    assert over_q.fitted_to(context).change(_At(q=0.0), (1.0, 1.0)) == pytest.approx(0.0, abs=1e-12)
    assert over_q.fitted_to(context).size == 2.0, "what is larger than usual may change by more"
    line = [fitted.change(_At(alpha=alpha), (1.0, 0.0)) for alpha in (0.03, 0.05, 0.07)]
    assert line[2] - line[1] == pytest.approx(line[1] - line[0], rel=1e-9)
    counts = [
        len(form.parameters)
        for form in (fitted, fitted.finer(), fitted.finer().finer(), fitted.finer().finer().finer())
    ]
    assert counts == [2, 5, 10, 10]


class _At:
    """A bus with some signals and no gust."""

    def __init__(self, **signals: float) -> None:
        self.__dict__ |= {"gust": 0.0, **signals}


def test_angles_are_those_against_the_air() -> None:
    curve = find_effect("varies:Cm_q(alpha)", ShortPeriod())
    assert isinstance(curve, Varies)
    assert curve.change(_At(alpha=0.03, **{}), (1.0, 0.0)) == curve.change(
        _Gusty(0.01, 0.02), (1.0, 0.0)
    )
    system = compile_model(rigid_model().with_effects(curve))
    assert "varies:Cm_q(alpha).shape1" in system.parameters


class _Gusty:
    """A bus with an angle of attack and a gust over the airspeed."""

    def __init__(self, alpha: float, gust: float) -> None:
        self.alpha, self.gust = alpha, gust


def test_a_recorded_airspeed_is_a_signal_like_any_other() -> None:
    rigid = ShortPeriod()
    speed = next(port for port in rigid.ports if port.name == "airspeed_change")
    curve = find_effect("varies:CL_alpha(airspeed)", replace(rigid, inputs=(*rigid.inputs, speed)))
    assert isinstance(curve, Varies) and curve.over == "airspeed_change"
    context = SearchContext(0.0, 10.0, 0.02, flown={"airspeed_change": (-4.0, 1.0)})
    assert (curve.fitted_to(context).low, curve.fitted_to(context).high) == (-4.0, 1.0)
    over_state = find_effect("varies:CL_q(airspeed)", Longitudinal())
    assert isinstance(over_state, Varies) and over_state.over == "airspeed"
    assert (
        longitudinal_model()
        .with_effects(over_state)
        .parameters["varies:CL_q(airspeed).shape1"]
        .unit
        == "1/rad"
    )


def test_of_an_own_model_what_multiplies_a_signal_may_vary() -> None:
    model = own_model(
        name="spring-mass",
        states={"x": "m", "v": "m/s"},
        inputs={"force": "N"},
        outputs={"x": "m"},
        constants={"m": (2.0, "kg")},
        parameters={
            "k": (50.0, "N/m"),
            "c": (0.0, "N s/m"),
            "load": (1.0, "N"),
            "unused": (1.0, "1"),
        },
        rates=lambda s, p: {"x": s.v, "v": (s.force - p.k * s.x - p.c * s.v * s.v + p.load) / p.m},
        readings=lambda s, p: {"x": s.x},
    )
    found = [effect for effect in candidates_for(model) if isinstance(effect, Varies)]
    assert [effect.name for effect in found] == [
        f"varies:{parameter}({signal})"
        for parameter in ("k", "c")
        for signal in ("x", "v", "force")
    ]
    assert other_names(model.equations) == {}
    context = SearchContext(0.0, 10.0, 0.02, flown={"x": (-0.4, 0.5)}, values={"k": 50.0})
    stiffness = found[0].fitted_to(context)
    assert stiffness.size == 50.0 and stiffness.parameters[0].unit == "N/m"
    # In MN/m it is the same spring: the usual change follows the unit. Of a parameter that is
    # declared as zero nothing is known.
    assert [found[0].fitted_to(replace(context, values={"k": k})).size for k in (5e-5, 0.0)] == [
        5e-5,
        1.0,
    ]
    system = compile_model(
        model.with_effects(stiffness).with_values(
            {"varies:k(x).shape1": 8.0, "varies:k(x).shape2": 0.0}
        )
    )
    rate = system.f(0.0, [0.2, 0.0], [0.0], system.parameters.values().tolist())[1]
    # Of a straight line over a range of width w about m, as large as one in the mean square about
    # zero: slope 1/sqrt(m^2 + w^2/12).
    k = 50.0 + 8.0 * 0.2 / np.sqrt(0.05**2 + 0.9**2 / 12.0)
    assert rate == pytest.approx((1.0 - k * 0.2) / 2.0, rel=1e-4)
