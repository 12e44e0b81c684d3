"""A campaign of a tracing scenario: what counts as named, as named alone, and as a false claim."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from exam.__main__ import main
from exam.hidden_effects import (
    TraceJudged,
    judged_of,
    named_scenario,
    scored_flight_of,
    trace_shares,
    verdict_shares,
)
from ident.tracing.diagnosis import Claim, Verdict
from scenarios.trials.planted_declaration import Grade
from scenarios.trials.planted_study import run_trace


def judged(
    hidden: tuple[str, ...],
    accepted: tuple[tuple[str, ...], ...],
    *claims: Claim,
    sigmas: tuple[float, ...] = (1.9, -2.1),
) -> TraceJudged:
    study: Any = SimpleNamespace(
        seed=4,
        grade=Grade.RIGHT,
        scenario=SimpleNamespace(expect=SimpleNamespace(effects=accepted)),
        simulated=SimpleNamespace(hidden={name: {} for name in hidden}),
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
        (
            [Claim("vane-offset", {}), Claim("input-delay", {}, ("actuator-lag",))],
            True,
            ("vane-offset",),
            ("input-delay/actuator-lag",),
        ),
        ([Claim("vane-offset", {}, claimed=False)], False, (), ()),
        ([], False, (), ()),
    ],
)
def test_a_claim_is_right_or_false_by_what_is_hidden(
    claims: list[Claim], named: bool, alone: tuple[str, ...], false: tuple[str, ...]
) -> None:
    found = judged(("vane-offset",), (("vane-offset",),), *claims)
    assert (found.named, found.alone, found.false) == ((("vane-offset", named),), alone, false)


def test_one_fault_under_two_names_and_another_form_are_named_right() -> None:
    assert judged(("sensor-lag:q",), (("sensor-lag:q",),), Claim("sensor-delay:q", {})).named == (
        ("sensor-lag:q", True),
    )
    bends = judged(
        ("own:tanh-moment",), (("moment-nonlinearity",),), Claim("moment-nonlinearity", {})
    )
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
    assert 1.0 - (1.0 - low) ** 4 == pytest.approx(0.025) and (1.0 - high) ** 4 + 4.0 * high * (
        1.0 - high
    ) ** 3 == pytest.approx(0.025)
    assert sum(share.count for share in verdict_shares([right, wrong]).values()) == 2


@pytest.mark.long
def test_a_campaign_is_written_and_a_flight_of_it_flown_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two falls through air of another scale height, diagnosed in tenths of a second."""
    coarse = "flight.step=0.02"  # s: flown ten times as fast
    words = [
        "hidden-effects",
        "trace-density",
        "--runs",
        "2",
        "--set",
        coarse,
        "--jobs",
        "1",
        "--no-figures",
        "--out",
        str(tmp_path),
    ]
    assert main(words) == 0
    assert "trace-density: 2 flights, seeds from " in capsys.readouterr().out
    rows = [*csv.DictReader((tmp_path / "flights.csv").read_text().splitlines())]
    content = json.loads((tmp_path / "campaign.json").read_text())
    assert [row["hidden"] for row in rows] == ["density-scale-height"] * 2 and content["runs"] == 2
    studies = [
        run_trace(named_scenario("trace-density", (coarse,)), int(row["seed"])) for row in rows
    ]
    flights = [scored_flight_of(study, judged_of(study)) for study in studies]
    assert [flight.verdict for flight in flights] == [row["verdict"] for row in rows]
    right = content["marks"]["rates"]["density-scale-height"]["right"]
    assert (right["count"], right["of"]) == (sum(flight.right for flight in flights), 2)
    assert sum(content["marks"]["concluded"]["density-scale-height"].values()) == 2
    names = [each for flight in flights for each in flight.stated]
    assert sum(each["count"] for each in content["marks"]["reliability"]) == sum(
        each.probability > 0.05 for each in names
    )
    given = [each for each in names if each.first]
    brier = sum((each.probability - each.right) ** 2 for each in given) / len(given)
    assert content["marks"]["brier"]["score"] == pytest.approx(brier)
    assert (
        tmp_path / "report.html"
    ).is_file() and "python -m exam hidden-effects trace-density" in (
        tmp_path / "report.html"
    ).read_text()
