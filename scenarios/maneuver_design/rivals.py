"""The effects that are to be told apart: found in the library, the first at a declared size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.maneuver_design.planned_flight import Planned
from ident.maneuver_design.rivalry import ODDS_COST, Acting, Contest, contest, found_by, price
from scenarios.maneuver_design.asked import JUST_FOUND, TYPICAL, Asked
from scenarios.maneuver_design.setting import numbers_of
from sim.declaration.effect import NoiseEffect
from sim.declaration.model import Model
from sim.declaration.proposal import Curve, Traceable
from sim.effects.library import find_effect
from sim.errors import DeclarationError, ModelError

MOST = 3  # effects at once: a diagnosis names two alternatives at most
RANGE = ("low", "high")  # of a curve
HALVINGS = 24


def rivals_of(asked: Asked, model: Model) -> tuple[Traceable, ...]:
    """The effects named by ``--tell``.

    Raises
    ------
    DeclarationError : fewer than two, the same twice, one that cannot act on the model or has no simulation that could be compared.
    """
    names = list(asked.tell)
    if not names:
        return ()
    if not 2 <= len(names) <= MOST or len(set(names)) < len(names):
        raise DeclarationError(f"{len(names)} effects", where="--tell", remedy=f"name two different effects, {MOST} at most: --tell A,B")
    found = []
    for name in names:
        try:
            effect = find_effect(name, model.equations)
        except ModelError as error:
            raise DeclarationError(error.what, where="--tell", remedy=error.remedy) from None
        if isinstance(effect, NoiseEffect) or not isinstance(effect, Traceable) or effect.traits.wrong_samples_of:
            remedy = "no maneuver tells it: it is judged by innovations or sample by sample"
            raise DeclarationError(f"{name} is random", where="--tell", remedy=remedy)
        if any(present.name == effect.name for present in model.effects):
            raise DeclarationError(f"{name} belongs to the model already", where="--tell", remedy="name effects that it lacks")
        found.append(effect)
    return tuple(found)


def sized(asked: Asked, effect: Traceable, reference: Planned) -> Acting:
    """The first effect as it acts: at the values of ``--size``, at typical ones, or where the reference maneuver just finds it."""
    typical = {item.name: item.value for item in effect.parameters}
    if asked.size == TYPICAL:
        return Acting(effect, typical)
    if asked.size == JUST_FOUND:
        return just_found(effect, reference)
    units = {item.name: item.unit for item in effect.parameters} | ({name: _unit(effect) for name in RANGE} if isinstance(effect, Curve) else {})
    given = numbers_of([asked.size], units, "--size")
    over = {name: given.pop(name) for name in RANGE if name in given}
    form = replace(effect, **over) if over else effect  # type: ignore[type-var]
    return Acting(form, {**typical, **given})


def just_found(effect: Traceable, reference: Planned) -> Acting:
    """The effect between absence and its typical values, where its expected gain is what the loop asks of an addition.

    Raises DeclarationError where even twice the typical values are not found in the reference maneuver.
    """
    typical = {item.name: item.value for item in effect.parameters}
    samples = len(reference.record) * len(reference.outputs)
    bar = ODDS_COST + price(effect, np.array([samples]))

    def at(share: float) -> Acting:
        values = {
            name: effect.absent[name] + share * (value - effect.absent[name]) if name in effect.absent else value for name, value in typical.items()
        }
        return Acting(effect, values)

    low, high = 0.0, 2.0
    if 2.0 * found_by(reference, at(high))[1].fit.cost < bar:
        raise DeclarationError(f"{effect.name} is not found at twice its usual size", where="--size found", remedy="give it a size")
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if 2.0 * found_by(reference, at(middle))[1].fit.cost > bar else (middle, high)
        if high - low < 1e-3 * high:
            break
    return at(high)


def mimicking(reference: Planned, true: Acting, rival: Traceable) -> Acting:
    """The rival at the values with which it looks most like the true effect; typical ones where it cannot."""
    found = contest(reference, true, rival)
    if found.found - found.left < 0.5 * ODDS_COST:
        return Acting(rival, {item.name: item.value for item in rival.parameters})
    return found.rival


def contests(planned: Planned, acting: Sequence[Acting]) -> tuple[Contest, ...]:
    """The first effect against each other one, and each of these against the first."""
    first, *others = acting
    out = []
    for other in others:
        out += [contest(planned, first, other.effect, hint=other.values), contest(planned, other, first.effect, hint=first.values)]
    return tuple(out)


def _unit(effect: Traceable) -> str:
    """Unit of a curve's argument: an angle, or that of a stick."""
    return "1" if getattr(effect, "unit", "rad") == "1" and getattr(effect, "control", "") else "rad"
