"""Search for misread columns of a record, and for a wrong time base.

The columns are compared as they were read, and corrected for each simple mistake. The measure is
the share of the motion that the kinematics leave unexplained. For correct columns it is a tenth or
less, also with the sensor effects of the library; in rough air it may be a half, but then no other
reading is better. For a misread column it is between a third and one, and a hundredth for the
correct reading of this column.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np

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
    is_reliable,
    lag_of,
    unexplained_lift,
)
from ident.recording.series import Certainty, Expectations, Kind, RecordFinding, quantities
from sim.record import Channel, Record

# smallest unexplained share that suggests a wrong clock (one that runs twice as fast gives 0.2)
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


def time_base_finding(
    columns: KinematicColumns, as_read: float, expected: Expectations
) -> RecordFinding | None:
    """Return the finding of a wrong time base; None where the time is correct.

    The finding is certain if the control power or the pitch attitude excludes a scale error of a
    sensor, and otherwise likely. ``as_read`` is the unexplained share of the columns as read.
    """
    most_steps = RATES_PER_OCTAVE * SEARCHED_OCTAVES
    factors = [
        2.0 ** (step / RATES_PER_OCTAVE) for step in range(-most_steps, most_steps + 1) if step
    ]
    shares = {
        factor: max(disagreement(columns.scaled({"time": factor})).values()) for factor in factors
    }
    best = min(shares, key=lambda factor: shares[factor])
    if (
        shares[best] > CORRECT_CLOCK_SHARE
        or shares[best] * CLOCK_IMPROVEMENT_RATIO > as_read
        or abs(math.log2(best)) < GROSS_CLOCK_ERROR
    ):
        return None
    numbers = quantities(factor=best, unexplained=as_read, unexplained_otherwise=shares[best])
    sentence = (
        f"disagrees with the kinematics: they hold if time runs {best:.2g} times as long as the "
        "column says"
    )
    # The attitude excludes a scale error of alpha. A scale error of the pitch rate has the effect
    # of a wrong clock in all relations but that of nz.
    attitude = {"theta", "alpha"} <= set(columns.outputs)
    by_rate = min(max(disagreement(columns.scaled({"q": factor})).values()) for factor in factors)
    certainty = Certainty.CERTAIN
    remedy = "correct the time column, or say its unit in a channel map"
    by_attitude = attitude and CLOCK_IMPROVEMENT_RATIO * shares[best] < by_rate
    if not by_attitude and not _control_agrees(columns, best, expected):
        certainty, remedy = Certainty.LIKELY, "check the sample rate and the units of the columns"
        scaled = "pitch rate" if attitude else "angle of attack"
        sentence += f", or if the {scaled} has a scale error"
    return RecordFinding("time", Kind.TIME_BASE, certainty, sentence, remedy, numbers=numbers)


def _control_agrees(columns: KinematicColumns, factor: float, expected: Expectations) -> bool:
    """Return whether the control power agrees with the vehicle file after the clock is corrected,
    and not before. Accelerations change with the square of the factor.
    """
    if expected.control_power is None or not expected.control_power or not expected.angular_control:
        return False
    log_ratios = []
    for columns_of_clock in (columns, columns.scaled({"time": factor})):
        power = control_power(columns_of_clock)
        if power is None or not is_reliable(power) or power.value * expected.control_power <= 0.0:
            return False
        log_ratios.append(abs(math.log(power.value / expected.control_power)))
    return log_ratios[1] < min(PLAUSIBLE_LOG_RATIO, 0.5 * log_ratios[0])


# A column is wrong above this unexplained share. Effects of the library leave at most 0.12, the
# noise of small motions 0.1, and a wrong column at least 0.28.
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
# Fewest samples in a lag for a certain finding. With two, the motion has four samples in a period,
# and one of 600 correct records seemed to have its time in ms.
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


def misread_findings(record: Record, expected: Expectations) -> list[RecordFinding]:
    """Return the findings of columns that are certainly or probably misread; empty if all columns
    are consistent, or if there is no relation between them.
    """
    names = (*record.input_names, *record.output_names)
    candidates = [large_angle_finding(record[name]) for name in SMALL_ANGLES if name in names]
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
    """Return a finding on nz, which was computed from az, as a finding on az. Where nz seems to be
    in m/s2, the values of az are too large by the factor g0.
    """
    if finding.kind is Kind.UNIT and finding.channel == "nz":
        return replace(finding, channel="az", remedy="check the unit of az: m/s2 is expected")
    channel, sentence, remedy = (
        re.sub(r"\bnz\b", "az", text)
        for text in (finding.channel, finding.sentence, finding.remedy)
    )
    return replace(finding, channel=channel, sentence=sentence, remedy=remedy)


SERVO_PULSES = (600.0, 2400.0)  # us, shortest and longest pulse of a servo
LEVEL_PULSES = (1200.0, 1800.0)  # us, range of the median pulse


def large_angle_finding(channel: Channel) -> RecordFinding | None:
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
        numbers=quantities(reach=(reach, "rad")),
    )


def _load_factor_unit_finding(channel: Channel) -> RecordFinding | None:
    """Return a finding if the median of a load factor is near 9.8: it is in m/s2."""
    middle = float(np.median(channel.values[channel.valid]))
    if not LEVEL_FLIGHT_RANGE[0] < abs(middle) < LEVEL_FLIGHT_RANGE[1]:
        return None
    text = f"is in m/s2, not in g: its median is {middle:.3g}"
    return RecordFinding(
        channel.name,
        Kind.UNIT,
        Certainty.CERTAIN,
        text,
        NZ_REMEDY,
        numbers=quantities(middle=(middle, "g")),
    )


def _lift_finding(columns: KinematicColumns, as_read: float) -> RecordFinding | None:
    """Return a finding if the correlation with alpha shows a wrong sign or exchange of nz."""
    y = columns.outputs
    if not {"alpha", "q", "nz"} <= set(y):
        return None
    lag, step = lag_of(columns), float(np.median(np.diff(columns.time)))
    alpha = change(y["alpha"], lag)
    shifts = sorted({min(round(shift / step), len(alpha) // 4) for shift in SHIFTS})

    def correlation_with_alpha(values: np.ndarray) -> float:
        """Return the largest correlation of the changes of ``values`` and alpha, where either is
        shifted by one of the ``SHIFTS``.
        """
        other = change(values, lag)
        correlations = []
        with np.errstate(invalid="ignore"):
            for k in shifts:
                pairs = ((alpha[k:], other[: len(other) - k]), (alpha[: len(alpha) - k], other[k:]))
                correlations += [
                    float(np.nan_to_num(np.corrcoef(first, second)[0, 1]))
                    for first, second in pairs
                ]
        return max(correlations, key=abs)

    correlation = correlation_with_alpha(y["nz"])
    with_sign = max(disagreement(columns.scaled({"nz": -1.0})).values())
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
            numbers=quantities(correlation=correlation),
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
        or not _significantly_smaller(unexplained_lift(columns), unexplained_lift(exchanged))
    ):
        return None
    name = columns.control_name
    text = (
        f"are exchanged: the column of {name} is correlated with alpha, that of nz is not, and the "
        "kinematics hold after the exchange"
    )
    return RecordFinding(
        f"nz and {name}",
        Kind.EXCHANGED,
        Certainty.CERTAIN,
        text,
        RENAME,
        numbers=quantities(correlation=correlation),
    )


def _degrees_finding(columns: KinematicColumns, as_read: float) -> RecordFinding | None:
    """Return a finding if all angles are in degrees: large, and consistent except with nz."""
    names = [name for name in columns.outputs if name in UNITS]
    if (
        "alpha" not in names
        or len(names) < 2
        or "nz" not in columns.outputs
        or float(np.ptp(columns.outputs["alpha"])) < LARGEST_ALPHA_RANGE
    ):
        return None
    share_in_degrees = max(
        disagreement(columns.scaled({name: 1.0 / DEGREES for name in names})).values(),
        default=math.inf,
    )
    if (
        share_in_degrees > CORRECT_CLOCK_SHARE
        or READING_IMPROVEMENT_RATIO * share_in_degrees > as_read
    ):
        return None
    text = "are in degrees, not in radians: only then do the kinematics with nz hold"
    return RecordFinding(
        " and ".join(names),
        Kind.UNIT,
        Certainty.CERTAIN,
        text,
        "say their units in a channel map",
        numbers=quantities(unexplained=as_read),
    )


def _best_reading_finding(
    columns: KinematicColumns, as_read: float, expected: Expectations
) -> RecordFinding | None:
    """Return the finding of another reading, a wrong airspeed or time base; None without any."""
    readings = sorted(
        (
            reading
            for reading in all_readings(columns)
            if reading.unexplained < _largest_correct_share(reading, columns)
        ),
        key=lambda reading: reading.unexplained,
    )
    best = readings[0] if readings else None
    possible: list[ColumnReading] = []
    if (
        best is not None
        and as_read > WRONG_COLUMN_SHARE
        and best.unexplained * READING_IMPROVEMENT_RATIO < as_read
    ):
        possible = [
            reading
            for reading in readings
            if (
                reading is best
                or reading.unexplained < READING_IMPROVEMENT_RATIO * best.unexplained
            )
            and _supported_by_other_evidence(reading, columns, expected) is not False
        ]
    if not possible:
        return _airspeed_finding(columns, as_read, expected) or time_base_finding(
            columns, as_read, expected
        )
    if len(possible) > 1 and expected.control_power is not None:
        # Where the control power of some readings agrees with the vehicle file, only these count.
        agreeing = [each for each in possible if _control_power_agrees(each.columns, expected)[0]]
        possible = agreeing or possible
    best, *rivals = possible
    units = re.fullmatch(r"is in (\S+), not in (\S+)", best.sentence)
    changed, read = (f"in {units[1]}", f"in {units[2]}") if units else ("corrected", "as read")
    sentence = (
        f"{best.sentence}: {read} {_percent(as_read)} of the motion does not fit the other "
        f"channels, {changed} {_percent(best.unexplained)}"
    )
    if best.kind is Kind.UNIT and best.channel == "nz" and not rivals:
        airspeed = _airspeed_finding(columns, as_read, expected, best)
        if airspeed is not None:
            return airspeed
    # Without alpha, nz replaces it. This is wrong for an accelerometer away from the centre of
    # gravity, so that only a finding of a sign is then certain.
    reliable = "alpha" in columns.outputs or best.kind is Kind.SIGN
    resolved = lag_of(columns) >= FEWEST_ROWS_PER_LAG
    confirmed = _supported_by_other_evidence(best, columns, expected) is not None
    certainty = Certainty.CERTAIN if reliable and resolved and confirmed else Certainty.LIKELY
    if rivals:
        sentence += f"; or {' or '.join(f'{each.channel} {each.sentence}' for each in rivals[:2])}"
    numbers = quantities(unexplained=as_read, unexplained_otherwise=best.unexplained)
    return RecordFinding(best.channel, best.kind, certainty, sentence, best.remedy, numbers=numbers)


def _airspeed_finding(
    columns: KinematicColumns,
    as_read: float,
    expected: Expectations,
    unit: ColumnReading | None = None,
) -> RecordFinding | None:
    """Return a finding if alpha, q and nz agree at another airspeed than that of the vehicle file.

    In alpha_dot = q - (g/V) (nz - nz_0), a wrong airspeed V has the same effect as a wrong factor
    of nz, so that the finding names both. It is certain where ``unit``, the reading of nz in
    another unit, is given. Otherwise it is likely, since the scale of the sensor may be wrong.
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
    sentence = (
        f"does not fit alpha and q at {expected.airspeed:.4g} m/s: the kinematics leave "
        f"{_percent(as_read)} of the motion unexplained; at {fitted_airspeed:.3g} m/s "
        f"{_percent(share)}"
    )
    remedy = "check the airspeed of the vehicle file, or the unit and scale of nz"
    if unit is not None:
        sentence += f"; or it {unit.sentence}"
        remedy = f"check the airspeed of the vehicle file; if it is right, {unit.remedy}"
    return RecordFinding(
        "nz",
        Kind.UNIT,
        Certainty.LIKELY if unit is None else Certainty.CERTAIN,
        sentence,
        remedy,
        numbers=quantities(
            unexplained=as_read, unexplained_otherwise=share, airspeed=(fitted_airspeed, "m/s")
        ),
    )


