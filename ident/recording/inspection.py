"""The record check: searches the raw columns for faults, misread columns and a wrong time base
included.

Columns are compared as read and as each simple fault would require; the measure is the share of the
motion that the kinematics leave unexplained. Sound sensors leave a tenth or less, also with the
sensor effects of the library. Rough air may leave half, but then no other reading is better. A
misread column leaves a third to all; its correct reading leaves a hundredth.
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
    fitted_gravity_over_speed,
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

# ---- A time base with a gross scale error

# smallest unexplained share that suggests a wrong clock (0.2 at twice the rate)
SUSPECT_CLOCK_SHARE = 0.12
CORRECT_CLOCK_SHARE = 0.06  # largest unexplained share of a correct clock
CLOCK_IMPROVEMENT_RATIO = 4.0  # smallest ratio of the unexplained shares, as read to corrected
# smallest error, in octaves: smaller ones may be a sensor's scale, and are left to the fit
GROSS_CLOCK_ERROR = 0.7
RATES_PER_OCTAVE = 4  # clock rates tried in an octave
SEARCHED_OCTAVES = 4
# largest |ln| of a ratio of control powers: starting values and effects differ by a factor of two
PLAUSIBLE_LOG_RATIO = 0.7


def wrong_clock(
    columns: KinematicColumns, as_read: float, expected: Expectations
) -> RecordFinding | None:
    """Return the finding of a wrong time base; None where time is right.

    It is certain if the control power, or the pitch attitude, excludes a sensor's scale error; else
    likely.
    """
    factors = [
        2.0 ** (step / RATES_PER_OCTAVE)
        for step in range(
            -RATES_PER_OCTAVE * SEARCHED_OCTAVES, RATES_PER_OCTAVE * SEARCHED_OCTAVES + 1
        )
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
    # Attitude excludes a scale of alpha. A scale of the pitch rate looks like a wrong clock, except
    # in nz.
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
    """Return whether the control power agrees with the vehicle file only if the clock is corrected:
    accelerations change with the square of the factor.
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


# ---- Mislabelled columns

# Between the observed extremes: effects of the library leave at most 0.12, a wrong column at least
# 0.28; small motions leave 0.1 by their noise.
WRONG_COLUMN_SHARE = 0.2  # unexplained share from which a column is wrong
CORRECT_COLUMN_SHARE = 0.15  # largest unexplained share of a correct column
CORRECT_EXCHANGE_SHARE = 0.1  # the same for an exchange with the control
READING_IMPROVEMENT_RATIO = 4.0  # smallest ratio of the unexplained shares, as read to corrected
# largest ratio to the vehicle file's control power: effects change it by 2, degrees by 57
CONTROL_POWER_FACTOR = 3.0
# Correlation of the changes of nz and alpha: at least 0.88 with any effect of the library.
AGREEING_CORRELATION = 0.85  # smallest correlation of channels that agree
DISAGREEING_CORRELATION = 0.7  # largest correlation of channels that disagree
# Rows of a lag. With two, the motion has four samples a period: one of 600 sound records was then
# read as if its time were in ms.
FEWEST_ROWS_PER_LAG = 3
# threshold of twice the log likelihood ratio, for a significance of 0.001
SIGNIFICANT_RATIO = -2.0 * math.log(1e-3)
# angles that are small in linear equations of motion
SMALL_ANGLES = ("alpha", "elevator", "beta", "aileron", "rudder")
LARGEST_ANGLE = 1.5  # rad, largest deviation of an angle from its median
ANGLE_PERCENTILE = 99.0  # percentile of the samples that must be within
# range of the median of nz in m/s2 (level flight, gentle climbs, dives and turns)
LEVEL_FLIGHT_RANGE = (9.0, 10.7)
LARGEST_ALPHA_RANGE = 0.6  # rad, largest peak-to-peak angle of attack


