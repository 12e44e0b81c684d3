"""A first-order lag between the recorded input and the vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, late_times
from sim.effects.instances import all_labelled, further_inputs, has_size, labelled
from sim.maths import each_column, linear_recurrence, real, where

SLOWEST = 5.0  # s, of what is no surface: an engine, a valve


@dataclass(frozen=True)
class ActuatorLag:
    """The surface y follows the recorded command u as y_dot = (u - y)/time_constant, settled at the
    start.

    ``time_constant`` in s, not negative; at zero y = u. The state form is stiff for a lag much
    shorter than the step. With ``own_name`` the lag belongs to the vehicle's model, and that is the
    full name of its parameter, shared with other inputs' lags.
    """

    signal: str = "elevator"
    unit: str = "rad"
    label: str = ""
    own_name: str = ""

    station: ClassVar[Station] = Station.INPUT_PATH
    rank: ClassVar[int] = 40
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("time_constant", 0.08, "s", bounds=(0.0, 5.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"time_constant": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "The surface follows the command with a first-order lag: time_constant dy/dt = u - y. A "
        "step arrives as an exponential, through two thirds "
        "after one time constant, a slow input merely late by that time, a fast one late and too "
        "small. A servo valve or a command filter does "
        "this. A slow record cannot tell it from a pure delay of the same length; steps sampled "
        "fast can, since a delay lets them pass as steps. "
        "Large and small steps take the same time, unlike with a rate limit."
    )

    @property
    def name(self) -> str:
        return labelled("actuator-lag", self.label)

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
            plausible={"time_constant": (0.0, 0.5 if has_size(self.unit) else SLOWEST)},
            twins=all_labelled(("actuator-second-order",), self.label),
        )

    @property
    def shared(self) -> bool:
        """Whether lags of other inputs may have the same parameter."""
        return bool(self.own_name)

    def rename(self, local: str) -> str:
        """Full name of a parameter."""
        return self.own_name or f"{self.name}.{local}"

    @property
    def online_states(self) -> tuple[Signal, ...]:
        return (Signal(f"actuator_{self.signal}", self.unit, f"{self.signal} behind its actuator"),)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"time_constant": time}) for time in late_times(context)]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Mean of the exact response over each cell, for an input that is constant within cells.

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
    # Without a lag E = 0, while the factor T/h carries a derivative towards positive lags.
    reached = -np.expm1(-h / lag) if lag.real > 0 else np.ones_like(h)
    y = linear_recurrence(1.0 - reached, reached * u, u[0])
    return u - (u - y[:-1]) * (lag / h * reached)


VARIANTS: tuple[Traceable, ...] = (ActuatorLag(),)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One for each input that has none yet."""
    return tuple(
        ActuatorLag(signal.name, signal.unit, label) for signal, label in further_inputs(equations)
    )
