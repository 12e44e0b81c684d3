"""Relations between the channels of one motion, and the alternative readings of columns that they
test.

Over a lag h of about half a period of the motion, alpha(t + h) - alpha(t) = int (q - (g/V) (nz -
nz_0)) dt and theta(t + h) - theta(t) = int q dt. Without nz the lift is a multiple of alpha (Z
alpha, Z > 0); without alpha a change of nz is one of alpha (k > 0). Differences over a lag remove
biases and slow drifts.

q(t + h) - q(t) = M_alpha int alpha dt + M_q int q dt + M_delta int delta(t - delay) dt + c h, by
least squares; nz replaces a missing alpha.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.recording.series import (
    FEWEST_SAMPLES,
    Certainty,
    Expectations,
    FindingQuantity,
    Kind,
    RecordFinding,
)
from sim.maths import G0
from sim.record import Channel, Record

# ---- Relations between the channels of one motion

MOTION_CHANNELS = ("alpha", "q", "nz", "theta")
LOWEST_AIRSPEED = 20.0  # m/s, lowest airspeed where it is unknown
LEAST_AIRSPEED = 5.0  # m/s, lowest airspeed of any aircraft
HIGHEST_AIRSPEED = 400.0  # m/s, highest airspeed where it is unknown
LARGEST_LIFT_DAMPING = 10.0  # 1/s: largest damping of alpha by lift
FEWEST_ROWS = 40
MOST_ROWS = 3000  # most rows that are compared
HALF_PERIOD_CORRELATION = 0.5  # autocorrelation of the changes at a lag of half a period
POWER_FLOOR = 1e-30
# fewest rows of a lag per row between two samples of a channel: straight lines between fewer do not
# follow the motion
FEWEST_ROWS_PER_LAG = 2
SHIFTS = (0.0, 0.05, 0.1, 0.2)  # s: delays and lags of sensors
LONGEST_DELAY = 0.3  # s: largest delay or lag, or arm over airspeed; these are effects of their own


@dataclass(frozen=True, eq=False)
class KinematicColumns:
    """Channels on one time base, ``(N,)`` each: gaps interpolated, single wrong samples removed;
    ``control`` is held between samples.
    """

    time: np.ndarray
    outputs: Mapping[str, np.ndarray]
    control: np.ndarray | None
    control_name: str
    gravity_over_speed: float | None

    def times(self, factors: Mapping[str, float]) -> KinematicColumns:
        """Return the columns with some channels multiplied; ``control`` and ``time`` may be among
        them.
        """
        outputs = {name: values * factors.get(name, 1.0) for name, values in self.outputs.items()}
        control = (
            None if self.control is None else self.control * factors.get(self.control_name, 1.0)
        )
        return replace(
            self, time=self.time * factors.get("time", 1.0), outputs=outputs, control=control
        )

    def exchanged(self, first: str, second: str) -> KinematicColumns:
        """Return the columns with two channels exchanged."""
        held = dict(self.outputs)
        if self.control is not None and self.control_name in (first, second):
            other = second if first == self.control_name else first
            control, held[other] = held[other], self.control
            return replace(self, outputs=held, control=control)
        held[first], held[second] = held[second], held[first]
        return replace(self, outputs=held)


def columns_of(record: Record, expected: Expectations) -> KinematicColumns | None:
    """Return the channels of one motion; None if there are none or they are too short. nz is -az/g0
    if az is given.
    """
    if len(record) < FEWEST_ROWS:
        return None
    rows = slice(0, MOST_ROWS)
    outputs = {
        name: _bridged(record, name)[rows]
        for name in MOTION_CHANNELS
        if name in record.output_names
    }
    if "nz" not in outputs and "az" in record.output_names:
        outputs["nz"] = -_bridged(record, "az")[rows] / G0
    if len(outputs) < 1:
        return None
    control = record.inputs[0] if record.inputs else None
    finite_rows = [
        np.flatnonzero(record[name].valid)
        for name in (*MOTION_CHANNELS, "az")
        if name in record.output_names
    ]
    sparse = max(
        int(np.median(np.diff(rows))) if len(rows) > 1 else len(record) for rows in finite_rows
    )
    over = (
        expected.gravity / expected.airspeed
        if expected.airspeed
        else _gravity_over_recorded_speed(record, expected.gravity)
    )
    values = control.values[rows] if control is not None else None
    columns = KinematicColumns(
        record.time[rows], outputs, values, control.name if control is not None else "", over
    )
    return columns if sparse * FEWEST_ROWS_PER_LAG <= lag_of(columns) else None


def disagreement(columns: KinematicColumns) -> dict[str, float]:
    """Return the unexplained share of the power of each relation: 0 if it holds, 1 if its sides are
    unrelated, up to 2.
    """
    lag = lag_of(columns)
    sides = relations(columns, lag)
    along = change(columns.outputs["q"], lag) if sides else np.zeros(0)
    return {
        name: _unexplained_share(left, right, along - np.mean(along))
        for name, (left, right) in sides.items()
    }


def relations(columns: KinematicColumns, lag: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return both sides of every relation that the columns allow, about their means, shape ``(N -
    lag,)``.
    """
    y = columns.outputs
    moved = {name: change(values, lag) for name, values in y.items()}
    sums = {
        name: change(integral(columns.time, values - np.mean(values)), lag)
        for name, values in y.items()
    }
    out = {}
    if "q" in y and "alpha" in y:
        if "nz" in y:
            factor = columns.gravity_over_speed
            if factor is None:
                slope = _slope(sums["nz"], sums["q"] - moved["alpha"])
                factor = float(np.clip(slope, G0 / HIGHEST_AIRSPEED, G0 / LOWEST_AIRSPEED))
            out["alpha"] = (moved["alpha"], sums["q"] - factor * sums["nz"])
        else:
            steep = float(
                np.clip(
                    _slope(sums["alpha"], sums["q"] - moved["alpha"]), 0.0, LARGEST_LIFT_DAMPING
                )
            )
            out["alpha"] = (moved["alpha"], sums["q"] - steep * sums["alpha"])
    elif "q" in y and "nz" in y and columns.gravity_over_speed is not None:
        rate = sums["q"] - columns.gravity_over_speed * sums["nz"]
        out["nz"] = (moved["nz"], max(_slope(rate, moved["nz"]), 0.0) * rate)
    if "q" in y and "theta" in y:
        out["theta"] = (moved["theta"], sums["q"])
    return {
        name: (left - np.mean(left), right - np.mean(right)) for name, (left, right) in out.items()
    }


