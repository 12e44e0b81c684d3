"""Columns that are not what their header says: exchanged, of turned sign, in degrees or m/s2, on a time base of another unit.

The columns are read as they stand and as each simple fault would have them; what counts is how well the kinematics then hold (``motion``).
Sound sensors leave a tenth of the power unexplained or less, also with the sensor effects of the library; rough air may leave half, but
then no other reading does better. A fault of this kind leaves a third to all of it, and its own reading takes that to a hundredth.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.recording.alternatives import DEGREES, NZ_REMEDY, RENAME, UNITS, Reading, all_readings
from ident.recording.control import ControlPower, control_power, sure
from ident.recording.finding import Certainty, Expectations, Finding, Kind, Number
from ident.recording.motion import FLOOR, SHIFTS, Columns, change, columns_of, disagreement, lag_of, unexplained_lift
from ident.recording.time_base import SUITS, SUSPECT, wrong_clock
from sim.record import Channel, Record

# Chosen between the two: records with any effect of the library leave 0.12 at most, a wrong column 0.28 at least; the noise of a small motion
# leaves 0.1 of the right reading, too.
WRONG, RIGHT, RIGHT_WITH_CONTROL = 0.2, 0.15, 0.1
CLEARLY = 4.0  # times less than as read, and than any reading of another kind
NEAR = 3.0  # factor within which a control power is that of the vehicle's data; effects and starting values differ by 2, degrees by 57
# Correlation of changes of nz and alpha: 0.88 at least with any effect of the library; a control moves otherwise.
TOGETHER, APART = 0.85, 0.7
# Rows of a lag: with two, a motion has four samples a period, and of 600 sound light aircraft one was read as in ms.
RESOLVED = 3
CHANCE = -2.0 * math.log(1e-3)  # of twice the log likelihood: the level of significance is one in a thousand
SMALL_ANGLES = ("alpha", "elevator", "beta", "aileron", "rudder")  # in rad, of a motion that linear equations describe
LARGEST, REACHED = 1.5, 99.0  # rad away from the middle that a hundredth of the samples may reach, and the rest in per cent
LEVEL = (9.0, 10.7)  # g, of a middle: level flight in m/s2, a little climbing, diving or turning
LARGE = 0.6  # rad, of an angle of attack from end to end


def misread(record: Record, expected: Expectations) -> list[Finding]:
    """Columns that are certainly, or likely, not what they are called; empty where all fit together or nothing joins them."""
    far = [one for name in SMALL_ANGLES if name in (*record.input_names, *record.output_names) and (one := _far(record[name])) is not None]
    far += [one for name in ("nz",) if name in record.output_names and (one := _gravity(record[name])) is not None]
    columns = columns_of(record, expected)
    if columns is None:
        return far
    found = _of_columns(columns, expected)
    if far and not any(one.kind is Kind.EXCHANGED for one in found):
        return far
    return [_of_az(one) for one in found] if "az" in record.output_names and "nz" not in record.output_names else found


def _of_columns(columns: Columns, expected: Expectations) -> list[Finding]:
    shares = disagreement(columns)
    as_read = max(shares.values(), default=0.0)
    found = _of_lift(columns, as_read) or _of_angles(columns, as_read)
    if found is None and as_read > SUSPECT:
        found = _best(columns, as_read, expected)
    if found is not None:
        return [found]
    return _of_control(columns, expected) if shares and as_read <= WRONG else []


def _of_az(finding: Finding) -> Finding:
    """What was found of nz, told of the column that it comes from: in m/s2 for nz is a factor of g0, that of g for az."""
    if finding.kind is Kind.UNIT and finding.channel == "nz":
        return replace(finding, channel="az", remedy="check the unit of az: m/s2 is meant")
    channel, sentence, remedy = (re.sub(r"\bnz\b", "az", text) for text in (finding.channel, finding.sentence, finding.remedy))
    return replace(finding, channel=channel, sentence=sentence, remedy=remedy)


def _far(channel: Channel) -> Finding | None:
    """A flow angle or a control that moves too far for radians."""
    values = channel.values[channel.valid]
    reach = float(np.percentile(np.abs(values - np.median(values)), REACHED)) if len(values) else 0.0
    if reach <= LARGEST:
        return None
    told = f"moves by {reach:.3g} rad ({math.degrees(reach):.3g} deg)"
    remedy = f"if the column is in degrees, name it {channel.name}_deg or say so in a channel map; if it is right, {channel.name} = false there"
    return Finding(channel.name, Kind.UNIT, Certainty.CERTAIN, told, remedy, numbers={"reach": Number(reach, "rad")})


def _gravity(channel: Channel) -> Finding | None:
    """A load factor whose middle is 9.8: nothing flies at that for half a record, and level flight reads that in m/s2."""
    middle = float(np.median(channel.values[channel.valid]))
    if not LEVEL[0] < abs(middle) < LEVEL[1]:
        return None
    told = f"is in m/s2, not in g: its middle is {middle:.3g}"
    return Finding(channel.name, Kind.UNIT, Certainty.CERTAIN, told, NZ_REMEDY, numbers={"middle": Number(middle, "g")})


def _of_lift(columns: Columns, as_read: float) -> Finding | None:
    """nz against alpha, which lift ties to each other: of turned sign, or exchanged with the control, where the kinematics say so too."""
    y = columns.outputs
    if not {"alpha", "q", "nz"} <= set(y):
        return None
    lag, step = lag_of(columns), float(np.median(np.diff(columns.time)))
    alpha = change(y["alpha"], lag)
    shifts = sorted({min(round(late / step), len(alpha) // 4) for late in SHIFTS})

    def goes_with_alpha(values: np.ndarray) -> float:
        """The largest correlation of changes, either column up to ``SHIFTS`` late."""
        other = change(values, lag)
        with np.errstate(invalid="ignore"):
            found = [float(np.nan_to_num(np.corrcoef(alpha[k:], other[: len(other) - k])[0, 1])) for k in shifts]
            found += [float(np.nan_to_num(np.corrcoef(alpha[: len(alpha) - k], other[k:])[0, 1])) for k in shifts]
        return max(found, key=abs)

    together = goes_with_alpha(y["nz"])
    turned = max(disagreement(columns.times({"nz": -1.0})).values())
    if together < -TOGETHER and turned < RIGHT and turned < as_read:
        told = f"has the sign turned: it falls when alpha rises (correlation {together:.2f}), and the kinematics hold better with the other sign"
        return Finding("nz", Kind.SIGN, Certainty.CERTAIN, told, "turn the sign of the column of nz", numbers={"correlation": Number(together, "1")})
    if columns.control is None or together > APART or goes_with_alpha(columns.control) < TOGETHER:
        return None
    exchanged = columns.exchanged("nz", columns.control_name)
    other = max(disagreement(exchanged).values())
    if other > RIGHT or CLEARLY * other > as_read or not _likelier(unexplained_lift(columns), unexplained_lift(exchanged)):
        return None
    name = columns.control_name
    told = f"are exchanged: the column of {name} goes with alpha, that of nz does not, and the kinematics hold so"
    return Finding(f"nz and {name}", Kind.EXCHANGED, Certainty.CERTAIN, told, RENAME, numbers={"correlation": Number(together, "1")})


def _of_angles(columns: Columns, as_read: float) -> Finding | None:
    """All angles in degrees at once: they agree with each other, but not with nz, and move further than any aircraft's in radians."""
    names = [name for name in columns.outputs if name in UNITS]
    if "alpha" not in names or len(names) < 2 or "nz" not in columns.outputs or float(np.ptp(columns.outputs["alpha"])) < LARGE:
        return None
    other = max(disagreement(columns.times({name: 1.0 / DEGREES for name in names})).values(), default=math.inf)
    if other > SUITS or CLEARLY * other > as_read:
        return None
    told = "are in degrees, not in radians: with nz the kinematics hold only so"
    return Finding(
        " and ".join(names), Kind.UNIT, Certainty.CERTAIN, told, "say their units in a channel map", numbers={"unexplained": Number(as_read, "1")}
    )


