"""Topics of a log on one grid, columns at lower rates, and channels that are computed from
columns.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flightid as fid
from scenarios.files.declarations import ColumnChoice, read_channel_map
from scenarios.files.records import read_record, read_with_notes
from sim.errors import RecordError
from sim.record import Hold
from tests.recorders.logs import write_dataflash, write_ulog

pytest.importorskip("pyulog")
MAP = {
    "elevator": ColumnChoice("servo.position"),
    "q": ColumnChoice("gyro.rate[1]"),
    "alpha": ColumnChoice("vane.angle"),
}


def log(
    folder: Path, gyro: float = 100.0, vane: float = 20.0, servo: float = 25.0, noise: float = 0.0
) -> Path:
    """A log of 10 s whose topics have rates of their own, Hz, and whose clocks begin at different
    times.
    """
    rng = np.random.default_rng(4)

    def stamps(rate: float, begin: float) -> np.ndarray:
        return np.round(1e6 * (3.0 + begin + np.arange(int(10 * rate)) / rate))

    g, v, s = stamps(gyro, 0.0), stamps(vane, 0.0137), stamps(servo, 0.021)
    motion = np.sin(2.0 * g * 1e-6) + noise * rng.standard_normal(g.size)
    topics = {
        "gyro": {"timestamp": g, "rate[0]": 0 * g, "rate[1]": motion},
        "vane": {"timestamp": v, "angle": np.cos(2.0 * v * 1e-6)},
        "servo": {"timestamp": s, "position": np.sin(0.7 * s * 1e-6)},
    }
    return write_ulog(folder / "log.ulg", topics)


def test_the_grid_is_the_fastest_outputs_clock_and_slow_outputs_keep_their_rate(
    tmp_path: Path,
) -> None:
    record, notes = read_with_notes(log(tmp_path), ["elevator"], ["q", "alpha"], MAP)
    assert np.median(np.diff(record.time)) == pytest.approx(0.01)
    np.testing.assert_allclose(record["q"].values, np.sin(2.0 * record.time), atol=1e-12)
    alpha = record["alpha"]
    assert np.count_nonzero(alpha.valid) == pytest.approx(0.2 * len(record), abs=2)
    np.testing.assert_allclose(
        alpha.values[alpha.valid], np.cos(2.0 * record.time[alpha.valid]), atol=0.003
    )
    np.testing.assert_allclose(record["elevator"].values, np.sin(0.7 * record.time), atol=1e-3)
    said = " ".join(notes)
    assert (
        "one grid" in said
        and "samples only where it was measured" in said
        and "joined by lines" in said
    )


def test_a_grid_that_is_asked_for_filters_what_is_faster(tmp_path: Path) -> None:
    path = log(tmp_path, gyro=500.0, noise=0.2)
    slow, notes = read_with_notes(path, ["elevator"], ["q"], MAP, rate=25.0)
    assert np.allclose(np.diff(slow.time), 0.04) and "low-pass" in " ".join(notes)
    inner = slice(5, -5)
    error = slow["q"].values[inner] - np.sin(2.0 * slow.time[inner])
    assert np.std(error) < 0.2 * np.sqrt(25.0 / 500.0) * 1.3


def test_inputs_between_their_samples_as_they_are_wanted(tmp_path: Path) -> None:
    path = log(tmp_path, servo=5.0)
    held = read_record(path, ["elevator"], ["q"], MAP, hold=Hold.PREVIOUS)["elevator"].values
    linear = read_record(path, ["elevator"], ["q"], MAP, hold=Hold.LINEAR)["elevator"].values
    chosen = read_record(
        path,
        ["elevator"],
        ["q"],
        {**MAP, "elevator": ColumnChoice("servo.position", hold="previous")},
    )["elevator"].values
    assert np.unique(held).size < 60 < np.unique(linear).size
    assert chosen.tobytes() == held.tobytes()


def test_a_column_at_a_lower_rate_in_one_table(tmp_path: Path) -> None:
    time = 0.02 * np.arange(300)
    cells = [repr(float(np.sin(t))) if n % 5 == 0 else "" for n, t in enumerate(time.tolist())]
    rows = [
        "time,elevator,q",
        *(f"{t:.2f},{cell},{float(np.cos(t))!r}" for t, cell in zip(time, cells, strict=True)),
    ]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(rows))
    record, notes = read_with_notes(path, ["elevator"], ["q"])
    np.testing.assert_allclose(record["elevator"].values[:296], np.sin(time)[:296], atol=1.5e-3)
    assert "a sample every 0.1 s" in " ".join(notes)
    path.write_text(
        "\n".join([*rows[:100], *(f"{row.split(',')[0]},,0" for row in rows[100:200]), *rows[200:]])
    )
    with pytest.raises(RecordError, match="an input sample is missing"):
        read_record(path, ["elevator"], ["q"])


def test_a_map_computes(tmp_path: Path) -> None:
    time = 0.02 * np.arange(200)
    elevator = 0.1 * np.sin(time)
    left, right = 1500 - 480 * elevator, 1510 + 480 * elevator
    path = tmp_path / "run.csv"
    rows = ["t,left_pwm,right_pwm,gyro [deg/s],speed [kt],late"]
    rows += [f"{t:.2f},{a!r},{b!r},{c!r},{d!r},{e!r}" for t, a, b, c, d, e in np.column_stack(
        [time, left, right, np.degrees(np.cos(time)), 100 + time, np.sin(time - 0.1)]).tolist()]  # fmt: skip  # noqa: E501
    path.write_text("\n".join(rows))
    map_file = tmp_path / "map.toml"
    map_file.write_text(
        'elevator = {sum = ["right_pwm", "left_pwm"], scale = 0.0, offset = 1.0}\n'
        'q = "gyro"\nairspeed = {column = 5, bias = 1.0}\nalpha = {column = "late", delay = 0.1, '
        "sign = -1}\n"
        'theta = {column = "late", table = [[-1.0, 1.0], [-2.0, 2.0]]}\n'
    )
    found = read_record(
        path, ["elevator"], ["q", "airspeed", "alpha", "theta"], read_channel_map(map_file)
    )
    assert np.all(found["elevator"].values == 1.0)
    np.testing.assert_allclose(found["q"].values, np.cos(time), rtol=1e-12)
    np.testing.assert_allclose(
        found["airspeed"].values, (100 + time) * 1852 / 3600 - 1.0, rtol=1e-12
    )
    np.testing.assert_allclose(found["alpha"].values[:-5], -np.sin(time)[:-5], atol=2e-4)
    np.testing.assert_allclose(found["theta"].values, 2.0 * np.sin(time - 0.1), rtol=1e-12)
    mixed = {
        "elevator": ColumnChoice("0.5*(pwm(right_pwm, 1510, 480) - pwm(left_pwm, 1500, 480))"),
        "q": ColumnChoice("gyro"),
    }
    np.testing.assert_allclose(
        read_record(path, ["elevator"], ["q"], mixed)["elevator"].values, elevator, atol=1e-12
    )


def test_a_channel_that_is_not_there_and_a_field_of_zeros(tmp_path: Path) -> None:
    stamps = np.arange(0.0, 4e6, 2e4)
    topics = {
        "a": {"timestamp": stamps, "q": np.sin(1e-6 * stamps), "alpha": np.cos(1e-6 * stamps)},
        "b": {"timestamp": stamps, "airspeed": 0.0 * stamps, "theta": 0.0 * stamps + 0.1},
    }
    log = write_ulog(tmp_path / "log.ulg", topics)
    channels = ("q", "alpha", "airspeed", "theta")
    assert read_record(log, (), (), {"q": ColumnChoice("a.q")}, optional=channels).output_names == (
        "q",
        "alpha",
        "theta",
    )
    (tmp_path / "map.toml").write_text('q = "a.q"\nalpha = false\n')
    chosen = read_channel_map(tmp_path / "map.toml")
    assert read_record(log, (), (), chosen, optional=channels).output_names == ("q", "theta")
    table = tmp_path / "run.csv"
    table.write_text("time,elevator,alpha,q\n0,0,1,2\n1,0,1,2\n2,1,1,2\n")
    assert read_record(
        table, ["elevator"], ["alpha", "q"], chosen | {"q": ColumnChoice("q")}
    ).output_names == ("q",)
    with pytest.raises(RecordError, match="no column 'elevator'"):
        read_record(table, ["elevator"], ["q"], {"elevator": ColumnChoice("")})


def test_one_rule_chooses_the_unit_of_a_column_in_a_table_and_in_a_log(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    stamps = np.arange(0.0, 4e6, 2e4)
    values = np.sin(1e-6 * stamps)
    messages = {
        "A": {"TimeUS": stamps, "deg": np.degrees(values), "odd": values},
        "B": {"TimeUS": stamps, "x": values},
    }
    log = write_dataflash(tmp_path / "log.bin", messages, {"A": "sdo"})
    choices = {
        "elevator": ColumnChoice("B.x"),
        "alpha": ColumnChoice("A.deg"),
        "q": ColumnChoice("A.odd"),
    }
    record, notes = read_with_notes(log, ["elevator"], ["alpha", "q"], choices)
    np.testing.assert_allclose(record["alpha"].values, values, atol=1e-12)
    # "m/s/s" is no unit of a rate: the numbers stay
    np.testing.assert_allclose(record["q"].values, values, atol=1e-12)
    assert any(
        "q: the unit m/s2 that the file states is no unit of it and is not used" in note
        for note in notes
    )
    table = tmp_path / "run.csv"
    rows = [
        f"{1e-6 * t},{v},{np.degrees(v)},{v}"
        for t, v in zip(stamps.tolist(), values.tolist(), strict=True)
    ]
    table.write_text("\n".join(["time,elevator,AoA [deg],rate [m/s2]", *rows]))
    found = read_record(table, ["elevator"], ["alpha"], {"alpha": ColumnChoice(3)})
    np.testing.assert_allclose(found["alpha"].values, values, atol=1e-12)
    for column in (4, "rate"):  # somebody wrote that unit: by number as by name
        with pytest.raises(RecordError, match="does not measure"):
            read_record(table, ["elevator"], ["q"], {"q": ColumnChoice(column)})


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        (ColumnChoice("gyro.rat[1]"), "did you mean 'gyro.rate[1]'"),
        (ColumnChoice("timestamp"), "is in 3 places"),
        (ColumnChoice(3), "means nothing in a log of several topics"),
        (ColumnChoice("gyro.rate[1] +"), "is no expression"),
        (ColumnChoice("2 * 3"), "reads no column"),
    ],
)
def test_faults_of_a_map_for_a_log(tmp_path: Path, choice: ColumnChoice, said: str) -> None:
    with pytest.raises(RecordError) as caught:
        read_record(log(tmp_path), ["elevator"], ["q"], {**MAP, "q": choice})
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_log_without_a_map_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"\(gyro, servo, vane\); .*flightid map"):
        read_record(log(tmp_path), ["elevator"], ["q"])


@pytest.mark.parametrize(
    "choices",
    [
        {"time": "vane.timestamp"},
        {"time": ("1e-6 * vane.timestamp", "s")},
        {"angle": "vane.angle"},
    ],
)
def test_a_map_of_one_topic_makes_a_record_of_its_rows(
    tmp_path: Path, choices: dict[str, str | tuple[str, str]]
) -> None:
    record = fid.read_record(log(tmp_path), channels=choices)
    assert record.time.size == 200 and record.time[0] == pytest.approx(3.0137)
    assert "angle" in record.names
    np.testing.assert_allclose(record["angle"], np.cos(2.0 * record.time), atol=1e-6)


def test_a_clock_of_two_topics_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="several topics; name the clock of one topic"):
        fid.read_record(log(tmp_path), channels={"time": "gyro.timestamp + vane.timestamp"})
