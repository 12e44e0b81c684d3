"""A recorder that shows the input later than the vehicle felt it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, late_times
from sim.effects.instances import all_labelled, further_inputs, labelled
from sim.effects.timing import moved_ahead
from sim.maths import each_column


@dataclass(frozen=True)
class InputRecordedLate:
    """The vehicle felt the input ``delay`` seconds before the record shows it: it gets u(t +
    delay).

    ``delay`` in s, not negative: the delay of the other sign. What the vehicle felt in the last
    ``delay`` seconds the record never showed: the last value is held there, and where the input
    still moves the outputs of these samples are wrong, the load factor most. It needs the future:
    no filter takes it, not even with a delay that is held. On the low-order equivalent system it is
    not offered: there it is a smaller ``delay`` of the model itself.
    """

    signal: str = "elevator"
    label: str = ""

    station: ClassVar[Station] = Station.INPUT_PATH
    rank: ClassVar[int] = 90
    commutes: ClassVar[bool] = True
    anticipates: ClassVar[bool] = True
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", 0.05, "s", bounds=(0.0, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"delay": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "The channel of the input is slower than the others: u_record(t) = u_vehicle(t - delay), "
        "so that the vehicle gets u_record(t + delay), "
        "delay >= 0. A filter before the recorder, a bus or a clock of its own do this. The "
        "aircraft seems to answer before it is asked, which no "
        "lag, actuator or delay can imitate, since these are all late; late sensors hide it, and "
        "if all of them are late by the same time nothing "
        "is left to see. A record whose input moves between its samples but is read as held looks "
        "late by half the interval. What came after the "
        "record's end is unknown: its last value is held, so let the input rest there."
    )

    @property
    def name(self) -> str:
        return labelled("input-recorded-late", self.label)

    @property
    def aliases(self) -> tuple[str, ...]:
        return ()

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {control} is recorded {delay} late",),
            short_name="input recorded late",
            twins=all_labelled(("input-delay",), self.label),
            plausible={"delay": (0.0, 0.4)},
            within_interval="delay",
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"delay": time}) for time in late_times(context)]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Mean of the shifted input over each cell, exact for an input that is constant within
        cells.
        """
        edges = np.asarray(edges, dtype=float)
        return each_column(lambda row, delay: moved_ahead(edges, row, delay), u, p.delay)


VARIANTS: tuple[Traceable, ...] = (InputRecordedLate(),)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One for each input that has none yet."""
    return tuple(
        InputRecordedLate(signal.name, label) for signal, label in further_inputs(equations)
    )
