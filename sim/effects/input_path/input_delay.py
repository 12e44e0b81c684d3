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
from sim.maths import each_column


def delayed_means(edges: np.ndarray, u: np.ndarray, delay: Any) -> np.ndarray:
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


def advanced_means(edges: np.ndarray, u: np.ndarray, delay: Any) -> np.ndarray:
    """Return the means of u(t + delay) over each cell: ``delayed_means`` with time reversed.

    After the last edge the last value holds.
    """
    return delayed_means(-edges[::-1], u[::-1], delay)[::-1]


class _Shift(OfInput):
    """Base of the two delays: one parameter ``delay``, which is not negative."""

    path_order: ClassVar[int] = 90
    commutes: ClassVar[bool] = True
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", 0.05, "s", bounds=(0.0, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"delay": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    plausible: ClassVar[Mapping[str, tuple[float, float]]] = {"delay": (0.0, 0.4)}

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"delay": time}) for time in delays_to_try(context)]


@dataclass(frozen=True)
class InputDelay(_Shift):
    """Delay of the input: u_vehicle(t) = u(t - delay), where u is the recorded input.

    ``delay`` is in s, not negative. Before the begin of the record the first value holds. A delay
    has no state form of finite order, so that filters need a fixed delay.

    A delay commutes with effects that do not depend on time. It acts last on the input path,
    because a dead band or a rate limit behind it would not be smooth in the delay of a step within
    a cell.

    Attributes
    ----------
    signal : name of the input.
    in_vehicle_model : whether the delay belongs to the vehicle's model (the low-order equivalent
        system, a multirotor). The full name of its parameter is then ``delay``, and delays of other
        inputs have the same parameter.
    label : suffix of the effect's name, where the vehicle has several inputs.
    """

    signal: str = "elevator"
    in_vehicle_model: bool = False
    label: str = ""

    family: ClassVar[str] = "input-delay"
    explanation: ClassVar[str] = (
        "Dead time of the input: the control surface follows the recorded command late, "
        "u_vehicle(t) = u_record(t - delay), delay >= 0. Causes are computing frames, data buses "
        "and time skew between recorders. Every response is late by the same time, whatever its "
        "shape, so the effect is largest where the input moves fast. A slow record cannot "
        "distinguish a delay from an actuator lag with a time constant equal to the delay."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("actuator-lag", "actuator-rate-limit"), self.label)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the aircraft responds {delay} after the recorded {control}",),
            short_name="delay",
            plausible=self.plausible,
            twins=all_labelled(("input-recorded-late", "actuator-second-order"), self.label),
        )

    @property
    def shared(self) -> bool:
        """Whether delays of other inputs may have the same parameter."""
        return self.in_vehicle_model

    def rename(self, local: str) -> str:
        """Return the full name of a parameter, whose name in the effect is ``local``."""
        return local if self.in_vehicle_model else f"{self.name}.{local}"

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the mean of the shifted input over each cell.

        At a delay of zero, its bound, the derivative is that towards longer delays.
        """
        edges = np.asarray(edges, dtype=float)
        return each_column(lambda row, delay: delayed_means(edges, row, delay), u, p.delay)


@dataclass(frozen=True)
class RecordedInputDelay(_Shift):
    """The input is recorded late: u_vehicle(t) = u(t + delay), where u is the recorded input.

    ``delay`` is in s, not negative; the effect is an input delay of opposite sign. The input of the
    last ``delay`` seconds is not in the record, and its last value is used there. If the input
    still moves there, the outputs of these samples are wrong, most of all the load factor. The
    effect needs future inputs, so no filter can use it. It is not offered for the low-order
    equivalent system, where it is the same as a smaller ``delay`` of the model.
    """

    signal: str = "elevator"
    label: str = ""

    family: ClassVar[str] = "input-recorded-late"
    anticipates: ClassVar[bool] = True
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "The input is recorded late: u_record(t) = u_vehicle(t - delay), so that the vehicle gets "
        "u_record(t + delay), delay >= 0. Causes are a filter before the recorder, a slow data bus "
        "or a separate clock. The aircraft seems to respond before the command. Lags, actuators "
        "and input delays cannot imitate this, since they all make the response later. Late "
        "sensors compensate the effect; if all outputs are late by the same time, it is not "
        "observable. If the input moves between samples but is read as held, it looks late by half "
        "the sampling interval. The input after the end of the record is unknown and held at its "
        "last value, so the input should be at rest there."
    )

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {control} is recorded {delay} late",),
            short_name="input recorded late",
            twins=all_labelled(("input-delay",), self.label),
            plausible=self.plausible,
            within_interval="delay",
        )

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the mean of the shifted input over each cell, exact for an input that is constant
        within cells.
        """
        edges = np.asarray(edges, dtype=float)
        return each_column(lambda row, delay: advanced_means(edges, row, delay), u, p.delay)


VARIANTS: tuple[Traceable, ...] = (InputDelay("elevator"), RecordedInputDelay())


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return the effects of this file for each input that ``VARIANTS`` does not cover."""
    return for_inputs(
        equations,
        lambda signal, label: InputDelay(signal.name, label=label),
        lambda signal, label: RecordedInputDelay(signal.name, label),
    )
