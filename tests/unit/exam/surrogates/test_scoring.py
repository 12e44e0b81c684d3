"""How a surrogate flight's diagnosis is scored, how a campaign counts, and what the declaration
refuses.
"""

from __future__ import annotations

import csv
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined
from scipy.stats import binom

from exam.repeated import fly_all
from exam.scoring import Share, share_of_flights, share_within_flights
from exam.surrogates import campaign, schema, study
from exam.surrogates.campaign import (
    Judged,
    by_derivative,
    by_effect,
    campaign_text,
    shares,
    surrogate_flights,
    worsened,
)
from exam.surrogates.declaration import Causes
from exam.surrogates.flights.drawing import Dominant, draw, hiding
from exam.surrogates.flights.flight import Flight
from exam.surrogates.flights.flying import fly_drawn
from exam.surrogates.report import campaign_page, surrogate_text
from exam.surrogates.schema import CATALOG, load_surrogate
from exam.surrogates.study import Naming, SurrogateStudy, acts, naming, scored
from ident.tracing.diagnosis import Claim, Prediction, Quantity, Verdict
from scenarios.diagnosis.diagnose import Tracing
from scenarios.studies.catalogue import scenario_kind
from scenarios.tasks.study import Execution
from scenarios.tasks.work import seed_of
from sim.effects.library import find_effect
from sim.errors import DeclarationError
from sim.record import Record
from tests.diagnoses import RIGID, tracing_of
from tests.surrogates import CALM, EVERY, short

LAG = Claim("sensor-lag:alpha", {"time_constant": Quantity(0.06, 0.002, "s")}, ("vane-offset",))


@pytest.mark.parametrize(
    ("hidden", "claims", "how"),
    [
        ("sensor-lag:alpha", [LAG], Naming.ALONE),
        ("sensor-delay:alpha", [LAG], Naming.ALONE),
        ("vane-offset", [LAG], Naming.IN_GROUP),
        ("sensor-lag:q", [LAG], Naming.MISSED),
        ("input-delay", [Claim("actuator-lag", {}, ("input-delay",))], Naming.IN_GROUP),
        ("input-delay", [Claim("actuator-lag", {})], Naming.MISSED),
        ("vane-offset", [], Naming.MISSED),
    ],
)
def test_naming(hidden: str, claims: list[Claim], how: Naming) -> None:
    assert naming(hidden, claims) is how


def test_which_claims_name_a_small_cause() -> None:
    for name in (
        "gust-turbulence",
        "speed-variation",
        "elastic-mode",
        "moment-nonlinearity",
        "lift-nonlinearity",
    ):
        assert acts(name, EVERY) and not acts(name, CALM)
    assert not acts("sensor-lag:q", EVERY)
    assert acts("speed-variation", Causes(gravity=1.0)) and acts(
        "speed-variation", Causes(speed_drift=0.01)
    )


def flight(*hidden: tuple[str, dict[str, float]]) -> Flight:
    plan = draw(short(EVERY), np.random.default_rng(2))
    plan = hiding(
        plan,
        tuple(
            Dominant(find_effect(name, plan.model.equations), values, (0, 1))
            for name, values in hidden
        ),
    )
    return Flight(plan, fly_drawn(plan, np.random.default_rng(3)))


def test_a_diagnosis_is_held_against_the_truth() -> None:
    """That of `tests.diagnoses` with ``partial`` claims a late alpha, with its group, and a scale
    of nz.
    """
    flown = flight(("vane-offset", {"arm": 4.0}))
    found = scored(flown.drawn.surrogate, 1, flown, tracing_of(Verdict.PARTIAL))
    assert found.named == (("vane-offset", Naming.IN_GROUP),)
    assert found.false == ("sensor-scale:nz",) and found.small == ()
    assert [row.name for row in found.derivatives] == list(RIGID.derivatives)
    assert all(
        row.nominal == flown.drawn.declared.parameters[row.name].value for row in found.derivatives
    )
    text = surrogate_text(found)
    assert (
        "vane-offset is named among the alternatives of a claim; sensor-scale:nz is claimed and is "
        "not there" in text
    )
    assert "hidden was vane-offset (arm 4 m)" in text and "lag-one correlation" in text


def test_hints_are_no_claims() -> None:
    flown = flight()
    found = scored(flown.drawn.surrogate, 1, flown, tracing_of(Verdict.UNEXPLAINED))
    assert (found.named, found.false, found.small) == ((), (), ())
    assert "nothing dominates" in surrogate_text(found)


