"""A pure delay between the recorded input and the vehicle, and its opposite, an input that is
recorded later than the vehicle felt it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, delays_to_try
from sim.effects.instances import all_labelled, for_inputs, labelled
from sim.effects.loads import moved_ahead, moved_back
from sim.maths import each_column


@dataclass(frozen=True)
class InputDelay:
    """The vehicle feels an input ``delay`` seconds after the record shows it: u(t) -> u(t - delay).

    ``delay`` in s, not negative. Before the record's start the first value holds. It has no state
    form of finite order: a filter takes it only with a delay that is held. It commutes with all
    effects that do not know the time, and stands last on the path: a cell that holds part of a jump
    would else make dead band and rate limit uneven in the delay. With ``own_name`` the delay
    belongs to the vehicle's model (the low-order equivalent system, a multirotor) and its full name
    is plain ``delay``, shared with the delays of other inputs.
    """

    signal: str = "elevator"
    own_name: bool = False
    label: str = ""

    station: ClassVar[Station] = Station.INPUT_PATH
    rank: ClassVar[int] = 90
    commutes: ClassVar[bool] = True
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", 0.05, "s", bounds=(0.0, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"delay": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "The control surface follows the recorded command after a dead time: u_vehicle(t) = "
        "u_record(t - delay), delay >= 0. Computing frames, "
        "data buses and time skew between recorders do this. Every response is late by the same "
        "time, whatever its shape, so the effect shows most "
        "where the input moves fast. A slow record cannot tell it from an actuator lag with a time "
        "constant equal to the delay."
    )

    @property
    def name(self) -> str:
        return labelled("input-delay", self.label)

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("actuator-lag", "actuator-rate-limit"), self.label)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the aircraft responds {delay} after the recorded {control}",),
            short_name="delay",
            plausible={"delay": (0.0, 0.4)},
            twins=all_labelled(("input-recorded-late", "actuator-second-order"), self.label),
        )

    @property
    def shared(self) -> bool:
        """Whether delays of other inputs may have the same parameter."""
        return self.own_name

    def rename(self, local: str) -> str:
        """Full name of a parameter."""
        return local if self.own_name else f"{self.name}.{local}"

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"delay": time}) for time in delays_to_try(context)]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Mean of the shifted input over each cell; at no delay the derivative is the one towards
        longer delays, as the bound asks.
        """
        edges = np.asarray(edges, dtype=float)
        return each_column(lambda row, delay: moved_back(edges, row, delay), u, p.delay)


@dataclass(frozen=True)
class RecordedInputDelay:
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
        return [Probe({"delay": time}) for time in delays_to_try(context)]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Mean of the shifted input over each cell, exact for an input that is constant within
        cells.
        """
        edges = np.asarray(edges, dtype=float)
        return each_column(lambda row, delay: moved_ahead(edges, row, delay), u, p.delay)


VARIANTS: tuple[Traceable, ...] = (InputDelay("elevator"), RecordedInputDelay())


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Both for each input that has none yet."""
    return for_inputs(
        equations,
        lambda signal, label: InputDelay(signal.name, label=label),
        lambda signal, label: RecordedInputDelay(signal.name, label),
    )
