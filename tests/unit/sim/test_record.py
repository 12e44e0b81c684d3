"""Records: what cannot be one, missing samples, windows, arrays in the order asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim.errors import RecordError, instant
from sim.record import Channel, Hold, Record

TIME = np.array([0.0, 0.1, 0.2, 0.35, 0.5])


def record() -> Record:
    alpha, q = np.array([1.0, math.nan, 3.0, 4.0, 5.0]), np.arange(5.0)
    return Record(
        TIME,
        (Channel.of("elevator", "rad", q + 10.0),),
        (Channel.of("alpha", "rad", alpha), Channel.of("q", "rad/s", q)),
        name="flight.csv",
    )


def build(
    time: object = TIME,
    inputs: dict[str, object] | None = None,
    outputs: dict[str, object] | None = None,
) -> Record:
    groups = [
        tuple(Channel.of(name, "1", np.asarray(v)) for name, v in (group or {}).items())
        for group in (inputs, outputs)
    ]
    return Record(np.asarray(time), groups[0], groups[1], name="flight.csv")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"time": [1.0]}, r"1 sample\(s\)"),
        ({"time": [0.0, math.nan, 0.2]}, "row 2: time is missing or infinite"),
        ({"time": [0.0, 0.1, math.inf]}, "row 3: time is missing or infinite"),
        ({"time": [0.0, 0.2, 0.1]}, r"row 3: time goes back \(0.2 s, then 0.1 s\)"),
        ({"time": [0.0, 0.1, 0.1]}, "row 3: time is repeated"),
        ({"outputs": {"q": [1.0, 2.0]}}, "channel q: 2 values for 5 times"),
        ({"outputs": {"q": [math.nan] * 5}}, "channel q: not a single number"),
        ({"inputs": {"q": np.ones(5)}, "outputs": {"q": np.ones(5)}}, "q.*twice"),
        ({"inputs": {"elevator": [1.0, 2.0, math.nan, 4.0, 5.0]}}, r"elevator"),
    ],
)
def test_what_cannot_be_a_record_is_refused_in_one_line(
    arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(RecordError, match=message) as caught:
        build(**arguments)  # type: ignore[arg-type]
    assert str(caught.value).startswith("flight.csv") or caught.value.where == "flight.csv"
    assert "\n" not in str(caught.value) and caught.value.remedy


def test_missing_samples_are_zero_and_marked() -> None:
    alpha = record()["alpha"]
    np.testing.assert_array_equal(alpha.valid, [True, False, True, True, True])
    assert alpha.values[1] == 0.0 and math.isnan(alpha.with_gaps()[1])


def test_arrays_come_in_the_order_asked_for() -> None:
    values, valid = record().output_array(["q", "nz", "alpha"])
    np.testing.assert_array_equal(values[0], np.arange(5.0))
    assert not valid[1].any() and valid[0].all() and not valid[2, 1]
    np.testing.assert_array_equal(record().input_array(), [np.arange(5.0) + 10.0])
    assert build(outputs={"q": np.ones(5)}).input_array([]).shape == (0, 5)


def test_windows_are_inclusive_and_keep_channels() -> None:
    cut = record().window(0.1, 0.35)
    np.testing.assert_array_equal(cut.time, [0.1, 0.2, 0.35])
    np.testing.assert_array_equal(cut["q"].values, [1.0, 2.0, 3.0])
    assert not cut["alpha"].valid[0] and cut.hold is Hold.PREVIOUS
    assert len(record().window()) == 5
    with pytest.raises(RecordError, match=r"fewer than two rows.*covers 0 to 0.5 s"):
        record().window(0.4, 9.0)


def test_channels_by_name_and_fewer_outputs() -> None:
    assert record().output_names == ("alpha", "q") and record().input_names == ("elevator",)
    assert record().only(["q"]).output_names == ("q",)
    with pytest.raises(RecordError, match="there is no channel 'nz'; it has elevator, alpha, q"):
        record()["nz"]


def test_nothing_can_be_changed_from_outside() -> None:
    time = TIME.copy()
    made = build(time, outputs={"q": np.ones(5)})
    time[0] = -1.0
    assert made.time[0] == 0.0
    for array in (made.time, made["q"].values, made["q"].valid, made.window(0.1)["q"].values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 7


@pytest.mark.parametrize(
    ("time", "digits", "text"),
    [
        (3.3412, 4, "3.341"),
        (0.0, 4, "0"),
        (45222.46, 4, "45222.46"),
        (45222.0, 6, "45222"),
        (1.7e9 + 0.25, 6, "1700000000.25"),
        (124.04, 4, "124"),
        (-1e300, 6, "-1e+300"),
    ],
)
def test_a_time_of_a_late_clock_keeps_its_hundredths(time: float, digits: int, text: str) -> None:
    assert instant(time, digits) == text
