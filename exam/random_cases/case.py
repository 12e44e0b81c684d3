"""Kinds, cases and scores of a random examination, and the draws of sizes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from exam.scoring import Statement
from sim.declaration.model import Model
from sim.record import Record

# ---- What a case is

AIRCRAFT = ("rigid", "loes")
ALL = ("rigid", "loes", "ballistic")


@dataclass(frozen=True)
class Setting:
    """One record of a case, from which sizes are drawn.

    ``peak`` the largest deflection in the control's unit, ``duration`` and ``interval`` (sampling)
    in s. The three scales take sizes that are said for the rigid aircraft to the equations at hand:
    ``moment`` and ``lift`` the unit of its ports in coefficients, ``control`` that of the control
    in radians.
    """

    model: Model
    peak: float
    duration: float
    interval: float
    moment: float = 1.0
    lift: float = 1.0
    control: float = 1.0

    def value(self, name: str) -> float:
        """A true parameter."""
        return self.model.parameters[name].value


Draw = Callable[[np.random.Generator, Setting], Mapping[str, float]]
Spoil = Callable[[Record, Mapping[str, float], np.random.Generator], Record]


@dataclass(frozen=True)
class Kind:
    """Something that may be hidden.

    Attributes
    ----------
    draw : its parameters, from a generator and the setting. models : on which it is drawn; channels
    : it needs to be seen. term : hides it in the flight; ``spoils`` : puts it into the finished
    record instead. answer : the effect that names it, empty where nothing in the library does.
    accepted : names that are no wrong claim beside the answer, and name it where there is none.
    words : by which a warning names a recorder's fault. apart : drawn anew for the second record,
    but the parameters in ``same``.
    """

    draw: Draw
    term: str = ""
    answer: str = ""
    models: tuple[str, ...] = AIRCRAFT
    channels: tuple[str, ...] = ()
    spoils: Spoil | None = None
    accepted: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    apart: bool = False
    same: tuple[str, ...] = ()

    @property
    def group(self) -> str:
        """``effect``, ``foreign`` or ``recorder``."""
        return "effect" if self.answer else "recorder" if self.spoils else "foreign"


@dataclass(frozen=True)
class Case:
    """One record pair with what is hidden in it; ``rate`` in samples a second."""

    seed: int
    aircraft: str
    hidden: tuple[str, ...]
    answers: frozenset[str]
    outside: bool
    channels: tuple[str, ...]
    rate: float
    model: str = "rigid"
    group: str = ""


@dataclass(frozen=True)
class Named:
    """A name in an answer, and whether it is what was hidden."""

    name: str
    hidden: bool


@dataclass(frozen=True)
class CaseScore:
    """A case marked.

    Attributes
    ----------
    verdict : ``refused`` where the files were not taken, ``failed`` where the loop broke off.
    claimed : names claimed; ``claims`` : for each its name, then its alternatives.
    right : the names are those hidden, or none where nothing is; of what no effect names,
    ``unexplained``; of a recorder's fault also a word on it. wrong : a claim names what is not
    there. errors : of derivatives, in reported standard deviations. held_out : the worst channel's
    error over the noise, zero without a diagnosis. statements : the claims with what they were
    weighed against, for the reliability of their probabilities. values : of what is hidden, in the
    fitted record. seconds : of the processor, for the diagnosis. said : why there is no diagnosis.
    """

    case: Case
    verdict: str
    claimed: tuple[str, ...]
    right: bool
    wrong: bool
    errors: Mapping[str, float]
    held_out: float
    seconds: float
    claims: tuple[tuple[Named, ...], ...] = ()
    statements: tuple[Statement, ...] = ()
    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    said: str = ""


# ---- How parameters of what is hidden are drawn


def uniform(low: float, high: float, local: str) -> Draw:
    """Even in the logarithm."""
    return lambda rng, s: {local: float(np.exp(rng.uniform(math.log(low), math.log(high))))}


def share(low: float, high: float, local: str) -> Draw:
    """A share of the largest deflection."""
    return lambda rng, s: {local: float(s.peak * rng.uniform(low, high))}


def signed(low: float, high: float, local: str) -> Draw:
    """Of either sign."""
    return lambda rng, s: {local: either(rng) * float(rng.uniform(low, high))}


def either(rng: np.random.Generator) -> float:
    """One or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def pulse(
    rng: np.random.Generator, s: Setting, shortest: float, longest: float, last: float = 0.7
) -> tuple[float, float]:
    """Begin and length of something that happens in a record, s; it begins at ``last`` of the
    record at the latest.
    """
    return float(rng.uniform(0.1, last) * s.duration), float(rng.uniform(shortest, longest))


def several(rng: np.random.Generator, **spans: tuple[float, float]) -> Mapping[str, float]:
    """Every parameter evenly between its ends."""
    return {name: float(rng.uniform(*span)) for name, span in spans.items()}
