"""Scenarios of the closed loop: their files, what a run shows and writes, and what the record's
accidents may move.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ident.banks.engines import BATCHED, FILTERPY, bank_differences
from scenarios.studies.catalogue import scenario_names, scenario_text
from scenarios.x29.content import loop_comparison
from scenarios.x29.declaration import fly_loop, printed_column
from scenarios.x29.estimating import run_over_seeds, set_up
from scenarios.x29.files import write_loop
from scenarios.x29.findings import bias_rows, not_identifiable, sentences
from scenarios.x29.study import (
    HALF_FRAME,
    LoopStudy,
    loop_scenario,
    response_check,
    run_loop,
    starting_values,
    verdicts,
)
from sim.closed_loop.linear import EquivalentSystem, equivalent_system
from sim.errors import DeclarationError
from tests.integration.command_line import CommandLine

NAMES = (
    "simulation",
    "flight",
    "time-shift",
    "convergence",
    "spike",
    "published",
    "breakout",
    "final-peak",
    "innovations",
    "reconstruction",
    "reconstruction-shift",
)


@cache
def study(name: str) -> LoopStudy:
    # The study of the margins is that of tests/unit/scenarios/x29, the methods are those of
    # test_x29_paper.py.
    return run_loop(
        loop_scenario(
            name, ["margins.samples=0", "methods=[]", "seeds=0"] if name == "x29-flight" else []
        )
    )


def moved(name: str) -> dict[str, float]:
    return dict(study(name).derived_differences)


def test_the_catalogue_is_complete() -> None:
    assert set(scenario_names("x29")) == {f"x29-{name}" for name in NAMES}


@pytest.mark.long
def test_the_bank_takes_the_delay_of_its_grid_and_wavers_between_two() -> None:
    """Over 14 seeds: F's 0.146 s lies between two of the bank's delays, R's 0.075 s is one of
    them.
    """
    quick = ["methods=[]", "seeds=0", "margins.samples=0"]
    chosen = {}
    for name in ("x29-flight", "x29-reconstruction"):
        scenario = replace(
            loop_scenario(name, quick[:2] + (quick[2:] if name == "x29-flight" else [])), seeds=14
        )
        found = run_over_seeds(scenario, starting_values(scenario), "printed")
        assert found is not None and len(found.delays) == 14
        chosen[name] = {delay: len(rows) for delay, rows in found.by_delay()}
        assert sum(chosen[name].values()) == 14
        if name == "x29-flight":
            assert found.delays[loop_scenario(name).seed - 1] == 0.125, (
                "the default seed is one of the three"
            )
    assert chosen["x29-flight"] == {0.15: 11, 0.125: 3}
    assert chosen["x29-reconstruction"] == {0.075: 14}
    assert run_over_seeds(loop_scenario("x29-flight", quick), {}, "printed") is None


@pytest.mark.parametrize("name", [f"x29-{name}" for name in NAMES])
def test_files_load_fly_and_name_own_choices(name: str) -> None:
    scenario = loop_scenario(name)
    assert "[own]" in scenario_text(name)
    assert scenario.title and scenario.about
    for column in scenario.published:
        assert printed_column(column)["M_delta"].value > 0, "the paper's sign is turned"
    record = fly_loop(scenario.flight, scenario.seed).record
    assert record.output_names == ("alpha", "q", "nz")
    for variant in scenario.variants:
        assert (variant.flight, variant.estimation) != (scenario.flight, scenario.estimation)


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ("flight.airframe=X", "flight.airframe"),
        ("flight.stick.amplitud=2", "did you mean 'amplitude'"),
        ("flight.duration=-1", "not above 0"),
        ("estimate.start.M_gamma=1", "M_gamma"),
        ("estimate.process_noise.nz=1", "there is no state 'nz'"),
        ("estimate.start_from=x29-flight", "one of start and start_from"),
        ("flight.spike={time=40, size=1.0}", "not within the flight"),
        ("flight.gust=1e-3", "low-order truth only"),
        ("estimate.engine=numba", "estimate.engine"),
        ("margins={samples=4}", "declare [against]"),
    ],
)
def test_a_wrong_declaration_is_one_line(change: str, part: str) -> None:
    with pytest.raises(DeclarationError, match=r"x29-simulation\.toml") as caught:
        loop_scenario("x29-simulation", [change])
    assert part in str(caught.value) and "\n" not in str(caught.value)


def test_a_scenario_that_starts_from_itself_is_refused(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text(
        scenario_text("x29-flight").replace(
            'start_from = "x29-simulation"', f'start_from = "{own}"'
        ),
        encoding="utf-8",
    )
    with pytest.raises(DeclarationError, match="circle"):
        run_loop(loop_scenario(str(own), ["flight.duration=3"]))


def test_the_spike_is_one_sample_of_the_recorded_stick_only() -> None:
    flight = loop_scenario("x29-spike").flight
    with_spike, without = (
        fly_loop(each, 1).record for each in (flight, replace(flight, spike=None))
    )
    assert np.count_nonzero(with_spike["stick"].values != without["stick"].values) == 1
    np.testing.assert_array_equal(with_spike["q"].values, without["q"].values)


@pytest.mark.long
def test_simulation_and_flight_agree_with_the_loops_own_equivalent() -> None:
    flight = study("x29-flight")
    assert flight.other is not None
    loops = {"S": flight.other, "F": flight.result}
    for result, share in zip(loops.values(), (0.10, 0.20), strict=True):
        loop = equivalent_system(result.simulated.x29)
        for name in ("L_alpha", "M_alpha", "M_delta", "M_q"):
            assert result.estimate.value(name) == pytest.approx(getattr(loop, name), rel=share), (
                name
            )
        found = {q.name: q.value for q in result.qualities}
        assert found["natural_frequency"] == pytest.approx(loop.natural_frequency, rel=0.05)
        assert found["damping_ratio"] == pytest.approx(loop.damping_ratio, abs=0.05)
        assert result.bank.refined == pytest.approx(loop.delay, abs=0.015)
    assert flight.differences is not None
    assert {"L_alpha", "M_alpha", "M_q", "delay"} <= {
        item.name for item in flight.differences.beyond
    }


@pytest.mark.long
def test_bias_is_told_against_the_equivalent_that_flies() -> None:
    # Held at the paper's L_q, the equivalent has an L_alpha that no airframe flies and no filter
    # finds.
    flight = study("x29-flight")
    check, airframe = flight.check, flight.result.simulated.x29.airframe
    assert (check.loop.L_q, check.flown.L_q) == (1.01, airframe.L_q) and airframe.L_q < 1.0
    assert (
        check.flown.L_alpha == pytest.approx(airframe.L_alpha, rel=0.003)
        and abs(check.loop.L_alpha / airframe.L_alpha - 1.0) > 0.015
    )
    assert check.flown.mismatch < 0.2 * check.loop.mismatch
    assert "L_alpha" not in [row.name for row in bias_rows(flight)]
    assert "against the loop's own equivalent with the flown L_q, 0.994," in " ".join(
        sentences(flight)
    )
    assert "white innovations: none" in " ".join(
        sentences(replace(flight, check=replace(check, flown=_estimated(flight))))
    )
    # A low-order truth flies the equivalent with the paper's L_q.
    low = response_check(
        replace(flight.result, simulated=replace(flight.result.simulated, truth=None))
    )
    assert low.flown == low.loop == check.loop


def _estimated(found: LoopStudy) -> EquivalentSystem:
    values = {
        name: found.result.estimate.value(name)
        for name in ("L_alpha", "M_alpha", "M_q", "M_delta", "L_delta", "inv_tau", "delay")
    }
    return replace(found.check.flown, **{**values, "delay": values["delay"] + HALF_FRAME})  # type: ignore[arg-type]


def test_what_the_engineer_reads_is_said_and_written(tmp_path: Path) -> None:
    flight = study("x29-flight")
    said = " ".join(sentences(flight))
    assert (
        "phase margin of F is smaller than that of S, that of D, whose" in said
        and "L_delta is not identifiable" in said
        and "with the opposite sign" in said
    )
    assert "L_delta" in [name for name, _, _ in not_identifiable(flight.result.estimate)]
    folder = write_loop(flight, tmp_path / "study", figures=())
    written = json.loads((folder / "comparison.json").read_text(encoding="utf-8"))
    assert (
        written["schema"] == "flightid/comparison/1"
        and written["against"]["scenario"] == "x29-simulation"
    )
    assert {"natural_frequency", "damping_ratio", "delay"} <= set(written["derived"])
    for row in written["parameters"].values():
        assert row["std"] > 0 and "true" not in row
    assert written["parameters"]["M_alpha"]["published"]["value"] == -8.95
    assert written["margins"]["F"]["phase_deg"] == pytest.approx(33.1, abs=1.0)
    assert (
        written["margins"]["D"]["phase_deg"] > written["margins"]["S"]["phase_deg"]
        and "open_margins" not in written
    )
    assert (
        written["linear"]["q_misfit_of"]["none of these"] < 1e-9 < written["linear"]["misfit"]["q"]
        and written["engine"]["name"] == "batched"
    )
    assert all(row["source"] for row in written["levels"])
    assert (folder / "history.csv").is_file() and (folder / "truth.json").is_file()
    assert len([path for path in folder.rglob("comparison.json")]) == 1


@pytest.mark.slow
def test_sentences_follow_the_numbers_of_the_seed() -> None:
    one = study("x29-flight")
    other = run_loop(
        loop_scenario(
            "x29-flight",
            ["flight.duration=8", "estimate.window_stop=8", "margins.samples=0", "methods=[]"],
        ),
        5,
    )
    assert other.other is not None and other.other.scenario.seed == other.seed == 5
    for found in (one, other):
        frequency, damping = (
            found.result.quality("natural_frequency"),
            found.result.quality("damping_ratio"),
        )
        assert frequency is not None and damping is not None
        loop, moved = found.check.loop, dict(found.derived_differences)
        equivalent, against = verdicts(found)
        assert (
            f"frequency {100.0 * (frequency.value / loop.natural_frequency - 1.0):+.1f} % (bound 5 "
            "%)" in equivalent
        )
        assert f"delay {1e3 * (found.result.bank.refined - loop.delay):+.1f} ms" in equivalent
        assert f"to {damping.value:.4g} ({moved['damping_ratio']:+.2f} sigmas)" in against
    assert verdicts(one) != verdicts(other)


def test_verdicts_change_with_the_numbers() -> None:
    flight = study("x29-flight")

    def said(**changes: object) -> str:
        return " ".join(verdicts(replace(flight, **changes)))  # type: ignore[arg-type]

    def moved(frequency: float, damping: float) -> str:
        return said(
            derived_differences=(("natural_frequency", frequency), ("damping_ratio", damping))
        )

    assert "both by less than a sigma" in moved(0.4, -0.9)
    assert "both by less than 3 sigmas" in moved(0.4, -2.9)
    assert "damping ratio by more than 3 sigmas" in moved(0.4, -3.1) and "both" not in moved(
        0.4, -3.1
    )
    first = flight.result.estimate
    last = replace(first, values=first.values + 0.5 * first.std)
    assert "not settled after 1 restart: the last one still moves" in said(
        passes=(first, last)
    ) and "by 0.50 sigmas" in said(passes=(first, last))
    assert "settled after 2 restarts" in said(
        passes=(first, last, last)
    ) and "not settled" not in said(passes=(first, last, last))
    faster = replace(
        flight.check,
        loop=replace(
            flight.check.loop, natural_frequency=0.9 * flight.check.loop.natural_frequency
        ),
    )
    assert "all within" in said() and "beyond the bound: frequency" in said(check=faster)
    peaked, missed = (
        replace(flight.scenario, peak=(1.0, 5.0)),
        replace(flight.misfit, peak_measured=0.08, peak_simulated=0.06),
    )
    assert "too small in free simulation: -25.0 %" in said(scenario=peaked, misfit=missed)
    assert "is met in free simulation" in said(
        scenario=peaked, misfit=replace(missed, peak_simulated=0.0805)
    )
    stretched = replace(flight.scenario, stretch=(9.0, 10.0))
    assert "does not stand out" in said(
        scenario=stretched, misfit=replace(flight.misfit, stretch=1.0, elsewhere=0.9)
    )
    assert "the stretch stands out" in said(
        scenario=stretched, misfit=replace(flight.misfit, stretch=1.8, elsewhere=0.9)
    )


def test_innovations_are_those_of_the_noise_on_the_standard_flight() -> None:
    assert abs(study("x29-flight").misfit.lag_one) < 0.1
    assert loop_comparison(study("x29-flight"))["outcome"] == "converged"


def test_simulate_writes_the_record(tmp_path: Path, flightid: CommandLine) -> None:
    flightid.done(
        "simulate", "x29-breakout", "--out", tmp_path / "r.csv", "--set", "flight.duration=4"
    )
    assert (tmp_path / "r.csv").read_text(encoding="utf-8").startswith("time")
    assert "x29-breakout.toml" in flightid.refused(
        "run", "x29-breakout", "--set", "flight.airfame=S"
    )


def test_filterpy_runs_the_filters_where_it_is_asked() -> None:
    scenario = loop_scenario("x29-simulation", ["estimate.engine=filterpy", "flight.duration=4"])
    setting = set_up(scenario.estimation, fly_loop(scenario.flight, 1), scenario.estimation.start)
    assert setting.engine is FILTERPY
    # Three of its filters over a part of the record; the slow test runs all of it.
    short = replace(setting, record=setting.record.window(0.0, 2.5))
    banks = [
        engine.run(short.record, short.system, fixed_values={"delay": np.array([0.1, 0.125])})
        for engine in (BATCHED, setting.engine)
    ]
    assert bank_differences(*banks).sound and bank_differences(*banks).largest < 1e-8


@pytest.mark.slow
def test_a_study_by_filterpy_is_the_study() -> None:
    changes = ["flight.duration=6", "methods=[]"]
    usual, other = (
        run_loop(loop_scenario("x29-simulation", [*changes, f"estimate.engine={name}"]))
        for name in ("batched", "filterpy")
    )
    assert (
        usual.engines is None
        and other.engines is not None
        and other.engines.sound
        and other.engines.largest < 1e-8
    )
    assert "filterpy, filter by filter, against the batched bank" in " ".join(sentences(other))
    assert loop_comparison(other)["engine"]["name"] == "filterpy"
    one, two = usual.result.estimate, other.result.estimate
    np.testing.assert_allclose((one.values - two.values) / one.std, 0.0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["x29-time-shift", "x29-convergence", "x29-spike"])
def test_accidents_move_frequency_and_damping_by_less_than_three_sigmas(name: str) -> None:
    assert abs(moved(name)["natural_frequency"]) < 3.0
    assert abs(moved(name)["damping_ratio"]) < 3.0


@pytest.mark.slow
def test_a_break_out_makes_the_model_miss_near_zero_stick() -> None:
    found = study("x29-breakout")
    none = next(v.misfit for v in found.variants if v.name == "none")
    assert found.misfit.stretch > 1.5 * found.misfit.elsewhere
    assert none.stretch < 0.1 * found.misfit.stretch


@pytest.mark.slow
def test_the_sticks_shaping_hides_part_of_the_final_peak_and_colours_innovations() -> None:
    peak = {v.name: v.misfit.peak_percent for v in study("x29-final-peak").variants}
    assert peak["curvature"] < -10 and peak["break-out"] < -10
    assert all(abs(peak[name]) < 2 for name in ("linear", "rate-limit", "low-order"))
    found = study("x29-innovations")
    lag = {v.name: v.misfit.lag_one for v in found.variants}
    assert found.misfit.lag_one > 0.3
    assert abs(lag["linear"]) < 0.1 and abs(lag["low-order"]) < 0.1
