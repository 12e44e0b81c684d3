"""Structures from stiff to soft, and a model of full order: what the figures of these studies stand
on.
"""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.statistics.intervals import determination
from ident.whole_record.layout import weighted_sensitivities
from scenarios.side_by_side import read_responses
from scenarios.studies.catalogue import load_scenario
from scenarios.studies.comparison import comparison
from scenarios.studies.estimating import (
    assumed_noise,
    biased_system,
    declared_model,
    flight_constants,
    fly_scenario,
    true_model,
)
from scenarios.studies.folder import write_study
from scenarios.studies.study import StudyResult, run_scenario
from scenarios.studies.sweep import (
    Sweep,
    _failure_place,
    criteria_of,
    sweep_content,
    sweep_csv,
    sweep_flexibility,
)
from sim.errors import DeclarationError
from sim.vehicles.factory import linearise
from sim.vehicles.flexibility import condense, with_frequency_factor
from sim.vehicles.library import read_parameter_set
from tests.integration.command_line import CommandLine

COARSE = ("flight.rate=20 Hz", "flight.step=0.005")


@pytest.fixture(scope="module")
def swept() -> tuple[StudyResult, Sweep]:
    scenario = load_scenario(
        "flexibility-sweep", [*COARSE, "sweep.frequency_factors=[4.0, 1.0, 0.5]"]
    )
    study = run_scenario(scenario)
    sweep = sweep_flexibility(scenario, study.record, study.seed)
    assert sweep is not None
    return study, sweep


def test_half_the_frequencies_are_the_second_aircraft() -> None:
    first, second = read_parameter_set("bomber_ac1"), read_parameter_set("bomber_ac2")
    assert with_frequency_factor(first, 0.5).values == pytest.approx(second.values, rel=1e-12)
    assert with_frequency_factor(first, 1.0) is first
    with pytest.raises(DeclarationError, match="no modal frequencies"):
        with_frequency_factor(read_parameter_set("bomber_rigid"), 0.5)


@pytest.mark.long
def test_the_sweep_passes_through_the_scenarios_own_flight(
    swept: tuple[StudyResult, Sweep],
) -> None:
    study, sweep = swept
    for method, found in zip(study.methods, sweep.point(1.0).methods, strict=True):
        assert found.names == method.result.estimate.names
        assert np.all(np.abs(found.values - method.result.estimate.values) < 1e-6 * found.std)
        assert {row.name: row.condensed for row in method.rows} == pytest.approx(
            {name: found.condensed[name] for name in found.names}
        )


@pytest.mark.long
def test_a_stiff_structure_is_the_rigid_aircraft_and_a_soft_one_is_not(
    swept: tuple[StudyResult, Sweep],
) -> None:
    _, sweep = swept
    for point in sweep.points:
        scaled = with_frequency_factor(read_parameter_set("bomber_ac1"), point.frequency_factor)
        assert dict(point.figures.condensed) == pytest.approx(
            dict(condense(scaled.values, 4).derivatives)
        )
    stiff, soft = sweep.points[0], sweep.points[-1]
    for name, rigid in sweep.rigid.items():
        assert abs(stiff.methods[0].errors(name)[1]) < 4.0 and abs(
            stiff.figures.condensed[name] - rigid
        ) < 0.11 * abs(rigid)
    assert max(abs(soft.methods[0].errors(name)[1]) for name in sweep.rigid) > 50.0
    moved = [abs(soft.figures.condensed[name] / rigid - 1.0) for name, rigid in sweep.rigid.items()]
    assert max(moved) > 0.5


