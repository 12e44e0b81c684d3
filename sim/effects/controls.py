"""Shared parts of effects on controls: affected coefficients, one-parameter curves, half widths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, shares_of_peak
from sim.effects.instances import labelled
from sim.maths import maximum, minimum

# ---- Which coefficients each lateral control moves, that which it is for first


@dataclass(frozen=True)
class LateralControl:
    """A control surface: its signal, the derivative of what it is for and of the side force, the
    ports of both, and the third pair.
    """

    control: str
    moment_by: str
    lift_by: str
    ports: tuple[str, str]
    further: tuple[tuple[str, str], ...]


LATERAL_CONTROLS = (
    LateralControl("aileron", "Cl_da", "CY_da", ("roll", "side_force"), (("yaw", "Cn_da"),)),
    LateralControl("rudder", "Cn_dr", "CY_dr", ("yaw", "side_force"), (("roll", "Cl_dr"),)),
)


# ---- A control whose effect is no straight line of its deflection

SHARES: Mapping[str, tuple[float, float]] = {"lift_share": (-3.0, 5.0)}


@dataclass(frozen=True)
class PlainControl:
    """moment += moment_by f(d), lift += ``lift_share`` lift_by f(d) for a deflection d, with the
    vehicle's derivatives by the control.

    ``lift_share`` is one where lift and moment come from one force on the surface, zero where the
    moment alone bends. f has one parameter, ``bend``, beside it; a subclass has its ``curve``.

    Attributes
    ----------
    control : the signal. moment_by, lift_by : names of the derivatives. share_free : whether
    ``lift_share`` is estimated: not where the
        control hardly lifts. ports : that moment and lift add to. further : ports beside them, each
        with its derivative by the control.
    label : of the name, where there are several controls. speed : the constant that is the declared
    airspeed; where it is only a
        ``reference_airspeed`` deflections are totals, and d counts from the ``middle`` of the
        range.
    """

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
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    states: ClassVar[tuple[Signal, ...]] = ()
    bend: ClassVar[Parameter]

    @property
    def name(self) -> str:
        return labelled("control-nonlinearity", self.label)

    @property
    def absent(self) -> Mapping[str, float]:
        return {self.bend.name: 0.0}

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.ports, *(port for port, _ in self.further))

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (
            self.moment_by,
            self.lift_by,
            *(derivative for _, derivative in self.further),
            self.speed,
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            self.bend,
            Parameter(
                "lift_share", 1.0, "1", prior_std=1.0, bounds=(-10.0, 10.0), free=self.share_free
            ),
        )

    def curve(self, d: Any, p: Any) -> Any:
        """f(d)."""
        raise NotImplementedError

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        d = getattr(s, self.control)
        more = self.curve(d - self.middle if self.middle else d, p)
        moment = getattr(vehicle, self.moment_by) * more
        lift = p.lift_share * getattr(vehicle, self.lift_by) * more
        others = {port: getattr(vehicle, derivative) * more for port, derivative in self.further}
        return {self.ports[0]: moment, self.ports[1]: lift, **others}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def used(self, context: SearchContext) -> tuple[float, float]:
        """The largest deflection from the middle that a record used, and the middle, in the
        control's unit.
        """
        low, high = context.flown_range(self.control) or context.flown_range("stick") or (0.0, 0.0)
        middle = 0.0 if self.speed == "airspeed" else 0.5 * (low + high)
        return max(abs(low - middle), abs(high - middle)), middle

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """The slope where there is none, lift and moment from one force."""
        return (Probe({**self.absent, "lift_share": 1.0}, (self.bend.name,)),)


Form = TypeVar("Form", bound=PlainControl)


def of_all_controls(form: type[Form], **pseudo_control: float) -> tuple[Form, ...]:
    """A form on every control of the equations; ``pseudo_control`` holds its usual sizes on that of
    the low-order equivalent.
    """
    lateral = (
        form(
            control=c.control,
            moment_by=c.moment_by,
            lift_by=c.lift_by,
            share_free=False,
            ports=c.ports,
            further=c.further,
            label=c.control,
        )
        for c in LATERAL_CONTROLS
    )
    stick = form(
        control="delta",
        moment_by="M_delta",
        lift_by="L_delta",
        share_free=False,
        **pseudo_control,  # type: ignore[arg-type]
    )
    return (form(), stick, *lateral, form(label="elevator", speed="reference_airspeed"))


# ---- What dead band and backlash share

ABSENT: Mapping[str, float] = MappingProxyType({"half_width": 0.0})


def half_width(typical: float, unit: str) -> tuple[Parameter, ...]:
    """The one parameter, not negative."""
    return (Parameter("half_width", typical, unit, bounds=(0.0, 1e9)),)


def believed(typical: float) -> Mapping[str, tuple[float, float]]:
    """Up to ten times the typical value: for an elevator some degrees."""
    return {"half_width": (0.0, 10.0 * typical)}


def tried(context: SearchContext, signal: str) -> Sequence[Probe]:
    """From a small share of the input's peak to more than half of it."""
    return [
        Probe({"half_width": size})
        for size in shares_of_peak(context, signal, (0.04, 0.12, 0.3, 0.6))
    ]


# ---- Play


def played(u: np.ndarray, half_width: Any) -> np.ndarray:
    """One run through a play.

    While the input rises y = max(y0, u - half_width), while it falls y = min(y0, u + half_width),
    y0 that at the last turn.
    """
    change = np.sign(np.diff(u.real))
    moves = np.flatnonzero(change)
    # the last cell before each turn's first move
    turns = moves[1:][change[moves[1:]] != change[moves[:-1]]]
    last = np.append(turns, len(u) - 1)
    rising = bool(len(moves) == 0 or change[moves[0]] > 0)
    y, held = u[0].item(), []
    for k, value in enumerate(u[last].tolist()):
        held.append(y)
        up = rising == (k % 2 == 0)
        pushed = value - half_width if up else value + half_width
        if pushed.real > y.real if up else pushed.real < y.real:
            y = pushed
    count = np.diff(last, prepend=-1)
    from_last = np.repeat(np.array(held), count)
    upward = np.repeat((np.arange(len(last)) % 2 == 0) == rising, count)
    return np.where(upward, maximum(from_last, u - half_width), minimum(from_last, u + half_width))
