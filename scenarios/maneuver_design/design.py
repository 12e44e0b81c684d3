"""The search for a maneuver: every kind as large as its limits allow, compared at equal amplitude
and time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.maneuver_design import (
    ODDS_COST,
    Acting,
    Contest,
    Planned,
    contest,
    found_by,
    linear_squares,
    price,
    sigmas_of,
)
from scenarios.maneuver_design.coherence import Predicted, predicted_responses
from scenarios.maneuver_design.setting import (
    JUST_FOUND,
    KINDS,
    OVER_A_BAND,
    TYPICAL,
    DesignRequest,
    Setting,
    numbers_of,
    setting_of,
)
from scenarios.maneuver_design.within_limits import LimitedManeuver, within_limits
from sim.declaration.effect import NoiseEffect
from sim.declaration.model import Model
from sim.declaration.proposal import Curve, Traceable
from sim.effects.library import find_effect
from sim.errors import DeclarationError, ModelError

# ---- The effects that are to be told apart

MOST = 3  # effects at once: a diagnosis names two alternatives at most
RANGE = ("low", "high")  # of a curve
HALVINGS = 24


def rivals_of(asked: DesignRequest, model: Model) -> tuple[Traceable, ...]:
    """The effects named by ``--tell``.

    Raises
    ------
    DeclarationError : fewer than two, the same twice, one that cannot act on the model or has no
    simulation that could be compared.
    """
    names = list(asked.tell)
    if not names:
        return ()
    if not 2 <= len(names) <= MOST or len(set(names)) < len(names):
        raise DeclarationError(
            f"{len(names)} effects",
            where="--tell",
            remedy=f"name two different effects, {MOST} at most: --tell A,B",
        )
    found = []
    for name in names:
        try:
            effect = find_effect(name, model.equations)
        except ModelError as error:
            raise DeclarationError(error.what, where="--tell", remedy=error.remedy) from None
        if (
            isinstance(effect, NoiseEffect)
            or not isinstance(effect, Traceable)
            or effect.traits.wrong_samples_of
        ):
            remedy = "no maneuver tells it: it is judged by innovations or sample by sample"
            raise DeclarationError(f"{name} is random", where="--tell", remedy=remedy)
        if any(present.name == effect.name for present in model.effects):
            raise DeclarationError(
                f"{name} belongs to the model already",
                where="--tell",
                remedy="name effects that it lacks",
            )
        found.append(effect)
    return tuple(found)


def sized(asked: DesignRequest, effect: Traceable, reference: Planned) -> Acting:
    """The first effect as it acts: at the values of ``--size``, at typical ones, or where the
    reference maneuver just finds it.
    """
    typical = {item.name: item.value for item in effect.parameters}
    if asked.size == TYPICAL:
        return Acting(effect, typical)
    if asked.size == JUST_FOUND:
        return just_found(effect, reference)
    units = {item.name: item.unit for item in effect.parameters} | (
        {name: _unit(effect) for name in RANGE} if isinstance(effect, Curve) else {}
    )
    given = numbers_of([asked.size], units, "--size")
    over = {name: given.pop(name) for name in RANGE if name in given}
    form = replace(effect, **over) if over else effect  # type: ignore[type-var]
    return Acting(form, {**typical, **given})


def just_found(effect: Traceable, reference: Planned) -> Acting:
    """The effect between absence and its typical values, where its expected gain is what the loop
    asks of an addition.

    Raises DeclarationError where even twice the typical values are not found in the reference
    maneuver.
    """
    typical = {item.name: item.value for item in effect.parameters}
    samples = len(reference.record) * len(reference.outputs)
    bar = ODDS_COST + price(effect, np.array([samples]))

    def at(share: float) -> Acting:
        values = {
            name: effect.absent[name] + share * (value - effect.absent[name])
            if name in effect.absent
            else value
            for name, value in typical.items()
        }
        return Acting(effect, values)

    low, high = 0.0, 2.0
    if 2.0 * found_by(reference, at(high))[1].fit.cost < bar:
        raise DeclarationError(
            f"{effect.name} is not found at twice its usual size",
            where="--size found",
            remedy="give it a size",
        )
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (
            (low, middle)
            if 2.0 * found_by(reference, at(middle))[1].fit.cost > bar
            else (middle, high)
        )
        if high - low < 1e-3 * high:
            break
    return at(high)


def mimicking(reference: Planned, true: Acting, rival: Traceable) -> Acting:
    """The rival at the values with which it looks most like the true effect; typical ones where it
    cannot.
    """
    found = contest(reference, true, rival)
    if found.found - found.left < 0.5 * ODDS_COST:
        return Acting(rival, {item.name: item.value for item in rival.parameters})
    return found.rival


def contests(planned: Planned, acting: Sequence[Acting]) -> tuple[Contest, ...]:
    """The first effect against each other one, and each of these against the first."""
    first, *others = acting
    out = []
    for other in others:
        out += [
            contest(planned, first, other.effect, hint=other.values),
            contest(planned, other, first.effect, hint=first.values),
        ]
    return tuple(out)


def _unit(effect: Traceable) -> str:
    """Unit of a curve's argument: an angle, or that of a stick."""
    return (
        "1" if getattr(effect, "unit", "rad") == "1" and getattr(effect, "control", "") else "rad"
    )


