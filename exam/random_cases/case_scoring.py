"""The score of an answer, and many scores together: which names are right and wrong, and the errors
of the numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence, Set
from itertools import permutations

import numpy as np

from exam.random_cases.case import Case, CaseScore, Named
from exam.random_cases.kinds import KINDS
from exam.random_cases.vehicles import NOISE, estimated
from exam.scoring import Statement, reliability, same_fault
from ident.statistics.intervals import clopper_pearson, clustered_share
from ident.tracing.diagnosis import Claim, Diagnosis, Verdict
from scenarios.diagnosis.diagnose import Tracing
from scenarios.diagnosis.evidence import warnings_of
from scenarios.report.summary import columns_of, table_lines
from scenarios.trials.planted_declaration import OWN
from sim.declaration.model import Model
from sim.errors import DeclarationError, FlightidError, RecordError

# ---- The score of an answer

REFUSED, FAILED = "refused", "failed"


def case_score_of(case: Case, model: Model, tracing: Tracing, seconds: float) -> CaseScore:
    """Return the score of a diagnosis."""
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
    """Return all names of the claims that have a probability."""
    return tuple(
        Statement(name, p, _is_hidden(case, name))
        for claim in claims
        for name, p in claim.probability.items()
    )


def refusal_score_of(case: Case, fault: FlightidError, seconds: float) -> CaseScore:
    """Return the score of a case without a diagnosis.

    Refusing the files is right for a fault of the recorder, and a false alarm for other cases. A
    failure is never right.
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
    """Return the answers that no claim gives, and whether a claim gives none of them.

    Each claim gives one answer at most, assigned so that most answers are given.
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
    """Return whether one of the names is accepted.

    A numbered effect (``elastic-mode#2``, ``elastic-mode:1``) is accepted with any number.
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
    """Return whether the verdict is right, given right claims."""
    verdict = tracing.diagnosis.verdict
    if not case.hidden:
        return verdict is Verdict.CONSISTENT
    if not case.outside:
        return True
    words = [word for name in case.hidden for word in KINDS[name].words]
    return verdict is Verdict.UNEXPLAINED or bool(claims) or _told_of(words, tracing)


def _told_of(words: Sequence[str], tracing: Tracing) -> bool:
    """Return whether a warning or a note on the record has one of the words."""
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


# ---- Many scores together

TWO_SIGMAS = 2.0
HEADINGS = (
    "cases",
    "of",
    "right, %",
    "95 % interval",
    "wrong, %",
    "95 % interval",
    "within 2 sigmas, %",
    "95 % interval",
)
# The held-out record has other realisations of these, which no fit can predict.
UNPREDICTABLE = ("turbulence", "spikes")


def summary(scores: Sequence[CaseScore]) -> dict[str, float]:
    """Return shares over many cases: right answers, wrong claims, derivatives within two standard
    deviations in right cases, and the median of the held-out error.
    """
    count, right = len(scores), [score for score in scores if score.right]
    free = [
        score
        for score in right
        if score.errors and not any(_unpredictable(name) for name in score.case.hidden)
    ]
    share, (low, high) = coverage(scores)
    wrong = sum(score.wrong for score in scores)
    return {
        "cases": float(count),
        "right": len(right) / count,
        "right, lower 95 %": clopper_pearson(len(right), count)[0],
        "right, upper 95 %": clopper_pearson(len(right), count)[1],
        "wrong claims": wrong / count,
        "wrong claims, upper 95 %": clopper_pearson(wrong, count)[1],
        "derivatives within two sigmas": share,
        "derivatives within two sigmas, lower 95 %": low,
        "derivatives within two sigmas, upper 95 %": high,
        "held-out error, median": float(np.median([score.held_out for score in free]))
        if free
        else 0.0,
        "seconds, median": float(np.median([score.seconds for score in scores])),
    }


def coverage(scores: Sequence[CaseScore]) -> tuple[float, tuple[float, float]]:
    """Return the share of derivatives within two standard deviations.

    It is over right cases in which nothing, or an effect of the library, is hidden. Derivatives of
    one case are correlated, so that the interval is over cases.
    """
    told = [
        np.abs([*score.errors.values()])
        for score in scores
        if score.right and not score.case.outside and score.errors
    ]
    if not told:
        return 0.0, (0.0, 1.0)
    within, of = (
        np.array([np.sum(errors < TWO_SIGMAS) for errors in told]),
        np.array([len(errors) for errors in told]),
    )
    return float(within.sum() / of.sum()), clustered_share(within, of, np.random.default_rng(0))


def summary_table(scores: Sequence[CaseScore]) -> list[str]:
    """Return the lines of a table: all cases, then those of each model, each group, and each hidden
    kind.

    A case with two hidden kinds counts for both.
    """
    rows = [_row("all", scores)]
    rows += _by(scores, lambda score: (score.case.model,))
    rows += _by(scores, lambda score: (score.case.group,))
    rows += _by(scores, lambda score: score.case.hidden)
    return table_lines(columns_of(HEADINGS, rows))


def reliability_table(statements: Sequence[Statement]) -> list[str]:
    """Return the lines of a table: shares of right names, by their probability."""
    rows = []
    for item in reliability(statements):
        right = f"{100.0 * item.right / item.count:.0f}" if item.count else ""
        rows.append(
            (
                f"{100 * item.low:.0f} to {100 * item.high:.0f}",
                str(item.count),
                f"{100.0 * item.said:.1f}",
                right,
                _span(item.interval),
            )
        )
    return table_lines(
        columns_of(
            ("probability said, %", "names", "mean said, %", "right, %", "95 % interval"), rows
        )
    )


def _by(
    scores: Sequence[CaseScore], names: Callable[[CaseScore], tuple[str, ...]]
) -> list[tuple[str, ...]]:
    known = sorted({name for score in scores for name in names(score)})
    return [_row(name, [score for score in scores if name in names(score)]) for name in known]


def _row(label: str, scores: Sequence[CaseScore]) -> tuple[str, ...]:
    of = len(scores)
    right, wrong = sum(score.right for score in scores), sum(score.wrong for score in scores)
    share, interval = coverage(scores)
    told = any(score.right and not score.case.outside and score.errors for score in scores)
    cells = [
        f"{100.0 * right / of:.1f}",
        _span(clopper_pearson(right, of)),
        f"{100.0 * wrong / of:.1f}",
        _span(clopper_pearson(wrong, of)),
    ]
    return (
        label,
        str(of),
        *cells,
        *((f"{100.0 * share:.1f}", _span(interval)) if told else ("", "")),
    )


def _span(interval: tuple[float, float]) -> str:
    return f"{100.0 * interval[0]:.1f} to {100.0 * interval[1]:.1f}"


def _unpredictable(name: str) -> bool:
    return OWN in KINDS[name].term or any(word in name for word in UNPREDICTABLE)
