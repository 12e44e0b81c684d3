"""One flight with one effect of the library in it, or nothing: drawn, sized, flown and written as
the loop is given it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from exam.every_effect.carriers import Carrier, HiddenEffects, drawn_carrier
from exam.every_effect.drawing import begun, drawn
from exam.every_effect.kinds import Instance, effect_of
from exam.every_effect.sizing import Scale, amount_for
from scenarios.files.writing import write_record
from scenarios.preparation.plan import Request
from sim.declaration.proposal import Traceable
from sim.record import Record

# sigmas: expected gains of 32 and 3200; at the first one nearly all weak effects are detected
WEAKEST, STRONGEST = 8.0, 80.0
SEEN = 0.5  # of what is wanted, below which another effect of the kind is tried
TRIES = 4


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight with its truth: ``values`` of the effect ``name`` (empty: nothing) in the fitted
    record, and its ``size`` in sigmas.

    ``values`` are local and SI; in the record that is held out an event begins at another time.
    """

    carrier: Carrier
    name: str
    values: Mapping[str, float]
    size: float
    train: Record
    validate: Record


def fly_hidden(instances: Sequence[Instance], turn: int, seed: int) -> Flown:
    """The flight of a seed with one of some ``instances`` in it: that whose ``turn`` it is, or one
    drawn at random where that cannot be seen.

    Sizes are even in the logarithm from ``WEAKEST`` to ``STRONGEST``. What stays too small at its
    largest plausible size is flown nevertheless.

    Raises
    ------
    FlightidError : the vehicle cannot be flown.
    """
    rng = np.random.default_rng((seed, 4))
    wanted = float(np.exp(rng.uniform(math.log(WEAKEST), math.log(STRONGEST))))
    instance, best = instances[turn % len(instances)], None
    for _ in range(TRIES):
        attempt = _attempt(instance, wanted, rng)
        if best is None or attempt[3] > best[3]:
            best = attempt
        if not instance.name or attempt[3] >= SEEN * wanted:
            break
        instance = instances[int(rng.integers(len(instances)))]
    assert best is not None
    carrier, effect, values, size = best
    hidden: HiddenEffects = () if effect is None else ((effect, values),)
    again: HiddenEffects = (
        () if effect is None else ((effect, _elsewhere(effect, values, carrier, rng)),)
    )
    train = carrier.measured(carrier.flown(carrier.train, hidden, rng), rng)
    validate = carrier.measured(carrier.flown(carrier.validate, again, rng), rng)
    return Flown(carrier, "" if effect is None else effect.name, values, size, train, validate)


def _attempt(
    instance: Instance, wanted: float, rng: np.random.Generator
) -> tuple[Carrier, Traceable | None, Mapping[str, float], float]:
    """A vehicle and values of an effect that are as strong as wanted, as far as they can be."""
    carrier = drawn_carrier(instance.model, rng)
    if not instance.name:
        return carrier, None, {}, 0.0
    effect = effect_of(instance)
    draw = drawn(effect, carrier.train, rng)
    scale = Scale(carrier, int(rng.integers(2**32)))

    def length(amount: float) -> float:
        return scale.length(((effect, draw.at(amount)),))

    amount, size = amount_for(length, wanted) if draw.sized else (1.0, length(1.0))
    return carrier, effect, draw.at(amount), size if math.isfinite(size) else 0.0


def _elsewhere(
    effect: Traceable, values: Mapping[str, float], carrier: Carrier, rng: np.random.Generator
) -> Mapping[str, float]:
    """Values in the record that is held out: those of the aircraft are the same, an event is
    another one.
    """
    onset = effect.traits.onset
    return {
        **values,
        **({onset: begun(carrier.validate, rng)} if onset and effect.traits.per_record else {}),
    }


def write_hidden(flown: Flown, folder: Path) -> Request:
    """What the loop is given, in a folder that exists: ``train.csv`` and ``validate.csv`` with
    their sidecars, ``vehicle.toml``.
    """
    train, _ = write_record(folder, flown.train, "train", simulated=True)
    validate, _ = write_record(folder, flown.validate, "validate", simulated=True)
    vehicle = folder / "vehicle.toml"
    vehicle.write_text(flown.carrier.vehicle_file, encoding="utf-8", newline="\n")
    return Request((train,), flown.carrier.model, vehicle, (validate,))