def test_criteria_find_where_a_rigid_model_fails(swept: tuple[StudyResult, Sweep]) -> None:
    _, sweep = swept
    found = {each.name: each for each in criteria_of(sweep.points)}
    assert set(found) == {"likelihood", "whiteness", "misfit"}
    for each in found.values():
        assert each.frequency_factor is not None and each.degree is not None
        assert 0.5 < each.frequency_factor < 4.0
        assert sweep.points[0].figures.degree < each.degree < sweep.points[-1].figures.degree
    assert (found["misfit"].degree or 0.0) > (found["likelihood"].degree or math.inf), (
        "a record shows the structure before it spoils the model"
    )
    rigid, elastic = (sweep.points[1].methods[i] for i in (1, 2))
    by_hand = 2 * (elastic.log_likelihood - rigid.log_likelihood) - 8 * math.log(2 * 161)
    assert found["likelihood"].values[1] == pytest.approx(by_hand)


def test_a_limit_is_passed_for_good_or_not_at_all() -> None:
    places = [0.0, 1.0, 2.0, 3.0]
    assert _failure_place(places, [-1.0, -1.0, 3.0, 5.0], 0.0, False) == pytest.approx(1.25)
    assert _failure_place(places, [-1.0, 2.0, -2.0, 5.0], 0.0, False) == pytest.approx(
        2.0 + 2.0 / 7.0
    ), "it had come back"
    assert _failure_place(places, [5.0, 1.0, -1.0, -5.0], 0.0, True) == pytest.approx(1.5)
    assert _failure_place(places, [1.0, 2.0, 3.0, 4.0], 0.0, False) is None, (
        "it began before the sweep"
    )
    assert _failure_place(places, [1.0, 2.0, 3.0, -1.0], 0.0, False) is None


def test_the_sweep_is_written_as_strict_json_and_as_a_table(
    swept: tuple[StudyResult, Sweep],
) -> None:
    study, sweep = swept
    content = json.loads(json.dumps(comparison(replace(study, sweep=sweep)), allow_nan=False))[
        "sweep"
    ]
    assert content == json.loads(json.dumps(sweep_content(sweep)))
    assert [mark["label"] for mark in content["marks"]] == ["AC1", "AC2"]
    rows = list(csv.DictReader(io.StringIO(sweep_csv(sweep))))
    assert len(rows) == 3 * (6 + 6 + 15)
    row = next(
        row for row in rows if row["frequency_factor"] == "0.5" and row["parameter"] == "Cm_alpha"
    )
    assert float(row["error_sigmas"]) == pytest.approx(
        (float(row["estimate"]) - float(row["condensed"])) / float(row["std"])
    )


@pytest.mark.parametrize("modes", [1, 4])
def test_alpha_and_q_show_three_numbers_a_state_whatever_the_maneuver(modes: int) -> None:
    # A transfer function of s states from one input to two strictly proper outputs has s + 2 s
    # coefficients.
    name = "flexible-ac1-full-order" if modes == 4 else "flexible-ac1-first-mode"
    sine = (
        '[{input="elevator", kind="multisine", amplitude=0.06, duration="8 s", '
        "harmonics=[1,2,3,5,8,12,14,16,18,20,22,24,26,28,30,33]}]"
    )
    scenario = load_scenario(name, [*COARSE, f"flight.maneuvers={sine}"])
    estimation = scenario.estimations[0]
    record, truth = fly_scenario(scenario, 1)
    model = declared_model(
        estimation,
        flight_constants(scenario.flight, estimation),
        assumed_noise(scenario, estimation),
    )
    system = biased_system(
        estimation,
        model.with_values({name: truth.parameters[name].value for name in estimation.start}),
    )
    names, slopes = weighted_sensitivities(record, system, np.array([2e-3, 2e-3]))
    found = determination(names, slopes, np.array([estimation.start[name].std for name in names]))
    assert len(names) == {1: 15, 4: 66}[modes]
    assert len(names) - found.unseen == 3 * (2 + 2 * modes)


