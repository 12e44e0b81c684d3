"""Result of the tracing loop (verdict, effects, evidence, errors before and after) and its
settings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from ident.flying_qualities.modes import Characteristics
from ident.statistics.residuals import ErrorFigures, ResidualTest
from ident.whole_record.layout import FitSettings
from sim.declaration.proposal import Traceable
from sim.record import Record


class Verdict(Enum):
    """Verdict of a diagnosis; the value is the word used in files."""

    CONSISTENT = "consistent"
    TRACED = "traced"
    PARTIAL = "partial"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


TIMES = ("delay", "time_constant")  # parameters that delay a signal
Data = tuple[Sequence[Record], Sequence[Record]]  # to be fitted, and to be predicted

_SENTENCES = {
    Verdict.CONSISTENT: "the residual is consistent with noise: nothing is missing",
    Verdict.TRACED: (
        "the effects listed explain the misfit: the residual is noise, also on data that were not "
        "fitted"
    ),
    Verdict.PARTIAL: (
        "the records support the effects listed, which do not explain all of the misfit"
    ),
    Verdict.AMBIGUOUS: "an effect is needed, but these data cannot tell it from its alternatives",
    Verdict.UNEXPLAINED: (
        "something is missing, and no effect of the library can be named as its cause"
    ),
}


class Concern(Enum):
    """Subject of a caution."""

    NOT_NOISE = "a residual test fails"
    NOISE_BURST = "noise is louder for a while"
    GUARD = "what is missing behaves like a term outside the library"
    NO_IMPROVEMENT = "the effects do not lower the error on data that were not fitted"


@dataclass(frozen=True)
class Requirement:
    """A requirement on a claim that was not met: the number found and the number required.

    Attributes
    ----------
    asked : the tested quantity, in words.
    value : the number found.
    bar : the number required.
    at_least : whether ``bar`` is a minimum; else a maximum.
    unit : of both.
    effects : names of the effects that it keeps from being claimed; empty for all of them.
    """

    asked: str
    value: float
    bar: float
    at_least: bool
    unit: str = ""
    effects: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The quantity, the number found and the number required."""
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        word = "at least" if self.at_least else "at most"
        return f"{self.asked} is {self.value:.3g}{unit}, required is {word} {self.bar:.3g}{unit}"


@dataclass(frozen=True)
class Caution:
    """A reason to doubt more than the verdict states: its kind, a sentence, and the failed residual
    test if there is one.

    ``requirement`` : the number found and required; None where the sentence is complete.
    """

    concern: Concern
    sentence: str
    test: ResidualTest | None = None
    requirement: Requirement | None = None


