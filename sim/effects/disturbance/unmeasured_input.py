"""Unmeasured loads: a pulse or step of lift and moment, and a random process on each load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from sim.declaration.effect import (
    Effect,
    Parameter,
    Regularity,
    Signal,
    Station,
    constants_needed,
    ports_needed,
)
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import WithoutStates, labelled, load_ports
from sim.effects.loads import (
    LOADS,
    USUAL_SUB_STEP,
    SizedOnPorts,
    edge_width,
    load_parameters,
    risen,
)

_USUAL_LOAD = {"1": 0.005, "1/s": 0.01, "rad/s": 0.01, "1/s2": 0.1, "rad/s2": 0.1}
DURATIONS = (0.3, 0.7, 1.5, 3.0, 6.0)  # s, trial values of a pulse


@dataclass(frozen=True)
class UnmeasuredInput(SizedOnPorts, WithoutStates):
    """An unmeasured load: a pulse of lift and moment from ``start`` on for ``duration``, s.

    ``lift`` and ``moment`` are coefficients on the rigid aircraft. On the low-order equivalent
    system they are changes of alpha_dot in 1/s and of q_dot in 1/s2. The edges last ``width`` s,
    centred on their times.

    Attributes
    ----------
    lasting : whether the load is a step, without a ``duration``.
    width : duration of an edge, s.
    units, sizes : units and usual sizes of the loads, by port.
    needs_constants : constants that the equations must have.
    ports : load ports that the effect adds to; its size parameters have their names.
    label : suffix of the effect's name, if the effect is one of several with a port each.
    sized : whether usual loads are known for the unit of the port; otherwise any size is plausible.
    """

    lasting: bool = False
    width: float = USUAL_SUB_STEP
    units: tuple[str, ...] = ("1", "1")
    sizes: tuple[float, ...] = (0.02, 0.01)
    needs_constants: tuple[str, ...] = ("Cm_alpha",)
    ports: tuple[str, ...] = LOADS
    label: str = ""
    sized: bool = True

    station: ClassVar[Station] = Station.DISTURBANCE
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ("lost-rows",)

    @property
    def explanation(self) -> str:
        loads, ratio = (
            (
                "CL += lift and Cm += moment",
                "its lift and moment have the ratio of CL_alpha to Cm_alpha",
            )
            if self.ports == LOADS
            else (
                f"The coefficient of {self.ports[0].replace('_', ' ')} += {self.ports[0]}",
                "its loads have a known ratio",
            )
        )
        return (
            "A load acts that is not recorded. Causes are a flap, a speed brake, another surface, "
            f"thrust with a pitching moment, or the release of a store. {loads} from start to "
            "start + duration, or from start on without end. The motion begins without any "
            "recorded input and follows the modes of the aircraft. A gust does this, too, but "
            f"acts through the angle of the air and moves the vane at once, so that {ratio}."
        )

    @property
    def name(self) -> str:
        return labelled("unmeasured-input", self.label)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        duration = () if self.lasting else (Parameter("duration", 1.5, "s", bounds=(0.02, 1000.0)),)
        loads = load_parameters(self.sizes, self.units, self.ports)
        return (Parameter("start", 2.0, "s"), *duration, *loads)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "something that is not recorded acts for {duration} from {start}: {rest}",
                "something that is not recorded acts from {start} on: {rest}",
            ),
            plausible={
                port: (-30.0 * size, 30.0 * size)
                for port, size in zip(self.ports, self.sizes, strict=True)
            }
            if self.sized
            else {},
            lasts="duration",
            onset="start",
            per_record=True,
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        share = risen(s.time, p.start, self.width)
        if not self.lasting:
            share = share - risen(s.time, p.start + p.duration, self.width)
        return {port: share * getattr(p, port) for port in self.ports}

    def fitted_to(self, context: SearchContext) -> UnmeasuredInput:
        """Return the effect with edges of one sub-step of the record."""
        return replace(self, width=edge_width(context.interval))

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe all loads at the begin of the record, for some durations.

        A later start only shifts the response.
        """
        start = {"start": context.begin + self.width, **self.absent}
        if self.lasting:
            return (Probe(start, self.ports, shifts=True),)
        return tuple(
            Probe({**start, "duration": duration}, self.ports, shifts=True)
            for duration in DURATIONS
            if 2.0 * context.interval <= duration <= 0.5 * context.duration
        )


