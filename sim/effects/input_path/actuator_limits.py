"""A limit of the rate or of the travel between the recorded input and the vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, shares_of_peak
from sim.effects.instances import MANY_SIZES, all_labelled, for_inputs, labelled, sized
from sim.maths import absolute, clip, each_column, maximum

UNLIMITED_RATE = 1e9
# peaks of the input run through in a second: from hardly felt to always behind
PER_SECOND = (20.0, 9.0, 4.0, 2.0, 0.9)
HALF_AND_TWICE = (
    "the same maneuver at half and at twice the size: only a rate limit makes large inputs later "
    "than small ones"
)
# cells behind on one side from which it is worth following the surface many cells at a time
_LONG = 16


@dataclass(frozen=True)
class ActuatorRateLimit:
    """The surface runs towards the held command with ``rate`` at most, in unit of the input per
    second, and stops there.

    At ``UNLIMITED_RATE`` it is taken as absent. It starts at the first recorded value. The rate is
    not a smooth function of where the surface is: there is no state form, a filter takes it only
    with a rate that is held.

    Attributes
    ----------
    signal, unit : the input it acts on. typical : the starting value, unless not ``sized``. label :
    of the name, where there are several inputs.
    """

    signal: str = "elevator"
    unit: str = "rad"
    typical: float = 0.3
    label: str = ""
    sized: bool = True

    station: ClassVar[Station] = Station.INPUT_PATH
    rank: ClassVar[int] = 50
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"rate": UNLIMITED_RATE})
    regularity: ClassVar[Regularity] = Regularity.INACTIVE
    explanation: ClassVar[str] = (
        "The surface can move only so fast: |dy/dt| <= rate, towards the command until y = u. A "
        "commanded step becomes a ramp whose length grows "
        "with the step, so that large inputs arrive later than small ones; a lag or a delay treats "
        "all sizes alike, and steps of one size cannot "
        "tell the three apart. Under large fast inputs the surface never reaches the command, and "
        "amplitude is lost as well as time. A record in "
        "which the command never moves faster than the limit shows nothing of it."
    )

    @property
    def name(self) -> str:
        return labelled("actuator-rate-limit", self.label)

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("input-delay", "actuator-lag"), self.label)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("rate", self.typical, f"{self.unit}/s", bounds=(1e-6, UNLIMITED_RATE)),)

    @property
    def traits(self) -> Traits:
        """Believed from a thirtieth to ten times the typical value: for an elevator from half a
        degree to some 170 degrees a second.
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
            for rate in shares_of_peak(context, self.signal, PER_SECOND)
            if 0.0 < rate < fastest
        ]

    def fitted_to(self, context: SearchContext) -> ActuatorRateLimit:
        """The same; where nothing is known of the input's unit, of a size that its record asks
        for.
        """
        peak = context.input_peak.get(self.signal, 0.0)
        return self if self.sized or not peak > 0.0 else replace(self, typical=3.0 * peak)

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Mean of the exact response over each cell, for an input that is constant within cells;
        loops only while the surface is behind.

        While the command stands, the distance to it shrinks from d to max(d - rate h, 0) over a
        cell of length h; its mean is d - rate h/2, or d^2/(2 rate h) where the surface arrives
        within the cell.
        """
        edges = np.asarray(edges, dtype=float)
        return each_column(lambda u, rate: _limited(edges, u, rate), u, p.rate)


def _limited(edges: np.ndarray, u: np.ndarray, rate: Any) -> np.ndarray:
    if rate.real >= UNLIMITED_RATE:
        return u
    starts = np.concatenate([[0], np.flatnonzero(u[1:] != u[:-1]) + 1])
    begin = edges[starts]
    start = _distances(u[starts], rate * np.diff(begin, append=edges[-1]))
    count = np.diff(starts, append=len(u))
    left = maximum(
        np.repeat(absolute(start), count) - rate * (edges[:-1] - np.repeat(begin, count)), 0.0
    )
    way = rate * np.diff(edges)
    mean = np.where(left.real >= way.real, left - 0.5 * way, left * left / (2.0 * way))
    return u + np.repeat(np.where(start.real < 0, -1.0, 1.0), count) * mean


def _distances(commands: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """How far the surface is from each command as it is given; ``ways`` are the most it moves
    before the next.
    """
    # Where it has arrived it is as far as the two commands are apart: the loop runs only while it
    # is behind.
    distances = np.append(commands[:1], commands[:-1]) - commands + 0.0 * ways
    reach, done, last = ways.real, 0, len(commands) - 1
    # a list of all would take longer than the loop
    target, most, most_real = commands.item, ways.item, reach.item
    for first in np.flatnonzero(np.abs(distances.real) > reach).tolist():
        if first < done:
            continue
        done, distance, begun, side = first, distances[first].item(), first, 0.0
        while done < last and abs(distance.real) > most_real(done):
            if (now := 1.0 if distance.real > 0.0 else -1.0) != side:
                begun, side = done, now
            if done - begun == _LONG:
                path = _one_way(commands, ways, done, distance, side)
                distances[done + 1 : done + 1 + len(path)] = path
                done, distance, begun = done + len(path), path[-1].item(), done + len(path)
                continue
            distance = target(done) + (distance - side * most(done)) - target(done + 1)
            done += 1
            distances[done] = distance
    return distances


def _one_way(
    commands: np.ndarray, ways: np.ndarray, start: int, distance: Any, side: float
) -> np.ndarray:
    """The distances after a cell, all at once, of a surface that is behind on one side, as far as
    it arrives or is overtaken: one at least.
    """
    length, last = 2 * _LONG, len(commands) - 1
    while True:
        stop = min(start + length, last)
        path = distance + np.cumsum(
            commands[start:stop] - commands[start + 1 : stop + 1] - side * ways[start:stop]
        )
        over = np.flatnonzero(side * path.real <= ways.real[start + 1 : stop + 1])
        if len(over) or stop == last:
            return path[: over[0] + 1] if len(over) else path
        length *= 4


UNLIMITED_TRAVEL = 1e9


@dataclass(frozen=True)
class ActuatorSaturation:
    """The vehicle feels max(-limit, min(u, limit)): the same limit on both sides of trim.

    ``limit`` in the unit of the input; at ``UNLIMITED_TRAVEL`` it is taken as absent. Without
    memory: the state form has no states.

    Attributes
    ----------
    signal, unit : the input it acts on. typical : the starting value, unless not ``sized``. label :
    of the name, where there are several inputs.
    """

    signal: str = "elevator"
    unit: str = "rad"
    typical: float = 0.05
    label: str = ""
    sized: bool = True

    station: ClassVar[Station] = Station.INPUT_PATH
    rank: ClassVar[int] = 60
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"limit": UNLIMITED_TRAVEL})
    regularity: ClassVar[Regularity] = Regularity.INACTIVE
    online_states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The surface stops at a limit although the command goes on: u_vehicle = max(-limit, min(u, "
        "limit)). Below the limit nothing is different, "
        "above it more command brings no more response. It is invisible in a record that stays "
        "below the limit, and where all inputs are of one "
        "size it only looks like a smaller control effectiveness: it takes inputs of several "
        "sizes, on both sides of the limit. The limit counts "
        "from where the recorded input does: from trim where that is a perturbation, from its zero "
        "where it is a total."
    )

    @property
    def name(self) -> str:
        return labelled("actuator-saturation", self.label)

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("input-deadband", "control-nonlinearity"), self.label)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("limit", self.typical, self.unit, bounds=(0.0, UNLIMITED_TRAVEL)),)

    @property
    def traits(self) -> Traits:
        """Believed from a tenth to ten times the typical value: for an elevator from a third of a
        degree to half a right angle.
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

    def fitted_to(self, context: SearchContext) -> ActuatorSaturation:
        """The same; where nothing is known of the input's unit, of a size that its record asks
        for.
        """
        peak = context.input_peak.get(self.signal, 0.0)
        return self if self.sized or not peak > 0.0 else replace(self, typical=0.5 * peak)

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Exact for an input that is constant within cells."""
        return each_column(lambda row, limit: clip(row, -limit, limit), u, p.limit)

    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]:
        return ()

    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any:
        return clip(v, -p.limit, p.limit)


VARIANTS: tuple[Traceable, ...] = (
    ActuatorRateLimit(),
    ActuatorRateLimit("stick", "1", 3.0),
    ActuatorSaturation(),
    ActuatorSaturation("stick", "1", 0.5),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Both for each input that has none yet."""
    return for_inputs(equations, sized(ActuatorRateLimit, 3.0), sized(ActuatorSaturation, 0.5))
