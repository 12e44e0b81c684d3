"""Loads that grow with the product of two signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.declaration.user_equations import OwnEquations
from sim.effects.instances import controls, per_unit, ports_without
from sim.effects.loads import LOADS, SizedOnPorts, load_parameters


@dataclass(frozen=True)
class ProductLoads(SizedOnPorts):
    """lift += ``lift`` a b, moment += ``moment`` a b, a and b two signals of the equations.

    Attributes
    ----------
    label : after ``guard:``. first, second : the signals, which may be the same. aliases, within :
    effects that contain it. units, sizes : of lift and moment. needs_constants : those of the
    equations it is written for. ports : that it loads, lift and moment or their like, and the names
    of these parameters.
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
    states: ClassVar[tuple[Signal, ...]] = ()

    @property
    def name(self) -> str:
        return f"guard:{self.label}"

    @property
    def traits(self) -> Traits:
        return Traits(
            guard=True,
        )

    @property
    def explanation(self) -> str:
        loads = f"{' and '.join(self.ports)} {'grow' if len(self.ports) > 1 else 'grows'}"
        return (
            f"A generic term: {loads} with the product {self.first} * {self.second}. No cause of "
            "the library stands behind it. Where it explains a "
            "record better than every effect does, the cause is none of them."
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return load_parameters(self.sizes, self.units, self.ports)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        product = getattr(s, self.first) * getattr(s, self.second)
        return {port: getattr(p, port) * product for port in self.ports}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by both where there is none."""
        return (Probe(self.absent, self.ports),)


_CONTROL = ("control-nonlinearity",)
GUARDS: tuple[Traceable, ...] = (
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
        _CONTROL,
    ),
    ProductLoads("alpha-q", "alpha_air", "q_hat", ("1/rad2", "1/rad2"), (100.0, 100.0), ("Cm_de",)),
    ProductLoads("alpha-control", "alpha_air", "delta", ("1/s", "1/s2"), (1.0, 10.0), ("M_delta",)),
    ProductLoads(
        "control-squared", "delta", "delta", ("1/s", "1/s2"), (0.02, 0.1), ("M_delta",), _CONTROL
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


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Products of two states or controls of a user's own model, on the ports where no estimated
    parameter multiplies either.

    Where one does, the product is that parameter growing with the other signal, which ``varies``
    says by name.
    """
    if not isinstance(equations, OwnEquations) or equations.terms:
        return ()
    ports, signals, found = (
        ports_without(GUARDS, equations),
        (*equations.states, *controls(equations)),
        list[Traceable](),
    )
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
                found.append(
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
    return tuple(found)
