"""The record check: every kind of fault of raw columns in turn, misread columns and time base among
them.

The columns are read as they stand and as each simple fault would have them; what counts is how well
the kinematics then hold (``motion``). Sound sensors leave a tenth of the power unexplained or less,
also with the sensor effects of the library; rough air may leave half, but then no other reading
does better. A fault of this kind leaves a third to all of it, and its own reading takes that to a
hundredth.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.recording.distorted_channels import band_limited, clipped, hum, zero_steps
from ident.recording.kinematic_relations import (
    DEGREES,
    NZ_REMEDY,
    POWER_FLOOR,
    RENAME,
    SHIFTS,
    UNITS,
    ColumnReading,
    ControlPower,
    KinematicColumns,
    all_readings,
    change,
    columns_of,
    control_power,
    disagreement,
    height_unit,
    lag_of,
    sure,
    unexplained_lift,
)
from ident.recording.missing_samples import (
    dropouts,
    held_samples,
    interpolated,
    missing_rows,
    stuck,
)
from ident.recording.series import (
    FEWEST_SAMPLES,
    Certainty,
    Expectations,
    FindingQuantity,
    Kind,
    RecordFinding,
    Series,
    changing_noise,
    coarse,
    series_of,
)
from sim.record import Channel, Record

# ---- A time base that runs grossly fast or slow

# unexplained share of the motion from which a clock is suspected (0.2 at twice the rate)
SUSPECT_CLOCK_SHARE = 0.12
CORRECT_CLOCK_SHARE = 0.06  # share that a correct clock leaves at most
CLOCK_IMPROVEMENT_RATIO = 4.0  # times less than as read
# of ln 2: scales of a sensor are nearer to one, and a clock that is less wrong is an effect for the
# fit
GROSS_CLOCK_ERROR = 0.7
PER_OCTAVE = 4  # clock rates tried in an octave
SEARCHED_OCTAVES = 4
# of a logarithm: starting values of a vehicle file and effects make up to a factor of two
PLAUSIBLE_LOG_RATIO = 0.7


def wrong_clock(
    columns: KinematicColumns, as_read: float, expected: Expectations
) -> RecordFinding | None:
    """Certain where the control's power, or pitch attitude, tell it from a scale of a sensor, else
    likely; None where time is right.
    """
    factors = [
        2.0 ** (step / PER_OCTAVE)
        for step in range(-PER_OCTAVE * SEARCHED_OCTAVES, PER_OCTAVE * SEARCHED_OCTAVES + 1)
        if step
    ]
    left = {
        factor: max(disagreement(columns.times({"time": factor})).values()) for factor in factors
    }
    best = min(left, key=lambda factor: left[factor])
    if (
        left[best] > CORRECT_CLOCK_SHARE
        or left[best] * CLOCK_IMPROVEMENT_RATIO > as_read
        or abs(math.log2(best)) < GROSS_CLOCK_ERROR
    ):
        return None
    numbers = {
        "factor": FindingQuantity(best, "1"),
        "unexplained": FindingQuantity(as_read, "1"),
        "unexplained_otherwise": FindingQuantity(left[best], "1"),
    }
    what = (
        f"disagrees with the kinematics: they hold if time runs {best:.2g} times as long as the "
        "column says"
    )
    # Attitude rules out a scale of alpha; one of the pitch rate does the same to it as the clock,
    # and is told by nz alone.
    attitude = {"theta", "alpha"} <= set(columns.outputs)
    by_rate = min(max(disagreement(columns.times({"q": factor})).values()) for factor in factors)
    if (attitude and CLOCK_IMPROVEMENT_RATIO * left[best] < by_rate) or _control_agrees(
        columns, best, expected
    ):
        return RecordFinding(
            "time",
            Kind.TIME_BASE,
            Certainty.CERTAIN,
            what,
            "mend the time column, or say its unit in a channel map",
            numbers=numbers,
        )
    what += f", or if the {'pitch rate' if attitude else 'angle of attack'} has a scale of its own"
    return RecordFinding(
        "time",
        Kind.TIME_BASE,
        Certainty.LIKELY,
        what,
        "check the sample rate and the units of the columns",
        numbers=numbers,
    )


def _control_agrees(columns: KinematicColumns, factor: float, expected: Expectations) -> bool:
    """Return whether the control's power is that of the vehicle's data only with the other clock:
    accelerations go with its square.
    """
    if expected.control_power is None or not expected.control_power or not expected.angular_control:
        return False
    estimates = []
    for some in (columns, columns.times({"time": factor})):
        power = control_power(some)
        if power is None or not sure(power) or power.value * expected.control_power <= 0.0:
            return False
        estimates.append(abs(math.log(power.value / expected.control_power)))
    return estimates[1] < min(PLAUSIBLE_LOG_RATIO, 0.5 * estimates[0])


# ---- Columns that are not what their header says

# Chosen between the two: records with any effect of the library leave 0.12 at most, a wrong column
# 0.28 at least; the noise of a small motion leaves 0.1 of the right reading, too.
WRONG_COLUMN_SHARE = 0.2  # unexplained share from which a column is wrong
CORRECT_COLUMN_SHARE = 0.15  # largest unexplained share of a correct column
RIGHT_WITH_CONTROL = 0.1  # the same where a control confirms it
READINGS_CLEARLY = 4.0  # times less than as read, and than any reading of another kind
# factor within which a control power is that of the vehicle's data; effects and starting values
# differ by 2, degrees by 57
CONTROL_POWER_FACTOR = 3.0
# Correlation of changes of nz and alpha: 0.88 at least with any effect of the library; a control
# moves otherwise.
AGREEING_CORRELATION = 0.85  # correlation from which two channels agree
DISAGREEING_CORRELATION = 0.7  # correlation below which they do not
# Rows of a lag: with two, a motion has four samples a period, and of 600 sound light aircraft one
# was read as in ms.
FEWEST_ROWS_PER_LAG = 3
# of twice the log likelihood: the level of significance is one in a thousand
CHANCE = -2.0 * math.log(1e-3)
# in rad, of a motion that linear equations describe
SMALL_ANGLES = ("alpha", "elevator", "beta", "aileron", "rudder")
LARGEST_ANGLE = 1.5  # rad, largest distance of an angle from its middle
ANGLE_PERCENTILE = 99.0  # percentile of the samples that must be within
LEVEL = (9.0, 10.7)  # g, of a middle: level flight in m/s2, a little climbing, diving or turning
LARGEST_ALPHA_RANGE = 0.6  # rad, of an angle of attack from end to end


def misread(record: Record, expected: Expectations) -> list[RecordFinding]:
    """Return the columns that are certainly or probably mislabelled; empty if all are consistent or
    no relation exists.
    """
    far = [
        one
        for name in SMALL_ANGLES
        if name in (*record.input_names, *record.output_names)
        and (one := _far(record[name])) is not None
    ]
    far += [
        one
        for name in ("nz",)
        if name in record.output_names and (one := _gravity(record[name])) is not None
    ]
    columns = columns_of(record, expected)
    if columns is None:
        return far
    result = _of_columns(columns, expected)
    if far and not any(one.kind is Kind.EXCHANGED for one in result):
        return far
    return (
        [_of_az(one) for one in result]
        if "az" in record.output_names and "nz" not in record.output_names
        else result
    )


def _of_columns(columns: KinematicColumns, expected: Expectations) -> list[RecordFinding]:
    shares = disagreement(columns)
    as_read = max(shares.values(), default=0.0)
    result = _of_lift(columns, as_read) or _of_angles(columns, as_read)
    if result is None and as_read > SUSPECT_CLOCK_SHARE:
        result = _best(columns, as_read, expected)
    if result is not None:
        return [result]
    return _of_control(columns, expected) if shares and as_read <= WRONG_COLUMN_SHARE else []


def _of_az(finding: RecordFinding) -> RecordFinding:
    """Return the finding on nz in terms of its source column: in m/s2 for nz is a factor of g0,
    that of g for az.
    """
    if finding.kind is Kind.UNIT and finding.channel == "nz":
        return replace(finding, channel="az", remedy="check the unit of az: m/s2 is meant")
    channel, sentence, remedy = (
        re.sub(r"\bnz\b", "az", text)
        for text in (finding.channel, finding.sentence, finding.remedy)
    )
    return replace(finding, channel=channel, sentence=sentence, remedy=remedy)


def _far(channel: Channel) -> RecordFinding | None:
    """Return a flow angle or a control that moves too far for radians."""
    values = channel.values[channel.valid]
    reach = (
        float(np.percentile(np.abs(values - np.median(values)), ANGLE_PERCENTILE))
        if len(values)
        else 0.0
    )
    if reach <= LARGEST_ANGLE:
        return None
    text = f"moves by {reach:.3g} rad ({math.degrees(reach):.3g} deg)"
    remedy = (
        f"if the column is in degrees, name it {channel.name}_deg or say so in a channel map; if "
        f"it is right, {channel.name} = false there"
    )
    return RecordFinding(
        channel.name,
        Kind.UNIT,
        Certainty.CERTAIN,
        text,
        remedy,
        numbers={"reach": FindingQuantity(reach, "rad")},
    )


def _gravity(channel: Channel) -> RecordFinding | None:
    """Return a load factor with a median of 9.8: level flight in m/s2."""
    middle = float(np.median(channel.values[channel.valid]))
    if not LEVEL[0] < abs(middle) < LEVEL[1]:
        return None
    text = f"is in m/s2, not in g: its middle is {middle:.3g}"
    return RecordFinding(
        channel.name,
        Kind.UNIT,
        Certainty.CERTAIN,
        text,
        NZ_REMEDY,
        numbers={"middle": FindingQuantity(middle, "g")},
    )


def _of_lift(columns: KinematicColumns, as_read: float) -> RecordFinding | None:
    """Sign of nz from its correlation with alpha, or exchange with the control, if the kinematics
    agree.
    """
    y = columns.outputs
    if not {"alpha", "q", "nz"} <= set(y):
        return None
    lag, step = lag_of(columns), float(np.median(np.diff(columns.time)))
    alpha = change(y["alpha"], lag)
    shifts = sorted({min(round(shift / step), len(alpha) // 4) for shift in SHIFTS})

    def goes_with_alpha(values: np.ndarray) -> float:
        """Largest correlation of changes, with shifts up to ``SHIFTS`` of either column."""
        other = change(values, lag)
        with np.errstate(invalid="ignore"):
            result = [
                float(np.nan_to_num(np.corrcoef(alpha[k:], other[: len(other) - k])[0, 1]))
                for k in shifts
            ]
            result += [
                float(np.nan_to_num(np.corrcoef(alpha[: len(alpha) - k], other[k:])[0, 1]))
                for k in shifts
            ]
        return max(result, key=abs)

    together = goes_with_alpha(y["nz"])
    turned = max(disagreement(columns.times({"nz": -1.0})).values())
    if together < -AGREEING_CORRELATION and turned < CORRECT_COLUMN_SHARE and turned < as_read:
        text = (
            f"has the sign turned: it falls when alpha rises (correlation {together:.2f}), and the "
            "kinematics hold better with the other sign"
        )
        return RecordFinding(
            "nz",
            Kind.SIGN,
            Certainty.CERTAIN,
            text,
            "turn the sign of the column of nz",
            numbers={"correlation": FindingQuantity(together, "1")},
        )
    if (
        columns.control is None
        or together > DISAGREEING_CORRELATION
        or goes_with_alpha(columns.control) < AGREEING_CORRELATION
    ):
        return None
    exchanged = columns.exchanged("nz", columns.control_name)
    other = max(disagreement(exchanged).values())
    if (
        other > CORRECT_COLUMN_SHARE
        or READINGS_CLEARLY * other > as_read
        or not _likelier(unexplained_lift(columns), unexplained_lift(exchanged))
    ):
        return None
    name = columns.control_name
    text = (
        f"are exchanged: the column of {name} goes with alpha, that of nz does not, and the "
        "kinematics hold so"
    )
    return RecordFinding(
        f"nz and {name}",
        Kind.EXCHANGED,
        Certainty.CERTAIN,
        text,
        RENAME,
        numbers={"correlation": FindingQuantity(together, "1")},
    )


def _of_angles(columns: KinematicColumns, as_read: float) -> RecordFinding | None:
    """All angles in degrees: consistent with each other, not with nz, and too large for radians."""
    names = [name for name in columns.outputs if name in UNITS]
    if (
        "alpha" not in names
        or len(names) < 2
        or "nz" not in columns.outputs
        or float(np.ptp(columns.outputs["alpha"])) < LARGEST_ALPHA_RANGE
    ):
        return None
    other = max(
        disagreement(columns.times({name: 1.0 / DEGREES for name in names})).values(),
        default=math.inf,
    )
    if other > CORRECT_CLOCK_SHARE or READINGS_CLEARLY * other > as_read:
        return None
    text = "are in degrees, not in radians: with nz the kinematics hold only so"
    return RecordFinding(
        " and ".join(names),
        Kind.UNIT,
        Certainty.CERTAIN,
        text,
        "say their units in a channel map",
        numbers={"unexplained": FindingQuantity(as_read, "1")},
    )


def _best(
    columns: KinematicColumns, as_read: float, expected: Expectations
) -> RecordFinding | None:
    readings = sorted(
        (one for one in all_readings(columns) if one.left < _right(one, columns)),
        key=lambda one: one.left,
    )
    best = readings[0] if readings else None
    if best is not None and as_read > WRONG_COLUMN_SHARE and best.left * READINGS_CLEARLY < as_read:
        near = [best, *(one for one in readings[1:] if one.left < READINGS_CLEARLY * best.left)]
        possible = [
            one for one in near if _implausible_as_read(one, columns, expected) is not False
        ]
        if not possible:
            return wrong_clock(columns, as_read, expected)
        best, rivals = _by_control(possible, expected) if len(possible) > 1 else (possible[0], [])
        numbers = {
            "unexplained": FindingQuantity(as_read, "1"),
            "unexplained_otherwise": FindingQuantity(best.left, "1"),
        }
        what = (
            f"{best.sentence}: as read, the kinematics leave {_percent(as_read)} of the motion "
            f"unexplained, read so {_percent(best.left)}"
        )
        # Without alpha nz stands for it, which an accelerometer off the centre of gravity does
        # badly: only a sign is beyond that.
        plain = ("alpha" in columns.outputs or best.kind is Kind.SIGN) and lag_of(
            columns
        ) >= FEWEST_ROWS_PER_LAG
        shown = _implausible_as_read(best, columns, expected) is not None
        certainty = Certainty.CERTAIN if plain and shown else Certainty.LIKELY
        if rivals:
            what += f"; or {' or '.join(f'{one.channel} {one.sentence}' for one in rivals[:2])}"
        return RecordFinding(best.channel, best.kind, certainty, what, best.remedy, numbers=numbers)
    return wrong_clock(columns, as_read, expected)


def _implausible_as_read(
    reading: ColumnReading, columns: KinematicColumns, expected: Expectations
) -> bool | None:
    """Return whether columns that a reading exchanges or turns are also implausible by what
    kinematics do not use; None where nothing else is known.

    A sensor that is wrong, or a gust, spoils the kinematics too, and a controller makes an elevator
    in the shape of what it feeds back: that the kinematics hold for another column is not enough.
    Lift decides on alpha, nz and the control, the pitch acceleration that the control makes on the
    pitch rate and the control.
    """
    names, exchange = set(reading.channel.split(" and ")), reading.kind is Kind.EXCHANGED
    if not exchange and reading.kind is not Kind.SIGN:
        return True
    lift = unexplained_lift(columns)
    # the law of lift is the same for these two exchanged
    if lift is not None and names & {"alpha", "nz"} and names != {"alpha", "nz"}:
        return _likelier(lift, unexplained_lift(reading.columns))
    by_control = exchange and columns.control_name in names
    if not by_control and "q" not in names:
        return True
    (here, power), (there, other) = (
        _pitching(some, expected) for some in (columns, reading.columns)
    )
    if here is not None and there is not None and here is not there:
        return there
    if not by_control:
        return True
    if power is None or other is None or "q" not in names:
        return None
    count = len(columns.time) / lag_of(columns)
    return _likelier((1.0 - power.explained, count), (1.0 - other.explained, count))


def _pitching(
    columns: KinematicColumns, expected: Expectations
) -> tuple[bool | None, ControlPower | None]:
    """Return whether the control power agrees with the vehicle file, None if unreliable; and that
    power.
    """
    power = control_power(columns)
    if power is None or not sure(power) or not expected.control_power:
        return None, power
    return _fits(power.value, expected), power


def _fits(power: float, expected: Expectations) -> bool:
    """Return whether a control power is that of the vehicle's data, or at least of its sign where
    only that is known.
    """
    ratio = power / expected.control_power if expected.control_power else 0.0
    return 1.0 / CONTROL_POWER_FACTOR < ratio < CONTROL_POWER_FACTOR or (
        ratio > 0.0 and not expected.angular_control
    )


def _likelier(before: tuple[float, float] | None, after: tuple[float, float] | None) -> bool:
    """Return whether the second unexplained share is significantly smaller; each with its number of
    independent parts.
    """
    if before is None or after is None:
        return False
    return (
        min(before[1], after[1])
        * math.log(max(before[0], POWER_FLOOR) / max(after[0], POWER_FLOOR))
        > CHANCE
    )


def _right(reading: ColumnReading, columns: KinematicColumns) -> float:
    """Return the largest unexplained share of a correct reading; smaller where a control takes
    part, since feedback makes it resemble the output.
    """
    return (
        RIGHT_WITH_CONTROL
        if reading.kind is Kind.EXCHANGED and columns.control_name in reading.channel.split(" and ")
        else CORRECT_COLUMN_SHARE
    )


def _by_control(
    rivals: Sequence[ColumnReading], expected: Expectations
) -> tuple[ColumnReading, list[ColumnReading]]:
    """Return, of the readings that the kinematics do not distinguish, those whose control power
    agrees with the vehicle file.
    """
    if expected.control_power is None:
        return rivals[0], list(rivals[1:])
    fitting = []
    for one in rivals:
        if _pitching(one.columns, expected)[0]:
            fitting.append(one)
    kept = fitting or list(rivals)
    return kept[0], kept[1:]


def _of_control(columns: KinematicColumns, expected: Expectations) -> list[RecordFinding]:
    """Return a control whose sign, or unit, is not that of the vehicle's data."""
    if expected.control_power is None or not expected.control_power:
        return []
    power = control_power(columns)
    if power is None or not sure(power) or _contradicted(columns, power.value):
        return []
    ratio, name = power.value / expected.control_power, columns.control_name
    text = (
        f"its pitch acceleration is {power.value:+.3g} rad/s2 per unit, the vehicle file says "
        f"{expected.control_power:+.3g}"
    )
    numbers = {
        "control_power": FindingQuantity(power.value, "rad/s2"),
        "expected": FindingQuantity(expected.control_power, "rad/s2"),
    }
    if ratio < 0.0:
        remedy = (
            f"turn the sign of the column of {name}, or that of its derivatives in the vehicle file"
        )
        return [
            RecordFinding(
                name,
                Kind.SIGN,
                Certainty.CERTAIN,
                f"has the sign turned: {text}",
                remedy,
                numbers=numbers,
            )
        ]
    if (
        expected.angular_control
        and 1.0 / CONTROL_POWER_FACTOR < ratio * DEGREES < CONTROL_POWER_FACTOR
    ):
        remedy = f"name the column {name}_deg, or say its unit in a channel map"
        return [
            RecordFinding(
                name,
                Kind.UNIT,
                Certainty.CERTAIN,
                f"is in deg, not in rad: {text}",
                remedy,
                numbers=numbers,
            )
        ]
    return []