def fitted_gravity_over_speed(columns: KinematicColumns) -> float | None:
    """Return gravity over the airspeed at which alpha, q and nz fit best; None without them, or if
    that is no airspeed of an aircraft.
    """
    y = columns.outputs
    if not {"alpha", "q", "nz"} <= set(y):
        return None
    lag = lag_of(columns)
    flow = change(y["alpha"], lag)
    pitch, load = (
        change(integral(columns.time, y[name] - np.mean(y[name])), lag) for name in ("q", "nz")
    )
    # A vane ahead of the centre of gravity, or a late one, adds a multiple of the change of q.
    sides = np.stack([load, change(y["q"], lag)])
    sides = sides - sides.mean(axis=1, keepdims=True)
    slope = float(np.linalg.lstsq(sides.T, pitch - flow - np.mean(pitch - flow), rcond=None)[0][0])
    return slope if G0 / HIGHEST_AIRSPEED <= slope <= G0 / LEAST_AIRSPEED else None


def unexplained_lift(columns: KinematicColumns) -> tuple[float, float] | None:
    """Return the share of the change of nz that the law of lift does not explain, and the number of
    independent samples; None without alpha or nz.

    nz - nz_0 = a alpha + b delta with a >= |b|: lift rises with the angle of attack, and a control
    surface gives less lift per radian than the whole aircraft. Integrals over a lag are compared,
    to average the noise. Either side may be delayed by up to ``SHIFTS``.
    """
    y = columns.outputs
    if not {"alpha", "nz"} <= set(y):
        return None
    lag, step = lag_of(columns), float(np.median(np.diff(columns.time)))
    control = np.zeros(len(columns.time)) if columns.control is None else columns.control
    load, flow, surface = (
        change(integral(columns.time, values - np.mean(values)), lag)
        for values in (y["nz"], y["alpha"], control)
    )
    shifts = sorted({min(round(shift / step), len(load) // 4) for shift in SHIFTS})
    pairs = [(load[: len(load) - k], flow[k:], surface[: len(load) - k]) for k in shifts]
    pairs += [(load[k:], flow[: len(load) - k], surface[: len(load) - k]) for k in shifts]
    return min(_share_of_lift(*each) for each in pairs), len(load) / lag


def _share_of_lift(load: np.ndarray, flow: np.ndarray, surface: np.ndarray) -> float:
    """Return the unexplained share of a load after the best fit of the two angles' sum and
    difference, with non-negative factors.
    """
    load, flow, surface = (values - np.mean(values) for values in (load, flow, surface))
    power = float(load @ load)
    if power <= POWER_FLOOR:
        return 0.0
    both = np.stack([flow + surface, flow - surface])
    gram, right = both @ both.T, both @ load
    single = [
        right[i] ** 2 / gram[i, i] if right[i] > 0.0 and gram[i, i] > POWER_FLOOR else 0.0
        for i in range(2)
    ]
    explained = max(single)
    if np.linalg.det(gram) > POWER_FLOOR * max(gram[0, 0] * gram[1, 1], POWER_FLOOR):
        factors = np.linalg.solve(gram, right)
        explained = float(factors @ right) if np.all(factors > 0.0) else explained
    return max(1.0 - explained / power, POWER_FLOOR)


def lag_of(columns: KinematicColumns) -> int:
    """Return the lag, in rows, at which the autocorrelation of the motion has halved."""
    name = next((name for name in ("q", "alpha", "nz", "theta") if name in columns.outputs), None)
    if name is None:
        return 1
    values = columns.outputs[name] - np.mean(columns.outputs[name])
    most = max(3, min(len(values) // 8, 300))
    first = float(values[:-1] @ values[1:]) / (len(values) - 1)
    return next(
        (
            lag
            for lag in range(2, most)
            if float(values[:-lag] @ values[lag:]) / (len(values) - lag)
            < HALF_PERIOD_CORRELATION * first
        ),
        most - 1,
    )


def _unexplained_share(left: np.ndarray, right: np.ndarray, along: np.ndarray) -> float:
    """Return the unexplained share of the power of both sides, after a fit of a delayed or offset
    sensor (a multiple of the change of ``along``).
    """
    power = float(left @ left + right @ right)
    if power <= POWER_FLOOR:
        return 0.0
    off = left - right
    off = off - float(np.clip(_slope(along, off), -LONGEST_DELAY, LONGEST_DELAY)) * along
    return float(off @ off) / power


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    x, y = x - np.mean(x), y - np.mean(y)
    power = float(x @ x)
    return float(x @ y) / power if power > POWER_FLOOR else 0.0


def change(values: np.ndarray, lag: int) -> np.ndarray:
    return np.asarray(values[lag:] - values[:-lag])


def integral(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])


def _bridged(record: Record, name: str) -> np.ndarray:
    channel = record[name]
    values = np.interp(record.time, record.time[channel.valid], channel.values[channel.valid])
    before, here, after = values[:-2], values[1:-1], values[2:]
    middle = np.maximum(np.minimum(before, here), np.minimum(np.maximum(before, here), after))
    return np.concatenate([values[:1], middle, values[-1:]])


def _gravity_over_recorded_speed(record: Record, gravity: float) -> float | None:
    if "airspeed" not in record.output_names:
        return None
    speed = float(np.median(record["airspeed"].values[record["airspeed"].valid]))
    return gravity / speed if speed > LOWEST_AIRSPEED else None


# ---- Simple faults that make columns misread

DEGREES = math.degrees(1.0)
PACES = {1e-3: "ms", 1e-6: "us"}
SHORTEST_STEP = 5e-4  # s: recorders of aircraft motion sample at 2000 Hz at most
UNITS = {"alpha": "deg", "q": "deg/s", "theta": "deg"}
RENAME = "give each column its own name, or a channel map"
NZ_REMEDY = "name the column nz [m/s2], or say its unit in a channel map"


@dataclass(frozen=True, eq=False)
class ColumnReading:
    """One reading of the columns: the fault that it assumes, the columns in it, and the share of
    the motion that kinematics do not explain.
    """

    kind: Kind
    channel: str
    columns: KinematicColumns
    sentence: str
    remedy: str
    left: float


def all_readings(columns: KinematicColumns) -> list[ColumnReading]:
    """Return the readings of the columns under every simple fault."""
    names, out = list(columns.outputs), []
    for name in names:
        out.append(
            _reading(
                Kind.SIGN,
                name,
                columns.times({name: -1.0}),
                "has the sign turned",
                f"turn the sign of the column of {name}",
            )
        )
        if name in UNITS:
            remedy = f"name the column {name} [{UNITS[name]}], or say its unit in a channel map"
            what = f"is in {UNITS[name]}, not in {UNITS[name].replace('deg', 'rad')}"
            out.append(
                _reading(Kind.UNIT, name, columns.times({name: 1.0 / DEGREES}), what, remedy)
            )
    if "nz" in names:
        out.append(
            _reading(
                Kind.UNIT, "nz", columns.times({"nz": 1.0 / G0}), "is in m/s2, not in g", NZ_REMEDY
            )
        )
        out.append(
            _reading(
                Kind.UNIT,
                "nz",
                columns.times({"nz": G0}),
                f"is {G0:.2g} times too small",
                "check its unit",
            )
        )
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    pairs += [(name, columns.control_name) for name in names if columns.control is not None]
    for a, b in pairs:
        out.append(
            _reading(
                Kind.EXCHANGED, f"{a} and {b}", columns.exchanged(a, b), "are exchanged", RENAME
            )
        )
    step = float(np.median(np.diff(columns.time)))
    for factor, unit in PACES.items():
        if factor * step < SHORTEST_STEP:
            continue
        remedy = f"name the column time [{unit}], or say its unit in a channel map"
        out.append(
            _reading(
                Kind.TIME_BASE,
                "time",
                columns.times({"time": factor}),
                f"is in {unit}, not in s",
                remedy,
            )
        )
    return out


def _reading(
    kind: Kind, channel: str, columns: KinematicColumns, sentence: str, remedy: str
) -> ColumnReading:
    return ColumnReading(
        kind, channel, columns, sentence, remedy, max(disagreement(columns).values(), default=2.0)
    )


# ---- The pitch acceleration that a recorded control makes

# s, delays and lags of controls that are tried
CONTROL_DELAYS = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2, 0.25, 0.3)
SIGNIFICANT_SIGMAS = 8.0  # smallest significance; one independent sample a lag is a rough count
# smallest explained share of the change of q: at least 0.79 in a hundred records with any effect of
# the library
LEAST_EXPLAINED_SHARE = 0.8
# largest unexplained share over that of the other sign. Observed: 0.37 with the wrong sign at 10
# samples a second, 0.1 with the right one at 50
LARGEST_OTHER_SIGN_SHARE = 0.25
# fewest rows of a lag: with fewer, a pulse that begins between two rows changes q as much as the
# control
FEWEST_ROWS_PER_PULSE = 4
FEWEST_CONTROL_LAGS = 12  # fewest independent samples, one a lag


@dataclass(frozen=True)
class ControlPower:
    """M_delta (rad/s2 per unit) with a standard deviation that counts one sample a lag, and the
    share of q's change that the fit explains.

    ``opposed`` : the largest share that a fit of the other sign explains, at another delay of the
    control. ``damped`` : the fit's M_q is negative, as of any aircraft.
    """

    value: float
    std: float
    explained: float
    opposed: float = 0.0
    damped: bool = True


def control_power(columns: KinematicColumns) -> ControlPower | None:
    """Return M_delta of the columns; None where q, a control or a second output is missing or too
    short.
    """
    y = columns.outputs
    partner = next((name for name in ("alpha", "nz") if name in y), None)
    if columns.control is None or "q" not in y or partner is None:
        return None
    lag = lag_of(columns)
    left = change(y["q"], lag)
    if lag < FEWEST_ROWS_PER_PULSE or len(left) // lag < FEWEST_CONTROL_LAGS:
        return None
    sums = [
        change(integral(columns.time, y[name] - np.mean(y[name])), lag) for name in (partner, "q")
    ]
    moved = np.concatenate(
        [
            [0.0],
            np.cumsum((columns.control - np.mean(columns.control))[:-1] * np.diff(columns.time)),
        ]
    )
    result = [
        fitted
        for delay in CONTROL_DELAYS
        if (
            fitted := _control_power_fit(
                left, sums, change(_delayed(columns.time, moved, delay), lag), lag
            )
        )
        is not None
    ]
    if not result:
        return None
    best = max(result, key=lambda one: one.explained)
    return replace(
        best,
        opposed=max((one.explained for one in result if one.value * best.value < 0.0), default=0.0),
    )


def sure(power: ControlPower) -> bool:
    """Return whether sign and size of a control power can be relied on.

    A few samples of a fast motion also agree with a control of the other sign that is delayed by
    half a period, or with an undamped motion. Of 1200 sound records of light aircraft at 8 to 50
    samples a second, one was reported with a wrong sign.
    """
    unrivalled = 1.0 - power.explained < LARGEST_OTHER_SIGN_SHARE * (1.0 - power.opposed)
    return (
        power.damped
        and abs(power.value) > SIGNIFICANT_SIGMAS * power.std
        and power.explained > LEAST_EXPLAINED_SHARE
        and unrivalled
    )


def _control_power_fit(
    left: np.ndarray, sums: list[np.ndarray], moved: np.ndarray, lag: int
) -> ControlPower | None:
    rows = np.stack([*sums, moved, np.ones(len(left))])
    scale = np.sqrt(np.mean(rows**2, axis=1))
    if np.min(scale) <= 0.0:
        return None
    unit = rows / scale[:, None]
    gram = unit @ unit.T
    if np.linalg.cond(gram) > 1e10:
        return None
    inverse = np.linalg.inv(gram)
    coefficients = inverse @ (unit @ left)
    off = left - coefficients @ unit
    power = float(np.sum((left - np.mean(left)) ** 2))
    if power <= 0.0:
        return None
    variance = float(off @ off) / len(left) * lag
    return ControlPower(
        float(coefficients[2] / scale[2]),
        max(float(np.sqrt(variance * inverse[2, 2]) / scale[2]), 1e-300),
        1.0 - float(off @ off) / power,
        damped=bool(coefficients[1] < 0.0),
    )


def _delayed(time: np.ndarray, moved: np.ndarray, delay: float) -> np.ndarray:
    return moved if delay == 0.0 else np.interp(time - delay, time, moved)


# ---- A height that is not in metres

HEIGHT = "altitude"
LENGTHS = {"ft": 0.3048, "km": 1000.0, "cm": 0.01, "mm": 0.001}
# smallest ratio of the unexplained power, in metres to another unit: four times the amplitude
UNIT_POWER_RATIO = 16.0
# largest unexplained share of the power about a straight line in the right unit; noise and varying
# drag leave less
CORRECT_UNIT_SHARE = 0.01
VELOCITY_PARTS = 40  # the velocity is a slope over two fortieths of the record


def height_unit(record: Record, expected: Expectations) -> list[RecordFinding]:
    """Return a finding if the height of a falling body obeys ``expected.gravity`` in another unit
    than metres only.

    Of h(t) in a unit of f metres, f h = c0 + c1 t - g t^2/2 + k D(t), where D is the double
    integral of -v |v| exp(-f h/H), v = f dh/dt, and the drag k is not negative. Near the terminal
    speed all units fit equally, and nothing is found.
    """
    if expected.scale_height is None or HEIGHT not in record.output_names:
        return []
    channel = record[HEIGHT]
    if np.count_nonzero(channel.valid) < 2 * FEWEST_SAMPLES:
        return []
    as_read = _unexplained_height(record.time, channel, 1.0, expected)
    result = sorted(
        (_unexplained_height(record.time, channel, factor, expected), unit)
        for unit, factor in LENGTHS.items()
    )
    (best, unit), (second, _) = result[:2]
    if best > CORRECT_UNIT_SHARE or UNIT_POWER_RATIO * best > min(as_read, second):
        return []
    text = (
        f"is in {unit}, not in m: it falls under gravity as heights in {unit} do (unexplained "
        f"{100.0 * best:.2g} % of the motion)"
    )
    text += f", not as heights in m ({100.0 * as_read:.2g} %)"
    numbers = {
        "unexplained": FindingQuantity(as_read, "1"),
        "unexplained_otherwise": FindingQuantity(best, "1"),
    }
    remedy = f"name the column {HEIGHT} [{unit}], or say its unit in a channel map"
    return [RecordFinding(HEIGHT, Kind.UNIT, Certainty.CERTAIN, text, remedy, numbers=numbers)]


def _unexplained_height(
    time: np.ndarray, channel: Channel, factor: float, expected: Expectations
) -> float:
    """Return the share of a height's power about a straight line that gravity and drag do not
    explain, if its unit is ``factor`` metres.
    """
    t, y = time[channel.valid] - time[channel.valid][0], factor * channel.values[channel.valid]
    velocity = _height_unit_slope(t, y)
    with np.errstate(over="ignore", under="ignore"):
        density = np.exp(-np.clip((y - y[0]) / (expected.scale_height or math.inf), -50.0, 50.0))
    drag = _integral(t, _integral(t, -velocity * np.abs(velocity) * density))
    line = np.stack([np.ones(len(t)), t / t[-1]], axis=1)
    rest = _residual_of(line, y + 0.5 * expected.gravity * t**2)
    along = _residual_of(line, drag)
    power = float(along @ along)
    if power > 0.0:
        rest = rest - max(float(rest @ along) / power, 0.0) * along
    about = _residual_of(line, y)
    total = float(about @ about)
    return float(rest @ rest) / total if total > 0.0 else math.inf


def _residual_of(line: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.asarray(values - line @ np.linalg.lstsq(line, values, rcond=None)[0])


def _height_unit_slope(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the slope of a line through the samples within a fortieth of the record on either
    side, by running sums.
    """
    reach = max(2, len(t) // VELOCITY_PARTS)
    low = np.maximum(np.arange(len(t)) - reach, 0)
    high = np.minimum(np.arange(len(t)) + reach + 1, len(t))
    y = y - y[0]
    sums = [np.concatenate([[0.0], np.cumsum(each)]) for each in (t, y, t * t, t * y)]
    st, sy, stt, sty = (each[high] - each[low] for each in sums)
    count = high - low
    return np.asarray((count * sty - st * sy) / (count * stt - st * st))


def _integral(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
