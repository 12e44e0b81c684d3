"""The kinematics of lateral and longitudinal records beside a diagnosis: faults under the names of
the models' effects, silent where they must be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ident.compatibility.trials import CompatibilitySettings, SensorFinding
from ident.tracing.diagnosis import Claim, Quantity
from scenarios.diagnosis.kinematics import (
    AGREES,
    CONTRADICTS,
    LATERAL,
    LONGITUDINAL,
    OF_MODEL,
    Kinematics,
    agreements,
    kinematics_of,
    right_clock,
    unnamed,
)
from scenarios.diagnosis.tables import kinematics_content, kinematics_lines
from scenarios.diagnosis.wording import Wording
from sim.effects.library import effects_for
from sim.maths import G0
from sim.record import Channel, Record
from tests.whole_axes import CONSTANTS, RATE, flown, true_model

SETTINGS = {
    "lateral": CompatibilitySettings(airspeed=CONSTANTS["lateral"]["airspeed"]),
    "longitudinal": CompatibilitySettings(),
}
Wrong = Callable[[Record], np.ndarray]


@pytest.fixture(scope="module")
def records() -> dict[str, list[Record]]:
    return {
        model: [replace(flown(model, seed), name=f"{seed}.csv") for seed in (1, 2)]
        for model in SETTINGS
    }


def misread(record: Record, name: str, reading: Wrong) -> Record:
    """The record with other readings of one channel."""
    outputs = tuple(
        Channel.of(c.name, c.unit, reading(record)) if c.name == name else c for c in record.outputs
    )
    return Record(record.time, record.inputs, outputs, record.hold, record.name)


def late(name: str, rows: int) -> Wrong:
    return lambda record: np.concatenate(
        [np.full(rows, record[name].values[0]), record[name].values[:-rows]]
    )


def asked(
    records: dict[str, list[Record]], model: str, name: str = "", reading: Wrong | None = None
) -> Kinematics:
    given = (
        records[model]
        if reading is None
        else [misread(record, name, reading) for record in records[model]]
    )
    return kinematics_of(given, SETTINGS[model], OF_MODEL[model])


def delay_of(found: Kinematics, name: str) -> SensorFinding:
    assert found.result is not None
    return next(each for each in found.result.findings if each.name == name)


@pytest.mark.long
@pytest.mark.parametrize(("model", "channel"), [("lateral", "beta"), ("longitudinal", "alpha")])
def test_a_late_vane_is_found_and_one_that_is_not_late_contradicted(
    records: dict[str, list[Record]], model: str, channel: str
) -> None:
    claim = Claim(f"sensor-delay:{channel}", {"delay": Quantity(2.0 / RATE, 0.002, "s")})
    found = asked(records, model, channel, late(channel, 2))
    (said,) = agreements(found, [claim])
    assert said.says == AGREES
    standing = delay_of(found, claim.name)
    assert standing.supported and abs(standing.value - 2.0 / RATE) < 0.006
    # Under the noise that it leaves an arm of the vane would seem likelier: each is fitted in full.
    assert (
        not delay_of(found, "vane-offset").supported
        or claim.name in delay_of(found, "vane-offset").group
    )
    sound = asked(records, model)
    assert unnamed(sound, []) == [] and agreements(sound, [claim])[0].says == CONTRADICTS


@pytest.mark.long
def test_a_vane_ahead_is_found_and_a_claim_of_it_agrees(records: dict[str, list[Record]]) -> None:
    speed = CONSTANTS["lateral"]["airspeed"]
    found = asked(
        records,
        "lateral",
        "beta",
        lambda record: record["beta"].values + 6.0 / speed * record["r"].values,
    )
    claim = Claim("vane-offset", {"arm": Quantity(6.0, 0.3, "m")})
    (said,) = agreements(found, [claim])
    assert said.says == AGREES and unnamed(found, [claim]) == []


@pytest.mark.long
def test_an_accelerometer_below_has_the_name_of_the_longitudinal_effect(
    records: dict[str, list[Record]],
) -> None:
    def felt(record: Record) -> np.ndarray:
        return np.asarray(
            record["nx"].values + 3.0 / G0 * np.gradient(record["q"].values, record.time)
        )

    found = asked(records, "longitudinal", "nx", felt)
    assert delay_of(found, "accelerometer-offset:nx").supported
    names = {effect.name for effect in effects_for(true_model("longitudinal").equations)}
    assert "accelerometer-offset:nx" in names and found.result is not None
    assert all(name in names for name in LONGITUDINAL.names.values())
    lines = kinematics_lines(found, [], Wording())
    assert "below the centre of gravity" in " ".join(lines)
    assert kinematics_content(found, [], Wording())["findings"][0]["parameters"]["arm"][
        "value"
    ] == pytest.approx(3.0, abs=0.6)


def test_accelerations_serve_as_load_factors_and_a_bias_is_told_as_one(
    records: dict[str, list[Record]],
) -> None:
    one = records["lateral"][0]
    outputs = tuple(
        Channel.of("ay", "m/s2", G0 * c.values) if c.name == "ny" else c for c in one.outputs
    )
    plain = kinematics_of([replace(one, outputs=outputs)], SETTINGS["lateral"], LATERAL)
    assert plain.result is not None and "ny" in plain.result.channels
    biased = kinematics_of(
        [misread(one, "p", lambda record: record["p"].values + 0.03)], SETTINGS["lateral"], LATERAL
    )
    line, source = kinematics_lines(biased, [], Wording())
    assert source == f"kinematics were checked on {one.name}: fitted data alone"
    assert (
        "bias:p, p reads 1.7" in line
        and "deg/s too much" in line
        and line.endswith("the fits of a diagnosis leave a bias of each channel free")
    )
    assert "parameters" in kinematics_content(biased, [], Wording())["findings"][0]


def test_records_that_close_no_relation_are_said_to() -> None:
    bare = flown("lateral", 1)
    bare = replace(bare, outputs=tuple(c for c in bare.outputs if c.name in ("beta", "r")))
    assert "p, phi" in kinematics_of([bare], SETTINGS["lateral"], LATERAL).why


def clocked(factor: float = 1.0, bias: float = 0.0, attitude: bool = True) -> Record:
    """Pitch rate and attitude of 20 s; the clock runs ``factor`` times as fast."""
    rng = np.random.default_rng(5)
    time = np.arange(1000) / 50.0
    q = 0.1 * np.sin(1.7 * time) * np.exp(-0.1 * (time - 6.0) ** 2) + 0.03 * np.sin(0.6 * time)
    theta = np.concatenate([[0.0], np.cumsum(0.5 * (q[1:] + q[:-1])) / 50.0])
    noisy = [
        Channel.of("q", "rad/s", q + bias + 1e-3 * rng.standard_normal(len(time))),
        Channel.of("theta", "rad", theta + 0.05 + 1e-3 * rng.standard_normal(len(time))),
    ]
    return Record(factor * time, (), tuple(noisy[: 2 if attitude else 1]), name="flight.csv")


def test_an_attitude_that_is_the_integral_of_the_rate_shows_a_right_clock() -> None:
    assert "time-base is no candidate" in right_clock([clocked(), clocked(bias=0.01)])
    for factor in (0.9, 1.03, 1.25):
        assert right_clock([clocked(factor)]) == ""
    assert right_clock([clocked(), clocked(attitude=False)]) == ""
    assert right_clock([]) == ""
