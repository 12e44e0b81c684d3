"""Rows that the recorder lost without a gap in the time column: all states jump at one row."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traits
from sim.effects.loads import USUAL_SUB_STEP
from sim.maths import absolute, maximum, once_for_alike

_USUAL_JUMP = {"rad": 0.05, "rad/s": 0.1, "m/s": 10.0, "m": 300.0, "1": 0.1}
MOST_STATES = 13  # those of a rigid body in three dimensions, with a quaternion


@dataclass(frozen=True)
class LostRows:
    """At ``start`` (s) each state jumps by its change during the lost rows.

    The states after the gap depend on inputs that were not recorded. The jump of each state is
    therefore a parameter, with the name and unit of the state. In equations without inputs the
    motion during the gap is known, and the only parameter is the time ``lost`` (s).

    Attributes
    ----------
    moved : names and units of the states of the equations.
    sizes : usual jumps, in these units: half the range of a state in the record.
    free : True for equations without inputs.
    width : half the duration of a jump, s; a jump lasts one sampling interval. If a fit makes one
        sub-step in an interval (100 Hz and more), the jumps are accurate to a third only.
    """

    moved: tuple[tuple[str, str], ...]
    sizes: tuple[float, ...]
    free: bool = False
    width: float = USUAL_SUB_STEP

    name: ClassVar[str] = "lost-rows"
    station: ClassVar[Station] = Station.SENSOR_PATH
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    explanation: ClassVar[str] = (
        "Rows of the record are lost. The time column has no gap. Causes are a logger that counts "
        "on from the last row it wrote, or times that were made afterwards from a sampling rate. "
        "At one row the whole motion jumps by its change during the lost time: each state after "
        "start = the state before it + its jump. A force cannot do this, because it changes rates, "
        "and not angles at once. A wrong sensor cannot do it either: only its own channel would "
        "jump, and the later motion would not follow from the new values. For a body without "
        "inputs the lost time can be estimated. The remedy is to give the parts before and after "
        "as two segments, or to restore the times."
    )
    traits: ClassVar[Traits] = Traits(
        sentences=(
            "rows of {lost} are lost at {start} without a gap in the times of the record",
            "rows of the record are lost at {start} without a gap in its times: the motion jumps "
            "({rest})",
        ),
        onset="start",
        per_record=True,
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        """Effects that usual records do not distinguish from this one.

        In a short period, a load of lift and moment that is shorter than two samples changes alpha
        and q at once.
        """
        return ("unmeasured-input",) if self.states_read[:2] == ("alpha", "q") else ()

    @property
    def states_read(self) -> tuple[str, ...]:
        return tuple(name for name, _ in self.moved)

    @property
    def sized(self) -> tuple[str, ...]:
        """Parameters that are zero if no rows are lost."""
        return ("lost",) if self.free else self.states_read

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        start = Parameter("start", 2.0037, "s")
        if self.free:
            return (start, Parameter("lost", 0.5, "s", bounds=(0.0, math.inf)))
        jumps = (
            Parameter(name, size, unit)
            for (name, unit), size in zip(self.moved, self.sizes, strict=True)
        )
        return (start, *jumps)

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(self.sized, 0.0))

    def added_rates(self, s: Any, rates: Sequence[Any], p: Any) -> Mapping[str, Any]:
        """Return the rate to add to each state: its jump times a triangular pulse of unit area,
        which sub-steps of ``width`` integrate exactly.
        """
        rise = once_for_alike(
            lambda start: maximum(1.0 - absolute((s.time - start) / self.width), 0.0) / self.width,
            p.start,
        )
        if self.free:
            return {
                name: rise * p.lost * rate
                for name, rate in zip(self.states_read, rates, strict=False)
            }
        return {name: rise * getattr(p, name) for name in self.states_read}

    def fitted_to(self, context: SearchContext) -> LostRows:
        """Return the effect with jumps within one sampling interval; the usual jump is half the
        range of each state that the record shows.
        """
        sizes = []
        for name, size in zip(self.states_read, self.sizes, strict=True):
            shown = context.flown_range(name)
            half = 0.5 * (shown[1] - shown[0]) if shown else 0.0
            sizes.append(half if half > 0.0 else size)
        return replace(self, width=0.5 * context.interval or self.width, sizes=tuple(sizes))

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe all jumps at the begin of the record; later ones only shift the response."""
        values = {"start": context.begin + self.width, **self.absent}
        return (Probe(values, self.sized, shifts=True, sharp=True),)


def _lost_rows(states: Sequence[Signal], free: bool) -> LostRows:
    moved = tuple((signal.name, signal.unit) for signal in states)
    return LostRows(moved, tuple(_USUAL_JUMP.get(unit, 1.0) for _, unit in moved), free)


VARIANTS: tuple[LostRows, ...] = (
    _lost_rows((Signal("alpha", "rad"), Signal("q", "rad/s")), free=False),
)


def made_for(equations: Equations) -> tuple[LostRows, ...]:
    """Return the effect on all states of the equations; none beyond ``MOST_STATES`` states."""
    if len(equations.states) > MOST_STATES:
        return ()
    return (_lost_rows(equations.states, free=not equations.inputs),)
