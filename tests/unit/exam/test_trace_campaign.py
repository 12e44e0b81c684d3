"""A campaign of a tracing scenario: what counts as named, as named alone, and as a false claim."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from exam.hidden_effects.campaign import TraceJudged, judged_of, trace_shares, verdict_shares
from ident.tracing.diagnosis import Claim, Verdict
from scenarios.trials.planted.study import Grade


def judged(hidden: tuple[str, ...], accepted: tuple[tuple[str, ...], ...], *claims: Claim, sigmas: tuple[float, ...] = (1.9, -2.1)) -> TraceJudged:
    study: Any = SimpleNamespace(
        seed=4,
        grade=Grade.RIGHT,
        scenario=SimpleNamespace(expect=SimpleNamespace(effects=accepted)),
        flown=SimpleNamespace(hidden={name: {} for name in hidden}),
        tracing=SimpleNamespace(diagnosis=SimpleNamespace(verdict=Verdict.TRACED, effects=claims)),
        derivatives=[SimpleNamespace(name=f"CL_{n}", sigmas=size) for n, size in enumerate(sigmas)],
    )
    return judged_of(study)


@pytest.mark.parametrize(
    ("claims", "named", "alone", "false"),
    [
        ([Claim("vane-offset", {})], True, ("vane-offset",), ()),
        ([Claim("vane-offset", {}, ("sensor-lag:alpha",))], True, (), ()),
        ([Claim("sensor-lag:alpha", {}, ("vane-offset",))], True, (), ()),
        ([Claim("sensor-lag:alpha", {})], False, (), ("sensor-lag:alpha",)),
        ([Claim("vane-offset", {}), Claim("input-delay", {}, ("actuator-lag",))], True, ("vane-offset",), ("input-delay/actuator-lag",)),
        ([Claim("vane-offset", {}, claimed=False)], False, (), ()),
        ([], False, (), ()),
    ],
)
def test_a_claim_is_right_or_false_by_what_is_hidden(claims: list[Claim], named: bool, alone: tuple[str, ...], false: tuple[str, ...]) -> None:
    found = judged(("vane-offset",), (("vane-offset",),), *claims)
    assert (found.named, found.alone, found.false) == ((("vane-offset", named),), alone, false)


def test_one_fault_under_two_names_and_another_form_are_named_right() -> None:
    assert judged(("sensor-lag:q",), (("sensor-lag:q",),), Claim("sensor-delay:q", {})).named == (("sensor-lag:q", True),)
    bends = judged(("own:tanh-moment",), (("moment-nonlinearity",),), Claim("moment-nonlinearity", {}))
    assert bends.named == (("moment-nonlinearity", True),) and not bends.false
    outside = judged(("own:products",), (), Claim("vane-offset", {}))
    assert outside.named == () and outside.false == ("vane-offset",)


def test_shares_are_counted_over_flights_and_within_them() -> None:
    right = judged(("vane-offset",), (("vane-offset",),), Claim("vane-offset", {}))
    wrong = judged(("vane-offset",), (("vane-offset",),), Claim("input-delay", {}))
    shares = trace_shares([right, wrong, right, right])
    counts = {key: (share.count, share.of) for key, share in shares.items()}
    assert counts == {key: (4, 4) for key in ("expected", "expected_or_alternative")} | {
        "named": (3, 4),
        "named_alone": (3, 4),
        "false_claims": (1, 4),
        "within_two_sigma": (4, 8),
    }
    low, high = shares["false_claims"].interval
    # Clopper and Pearson: so few, or so many, have a chance of 2.5 % each.
    assert 1.0 - (1.0 - low) ** 4 == pytest.approx(0.025) and (1.0 - high) ** 4 + 4.0 * high * (1.0 - high) ** 3 == pytest.approx(0.025)
    assert sum(share.count for share in verdict_shares([right, wrong]).values()) == 2
