"""The scenario `unstable`: an unstable aircraft under feedback is identified as well as a stable
one in the same loop.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from ident.statistics.intervals import clopper_pearson
from scenarios.report.quantities import console
from scenarios.report.terminal import show_blocks
from scenarios.studies.catalogue import load_scenario
from scenarios.studies.declaration import Scenario
from scenarios.studies.estimating import estimate_record, fly_scenario, true_model
from scenarios.studies.folder import write_study
from scenarios.studies.study import Scatter, fly_repeatedly, run_scenario
from scenarios.studies.text import print_study, repeated_blocks
from sim.errors import DeclarationError
from sim.vehicles.factory import linearise


def scenario(runs: int, *methods: str, flights: slice = slice(None)) -> Scenario:
    """The scenario with few methods on its repeated flights."""
    whole = load_scenario("unstable", [f"repeated.runs={runs}"])
    assert whole.repeated is not None
    kept = tuple(
        replace(each, methods=tuple(name for name in each.methods if name in methods))
        for each in whole.repeated.flights[flights]
    )
    return replace(whole, repeated=replace(whole.repeated, flights=kept))


def test_the_two_aircraft_fly_one_closed_loop_and_one_of_them_doubles_in_half_a_second() -> None:
    whole = scenario(2)
    assert whole.repeated is not None
    closed, rates = [], []
    for each in whole.repeated.flights[:2]:
        lin, gains = linearise(true_model(each.flight)), each.flight.feedback["elevator"]
        rates.append(max(np.linalg.eigvals(lin.A).real))
        closed.append(lin.A + lin.B @ np.array([[gains.get("alpha", 0.0), gains["q"]]]))
    np.testing.assert_allclose(closed[0], closed[1], rtol=1e-9)
    assert 0.5 < np.log(2.0) / rates[0] < 1.0 and rates[1] < 0.0


@pytest.mark.long
def test_repeated_flights_are_told_drawn_and_written(tmp_path: Path) -> None:
    small = scenario(2, "main", flights=slice(0, 2))
    study = run_scenario(replace(small, estimations=small.estimations[:1], repeated=None))
    assert all(abs(row.sigmas or np.inf) < 4.0 for row in study.main.rows)
    study = replace(study, repeated=fly_repeatedly(small))
    assert [(each.flight, each.errors.shape) for each in study.repeated] == [
        ("unstable", (6, 2)),
        ("stable", (6, 2)),
    ]
    write_study(study, tmp_path / "study")
    written = json.loads((tmp_path / "study" / "comparison.json").read_text(encoding="utf-8"))[
        "repeated"
    ]
    assert [each["outcomes"] for each in written] == [{"converged": 2}, {"converged": 2}]
    assert written[0]["parameters"]["Cm_alpha"]["rms_error"] == pytest.approx(
        study.repeated[0].rms[3]
    )
    assert (tmp_path / "study" / "repeated.png").is_file()
    out = console()
    with out.capture() as said:
        print_study(study, out)
    assert "2 runs of each flight" in said.get() and "stable: output error" in said.get()
    # The first run is the study's own record.
    record, _ = fly_scenario(replace(small, flight=small.repeated.flights[0].flight), 1)  # type: ignore[union-attr]
    np.testing.assert_array_equal(record["elevator"].values, study.record["elevator"].values)


def test_wrong_names_are_refused_by_key() -> None:
    with pytest.raises(DeclarationError, match="no derivative 'Cm_beta'"):
        run_scenario(load_scenario("unstable", ["flight.derivatives={Cm_beta = 1.0}"]))
    with pytest.raises(DeclarationError, match="there is no method 'ekf'"):
        load_scenario("unstable", ['repeated.flights.1.methods=["ekf"]'])


def test_methods_of_other_derivatives_stand_in_one_table() -> None:
    """Each number under its own name, a dash where a method does not estimate it."""
    main, filtered = load_scenario("unstable").estimations[:2]
    both = Scatter(
        "calm",
        main,
        ("a", "b"),
        ("1", "1"),
        np.array([[2.0], [3.0]]),
        np.ones((2, 1)),
        {"converged": 1},
    )
    one = Scatter(
        "calm", filtered, ("b",), ("1",), np.array([[5.0]]), np.ones((1, 1)), {"converged": 1}
    )
    out = console()
    with out.capture() as said:
        show_blocks(out, repeated_blocks([both, one]))
    rows = [line.split() for line in said.get().splitlines() if "calm: " in line]
    assert [row[-2:] for row in rows[:2]] == [["2.00", "3.00"], ["-", "5.00"]]


def held(found: Scatter, derivative: int) -> int:
    return int(np.sum(np.abs(found.sigmas[derivative]) <= 2.0))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["main", "filter"])
def test_two_sigma_intervals_hold_as_often_on_the_unstable_aircraft(method: str) -> None:
    """Of 50 runs, by derivative, within the binomial bounds of 95.4 % at odds of one in a thousand;
    all runs settle.
    """
    few = int(binom.ppf(1e-3, 50, 0.9545))
    for found in fly_repeatedly(scenario(50, method, flights=slice(0, 2)), 101):
        assert found.outcomes == {"converged": 50}
        assert all(held(found, i) >= few for i in range(6)), (found.flight, found.rms_sigmas)
        assert np.all(found.rms_sigmas < 1.35)


@pytest.mark.slow
def test_in_rough_air_output_error_is_far_off_on_either_aircraft_and_filter_error_is_not() -> None:
    """Errors in units: the filter's are those of calm air within a factor, output error's several
    times as large.
    """
    found = {
        (each.flight, each.estimation.name): each
        for each in fly_repeatedly(scenario(20, "main", "filter-error"), 201)
    }
    for flight in ("unstable", "stable"):
        calm, rough = found[flight, "main"].rms, found[f"{flight}, rough air", "main"].rms
        filtered = found[f"{flight}, rough air", "filter-error"]
        assert filtered.outcomes.get("converged", 0) >= 17
        assert np.all(rough > 1.5 * calm) and np.all(filtered.rms < 3.0 * calm)
        hits = sum(held(filtered, i) for i in range(6))
        assert clopper_pearson(hits / 6.0, filtered.errors.shape[1])[1] > 0.9


def test_the_estimate_of_one_run_is_what_the_repetition_counts() -> None:
    small = scenario(2, "regression", flights=slice(0, 1))
    (found,) = fly_repeatedly(small, 3)
    from scenarios.studies.estimating import assumed_noise, declared_model, vehicle_constants

    record, truth = fly_scenario(replace(small, flight=small.repeated.flights[0].flight), 4)  # type: ignore[union-attr]
    estimation = found.estimation
    model = declared_model(
        estimation,
        vehicle_constants(estimation, small.flight.vehicle),
        assumed_noise(small, estimation),
    )
    estimate = estimate_record(estimation, record, model).estimate
    assert found.errors[3, 1] == pytest.approx(
        estimate.value("Cm_alpha") - truth.parameters["Cm_alpha"].value
    )
