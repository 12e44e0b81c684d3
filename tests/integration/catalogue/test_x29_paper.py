"""NASA TM-101722's own procedure and numbers beside ours: methods by name, what its numbers say,
which way its restarts go.
"""

from __future__ import annotations

import io
import json
import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from ident.banks.bank import filter_alone
from ident.banks.delays import DELAYS
from scenarios.report.terminal import show_blocks
from scenarios.side_by_side import read_columns
from scenarios.x29.declaration import METHODS, printed_column, printed_correlation, printed_noise
from scenarios.x29.estimating import single_pass_restarts
from scenarios.x29.files import write_loop
from scenarios.x29.findings import noise_sentence, paper_sentences, prior_sentence
from scenarios.x29.published_tables import paper_blocks
from scenarios.x29.study import LoopStudy, loop_scenario, run_loop
from sim.errors import DeclarationError
from tests.oracles.short_period_tables import NAMES, ROWS, numbers


@cache
def flight() -> LoopStudy:
    return run_loop(loop_scenario("x29-flight", ["margins.samples=0", "seeds=2"]))


def printed(column: str, kind: str) -> dict[str, float]:
    return {
        name: float(value) for name, value in zip(NAMES, numbers(ROWS[column][kind]), strict=True)
    }


@pytest.mark.slow
def test_the_papers_procedure_is_its_p0_its_r_and_the_likeliest_plain_filter() -> None:
    study = flight()
    found = {m.name: m for m in study.methods}
    assert tuple(found) == loop_scenario("x29-flight").methods and set(found) <= set(METHODS)
    assert dict(study.paper.noise_std) == pytest.approx(printed_noise("flight"))
    variance = printed("simulation", "initial variance")
    for name in ("L_alpha", "M_q", "inv_tau", "delta_0"):
        assert study.paper.system.parameters[name].prior_std ** 2 == pytest.approx(variance[name])
    paper, system = found["paper"], study.paper.system
    alone = {
        d: filter_alone(
            study.paper.record,
            replace(system, parameters=system.parameters.with_values({"delay": d})),
        )
        for d in DELAYS[4:8]
    }
    best = max(alone, key=lambda d: alone[d].log_likelihood)
    assert paper.delay == best
    for name, value in alone[best].as_dict().items():
        assert paper.values[name] == pytest.approx(value, rel=1e-6, abs=1e-9), name
    assert found["held"].delay == study.result.bank.refined
    assert found["relinearised"].delay == paper.delay != found["paper-other"].delay
    assert (paper.delay < study.result.bank.refined) != (
        found["paper-other"].delay < study.result.bank.refined
    )


@pytest.mark.long
def test_the_noise_flown_is_the_papers() -> None:
    record = flight().result.simulated.record
    quiet = record.time > 10.0
    for name, std in printed_noise("flight").items():
        # Four sigmas of a standard deviation of 400 samples.
        assert np.std(record[name].values[quiet]) == pytest.approx(
            std, rel=4.0 / math.sqrt(2.0 * quiet.sum())
        ), name


@pytest.mark.long
def test_sigmas_come_out_near_the_printed_ones() -> None:
    # Within a half: the paper's input, which decides them too, is not known.
    estimate, plain = flight().result.estimate, flight().single_pass.estimate
    final = {name: math.sqrt(value) for name, value in printed("flight", "final variance").items()}
    for name in ("L_alpha", "L_q", "L_delta", "M_q", "L_0"):
        assert estimate.sigma(name) == pytest.approx(final[name], rel=0.5), name
    for name in ("M_0", "delta_0", "inv_tau"):
        assert plain.sigma(name) == pytest.approx(final[name], rel=0.5), name
        assert estimate.sigma(name) > 2.0 * plain.sigma(name), name


def test_what_the_printed_numbers_say_of_themselves() -> None:
    start, variance = printed("simulation", "initial"), printed("simulation", "initial variance")
    said = prior_sentence()
    for name in ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau"):
        assert f"{name} {math.sqrt(variance[name]):.3g} for {abs(start[name]) / 4.0:.3g}" in said
        assert f"{name} {4.0 * math.sqrt(variance[name]):.3g}" in said.split("another start")[1]
    assert "no filter leaves that" in noise_sentence(
        "simulation"
    ) and "hundredth" not in noise_sentence("flight")
    said = " ".join(paper_sentences(flight()))
    value, sigma = 14.6, math.sqrt(0.0891)
    low, high = (0.075 + 1.0 / value + side * 2.0 * sigma / value**2 for side in (-1.0, 1.0))
    assert (
        f"{low:.4f} to {high:.4f} s" in said
        and abs(low - 0.140) < 1e-3
        and abs(high - 0.146) < 1e-3
    )
    assert "wider than two sigmas of its Table 2" in said