def misread(record: Record, expected: Expectations) -> list[RecordFinding]:
    """Return the certainly or probably mislabelled columns; empty if all are consistent or no
    relation between them exists.
    """
    far = [
        one
        for name in SMALL_ANGLES
        if name in (*record.input_names, *record.output_names)
        and (one := large_angle(record[name])) is not None
    ]
    far += [
        one
        for name in ("nz",)
        if name in record.output_names
        and (one := _load_factor_unit_finding(record[name])) is not None
    ]
    columns = columns_of(record, expected)
    if columns is None:
        return far
    result = _column_findings(columns, expected)
    if far and not any(one.kind is Kind.EXCHANGED for one in result):
        return far
    return (
        [_as_az_finding(one) for one in result]
        if "az" in record.output_names and "nz" not in record.output_names
        else result
    )


def _column_findings(columns: KinematicColumns, expected: Expectations) -> list[RecordFinding]:
    shares = disagreement(columns)
    as_read = max(shares.values(), default=0.0)
    result = _lift_finding(columns, as_read) or _degrees_finding(columns, as_read)
    if result is None and as_read > SUSPECT_CLOCK_SHARE:
        result = _best_reading_finding(columns, as_read, expected)
    if result is not None:
        return [result]
    return _control_finding(columns, expected) if shares and as_read <= WRONG_COLUMN_SHARE else []


def _as_az_finding(finding: RecordFinding) -> RecordFinding:
    """Return a finding on nz in terms of az, its source column; nz in m/s2 means az multiplied by
    g0 once too often.
    """
    if finding.kind is Kind.UNIT and finding.channel == "nz":
        return replace(finding, channel="az", remedy="check the unit of az: m/s2 is meant")
    channel, sentence, remedy = (
        re.sub(r"\bnz\b", "az", text)
        for text in (finding.channel, finding.sentence, finding.remedy)
    )
    return replace(finding, channel=channel, sentence=sentence, remedy=remedy)


SERVO_PULSES = (600.0, 2400.0)  # us, shortest and longest
LEVEL_PULSES = (1200.0, 1800.0)  # us, of a surface most of the time


def large_angle(channel: Channel) -> RecordFinding | None:
    """Return a finding if a flow angle or control moves too far to be in radians."""
    values = channel.values[channel.valid]
    reach = (
        float(np.percentile(np.abs(values - np.median(values)), ANGLE_PERCENTILE))
        if len(values)
        else 0.0
    )
    if reach <= LARGEST_ANGLE:
        return None
    text = f"moves by {reach:.3g} rad ({math.degrees(reach):.3g} deg)"
    remedy = f"if the column is in degrees, name it {channel.name}_deg or say so in a channel map"
    lowest, middle, highest = np.percentile(values, (1.0, 50.0, 99.0))
    level = LEVEL_PULSES[0] < middle < LEVEL_PULSES[1]
    if SERVO_PULSES[0] < lowest and level and highest < SERVO_PULSES[1]:
        text = f"looks like servo pulses in us ({lowest:.4g} to {highest:.4g}), not radians"
        remedy = (
            f'make an angle of them in a channel map: {channel.name} = "pwm(COLUMN, 1500, 573)" '
            "(the pulse at zero, and us per radian)"
        )
    return RecordFinding(
        channel.name,
        Kind.UNIT,
        Certainty.CERTAIN,
        text,
        remedy,
        numbers={"reach": FindingQuantity(reach, "rad")},
    )


def _load_factor_unit_finding(channel: Channel) -> RecordFinding | None:
    """Return a finding if the median of a load factor is near 9.8: it is in m/s2."""
    middle = float(np.median(channel.values[channel.valid]))
    if not LEVEL_FLIGHT_RANGE[0] < abs(middle) < LEVEL_FLIGHT_RANGE[1]:
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


