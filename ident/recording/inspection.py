"""The record check: searches the raw columns for faults, misread columns and a wrong time base
included.

The columns are compared as they were read and as each simple mistake would require. The measure is
the share of the motion that the kinematics leave unexplained. It is a tenth or less for correct
columns, also with the sensor effects of the library. It may be a half in rough air, but then no
other reading is better. It is a third to all for a misread column, and a hundredth for its correct
reading.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.recording.distorted_channels import band_limited, clipped, hum, zero_steps
from ident.recording.interpolation import interpolated
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

# smallest unexplained share that suggests a wrong clock (one at twice the rate gives 0.2)
SUSPECT_CLOCK_SHARE = 0.12
CORRECT_CLOCK_SHARE = 0.06  # largest unexplained share of a correct clock
# smallest ratio of the unexplained shares, as read over corrected
CLOCK_IMPROVEMENT_RATIO = 4.0
# smallest error of a clock, in octaves: a smaller one may be the scale of a sensor
GROSS_CLOCK_ERROR = 0.7
RATES_PER_OCTAVE = 4  # clock rates that are tried in an octave
SEARCHED_OCTAVES = 4  # octaves that are searched below and above the rate as read
# largest |ln| of the estimated over the declared control power: declared values may be wrong by a
# factor of two
PLAUSIBLE_LOG_RATIO = 0.7


def wrong_clock(
    columns: KinematicColumns, as_read: float, expected: Expectations
) -> RecordFinding | None:
    """Return the finding of a wrong time base; None where the time is correct.

    It is certain if the control power or the pitch attitude excludes a scale error of a sensor,
    otherwise likely. ``as_read`` is the unexplained share of the columns as read.
    """
    most_steps = RATES_PER_OCTAVE * SEARCHED_OCTAVES
    factors = [
        2.0 ** (step / RATES_PER_OCTAVE) for step in range(-most_steps, most_steps + 1) if step
    ]
    shares = {
        factor: max(disagreement(columns.times({"time": factor})).values()) for factor in factors
    }
    best = min(shares, key=lambda factor: shares[factor])
    if (
        shares[best] > CORRECT_CLOCK_SHARE
        or shares[best] * CLOCK_IMPROVEMENT_RATIO > as_read
        or abs(math.log2(best)) < GROSS_CLOCK_ERROR
    ):
        return None
    numbers = {
        "factor": FindingQuantity(best, "1"),
        "unexplained": FindingQuantity(as_read, "1"),
        "unexplained_otherwise": FindingQuantity(shares[best], "1"),
    }
    sentence = (
        f"disagrees with the kinematics: they hold if time runs {best:.2g} times as long as the "
        "column says"
    )
    # The attitude excludes a scale error of alpha. A scale error of the pitch rate has the effect
    # of a wrong clock in all relations but that of nz.
    attitude = {"theta", "alpha"} <= set(columns.outputs)
    by_rate = min(max(disagreement(columns.times({"q": factor})).values()) for factor in factors)
    if (attitude and CLOCK_IMPROVEMENT_RATIO * shares[best] < by_rate) or _control_agrees(
        columns, best, expected
    ):
        return RecordFinding(
            "time",
            Kind.TIME_BASE,
            Certainty.CERTAIN,
            sentence,
            "mend the time column, or say its unit in a channel map",
            numbers=numbers,
        )
    sentence += (
        f", or if the {'pitch rate' if attitude else 'angle of attack'} has a scale of its own"
    )
    return RecordFinding(
        "time",
        Kind.TIME_BASE,
        Certainty.LIKELY,
        sentence,
        "check the sample rate and the units of the columns",
        numbers=numbers,
    )


def _control_agrees(columns: KinematicColumns, factor: float, expected: Expectations) -> bool:
    """Return whether the control power agrees with the vehicle file after the clock is corrected,
    and not before. Accelerations change with the square of the factor.
    """
    if expected.control_power is None or not expected.control_power or not expected.angular_control:
        return False
    log_ratios = []
    for columns_of_clock in (columns, columns.times({"time": factor})):
        power = control_power(columns_of_clock)
        if power is None or not sure(power) or power.value * expected.control_power <= 0.0:
            return False
        log_ratios.append(abs(math.log(power.value / expected.control_power)))
    return log_ratios[1] < min(PLAUSIBLE_LOG_RATIO, 0.5 * log_ratios[0])


# ---- Mislabelled columns

# a column is wrong above this unexplained share: effects of the library leave at most 0.12, the
# noise of small motions 0.1, and a wrong column at least 0.28
WRONG_COLUMN_SHARE = 0.2
CORRECT_COLUMN_SHARE = 0.15  # largest unexplained share of a correct column
CORRECT_EXCHANGE_SHARE = 0.1  # the same after an exchange with the control
# smallest ratio of the unexplained shares, as read over corrected
READING_IMPROVEMENT_RATIO = 4.0
# largest ratio of the estimated and the declared control power: effects change it by a factor of 2,
# degrees by 57
CONTROL_POWER_FACTOR = 3.0
# smallest correlation of the changes of channels that agree: it is at least 0.88 between nz and
# alpha with any effect of the library
AGREEING_CORRELATION = 0.85
DISAGREEING_CORRELATION = 0.7  # largest correlation of the changes of channels that disagree
# fewest samples in a lag of a certain finding: with two, the motion has four samples in a period,
# and one of 600 correct records was taken for one with its time in ms
FEWEST_ROWS_PER_LAG = 3
# threshold of twice the log likelihood ratio, for a significance of 0.001
SIGNIFICANT_RATIO = -2.0 * math.log(1e-3)
# angles that are small in linear equations of motion
SMALL_ANGLES = ("alpha", "elevator", "beta", "aileron", "rudder")
LARGEST_ANGLE = 1.5  # rad, largest deviation of an angle from its median
ANGLE_PERCENTILE = 99.0  # percentile of the deviations that is compared with it
# range of the median of a load in m/s2 (level flight, gentle climbs, dives and turns)
LEVEL_FLIGHT_RANGE = (9.0, 10.7)
LARGEST_ALPHA_RANGE = 0.6  # rad, largest range of an angle of attack


def misread(record: Record, expected: Expectations) -> list[RecordFinding]:
    """Return the findings of columns that are certainly or probably misread; empty if all columns
    are consistent, or no relation joins them.
    """
    names = (*record.input_names, *record.output_names)
    candidates = [large_angle(record[name]) for name in SMALL_ANGLES if name in names]
    if "nz" in record.output_names:
        candidates.append(_load_factor_unit_finding(record["nz"]))
    by_range = [finding for finding in candidates if finding is not None]
    columns = columns_of(record, expected)
    if columns is None:
        return by_range
    findings = _column_findings(columns, expected)
    if by_range and not any(finding.kind is Kind.EXCHANGED for finding in findings):
        return by_range
    if "az" in record.output_names and "nz" not in record.output_names:
        return [_as_az_finding(finding) for finding in findings]
    return findings


def _column_findings(columns: KinematicColumns, expected: Expectations) -> list[RecordFinding]:
    """Return the findings of columns that contradict the kinematics or the vehicle file."""
    shares = disagreement(columns)
    as_read = max(shares.values(), default=0.0)
    finding = _lift_finding(columns, as_read) or _degrees_finding(columns, as_read)
    if finding is None and as_read > SUSPECT_CLOCK_SHARE:
        finding = _best_reading_finding(columns, as_read, expected)
    if finding is not None:
        return [finding]
    return _control_finding(columns, expected) if shares and as_read <= WRONG_COLUMN_SHARE else []


def _as_az_finding(finding: RecordFinding) -> RecordFinding:
    """Return a finding on nz as one on az, its source column. Where nz seems to be in m/s2, az was
    multiplied by g0 once too often.
    """
    if finding.kind is Kind.UNIT and finding.channel == "nz":
        return replace(finding, channel="az", remedy="check the unit of az: m/s2 is meant")
    channel, sentence, remedy = (
        re.sub(r"\bnz\b", "az", text)
        for text in (finding.channel, finding.sentence, finding.remedy)
    )
    return replace(finding, channel=channel, sentence=sentence, remedy=remedy)


SERVO_PULSES = (600.0, 2400.0)  # us, shortest and longest pulse of a servo
LEVEL_PULSES = (1200.0, 1800.0)  # us, range of the median pulse


def large_angle(channel: Channel) -> RecordFinding | None:
    """Return a finding if a flow angle or control moves too far to be in radians."""
    values = channel.values[channel.valid]
    if not len(values):
        return None
    reach = float(np.percentile(np.abs(values - np.median(values)), ANGLE_PERCENTILE))
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
    """Return a finding if the correlation of nz with alpha shows a wrong sign, or an exchange with
    the control, and the kinematics agree.
    """
    y = columns.outputs
    if not {"alpha", "q", "nz"} <= set(y):
        return None
    lag, step = lag_of(columns), float(np.median(np.diff(columns.time)))
    alpha = change(y["alpha"], lag)
    shifts = sorted({min(round(shift / step), len(alpha) // 4) for shift in SHIFTS})

    def correlation_with_alpha(values: np.ndarray) -> float:
        """Return the largest correlation with the changes of alpha, over shifts (``SHIFTS``) of
        either.
        """
        other = change(values, lag)
        correlations = []
        with np.errstate(invalid="ignore"):
            for k in shifts:
                pairs = (
                    (alpha[k:], other[: len(other) - k]),
                    (alpha[: len(alpha) - k], other[k:]),
                )
                correlations += [
                    float(np.nan_to_num(np.corrcoef(first, second)[0, 1]))
                    for first, second in pairs
                ]
        return max(correlations, key=abs)

    correlation = correlation_with_alpha(y["nz"])
    with_sign = max(disagreement(columns.times({"nz": -1.0})).values())
    correct = with_sign < CORRECT_COLUMN_SHARE and with_sign < as_read
    if correlation < -AGREEING_CORRELATION and correct:
        text = (
            f"has the sign turned: it falls when alpha rises (correlation {correlation:.2f}), and "
            "the kinematics hold better with the other sign"
        )
        return RecordFinding(
            "nz",
            Kind.SIGN,
            Certainty.CERTAIN,
            text,
            "turn the sign of the column of nz",
            numbers={"correlation": FindingQuantity(correlation, "1")},
        )
    if (
        columns.control is None
        or correlation > DISAGREEING_CORRELATION
        or correlation_with_alpha(columns.control) < AGREEING_CORRELATION
    ):
        return None
    exchanged = columns.exchanged("nz", columns.control_name)
    exchanged_share = max(disagreement(exchanged).values())
    if (
        exchanged_share > CORRECT_COLUMN_SHARE
        or READING_IMPROVEMENT_RATIO * exchanged_share > as_read
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
        numbers={"correlation": FindingQuantity(correlation, "1")},
    )


def _degrees_finding(columns: KinematicColumns, as_read: float) -> RecordFinding | None:
    """Return a finding if all angles are in degrees: they are large, and consistent with each other
    but not with nz.
    """
    names = [name for name in columns.outputs if name in UNITS]
    if (
        "alpha" not in names
        or len(names) < 2
        or "nz" not in columns.outputs
        or float(np.ptp(columns.outputs["alpha"])) < LARGEST_ALPHA_RANGE
    ):
        return None
    share_in_degrees = max(
        disagreement(columns.times({name: 1.0 / DEGREES for name in names})).values(),
        default=math.inf,
    )
    if (
        share_in_degrees > CORRECT_CLOCK_SHARE
        or READING_IMPROVEMENT_RATIO * share_in_degrees > as_read
    ):
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
    """Return the finding of the best other reading of the columns, of a wrong airspeed or of a
    wrong time base; None without any.
    """
    readings = sorted(
        (
            reading
            for reading in all_readings(columns)
            if reading.left < _largest_correct_share(reading, columns)
        ),
        key=lambda reading: reading.left,
    )
    best = readings[0] if readings else None
    if (
        best is not None
        and as_read > WRONG_COLUMN_SHARE
        and best.left * READING_IMPROVEMENT_RATIO < as_read
    ):
        near = [
            best,
            *(
                reading
                for reading in readings[1:]
                if reading.left < READING_IMPROVEMENT_RATIO * best.left
            ),
        ]
        possible = [
            reading
            for reading in near
            if _implausible_as_read(reading, columns, expected) is not False
        ]
        if not possible:
            return _airspeed_finding(columns, as_read, expected) or wrong_clock(
                columns, as_read, expected
            )
        best = possible[0]
        rivals: list[ColumnReading] = []
        if len(possible) > 1:
            best, rivals = _rivals_by_control(possible, expected)
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
        # Without alpha, nz takes its place. This is wrong for an accelerometer away from the centre
        # of gravity, and only a finding of a sign is then certain.
        reliable = "alpha" in columns.outputs or best.kind is Kind.SIGN
        resolved = lag_of(columns) >= FEWEST_ROWS_PER_LAG
        confirmed = _implausible_as_read(best, columns, expected) is not None
        certain = reliable and resolved and confirmed
        certainty = Certainty.CERTAIN if certain else Certainty.LIKELY
        if rivals:
            others = [f"{rival.channel} {rival.sentence}" for rival in rivals[:2]]
            what += f"; or {' or '.join(others)}"
        return RecordFinding(best.channel, best.kind, certainty, what, best.remedy, numbers=numbers)
    return _airspeed_finding(columns, as_read, expected) or wrong_clock(columns, as_read, expected)


def _airspeed_finding(
    columns: KinematicColumns,
    as_read: float,
    expected: Expectations,
    unit: ColumnReading | None = None,
) -> RecordFinding | None:
    """Return a finding if alpha, q and nz agree at another airspeed than that of the vehicle file.

    In alpha_dot = q - (g/V) (nz - nz_0), a wrong airspeed V has the same effect as a wrong factor
    of nz. The finding names both. It is certain where ``unit`` is the reading of nz in another
    unit, and otherwise likely, since the scale of the sensor may be wrong.
    """
    gravity_over_speed = fitted_gravity_over_speed(columns)
    if expected.airspeed is None or gravity_over_speed is None:
        return None
    share = max(
        disagreement(replace(columns, gravity_over_speed=gravity_over_speed)).values(), default=2.0
    )
    if share >= CORRECT_COLUMN_SHARE or share * READING_IMPROVEMENT_RATIO >= as_read:
        return None
    fitted_airspeed = expected.gravity / gravity_over_speed
    what = (
        f"does not fit alpha and q at {expected.airspeed:.4g} m/s: the kinematics leave "
        f"{_percent(as_read)} of the motion unexplained; at {fitted_airspeed:.3g} m/s "
        f"{_percent(share)}"
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
            "unexplained_otherwise": FindingQuantity(share, "1"),
            "airspeed": FindingQuantity(fitted_airspeed, "m/s"),
        },
    )


def _implausible_as_read(
    reading: ColumnReading, columns: KinematicColumns, expected: Expectations
) -> bool | None:
    """Return whether evidence other than the kinematics also contradicts the columns as read; None
    without further evidence.

    The kinematics alone do not prove an exchange or a sign. Sensor faults and gusts disturb them
    too, and feedback makes an elevator similar to a measured output. The relation of lift tests
    alpha, nz and the control. The pitch acceleration tests the pitch rate and the control.
    """
    names, exchange = set(reading.channel.split(" and ")), reading.kind is Kind.EXCHANGED
    if not exchange and reading.kind is not Kind.SIGN:
        return True
    lift = unexplained_lift(columns)
    # an exchange of alpha and nz does not change the relation of lift
    if lift is not None and names & {"alpha", "nz"} and names != {"alpha", "nz"}:
        return _likelier(lift, unexplained_lift(reading.columns))
    by_control = exchange and columns.control_name in names
    if not by_control and "q" not in names:
        return True
    agrees_as_read, power_as_read = _control_power_agrees(columns, expected)
    agrees, power = _control_power_agrees(reading.columns, expected)
    if agrees_as_read is not None and agrees is not None and agrees_as_read is not agrees:
        return agrees
    if not by_control:
        return True
    if power_as_read is None or power is None or "q" not in names:
        return None
    count = len(columns.time) / lag_of(columns)
    return _likelier((1.0 - power_as_read.explained, count), (1.0 - power.explained, count))


def _control_power_agrees(
    columns: KinematicColumns, expected: Expectations
) -> tuple[bool | None, ControlPower | None]:
    """Return whether the control power agrees with the vehicle file (None if it is unreliable), and
    the control power.
    """
    power = control_power(columns)
    if power is None or not sure(power) or not expected.control_power:
        return None, power
    return _power_agrees(power.value, expected), power


def _power_agrees(power: float, expected: Expectations) -> bool:
    """Return whether a control power agrees with the vehicle file; only its sign must agree if the
    unit of the control is unknown.
    """
    ratio = power / expected.control_power if expected.control_power else 0.0
    if not expected.angular_control and ratio > 0.0:
        return True
    return 1.0 / CONTROL_POWER_FACTOR < ratio < CONTROL_POWER_FACTOR


def _likelier(before: tuple[float, float] | None, after: tuple[float, float] | None) -> bool:
    """Return whether the unexplained share ``after`` is significantly smaller than ``before``. Each
    is a share with its number of independent samples.
    """
    if before is None or after is None:
        return False
    (share_before, count_before), (share_after, count_after) = before, after
    log_ratio = math.log(max(share_before, POWER_FLOOR) / max(share_after, POWER_FLOOR))
    return min(count_before, count_after) * log_ratio > SIGNIFICANT_RATIO


def _largest_correct_share(reading: ColumnReading, columns: KinematicColumns) -> float:
    """Return the largest unexplained share of a correct reading. It is smaller for an exchange with
    a control, since feedback makes a control similar to an output.
    """
    names = reading.channel.split(" and ")
    if reading.kind is Kind.EXCHANGED and columns.control_name in names:
        return CORRECT_EXCHANGE_SHARE
    return CORRECT_COLUMN_SHARE


def _rivals_by_control(
    rivals: Sequence[ColumnReading], expected: Expectations
) -> tuple[ColumnReading, list[ColumnReading]]:
    """Return the first reading and its rivals. Where the control power of some readings agrees with
    the vehicle file, only these are kept.
    """
    if expected.control_power is None:
        return rivals[0], list(rivals[1:])
    agreeing = [
        reading for reading in rivals if _control_power_agrees(reading.columns, expected)[0]
    ]
    kept = agreeing or list(rivals)
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
    """Return whether the control power has the other sign when nz takes the place of alpha."""
    without_alpha = replace(
        columns,
        outputs={name: values for name, values in columns.outputs.items() if name != "alpha"},
    )
    other = control_power(without_alpha) if "alpha" in columns.outputs else None
    return other is not None and other.value * power < 0.0


def _percent(share: float) -> str:
    """Return a share as text in percent."""
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"


# ---- The record check

# order of the findings
ORDER = (Certainty.CERTAIN, Certainty.LIKELY, Certainty.COSTS_INFORMATION, Certainty.NOTED)


def inspect(record: Record, expected: Expectations | None = None) -> tuple[RecordFinding, ...]:
    """Return the findings in the raw columns of a record, the certain ones first.

    Parameters
    ----------
    record : the record as it was read, in SI units and radians, with nz in g.
    expected : known values of the aircraft; None compares the channels with each other only.
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
    findings = missing_rows(record) if len(record) >= FEWEST_SAMPLES else []
    for series in outputs:
        others = [other for other in outputs if other is not series]
        findings += _sample_findings(series, others, inputs, len(record), masked)
    for series in inputs:
        findings += [
            *dropouts(series, len(record), is_input=True),
            *clipped(series, len(record), is_input=True),
        ]
        interpolation = interpolated(series, len(record), is_input=True)
        findings += [interpolation] if interpolation is not None else []
    band_limits = [finding for series in inputs if (finding := band_limited(series)) is not None]
    findings += band_limits
    clean = _without_masked(record, masked)
    usable = [
        series_of(clean, clean[series.name])
        for series in outputs
        if not _mostly_masked(masked.get(series.name))
    ]
    for series in usable:
        others = [other for other in usable if other is not series]
        candidates = (
            coarse(series),
            changing_noise(series, len(record), inputs, others),
            hum(series, inputs),
            _band_limit_finding(series, band_limits),
        )
        findings += [finding for finding in candidates if finding is not None]
    findings += zero_steps(
        [series for series in usable if series.least_bit <= 2.0 * max(series.noise, 1e-300)],
        inputs,
        masked,
        gravity_over_speed,
    )
    if expected.aircraft:
        findings += misread(clean, expected)
    findings += height_unit(clean, expected)
    return tuple(sorted(findings, key=lambda finding: ORDER.index(finding.certainty)))


