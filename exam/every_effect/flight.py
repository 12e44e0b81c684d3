"""One flight with one hidden effect. Its values and its size are drawn, then it is flown and
written.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from exam.every_effect.carriers import (
    Carrier,
    HiddenEffects,
    Instance,
    Plan,
    drawn_carrier,
    effect_of,
)
from scenarios.files.writing import write_record
from scenarios.preparation.plan import Request
from sim.declaration.effect import Parameter
from sim.declaration.model import Model
from sim.declaration.proposal import RangedCurve, Traceable
from sim.errors import FlightidError
from sim.record import Record

# ---- How the values of a hidden effect are drawn

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


# ---- How strong a hidden effect is, and the amount of it that is as strong as wanted

COARSE = 0.01  # s
SLOPE = 1e-4  # of a parameter's value
START = 1e-3  # of a state that begins at zero
STEEPEST = 0.4  # rad: about trim no model describes more
ANGLES = ("alpha", "beta")
ROUNDS = 14
LARGEST = 6.0  # of the usual amount
NEAR = 0.05  # of the wanted length, at which an amount is good


class Scale:
    """The strength of what is hidden in the fitted record of a carrier; random effects with the
    same random numbers whatever their size.
    """

    def __init__(self, carrier: Carrier, seed: int) -> None:
        self._carrier, self._seed = carrier, seed
        plan = carrier.train
        base = self._whitened(plan, ())
        assert base is not None
        self._base = base
        self._span = np.linalg.qr(self._columns(plan))[0]

    def length(self, hidden: HiddenEffects) -> float:
        """The change in sigmas that nothing declared explains, infinite where it cannot be flown;
        half its square is the expected gain.
        """
        changed = self._whitened(self._carrier.train, hidden)
        if changed is None:
            return math.inf
        change = changed - self._base
        return float(np.linalg.norm(change - self._span @ (self._span.T @ change)))

    def _whitened(self, plan: Plan, hidden: HiddenEffects) -> np.ndarray | None:
        """Outputs in noise sigmas, one after the other; None where there are none, or beyond what
        perturbations about trim describe.
        """
        try:
            record = self._carrier.flown(
                plan, hidden, np.random.default_rng(self._seed), step=COARSE
            )
        except (FlightidError, FloatingPointError):
            return None
        angles = [record[name].values for name in ANGLES if name in self._carrier.noise]
        if not all(np.all(np.isfinite(c.values)) for c in record.outputs) or any(
            np.max(np.abs(angle)) > STEEPEST for angle in angles
        ):
            return None
        return np.concatenate([c.values / self._carrier.noise[c.name] for c in record.outputs])

    def _columns(self, plan: Plan) -> np.ndarray:
        """Directions of what is declared: parameters, where the states begin, a bias of each
        output; ``(samples, directions)``, of length one.
        """
        model = plan.model
        moved: list[Model] = []
        for name in self._carrier.free:
            value = model.parameters[name].value
            moved.append(model.with_values({name: value + SLOPE * (abs(value) or 1.0)}))
        for item in model.initial:
            step = START * abs(item.value) if abs(item.value) > 1.0 else START
            moved.append(
                model.with_initial(model.initial.with_values({item.name: item.value + step}))
            )
        columns = [
            there - self._base
            for changed in moved
            if (there := self._whitened(replace(plan, model=changed), ())) is not None
        ]
        count = len(self._base) // len(self._carrier.noise)
        columns += [*np.kron(np.eye(len(self._carrier.noise)), np.ones(count))]
        sizes = [float(np.linalg.norm(column)) for column in columns]
        return np.array(
            [column / size for column, size in zip(columns, sizes, strict=True) if size > 0.0]
        ).T


def amount_for(length: Callable[[float], float], wanted: float) -> tuple[float, float]:
    """The amount at which a length, which grows with it, is the wanted one, and the length there;
    else the nearest that can be flown.
    """
    amount, low, high = 1.0, 0.0, LARGEST
    best = (0.0, 0.0)
    for _ in range(ROUNDS):
        now = length(amount)
        if math.isfinite(now) and abs(now - wanted) < abs(best[1] - wanted):
            best = (amount, now)
        if abs(now - wanted) < NEAR * wanted or (now < wanted and amount >= LARGEST):
            break
        low, high = (amount, high) if now < wanted else (low, amount)
        # The length grows nearly as the amount does; where that law leads astray the amount is
        # sought between what is known.
        step = amount * wanted / now if math.isfinite(now) and now > 0.0 else 0.0
        beyond = step >= high == LARGEST
        amount = (
            step
            if low < step < high
            else LARGEST
            if beyond
            else math.sqrt(low * high)
            if low > 0.0
            else 0.3 * high
        )
    return best


# ---- One flight with one effect of the library in it, or nothing

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