def _contradicted(columns: KinematicColumns, power: float) -> bool:
    """Return whether the control power has the other sign with nz in place of alpha."""
    without = replace(
        columns,
        outputs={name: values for name, values in columns.outputs.items() if name != "alpha"},
    )
    other = control_power(without) if "alpha" in columns.outputs else None
    return other is not None and other.value * power < 0.0


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"


# ---- The raw look at a record

ORDER = (Certainty.CERTAIN, Certainty.LIKELY, Certainty.COSTS_INFORMATION, Certainty.NOTED)


def inspect(record: Record, expected: Expectations | None = None) -> tuple[RecordFinding, ...]:
    """Return the findings in the raw columns of a record, the certain ones first.

    Parameters
    ----------
    record : as it was read, before anything is done to it; SI and radians, nz in g.
    expected : what it is compared with beside itself; None: itself alone.

    A few tens of milliseconds for a thousand rows of four channels. No finding is raised as an
    error; what follows from one is the caller's.
    """
    expected = expected or Expectations()
    over = expected.gravity / expected.airspeed if expected.airspeed else None
    outputs = [
        series_of(record, channel)
        for channel in record.outputs
        if np.count_nonzero(channel.valid) >= FEWEST_SAMPLES
    ]
    inputs = [series_of(record, channel) for channel in record.inputs]
    masked: dict[str, np.ndarray] = {}
    result = missing_rows(record) if len(record) >= FEWEST_SAMPLES else []
    for series in outputs:
        others = [other for other in outputs if other is not series]
        result += _samples(series, others, inputs, len(record), masked)
    for series in inputs:
        result += [
            *dropouts(series, len(record), is_input=True),
            *clipped(series, len(record), is_input=True),
        ]
        filled = interpolated(series, len(record), is_input=True)
        result += [filled] if filled is not None else []
    limited = [one for series in inputs if (one := band_limited(series)) is not None]
    result += limited
    clean = _without(record, masked)
    whole = [
        series_of(clean, clean[series.name])
        for series in outputs
        if not _mostly(masked.get(series.name))
    ]
    for series in whole:
        others = [other for other in whole if other is not series]
        looked = (
            coarse(series),
            changing_noise(series, len(record), inputs, others),
            hum(series, inputs),
            _band_limited(series, limited),
        )
        result += [one for one in looked if one is not None]
    result += zero_steps(
        [series for series in whole if series.least_bit <= 2.0 * max(series.noise, 1e-300)],
        inputs,
        masked,
        over,
    )
    if expected.aircraft:
        result += misread(clean, expected)
    result += height_unit(clean, expected)
    return tuple(sorted(result, key=lambda one: ORDER.index(one.certainty)))


