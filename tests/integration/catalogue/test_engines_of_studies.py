"""Every extended Kalman filter of a single record is filterpy's: its calls are counted, and the
study says and keeps who ran it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import filterpy.kalman
import numpy as np
import pytest

from ident.banks.engines import BATCHED, FILTERPY
from ident.filters.ekf import FilterSettings, run_ekf, run_iterated_ekf
from ident.flying_qualities.levels import flight_phase_of
from scenarios.identification.assessment import Options
from scenarios.identification.files import identification_content
from scenarios.identification.identify import identify
from scenarios.preparation.declared_model import model_of_file
from scenarios.report.quantities import as_text
from scenarios.studies.catalogue import load_scenario, scenario_names
from scenarios.studies.comparison import comparison
from scenarios.studies.study import run_scenario
from scenarios.studies.text import print_study
from scenarios.x29.content import loop_comparison
from scenarios.x29.printing import print_loop
from scenarios.x29.study import loop_scenario, run_loop
from sim.declaration.compile import compile_model
from sim.declaration.effect import ParameterSet
from sim.declaration.model import Noise
from sim.errors import DeclarationError
from sim.record import Record
from tests.every_model import MODELS, case_of

WITH_EKF = [
    name
    for name in scenario_names("identification")
    if any(each.method == "ekf" for each in load_scenario(name).estimations)
]
# Of a closed-loop scenario only the bank counts here: a short flight, nothing beside it.
LOOP_CHANGES = [
    "flight.duration=5",
    "methods=[]",
    "variants=[]",
    "together=[]",
    "estimate.restarts=0",
]
FLOWN = flight_phase_of(None, None)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Counts of filterpy's ``predict`` and ``update``."""
    counted: Counter[str] = Counter()
    for name in ("predict", "update"):
        monkeypatch.setattr(filterpy.kalman.ExtendedKalmanFilter, name, _counting(counted, name))
    return counted


def _counting(counted: Counter[str], name: str) -> object:
    original = getattr(filterpy.kalman.ExtendedKalmanFilter, name)

    def method(*arguments: object, **keywords: object) -> object:
        counted[name] += 1
        return original(*arguments, **keywords)

    return method


@pytest.mark.sampled
@pytest.mark.parametrize("name", WITH_EKF)
def test_a_scenario_that_is_run_is_filtered_by_filterpy(name: str, calls: Counter[str]) -> None:
    scenario = load_scenario(name)
    filtered = next(each for each in scenario.estimations if each.method == "ekf")
    study = run_scenario(
        replace(
            scenario,
            estimations=(filtered,),
            repeated=None,
            sweep=None,
            determination=False,
            condensed=False,
        )
    )
    samples = len(study.main.result.record)
    assert calls["predict"] >= samples - 1 and calls["update"] > 0.5 * samples
    assert comparison(study)["engine"] == {
        "name": "filterpy",
        "sentence": "filterpy ExtendedKalmanFilter",
    }
    assert (
        as_text(lambda out: print_study(study, out)).count(
            "engine: filterpy ExtendedKalmanFilter\n"
        )
        == 1
    )


@pytest.mark.long
@pytest.mark.parametrize("name", scenario_names("x29"))
def test_a_bank_is_compared_with_filterpy_on_its_likeliest_filter(
    name: str, calls: Counter[str]
) -> None:
    scenario = loop_scenario(name)
    whole = scenario.estimation.window_stop is not None or scenario.flight.spike is not None
    short = replace(
        loop_scenario(name, LOOP_CHANGES[1:] if whole else LOOP_CHANGES),
        against=None,
        margins=None,
        stretch=None,
        peak=None,
    )
    study = run_loop(short)
    samples = len(study.paper.record)
    assert calls["predict"] == samples - 1 and calls["update"] == samples, "one pass of one filter"
    written, second = loop_comparison(study)["engine"], study.second
    assert second is not None and second.sigmas < 1e-9 and second.delay == study.single_pass.delay
    assert (
        written["name"] == "batched"
        and written["against_filterpy"]["largest_sigmas"] == second.sigmas
    )
    printed = as_text(lambda out: print_loop(study, out))
    assert (
        printed.count("engine: batched kernel; equals filterpy to ") == 1
        and f"sigma on the filter at {second.delay:.4g} s" in printed
    )


