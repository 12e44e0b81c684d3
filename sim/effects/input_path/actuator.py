"""Actuators between the recorded input and the vehicle: of first or second order, or with a limit
of rate or travel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Signal
from sim.declaration.model import Equations
from sim.declaration.proposal import (
    Probe,
    SearchContext,
    Traceable,
    Traits,
    delays_to_try,
    shares_of_peak,
)
from sim.effects.instances import (
    MANY_SIZES,
    OfInput,
    SizedOnInput,
    all_labelled,
    for_inputs,
    has_typical_size,
    sized,
)
from sim.maths import (
    absolute,
    clip,
    each_column,
    exp,
    linear_recurrence,
    maximum,
    real,
    sqrt,
    where,
)

# s, longest plausible lag of an input that is not a surface deflection, as of an engine or a valve
LONGEST_LAG = 5.0
# s, usual lag of engines: longer for turbofans near idle, shorter for propellers
USUAL_ENGINE_LAG = 1.0
OVERSHOOT = (
    "quick inputs (short doublets, or a sweep beyond the actuator's frequency): only an actuator "
    "of second order overshoots"
)


@dataclass(frozen=True)
class ActuatorLag(OfInput):
    """First-order lag: the surface y follows the recorded command u, y_dot = (u - y)/time_constant.

    At the start y = u. ``time_constant`` is in s, not negative; at zero y = u. The differential
    equation that a filter uses (``rates``) is stiff for a lag much shorter than the step.

    Attributes
    ----------
    signal, unit : name and unit of the input.
    label : suffix of the effect's name, where the vehicle has several inputs.
    model_parameter : full name of the time constant, if the vehicle model declares the lag itself.
        Lags of several inputs may have the same one.
    """

    signal: str = "elevator"
    unit: str = "rad"
    label: str = ""
    model_parameter: str = ""

    family: ClassVar[str] = "actuator-lag"
    path_order: ClassVar[int] = 40
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("time_constant", 0.08, "s", bounds=(0.0, 5.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"time_constant": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "First-order lag of an actuator: the surface y follows the command u with time_constant "
        "dy/dt = u - y. The response to a step is an exponential that has covered two thirds of "
        "the way after one time constant. The response to a slow input is only late by the time "
        "constant, that to a fast input is late and too small. Causes are a servo valve or a "
        "command filter. A slow record cannot distinguish a lag from a delay of the same length. "
        "Steps that are sampled fast can, since a delay does not change their shape. Large and "
        "small steps take the same time, unlike with a rate limit."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("input-delay", "actuator-rate-limit"), self.label)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the actuator follows the {control} with a lag of {time_constant}",),
            short_name="actuator lag",
            separating={
                "input-delay": (
                    "quick inputs (short doublets, or a sweep up to the inverse of the lag): a lag "
                    "loses amplitude there, a delay does not"
                )
            },
            plausible={"time_constant": (0.0, 0.5 if has_typical_size(self.unit) else LONGEST_LAG)},
            usual={} if has_typical_size(self.unit) else {"time_constant": USUAL_ENGINE_LAG},
            # Another form of the same fault; only one of the two is claimed.
            twins=all_labelled(("actuator-second-order",), self.label),
        )

    @property
    def shared(self) -> bool:
        """Whether lags of other inputs may have the same parameter."""
        return bool(self.model_parameter)

    def rename(self, local: str) -> str:
        """Return the full name of a parameter, whose name in the effect is ``local``."""
        return self.model_parameter or f"{self.name}.{local}"

    @property
    def online_states(self) -> tuple[Signal, ...]:
        return (Signal(f"actuator_{self.signal}", self.unit, f"{self.signal} after its actuator"),)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"time_constant": time}) for time in delays_to_try(context)]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the mean of the exact response over each cell, for an input that is constant
        within cells.

        With E = exp(-h/T): y(h) = u + (y0 - u) E, and its mean is u - (u - y0) (T/h) (1 - E).
        """
        h = np.diff(edges)
        return each_column(lambda row, lag: _lagged(h, row, lag), u, p.time_constant)

    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]:
        acts = real(p.time_constant) > 0
        return (where(acts, (v - x[0]) / where(acts, p.time_constant, 1.0), 0.0 * x[0]),)

    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any:
        return where(real(p.time_constant) > 0, x[0], v)