def _samples(
    series: Series,
    others: Sequence[Series],
    inputs: Sequence[Series],
    count: int,
    masked: dict[str, np.ndarray],
) -> list[RecordFinding]:
    """Return the findings that mask samples of one channel; a sample is masked once."""
    taken = np.zeros(count, dtype=bool)
    out = dropouts(series, count)
    for one in out:
        taken |= one.mask
    hold = held_samples(series, count) if not out else None
    filled = interpolated(series, count, inputs) if not out and hold is None else None
    lower_rate = hold or filled
    if lower_rate is not None:
        out.append(lower_rate)
        taken |= lower_rate.mask
    else:
        for one in clipped(series, count):
            out.append(one)
            taken |= one.mask
        still = stuck(series, others, inputs, count, taken)
        if still is not None:
            out.append(still)
            taken |= still.mask
    masked[series.name] = taken
    return out


def _band_limited(series: Series, inputs: Sequence[RecordFinding]) -> RecordFinding | None:
    """Return an output's end of the spectrum, unless that of an input explains it: a motion without
    noise ends where what excites it does.
    """
    result = band_limited(series)
    return (
        None
        if result is None
        or any(
            0.5 < one.numbers["cutoff"].value / result.numbers["cutoff"].value < 2.0
            for one in inputs
        )
        else result
    )


def _mostly(mask: np.ndarray | None) -> bool:
    """Whether so many samples are masked that the rest is no longer sampled as the record is."""
    return mask is not None and bool(np.mean(mask) > 0.1)


def _without(record: Record, masked: dict[str, np.ndarray]) -> Record:
    """Return the record less its masked samples."""
    if not any(np.any(mask) for mask in masked.values()):
        return record
    outputs = tuple(
        replace(channel, valid=channel.valid & ~masked[channel.name])
        if np.any(masked.get(channel.name, False))
        else channel
        for channel in record.outputs
    )
    return replace(record, outputs=outputs)
