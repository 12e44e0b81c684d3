"""Shared parts of effects: shifts and edges in time, the course of a gust, the reading of a
displaced vane, added loads with their parameters by port, and smooth curves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traits
from sim.maths import G0, clip, combine, cos, natural_shapes, once_for_alike, shape_names, trailing

# ---- Earlier values of a channel, for sensors with a delay

# s; a jump at a sample is spread over this time, as a delayed input is by its cells.
JUMP_SPREAD_TIME = 0.001


def each_run_earlier(
    steps: Any, begin: Any, end: Any, shown: Callable[..., Any], *values: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of a channel at the earlier times ``shown(edges, *values)``.

    The channel is linear from ``begin`` to ``end`` of each sub-step. Before the start its first
    value holds. A jump at an edge is spread linearly over the ``JUMP_SPREAD_TIME`` before it, so
    that outputs are continuous in the delay.

    Parameters
    ----------
    steps, begin, end : ``(M,)``, ``(M + 1, ...)`` and ``(M, ...)`` as in ``SensorEffect.act``.
    shown : function of the edges ``(M + 1,)``, s from the record's start, and of ``values``, that
        returns the time shown at each edge.
    values : parameters of a run, which broadcast with the batch axes. Runs with equal values are
        computed together.
    """
    begin, end, steps = np.asarray(begin), np.asarray(end), np.asarray(steps)
    given = [np.asarray(value) for value in values]
    shape = np.broadcast_shapes(*(value.shape for value in given), begin.shape[1:], end.shape[1:])
    begin, end = (
        np.broadcast_to(trailing(row, len(shape)), (len(row), *shape)).reshape(len(row), -1)
        for row in (begin, end)
    )
    runs = [np.broadcast_to(value, shape).reshape(-1) for value in given]
    edges = np.concatenate([[0.0], np.cumsum(steps)])
    out = np.empty((2, *begin.shape), dtype=np.result_type(begin, end, *given))
    groups: dict[tuple[Any, ...], list[int]] = {}
    for column, run in enumerate(zip(*(row.tolist() for row in runs), strict=True)):
        groups.setdefault(run, []).append(column)
    for run, alike in groups.items():  # most runs of a batch are equal
        out[0][:, alike], out[1][:, alike] = _earlier(
            edges, steps, begin[:, alike], end[:, alike], shown(edges, *run)
        )
    return out[0].reshape(-1, *shape), out[1, 1:].reshape(-1, *shape)


