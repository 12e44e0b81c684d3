"""A rigid aircraft with six degrees of freedom and coefficients that are sums of named terms.

Body axes, x forward, y to the right, z down. With the components u, v, w of the velocity, surfaces
and non-dimensional rates as signals of the terms (see `sim.aerodynamics`),

    u_dot = r v - q w - g sin(theta) + (qS CX + T cos(e))/m
    v_dot = p w - r u + g cos(theta) sin(phi) + qS CY/m
    w_dot = q u - p v + g cos(theta) cos(phi) + (qS CZ - T sin(e))/m

and Euler's equations with Ixz [1]_. States are the airspeed V, alpha and beta instead of u, v, w.
Coefficients of lift and drag, CL and CD, are turned by alpha into CZ and CX. Moment coefficients
refer to a reference point; ``cg`` is the position of the centre of gravity relative to it.

With a recorded wind, these states describe the velocity over the ground. Aerodynamic forces and the
outputs airspeed, alpha and beta belong to the velocity relative to the air.

References
----------
.. [1] B. L. Stevens, F. L. Lewis and E. N. Johnson, Aircraft Control and Simulation, 3rd ed.,
   Wiley, 2016, sections 1.7 and 2.3.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from sim.aerodynamics import AS_TERM, FLOW, RATES, Term, TermTable
from sim.declaration.effect import FROM_OUTPUTS, Parameter, ParameterSet
from sim.declaration.model import Model
from sim.declaration.user_equations import UserEquations
from sim.declaration.user_model import own_model
from sim.errors import DeclarationError, ModelError
from sim.maths import G0, add_product, arctan, cos, interpolate, plus, sin, sqrt
from sim.vehicles.attitude import ATTITUDES, EULER, angular_accelerations
from sim.vehicles.library import refuse_numbers

NAME = "aircraft"
BODY_AXES = ("CX", "CY", "CZ")  # force coefficients in body axes
WIND_AXES = ("CD", "CY", "CL")  # drag, side force and lift
MOMENTS = ("Cl", "Cm", "Cn")
FORCES = tuple(dict.fromkeys((*BODY_AXES, *WIND_AXES)))
CONSTANTS: Mapping[str, str] = MappingProxyType(
    {
        "mass": "kg",
        "wing_area": "m2",
        "chord": "m",
        "span": "m",
        "roll_inertia": "kg m2",
        "pitch_inertia": "kg m2",
        "yaw_inertia": "kg m2",
        "cross_inertia": "kg m2",
        "air_density": "kg/m3",
        "speed_of_sound": "m/s",
        "cg_x": "m",
        "cg_y": "m",
        "cg_z": "m",
        "thrust_arm": "m",
        "thrust_angle": "rad",
    }
)
VARYING = (  # constants that may be columns of the record
    *("mass", "roll_inertia", "pitch_inertia", "yaw_inertia", "cross_inertia"),
    *("air_density", "cg_x", "cg_y", "cg_z"),
)
DEFAULTS: Mapping[str, float] = MappingProxyType(
    {
        "cross_inertia": 0.0,
        "speed_of_sound": 340.294,
        **dict.fromkeys(("cg_x", "cg_y", "cg_z", "thrust_arm", "thrust_angle"), 0.0),
    }
)
STATES: Mapping[str, str] = MappingProxyType(
    {
        "airspeed": "m/s",
        "alpha": "rad",
        "beta": "rad",
        "p": "rad/s",
        "q": "rad/s",
        "r": "rad/s",
        "phi": "rad",
        "theta": "rad",
    }
)
FURTHER: Mapping[str, str] = MappingProxyType({"psi": "rad", "altitude": "m"})
OUTPUTS: Mapping[str, str] = MappingProxyType({**STATES, "ax": "m/s2", "ay": "m/s2", "az": "m/s2"})
# Axes of a recorded wind -> its columns: components of the velocity of the air, m/s.
WIND: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {"earth": ("wind_north", "wind_east", "wind_down"), "body": ("wind_u", "wind_v", "wind_w")}
)
SENSORS = ("airspeed", "alpha", "beta", "accelerometer")
BIASED = ("p", "q", "r")
Point = tuple[float, float, float]
_AT_CG: Point = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Thrust:
    """Propulsive force along an axis of the body.

    Attributes
    ----------
    signal : input: ``thrust`` in N, ``throttle`` from 0 to 1, or empty for a glider.
    table : positions of the throttle, and the thrust there, N.
    """

    signal: str = "thrust"
    table: tuple[tuple[float, ...], tuple[float, ...]] = ((0.0, 1.0), (0.0, 0.0))


@dataclass(frozen=True)
class Aircraft:
    """Declaration of an aircraft in a vehicle file, in SI units.

    Attributes
    ----------
    name : name of the vehicle.
    constants : values of ``CONSTANTS``.
    surfaces : recorded control inputs with their units.
    mixes : sums of surfaces that terms use: name -> surface -> factor.
    coefficients : terms and their values for CX CY CZ or CD CY CL, and Cl Cm Cn.
    sensors : positions of ``SENSORS`` from the centre of gravity in body axes, m.
    thrust : propulsive force.
    wind : axes of a wind that is recorded, a key of ``WIND``; empty without wind.
    varying : constants that are columns of the record.
    start : initial values of states.
    biases : outputs with a free constant bias.
    further : states in addition to ``STATES``.
    recorded : states that are columns of the record and not simulated; recorded alpha and beta are
        the readings of their vanes.
    attitude : ``euler`` or ``quaternion``, the representation that is integrated.
    estimated : coordinates of sensors that are parameters, such as ``accelerometer_y``; their
        starting values are in ``sensors``.
    """

    name: str
    constants: Mapping[str, float]
    surfaces: Mapping[str, str]
    coefficients: Mapping[str, Mapping[Term, float]]
    mixes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    sensors: Mapping[str, Point] = field(default_factory=dict)
    thrust: Thrust = Thrust()
    wind: str = ""
    varying: tuple[str, ...] = ()
    start: Mapping[str, float] = field(default_factory=dict)
    biases: tuple[str, ...] = BIASED
    further: tuple[str, ...] = ()
    recorded: tuple[str, ...] = ()
    attitude: str = EULER
    estimated: tuple[str, ...] = ()

    @property
    def signals(self) -> tuple[str, ...]:
        """Names that may occur in terms."""
        return (*FLOW, *dict.fromkeys((*self.surfaces, *self.mixes)))

    @property
    def angles(self) -> frozenset[str]:
        """Signals whose derivatives are per radian."""
        mixed = {
            name
            for name, parts in self.mixes.items()
            if all(self.surfaces.get(part) == "rad" for part in parts)
        }
        return frozenset(
            {"alpha", "beta", *RATES, *(n for n, unit in self.surfaces.items() if unit == "rad")}
            | mixed
        )

    @property
    def forces(self) -> tuple[str, ...]:
        """Names of the three force coefficients."""
        return WIND_AXES if {"CD", "CL"} & set(self.coefficients) else BODY_AXES

    @property
    def parameters(self) -> dict[str, tuple[float, str]]:
        """Value and unit of each term's coefficient, by the parameter's name."""
        return {
            f"{axis}_{term.label}": (value, term.unit(self.angles))
            for axis, terms in self.coefficients.items()
            for term, value in terms.items()
        }

    @property
    def positions(self) -> dict[str, tuple[float, str]]:
        """Value and unit, m, of each estimated coordinate of a sensor."""
        places = {
            f"{name}_{axis}": value
            for name in SENSORS
            for axis, value in zip("xyz", self.sensors.get(name, _AT_CG), strict=True)
        }
        return {name: (places[name], "m") for name in self.estimated}

    @property
    def terms(self) -> dict[str, tuple[str, Term]]:
        """Coefficient and term of each parameter."""
        return {
            f"{axis}_{term.label}": (axis, term)
            for axis, terms in self.coefficients.items()
            for term in terms
        }

    def with_values(self, values: Mapping[str, float]) -> Aircraft:
        """Return the declaration with other values of some parameters."""
        sensors = {name: list(place) for name, place in self.sensors.items()}
        for each, (old, _) in self.positions.items():
            name, axis = each.rsplit("_", 1)
            sensors.setdefault(name, [*_AT_CG])["xyz".index(axis)] = values.get(each, old)
        return replace(
            self,
            sensors={name: (x, y, z) for name, (x, y, z) in sensors.items()},
            coefficients={
                axis: {term: values.get(f"{axis}_{term.label}", old) for term, old in terms.items()}
                for axis, terms in self.coefficients.items()
            },
        )


def refuse_unphysical(aircraft: Aircraft) -> None:
    """Raise DeclarationError for constants that no aircraft has, or incomplete coefficients."""
    where = f"vehicle {aircraft.name}"
    refuse_numbers(aircraft.constants, CONSTANTS, where)
    both = {"CD", "CL"} & set(aircraft.coefficients), {"CX", "CZ"} & set(aircraft.coefficients)
    if all(both):
        raise DeclarationError(
            "forces are given in body axes and in wind axes",
            where=where,
            remedy="give CX, CY and CZ, or CD, CY and CL",
        )
    for axis in (*aircraft.forces, *MOMENTS):
        if not aircraft.coefficients.get(axis):
            remedy = f'add [aerodynamics.{axis}] with "1" = 0.0 at least'
            what = f"the coefficient {axis} has no term"
            raise DeclarationError(what, where=where, remedy=remedy)


def refuse_wind(axes: str, further: Collection[str], where: str) -> None:
    """Raise DeclarationError for a wind in unknown axes, or in those of the Earth without heading.

    ``further`` are the states in addition to ``STATES``.
    """
    if axes and axes not in WIND:
        raise DeclarationError(
            f"{axes!r} are no axes of a wind",
            where=where,
            remedy='write wind = "earth" (wind_north, wind_east, wind_down) or "body" (wind_u, '
            "wind_v, wind_w)",
        )
    if axes == "earth" and "psi" not in further:
        raise DeclarationError(
            "wind is recorded to the north and to the east, and the heading is no state",
            where=where,
            remedy='add states = ["psi"], or give the wind in body axes, wind = "body"',
        )


def refuse_recorded(
    recorded: Collection[str], wind: str, where: str, attitude: str = EULER
) -> None:
    """Raise DeclarationError for recorded states that the model cannot have.

    Not all states can be recorded, since none would be left to simulate, and a wind or a quaternion
    excludes some. An attitude that is no key of ``ATTITUDES`` is refused, too.
    """
    if attitude not in ATTITUDES:
        raise DeclarationError(
            f"{attitude!r} is no way to integrate an attitude",
            where=where,
            remedy=f"write attitude = {' or '.join(repr(name) for name in ATTITUDES)}",
        )
    if set(STATES) <= set(recorded):
        raise DeclarationError(
            "all states are recorded, and nothing is left to simulate",
            where=where,
            remedy='leave out those that the maneuver moves, as in recorded = ["airspeed", '
            '"alpha", "q", "theta"] for lateral ones',
        )
    if attitude != EULER and {"phi", "theta"} & set(recorded):
        raise DeclarationError(
            "phi and theta are recorded, and a quaternion integrates both",
            where=where,
            remedy='write attitude = "euler", or leave both out of recorded',
        )
    if wind and {"airspeed", "alpha", "beta"} & set(recorded):
        raise DeclarationError(
            "airspeed, alpha and beta are recorded against the air, and with wind the states are "
            "over the ground",
            where=where,
            remedy="leave out wind, or these three from recorded",
        )


def aircraft_model(aircraft: Aircraft) -> Model:
    """Return the model of a declared aircraft: constants held, all coefficients of terms free.

    Parameters
    ----------
    aircraft : the declaration.

    Returns
    -------
    Model whose parameters are the coefficients of terms and the estimated positions of sensors. Its
    states are airspeed, alpha, beta, p, q, r, phi, theta and those of ``further``, without those
    that are ``recorded``, which are inputs. Its outputs are the states and ax, ay, az (specific
    force, m/s2), each at the position of its sensor. Ports ``CX`` ... ``Cn`` add to the
    coefficients.

    Raises
    ------
    DeclarationError : see ``refuse_unphysical``, ``refuse_wind`` and ``refuse_recorded``.
    """
    where = f"vehicle {aircraft.name}"
    refuse_unphysical(aircraft)
    refuse_wind(aircraft.wind, aircraft.further, where)
    refuse_recorded(aircraft.recorded, aircraft.wind, where, aircraft.attitude)
    thrust = aircraft.thrust.signal
    inputs = {
        **aircraft.surfaces,
        **({thrust: "1" if thrust == "throttle" else "N"} if thrust else {}),
        **dict.fromkeys(WIND.get(aircraft.wind, ()), "m/s"),
        **{name: CONSTANTS[name] for name in aircraft.varying},
        **{name: STATES[name] for name in aircraft.recorded},
    }
    outputs = {name: unit for name, unit in OUTPUTS.items() if name not in aircraft.recorded}
    constants = {
        name: (aircraft.constants[name], unit)
        for name, unit in CONSTANTS.items()
        if name not in aircraft.varying
    }
    further = {name: FURTHER[name] for name in FURTHER if name in aircraft.further}
    motion = _AircraftEquations(aircraft)
    attitude = ATTITUDES[aircraft.attitude]
    angles = {name: aircraft.start.get(name, 0.0) for name in ("phi", "theta", "psi")}
    initial = {
        **{name: value for name, value in aircraft.start.items() if name not in angles},
        **{n: v for n, v in attitude.at_start(**angles).items() if n in motion.moving},
        **{name: aircraft.constants[name] for name in aircraft.varying},
    }
    units = {**STATES, **FURTHER, **attitude.states, **attitude.headed}
    try:
        model = own_model(
            NAME,
            {name: units[name] for name in motion.moving},
            inputs,
            {**outputs, **further},
            {**aircraft.parameters, **aircraft.positions},
            motion.rates,
            motion.readings,
            constants,
            dict.fromkeys((*aircraft.forces, *MOMENTS), "1"),
            motion.flow,
            initial,
            biases=[name for name in aircraft.biases if name not in aircraft.recorded],
        )
    except ModelError as error:
        raise DeclarationError(error.what, where=where, remedy=error.remedy) from error
    assert isinstance(model.equations, UserEquations)
    terms = tuple((axis, term.text) for axis, term in aircraft.terms.values())
    starts = [_start(item, aircraft.attitude) for item in model.initial]
    equations = replace(model.equations, terms=terms)
    return replace(model, equations=equations, initial=ParameterSet(tuple(starts)))


def _start(item: Parameter, attitude: str) -> Parameter:
    """Return the initial value of a state in the form for a fit.

    Initial values of a quaternion follow from the outputs ``phi``, ``theta`` and ``psi``, or are
    held.
    """
    of_attitude = ATTITUDES[attitude]
    if item.name in of_attitude.held:
        return replace(item, free=False)
    by_angles = attitude != EULER and item.name in {**of_attitude.states, **of_attitude.headed}
    return replace(item, source=FROM_OUTPUTS) if by_angles else item


def declaration_of(model: Model) -> Aircraft | None:
    """Return the declaration of an aircraft's model with its values; None for another model."""
    motion = getattr(getattr(model.equations, "rates", None), "__self__", None)
    if not isinstance(motion, _AircraftEquations):
        return None
    values = {item.name: item.value for item in model.parameters}
    aircraft = motion.aircraft.with_values(values)
    held = {name: values.get(name, value) for name, value in aircraft.constants.items()}
    return replace(aircraft, constants=held)