def test_a_method_may_fly_maneuvers_of_its_own(tmp_path: Path) -> None:
    own = '[{input="elevator", kind="doublet", amplitude=0.05, unit="0.5 s", start="1 s"}]'
    scenario = load_scenario(
        "rigid",
        [
            *COARSE,
            f'methods=[{{name="doublet", explanation="x", flight={{maneuvers={own}}}}}]',
            "determination=true",
        ],
    )
    study = run_scenario(scenario)
    other = study.methods[1]
    assert np.max(np.abs(other.result.record["elevator"].values)) == pytest.approx(0.05)
    assert np.max(np.abs(study.record["elevator"].values)) == pytest.approx(0.10471)
    write_study(study, tmp_path / "study", figures=())
    written = read_responses(tmp_path / "study", "doublet")
    assert written is not None
    assert np.std(written.measured["q"] - written.true["q"]) == pytest.approx(
        study.truth.noise_std["q"], rel=0.3
    )
    main, second = (method.determination for method in study.methods)
    assert main is not None and second is not None
    assert main.found.posterior_std == pytest.approx(study.main.result.estimate.std, rel=0.1), (
        "a filter of all parameters loses nothing here"
    )
    assert np.all(second.found.posterior_std > main.found.posterior_std), (
        "half the amplitude tells less"
    )
    assert main.found.unseen == 0 and main.overclaimed == ()
    content = json.loads((tmp_path / "study" / "comparison.json").read_text())
    assert (
        content["determination"]["directions_determined"]
        == 6
        == len(content["determination"]["strengths"])
    )


@pytest.mark.parametrize(
    ("name", "change", "what"),
    [
        ("flexibility-sweep", 'sweep.marks=[{label="x", frequency_factor=3.3}]', "no such factor"),
        ("flexibility-sweep", "sweep.frequency_factors=[1.0]", "sweep.frequency_factors"),
        ("flexibility-sweep", "estimate.modes=1", "the main method is no rigid model"),
        ("rigid", "sweep.frequency_factors=[1.0, 2.0, 3.0]", "there is no structure to soften"),
        ("rigid", "flight.frequency_factor=0.5", "it has no modal frequencies"),
        (
            "flexibility-sweep",
            'methods=[{name="x", flight={duration="6 s"}}]',
            "a sweep is flown once for all methods",
        ),
    ],
)
def test_what_cannot_be_swept_or_flown_is_refused(
    name: str, change: str, what: str, flightid: CommandLine
) -> None:
    assert what in flightid.refused("run", name, "--set", change)


@pytest.mark.slow
def test_what_the_full_order_model_says_of_the_papers_sentence() -> None:
    study = run_scenario(load_scenario("flexible-ac1-full-order"))
    steps, sine, filtered = (method.determination for method in study.methods)
    assert steps is not None and sine is not None and filtered is not None
    for each in (steps, sine, filtered):
        assert (len(each.found.names), each.found.unseen) == (66, 36)
    assert 12 <= steps.found.determined < sine.found.determined <= 17
    assert sine.found.effective > steps.found.effective + 1.0
    assert steps.overclaimed == sine.overclaimed == () and len(filtered.overclaimed) >= 5
    main = study.main
    assert all(test.passed for test in main.tests)
    assert np.mean([abs(row.sigmas or 0.0) < 2.0 for row in main.rows]) > 0.9
    value, sigma = main.derived["natural_frequency"]
    true = sorted(
        abs(root)
        for root in np.linalg.eigvals(linearise(true_model(study.scenario.flight)).A)
        if root.imag > 0
    )[0]
    assert sigma < 1e-3 and abs(value - true) < 3.0 * sigma


@pytest.mark.slow
def test_a_known_combination_is_as_far_off_as_it_says() -> None:
    # The short period of the first-mode model, which none of its three unseen directions touches,
    # over runs with other noise.
    scenario = load_scenario(
        "flexible-ac1-first-mode",
        ["flight.modes=1", "condensed=false", "distance=same equations, finer step"],
    )
    scenario = replace(
        scenario,
        estimations=(next(each for each in scenario.estimations if each.name == "output-error"),),
    )
    true = sorted(
        abs(root)
        for root in np.linalg.eigvals(linearise(true_model(scenario.flight)).A)
        if root.imag > 0
    )[0]
    found = [run_scenario(scenario, seed).main.derived["natural_frequency"] for seed in range(40)]
    errors = np.array([(value - true) / sigma for value, sigma in found])
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.3