def _sample_findings(
    series: Series,
    others: Sequence[Series],
    inputs: Sequence[Series],
    count: int,
    masked: dict[str, np.ndarray],
) -> list[RecordFinding]:
    """Return the findings on wrong samples of one channel, and store their mask in ``masked``. No
    sample is in two findings.
    """
    mask = np.zeros(count, dtype=bool)
    findings = dropouts(series, count)
    for finding in findings:
        mask |= finding.mask
    hold = held_samples(series, count) if not findings else None
    interpolation = interpolated(series, count, inputs) if not findings and hold is None else None
    lower_rate = hold or interpolation
    if lower_rate is not None:
        findings.append(lower_rate)
        mask |= lower_rate.mask
    else:
        for finding in clipped(series, count):
            findings.append(finding)
            mask |= finding.mask
        stuck_finding = stuck(series, others, inputs, count, mask)
        if stuck_finding is not None:
            findings.append(stuck_finding)
            mask |= stuck_finding.mask
    masked[series.name] = mask
    return findings


def _band_limit_finding(series: Series, inputs: Sequence[RecordFinding]) -> RecordFinding | None:
    """Return the finding of a band-limited output; None where an input has about the same cutoff,
    since a motion without noise has the bandwidth of its excitation.
    """
    finding = band_limited(series)
    if finding is None:
        return None
    cutoff = finding.numbers["cutoff"].value
    if any(0.5 < of_input.numbers["cutoff"].value / cutoff < 2.0 for of_input in inputs):
        return None
    return finding


def _mostly_masked(mask: np.ndarray | None) -> bool:
    """Return whether more than a tenth of the samples is masked."""
    return mask is not None and bool(np.mean(mask) > 0.1)


def _without_masked(record: Record, masked: dict[str, np.ndarray]) -> Record:
    """Return the record with its masked samples invalid."""
    if not any(np.any(mask) for mask in masked.values()):
        return record
    outputs = tuple(
        replace(channel, valid=channel.valid & ~masked[channel.name])
        if np.any(masked.get(channel.name, False))
        else channel
        for channel in record.outputs
    )
    return replace(record, outputs=outputs)
