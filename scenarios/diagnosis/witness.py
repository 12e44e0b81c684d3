"""The check of the kinematics as a witness of the tracing loop: asked when a ranking hangs on it, and made once at most."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from ident.alongside import Alongside
from ident.compatibility.result import Compatibility, SensorFinding
from ident.tracing.diagnosis import Claim, Quantity
from scenarios.diagnosis.kinematics import AGREES, CONTRADICTS, DIFFERS, IN_KIND, MIRRORED, Kinematics, agreements, late_instead, worth_of

_WORTH: Mapping[str, int] = {AGREES: 1, IN_KIND: 1, DIFFERS: 1, CONTRADICTS: -1}

# What the relation alpha_dot = q - (g/V) nz cannot tell from another effect, and the channels that do tell them apart.
EXACT_TWINS: Mapping[str, tuple[str, frozenset[str]]] = {
    "sensor-scale:alpha": ("time-base", frozenset({"theta"})),  # a slow clock divides alpha_dot, and with it theta_dot
    "sensor-scale:q": ("time-base", frozenset({"theta", "airspeed"})),  # as a scale of q and nz, and nz has that of an airspeed that is wrong
    "sensor-scale:nz": ("sensor-coupling:q", frozenset({"theta"})),  # a gyro that feels k nz: as (g/V + k) nz
    "vane-offset": ("accelerometer-offset:nz", frozenset()),  # (g/V) (arm/g) q_dot, integrated: (arm/V) q; of sideslip that of ny
    "accelerometer-offset:nz": ("vane-offset", frozenset()),
    "accelerometer-offset:ny": ("vane-offset", frozenset()),
    "sensor-scale:p": ("time-base", frozenset({"beta"})),  # phi alone turns with p
    "sensor-scale:phi": ("time-base", frozenset({"beta"})),
}


@dataclass(frozen=True, eq=False)
class KinematicWitness:
    """Says of an effect whether the kinematics alone speak for it (1), against it (-1), or not at all (0).

    ``check`` makes the check; None where there is none to make. A fault that stands there with another value is there all the same. Of a fault
    that is word for word another effect to the kinematics (``twin_of``), alone or with its group, they say nothing.
    """

    check: Callable[[], Kinematics] | None

    @cached_property
    def _checking(self) -> Alongside[Kinematics] | None:
        return Alongside(self.check) if self.check is not None else None

    @cached_property
    def kinematics(self) -> Kinematics | None:
        return self._checking.result() if self._checking is not None else None

    def prepare(self) -> None:
        """It is going to be asked: the check begins, beside what else is done."""
        if self._checking is not None and "kinematics" not in self.__dict__:
            self._checking.begin()

    def __enter__(self) -> KinematicWitness:
        return self

    def __exit__(self, *raised: object) -> None:
        """Nobody asks any more."""
        if self._checking is not None:
            self._checking.drop()

    def __call__(self, effect: str, parameters: Mapping[str, Quantity]) -> int:
        if self.kinematics is None or self.kinematics.result is None or shares_a_twin(effect, self.kinematics.result):
            return 0
        said = agreements(self.kinematics, [Claim(effect, parameters)])
        return _WORTH.get(said[0].says, 0) if said else 0

    def evidence(self, effect: str, parameters: Mapping[str, Quantity]) -> float:
        """How strongly the kinematics speak for an effect of these values (``kinematic_evidence``); zero where there is no check."""
        return kinematic_evidence(self.kinematics, effect, parameters) if self.kinematics is not None else 0.0

    def against(self, effect: str, parameters: Mapping[str, Quantity]) -> float:
        """How strongly they speak against it (``kinematic_contradiction``); zero where there is no check."""
        return kinematic_contradiction(self.kinematics, effect, parameters) if self.kinematics is not None else 0.0


def kinematic_evidence(kinematics: Kinematics, effect: str, parameters: Mapping[str, Quantity]) -> float:
    """Log likelihood by which the kinematics alone speak for an effect of these values, against its absence; negative where they speak against it.

    The faults that stand there take part all along. A fault among them brings what it gains beside the others, less half the square of how
    far the values are apart in sigmas; one that another has been found for in its place brings, negative, what it loses to that one; any
    other what it would gain beside all, less the same half square, but loses no more than it would in the place of one of them. Over the
    colour of what is left throughout. Zero of effects that are no fault of a sensor here, that the channels cannot tell, on which the two
    methods disagree, or that share a twin (``shares_a_twin``).

    The members of a group are within chance of each other: each has about the evidence of the whole group.
    """
    result = kinematics.result
    if result is None or not parameters or shares_a_twin(effect, result):
        return 0.0
    item = next((each for each in result.joint.estimates if each.name == effect), None)
    own = next((each for each in result.findings if each.name == effect), None)
    if item is None or own is None or not item.told or not item.agrees:
        return 0.0
    apart = _half_square_apart(own, next(iter(parameters.values())))
    lost = own.lost if own.lost is not None else math.inf
    said = -lost - apart if late_instead(own, result) is not None else max(own.gain - apart, -lost)
    return said if math.isfinite(said) else 0.0


def kinematic_contradiction(kinematics: Kinematics, effect: str, parameters: Mapping[str, Quantity]) -> float:
    """Log likelihood by which the kinematics alone speak against an effect of these values, zero or more.

    As ``kinematic_evidence`` where they can speak for it. Of an arm, which they cannot tell from its twin, they know the size of either all the
    same: where one of the two stands, by half the square of how far the sizes are apart in sigmas, less what it gains.
    """
    result = kinematics.result
    if result is None or not parameters:
        return 0.0
    if not shares_a_twin(effect, result):
        return max(0.0, -kinematic_evidence(kinematics, effect, parameters))
    own = next((each for each in result.findings if each.stands and each.name in (effect, MIRRORED.get(effect))), None)
    if own is None:
        return 0.0
    value = own.value if own.name == effect else -own.value
    said = _half_square_apart(replace(own, value=value), next(iter(parameters.values()))) - own.gain
    return max(0.0, said) if math.isfinite(said) else 0.0


def twin_of(effect: str, channels: tuple[str, ...]) -> str:
    """The effect that is word for word the same to the kinematics of these channels; empty where there is none."""
    twin, told_by = EXACT_TWINS.get(effect, ("", frozenset()))
    return twin if not told_by.intersection(channels) else ""


def _half_square_apart(own: SensorFinding, mine: Quantity) -> float:
    """Half the square of how far two values are apart in sigmas."""
    # A tenth of what is common in practice is what interpolation makes; half of it as one sigma.
    return 0.5 * ((own.value - mine.value) / math.hypot(own.std, mine.std, 0.5 * worth_of(own))) ** 2


def shares_a_twin(effect: str, result: Compatibility) -> bool:
    """Whether an effect, or one of the group that stands for it, has such a twin: what speaks for it speaks for that as well."""
    names = {effect}
    for finding in result.findings:
        if finding.stands and effect in (finding.name, *finding.group):
            names |= {finding.name, *finding.group}
    return any(twin_of(name, result.channels) for name in names)
