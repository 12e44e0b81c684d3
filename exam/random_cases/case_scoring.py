"""The score of an answer: which names are right, which are wrong, and how far the numbers are
off.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from itertools import permutations

from exam.calibration import Statement
from exam.random_cases.case import Case, CaseScore, Named
from exam.random_cases.kinds import KINDS
from exam.random_cases.vehicles import NOISE, estimated
from exam.scoring import same_fault
from ident.tracing.diagnosis import Claim, Diagnosis, Verdict
from scenarios.diagnosis.diagnose import Tracing
from scenarios.diagnosis.evidence import warnings_of
from sim.declaration.model import Model
from sim.errors import DeclarationError, FlightidError, RecordError

REFUSED, FAILED = "refused", "failed"


def case_score_of(case: Case, model: Model, tracing: Tracing, seconds: float) -> CaseScore:
    """The score of a diagnosis."""
    diagnosis = tracing.diagnosis
    claims = [claim for claim in diagnosis.effects if claim.claimed]
    left, wrong = _matched(case, claims)
    return CaseScore(
        case,
        diagnosis.verdict.value,
        tuple(claim.name for claim in claims),
        not wrong and not left and _rightly_concluded(case, tracing, claims),
        wrong,
        _errors(case, model, diagnosis),
        max(rmse / NOISE[name] for name, rmse in diagnosis.error_after.rmse.items()),
        seconds,
        tuple(
            tuple(Named(name, _is_hidden(case, name)) for name in (claim.name, *claim.alternatives))
            for claim in claims
        ),
        _statements(case, claims),
    )


def _statements(case: Case, claims: Sequence[Claim]) -> tuple[Statement, ...]:
    """All names of the claims that have a probability."""
    return tuple(
        Statement(name, p, _is_hidden(case, name))
        for claim in claims
        for name, p in claim.probability.items()
    )


def refusal_score_of(case: Case, fault: FlightidError, seconds: float) -> CaseScore:
    """The score where there is no diagnosis: files refused are right for a recorder's fault and an
    alarm for all else, a failure is never right.
    """
    refused = isinstance(fault, RecordError | DeclarationError)
    return CaseScore(
        case,
        REFUSED if refused else FAILED,
        (),
        refused and case.group == "recorder",
        False,
        {},
        0.0,
        seconds,
        said=str(fault),
    )


def _matched(case: Case, claims: Sequence[Claim]) -> tuple[set[str], bool]:
    """Answers that no claim gives, and whether a claim gives none; each claim answers once, so as
    to answer most.
    """
    answers = sorted(case.answers)
    accepted = {name for hidden in case.hidden for name in KINDS[hidden].accepted}
    best: tuple[set[str], bool] = (set(answers), bool(claims))
    for order in permutations(claims):
        left, wrong = set(answers), False
        for claim in order:
            hit = next(
                (answer for answer in answers if answer in left and _says(answer, claim)), None
            )
            wrong = wrong or (
                hit is None and not _given({claim.name, *claim.alternatives}, accepted)
            )
            left.discard(hit or "")
        if (wrong, len(left)) < (best[1], len(best[0])) or order == tuple(claims):
            best = (left, wrong)
    return best


def _says(answer: str, claim: Claim) -> bool:
    return _given({claim.name, *claim.alternatives}, same_fault(answer))


def _given(names: Set[str], accepted: Set[str]) -> bool:
    """Whether one of the names is accepted; of a numbered effect (``elastic-mode#2``,
    ``elastic-mode:1``) any number.
    """
    plain = {name.partition("#")[0] for name in names}
    return bool(
        plain
        & {*accepted, *(name.partition(":")[0] for name in accepted if name.startswith("elastic"))}
    )


def _is_hidden(case: Case, name: str) -> bool:
    accepted = {other for answer in case.answers for other in same_fault(answer)}
    return _given(
        {name}, accepted | {other for hidden in case.hidden for other in KINDS[hidden].accepted}
    )


def _rightly_concluded(case: Case, tracing: Tracing, claims: Sequence[Claim]) -> bool:
    """Whether the verdict is right, where the claims are."""
    verdict = tracing.diagnosis.verdict
    if not case.hidden:
        return verdict is Verdict.CONSISTENT
    if not case.outside:
        return True
    words = [word for name in case.hidden for word in KINDS[name].words]
    return verdict is Verdict.UNEXPLAINED or bool(claims) or _told_of(words, tracing)


def _told_of(words: Sequence[str], tracing: Tracing) -> bool:
    """Whether a warning or a note about the record has one of the words."""
    look = (*tracing.look.doubts, *tracing.look.lines)
    texts = [*tracing.doubts, *look, *tracing.notes, *warnings_of(tracing)]
    return any(
        re.search(rf"\b{re.escape(word)}\b", text, re.IGNORECASE)
        for word in words
        for text in texts
    )


def _errors(case: Case, model: Model, diagnosis: Diagnosis) -> Mapping[str, float]:
    after = {
        name: diagnosis.after[name] for name in estimated(case.model) if name in diagnosis.after
    }
    return {
        name: (found.value - model.parameters[name].value) / found.std
        for name, found in after.items()
    }