def _earlier(
    edges: np.ndarray, steps: np.ndarray, begin: np.ndarray, end: np.ndarray, then: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of c runs just after and just before the times ``then (M + 1,)``, s.

    ``begin`` is ``(M + 1, c)`` and ``end`` ``(M, c)``. Times after the end are set to the end.
    """
    then = np.where(then.real > edges[-1], edges[-1], then)
    # Each earlier time lies in sub-step k, its end included; before the first sub-step k = -1.
    k = np.searchsorted(edges, then.real, side="left") - 1
    inside, k = (k >= 0)[:, None], np.maximum(k, 0)
    gap = (edges[k + 1] - then)[:, None]
    after, before = begin[k + 1], end[k]
    ramp = gap * ((end - begin[:-1]) / steps[:, None])[k]
    aperture = np.minimum(JUMP_SPREAD_TIME, steps[k])[:, None]
    spread = np.where(
        gap.real < aperture, after - ramp - gap / aperture * (after - before), before - ramp
    )
    first = begin[:1]
    return np.where(inside, spread, first), np.where(inside, before - ramp, first)


# ---- Events at a time

USUAL_SUB_STEP = 0.01  # s, one usual sub-step
SLOW_WIDTH = 0.1  # s, for bodies tracked over minutes


def risen(time: Any, at: Any, width: float) -> Any:
    """Return a step with a ramp: 0 before the time ``at``, 1 after it, s.

    The ramp lasts ``width`` s and is centred on ``at``. If ``width`` is a multiple of the sub-step
    of an integration, the integral does not depend on the position of ``at`` between sub-steps.
    """
    return once_for_alike(lambda at: clip((time - at) / width + 0.5, 0.0, 1.0), at)


def edge_width(interval: float, usual: float = USUAL_SUB_STEP) -> float:
    """Return the sub-step of a fit, s: the largest integer fraction of a sampling ``interval`` that
    is at most ``usual``.
    """
    return interval / max(1, math.ceil(interval / usual - 1e-6)) if interval > 0 else usual


# ---- An input that is shifted in time, as means over cells


def moved_back(edges: np.ndarray, u: np.ndarray, delay: Any) -> np.ndarray:
    """Return the means of u(t - delay) over each cell ``(n,)``.

    They are exact for an input that is constant within cells. Before the first edge the first value
    holds. A cell that is shifted by the delay begins in cell j and ends in cell k. Its mean is
    computed as u[k] plus contributions of the cells before k, so that a delay of zero returns u
    exactly. If the shifted edge is an edge of a cell, the derivative is that towards longer delays.

    Parameters
    ----------
    edges : ``(n + 1,)``, boundaries of the cells, s, increasing.
    u : ``(n,)``, mean of the input over each cell.
    delay : s, not negative; may be complex.
    """
    width, last = np.diff(edges), len(u) - 1
    area = np.concatenate([np.zeros(1), np.cumsum(u * width)])
    cell = np.searchsorted(edges, edges - delay.real, side="left") - 1
    j, k = np.clip(cell[:-1], -1, last), np.clip(cell[1:], -1, last)
    first, final = u[np.maximum(j, 0)], np.maximum(k, 0)
    at_final = u[final]
    next_edge = edges[j + 1]
    between = area[final] - area[j + 1] - at_final * (edges[final] - next_edge)
    excess = between + (first - at_final) * (next_edge - (edges[:-1] - delay))
    return np.asarray(at_final + np.where(k > j, excess, 0.0) / width)


def moved_ahead(edges: np.ndarray, u: np.ndarray, delay: Any) -> np.ndarray:
    """Return the means of u(t + delay), as ``moved_back`` with time reversed.

    After the last edge the last value holds.
    """
    return moved_back(-edges[::-1], u[::-1], delay)[::-1]


# ---- A single gust of one-minus-cosine shape

SHAPES = ("shape1", "shape2", "shape3")
PLAUSIBLE: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"peak": (-20.0, 20.0), "duration": (0.1, 20.0)}
)
DURATIONS = (0.25, 0.5, 1.0, 2.0, 4.0)  # s, gusts that a search tries


def gust_parameters(fine: bool) -> tuple[Parameter, ...]:
    """Return the parameters of a gust: ``peak`` and, if ``fine``, three shapes, m/s; ``start`` and
    ``duration``, s.
    """
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
    """Return the parameter values at which there is no gust."""
    return MappingProxyType(dict.fromkeys(("peak", *(SHAPES if fine else ())), 0.0))


def gust_speed(time: Any, p: Any, lasting: bool, fine: bool) -> Any:
    """Return the speed of a gust, w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)), m/s.

    Parameters
    ----------
    time : s.
    p : parameters of ``gust_parameters``.
    lasting : whether the gust keeps its peak after its first half; else it is zero outside.
    fine : add the sum of ``shape1`` ... ``shape3`` times sin(k pi x), where x runs from 0 to 1 over
        the gust or its rise, minus the contribution of each shape at the peak.
    """
    end = 0.5 if lasting else 1.0

    def passed(start: Any, duration: Any) -> Any:
        return clip((time - start) / duration, 0.0, end)

    def course(start: Any, duration: Any) -> Any:
        return 0.5 * (1.0 - cos(2.0 * math.pi * passed(start, duration)))

    def shape(k: int, start: Any, duration: Any) -> Any:
        # Minus its value in the middle of a passing gust: the peak remains the speed there.
        middle = 0.0 if lasting else (0.0, 1.0, 0.0, -1.0)[k]
        swing = cos(math.pi * (k * passed(start, duration) / end - 0.5))
        return swing - middle * course(start, duration) if middle else swing

    gust = p.peak * once_for_alike(course, p.start, p.duration)
    for k, name in enumerate(SHAPES if fine else (), start=1):
        gust = gust + getattr(p, name) * once_for_alike(partial(shape, k), p.start, p.duration)
    return gust


def gust_probes(context: SearchContext, fine: bool) -> Sequence[Probe]:
    """Return probes of the peak of a gust at the begin of the record, for some durations.

    A later start only shifts the response.
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


# ---- Reading of a vane away from the centre of gravity due to rotation


def at_arm(s: Any, vehicle: Any, arm: Any, rate: str, speed: str) -> Any:
    """Return (arm/V) rate, the change of a vane's reading by rotation, rad.

    Parameters
    ----------
    s, vehicle : signals, and constants of the equations.
    arm : distance of the vane from the centre of gravity, m.
    rate : name of the angular rate.
    speed : name of the constant that is V if the equations have no state of airspeed.
    """
    V = s.V if hasattr(s, "V") else getattr(vehicle, speed)
    return arm / V * getattr(s, rate)


