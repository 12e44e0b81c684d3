"""Catch-all terms: damping that depends on amplitude, derivatives and drag that drift, elevator
drag, and loads with hysteresis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import ProbedAtAbsence, WithoutStates, all_labelled, labelled
from sim.effects.loads import LOADS, NO_CAUSE, SizedOnPorts, load_parameters
from sim.maths import absolute


@dataclass(frozen=True)
class DampingCurve(SizedOnPorts, WithoutStates, ProbedAtAbsence):
    """Damping that depends on amplitude: lift += ``lift`` r |r|, moment += ``moment`` r |r|.

    r is an angular rate.

    Attributes
    ----------
    rate : signal r in the equations.
    units, sizes : units and usual sizes of the loads, by port.
    needs_constants : constants that the equations must have.
    ports : load ports that the effect adds to; its size parameters have their names.
    label : suffix of the effect's name, where there are several rates.
    """

    rate: str
    units: tuple[str, str]
    sizes: tuple[float, float]
    needs_constants: tuple[str, ...]
    ports: tuple[str, str] = LOADS
    label: str = ""

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "A generic term: damping increases with the size of the rate: CL += lift q |q| and Cm "
        f"+= moment q |q|, with non-dimensional q; for roll and yaw likewise. {NO_CAUSE}"
    )

    @property
    def name(self) -> str:
        return labelled("guard:damping-curve", self.label)

    @property
    def traits(self) -> Traits:
        return Traits(guard=True)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return load_parameters(self.sizes, self.units, self.ports)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        rate = getattr(s, self.rate)
        curve = rate * absolute(rate)
        return {port: getattr(p, port) * curve for port in self.ports}


@dataclass(frozen=True)
class DriftingDerivatives(WithoutStates, ProbedAtAbsence):
    """Derivatives that drift: moment += (t - begin) (``stability`` alpha + ``control`` d), lift +=
    (t - begin) ``slope`` alpha.

    d is the deflection of a control.

    Attributes
    ----------
    control_signal : signal d in the equations.
    units, sizes : units and usual sizes of stability, control and slope.
    needs_constants : constants that the equations must have.
    begin : time at which the derivatives have their declared values, s.
    ports : ports of lift and moment, or of side force and yawing or rolling moment.
    angle : signal of alpha or beta.
    label : suffix of the effect's name, where there are several groups of derivatives.
    """

    control_signal: str
    units: tuple[str, str, str]
    sizes: tuple[float, float, float]
    needs_constants: tuple[str, ...]
    begin: float = 0.0
    ports: tuple[str, str] = LOADS
    angle: str = "alpha_air"
    label: str = ""

    station: ClassVar[Station] = Station.DYNAMICS
    absent: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"stability": 0.0, "control": 0.0, "slope": 0.0}
    )
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    traits: ClassVar[Traits] = Traits(per_record=True, guard=True)
    explanation: ClassVar[str] = (
        "A generic term: stability, control power and lift slope change steadily with time, "
        "each at its own rate: Cm += (t - begin) (stability alpha + control d), CL += (t - "
        f"begin) slope alpha. Causes are fuel that moves or ice that grows. {NO_CAUSE}"
    )

    @property
    def name(self) -> str:
        return labelled("guard:drifting-derivatives", self.label)

    @property
    def aliases(self) -> tuple[str, ...]:
        return ("speed-variation", *all_labelled(("derivative-jump",), self.label))

    @property
    def needs(self) -> tuple[str, ...]:
        return self.ports

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        names = ("stability", "control", "slope")
        return tuple(
            Parameter(name, size, unit)
            for name, size, unit in zip(names, self.sizes, self.units, strict=True)
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        since = s.time - self.begin
        angle = getattr(s, self.angle)
        moment = p.stability * angle + p.control * getattr(s, self.control_signal)
        return {self.ports[1]: since * moment, self.ports[0]: since * p.slope * angle}

    def fitted_to(self, context: SearchContext) -> DriftingDerivatives:
        """Return the effect whose derivatives have their declared values at the begin of the
        record.
        """
        return replace(self, begin=context.begin)


@dataclass(frozen=True)
class ControlDrag(WithoutStates, ProbedAtAbsence):
    """Elevator drag: drag += ``drag`` elevator, where the elevator is a total deflection.

    ``drag`` is CD_de, 1/rad. Elevator drag makes nx respond to the elevator at once. So does an
    axial accelerometer above or below the centre of gravity, which reads the pitch acceleration.
    Without this term, elevator drag would be reported as a sensor position.
    """

    name: ClassVar[str] = "guard:control-drag"
    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ("drag",)
    needs_constants: ClassVar[tuple[str, ...]] = ("Cm_de", "reference_airspeed")
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("drag", 0.1, "1/rad"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"drag": 0.0})
    traits: ClassVar[Traits] = Traits(guard=True)
    explanation: ClassVar[str] = (
        "A generic term: drag increases with the elevator: CD += drag elevator. The "
        f"longitudinal equations have no drag of the controls. {NO_CAUSE}"
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"drag": p.drag * s.elevator}


@dataclass(frozen=True)
class DragDrift(WithoutStates, ProbedAtAbsence):
    """Drifting drag: log drag += ``rate`` (t - begin), with ``rate`` in 1/s.

    Attributes
    ----------
    begin : time at which the ballistic coefficient beta has its declared value, s.
    """

    begin: float = 0.0

    name: ClassVar[str] = "guard:drag-drift"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("log_drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("rate", 0.03, "1/s", bounds=(-1.0, 1.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"rate": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("density-scale-height", "drag-mach")
    traits: ClassVar[Traits] = Traits(guard=True)
    explanation: ClassVar[str] = (
        "A generic term: the drag of a falling body changes steadily with time: drag = "
        f"exp(rate (t - begin)) * 0.5 rho v^2 / beta. {NO_CAUSE}"
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"log_drag": p.rate * (s.time - self.begin)}

    def fitted_to(self, context: SearchContext) -> DragDrift:
        """Return the effect whose beta has its declared value at the begin of the record."""
        return replace(self, begin=context.begin)


WIDTHS = (0.005, 0.02, 0.06)  # rad, trial values: from friction to the size of a maneuver


@dataclass(frozen=True)
class Hysteresis(SizedOnPorts):
    """Loads with hysteresis: lift += ``lift`` memory, moment += ``moment`` memory.

    The memory is a state with memory_dot = (rate - |rate| memory)/``width``. This is Dahl's law of
    friction and of rate-independent hysteresis. The memory tends to the sign of the ``rate``,
    rad/s, over a rotation of ``width``, rad, and is constant at rest. A small width represents
    friction; a large one represents late reattachment of the flow, or a sliding load.

    Attributes
    ----------
    units, sizes : units and usual sizes of the loads, by port.
    needs_constants : constants that the equations must have.
    ports : load ports that the effect adds to; its size parameters have their names.
    rate : signal of the rate.
    """

    units: tuple[str, str]
    sizes: tuple[float, float]
    needs_constants: tuple[str, ...]
    ports: tuple[str, str] = LOADS
    rate: str = "q"

    name: ClassVar[str] = "guard:hysteresis"
    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = (
        Signal("memory", "1", "direction of the last motion, -1 to 1"),
    )
    traits: ClassVar[Traits] = Traits(guard=True)
    explanation: ClassVar[str] = (
        "A generic term: lift and moment depend on the direction of the last rotation, at any "
        "speed of rotation: CL += lift memory, Cm += moment memory, with a memory from -1 to "
        "1. Causes are friction, flow that reattaches later than it separated, or a load that "
        f"slides. {NO_CAUSE}"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("width", 0.02, "rad", bounds=(1e-3, 1.0)),
            *load_parameters(self.sizes, self.units, self.ports),
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {port: getattr(p, port) * s.memory for port in self.ports}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        rate = getattr(s, self.rate)
        return ((rate - absolute(rate) * s.memory) / p.width,)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe the loads at some widths."""
        return tuple(Probe({"width": width, **self.absent}, self.ports) for width in WIDTHS)


