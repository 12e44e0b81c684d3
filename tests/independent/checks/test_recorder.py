"""Each fault of the recorder changes the columns it names in the way it says, and nothing else;
sheets are sampled and written as told.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.independent import recorder
from tests.independent.catalogue import FAULTS, IN_THE_FILE, ON_SIGNALS
from tests.independent.flight import G0, Flight
from tests.independent.recording import USUAL, WRONG, Sheet, sampled, write_sheet, write_vehicle
from tests.independent.short_period import VEHICLES

RATE = 50.0


def a_sheet() -> Sheet:
    time = np.arange(1001) / RATE
    rng = np.random.default_rng(5)
    columns = {
        name: 0.1 * np.sin(1.3 * time + k) + 0.01 * rng.standard_normal(len(time))
        for k, name in enumerate(("elevator", "alpha", "q", "nz"))
    }
    return Sheet(time, columns)


def test_held_and_stuck_values_repeat() -> None:
    sheet = a_sheet()
    held = recorder.held_lower("q", 4)(sheet).columns["q"]
    np.testing.assert_array_equal(
        held[:1000].reshape(250, 4), np.repeat(sheet.columns["q"][:1000:4, None], 4, axis=1)
    )
    stuck = recorder.stuck("alpha", 4.0, 2.0)(sheet).columns["alpha"]
    where = (sheet.time >= 4.0) & (sheet.time < 6.0)
    assert np.all(stuck[where] == sheet.columns["alpha"][200]) and np.array_equal(
        stuck[~where], sheet.columns["alpha"][~where]
    )


def test_clipped_values_lie_flat_at_both_ends() -> None:
    values = recorder.clipped("nz", 0.2)(a_sheet()).columns["nz"]
    assert np.sum(values == values.max()) > 50 and np.sum(values == values.min()) > 50


def test_coarse_values_lie_on_a_grid() -> None:
    values = recorder.coarse("alpha", 0.02)(a_sheet()).columns["alpha"]
    np.testing.assert_allclose(values / 0.02, np.round(values / 0.02), atol=1e-9)
    assert len(np.unique(values)) < 20


def test_links_drop_out_and_rows_are_lost() -> None:
    sheet = a_sheet()
    assert np.sum(recorder.zero_runs("q", 3.0, 1.0)(sheet).columns["q"] == 0.0) == 100
    shorter = recorder.rows_missing(3.5, 2.0)(sheet)
    assert len(shorter.time) == 901 and {len(values) for values in shorter.columns.values()} == {
        901
    }
    assert np.max(np.diff(shorter.time)) == pytest.approx(2.02)


def test_units_signs_and_names() -> None:
    sheet = a_sheet()
    np.testing.assert_allclose(
        recorder.in_degrees("alpha")(sheet).columns["alpha"], np.degrees(sheet.columns["alpha"])
    )
    np.testing.assert_allclose(
        recorder.in_metres_per_second_squared(sheet).columns["nz"], G0 * sheet.columns["nz"]
    )
    np.testing.assert_array_equal(
        recorder.sign_turned("elevator")(sheet).columns["elevator"], -sheet.columns["elevator"]
    )
    swapped = recorder.exchanged("alpha", "q")(sheet).columns
    assert swapped["alpha"] is sheet.columns["q"] and swapped["q"] is sheet.columns["alpha"]
    np.testing.assert_allclose(recorder.time_base(1.3)(sheet).time, 1.3 * sheet.time)


def test_bursts_hum_and_steps_have_their_size() -> None:
    sheet = a_sheet()
    burst = (
        recorder.noise_burst("nz", 8.0, 5.0, 0.3, np.random.default_rng(1))(sheet).columns["nz"]
        - sheet.columns["nz"]
    )
    where = (sheet.time >= 8.0) & (sheet.time < 13.0)
    assert np.all(burst[~where] == 0.0) and np.std(burst[where]) == pytest.approx(0.3, rel=0.2)
    hum = recorder.hum("q", 13.0, 0.2)(sheet).columns["q"] - sheet.columns["q"]
    assert np.sqrt(2.0) * np.std(hum) == pytest.approx(0.2, rel=0.02)
    step = recorder.zero_step("alpha", 11.0, 0.05)(sheet).columns["alpha"] - sheet.columns["alpha"]
    assert step[sheet.time < 11.0].any() == np.False_ and np.allclose(
        step[sheet.time >= 11.0], 0.05
    )


@pytest.mark.parametrize("fault", IN_THE_FILE, ids=lambda fault: fault.name)
def test_a_fault_of_the_file_spoils_the_columns_it_names_and_no_other(fault: object) -> None:
    planted = FAULTS[getattr(fault, "name", "")]
    _on_signals, on_sheet = planted.make(planted.sizes[1], np.random.default_rng(2))
    before = a_sheet()
    after = on_sheet(before)
    if len(after.time) == len(before.time):
        changed = {
            name
            for name in before.columns
            if not np.array_equal(before.columns[name], after.columns[name])
        }
        assert changed == set(planted.channels) & set(before.columns)
    assert (
        len(after.time) != len(before.time)
        or bool(changed)
        or not np.array_equal(before.time, after.time)
    )


@pytest.mark.parametrize("fault", ON_SIGNALS, ids=lambda fault: fault.name)
def test_sizes_are_in_order_and_drawn_between(fault: object) -> None:
    planted = FAULTS[getattr(fault, "name", "")]
    low, high = planted.sizes
    drawn = [planted.drawn(np.random.default_rng(seed)) for seed in range(20)]
    assert all(low <= abs(size) <= high for size in drawn)
    assert (min(drawn) < 0.0) == planted.either_sign


def test_sampling_takes_every_so_many_steps_and_adds_the_noise(tmp_path: Path) -> None:
    time = np.arange(8001) / 400.0
    alpha, q, nz, theta = (np.sin(time + k) for k in range(4))
    flight = Flight(
        1.0 / 400.0, 0.1 * np.sin(time), alpha, q, nz, theta, np.full_like(time, 90.0), 90.0
    )
    sheet = sampled(flight, RATE, ("alpha", "nz"), USUAL, np.random.default_rng(3))
    assert list(sheet.columns) == ["elevator", "alpha", "nz"] and sheet.rate == pytest.approx(RATE)
    np.testing.assert_array_equal(sheet.columns["elevator"], flight.elevator[::8])
    for name in ("alpha", "nz"):
        noise = sheet.columns[name] - flight.signal(name)[::8]
        # 1001 samples: the scatter is known to 2.2 %, four sigmas are 9 %.
        assert np.std(noise) == pytest.approx(USUAL[name], rel=0.09)
    fewer = sampled(flight, RATE, ("nz",), USUAL, np.random.default_rng(3))
    np.testing.assert_array_equal(fewer.columns["nz"], sheet.columns["nz"])
    with pytest.raises(AssertionError, match="no part"):
        sampled(flight, 30.0, ("nz",), USUAL, np.random.default_rng(3))
    columns = {
        **sheet.columns,
        "alpha": np.where(sheet.time == 1.0, np.nan, sheet.columns["alpha"]),
    }
    write_sheet(tmp_path / "r.csv", Sheet(sheet.time, columns))
    lines = (tmp_path / "r.csv").read_text().splitlines()
    assert lines[0] == "time [s],elevator [rad],alpha [rad],nz [g]" and len(lines) == 1002
    assert lines[51].split(",")[0] == "1" and lines[51].split(",")[2] == ""


def test_a_vehicle_file_holds_true_constants_and_wrong_starts(tmp_path: Path) -> None:
    vehicle = VEHICLES["jet"]
    write_vehicle(tmp_path / "v.toml", vehicle, np.random.default_rng(4))
    content = tomllib.loads((tmp_path / "v.toml").read_text())
    assert content["mass"] == pytest.approx(vehicle.mass, rel=1e-6) and content[
        "airspeed"
    ] == pytest.approx(vehicle.airspeed, rel=1e-6)
    ratios = [content["derivatives"][name] / true for name, true in vehicle.derivatives.items()]
    assert (
        all(1.0 - WRONG - 1e-3 <= ratio <= 1.0 + WRONG + 1e-3 for ratio in ratios)
        and max(abs(ratio - 1.0) for ratio in ratios) > 0.05
    )