def _lagged(h: np.ndarray, u: np.ndarray, lag: Any) -> np.ndarray:
    # ``reached`` is 1 - E, which is one without a lag. The factor T/h keeps the imaginary part of a
    # complex lag, so that the one-sided derivative at zero is right.
    reached = -np.expm1(-h / lag) if lag.real > 0 else np.ones_like(h)
    y = linear_recurrence(1.0 - reached, reached * u, u[0])
    return u - (u - y[:-1]) * (lag / h * reached)


UNLIMITED = 1e9  # rad/s, frequency at which the effect is absent
# Largest damping. The ratio of the two poles is then 34, and any record shows only a lag.
MOST_DAMPED = 3.0
SERVO_DAMPING = 0.7  # damping of a well-made servo
# Trial values, rad/s. From one of the two, a fit reaches all frequencies.
FREQUENCIES = (45.0, 15.0)


@dataclass(frozen=True)
class ActuatorSecondOrder(OfInput):
    """Second-order actuator: the surface d follows the recorded command u, d_ddot = frequency^2 (u
    - d) - 2 damping frequency d_dot.

    At the start d = u. ``frequency`` is in rad/s; at ``UNLIMITED`` the effect is absent and d = u.
    ``damping`` is positive, without unit. With much damping the effect is a lag of 2
    damping/frequency, and with a high frequency a delay of this length. Lag and delay are simpler,
    and preferred if they fit as well. The effect is not offered for the low-order equivalent
    system, whose own lag and delay represent all parts between stick and surface.
    """

    signal: str = "elevator"
    unit: str = "rad"
    label: str = ""

    family: ClassVar[str] = "actuator-second-order"
    path_order: ClassVar[int] = 40
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("frequency", 20.0, "rad/s", bounds=(0.5, UNLIMITED)),
        Parameter("damping", 0.5, "1", bounds=(0.02, MOST_DAMPED)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"frequency": UNLIMITED})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    explanation: ClassVar[str] = (
        "Second-order actuator: the surface d follows the command u with d_ddot = frequency^2 (u - "
        "d) - 2 damping frequency d_dot. The cause is the inertia of the surface with the "
        "stiffness of its servo. The response to a step has a rounded beginning; with low damping "
        "it overshoots and oscillates. Slow inputs arrive late by 2 damping/frequency, as with a "
        "lag or a delay of this length. Inputs near the actuator's frequency arrive too large with "
        "low damping and too small with high damping. Steps that are sampled fast distinguish the "
        "actuator from a lag or a delay; a slow record does not."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        # With low damping it equals a structural mode driven by the control.
        return (*all_labelled(("actuator-lag", "input-delay"), self.label), "elastic-mode")

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "the actuator follows the {control} as an oscillator of {frequency} "
                "({frequency_hertz}), damping {damping}",
            ),
            short_name="actuator of second order",
            separating=dict.fromkeys(("actuator-lag", "input-delay"), OVERSHOOT),
            twins=all_labelled(("actuator-lag", "input-delay"), self.label),
            oscillates=("frequency",),
            plausible={
                "frequency": (3.0 if has_typical_size(self.unit) else 0.3, 200.0),
                "damping": (0.1, MOST_DAMPED),
            },
        )

    @property
    def online_states(self) -> tuple[Signal, ...]:
        return (
            Signal(f"actuator_{self.signal}", self.unit, f"{self.signal} after its actuator"),
            Signal(f"actuator_{self.signal}_rate", f"{self.unit}/s", "its rate"),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe well-damped actuators, at frequencies that the sampling resolves."""
        fastest = 3.0 / context.interval
        tried = [frequency for frequency in FREQUENCIES if frequency < fastest] or FREQUENCIES[-1:]
        return [Probe({"frequency": frequency, "damping": SERVO_DAMPING}) for frequency in tried]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the mean of the exact response over each cell, for an input that is constant
        within cells.
        """
        h = np.diff(edges)
        return each_column(
            lambda row, frequency, damping: _followed(h, row, frequency, damping),
            u,
            p.frequency,
            p.damping,
        )

    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]:
        acts = real(p.frequency) < UNLIMITED
        frequency = where(acts, p.frequency, 0.0)
        return where(acts, x[1], 0.0 * x[1]), frequency * (
            frequency * (v - x[0]) - 2.0 * p.damping * x[1]
        )

    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any:
        return where(real(p.frequency) < UNLIMITED, x[0], v)