def _lift_finding(columns: KinematicColumns, as_read: float) -> RecordFinding | None:
    """Return a finding if nz has the wrong sign or is exchanged with the control, by its
    correlation with alpha; the kinematics must agree.
    """
    y = columns.outputs
    if not {"alpha", "q", "nz"} <= set(y):
        return None
    lag, step = lag_of(columns), float(np.median(np.diff(columns.time)))
    alpha = change(y["alpha"], lag)
    shifts = sorted({min(round(shift / step), len(alpha) // 4) for shift in SHIFTS})

    def goes_with_alpha(values: np.ndarray) -> float:
        """Return the largest correlation of the changes, over shifts (``SHIFTS``) of either."""
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
        or READING_IMPROVEMENT_RATIO * other > as_read
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


def _degrees_finding(columns: KinematicColumns, as_read: float) -> RecordFinding | None:
    """Return a finding if all angles are in degrees: consistent with each other, not with nz, and
    large.
    """
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
    if other > CORRECT_CLOCK_SHARE or READING_IMPROVEMENT_RATIO * other > as_read:
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


def _best_reading_finding(
    columns: KinematicColumns, as_read: float, expected: Expectations
) -> RecordFinding | None:
    readings = sorted(
        (one for one in all_readings(columns) if one.left < _largest_correct_share(one, columns)),
        key=lambda one: one.left,
    )
    best = readings[0] if readings else None
    if (
        best is not None
        and as_read > WRONG_COLUMN_SHARE
        and best.left * READING_IMPROVEMENT_RATIO < as_read
    ):
        near = [
            best,
            *(one for one in readings[1:] if one.left < READING_IMPROVEMENT_RATIO * best.left),
        ]
        possible = [
            one for one in near if _implausible_as_read(one, columns, expected) is not False
        ]
        if not possible:
            return _airspeed_finding(columns, as_read, expected) or wrong_clock(
                columns, as_read, expected
            )
        best, rivals = (
            _rivals_by_control(possible, expected) if len(possible) > 1 else (possible[0], [])
        )
        numbers = {
            "unexplained": FindingQuantity(as_read, "1"),
            "unexplained_otherwise": FindingQuantity(best.left, "1"),
        }
        units = re.fullmatch(r"is in (\S+), not in (\S+)", best.sentence)
        changed, read = (f"in {units[1]}", f"in {units[2]}") if units else ("so", "as read")
        what = (
            f"{best.sentence}: {read} {_percent(as_read)} of the motion does not fit the other "
            f"channels, {changed} {_percent(best.left)}"
        )
        if best.kind is Kind.UNIT and best.channel == "nz" and not rivals:
            airspeed = _airspeed_finding(columns, as_read, expected, best)
            if airspeed is not None:
                return airspeed
        # Without alpha, nz replaces it. An accelerometer off the centre of gravity spoils that;
        # only a sign is still certain.
        plain = ("alpha" in columns.outputs or best.kind is Kind.SIGN) and lag_of(
            columns
        ) >= FEWEST_ROWS_PER_LAG
        shown = _implausible_as_read(best, columns, expected) is not None
        certainty = Certainty.CERTAIN if plain and shown else Certainty.LIKELY
        if rivals:
            what += f"; or {' or '.join(f'{one.channel} {one.sentence}' for one in rivals[:2])}"
        return RecordFinding(best.channel, best.kind, certainty, what, best.remedy, numbers=numbers)
    return _airspeed_finding(columns, as_read, expected) or wrong_clock(columns, as_read, expected)


def _airspeed_finding(
    columns: KinematicColumns,
    as_read: float,
    expected: Expectations,
    unit: ColumnReading | None = None,
) -> RecordFinding | None:
    """Return a finding if alpha, q and nz fit at another airspeed than that of the vehicle file.

    In alpha_dot = q - (g/V) (nz - nz_0), a wrong V is the same as a wrong factor of nz: both are
    named, the reading of nz in another ``unit`` with its words. Without one it may be the scale of
    the sensor, a warning.
    """
    over = fitted_gravity_over_speed(columns)
    if expected.airspeed is None or over is None:
        return None
    left = max(disagreement(replace(columns, gravity_over_speed=over)).values(), default=2.0)
    if left >= CORRECT_COLUMN_SHARE or left * READING_IMPROVEMENT_RATIO >= as_read:
        return None
    fits = expected.gravity / over
    what = (
        f"does not fit alpha and q at {expected.airspeed:.4g} m/s: the kinematics leave "
        f"{_percent(as_read)} of the motion unexplained; at {fits:.3g} m/s {_percent(left)}"
    )
    remedy = "check the airspeed of the vehicle file, or the unit and scale of nz"
    if unit is not None:
        what += f"; or it {unit.sentence}"
        remedy = f"check the airspeed of the vehicle file; if it is right, {unit.remedy}"
    return RecordFinding(
        "nz",
        Kind.UNIT,
        Certainty.LIKELY if unit is None else Certainty.CERTAIN,
        what,
        remedy,
        numbers={
            "unexplained": FindingQuantity(as_read, "1"),
            "unexplained_otherwise": FindingQuantity(left, "1"),
            "airspeed": FindingQuantity(fits, "m/s"),
        },
    )


def _implausible_as_read(
    reading: ColumnReading, columns: KinematicColumns, expected: Expectations
) -> bool | None:
    """Return whether evidence other than the kinematics also contradicts the columns as read; None
    without such evidence.

    Kinematics alone do not prove an exchange: sensor faults and gusts disturb them too, and
    feedback makes an elevator resemble a measured output. The law of lift tests alpha, nz and the
    control; the pitch acceleration tests the pitch rate and the control.
    """
    names, exchange = set(reading.channel.split(" and ")), reading.kind is Kind.EXCHANGED
    if not exchange and reading.kind is not Kind.SIGN:
        return True
    lift = unexplained_lift(columns)
    # exchanging alpha and nz leaves the law of lift unchanged
    if lift is not None and names & {"alpha", "nz"} and names != {"alpha", "nz"}:
        return _likelier(lift, unexplained_lift(reading.columns))
    by_control = exchange and columns.control_name in names
    if not by_control and "q" not in names:
        return True
    (here, power), (there, other) = (
        _control_power_agrees(some, expected) for some in (columns, reading.columns)
    )
    if here is not None and there is not None and here is not there:
        return there
    if not by_control:
        return True
    if power is None or other is None or "q" not in names:
        return None
    count = len(columns.time) / lag_of(columns)
    return _likelier((1.0 - power.explained, count), (1.0 - other.explained, count))


def _control_power_agrees(
    columns: KinematicColumns, expected: Expectations
) -> tuple[bool | None, ControlPower | None]:
    """Return whether the control power agrees with the vehicle file (None if unreliable), and that
    power.
    """
    power = control_power(columns)
    if power is None or not sure(power) or not expected.control_power:
        return None, power
    return _power_agrees(power.value, expected), power


def _power_agrees(power: float, expected: Expectations) -> bool:
    """Return whether a control power agrees with the vehicle file, in sign alone if its unit is
    unknown.
    """
    ratio = power / expected.control_power if expected.control_power else 0.0
    return 1.0 / CONTROL_POWER_FACTOR < ratio < CONTROL_POWER_FACTOR or (
        ratio > 0.0 and not expected.angular_control
    )


def _likelier(before: tuple[float, float] | None, after: tuple[float, float] | None) -> bool:
    """Return whether the second unexplained share is significantly smaller; each share comes with
    its number of independent samples.
    """
    if before is None or after is None:
        return False
    return (
        min(before[1], after[1])
        * math.log(max(before[0], POWER_FLOOR) / max(after[0], POWER_FLOOR))
        > SIGNIFICANT_RATIO
    )


def _largest_correct_share(reading: ColumnReading, columns: KinematicColumns) -> float:
    """Return the largest unexplained share of a correct reading. It is smaller for an exchange with
    a control, since feedback makes a control resemble an output.
    """
    return (
        CORRECT_EXCHANGE_SHARE
        if reading.kind is Kind.EXCHANGED and columns.control_name in reading.channel.split(" and ")
        else CORRECT_COLUMN_SHARE
    )


def _rivals_by_control(
    rivals: Sequence[ColumnReading], expected: Expectations
) -> tuple[ColumnReading, list[ColumnReading]]:
    """Return the first reading and its rivals, reduced to those whose control power agrees with the
    vehicle file if there are any.
    """
    if expected.control_power is None:
        return rivals[0], list(rivals[1:])
    fitting = []
    for one in rivals:
        if _control_power_agrees(one.columns, expected)[0]:
            fitting.append(one)
    kept = fitting or list(rivals)
    return kept[0], kept[1:]


def _control_finding(columns: KinematicColumns, expected: Expectations) -> list[RecordFinding]:
    """Return a finding if the sign or unit of a control contradicts the vehicle file."""
    if expected.control_power is None or not expected.control_power:
        return []
    power = control_power(columns)
    if power is None or not sure(power) or _nz_contradicts(columns, power.value):
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


def _nz_contradicts(columns: KinematicColumns, power: float) -> bool:
    """Return whether nz in place of alpha gives a control power of the other sign."""
    without = replace(
        columns,
        outputs={name: values for name, values in columns.outputs.items() if name != "alpha"},
    )
    other = control_power(without) if "alpha" in columns.outputs else None
    return other is not None and other.value * power < 0.0


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"


# ---- The record check

ORDER = (Certainty.CERTAIN, Certainty.LIKELY, Certainty.COSTS_INFORMATION, Certainty.NOTED)


def inspect(record: Record, expected: Expectations | None = None) -> tuple[RecordFinding, ...]:
    """Return the findings in the raw columns of a record, the certain ones first.

    Parameters
    ----------
    record : as it was read, before anything is done to it; SI and radians, nz in g.
    expected : known values to compare with; None compares the record's channels only.

    Takes a few tens of milliseconds for a thousand rows of four channels. Findings never raise an
    error; the caller decides.
    """
    expected = expected or Expectations()
    gravity_over_speed = expected.gravity / expected.airspeed if expected.airspeed else None
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
        result += _sample_findings(series, others, inputs, len(record), masked)
    for series in inputs:
        result += [
            *dropouts(series, len(record), is_input=True),
            *clipped(series, len(record), is_input=True),
        ]
        filled = interpolated(series, len(record), is_input=True)
        result += [filled] if filled is not None else []
    limited = [one for series in inputs if (one := band_limited(series)) is not None]
    result += limited
    clean = _without_masked(record, masked)
    whole = [
        series_of(clean, clean[series.name])
        for series in outputs
        if not _mostly_masked(masked.get(series.name))
    ]
    for series in whole:
        others = [other for other in whole if other is not series]
        looked = (
            coarse(series),
            changing_noise(series, len(record), inputs, others),
            hum(series, inputs),
            _band_limit_finding(series, limited),
        )
        result += [one for one in looked if one is not None]
    result += zero_steps(
        [series for series in whole if series.least_bit <= 2.0 * max(series.noise, 1e-300)],
        inputs,
        masked,
        gravity_over_speed,
    )
    if expected.aircraft:
        result += misread(clean, expected)
    result += height_unit(clean, expected)
    return tuple(sorted(result, key=lambda one: ORDER.index(one.certainty)))


def _sample_findings(
    series: Series,
    others: Sequence[Series],
    inputs: Sequence[Series],
    count: int,
    masked: dict[str, np.ndarray],
) -> list[RecordFinding]:
    """Return the findings that mask samples of one channel; no sample is masked twice."""
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


def _band_limit_finding(series: Series, inputs: Sequence[RecordFinding]) -> RecordFinding | None:
    """Return the finding of a band-limited output, unless an input has about the same cutoff: a
    motion without noise has the bandwidth of its excitation.
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


def _mostly_masked(mask: np.ndarray | None) -> bool:
    """Return whether more than a tenth of the samples is masked."""
    return mask is not None and bool(np.mean(mask) > 0.1)


def _without_masked(record: Record, masked: dict[str, np.ndarray]) -> Record:
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