class _AircraftEquations:
    """The functions of an aircraft's equations."""

    def __init__(self, aircraft: Aircraft) -> None:
        self.aircraft = aircraft
        terms = [
            (axis, term)
            for axis in (*aircraft.forces, *MOMENTS)
            for term in aircraft.coefficients[axis]
        ]
        self.coefficients = [(axis, f"{axis}_{term.label}") for axis, term in terms]
        self.table = TermTable([term for _, term in terms])
        self.needs_mach = any("mach" in term.signals for _, term in aircraft.terms.values())
        self.places = {name: aircraft.sensors.get(name, _AT_CG) for name in SENSORS}
        # Parameters that are coordinates of a sensor; empty for a coordinate that is fixed.
        self.estimated = {
            name: tuple(
                each if (each := f"{name}_{axis}") in aircraft.estimated else "" for axis in "xyz"
            )
            for name in SENSORS
        }
        self.away = {n for n in SENSORS if self.places[n] != _AT_CG or any(self.estimated[n])}
        self.attitude = ATTITUDES[aircraft.attitude]
        self.has_heading = "psi" in aircraft.further
        states = (
            *(name for name in STATES if name not in ("phi", "theta")),
            *self.attitude.states,
            *(self.attitude.headed if self.has_heading else ()),
            *(name for name in aircraft.further if name != "psi"),
        )
        self.moving = tuple(name for name in states if name not in aircraft.recorded)
        self.read = tuple(
            name for name in (*STATES, *aircraft.further) if name not in aircraft.recorded
        )

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        """Return velocity relative to the air, pressure times area, thrust, and sums of terms."""
        c = self._constants(s, p)
        if self.aircraft.wind:
            u, v, w = (a - b for a, b in zip(self._velocity(s), self._wind(s), strict=True))
            V = sqrt(u * u + v * v + w * w)
            alpha, beta = _angle(w, u), _arcsine(v / V)
            sine, cosine = sin(alpha), cos(alpha)
        else:
            V, alpha, beta = s.airspeed, self._alpha(s), self._beta(s)
            sine, cosine, across = sin(alpha), cos(alpha), V * cos(beta)
            u, v, w = across * cosine, V * sin(beta), across * sine
        half = 0.5 / V
        values = {
            "alpha": alpha,
            "beta": beta,
            "p": s.p * c["span"] * half,
            "q": s.q * c["chord"] * half,
            "r": s.r * c["span"] * half,
            **{name: getattr(s, name) for name in self.aircraft.surfaces},
        }
        if self.needs_mach:
            values["mach"] = V / c["speed_of_sound"]
        for name, parts in self.aircraft.mixes.items():
            values[name] = sum(factor * getattr(s, each) for each, factor in parts.items())
        result = {
            "u_air": u,
            "v_air": v,
            "w_air": w,
            "sin_alpha": sine,
            "cos_alpha": cosine,
            "pressure_area": 0.5 * c["air_density"] * V * V * c["wing_area"],
            "thrust_force": self._thrust(s),
            **{AS_TERM + name: value for name, value in values.items()},
        }
        totals: dict[str, Any] = {axis: 0.0 for axis in (*self.aircraft.forces, *MOMENTS)}
        for (axis, name), term in zip(self.coefficients, self.table.values(values), strict=True):
            totals[axis] = add_product(totals[axis], getattr(p, name), term)
        return result | {f"{axis}_terms": total for axis, total in totals.items()}

    def rates(self, s: Any, p: Any) -> Mapping[str, Any]:
        """Return the rates of all simulated states."""
        c = self._constants(s, p)
        (X, Y, Z), (L, M, N) = self._loads(s, c)
        u, v, w = self._velocity(s) if self.aircraft.wind else (s.u_air, s.v_air, s.w_air)
        (x, y, z), attitude_rates = self.attitude.motion(s)
        u_dot = s.r * v - s.q * w + G0 * x + X / c["mass"]
        v_dot = s.p * w - s.r * u + G0 * y + Y / c["mass"]
        w_dot = s.q * u - s.p * v + G0 * z + Z / c["mass"]
        V, plane = s.airspeed, u * u + w * w
        V_dot = (u * u_dot + v * v_dot + w * w_dot) / V
        result = {
            "airspeed": V_dot,
            "alpha": (u * w_dot - w * u_dot) / plane,
            "beta": (V * v_dot - v * V_dot) / (V * sqrt(plane)),
            **angular_accelerations(s, c, L, M, N),
            **attitude_rates,
            "altitude": -(u * x + v * y + w * z),
        }
        return {name: result[name] for name in self.moving}

    def readings(self, s: Any, p: Any) -> Mapping[str, Any]:
        """Return the readings of the sensors at their positions."""
        c = self._constants(s, p)
        (X, Y, Z), (L, M, N) = self._loads(s, c)
        angles = self.attitude.angles(s, self.has_heading)
        result = {n: angles[n] if n in angles else getattr(s, n) for n in self.read}
        for name in ("airspeed", "alpha", "beta"):
            if name not in self.moving:
                continue
            u, v, w = s.u_air, s.v_air, s.w_air
            if name in self.away:
                u, v, w = self._velocity_at(s, self._place(name, p))
            if name == "alpha":
                result[name] = _angle(w, u)
            else:
                V = sqrt(u * u + v * v + w * w)
                result[name] = V if name == "airspeed" else _arcsine(v / V)
        result |= {"ax": X / c["mass"], "ay": Y / c["mass"], "az": Z / c["mass"]}
        if "accelerometer" in self.away:
            x, y, z = self._place("accelerometer", p)
            turn = angular_accelerations(s, c, L, M, N)
            P, Q, R = s.p, s.q, s.r
            result["ax"] += -x * (Q * Q + R * R) + y * (P * Q - turn["r"]) + z * (P * R + turn["q"])
            result["ay"] += x * (P * Q + turn["r"]) - y * (P * P + R * R) + z * (Q * R - turn["p"])
            result["az"] += x * (P * R - turn["q"]) + y * (Q * R + turn["p"]) - z * (P * P + Q * Q)
        return result

    def _place(self, name: str, p: Any) -> tuple[Any, Any, Any]:
        """Return the position of a sensor from the centre of gravity, m."""
        x, y, z = (
            getattr(p, parameter) if parameter else value
            for value, parameter in zip(self.places[name], self.estimated[name], strict=True)
        )
        return x, y, z

    def _constants(self, s: Any, p: Any) -> dict[str, Any]:
        varying = self.aircraft.varying
        return {name: getattr(s if name in varying else p, name) for name in CONSTANTS}

    def _alpha(self, s: Any) -> Any:
        """Return alpha at the centre of gravity; a recorded one is corrected for its vane's arm."""
        if "alpha" in self.moving or "alpha" not in self.away:
            return s.alpha
        x, y, _ = self.places["alpha"]
        across = (s.p * y - s.q * x) / (s.airspeed * cos(s.alpha))
        return arctan(sin(s.alpha) / cos(s.alpha) - across)

    def _beta(self, s: Any) -> Any:
        """Return beta at the centre of gravity; a recorded one is corrected for its vane's arm."""
        if "beta" in self.moving:
            return s.beta
        x, _, z = self.places["beta"]
        return s.beta - (s.r * x - s.p * z) / s.airspeed

    def _velocity(self, s: Any) -> tuple[Any, Any, Any]:
        """Return u, v, w of the centre of gravity, m/s."""
        alpha, beta = self._alpha(s), self._beta(s)
        across = s.airspeed * cos(beta)
        return across * cos(alpha), s.airspeed * sin(beta), across * sin(alpha)

    def _wind(self, s: Any) -> tuple[Any, Any, Any]:
        """Return the wind in body axes, m/s."""
        parts = tuple(getattr(s, name) for name in WIND[self.aircraft.wind])
        return parts if self.aircraft.wind == "body" else self.attitude.to_body(s, *parts)

    def _thrust(self, s: Any) -> Any:
        source = self.aircraft.thrust
        if not source.signal:
            return 0.0
        if source.signal == "thrust":
            return s.thrust
        return interpolate(s.throttle, *(np.array(each) for each in source.table))

    def _velocity_at(self, s: Any, place: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        """Return the velocity of a point of the aircraft relative to the air."""
        x, y, z = place
        return (
            s.u_air + s.q * z - s.r * y,
            s.v_air + s.r * x - s.p * z,
            s.w_air + s.p * y - s.q * x,
        )

    def _loads(
        self, s: Any, c: Mapping[str, Any]
    ) -> tuple[tuple[Any, Any, Any], tuple[Any, Any, Any]]:
        """Return forces without weight, N, and moments about the centre of gravity, N m."""
        qS = s.pressure_area
        first, side, third = (
            plus(getattr(s, f"{axis}_terms"), getattr(s, axis)) for axis in self.aircraft.forces
        )
        roll, pitch, yaw = (plus(getattr(s, f"{a}_terms"), getattr(s, a)) for a in MOMENTS)
        if self.aircraft.forces == WIND_AXES:
            sine, cosine = s.sin_alpha, s.cos_alpha
            first, third = third * sine - first * cosine, -(first * sine + third * cosine)
        X, Y, Z = qS * first, qS * side, qS * third
        x, y, z = c["cg_x"], c["cg_y"], c["cg_z"]
        L = qS * c["span"] * roll - (y * Z - z * Y)
        M = qS * c["chord"] * pitch - (z * X - x * Z)
        N = qS * c["span"] * yaw - (x * Y - y * X)
        T = s.thrust_force
        M = M + T * c["thrust_arm"]
        return (X + T * cos(c["thrust_angle"]), Y, Z - T * sin(c["thrust_angle"])), (L, M, N)


def _angle(y: Any, x: Any) -> Any:
    """Return the angle whose tangent is y/x, x positive; keeps complex steps."""
    return arctan(y / x)


def _arcsine(x: Any) -> Any:
    return arctan(x / sqrt(1.0 - x * x))
