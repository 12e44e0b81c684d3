"""A wrong scale factor or a bent calibration of one output channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import further_outputs, large_output, per, per_square

_ALIASES_OF_SCALE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "alpha": ("time-base", "sensor-scale:q", "sensor-lag:nz", "sensor-delay:nz"),
        "q": ("sensor-scale:alpha",),
        "nz": (),
        "altitude": ("density-scale-height",),
    }
)

SLOW_AND_QUICK = (
    "slow pull-ups beside quick doublets, small and large: a scale is the same in all of them"
)
WITH_LOAD_FACTOR = (
    "a record with the load factor as well: kinematics then tie the channels together"
)


@dataclass(frozen=True)
class SensorScale:
    """The recorded channel is ``scale`` times the true one, before the bias is added.

    ``scale`` without unit, positive; 1 where the sensor is right. Of the altitude only a large one
    shows: another start and beta make nearly the same fall (of three percent a seventh of the noise
    is left).
    """

    channel: str

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 10
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("scale", 1.05, "1", bounds=(0.01, 100.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"scale": 1.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    explanation: ClassVar[str] = (
        "The sensor's calibration factor is wrong: y_recorded = scale y + bias. A vane in the "
        "upwash of the fuselage reads too much, a gyro with a "
        "wrong range setting any amount. One scaled channel contradicts the others: the kinematics "
        "alpha_dot = q - (g/V)(nz - 1) join the three "
        "without any aerodynamics, so that with alpha, q and nz at hand a single scale shows. With "
        "two channels it only changes the derivatives: "
        "the lift slope for alpha, all moment derivatives for q, and the record cannot say which "
        "is at fault. An altitude scaled together with the "
        "density's scale height and with beta gives the same fall but for gravity: only where it "
        "is large does it show."
    )

    @property
    def name(self) -> str:
        return f"sensor-scale:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return _ALIASES_OF_SCALE.get(self.channel, ())

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {channel} is read {scale_percent} {scale_direction}",),
            separating={
                **dict.fromkeys(
                    ("sensor-lag", "sensor-delay", "lift-nonlinearity"), SLOW_AND_QUICK
                ),
                "sensor-scale": WITH_LOAD_FACTOR,
            },
            equivalents=("time-base",) if self.channel == "alpha" else (),
            plausible={"scale": (0.5, 2.0)},
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"scale": 1.0}, ("scale",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: p.scale * y[self.channel]}


_ALIASES_OF_CURVE = {
    **{
        "alpha": ("lift-nonlinearity",),
        "nz": ("lift-nonlinearity",),
        "q": ("moment-nonlinearity",),
    },
    **{
        "p": ("roll-nonlinearity",),
        "r": ("yaw-nonlinearity",),
        "ny": ("side-force-nonlinearity",),
        "nx": ("drag-nonlinearity",),
    },
}
# rad, rad/s, g about trim: what a record without a known range is taken to fly
LARGEST = {"alpha": 0.15, "q": 0.3, "nz": 3.0}
POWERS: Mapping[str, int] = MappingProxyType({"curvature": 2, "cubic": 3})
BOTH = tuple(POWERS)
AT_HALF = 2.0  # a cube starts where it is as large as the square at half of the range
WITH_OTHERS = (
    "a record with the other two of alpha, q and nz: a bent load moves all three by the "
    "kinematics, a bent reading one"
)


@dataclass(frozen=True)
class SensorCurve:
    """The recorded channel is y + curvature y^2 + cubic y^3, y the true value about trim, before
    the bias is added.

    ``curvature`` in 1 over the unit of the channel, ``cubic`` in 1 over its square, of either sign;
    a plain curve has one of the two.

    Attributes
    ----------
    channel, unit : the output it acts on. typical : starting curvature.
    middle : of the readings, from where y counts; zero where they are perturbations. is_state :
    whether the channel
        is a state, whose range is known without its bias.
    bends : which of the two it has.
    low, high : flown range about trim, in the unit of the channel: believed is what leaves the
    reading rising all over it,
        1 + 2 curvature y + 3 cubic y^2 > 0 where either stands alone, and at its ends no more than
        twice what it should be.
    """

    channel: str
    unit: str
    typical: float
    low: float
    high: float
    middle: float = 0.0
    is_state: bool = False
    bends: tuple[str, ...] = ("curvature",)

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 5
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    explanation: ClassVar[str] = (
        "The sensor's calibration is not straight: y_recorded = y + curvature y^2 + bias, y "
        "counted from trim, where the slope is one. A vane near "
        "a fuselage whose upwash changes with the angle, a potentiometer loaded at one end and a "
        "filter of pressures do this. Pull-ups and "
        "push-overs of one size then read unlike. A sensor that errs alike to both sides has cubic "
        "y^3 in the place of the square, and a freer form "
        "has both. The kinematics alpha_dot = q - (g/V) nz show it in the one channel that is "
        "bent; lift or moment "
        "that bend over the angle of attack change the motion itself and obey the kinematics. With "
        "one channel alone the two look much the same."
    )

    @property
    def name(self) -> str:
        return f"sensor-curve:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return _ALIASES_OF_CURVE.get(self.channel, ())

    @property
    def absent(self) -> Mapping[str, float]:
        return dict.fromkeys(self.bends, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        reach = max(self.high, -self.low, 1e-6)
        both = {
            "curvature": Parameter("curvature", self.typical, per(self.unit)),
            "cubic": Parameter("cubic", AT_HALF * self.typical / reach, per_square(self.unit)),
        }
        return tuple(both[name] for name in self.bends)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "the reading of the {channel} is bent: it has {curvature} times its square and "
                "{cubic} times its cube too much",
                "the reading of the {channel} is bent: it has {curvature} times its square too "
                "much",
                "the reading of the {channel} is bent: it has {cubic} times its cube too much",
            ),
            separating=dict.fromkeys(("lift-nonlinearity", "moment-nonlinearity"), WITH_OTHERS),
            plausible={
                name: range_ for name, range_ in self._believed().items() if name in self.bends
            },
        )

    def _believed(self) -> Mapping[str, tuple[float, float]]:
        up, down = max(self.high, 1e-6), min(self.low, -1e-6)
        reach = max(up, -down)
        return {
            "curvature": (-0.5 / up, -0.5 / down),
            "cubic": (-1.0 / (3.0 * reach**2), 1.0 / reach**2),
        }

    def finer(self) -> SensorCurve:
        """The same with square and cube."""
        return replace(self, bends=BOTH)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe(self.absent, self.bends)]

    def fitted_to(self, context: SearchContext) -> SensorCurve:
        """The same over the range that the record flew, its bias taken off."""
        flown = context.flown_range(self.channel)
        if flown is None:
            return self
        # The range of a state is that of the motion, without the bias of its reading.
        bias = 0.0 if self.is_state else context.values.get(f"bias_{self.channel}", 0.0)
        low, high = flown[0] - bias, flown[1] - bias
        if max(low, -high) > high - low:
            # A total that never comes near zero: about there a square is next to a scale.
            middle = 0.5 * (low + high)
            return replace(self, low=low - middle, high=high - middle, middle=middle)
        return replace(self, low=min(low, 0.0), high=max(high, 0.0))

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        true = y[self.channel]
        off = true - self.middle if self.middle else true
        bent = sum(
            getattr(p, name) * off**power for name, power in POWERS.items() if name in self.bends
        )
        return {self.channel: true + bent}


_PLAIN = (
    SensorCurve("alpha", "rad", 3.0, -LARGEST["alpha"], LARGEST["alpha"], is_state=True),
    SensorCurve("q", "rad/s", 0.8, -LARGEST["q"], LARGEST["q"], is_state=True),
    SensorCurve("nz", "g", 0.1, -LARGEST["nz"], LARGEST["nz"]),
)


def _square_or_cube(plain: Sequence[SensorCurve]) -> tuple[Traceable, ...]:
    return tuple(replace(each, bends=(name,)) for each in plain for name in BOTH)


VARIANTS: tuple[Traceable, ...] = (
    *(SensorScale(channel) for channel in ("alpha", "q", "nz", "altitude")),
    *_square_or_cube(_PLAIN),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """A scale, a square and a cube for each output that has none yet."""
    states = {signal.name for signal in equations.states}
    further = further_outputs(equations)
    sized = ((each, large_output(each.unit)) for each in further)
    curves = [
        SensorCurve(each.name, each.unit, 0.2 / large, -large, large, is_state=each.name in states)
        for each, large in sized
    ]
    return (*(SensorScale(each.name) for each in further), *_square_or_cube(curves))