# ---- The search

PACES = (0.25, 0.5, 1.0, 2.0)  # of the pulse that the roots ask for
REFERENCE = "3-2-1-1"


@dataclass(frozen=True, eq=False)
class DesignedManeuver:
    """One kind at its best pace (s).

    ``sigmas`` : expected standard deviations of the free parameters; ``criterion``: the geometric
    mean of these over the values, of those that are determined. ``contests`` of the effects that
    are to be told apart; ``chance``: that it tells whichever of them acts, at least. ``responses``
    : frequency responses over the band that is asked for.
    """

    kind: str
    pace: float
    flight: LimitedManeuver
    sigmas: Mapping[str, float]
    criterion: float
    contests: tuple[Contest, ...] = ()
    responses: Predicted | None = None

    @property
    def chance(self) -> float:
        """The least over the effects of the probability that each is found, and preferred to all
        others by enough.
        """
        missed: dict[str, float] = {}
        for each in self.contests:
            missed[each.true.effect.name] = (
                missed.get(each.true.effect.name, 0.0) + 1.0 - each.chance
            )
        return max(0.0, 1.0 - max(missed.values(), default=1.0))

    @property
    def log_likelihood(self) -> float:
        """The least expected difference of the log likelihoods."""
        return min((each.decision.log_likelihood for each in self.contests), default=0.0)


@dataclass(frozen=True, eq=False)
class DesignResult:
    """Maneuvers, the best first, with what was asked and what that came to; ``acting``: the effects
    with their values.
    """

    asked: DesignRequest
    setting: Setting
    maneuvers: tuple[DesignedManeuver, ...]
    acting: tuple[Acting, ...] = ()

    @property
    def best(self) -> DesignedManeuver:
        return self.maneuvers[0]


def design(
    asked: DesignRequest, progress: Callable[[str, float], None] = lambda stage, share: None
) -> DesignResult:
    """Design a maneuver of each kind and rank them: by the chance to decide, else by the expected
    standard deviations.

    Raises
    ------
    DeclarationError : anything wrong in what is asked, in one line; limits that no maneuver keeps.
    """
    setting = setting_of(asked)
    effects = rivals_of(asked, setting.model)
    acting = _acting(asked, effects, _reference(setting)) if effects else ()
    found = []
    able = [kind for kind in KINDS if kind in asked.flown.kinds]
    kinds = [kind for kind in able if asked.band is None or kind in OVER_A_BAND]
    for number, kind in enumerate(kinds):
        progress(kind, number / len(kinds))
        best = (
            _best_pace(setting, kind, acting)
            if asked.band is None
            else _over_the_band(setting, kind)
        )
        if best is not None:
            found.append(_weighed(setting, kind, *best, acting))
    if not found:
        raise DeclarationError(
            "no kind of maneuver has room", where="--duration", remedy="give a longer one"
        )
    return DesignResult(asked, setting, tuple(sorted(found, key=_rank)), acting)