def _supported_by_other_evidence(
    reading: ColumnReading, columns: KinematicColumns, expected: Expectations
) -> bool | None:
    """Return whether evidence other than the kinematics also contradicts the columns as read and
    supports ``reading``; None without such evidence.

    The kinematics alone do not prove an exchange or a sign. Sensor faults and gusts disturb them
    too, and feedback makes an elevator similar to a measured output. The relation of lift tests
    alpha, nz and the control. The pitch acceleration tests the pitch rate and the control.
    """
    names, exchange = set(reading.channel.split(" and ")), reading.kind is Kind.EXCHANGED
    if not exchange and reading.kind is not Kind.SIGN:
        return True
    lift = unexplained_lift(columns)
    # An exchange of alpha and nz does not change the relation of lift.
    if lift is not None and names & {"alpha", "nz"} and names != {"alpha", "nz"}:
        return _significantly_smaller(lift, unexplained_lift(reading.columns))
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
    return _significantly_smaller(
        (1.0 - power_as_read.explained, count), (1.0 - power.explained, count)
    )


def _control_power_agrees(
    columns: KinematicColumns, expected: Expectations
) -> tuple[bool | None, ControlPower | None]:
    """Return the control power, after whether it agrees with the vehicle file (None: unclear)."""
    power = control_power(columns)
    if power is None or not is_reliable(power) or not expected.control_power:
        return None, power
    return _power_agrees(power.value, expected), power


