"""Filters of ``identify`` from starts that are zero or ten times too large, and under coloured
noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from exam.coverage.estimators import write_flight
from exam.coverage.independent_flights import flown, maneuver, motion
from ident.estimate import Outcome
from ident.filters.ekf import iterated_to_convergence
from scenarios.identification.assessment import IdentificationResult
from scenarios.identification.cautions import cautions_of
from scenarios.identification.identify import identify, identify_files
from scenarios.identification.methods import LEAST_NOISE
from scenarios.preparation.plan import Plan, Request
from sim.errors import RecordError
from sim.record import Hold, Record
from tests.every_model import Case, case_of

STARTS = {"zero": 0.0, "ten times": 10.0}
COEFFICIENT = 0.9


def started(case: Case, factor: float, true: Mapping[str, float]) -> Case:
    """The case with a vehicle file whose derivatives are the true ones times ``factor``."""
    derivatives = {name: factor * true[name] for name in case.vehicle.derivatives}
    own = None if case.vehicle.own is None else case.vehicle.own.with_values(derivatives)
    return replace(case, vehicle=replace(case.vehicle, derivatives=derivatives, own=own))


@cache
def usual(model: str, method: str) -> IdentificationResult:
    case = case_of(model)
    return identify(case.record, case.vehicle, method)


@pytest.mark.long
@pytest.mark.parametrize("start", list(STARTS))
@pytest.mark.parametrize(
    ("model", "method"),
    [("rigid", "ekf"), ("lateral", "ekf"), ("own", "ekf"), ("rigid", "ukf"), ("own", "ukf")],
)
def test_the_result_does_not_depend_on_the_start(model: str, method: str, start: str) -> None:
    case = started(case_of(model), STARTS[start], case_of(model).true)
    found, expected = (
        identify(case.record, case.vehicle, method).estimate,
        usual(model, method).estimate,
    )
    assert found.outcome is Outcome.CONVERGED
    off = [(found.value(name) - expected.value(name)) / expected.sigma(name) for name in case.true]
    assert np.max(np.abs(off)) < 0.1, dict(zip(case.true, off, strict=True))
    wrong = [(found.value(name) - true) / found.sigma(name) for name, true in case.true.items()]
    assert np.max(np.abs(wrong)) < 4.0


def with_coloured_noise(record: Record, exact: Record, seed: int) -> Record:
    """First-order autoregressive noise of the same standard deviation in place of a record's white
    noise.
    """
    rng, outputs = np.random.default_rng(seed), []
    for channel in record.outputs:
        white = rng.standard_normal(len(record) + 200)
        noise = np.zeros_like(white)
        for k in range(1, len(white)):
            noise[k] = COEFFICIENT * noise[k - 1] + np.sqrt(1.0 - COEFFICIENT**2) * white[k]
        clean = exact[channel.name].values
        outputs.append(
            replace(channel, values=clean + float(np.std(channel.values - clean)) * noise[200:])
        )
    return replace(record, outputs=tuple(outputs))


@pytest.mark.long
@pytest.mark.parametrize("method", ["ekf", "ukf"])
def test_coloured_noise_widens_sigmas_and_is_said(method: str) -> None:
    case, exact = case_of("rigid"), case_of("rigid", noise=0.0)
    seeds = range(6 if method == "ekf" else 1)
    found = [
        identify(with_coloured_noise(case.record, exact.record, seed), case.vehicle, method)
        for seed in seeds
    ]
    off = np.array(
        [
            [
                (each.estimate.value(name) - true) / each.estimate.sigma(name)
                for name, true in case.true.items()
            ]
            for each in found
        ]
    )
    assert np.sqrt(np.mean(off**2)) < 1.8, "white standard deviations would give about four"
    for each in found:
        said = [caution for caution in each.cautions if "the noise is not white" in caution]
        assert (
            len(said) == 1
            and "times too small" in said[0]
            and "those given are corrected for it" in said[0]
        )
    white = usual("rigid", method)
    assert not any("white" in caution for caution in white.cautions)
    assert np.median(found[0].estimate.std / white.estimate.std) > 2.0


@pytest.mark.long
def test_standard_deviations_that_were_not_corrected_are_said_to_be_too_small() -> None:
    case, exact = case_of("rigid"), case_of("rigid", noise=0.0)
    found = identify(with_coloured_noise(case.record, exact.record, 1), case.vehicle, "ekf")
    history = found.estimate.history
    assert history is not None
    last = {
        name: history.covariance[-1][history.names.index(name)] for name in found.estimate.names
    }
    at = [history.names.index(name) for name in found.estimate.names]
    white = replace(found.estimate, covariance=np.array([row[at] for row in last.values()]))
    (said,) = [
        each for each in cautions_of(found.vehicle, white, found.rows) if "not white" in each
    ]
    assert "are up to" in said and said.endswith("those given are for white noise")


@pytest.mark.long
@pytest.mark.parametrize("digits", [6, 12])
@pytest.mark.parametrize(
    ("model", "method"),
    [("rigid", "ekf"), ("rigid", "ukf"), ("lateral", "ekf"), ("longitudinal", "ekf")],
)
def test_without_noise_a_filter_has_the_sigmas_of_the_noise_that_it_assumes(
    tmp_path: Path, model: str, method: str, digits: int
) -> None:
    flight = flown(model, "white", 0)
    calm = motion(model, *maneuver(model))
    columns = {
        name: calm.get(name.split(" ")[0], values) for name, values in flight.columns.items()
    }
    rounded = {
        name: np.array([float(f"{value:.{digits}g}") for value in values])
        for name, values in columns.items()
    }
    record, vehicle = write_flight(tmp_path, replace(flight, columns=rounded))
    estimate = identify_files(
        Request((record,), model, vehicle, plan=Plan(hold=Hold.PREVIOUS)), method
    ).found.estimate
    assert estimate.outcome is Outcome.CONVERGED
    assert (
        f"hardly any noise; a filter needs some, and assumes {LEAST_NOISE:.1g}" in estimate.message
    )
    for name, true in flight.true.items():
        assert abs(estimate.value(name) - true) < 2.0 * estimate.sigma(name), name
        assert estimate.sigma(name) < 1e-3 * abs(true), name


def test_a_pass_that_breaks_down_is_no_convergence() -> None:
    begun = usual("own", "ekf").estimate
    broken = replace(begun, outcome=Outcome.INDEFINITE, message="at 3 s")
    ended = iterated_to_convergence(begun, lambda done: broken, 15)
    assert ended.outcome is Outcome.INDEFINITE and "pass 2 broke down at 3 s" in ended.message
    assert np.array_equal(ended.values, begun.values)
    assert "--method output-error" in ended.outcome.hint


@pytest.mark.parametrize("method", ["output-error", "ekf", "ukf"])
def test_linear_algebra_that_fails_is_one_line_on_the_record(
    monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr("scenarios.identification.methods.fit_output_error", fails)
    case = case_of("rigid")
    with pytest.raises(
        RecordError, match=f"the linear algebra of {method} fails on it .*use another --method"
    ):
        identify(case.record, case.vehicle, method)


@pytest.mark.long
def test_filter_error_settles_where_biases_are_hardly_known(tmp_path: Path) -> None:
    """In still air the intensity of gusts is at its bound, and steps along biases stay long while
    the likelihood no longer changes.
    """
    flight = flown("lateral", "white", 6)
    record, vehicle = write_flight(tmp_path, flight)
    found = identify_files(
        Request((record,), "lateral", vehicle, plan=Plan(hold=Hold.PREVIOUS)), "filter-error"
    ).found.estimate
    assert found.outcome is Outcome.CONVERGED
    off = [
        (found.value(name) - true) / found.sigma(name)
        for name, true in flight.true.items()
        if name in found.names
    ]
    assert np.max(np.abs(off)) < 4.0
