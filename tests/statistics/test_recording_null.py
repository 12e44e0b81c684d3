"""How often the raw look warns of, refuses or masks anything in records without a fault; many
flights, therefore slow.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.recording.inspection import inspect
from ident.recording.series import Certainty, Expectations, Kind
from sim.record import Record
from tests.recorded_flight import SIGMAS, Aircraft, drawn, fall, flight, rounded

CHANNELS = (
    ("alpha", "q", "nz"),
    ("alpha", "q"),
    ("alpha", "q", "nz", "theta"),
    ("q", "nz"),
    ("alpha", "q", "nz", "airspeed"),
)
TWELVE_BITS = {
    "alpha": np.radians(60.0) / 4096,
    "q": np.radians(120.0) / 4096,
    "nz": 12.0 / 4096,
    "theta": np.radians(180.0) / 4096,
}
LIGHT_CHANNELS = (("alpha", "q", "nz"), ("q", "nz"), ("alpha", "q"), ("alpha", "q", "nz", "theta"))
FLIGHTS = 300


def clean_flight(seed: int) -> tuple[Record, Expectations]:
    """Any aircraft, maneuver, rate, channels, noise from a tenth to twice the usual, rough air or
    none, any converter.
    """
    rng = np.random.default_rng(seed)
    aircraft, rate = (
        drawn(rng),
        float(rng.choice([10.0, 20.0, 25.0, 40.0, 50.0, 80.0, 100.0, 200.0])),
    )
    kind, outputs = (
        str(rng.choice(["3211", "doublets", "sweep", "steps"])),
        CHANNELS[int(rng.integers(len(CHANNELS)))],
    )
    offsets = {
        "alpha": 0.1 * rng.standard_normal(),
        "q": 0.02 * rng.standard_normal(),
        "theta": 0.1 * rng.standard_normal(),
    }
    duration, noise = (
        rng.uniform(8.0, 40.0 if rate < 100.0 else 15.0),
        float(rng.choice([0.1, 0.5, 1.0, 2.0])),
    )
    gust = float(rng.choice([0.0, 0.0, 0.003]))
    record = flight(
        rng, aircraft, kind, rate, duration, rng.uniform(0.01, 0.05), outputs, noise, offsets, gust
    )
    own = {name: SIGMAS[name] * float(rng.choice([0.3, 1.0, 2.0, 4.0])) for name in outputs}
    bits = ({}, TWELVE_BITS, own, dict.fromkeys(outputs, 1e-5))[int(rng.integers(4))]
    return rounded(
        record, **{name: bit for name, bit in bits.items() if name in outputs}
    ), aircraft.expected


@pytest.mark.slow
def test_clean_records_are_left_alone() -> None:
    """At most one in a hundred over all checks of a record; one of 1500 that took no part in
    setting the thresholds.

    A note that a channel is filtered is an accusation as well.
    """
    accused = {}
    for seed in range(50_000, 50_000 + FLIGHTS):
        record, expected = clean_flight(seed)
        told = [
            one
            for one in inspect(record, expected)
            if one.certainty is not Certainty.NOTED or one.kind is Kind.FILTERED
        ]
        if told:
            accused[seed] = [(one.channel, one.kind.value) for one in told]
    assert len(accused) <= 0.01 * FLIGHTS, accused


def light_aircraft(seed: int) -> tuple[Record, Expectations]:
    """A model or a light aircraft whose short period takes 4 samples or more of a slow recorder."""
    rng = np.random.default_rng([77, seed])
    frequency, damping = rng.uniform(3.0, 15.0), rng.uniform(0.4, 1.0)
    lift = rng.uniform(0.5, 1.3) * damping * frequency
    rate = lift - 2.0 * damping * frequency
    power, speed = -rng.uniform(0.4, 1.5) * frequency**2, rng.uniform(15.0, 60.0)
    aircraft = Aircraft(
        lift, -(frequency**2) + lift * rate, rate, power, rng.uniform(0.0, 0.3), speed
    )
    kind, outputs = (
        str(rng.choice(["3211", "doublets", "sweep", "steps"])),
        LIGHT_CHANNELS[int(rng.integers(len(LIGHT_CHANNELS)))],
    )
    sampled, noise, gust = (
        float(rng.choice(some))
        for some in (
            [8.0, 10.0, 12.5, 16.0, 20.0, 25.0, 50.0],
            [0.1, 1.0, 2.0],
            [0.0, 0.0, 0.01, 0.02],
        )
    )
    record = flight(
        rng,
        aircraft,
        kind,
        sampled,
        rng.uniform(8.0, 30.0),
        rng.uniform(0.02, 0.1),
        outputs,
        noise,
        None,
        gust,
    )
    return record, aircraft.expected


@pytest.mark.slow
def test_light_aircraft_sampled_slowly_are_not_refused() -> None:
    """Of 1200 none was; seven were warned of, all at 8 or 10 samples a second with less than five
    samples a period.
    """
    refused: dict[int, list[str]] = {}
    warned: dict[int, list[str]] = {}
    for seed in range(5000, 5000 + FLIGHTS):
        record, expected = light_aircraft(seed)
        found = inspect(record, expected)
        for told, certainty in ((refused, Certainty.CERTAIN), (warned, Certainty.LIKELY)):
            if sentences := [one.sentence for one in found if one.certainty is certainty]:
                told[seed] = sentences
    assert refused == {} and len(warned) <= 0.02 * FLIGHTS, (refused, warned)


@pytest.mark.slow
def test_clean_falls_are_left_alone() -> None:
    accused = {}
    for seed in range(200):
        rng = np.random.default_rng(seed)
        record = fall(
            rng,
            float(rng.choice([10.0, 20.0, 50.0])),
            rng.uniform(15.0, 35.0),
            rng.uniform(0.1, 10.0),
        )
        record = rounded(record, altitude=float(rng.choice([0.01, 0.3, 1.0, 5.0])))
        if any(one.certainty is not Certainty.NOTED for one in inspect(record)):
            accused[seed] = [one.kind.value for one in inspect(record)]
    assert len(accused) <= 2, accused
