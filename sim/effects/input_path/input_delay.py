"""A pure delay between the recorded input and the vehicle, and a delay of the recorded input
itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, delays_to_try
from sim.effects.instances import OfInput, all_labelled, for_inputs
from sim.effects.loads import moved_ahead, moved_back
from sim.maths import each_column


@dataclass(frozen=True)
class InputDelay(OfInput):
    """Delay of the input: u_vehicle(t) = u(t - delay), where u is the recorded input.

    ``delay`` is in s, not negative. Before the begin of the record the first value holds. A delay
    has no state form of finite order, so that filters need a fixed delay. It commutes with effects
    that do not depend on time, and acts last on the input path: dead band and rate limit would not
    be smooth in the delay of a step within a cell. With ``in_vehicle_model`` the delay belongs to
    the vehicle's model (the low-order equivalent system, a multirotor): the full name of its
    parameter is ``delay``, and delays of other inputs have the same parameter.
    """

    signal: str = "elevator"
    in_vehicle_model: bool = False
    label: str = ""

    family: ClassVar[str] = "input-delay"
    path_order: ClassVar[int] = 90
    commutes: ClassVar[bool] = True
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", 0.05, "s", bounds=(0.0, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"delay": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "The control surface follows the recorded command after a dead time: u_vehicle(t) = "
        "u_record(t - delay), delay >= 0. Computing frames, data buses and time skew between "
        "recorders do this. Every response is late by the same time, whatever its shape, so the "
        "effect shows most where the input moves fast. A slow record cannot tell it from an "
        "actuator lag with a time constant equal to the delay."
    )

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
        return self.in_vehicle_model

    def rename(self, local: str) -> str:
        """Return the full name of a parameter, whose name in the effect is ``local``."""
        return local if self.in_vehicle_model else f"{self.name}.{local}"

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"delay": time}) for time in delays_to_try(context)]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the mean of the shifted input over each cell.

        At a delay of zero, its bound, the derivative is that towards longer delays.
        """
        edges = np.asarray(edges, dtype=float)
        return each_column(lambda row, delay: moved_back(edges, row, delay), u, p.delay)


@dataclass(frozen=True)
class RecordedInputDelay(OfInput):
    """The input is recorded late: u_vehicle(t) = u(t + delay), where u is the recorded input.

    ``delay`` is in s, not negative; it is an input delay of opposite sign. The input of the last
    ``delay`` seconds is not in the record. The last value is used there, so that outputs of these
    samples, the load factor most, are wrong if the input still moves. The effect needs future
    inputs, so that no filter can use it. It is not offered for the low-order equivalent system,
    where it equals a smaller ``delay`` of the model.
    """

    signal: str = "elevator"
    label: str = ""

    family: ClassVar[str] = "input-recorded-late"
    path_order: ClassVar[int] = 90
    commutes: ClassVar[bool] = True
    anticipates: ClassVar[bool] = True
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", 0.05, "s", bounds=(0.0, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"delay": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "The channel of the input is slower than the others: u_record(t) = u_vehicle(t - delay), "
        "so that the vehicle gets u_record(t + delay), delay >= 0. A filter before the recorder, a "
        "bus or a clock of its own do this. The aircraft seems to answer before it is asked, which "
        "no lag, actuator or delay can imitate, since these are all late; late sensors hide it, "
        "and if all of them are late by the same time nothing is left to see. A record whose input "
        "moves between its samples but is read as held looks late by half the interval. What came "
        "after the record's end is unknown: its last value is held, so let the input rest there."
    )

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
        """Return the mean of the shifted input over each cell, exact for an input that is constant
        within cells.
        """
        edges = np.asarray(edges, dtype=float)
        return each_column(lambda row, delay: moved_ahead(edges, row, delay), u, p.delay)


VARIANTS: tuple[Traceable, ...] = (InputDelay("elevator"), RecordedInputDelay())


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return the effects of this file for each input that ``VARIANTS`` does not cover."""
    return for_inputs(
        equations,
        lambda signal, label: InputDelay(signal.name, label=label),
        lambda signal, label: RecordedInputDelay(signal.name, label),
    )
