"""Relations between the channels of one motion, and tests of alternative readings of the columns.

Changes over a lag h of about half a period of the motion are compared, which removes biases and
slow drifts:

- alpha(t + h) - alpha(t) = int (q - (g/V) (nz - nz_0)) dt. Without nz, the load term is replaced by
  Z alpha with a fitted Z > 0. Without alpha, the change of nz is that of alpha times a fitted
  k > 0.
- theta(t + h) - theta(t) = int q dt.
- q(t + h) - q(t) = M_alpha int alpha dt + M_q int q dt + M_delta int delta(t - delay) dt + c h, by
  least squares. nz replaces a missing alpha.

The integrals are from t to t + h.
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
    Kind,
    RecordFinding,
    quantities,
)
from sim.maths import G0
from sim.record import Channel, Record

# ---- Relations between the channels of one motion

MOTION_CHANNELS = ("alpha", "q", "nz", "theta")
LOWEST_AIRSPEED = 20.0  # m/s, lowest airspeed where it is unknown
LEAST_AIRSPEED = 5.0  # m/s, lowest airspeed of any aircraft
HIGHEST_AIRSPEED = 400.0  # m/s, highest airspeed where it is unknown
LARGEST_LIFT_DAMPING = 10.0  # 1/s: largest damping of alpha by lift
FEWEST_ROWS = 40  # fewest rows of a record
MOST_ROWS = 3000  # most rows that are compared
LONGEST_LAG = 300  # rows, and at most an eighth of the record
# autocorrelation of the motion, over that at one row, at a lag of half a period
HALF_PERIOD_CORRELATION = 0.5
POWER_FLOOR = 1e-30  # a smaller power is zero
# smallest ratio of the lag to the distance between two valid samples of a channel: straight lines
# between more distant samples do not follow the motion
FEWEST_ROWS_PER_LAG = 2
SHIFTS = (0.0, 0.05, 0.1, 0.2)  # s: delays of a sensor that are tried
LONGEST_DELAY = 0.3  # s: largest delay, or arm over airspeed, of a sensor without another fault


@dataclass(frozen=True, eq=False)
class KinematicColumns:
    """Channels of a motion on one time base, without gaps and without single wrong samples.

    Attributes
    ----------
    time : ``(N,)``, s.
    outputs : name -> ``(N,)``.
    control : ``(N,)`` first input, held between samples; None without an input.
    control_name : name of this input; empty without one.
    gravity_over_speed : 1/s; None where the airspeed is unknown.
    """

    time: np.ndarray
    outputs: Mapping[str, np.ndarray]
    control: np.ndarray | None
    control_name: str
    gravity_over_speed: float | None

    def scaled(self, factors: Mapping[str, float]) -> KinematicColumns:
        """Return the columns with some channels multiplied by ``factors``, name -> factor. The
        control and "time" may be among them.
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
        outputs = dict(self.outputs)
        if self.control is not None and self.control_name in (first, second):
            output = second if first == self.control_name else first
            control, outputs[output] = outputs[output], self.control
            return replace(self, outputs=outputs, control=control)
        outputs[first], outputs[second] = outputs[second], outputs[first]
        return replace(self, outputs=outputs)