def _best(columns: Columns, as_read: float, expected: Expectations) -> Finding | None:
    readings = sorted((one for one in all_readings(columns) if one.left < _right(one, columns)), key=lambda one: one.left)
    best = readings[0] if readings else None
    if best is not None and as_read > WRONG and best.left * CLEARLY < as_read:
        near = [best, *(one for one in readings[1:] if one.left < CLEARLY * best.left)]
        possible = [one for one in near if _implausible_as_read(one, columns, expected) is not False]
        if not possible:
            return wrong_clock(columns, as_read, expected)
        best, rivals = _by_control(possible, expected) if len(possible) > 1 else (possible[0], [])
        numbers = {"unexplained": Number(as_read, "1"), "unexplained_otherwise": Number(best.left, "1")}
        what = f"{best.sentence}: as read, the kinematics leave {_percent(as_read)} of the motion unexplained, read so {_percent(best.left)}"
        # Without alpha nz stands for it, which an accelerometer off the centre of gravity does badly: only a sign is beyond that.
        plain = ("alpha" in columns.outputs or best.kind is Kind.SIGN) and lag_of(columns) >= RESOLVED
        shown = _implausible_as_read(best, columns, expected) is not None
        certainty = Certainty.CERTAIN if plain and shown else Certainty.LIKELY
        if rivals:
            what += f"; or {' or '.join(f'{one.channel} {one.sentence}' for one in rivals[:2])}"
        return Finding(best.channel, best.kind, certainty, what, best.remedy, numbers=numbers)
    return wrong_clock(columns, as_read, expected)