def _over_the_band(setting: Setting, kind: str) -> tuple[float, np.ndarray, LimitedManeuver] | None:
    """Pace, shapes and flight of one kind over the band that is asked for; None where it has no
    room.
    """
    assert setting.room.band is not None
    pace = np.pi / setting.room.band[1]
    shapes = KINDS[kind](setting.room, pace)
    return None if shapes is None else (pace, shapes, within_limits(setting, shapes, quick=True))


def _rank(maneuver: DesignedManeuver) -> tuple[float, float, float]:
    if maneuver.responses is not None:
        return (maneuver.responses.criterion, 0.0, maneuver.criterion)
    return (-round(maneuver.chance, 3), -min(maneuver.log_likelihood, 1e6), maneuver.criterion)


def _reference(setting: Setting) -> LimitedManeuver:
    """A 3-2-1-1 as the roots ask for, in which sizes are found that look alike; slower ones may
    have no room.
    """
    for share in (1.0, 0.63, 0.4, 0.25):
        shapes = KINDS[REFERENCE](setting.room, _sampled(setting, share))
        if shapes is not None:
            return within_limits(setting, shapes)
    raise DeclarationError(
        "there is no room for a 3-2-1-1", where="--duration", remedy="give a longer one"
    )


def _acting(
    asked: DesignRequest, effects: Sequence[Traceable], reference: LimitedManeuver
) -> tuple[Acting, ...]:
    try:
        first = sized(asked, effects[0], reference.planned)
        return (first, *(mimicking(reference.planned, first, other) for other in effects[1:]))
    except ModelError as error:
        raise DeclarationError(
            f"{effects[0].name} of this size: {error.what}",
            where="--size",
            remedy="give a smaller one",
        ) from None


def _sampled(setting: Setting, share: float) -> float:
    """A pace that is a whole number of samples and no shorter than can be flown, s."""
    interval = setting.room.interval
    least = math.ceil(setting.flown.shortest_step / interval - 1e-9)
    return max(1, least, round(share * setting.room.pulse / interval)) * interval


def _best_pace(
    setting: Setting, kind: str, acting: Sequence[Acting]
) -> tuple[float, np.ndarray, LimitedManeuver] | None:
    """Pace, shapes and flight of one kind that serves best by the quick criterion; None where none
    has room.
    """
    best, least = None, np.inf
    for pace in dict.fromkeys(_sampled(setting, share) for share in PACES):
        shapes = KINDS[kind](setting.room, pace)
        if shapes is None:
            continue
        try:
            flight = within_limits(setting, shapes, quick=True)
            cost = (
                -min(linear_squares(flight.planned, acting[0], other) for other in acting[1:])
                if acting
                else _criterion(flight)
            )
        except ModelError:
            continue
        if cost < least:
            best, least = (pace, shapes, flight), cost
    return best


def _weighed(
    setting: Setting,
    kind: str,
    pace: float,
    shapes: np.ndarray,
    quick: LimitedManeuver,
    acting: Sequence[Acting],
) -> DesignedManeuver:
    flight = within_limits(setting, shapes, start=quick.scale, bound_by=quick.bound_by)
    sigmas = sigmas_of(flight.motion.fit)
    responses = predicted_responses(setting, flight) if setting.room.band is not None else None
    told = contests(flight.planned, acting) if acting else ()
    return DesignedManeuver(kind, pace, flight, sigmas, _criterion(flight), told, responses)


def _criterion(flight: LimitedManeuver) -> float:
    """Geometric mean of sigma over value of what is determined to better than its value: the lower,
    the better.
    """
    sigmas = sigmas_of(flight.motion.fit)
    parameters = flight.motion.model.parameters
    shares = [
        min(std / abs(parameters[name].value), 1.0)
        for name, std in sigmas.items()
        if parameters[name].value != 0.0
    ]
    return float(np.exp(np.mean(np.log(shares)))) if shares else 1.0
