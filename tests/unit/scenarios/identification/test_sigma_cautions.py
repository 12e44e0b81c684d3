"""Cautions on sigmas that are too small: in gusts for methods that take no account of them, and
nowhere else.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import flightid
from exam.coverage.independent_flights import flown
from ident.estimate import Estimate
from ident.statistics.residuals import MADE_BY_INPUTS, ResidualTest, share_from_inputs
from scenarios.files.vehicles import VehicleFile
from scenarios.identification import cautions as cautions_module
from scenarios.identification.cautions import (
    FILTER_ERROR,
    LOST_ROWS,
    SHORT_IN_GUSTS,
    disturbed_outputs,
    lost_rows,
)
from scenarios.identification.identify import identify
from sim.record import Channel, Record
from tests import bases
from tests.rigid_problem import noisy


def cautions(method: str, noise: str, run: int = 0) -> list[str]:
    flight = flown("rigid", noise, run)
    vehicle = {**flight.vehicle, "derivatives": dict(flight.start)}
    frame = pd.DataFrame(flight.columns)
    found = flightid.identify(frame, "rigid", vehicle, method=method, hold="previous")
    return [each for each in found.warnings if "multiply the sigmas" in each]


@pytest.mark.sampled
@pytest.mark.parametrize("method", sorted(SHORT_IN_GUSTS))
@pytest.mark.parametrize("noise", ["markov-gusts", "dryden-gusts"])
def test_gusts_are_cautioned_with_their_factor(method: str, noise: str) -> None:
    (said,) = cautions(method, noise)
    factor, worst, held = SHORT_IN_GUSTS[method]
    assert 1.0 < factor < worst and f"multiply the sigmas by {factor:g} " in said
    assert f"need up to {worst:g})" in said and f"{100 * held:.0f} %" in said


@pytest.mark.sampled
@pytest.mark.parametrize("method", sorted(SHORT_IN_GUSTS))
@pytest.mark.parametrize("noise", ["white", "ar1"])
def test_noise_of_each_sensor_by_itself_is_not(method: str, noise: str) -> None:
    assert [said for run in range(4) for said in cautions(method, noise, run)] == []


@pytest.mark.long
def test_filter_error_is_cautioned_where_it_finds_gusts() -> None:
    (said,) = cautions("filter-error", "markov-gusts")
    factor, held = FILTER_ERROR
    assert f"multiply the sigmas by up to {factor:g} if" in said
    assert f"{100 * held:.0f} %" in said
    assert cautions("filter-error", "white") == []


@pytest.mark.long
def test_methods_that_hold_in_gusts_are_not_cautioned() -> None:
    assert cautions("equation-error", "dryden-gusts") == []


@pytest.mark.long
@pytest.mark.parametrize("method", sorted(LOST_ROWS))
@pytest.mark.parametrize(("dropped", "cautioned"), [(0.02, False), (0.2, True)])
def test_lost_rows_are_cautioned_from_the_measured_share_on(
    method: str, dropped: float, *, cautioned: bool
) -> None:
    flight = flown("rigid", "white", 0)
    frame = pd.DataFrame(flight.columns)
    lost = np.random.default_rng(1).choice(
        np.arange(1, len(frame) - 1), int(dropped * len(frame)), replace=False
    )
    vehicle = {**flight.vehicle, "derivatives": dict(flight.start)}
    found = flightid.identify(
        frame.drop(index=lost), "rigid", vehicle, method=method, hold="previous"
    )
    said = [each for each in found.warnings if "rows are lost" in each]
    assert len(said) == cautioned
    if cautioned:
        assert (
            f"from {100 * LOST_ROWS[method]:g} % on that biases {method} by more than half a sigma"
            in said[0]
        )


def test_one_long_gap_and_jittered_times_are_no_lost_rows() -> None:
    rng = np.random.default_rng(2)
    time = np.arange(400) * 0.02 + 0.002 * rng.uniform(size=400)
    time[200:] += 5.0
    channel = Channel.of("q", "rad/s", rng.standard_normal(400))
    record = Record(time, (), (channel,))
    assert lost_rows([record]) == pytest.approx(1 / 399)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("noise", "proposed"),
    [("markov-gusts", True), ("dryden-gusts", True), ("ar1", False), ("white", False)],
)
def test_filter_error_is_proposed_in_gusts_and_not_for_coloured_noise_of_each_sensor(
    noise: str, *, proposed: bool
) -> None:
    flight = flown("rigid", noise, 1)
    vehicle = {**flight.vehicle, "derivatives": dict(flight.start)}
    found = flightid.identify(pd.DataFrame(flight.columns), "rigid", vehicle, hold="previous")
    assert any("--method filter-error" in note for note in found.details.found.notes) == proposed


def test_an_output_that_fails_two_tests_is_named_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cautions_module, "_moved_together", lambda records, estimate: True)
    estimate = cast(Estimate, SimpleNamespace(method="output-error", output_names=("alpha", "q")))
    tests = [
        ResidualTest(kind, name, 1.0, 1e-9, "")
        for name in ("alpha", "q")
        for kind in ("whiteness", "size")
    ]
    assert disturbed_outputs([], estimate, tests) == ("alpha", "q")


def test_outputs_that_are_all_late_are_no_rough_air() -> None:
    """A delay common to all sensors moves all residuals together, as gusts do, but with the
    inputs.
    """
    flight = flown("rigid", "white", 0)
    frame = pd.DataFrame(flight.columns)
    outputs = [name for name in frame if str(name).split()[0] in ("alpha", "q", "nz")]
    frame[outputs] = frame[outputs].shift(4).bfill()
    vehicle = {**flight.vehicle, "derivatives": dict(flight.start)}
    found = flightid.identify(frame, "rigid", vehicle, hold="previous")
    said = " ".join((*found.warnings, *found.details.found.notes))
    assert "follow the inputs" in said and "--" not in " ".join(found.warnings)
    assert not any(word in said for word in ("rough", "gusts", "turbulence"))


@pytest.mark.parametrize("method", ["output-error", "ekf"])
def test_sigmas_of_coloured_sensor_noise_are_not_forbidden(method: str) -> None:
    """The page on estimators says that such sigmas hold: the warning must not say the opposite."""
    flight = flown("rigid", "ar1", 0)
    vehicle = {**flight.vehicle, "derivatives": dict(flight.start)}
    found = flightid.identify(
        pd.DataFrame(flight.columns), "rigid", vehicle, method=method, hold="previous"
    )
    said = found.warnings[0]
    assert said.startswith("do not use these sigmas unless the sensor noise itself is coloured")
    assert "do not follow the inputs" in said and "flightid.diagnose" in said


@pytest.mark.parametrize("seed", range(5))
def test_the_share_from_inputs_is_that_of_a_response_and_not_of_noise(seed: int) -> None:
    """A response of known share of the power is found as that share; red noise as nothing. What is
    slower than 5.6 s counts in neither.
    """
    rng = np.random.default_rng(seed)
    count, interval = 1000, 0.02
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0], count // 25), 25)[None, :]
    response = np.convolve(u[0], np.exp(-np.arange(150) * interval / 0.4))[:count]
    noise = rng.standard_normal(count)
    red = lfilter([1.0], [1.0, -0.97], rng.standard_normal(count))
    rows = np.array([response / response.std() + noise, red, np.zeros(count)])
    valid = np.ones((3, count), dtype=bool)
    smooth = np.ones(281) / 281.0
    fast = [
        np.var(row - np.convolve(np.pad(row, 140, mode="edge"), smooth, "valid"))
        for row in (response / response.std(), noise)
    ]
    expected = fast[0] / sum(fast)
    shares = share_from_inputs(rows, valid, u, interval)
    assert expected > 0.35 and shares[0] == pytest.approx(expected, abs=0.1)
    assert shares[1] < MADE_BY_INPUTS and shares[2] == 0.0
    missing = valid.copy()
    missing[0, rng.random(count) < 0.3] = False
    with_gaps = share_from_inputs(np.where(missing, rows, 0.0), missing, u, interval)
    assert with_gaps[0] == pytest.approx(expected, abs=0.12)
    assert np.all(share_from_inputs(rows, valid, u[:0], interval) == 0.0)


def test_slow_residuals_are_not_predicted_by_slow_inputs() -> None:
    """A residual of the phugoid's period, and a random walk, resemble inputs by chance; what a late
    input leaves does not.
    """
    once = np.repeat([0.0, 1.0, -1.0, 1.0, -1.0, 0.0], [40, 30, 20, 10, 10, 190])
    steps = np.concatenate([once, once])
    inputs = np.array([steps, np.sin(0.1 * np.arange(600) / 14.0)])
    turn, damped = 0.0139, np.exp(-0.12 * 0.0139)
    phugoid = [1.0, -2.0 * damped * np.cos(turn), damped**2]
    late, slow = [], []
    for seed in range(30):
        noise = np.random.default_rng(seed).standard_normal(1600)
        rows = np.array(
            [
                np.roll(steps, 4) - steps + 0.3 * noise[1000:],
                lfilter([1.0], phugoid, noise)[1000:],
                np.cumsum(noise)[1000:],
            ]
        )
        shares = share_from_inputs(rows, np.ones(rows.shape, dtype=bool), inputs, 0.1)
        late.append(shares[0])
        slow += shares[1:].tolist()
    assert min(late) > MADE_BY_INPUTS > 0.0 > np.median(slow) and max(slow) < MADE_BY_INPUTS


def two_flights(share: float) -> list[str]:
    """Cautions of a fit to two flights, the second with ``share`` of Cm_alpha."""
    values = bases.RIGID_VALUES
    model = bases.rigid_model()
    free = model.parameters.free_names
    constants = {name: value for name, value in values.items() if name not in free}
    vehicle = VehicleFile("rigid", "rigid", constants, {name: values[name] for name in free})
    other = model.with_values({"Cm_alpha": share * values["Cm_alpha"]})
    records = [
        replace(
            noisy(each, bases.rigid_flight(8.0), np.random.default_rng(seed)), name=f"{seed}.csv"
        )
        for seed, each in ((1, model), (2, other))
    ]
    found = identify(records[0], vehicle, "output-error", records[1:])
    return [each for each in found.cautions if "contradict" in each]


def test_records_of_two_aircraft_are_said_to_contradict_each_other() -> None:
    (said,) = two_flights(0.6)
    assert "each by itself leaves noise alone, all together do not (" in said
    assert "Cm_alpha -1.6" in said and "in 1.csv, -0.99" in said
    assert two_flights(1.0) == []
