"""The catalogue: laws for every scenario, and what the cheap ones must show at their default
seed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from scenarios.report.quantities import as_text
from scenarios.studies.catalogue import load_document, load_scenario, scenario_names, scenario_text
from scenarios.studies.comparison import comparison
from scenarios.studies.declaration import (
    Estimation,
    ManeuverPlan,
    PublishedChoice,
    Start,
    published_remark,
    published_values,
)
from scenarios.studies.estimating import (
    DISTANCES,
    assumed_noise,
    declared_model,
    true_model,
    vehicle_constants,
)
from scenarios.studies.study import MethodResult, StudyResult, flexibility_sentences, run_scenario
from scenarios.studies.text import print_study
from sim.errors import DeclarationError
from sim.vehicles import factory
from sim.vehicles.factory import linearise
from sim.vehicles.library import read_parameter_set
from tests.oracles.cramer_rao import bound, fall_outputs, short_period_outputs
from tests.repeated import repeat

EXPECTED = {
    "ballistic",
    "ballistic-process-noise",
    "rigid",
    "rigid-euler",
    "rigid-process-noise-a",
    "rigid-process-noise-b",
    "flexible-ac1-equivalent",
    "flexible-ac2-equivalent",
    "flexible-ac1-first-mode",
    "flexible-ac2-first-mode",
    "flexible-ac1-full-order",
    "flexibility-sweep",
    "lateral",
    "longitudinal",
    "unstable",
    "aircraft-airliner",
    "aircraft-f16",
    "aircraft-uav",
}
WHOLE_AXES = tuple(name for name in factory.WHOLE_AXES if name in scenario_names("identification"))
OWN_FLIGHTS = {*WHOLE_AXES, "unstable", "flexible-ac1-full-order"}  # that no paper has printed
POUND_PER_SQUARE_FOOT = 4.882427636
# the 3-2-1-1 of the rigid aircraft
SWITCHES = [
    (0.0, 0.0),
    (1.0, 0.10471),
    (2.5, -0.10471),
    (3.5, 0.10471),
    (4.0, -0.10471),
    (4.5, 0.0),
]
every_scenario = pytest.mark.parametrize("name", scenario_names("identification"))


@cache
def study(name: str) -> StudyResult:
    return run_scenario(load_scenario(name))


def method(name: str, method_name: str) -> MethodResult:
    return next(item for item in study(name).methods if item.estimation.name == method_name)


def test_the_catalogue_is_complete() -> None:
    assert set(scenario_names()) >= EXPECTED


@every_scenario
def test_says_how_far_its_truth_is_from_its_model(name: str) -> None:
    scenario = load_scenario(name)
    lacking = any(item.modes < scenario.flight.modes for item in scenario.estimations)
    assert scenario.distance in DISTANCES
    assert (scenario.distance == "effect missing") == lacking
    assert scenario.condensed == lacking, (
        "a model that lacks modes is held against condensed values"
    )


@every_scenario
def test_free_parameters_have_unit_and_prior_and_none_starts_at_the_truth(name: str) -> None:
    scenario = load_scenario(name)
    truth = true_model(scenario.flight).parameters
    for estimation in scenario.estimations:
        model = declared_model(
            estimation,
            vehicle_constants(estimation, scenario.flight.vehicle),
            assumed_noise(scenario, estimation),
        )
        assert set(model.parameters.free_names) == set(estimation.start)
        for parameter in model.parameters:
            if parameter.free:
                assert parameter.unit
                assert 0 < parameter.prior_std < math.inf
                assert parameter.value != truth[parameter.name].value, (
                    f"{parameter.name} starts at the truth"
                )


@every_scenario
def test_results_are_explained_and_own_choices_are_named(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.title
    assert scenario.about
    assert all(estimation.explanation for estimation in scenario.estimations)
    if scenario.flight.own is not None and not scenario.choices:
        assert "All numbers are [own]" in scenario_text(name)
        return
    document = load_document(name)[0]
    assert "[own]" not in scenario_text(name).replace("\n[own]\n", ""), (
        "what is chosen is told by the study, not by a mark in its file"
    )
    assert {key for key in ("start", "process_noise") if document["estimate"].get(key)} <= document[
        "own"
    ]["estimate"].keys()
    for method in document.get("methods", []):
        assert {key for key in ("start", "process_noise") if method.get(key)} <= method.get(
            "own", {}
        ).keys(), method["name"]


@pytest.mark.long
@pytest.mark.parametrize("name", ["ballistic", "rigid", "flexible-ac1-equivalent"])
def test_a_study_tells_what_was_chosen_and_what_else_was_flown(name: str) -> None:
    found = study(name)
    told, written = (
        " ".join(as_text(lambda out: print_study(found, out)).split()),
        comparison(found),
    )
    for choice in found.scenario.choices:
        assert f"{choice.key} = {choice.value}: {choice.reason}" in told
        assert written["own"][choice.key] == {"value": choice.value, "reason": choice.reason}
    for estimation in found.scenario.estimations[1:]:
        assert written["methods"][estimation.name].get("own", {}).keys() == {
            choice.key for choice in estimation.choices
        }
        assert ("flight" in written["methods"][estimation.name]) is (estimation.flight is not None)
    origins = {name for names in written["vehicle_origins"].values() for name in names}
    assert {
        "ballistic": {"gravity"},
        "rigid": {"airspeed", "air_density", "mass", "pitch_inertia"},
    }.get(name, set()) <= origins
    assert (
        ("Cm_eta1 flies with -0.032, printed 0.0025" in told)
        is (name == "flexible-ac1-equivalent")
        is ("Cm_eta1" in written["misprints"])
    )
    assert (
        "its own flight: step 0.1 s; integration euler; truth and model: same equations and step"
        in told
    ) is (name == "ballistic")


@every_scenario
def test_published_columns_exist_and_are_in_the_parameters_units(name: str) -> None:
    scenario = load_scenario(name)
    for estimation in scenario.estimations:
        if name in OWN_FLIGHTS or estimation.own is not None:
            assert estimation.published is None, "no paper has printed this flight"
            continue
        assert estimation.published is not None
        found = published_values(estimation.published, {"beta": "kg/m2"})
        assert set(found) == set(estimation.start)
        assert all(start.std > 0 for start in found.values())


@every_scenario
def test_no_filter_is_told_another_noise_than_its_sensors_have(name: str) -> None:
    for estimation in load_scenario(name).estimations:
        assert not estimation.noise_std


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        "ballistic",
        "ballistic-process-noise",
        "rigid",
        "rigid-process-noise-a",
        "rigid-process-noise-b",
        "own-model",
        "aircraft-airliner",
        "aircraft-uav",
        pytest.param("aircraft-f16", marks=pytest.mark.slow),
        *WHOLE_AXES,
    ],
)
def test_main_result_is_within_three_sigma_of_the_truth(name: str) -> None:
    assert study(name).main.result.estimate.outcome.code == "converged"
    for row in study(name).main.rows:
        assert row.sigmas is not None
        assert abs(row.sigmas) < 3, row


def test_elastic_modes_of_a_rigid_set_are_refused() -> None:
    for name in WHOLE_AXES:
        with pytest.raises(DeclarationError, match="elastic modes asked for"):
            run_scenario(load_scenario(name, ["flight.modes=1"]))


@pytest.mark.parametrize(
    ("name", "about", "modes"),
    [
        ("lateral", {}, ("dutch_roll",)),
        ("longitudinal", {"airspeed": 53.6448, "thrust": 1506.6}, ("phugoid", "short_period")),
    ],
)
def test_a_whole_axis_has_the_oscillations_of_its_true_derivatives(
    name: str, about: dict[str, float], modes: tuple[str, ...]
) -> None:
    main, truth = study(name).main, true_model(study(name).scenario.flight)
    assert {row.name for row in main.rows} == set(truth.parameters.free_names), "biases are no rows"
    found = np.linalg.eigvals(linearise(truth, about=about).A)
    for mode, root in zip(
        modes, sorted((root for root in found if root.imag > 0), key=abs), strict=True
    ):
        for key, told in (
            (f"{mode}_frequency", abs(root)),
            (f"{mode}_damping", -root.real / abs(root)),
        ):
            value, sigma = main.derived[key]
            assert abs(value - told) < 3.0 * sigma, key


def test_rigid_is_right_where_the_paper_is_many_of_its_sigmas_off() -> None:
    rows = {row.name: row for row in study("rigid").main.rows}
    for name, published in {"Cm_de": 111, "Cm_alpha": 31, "CL_de": 12, "CL_q": 11}.items():
        assert abs(rows[name].published_sigmas or 0.0) == pytest.approx(published, abs=0.6)
        assert abs(rows[name].sigmas or math.inf) < 3


def test_rigid_sigmas_are_near_the_cramer_rao_bound() -> None:
    estimation = study("rigid").main.estimation
    values = {**read_parameter_set("bomber_rigid").values, "alpha": 0.0, "q": 0.0}
    prior = {
        **{n: s.std for n, s in estimation.start.items()},
        **{n: s.std for n, s in estimation.initial.items()},
    }
    noise = math.sqrt(0.016) * math.pi / 180
    smallest = bound(
        short_period_outputs(study("rigid").record.time, SWITCHES), values, prior, [noise, noise]
    )
    for row in study("rigid").main.rows:
        assert 1 / 1.3 < row.std / smallest[row.name] < 1.3, (row.name, row.std, smallest[row.name])


def test_ballistic_sigma_is_near_the_cramer_rao_bound_and_the_papers() -> None:
    main = study("ballistic").main
    data = read_parameter_set("ballistic_target")
    values = {**data.values, **{number.name: number.value for number in data.initial}}
    prior = {
        "beta": main.estimation.start["beta"].std,
        **{n: s.std for n, s in main.estimation.initial.items()},
    }
    smallest = bound(fall_outputs(study("ballistic").record.time), values, prior, [25 * 0.3048])
    assert main.rows[0].std == pytest.approx(smallest["beta"], rel=0.02)
    assert main.rows[0].std / POUND_PER_SQUARE_FOOT == pytest.approx(0.29, abs=0.01)


def test_ballistic_shows_what_the_papers_set_up_hides_and_the_cure_of_the_rest() -> None:
    papers, true_fall = (
        method("ballistic", "paper-two-terms"),
        method("ballistic", "paper-true-fall"),
    )
    assert papers.result.record is not true_fall.result.record is study("ballistic").record
    assert true_fall.rows[0].sigmas is not None and papers.rows[0].sigmas is not None
    assert true_fall.rows[0].sigmas < -35 < 10 * papers.rows[0].sigmas < 0, (
        "Euler's error is hidden where the truth has it too"
    )
    for name in ("paper-start-cured", "output-error"):
        assert abs(method("ballistic", name).rows[0].sigmas or math.inf) < 3
    assert papers.rows[0].published_sigmas == pytest.approx(-7.3, abs=0.1)


@pytest.mark.long
def test_the_third_taylor_term_is_worth_far_less_than_the_papers_columns_differ() -> None:
    for scenario, name, most in (
        ("ballistic", "paper", 0.2),
        ("ballistic-process-noise", "paper", 0.4),
    ):
        two, three = (
            method(scenario, f"{name}-{terms}-terms").rows[0] for terms in ("two", "three")
        )
        assert two.published is not None and three.published is not None
        printed = (three.published.value - two.published.value) / POUND_PER_SQUARE_FOOT
        assert abs(three.estimate - two.estimate) / POUND_PER_SQUARE_FOOT < most
        assert printed == pytest.approx(1.937 if scenario == "ballistic" else -0.164, abs=0.001)


def test_no_rate_of_eulers_steps_explains_the_papers_errors_of_the_rigid_aircraft() -> None:
    for name in ("main", "fifty-hertz", "twenty-hertz", "ten-hertz"):
        rows = {row.name: row for row in method("rigid-euler", name).rows}
        share = {
            key: (row.estimate - (row.true or 0.0)) / (row.published.value - (row.true or 0.0))
            for key, row in rows.items()
            if row.published
        }
        assert share["CL_q"] < 0, "the other way"
        assert 0 < share["Cm_de"] < 0.5
        assert share["CL_alpha"] < -7, "where the paper is right"
        assert share["CL_de"] > 0.6 and share["Cm_alpha"] > 0.2, (
            "these two it does explain, CL_de at 100 and Cm_alpha near 25 Hz"
        )
    assert all(abs(row.sigmas or math.inf) < 3 for row in method("rigid-euler", "runge-kutta").rows)


@pytest.mark.parametrize(
    ("table", "column", "name", "share"),
    [
        ("rigid", "none", "Cm_q", 0.962),
        ("rigid", "case_a", "Cm_q", 0.9995),
        ("rigid", "case_b", "Cm_q", 0.9995),
        ("rigid_equivalent", "ac1", "Cm_q", 0.952),
        ("rigid_equivalent", "ac2", "Cm_q", 0.997),
        ("rigid_equivalent", "ac2", "CL_q", 0.873),
    ],
)
def test_the_papers_sigmas_of_cm_q_are_its_prior_and_every_table_says_so(
    table: str, column: str, name: str, share: float
) -> None:
    choice = PublishedChoice("simulated_flight_data", table, column)
    true = read_parameter_set("bomber_rigid")[name].value
    assert published_values(choice, {})[name].std / (0.2 * abs(true)) == pytest.approx(
        share, abs=5e-4
    )
    assert name in published_remark(choice) and "prior" in published_remark(choice)


def test_table_5_claims_to_know_cm_q_far_better_than_table_4() -> None:
    for column, times in (("ac1", 24), ("ac2", 14)):
        six, fifteen = (
            PublishedChoice("simulated_flight_data", table, column)
            for table in ("rigid_equivalent", "first_mode")
        )
        assert (
            round(published_values(six, {})["Cm_q"].std / published_values(fifteen, {})["Cm_q"].std)
            == times
        )
        assert f"a {times}th of" in published_remark(fifteen)


@every_scenario
def test_a_remark_on_a_published_column_stands_under_every_table_that_shows_it(name: str) -> None:
    for estimation in load_scenario(name).estimations:
        assert bool(published_remark(estimation.published)) is (estimation.published is not None)
    if name in ("rigid", "ballistic"):
        told, written = as_text(lambda out: print_study(study(name), out)), comparison(study(name))
        assert told.count("docs/papers.md compares") == sum(
            item.published is not None for item in load_scenario(name).estimations
        )
        assert written["published_remark"].startswith("Table")


def test_a_filter_that_hardly_sees_cm_q_has_the_papers_sigmas() -> None:
    """Priors of 20 % and a sensitivity to Cm_q of 1/250: five printed sigmas within a fifth, Cm_de
    apart; whole, Cm_q is known 70 times better.
    """
    values = {**read_parameter_set("bomber_rigid").values, "alpha": 0.0, "q": 0.0}
    found = published_values(PublishedChoice("simulated_flight_data", "rigid", "none"), {})
    prior = {
        **{name: 0.2 * abs(values[name]) for name in found},
        "alpha": math.radians(0.5),
        "q": math.radians(0.5),
    }
    outputs, noise = (
        short_period_outputs(study("rigid").record.time, SWITCHES),
        math.sqrt(0.016) * math.pi / 180,
    )

    def hardly(v: Mapping[str, float]) -> np.ndarray:
        return outputs({**v, "Cm_q": values["Cm_q"] + (v["Cm_q"] - values["Cm_q"]) / 250})

    blind, ours = (
        bound(hardly, values, prior, [noise, noise]),
        {row.name: row.std for row in study("rigid").main.rows},
    )
    for name, entry in found.items():
        assert 1 / 1.2 < blind[name] / entry.std < 1.2 or name == "Cm_de", name
    assert blind["Cm_q"] > 60 * ours["Cm_q"] and blind["CL_alpha"] < 0.6 * ours["CL_alpha"]


def test_what_the_paper_prints_as_sigma_with_process_noise_is_its_error() -> None:
    for name, same in (("ballistic", False), ("ballistic-process-noise", True)):
        for terms in ("two", "three"):
            row = method(name, f"paper-{terms}-terms").rows[0]
            assert row.published_sigmas is not None
            assert (abs(row.published_sigmas + 1.0) < 1e-5) is same, (
                "to the last digit that is printed"
            )


def test_process_noise_on_beta_gives_a_sigma_of_the_printed_size() -> None:
    for method_result in study("ballistic-process-noise").methods[:5]:
        assert method_result.rows[0].std / POUND_PER_SQUARE_FOOT == pytest.approx(11.1, abs=0.15)


def test_tuned_process_noise_gives_the_printed_sigmas() -> None:
    for row in study("rigid-process-noise-b").main.rows:
        if row.name != "Cm_q":
            assert row.published is not None
            assert row.std == pytest.approx(row.published.std, rel=0.02)


def test_equivalents_are_within_three_sigma_of_condensation_and_the_residual_says_why_others_are_not() -> (  # noqa: E501
    None
):
    assert all(
        abs(row.sigmas or math.inf) < 3 for row in study("flexible-ac1-equivalent").main.rows
    )
    plain = method("flexible-ac1-equivalent", "no-process-noise")
    assert max(abs(row.sigmas or 0.0) for row in plain.rows) > 10
    assert min(test.p_value for test in plain.tests) < 1e-20, (
        "a rigid model leaves a residual that is not white"
    )
    note = next(
        note
        for note in study("flexible-ac1-equivalent").notes
        if note.startswith("no-process-noise: share")
    )
    share, white = (
        int(note.split(" q ")[1].split(" %")[0]),
        int(note.split("white noise has ")[1].split(" %")[0]),
    )
    assert share > 3 * white


@pytest.mark.long
def test_a_rigid_model_serves_the_first_flexible_aircraft_and_no_longer_the_second() -> None:
    serves = {}
    for name in ("flexible-ac1-equivalent", "flexible-ac2-equivalent"):
        found, written = study(name).flexibility, comparison(study(name))["flexibility"]
        assert found is not None
        assert (
            written["misfit"] == found.misfit
            and written["largest_misfit"] == 1.0
            and written["degree"] == found.degree
        )
        serves[name] = written["rigid_serves"]
        said = " ".join(flexibility_sentences(found, study(name).scenario.flight.noise_std))
        assert ("no longer serves" in said) is not written["rigid_serves"]
        for row in study(name).main.rows:
            assert row.condensed == pytest.approx(found.condensed[row.name], rel=1e-9)
    assert list(serves.values()) == [True, False]
    assert study("rigid").flexibility is None and "flexibility" not in comparison(study("rigid"))


def test_same_seed_same_numbers_other_seed_other_numbers() -> None:
    whole = load_scenario("ballistic")
    scenario = replace(
        whole,
        estimations=whole.estimations[1:2],
        flight=replace(whole.flight, duration=5.0, step=0.01),
    )
    first, second, other = (
        run_scenario(scenario),
        run_scenario(scenario),
        run_scenario(scenario, seed=2),
    )
    assert first.main.rows == second.main.rows
    assert first.main.rows != other.main.rows


@pytest.mark.parametrize("method_name", ["main", "one-pass"])
def test_batched_runs_are_what_the_scenario_does(method_name: str) -> None:
    scenario = load_scenario("ballistic")
    runs = repeat(
        scenario, next(item for item in scenario.estimations if item.name == method_name), [1, 2]
    )
    row = method("ballistic", method_name).rows[0]
    assert runs.estimate[0, 0] == pytest.approx(row.estimate, abs=0.01 * row.std)
    assert runs.std[0, 0] == pytest.approx(row.std, rel=1e-3)


@pytest.mark.parametrize("modes", [2, 3, 4])
def test_any_number_of_modes_can_be_estimated(modes: int) -> None:
    scenario = load_scenario("flexible-ac1-first-mode")
    truth = true_model(scenario.flight).parameters
    constants = ("omega", "zeta", "generalized_mass")
    own = [
        f"{name}{i}"
        for i in range(1, modes + 1)
        for name in ("CL_eta", "CL_etadot", "Cm_eta", "Cm_etadot")
    ]
    own += [
        f"Ceta{i}_{by}"
        for i in range(1, modes + 1)
        for by in ("alpha", "q", "de", f"eta{i}", f"etadot{i}")
    ]
    free = [*scenario.estimations[0].start][:6] + own
    couplings = [
        f"Ceta{i}_{by}{j}"
        for i in range(1, modes + 1)
        for j in range(1, modes + 1)
        if i != j
        for by in ("eta", "etadot")
    ]
    size = {name: abs(truth[name].value) + 1e-5 for name in free}
    states = {
        f"{state}{i}": Start(0.0, std)
        for i in range(1, modes + 1)
        for state, std in (("eta", 0.02), ("etadot", 0.2))
    }
    estimation: Estimation = replace(
        scenario.estimations[0],
        name="all",
        modes=modes,
        start={
            name: Start(truth[name].value + 0.05 * size[name], 0.2 * size[name]) for name in free
        },
        held={name: truth[name].value for name in couplings},
        initial={**dict(list(scenario.estimations[0].initial.items())[:2]), **states},
        published=None,
    )
    assert not any(name.startswith(constants) for name in free)
    plan = ManeuverPlan("elevator", "doublet", {"amplitude": 0.1, "unit": 0.3, "start": 0.1})
    short = replace(
        scenario,
        flight=replace(scenario.flight, duration=1.5, rate=50.0, step=0.005, maneuvers=(plan,)),
        estimations=(estimation,),
    )
    main = run_scenario(short).main
    assert main.result.estimate.outcome.code == "converged"
    assert len(main.rows) == 6 + 9 * modes
    prior = np.array([0.2 * size[row.name] for row in main.rows])
    std = np.array([row.std for row in main.rows])
    assert np.all(std < prior * (1 + 1e-9)), "data can only narrow a prior"
    assert std[5] < 0.5 * prior[5], "Cm_de shows in every response"
    assert (main.rows[0].condensed == truth["CL_alpha"].value) == (modes == 4)