def _followed(h: np.ndarray, u: np.ndarray, frequency: Any, damping: Any) -> np.ndarray:
    """Return the means ``(n,)`` of the surface d over cells of lengths ``h (n,)``, s.

    The integral of d over a cell follows from the differential equation: u h - [d_dot + 2 damping
    frequency d] / frequency^2, where the bracket is the difference between the ends of the cell.
    """
    if frequency.real >= UNLIMITED:
        return u
    from scipy.linalg.lapack import dtbtrs, ztbtrs

    sizes, place = np.unique(h, return_inverse=True)
    (a, b), (c, e) = _transition(sizes, frequency, damping)[:, :, place]
    n, complex_ = len(u), np.iscomplexobj(a) or np.iscomplexobj(u)
    # The unknowns are d and d_dot at one edge after the other. Each pair depends on the pair before
    # it, so that the matrix is a triangular band of width three.
    band = np.zeros((4, 2 * n + 2), dtype=complex if complex_ else float)
    right = np.zeros(2 * n + 2, dtype=complex if complex_ else float)
    band[0] = 1.0
    band[2, 0 : 2 * n : 2], band[1, 1 : 2 * n : 2] = -a, -b
    band[3, 0 : 2 * n : 2], band[2, 1 : 2 * n : 2] = -c, -e
    right[0], right[2::2], right[3::2] = u[0], (1.0 - a) * u, -c * u
    y = (ztbtrs if complex_ else dtbtrs)(band, right[:, None], uplo="L", diag="U")[0][:, 0]
    bracket = np.diff(y[1::2]) + 2.0 * damping * frequency * np.diff(y[::2])
    return np.asarray(u - bracket / (frequency * frequency * h))


# Largest |r^2| in `_transition` for which four terms of the series are exact to rounding.
SERIES_LIMIT = 1e-3


def _transition(h: np.ndarray, frequency: Any, damping: Any) -> np.ndarray:
    """Return the transition matrices ``(2, 2, n)`` over cells of lengths ``h``, exact for any
    damping.

    The state is the distance from the command and its rate. With r^2 = (damping^2 - 1) frequency^2
    h^2 the elements contain exp(-damping frequency h) times cosh r and sinh(r)/r.
    """
    square = (damping * damping - 1.0) * (frequency * h) ** 2
    near = np.abs(square) < SERIES_LIMIT
    # Both functions are even in r. Near r = 0 the root has no derivative, and a series is used.
    r = sqrt(np.where(near, SERIES_LIMIT, square).astype(complex))
    decay = damping * frequency * h
    slow, fast = exp(r - decay), exp(-r - decay)
    C = np.where(
        near,
        exp(-decay) * (1.0 + square / 2.0 * (1.0 + square / 12.0 * (1.0 + square / 30.0))),
        0.5 * (slow + fast),
    )
    S = (
        np.where(
            near,
            exp(-decay) * (1.0 + square / 6.0 * (1.0 + square / 20.0 * (1.0 + square / 42.0))),
            0.5 * (slow - fast) / r,
        )
        * h
    )
    own = damping * frequency * S
    out = np.array([[C + own, S], [-frequency * frequency * S, C - own]])
    return out if isinstance(frequency, complex) or isinstance(damping, complex) else out.real


UNLIMITED_RATE = 1e9  # rate at which the effect is absent
# Trial rates, in input peaks per second: from hardly noticeable to always limiting.
RATES_PER_PEAK = (20.0, 9.0, 4.0, 2.0, 0.9)
HALF_AND_TWICE = (
    "the same maneuver at half and at twice the size: only a rate limit makes large inputs later "
    "than small ones"
)
# Once the surface has stayed on one side of the command for so many cells, further cells are
# computed in batches.
_CELLS_BEFORE_BATCH = 16


