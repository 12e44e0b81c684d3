"""What the tracing loop returns: verdict, effects, evidence, errors before and after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from ident.flying_qualities.characteristics import Characteristics
from ident.statistics.residuals import ResidualTest
from ident.tracing.weighed import Weighed
from ident.whole_record.layout import FitSettings
from sim.declaration.proposal import Traceable
from sim.record import Record


class Verdict(Enum):
    """The value is what files say; see the sentence for people."""

    CONSISTENT = "consistent"
    TRACED = "traced"
    PARTIAL = "partial"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


_SENTENCES = {
    Verdict.CONSISTENT: "the residual is what the noise alone would give: nothing is missing",
    Verdict.TRACED: "the effects listed explain what was missing: what remains is noise, also on data that were not fitted",
    Verdict.PARTIAL: "the effects listed replicate from record to record, but what remains is not noise",
    Verdict.AMBIGUOUS: "an effect is needed, but these data cannot tell it from its alternatives",
    Verdict.UNEXPLAINED: "something is missing, and no effect of the library can be named as its cause",
}


class Concern(Enum):
    """What a caution is about."""

    NOT_NOISE = "a residual test fails"
    DIFFERS_HELD_OUT = "the fitted records are explained, the others are not"
    GUARD = "what is missing behaves like a term outside the library"
    BEYOND_BELIEF = "what fits best has parameters that no one believes"
    UNDETERMINED = "what fits best has numbers that the records do not determine"
    ROWS_MISSING = "what fits best acts where rows are missing"
    DERIVATIVES = "a derivative is far from what the vehicle file says"
    ONE_CAUSE = "effects that fit together stand for one cause"
    CONTRADICTED = "the kinematics speak against what fits best"
    UNLIKELY = "something that is not named is too likely"
    GOES_WITH_MOTION = "what process noise would explain goes with the motion"
    NO_IMPROVEMENT = "the effects do not lower the error on data that were not fitted"


@dataclass(frozen=True)
class Requirement:
    """A requirement on a claim that was not met, with its number against the bar.

    Attributes
    ----------
    asked : the quantity that is asked about, in words. value : what was found. bar : what is required.
    at_least : whether the value has to reach the bar; else it must not exceed it. unit : of both.
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
    """What speaks against more than the verdict says: its kind, a sentence, and the residual test where one failed.

    ``requirement`` : what was asked, with its number; None where the sentence has all there is.
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
class Evidence:
    """Why an effect is claimed although what remains is not noise: it was cross-validated.

    ``error_left`` is the error on records that were not fitted over that before, a geometric mean over channels and records, ``error_left_std`` its
    scatter under resampling of blocks. ``by_record`` its parameters from each record by itself. ``derivatives`` the declared
    parameters with it, and with each of its alternatives in its place, by effect name. ``already_in_model`` names
    the effects that were in the model before. ``own_values`` : each record has its own, so that they need not be alike.
    """

    error_left: float
    error_left_std: float
    by_record: tuple[Mapping[str, Quantity], ...]
    derivatives: Mapping[str, Mapping[str, Quantity]]
    already_in_model: tuple[str, ...] = ()
    own_values: bool = False


@dataclass(frozen=True)
class Claim:
    """One effect of the verdict.

    ``parameters`` by local name; ``alternatives`` (two at most) fit these data as well; ``claimed`` False marks a hint.
    ``records`` numbers those it acts on (from 0) where it does not act on all. ``evidence`` is there where it was cross-validated.
    ``derivatives_under`` : the declared parameters with it, and with each alternative in its place, by effect name; empty without any.
    ``probability`` that it acts, each that could take its place, and something else, by name; empty of hints. ``weighed`` : what that rests on.
    ``one_step_gains`` : by how much it raises the log likelihood of one-step predictions of each record that was not fitted, where that decided.
    ``reasons`` : of a hint, why it is not claimed, a sentence each with the number and the bar.
    """

    name: str
    parameters: Mapping[str, Quantity]
    alternatives: tuple[str, ...] = ()
    claimed: bool = True
    records: tuple[int, ...] = ()
    explanation: str = ""
    evidence: Evidence | None = None
    derivatives_under: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)
    probability: Mapping[str, float] = field(default_factory=dict)
    weighed: Weighed | None = None
    one_step_gains: tuple[float, ...] = ()
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Candidate:
    """Evidence on one candidate added to one fitted model of the search; ``within`` names the effects that were already in it.

    ``gain`` is that of the log likelihood; ``p_value`` of that gain where the fitted model is true, for the parameters added;
    ``held_out_change`` the relative change of the error on data not fitted (negative is better), ``held_out_scatter`` its
    standard deviation under resampling of blocks; None where not computed.
    ``fitted`` False: the gain is the projected score's, not that of a full fit. ``remark`` says whether it was
    cross-validated, and why not, where that was asked.
    """

    round: int
    within: tuple[str, ...]
    name: str
    gain: float
    p_value: float
    fitted: bool
    plausible: bool
    parameters: Mapping[str, Quantity]
    held_out_change: float | None = None
    collinear_with: tuple[str, ...] = ()
    remark: str = ""
    held_out_scatter: float | None = None


@dataclass(frozen=True)
class Step:
    """One decision of the search: the set it led to, the criterion there, and the reason in words."""

    effects: tuple[str, ...]
    criterion: float
    log_likelihood: float
    sentence: str


@dataclass(frozen=True)
class ErrorFigures:
    """Simulation error by channel: root mean square, that over the measured spread, R squared, Theil's coefficient."""

    rmse: Mapping[str, float]
    nrmse: Mapping[str, float]
    r2: Mapping[str, float]
    theil: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Prediction:
    """Free simulation of one record, before and after: ``(m, N)`` in the order of ``channels``."""

    record: Record
    channels: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True, eq=False)
