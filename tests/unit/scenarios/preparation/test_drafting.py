"""Drafts of a channel map: what is the clock, which unit, and what is said of the rest of the
file.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from scenarios.files.declarations import ColumnChoice
from scenarios.files.measured.columns import RecordFile, read_record_file
from scenarios.files.records import read_with_notes
from scenarios.preparation.draft_text import map_text, vehicle_text
from scenarios.preparation.drafting import Draft, drafted
from scenarios.preparation.reading import unscaled_commands
from sim.errors import RecordError
from tests.recorders.flights import flight, px4

TIME = 0.02 * np.arange(60)
ALPHA = 0.05 * np.sin(TIME)


def opened(folder: Path, header: str, rows: list[str]) -> RecordFile:
    path = folder / "record.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return read_record_file(path)


def choice(draft: Draft, channel: str) -> ColumnChoice:
    (found,) = (guess for guess in draft.guesses if guess.channel == channel)
    return found.choice


@pytest.mark.parametrize("first", [0, 1])
def test_the_number_of_a_row_is_no_clock(tmp_path: Path, first: int) -> None:
    rows = [f"{n + first},{alpha:.6f}" for n, alpha in enumerate(ALPHA)]
    draft = drafted(opened(tmp_path, "Sample,alpha", rows))
    assert draft.clockless and "--rate HZ" in draft.faults[0]


def test_the_clock_beside_the_number_of_a_row_is_found(tmp_path: Path) -> None:
    rows = [
        f"{n},{time:.2f},{alpha:.6f}"
        for n, (time, alpha) in enumerate(zip(TIME, ALPHA, strict=True))
    ]
    assert (
        choice(drafted(opened(tmp_path, "Sample,elapsed so far,alpha", rows)), "time").column == 2
    )


@pytest.mark.parametrize("header", ["Zeit", "when"])
def test_a_column_of_dates_is_the_clock(tmp_path: Path, header: str) -> None:
    rows = [
        f"03/01/2025 11:59:{time:09.6f} PM,{alpha:.6f}"
        for time, alpha in zip(TIME, ALPHA, strict=True)
    ]
    draft = drafted(opened(tmp_path, f"{header},alpha", rows))
    assert not draft.clockless and not draft.faults


def with_a_vector(folder: Path, others: dict[str, np.ndarray]) -> Draft:
    """Of a file whose variable ``p`` has five numbers, as the result of a regression has."""
    savemat(folder / "record.mat", {"t": TIME, "p": np.arange(5.0), **others})
    return drafted(read_record_file(folder / "record.mat"))


def test_a_column_that_cannot_be_read_does_not_take_the_others_along(tmp_path: Path) -> None:
    """Only a fault of the whole file ends a draft: here another column could be the channel."""
    draft = with_a_vector(tmp_path, {"x1": ALPHA, "y": ALPHA})
    assert draft.readable and draft.unused == ("x1", "y")
    assert "5 values for 60 times" in draft.faults[0]
    assert not with_a_vector(tmp_path, {}).readable
    assert not with_a_vector(tmp_path, {"other": np.arange(7.0)}).readable


def test_a_row_that_ends_early_takes_all_columns_along(tmp_path: Path) -> None:
    rows = [f"{time:.2f},{alpha:.6f},1" for time, alpha in zip(TIME, ALPHA, strict=True)]
    draft = drafted(opened(tmp_path, "time,alpha,other", [*rows[:-1], "1.18,0"]))
    assert draft.unused == ("other",) and not draft.readable


@pytest.mark.parametrize("header", ["other", "other [V]"])
def test_a_unit_is_no_reason_that_a_column_cannot_be_read(tmp_path: Path, header: str) -> None:
    rows = [f"{time:.2f},broken,{time:.2f}" for time in TIME]
    assert drafted(opened(tmp_path, f"time,alpha,{header}", rows)).readable


def test_a_fill_value_does_not_turn_the_unit(tmp_path: Path) -> None:
    """Radians with -999 for no measurement do not move by 999."""
    rows = [
        f"{time:.2f},{-999 if 20 <= n < 25 else alpha:.6f}"
        for n, (time, alpha) in enumerate(zip(TIME, ALPHA, strict=True))
    ]
    draft = drafted(opened(tmp_path, "time,alpha", rows))
    (alpha,) = (guess for guess in draft.guesses if guess.channel == "alpha")
    assert alpha.choice.unit is None and "-999 is taken as a fill value" in alpha.reason


def test_the_unit_of_a_clock_stands_before_the_message_in_brackets(tmp_path: Path) -> None:
    rows = [
        f"{12000 + 1e3 * time:.0f},{alpha:.6f}" for time, alpha in zip(TIME, ALPHA, strict=True)
    ]
    assert (
        choice(drafted(opened(tmp_path, "time_boot_ms(ATTITUDE),alpha", rows)), "time").unit == "ms"
    )


def test_vectors_beside_several_structs_are_columns_without_a_topic(tmp_path: Path) -> None:
    from scipy.io import savemat

    structs = {name: {"time": TIME[::2], "height": TIME[::2]} for name in ("gps", "baro")}
    savemat(tmp_path / "record.mat", {"time": TIME, "alpha": ALPHA, **structs})
    draft = drafted(read_record_file(tmp_path / "record.mat"))
    assert choice(draft, "alpha").column == "alpha" and not draft.faults


def test_sheets_of_other_runs_are_said_not_to_be_read(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("python_calamine")
    pytest.importorskip("openpyxl")
    with pandas.ExcelWriter(tmp_path / "record.xlsx") as book:
        for run in ("Run1", "Run2", "Run3"):
            pandas.DataFrame({"time": TIME, "alpha": ALPHA}).to_excel(
                book, sheet_name=run, index=False
            )
    file = read_record_file(tmp_path / "record.xlsx")
    draft = drafted(file)
    notes = read_with_notes(file, (), ["alpha"], {"alpha": choice(draft, "alpha")})[1]
    assert "Run2, Run3 have the same columns as Run1 and are not read" in notes


def test_an_archive_of_two_files_is_refused_with_their_names(tmp_path: Path) -> None:
    import zipfile

    with zipfile.ZipFile(tmp_path / "record.zip", "w") as archive:
        for name in ("one.csv", "two.csv"):
            archive.writestr(name, "time,alpha\n0,0\n")
    with pytest.raises(
        RecordError, match=r"the archive holds 2 files \(one.csv, two.csv\); some have the same"
    ):
        read_record_file(tmp_path / "record.zip")


def test_an_archive_with_a_file_for_each_channel_is_one_log(tmp_path: Path) -> None:
    import zipfile

    with zipfile.ZipFile(tmp_path / "flight.zip", "w") as archive:
        for name, column, step in (("vane", "alpha [deg]", 1), ("gyro", "q [deg/s]", 3)):
            rows = [f"{t:.2f},{9.0 * a:.6f}" for t, a in zip(TIME, ALPHA, strict=True)][::step]
            archive.writestr(f"channels/{name}.csv", "\n".join([f"t,{column}", *rows]))
    file = read_record_file(tmp_path / "flight.zip")
    assert [topic.name for topic in file.topics] == ["vane", "gyro"]
    draft = drafted(file)
    chosen = {name: choice(draft, name) for name in ("alpha", "q")}
    record = read_with_notes(file, (), ["alpha", "q"], chosen)[0]
    assert int(record["alpha"].valid.sum()) == 58 and int(record["q"].valid.sum()) == 20
    assert record["alpha"].values[30] == pytest.approx(np.deg2rad(9.0 * ALPHA[30]), abs=1e-7)


@pytest.mark.parametrize(
    ("header", "channel", "unit"),
    [
        ("AOA_NB (deg)", "alpha", "deg"),
        ("QRATE (deg/s)", "q", "deg/s"),
        ("gx_dps", "p", "deg/s"),
        ("NZCG (g)", "nz", "g"),
        ("KTAS (kts)", "airspeed", "kts"),
        ("Elev Pos [deg]", "elevator", "deg"),
        ("Querruder [deg]", "aileron", "deg"),
        ("EPOS [deg]", "elevator", "deg"),
        ("RPOS [deg]", "rudder", "deg"),
        ("HP [ft]", "altitude", "ft"),
    ],
)
def test_usual_headers_are_recognised(tmp_path: Path, header: str, channel: str, unit: str) -> None:
    rows = [f"{time:.2f},{50.0 + 9.0 * a:.6f}" for time, a in zip(TIME, ALPHA, strict=True)]
    found = choice(drafted(opened(tmp_path, f"time,{header}", rows)), channel)
    assert (found.column, found.unit) == (header, unit)


@pytest.mark.parametrize("largest", [100.0, 3.0])  # in degrees, in radians
def test_elevons_are_elevator_and_aileron_and_indicated_airspeed_is_a_pressure(
    tmp_path: Path, largest: float
) -> None:
    left, right = largest * ALPHA, 0.5 * largest * ALPHA**2
    rows = [f"{t:.2f},{a:.9f},{b:.9f},100" for t, a, b in zip(TIME, left, right, strict=True)]
    rows[0] = rows[0].removesuffix("100") + "101"  # a channel that never moves is no measurement
    file = opened(tmp_path, "time,ELEVON_L,ELEVON_R,IAS_kt", ["s,,,kt", *rows])
    draft = drafted(file)
    chosen = {name: choice(draft, name) for name in ("elevator", "aileron", "dynamic_pressure")}
    record = read_with_notes(file, ("elevator", "aileron"), ("dynamic_pressure",), chosen)[0]
    radians = np.deg2rad(1.0) if largest > 10.0 else 1.0
    for name, sign in (("elevator", 1.0), ("aileron", -1.0)):
        expected = 0.5 * radians * (left + sign * right)
        np.testing.assert_allclose(record[name].values, expected, atol=1e-6)
    # A speed of 100 kt is 51.444 m/s.
    pressure = record["dynamic_pressure"].values[-1]
    assert pressure == pytest.approx(0.5 * 1.225 * 51.4444**2, rel=1e-4)


def test_the_draft_is_for_the_axis_whose_motion_is_recorded(tmp_path: Path) -> None:
    rows = [f"{time:.2f},{a:.6f},{-a:.6f}" for time, a in zip(TIME, ALPHA, strict=True)]
    lateral = drafted(opened(tmp_path, "time,beta,p", rows))
    assert lateral.model == "" and lateral.nearest == "lateral"
    assert "# Not found: aileron, rudder, r, phi. A line is such as" in map_text(lateral)
    assert "--model lateral" in vehicle_text(lateral)
    pitch = drafted(opened(tmp_path, "time,p,q", rows))
    assert pitch.nearest == "" and "--model rigid" in vehicle_text(pitch)


@pytest.mark.parametrize(
    ("header", "channel"),
    [
        ("Höhenruder", "elevator"),
        ("HÖHENRUDER [deg]", "elevator"),
        ("Ho\u0308henruder", "elevator"),
        ("Hängewinkel (deg)", "phi"),
        ("servo_elevator [deg]", "elevator"),
        ("servo_aileron [deg]", "aileron"),
        ("rudder_servo (deg)", "rudder"),
        ("gyro_p [deg/s]", "p"),
        ("gyro_q [deg/s]", "q"),
        ("Gyro R (rad/s)", "r"),
    ],
)
def test_umlauts_and_the_names_of_servos_and_gyros_are_recognised(
    tmp_path: Path, header: str, channel: str
) -> None:
    rows = [f"{time:.2f},{value:.6f}" for time, value in zip(TIME, ALPHA, strict=True)]
    assert choice(drafted(opened(tmp_path, f"time,{header}", rows)), channel).column == header


def written(folder: Path, channel: str, header: str, step: int = 1) -> None:
    rows = [f"{time},{value}" for time, value in zip(TIME[::step], ALPHA[::step], strict=True)]
    (folder / f"{channel}.csv").write_text("\n".join([header, *rows]) + "\n")


def test_a_folder_with_a_file_for_each_channel_is_one_log(tmp_path: Path) -> None:
    written(tmp_path, "elevator", "time,value")
    written(tmp_path, "alpha", "time,value (deg)", step=2)
    written(tmp_path, "rate", "time,q")
    file = read_record_file(tmp_path)
    record, _ = read_with_notes(file, ("elevator",), ["alpha", "q"])
    assert record.name == tmp_path.name and record.time[1] == pytest.approx(TIME[1])
    assert record["alpha"].values[2] == pytest.approx(np.radians(ALPHA[2]))
    # Clocks are used: none is a column without a channel.
    assert not drafted(file).unused


def test_a_folder_of_records_is_refused_with_what_to_do(tmp_path: Path) -> None:
    written(tmp_path, "flight_1", "time,alpha")
    written(tmp_path, "flight_2", "time,alpha")
    with pytest.raises(RecordError, match=r"two files of this folder hold 'alpha'.*name one of"):
        read_record_file(tmp_path)
    (tmp_path / "flight_1.csv").write_text("time,alpha,q\n0,0,0\n")
    with pytest.raises(RecordError, match=r"flight_1.csv is not a table of time and one channel"):
        read_record_file(tmp_path)


def test_channels_of_all_axes_are_those_of_the_aircraft(tmp_path: Path) -> None:
    names = ["elevator", "rudder", "p", "q", "r", "airspeed", "alpha", "theta", "thrust"]
    columns = [TIME, *[ALPHA] * len(names)]
    rows = [",".join(map(str, row)) for row in np.transpose(columns)]
    draft = drafted(opened(tmp_path, ",".join(["time", *names]), rows))
    assert draft.model == "aircraft"
    text = vehicle_text(draft)
    content = tomllib.loads(text)
    assert content["model"] == "aircraft" and content["surfaces"] == dict.fromkeys(names[:2], "rad")
    assert '"rudder" = ...' in text and '"aileron"' not in text


def test_columns_that_never_move_are_said_to_be_left_out_for_that(tmp_path: Path) -> None:
    rows = [
        f"{time:.2f},{value:.6f},{value:.6f},{value:.6f},0.0"
        for time, value in zip(TIME, ALPHA, strict=True)
    ]
    draft = drafted(opened(tmp_path, "time,elevator,alpha,q,rudder", rows))
    text = map_text(draft)
    assert draft.constant == {"rudder": "rudder"} and draft.unused == ()
    assert "# Left out, since they never move: rudder." in text
    assert "# Not found, and not needed by --model rigid: aileron, beta." in text


def test_a_command_from_minus_one_to_one_is_drafted_with_its_throw_to_enter(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    log = px4(tmp_path / "uav.ulg", flight())
    draft = drafted(read_record_file(log))
    assert {guess.channel for guess in draft.guesses if guess.command} == {"elevator", "aileron"}
    assert (
        '# elevator = {column = "THROW * actuator_servos.control[1]", unit = "deg"}  #'
        in map_text(draft)
    )
    column = "actuator_servos.control[1]"
    (warning,) = unscaled_commands({"elevator": ColumnChoice(column)})
    assert warning.startswith("elevator seems to be an unscaled command")
    assert unscaled_commands({"elevator": ColumnChoice(f"25 * {column}", "deg")}) == ()


def test_a_stated_unit_or_factor_and_a_measured_angle_are_no_unscaled_commands() -> None:
    """ArduPilot's angle of attack, in degrees by the map, was called a command from -1 to 1."""
    column = "actuator_servos.control[1]"
    for channel, choice in (
        ("alpha", ColumnChoice("AOA.AOA", "deg")),
        ("alpha", ColumnChoice("AOA.AOA")),
        ("beta", ColumnChoice("AOA.SSA")),
        ("theta", ColumnChoice("ATT.Pitch")),
        ("elevator", ColumnChoice(column, "deg")),
        ("elevator", ColumnChoice(column, scale=0.4)),
    ):
        assert unscaled_commands({channel: choice}) == ()
