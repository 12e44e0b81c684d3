"""Logs in Python: a channel map makes a record of them, as of any other file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flightid as fid
from tests.recorders.flights import flight, px4

pytest.importorskip("pyulog")


@pytest.mark.long
def test_a_log_with_a_map_is_a_record(tmp_path: Path) -> None:
    columns = flight()
    log = px4(tmp_path / "uav.ulg", columns)
    chosen: dict[str, str | tuple[str, str]] = {
        "elevator": ("30 * 0.5*(actuator_servos.control[0] + actuator_servos.control[1])", "deg"),
        "q": "vehicle_angular_velocity.xyz[1]",
    }
    record = fid.read_record(log, channels=chosen)
    assert record.names == ("elevator", "q") and record.input_names == ("elevator",)
    np.testing.assert_allclose(record["q"], columns["q"], atol=1e-12)
    np.testing.assert_allclose(record["elevator"], columns["elevator"], atol=1e-12)
    np.testing.assert_allclose(record.time - record.time[0], columns["time"], atol=1e-6)


@pytest.mark.long
def test_a_log_without_a_map_is_refused(tmp_path: Path) -> None:
    with pytest.raises(fid.InputError, match="flightid map"):
        fid.read_record(px4(tmp_path / "uav.ulg", flight()))


def test_expressions_on_a_frame() -> None:
    import pandas

    frame = pandas.DataFrame(
        {"t": np.arange(5) * 0.1, "left": np.arange(5.0), "right": 2.0 * np.arange(5)}
    )
    record = fid.read_record(frame, channels={"elevator": "0.5*(left + right)"})
    np.testing.assert_allclose(record["elevator"], 1.5 * np.arange(5))
    assert record.time.tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