# ---- Added loads: parameters named after the ports they add to

LOADS = ("lift", "moment")


class SizedOnPorts:
    """Base of terms with one size for each port to which they add.

    The parameter has the name of the port. The term is absent if all sizes are zero.
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


_COEFFICIENTS = {  # Coefficients by port, of the aircraft and of the low-order equivalent system.
    "lift": ("CL", "L"),
    "moment": ("Cm", "M"),
    "side_force": ("CY",),
    "roll": ("Cl",),
    "yaw": ("Cn",),
}
# Signal multiplied by a derivative of the built-in models, by the suffix of its name; and the
# suffix by signal.
MULTIPLIED = {
    "alpha": "alpha",
    "q": "q",
    "V": "airspeed",
    "beta": "beta",
    "p": "p",
    "r": "r",
    "de": "elevator",
    "da": "aileron",
    "dr": "rudder",
    "delta": "delta",
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
    """Return the increment of the port ``lift`` by a change of the airspeed at trim.

    The lift that carries the weight follows the dynamic pressure qbar, with surfaces and attitude
    at trim. About level flight nz gains qbar/qbar_0 - 1 and alpha_dot loses (g/V) (qbar/qbar_0 -
    1), where V is the changed airspeed and qbar_0 the pressure at the declared airspeed and
    density. In equations with a mass the port is a coefficient, and its increment m g0/S (1/qbar_0
    - 1/qbar). In equations with a dimensional lift it is the change of alpha_dot, 1/s, negative for
    a faster aircraft.

    Parameters
    ----------
    change : change of the airspeed, m/s, in addition to ``airspeed_change``.
    vehicle : constants of the equations.
    airspeed_change, density_change : m/s and kg/m3, values of the ports of these names; their lift
        is not part of the result.
    """
    V = vehicle.airspeed + airspeed_change
    if hasattr(vehicle, "mass"):
        density = vehicle.air_density
        loading = 2.0 * vehicle.mass * G0 / (vehicle.wing_area * (density + density_change))
        # The share of qbar_0 drops out: m g0/S (1/qbar_before - 1/qbar_after).
        return loading * (1.0 / (V * V) - 1.0 / ((V + change) * (V + change)))
    return _excess(V, vehicle) - _excess(V + change, vehicle)


def _excess(V: Any, vehicle: Any) -> Any:
    """Return (g/V) (qbar/qbar_0 - 1), 1/s, at constant density."""
    return vehicle.gravity / V * (V * V / (vehicle.airspeed * vehicle.airspeed) - 1.0)


# ---- Nonlinear load over the angle of attack

_WIDEST = 30.0  # largest plausible size of a shape, in usual sizes


@dataclass(frozen=True)
class LoadCurve:
    """A nonlinear load: ``port`` += f(alpha), or f(beta) for loads of sideslip.

    f is a natural cubic spline over ``[low, high]`` with f(0) = f'(0) = 0, because the slope at
    zero belongs to the declared derivative; it is linear outside the range. f = sum of ``shape1``
    ... times orthonormal shapes (`sim.maths`). Each parameter is the root mean square that its
    shape adds over the range, in the unit of the port: a coefficient on the rigid aircraft, 1/s of
    alpha_dot or 1/s2 on the low-order equivalent system. The angle is in rad and includes the gust.

    Attributes
    ----------
    port : port to which the load is added.
    name, short_name, explanation : as of every effect.
    load : the load in words, as the begin of a sentence.
    unit, size : unit and usual size of the load.
    needs_constants : constants that the equations must have.
    angle, flown : signal of the angle, and output that shows its range.
    middle : middle of the range, from which f counts if the angle is a ``total``.
    total : whether the angle is a total value and no perturbation.
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
    states: ClassVar[tuple[Signal, ...]] = ()

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
        angle = getattr(s, self.angle)
        angle = angle - self.middle if self.total else angle
        shapes = natural_shapes(self.low - self.middle, self.high - self.middle, self.fine)
        return {self.port: combine(shapes, angle, p)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> LoadCurve:
        """Return the effect over the range of angles of the record."""
        low, high = context.flown_range(self.flown) or (self.low, self.high)
        middle = 0.5 * (low + high) if self.total else 0.0
        return replace(self, low=low, high=high, middle=middle)

    def finer(self) -> LoadCurve:
        """Return the refined form, with five more shapes."""
        return replace(self, fine=True)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe the slopes by all shapes at absence."""
        return (Probe(self.absent, shape_names(self.fine)),)
