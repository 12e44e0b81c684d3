"""Records in Python: the same names, units and messages as in files, and ways to other packages and
back that lose nothing.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import control
import numpy as np
import pandas
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st

import flightid as fid
from scenarios.api.record import record_of
from scenarios.files.writing import write_record
from sim import record as sim_record
from sim.errors import FlightidError
from sim.record import Channel, Hold

TIME = np.arange(6) * 0.1
ALPHA = np.array([0.0, 1.0, 2.0, 3.0, math.nan, 1.0])


def frame(**columns: Any) -> pandas.DataFrame:
    return pandas.DataFrame({"time": TIME, "elevator": np.linspace(0.0, 1.0, 6), **columns})


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        ({"alpha_deg": ALPHA}, {}),
        ({"alpha [deg]": ALPHA}, {}),
        ({"alpha (deg)": ALPHA}, {}),
        ({"alpha": ALPHA}, {"units": {"alpha": "deg"}}),
        ({"AoA1": ALPHA}, {"channels": {"alpha": ("AoA1", "deg")}}),
        ({"AoA1": ALPHA}, {"channels": {"alpha": "AoA1"}, "units": {"AoA1": "deg"}}),
        ({"AoA1": ALPHA}, {"channels": {"alpha": {"column": "AoA1", "unit": "deg"}}}),
        ({"alpha_deg": ALPHA.astype("float32")}, {}),
        ({"alpha_deg": pandas.array([0.0, 1.0, 2.0, 3.0, None, 1.0], dtype="Float64")}, {}),
        ({"alpha_deg": [0, 1, "2", 3.0, None, " 1 "]}, {}),
    ],
)
def test_a_channel_is_found_by_name_and_unit_as_in_a_file(
    columns: dict[str, Any], told: dict[str, Any]
) -> None:
    record = fid.read_record(frame(**columns), **told)
    np.testing.assert_allclose(record["alpha"], np.radians(ALPHA), rtol=1e-7)
    assert (record.names, record.units["alpha"], record.input_names, len(record)) == (
        ("elevator", "alpha"),
        "rad",
        ("elevator",),
        6,
    )


def test_a_column_that_is_no_channel_of_ours_keeps_its_name_unit_and_numbers() -> None:
    record = fid.read_record(
        frame(alpha=ALPHA, **{"force [N]": TIME, "comment": ["a"] * 6}), inputs=["force"]
    )
    assert record.names == ("elevator", "alpha", "force") and record.units["force"] == "N"
    assert record.input_names == ("force",) and record["force"].tolist() == TIME.tolist()


START = pandas.Timestamp("2026-05-01 12:00:00")


@pytest.mark.parametrize(
    "index",
    [
        pandas.Index(TIME, name="time"),
        pandas.Index(1000.0 * TIME, name="time [ms]"),
        pandas.to_timedelta(TIME, unit="s"),
        START + pandas.to_timedelta(TIME, unit="s"),
        (START + pandas.to_timedelta(TIME, unit="s")).tz_localize("Europe/Berlin"),
        pandas.DatetimeIndex(START + pandas.to_timedelta(TIME, unit="s")).as_unit("ms"),
    ],
    ids=["float", "milliseconds", "timedelta", "datetime", "time zone", "coarse datetime"],
)
def test_the_time_may_be_the_index(index: pandas.Index) -> None:
    record = fid.read_record(pandas.DataFrame({"alpha": ALPHA}, index=index))
    np.testing.assert_allclose(record.time, TIME, atol=1e-12)
    assert record.names == ("alpha",)


def test_a_clock_that_is_put_forward_is_no_gap() -> None:
    index = pandas.date_range("2026-03-29 01:59:59", periods=4, freq="s", tz="Europe/Berlin")
    assert fid.read_record(pandas.DataFrame({"alpha": ALPHA[:4]}, index=index)).time.tolist() == [
        0.0,
        1.0,
        2.0,
        3.0,
    ]


def test_of_a_dataset_what_has_the_time_of_the_record() -> None:
    variables = {
        "alpha": ("time", ALPHA, {"units": "deg"}),
        "height": ("level", [1.0, 2.0]),
        "map": (("time", "level"), np.zeros((6, 2))),
    }
    record = fid.read_record(xarray.Dataset(variables, {"time": TIME, "level": [0, 1]}))
    assert record.names == ("alpha",) and record["alpha"][3] == math.radians(3.0)
    for name, said in (
        ("height", "it is over level, not over time"),
        ("map", "it is over time, level, not over time"),
    ):
        with pytest.raises(FlightidError, match=f"column '{name}': {said}; "):
            record[name]


def test_a_channel_of_a_dataset_over_another_dimension_is_not_left_out_silently() -> None:
    variables = {"elevator": ("time", np.zeros(6)), "q": ("time", ALPHA), "alpha": ("frame", ALPHA)}
    record = fid.read_record(xarray.Dataset(variables, {"time": TIME, "frame": np.arange(6)}))
    with pytest.raises(FlightidError, match="column 'alpha': it is over frame, not over time"):
        fid.identify(record, "rigid", "bomber_rigid")


def test_columns_of_two_levels_are_channels_with_units(tmp_path: Path) -> None:
    levels = pandas.MultiIndex.from_tuples([("time", "s"), ("alpha", "deg"), ("q", "")])
    frame = pandas.DataFrame(np.column_stack([TIME, ALPHA, ALPHA]), columns=levels)
    frame.to_parquet(tmp_path / "levels.parquet")
    for record in (fid.read_record(frame), fid.read_record(tmp_path / "levels.parquet")):
        assert (
            record.names == ("alpha", "q")
            and record["alpha"][3] == math.radians(3.0)
            and record["q"][3] == 3.0
        )


def test_elements_of_an_array_keep_their_names() -> None:
    columns = {"time": TIME, **{f"rate[{i}]": ALPHA + i for i in range(3)}}
    record = fid.read_record(columns)
    assert record.names == ("rate[0]", "rate[1]", "rate[2]")
    np.testing.assert_array_equal(record["rate[1]"], ALPHA + 1)


def test_a_channel_in_the_index_of_a_dataframe_is_read(tmp_path: Path) -> None:
    frame = pandas.DataFrame({"time": TIME, "alpha": ALPHA, "q": ALPHA})
    assert fid.read_record(frame.set_index("q")).names == ("q", "alpha")
    frame.set_index(["time", "q"]).to_parquet(tmp_path / "index.parquet")
    for record in (
        fid.read_record(frame.set_index(["time", "q"])),
        fid.read_record(tmp_path / "index.parquet"),
    ):
        assert set(record.names) == {"alpha", "q"} and record.time.tolist() == list(TIME)


def test_masked_samples_are_missing() -> None:
    record = fid.read_record(
        {"time": TIME, "q": np.ma.masked_equal(np.array([1.0, 2.0, 9.0, 4.0, 5.0, 6.0]), 9.0)}
    )
    assert np.isnan(record["q"]).tolist() == [False, False, True, False, False, False]


def test_a_name_with_control_characters_is_refused() -> None:
    with pytest.raises(
        FlightidError, match=r"record, header: the name 'al\\x07pha' holds control characters"
    ):
        fid.read_record({"time": TIME, "al\x07pha": ALPHA})


def test_arrays_by_name_and_structured_arrays_are_records() -> None:
    by_name = fid.read_record({"time": TIME, "alpha": ALPHA, "elevator": [0.0] * 6})
    rows = np.array(list(zip(TIME, ALPHA, strict=True)), dtype=[("time", float), ("alpha", float)])
    assert (
        by_name["alpha"].tolist()[:4]
        == fid.read_record(rows)["alpha"].tolist()[:4]
        == ALPHA.tolist()[:4]
    )
    assert fid.read_record(by_name) is by_name


FAULTS: list[tuple[dict[str, Any], str]] = [
    ({"elevator": TIME, "alpha": ALPHA}, "header: there is no column 'time'"),
    ({"time": TIME[::-1], "alpha": ALPHA}, "row 2, column 'time': time goes back"),
    (
        {"time": [0.0, 0.1, 0.1, 0.3, 0.4, 0.5], "alpha": ALPHA},
        "row 3, column 'time': time is repeated",
    ),
    (
        {"time": [0.0, 0.1, None, 0.3, 0.4, 0.5], "alpha": ALPHA},
        "row 3, column 'time': time is missing",
    ),
    (
        {"time": TIME, "alpha": [0.0, 1.0, "x", 0.0, 0.0, 0.0]},
        "row 3, column 'alpha': 'x' is not a number",
    ),
    (
        {"time": TIME, "alpha": [0.0, 1.0, math.inf, 0.0, 0.0, 0.0]},
        "row 3, column 'alpha': an infinite value",
    ),
    ({"time": TIME, "alpha": ALPHA[:4]}, "column 'alpha': 4 values for 6 times"),
    ({"time": TIME[:1], "alpha": ALPHA[:1]}, "row 1, column 'time': one sample only"),
    ({"time": TIME, "alpha": [math.nan] * 6}, "column 'alpha': not a single number"),
]


@pytest.mark.parametrize(("columns", "told"), FAULTS)
def test_a_fault_is_told_as_a_file_would_be(columns: dict[str, Any], told: str) -> None:
    with pytest.raises(fid.InputError) as raised:
        read = fid.read_record(columns, name="flight")
        _ = read.time
        _ = read["alpha"]
    assert str(raised.value).startswith(f"flight, {told}") and raised.value.remedy


@pytest.mark.parametrize(
    ("told", "line"),
    [
        (
            {"units": {"alfa": "deg"}},
            "record, units: there is no column 'alfa'; did you mean 'alpha'?",
        ),
        (
            {"units": {"q": "rad/s"}},
            "record, units: column 'q' is in deg/s, as it says itself, not in rad/s; leave one of "
            "the two out",
        ),
        (
            {"units": {"nz": "g"}},
            "record, units: column 'nz_g' says its unit itself; leave the unit out, or rename the "
            "column",
        ),
        ({"channels": {"beta": "sideslip"}}, ""),
        (
            {"inputs": ["alfa"]},
            "record, inputs: there is no channel 'alfa'; did you mean 'alpha'?",
        ),
        (
            {"inputs": 3},
            "record, inputs: a int is no list of channels; give names of channels, such as "
            '["elevator"]',
        ),
        ({"hold": "next"}, "--hold: there is no hold 'next'; use previous or linear"),
    ],
)
def test_what_is_said_of_a_record_has_to_fit_it(told: dict[str, Any], line: str) -> None:
    columns = {"time": TIME, "alpha": ALPHA, "q [deg/s]": TIME, "nz_g": TIME}
    if not line:  # a channel map names a column for whoever asks for that channel
        assert "beta" not in fid.read_record(columns, **told)
        return
    with pytest.raises(fid.InputError) as raised:
        fid.read_record(columns, **told)
    assert str(raised.value) == line


@pytest.mark.parametrize(
    ("told", "line"),
    [
        ({"channels": {"alpha": "vane"}}, "there is no column 'vane', which the channel map names"),
        ({"channels": {"alpha": ("alpha", "furlong")}}, "unit 'furlong' does not measure an angle"),
        ({"units": {"alpha": "m"}}, "unit 'm' does not measure an angle"),
    ],
)
def test_a_channel_with_a_wrong_column_or_unit_has_no_values(
    told: dict[str, Any], line: str
) -> None:
    record = fid.read_record(frame(alpha=ALPHA, q=TIME), **told)
    with pytest.raises(fid.InputError, match=line):
        record["alpha"]
    assert np.array_equal(record["q"], TIME)


def test_one_input_may_be_named_by_a_text() -> None:
    assert fid.read_record(frame(alpha=ALPHA), inputs="alpha").input_names == ("alpha",)


@pytest.mark.parametrize("source", [3.0, object(), [1.0, 2.0], None])
def test_what_holds_no_record_is_refused(source: object) -> None:
    with pytest.raises(fid.InputError, match="is no record"):
        fid.read_record(source)


@pytest.mark.parametrize("hold", [*Hold, None])
def test_a_file_and_a_table_with_its_content_are_one_record(
    tmp_path: Path, hold: Hold | None
) -> None:
    alpha = Channel.of("alpha", "rad", np.radians(ALPHA))
    flown = sim_record.Record(
        TIME, (Channel.of("elevator", "rad", TIME),), (alpha,), hold or Hold.PREVIOUS
    )
    path, sidecar = write_record(tmp_path, flown, "flight")
    if hold is None:
        sidecar.unlink()
    one, two = (
        fid.read_record(path),
        fid.read_record(
            pandas.read_csv(path), name="flight.csv", hold=hold.value if hold else None
        ),
    )
    assert (one.name, one.hold, one.names, one.units) == (two.name, two.hold, two.names, two.units)
    assert all(
        np.array_equal(one[name], two[name], equal_nan=True) for name in ("time", *one.names)
    )
    assert one.file.sidecar.states_hold is two.file.sidecar.states_hold is (hold is not None)


def test_a_window_is_a_record_of_its_own() -> None:
    record = fid.read_record(frame(alpha=ALPHA), name="flight")
    part = record.window(0.15, 0.4)
    assert part.name == "flight[0.15-0.4 s]" and part.time.tolist() == TIME[2:5].tolist()
    assert (
        np.array_equal(part["alpha"], ALPHA[2:5], equal_nan=True)
        and record.window(stop=0.2).name == "flight[0-0.2 s]"
    )
    with pytest.raises(
        fid.InputError,
        match=r"there is no row between start= and stop=; the record covers 0 to 0\.5 s",
    ):
        record.window(0.6)
    with pytest.raises(fid.InputError, match=r"start= is not a number; give a time in s"):
        record.window("a")  # type: ignore[arg-type]
    broken = fid.read_record(frame(alpha=[*ALPHA[:5], "x"]))
    assert broken.window(stop=0.35)["alpha"].tolist() == ALPHA[:4].tolist()
    with pytest.raises(fid.InputError, match="row 6"):
        _ = broken.window(0.3)["alpha"]


NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)
UNITS = {
    "elevator": "rad",
    "stick": "in",
    "alpha": "rad",
    "q": "rad/s",
    "nz": "g",
    "airspeed": "m/s",
    "force": "N",
}


@st.composite
def records(draw: st.DrawFn) -> sim_record.Record:
    """A record of any of our channels and one that is none, with missing samples in its outputs."""
    count = draw(st.integers(2, 6))
    time = np.cumsum(draw(st.lists(st.floats(1e-3, 10.0), min_size=count, max_size=count)))
    names = draw(st.lists(st.sampled_from(list(UNITS)), min_size=1, unique=True))
    split = draw(st.integers(0, len(names) - 1))
    rows = {
        name: np.array(draw(st.lists(NUMBERS, min_size=count, max_size=count))) for name in names
    }
    for name in names[split:]:
        rows[name][1:] = np.where(
            draw(st.lists(st.booleans(), min_size=count - 1, max_size=count - 1)),
            math.nan,
            rows[name][1:],
        )
    channels = [Channel.of(name, UNITS[name], rows[name]) for name in names]
    hold = draw(st.sampled_from(list(Hold)))
    return sim_record.Record(time, tuple(channels[:split]), tuple(channels[split:]), hold, "flight")


def told(record: fid.Record) -> dict[str, Any]:
    """All that a record says, numbers as they print."""
    columns = {name: record[name].tolist() for name in ("time", *record.names)}
    return {
        "columns": repr(columns),
        "units": record.units,
        "inputs": record.input_names,
        "hold": record.hold,
        "name": record.name,
    }


@given(records())
@settings(max_examples=15, deadline=None)
def test_ways_to_other_packages_and_back_lose_nothing(given_record: sim_record.Record) -> None:
    record = record_of(given_record)
    assert told(fid.Record.from_pandas(record.to_pandas())) == told(record)
    assert told(fid.Record.from_xarray(record.to_xarray())) == told(record)
    back = fid.Record.from_control(record.to_control(), units=record.units, hold=record.hold)
    assert told(back) == told(record)


def test_what_others_get_is_named_as_they_name_it() -> None:
    record = fid.read_record(frame(alpha_deg=ALPHA, q=TIME), name="flight")
    dataset, response, table = record.to_xarray(), record.to_control(), record.to_pandas()
    assert (
        isinstance(dataset, xarray.Dataset)
        and dataset["alpha"].attrs == {"units": "rad"}
        and dataset["alpha"].dims == ("time",)
    )
    assert (
        isinstance(response, control.TimeResponseData)
        and response.output_labels == ["alpha", "q"]
        and response.input_labels == ["elevator"]
    )
    assert (
        table.index.name == "time"
        and table.attrs["units"]["q"] == "rad/s"
        and list(table.columns) == ["elevator", "alpha", "q"]
    )
    simulated = control.forced_response(
        control.ss([[-1.0]], [[1.0]], [[1.0]], 0, inputs="elevator", outputs="q", states="q"),
        TIME,
        np.ones(6),
    )
    assert fid.read_record(simulated).input_names == ("elevator",)
    assert fid.read_record(simulated)["q"].tolist() == simulated.y[0].tolist()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(
        ImportError,
        match="to_xarray needs xarray, which is not installed: python -m pip install xarray",
    ):
        fid.read_record(frame(alpha=ALPHA)).to_xarray()
