"""The kinematic relations of six degrees of freedom against a flight by Newton's law, and every
fault against what it does to a reading.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.compatibility.kinematics import SensorFault
from ident.compatibility.signals import KinematicSignals
from ident.compatibility.six_degrees.kinematics import (
    evaluate,
    faults_of,
    linearised,
    prepared_signals,
    relations,
    unknowns_of,
    usable_channels,
)
from sim.record import Channel, Record
from tests.oracles.six_degrees import LATERAL, NOISE, SPEED, UNITS, WHOLE, Faults, fly, shown
from tests.unit.ident.compatibility.six_degrees.planting import planted, size_of


def signals(
    channels: tuple[str, ...], faults: Faults, rate: float = 50.0, noise: float = 0.0
) -> KinematicSignals:
    record = shown(fly(), channels, faults, 0, rate, noise)
    return prepared_signals(record, usable_channels(record), SPEED, 9.80665, 0.0)[0]


def true_unknowns(s: KinematicSignals) -> np.ndarray:
    """The states as they start; nothing biased, no wind that climbs; attitude and angle of attack
    at their mean where they are not recorded.
    """
    flown, out = fly(), []
    for item in unknowns_of(s):
        kind, name = item.key
        out.append(
            float({"start": flown[name][0], "level": np.mean(flown[name])}[kind])
            if kind in ("start", "level")
            else 0.0
        )
    return np.array(out)


def left(
    s: KinematicSignals, faults: tuple[SensorFault, ...] = (), sizes: tuple[float, ...] = ()
) -> np.ndarray:
    """Measured less reconstructed, in parts of the noise of each output: ``(m, N)``."""
    y = evaluate(
        s, unknowns_of(s), faults, true_unknowns(s)[None], np.array([sizes]).reshape(1, -1)
    )[:, 0]
    measured = np.array([s.channels[name] for name in s.outputs])
    return np.asarray(
        np.where(s.valid, measured - y, 0.0) / np.array([[NOISE[name]] for name in s.outputs])
    )


@pytest.mark.parametrize(
    ("channels", "most"),
    [(WHOLE, 0.1), (("nz", "ny", "nx", *WHOLE[:3], *WHOLE[6:]), 0.1), (LATERAL, 1.0)],
)
def test_a_true_flight_is_reconstructed(channels: tuple[str, ...], most: float) -> None:
    """Of lateral channels alone alpha and theta are taken as constants, which costs part of the
    noise.
    """
    s = signals(channels, Faults(), rate=100.0)
    assert len(s.outputs) == (7 if len(channels) == 13 else 2)
    assert np.abs(left(s)).max() < most


def test_a_climbing_turn_without_yaw_rate_keeps_its_bank() -> None:
    """The heading turns by g tan(phi)/V, and the axis of roll points up by theta: p = -psi_dot
    sin(theta) holds the bank.
    """
    time, bank, climb = np.arange(500) / 25.0, 0.5, 0.6
    p = -9.80665 * np.tan(bank) / SPEED * np.sin(climb)
    record = Record(
        time,
        (),
        tuple(
            Channel.of(n, UNITS[n], np.full(500, v))
            for n, v in (("p", p), ("phi", bank), ("theta", climb))
        ),
    )
    s = prepared_signals(record, usable_channels(record), SPEED, 9.80665, 0.0)[0]
    unknown_values = np.array(
        [bank if item.key == ("start", "phi") else 0.0 for item in unknowns_of(s)]
    )
    assert (
        np.abs(
            evaluate(s, unknowns_of(s), (), unknown_values[None], np.zeros((1, 0)))[0, 0] - bank
        ).max()
        < 1e-9
    )


ALL_FAULTS = faults_of(signals(WHOLE, Faults()))


@pytest.mark.parametrize("fault", ALL_FAULTS, ids=lambda fault: fault.name)
def test_a_fault_explains_what_it_does(fault: SensorFault) -> None:
    size = size_of(fault)
    s = signals(WHOLE, planted(fault, size))
    without, beside = (np.sqrt(np.mean(e**2)) for e in (left(s), left(s, (fault,), (size,))))
    assert beside < 0.15 * without + 0.02, f"{beside / without:.2f} of it is left"


def test_every_kind_of_fault_is_there_and_named_once() -> None:
    names = [fault.name for fault in ALL_FAULTS]
    assert len(set(names)) == len(names) == 4 * 13 + 4 + 1 + 6 + 3
    assert {
        "vane-offset",
        "vane-offset:boom",
        "vane-offset:beta",
        "accelerometer-offset-below:ay",
        "accelerometer-offset",
        "sensor-delay:psi",
    } <= set(names)


def test_slopes_are_those_of_one_row_at_a_time() -> None:
    s = signals(WHOLE, Faults(), rate=25.0)
    unknowns, unknown_values = unknowns_of(s), true_unknowns(s)
    y, slopes = linearised(s, unknowns, ALL_FAULTS, unknown_values, np.zeros(len(ALL_FAULTS)))
    n = len(unknown_values)
    for j in (0, 1, 30, len(ALL_FAULTS) - 1):
        ends = np.zeros((2, len(ALL_FAULTS)))
        ends[:, j] = [1e-4, -1e-4]
        two = evaluate(s, unknowns, ALL_FAULTS, np.stack([unknown_values, unknown_values]), ends)
        scale = float(np.abs(slopes[:, :, n + j]).max())
        assert np.abs((two[:, 0] - two[:, 1]) / 2e-4 - slopes[:, :, n + j]).max() < 0.05 * scale
    assert np.array_equal(
        y,
        evaluate(s, unknowns, ALL_FAULTS, unknown_values[None], np.zeros((1, len(ALL_FAULTS))))[
            :, 0
        ],
    )


@pytest.mark.parametrize(
    ("channels", "closed"),
    [
        (WHOLE, {"alpha", "theta", "airspeed", "beta", "phi", "psi", "height"}),
        (LATERAL, {"beta", "phi"}),
        (("p", "phi"), {"phi"}),
        (("alpha", "q", "nz", "theta", "altitude"), {"alpha", "theta", "altitude"}),
        (("q", "theta", "phi"), set()),
        (("beta", "r", "ay"), set()),
        (("r", "psi"), set()),
    ],
)
def test_relations_are_those_that_the_channels_close(
    channels: tuple[str, ...], closed: set[str]
) -> None:
    assert set(relations(channels, speed=True)) == closed
    assert not {"alpha", "beta", "altitude"} & set(relations(channels, speed=False))


def test_a_heading_through_north_is_unwrapped_and_a_load_without_weight_gets_it() -> None:
    record = shown(
        fly(), ("p", "q", "r", "phi", "psi", "alpha", "nz"), Faults(bias={"nz": -1.0}), 0, 25.0, 0.0
    )
    assert np.ptp(record["psi"].values) > 6.0
    s, notes = prepared_signals(record, usable_channels(record), SPEED, 9.80665, 0.0)
    assert np.ptp(s.channels["psi"]) < 0.5 and np.mean(s.channels["nz"]) == pytest.approx(
        1.0, abs=0.1
    )
    assert notes == ("nz of flight 0 does not include the weight, which is added",)
