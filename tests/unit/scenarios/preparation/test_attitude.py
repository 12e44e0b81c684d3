"""A measured pitch attitude becomes an input that a phugoid takes, where all records have it and no
airspeed is recorded.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenarios.files.vehicles import VehicleFile
from scenarios.preparation.declared_model import model_of_file
from scenarios.preparation.measured_inputs import PARTLY, TRIM_AVERAGING_TIME, with_attitude
from sim.declaration.effect import Signal
from sim.record import Channel, Hold, Record
from tests.diagnoses import BALLISTIC, LOES, measured_record
from tests.preparing import OUTPUTS, declared
from tests.recorded_flight import SIGMAS, flight

TRUE = 0.3 + 0.2 * np.maximum(measured_record().time - TRIM_AVERAGING_TIME, 0.0)
NOISE = 5e-4  # rad, five sigmas


def with_theta(theta: np.ndarray, hold: Hold = Hold.LINEAR) -> Record:
    record = measured_record()
    return replace(record, outputs=(*record.outputs, Channel.of("theta", "rad", theta)), hold=hold)


def rising() -> np.ndarray:
    return TRUE + 1e-4 * np.random.default_rng(1).standard_normal(len(TRUE))


def test_it_counts_from_the_begin_and_is_no_output_any_more() -> None:
    model, (record,), said = with_attitude(declared(), [with_theta(rising())])
    assert (
        said
        and record.input_names == ("elevator", "theta")
        and record.output_names == ("alpha", "q", "nz")
    )
    assert [signal.name for signal in model.equations.inputs] == ["elevator", "theta"]
    np.testing.assert_allclose(record["theta"].values, TRUE - 0.3, atol=NOISE)


def test_gaps_and_a_wild_sample_are_bridged() -> None:
    theta = rising()
    theta[[50, 51, 52]], theta[200] = np.nan, 3.0
    _, (record,), _ = with_attitude(declared(), [with_theta(theta)])
    np.testing.assert_allclose(record["theta"].values, TRUE - 0.3, atol=NOISE)


@pytest.mark.parametrize("rate", [10.0, 50.0])
@pytest.mark.parametrize("kind", ["doublets", "sweep"])
@pytest.mark.parametrize("noise", [0.1, 1.0])
def test_where_the_attitude_turns_it_is_followed(kind: str, rate: float, noise: float) -> None:
    """Turning points within a few samples are motion and no wrong samples."""
    drawn = (np.random.default_rng(3), None)
    recorded, true = (
        flight(
            rng,
            kind=kind,
            rate=rate,
            duration=20.0,
            size=0.05,
            noise=noise,
            outputs=(*OUTPUTS, "theta"),
        )
        for rng in drawn
    )
    _, (record,), _ = with_attitude(declared(), [replace(recorded, hold=Hold.LINEAR)])
    off = record["theta"].values - true["theta"].values
    assert float(np.ptp(off)) < 10.0 * noise * SIGMAS["theta"]


def test_held_between_samples_it_is_the_mean_of_each_interval() -> None:
    _, (record,), _ = with_attitude(declared(), [with_theta(rising(), Hold.PREVIOUS)])
    straight = TRUE - 0.3
    np.testing.assert_allclose(
        record["theta"].values[:-1], 0.5 * (straight[1:] + straight[:-1]), atol=NOISE
    )


def test_where_one_record_lacks_it_none_uses_it_and_that_is_said() -> None:
    mostly_gone = np.where(np.arange(len(rising())) % 4 == 0, rising(), np.nan)
    for lacking in (measured_record(), with_theta(mostly_gone)):
        model, records, said = with_attitude(declared(), [with_theta(rising()), lacking])
        assert said == PARTLY
        assert model == declared() and all(
            "theta" not in (*record.input_names, *record.output_names) for record in records
        )
    assert with_attitude(declared(), [measured_record()])[2] == ""


@pytest.mark.parametrize("vehicle", [LOES, BALLISTIC])
def test_a_model_without_a_phugoid_has_no_use_for_it(vehicle: VehicleFile) -> None:
    model = model_of_file(vehicle)
    same, (record,), said = with_attitude(model, [with_theta(rising())])
    assert same is model and said == "" and "theta" not in record.output_names


def test_a_recorded_airspeed_goes_before_it() -> None:
    model = declared()
    equations = model.equations
    speedy = replace(
        model,
        equations=replace(equations, inputs=(*equations.inputs, Signal("airspeed_change", "m/s"))),  # type: ignore[type-var]
    )
    same, (record,), said = with_attitude(speedy, [with_theta(rising())])
    assert same is speedy and said == "" and "theta" not in record.output_names
