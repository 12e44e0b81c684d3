"""The log of a flight computer in lab 7: what pymavlink and ``read_record`` find in it is the
flight that was simulated.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason='no pymavlink: python -m pip install -e ".[labs]"')

import flightid
from flightid.labs.workings import own_data, recorder_log
from sim.errors import FlightidError


@pytest.fixture(scope="module")
def given() -> own_data.Kept:
    return own_data.kept(
        own_data.files_of(own_data.LOG),
        own_data.vehicle_text("rigid", own_data.LOG),
        own_data.map_of(own_data.LOG),
    )


def test_the_record_is_the_flight_within_what_the_log_resolves(given: own_data.Kept) -> None:
    """A pulse is a whole microsecond, and two elevons are averaged; all else is a float."""
    steps = {"elevator": 0.5 / recorder_log.PULSE, "alpha": 1e-7, "q": 1e-7, "nz": 1e-6}
    for read, flown in zip(own_data.read(given), recorder_log.flights(), strict=True):
        assert list(read.units) == list(steps)
        for channel in flown.channels:
            np.testing.assert_allclose(
                read[channel.name] - (channel.name == "nz"),
                channel.values,
                atol=1.001 * steps[channel.name],
            )


def test_pymavlink_reads_each_message(given: own_data.Kept) -> None:
    from pymavlink.DFReader import DFReader_binary

    log = DFReader_binary(str(given.records[0]))
    counts: dict[str, int] = {}
    first: dict[str, dict[str, object]] = {}
    while (message := log.recv_msg()) is not None:
        kind = message.get_type()
        counts[kind] = counts.get(kind, 0) + 1
        first.setdefault(kind, message.to_dict())
    log.data_map.close()
    log.filehandle.close()
    samples = len(recorder_log.flights()[0].time)
    assert counts == {"FMT": 4, "IMU": samples, "AOA": samples, "RCOU": samples}
    assert first["RCOU"]["C1"] == 1500 and first["RCOU"]["C2"] == 1510
    assert first["IMU"]["AccZ"] == pytest.approx(-9.8, abs=5 * 9.8 * recorder_log.NOISE["nz"])
    assert first["IMU"]["TimeUS"] == 41_000_000


def test_the_left_elevon_is_reversed(given: own_data.Kept, tmp_path: Path) -> None:
    """With the left elevon taken the other way the two cancel, and the elevator rests."""
    channels = tmp_path / "map.toml"
    channels.write_text(recorder_log.MAP.replace("573) - pwm", "573) + pwm"), encoding="utf-8")
    record = flightid.read_record(given.records[0], channels=channels)
    assert np.max(np.abs(record["elevator"])) <= 1.0 / recorder_log.PULSE
    assert math.isclose(record["q"].std(), own_data.read(given)[0]["q"].std())


def test_a_cut_log_is_refused_in_one_line(given: own_data.Kept, tmp_path: Path) -> None:
    path = tmp_path / "cut.BIN"
    path.write_bytes(given.records[0].read_bytes()[:60])
    _, refused = own_data.tried(lambda: flightid.read_record(path, channels=given.channels))
    assert refused.count("\n") == 0 and "cut.BIN" in refused
    with pytest.raises(FlightidError):
        flightid.read_record(path, channels=given.channels)