VARIANTS: tuple[Traceable, ...] = (
    UnmeasuredInput(),
    UnmeasuredInput(lasting=True),
    UnmeasuredInput(units=("1/s", "1/s2"), sizes=(0.01, 0.1), needs_constants=("M_alpha",)),
    UnmeasuredInput(
        lasting=True, units=("1/s", "1/s2"), sizes=(0.01, 0.1), needs_constants=("M_alpha",)
    ),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return a pulse and a step on each load port to which no effect of ``VARIANTS`` adds."""
    ports = load_ports(equations)
    covered = {
        port
        for each in VARIANTS
        if {*equations.parameter_names}.issuperset(constants_needed(each))
        for port in ports_needed(each)
    }
    candidates: list[Traceable] = []
    for port in ports:
        if port.name in covered and covered <= {each.name for each in ports}:
            continue
        candidates += [
            UnmeasuredInput(
                lasting,
                units=(port.unit,),
                sizes=(_USUAL_LOAD.get(port.unit, 1.0),),
                needs_constants=(),
                ports=(port.name,),
                label=port.name if len(ports) > 1 else "",
                sized=port.unit in _USUAL_LOAD,
            )
            for lasting in (False, True)
        ]
    return tuple(candidates)


@dataclass(frozen=True)
class ModelDiscrepancy(SizedOnPorts):
    """Model discrepancy: a first-order Gauss-Markov process is added to each load port.

    The standard deviation of a process is the parameter with the name of the port, and its
    correlation time is ``time``. This is the model discrepancy of Kennedy and O'Hagan, applied to
    forces and moments, where the errors of an aircraft model are.

    Attributes
    ----------
    units, sizes : units and usual sizes of the loads, by port; the starting standard deviation is a
        tenth of the size.
    needs_constants : constants that the equations must have.
    ports : load ports that the effect adds to.
    """

    units: tuple[str, ...] = ("1", "1")
    sizes: tuple[float, ...] = (0.02, 0.01)
    needs_constants: tuple[str, ...] = ("Cm_alpha",)
    ports: tuple[str, ...] = LOADS

    name: ClassVar[str] = "model-discrepancy"
    station: ClassVar[Station] = Station.DISTURBANCE
    regularity: ClassVar[Regularity] = Regularity.PROCESS_NOISE
    aliases: ClassVar[tuple[str, ...]] = ()
    traits: ClassVar[Traits] = Traits(background=True)
    explanation: ClassVar[str] = (
        "The sum of many small unmodelled causes in the forces and moments."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        sizes = tuple(
            Parameter(port, 0.1 * size, unit, bounds=(0.0, 30.0 * size))
            for port, size, unit in zip(self.ports, self.sizes, self.units, strict=True)
        )
        return (*sizes, Parameter("time", 0.5, "s", free=False))

    @property
    def states(self) -> tuple[Signal, ...]:
        return tuple(
            Signal(f"discrepancy_{port}", unit, f"discrepancy of {port.replace('_', ' ')}")
            for port, unit in zip(self.ports, self.units, strict=True)
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {port: getattr(s, f"discrepancy_{port}") for port in self.ports}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return tuple(-getattr(s, f"discrepancy_{port}") / p.time for port in self.ports)

    def density(self, vehicle: Any, p: Any) -> Sequence[Any]:
        """Return the spectral density of the noise on each state's rate."""
        return tuple(2.0 * getattr(p, port) ** 2 / p.time for port in self.ports)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return ()


def discrepancy_for(effects: Sequence[Effect]) -> ModelDiscrepancy | None:
    """Return a discrepancy of all loads to which an unmeasured input can add; None without any.

    Parameters
    ----------
    effects : effects that can act on a vehicle.
    """
    loads = [each for each in effects if isinstance(each, UnmeasuredInput) and not each.lasting]
    if not loads:
        return None
    constants = dict.fromkeys(name for load in loads for name in load.needs_constants)
    return ModelDiscrepancy(
        tuple(unit for load in loads for unit in load.units),
        tuple(size for load in loads for size in load.sizes),
        tuple(constants),
        tuple(port for load in loads for port in load.ports),
    )
