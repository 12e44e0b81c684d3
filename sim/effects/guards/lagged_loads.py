"""Loads that follow a state late, the angle of attack or another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.declaration.user_equations import OwnEquations
from sim.effects.instances import all_labelled, further_inputs, labelled, per_unit, ports_without
from sim.effects.loads import LOADS, SizedOnPorts, load_parameters

LAGS = (0.05, 0.15, 0.5, 1.5)  # s, that a search tries: about the short period's time
LOOKS_LATE = ("actuator-lag", "input-delay")


@dataclass(frozen=True)
class LaggedLoads(SizedOnPorts):
    """late_dot = (angle - late)/``lag``, lift += ``lift`` (angle - late), moment += ``moment``
    (angle - late).

    The first term of unsteady aerodynamics: loads that overshoot or build up with time constant
    ``lag``, s. For a short lag it is a derivative by alpha_dot, which the declared derivatives hold
    already.

    Attributes
    ----------
    units, sizes : of lift and moment. needs_constants : those of the equations it is written for.
    ports : that it loads, and the names of these parameters. angle : the signal that is followed
    late. aliases : effects that look like it. total : whether the signal is one; it then counts
    from ``middle``, that of the values flown, so that the loads do not begin with a jump. flown,
    counted_in : the state behind the signal and its unit. of : of the name, where there are guards
    for several states.
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
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    traits: ClassVar[Traits] = Traits(guard=True)

    @property
    def name(self) -> str:
        return labelled("guard:lagged-loads", self.of)

    @property
    def states(self) -> tuple[Signal, ...]:
        return (Signal(self._late, self.counted_in, f"{self.flown}, late"),)

    @property
    def _late(self) -> str:
        """Of several each has its own, under a name that no user's signal can have."""
        return f"{self.of}, late" if self.of else "late_angle"

    @property
    def explanation(self) -> str:
        loads = " and ".join(port.replace("_", " ") for port in self.ports)
        return (
            f"A generic term: {loads} take{'' if len(self.ports) > 1 else 's'} time to follow "
            f"{self.flown}: each += size ({self.flown} - late) with "
            f"late_dot = ({self.flown} - late)/lag. No cause of the library stands behind it. "
            "Where it explains a record better than every effect "
            "does, the cause is none of them."
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        loads = load_parameters(self.sizes, self.units, self.ports)
        return (Parameter("lag", 0.3, "s", bounds=(0.01, 20.0)), *loads)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        ahead = self._angle(s) - getattr(s, self._late)
        return {port: getattr(p, port) * ahead for port in self.ports}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ((self._angle(s) - getattr(s, self._late)) / p.lag,)

    def _angle(self, s: Any) -> Any:
        angle = getattr(s, self.angle)
        return angle - self.middle if self.total else angle

    def fitted_to(self, context: SearchContext) -> LaggedLoads:
        """The same; a total counts from the middle of the values that the record flew."""
        flown = context.flown_range(self.flown)
        return replace(self, middle=0.5 * (flown[0] + flown[1])) if self.total and flown else self

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by all loads at some lags."""
        return tuple(
            Probe({"lag": lag, **self.absent}, self.ports) for lag in LAGS if lag > context.interval
        )


_RUDDER, _ELEVATOR = all_labelled(LOOKS_LATE, "rudder"), all_labelled(LOOKS_LATE, "elevator")
GUARDS: tuple[Traceable, ...] = (
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


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One for each state of a user's own model, on the ports where an estimated parameter
    multiplies it.
    """
    if not isinstance(equations, OwnEquations):
        return ()
    looks = (
        tuple(
            name
            for signal, label in further_inputs(equations)
            for name in all_labelled(LOOKS_LATE, label)
        )
        or LOOKS_LATE
    )
    ports, found = ports_without(GUARDS, equations), list[Traceable]()
    multiplied = {(port, signal) for port, signal, _ in equations.products}
    for state in equations.states:
        loaded = [port for port in ports if (port.name, state.name) in multiplied]
        if loaded:
            units, names = (
                tuple(per_unit(port.unit, state.unit) for port in loaded),
                tuple(port.name for port in loaded),
            )
            late = LaggedLoads(
                units, (1.0,) * len(loaded), (), names, state.name, looks, total=True
            )
            found.append(replace(late, flown=state.name, counted_in=state.unit, of=state.name))
    return tuple(found)
