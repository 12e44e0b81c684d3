"""Wrong single samples (spikes) of one channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import further_inputs, further_outputs, large_input, large_output
from sim.maths import maximum, minimum, real, trailing

EXPLANATION = (
    "Isolated samples are wrong: y_recorded = y + size at a few times, and y elsewhere. Causes are "
    "lost bits, telemetry dropouts and connectors that lose contact. Neighbouring samples do not "
    "respond to such a sample, which no motion of the vehicle could do. If the recorded input has "
    "spikes, the vehicle does not react to them. In a least-squares fit a single spike outweighs "
    "hundreds of good samples. Spikes are therefore found by a rule and masked before anything is "
    "fitted. Noise with heavy tails also has large samples, but of all sizes in between; these are "
    "not spikes, nor are outliers in runs."
)


@dataclass(frozen=True)
class Bursts:
    """Random times and signs of ``count`` spikes, drawn from ``seed``.

    The record is divided into ``count`` equal parts, and each part has one spike.
    """

    count: int = 6
    seed: int = 0

    def errors(self, begin: Any, end: Any, p: Any) -> Any:
        """Return the mean error over each interval, ``(n, ...)`` with the batch axes of ``p``.

        ``begin`` and ``end`` are ``(n,)``, s from the record's start. A spike begins at a multiple
        of ``p.width`` and lasts for ``p.width``. For an interval of no length (an instant), a spike
        counts if the instant is within half a width of its begin, so that rounding of sample times
        does not matter. ``p.duration`` is the duration of the record.
        """
        rng = np.random.default_rng(self.seed)
        places = (np.arange(self.count) + rng.uniform(0.2, 0.8, self.count)) / self.count
        signs = rng.choice((-1.0, 1.0), self.count)
        depth = max(np.ndim(p.size), np.ndim(p.duration), np.ndim(p.width))
        begin, end = trailing(np.asarray(begin), depth), trailing(np.asarray(end), depth)
        long = end > begin
        total: Any = 0.0
        for place, sign in zip(places.tolist(), signs.tolist(), strict=True):
            number = np.ceil(place * np.asarray(p.duration).real / np.asarray(p.width).real)
            first = np.where(long, number, number - 0.5) * p.width
            last = first + p.width
            covered = maximum(minimum(end, last) - maximum(begin, first), 0.0) / np.where(
                long, end - begin, 1.0
            )
            total = total + sign * np.where(
                long, covered, (begin >= real(first)) & (begin < real(last))
            )
        return p.size * total


class _Spikes:
    """Base of spikes of an output channel or a recorded input, whose name is ``wrong``."""

    unit: str
    typical: float

    station: ClassVar[Station] = Station.SENSOR_PATH
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.OUTLIER
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = EXPLANATION

    @property
    def wrong(self) -> str:
        """Name of the output or input that has the spikes."""
        raise NotImplementedError

    @property
    def name(self) -> str:
        return f"sensor-spikes:{self.wrong}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("size", self.typical, self.unit),
            Parameter("duration", 5.0, "s", bounds=(1e-3, 1e6), free=False),
            Parameter("width", 0.02, "s", bounds=(1e-6, 10.0), free=False),
        )

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "the reading of the {channel} has {count_spikes} of about {size}",
                "the reading of the {channel} has spikes: {rest}",
                "the reading of the {channel} has spikes",
            ),
            per_record=True,
            wrong_samples_of=self.wrong,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return ()


@dataclass(frozen=True)
class SensorSpikes(_Spikes):
    """The recorded output has spikes of plus or minus ``size`` at the times of ``bursts``.

    They act after all other sensor effects. ``size`` is in the unit of the channel. ``duration`` of
    the record and ``width`` of a spike, s, are held. With a width of one sampling interval each
    spike is one sample. The effect is for simulation: a search finds and masks such samples by a
    rule and fits no size.

    Attributes
    ----------
    channel, unit : name and unit of the output.
    typical : starting size.
    bursts : times and signs of the spikes.
    """

    channel: str
    unit: str
    typical: float
    bursts: Bursts = Bursts()

    path_order: ClassVar[int] = 90

    @property
    def wrong(self) -> str:
        return self.channel

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Return the values at the edges of the sub-steps with the spikes."""
        begin, end = np.asarray(begin), np.asarray(end)
        edges = np.concatenate([[0.0], np.cumsum(steps)])
        error = self.bursts.errors(edges, edges, p)
        depth = max(error.ndim, begin.ndim) - 1
        error = trailing(error, depth)
        return trailing(begin, depth) + error, trailing(end, depth) + error[1:]


@dataclass(frozen=True)
class InputSpikes(_Spikes):
    """The recorded input has spikes of plus or minus ``size``; the input of the vehicle has none.

    The parameters are those of `SensorSpikes`. A simulation starts from the recorded input, from
    which the spikes are subtracted before any other effect on the input.

    Attributes
    ----------
    signal, unit : name and unit of the input.
    typical : starting size.
    bursts : times and signs of the spikes.
    """

    signal: str = "elevator"
    unit: str = "rad"
    typical: float = 0.1
    bursts: Bursts = Bursts()

    path_order: ClassVar[int] = -10

    @property
    def wrong(self) -> str:
        return self.signal

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the means over cells without the spikes.

        If a spike covers part of a cell, that part of it is subtracted from the mean.
        """
        u, elapsed = np.asarray(u), np.asarray(edges) - edges[0]
        error = self.bursts.errors(elapsed[:-1], elapsed[1:], p)
        depth = max(error.ndim, u.ndim) - 1
        return trailing(u, depth) - trailing(error, depth)


VARIANTS: tuple[Traceable, ...] = (
    SensorSpikes("alpha", "rad", 0.05),
    SensorSpikes("q", "rad/s", 0.05),
    SensorSpikes("nz", "g", 0.5),
    SensorSpikes("altitude", "m", 250.0),
    InputSpikes(),
    InputSpikes("stick", "1", 1.0),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return spikes for each output and input that ``VARIANTS`` does not cover."""
    return (
        *(
            SensorSpikes(each.name, each.unit, 0.5 * large_output(each.unit))
            for each in further_outputs(equations)
        ),
        *(
            InputSpikes(signal.name, signal.unit, large_input(signal.unit))
            for signal, _ in further_inputs(equations)
        ),
    )
