"""What a diagnosis rests on: the claims, the residual tests, and what speaks against more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ident.statistics.residuals import ResidualTest
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Caution, Claim, Concern, Requirement, Verdict
from ident.tracing.validation.held_out import HeldOut
from ident.tracing.whiteness import whiteness


@dataclass(frozen=True, eq=False)
class ResidualTests:
    """Residual tests of the fitted records, and of held-out ones under what the fitted ones
    taught.
    """

    fitted: tuple[ResidualTest, ...]
    others: tuple[ResidualTest, ...] = ()

    @property
    def all(self) -> tuple[ResidualTest, ...]:
        """All of them."""
        return (*self.fitted, *self.others)


@dataclass(frozen=True, eq=False)
class Judgement:
    """A verdict on a set of effects.

    Attributes
    ----------
    best : the set. out : that set on data that were not fitted.
    claims : its effects and hints. tests : of what it leaves. cautions : what speaks against more.
    """

    verdict: Verdict
    best: FittedModel
    out: HeldOut
    claims: tuple[Claim, ...]
    tests: ResidualTests
    cautions: tuple[Caution, ...]


def residual_tests(best: FittedModel, out: HeldOut) -> ResidualTests:
    """Is what remains noise, on the fitted records and on the others?"""
    others = whiteness(out.informed, "held out") if out.informed is not None else ()
    return ResidualTests(tuple(whiteness(best.fit, "fitted")), tuple(others))


def not_noise(tests: Sequence[ResidualTest], least: float) -> list[Caution]:
    """What is left: a caution for each test whose p-value is below ``least``."""
    return [
        Caution(
            Concern.NOT_NOISE,
            f"{test.channel}: {test.sentence} (p = {test.p_value:.1e})",
            test,
            Requirement(
                f"the p-value of the residual test of {test.channel}",
                test.p_value,
                least,
                at_least=True,
            ),
        )
        for test in tests
        if test.p_value < least
    ]
