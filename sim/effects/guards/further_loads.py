"""Catch-all terms: loads that lag a state, oscillate at one frequency, or are products of two
signals; and a vane behind the centre of gravity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.declaration.user_equations import UserEquations
from sim.effects.instances import (
    ProbedAtAbsence,
    WithoutStates,
    all_labelled,
    controls,
    further_inputs,
    labelled,
    per_unit,
    ports_without,
)
from sim.effects.loads import (
    LOADS,
    NO_CAUSE,
    DisplacedVane,
    SizedOnPorts,
    in_words,
    load_parameters,
)
from sim.maths import cos, once_for_alike

LAGS = (0.05, 0.15, 0.5, 1.5)  # s, trial values, below and above usual short-period times
# Effects on an input that make the loads late as well.
LOOKS_LATE = ("actuator-lag", "input-delay")


@dataclass(frozen=True)
class LaggedLoads(SizedOnPorts):
    """Loads that lag a signal: late_dot = (signal - late)/``lag``, lift += ``lift`` (signal -
    late), moment += ``moment`` (signal - late).

    This is the first-order model of unsteady aerodynamics. The loads overshoot or build up with the
    time constant ``lag``, s. With a short lag it equals a derivative by alpha_dot, whose effect the
    declared derivatives include.

    Attributes
    ----------
    units, sizes : units and usual sizes of the loads, by port.
    needs_constants : constants that the equations must have.
    ports : load ports that the effect adds to; its size parameters have their names.
    angle : signal that the loads lag, an angle or any state.
    aliases : effects that a record may not distinguish from this one.
    total : whether the signal is a total value. It is then counted from ``middle``, the middle of
        its range, so that the loads do not begin with a jump.
    flown, counted_in : name and unit of the state whose value the signal is.
    of : suffix of the effect's name, if there are such terms for several states.
    """

    units: tuple[str, ...]
    sizes: tuple[float, ...]
    needs_constants: tuple[str, ...]
    ports: tuple[str, ...] = LOADS
    angle: str = "alpha_air"
    aliases: tuple[str, ...] = LOOKS_LATE
    total: bool = False
    middle: float = 0.0
    flown: str = "alpha"
    counted_in: str = "rad"
    of: str = ""

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    traits: ClassVar[Traits] = Traits(guard=True)

    @property
    def name(self) -> str:
        return labelled("guard:lagged-loads", self.of)

    @property
    def states(self) -> tuple[Signal, ...]:
        return (Signal(self._late_state, self.counted_in, f"{self.flown}, late"),)

    @property
    def _late_state(self) -> str:
        """Name of the state; one of several has a name that no user's signal can have."""
        return f"{self.of}, late" if self.of else "late_angle"

    @property
    def explanation(self) -> str:
        several = len(self.ports) > 1
        return (
            f"A generic term: {in_words(self.ports)} "
            f"follow{'' if several else 's'} {self.flown} with a lag: the port {self.ports[-1]} += "
            f"size ({self.flown} - late) with late_dot = ({self.flown} - late)/lag"
            f"{', the other port likewise' if several else ''}. {NO_CAUSE}"
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        loads = load_parameters(self.sizes, self.units, self.ports)
        return (Parameter("lag", 0.3, "s", bounds=(0.01, 20.0)), *loads)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        ahead = self._angle(s) - getattr(s, self._late_state)
        return {port: getattr(p, port) * ahead for port in self.ports}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ((self._angle(s) - getattr(s, self._late_state)) / p.lag,)

    def _angle(self, s: Any) -> Any:
        angle = getattr(s, self.angle)
        return angle - self.middle if self.total else angle

    def fitted_to(self, context: SearchContext) -> LaggedLoads:
        """Return the effect; total values are counted from the middle of the record's range."""
        recorded = context.flown_range(self.flown)
        if not self.total or recorded is None:
            return self
        return replace(self, middle=0.5 * (recorded[0] + recorded[1]))

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe all loads at some lags."""
        return tuple(
            Probe({"lag": lag, **self.absent}, self.ports) for lag in LAGS if lag > context.interval
        )


_RUDDER, _ELEVATOR = all_labelled(LOOKS_LATE, "rudder"), all_labelled(LOOKS_LATE, "elevator")
LAGGED_LOADS: tuple[Traceable, ...] = (
    LaggedLoads(("1/rad", "1/rad"), (0.5, 0.3), ("Cm_de", "airspeed")),
    LaggedLoads(("1/s", "1/s2"), (0.3, 2.0), ("M_delta",)),
    LaggedLoads(
        ("1/rad", "1/rad"),
        (0.1, 0.03),
        ("Cn_dr",),
        ("side_force", "yaw"),
        "beta_air",
        _RUDDER,
        flown="beta",
    ),
    LaggedLoads(
        ("1/rad", "1/rad"),
        (0.5, 0.3),
        ("Cm_de", "reference_airspeed"),
        aliases=_ELEVATOR,
        total=True,
    ),
)


def lagged_made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return lagged loads for each state of a user model, on the ports where an estimated parameter
    multiplies the state.
    """
    if not isinstance(equations, UserEquations):
        return ()
    labels = [label for _, label in further_inputs(equations)]
    aliases = tuple(name for label in labels for name in all_labelled(LOOKS_LATE, label))
    ports, candidates = ports_without(LAGGED_LOADS, equations), list[Traceable]()
    multiplied = {(port, signal) for port, signal, _ in equations.products}
    for state in equations.states:
        loaded = [port for port in ports if (port.name, state.name) in multiplied]
        if loaded:
            units = tuple(per_unit(port.unit, state.unit) for port in loaded)
            names = tuple(port.name for port in loaded)
            lagged = LaggedLoads(
                units,
                (1.0,) * len(loaded),
                (),
                names,
                state.name,
                aliases or LOOKS_LATE,
                total=True,
            )
            candidates.append(
                replace(lagged, flown=state.name, counted_in=state.unit, of=state.name)
            )
    return tuple(candidates)


# Ratio of successive trial frequencies; the peaks of the residual's spectrum are tried as well.
FREQUENCY_RATIO = 1.12
HIGHEST_FREQUENCY = 60.0  # rad/s
# Most ports that one oscillation loads together. Each further port adds two parameters.
MOST_COUPLED_PORTS = 2


@dataclass(frozen=True)
class PeriodicLoads(WithoutStates):
    """Loads at one frequency: lift += ``lift_cos`` cos(w t) + ``lift_sin`` sin(w t), moment
    likewise, where w is the ``frequency`` in rad/s.

    The loads do not depend on the state. Causes are a rotor, a limit cycle of the control system,
    or a periodic input that was not recorded. For a falling body the logarithm of the drag
    oscillates, as for a body that oscillates about its axis.

    Attributes
    ----------
    units, sizes : units and usual sizes of the loads, by port.
    needs_constants : constants that the equations must have.
    ports : load ports that the effect adds to; its parameters are named after them.
    label : suffix of the effect's name, if there are several such effects.
    """

    units: tuple[str, ...]
    sizes: tuple[float, ...]
    needs_constants: tuple[str, ...]
    ports: tuple[str, ...] = LOADS
    label: str = ""

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ("elastic-mode",)
    traits: ClassVar[Traits] = Traits(per_record=True, guard=True)

    @property
    def name(self) -> str:
        return labelled("guard:periodic-loads", self.label)

    @property
    def explanation(self) -> str:
        port = self.ports[-1]
        return (
            f"A generic term: {in_words(self.ports)} "
            f"oscillate{'' if len(self.ports) > 1 else 's'} at one frequency throughout the "
            f"record, independently of controls and motion: {port.replace('_', ' ')} += {port}_cos "
            f"cos(w t) + {port}_sin sin(w t). {NO_CAUSE}"
        )

    @property
    def needs(self) -> tuple[str, ...]:
        return self.ports

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(
            {f"{port}_{part}": 0.0 for port in self.ports for part in ("cos", "sin")}
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        sized = zip(self.ports, self.sizes, self.units, strict=True)
        loads = (
            Parameter(f"{port}_{part}", size, unit)
            for port, size, unit in sized
            for part in ("cos", "sin")
        )
        return (Parameter("frequency", 6.0, "rad/s", bounds=(0.2, 400.0)), *loads)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        even = once_for_alike(lambda frequency: cos(frequency * s.time), p.frequency)
        odd = once_for_alike(lambda frequency: cos(frequency * s.time - 0.5 * math.pi), p.frequency)
        return {
            port: getattr(p, f"{port}_cos") * even + getattr(p, f"{port}_sin") * odd
            for port in self.ports
        }

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe all sizes at the peaks of the residual's spectrum, then over a grid of
        frequencies.
        """
        slowest = max(1.0, 6.0 * math.pi / max(context.duration, 1.0))
        fastest = min(0.5 * math.pi / context.interval, HIGHEST_FREQUENCY)
        count = max(2, math.ceil(math.log(max(fastest / slowest, 1.1)) / math.log(FREQUENCY_RATIO)))
        grid = [slowest * (fastest / slowest) ** (i / (count - 1)) for i in range(count)]
        peaks = [
            frequency for frequency in context.residual_peaks if slowest <= frequency <= fastest
        ]
        return tuple(
            Probe({"frequency": frequency, **self.absent}, tuple(self.absent))
            for frequency in (*peaks, *grid)
        )


PERIODIC_LOADS: tuple[Traceable, ...] = (
    PeriodicLoads(("1", "1"), (0.01, 0.01), ("Cm_de",)),
    PeriodicLoads(("1/s", "1/s2"), (0.01, 0.1), ("M_delta",)),
    PeriodicLoads(("1", "1"), (0.002, 0.002), ("Cn_dr",), ("roll", "yaw")),
    PeriodicLoads(("1",), (0.2,), (), ("log_drag",)),
)


def periodic_made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return periodic loads on the ports of a user's model on which an estimated parameter acts.

    Up to ``MOST_COUPLED_PORTS`` ports have one term together; more ports have a term each.
    """
    if not isinstance(equations, UserEquations):
        return ()
    moved = {port for port, _, _ in equations.products}
    ports = [port for port in ports_without(PERIODIC_LOADS, equations) if port.name in moved]
    together = [ports] if 0 < len(ports) <= MOST_COUPLED_PORTS else [[port] for port in ports]
    return tuple(
        PeriodicLoads(
            tuple(p.unit for p in some),
            (1.0,) * len(some),
            (),
            tuple(p.name for p in some),
            some[0].name if len(together) > 1 else "",
        )
        for some in together
    )


@dataclass(frozen=True)
class ProductLoads(SizedOnPorts, WithoutStates, ProbedAtAbsence):
    """Loads by a product of two signals a and b: lift += ``lift`` a b, moment += ``moment`` a b.

    Attributes
    ----------
    label : name of the term, after ``guard:``.
    first, second : names of the signals a and b, which may be the same.
    units, sizes : units and usual sizes of the loads, by port.
    needs_constants : constants that the equations must have.
    aliases : effects of which the product is a special case.
    ports : load ports that the effect adds to; its size parameters have their names.
    """

    label: str
    first: str
    second: str
    units: tuple[str, ...]
    sizes: tuple[float, ...]
    needs_constants: tuple[str, ...]
    aliases: tuple[str, ...] = ()
    ports: tuple[str, ...] = LOADS

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR

    @property
    def name(self) -> str:
        return f"guard:{self.label}"

    @property
    def traits(self) -> Traits:
        return Traits(guard=True)

    @property
    def explanation(self) -> str:
        return (
            f"A generic term: {in_words(self.ports)} "
            f"increase{'' if len(self.ports) > 1 else 's'} with the product of two signals: the "
            f"port {self.ports[-1]} += size {self.first} * {self.second}. {NO_CAUSE}"
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return load_parameters(self.sizes, self.units, self.ports)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        product = getattr(s, self.first) * getattr(s, self.second)
        return {port: getattr(p, port) * product for port in self.ports}


_CONTROL_CURVE = ("control-nonlinearity",)
PRODUCT_LOADS: tuple[Traceable, ...] = (
    ProductLoads(
        "alpha-control", "alpha_air", "elevator", ("1/rad2", "1/rad2"), (5.0, 5.0), ("Cm_de",)
    ),
    ProductLoads(
        "control-squared",
        "elevator",
        "elevator",
        ("1/rad2", "1/rad2"),
        (3.0, 3.0),
        ("Cm_de", "airspeed"),
        _CONTROL_CURVE,
    ),
    ProductLoads("alpha-q", "alpha_air", "q_hat", ("1/rad2", "1/rad2"), (100.0, 100.0), ("Cm_de",)),
    ProductLoads("alpha-control", "alpha_air", "delta", ("1/s", "1/s2"), (1.0, 10.0), ("M_delta",)),
    ProductLoads(
        "control-squared",
        "delta",
        "delta",
        ("1/s", "1/s2"),
        (0.02, 0.1),
        ("M_delta",),
        _CONTROL_CURVE,
    ),
    ProductLoads("alpha-q", "alpha_air", "q", ("1/rad", "1/(rad s)"), (5.0, 20.0), ("M_delta",)),
    ProductLoads(
        "control-squared",
        "elevator",
        "elevator",
        ("1/rad2", "1/rad2"),
        (3.0, 3.0),
        ("Cm_de", "reference_airspeed"),
        ("control-nonlinearity:elevator",),
    ),
    *(
        ProductLoads(
            name, first, second, ("1/rad2", "1/rad2"), (1.0, 1.0), ("Cn_dr",), within, ports
        )
        for name, first, second, within, ports in (
            ("beta-rudder", "beta_air", "rudder", (), ("side_force", "yaw")),
            ("beta-aileron", "beta_air", "aileron", (), ("yaw", "roll")),
            ("beta-p", "beta_air", "p_hat", (), ("yaw", "roll")),
            ("beta-r", "beta_air", "r_hat", (), ("roll", "yaw")),
            (
                "rudder-squared",
                "rudder",
                "rudder",
                ("control-nonlinearity:rudder",),
                ("side_force", "yaw"),
            ),
            (
                "aileron-squared",
                "aileron",
                "aileron",
                ("control-nonlinearity:aileron",),
                ("yaw", "roll"),
            ),
        )
    ),
)


def products_made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return products of two states or controls of a user's model, on the ports where no estimated
    parameter multiplies either signal.

    If a parameter does, the product is the same as this parameter growing with the other signal,
    which the effect ``varies`` covers.
    """
    if not isinstance(equations, UserEquations) or equations.terms:
        return ()
    ports = ports_without(PRODUCT_LOADS, equations)
    signals, candidates = (*equations.states, *controls(equations)), list[Traceable]()
    multiplied = {(port, signal) for port, signal, _ in equations.products}
    for place, first in enumerate(signals):
        for second in signals[place:]:
            free = [
                port
                for port in ports
                if not {(port.name, first.name), (port.name, second.name)} & multiplied
            ]
            if free:
                units = tuple(per_unit(port.unit, first.unit, second.unit) for port in free)
                names = tuple(port.name for port in free)
                candidates.append(
                    ProductLoads(
                        f"{first.name}-{second.name}",
                        first.name,
                        second.name,
                        units,
                        (1.0,) * len(free),
                        (),
                        (),
                        names,
                    )
                )
    return tuple(candidates)


@dataclass(frozen=True)
class VaneBehind(DisplacedVane):
    """A vane behind the centre of gravity: alpha_m = alpha + (arm/V) q. A vane of sideslip reads
    beta_m = beta - (arm/V) r.

    ``arm`` is in m behind the centre of gravity, not negative. No effect of the library is such a
    vane, and an accelerometer as far ahead fits every record equally. The two therefore compete: if
    the derivatives with this term are closer to the declared ones, the accelerometer is not
    claimed.

    Attributes
    ----------
    channel, rate : name of the output, and angular rate in the plane of the vane.
    sign : sign of the contribution of the rate.
    accelerometer : channel of the accelerometer that fits equally.
    speed : name of the constant that is the airspeed, for equations without a varying airspeed.
    """

    channel: str = "alpha"
    rate: str = "q"
    sign: float = 1.0
    accelerometer: str = "nz"
    speed: str = "airspeed"

    name: ClassVar[str] = "guard:vane-behind"
    explanation: ClassVar[str] = (
        "A generic term: the angle of attack is read too early: alpha_m = alpha + (arm/V) q. "
        "Causes are a vane behind the centre of gravity, or a correction for a nose boom that does "
        "not exist. An accelerometer ahead of the centre of gravity gives the same record with "
        "other derivatives. If the declared derivatives favour this reading, no cause of the "
        "library is claimed."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"accelerometer-offset:{self.accelerometer}",)

    @property
    def traits(self) -> Traits:
        return Traits(guard=True, twins=self.aliases, equivalents=self.aliases)


VANE_BEHIND: tuple[Traceable, ...] = (
    VaneBehind(),
    VaneBehind("beta", "r", -1.0, "ny"),
    VaneBehind(speed="reference_airspeed"),
)


GUARDS: tuple[Traceable, ...] = (*LAGGED_LOADS, *PERIODIC_LOADS, *PRODUCT_LOADS, *VANE_BEHIND)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return the terms of this file for the signals and ports of a user model."""
    return (
        *lagged_made_for(equations),
        *periodic_made_for(equations),
        *products_made_for(equations),
    )
