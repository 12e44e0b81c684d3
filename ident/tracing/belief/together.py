"""Effects of one set that stand for one cause: two words for one thing fit it, and neither is its name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from math import hypot

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Caution, Concern, Quantity, Requirement
from sim.declaration.effect import Station
from sim.declaration.proposal import Traceable

Found = Sequence[tuple[Traceable, Mapping[str, Quantity]]]


def one_cause(best: FittedModel, found: Found) -> list[Caution]:
    """Cautions where effects with these parameters (by local name) stand for one cause that is none of them; empty where they do not."""
    return [*_at_one_moment(best, found), *_of_one_curve(best), *_beside_a_general_form(best)]


def _at_one_moment(best: FittedModel, found: Found) -> list[Caution]:
    """Two events that begin together. By chance two begin within a share s of the record's span in 2 s of all records."""
    span = max(float(problem.record.time[-1] - problem.record.time[0]) for problem in best.fit.layout.problems)
    events = [(effect, values[effect.traits.onset]) for effect, values in found if effect.traits.onset in values]
    out = []
    for (one, at), (other, then) in combinations(events, 2):
        near = max(thresholds.COINCIDENT * span, thresholds.OFF_ABSENCE * hypot(at.std, then.std))
        if abs(at.value - then.value) < near and not may_begin_together(one, other):
            told = f"{one.name} and {other.name} begin at the same moment ({at.value:.3g} s): one occurrence, which neither describes"
            words = f"the time between the begins of {one.name} and {other.name}"
            asked = Requirement(words, abs(at.value - then.value), near, at_least=True, unit="s", effects=(one.name, other.name))
            out.append(Caution(Concern.ONE_CAUSE, told, requirement=asked))
    return out


def may_begin_together(one: Traceable, other: Traceable) -> bool:
    """Whether one occurrence may have both events for its parts: a change of the aircraft with any other, or loads of one kind in two axes."""
    changed = Station.DYNAMICS in (one.station, other.station)
    return changed or (one.station is other.station is Station.DISTURBANCE and _family(one) == _family(other))


def _family(effect: Traceable) -> str:
    return effect.name.partition(":")[0]


def _of_one_curve(best: FittedModel) -> list[Caution]:
    """Two forces of a body that nothing drives and of which one output is recorded: a single curve shows one cause, whatever its form."""
    forces = _forces(best)
    if not _is_one_curve(best) or len(forces) < 2:
        return []
    told = f"it takes {' and '.join(forces)} together to fit one curve of one output, which does not tell two forces from one of another form"
    asked = Requirement("the number of forces fitted to one curve of one output", len(forces), 1, at_least=False, effects=tuple(forces))
    return [Caution(Concern.ONE_CAUSE, told, requirement=asked)]


def _beside_a_general_form(best: FittedModel) -> list[Caution]:
    """A curve of any signal bends to whatever shape the cause has, nearly: a force or an input beside it may be what it misses of that one cause.

    What is wrong with a sensor is not: it acts behind all forces.
    """
    general = [effect.name for effect in best.foreground if effect.traits.general]
    others = (effect for effect in best.foreground if not (effect.traits.general or effect.traits.guard))
    beside = [effect.name for effect in others if effect.station is not Station.SENSOR_PATH]
    if not general or not beside:
        return []
    told = f"{' and '.join(general)} leaves noise only with {' and '.join(beside)} beside it, which may be what the curve misses of the cause"
    words = "the number of other causes beside a curve of any signal"
    asked = Requirement(words, len(beside), 0, at_least=False, effects=(*general, *beside))
    return [Caution(Concern.ONE_CAUSE, told, requirement=asked)]


def is_open_form(best: FittedModel) -> bool:
    """Whether a set that leaves more than noise has a force in one curve of one output: with what it leaves it is a force of another form."""
    return _is_one_curve(best) and bool(_forces(best))


def _is_one_curve(best: FittedModel) -> bool:
    return len(best.fit.layout.problems) == 1 and len(best.system.output_names) == 1 and not best.system.input_names


def _forces(best: FittedModel) -> list[str]:
    return [effect.name for effect in best.foreground if effect.station in (Station.DYNAMICS, Station.DISTURBANCE) and not effect.traits.guard]
