"""An elastic mode that the declared model lacks: an oscillator driven by a control and by the angle
of attack or sideslip.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import (
    RESOLVED_FREQUENCY_SHARE,
    Probe,
    SearchContext,
    Traceable,
    Traits,
)
from sim.errors import ModelError

STARTING_DAMPING = 0.03  # start of a search; structures have 0.01 to 0.05
# Ratio of successive trial frequencies, so close that a mode of this damping responds to one.
FREQUENCY_RATIO = 1.09
# rad/s; a record is taken to resolve at least this frequency.
LOWEST_FREQUENCY = 4.0
HIGHEST_FREQUENCY = 250.0  # rad/s, highest frequency resolved by usual sub-steps
# Moment derivatives by angle and by control, for each control. Angle and control drive a mode in
# about the ratio of the two.
MOMENT_DERIVATIVES = {
    "elevator": ("Cm_alpha", "Cm_de"),
    "delta": ("M_alpha", "M_delta"),
    "rudder": ("Cn_beta", "Cn_dr"),
}
ANGLE_GAIN_STD = 3.0  # prior standard deviation of ``angle_gain``, relative to this ratio


@dataclass(frozen=True)
class ElasticMode:
    """An elastic mode: eta_ddot = -2 damping frequency eta_dot + frequency^2 (control + angle_gain
    alpha - eta).

    The gain of the control is one by convention: eta is the steady deflection of the control that
    bends the structure as much. ``lift`` and ``moment`` times eta add to the loads. The gyro reads
    q + ``gyro`` eta_dot, with the local rate of bending. On the rigid aircraft eta is in rad and
    the loads are coefficients. On the low-order equivalent system eta is in the unit of the stick
    and driven by the pseudo-control, with lift in 1/s and moment in 1/s2. alpha includes the gust.

    Attributes
    ----------
    number : number of the mode: 1 is ``elastic-mode``, 2 is ``elastic-mode#2``.
    fine : whether this is the refined form. It adds loads by the rate of bending (``lift_rate`` and
        ``moment_rate`` times eta_dot/frequency), forcing by the pitch rate (``pitch_gain`` q), and
        an accelerometer away from the node (nz + ``accelerometer`` eta_ddot).
    control, angle : signal of the control that drives the mode, and its unit.
    loads, sizes : units of lift and moment; starting values of lift, moment and gyro.
    needs_constants : constants that the equations must have.
    fastest : highest frequency that the records resolve, rad/s.
    ports : load ports that the effect adds to; its size parameters have their names.
    read_as : angle that drives the mode, rate that the gyro reads, and channel of the
        accelerometer.
    total : whether control and angle are totals. The steady value of their forcing is then a free
        parameter ``trim``, which is subtracted, since a record begins without bending.
    middle : starting value of ``trim``: the middle of the deflections in the record.
    angle_std : prior standard deviation of ``angle_gain``. The air bends a structure about as it
        turns the aircraft. Without this prior, a record that does not determine ``angle_gain``
        could attribute a moment of the aircraft to it.
    """

    number: int = 1
    fine: bool = False
    control: str = "elevator"
    angle: str = "rad"
    loads: tuple[str, str] = ("1/rad", "1/rad")
    sizes: tuple[float, float, float] = (0.2, -0.3, 0.02)
    needs_constants: tuple[str, ...] = ("Cm_alpha", "airspeed")
    fastest: float = 400.0
    ports: tuple[str, str] = ("lift", "moment")
    read_as: tuple[str, str, str] = ("alpha_air", "q", "nz")
    total: bool = False
    middle: float = 0.0
    angle_std: float = math.inf

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ()

    @property
    def explanation(self) -> str:
        part, angle, control, loads, rate, motion, channels = (
            (
                "The fin or the aft fuselage bends sideways",
                "beta",
                "rudder",
                "the side force by side_force eta and the yawing moment by yaw eta",
                "r",
                "Dutch roll",
                "yaw rate and lateral load factor",
            )
            if "yaw" in self.ports
            else (
                "The structure bends",
                "alpha",
                "control",
                "the lift by lift eta and the moment by moment eta",
                "q",
                "short period",
                "pitch rate and load factor",
            )
        )
        return (
            f"{part}. The declared model assumes that it is rigid. One elastic mode is an "
            f"oscillator that the {control} and {angle} drive: eta_ddot = -2 damping frequency "
            f"eta_dot + frequency^2 (control + angle_gain {angle} - eta). Bending changes {loads}. "
            f"It also turns the place where the gyro is mounted, which reads {rate} + gyro "
            f"eta_dot. After each quick movement of the {control} the record oscillates at a "
            f"frequency above that of the {motion}, mostly in {channels}. The scale of eta is a "
            f"convention, defined by the gain of one on the {control}. A mode that is much faster "
            "than the input only changes the derivatives and is not observable."
        )

    def __post_init__(self) -> None:
        if self.number < 1:
            raise ModelError(
                f"mode {self.number}", where="elastic-mode", remedy="number further modes from 2"
            )

    @property
    def name(self) -> str:
        return "elastic-mode" if self.number == 1 else f"elastic-mode#{self.number}"

    @property
    def needs(self) -> tuple[str, ...]:
        return self.ports

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "the structure bends: a mode of {frequency} ({frequency_hertz}), damping {damping}",
            ),
            short_name="bending structure",
            # Structures have 0.01 to 0.05; aerodynamic damping of the first wing bending adds up to
            # about 0.1.
            plausible={"frequency": (3.0, min(200.0, self.fastest)), "damping": (0.003, 0.2)},
            oscillates=("frequency",),
        )

    @property
    def states(self) -> tuple[Signal, ...]:
        return (
            Signal(f"bending_{self.number}", self.angle, "bending of an elastic mode"),
            Signal(f"bending_rate_{self.number}", f"{self.angle}/s", "its rate"),
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        lift, moment, gyro = self.sizes
        base = (
            Parameter("frequency", min(15.0, self.fastest), "rad/s", bounds=(1.0, self.fastest)),
            Parameter("damping", STARTING_DAMPING, "1", bounds=(0.0005, 0.7)),
            Parameter(self.ports[0], lift, self.loads[0]),
            Parameter(self.ports[1], moment, self.loads[1]),
            Parameter("angle_gain", 0.0, f"{self.angle}/rad", prior_std=self.angle_std),
            Parameter("gyro", gyro, f"rad/{self.angle}"),
            *((Parameter("trim", self.middle, self.angle),) if self.total else ()),
        )
        if not self.fine:
            return base
        return (
            *base,
            Parameter(f"{self.ports[0]}_rate", 0.3 * lift, self.loads[0]),
            Parameter(f"{self.ports[1]}_rate", 0.3 * moment, self.loads[1]),
            Parameter("pitch_gain", 0.0, f"{self.angle} s/rad"),
            Parameter("accelerometer", 0.1 * gyro, f"g s2/{self.angle}"),
        )

    @property
    def absent(self) -> Mapping[str, float]:
        further = (*(f"{port}_rate" for port in self.ports), "accelerometer") if self.fine else ()
        return MappingProxyType(dict.fromkeys((*self.ports, "gyro", *further), 0.0))

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        eta, rate = self._bending(s)
        added = {port: getattr(p, port) * eta for port in self.ports}
        if self.fine:
            phase = rate / p.frequency
            added = {
                port: load + getattr(p, f"{port}_rate") * phase for port, load in added.items()
            }
        return added

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        eta, rate = self._bending(s)
        angle, rate_read, _ = self.read_as
        force = getattr(s, self.control) + p.angle_gain * getattr(s, angle) - eta
        if self.total:
            force = force - p.trim
        if self.fine:
            force = force + p.pitch_gain * getattr(s, rate_read)
        return rate, p.frequency * (p.frequency * force - 2.0 * p.damping * rate)

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        rate, acceleration = self.derivatives(s, vehicle, p)
        _, gyro, accelerometer = self.read_as
        changed = {gyro: y[gyro] + p.gyro * rate}
        return (
            {**changed, accelerometer: y[accelerometer] + p.accelerometer * acceleration}
            if self.fine and accelerometer in y
            else changed
        )

    def finer(self) -> ElasticMode:
        """Return the refined form, with all couplings."""
        return replace(self, fine=True)

    def fitted_to(self, context: SearchContext) -> ElasticMode:
        """Return the mode with frequencies that the records resolve, and with a prior of
        ``angle_gain`` from the derivatives of the aircraft.

        Total deflections are counted from the middle of their range.
        """
        low, high = (context.flown_range(self.control) if self.total else None) or (
            self.middle,
            self.middle,
        )
        by_angle, by_control = (
            abs(context.values.get(name, 0.0)) for name in MOMENT_DERIVATIVES[self.control]
        )
        std = (
            ANGLE_GAIN_STD * by_angle / by_control
            if by_angle > 0.0 and by_control > 0.0
            else math.inf
        )
        return replace(self, fastest=_resolved(context), middle=0.5 * (low + high), angle_std=std)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe the couplings at the peaks of the residual's spectrum, then over a grid of
        frequencies up to four fifths of half the sampling rate.
        """
        slowest = max(2.0, 4.0 * math.pi / max(context.duration, 1.0))
        fastest = min(_resolved(context), HIGHEST_FREQUENCY)
        count = max(2, math.ceil(math.log(max(fastest / slowest, 1.1)) / math.log(FREQUENCY_RATIO)))
        grid = [
            min(slowest * (fastest / slowest) ** (i / (count - 1)), fastest) for i in range(count)
        ]
        peaks = [
            frequency for frequency in context.residual_peaks if slowest <= frequency <= fastest
        ]
        slopes = tuple(self.absent)
        start = (
            {item.name: item.value for item in self.parameters}
            | dict.fromkeys(slopes, 0.0)
            | {"damping": STARTING_DAMPING}
        )
        return tuple(
            Probe({**start, "frequency": frequency}, slopes) for frequency in (*peaks, *grid)
        )

    def _bending(self, s: Any) -> tuple[Any, Any]:
        return getattr(s, f"bending_{self.number}"), getattr(s, f"bending_rate_{self.number}")


def _resolved(context: SearchContext) -> float:
    """Return the highest frequency that a record resolves, rad/s."""
    return max(RESOLVED_FREQUENCY_SHARE * math.pi / context.interval, LOWEST_FREQUENCY)


VARIANTS: tuple[Traceable, ...] = (
    ElasticMode(),
    ElasticMode(
        control="delta",
        angle="1",
        loads=("1/s", "1/s2"),
        sizes=(0.002, -0.04, 0.002),
        needs_constants=("M_delta",),
    ),
    ElasticMode(
        control="rudder",
        sizes=(0.05, -0.02, 0.01),
        needs_constants=("Cn_dr",),
        ports=("side_force", "yaw"),
        read_as=("beta_air", "r", "ny"),
    ),
    ElasticMode(needs_constants=("Cm_alpha", "reference_airspeed"), total=True),
)
