"""Control surface that works more to one side than to the other: the plainest form of a control that is no straight line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits
from sim.effects.instances import labelled
from sim.effects.lateral_controls import LATERAL_CONTROLS
from sim.maths.elementary import sqrt

ROUNDED = 0.001  # of the largest deflection: the kink is a curve that narrow, so that there is a slope everywhere


@dataclass(frozen=True)
class ControlUnevenness:
    """The moment of a deflection d is that of d + ``unevenness`` |d|: slopes of 1 + unevenness to the positive side, 1 - unevenness to the other.

    moment += moment_by unevenness |d|, lift += ``lift_share`` lift_by unevenness |d|, so that the vehicle's derivatives are the means of both
    sides. |d| stands for sqrt(d^2 + w^2) - w, ``width`` w in the control's unit. ``lift_share`` as in the curved form.

    Attributes
    ----------
    ports, further, label, speed, middle : as of the curved form; d counts from the middle.
    width : of the rounded kink. control : the signal. moment_by, lift_by : names of the derivatives. share_free : whether ``lift_share`` is
        estimated: not where the control hardly lifts.
    """

    width: float = 0.00005
    control: str = "elevator"
    moment_by: str = "Cm_de"
    lift_by: str = "CL_de"
    share_free: bool = True
    ports: tuple[str, str] = ("moment", "lift")
    further: tuple[tuple[str, str], ...] = ()
    label: str = ""
    speed: str = "airspeed"
    middle: float = 0.0

    station: ClassVar[Station] = Station.DYNAMICS
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"unevenness": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("the {control} works unequally to both sides, by {unevenness_change} about the mean (unevenness {unevenness})",),
        short_name="uneven control",
        plausible={"unevenness": (-0.7, 0.7), "lift_share": (-3.0, 5.0)},
    )

    @property
    def explanation(self) -> str:
        moment = self.moment_by.partition("_")[0]
        return (
            f"The surface works more to one side than to the other: {moment} = ... + {self.moment_by} (d + unevenness |d|) for a deflection d from "
            "trim, its other coefficients likewise. A tail near its stall, a gap that one side opens, or an actuator with two gains do this. The "
            "derivative is then the mean of both sides, and a model with one slope errs with the same sign for up and down: after a doublet it ends "
            "at another attitude than the aircraft. An input to one side alone only shows another derivative; it takes steps to both."
        )

    @property
    def name(self) -> str:
        return labelled("control-nonlinearity", self.label)

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.ports, *(port for port, _ in self.further))

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.moment_by, self.lift_by, *(derivative for _, derivative in self.further), self.speed)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        share = Parameter("lift_share", 1.0, "1", prior_std=1.0, bounds=(-10.0, 10.0), free=self.share_free)
        return (Parameter("unevenness", 0.2, "1", bounds=(-1.0, 1.0)), share)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        d = getattr(s, self.control)
        d = d - self.middle if self.middle else d
        more = p.unevenness * (sqrt(d * d + self.width * self.width) - self.width)
        moment, lift = getattr(vehicle, self.moment_by) * more, p.lift_share * getattr(vehicle, self.lift_by) * more
        others = {port: getattr(vehicle, derivative) * more for port, derivative in self.further}
        return {self.ports[0]: moment, self.ports[1]: lift, **others}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> ControlUnevenness:
        """The same with a kink as narrow as the deflections of the record ask."""
        low, high = context.flown_range(self.control) or context.flown_range("stick") or (0.0, 0.0)
        middle = 0.0 if self.speed == "airspeed" else 0.5 * (low + high)
        return replace(self, width=ROUNDED * max(abs(low - middle), abs(high - middle)) or self.width, middle=middle)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """The slope where there is none, lift and moment from one force."""
        return (Probe({**self.absent, "lift_share": 1.0}, ("unevenness",)),)


VARIANTS: tuple[Traceable, ...] = (
    ControlUnevenness(),
    ControlUnevenness(width=0.0005, control="delta", moment_by="M_delta", lift_by="L_delta", share_free=False),
    *(
        ControlUnevenness(
            control=c.control, moment_by=c.moment_by, lift_by=c.lift_by, share_free=False, ports=c.ports, further=c.further, label=c.control
        )
        for c in LATERAL_CONTROLS
    ),
    ControlUnevenness(label="elevator", speed="reference_airspeed"),
)
