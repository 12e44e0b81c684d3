"""Shared parts of effects: the course of a gust, the reading of a displaced vane, and added loads
with their parameters by port, the lift that carries the weight, and smooth curves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traits
from sim.maths import G0, clip, combine, cos, natural_shapes, once_for_alike, shape_names

# ---- A single gust of one-minus-cosine shape

SHAPES = ("shape1", "shape2", "shape3")
PLAUSIBLE: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"peak": (-20.0, 20.0), "duration": (0.1, 20.0)}
)
DURATIONS = (0.25, 0.5, 1.0, 2.0, 4.0)  # s, gusts that a search tries


def gust_parameters(fine: bool) -> tuple[Parameter, ...]:
    """``peak`` and three shapes where ``fine``, m/s; ``start`` and ``duration``, s."""
    shapes = tuple(
        Parameter(name, 0.3, "m/s", bounds=(-50.0, 50.0)) for name in (SHAPES if fine else ())
    )
    return (
        Parameter("peak", 3.0, "m/s", bounds=(-50.0, 50.0)),
        Parameter("start", 2.0, "s"),
        Parameter("duration", 1.0, "s", bounds=(0.05, 60.0)),
        *shapes,
    )


def calm_air(fine: bool) -> Mapping[str, float]:
    """Values at which there is no gust."""
    return MappingProxyType(dict.fromkeys(("peak", *(SHAPES if fine else ())), 0.0))


def gust_speed(time: Any, p: Any, lasting: bool, fine: bool) -> Any:
    """w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)), m/s, zero outside the gust; with
    ``lasting`` the first half, and then the peak.

    With ``fine`` + the sum of ``shape1`` ... ``shape3`` times sin(k pi x), x from 0 to 1 over the
    gust, or over its rise, less what would change the peak. ``time`` in s; ``p`` has the parameters
    of ``gust_parameters``.
    """
    end = 0.5 if lasting else 1.0

    def passed(start: Any, duration: Any) -> Any:
        return clip((time - start) / duration, 0.0, end)

    def course(start: Any, duration: Any) -> Any:
        return 0.5 * (1.0 - cos(2.0 * math.pi * passed(start, duration)))

    def shape(k: int, start: Any, duration: Any) -> Any:
        # Less what it has in the middle of a gust that passes: the peak stays the speed there.
        middle = 0.0 if lasting else (0.0, 1.0, 0.0, -1.0)[k]
        swing = cos(math.pi * (k * passed(start, duration) / end - 0.5))
        return swing - middle * course(start, duration) if middle else swing

    gust = p.peak * once_for_alike(course, p.start, p.duration)
    for k, name in enumerate(SHAPES if fine else (), start=1):
        gust = gust + getattr(p, name) * once_for_alike(partial(shape, k), p.start, p.duration)
    return gust


def gust_probes(context: SearchContext, fine: bool) -> Sequence[Probe]:
    """Slope by the peak of a gust at the record's begin, for some durations; a later start only
    shifts it.
    """
    durations = [
        duration
        for duration in DURATIONS
        if 4.0 * context.interval <= duration <= 0.5 * context.duration
    ]
    return tuple(
        Probe(
            {**calm_air(fine), "start": context.begin, "duration": duration}, ("peak",), shifts=True
        )
        for duration in durations
    )


# ---- What a vane away from the centre of gravity reads of the turning of the aircraft


def at_arm(s: Any, vehicle: Any, arm: Any, rate: str, speed: str) -> Any:
    """(arm/V) rate, rad: V the airspeed at the time, or the declared one of equations without;
    ``arm`` in m, ``rate`` and ``speed`` by name.
    """
    V = s.V if hasattr(s, "V") else getattr(vehicle, speed)
    return arm / V * getattr(s, rate)


# ---- Added loads: parameters named after the ports they add to

LOADS = ("lift", "moment")


class SizedOnPorts:
    """What terms share that have one size for each port that they load: a parameter of the port's
    name, absent where all are zero.
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
    """One parameter for each of some ports, named after it, with a usual size in its unit."""
    return tuple(
        Parameter(name, size, unit) for name, size, unit in zip(ports, sizes, units, strict=True)
    )