def with_predictions(
    tracing: Tracing, record: Record, before: float, after: float
) -> SurrogateStudy:
    """A study whose held-out errors are white of these sizes."""
    rng, channels = np.random.default_rng(2), ("alpha", "q", "nz")
    z, _ = record.output_array(channels)
    guesses = [
        z + size * np.ptp(z, axis=1)[:, None] * rng.standard_normal(z.shape)
        for size in (before, after)
    ]
    diagnosis = replace(tracing.diagnosis, predictions=(Prediction(record, channels, *guesses),))
    flown = flight()
    return scored(flown.drawn.surrogate, 1, flown, replace(tracing, diagnosis=diagnosis))


@pytest.mark.sampled
@pytest.mark.parametrize(("after", "worse"), [(0.05, False), (0.1, False), (0.15, True)])
def test_worse_means_by_more_than_the_scatter_of_the_error(after: float, worse: bool) -> None:
    assert (
        worsened(with_predictions(tracing_of(Verdict.TRACED), flight().records[0], 0.1, after))
        is worse
    )


JUDGED = (
    Judged(
        1,
        "partial",
        ("vane-offset",),
        (("vane-offset", Naming.ALONE),),
        (),
        ("gust-turbulence",),
        False,
        {"CL_q": 1.0, "Cm_q": -3.0},
        {"CL_q": 0.1, "Cm_q": 0.3},
    ),
    Judged(
        2,
        "partial",
        (),
        (("vane-offset", Naming.IN_GROUP),),
        ("input-delay",),
        (),
        True,
        {"CL_q": -1.9, "Cm_q": 0.0},
        {"CL_q": -0.1, "Cm_q": 0.5},
    ),
    Judged(3, "unexplained", (), (("input-delay", Naming.MISSED),), (), (), False, {}, {}),
)


def test_shares_of_a_campaign() -> None:
    found = shares(JUDGED)
    assert {key: (share.count, share.of) for key, share in found.items()} == {
        "named": (2, 3),
        "named_alone": (1, 3),
        "false_claims": (1, 3),
        "small_claims": (1, 3),
        "held_out_worse": (1, 3),
        "within_two_sigma": (3, 4),
    }
    assert by_effect(JUDGED) == {"input-delay": (1, 0, 0), "vane-offset": (2, 1, 1)}
    inside, middle, size = by_derivative(JUDGED)["CL_q"]
    assert (
        (inside.count, inside.of) == (2, 2)
        and middle == pytest.approx(0.0)
        and size == pytest.approx(0.1)
    )


def test_flights_are_counted_by_clopper_and_pearson_and_what_one_flight_says_together() -> None:
    low, high = share_of_flights([True] * 5 + [False] * 95).interval
    assert binom.sf(4, 100, low) == pytest.approx(0.025) and binom.cdf(
        5, 100, high
    ) == pytest.approx(0.025)
    assert share_of_flights([]) == Share(0, 0, (0.0, 1.0))
    # Six derivatives that are right or wrong together are one trial, not six.
    flights = [[number % 5 > 0] * 6 for number in range(50)]
    together = share_within_flights(flights)
    once = share_of_flights(flight[0] for flight in flights)
    assert (together.count, together.of) == (240, 300)
    assert together.interval == pytest.approx(once.interval, abs=0.04)
    narrow = share_of_flights(hit for flight in flights for hit in flight).interval
    assert together.interval[1] - together.interval[0] > 2.0 * (narrow[1] - narrow[0])
    assert share_within_flights([[True], [], [False]]) == share_of_flights([True, False])


@pytest.mark.long
def test_a_campaign_flies_every_seed_and_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from exam.surrogates.campaign import write_campaign

    monkeypatch.setattr(
        study, "diagnosed", lambda records, vehicle, model, progress: tracing_of(Verdict.PARTIAL)
    )
    done = fly_all(surrogate_flights(replace(short(EVERY, step=0.02), draws=2)), 2, 7, Execution())
    judged = done.found
    seeds = [seed_of(7, number) for number in range(2)]
    assert [flown.seed for flown in judged] == seeds
    assert all(set(flown.errors) == set(RIGID.derivatives) for flown in judged)
    text = campaign_text(short(EVERY), judged, done.words)
    assert "2 flights, seeds from 7" in text and "2 of 2" in text
    assert f"seed {seeds[0]}: sensor-lag:alpha and sensor-scale:nz claimed, and not there" in text
    write_campaign(short(EVERY), done, tmp_path / "c", partial(campaign_page, short(EVERY), done))
    assert (tmp_path / "c" / "campaign.json").is_file()
    row = next(csv.DictReader((tmp_path / "c" / "flights.csv").read_text().splitlines()))
    assert (row["seed"], row["verdict"], row["hidden"], row["false_claims"]) == (
        str(seeds[0]),
        "partial",
        "",
        "sensor-lag:alpha + sensor-scale:nz",
    )
    assert row["said"].startswith("sensor-lag:alpha")


