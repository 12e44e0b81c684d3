"""The dominant effect of a surrogate flight. It is drawn by name, with a size at which it causes a
given share of the declared model's error.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from exam.surrogates.declaration import LATERAL, LONGITUDINAL
from exam.surrogates.fitting import declared_model, misfit
from exam.surrogates.flights.drawing import SPEED, Dominant, Drawn, hiding
from exam.surrogates.flights.flying import fly_drawn
from exam.surrogates.flights.kinds import KINDS, Kind, values_at
from exam.surrogates.flights.lateral.drawing import LATERAL_KINDS
from sim.effects.library import find_effect
from sim.errors import DeclarationError, ModelError

LEAST = 0.3  # smallest share of the error that a dominant effect causes
SIZED_ON = 2  # records that determine the size
SIZING_STEP = 0.01  # s
ROUNDS = 4
OF_AXIS = {LONGITUDINAL: KINDS, LATERAL: LATERAL_KINDS}


def draw_dominant(drawn: Drawn, rng: np.random.Generator) -> Drawn:
    """Return the flight with as many effects as it declares; names whose largest size is still too
    small are skipped.

    Raises
    ------
    DeclarationError : a name that cannot be hidden, or too few of the names make a difference on
    this flight.
    """
    wanted = drawn.surrogate.hidden
    for name in wanted.names:
        _kind(drawn, name)
    chosen: list[Dominant] = []
    if wanted.count:
        seed = int(rng.integers(2**32))
        before = misfit(_records(drawn, seed), declared_model(drawn.declared, drawn.starts))
        for name in rng.permutation(list(wanted.names)):
            if any(group(str(name)) == group(other.name) for other in chosen):
                continue
            if name in wanted.sizes:
                found = of_declared_size(drawn, str(name), before, seed, rng)
            else:
                found = sized(drawn, str(name), rng.uniform(*wanted.reduction), before, seed, rng)
            if found is not None:
                chosen.append(found)
            if len(chosen) == wanted.count:
                return hiding(drawn, tuple(chosen))
        what = f"only {len(chosen)} of {wanted.count} effects make a difference on this flight"
        raise DeclarationError(
            what, where="key hidden", remedy="name more effects, or ask for a smaller reduction"
        )
    return drawn


def sized(
    drawn: Drawn,
    name: str,
    reduction: float,
    before: np.ndarray,
    seed: int,
    rng: np.random.Generator,
) -> Dominant | None:
    """Return an effect with the size that gives the wanted error of the declared model.

    In the channel that shows the effect most, the error is that of a flight without it over (1 -
    reduction). ``before`` is the misfit without the effect, of the same records with the same
    random numbers. None is returned if its largest size stays below ``LEAST``.
    """
    at = _kind(drawn, name)(drawn, rng)
    effect: Any = find_effect(name, drawn.model.equations)
    if hasattr(effect, "low"):
        reach = _peak(drawn, effect.control) if name.startswith("control") else 0.09
        effect = replace(effect, low=-reach, high=reach)
    count = len(drawn.maneuvers)
    records = (
        (int(rng.integers(count)),)
        if effect.traits.per_record and name != SPEED
        else tuple(range(count))
    )
    sizing = tuple(range(SIZED_ON)) if len(records) == 1 else records
    model, wanted = declared_model(drawn.declared, drawn.starts), -math.log(1.0 - reduction)

    def reached(size: float) -> float:
        changed = hiding(drawn, (Dominant(effect, at(size), sizing),))
        try:
            return float(np.max(np.log(misfit(_records(changed, seed), model) / before)))
        except ModelError:
            return math.inf

    # The square of the misfit is nearly proportional to that of the size. Where this fails, a
    # step is
    # halved.
    size, low, high = 0.3, 0.0, 1.0
    for _ in range(ROUNDS):
        now = reached(size)
        if abs(now - wanted) < 0.1 * wanted or (now < wanted and size >= 1.0):
            break
        low, high = (size, high) if now < wanted else (low, size)
        step = math.sqrt(math.expm1(2.0 * wanted) / max(math.expm1(2.0 * min(now, 5.0)), 1e-4))
        size = (
            min(size * step, 1.0)
            if low < size * step < high or (size * step >= 1.0 and high == 1.0)
            else 0.5 * (low + high)
        )
    else:
        now = reached(size)
    return (
        Dominant(effect, at(size), records)
        if now > -math.log(1.0 - LEAST) and math.isfinite(now)
        else None
    )


def of_declared_size(
    drawn: Drawn, name: str, before: np.ndarray, seed: int, rng: np.random.Generator
) -> Dominant | None:
    """Return an effect with a size from its declared span, drawn uniformly among sizes that cause
    at least ``LEAST`` of the error.

    None is returned if the largest size does not. ``before`` and ``seed`` are as in ``sized``.
    """
    low, high = drawn.surrogate.hidden.sizes[name]
    effect, sign = find_effect(name, drawn.model.equations), float(rng.choice([-1.0, 1.0]))
    model, records = (
        declared_model(drawn.declared, drawn.starts),
        tuple(range(len(drawn.maneuvers))),
    )
    for left in reversed(range(ROUNDS)):
        size = rng.uniform(low, high) if left else high
        found = Dominant(effect, values_at(drawn, name, size, sign), records)
        if float(np.max(misfit(_records(hiding(drawn, (found,)), seed), model) / before)) > 1.0 / (
            1.0 - LEAST
        ):
            return found
        low = size  # a larger size has a larger effect
    return None


def group(name: str) -> str:
    """Return the group of an effect with similar traces; only one effect of a group is hidden at a
    time.
    """
    kind, _, channel = name.partition(":")
    if name in ("vane-offset", "accelerometer-offset:nz", "accelerometer-offset:ny"):
        return "late alpha"
    if kind in ("sensor-lag", "sensor-delay"):
        return f"late {channel}"
    if kind in ("input-delay", "actuator-lag", "actuator-rate-limit"):
        return "late input"
    if kind in ("input-deadband", "actuator-saturation", "control-nonlinearity", "input-backlash"):
        return "control curve"
    return kind


def _records(drawn: Drawn, seed: int) -> list:
    return [
        flown.record
        for flown in fly_drawn(drawn, np.random.default_rng(seed), step=SIZING_STEP, count=SIZED_ON)
    ]


def _peak(drawn: Drawn, signal: str) -> float:
    return max(float(np.max(np.abs(move.values))) for move in drawn.moves(signal))


def _kind(drawn: Drawn, name: str) -> Kind:
    kinds = OF_AXIS[drawn.surrogate.flight.axis]
    if name not in kinds:
        raise DeclarationError(
            f"{name!r} cannot be hidden", where="key hidden.names", remedy=f"use {', '.join(kinds)}"
        )
    return kinds[name]