def columns_of(record: Record, expected: Expectations) -> KinematicColumns | None:
    """Return the channels of the longitudinal motion, with nz = -az/g0 where only az is recorded.

    The result is None if there is no such channel, or if the record is too short or too sparse.
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
    if not outputs:
        return None
    valid_rows = [
        np.flatnonzero(record[name].valid)
        for name in (*MOTION_CHANNELS, "az")
        if name in record.output_names
    ]
    sample_distance = max(
        int(np.median(np.diff(rows))) if len(rows) > 1 else len(record) for rows in valid_rows
    )
    if expected.airspeed:
        gravity_over_speed: float | None = expected.gravity / expected.airspeed
    else:
        gravity_over_speed = _gravity_over_recorded_speed(record, expected.gravity)
    control = record.inputs[0] if record.inputs else None
    columns = KinematicColumns(
        record.time[rows],
        outputs,
        None if control is None else control.values[rows],
        "" if control is None else control.name,
        gravity_over_speed,
    )
    return columns if sample_distance * FEWEST_ROWS_PER_LAG <= lag_of(columns) else None


def disagreement(columns: KinematicColumns) -> dict[str, float]:
    """Return output -> unexplained share of the power of its relation. The share is 0 if the
    relation holds, 1 if both sides are uncorrelated, and 2 if they are equal with opposite signs.
    """
    lag = lag_of(columns)
    sides = relations(columns, lag)
    if not sides:
        return {}
    change_of_q = change(columns.outputs["q"], lag)
    return {
        name: _unexplained_share(left, right, change_of_q - np.mean(change_of_q))
        for name, (left, right) in sides.items()
    }


def relations(columns: KinematicColumns, lag: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return output -> both sides ``(N - lag,)`` of its relation, without their means, for the
    relations whose channels are recorded. ``lag`` is in rows.
    """
    y = columns.outputs
    changes = {name: change(values, lag) for name, values in y.items()}
    integrals = {
        name: change(integral(columns.time, values - np.mean(values)), lag)
        for name, values in y.items()
    }
    sides = {}
    if "q" in y and "alpha" in y:
        lift_rate = integrals["q"] - changes["alpha"]
        if "nz" in y:
            factor = columns.gravity_over_speed
            if factor is None:
                slope = _slope(integrals["nz"], lift_rate)
                factor = float(np.clip(slope, G0 / HIGHEST_AIRSPEED, G0 / LOWEST_AIRSPEED))
            sides["alpha"] = (changes["alpha"], integrals["q"] - factor * integrals["nz"])
        else:
            slope = _slope(integrals["alpha"], lift_rate)
            damping = float(np.clip(slope, 0.0, LARGEST_LIFT_DAMPING))
            sides["alpha"] = (changes["alpha"], integrals["q"] - damping * integrals["alpha"])
    elif "q" in y and "nz" in y and columns.gravity_over_speed is not None:
        change_of_alpha = integrals["q"] - columns.gravity_over_speed * integrals["nz"]
        factor = max(_slope(change_of_alpha, changes["nz"]), 0.0)
        sides["nz"] = (changes["nz"], factor * change_of_alpha)
    if "q" in y and "theta" in y:
        sides["theta"] = (changes["theta"], integrals["q"])
    return {
        name: (left - np.mean(left), right - np.mean(right))
        for name, (left, right) in sides.items()
    }


def fitted_gravity_over_speed(columns: KinematicColumns) -> float | None:
    """Return gravity over the airspeed, 1/s, at which alpha, q and nz agree best.

    The result is None if one of these channels is missing, or if no aircraft flies at this
    airspeed.
    """
    y = columns.outputs
    if not {"alpha", "q", "nz"} <= set(y):
        return None
    lag = lag_of(columns)
    pitch, load = (
        change(integral(columns.time, y[name] - np.mean(y[name])), lag) for name in ("q", "nz")
    )
    lift_rate = pitch - change(y["alpha"], lag)
    # A vane ahead of the centre of gravity, or with a delay, adds a multiple of the change of q.
    regressors = np.stack([load, change(y["q"], lag)])
    regressors = regressors - regressors.mean(axis=1, keepdims=True)
    coefficients = np.linalg.lstsq(regressors.T, lift_rate - np.mean(lift_rate), rcond=None)[0]
    slope = float(coefficients[0])
    return slope if G0 / HIGHEST_AIRSPEED <= slope <= G0 / LEAST_AIRSPEED else None