class Trained:
    """What the fitted records say of a model with effects: all that a free simulation of another record takes from them.

    ``shared`` by parameter; ``own``, one mapping a fitted record, by the parameters that are each record's own and by ``STATE(0)``.
    """

    effects: tuple[Traceable, ...]
    outputs: tuple[str, ...]
    shared: Mapping[str, float]
    own: tuple[Mapping[str, float], ...]
    settings: FitSettings


@dataclass(frozen=True, eq=False)
class FittedRecord:
    """A training record with the residuals ``(m, N)`` before and after; ``used`` False where a sample was set aside."""

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
    before, after : derivatives of the declared model and of the final one. derived_before, derived_after : frequency, damping, ...
    error_before, error_after : on ``predictions``; ``held_out`` False where these were fitted. ``used_to_choose`` : they were not
        fitted, but took part in choosing effects.
    noise_floor : sensor noise by channel: the level of the fit where its residual is white, else estimated from the residual's high
        frequencies. residual_std : the level of the fit, whatever is in it.
    tests_before, tests_after : residual tests. steps, candidates : how the search went.
    seconds : time by stage. scatter : standard deviation of declared parameters between fits of single records, where they were made.
    modes_before, modes_after : numbers of the modes from which levels of flying qualities follow, None where there are none.
    stopped : the search, or a stage of it, ended at its means.
    trained_before, trained_after : what another record is predicted with.
    not_met : requirements that were not met, where something is not claimed or not all is explained.
    inflation : the factor that differences between records put on sigmas of these parameters, after; those before have one of their own.
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
    seconds: Mapping[str, float]
    scatter: Mapping[str, float] = field(default_factory=dict)
    inflation: Mapping[str, float] = field(default_factory=dict)
    used_to_choose: bool = False
    stopped: bool = False
    residual_std: Mapping[str, float] = field(default_factory=dict)
    modes_before: Characteristics | None = None
    modes_after: Characteristics | None = None
    trained_before: Trained | None = None
    trained_after: Trained | None = None
    not_met: tuple[Requirement, ...] = ()

    def __repr__(self) -> str:
        named = ", ".join(claim.name for claim in self.effects if claim.claimed) or "no effect claimed"
        return f"<Diagnosis: {self.verdict.value}, {named}, {len(self.fitted)} records fitted and {len(self.predictions)} predicted>"
