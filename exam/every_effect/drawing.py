"""How the values of a hidden effect are drawn: where it acts at random, how strong it is by one
amount.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from exam.every_effect.carriers import Plan
from sim.declaration.effect import Parameter
from sim.declaration.proposal import RangedCurve, Traceable

# an absent value beyond it is a limit that is never reached: such a parameter goes as one over the
# amount
FAR = 1e6
EARLIEST, LATEST = 0.15, 0.6  # of the record, when an event begins
_KNOWN = ("duration", "width")  # of simulated spikes: what they ask of the record


@dataclass(frozen=True, eq=False)
class Draw:
    """An effect's values by amount: at one those of usual size, at zero its absence.

    ``usual`` : local values at an amount of one; ``absent`` of those that the amount moves;
    ``items`` its parameters by local name.
    """

    usual: Mapping[str, float]
    absent: Mapping[str, float]
    items: Mapping[str, Parameter]
    plausible: Mapping[str, tuple[float, float]]

    @property
    def sized(self) -> bool:
        """Whether there is anything that an amount moves."""
        return bool(self.absent)

    def at(self, amount: float) -> dict[str, float]:
        """Local values, none beyond what is plausible."""
        values = dict(self.usual)
        for local, gone in self.absent.items():
            if abs(gone) >= FAR:
                values[local] = (
                    gone if amount * FAR <= abs(self.usual[local]) else self.usual[local] / amount
                )
            else:
                values[local] = gone + amount * (self.usual[local] - gone)
        return {local: self._held(local, value) for local, value in values.items()}

    def _held(self, local: str, value: float) -> float:
        low, high = self.items[local].bounds
        if local in self.plausible and not abs(self.absent.get(local, 0.0)) >= FAR:
            low, high = max(low, self.plausible[local][0]), min(high, self.plausible[local][1])
            gone = self.absent.get(local)
            low, high = (low, high) if gone is None else (min(low, gone), max(high, gone))
        return float(min(max(value, low), high))


def drawn(effect: Traceable, plan: Plan, rng: np.random.Generator) -> Draw:
    """Values of an effect for one record: the time of an event anywhere but at the ends, other
    values about usual ones, signs where they may turn.
    """
    traits, items = effect.traits, {item.name: item for item in effect.parameters}
    moved = {local: gone for local, gone in effect.absent.items() if items[local].free}
    sign = _sign(effect, moved, items, rng)
    usual: dict[str, float] = {}
    for local, item in items.items():
        if local == traits.onset:
            usual[local] = begun(plan, rng)
        elif traits.wrong_samples_of and local in _KNOWN:
            usual[local] = plan.duration if local == "duration" else plan.interval
        elif local in moved and not isinstance(effect, RangedCurve):
            gone = 0.0 if abs(moved[local]) >= FAR else moved[local]
            usual[local] = gone + sign * (item.value - gone) * _about(
                rng, 0.6 if len(moved) > 1 else 0.0
            )
        elif item.free and local not in moved:
            usual[local] = item.value * _about(rng, 0.35)
        else:
            usual[local] = item.value
    if isinstance(effect, RangedCurve):
        usual |= _shapes(moved, items, rng)
    return Draw(usual, moved, items, traits.plausible)


def begun(plan: Plan, rng: np.random.Generator) -> float:
    """When an event begins in a record, s."""
    return float(plan.time[0] + rng.uniform(EARLIEST, LATEST) * plan.duration)


def _about(rng: np.random.Generator, spread: float) -> float:
    """A factor about one, even in the logarithm."""
    return float(np.exp(rng.uniform(-spread, spread)))


def _sign(
    effect: Traceable,
    moved: Mapping[str, float],
    items: Mapping[str, Parameter],
    rng: np.random.Generator,
) -> float:
    """One of two signs where the other makes sense: within bounds, and no mode is excited by its
    own motion.
    """
    either = float(rng.choice([-1.0, 1.0]))
    turned = all(
        abs(gone) < FAR
        and items[local].bounds[0] <= 2.0 * gone - items[local].value <= items[local].bounds[1]
        for local, gone in moved.items()
    )
    return either if turned and not effect.traits.oscillates else 1.0


def _shapes(
    moved: Mapping[str, float], items: Mapping[str, Parameter], rng: np.random.Generator
) -> dict[str, float]:
    """A smooth curve of random form, as large as the usual one: coefficients that fall off, of
    either sign.
    """
    names = list(moved)
    drawn = rng.standard_normal(len(names)) / (1.0 + np.arange(len(names))) ** 1.5
    drawn *= math.hypot(*(items[name].value for name in names)) / np.linalg.norm(drawn)
    return dict(zip(names, drawn.tolist(), strict=True))