# Coefficients by port, of the aircraft and of the low-order equivalent system.
_COEFFICIENTS = {
    "lift": ("CL", "L"),
    "moment": ("Cm", "M"),
    "side_force": ("CY",),
    "roll": ("Cl",),
    "yaw": ("Cn",),
}
# The signal that a derivative of the built-in models multiplies, by what stands behind its
# underscore; and that end, by the signal on the bus.
MULTIPLIED = {
    **{"alpha": "alpha", "q": "q", "V": "airspeed", "beta": "beta", "p": "p", "r": "r"},
    **{"de": "elevator", "da": "aileron", "dr": "rudder", "delta": "delta"},
}
_ENDS = {signal: end for end, signal in MULTIPLIED.items()} | {
    "alpha_air": "alpha",
    "q_hat": "q",
    "beta_air": "beta",
    "p_hat": "p",
    "r_hat": "r",
}


def weight_lift(
    change: Any, vehicle: Any, airspeed_change: Any = 0.0, density_change: Any = 0.0
) -> Any:
    """Increment of the port ``lift`` where the airspeed changes by ``change`` (m/s) and surfaces
    and attitude stay as in trim.

    About level flight nz gains qbar/qbar_0 - 1 and alpha_dot loses (g/V) (qbar/qbar_0 - 1), V the
    changed airspeed. On equations with a mass ``lift`` is a coefficient, m g0/S (1/qbar_0 -
    1/qbar); on those with a dimensional lift it is that rate of alpha, 1/s, negative where the
    aircraft is faster. qbar_0 holds at the declared airspeed and density.

    Parameters
    ----------
    change : m/s, above what the ports hold already. vehicle : constants of the equations.
    airspeed_change, density_change : m/s and kg/m3, what the ports of these names hold before;
    their own lift is not counted here.
    """
    V = vehicle.airspeed + airspeed_change
    if hasattr(vehicle, "mass"):
        density = vehicle.air_density
        loading = 2.0 * vehicle.mass * G0 / (vehicle.wing_area * (density + density_change))
        # The share of qbar_0 drops out: m g0/S (1/qbar_before - 1/qbar_after).
        return loading * (1.0 / (V * V) - 1.0 / ((V + change) * (V + change)))
    return _excess(V, vehicle) - _excess(V + change, vehicle)


def _excess(V: Any, vehicle: Any) -> Any:
    """(g/V) (qbar/qbar_0 - 1), 1/s, at constant density."""
    return vehicle.gravity / V * (V * V / (vehicle.airspeed * vehicle.airspeed) - 1.0)


# ---- A load that is no straight line of the angle of attack

_WIDEST = 30.0  # usual sizes up to which a shape is believed


@dataclass(frozen=True)
class LoadCurve:
    """``port`` += f(alpha), f a natural cubic spline over ``[low, high]`` with f(0) = f'(0) = 0; of
    sideslip, f(beta).

    f = sum of ``shape1`` ... times orthonormal shapes (`sim.maths`): each is the root mean square
    that its shape adds over the range, in the port's unit: a coefficient on the rigid aircraft, 1/s
    of alpha_dot or 1/s2 on the low-order equivalent system. alpha in rad, the gust included;
    outside the range f goes on straight. The slope at zero stays with the declared derivative.

    Attributes
    ----------
    port : what it adds to. name, load, short_name, explanation : of the effect; ``load`` as a
    sentence begins with it. unit, size : of what is added, and a usual one. needs_constants : those
    of the equations it is written for. angle, flown : what it is a curve of, and the output that
    shows its range. middle : of that range, from which f counts where the angle
        is a ``total``.
    low, high : the flown range, rad. fine : nine shapes instead of four, the first four the same.
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
    states: ClassVar[tuple[Signal, ...]] = ()

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.port,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        # What the model does not reach must not run away: beside an angle that is read wrong it
        # flies less than the record shows.
        names = enumerate(shape_names(self.fine))
        return tuple(
            Parameter(
                name, self.size / (1.0 + i), self.unit, prior_std=_WIDEST * self.size / (1.0 + i)
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
                shape_names(self.fine), (-_WIDEST * self.size, _WIDEST * self.size)
            ),
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        at = getattr(s, self.angle)
        at = at - self.middle if self.total else at
        return {
            self.port: combine(
                natural_shapes(self.low - self.middle, self.high - self.middle, self.fine), at, p
            )
        }

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> LoadCurve:
        """The same over the range of angles that the record flew."""
        low, high = context.flown_range(self.flown) or (self.low, self.high)
        middle = 0.5 * (low + high) if self.total else 0.0
        return replace(self, low=low, high=high, middle=middle)

    def finer(self) -> LoadCurve:
        """The same with five finer shapes."""
        return replace(self, fine=True)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by all shapes where there is none."""
        return (Probe(self.absent, shape_names(self.fine)),)
