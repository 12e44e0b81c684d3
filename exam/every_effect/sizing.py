"""How strong a hidden effect is, and the amount of it that is as strong as wanted.

Strength is the expected gain of the log likelihood, as in ``detection``: half the squared change
that the effect makes to the outputs of the fitted record, in noise sigmas, as far as no change of
the declared parameters, of the initial state or of biases can stand in for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from exam.every_effect.carriers import Carrier, HiddenEffects, Plan
from sim.declaration.model import Model
from sim.errors import FlightidError

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
