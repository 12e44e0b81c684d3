"""Shared parts of effects: edges in time, the reading of a displaced vane, added loads with their
parameters by port, and smooth curves of a load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import SearchContext, Traits
from sim.effects.instances import ProbedAtAbsence, WithoutStates
from sim.maths import clip, combine, natural_shapes, once_for_alike, shape_names

# ---- Events at a time

USUAL_SUB_STEP = 0.01  # s
SLOW_WIDTH = 0.1  # s, width of an edge for bodies that are tracked over minutes


def risen(time: Any, at: Any, width: float) -> Any:
    """Return a step with a ramp, from 0 before the time ``at`` to 1 after it, s.

    The ramp lasts ``width`` s and is centred on ``at``. If ``width`` is a multiple of the sub-step
    of an integration, the integral does not depend on the position of ``at`` between sub-steps.
    """
    return once_for_alike(lambda at: clip((time - at) / width + 0.5, 0.0, 1.0), at)


def edge_width(interval: float, usual: float = USUAL_SUB_STEP) -> float:
    """Return the sub-step of a fit, s: the largest integer fraction of a sampling ``interval`` that
    is at most ``usual``.
    """
    return interval / max(1, math.ceil(interval / usual - 1e-6)) if interval > 0 else usual


# ---- Reading of a vane away from the centre of gravity due to rotation


def at_arm(s: Any, vehicle: Any, arm: Any, rate: str, speed: str) -> Any:
    """Return (arm/V) rate, the change of a displaced vane's reading by rotation, rad.

    Parameters
    ----------
    s, vehicle : signals, and constants of the equations.
    arm : distance of the vane from the centre of gravity, m.
    rate : name of the angular rate.
    speed : name of the constant that is V, for equations without a varying airspeed.
    """
    V = s.V if hasattr(s, "V") else getattr(vehicle, speed)
    return arm / V * getattr(s, rate)


class DisplacedVane(ProbedAtAbsence):
    """Base of vanes at a distance ``arm`` from the centre of gravity, in m, which is not negative.

    A subclass has the fields ``channel``, ``rate`` (angular rate in the plane of the vane),
    ``sign`` of the contribution of the rate, and ``speed`` (name of the constant that is the
    airspeed, for equations without a varying airspeed).
    """

    channel: str
    rate: str
    sign: float
    speed: str

    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("arm", 5.0, "m", bounds=(0.0, 100.0)),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"arm": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.speed,)

    @property
    def states_read(self) -> tuple[str, ...]:
        return (self.rate,)

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        added = at_arm(s, vehicle, self.sign * p.arm, self.rate, self.speed)
        return {self.channel: y[self.channel] + added}


# ---- Added loads: parameters named after the ports they add to

LOADS = ("lift", "moment")
# Last sentences of the explanation of a catch-all term.
NO_CAUSE = (
    "This term does not represent a cause of the library. If it explains a record better than "
    "every effect, the cause is none of these effects."
)


def in_words(ports: Sequence[str]) -> str:
    """Return the names of ports in words, such as ``"side force and yaw"``."""
    return " and ".join(port.replace("_", " ") for port in ports)


class SizedOnPorts:
    """Base of terms with one size for each port to which they add.

    The size parameter has the name of the port. The term is absent if all sizes are zero.
    """

    ports: tuple[str, ...]

    @property
    def needs(self) -> tuple[str, ...]:
        return self.ports

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(self.ports, 0.0))


def load_parameters(
    sizes: Sequence[float], units: Sequence[str], ports: Sequence[str] = LOADS
) -> tuple[Parameter, ...]:
    """Return a parameter for each port, with the name of the port, a usual size and a unit."""
    return tuple(
        Parameter(name, size, unit) for name, size, unit in zip(ports, sizes, units, strict=True)
    )


# ---- Nonlinear load over the angle of attack

_LARGEST_SHAPE = 30.0  # largest plausible size of a shape, in usual sizes


@dataclass(frozen=True)
class LoadCurve(WithoutStates, ProbedAtAbsence):
    """A nonlinear load: ``port`` += f(alpha), or f(beta) for loads of sideslip.

    f is a natural cubic spline over ``[low, high]`` with f(0) = f'(0) = 0, because the slope at
    zero is the declared derivative. Outside the range f is linear. f = sum of ``shape1`` ... times
    orthonormal shapes (`sim.maths`). Each parameter is the root mean square that its shape adds
    over the range, in the unit of the port: a coefficient on the rigid aircraft, 1/s of alpha_dot
    or 1/s2 of q_dot on the low-order equivalent system. The angle is in rad and includes the gust.

    Attributes
    ----------
    port : port to which the load is added.
    name, short_name, explanation : see `sim.declaration.effect.Effect` and `Traits`.
    load : the load in words, as the begin of a sentence.
    unit, size : unit and usual size of the load.
    needs_constants : constants that the equations must have.
    angle, flown : signal of the angle, and output that shows its range.
    middle : middle of the range, from which a total angle is counted.
    total : whether the angle is a total value instead of a perturbation.
    low, high : range of the angle in the record, rad.
    fine : use nine shapes instead of four; the first four are the same.
    """

    port: str
    name: str
    load: str
    short_name: str
    explanation: str
    unit: str
    size: float
    needs_constants: tuple[str, ...]
    low: float = -0.15
    high: float = 0.15
    fine: bool = False
    angle: str = "alpha_air"
    flown: str = "alpha"
    middle: float = 0.0
    total: bool = False

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.port,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        # The prior regularises shapes at angles that the model does not reach: with a wrong reading
        # of the angle, its range is smaller than that of the record.
        names = enumerate(shape_names(self.fine))
        return tuple(
            Parameter(
                name,
                self.size / (1.0 + i),
                self.unit,
                prior_std=_LARGEST_SHAPE * self.size / (1.0 + i),
            )
            for i, name in names
        )

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(shape_names(self.fine), 0.0))

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                f"{self.load} is not linear in the angle of "
                f"{'attack' if self.flown == 'alpha' else 'sideslip'}",
            ),
            short_name=self.short_name,
            plausible=dict.fromkeys(
                shape_names(self.fine), (-_LARGEST_SHAPE * self.size, _LARGEST_SHAPE * self.size)
            ),
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        angle = getattr(s, self.angle)
        angle = angle - self.middle if self.total else angle
        shapes = natural_shapes(self.low - self.middle, self.high - self.middle, self.fine)
        return {self.port: combine(shapes, angle, p)}

    def fitted_to(self, context: SearchContext) -> LoadCurve:
        """Return the effect over the range of angles of the record."""
        low, high = context.flown_range(self.flown) or (self.low, self.high)
        middle = 0.5 * (low + high) if self.total else 0.0
        return replace(self, low=low, high=high, middle=middle)

    def finer(self) -> LoadCurve:
        """Return the refined form, with five more shapes."""
        return replace(self, fine=True)