def _power_agrees(power: float, expected: Expectations) -> bool:
    """Return whether a control power agrees, by sign alone if the control's unit is unknown."""
    ratio = power / expected.control_power if expected.control_power else 0.0
    if not expected.angular_control and ratio > 0.0:
        return True
    return 1.0 / CONTROL_POWER_FACTOR < ratio < CONTROL_POWER_FACTOR


def _significantly_smaller(
    before: tuple[float, float] | None, after: tuple[float, float] | None
) -> bool:
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


def _control_finding(columns: KinematicColumns, expected: Expectations) -> list[RecordFinding]:
    """Return a finding if the sign or unit of a control contradicts the vehicle file."""
    if expected.control_power is None or not expected.control_power:
        return []
    power = control_power(columns)
    if power is None or not is_reliable(power) or _nz_contradicts(columns, power.value):
        return []
    ratio, name = power.value / expected.control_power, columns.control_name
    text = (
        f"its pitch acceleration is {power.value:+.3g} rad/s2 per unit, the vehicle file says "
        f"{expected.control_power:+.3g}"
    )
    numbers = quantities(
        control_power=(power.value, "rad/s2"), expected=(expected.control_power, "rad/s2")
    )
    in_degrees = 1.0 / CONTROL_POWER_FACTOR < ratio * DEGREES < CONTROL_POWER_FACTOR
    if ratio < 0.0:
        kind, sentence = Kind.SIGN, f"has the sign turned: {text}"
        remedy = (
            f"turn the sign of the column of {name}, or that of its derivatives in the vehicle file"
        )
    elif expected.angular_control and in_degrees:
        kind, sentence = Kind.UNIT, f"is in deg, not in rad: {text}"
        remedy = f"name the column {name}_deg, or say its unit in a channel map"
    else:
        return []
    return [RecordFinding(name, kind, Certainty.CERTAIN, sentence, remedy, numbers=numbers)]


def _nz_contradicts(columns: KinematicColumns, power: float) -> bool:
    """Return whether the control power has the other sign if nz replaces alpha in the fit."""
    without_alpha = replace(
        columns,
        outputs={name: values for name, values in columns.outputs.items() if name != "alpha"},
    )
    other = control_power(without_alpha) if "alpha" in columns.outputs else None
    return other is not None and other.value * power < 0.0


def _percent(share: float) -> str:
    """Return a share as text in percent."""
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"