_PER_SECOND = ("1/(rad s)", "1/(rad s)", "1/(rad s)")
GUARDS: tuple[Traceable, ...] = (
    DampingCurve("q_hat", ("1/rad2", "1/rad2"), (500.0, 500.0), ("Cm_de",)),
    DampingCurve("q", ("1/rad", "1/rad"), (0.3, 5.0), ("M_delta",)),
    DriftingDerivatives("elevator", _PER_SECOND, (0.02, 0.02, 0.05), ("Cm_de",)),
    DriftingDerivatives("delta", ("1/s3", "1/s3", "1/s2"), (0.1, 0.02, 0.02), ("M_delta",)),
    DampingCurve("p_hat", ("1/rad2", "1/rad2"), (-0.5, -3.0), ("Cn_dr",), ("yaw", "roll"), "p"),
    DampingCurve("r_hat", ("1/rad2", "1/rad2"), (1.0, -3.0), ("Cn_dr",), ("roll", "yaw"), "r"),
    *(
        DriftingDerivatives(
            control,
            _PER_SECOND,
            (0.002, 0.002, 0.01),
            ("Cn_dr",),
            ports=("side_force", moment),
            angle="beta_air",
            label=moment,
        )
        for control, moment in (("rudder", "yaw"), ("aileron", "roll"))
    ),
    ControlDrag(),
    DragDrift(),
    Hysteresis(("1", "1"), (0.01, 0.005), ("Cm_de", "airspeed")),
    Hysteresis(("1/s", "1/s2"), (0.01, 0.1), ("M_delta",)),
    Hysteresis(("1", "1"), (0.01, 0.005), ("Cm_de", "reference_airspeed")),
)