def _implausible_as_read(reading: Reading, columns: Columns, expected: Expectations) -> bool | None:
    """Whether columns that a reading exchanges or turns are also implausible by what kinematics do not use; None where nothing else is known.

    A sensor that is wrong, or a gust, spoils the kinematics too, and a controller makes an elevator in the shape of what it feeds back:
    that the kinematics hold for another column is not enough. Lift decides on alpha, nz and the control, the pitch acceleration that
    the control makes on the pitch rate and the control.
    """
    names, exchange = set(reading.channel.split(" and ")), reading.kind is Kind.EXCHANGED
    if not exchange and reading.kind is not Kind.SIGN:
        return True
    lift = unexplained_lift(columns)
    if lift is not None and names & {"alpha", "nz"} and names != {"alpha", "nz"}:  # the law of lift is the same for these two exchanged
        return _likelier(lift, unexplained_lift(reading.columns))
    by_control = exchange and columns.control_name in names
    if not by_control and "q" not in names:
        return True
    (here, power), (there, other) = (_pitching(some, expected) for some in (columns, reading.columns))
    if here is not None and there is not None and here is not there:
        return there
    if not by_control:
        return True
    if power is None or other is None or "q" not in names:
        return None
    count = len(columns.time) / lag_of(columns)
    return _likelier((1.0 - power.explained, count), (1.0 - other.explained, count))


def _pitching(columns: Columns, expected: Expectations) -> tuple[bool | None, ControlPower | None]:
    """Whether the control has the power that the vehicle's data say, None where it cannot be relied on; and that power."""
    found = control_power(columns)
    if found is None or not sure(found) or not expected.control_power:
        return None, found
    return _fits(found.value, expected), found


def _fits(power: float, expected: Expectations) -> bool:
    """Whether a control power is that of the vehicle's data, or at least of its sign where only that is known."""
    ratio = power / expected.control_power if expected.control_power else 0.0
    return 1.0 / NEAR < ratio < NEAR or (ratio > 0.0 and not expected.angular_control)


def _likelier(before: tuple[float, float] | None, after: tuple[float, float] | None) -> bool:
    """Whether the second share of what is left is smaller beyond chance; with each the number of independent stretches."""
    if before is None or after is None:
        return False
    return min(before[1], after[1]) * math.log(max(before[0], FLOOR) / max(after[0], FLOOR)) > CHANCE


def _right(reading: Reading, columns: Columns) -> float:
    """What a reading may leave; less where the control takes part, which a feedback makes look like what it feeds back."""
    return RIGHT_WITH_CONTROL if reading.kind is Kind.EXCHANGED and columns.control_name in reading.channel.split(" and ") else RIGHT


def _by_control(rivals: Sequence[Reading], expected: Expectations) -> tuple[Reading, list[Reading]]:
    """Of readings that the kinematics cannot tell apart, those that give the control the power that the vehicle's data say."""
    if expected.control_power is None:
        return rivals[0], list(rivals[1:])
    fitting = []
    for one in rivals:
        if _pitching(one.columns, expected)[0]:
            fitting.append(one)
    kept = fitting or list(rivals)
    return kept[0], kept[1:]


def _of_control(columns: Columns, expected: Expectations) -> list[Finding]:
    """A control whose sign, or unit, is not that of the vehicle's data."""
    if expected.control_power is None or not expected.control_power:
        return []
    found = control_power(columns)
    if found is None or not sure(found) or _contradicted(columns, found.value):
        return []
    ratio, name = found.value / expected.control_power, columns.control_name
    told = f"its pitch acceleration is {found.value:+.3g} rad/s2 per unit, the vehicle file says {expected.control_power:+.3g}"
    numbers = {"control_power": Number(found.value, "rad/s2"), "expected": Number(expected.control_power, "rad/s2")}
    if ratio < 0.0:
        remedy = f"turn the sign of the column of {name}, or that of its derivatives in the vehicle file"
        return [Finding(name, Kind.SIGN, Certainty.CERTAIN, f"has the sign turned: {told}", remedy, numbers=numbers)]
    if expected.angular_control and 1.0 / NEAR < ratio * DEGREES < NEAR:
        remedy = f"name the column {name}_deg, or say its unit in a channel map"
        return [Finding(name, Kind.UNIT, Certainty.CERTAIN, f"is in deg, not in rad: {told}", remedy, numbers=numbers)]
    return []


def _contradicted(columns: Columns, power: float) -> bool:
    """Whether a control power has the other sign with nz in the place of alpha: a vane that is very late bends it so far."""
    without = replace(columns, outputs={name: values for name, values in columns.outputs.items() if name != "alpha"})
    other = control_power(without) if "alpha" in columns.outputs else None
    return other is not None and other.value * power < 0.0


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"