@dataclass(frozen=True)
class ActuatorRateLimit(SizedOnInput):
    """Rate limit: the surface moves towards the command at most at ``rate``, in the input's unit
    per second.

    At ``UNLIMITED_RATE`` the effect is absent. The surface starts at the first recorded value. Its
    speed is not a smooth function of its position. The effect therefore has no differential
    equation (``rates``), and a filter can use it with a fixed rate only.
    """

    typical: float = 0.3

    family: ClassVar[str] = "actuator-rate-limit"
    typical_share_of_peak: ClassVar[float] = 3.0
    path_order: ClassVar[int] = 50
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"rate": UNLIMITED_RATE})
    regularity: ClassVar[Regularity] = Regularity.INACTIVE
    explanation: ClassVar[str] = (
        "Rate limit of an actuator: the surface y moves with |dy/dt| <= rate, towards the command "
        "u until y = u. The response to a commanded step is a ramp whose length is proportional to "
        "the step. Large inputs therefore arrive later than small ones. A lag or a delay acts "
        "alike on inputs of all sizes, so steps of one size cannot distinguish the three. With "
        "large fast inputs the surface never reaches the command, and the amplitude is reduced as "
        "well. If the command never moves faster than the limit, the record does not show it."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("input-delay", "actuator-lag"), self.label)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("rate", self.typical, f"{self.unit}/s", bounds=(1e-6, UNLIMITED_RATE)),)

    @property
    def traits(self) -> Traits:
        """Traits of the effect.

        A rate is plausible from a thirtieth to ten times the typical value, for an elevator from
        half a degree to about 170 degrees per second.
        """
        return Traits(
            sentences=("the actuator moves no faster than {rate}",),
            short_name="actuator rate limit",
            separating=dict.fromkeys(("input-delay", "actuator-lag"), HALF_AND_TWICE),
            plausible={"rate": (self.typical / 30.0, 10.0 * self.typical)},
            in_input_unit=("rate",),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        fastest = context.input_rate.get(self.signal, 0.0)
        return [
            Probe({"rate": rate})
            for rate in shares_of_peak(context, self.signal, RATES_PER_PEAK)
            if 0.0 < rate < fastest
        ]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the mean of the exact response over each cell, for an input that is constant
        within cells.

        While the command is constant, the distance from it falls from d to max(d - rate h, 0) over
        a cell of length h. Its mean is d - rate h/2, or d^2/(2 rate h) if the surface arrives
        within the cell.
        """
        edges = np.asarray(edges, dtype=float)
        return each_column(lambda u, rate: _limited(edges, u, rate), u, p.rate)


def _limited(edges: np.ndarray, u: np.ndarray, rate: Any) -> np.ndarray:
    if rate.real >= UNLIMITED_RATE:
        return u
    changed_at = np.concatenate([[0], np.flatnonzero(u[1:] != u[:-1]) + 1])
    change_times = edges[changed_at]
    initial_distances = _distances(u[changed_at], rate * np.diff(change_times, append=edges[-1]))
    count = np.diff(changed_at, append=len(u))
    since_change = edges[:-1] - np.repeat(change_times, count)
    left = maximum(np.repeat(absolute(initial_distances), count) - rate * since_change, 0.0)
    travel = rate * np.diff(edges)
    # Mean distance over a cell, if the surface does not arrive within it, and if it does.
    mean = np.where(left.real >= travel.real, left - 0.5 * travel, left * left / (2.0 * travel))
    return u + np.repeat(np.where(initial_distances.real < 0, -1.0, 1.0), count) * mean


def _distances(commands: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Return the distance of the surface from each command at the time of the command.

    ``ways`` are the largest travels of the surface before the next command.
    """
    # After the surface has arrived, the distance is the change of the command. So the loop only
    # runs while the surface lags.
    distances = np.append(commands[:1], commands[:-1]) - commands + 0.0 * ways
    reach, done, last = ways.real, 0, len(commands) - 1
    # Single items are taken, because a list of all values would take longer than the loop.
    target, most, most_real = commands.item, ways.item, reach.item
    for first in np.flatnonzero(np.abs(distances.real) > reach).tolist():
        if first < done:
            continue
        done, distance, first_behind, side = first, distances[first].item(), first, 0.0
        while done < last and abs(distance.real) > most_real(done):
            if (now := 1.0 if distance.real > 0.0 else -1.0) != side:
                first_behind, side = done, now
            if done - first_behind == _CELLS_BEFORE_BATCH:
                path = _lagging_run(commands, ways, done, distance, side)
                distances[done + 1 : done + 1 + len(path)] = path
                done, distance, first_behind = done + len(path), path[-1].item(), done + len(path)
                continue
            distance = target(done) + (distance - side * most(done)) - target(done + 1)
            done += 1
            distances[done] = distance
    return distances


def _lagging_run(
    commands: np.ndarray, ways: np.ndarray, start: int, distance: Any, side: float
) -> np.ndarray:
    """Return the distance at the end of each cell, from cell ``start`` on, as long as the surface
    stays on one side of the command.

    The last value is that of the cell in which the surface arrives. There is at least one value.
    """
    length, last = 2 * _CELLS_BEFORE_BATCH, len(commands) - 1
    while True:
        stop = min(start + length, last)
        path = distance + np.cumsum(
            commands[start:stop] - commands[start + 1 : stop + 1] - side * ways[start:stop]
        )
        over = np.flatnonzero(side * path.real <= ways.real[start + 1 : stop + 1])
        if len(over) or stop == last:
            return path[: over[0] + 1] if len(over) else path
        length *= 4


UNLIMITED_TRAVEL = 1e9  # limit of travel at which the effect is absent


@dataclass(frozen=True)
class ActuatorSaturation(SizedOnInput):
    """Travel limit: the vehicle's input is max(-limit, min(u, limit)), on both sides of trim.

    ``limit`` is in the unit of the input; at ``UNLIMITED_TRAVEL`` the effect is absent. The effect
    has no memory, and therefore no states in a filter.
    """

    typical: float = 0.05

    family: ClassVar[str] = "actuator-saturation"
    typical_share_of_peak: ClassVar[float] = 0.5
    path_order: ClassVar[int] = 60
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"limit": UNLIMITED_TRAVEL})
    regularity: ClassVar[Regularity] = Regularity.INACTIVE
    online_states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Travel limit of an actuator: u_vehicle = max(-limit, min(u, limit)). Below the limit the "
        "response is unchanged. Above it a larger command gives no larger response. A record that "
        "stays below the limit does not show the effect. Inputs of a single size only show a "
        "smaller control effectiveness, so inputs of several sizes, on both sides of the limit, "
        "are needed. The limit counts from the zero of the recorded input, which is trim if the "
        "input is a perturbation."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("input-deadband", "control-nonlinearity"), self.label)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("limit", self.typical, self.unit, bounds=(0.0, UNLIMITED_TRAVEL)),)

    @property
    def traits(self) -> Traits:
        """Traits of the effect.

        A limit is plausible from a tenth to ten times the typical value, for an elevator from 0.3
        to 30 degrees.
        """
        return Traits(
            sentences=("the actuator stops at +-{limit}",),
            short_name="actuator stop",
            separating={"input-deadband": MANY_SIZES, "control-nonlinearity": MANY_SIZES},
            plausible={"limit": (0.1 * self.typical, 10.0 * self.typical)},
            in_input_unit=("limit",),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [
            Probe({"limit": size})
            for size in shares_of_peak(context, self.signal, (0.95, 0.85, 0.7, 0.5))
        ]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the input behind the effect; exact for an input that is constant within cells."""
        return each_column(lambda row, limit: clip(row, -limit, limit), u, p.limit)

    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]:
        return ()

    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any:
        return clip(v, -p.limit, p.limit)


VARIANTS: tuple[Traceable, ...] = (
    ActuatorLag(),
    ActuatorSecondOrder(),
    ActuatorRateLimit(),
    ActuatorRateLimit("stick", "1", 3.0),
    ActuatorSaturation(),
    ActuatorSaturation("stick", "1", 0.5),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return all four effects for each input that ``VARIANTS`` does not cover."""
    return for_inputs(
        equations,
        lambda signal, label: ActuatorLag(signal.name, signal.unit, label),
        lambda signal, label: ActuatorSecondOrder(signal.name, signal.unit, label),
        sized(ActuatorRateLimit, 3.0),
        sized(ActuatorSaturation, 0.5),
    )
