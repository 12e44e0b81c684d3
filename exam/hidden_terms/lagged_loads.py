"""Lift and moment that build up in two stages; not an effect of the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station


@dataclass(frozen=True)
class TwoStageLoads:
    """moment += ``moment`` (alpha - late), lift += ``lift`` (alpha - late), late = 0.6 fast + 0.4
    slow.

    fast_dot = (alpha - fast)/``fast``, slow_dot = (alpha - slow)/``slow``, time constants in s. The
    loads overshoot after a change of the angle of attack.
    """

    name: ClassVar[str] = "own:lagged-loads"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment", "lift")
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("moment", -0.3, "1/rad"),
        Parameter("lift", 1.0, "1/rad"),
        Parameter("fast", 0.3, "s", bounds=(0.01, 100.0)),
        Parameter("slow", 1.5, "s", bounds=(0.01, 100.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"moment": 0.0, "lift": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = (
        Signal("fast_angle", "rad", "angle of attack, late by the fast stage"),
        Signal("slow_angle", "rad", "and by the slow one"),
    )
    explanation: ClassVar[str] = (
        "The wake takes its time: loads follow the angle of attack in two stages, a fast and a "
        "slow one."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        ahead = s.alpha_air - 0.6 * s.fast_angle - 0.4 * s.slow_angle
        return {"moment": p.moment * ahead, "lift": p.lift * ahead}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return (s.alpha_air - s.fast_angle) / p.fast, (s.alpha_air - s.slow_angle) / p.slow


TERM = TwoStageLoads()
