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

# An absent value beyond this is a limit that is never reached. Such a parameter is proportional to
# the inverse of the amount.
FAR = 1e6
EARLIEST, LATEST = 0.15, 0.6  # begin of an event, as a share of the record
_OF_RECORD = ("duration", "width")  # parameters of simulated spikes that are those of the record


@dataclass(frozen=True, eq=False)
class Draw:
    """Values of an effect as a function of an amount: absent at zero, of usual size at one.

    ``usual`` has the local values at an amount of one, and ``absent`` the absent values of the
    parameters that depend on the amount. ``items`` has the parameters by local name, and
    ``plausible`` their plausible ranges.
    """

    usual: Mapping[str, float]
    absent: Mapping[str, float]
    items: Mapping[str, Parameter]
    plausible: Mapping[str, tuple[float, float]]

    @property
    def sized(self) -> bool:
        """Whether any parameter depends on the amount."""
        return bool(self.absent)

    def at(self, amount: float) -> dict[str, float]:
        """Return the local values at an amount, limited to their plausible ranges."""
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
    """Draw the values of an effect for one record.

    An event begins anywhere but at the ends of the record. Other values scatter about usual ones,
    with either sign where both are possible.
    """
    traits, items = effect.traits, {item.name: item for item in effect.parameters}
    moved = {local: gone for local, gone in effect.absent.items() if items[local].free}
    sign = _sign(effect, moved, items, rng)
    usual: dict[str, float] = {}
    for local, item in items.items():
        if local == traits.onset:
            usual[local] = begun(plan, rng)
        elif traits.wrong_samples_of and local in _OF_RECORD:
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
    """Draw the time at which an event begins in a record, s."""
    return float(plan.time[0] + rng.uniform(EARLIEST, LATEST) * plan.duration)


def _about(rng: np.random.Generator, spread: float) -> float:
    """Draw a factor about one, uniform in the logarithm."""
    return float(np.exp(rng.uniform(-spread, spread)))


def _sign(
    effect: Traceable,
    moved: Mapping[str, float],
    items: Mapping[str, Parameter],
    rng: np.random.Generator,
) -> float:
    """Draw a sign; it is always positive if the other sign is not possible.

    The other sign is not possible if it is out of bounds, or if a mode would be excited by its own
    motion.
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
    """Draw the coefficients of a smooth curve of random form and usual size.

    The coefficients decrease with their number and have either sign.
    """
    names = list(moved)
    drawn = rng.standard_normal(len(names)) / (1.0 + np.arange(len(names))) ** 1.5
    drawn *= math.hypot(*(items[name].value for name in names)) / np.linalg.norm(drawn)
    return dict(zip(names, drawn.tolist(), strict=True))


# ---- The strength of a hidden effect, and the amount that gives a wanted strength

COARSE = 0.01  # s, integration step
SLOPE = 1e-4  # step of a difference, relative to the value of a parameter
START = 1e-3  # step of a difference, for an initial state of zero
STEEPEST = 0.4  # rad, largest angle that perturbations about trim describe
ANGLES = ("alpha", "beta")
ROUNDS = 14  # most amounts that are tried
LARGEST = 6.0  # largest amount
NEAR = 0.05  # tolerance of the length, relative to the wanted one


class Scale:
    """The strength of a hidden effect in the fitted record of a carrier.

    Random effects use the same random numbers for all sizes.
    """

    def __init__(self, carrier: Carrier, seed: int) -> None:
        self._carrier, self._seed = carrier, seed
        plan = carrier.train
        base = self._whitened(plan, ())
        assert base is not None
        self._base = base
        self._span = np.linalg.qr(self._columns(plan))[0]

    def length(self, hidden: HiddenEffects) -> float:
        """Return the change of the outputs in sigmas that the declared unknowns cannot explain.

        It is infinite if the flight is not possible. Half its square is the expected gain of the
        log likelihood.
        """
        changed = self._whitened(self._carrier.train, hidden)
        if changed is None:
            return math.inf
        change = changed - self._base
        return float(np.linalg.norm(change - self._span @ (self._span.T @ change)))

    def _whitened(self, plan: Plan, hidden: HiddenEffects) -> np.ndarray | None:
        """Return all outputs in noise sigmas, joined.

        The result is None if the flight is not possible, or goes beyond perturbations about trim.
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
        """Return the directions of the declared unknowns, ``(samples, directions)``, of length one.

        The unknowns are parameters, initial states, and a bias of each output.
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
    """Return the amount at which an increasing length has the wanted value, and the length there.

    If no amount gives the wanted length, the amount with the nearest length that can be flown is
    returned.
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
        # The length is nearly proportional to the amount. Where this fails, the amount is searched
        # between the known ones.
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

# Sigmas; the expected gains are 32 and 3200. At the first one nearly all effects are detected.
WEAKEST, STRONGEST = 8.0, 80.0
SEEN = 0.5  # share of the wanted size below which another instance of the kind is tried
TRIES = 4


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight with its truth.

    ``values`` are those of the effect ``name`` in the fitted record, local and SI, and ``size`` is
    its size in sigmas. The name is empty if nothing is hidden. In the held-out record an event
    begins at another time.
    """

    carrier: Carrier
    name: str
    values: Mapping[str, float]
    size: float
    train: Record
    validate: Record


def fly_hidden(instances: Sequence[Instance], turn: int, seed: int) -> Flown:
    """Fly the flight of a seed with one of some ``instances`` hidden in it.

    The instance is the one whose ``turn`` it is. If it cannot be observed, another one is drawn at
    random. Sizes are uniform in the logarithm from ``WEAKEST`` to ``STRONGEST``. An instance that
    is too small at its largest plausible size is flown nevertheless.

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
    """Draw a vehicle, and the values of an effect with the wanted strength, as far as possible."""
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
    """Return the values in the held-out record.

    Values of the aircraft are the same; an event begins at another time.
    """
    onset = effect.traits.onset
    return {
        **values,
        **({onset: begun(carrier.validate, rng)} if onset and effect.traits.per_record else {}),
    }


def write_hidden(flown: Flown, folder: Path) -> Request:
    """Write the files for the loop into an existing folder.

    They are ``train.csv`` and ``validate.csv`` with their sidecars, and ``vehicle.toml``.
    """
    train, _ = write_record(folder, flown.train, "train", simulated=True)
    validate, _ = write_record(folder, flown.validate, "validate", simulated=True)
    vehicle = folder / "vehicle.toml"
    vehicle.write_text(flown.carrier.vehicle_file, encoding="utf-8", newline="\n")
    return Request((train,), flown.carrier.model, vehicle, (validate,))