def test_whether_the_procedure_misses_its_own_table_hangs_on_its_numbers() -> None:
    study = flight()
    paper = study.methods[0]
    met = replace(
        paper,
        values={
            **paper.values,
            **{
                name: cell.value
                for name, cell in printed_column("flight").items()
                if name in paper.values
            },
        },
    )
    far = replace(met, values={**met.values, "M_q": met.values["M_q"] - 10.0 * paper.std["M_q"]})
    said = {
        name: " ".join(paper_sentences(replace(study, methods=(m, *study.methods[1:]))))
        for name, m in {"met": met, "far": far}.items()
    }
    assert "comes within 3 sigmas of its own Table 2" in said["met"] and "misses" not in said["met"]
    assert "misses M_q of its own Table 2" in said["far"]
    without = paper_sentences(replace(study, scenario=replace(study.scenario, methods=())))
    assert without == (), "a study without methods says nothing of the paper's"


def test_restarts_go_by_the_delay_that_is_held() -> None:
    study = flight()
    refined = study.first.refined
    shorter, longer = max(d for d in DELAYS if d < refined), min(d for d in DELAYS if d > refined)
    found = single_pass_restarts(study.paper, [shorter, longer], passes=3)
    first, last = found.values["inv_tau"][0], found.values["inv_tau"][-1]
    assert last[0] < first[0] and last[1] > first[1]
    # The first pass is the bank's own.
    at = [int(np.argmin(np.abs(study.single_pass.delays - d))) for d in (shorter, longer)]
    np.testing.assert_allclose(
        found.values["M_q"][0],
        study.single_pass.bank.mean[study.single_pass.bank.names.index("M_q"), at],
        rtol=1e-9,
    )
    said = " ".join(paper_sentences(replace(study, restarts={"as printed": found})))
    assert (
        f"held at {longer:.4f} s" in said and "(as the paper)" in said and "(the other way)" in said
    )
    turned = replace(found, values={name: value[::-1] for name, value in found.values.items()})
    assert "turns the direction at a grid point" in " ".join(
        paper_sentences(replace(study, restarts={"one": found, "other": turned}))
    )


def test_the_papers_tables_are_written_beside_ours(tmp_path: Path) -> None:
    written = json.loads(
        (write_loop(flight(), tmp_path / "study", figures=()) / "comparison.json").read_text(
            encoding="utf-8"
        )
    )
    states, final = written["published"]["states"], printed("flight", "final variance")
    assert states["M_q"]["final_variance"]["published"] == pytest.approx(final["M_q"])
    assert (
        states["q"]["R"]["here"] == pytest.approx(states["q"]["R"]["published"])
        and "R" not in states["delta"]
    )
    names, C = printed_correlation("flight")
    assert written["published"]["correlation"] == {"names": list(names), "matrix": C.tolist()}
    assert {tuple(row["pair"]) for row in written["published"]["correlation_pairs"]} >= {
        ("delta", "delta_0"),
        ("M_delta", "M_q"),
    }
    assert written["published"]["checks"]["delay"] == {
        "low": 0.14,
        "high": 0.146,
        "frequency_response": 0.12,
    }
    assert [m["name"] for m in written["methods"]] == [*loop_scenario("x29-flight").methods, "own"]
    # `flightid compare` reads them as methods of the study, in the units of its main one.
    main, *methods = read_columns([str(tmp_path / "study")], every=True)
    assert [column.method for column in methods] == [
        *loop_scenario("x29-flight").methods
    ] and methods[0].estimator == METHODS["paper"]
    assert all(
        value.unit == main.values[name].unit
        for column in methods
        for name, value in column.values.items()
    )
    assert {"L_alpha", "M_q", "inv_tau", "nz_0"} <= methods[0].values.keys()


def test_the_time_shift_moves_the_whole_window_of_one_record() -> None:
    one, other = loop_scenario("x29-flight"), loop_scenario("x29-time-shift")
    assert one.flight == other.flight and one.seed == other.seed
    begin, end = one.estimation.window_start or 0.0, one.estimation.window_stop or 0.0
    assert (other.estimation.window_start, other.estimation.window_stop) == (begin + 1.5, end + 1.5)
    assert other.flight.duration >= end + 1.5


def test_a_method_that_is_not_there_is_refused() -> None:
    with pytest.raises(DeclarationError, match=r"there is no method 'best'.*refined-printed"):
        loop_scenario("x29-flight", ['methods=["best"]'])
    with pytest.raises(
        DeclarationError, match=r"key published: there is no column 'fight'; use simulation, flight"
    ):
        loop_scenario("x29-flight", ['published=["fight"]'])
    with pytest.raises(DeclarationError, match=r"there is no output 'roll'"):
        loop_scenario("x29-flight", ['flight.noise_variance={roll="1 deg^2"}'])


def test_the_terminal_shows_both_beside_each_other() -> None:
    out = Console(width=200, file=io.StringIO())
    show_blocks(out, paper_blocks(flight()))
    said = out.file.getvalue()  # type: ignore[attr-defined]
    paper = flight().methods[0]
    row = next(line for line in said.splitlines() if METHODS["paper"] in line)
    assert f"{paper.delay:.4f}" in row and f"{paper.frequency:.2f}" in row
    state = next(
        line for line in said.splitlines() if line.startswith("  M_q ") and " 1.6 " in line
    )
    assert state.count(" 1.6 ") == 2, "initial sigma here and as published"
    assert not re.search(r"\de[+-]\d", said), "plain numbers"
    assert "correlations as published in Table 2" in said and "-0.93*" in said