@dataclass(frozen=True)
class Quantity:
    """An estimated number: value, standard deviation corrected for coloured residuals, unit."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Claim:
    """One effect of the verdict.

    Attributes
    ----------
    parameters : by local name.
    alternatives : names of at most two effects that fit as well.
    claimed : False marks a hint.
    reasons : of a hint, why it is not claimed, one sentence each.
    records : numbers, from 0, of the records it acts on; empty if it acts on all.
    by_record : its parameters in each fitted record if the residual is not noise; else empty.
    derivatives_under : declared parameters with this effect, and with each alternative instead, by
        effect name; may be empty.
    probability : that it acts, and of each alternative, by name; empty for hints.
    spread : z of Vuong's test over blocks of time, if the residual is not noise.
    one_step_gains : increase of the log likelihood of one-step predictions of each held-out record,
        if that decided.
    """

    name: str
    parameters: Mapping[str, Quantity]
    alternatives: tuple[str, ...] = ()
    claimed: bool = True
    records: tuple[int, ...] = ()
    explanation: str = ""
    by_record: tuple[Mapping[str, Quantity], ...] = ()
    derivatives_under: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)
    probability: Mapping[str, float] = field(default_factory=dict)
    spread: float | None = None
    one_step_gains: tuple[float, ...] = ()
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Candidate:
    """One candidate added to one fitted set of the search; ``within`` names the effects already in
    that set.

    ``gain`` : of the log evidence. ``weight`` : the gain with prior odds; above zero the effect is
    more probable than not. ``fitted`` : False where both come from the linearised signature,
    without parameter values.
    """

    round: int
    within: tuple[str, ...]
    name: str
    gain: float
    weight: float
    fitted: bool
    parameters: Mapping[str, Quantity]
    collinear_with: tuple[str, ...] = ()


@dataclass(frozen=True)
class Step:
    """One step of the search: the most probable set after it, its log evidence and log likelihood,
    and a sentence.
    """

    effects: tuple[str, ...]
    log_evidence: float
    log_likelihood: float
    sentence: str


@dataclass(frozen=True, eq=False)
class Prediction:
    """Free simulation of one record, before and after: ``(m, N)`` in the order of ``channels``."""

    record: Record
    channels: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True, eq=False)
class Trained:
    """Estimates of a model with effects that a free simulation of another record uses.

    ``shared`` : by parameter. ``own`` : one mapping a fitted record, by the parameters of single
    records and by ``STATE(0)``.
    """

    effects: tuple[Traceable, ...]
    outputs: tuple[str, ...]
    shared: Mapping[str, float]
    own: tuple[Mapping[str, float], ...]
    settings: FitSettings


@dataclass(frozen=True)
class FittedSet:
    """A set of effects that the search fitted.

    Attributes
    ----------
    noise : the noise of the search, in words.
    effects : their names.
    log_likelihood, log_evidence : of the records.
    log_prior : log prior odds of the effects.
    """

    noise: str
    effects: tuple[str, ...]
    log_likelihood: float
    log_evidence: float
    log_prior: float


@dataclass(frozen=True, eq=False)
class OneStep:
    """Predictions one step ahead of held-out records, with the discrepancy before and after.

    Attributes
    ----------
    before, after : their errors.
    gains : rise of the log likelihood of each record from before to after.
    """

    before: ErrorFigures
    after: ErrorFigures
    gains: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class FittedRecord:
    """A training record with the residuals ``(m, N)`` before and after; ``used`` is False at masked
    samples.
    """

    record: Record
    channels: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray
    used: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """The tracing loop's result.

    Attributes
    ----------
    before, after : derivatives of the declared model and of the final one.
    derived_before, derived_after : frequency, damping, ...
    error_before, error_after : on ``predictions``; ``held_out`` False where these were fitted.
    one_step : predictions one step ahead, where there is a discrepancy and data are held out.
    noise_floor : sensor noise by channel: the level of the fit where its residual is white, else
        estimated from the residual's high frequencies.
    residual_std : the level of the fit, whatever is in it.
    tests_before, tests_after : residual tests.
    steps, candidates, sets : how the search went; ``sets`` by their posterior probability.
    scatter : standard deviation of declared parameters between fits of single records, where they
        were made.
    modes_before, modes_after : numbers of the modes from which levels of flying qualities follow,
        None where there are none.
    stopped : a search used all its fits.
    trained_before, trained_after : what another record is predicted with.
    not_met : requirements that were not met, where something is not claimed or not all is
        explained.
    inflation : the factor that differences between records put on sigmas of these parameters,
        after; those before have one of their own.
    """

    verdict: Verdict
    effects: tuple[Claim, ...]
    before: Mapping[str, Quantity]
    after: Mapping[str, Quantity]
    derived_before: Mapping[str, Quantity]
    derived_after: Mapping[str, Quantity]
    error_before: ErrorFigures
    error_after: ErrorFigures
    noise_floor: Mapping[str, float]
    held_out: bool
    tests_before: tuple[ResidualTest, ...]
    tests_after: tuple[ResidualTest, ...]
    steps: tuple[Step, ...]
    candidates: tuple[Candidate, ...]
    warnings: tuple[Caution, ...]
    predictions: tuple[Prediction, ...]
    fitted: tuple[FittedRecord, ...]
    scatter: Mapping[str, float] = field(default_factory=dict)
    inflation: Mapping[str, float] = field(default_factory=dict)
    stopped: bool = False
    residual_std: Mapping[str, float] = field(default_factory=dict)
    modes_before: Characteristics | None = None
    modes_after: Characteristics | None = None
    trained_before: Trained | None = None
    trained_after: Trained | None = None
    not_met: tuple[Requirement, ...] = ()
    one_step: OneStep | None = None
    sets: tuple[FittedSet, ...] = ()

    def __repr__(self) -> str:
        named = (
            ", ".join(claim.name for claim in self.effects if claim.claimed) or "no effect claimed"
        )
        return (
            f"<Diagnosis: {self.verdict.value}, {named}, {len(self.fitted)} records fitted and "
            f"{len(self.predictions)} predicted>"
        )


@dataclass(frozen=True)
class TraceSettings:
    """Settings of the loop.

    Attributes
    ----------
    max_step : longest integration sub-step, s.
    depth : most effects in a set.
    budget : fits of one search: a residual that defies the library must not take for ever.
    effort : what these settings are called, one of ``EFFORTS``.
    """

    max_step: float = 0.01
    depth: int = 3
    budget: int = 40
    effort: str = "normal"


NORMAL = TraceSettings()
THOROUGH = TraceSettings(depth=4, budget=10 * NORMAL.budget, effort="thorough")
EFFORTS = {settings.effort: settings for settings in (NORMAL, THOROUGH)}
