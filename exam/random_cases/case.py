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

    ``peak`` is the largest deflection in the control's unit; ``duration`` and ``interval``
    (sampling) are in s. Sizes are given for the rigid aircraft. The three scales convert them to
    other equations: ``moment`` and ``lift`` are the units of the ports in coefficients, ``control``
    is that of the control in radians.
    """

    model: Model
    peak: float
    duration: float
    interval: float
    moment: float = 1.0
    lift: float = 1.0
    control: float = 1.0

    def value(self, name: str) -> float:
        """Return a true parameter."""
        return self.model.parameters[name].value


Draw = Callable[[np.random.Generator, Setting], Mapping[str, float]]
Spoil = Callable[[Record, Mapping[str, float], np.random.Generator], Record]


@dataclass(frozen=True)
class Kind:
    """A kind of hidden cause.

    Attributes
    ----------
    draw : draws the parameters, from a generator and the setting.
    term : name of the term that acts in the flight.
    answer : name of the effect that is the right answer; empty if the library has none.
    models : models on which the kind is drawn.
    channels : channels that must be recorded for the kind to be observable.
    spoils : function that puts the kind into the finished record, instead of ``term``.
    accepted : names that are not wrong in addition to the answer; without an answer they are right.
    words : words by which a warning names a fault of the recorder.
    apart : whether the parameters are drawn again for the second record.
    same : parameters that are not drawn again.
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
    """One pair of records with a hidden cause; ``rate`` is in samples per second."""

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
    """A name in an answer, and whether it is a hidden cause."""

    name: str
    hidden: bool


@dataclass(frozen=True)
class CaseScore:
    """The score of a case.

    Attributes
    ----------
    verdict : verdict of the diagnosis; ``refused`` if the files were refused, ``failed`` if the
        loop failed.
    claimed : claimed names.
    right : whether the names are the hidden ones, or none if nothing is hidden. For a cause without
        a name ``unexplained`` is right; for a fault of the recorder also a warning about it.
    wrong : whether a claim names a cause that is not there.
    errors : errors of derivatives, in reported standard deviations.
    held_out : error of the worst channel over the noise, zero without a diagnosis.
    seconds : processor time of the diagnosis.
    claims : names of each claim, followed by its alternatives.
    statements : the claims with their truth, for the reliability of their probabilities.
    values : values of the hidden causes in the fitted record.
    said : reason why there is no diagnosis.
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
    """Draw uniformly in the logarithm."""
    return lambda rng, s: {local: float(np.exp(rng.uniform(math.log(low), math.log(high))))}


def share(low: float, high: float, local: str) -> Draw:
    """Draw a share of the largest deflection."""
    return lambda rng, s: {local: float(s.peak * rng.uniform(low, high))}


def signed(low: float, high: float, local: str) -> Draw:
    """Draw with either sign."""
    return lambda rng, s: {local: either(rng) * float(rng.uniform(low, high))}


def either(rng: np.random.Generator) -> float:
    """Draw one or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def pulse(
    rng: np.random.Generator, s: Setting, shortest: float, longest: float, last: float = 0.7
) -> tuple[float, float]:
    """Draw begin and length of an event in a record, s. It begins at the share ``last`` of the
    record at the latest.
    """
    return float(rng.uniform(0.1, last) * s.duration), float(rng.uniform(shortest, longest))


def several(rng: np.random.Generator, **spans: tuple[float, float]) -> Mapping[str, float]:
    """Draw every parameter uniformly between its ends."""
    return {name: float(rng.uniform(*span)) for name, span in spans.items()}