@pytest.mark.long
def test_a_campaign_goes_on_and_gives_the_same(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(
        study, "diagnosed", lambda records, vehicle, model, progress: tracing_of(Verdict.PARTIAL)
    )
    flown, told = replace(short(EVERY, step=0.02), draws=0), []
    kept = fly_all(
        surrogate_flights(flown),
        2,
        7,
        Execution(1, tmp_path),
        lambda stage, share: told.append(share),
    )
    more = fly_all(surrogate_flights(flown), 3, 7, Execution(1, tmp_path, resume=True))
    assert (
        more == fly_all(surrogate_flights(flown), 3, 7, Execution())
        and more.found[:2] == kept.found
    )
    assert told == sorted(told) and told[-1] == 1.0


def test_without_draws_there_are_no_pseudo_true_values(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        study, "diagnosed", lambda records, vehicle, model, progress: tracing_of(Verdict.CONSISTENT)
    )
    assert campaign.judge_flight(replace(short(step=0.02), draws=0), 3).errors == {}


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (
            "hidden.names=['input-dealy']",
            "there is no effect that can be hidden here 'input-dealy'",
        ),
        ("hidden.count=3", None),
        ("flight.vehicles=['glider']", "there is no vehicle 'glider'"),
        ("flight.maneuvers=['roll']", "there is no maneuver 'roll'"),
        ("flight.records=[6,4]", "6 to 4 records"),
        ("flight.records=[1,4]", "1 to 4 records"),
        ("flight.duration=4", "hold no maneuver"),
        ("flight.amplitude=['3 deg','1 deg']", "key flight.amplitude"),
        ("flight.amplitude=['3 kg','4 kg']", "key flight.amplitude"),
        ("causes.turbulence=-1", "is no level"),
        ("causes.turbulence_length=0", "is not above 0"),
        ("causes.speed_drift=1.5", "causes.speed_drift"),
        ("causes.wind=1", "causes.wind"),
        ("causes.noise_std={beta=1.0}", "there is no channel 'beta'"),
        ("estimate.wrong=[0.3,1.0]", "are no shares"),
        ("estimate.draws=-1", "estimate.draws"),
    ],
)
def test_what_a_declaration_refuses(change: str, what: str | None) -> None:
    if what is None:
        assert load_surrogate("surrogate-one", (change,)).hidden.count == 3
        return
    with pytest.raises(DeclarationError, match=what):
        load_surrogate("surrogate-one", (change,))


def test_more_hidden_than_names_are_refused() -> None:
    with pytest.raises(DeclarationError, match="2 of 1 names"):
        load_surrogate("surrogate-one", ("hidden.count=2", "hidden.names=['input-delay']"))


def test_a_file_of_an_earlier_version_leads_here(tmp_path: Path) -> None:
    text = (CATALOG / "surrogate-one.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace('kind = "surrogate"', 'kind = "standin"'))
    with pytest.raises(
        DeclarationError,
        match=r"kind 'standin' examines the tracing loop; .* python -m exam surrogate ",
    ):
        scenario_kind(str(tmp_path / "mine.toml"))


def test_every_level_can_be_declared() -> None:
    assert set(schema._Causes.model_fields) == {item.name for item in fields(Causes)}


SECTIONS: dict[str, type[BaseModel]] = {
    "What a file declares": schema._Surrogate,
    "`[flight]` of a surrogate flight": schema._Flight,
    "`[causes]`": schema._Causes,
    "`[hidden]` of a surrogate flight": schema._Hidden,
    "`[estimate]` of a surrogate flight": schema._Estimate,
}


@pytest.mark.parametrize("title", SECTIONS)
def test_keys_and_defaults_are_documented(title: str) -> None:
    text = (CATALOG.parent / "README.md").read_text(encoding="utf-8")
    section = text.split(f"\n## {title}\n")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    documented = {key.strip().strip("`"): default.strip() for key, default, *_ in rows}
    assert documented == {
        field.alias or name: shown(field.default)
        for name, field in SECTIONS[title].model_fields.items()
    }


def shown(default: object) -> str:
    if default is PydanticUndefined:
        return "required"
    if isinstance(default, BaseModel) or default in ("", [], {}):
        return "empty"
    if isinstance(default, list):
        return f"`[{', '.join(f'{item}' if not isinstance(item, str) else chr(34) + item + chr(34) for item in default)}]`"  # noqa: E501
    return f"`{str(default).lower() if isinstance(default, bool) else default}`"