def unexplained_lift(columns: KinematicColumns) -> tuple[float, float] | None:
    """Return the share of the power of nz that alpha and the control do not explain, and the number
    of independent samples; None without alpha or nz.

    The model is nz - nz_0 = a alpha + b delta with a >= |b|: lift rises with the angle of attack,
    and a control surface gives less lift per radian than the whole aircraft. Integrals over a lag
    are compared, since they average the noise. Either side may be delayed by one of the ``SHIFTS``.
    """
    y = columns.outputs
    if not {"alpha", "nz"} <= set(y):
        return None
    lag, step = lag_of(columns), float(np.median(np.diff(columns.time)))
    control = np.zeros(len(columns.time)) if columns.control is None else columns.control
    load, alpha, surface = (
        change(integral(columns.time, values - np.mean(values)), lag)
        for values in (y["nz"], y["alpha"], control)
    )
    n = len(load)
    shifts = sorted({min(round(shift / step), n // 4) for shift in SHIFTS})
    shifted = [(load[: n - k], alpha[k:], surface[: n - k]) for k in shifts]
    shifted += [(load[k:], alpha[: n - k], surface[: n - k]) for k in shifts]
    return min(_unexplained_share_of_lift(*series) for series in shifted), n / lag


def _unexplained_share_of_lift(load: np.ndarray, alpha: np.ndarray, surface: np.ndarray) -> float:
    """Return the unexplained share of a load, regressed on alpha + surface and alpha - surface."""
    load, alpha, surface = (values - np.mean(values) for values in (load, alpha, surface))
    power = float(load @ load)
    if power <= POWER_FLOOR:
        return 0.0
    regressors = np.stack([alpha + surface, alpha - surface])
    gram, right = regressors @ regressors.T, regressors @ load
    explained = max(
        right[i] ** 2 / gram[i, i] if right[i] > 0.0 and gram[i, i] > POWER_FLOOR else 0.0
        for i in range(2)
    )
    if np.linalg.det(gram) > POWER_FLOOR * max(gram[0, 0] * gram[1, 1], POWER_FLOOR):
        factors = np.linalg.solve(gram, right)
        if np.all(factors > 0.0):
            explained = float(factors @ right)
    return max(1.0 - explained / power, POWER_FLOOR)


def lag_of(columns: KinematicColumns) -> int:
    """Return the lag, in rows, at which the autocovariance of the motion has fallen to half of its
    value at a lag of one row.
    """
    name = next((name for name in ("q", "alpha", "nz", "theta") if name in columns.outputs), None)
    if name is None:
        return 1
    values = columns.outputs[name] - np.mean(columns.outputs[name])
    longest = max(3, min(len(values) // 8, LONGEST_LAG))
    at_one_row = float(values[:-1] @ values[1:]) / (len(values) - 1)
    for lag in range(2, longest):
        covariance = float(values[:-lag] @ values[lag:]) / (len(values) - lag)
        if covariance < HALF_PERIOD_CORRELATION * at_one_row:
            return lag
    return longest - 1


def _unexplained_share(left: np.ndarray, right: np.ndarray, change_of_q: np.ndarray) -> float:
    """Return the power of the difference of both sides of a relation, over the power of both. A
    multiple of the change of q, which a delay or an arm of a sensor causes, is first removed from
    the difference.
    """
    power = float(left @ left + right @ right)
    if power <= POWER_FLOOR:
        return 0.0
    difference = left - right
    delay = float(np.clip(_slope(change_of_q, difference), -LONGEST_DELAY, LONGEST_DELAY))
    difference = difference - delay * change_of_q
    return float(difference @ difference) / power


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    """Return the slope of the regression line of y over x; zero for a constant x."""
    x, y = x - np.mean(x), y - np.mean(y)
    power = float(x @ x)
    return float(x @ y) / power if power > POWER_FLOOR else 0.0


def change(values: np.ndarray, lag: int) -> np.ndarray:
    """Return the changes ``(N - lag,)`` of ``values (N,)`` over ``lag`` rows."""
    return np.asarray(values[lag:] - values[:-lag])


def integral(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the integral ``(N,)`` of ``values (N,)`` from the first sample, by the trapezoidal
    rule.
    """
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])


def _bridged(record: Record, name: str) -> np.ndarray:
    """Return a channel with gaps interpolated, after a median of three samples."""
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

DEGREES = math.degrees(1.0)  # degrees in a radian
TIME_UNITS = {1e-3: "ms", 1e-6: "us"}
SHORTEST_STEP = 5e-4  # s: recorders of aircraft motion sample at 2000 Hz at most
UNITS = {"alpha": "deg", "q": "deg/s", "theta": "deg"}
RENAME = "give each column its own name, or a channel map"
NZ_REMEDY = "name the column nz [m/s2], or say its unit in a channel map"


@dataclass(frozen=True, eq=False)
class ColumnReading:
    """A reading of the columns under the assumption of one fault.

    Attributes
    ----------
    kind : kind of the fault.
    channel : name of the channel with the fault.
    columns : the columns with the fault corrected.
    sentence : statement of the fault.
    remedy : how to correct it in the file.
    unexplained : largest unexplained share of a relation.
    """

    kind: Kind
    channel: str
    columns: KinematicColumns
    sentence: str
    remedy: str
    unexplained: float


def all_readings(columns: KinematicColumns) -> list[ColumnReading]:
    """Return the readings of the columns under every simple fault."""
    names = list(columns.outputs)
    readings: list[ColumnReading] = []

    def add(
        kind: Kind, channel: str, corrected: KinematicColumns, sentence: str, remedy: str
    ) -> None:
        share = max(disagreement(corrected).values(), default=2.0)
        readings.append(ColumnReading(kind, channel, corrected, sentence, remedy, share))

    for name in names:
        remedy = f"turn the sign of the column of {name}"
        add(Kind.SIGN, name, columns.scaled({name: -1.0}), "has the sign turned", remedy)
        if name in UNITS:
            sentence = f"is in {UNITS[name]}, not in {UNITS[name].replace('deg', 'rad')}"
            remedy = f"name the column {name} [{UNITS[name]}], or say its unit in a channel map"
            add(Kind.UNIT, name, columns.scaled({name: 1.0 / DEGREES}), sentence, remedy)
    if "nz" in names:
        add(Kind.UNIT, "nz", columns.scaled({"nz": 1.0 / G0}), "is in m/s2, not in g", NZ_REMEDY)
        sentence = f"is {G0:.2g} times too small"
        add(Kind.UNIT, "nz", columns.scaled({"nz": G0}), sentence, "check its unit")
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    pairs += [(name, columns.control_name) for name in names if columns.control is not None]
    for a, b in pairs:
        add(Kind.EXCHANGED, f"{a} and {b}", columns.exchanged(a, b), "are exchanged", RENAME)
    step = float(np.median(np.diff(columns.time)))
    for factor, unit in TIME_UNITS.items():
        if factor * step >= SHORTEST_STEP:
            sentence = f"is in {unit}, not in s"
            remedy = f"name the column time [{unit}], or say its unit in a channel map"
            add(Kind.TIME_BASE, "time", columns.scaled({"time": factor}), sentence, remedy)
    return readings


# ---- Control power: pitch acceleration per unit of a recorded control

# s, delays and lags of controls that are tried
CONTROL_DELAYS = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2, 0.25, 0.3)
# smallest control power, in sigmas; the sigmas are rough, with one independent sample in a lag
SIGNIFICANT_SIGMAS = 8.0
# smallest explained share of the change of q: at least 0.79 in a hundred records with any effect of
# the library
LEAST_EXPLAINED_SHARE = 0.8
# largest unexplained share over that of the other sign. Observed: 0.37 with the wrong sign at 10
# samples a second, 0.1 with the right one at 50
LARGEST_OTHER_SIGN_SHARE = 0.25
# smallest lag, rows: with a smaller one, the begin of a pulse between two rows matters
FEWEST_ROWS_PER_PULSE = 4
FEWEST_CONTROL_LAGS = 12  # fewest independent samples, one in a lag
LARGEST_CONDITION_NUMBER = 1e10


@dataclass(frozen=True)
class ControlPower:
    """Control power M_delta by least squares.

    Attributes
    ----------
    value : M_delta, rad/s2 per unit of the control.
    std : its standard deviation, with one independent sample in a lag.
    explained : share of the power of the change of q that the fit explains.
    explained_opposite : the same for the best fit with the other sign of M_delta, at another delay.
    damped : whether M_q is negative, as for any aircraft.
    """

    value: float
    std: float
    explained: float
    explained_opposite: float = 0.0
    damped: bool = True


def control_power(columns: KinematicColumns) -> ControlPower | None:
    """Return M_delta at the best delay of the control.

    The result is None if q, the control, or both alpha and nz are missing, or if the record is too
    short.
    """
    y = columns.outputs
    angle = next((name for name in ("alpha", "nz") if name in y), None)
    if columns.control is None or "q" not in y or angle is None:
        return None
    lag = lag_of(columns)
    change_of_q = change(y["q"], lag)
    if lag < FEWEST_ROWS_PER_PULSE or len(change_of_q) // lag < FEWEST_CONTROL_LAGS:
        return None
    integrals = [
        change(integral(columns.time, y[name] - np.mean(y[name])), lag) for name in (angle, "q")
    ]
    control = (columns.control - np.mean(columns.control))[:-1]
    control_integral = np.concatenate([[0.0], np.cumsum(control * np.diff(columns.time))])
    fits = []
    for delay in CONTROL_DELAYS:
        delayed = control_integral
        if delay:
            delayed = np.interp(columns.time - delay, columns.time, control_integral)
        fit = _control_power_fit(change_of_q, [*integrals, change(delayed, lag)], lag)
        fits += [fit] if fit is not None else []
    if not fits:
        return None
    best = max(fits, key=lambda fit: fit.explained)
    explained_opposite = [fit.explained for fit in fits if fit.value * best.value < 0.0]
    return replace(best, explained_opposite=max(explained_opposite, default=0.0))


def is_reliable(power: ControlPower) -> bool:
    """Return whether sign and size of a control power are reliable.

    A few samples of a fast motion also agree with a control of the other sign that is delayed by
    half a period, or with an undamped motion. With these criteria, one of 1200 correct records of
    light aircraft, at 8 to 50 samples a second, was reported with a wrong sign.
    """
    sign_is_clear = 1.0 - power.explained < LARGEST_OTHER_SIGN_SHARE * (
        1.0 - power.explained_opposite
    )
    return (
        power.damped
        and abs(power.value) > SIGNIFICANT_SIGMAS * power.std
        and power.explained > LEAST_EXPLAINED_SHARE
        and sign_is_clear
    )


def _control_power_fit(
    change_of_q: np.ndarray, integrals: list[np.ndarray], lag: int
) -> ControlPower | None:
    """Return the regression of the change of q on ``integrals``; None if these are collinear."""
    regressors = np.stack([*integrals, np.ones(len(change_of_q))])
    scale = np.sqrt(np.mean(regressors**2, axis=1))
    if np.min(scale) <= 0.0:
        return None
    scaled = regressors / scale[:, None]
    gram = scaled @ scaled.T
    if np.linalg.cond(gram) > LARGEST_CONDITION_NUMBER:
        return None
    inverse = np.linalg.inv(gram)
    coefficients = inverse @ (scaled @ change_of_q)
    residual = change_of_q - coefficients @ scaled
    power = float(np.sum((change_of_q - np.mean(change_of_q)) ** 2))
    if power <= 0.0:
        return None
    variance = float(residual @ residual) / len(residual) * lag
    return ControlPower(
        float(coefficients[2] / scale[2]),
        max(float(np.sqrt(variance * inverse[2, 2]) / scale[2]), 1e-300),
        1.0 - float(residual @ residual) / power,
        damped=bool(coefficients[1] < 0.0),
    )


# ---- A height that is not in metres

HEIGHT = "altitude"
LENGTH_UNITS = {"ft": 0.3048, "km": 1000.0, "cm": 0.01, "mm": 0.001}
# smallest ratio of the unexplained power in metres to that in the right unit: four in amplitude
UNIT_POWER_RATIO = 16.0
# largest unexplained share in the right unit; noise and varying drag leave less
CORRECT_UNIT_SHARE = 0.01
VELOCITY_PARTS = 40  # the velocity is a slope over two fortieths of the record
LARGEST_DENSITY_EXPONENT = 50.0  # larger exponents are limited, so that the density is finite


def height_unit_findings(record: Record, expected: Expectations) -> list[RecordFinding]:
    """Return a finding if the height of a falling body agrees with gravity in another unit, and not
    in metres.

    A height h(t) in a unit of f metres obeys f h = c0 + c1 t - g t^2/2 + k D(t). D is the double
    integral of -v |v| exp(-f h/H) over time, with v = f dh/dt and the scale height H of the air
    density. The drag factor k is not negative. Near the terminal speed all units fit equally well,
    and there is no finding.
    """
    if expected.scale_height is None or HEIGHT not in record.output_names:
        return []
    channel = record[HEIGHT]
    if np.count_nonzero(channel.valid) < 2 * FEWEST_SAMPLES:
        return []
    share_in_metres = _unexplained_height(record.time, channel, 1.0, expected)
    shares = sorted(
        (_unexplained_height(record.time, channel, factor, expected), unit)
        for unit, factor in LENGTH_UNITS.items()
    )
    (best, unit), (second, _) = shares[:2]
    if best > CORRECT_UNIT_SHARE or UNIT_POWER_RATIO * best > min(share_in_metres, second):
        return []
    text = (
        f"is in {unit}, not in m: it falls under gravity as heights in {unit} do (unexplained "
        f"{100.0 * best:.2g} % of the motion), not as heights in m "
        f"({100.0 * share_in_metres:.2g} %)"
    )
    numbers = quantities(unexplained=share_in_metres, unexplained_otherwise=best)
    remedy = f"name the column {HEIGHT} [{unit}], or say its unit in a channel map"
    return [RecordFinding(HEIGHT, Kind.UNIT, Certainty.CERTAIN, text, remedy, numbers=numbers)]


def _unexplained_height(
    time: np.ndarray, channel: Channel, factor: float, expected: Expectations
) -> float:
    """Return the share of the power of a height that gravity and drag do not explain, if its unit
    is ``factor`` metres. All powers are those about straight lines.
    """
    t, y = time[channel.valid] - time[channel.valid][0], factor * channel.values[channel.valid]
    velocity = _local_slope(t, y)
    exponent = (y - y[0]) / (expected.scale_height or math.inf)
    with np.errstate(over="ignore", under="ignore"):
        density = np.exp(-np.clip(exponent, -LARGEST_DENSITY_EXPONENT, LARGEST_DENSITY_EXPONENT))
    drag = integral(t, integral(t, -velocity * np.abs(velocity) * density))
    line = np.stack([np.ones(len(t)), t / t[-1]], axis=1)
    residual = _residual_of(line, y + 0.5 * expected.gravity * t**2)
    drag_about_line = _residual_of(line, drag)
    drag_power = float(drag_about_line @ drag_about_line)
    if drag_power > 0.0:
        factor_of_drag = max(float(residual @ drag_about_line) / drag_power, 0.0)
        residual = residual - factor_of_drag * drag_about_line
    height_about_line = _residual_of(line, y)
    height_power = float(height_about_line @ height_about_line)
    return float(residual @ residual) / height_power if height_power > 0.0 else math.inf


def _residual_of(line: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return ``values (N,)`` minus their regression on the columns of ``line (N, 2)``."""
    return np.asarray(values - line @ np.linalg.lstsq(line, values, rcond=None)[0])


def _local_slope(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the slope ``(N,)`` of a line through a fortieth of the record on either side."""
    reach = max(2, len(t) // VELOCITY_PARTS)
    low = np.maximum(np.arange(len(t)) - reach, 0)
    high = np.minimum(np.arange(len(t)) + reach + 1, len(t))
    y = y - y[0]
    sums = [np.concatenate([[0.0], np.cumsum(values)]) for values in (t, y, t * t, t * y)]
    st, sy, stt, sty = (running[high] - running[low] for running in sums)
    count = high - low
    return np.asarray((count * sty - st * sy) / (count * stt - st * st))
