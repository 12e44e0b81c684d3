"""The search: every kind of maneuver at the pace that serves best, compared at equal peak amplitude and time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.maneuver_design.planned_flight import sigmas_of
from ident.maneuver_design.rivalry import Acting, Contest, linear_squares
from scenarios.maneuver_design.asked import Asked
from scenarios.maneuver_design.coherence import Predicted, predicted_responses
from scenarios.maneuver_design.kinds import KINDS, OVER_A_BAND
from scenarios.maneuver_design.rivals import contests, mimicking, rivals_of, sized
from scenarios.maneuver_design.setting import Setting, setting_of
from scenarios.maneuver_design.within_limits import Flight, within_limits
from sim.declaration.proposal import Traceable
from sim.errors import DeclarationError, ModelError

PACES = (0.25, 0.5, 1.0, 2.0)  # of the pulse that the roots ask for
REFERENCE = "3-2-1-1"


@dataclass(frozen=True, eq=False)
class Maneuver:
    """One kind at its best pace (s).

    ``sigmas`` : expected standard deviations of the free parameters; ``criterion``: the geometric mean of these over the values, of those that
    are determined. ``contests`` of the effects that are to be told apart; ``chance``: that it tells whichever of them acts, at least.
    ``responses`` : frequency responses over the band that is asked for.
    """

    kind: str
    pace: float
    flight: Flight
    sigmas: Mapping[str, float]
    criterion: float
    contests: tuple[Contest, ...] = ()
    responses: Predicted | None = None

    @property
    def chance(self) -> float:
        """The least over the effects of the probability that each is found, and preferred to all others by enough."""
        missed: dict[str, float] = {}
        for each in self.contests:
            missed[each.true.effect.name] = missed.get(each.true.effect.name, 0.0) + 1.0 - each.chance
        return max(0.0, 1.0 - max(missed.values(), default=1.0))

    @property
    def log_likelihood(self) -> float:
        """The least expected difference of the log likelihoods."""
        return min((each.decision.log_likelihood for each in self.contests), default=0.0)


@dataclass(frozen=True, eq=False)
class Design:
    """Maneuvers, the best first, with what was asked and what that came to; ``acting``: the effects with their values."""

    asked: Asked
    setting: Setting
    maneuvers: tuple[Maneuver, ...]
    acting: tuple[Acting, ...] = ()

    @property
    def best(self) -> Maneuver:
        return self.maneuvers[0]


def design(asked: Asked, progress: Callable[[str, float], None] = lambda stage, share: None) -> Design:
    """Design a maneuver of each kind and rank them: by the chance to decide, else by the expected standard deviations.

    Raises
    ------
    DeclarationError : anything wrong in what is asked, in one line; limits that no maneuver keeps.
    """
    setting = setting_of(asked)
    effects = rivals_of(asked, setting.model)
    acting = _acting(asked, effects, _reference(setting)) if effects else ()
    found = []
    kinds = [kind for kind in KINDS if asked.band is None or kind in OVER_A_BAND]
    for number, kind in enumerate(kinds):
        progress(kind, number / len(kinds))
        best = _best_pace(setting, kind, acting) if asked.band is None else _over_the_band(setting, kind)
        if best is not None:
            found.append(_weighed(setting, kind, *best, acting))
    if not found:
        raise DeclarationError("no kind of maneuver has room", where="--duration", remedy="give a longer one")
    return Design(asked, setting, tuple(sorted(found, key=_rank)), acting)


def _over_the_band(setting: Setting, kind: str) -> tuple[float, np.ndarray, Flight] | None:
    """Pace, shapes and flight of one kind over the band that is asked for; None where it has no room."""
    assert setting.room.band is not None
    pace = np.pi / setting.room.band[1]
    shapes = KINDS[kind](setting.room, pace)
    return None if shapes is None else (pace, shapes, within_limits(setting, shapes, quick=True))


def _rank(maneuver: Maneuver) -> tuple[float, float, float]:
    if maneuver.responses is not None:
        return (maneuver.responses.criterion, 0.0, maneuver.criterion)
    return (-round(maneuver.chance, 3), -min(maneuver.log_likelihood, 1e6), maneuver.criterion)


def _reference(setting: Setting) -> Flight:
    """A 3-2-1-1 as the roots ask for, in which sizes are found that look alike; slower ones may have no room."""
    for share in (1.0, 0.63, 0.4, 0.25):
        shapes = KINDS[REFERENCE](setting.room, _sampled(setting, share))
        if shapes is not None:
            return within_limits(setting, shapes)
    raise DeclarationError("there is no room for a 3-2-1-1", where="--duration", remedy="give a longer one")


def _acting(asked: Asked, effects: Sequence[Traceable], reference: Flight) -> tuple[Acting, ...]:
    try:
        first = sized(asked, effects[0], reference.planned)
        return (first, *(mimicking(reference.planned, first, other) for other in effects[1:]))
    except ModelError as error:
        raise DeclarationError(f"{effects[0].name} of this size: {error.what}", where="--size", remedy="give a smaller one") from None


def _sampled(setting: Setting, share: float) -> float:
    """A pace that is a whole number of samples, s."""
    return max(1.0, round(share * setting.room.pulse / setting.room.interval)) * setting.room.interval


def _best_pace(setting: Setting, kind: str, acting: Sequence[Acting]) -> tuple[float, np.ndarray, Flight] | None:
    """Pace, shapes and flight of one kind that serves best by the quick criterion; None where none has room."""
    best, least = None, np.inf
    for pace in dict.fromkeys(_sampled(setting, share) for share in PACES):
        shapes = KINDS[kind](setting.room, pace)
        if shapes is None:
            continue
        try:
            flight = within_limits(setting, shapes, quick=True)
            cost = -min(linear_squares(flight.planned, acting[0], other) for other in acting[1:]) if acting else _criterion(flight)
        except ModelError:
            continue
        if cost < least:
            best, least = (pace, shapes, flight), cost
    return best


def _weighed(setting: Setting, kind: str, pace: float, shapes: np.ndarray, quick: Flight, acting: Sequence[Acting]) -> Maneuver:
    flight = within_limits(setting, shapes, start=quick.scale, bound_by=quick.bound_by)
    sigmas = sigmas_of(flight.motion.fit)
    responses = predicted_responses(setting, flight) if setting.room.band is not None else None
    told = contests(flight.planned, acting) if acting else ()
    return Maneuver(kind, pace, flight, sigmas, _criterion(flight), told, responses)


def _criterion(flight: Flight) -> float:
    """Geometric mean of sigma over value of what is determined to better than its value: the lower, the better."""
    sigmas = sigmas_of(flight.motion.fit)
    parameters = flight.motion.model.parameters
    shares = [min(std / abs(parameters[name].value), 1.0) for name, std in sigmas.items() if parameters[name].value != 0.0]
    return float(np.exp(np.mean(np.log(shares)))) if shares else 1.0