@pytest.mark.sampled
@pytest.mark.parametrize("model", MODELS)
def test_identify_by_ekf_is_filtered_by_filterpy(model: str, calls: Counter[str]) -> None:
    case = case_of(model)
    found = identify(case.record, case.vehicle, "ekf")
    assert calls["predict"] > 0.9 * len(case.record) and calls["update"] > 0.9 * len(case.record)
    engine = identification_content(found, (), FLOWN)["engine"]
    if model == "loes":
        assert engine["name"] == "batched" and engine["against_filterpy"]["largest_sigmas"] < 1e-9
    else:
        assert engine == {"name": "filterpy", "sentence": "filterpy ExtendedKalmanFilter"}


@pytest.mark.long
@pytest.mark.parametrize("model", ["rigid", "own"])
def test_identify_by_the_batched_kernel_calls_no_filterpy(model: str, calls: Counter[str]) -> None:
    case = case_of(model)
    own, usual = (
        identify(case.record, case.vehicle, "ekf", options=Options(engine=engine))
        for engine in ("batched", "filterpy")
    )
    assert (
        own.engine == {"name": "batched", "sentence": "batched kernel"}
        and usual.engine["name"] == "filterpy"
    )
    np.testing.assert_allclose(
        (own.estimate.values - usual.estimate.values) / own.estimate.std, 0.0, atol=1e-9
    )
    before = calls["predict"]
    identify(case.record, case.vehicle, "ekf", options=Options(engine="batched"))
    assert calls["predict"] == before


def test_a_scenario_by_the_batched_kernel(calls: Counter[str]) -> None:
    study = run_scenario(load_scenario("rigid", ["estimate.engine=batched"]))
    assert not calls and comparison(study)["engine"] == {
        "name": "batched",
        "sentence": "batched kernel",
    }
    with pytest.raises(
        DeclarationError, match=r"key estimate.engine: .*no method is an extended Kalman filter"
    ):
        load_scenario("lateral", ["estimate.engine=batched"])
    with pytest.raises(DeclarationError, match=r"estimate.engine"):
        load_scenario("rigid", ["estimate.engine=numba"])


def _with_gaps(record: Record) -> Record:
    """Every tenth sample of the first output is missing, and all outputs of samples 20 to 24."""
    at = np.arange(len(record))
    outputs = []
    for number, channel in enumerate(record.outputs):
        known = channel.valid & ~((at >= 20) & (at < 25))
        known &= ~((at % 10 == 3) & (number == 0))
        outputs.append(replace(channel, values=np.where(known, channel.values, 0.0), valid=known))
    return replace(record, outputs=tuple(outputs))


# The others have a delay, which a filter on line takes from a fit of the whole record.
@pytest.mark.sampled
@pytest.mark.parametrize("model", [each for each in MODELS if each not in ("loes", "multirotor")])
@pytest.mark.parametrize("passes", [1, 3])
def test_both_engines_agree_to_a_billionth_of_a_sigma_with_missing_samples(
    model: str, passes: int
) -> None:
    case = case_of(model)
    record, declared = _with_gaps(case.record), model_of_file(case.vehicle)
    states = [
        replace(item, prior_std=max(0.1 * abs(item.value), 0.05)) for item in declared.initial
    ]
    noise = Noise(
        {
            channel.name: max(0.05 * float(np.std(channel.values)), 1e-4)
            for channel in record.outputs
        }
    )
    system = compile_model(
        replace(declared, initial=ParameterSet(tuple(states)), noise=noise),
        record.output_names,
        online=True,
    )
    settings = FilterSettings(passes=passes)
    for run in (run_ekf, run_iterated_ekf):
        one, other = (
            run(record, system, settings, by=engine.one_pass) for engine in (FILTERPY, BATCHED)
        )
        assert one.outcome is other.outcome and one.iterations == other.iterations
        assert one.history is not None and other.history is not None
        sigma = np.maximum(one.history.std, np.finfo(float).tiny)
        np.testing.assert_allclose((other.history.mean - one.history.mean) / sigma, 0.0, atol=1e-9)
        np.testing.assert_allclose((other.history.std - one.history.std) / sigma, 0.0, atol=1e-9)
        assert other.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-10)
