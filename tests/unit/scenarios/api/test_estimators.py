"""Estimators as functions of a model and a record, prepared records, and messages in the words of
Python.
"""

from __future__ import annotations

import numpy as np
import pytest

import flightid as fid
from scenarios.api.tables import as_keywords, in_python_words


@pytest.fixture(scope="module")
def record() -> fid.Record:
    return fid.simulate("rigid", seed=3, set={"flight.rate": 50}).record


@pytest.fixture(scope="module")
def start() -> fid.Vehicle:
    bomber = fid.vehicle("bomber_rigid")
    return fid.vehicle(bomber, derivatives={"Cm_q": 0.8 * bomber["Cm_q"]})


@pytest.mark.sampled
@pytest.mark.parametrize("method", ["output-error", "equation-error", "ekf"])
def test_an_estimator_finds_what_the_command_finds(
    method: str, record: fid.Record, start: fid.Vehicle
) -> None:
    found = getattr(fid.estimators, method.replace("-", "_"))("rigid", record, start)
    whole = fid.identify(record, "rigid", start, method=method, hold=record.hold)
    for name, each in whole.parameters.items():
        assert found.value(name) == pytest.approx(each.value, rel=1e-9)
        assert found.sigma(name) == pytest.approx(each.sigma, rel=1e-6)


@pytest.mark.long
def test_a_smoother_knows_more_than_its_filter(record: fid.Record, start: fid.Vehicle) -> None:
    found = fid.estimators.ekf("rigid", record, start)
    assert found.history is not None
    smoothed = fid.estimators.smoother(found)
    assert (
        smoothed.mean.shape == found.history.mean.shape == (len(found.history.names), len(record))
    )
    assert np.all(smoothed.std <= found.history.std * (1.0 + 1e-9))
    assert len(repr(smoothed)) < 200 and f"{len(record)} samples" in repr(smoothed)
    with pytest.raises(fid.InputError, match="no history to smooth"):
        fid.estimators.smoother(fid.estimators.equation_error("rigid", record, start))


def test_what_does_not_fit_is_one_line(record: fid.Record) -> None:
    with pytest.raises(fid.InputError, match="runs along one record, and there are 2"):
        fid.estimators.ukf("rigid", [record, record], "bomber_rigid")
    with pytest.raises(fid.InputError, match="the record has no aileron, rudder"):
        fid.estimators.output_error("lateral", record, "navion_lateral")


def test_a_prepared_record_is_what_the_keywords_prepare(
    record: fid.Record, start: fid.Vehicle
) -> None:
    by_keyword = fid.identify(record, "rigid", start, rate=20.0, hold=record.hold)
    by_method = fid.identify(record.resample(20.0), "rigid", start, hold="linear")
    assert by_method.values == pytest.approx(by_keyword.values, rel=1e-6)
    assert record.lowpass(5.0).hold == "linear" and len(record.lowpass(5.0)) == len(record)
    other = record.with_hold("linear")
    assert (other.hold, record.hold) == ("linear", "previous")
    assert np.array_equal(other["alpha"], record["alpha"])


def test_messages_name_keywords(record: fid.Record) -> None:
    assert as_keywords("--to x", ("study", "to", "path")) == "to= x"
    assert as_keywords("use --method ekf, --from and --trust-record") == (
        'use method="ekf", start= and trust_record='
    )
    said = ("next: flightid diagnose /a/1.BIN --model rigid --validate /a/2.BIN --channels m.toml",)
    assert in_python_words(said) == ("next: flightid.diagnose on the same records",)
    said = ("flightid identify a.csv --model rigid --start 3 --method filter-error estimates it",)
    assert in_python_words(said) == (
        'flightid.identify on the same records with method="filter-error" estimates it',
    )
    calls = [
        lambda: record.resample(1e4),
        lambda: record.lowpass(40.0),
        lambda: record.with_hold("steady"),
        lambda: fid.identify(record, "rigid", "bomber_rigid", method="guess"),
        lambda: fid.identify(record, "rigid"),
        lambda: fid.diagnose(record, "rigid", "bomber_rigid", rate=-1.0),
        lambda: fid.design("rigid", "bomber_rigid", duration=-1.0),
    ]
    for call in calls:
        with pytest.raises(fid.InputError) as refused:
            call()
        assert "--" not in str(refused.value) and "\n" not in str(refused.value)


def test_results_show_what_works_and_little_else(record: fid.Record) -> None:
    found = fid.identify(record, "rigid", "bomber_rigid")
    estimate = fid.estimators.output_error("rigid", record, "bomber_rigid")
    shown = [found, found.parameters, found["Cm_q"], record, estimate, found.details]
    shown += [fid.vehicle("bomber_rigid"), fid.vehicle("bomber_rigid").parameters, fid.effects()]
    for each in shown:
        assert "\n" not in repr(each) and len(repr(each)) <= 300
    assert found.to_markdown().count("\n") == 1 + len(found.parameters)
    assert found.to_latex().count(r"\\") == 1 + len(found.parameters)
    for each in (found, record, fid.estimators, fid.plot):
        assert all(hasattr(each, name) for name in dir(each))


@pytest.mark.parametrize("method", ["ekf", "ukf", "output_error", "equation_error"])
def test_three_samples_are_too_few_for_any_estimator(method: str, record: fid.Record) -> None:
    short = {name: record[name][40:43] for name in record.names}
    short["time"] = record.time[40:43]
    with pytest.raises(fid.InputError, match="samples of outputs are too few for"):
        getattr(fid.estimators, method)("rigid", short, "bomber_rigid")


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("--fix delay=0 leaves it out", 'fix={"delay": 0} leaves it out'),
        ("take --fit alpha=dutch-roll, or", 'take fit={"alpha": "dutch-roll"}, or'),
        ("fix one of them with --fix, or", "fix one of them with fix=, or"),
    ],
)
def test_a_pair_of_an_option_is_a_mapping(said: str, shown: str) -> None:
    assert as_keywords(said) == shown
