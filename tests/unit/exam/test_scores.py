"""Statistics of campaigns of the loop, each written a second way: by hand, by scipy's
distributions, by a direct count.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import beta, binom

from exam.scores.figures import scores_figures
from exam.scores.rates import (
    NORMAL,
    Scores,
    brier,
    coverage_of,
    false_share,
    outcomes,
    reliability_of,
    right_share,
    standings,
)
from exam.scores.report import (
    confusion_rows,
    drawn_scores,
    rate_rows,
    scores_blocks,
    scores_content,
    scores_sections,
)
from exam.scores.scored_flight import (
    Outcome,
    ScoredFlight,
    Standing,
    Stated,
    is_curve,
    outcome_of,
    over_noise,
    parameter_errors,
    plain_name,
    stated_by,
)
from ident.statistics.residuals import ErrorFigures
from ident.tracing.diagnosis import Claim, Quantity, Verdict
from scenarios.report.figure_formats import USUAL
from scenarios.report.terminal import cell_text
from tests.figure_laws import broken_laws, words

NAMES = ("vane-offset", "sensor-lag:q", "input-delay")


def flight(
    hidden: str,
    given: str = "",
    *,
    outcome: Outcome = Outcome.NAMED,
    right: bool | None = None,
    p: float = 0.9,
    errors: Sequence[float] = (),
) -> ScoredFlight:
    hit = (given == hidden if hidden else outcome is Outcome.NOTHING) if right is None else right
    stated = (Stated(given, p, True, hit),) if given else ()
    parameters = {f"{hidden}.{number}": error for number, error in enumerate(errors)}
    return ScoredFlight(
        (hidden,) if hidden else (),
        "traced",
        outcome,
        (given,) if given else (),
        hit,
        (given,) if given and not hit else (),
        stated,
        parameters,
    )


def many(seed: int, count: int = 400) -> Scores:
    """Flights of which a name said to be right with p is so in that share, and whose errors have
    the sigmas that are reported.
    """
    rng = np.random.default_rng(seed)
    flights = []
    for _ in range(count):
        hidden = NAMES[int(rng.integers(3))]
        p = float(rng.uniform(0.06, 1.0))
        given = hidden if rng.random() < p else next(name for name in NAMES if name != hidden)
        flights.append(
            flight(
                hidden,
                given,
                p=p,
                errors=rng.standard_normal(2).tolist() if given == hidden else (),
            )
        )
    flights += [flight("", outcome=Outcome.NOTHING) for _ in range(30)] + [
        flight("", "vane-offset") for _ in range(2)
    ]
    return Scores(flights, [each.hidden[0] if each.hidden else "nothing" for each in flights])


def test_rates_are_counts_with_the_interval_of_the_binomial_distribution() -> None:
    flights = (
        [flight("a", "a")] * 7
        + [flight("a", "b")] * 2
        + [flight("a", outcome=Outcome.UNEXPLAINED)] * 3
        + [flight("a", outcome=Outcome.NOTHING)]
    )
    shares = outcomes(flights)
    assert {key.value: share.count for key, share in shares.items()} == {
        "named": 9,
        "ambiguous": 0,
        "unexplained": 3,
        "nothing missing": 1,
    }
    right = right_share(flights)
    assert (right.count, right.of) == (7, 13) and sum(
        share.count for share in standings(flights).values()
    ) == 13
    # Clopper and Pearson by the quantiles of the beta distribution, and by what they mean.
    assert right.interval == pytest.approx((beta.ppf(0.025, 7, 7), beta.ppf(0.975, 8, 6)))
    assert binom.sf(6, 13, right.interval[0]) == pytest.approx(0.025) and binom.cdf(
        7, 13, right.interval[1]
    ) == pytest.approx(0.025)
    (row,) = rate_rows(Scores(flights, ["a"] * 13))
    told = ["a", "13", "54 %", "25 to 81 %", "7", "0", "3", "1", "2"]
    assert [cell_text(cell) for cell in row] == told


@pytest.mark.parametrize(
    ("outcome", "right", "standing"),
    [
        (Outcome.NAMED, True, Standing.RIGHT),
        (Outcome.NAMED, False, Standing.WRONG),
        (Outcome.AMBIGUOUS, True, Standing.AMONG),
        (Outcome.AMBIGUOUS, False, Standing.BESIDE),
        (Outcome.UNEXPLAINED, False, Standing.UNEXPLAINED),
        (Outcome.NOTHING, True, Standing.NOTHING),
    ],
)
def test_an_outcome_stands_by_whether_it_is_right(
    outcome: Outcome, right: bool, standing: Standing
) -> None:
    assert flight("a", "b", outcome=outcome, right=right).standing is standing


def test_conclusions_are_counted_in_full_and_by_kind() -> None:
    flights = [
        *(
            flight("sensor-lag:q", "sensor-lag:q"),
            flight("sensor-lag:q", "sensor-delay:q", right=True),
            flight("sensor-lag:q", "sensor-lag:nz"),
        ),
        *(
            flight("sensor-lag:q", outcome=Outcome.UNEXPLAINED),
            flight("", outcome=Outcome.NOTHING),
            flight("", "elastic-mode#2"),
        ),
    ]
    labels = ["sensor-lag"] * 4 + ["nothing"] * 2
    in_full = dict.fromkeys(("sensor-lag:q", "sensor-delay:q", "sensor-lag:nz", "unexplained"), 1)
    assert Scores(flights, labels).confusion == {
        "sensor-lag": in_full,
        "nothing": {"nothing missing": 1, "elastic-mode#2": 1},
    }
    kinds = Scores(flights, labels, by_kind=True)
    assert kinds.confusion["sensor-lag"] == dict.fromkeys(
        ("sensor-lag", "sensor-delay", "sensor-lag elsewhere", "unexplained"), 1
    )
    assert [(row[0], row[1]) for row in confusion_rows(kinds)][-1] == ("nothing", "elastic-mode")
    clean = false_share([each for each in flights if not each.hidden])
    assert (clean.count, clean.of) == (1, 2)
    both = ScoredFlight(("a", "b"), "traced", Outcome.NAMED, ("a", "b"), True)
    assert Scores([both], ["x"]).confusion == {"x": {"a + b": 1}} and Scores(
        [both], ["x"], True
    ).confusion == {"x": {"several names": 1}}


def test_probabilities_are_counted_in_bins_and_scored_by_brier() -> None:
    scores = many(3)
    pairs = [(each.probability, each.right) for one in scores.flights for each in one.stated]
    for item in reliability_of(scores.flights):
        inside = [(p, right) for p, right in pairs if item.low < p <= item.high]
        assert (item.count, item.right) == (len(inside), sum(right for _, right in inside))
        assert item.said == pytest.approx(sum(p for p, _ in inside) / len(inside))
        low = beta.ppf(0.025, item.right, item.count - item.right + 1) if item.right else 0.0
        high = (
            beta.ppf(0.975, item.right + 1, item.count - item.right)
            if item.right < item.count
            else 1.0
        )
        assert item.interval == pytest.approx((low, high))
    score = brier(scores.flights)
    assert score is not None and score.count == len(pairs)
    assert score.score == pytest.approx(
        sum((1.0 - p) ** 2 if right else p**2 for p, right in pairs) / len(pairs)
    )
    share = sum(right for _, right in pairs) / len(pairs)
    assert (
        score.constant == pytest.approx(share * (1.0 - share))
        and score.interval[0] < score.score < score.interval[1]
    )
    # By the normal law of a mean the same width, for one name a flight.
    spread = np.std([(p - right) ** 2 for p, right in pairs]) / np.sqrt(len(pairs))
    assert score.interval[1] - score.interval[0] == pytest.approx(2.0 * 1.96 * spread, rel=0.1)
    assert brier([flight("a", outcome=Outcome.NOTHING)]) is None


def test_coverage_counts_parameters_and_its_interval_flights() -> None:
    flights = [
        flight("a", "a", errors=(0.5, 1.5, 2.5)),
        flight("a", "a", errors=(-0.9, 3.5)),
        flight("b", "b", errors=(-2.9,)),
        flight("b", "a"),
    ]
    found = coverage_of(Scores(flights, ["a", "a", "b", "b"]))
    counts = {
        label: [(share.count, share.of) for share in shares] for label, shares in found.items()
    }
    assert counts == {
        "a": [(2, 5), (3, 5), (4, 5)],
        "b": [(0, 1), (0, 1), (1, 1)],
        "all": [(2, 6), (3, 6), (5, 6)],
    }
    assert pytest.approx((68.27, 95.45, 99.73), abs=0.005) == NORMAL
    # Parameters of one flight that are right or wrong together count as one.
    together = coverage_of(
        Scores([flight("a", "a", errors=(size,) * 6) for size in (0.1, 0.2, 5.0)] * 10, ["a"] * 30)
    )["a"][1]
    alone = coverage_of(
        Scores([flight("a", "a", errors=(size,)) for size in (0.1, 0.2, 5.0)] * 10, ["a"] * 30)
    )["a"][1]
    assert together.interval == pytest.approx(alone.interval, abs=0.04)


@pytest.mark.slow
def test_intervals_hold_what_is_true_as_often_as_they_say() -> None:
    """Of 400 campaigns whose probabilities and sigmas are right, nineteen of twenty intervals hold
    them.
    """
    held: dict[str, list[bool]] = {"brier": [], "bins": [], "two sigmas": []}
    for seed in range(400):
        scores = many(seed, 120)
        score, expected = brier(scores.flights), []
        assert score is not None
        for one in scores.flights:
            expected += [
                each.probability * (1.0 - each.probability) for each in one.stated if one.hidden
            ]
        clean = [
            each.probability**2 for one in scores.flights if not one.hidden for each in one.stated
        ]
        held["brier"].append(
            score.interval[0] <= (sum(expected) + sum(clean)) / score.count <= score.interval[1]
        )
        planted = [each for each in scores.flights if each.hidden]
        held["bins"] += [
            item.interval[0] <= item.said <= item.interval[1]
            for item in reliability_of(planted)
            if item.count
        ]
        low, high = coverage_of(scores)["all"][1].interval
        held["two sigmas"].append(low <= NORMAL[1] / 100.0 <= high)
    for name, hits in held.items():
        share = float(np.mean(hits))
        assert 0.90 < share <= 1.0, (name, share)


def test_what_a_claim_says_is_read_from_it() -> None:
    claim = Claim(
        "sensor-lag:q",
        {"time_constant": Quantity(0.06, 0.002, "s")},
        probability={"sensor-lag:q": 0.7, "vane-offset": 0.2},
    )
    assert stated_by([claim], {"sensor-lag:q"}) == (
        Stated("sensor-lag:q", 0.7, True, True),
        Stated("vane-offset", 0.2, False, False),
    )
    assert parameter_errors([claim], {"sensor-lag:q": {"time_constant": 0.05}}) == pytest.approx(
        {"sensor-lag:q.time_constant": 5.0}
    )
    assert parameter_errors([claim], {"vane-offset": {"arm": 5.0}}) == {}
    assert (
        outcome_of("consistent", []) is Outcome.NOTHING
        and outcome_of("traced", []) is Outcome.UNEXPLAINED
    )
    assert (
        outcome_of("ambiguous", [claim]) is Outcome.AMBIGUOUS
        and outcome_of("partial", [claim]) is Outcome.NAMED
    )
    figures = ErrorFigures({"alpha": 0.002, "q": 0.003}, {}, {}, {})
    assert over_noise(figures, {"alpha": 0.001, "q": 0.003}) == pytest.approx(
        np.sqrt((4.0 + 1.0) / 2.0)
    ) and np.isnan(over_noise(figures, {}))
    assert (
        plain_name("elastic-mode#2") == plain_name("elastic-mode:1") == "elastic-mode"
        and plain_name("sensor-lag:q") == "sensor-lag:q"
    )
    assert is_curve("moment-nonlinearity") and not is_curve("vane-offset")


@pytest.mark.long
def test_the_terminal_the_page_and_the_files_say_the_same(tmp_path: Path) -> None:
    scores = many(5, 40)
    text, content = (
        "\n".join(line for block in scores_blocks(scores) for line in block),
        scores_content(scores),
    )
    right = content["all"]["right"]
    assert (
        f"{100.0 * right['count'] / right['of']:.0f} %" in text
        and "false names on the 32 flights with nothing hidden: 2, 6 %" in text
    )
    assert (
        content["false_names_on_clean"]["count"] == 2 and f"{content['brier']['score']:.3f}" in text
    )
    drawn = drawn_scores(scores, "x", tmp_path, USUAL)
    assert [each.stem for each in drawn] == [
        "verdicts",
        "confusion",
        "reliability",
        "effect_coverage",
    ]
    assert all(
        (tmp_path / f"{each.stem}.png").read_bytes().startswith(b"\x89PNG") for each in drawn
    )
    sections = scores_sections(scores, drawn)
    assert len(sections) == 4 and all(
        any(type(block).__name__ == "Figure" for block in each.blocks) for each in sections
    )
    assert scores_sections(
        Scores([flight("", outcome=Outcome.NOTHING)], ["nothing"])
    ) and not drawn_scores(scores, "x", tmp_path, ())


@pytest.mark.long
@pytest.mark.parametrize(
    "scores",
    [
        many(5, 40),
        Scores([flight("vane-offset", "vane-offset", errors=(0.3,))] * 2, ["vane-offset"] * 2),
    ],
)
def test_figures_keep_the_laws_of_figures(scores: Scores) -> None:
    for stem, make in scores_figures(scores, "every-effect"):
        assert broken_laws(make()) == [], stem
    figures = {stem: make() for stem, make in scores_figures(scores, "every-effect")}
    assert f"vane-offset ({len(scores.groups['vane-offset'])})" in words(figures["verdicts"])
    assert ("confusion" in figures) is (len(scores.groups) > 1)


def test_bars_are_as_long_as_the_shares() -> None:
    flights: list[Any] = [flight("a", "a")] * 3 + [flight("a", "b")]
    figure = dict(scores_figures(Scores(flights, ["a"] * 4), "x"))["verdicts"]()
    bars: list[Any] = list(figure.axes[0].patches)
    widths = {round(bar.get_width(), 6) for bar in bars if bar.get_width() > 0.0}
    assert widths == {75.0, 25.0}


def test_scenarios_give_the_same_marks() -> None:
    from exam.hidden_effects import TraceJudged, scored_flight_of
    from scenarios.trials.planted_declaration import Grade

    claim = Claim(
        "sensor-lag:q",
        {"time_constant": Quantity(0.06, 0.002, "s")},
        ("vane-offset",),
        probability={"sensor-lag:q": 0.6, "vane-offset": 0.3},
    )
    figures = ErrorFigures({"q": 0.004}, {}, {}, {}), ErrorFigures({"q": 0.002}, {}, {}, {})
    study: Any = SimpleNamespace(
        grade=Grade.AMBIGUOUS,
        scenario=SimpleNamespace(expect=SimpleNamespace(effects=(("vane-offset",),))),
        simulated=SimpleNamespace(hidden={"vane-offset": {"arm": 5.0}}, noise_std={"q": 0.002}),
        tracing=SimpleNamespace(
            diagnosis=SimpleNamespace(
                verdict=Verdict.AMBIGUOUS,
                effects=(claim,),
                error_before=figures[0],
                error_after=figures[1],
            )
        ),
    )
    judged = TraceJudged(4, "ambiguous", Grade.AMBIGUOUS, (), (), (), (), ())
    marked = scored_flight_of(study, judged)
    assert marked.standing is Standing.AMONG and (
        marked.held_out_before,
        marked.held_out_after,
    ) == (2.0, 1.0)
    assert [(each.name, each.right) for each in marked.stated] == [
        ("sensor-lag:q", False),
        ("vane-offset", True),
    ]
